"""The default engine: leadline's own network, in epochs, with checkpoints. Permissive: its weights may be shipped."""

from __future__ import annotations

import pickle
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from leadline.errors import InputError
from leadline.training.engines.base import CHECKPOINT, TRAIN_EXTRA, TRAINED, Epoch, Lesson, Progress, Quality
from leadline.training.settings import TrainConfig

if TYPE_CHECKING:
    from leadline.training.train import Trainer

LARGER, SMALLER = 1.15, 0.75  # sizes of the training pictures against that of the exported network
STRIDE = 32


class Own:
    name = "leadline"
    licence = "yours: leadline's network and trainer are Apache-2.0 and put no condition on weights trained with them"

    def check(self) -> None:
        try:
            import onnx  # noqa: F401, PLC0415
            import torch  # noqa: F401, PLC0415
        except ImportError as error:
            raise InputError(f"training needs {error.name}, which is not installed", "", TRAIN_EXTRA) from error

    def train(self, lesson: Lesson, settings: TrainConfig, out: Path, progress: Progress) -> Path:
        from leadline.training.export import export_onnx  # noqa: PLC0415

        run = _Run(lesson, settings, out / CHECKPOINT)
        while not run.done:
            run.epoch(progress)
        export_onnx(run.best_network(), out / TRAINED, lesson.names, settings.size, {})
        return out / TRAINED


class _Run:
    """A training as far as it has come: everything in it is in the checkpoint, which is written after each epoch."""

    def __init__(self, lesson: Lesson, settings: TrainConfig, checkpoint: Path) -> None:
        import torch  # noqa: PLC0415

        from leadline.training.train import KEPT_LONG_SIDE, Pool, Settings, Trainer  # noqa: PLC0415

        self._lesson, self._settings, self._checkpoint = lesson, settings, checkpoint
        self._per_epoch = -(-len(lesson.train) // settings.batch)
        steps = self._per_epoch * settings.epochs
        self._trainer: Trainer = Trainer(
            [Pool(lesson.train, 1.0, long_side=max(KEPT_LONG_SIDE, round(1.5 * settings.size)))],
            len(lesson.names),
            Settings(
                steps=steps,
                batch=settings.batch,
                sizes=sizes(settings.size, lesson),
                size_weights=(0.5, 0.25, 0.25),
                learning_rate=settings.learning_rate,
                warm_up=min(100, steps // 10),
                mosaic=settings.mosaic,
                plain_end=settings.plain_end,
                average=min(0.997, 1 - 10 / steps) if steps > 20 else 0.5,
                seed=settings.seed,
                threads=settings.threads,
            ),
        )
        self.history: list[Epoch] = []
        self._seconds = 0.0
        self._best: dict[str, Any] = {}
        if checkpoint.exists():
            try:
                self._load(torch.load(checkpoint, weights_only=True))
            except (RuntimeError, KeyError, EOFError, pickle.UnpicklingError) as error:
                raise InputError(
                    "is no checkpoint of this version of leadline", str(checkpoint), "give a new folder to --out"
                ) from error

    @property
    def done(self) -> bool:
        """All epochs, out of time, or no better for too long."""
        if not self.history:
            return False
        since_best = len(self.history) - max(e.number for e in self.history if e.best)
        weary = 0 < self._settings.patience <= since_best
        return len(self.history) >= self._settings.epochs or weary or self._time_gone() >= 1

    def epoch(self, progress: Progress) -> None:
        """One epoch, its judgement, and the checkpoint."""
        began, before = time.monotonic(), self._seconds
        losses = []
        total = self._per_epoch * self._settings.epochs
        for _ in range(self._per_epoch):
            losses.append(self._trainer.step(max(self._trainer.steps, self._time_gone() * total)))
            self._seconds = before + time.monotonic() - began
            progress.tick(self._trainer.steps, total)
            if self._time_gone() >= 1:
                break
        quality = self._lesson.judge(self._detector())
        best = not self._best or quality.ap50_95 >= max(e.quality.ap50_95 for e in self.history)
        if best:
            self._best = {name: value.clone() for name, value in self._trainer.average.state_dict().items()}
        self._seconds = before + time.monotonic() - began
        done = Epoch(len(self.history) + 1, sum(losses) / len(losses), quality, best, self._seconds)
        self.history.append(done)
        self._save()
        progress.epoch(done)

    def best_network(self) -> Any:
        network = self._trainer.average
        network.load_state_dict(self._best)
        return network

    def _time_gone(self) -> float:
        """How much of the time budget is spent; 0 without one."""
        return self._seconds / 60 / self._settings.minutes if self._settings.minutes else 0.0

    def _detector(self) -> Any:
        from leadline.training.engines.in_torch import TorchDetector  # noqa: PLC0415

        return TorchDetector(self._trainer.average, self._lesson.names, self._settings.size).detect

    def _save(self) -> None:
        """Whole or not at all: a kill while writing leaves the epoch before."""
        import torch  # noqa: PLC0415

        beside = self._checkpoint.with_suffix(".tmp")
        history = [(e.number, e.loss, e.quality.ap50, e.quality.ap50_95, e.best, e.seconds) for e in self.history]
        torch.save({"trainer": self._trainer.state(), "best": self._best, "history": history}, beside)
        beside.replace(self._checkpoint)

    def _load(self, saved: dict[str, Any]) -> None:
        self._trainer.load(saved["trainer"])
        self._best = saved["best"]
        self.history = [
            Epoch(number, loss, Quality(ap50, ap50_95), best, seconds)
            for number, loss, ap50, ap50_95, best, seconds in saved["history"]
        ]
        self._seconds = self.history[-1].seconds


def sizes(long_side: int, lesson: Lesson) -> tuple[tuple[int, int], ...]:
    """Sizes (w, h) of the training pictures: the shape of most images, at the network's size, smaller and larger."""
    width, height = _usual_shape(lesson)
    unit = long_side / max(width, height)

    def fitted(factor: float) -> tuple[int, int]:
        w, h = (max(2, round(side * unit * factor / STRIDE)) * STRIDE for side in (width, height))
        return w, h

    return fitted(1.0), fitted(SMALLER), fitted(LARGER)


def _usual_shape(lesson: Lesson) -> tuple[float, float]:
    """The median width and height of a few training images."""
    import cv2  # noqa: PLC0415
    import numpy as np  # noqa: PLC0415

    few = lesson.train[:: max(1, len(lesson.train) // 15)]
    shapes = [image.shape[1::-1] for e in few if (image := cv2.imread(str(e.image))) is not None]
    width, height = np.median(np.array(shapes, np.float64), axis=0)
    return float(width), float(height)
