"""The command line of calibration: `leadline calibrate ...` and `leadline board`. Parses, calls, prints."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leadline.cli_progress import progress
from leadline.errors import InputError

if TYPE_CHECKING:
    from leadline.calibration.board import Board
    from leadline.pipeline.calibrate_cameras import CameraReport
    from leadline.pipeline.calibrate_laser import LaserReport

app = typer.Typer(no_args_is_help=True, help="Calibrate cameras, port, laser and range; check a rig.")

_FILE_WIDTH = 160  # of tables that go to a file or a pipe, where nothing need be cut off

BoardOption = Annotated[str, typer.Option(help="Inner corners, COLUMNSxROWS.")]
SquareOption = Annotated[float, typer.Option(help="Side of a square in metres.")]
CharucoOption = Annotated[str | None, typer.Option(help="ArUco dictionary of a ChArUco board, such as 5X5_100.")]
MarkerOption = Annotated[float | None, typer.Option(help="Side of a ChArUco marker, metres; default: 0.7 squares.")]


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
    charuco: CharucoOption = None,
    marker: MarkerOption = None,
    warp: Annotated[bool, typer.Option("--warp", help="The board may be bent: estimate by how much.")] = False,
) -> None:
    """Cameras, their pose, the port and the water's index from boards in air and in water."""
    from leadline.calibration.cameras import CameraSettings  # noqa: PLC0415  heavy imports wait until they are needed
    from leadline.pipeline.build import stated_water  # noqa: PLC0415
    from leadline.pipeline.calibrate_cameras import calibrate  # noqa: PLC0415

    settings = CameraSettings(port_thickness, port_index, stated_water(water_state), warp)
    target, behind_port = make_board(board, square, charuco, marker), air_port is AirPort.WITH
    with progress("looking for boards") as tick:
        report = calibrate(target, out, air=air, water=water, air_port=behind_port, settings=settings, tick=tick)
    _print_cameras(report)


@app.command("check")
def check(
    rig: Annotated[str, typer.Option(help="Rig file or a shipped rig.")],
    dive: Annotated[Path, typer.Option(help="Folder of board images or a dive folder, not used in the calibration.")],
    board: BoardOption,
    square: SquareOption,
    charuco: CharucoOption = None,
    marker: MarkerOption = None,
) -> None:
    """How good is a rig on boards that it has not seen? Verdict and next action."""
    from leadline.cli_calibrate_tables import check_lines  # noqa: PLC0415
    from leadline.pipeline.calibrate_cameras import check as run_check  # noqa: PLC0415

    target = make_board(board, square, charuco, marker)
    with progress("looking for boards") as tick:
        held_out, remarks = run_check(rig, dive, target, tick)
    for line in (*remarks, *check_lines(held_out, target)):
        typer.echo(line)


class LaserMedium(StrEnum):
    AIR = "air"
    WATER = "water"


class LaserMethod(StrEnum):
    ML = "ml"
    PAPER = "paper"


DiveOption = Annotated[str, typer.Option(help="A static dive: folder or .mcap; stations 2 s and more.")]
RigOption = Annotated[str, typer.Option(help="Rig file or a shipped rig.")]
RigOutOption = Annotated[Path, typer.Option(help="Rig file to write; may be the same.")]
NoBoardOption = Annotated[str | None, typer.Option(help="Inner corners, COLUMNSxROWS; needed where no spot is seen.")]
NoSquareOption = Annotated[float | None, typer.Option(help="Side of a square in metres.")]


@app.command("laser")
def laser(
    dive: Annotated[str, typer.Option(help="A static dive with the spot in both images, or images/ and ranges.csv.")],
    out: RigOutOption,
    rig: Annotated[str | None, typer.Option(help="Rig file; may be left out with ranges.csv.")] = None,
    board: NoBoardOption = None,
    square: NoSquareOption = None,
    medium: Annotated[LaserMedium, typer.Option(help="Where the dive was made.")] = LaserMedium.AIR,
    air_port: Annotated[AirPort, typer.Option(help="Were the air images taken through the port?")] = AirPort.WITHOUT,
    method: Annotated[LaserMethod, typer.Option(help="Ours, or the paper's stacked equations.")] = LaserMethod.ML,
) -> None:
    """Where the laser's beam runs, and its range's scale and offset."""
    from leadline.pipeline import calibrate_laser  # noqa: PLC0415

    aimed_at = _optional_board(board, square)
    how = {"medium": medium.value, "air_port": air_port.value, "method": method.value}
    with progress("looking for the spot" if aimed_at is None else "looking for boards") as tick:
        report = calibrate_laser.laser(dive, rig, out, board=aimed_at, **how, tick=tick)
    _say(report, out)


