"""Short cuts of the shipped scenarios, small and rendered once for all tests of a process."""

from __future__ import annotations

from functools import cache

import numpy as np

from leadline.samples import Array, Detection, Sample, Solution, Status, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario


@cache
def cut(
    name: str, start_m: float = 1.2, end_m: float = 0.4, rate_hz: float = 5.0, speed_m_s: float = 0.4
) -> SimulatedDive:
    """An even approach without dwelling, 640 x 360."""
    scenario = Scenario.load(name)
    path = scenario.path.model_copy(update={"start_m": start_m, "end_m": end_m, "speed_m_s": speed_m_s, "dwell_s": 0.0})
    camera = scenario.camera.model_copy(update={"rate_hz": rate_hz})
    laser = scenario.laser.model_copy(update={"dropouts": 0.0})
    return SimulatedDive(scenario.model_copy(update={"path": path, "camera": camera, "laser": laser}), seed=3)


@cache
def samples(dive: SimulatedDive) -> tuple[Sample, ...]:
    return tuple(dive.samples())


class TrueBoxes:
    """The target's true box in every frame, as a perfect detector would give it; none in frames that are black."""

    def __init__(self, dive: SimulatedDive) -> None:
        samples(dive)
        self._boxes = {f["name"]: f["box_left_px"] for f in dive.details["frames"]}

    def find(self, frame: StereoFrame) -> list[Detection]:
        x0, y0, x1, y1 = self._boxes[frame.name] or (0, 0, 0, 0)
        if not frame.left.any() or x1 <= x0:
            return []
        return [Detection((float(x0), float(y0), float(x1 - x0), float(y1 - y0)), 0.9)]


def range_errors(solutions: list[Solution], dive: SimulatedDive) -> tuple[Array, Array]:
    """Errors and stated sigmas (N,), m, of the valid solutions."""
    valid = [s for s in solutions if s.status is Status.VALID]
    error = [s.range_m - dive.truth_at(s.t_ns).range_m for s in valid]  # type: ignore[operator]
    return np.array(error), np.array([s.range_sigma_m for s in valid], float)
