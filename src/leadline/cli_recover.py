"""The command line of damaged recordings: `leadline recover`. Parses, calls, prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def recover(
    file: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="A cut or damaged recording.")],
    out: Annotated[Path | None, typer.Option(help="New file; default: FILE.recovered.mcap.")] = None,
) -> None:
    """Make a whole, indexed file of what can be read of a recording, and say what was lost."""
    from leadline.wire.recording import recover as recover_file  # noqa: PLC0415  heavy imports wait until needed

    target = out or file.with_suffix(".recovered.mcap")
    recovery = recover_file(file, target)
    for line in recovery.lost:
        typer.echo(f"{file.name}: {line}")
    if not recovery.lost:
        typer.echo("nothing was lost")
    for topic, count in sorted(recovery.counts.items()):
        typer.echo(f"{count:8d} {topic}")
    typer.echo(f"{target}: {recovery.length_s:.2f} s, {sum(recovery.counts.values())} messages, read back and decoded")
