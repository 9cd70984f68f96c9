"""What a run came to, as plain values for ``summary.json`` and for the table at its end."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from leadline.evaluation.accuracy import Errors, by_distance, by_stage
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Array, Solution, Stage, Status

_PARTS = ("leadline", "numpy", "opencv-python-headless", "onnxruntime", "scipy")


def summarise(solutions: Sequence[Solution]) -> dict[str, Any]:
    """Counts by stage, status, use and rejection, and the range with its stated sigma (valid solutions), metres."""
    valid = [s for s in solutions if s.status is Status.VALID]
    return {
        "solutions": len(solutions),
        "stages": _counts(solutions, lambda s: str(int(s.stage)), [str(int(stage)) for stage in Stage]),
        "status": _counts(solutions, lambda s: str(s.status), [str(status) for status in Status]),
        "used": dict(sorted(Counter(str(kind) for s in solutions for kind in s.used).items())),
        "rejected": dict(sorted(Counter(f"{r.kind}: {r.reason}" for s in solutions for r in s.rejected).items())),
        "range_m": _spread([s.range_m for s in valid if s.range_m is not None]),
        "range_sigma_m": _spread([s.range_sigma_m for s in valid if s.range_sigma_m is not None]),
    }


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


def rates(stamps_ns: Sequence[int]) -> float | None:
    """Samples a second; None for fewer than two."""
    span_s = (max(stamps_ns) - min(stamps_ns)) / NS_PER_S if stamps_ns else 0.0
    return (len(stamps_ns) - 1) / span_s if span_s > 0 else None


def step_times_ms(steps_s: Sequence[float]) -> dict[str, float] | None:
    """How long the localizer took for a frame."""
    if not steps_s:
        return None
    ms = 1e3 * np.array(steps_s)
    return {"median": float(np.median(ms)), "p95": float(np.percentile(ms, 95)), "max": float(ms.max())}


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


def _counts(solutions: Sequence[Solution], key: Any, names: Sequence[str]) -> dict[str, int]:
    counted = Counter(key(solution) for solution in solutions)
    return {name: counted[name] for name in names}


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    return {"min": float(min(values)), "median": float(np.median(values)), "max": float(max(values))}
