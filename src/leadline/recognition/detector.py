"""A target detector on ONNX Runtime (the only file that imports it).

Boxes: ``Detection.box_px`` = x, y, width, height of the box's edges, in the project's pixels: (0, 0) is the centre of
the first pixel, so a box around the whole image is (-0.5, -0.5, W, H). Files that follow COCO put (0, 0) half a pixel
further out, at that pixel's corner; ``boxes.py`` and ``evaluation/detect.py`` convert.
"""

from __future__ import annotations

import ast
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from leadline.errors import InputError
from leadline.recognition.heads import Head, recognise
from leadline.samples import Detection, Image, StereoFrame

Floats = NDArray[np.float32]
GREY = 114  # what fills the border of a letterboxed image; the value that the common trainers use
SHIPPED = "balls.onnx"
MOST_CANDIDATES = 300
STRIDE = 32


class Detector:
    """Finds targets in images with an ONNX model; without ``path`` the shipped one for balls and buoys.

    Reads YOLOv8/v11, YOLOX, end-to-end (boxes, score, class) and leadline's own models; see ``heads.recognise``.
    ``score``: boxes below it are dropped; ``nms_iou``: of two of one class that overlap more, the better stays.
    Raises InputError where the file is missing, no ONNX model, or has another output.
    """

    def __init__(
        self, path: str | Path | None = None, score: float = 0.3, nms_iou: float = 0.5, threads: int = 2
    ) -> None:
        self.path = str(path) if path is not None else str(resources.files("leadline") / "models" / SHIPPED)
        self.score, self.nms_iou = score, nms_iou
        self._session = _open(self.path, threads)
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)
        self._input = self._session.get_inputs()[0]
        self._fixed, self._long_side = _input_size(self._input.shape, self.metadata, self.path)
        self._names = _names(self.metadata)
        self._head = self._recognise_head()

    def find(self, frame: StereoFrame) -> list[Detection]:
        """The targets in the frame's left image, best first."""
        return self.detect(frame.left)

    def detect(self, image: Image) -> list[Detection]:
        """The targets in ``image`` (H, W, 3) BGR or (H, W), best first."""
        height, width = image.shape[:2]
        blob, scale, pad = letterbox(image, self._size_for(width, height), self._head.bgr_255)
        outputs = self._session.run(None, {self._input.name: blob})
        boxes, scores, classes = self._head.decode(outputs[0][0], blob.shape[3], blob.shape[2])
        keep = scores >= self.score
        boxes, scores, classes = (boxes[keep] - np.tile(pad, 2)) / scale, scores[keep], classes[keep]
        boxes = np.clip(boxes, 0, np.array([width, height, width, height], np.float32))
        return [
            Detection(_box_px(boxes[k]), float(scores[k]), self._names.get(int(classes[k]), str(int(classes[k]))))
            for k in best_of_overlapping(boxes, scores, classes, self.nms_iou)
        ]

    def _size_for(self, width: int, height: int) -> tuple[int, int]:
        """The network's input (w, h) for an image: the model's own, or the image's shape in whole strides."""
        if self._fixed is not None:
            return self._fixed
        scale = self._long_side / max(width, height)
        return _strides(width * scale), _strides(height * scale)

    def _recognise_head(self) -> Head:
        """Run the model once on grey (which also warms it up) and tell its layout from what comes out."""
        width, height = self._fixed or (self._long_side, self._long_side)
        grey = np.full((1, 3, height, width), GREY / 255, np.float32)
        try:
            outputs = self._session.run(None, {self._input.name: grey})
        except Exception as error:  # ONNX Runtime's own classes are not public
            raise InputError(
                f"the model does not run on a {width}x{height} image ({_first_line(error)})", self.path,
                "export it with input (1, 3, height, width), float32",
            ) from error  # fmt: skip
        shape = tuple(int(n) for n in np.shape(outputs[0]))
        head = recognise(shape, width, height)
        if head is None:
            raise InputError(
                f"unknown model output {'x'.join(map(str, shape))}", self.path,
                "give a YOLOv8/v11 (1x(4+classes)xN), end-to-end (1xNx6) or YOLOX (1xNx(5+classes)) detector",
            )  # fmt: skip
        return head


def _open(path: str, threads: int) -> Any:
    if not Path(path).is_file():
        raise InputError("no such model file", path, "give an .onnx file, or leave --model out for the shipped one")
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    try:
        return ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime's own classes are not public
        raise InputError(f"not a readable ONNX model ({_first_line(error)})", path, "export it again") from error


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:160]


def _input_size(shape: list[Any], meta: dict[str, str], path: str) -> tuple[tuple[int, int] | None, int]:
    """The fixed input size (w, h), or None for a model that takes any, and the long side to use then."""
    if len(shape) != 4 or (isinstance(shape[1], int) and shape[1] != 3):
        raise InputError(f"unknown model input {shape}", path, "give a detector with input (1, 3, height, width)")
    if isinstance(shape[2], int) and isinstance(shape[3], int):
        return (shape[3], shape[2]), max(shape[2:])
    size = _literal(meta.get("imgsz"), [640])
    return None, max(int(v) for v in np.ravel(size))


def _names(meta: dict[str, str]) -> dict[int, str]:
    names = _literal(meta.get("names"), {})
    pairs = names.items() if isinstance(names, dict) else enumerate(names)
    return {int(k): str(v) for k, v in pairs}


def _literal(text: str | None, default: Any) -> Any:
    """A value written in the metadata as Python writes it, as the common exporters do."""
    try:
        return ast.literal_eval(text) if text else default
    except (ValueError, SyntaxError):
        return default


def _strides(side: float) -> int:
    return max(STRIDE, int(np.ceil(side / STRIDE - 1e-6)) * STRIDE)


def letterbox(image: Image, size: tuple[int, int], bgr_255: bool) -> tuple[Floats, float, Floats]:
    """The image, scaled to fit ``size`` (w, h) and centred on grey, as the network's input.

    -> (1, 3, h, w) RGB in 0..1 (or BGR in 0..255), the scale, the border (2,) x, y: q_net = scale * q + border.
    """
    if image.ndim == 2:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    height, width = image.shape[:2]
    scale = min(size[0] / width, size[1] / height)
    fitted = (max(1, round(width * scale)), max(1, round(height * scale)))
    canvas = np.full((size[1], size[0], 3), GREY, np.uint8)
    left, top = (size[0] - fitted[0]) // 2, (size[1] - fitted[1]) // 2
    canvas[top : top + fitted[1], left : left + fitted[0]] = cv2.resize(
        _halved(image, fitted), fitted, interpolation=cv2.INTER_LINEAR
    )
    blob = cv2.dnn.blobFromImage(canvas, 1.0 if bgr_255 else 1 / 255, swapRB=not bgr_255)
    return np.asarray(blob, np.float32), scale, np.array([left, top], np.float32)


def _halved(image: Image, size: tuple[int, int]) -> Image:
    """Exact halvings by averaging while the image is twice ``size`` or more: no aliasing, at a fraction of the cost."""
    while image.shape[1] >= 2 * size[0] and image.shape[0] % 2 == 0 and image.shape[1] % 2 == 0:
        half = (image.shape[1] // 2, image.shape[0] // 2)
        image = np.asarray(cv2.resize(image, half, interpolation=cv2.INTER_AREA), np.uint8)
    return image


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
