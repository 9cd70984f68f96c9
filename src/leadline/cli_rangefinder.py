"""The command line of a rangefinder that is not there: `leadline rangefinder`. Parses, calls, prints."""

from __future__ import annotations

from typing import Annotated

import typer


def rangefinder(
    protocol: Annotated[str, typer.Option(help="jrt, m703a, dimetix, lightware, lightware-text or text.")] = "jrt",
    range_m: Annotated[float, typer.Option("--range", min=0.01, help="Distance it reads, m.")] = 1.5,
    sway_m: Annotated[float, typer.Option("--sway", min=0.0, help="It swings to and fro by so much, m.")] = 0.2,
    rate_hz: Annotated[float, typer.Option("--rate", min=0.1, help="Readings a second.")] = 3.0,
) -> None:
    """A simulated rangefinder on a serial port, to try a set-up out; until Ctrl-C."""
    from leadline.sources.laser_simulated import SimulatedLaser, swaying  # noqa: PLC0415  heavy imports wait until needed

    with SimulatedLaser(protocol, swaying(protocol, range_m, sway_m), rate_hz) as laser:
        typer.echo(f"serial:{laser.port}?protocol={protocol}")
        try:
            laser.wait()
        except KeyboardInterrupt:
            typer.echo(f"{laser.sent} readings sent")