@app.command("range")
def water_range(
    dive: DiveOption,
    rig: RigOption,
    out: RigOutOption,
    board: NoBoardOption = None,
    square: NoSquareOption = None,
    refine: Annotated[bool, typer.Option("--refine", help="Refine port, index and cameras too.")] = False,
    port_distance: Annotated[
        float | None,
        typer.Option(help="With --refine, pupil to glass in metres, known to 2 mm; default: 0.015 +-0.01."),
    ] = None,
    port_thickness: Annotated[float | None, typer.Option(help="Of the glass, metres; default: 0.002 +-0.001.")] = None,
    port_index: Annotated[float | None, typer.Option(help="Of the glass; default: 1.52 +-0.03.")] = None,
    water_state: Annotated[
        str | None, typer.Option(help="With --refine: salinity=PSU,temperature=C,depth=M; default: 1.338 +-0.004.")
    ] = None,
) -> None:
    """In water: what the readings mean, and the paper's f'; with --refine also port, index and cameras."""
    from leadline.pipeline import calibrate_laser  # noqa: PLC0415
    from leadline.pipeline.build import stated_water  # noqa: PLC0415

    _optional_board(board, square)  # a spot needs none; it is checked all the same
    guess = calibrate_laser.port_guess(port_distance, port_thickness, port_index)
    water = stated_water(water_state)
    with progress("looking for the spot") as tick:
        report = calibrate_laser.water_range(dive, rig, out, refined=refine, guess=guess, water=water, tick=tick)
    _say(report, out)


def _optional_board(size: str | None, square: float | None) -> Board | None:
    from leadline.calibration.board import Board  # noqa: PLC0415

    if (size is None) != (square is None):
        raise InputError("--board and --square go together", "", "give both or neither")
    return None if size is None or square is None else Board.parse(size, square)


def _say(report: LaserReport, out: Path) -> None:
    """Remarks, then tables, then the file."""
    from rich.table import Table  # noqa: PLC0415

    from leadline.cli_console import open_console  # noqa: PLC0415

    console = open_console()
    if not console.is_terminal:
        console.width = _FILE_WIDTH
    for line in report.lines:
        typer.echo(line)
    for title, heads, rows in report.tables:
        table = Table(*heads, title=title, title_justify="left")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    typer.echo(str(out))


class RigFormat(StrEnum):
    LEADLINE = "leadline"
    OPENCV = "opencv"
    ROS = "ros"


@app.command("convert")
def convert(
    source: Annotated[list[Path], typer.Argument(metavar="FILE...", help="A rig file, or another program's: 1 or 2.")],
    out: Annotated[Path, typer.Option(help="File to write; for ros a folder.")],
    to: Annotated[RigFormat, typer.Option("--format", help="opencv and ros get the in-water pinhole.")] = (
        RigFormat.LEADLINE
    ),
    size: Annotated[str | None, typer.Option(help="WIDTHxHEIGHT, for an OpenCV file without.")] = None,
) -> None:
    """Between rig files and calibmar (in), OpenCV's stereo YAML and the ROS camera_info pair (in and out)."""
    from leadline.pipeline.convert import convert as run_convert  # noqa: PLC0415

    for file in run_convert(source, out, to.value, size):
        typer.echo(str(file))


def board(
    out: Annotated[Path, typer.Option(help="PDF to write.")] = Path("board.pdf"),
    size: Annotated[str, typer.Option(help="Inner corners, COLUMNSxROWS.")] = "11x8",
    square: SquareOption = 0.030,
    charuco: CharucoOption = None,
    marker: MarkerOption = None,
) -> None:
    """A calibration board as a PDF that measures right on paper (print at 100 %)."""
    from leadline.wire.board_pdf import write_board  # noqa: PLC0415

    width, height = write_board(out, make_board(size, square, charuco, marker))
    typer.echo(f"{out}: {width * 1e3:.1f} x {height * 1e3:.1f} mm; print at 100 %")


def make_board(size: str, square_m: float, charuco: str | None = None, marker_m: float | None = None) -> Board:
    from leadline.calibration.board import Board, Charuco  # noqa: PLC0415

    if charuco is None:
        return Board.parse(size, square_m)
    return Board.parse(size, square_m, Charuco(charuco, 0.7 * square_m if marker_m is None else marker_m))


def _print_cameras(report: CameraReport) -> None:
    from leadline.cli_calibrate_tables import camera_lines  # noqa: PLC0415

    for line in camera_lines(report):
        typer.echo(line)
