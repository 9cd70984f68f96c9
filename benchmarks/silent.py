"""Simulated dives with things that go wrong: how often a solution is wrong and does not say so.

    python -m benchmarks.silent [DIVES [FIRST]]

Small pictures (320x180), some thirty frames a dive, drawn by its number: scene, water, featureless or clothed, sensor
faults, exposures and clocks apart, a rig for other water, boxes that shake and fail. Silent: a valid solution whose
range is off by more than 5 stated sigmas and 20 mm.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from leadline.localizer import Localizer
from leadline.rig import Rig
from leadline.samples import Detection, Sample, Solution, Status, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.faults import Fault, Mode, Sensor
from leadline.simulation.scenario import Scenario
from leadline.target import Cylinder, Plane, Sphere, Surface, Target
from leadline.water import Water, WaterState

SILENT_SIGMAS, SILENT_M = 5.0, 0.020
TARGETS: dict[str, tuple[Target, ...]] = {
    "demo": (Sphere(0.34), Sphere(), Surface()),
    "turbid": (Sphere(0.34),),
    "stress": (Sphere(0.34),),
    "hull": (Plane(),),
    "pile": (Cylinder(0.5),),
    "lump": (Surface(),),
}
SCENES = ("demo", "demo", "demo", "turbid", "turbid", "stress", "stress", "hull", "hull", "lump")
FAULTS: tuple[tuple[Sensor, Mode, float | None], ...] = (
    ("camera", "off", None), ("camera", "stuck", None), ("camera", "garbage", None), ("camera", "wrong", 4.0),
    ("camera", "slow", 3.0), ("camera", "delayed", 0.4), ("camera", "intermittent", 0.5),
    ("left", "off", None), ("left", "stuck", None), ("right", "off", None), ("right", "stuck", None),
    ("right", "wrong", 6.0), ("right", "garbage", None),
    ("laser", "off", None), ("laser", "stuck", None), ("laser", "garbage", None), ("laser", "wrong", 0.1),
    ("laser", "wrong", 0.3), ("laser", "delayed", 0.5), ("laser", "intermittent", 0.5),
)  # fmt: skip
WINDOW_S = 2.0


@dataclass(frozen=True, slots=True)
class Case:
    """A dive, whom it is told to look for, with which rig."""

    name: str
    dive: SimulatedDive
    target: Target
    rig: Rig


@dataclass(frozen=True, slots=True)
class Result:
    """errors and sigmas of the valid solutions, m; silent: times of the silent ones, s."""

    name: str
    error_m: np.ndarray[Any, np.dtype[np.float64]]
    sigma_m: np.ndarray[Any, np.dtype[np.float64]]
    silent_s: tuple[float, ...]
    notices: tuple[str, ...]


class ShakyBoxes:
    """The true boxes, their borders off by some per cent of their size; now and then none."""

    def __init__(self, dive: SimulatedDive, rng: np.random.Generator) -> None:
        self._dive, self._rng = dive, rng

    def find(self, frame: StereoFrame) -> list[Detection]:
        truth = {one["name"]: one["box_left_px"] for one in self._dive.details["frames"]}
        x0, y0, x1, y1 = truth.get(frame.name) or (0, 0, 0, 0)
        if self._rng.random() < 0.05 or x1 <= x0 or frame.left.mean() < 2:
            return []
        off = 0.03 * self._rng.standard_normal(4) * [x1 - x0, y1 - y0, x1 - x0, y1 - y0]
        x0, y0, x1, y1 = np.array([x0, y0, x1, y1]) + off
        return [Detection((float(x0), float(y0), float(x1 - x0), float(y1 - y0)), 0.9)]


def case(number: int) -> Case:
    """The dive of this number."""
    rng = np.random.default_rng(number)
    scene = SCENES[rng.integers(len(SCENES))]
    scenario = Scenario.load(scene)
    start_m = float(rng.uniform(1.0, 2.2))
    path = {"start_m": start_m, "end_m": max(0.25, start_m - 0.9), "speed_m_s": rng.uniform(0.12, 0.35), "dwell_s": 0.5}
    duration_s = (path["start_m"] - path["end_m"]) / path["speed_m_s"] + path["dwell_s"]
    camera: dict[str, Any] = {"rate_hz": min(30 / duration_s, 10.0), "image_width_px": 320}
    laser: dict[str, Any] = {}
    told = [scene]
    if rng.random() < 0.3 and scene != "stress":
        camera |= {"skew_s": float(rng.choice([-0.016, 0.008, 0.016])), "skew_known": bool(rng.random() < 0.7)}
        told.append(f"skew {camera['skew_s']:g} {'known' if camera['skew_known'] else 'untold'}")
    if rng.random() < 0.3:
        laser["clock_offset_s"] = float(rng.choice([0.015, -0.03, 0.3, -0.3]))
        told.append(f"clock {laser['clock_offset_s']:g}")
    target: dict[str, Any] = {}
    if rng.random() < 0.3:
        target = {"contrast": 0.0, "detail": 0.0}
        told.append("featureless")
    faults = []
    for _ in range(rng.choice([0, 1, 2], p=[0.35, 0.45, 0.2])):
        sensor, mode, size = FAULTS[rng.integers(len(FAULTS))]
        start_s = float(rng.uniform(0, duration_s - 0.5))
        faults.append(Fault(sensor=sensor, mode=mode, size=size, start_s=start_s, end_s=start_s + WINDOW_S))
        told.append(f"{sensor} {mode} {start_s:.1f} s")
    parts = {
        "path": scenario.path.model_copy(update=path),
        "camera": scenario.camera.model_copy(update=camera),
        "laser": scenario.laser.model_copy(update=laser),
        "target": scenario.target.model_copy(update=target),
        "faults": tuple(faults),
    }
    dive = SimulatedDive(scenario.model_copy(update=parts), seed=number)
    rig = dive.rig
    if rng.random() < 0.1:
        rig = rig.in_water(Water.from_state(WaterState(20.0, 35.0), rig.laser_wavelength_nm))
        told.append("rig of the sea")
    choice = TARGETS[scene][rng.integers(len(TARGETS[scene]))]
    return Case(f"{number}: {', '.join([*told, choice.name])}", dive, choice, rig)


def solve(one: Case, inputs: Iterator[Sample] | None = None) -> Result:
    """Run a case through the localizer."""
    boxes = ShakyBoxes(one.dive, np.random.default_rng(one.dive.seed))
    finder = None if isinstance(one.target, Plane | Cylinder) else boxes
    localizer = Localizer(one.rig, one.target, finder)
    rows = [row for s in map(localizer.step, inputs or one.dive.samples()) if (row := _row(one.dive, s)) is not None]
    t_s, error, sigma = np.array(rows).reshape(-1, 3).T
    silent = (np.abs(error) > SILENT_SIGMAS * sigma) & (np.abs(error) > SILENT_M)
    return Result(one.name, error, sigma, tuple(t_s[silent].tolist()), tuple(localizer.notices))


def _row(dive: SimulatedDive, s: Solution | None) -> tuple[float, float, float] | None:
    if s is None or s.status is not Status.VALID or s.range_m is None or s.range_sigma_m is None:
        return None
    return s.t_s, s.range_m - dive.truth_at(s.t_ns).range_m, s.range_sigma_m


def main(dives: int = 40, first: int = 0) -> bool:
    """Print the silent errors and a line of sums; whether there were none."""
    cv2.setNumThreads(1)
    results = []
    for number in range(first, first + dives):
        result = solve(case(number))
        results.append(result)
        if result.silent_s:
            worst = float(np.abs(result.error_m).max())
            times = ", ".join(f"{t:.2f}" for t in result.silent_s[:6])
            print(f"{result.name}: {len(result.silent_s)} silent, to {1e3 * worst:.0f} mm, at {times} s", flush=True)
    error, sigma = (np.concatenate([getattr(r, name) for r in results]) for name in ("error_m", "sigma_m"))
    count = sum(len(r.silent_s) for r in results)
    print(
        f"{dives} dives, {len(error)} solutions: {count} silent in {sum(bool(r.silent_s) for r in results)} dives; "
        f"|error| mean {1e3 * np.abs(error).mean():.1f} mm, RMS {1e3 * np.sqrt(np.mean(error**2)):.1f} mm, "
        f"median sigma {1e3 * np.median(sigma):.1f} mm, within 2 sigma {np.mean(np.abs(error) < 2 * sigma):.1%}"
    )
    return count == 0


if __name__ == "__main__":
    sys.exit(0 if main(*map(int, sys.argv[1:])) else 1)
