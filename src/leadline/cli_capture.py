"""The command line of guided capture: `leadline capture`. Parses, calls, prints."""

from __future__ import annotations

import webbrowser
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leadline.cli_calibrate import CharucoOption, MarkerOption, NoBoardOption, NoSquareOption, make_board
from leadline.cli_view import ViewAt, has_screen
from leadline.errors import InputError

if TYPE_CHECKING:
    from leadline.pipeline.capture import Capture, CaptureReport
    from leadline.sources import Source

SAVED_SHOWN_S = 0.7  # a saved picture stands so long on the page


class CaptureMedium(StrEnum):
    AIR = "air"
    WATER = "water"


def capture(
    source: Annotated[
        str, typer.Argument(help="Live cameras (uvc:0, rtsp:, ros2:), a dive, or a folder of image pairs.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the images; one that was begun is gone on with.")],
    board: NoBoardOption = None,
    square: NoSquareOption = None,
    charuco: CharucoOption = None,
    marker: MarkerOption = None,
    medium: Annotated[CaptureMedium, typer.Option(help="Where the board is.")] = CaptureMedium.AIR,
    rig: Annotated[str | None, typer.Option(help="Rig file, if there is one already: better distances.")] = None,
    target: Annotated[
        bool, typer.Option("--target", help="Images of the target, for training, not of a board.")
    ] = False,
    model: Annotated[
        Path | None, typer.Option(help="With --target: detector (ONNX); default: the shipped one.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of a simulation.")] = 0,
    view: Annotated[bool, typer.Option("--view", help="Serve the page for a recorded source too.")] = False,
    view_at: ViewAt = None,
    headless: Annotated[bool, typer.Option("--headless", help="Never open a window or a browser.")] = False,
) -> None:
    """Take calibration or training images, guided: what is missing, what is wrong, good ones saved by themselves."""
    from leadline.pipeline.capture import capture as run  # noqa: PLC0415  heavy imports wait until they are needed
    from leadline.pipeline.capture import new_sink, open_pictures  # noqa: PLC0415

    checked = _checked(board, square, target, model)
    shown = view or view_at is not None
    pictures = open_pictures(source, real_time=shown, seed=seed)
    if target:
        task, aim = _target(out, model, patient=not pictures.live), "Images of the target, for training"
    else:
        size, side_m = checked
        task = _board(out, size, side_m, charuco, marker, medium, rig, patient=not pictures.live)
        aim = f"Images of the {size} board in {medium.value}"
    with ExitStack() as stack:
        sink = new_sink(task, pictures, aim)
        page = None
        if shown or pictures.live:
            from leadline.pipeline.page import Page  # noqa: PLC0415
            from leadline.sinks.web_access import Place  # noqa: PLC0415

            page = stack.enter_context(Page(sink, Place.parse(view_at) if view_at else Place()))
            typer.echo(f"capture page: {page.url}")
            if not headless and has_screen():
                webbrowser.open(page.url)
        report = run(pictures, task, sink, say=typer.echo, hold_s=SAVED_SHOWN_S if page else 0.0)
        lines = _lines(report, pictures)
        for line in lines:
            typer.echo(line)
        if page is not None:
            sink.ended(lines)
            typer.echo(f"the page stays as long as somebody looks at it, or until Ctrl-C: {page.url}")
            page.linger()
    if not report.enough:
        raise typer.Exit(1)


def _checked(board: str | None, square: float | None, target: bool, model: Path | None) -> tuple[str, float]:
    if target:
        if board is not None or square is not None:
            raise InputError("--target and --board are two kinds of images", "", "give one of them")
        return "", 0.0
    if model is not None:
        raise InputError("--model is for --target", "", "add it, or leave the model out")
    if board is None or square is None:
        fix = "give --board 11x8 --square 0.030 (inner corners, metres), or --target"
        raise InputError("images of what?", "", fix)
    return board, square


def _board(
    out: Path,
    size: str,
    square_m: float,
    charuco: str | None,
    marker_m: float | None,
    medium: CaptureMedium,
    rig: str | None,
    *,
    patient: bool,
) -> Capture:
    from leadline.pipeline.capture_board import BoardCapture  # noqa: PLC0415
    from leadline.rig import Rig  # noqa: PLC0415
    from leadline.rig_derivatives import Medium  # noqa: PLC0415

    known = None if rig is None else Rig.load(rig)
    board = make_board(size, square_m, charuco, marker_m)
    return BoardCapture(out, board, Medium(medium.value), known, patient=patient)


def _target(out: Path, model: Path | None, *, patient: bool) -> Capture:
    from leadline.config import Config  # noqa: PLC0415
    from leadline.pipeline.capture_target import TargetCapture  # noqa: PLC0415

    return TargetCapture(out, model, Config(), patient=patient)


def _lines(report: CaptureReport, source: Source) -> list[str]:
    """What it came to."""
    kept = f"{report.count} images in {report.out} ({report.looked_at} looked at)"
    notices = [str(one) for one in source.notices[:3]]
    if report.enough:
        return [f"enough: {kept}", *report.next, *notices]
    lines = [f"NOT enough: {kept}. Missing: {'; '.join(report.missing)}"]
    if not report.count and report.last:
        lines.append(f"the last picture: {report.last}")
    return [*lines, *report.next, "the same command goes on with this folder", *notices]
