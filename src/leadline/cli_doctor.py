"""The command line of the check before a dive: `leadline doctor`. Parses, calls, prints."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from leadline.cli_console import open_console
from leadline.cli_progress import progress

COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}


def doctor(
    source: Annotated[
        str | None, typer.Argument(metavar="[SOURCE]", help="Live devices (uvc:0+serial:/dev/ttyUSB0) or a dive.")
    ] = None,
    rig: Annotated[str | None, typer.Option(help="Rig file or a shipped rig.")] = None,
    out: Annotated[Path, typer.Option(help="Where the dive is going to be recorded.")] = Path(),
    model: Annotated[Path | None, typer.Option(help="Detector (ONNX); default: the shipped one for balls.")] = None,
    fps: Annotated[float | None, typer.Option(min=0.1, help="Wanted frames a second; default: the camera's.")] = None,
    seconds: Annotated[float, typer.Option(min=1.0, help="How long to listen to live devices.")] = 4.0,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """Check cameras, laser, rig, disk, clock, model and speed before a dive, and say what to do."""
    from leadline.pipeline.doctor import Level, examine, worst  # noqa: PLC0415  heavy imports wait until needed

    findings = []
    with progress("examining") as tick:
        for finding in examine(source, rig, out, model=model, fps=fps, seconds=seconds):
            findings.append(finding)
            tick(len(findings), None)
    if as_json:
        typer.echo(json.dumps([dataclasses.asdict(finding) for finding in findings], indent=1))
    else:
        table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
        table.add_column(no_wrap=True)
        table.add_column(no_wrap=True)
        table.add_column(overflow="fold")
        for finding in findings:
            said = finding.said + (f"\n→ {finding.advice}" if finding.advice else "")
            table.add_row(Text(finding.level, COLOURS[finding.level]), finding.part, said)
        open_console().print(table)
    if worst(findings) is Level.FAIL:
        raise typer.Exit(1)
