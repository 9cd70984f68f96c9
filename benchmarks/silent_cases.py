"""The dives of ``benchmarks.silent``: drawn by their number, rendered once, spoilt by faults as often as wanted."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leadline.rig import Rig
from leadline.samples import Detection, Sample, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.faults import Fault, Mode, Sensor, inject
from leadline.simulation.scenario import Scenario
from leadline.target import Cylinder, Plane, Sphere, Surface, Target
from leadline.water import Water, WaterState

Box = tuple[int, int, int, int]
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
MISSED, SHAKE = 0.05, 0.03  # share of boxes that are not found; how far off borders are, of the box's size


@dataclass(frozen=True, slots=True)
class Footage:
    """A dive without faults: samples as they arrive, the true rig, true range (m) by stamp, boxes by frame name."""

    samples: tuple[Sample, ...]
    rig: Rig
    range_m: dict[int, float]
    boxes_px: dict[str, Box | None]


@dataclass(frozen=True, slots=True)
class Case:
    """A dive, what goes wrong in it, and whom the localizer is told to look for, with which rig."""

    number: int
    draw: int
    name: str
    scenario: Scenario
    faults: tuple[Fault, ...]
    target: Target
    rig_of_the_sea: bool

    def footage(self, folder: Path | None = None) -> Footage:
        """Rendered; ``folder``: where what was rendered once is kept."""
        kept = None if folder is None else folder / f"{self.number}.pickle"
        if kept is not None and kept.exists():
            return pickle.loads(kept.read_bytes())  # type: ignore[no-any-return]
        footage = _render(self)
        if kept is not None:
            part = kept.with_suffix(".part")
            part.write_bytes(pickle.dumps(footage))
            part.rename(kept)
        return footage

    def rig(self, footage: Footage) -> Rig:
        """The rig that the localizer is given."""
        if not self.rig_of_the_sea:
            return footage.rig
        return footage.rig.in_water(Water.from_state(WaterState(20.0, 35.0), footage.rig.laser_wavelength_nm))

    def samples(self, footage: Footage) -> Iterator[Sample]:
        """What comes, with its faults."""
        return inject(footage.samples, self.faults, np.random.default_rng((self.number, self.draw, 1)))


class ShakyBoxes:
    """The true boxes of what is in the left picture, their borders a little off; now and then none."""

    def __init__(self, footage: Footage, seed: int) -> None:
        frames = [s for s in footage.samples if isinstance(s, StereoFrame)]
        self._boxes = {id(frame.left): footage.boxes_px[frame.name] for frame in frames}
        self._rng = np.random.default_rng(seed)

    def find(self, frame: StereoFrame) -> list[Detection]:
        box, missed, off = self._boxes.get(id(frame.left)), self._rng.random() < MISSED, self._rng.standard_normal(4)
        if box is None or missed:
            return []
        size = np.array([box[2] - box[0], box[3] - box[1]])
        x0, y0, x1, y1 = (np.array(box) + SHAKE * off * np.tile(size, 2)).tolist()
        return [Detection((x0, y0, x1 - x0, y1 - y0), 0.9)]


def case(number: int, draw: int = 0) -> Case:
    """The dive of this number; ``draw``: other faults and another target in the same pictures."""
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
    if draw:
        rng = np.random.default_rng((number, draw))
    faults = []
    for _ in range(rng.choice([0, 1, 2], p=[0.35, 0.45, 0.2])):
        sensor, mode, size = FAULTS[rng.integers(len(FAULTS))]
        start_s = float(rng.uniform(0, duration_s - 0.5))
        faults.append(Fault(sensor=sensor, mode=mode, size=size, start_s=start_s, end_s=start_s + WINDOW_S))
        told.append(f"{sensor} {mode} {'' if size is None else f'{size:g} '}{start_s:.1f} s")
    of_the_sea = bool(rng.random() < 0.1)
    if of_the_sea:
        told.append("rig of the sea")
    choice = TARGETS[scene][rng.integers(len(TARGETS[scene]))]
    parts = {
        "path": scenario.path.model_copy(update=path),
        "camera": scenario.camera.model_copy(update=camera),
        "laser": scenario.laser.model_copy(update=laser),
        "target": scenario.target.model_copy(update=target),
        "faults": (),
    }
    name = f"{number}{f'.{draw}' if draw else ''}: {', '.join([*told, choice.name])}"
    return Case(number, draw, name, scenario.model_copy(update=parts), tuple(faults), choice, of_the_sea)


def _render(one: Case) -> Footage:
    dive = SimulatedDive(one.scenario, seed=one.number)
    samples = tuple(dive.samples())
    boxes = {frame["name"]: frame["box_left_px"] for frame in dive.details["frames"]}
    ranges = {s.t_ns: dive.truth_at(s.t_ns).range_m for s in samples}
    return Footage(samples, dive.rig, ranges, boxes)
