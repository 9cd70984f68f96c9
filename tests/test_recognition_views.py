"""Boxes of a ball that is cut by the border, fills the view, or is lit from one side only, in rendered pictures."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline.recognition.detector import Detector
from leadline.recognition.track import Box, iou
from leadline.samples import Image

pytestmark = pytest.mark.data
LEAST_IOU = 0.5


@pytest.fixture(scope="module")
def detector() -> Detector:
    return Detector(threads=1)


def views(data_dir: Path) -> list[tuple[str, Image, Box]]:
    """Every fourth left picture of both dives, and the last, with its true box."""
    out = []
    for dive in ("approach_ball_clear", "approach_ball_turbid"):
        folder = data_dir / "rendered_dives" / dive
        frames = json.loads((folder / "truth.json").read_text())["frames"]
        for frame in [*frames[:-1:4], frames[-1]]:
            x0, y0, x1, y1 = frame["bbox_left_px"]
            image = np.asarray(cv2.imread(str(folder / frame["left"])), np.uint8)
            out.append((f"{dive} {frame['left']}", image, (x0 - 0.5, y0 - 0.5, x1 - x0, y1 - y0)))
    return out


def best_iou(detector: Detector, image: Image, box: Box) -> float:
    return max((iou(d.box_px, box) for d in detector.detect(image)), default=0.0)


def lost(found: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 2) for name, value in found.items() if value < LEAST_IOU}


def test_in_full_view_and_filling_it(detector: Detector, data_dir: Path) -> None:
    assert lost({name: best_iou(detector, image, box) for name, image, box in views(data_dir)}) == {}


@pytest.mark.parametrize("part", [0.4, 0.6])
@pytest.mark.parametrize("side", ["left", "bottom"])
def test_cut_by_the_border(detector: Detector, data_dir: Path, part: float, side: str) -> None:
    """The picture ends where only a part of the ball is left in it."""
    found = {}
    for name, image, (x, y, w, h) in views(data_dir):
        if side == "left":
            start = int(x + (1 - part) * w)
            if start > 0.6 * image.shape[1] or start < 0:
                continue
            found[name] = best_iou(detector, image[:, start:], (-0.5, y, x + w - start + 0.5, h))
        else:
            end = int(y + part * h)
            if end < 0.4 * image.shape[0]:
                continue
            found[name] = best_iou(detector, image[:end], (x, y, w, end - 0.5 - y))
    assert len(found) >= 4
    assert len(lost(found)) <= len(found) // 6, lost(found)


def test_lit_from_one_side(detector: Detector, data_dir: Path) -> None:
    """The light falls off across the ball, to a seventh."""
    found = {}
    for name, image, box in views(data_dir):
        across = np.clip((np.arange(image.shape[1]) - box[0]) / box[2], 0, 1)
        dimmed = (image * (1 - 0.85 * across)[None, :, None]).astype(np.uint8)
        found[name] = best_iou(detector, dimmed, box)
    assert len(lost(found)) <= len(found) // 6, lost(found)
