"""What a run came to, as plain values for ``summary.json`` and for the table at its end."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from leadline.evaluation.accuracy import Errors, by_distance, by_stage
from leadline.rig import Rig
from leadline.samples import Array

_PARTS = ("leadline", "numpy", "opencv-python-headless", "onnxruntime", "scipy")


def accuracy(errors: Errors, *, own_point: bool = False) -> dict[str, Any] | None:
    """The tables of errors as plain values; None without truth. ``own_point``: also against the paper's own point."""
    if not len(errors.t_s):
        return None
    tables = {"by_stage": by_stage(errors), "by_distance": by_distance(errors)}
    if own_point:
        tables |= {
            "own_point_by_stage": by_stage(errors, own_point=True),
            "own_point_by_distance": by_distance(errors, own_point=True),
        }
    return {name: [asdict(row) for row in rows] for name, rows in tables.items()}


def pixel_cost_m(rig: Rig, range_m: float) -> float | None:
    """What one pixel of disparity is worth at a range, straight ahead, in metres; None where nothing is seen there."""
    left_px, right_px = rig.project(np.array([[0.0, 0.0, range_m]]))
    if not (np.isfinite(left_px).all() and np.isfinite(right_px).all()):
        return None
    half: Array = np.array([0.5, 0.0])
    points = rig.triangulate(np.repeat(left_px, 2, axis=0), np.concatenate([right_px - half, right_px + half]))[0]
    cost = float(np.linalg.norm(points[1] - points[0]))
    return cost if np.isfinite(cost) else None


def versions() -> Mapping[str, str]:
    found = {"python": platform.python_version()}
    for part in _PARTS:
        try:
            found[part] = version(part)
        except PackageNotFoundError:  # pragma: no cover - a source tree, or another build of OpenCV
            found[part] = "unknown"
    return found
