"""`leadline train`: a labelled set -> a detector (ONNX), where it comes from, and how good it is on unseen clips."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from leadline.errors import InputError
from leadline.evaluation.detection import evaluate_detections
from leadline.evaluation.detector_report import LEAST_SCORE, DetectorReport, write_detector_report
from leadline.evaluation.summary import versions
from leadline.files import make_folder, write_whole
from leadline.recognition.detector import Detector
from leadline.samples import Detection, Image
from leadline.training.dataset import UNSURE, Dataset, Example, read_dataset
from leadline.training.engines import Engine, Epoch, Lesson, Progress, Quality, open_engine
from leadline.training.settings import TrainConfig
from leadline.training.split import Split, split_by_clip

MODEL, SETTINGS, SPLIT, HISTORY, REPORT = "model.onnx", "settings.yaml", "split.csv", "history.csv", "test"
MAY_CHANGE = {"threads", "minutes"}  # settings with which a training that was cut off may go on


@dataclass(frozen=True, slots=True)
class Plan:
    """A training that may begin: everything has been read and checked, nothing is written yet."""

    data: Dataset
    split: Split
    settings: TrainConfig
    engine: Engine
    out: Path
    record: dict[str, Any]  # settings.yaml: what this training is; one that goes on has the same
    resumes: bool


@dataclass(frozen=True, slots=True)
class Trained:
    model: Path
    report: DetectorReport
    files: list[Path]


def plan_training(
    path: Path,
    out: Path,
    settings: TrainConfig,
    classes: str | None = None,
    clips: Path | None = None,
    progress: Callable[[int, int | None], None] = lambda done, total: None,
) -> Plan:
    """Read the set and split it. InputError for a set that cannot be used, or where ``out`` holds something else."""
    root = path if path.is_dir() else path.parent
    if path.exists() and out.resolve().is_relative_to(root.resolve()):
        raise InputError("lies within the set", str(out), "give another folder to --out")
    engine = open_engine(settings.engine)
    engine.check()
    data = read_dataset(path, classes, clips, progress)
    split = split_by_clip(data.examples, settings.seed)
    record = {
        "settings": settings.model_dump(mode="json"),
        "classes": list(data.names),
        "data": {
            "format": data.format,
            "sha256": data.digest(),
            **{part: _count(getattr(split, part)) for part in ("train", "val", "test")},
        },
        "split_sha256": hashlib.sha256(_split_table(split).encode()).hexdigest(),
    }
    resumes = _resumes(out, record)
    return Plan(data, split, settings, engine, out, record, resumes)


def train(
    plan: Plan, progress: Progress, tick: Callable[[int, int | None], None] = lambda done, total: None
) -> Trained:
    """Train, export, and judge on the test part. What was cut off goes on; what is finished is judged again."""
    make_folder(plan.out)
    write_whole(plan.out / SETTINGS, yaml.safe_dump(plan.record, sort_keys=False))
    write_whole(plan.out / SPLIT, _split_table(plan.split))
    model = plan.out / MODEL
    if not model.exists():
        lesson = Lesson(plan.split.train, plan.split.val, plan.data.names, _judge(plan.split.val, plan.data.names))
        recorder = _Recorder(progress, plan.out / HISTORY)
        trained = plan.engine.train(lesson, plan.settings, plan.out, recorder)
        _describe(trained, plan)
        trained.replace(model)
    part, examples = ("test", plan.split.test) if plan.split.test else ("validation", plan.split.val)
    report = write_detector_report(
        examples,
        Detector(model, score=LEAST_SCORE, threads=plan.settings.threads).detect,
        plan.out / REPORT,
        plan.data.names,
        title=f"{model.name} on the {part} part of {plan.data.path.name}",
        notices=plan.split.notices,
        progress=tick,
    )
    return Trained(model, report, [model, plan.out / SETTINGS, plan.out / SPLIT, plan.out / HISTORY, *report.files])


def _resumes(out: Path, record: dict[str, Any]) -> bool:
    """Whether ``out`` holds this very training, cut off or done."""
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return False
    try:
        there = yaml.safe_load((out / SETTINGS).read_text())
        _compared(there)
    except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError):
        raise InputError("holds something that is not a training", str(out), "give a new folder to --out") from None
    if _compared(there) == _compared(record):
        return True
    old, new = there["settings"], record["settings"]
    changed = [f"{key} {old.get(key)} there, {new[key]} now" for key in new if old.get(key) != new[key]]
    what = ", ".join(line for line in changed if line.split()[0] not in MAY_CHANGE) or "other images or classes"
    raise InputError(f"holds another training ({what})", str(out), "give a new folder to --out")


def _compared(record: dict[str, Any]) -> dict[str, Any]:
    settings = {key: value for key, value in record["settings"].items() if key not in MAY_CHANGE}
    return {**record, "settings": settings}


def _count(examples: Sequence[Example]) -> dict[str, int]:
    return {
        "clips": len({e.clip for e in examples}),
        "images": len(examples),
        "boxes": sum(int((e.classes > UNSURE).sum()) for e in examples),
    }


def _split_table(split: Split) -> str:
    """Which image is in which part; can be given back as ``--clips``."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("image", "clip", "part"))
    for part in ("train", "val", "test"):
        table.writerows((e.image.name, e.clip, part) for e in getattr(split, part))
    return text.getvalue()


