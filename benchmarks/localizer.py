"""A localizer's step without its detector, part by part, at 1920x1080 and 640x360, with a yardstick in the same run.

python -m benchmarks.localizer [DIVE]      # a dive folder of a ball of 0.34 m; default: a simulated approach

The yardstick is OpenCV making both frames grey and half as large: a busy machine slows it as much as the step, so that
their ratio holds where milliseconds do not. CPU time of one thread, medians over the frames after the first.
"""

from __future__ import annotations

import os
import sys

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before NumPy loads

import time  # noqa: E402
from collections import defaultdict  # noqa: E402
from collections.abc import Iterator  # noqa: E402
from contextlib import contextmanager  # noqa: E402
from dataclasses import replace  # noqa: E402
from functools import wraps  # noqa: E402
from typing import Any  # noqa: E402

import cv2  # noqa: E402
import numpy as np  # noqa: E402

from leadline import Detector, Localizer, Rig, Sphere  # noqa: E402
from leadline.estimation import Filter  # noqa: E402
from leadline.localizer.laser import LaserSight  # noqa: E402
from leadline.ranging import stereo  # noqa: E402
from leadline.ranging.calibration_error import CalibrationError  # noqa: E402
from leadline.ranging.outline import OutlineRanger  # noqa: E402
from leadline.samples import Detection, Sample, StereoFrame  # noqa: E402
from leadline.simulation.dive import SimulatedDive  # noqa: E402
from leadline.simulation.scenario import Scenario  # noqa: E402
from leadline.sources import open_source  # noqa: E402

PROMISED_MS = 10.0  # at 1920x1080
ROUNDS = 3
PARTS: tuple[tuple[Any, str, str], ...] = (
    (stereo.StereoRanger, "measure", "stereo"),
    (stereo, "coarse_points", "  coarse sweep"),
    (stereo.Region, "of", "  images"),
    (stereo, "centres", "  choice of patches"),
    (stereo, "predicted", "  their prediction"),
    (stereo, "search", "  search"),
    (stereo, "refine", "  refinement"),
    (stereo, "triangulated", "  triangulation"),
    (stereo, "fit", "  shape"),
    (OutlineRanger, "measure", "outline"),
    (LaserSight, "spot", "spot"),
    (Localizer, "_fresh", "new picture?"),
    (Localizer, "_where", "expected place"),
    (Localizer, "_hold", "held place"),
    (Localizer, "_add", "filter, with gates"),
    (Filter, "add", "  filter itself"),
    (Localizer, "_hear", "witnesses"),
    (Localizer, "_compare", "laser against cameras"),
    (Localizer, "_solution", "solution"),
)  # an indented part is within the one above it
EVERYWHERE: tuple[tuple[Any, str, str], ...] = (
    (CalibrationError, "at", "(calibration error)"),
    (Filter, "at", "(predictions)"),
)  # within several of the others
UNNAMED = "all else"


class Known:
    """Boxes found beforehand, of the frames of one dive by their stamps."""

    def __init__(self, boxes: dict[int, list[Detection]]) -> None:
        self._boxes = boxes

    def find(self, frame: StereoFrame) -> list[Detection]:
        return self._boxes[frame.t_ns]


def smaller(samples: list[Sample], factor: int) -> list[Sample]:
    def shrunk(image: Any) -> Any:
        return cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)

    return [
        replace(s, left=shrunk(s.left), right=shrunk(s.right), encoded=None) if isinstance(s, StereoFrame) else s
        for s in samples
    ]


