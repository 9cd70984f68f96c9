"""Small dives for the tests of sources, sinks and wire."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from leadline.samples import LaserRange, Sample, StereoFrame, VehicleMotion

LATE_NS = 1_700_000_001_000_000_000
SIZE = (64, 48)  # width, height


def picture(seed: int, size: tuple[int, int] = SIZE, *, grey: bool = False) -> np.ndarray:
    shape = (size[1], size[0]) if grey else (size[1], size[0], 3)
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def write_folder(folder: Path, frames: int = 4, *, frames_csv: str = "", laser_csv: str = "") -> Path:
    """A clean dive: frames every 0.4 s with JPEG images, a reading with each; tables replaceable by their text."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(frames):
        for side, seed in (("left", i), ("right", 100 + i)):
            cv2.imwrite(str(folder / f"{side}_{i}.jpg"), picture(seed))
    rows = "".join(f"{i * 4 / 10},left_{i}.jpg,right_{i}.jpg\n" for i in range(frames))
    (folder / "frames.csv").write_text(frames_csv or f"t_s,left,right\n{rows}")
    readings = "".join(f"{i * 4 / 10},{3 - i / 10}\n" for i in range(frames))
    (folder / "laser.csv").write_text(laser_csv or f"t_s,range_m\n{readings}")
    return folder


def same(one: Sample, other: Sample) -> bool:
    """Bit for bit, but for the compressed bytes, which a frame made in memory does not have."""
    if not (isinstance(one, StereoFrame) and isinstance(other, StereoFrame)):
        return one == other
    fields = ("t_ns", "arrival_ns", "left_t_ns", "right_t_ns", "name")
    return (
        all(getattr(one, field) == getattr(other, field) for field in fields)
        and np.array_equal(one.left, other.left)
        and np.array_equal(one.right, other.right)
    )


def memory_dive() -> list[Sample]:
    """Frames without bytes (grey and colour), skew, late arrival, odd numbers: all that a recording has to keep."""
    return [
        LaserRange(0, 0.668, None, None),
        StereoFrame(100_000_001, picture(1), picture(2), 180_000_000, 99_000_000, 101_000_002, "a/left_0.png"),
        LaserRange(150_000_000, 3.0587654321, 0.12345678901234567, 190_000_000),
        StereoFrame(1_700_000_000_123_456_789, picture(3, grey=True), picture(4, grey=True), name="left,1.png"),
        VehicleMotion(
            LATE_NS, (0.1, -0.25, 1 / 3), (0.01, 0.0, -0.02), 0.0123456789012345, 0.003, LATE_NS + 20_000_000
        ),
        VehicleMotion(LATE_NS + 7, None, (1 / 7, 0.0, 0.0), arrival_ns=LATE_NS + 20_000_000),
    ]
