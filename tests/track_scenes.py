"""Sequences in which detections fail: misses, a second ball that crosses, false boxes, a target that is gone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np

from leadline.samples import Detection, Image, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from short_dives import TrueBoxes, cut, samples

Boxes = Callable[[int, list[Detection]], list[Detection]]  # number of the frame, what is truly there -> what is found
RATE_HZ = 8.0


@cache
def dive() -> SimulatedDive:
    return cut("demo", 0.9, 0.45, RATE_HZ, 0.2)  # 19 frames


@cache
def empty_frame() -> StereoFrame:
    """The same water without a ball in view."""
    scenario = Scenario.load("demo")
    path = scenario.path.model_copy(update={"start_m": 0.9, "end_m": 0.85, "dwell_s": 0.0, "offset_m": (4.0, 0.0)})
    camera = scenario.camera.model_copy(update={"rate_hz": RATE_HZ})
    return frames(SimulatedDive(scenario.model_copy(update={"path": path, "camera": camera}), seed=3))[0]


def empty_frames(times_ns: list[int]) -> list[StereoFrame]:
    """Frames without a ball at these times, each with its own noise."""
    frame = empty_frame()
    noise = np.random.default_rng(7).integers(-2, 3, frame.left.shape, np.int8)
    left, right = (np.clip(image, 2, 253) for image in (frame.left, frame.right))

    def noisy(image: Image, k: int) -> Image:
        return np.asarray(image + np.roll(noise, 3 * k + 1, axis=0), np.uint8)

    return [
        replace(frame, t_ns=t, name="", left=noisy(left, k), right=noisy(right, 50 + k), encoded=None)
        for k, t in enumerate(times_ns)
    ]


def frames(of: SimulatedDive) -> list[StereoFrame]:
    return [sample for sample in samples(of) if isinstance(sample, StereoFrame)]


class Spoilt:
    """True boxes, spoilt by ``spoil``."""

    def __init__(self, spoil: Boxes) -> None:
        self._spoil, self._true = spoil, TrueBoxes(dive())
        self._number = {frame.name: k for k, frame in enumerate(frames(dive()))}

    def find(self, frame: StereoFrame) -> list[Detection]:
        return self._spoil(self._number[frame.name], self._true.find(frame)) if frame.name else []


def with_second_ball(frame: StereoFrame, box: tuple[float, ...], shift_sizes: tuple[float, float]) -> StereoFrame:
    """The frame with its ball once more, at the same distance, beside or before itself."""
    dx, dy = (round(shift_sizes[k] * box[k + 2]) for k in (0, 1))
    disparity = _disparity(frame, box)
    left = _paste(frame.left, box, dx, dy)
    right = _paste(frame.right, (box[0] - disparity, *box[1:]), dx, dy)
    return replace(frame, left=left, right=right, encoded=None)


def shifted(box: tuple[float, ...], shift_sizes: tuple[float, float]) -> tuple[float, float, float, float]:
    return (box[0] + shift_sizes[0] * box[2], box[1] + shift_sizes[1] * box[3], box[2], box[3])


def _disparity(frame: StereoFrame, box: tuple[float, ...]) -> float:
    x, y, w, h = (round(v) for v in box)
    x, y = max(x, 0), max(y, 0)
    patch = frame.left[y : y + h, x : x + w]
    strip = frame.right[y : y + patch.shape[0], : x + patch.shape[1]]
    return x - float(cv2.minMaxLoc(cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED))[3][0])


def _paste(image: Image, box: tuple[float, ...], dx: int, dy: int) -> Image:
    """A disc of the image once more, ``dx``, ``dy`` px from where it is."""
    x, y, w, h = box
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.circle(mask, (round(x + w / 2), round(y + h / 2)), round(min(w, h) / 2) + 1, 255, -1)
    move = np.array([[1, 0, dx], [0, 1, dy]], np.float64)
    size = (image.shape[1], image.shape[0])
    there = cv2.warpAffine(mask, move, size, flags=cv2.INTER_NEAREST) > 0
    out = image.copy()
    out[there] = cv2.warpAffine(image, move, size, flags=cv2.INTER_NEAREST)[there]
    return out
