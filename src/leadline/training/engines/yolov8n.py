"""The paper's engine: YOLOv8n by Ultralytics, which the user installs. AGPL-3.0, not part of leadline."""

from __future__ import annotations

import logging
import os
import shutil
import time
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import yaml

from leadline.errors import InputError
from leadline.training.dataset import Example
from leadline.training.engines.base import TRAINED, Epoch, Lesson, Progress, Quality
from leadline.training.settings import TrainConfig

FOLDER, RUN = "yolov8n", "run"
INSTALL = "pip install ultralytics (AGPL-3.0), or leave --engine out"


class Yolov8n:
    name = "yolov8n"
    licence = "AGPL-3.0: trained by Ultralytics YOLOv8, whose makers hold that exported models stay under it"

    def check(self) -> None:
        _ultralytics()

    def train(self, lesson: Lesson, settings: TrainConfig, out: Path, progress: Progress) -> Path:
        """From scratch, by the paper's recipe; goes on from Ultralytics' own ``last.pt`` where there is one."""
        yolo = _ultralytics()
        folder = (out / FOLDER).resolve()
        last = folder / RUN / "weights" / "last.pt"
        data = _write_set(lesson, folder)
        model = yolo(str(last) if last.exists() else "yolov8n.yaml", task="detect", verbose=False)
        watcher = _Watcher(progress, settings)
        model.add_callback("on_train_start", lambda _: import_module("torch").set_num_threads(settings.threads))
        model.add_callback("on_train_batch_end", watcher.batch)
        model.add_callback("on_fit_epoch_end", watcher.epoch)
        if not (last.exists() and _finished(last)):
            model.train(resume=last.exists(), data=str(data), **_arguments(settings, folder))
        best = yolo(str(last.with_name("best.pt")), task="detect", verbose=False)
        width, height = _shape(lesson, settings.size)
        exported = best.export(format="onnx", imgsz=(height, width), simplify=False, dynamic=False, device="cpu")
        return Path(shutil.move(exported, out / TRAINED))


def _arguments(settings: TrainConfig, folder: Path) -> dict[str, Any]:
    """Ultralytics' settings. Its own defaults would download weights, use mixed precision and draw plots; ``nbs`` other
    than the batch gathers gradients over many steps, which wrecks short trainings."""
    return {
        "project": str(folder),
        "name": RUN,
        "exist_ok": True,
        "epochs": settings.epochs,
        "time": settings.minutes / 60 if settings.minutes else None,
        "batch": settings.batch,
        "nbs": settings.batch,
        "imgsz": settings.size,
        "mosaic": settings.mosaic,
        "close_mosaic": round(settings.epochs * settings.plain_end),
        "patience": settings.patience or settings.epochs,
        "seed": settings.seed,
        "deterministic": True,
        "device": "cpu",
        "workers": 0,
        "pretrained": False,
        "amp": False,
        "plots": False,
        "verbose": False,
    }


def _ultralytics() -> Any:
    """Its class ``YOLO``, told to stay offline and quiet."""
    os.environ |= {"YOLO_OFFLINE": "true", "YOLO_AUTOINSTALL": "false", "YOLO_VERBOSE": "false"}
    try:
        torch = import_module("torch")
        if not _has_nms(torch):
            _register_nms(torch)
        ultralytics = import_module("ultralytics")
    except ImportError as error:
        raise InputError(f"the engine yolov8n needs {error.name}, which is not installed", "", INSTALL) from error
    ultralytics.utils.LOGGER.setLevel(logging.ERROR)
    return ultralytics.YOLO


def _has_nms(torch: Any) -> bool:
    try:
        import_module("torchvision")
    except ImportError:  # Ultralytics' own import says so
        return True
    except RuntimeError:  # torchvision::nms does not exist: a build for CUDA beside a torch for the processor
        return False
    return hasattr(torch.ops.torchvision, "nms")


