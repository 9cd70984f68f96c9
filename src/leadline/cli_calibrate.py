"""The command line of calibration: `leadline calibrate ...` and `leadline board`. Parses, calls, prints."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, help="Calibrate cameras, port, laser and range; check a rig.")

BoardOption = Annotated[str, typer.Option(help="Inner corners, COLUMNSxROWS.")]
SquareOption = Annotated[float, typer.Option(help="Side of a square in metres.")]


class AirPort(StrEnum):
    WITHOUT = "without"
    WITH = "with"


@app.command("cameras")
def cameras(
    out: Annotated[Path, typer.Option(help="Rig file to write; a page (.html) stands beside it.")],
    board: BoardOption,
    square: SquareOption,
    air: Annotated[Path | None, typer.Option(help="Folder of board images in air.")] = None,
    water: Annotated[Path | None, typer.Option(help="Folder of board images in water.")] = None,
    port_thickness: Annotated[float | None, typer.Option(help="Of the glass, metres; default: 0.002 +-0.001.")] = None,
    port_index: Annotated[float | None, typer.Option(help="Of the glass; default: 1.52 +-0.03.")] = None,
    air_port: Annotated[AirPort, typer.Option(help="Were the air images taken through the port?")] = AirPort.WITHOUT,
    water_state: Annotated[
        str | None, typer.Option(help="salinity=PSU,temperature=C,depth=M; default: index 1.338 +-0.004.")
    ] = None,
    charuco: Annotated[str | None, typer.Option(help="ArUco dictionary of a ChArUco board, such as 5X5_100.")] = None,
    marker: Annotated[float | None, typer.Option(help="Side of a ChArUco marker, metres.")] = None,
) -> None:
    """Cameras, their pose, the port and the water's index from boards in air and in water."""


@app.command("check")
def check(
    rig: Annotated[str, typer.Option(help="Rig file or a shipped rig.")],
    dive: Annotated[Path, typer.Option(help="Folder of board images or a dive folder, not used in the calibration.")],
    board: BoardOption,
    square: SquareOption,
) -> None:
    """How good is a rig on boards that it has not seen? Verdict and next action."""


def board(
    out: Annotated[Path, typer.Option(help="PDF to write.")] = Path("board.pdf"),
    size: Annotated[str, typer.Option(help="Inner corners, COLUMNSxROWS.")] = "11x8",
    square: SquareOption = 0.030,
) -> None:
    """A calibration board as a PDF that measures right on paper (print at 100 %)."""
