"""What an engine is given, what it gives back, and which there are. Needs no torch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from leadline.samples import Detection, Image
from leadline.training.dataset import Example
from leadline.training.settings import TrainConfig

TRAINED = "trained.onnx"  # without what the caller says of it
CHECKPOINT = "checkpoint.pt"
TRAIN_EXTRA = "pip install 'leadline[train]'"


@dataclass(frozen=True, slots=True)
class Quality:
    """How good the weights are on the validation part."""

    ap50: float
    ap50_95: float


@dataclass(frozen=True, slots=True)
class Epoch:
    """What an epoch came to; ``number`` from 1, ``seconds`` since the training began, pauses left out."""

    number: int
    loss: float
    quality: Quality
    best: bool
    seconds: float


class Progress(Protocol):
    def tick(self, done: int, total: int | None) -> None:
        """So many steps are done."""

    def epoch(self, epoch: Epoch) -> None:
        """An epoch is done, and saved."""


@dataclass(frozen=True, slots=True)
class Lesson:
    """What is to be learnt, and ``judge``: how good a detector (BGR image -> detections) is on the validation part."""

    train: Sequence[Example]
    val: Sequence[Example]
    names: tuple[str, ...]
    judge: Callable[[Callable[[Image], list[Detection]]], Quality]


class Engine(Protocol):
    """Trains in ``out``, from where an earlier call with the same lesson and settings was cut off."""

    name: str
    licence: str  # of the trained weights

    def check(self) -> None:
        """InputError, with the command that helps, where the engine's packages are not installed."""

    def train(self, lesson: Lesson, settings: TrainConfig, out: Path, progress: Progress) -> Path:
        """The ONNX file of the best weights."""
        ...


def open_engine(name: str) -> Engine:
    """The engine called ``name``; its packages are imported when it trains."""
    if name == "yolov8n":
        from leadline.training.engines.yolov8n import Yolov8n  # noqa: PLC0415

        return Yolov8n()
    from leadline.training.engines.own import Own  # noqa: PLC0415

    return Own()


ENGINES = {
    "leadline": "leadline's own network and trainer (Apache-2.0); the trained weights are yours",
    "yolov8n": "YOLOv8n by Ultralytics: AGPL-3.0, trained and exported weights included; you install it",
}