def _register_nms(torch: Any) -> None:
    """Give torchvision, built for another torch, what it needs to be imported, and the one operator that is called."""
    library = torch.library.Library("torchvision", "FRAGMENT")
    for operator in ("nms", "qnms"):
        library.define(f"{operator}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    library.impl("nms", _nms, "CPU")
    _KEPT.append(library)  # the operators are taken back when this is collected
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that its own operators cannot be loaded
        import_module("torchvision")
    boxes: Any = import_module("torchvision.ops.boxes")
    boxes._assert_has_ops = lambda: None


_KEPT: list[Any] = []


def _nms(boxes: Any, scores: Any, threshold: float) -> Any:
    import cv2  # noqa: PLC0415
    import torch  # noqa: PLC0415

    corners = boxes.double()
    rectangles = torch.cat([corners[:, :2], corners[:, 2:] - corners[:, :2]], 1).tolist()
    kept = cv2.dnn.NMSBoxes(rectangles, scores.double().tolist(), 0.0, float(threshold))
    return torch.as_tensor(list(kept), dtype=torch.int64).flatten()


def _finished(last: Path) -> bool:
    """Ultralytics strips a checkpoint of its epoch when the training is done."""
    import torch  # noqa: PLC0415

    return bool(torch.load(last, map_location="cpu", weights_only=False).get("epoch", -1) < 0)


def _write_set(lesson: Lesson, folder: Path) -> Path:
    """The set as Ultralytics reads it: links to the images, labels beside them; unsure boxes are not told."""
    for part, examples in (("train", lesson.train), ("val", lesson.val)):
        place = folder / "set" / part
        shutil.rmtree(place, ignore_errors=True)
        for kind in ("images", "labels"):
            (place / kind).mkdir(parents=True)
        for number, example in enumerate(examples):
            name = f"{number:05d}_{example.image.stem}"
            _link(example.image.resolve(), place / "images" / (name + example.image.suffix.lower()))
            (place / "labels" / f"{name}.txt").write_text(_rows(example))
    file = folder / "set" / "data.yaml"
    told = {
        "path": str(file.parent),
        "train": "train/images",
        "val": "val/images",
        "names": dict(enumerate(lesson.names)),
    }
    file.write_text(yaml.safe_dump(told))
    return file


def _link(image: Path, link: Path) -> None:
    try:
        link.symlink_to(image)
    except OSError:  # not allowed to, on some systems
        shutil.copyfile(image, link)


def _rows(example: Example) -> str:
    import cv2  # noqa: PLC0415

    height, width = cv2.imread(str(example.image)).shape[:2]  # type: ignore[union-attr]
    rows = []
    for number, (x0, y0, x1, y1) in zip(example.classes.tolist(), example.boxes.tolist(), strict=True):
        if number >= 0:
            centre = (x0 + x1) / 2 / width, (y0 + y1) / 2 / height
            rows.append(f"{number} {centre[0]:.6f} {centre[1]:.6f} {(x1 - x0) / width:.6f} {(y1 - y0) / height:.6f}\n")
    return "".join(rows)


def _shape(lesson: Lesson, long_side: int) -> tuple[int, int]:
    from leadline.training.engines.own import sizes  # noqa: PLC0415

    return sizes(long_side, lesson)[0]


class _Watcher:
    """Ultralytics' callbacks -> progress."""

    def __init__(self, progress: Progress, settings: TrainConfig) -> None:
        self._progress, self._epochs = progress, settings.epochs
        self._began, self._batches, self._learnt = time.monotonic(), 0, False

    def batch(self, trainer: Any) -> None:
        self._learnt = True
        self._batches += 1
        each = len(trainer.train_loader)
        self._progress.tick(trainer.epoch * each + (self._batches - 1) % each + 1, each * self._epochs)

    def epoch(self, trainer: Any) -> None:
        if not self._learnt:  # the last judgement, of the best weights, belongs to no epoch
            return
        self._learnt = False
        quality = Quality(trainer.metrics["metrics/mAP50(B)"], trainer.metrics["metrics/mAP50-95(B)"])
        best = bool(trainer.fitness == trainer.best_fitness)
        losses = trainer.tloss.values() if isinstance(trainer.tloss, dict) else trainer.tloss  # by version
        loss = sum(float(part) for part in losses)
        self._progress.epoch(Epoch(trainer.epoch + 1, loss, quality, best, time.monotonic() - self._began))
