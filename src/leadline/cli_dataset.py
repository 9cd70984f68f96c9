"""The command line of data sets: `leadline dataset`. Parses, calls, prints."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leadline.cli_progress import progress
from leadline.errors import InputError

if TYPE_CHECKING:
    from leadline.config import Config
    from leadline.pipeline.dataset_labels import Labeller


class LabelBy(StrEnum):
    MODEL = "model"
    RANGE = "range"


def dataset(
    recordings: Annotated[
        list[str], typer.Argument(metavar="RECORDING...", help="Dive folders, .mcap files, sim:SCENARIO.")
    ],
    out: Annotated[Path, typer.Option(help="New folder for the set.")],
    count: Annotated[int, typer.Option(min=1, help="Of frames, at most.")] = 200,
    label: Annotated[
        LabelBy, typer.Option(help="Who labels: a model, or the laser's spot with the stereo range (balls; no model).")
    ] = LabelBy.MODEL,
    model: Annotated[Path | None, typer.Option(help="Detector (ONNX); default: the shipped one for balls.")] = None,
    target: Annotated[str | None, typer.Option(help="For --label range: sphere[:DIAMETER], metres.")] = None,
    name: Annotated[str, typer.Option(help="For --label range: what the target is called.")] = "target",
    rig: Annotated[
        str | None, typer.Option(help="For --label range: rig file or a shipped rig; default: the recording's own.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of a simulation.")] = 0,
    config: Annotated[Path | None, typer.Option(help="Settings (see `leadline config dump`).")] = None,
) -> None:
    """Draw a varied set of frames from recordings, pre-labelled, ready for a labelling tool and for training."""
    from leadline.config import Config  # noqa: PLC0415  heavy imports wait until they are needed
    from leadline.pipeline.dataset import draw_dataset  # noqa: PLC0415

    settings = Config() if config is None else Config.load(config)
    labeller = _labeller(label, model, target, rig, name, settings, seed)
    with progress("looking at frames") as tick:
        report = draw_dataset(recordings, out, labeller, count=count, progress=tick)
    boxes = sum(len(item.labels.boxes) for item in report.items)
    typer.echo(f"{len(report.items)} of {report.looked_at} frames, {boxes} boxes by {labeller.provenance}: {out}")
    for size, seen, kept in report.sizes:
        typer.echo(f"  {size:22} {kept:5d} of {seen}")
    for line in report.notices:
        typer.echo(line)
    typer.echo(f"to look at first: {report.first} frames, {out / 'review.csv'}, {out / 'preview.html'}")
    typer.echo(f"next: correct the labels ({out / 'README.md'}), then leadline train {out} --out MODEL_FOLDER")


def _labeller(
    label: LabelBy,
    model: Path | None,
    target: str | None,
    rig: str | None,
    name: str,
    config: Config,
    seed: int,
) -> Labeller:
    from leadline.pipeline.dataset_labels import ModelLabeller, RangeLabeller  # noqa: PLC0415

    if label is LabelBy.RANGE:
        if model is not None:
            raise InputError("--model and --label range are two answers to one question", fix="give one of them")
        return RangeLabeller(target, rig, config, name, seed)
    if target is not None or rig is not None:
        raise InputError("--target and --rig are for --label range", fix="add it, or leave them out")
    return ModelLabeller(model, config, seed)
