"""A network in training as a detector, so that it can be judged without an export."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from leadline.recognition.detector import best_of_overlapping
from leadline.recognition.heads import decode_yolov8
from leadline.recognition.letterbox import letterbox, planes
from leadline.samples import Detection, Image
from leadline.training.network import LARGEST_STRIDE, Exported, Network

LEAST_SCORE = 0.01
NMS_IOU = 0.5


class TorchDetector:
    """Does what ``recognition.Detector`` does with the exported network."""

    def __init__(self, network: Network, names: Sequence[str], long_side: int) -> None:
        self._exported = Exported(network).eval()
        self._names, self._long_side = names, long_side

    def detect(self, image: Image) -> list[Detection]:
        """The targets in ``image`` (H, W, 3) BGR, best first."""
        height, width = image.shape[:2]
        scale = self._long_side / max(width, height)
        size = tuple(-(-round(side * scale) // LARGEST_STRIDE) * LARGEST_STRIDE for side in (width, height))
        fitted = letterbox(image, (size[0], size[1]))
        pixels = torch.from_numpy(planes(fitted.canvas)).contiguous(memory_format=torch.channels_last)
        with torch.inference_mode():
            output = self._exported(pixels)[0].numpy()
        boxes, scores, classes = decode_yolov8(output, size[0], size[1], LEAST_SCORE)
        border = np.array([fitted.left, fitted.top] * 2, np.float32)
        boxes = np.clip((boxes - border) / fitted.scale, 0, np.array([width, height] * 2, np.float32))
        return [
            Detection(
                (float(x0) - 0.5, float(y0) - 0.5, float(x1 - x0), float(y1 - y0)),
                float(scores[k]),
                self._names[int(classes[k])],
            )
            for k in best_of_overlapping(boxes, scores, classes, NMS_IOU)
            for x0, y0, x1, y1 in [boxes[k]]
        ]
