"""`leadline evaluate detector DATA`: a labelled set and a model brought together, class by class."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from leadline.config import DetectorConfig
from leadline.errors import InputError
from leadline.evaluation.detector_report import LEAST_SCORE, DetectorReport, Progress, write_detector_report
from leadline.recognition.detector import Detector
from leadline.training.dataset import Dataset, Example, read_dataset


def evaluate_detector(
    data: Path,
    out: Path,
    *,
    model: Path | None = None,
    classes: str | None = None,
    clips: Path | None = None,
    part: str | None = None,
    config: DetectorConfig | None = None,
    progress: Progress = lambda done, total: None,
) -> DetectorReport:
    """Evaluate ``model`` (None: the shipped one) on a YOLO, COCO or Pascal VOC set, or on a ``part`` of its own split.

    ``classes``: as for training, the set's classes under the model's names (``ball=buoy_*``); ``clips``: a CSV file
    image,clip[,part]. ``config.score`` is the score at which is counted what was found and missed. InputError for a set
    or a model that cannot be used, and where none of the set's classes is one of the model's.
    """
    config = config or DetectorConfig()
    detector = Detector(model, **(config.model_dump() | {"score": min(LEAST_SCORE, config.score)}))
    dataset = read_dataset(data, classes, clips)
    examples, notices = _of_part(dataset, part)
    names, examples, unknown = _matched(dataset, examples, detector.names, detector.path)
    return write_detector_report(
        examples,
        detector.detect,
        out,
        names,
        score=config.score,
        title=f"{Path(detector.path).name} on {data} ({dataset.format}{f', {part}' if part else ''})",
        notices=[*notices, *dataset.notices, *unknown],
        progress=progress,
    )


def _of_part(dataset: Dataset, part: str | None) -> tuple[list[Example], list[str]]:
    """The examples to look at: all, or those of a part of the set's own split."""
    parts = sorted({example.part for example in dataset.examples if example.part})
    if part is None:
        split = ", ".join(parts)
        return list(dataset.examples), [f"the set is split into {split}; all of it is looked at"] if parts else []
    examples = [example for example in dataset.examples if example.part == part]
    if not examples:
        has = f"it has {', '.join(parts)}" if parts else "it has no split"
        raise InputError(f"no image of the part {part!r}", str(dataset.path), f"{has}; leave --part out for all of it")
    return examples, []


def _matched(
    dataset: Dataset, examples: Sequence[Example], known: Sequence[str], model: str
) -> tuple[list[str], list[Example], list[str]]:
    """Class names to evaluate, examples with the classes so numbered, and what is left out. InputError if all is."""
    if not known:  # an export without names: its detections are labelled by number
        numbers = [str(number) for number in range(len(dataset.names))]
        told = f"the model does not name its classes: taken in the set's order ({', '.join(dataset.names)})"
        return numbers, list(examples), [told]
    names = [name for name in dataset.names if name in known]
    if not names:
        raise InputError(
            f"the classes {_some(dataset.names)} are none of the model's ({_some(known)}; {model})",
            str(dataset.path),
            f"say which is which, such as --classes '{known[0]}={dataset.names[0]}' or '{known[0]}=*'",
        )
    number = np.array([names.index(name) if name in names else len(names) for name in dataset.names], np.int64)
    unknown = [name for name in dataset.names if name not in names]
    told_of = [f"the model does not know these classes, they are left out: {_some(unknown)}"] if unknown else []
    return names, [_renumbered(example, number, len(names)) for example in examples], told_of


def _renumbered(example: Example, number: np.ndarray, unknown: int) -> Example:
    classes = np.where(example.classes < 0, example.classes, number[example.classes])
    keep = classes != unknown
    return replace(example, boxes=example.boxes[keep], classes=classes[keep])


def _some(names: Sequence[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