def load(source: str | None) -> tuple[list[Sample], Rig, dict[int, list[Detection]]]:
    rig = Rig.load("rendered")
    if source is None:
        scenario = Scenario.load("approach")
        path = scenario.path.model_copy(update={"start_m": 2.2, "end_m": 0.25, "speed_m_s": 0.4, "dwell_s": 0.0})
        camera = scenario.camera.model_copy(update={"rate_hz": 3.0, "image_width_px": rig.left.width})
        dive = SimulatedDive(scenario.model_copy(update={"path": path, "camera": camera}), rig=rig)
        samples = list(dive.samples())
        ends = {f["name"]: f["box_left_px"] for f in dive.details["frames"]}
        found = {
            s.t_ns: [Detection((x0, y0, x1 - x0, y1 - y0), 0.9)]
            for s in samples
            if isinstance(s, StereoFrame)
            for x0, y0, x1, y1 in [ends[s.name]]
        }
        return samples, rig, found
    samples, detector = list(open_source(source)), Detector()
    return samples, rig, {s.t_ns: list(detector.find(s)) for s in samples if isinstance(s, StereoFrame)}


@contextmanager
def clocked(spent: dict[str, float]) -> Iterator[None]:
    """Every part adds the milliseconds of its calls to its name."""
    before = [(owner, name, owner.__dict__[name]) for owner, name, _ in PARTS + EVERYWHERE]
    for owner, name, label in PARTS + EVERYWHERE:
        setattr(owner, name, _clock(owner.__dict__[name], label, spent))
    try:
        yield
    finally:
        for owner, name, value in before:
            setattr(owner, name, value)


def _clock(call: Any, label: str, spent: dict[str, float]) -> Any:
    inner = call.__func__ if isinstance(call, classmethod) else call

    @wraps(inner)
    def timed(*args: Any, **kwargs: Any) -> Any:
        start = time.process_time()
        try:
            return inner(*args, **kwargs)
        finally:
            spent[label] += (time.process_time() - start) * 1e3

    return classmethod(timed) if isinstance(call, classmethod) else timed


def yardstick(frame: StereoFrame) -> float:
    start = time.process_time()
    for image in (frame.left, frame.right):
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return (time.process_time() - start) * 1e3


def measure(samples: list[Sample], rig: Rig, boxes: dict[int, list[Detection]]) -> tuple[dict[str, float], float]:
    """Median ms of each part and of the step, and the yardstick's."""
    rows: list[dict[str, float]] = []
    ruler = []
    for _ in range(ROUNDS):
        localizer = Localizer(rig, Sphere(diameter_m=0.34), Known(boxes))
        first = True
        for sample in samples:
            if not isinstance(sample, StereoFrame):
                localizer.step(sample)
                continue
            ruler.append(yardstick(sample))
            spent: dict[str, float] = defaultdict(float)
            with clocked(spent):
                start = time.process_time()
                localizer.step(sample)
                spent["step"] = (time.process_time() - start) * 1e3
            spent[UNNAMED] = spent["step"] - sum(spent[label] for *_, label in PARTS if not label.startswith(" "))
            if not first:
                rows.append(spent)
            first = False
    labels = ["step", *(label for *_, label in PARTS), UNNAMED, *(label for *_, label in EVERYWHERE)]
    return {label: float(np.median([row.get(label, 0.0) for row in rows])) for label in labels}, float(np.median(ruler))


def main(source: str | None) -> bool:
    """Print the table; whether the promise is kept."""
    cv2.setNumThreads(1)
    samples, rig, boxes = load(source)
    kept = True
    for factor in (1, 3):
        scaled = {
            t_ns: [replace(d, box_px=tuple(v / factor for v in d.box_px)) for d in found]  # type: ignore[arg-type]
            for t_ns, found in boxes.items()
        }
        parts, ruler = measure(smaller(samples, factor), rig.scaled(1 / factor), scaled)
        print(f"\n{rig.left.width // factor}x{rig.left.height // factor}: yardstick {ruler:.2f} ms")
        for label, ms in parts.items():
            print(f"  {label:22s} {ms:7.2f} ms {ms / ruler:7.2f} yardsticks")
        if factor == 1:
            kept = parts["step"] <= PROMISED_MS
            print(f"  promised: a step in {PROMISED_MS:g} ms: {'kept' if kept else 'MISSED'}")
    return kept


if __name__ == "__main__":
    sys.exit(0 if main(sys.argv[1] if len(sys.argv) > 1 else None) else 1)
