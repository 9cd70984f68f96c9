"""A target detector: any common ONNX model, an image in, boxes out.

Boxes: ``Detection.box_px`` = x, y, width, height of the box's edges, in the project's pixels: (0, 0) is the centre of
the first pixel, so a box around the whole image is (-0.5, -0.5, W, H). Files that follow COCO put (0, 0) half a pixel
further out, at that pixel's corner; ``boxes.py`` and ``evaluation/detect.py`` convert.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.config import Provider
from leadline.errors import InputError
from leadline.recognition.heads import Floats, Head, recognise
from leadline.recognition.letterbox import GREY, letterbox, planes, three_channels
from leadline.recognition.runtime import Model, literal
from leadline.samples import Detection, Image, StereoFrame

SHIPPED = "balls.onnx"
MOST_CANDIDATES = 300
STRIDE = 32
LAYOUTS = "give a YOLOv8/v11 (1x(4+classes)xN), end-to-end (1xNx6) or YOLOX (1xNx(5+classes)) detector"


class Detector:
    """Finds targets in images with an ONNX model; without ``path`` the shipped one for balls and buoys.

    Reads YOLOv8/v11, YOLOX, end-to-end (boxes, score, class) and leadline's own models; see ``heads.recognise``.
    ``score``: boxes below it are dropped; ``nms_iou``: of two of one class that overlap more, the better stays;
    ``provider``: what it runs on; ``threads``: of the CPU; ``long_side_px``: of the network's input, for a model of
    free size (default: the model's own). The model has run once when the constructor returns.
    Raises InputError where the file is missing, no ONNX model, has another input or output, or cannot run there.
    """

    def __init__(
        self,
        path: str | Path | None = None,
        score: float = 0.3,
        nms_iou: float = 0.5,
        threads: int = 2,
        provider: Provider = "cpu",
        long_side_px: int | None = None,
    ) -> None:
        self.path = str(path) if path is not None else str(resources.files("leadline") / "models" / SHIPPED)
        self.score, self.nms_iou = score, nms_iou
        self._model = Model(self.path, provider, threads)
        self.metadata = self._model.metadata
        self._long_side = long_side_px or self._model.long_side
        self._names = _names(self.metadata)
        self._head = self._recognise_head()

    @property
    def names(self) -> tuple[str, ...]:
        """Its classes, in their order; empty where the model does not say: its labels are then numbers."""
        return tuple(self._names[k] for k in sorted(self._names))

    def find(self, frame: StereoFrame) -> list[Detection]:
        """The targets in the frame's left image, best first."""
        return self.detect(frame.left)

    def warm_up(self, width: int, height: int) -> None:
        """Run once on an image of this size: a GPU's first run on a size builds its kernels, for seconds or minutes."""
        self.detect(np.full((height, width, 3), GREY, np.uint8))

    def detect(self, image: Image) -> list[Detection]:
        """The targets in ``image`` (H, W, 3) BGR or (H, W), best first. InputError where it is no such image."""
        image = three_channels(image)
        height, width = image.shape[:2]
        fitted = letterbox(image, self._size_for(width, height))
        pixels = planes(fitted.canvas, self._model.dtype, bgr_255=self._head.bgr_255)
        output = self._model.run(pixels)
        boxes, scores, classes = self._head.decode(output[0], pixels.shape[3], pixels.shape[2], self.score)
        border = np.array([fitted.left, fitted.top] * 2, np.float32)
        boxes = np.clip((boxes - border) / fitted.scale, 0, np.array([width, height] * 2, np.float32))
        keep = (scores >= self.score) & (boxes[:, 2:] > boxes[:, :2]).all(axis=1)  # some lie in the border alone
        boxes, scores, classes = boxes[keep], scores[keep], classes[keep]
        return [
            Detection(_box_px(boxes[k]), float(scores[k]), self._names.get(int(classes[k]), str(int(classes[k]))))
            for k in best_of_overlapping(boxes, scores, classes, self.nms_iou)
        ]

    def _size_for(self, width: int, height: int) -> tuple[int, int]:
        """The network's input (w, h) for an image: the model's own, or the image's shape in whole strides."""
        own_width, own_height = self._model.size
        sides = ((own_width, width), (own_height, height))
        scale = min((own / side for own, side in sides if own), default=self._long_side / max(width, height))
        return own_width or _strides(width * scale), own_height or _strides(height * scale)

    def _recognise_head(self) -> Head:
        """Run the model once on grey (which also warms it up) and tell its layout from what comes out."""
        task = self.metadata.get("task", "detect")
        if task != "detect":
            raise InputError(f"the model is made to {task}, not to detect", self.path, LAYOUTS)
        width, height = self._size_for(self._long_side, self._long_side)
        canvas = np.full((height, width, 3), GREY, np.uint8)
        output = self._model.run(planes(canvas, self._model.dtype))
        head = recognise(output, width, height, len(self._names))
        if head is None:
            known = f" of {len(self._names)} classes" if self._names else ""
            shape = "x".join(map(str, output.shape))
            raise InputError(f"unknown model output {shape}{known} for {width}x{height}", self.path, LAYOUTS)
        return head


def _names(meta: dict[str, str]) -> dict[int, str]:
    names = literal(meta.get("names"), {})
    pairs = names.items() if isinstance(names, dict) else enumerate(names)
    return {int(k): str(v) for k, v in pairs}


def _strides(side: float) -> int:
    return max(STRIDE, int(np.ceil(side / STRIDE - 1e-6)) * STRIDE)


def best_of_overlapping(boxes: Floats, scores: Floats, classes: NDArray[np.int64], iou: float) -> list[int]:
    """Non-maximum suppression within each class: the numbers of the boxes (N, 4) x0 y0 x1 y1 that stay, best first."""
    if len(boxes) == 0:
        return []
    apart = classes.astype(np.float32)[:, None] * np.float32(boxes.max() + 1)  # classes never meet
    corner = boxes[:, :2] + apart
    rects = np.hstack([corner, boxes[:, 2:] - boxes[:, :2]]).tolist()
    kept = cv2.dnn.NMSBoxes(rects, scores.tolist(), 0.0, iou, top_k=MOST_CANDIDATES)
    return sorted((int(k) for k in np.ravel(kept)), key=lambda k: -float(scores[k]))


def _box_px(box: Floats) -> tuple[float, float, float, float]:
    """x0 y0 x1 y1 from the corner of the first pixel -> x y w h from its centre."""
    x0, y0, x1, y1 = (float(v) for v in box)
    return x0 - 0.5, y0 - 0.5, x1 - x0, y1 - y0