def _judge(val: Sequence[Example], names: Sequence[str]) -> Callable[[Callable[[Image], list[Detection]]], Quality]:
    """AP on the validation part: the mean over the classes that it shows."""

    def judge(detect: Callable[[Image], list[Detection]]) -> Quality:
        found = {str(e.image): detect(np.asarray(cv2.imread(str(e.image)), np.uint8)) for e in val}
        aps = []
        for number, name in enumerate(names):
            truth = {str(e.image): _rectangles(e, number) for e in val}
            unsure = {str(e.image): _rectangles(e, UNSURE) for e in val}
            if any(truth.values()):
                mine = {image: [d for d in them if d.label == name] for image, them in found.items()}
                quality = evaluate_detections(mine, truth, unsure)
                aps.append((quality.ap50, quality.ap50_95))
        ap50, ap50_95 = np.mean(aps, axis=0)
        return Quality(float(ap50), float(ap50_95))

    return judge


def _rectangles(example: Example, number: int) -> list[tuple[float, float, float, float]]:
    boxes = example.boxes[example.classes == number].tolist()
    return [(x0 - 0.5, y0 - 0.5, x1 - x0, y1 - y0) for x0, y0, x1, y1 in boxes]


class _Recorder:
    """Passes progress on, and writes each epoch down."""

    def __init__(self, progress: Progress, file: Path) -> None:
        self._progress, self._file = progress, file

    def tick(self, done: int, total: int | None) -> None:
        self._progress.tick(done, total)

    def epoch(self, epoch: Epoch) -> None:
        rows = self._file.read_text().splitlines()[: epoch.number] if self._file.exists() else []
        rows = rows or ["epoch,loss,val_ap50,val_ap50_95,best,seconds"]
        quality = epoch.quality
        rows.append(
            f"{epoch.number},{epoch.loss:.4f},{quality.ap50:.4f},{quality.ap50_95:.4f},{int(epoch.best)},{epoch.seconds:.1f}"
        )
        write_whole(self._file, "\n".join(rows) + "\n")
        self._progress.epoch(epoch)


def _describe(model: Path, plan: Plan) -> None:
    """Where the weights come from, into the model's own metadata."""
    from leadline.training.export import add_metadata  # noqa: PLC0415

    split = {part: plan.record["data"][part] for part in ("train", "val", "test")}
    add_metadata(
        model,
        {
            "author": f"leadline {versions()['leadline']} train",
            "date": datetime.now(UTC).date().isoformat(),
            "engine": plan.engine.name,
            "license": plan.engine.licence,
            "data": f"{plan.data.path.name}: {len(plan.data.examples)} images ({plan.data.format})",
            "data_sha256": plan.record["data"]["sha256"],
            "split": json.dumps(split),
            "split_sha256": plan.record["split_sha256"],
            "settings": json.dumps(plan.record["settings"]),
        },
    )
