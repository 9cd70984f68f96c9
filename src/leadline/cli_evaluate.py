"""The command line of evaluation: `leadline evaluate ...`. Parses, calls, prints."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leadline.cli_progress import progress

if TYPE_CHECKING:
    from rich.table import Table

    from leadline.evaluation.detection_tables import Row
    from leadline.evaluation.run_metrics import RunMetrics

app = typer.Typer(no_args_is_help=True, help="How good was it? Against a truth that was measured otherwise.")


class Part(StrEnum):
    TRAIN = "train"
    VAL = "val"
    TEST = "test"


@app.command("run")
def run(
    source: Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder, or one of its tables.")],
    truth: Annotated[Path, typer.Option(help="CSV with the columns t_s,x_m,y_m,z_m,range_m.")],
    out: Annotated[Path, typer.Option(help="Folder for metrics.json and the pictures.")],
) -> None:
    """A run's errors by stage and by distance, whether its sigma was honest, and how often it had an answer."""
    from leadline.cli_console import open_console  # noqa: PLC0415  heavy imports wait until they are needed
    from leadline.cli_tables import error_table  # noqa: PLC0415
    from leadline.evaluation.run_metrics import evaluate_run  # noqa: PLC0415

    result = evaluate_run(source, truth, out)
    console = open_console()
    for line in result.ignored[:1]:
        typer.echo(f"{len(result.ignored)} rows of the truth ignored, the first: {line}")
    if result.own_point:
        console.print(error_table("D against its own point of the surface, mm", result.own_point))
    if result.by_stage:
        console.print(error_table("range against the nearest surface, by stage, mm", result.by_stage))
        console.print(error_table("range against the nearest surface, by distance, mm", result.by_distance, "distance"))
    console.print(_availability(result))
    for file in result.files:
        typer.echo(str(file))


@app.command("detector")
def detector(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="Labelled images: YOLO, COCO or Pascal VOC.")],
    out: Annotated[Path, typer.Option(help="Folder for the page, the figures and the pictures.")],
    model: Annotated[Path | None, typer.Option(help="Detector (ONNX); default: the shipped one for balls.")] = None,
    classes: Annotated[
        str | None, typer.Option(help="The set's classes under the model's names: 'ball=buoy_*,fish=trout'.")
    ] = None,
    part: Annotated[Part | None, typer.Option(help="Of the set's own split; default: all of it.")] = None,
    clips: Annotated[Path | None, typer.Option(help="CSV image,clip[,part]; default: told from file names.")] = None,
    score: Annotated[
        float | None, typer.Option(min=0, max=1, help="At which boxes are counted; default: the settings' (0.3).")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="Settings (see `leadline config dump`).")] = None,
) -> None:
    """How well a detector finds the target: AP, recall by size and water, centre errors, what went wrong."""
    from leadline.cli_console import open_console  # noqa: PLC0415
    from leadline.config import Config  # noqa: PLC0415
    from leadline.evaluation.detection_page import lines  # noqa: PLC0415
    from leadline.evaluation.detection_run import evaluate_detector  # noqa: PLC0415

    settings = (Config() if config is None else Config.load(config)).detector
    if score is not None:
        settings = settings.model_copy(update={"score": score})
    with progress("detecting") as tick:
        result = evaluate_detector(
            data,
            out,
            model=model,
            classes=classes,
            clips=clips,
            part=part.value if part else None,
            config=settings,
            progress=tick,
        )
    for told in (*lines(result), *result.notices):
        typer.echo(told)
    console = open_console()
    console.print(_boxes("by box size; px: how far the found boxes' centres are off", result.recall_by_size))
    console.print(_boxes("by water", [row.all for row in result.by_water]))
    for file in result.files:
        typer.echo(str(file))


def _boxes(title: str, rows: list[Row]) -> Table:
    from rich.table import Table  # noqa: PLC0415

    from leadline.evaluation.detection_page import row_cells  # noqa: PLC0415

    table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for name in ("labelled", "found", "recall", "false", "precision", "mean px", "RMS px", "95 % px"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*row_cells(row))
    return table


def _availability(result: RunMetrics) -> Table:
    from rich.table import Table  # noqa: PLC0415

    title = f"availability; longest time without a valid solution {result.longest_gap_s:.2f} s"
    table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))
    table.add_column("distance", no_wrap=True)
    for name in ("solutions", "valid", "coasting", "lost"):
        table.add_column(name, justify="right")
    for row in result.availability:
        shares = [f"{count / row.count:.0%}" for count in (row.valid, row.coasting, row.lost)]
        table.add_row(row.name, str(row.count), *shares)
    return table
