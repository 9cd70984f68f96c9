"""The command line of training: `leadline train`. Parses, calls, prints."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leadline.cli_progress import Tick, progress
from leadline.errors import InputError

if TYPE_CHECKING:
    from leadline.pipeline.train import Plan
    from leadline.training.engines import Epoch
    from leadline.training.settings import TrainConfig

ENGINE_HELP = (
    "leadline: own network, Apache-2.0, the weights are yours. yolov8n: Ultralytics, AGPL-3.0 (exported weights "
    "included), to be installed by you."
)


def train(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="YOLO, COCO or Pascal VOC set: a folder or its file.")],
    out: Annotated[Path, typer.Option(help="Folder for the model and its figures; one that was cut off goes on.")],
    engine: Annotated[str, typer.Option(help=ENGINE_HELP)] = "leadline",
    epochs: Annotated[int, typer.Option(help="The paper's: 50.")] = 50,
    batch: Annotated[int, typer.Option(help="The paper's: 4.")] = 4,
    size: Annotated[
        int | None, typer.Option(help="Long side of the network's input, pixels; 416, yolov8n 640.")
    ] = None,
    classes: Annotated[
        str | None, typer.Option(help="Keep some classes (buoy_red,gate), or merge them (ball=buoy_*,ball=float).")
    ] = None,
    clips: Annotated[
        Path | None, typer.Option(help="CSV image,clip[,part] where file names do not tell the clips.")
    ] = None,
    minutes: Annotated[float | None, typer.Option(help="Be done by then, whatever the epochs.")] = None,
    patience: Annotated[
        int | None, typer.Option(help="Stop after so many epochs without gain, 0: never; 20, yolov8n 0.")
    ] = None,
    mosaic: Annotated[float | None, typer.Option(help="Share of pictures made of four; 0.5, yolov8n 1.")] = None,
    threads: Annotated[int | None, typer.Option(help="Threads of the processor; 2.")] = None,
    seed: Annotated[int, typer.Option(help="Of the split, the first weights and the pictures.")] = 0,
) -> None:
    """Teach a detector your target: 50 to 2,000 labelled images -> an ONNX file with its figures."""
    from leadline.pipeline.train import plan_training  # noqa: PLC0415  heavy imports wait until they are needed
    from leadline.pipeline.train import train as run_training  # noqa: PLC0415

    given = {"size": size, "minutes": minutes, "patience": patience, "mosaic": mosaic, "threads": threads}
    settings = _settings(
        engine=engine, epochs=epochs, batch=batch, seed=seed, **{k: v for k, v in given.items() if v is not None}
    )
    with progress("reading the set") as tick:
        plan = plan_training(data, out, settings, classes, clips, tick)
    _print_plan(plan)
    with _shown(plan) as shown:
        result = run_training(plan, shown, shown.tick)
    report = result.report
    part = "test part" if plan.split.test else "validation part"
    typer.echo(
        f"{part}: AP50 {report.ap50:.3f}, AP75 {report.ap75:.3f}, AP50-95 {report.ap50_95:.3f} "
        f"({report.images} images, {report.boxes} boxes)"
    )
    for row in report.recall_by_size:
        if row.recall is not None:
            typer.echo(f"recall, {row.name}: {row.recall:.3f} of {row.truths} boxes")
    for file in result.files:
        typer.echo(str(file))


def _settings(**given: object) -> TrainConfig:
    from pydantic import ValidationError  # noqa: PLC0415

    from leadline.training.settings import TrainConfig  # noqa: PLC0415

    try:
        return TrainConfig.model_validate(given)
    except ValidationError as error:
        first = error.errors()[0]
        key = str(first["loc"][0])
        raise InputError(f"{given[key]}: {first['msg']}", f"--{key.replace('_', '-')}", "see --help") from error


def _print_plan(plan: Plan) -> None:
    from leadline.training.engines import ENGINES  # noqa: PLC0415

    data, split = plan.data, plan.split
    typer.echo(f"{data.format} set, {len(data.examples)} images, classes: {', '.join(data.names)}")
    for line in (*data.notices, *split.notices):
        typer.echo(f"  {line}")
    for part in ("train", "val", "test"):
        count = plan.record["data"][part]
        typer.echo(f"  {part}: {count['images']} images, {count['boxes']} boxes, {count['clips']} clips")
    typer.echo(f"engine {plan.engine.name}: {ENGINES[plan.engine.name]}")
    if plan.resumes:
        typer.echo(f"{plan.out}: the same training was begun there; it goes on")


class _Shown:
    """Progress as lines, one an epoch, under a bar of steps."""

    def __init__(self, tick: Tick, epochs: int) -> None:
        self.tick = tick
        self._epochs = epochs

    def epoch(self, epoch: Epoch) -> None:
        quality = epoch.quality
        left_min = epoch.seconds / 60 / epoch.number * (self._epochs - epoch.number)
        typer.echo(
            f"epoch {epoch.number}/{self._epochs}  loss {epoch.loss:.3f}  val AP50 {quality.ap50:.3f}  "
            f"AP50-95 {quality.ap50_95:.3f}{'  best' if epoch.best else ''}  "
            f"{epoch.seconds / 60:.1f} min, at most {left_min:.0f} more"
        )


@contextmanager
def _shown(plan: Plan) -> Iterator[_Shown]:
    with progress("training") as tick:
        yield _Shown(tick, plan.settings.epochs)
