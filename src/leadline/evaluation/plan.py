"""``leadline plan``: what accuracy a rig will have, where, and with which of its measurements; before there is a dive.

No formula of its own: the measurements that a target at a place would give (``plan_sight``) go through the localizer,
with fresh noise in every frame, and what it then states is the prediction. The noise is drawn from a fixed seed.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from leadline.calibration.comparison import PLACES, field_points
from leadline.config import Config
from leadline.evaluation.plan_sight import (
    Conditions,
    ExpectedSight,
    box_of,
    expected_size,
    expected_spot,
    expected_stereo,
    vector_at,
)
from leadline.localizer import Localizer
from leadline.ranging.beam import BeamRanger
from leadline.ranging.coarse import Box
from leadline.rig import Rig
from leadline.samples import (
    NS_PER_S,
    Array,
    Detection,
    Kind,
    LaserRange,
    Measurement,
    Sample,
    Solution,
    Stage,
    StereoFrame,
)
from leadline.target import Target, range_with_sigma

DISTANCES_M = (0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.2, 3.0, 4.0, 5.0)
AIMED = "aimed"
EDGE = 0.05  # of an image's sides: what lies nearer to its border is not aimed at
DRAWS = 15  # frames alone, whose median is stated
_NO_IMAGE = np.zeros((1, 1), np.uint8)


@dataclass(frozen=True, slots=True)
class Sigma:
    """Standard deviations, m: of the range, and of the position (root of its covariance's trace)."""

    range_m: float
    position_m: float


@dataclass(frozen=True, slots=True)
class Cell:
    """The target with its nearest point at a distance and a place of the view.

    each: range sigma of what one frame (laser: one reading) gives by itself, by kind; a spot's and a reading's along
    the beam. alone, filtered: with all of it; None where there is nothing to start from. calibration_m: the part of the
    rig's own uncertainty in stereo's range.
    """

    distance_m: float
    place: str
    each: dict[str, float] = field(default_factory=dict)
    alone: Sigma | None = None
    filtered: Sigma | None = None
    stage: int = int(Stage.SEARCHING)
    calibration_m: float = 0.0

    @property
    def alone_m(self) -> float | None:
        return None if self.alone is None else self.alone.range_m

    @property
    def filtered_m(self) -> float | None:
        return None if self.filtered is None else self.filtered.range_m


class Rehearsal:
    """A target, a rig and conditions; ``cell`` says what is to be expected there."""

    def __init__(self, rig: Rig, target: Target, conditions: Conditions, config: Config | None = None) -> None:
        self.rig, self.target, self.conditions, self.config = rig, target, conditions, config or Config()
        self._localizer = _Rehearsing(rig, target, self.config)
        self._beam = None if rig.laser is None else BeamRanger(rig, target)

    def expected(self, x: Array) -> list[Measurement]:
        """What one frame says; the laser's reading is not in it."""
        rig, target, config = self.rig, self.target, self.config
        found = [
            expected_size(rig, target, config.outline, x),
            expected_stereo(rig, target, config.stereo, self.conditions, x),
        ]
        if self._beam is not None:
            found.append(expected_spot(rig, target, self._beam, config.beam, self.conditions, x))
        return [one for one in found if one is not None]

    def kinds(self, nearest_m: Array) -> set[str]:
        """What can be measured of a target with its nearest point there."""
        x = vector_at(self.target, nearest_m)
        found = {one.kind.value for one in self.expected(x)}
        return found if self._reading(x, 0) is None else found | {Kind.LASER.value}

    def cell(self, nearest_m: Array, place: str = AIMED) -> Cell:
        """``nearest_m``: (3,) the target's nearest point."""
        distance = float(np.linalg.norm(nearest_m))
        x = vector_at(self.target, nearest_m)
        seen = self.expected(x)
        box = box_of(self.rig, self.target, x)
        each = {one.kind.value: self._range_sigma(one) for one in seen}
        reading = self._reading(x, 0)
        if reading is not None and self._beam is not None and self.rig.laser is not None:
            gain = self.rig.laser.range_scale * self.rig.laser.group_index
            each[Kind.LASER.value] = float(np.sqrt(self._beam.reading(reading).cov[0, 0])) / gain
        sight = nearest_m / distance
        calibration = float(np.sqrt(sight @ self._localizer.calibration.at(x[:3]) @ sight))
        if box is None:
            return Cell(distance, place, each, calibration_m=calibration)
        last = self._filtered(x, seen, box)
        stage = Stage.SEARCHING if last is None else last[-1].stage
        half = None if last is None else last[len(last) // 2 :]
        alone, filtered = _sigma(self._alone(x, seen, box)), _sigma(half)
        return Cell(distance, place, each, alone, filtered, int(stage), calibration)

    def without_laser(self) -> Rehearsal:
        return Rehearsal(dataclasses.replace(self.rig, laser=None), self.target, self.conditions, self.config)

    def _range_sigma(self, one: Measurement) -> float:
        if one.kind is Kind.SPOT:
            return float(np.sqrt(one.cov[0, 0]))
        return range_with_sigma(self.target, one.z, one.cov)[1]

    def _reading(self, x: Array, t_ns: int) -> LaserRange | None:
        """The exact reading of a target at x; None where the beam misses it."""
        laser = self.rig.laser
        if laser is None:
            return None
        length = float(self.target.beam_length(x, laser.origin_m[None], laser.direction[None])[0][0])
        return LaserRange(t_ns, laser.raw_m(length)) if np.isfinite(length) else None

    def _alone(self, x: Array, seen: list[Measurement], box: Box) -> list[Solution] | None:
        """Frames with a reading at the same time, each by itself."""
        localizer = self._localizer.showing(seen, box, filtered=False)
        spacing_ns = int(2 * max(self.config.beam.reading_age_s, 1.0) * NS_PER_S)
        samples: list[Sample] = []
        for i in range(1, DRAWS + 1):
            samples += self._noisy_reading(x, i * spacing_ns, i)
            samples.append(_frame(i * spacing_ns))
        return _frames(localizer, samples)

    def _filtered(self, x: Array, seen: list[Measurement], box: Box) -> list[Solution] | None:
        """All solutions of a target that is looked at for a while."""
        c = self.conditions
        samples: list[Sample] = [
            _frame(int(i / c.frames_hz * NS_PER_S)) for i in range(int(c.seconds * c.frames_hz) + 1)
        ]
        for i in range(int(c.seconds * c.readings_hz)):
            samples += self._noisy_reading(x, int((i + 0.5) / c.readings_hz * NS_PER_S), i)
        samples.sort(key=lambda sample: sample.t_ns)
        return _frames(self._localizer.showing(seen, box, filtered=True), samples)

    def _noisy_reading(self, x: Array, t_ns: int, seed: int) -> list[Sample]:
        exact = self._reading(x, t_ns)
        if exact is None or self.rig.laser is None:
            return []
        noise = self.rig.laser.range_sigma_m * float(np.random.default_rng((7, seed)).standard_normal())
        return [dataclasses.replace(exact, range_m=exact.range_m + noise)]


class _Rehearsing(Localizer):
    """The localizer with expected measurements in the place of its eyes."""

    def __init__(self, rig: Rig, target: Target, config: Config) -> None:
        super().__init__(rig, target, None, config)
        self.calibration = self._sight.calibration
        self._sight = self._expected = ExpectedSight(self._sight, seed=11)

    def showing(self, seen: list[Measurement], box: Box, *, filtered: bool) -> _Rehearsing:
        """A fresh one; its tables take long to make, and are copied."""
        fresh = copy.deepcopy(self)
        fresh._filtered, fresh._finder, fresh._expected.expected = filtered, _Boxed(box), seen
        return fresh


class _Boxed:
    """Finds the target where it is."""

    def __init__(self, box: Box) -> None:
        self._found = [Detection(box, 1.0)]

    def find(self, frame: StereoFrame) -> list[Detection]:
        return self._found


def _frame(t_ns: int) -> StereoFrame:
    return StereoFrame(t_ns, _NO_IMAGE, _NO_IMAGE)


def _frames(localizer: Localizer, samples: Sequence[Sample]) -> list[Solution] | None:
    """The frames' solutions; None where none has a position."""
    taken = [(sample, localizer.step(sample)) for sample in samples]
    found = [s for sample, s in taken if isinstance(sample, StereoFrame) and s is not None and s.cov_m2 is not None]
    return found or None


def _sigma(solutions: Sequence[Solution] | None) -> Sigma | None:
    if solutions is None:
        return None
    range_m = float(np.median([s.range_sigma_m for s in solutions if s.range_sigma_m is not None]))
    return Sigma(range_m, float(np.median([np.sqrt(np.trace(s.cov_m2)) for s in solutions if s.cov_m2 is not None])))


def aimed(rig: Rig, distance_m: float) -> Array:
    """(3,) the point of the beam at a distance, which a pilot puts on the target; where no camera sees it, or without a
    laser, the middle of the common view. NaN where the views do not meet."""
    laser = rig.laser
    if laser is not None:
        along = float(laser.origin_m @ laser.direction)
        inside = along**2 + distance_m**2 - float(laser.origin_m @ laser.origin_m)
        point = laser.origin_m + (np.sqrt(max(inside, 0.0)) - along) * laser.direction
        sizes = ((rig.left.width, rig.left.height), (rig.right.width, rig.right.height))
        if all(_inside(q_px[0], size) for q_px, size in zip(rig.project(point[None]), sizes, strict=True)):
            return np.asarray(point)
    middle = field_points(rig, [distance_m])[0, 0]
    return np.asarray(middle * distance_m / np.linalg.norm(middle))


def _inside(q_px: Array, size: tuple[int, int]) -> bool:
    low, high = EDGE * np.array(size), (1 - EDGE) * np.array(size)
    return bool(((q_px > low) & (q_px < high)).all())


def places(rig: Rig, distance_m: float) -> dict[str, Array]:
    """Nearest points (3,) of targets at a distance: where the beam is, and over the common view, by name."""
    points = field_points(rig, [distance_m])[0]
    found = dict(zip(PLACES, points * distance_m / np.linalg.norm(points, axis=1, keepdims=True), strict=True))
    return {name: p for name, p in ({AIMED: aimed(rig, distance_m)} | found).items() if np.isfinite(p).all()}


def table(rehearsal: Rehearsal, distances_m: Sequence[float] = DISTANCES_M) -> list[Cell]:
    """Every distance at every place that both cameras see."""
    return [rehearsal.cell(p, name) for z in distances_m for name, p in places(rehearsal.rig, z).items()]
