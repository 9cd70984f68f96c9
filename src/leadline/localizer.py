"""The door: a sample goes in, a solution comes out. Live, simulated and replayed dives differ only before and after it.

    frame  -> box -> stereo on the target -> outline -> spot -+
    laser reading -------------------------------------------+-> one filter -> solution

The paper's three stages are which of these there are at the moment. No clock, no file, no network, no random number:
the time is in the sample, and the same samples give the same solutions bit for bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leadline.config import Config
from leadline.estimation import Estimate, Filter, FilterSettings
from leadline.ranging.beam import BeamRanger
from leadline.ranging.calibration_error import CalibrationError
from leadline.ranging.coarse import Box
from leadline.ranging.outline import OutlineRanger
from leadline.ranging.stereo import Pair, Prior, StereoRanger
from leadline.recognition.finder import Finder
from leadline.recognition.spot import find_spot
from leadline.recognition.track import choose, iou
from leadline.recognition.view import WholeView
from leadline.rig import Rig, Side
from leadline.samples import (
    NS_PER_S,
    Array,
    Detection,
    Kind,
    LaserRange,
    Measurement,
    Rejected,
    Sample,
    Solution,
    Stage,
    Status,
    StereoFrame,
)
from leadline.target import Sphere, Surface, Target

POOR = 0.1  # a range less certain than this part of itself is no prediction
VISION, BEAM = frozenset({Kind.STEREO, Kind.SIZE}), frozenset({Kind.LASER, Kind.SPOT})


class Localizer:
    """Ranges and tracks one target.

    rig: the calibrated rig. target: its shape. detector: who finds it in the left image (default: the whole view).
    filtered: False takes every frame alone, with the laser readings near it, and remembers nothing else.
    """

    def __init__(
        self,
        rig: Rig,
        target: Target | None = None,
        detector: Finder | None = None,
        config: Config | None = None,
        *,
        filtered: bool = True,
    ) -> None:
        self._rig, self._target = rig, target or Surface()
        self._finder = detector or WholeView()
        self._config = config or Config()
        self._filtered = filtered
        self._filter = Filter(FilterSettings(**self._config.filter.model_dump()))
        self._stereo = StereoRanger(rig, self._target, self._config.stereo)
        self._outline = self._make_outline()
        self._beam = None if rig.laser is None else BeamRanger(rig, self._target)
        self._calibration = CalibrationError(rig)
        self._beam_variance = 0.0 if self._beam is None else self._beam.calibration_variance_m2
        self._readings: deque[LaserRange] = deque(maxlen=32)
        self._last_used: dict[Kind, int] = {}
        self._last_box: Box | None = None
        self.detections: list[Detection] = []  # of the last frame, for those who draw

    def step(self, sample: Sample) -> Solution | None:
        """Take a sample; a solution at its time, or None for a laser reading while there is no target."""
        if isinstance(sample, LaserRange):
            return self._take_reading(sample)
        if not self._filtered:
            self._forget()
        self._expire(sample.t_ns)
        before = self._filter.at(sample.t_ns) if self._filter.alive else None
        self.detections = self._finder.find(sample)
        box = self._where(before)
        if box is None:
            return self._solution(sample.t_ns, [], [])
        measurements, rejected = self._measure(sample, box, before)
        if not self._filter.alive and not self._start(sample.t_ns, box, measurements):
            return self._solution(sample.t_ns, [], rejected)
        used, turned_away = self._filter.add(sample.t_ns, measurements)
        self._last_box = box
        return self._solution(sample.t_ns, used, rejected + turned_away)

    def _take_reading(self, sample: LaserRange) -> Solution | None:
        self._readings.append(sample)
        if self._beam is None or not self._filtered:
            return None
        self._expire(sample.t_ns)
        if not self._filter.alive:
            return None
        used, rejected = self._filter.add(sample.t_ns, [self._beam.reading(sample)])
        return self._solution(sample.t_ns, used, rejected)

    def _make_outline(self) -> OutlineRanger | None:
        if not isinstance(self._target, Sphere):
            return None
        return OutlineRanger(self._rig, self._target, self._config.outline)

    def _forget(self) -> None:
        self._filter.stop()
        self._last_used.clear()
        self._last_box = None

    def _expire(self, t_ns: int) -> None:
        """Give a target up that nothing was measured of for too long."""
        last = max(self._last_used.values(), default=t_ns)
        if self._filter.alive and t_ns - last > self._config.status.lost_after_s * NS_PER_S:
            self._forget()

    def _where(self, before: Estimate | None) -> Box | None:
        """The target's box: a detection that goes on from the last one, else where it must still be."""
        expected = self._last_box if before is not None else None
        found = choose(self.detections, expected)
        if expected is not None and (found is None or iou(found.box_px, expected) == 0.0):
            return expected
        return None if found is None else found.box_px

    def _measure(
        self, frame: StereoFrame, box: Box, before: Estimate | None
    ) -> tuple[list[Measurement], list[Rejected]]:
        """All that one frame says, each from the best idea of the target so far."""
        pair = Pair.of(frame.left, frame.right, self._rig)
        guess = None if before is None else Prior(before.x, self._range_sigma(before.x, before.cov))
        if guess is not None and guess.range_sigma_m > POOR * np.linalg.norm(guess.x[:3]):
            guess = None
        results = self._see(frame.t_ns, pair, box, guess)
        seen = [r for r in results if isinstance(r, Measurement)]
        x = seen[0].z if seen else guess.x if guess is not None else self._idea(box)
        results += self._measure_beam(frame, x)
        taken = [self._with_calibration(r) for r in results if isinstance(r, Measurement)]
        return taken, [r for r in results if isinstance(r, Rejected)]

    def _with_calibration(self, measurement: Measurement) -> Measurement:
        """What vision measures is no better than its calibration: it must not turn the laser away for that."""
        if measurement.kind not in VISION:
            return measurement
        cov = measurement.cov.copy()
        cov[:3, :3] += self._calibration.at(measurement.z[:3])
        return replace(measurement, cov=cov)

    def _see(self, t_ns: int, pair: Pair, box: Box, guess: Prior | None) -> list[Measurement | Rejected]:
        """Outline, then stereo where that says; each helps the other where it fails. The first to hold leads."""
        size = self._trace(t_ns, pair, box, guess)
        if isinstance(size, Measurement) and guess is None:
            guess = Prior(size.z, self._range_sigma(size.z, size.cov))
        stereo = self._stereo.measure(t_ns, pair, box, guess)
        if isinstance(stereo, Rejected) and not isinstance(size, Measurement) and guess is not None:
            stereo = self._stereo.measure(t_ns, pair, box, None)
        if self._outline is not None and isinstance(stereo, Measurement) and not isinstance(size, Measurement):
            size = self._outline.measure(t_ns, pair, stereo.z)
        return [stereo] if size is None else [size, stereo]

    def _trace(self, t_ns: int, pair: Pair, box: Box, guess: Prior | None) -> Measurement | Rejected | None:
        """The ball's outline from the prediction, else from its box; None for what has none or before it has a size."""
        if self._outline is None:
            return None
        if guess is not None:
            size = self._outline.measure(t_ns, pair, guess.x)
            if isinstance(size, Measurement):
                return size
        if len(self._target.shape_mean):
            return None
        return self._outline.measure(t_ns, pair, self._idea(box))

    def _measure_beam(self, frame: StereoFrame, x: Array) -> list[Measurement | Rejected]:
        """The spot, where the target as known so far would show it; with every frame alone, the reading near it too."""
        if self._beam is None or self._rig.laser is None:
            return []
        results: list[Measurement | Rejected] = []
        laser, config = self._rig.laser, self._config.beam
        length = float(self._target.beam_length(x, laser.origin_m[None], laser.direction[None])[0][0])
        if np.isfinite(length):
            seen: dict[Side, tuple[Array, Array]] = {}
            for side, image in (("left", frame.left), ("right", frame.right)):
                _, curve_px = self._beam.curve(side, max(0.8 * length, config.nearest_m), 1.25 * length)  # type: ignore[arg-type]
                focal_px = self._rig.focal_outside_px
                spot = find_spot(image, curve_px, config.spot_radius_m * focal_px / length)
                if spot is not None:
                    seen[side] = (spot.q_px, spot.cov_px2)  # type: ignore[index]
            results += [self._beam.spot(frame.t_ns, seen)] if seen else []
        if not self._filtered:
            results += self._reading_near(frame.t_ns)
        return results

    def _reading_near(self, t_ns: int) -> list[Measurement | Rejected]:
        """The nearest reading in time, less certain by what the target may have moved since."""
        near = min(self._readings, key=lambda reading: abs(reading.t_ns - t_ns), default=None)
        if near is None or self._beam is None:
            return []
        age_s = abs(near.t_ns - t_ns) / NS_PER_S
        if age_s > self._config.beam.reading_age_s:
            return []
        return [self._beam.reading(near, self._config.filter.initial_speed_m_s * age_s)]

    def _idea(self, box: Box) -> Array:
        """Where the target may be by its box alone: along its middle."""
        x, y, width, height = box
        middle = np.array([[x + width / 2, y + height / 2]])
        origins, directions = self._rig.rays(middle, "left")
        return np.concatenate([origins[0] + self._box_range(box) * directions[0], self._target.shape_mean])

    def _box_range(self, box: Box) -> float:
        """From a known ball's size in the image, else the last laser reading, else arm's length and some."""
        x, y, width, height = box
        if isinstance(self._target, Sphere) and self._target.diameter_m is not None:
            sides = self._rig.rays(np.array([[x, y + height / 2], [x + width, y + height / 2]]), "left")[1]
            angle = float(np.arccos(np.clip(sides[0] @ sides[1], -1, 1))) / 2
            return float(self._target.diameter_m / 2 / max(np.sin(angle), 0.05))
        if self._readings and self._rig.laser is not None:
            return max(self._rig.laser.length_m(self._readings[-1].range_m), 0.1)
        return 1.0

    def _start(self, t_ns: int, box: Box, measurements: Sequence[Measurement]) -> bool:
        """Begin a track: wide, where the first measurement that fixes a position has it."""
        first = next((m for m in measurements if m.kind in VISION), None)
        if first is None:
            return False
        x = np.concatenate([first.z[:3], first.z[3:] if len(first.z) > 3 else self._target.shape_mean])
        wide = np.diag(np.concatenate([np.full(3, (0.3 * np.linalg.norm(x[:3])) ** 2), self._target.shape_sigma**2]))
        self._filter.start(t_ns, x, wide, self._target.shape_walk)
        return True

    def _range_sigma(self, x: Array, cov: Array) -> float:
        _, gradient = self._target.range(x)
        return float(np.sqrt(gradient @ cov @ gradient))

    def _solution(self, t_ns: int, used: Sequence[Kind], rejected: Sequence[Rejected]) -> Solution:
        for kind in used:
            self._last_used[kind] = max(t_ns, self._last_used.get(kind, t_ns))
        turned_away = tuple(rejected)
        if not self._filter.alive or not self._last_used:
            self._filter.stop()
            return Solution(t_ns, Stage.SEARCHING, Status.LOST, used=tuple(used), rejected=turned_away)
        estimate = self._filter.at(t_ns)
        distance, gradient = self._target.range(estimate.x)
        cov = estimate.cov + self._systematic(estimate)
        quiet_s = (t_ns - max(self._last_used.values())) / NS_PER_S
        return Solution(
            t_ns=t_ns,
            stage=self._stage(t_ns),
            status=Status.VALID if quiet_s <= self._config.status.coast_after_s else Status.COASTING,
            position_m=estimate.x[:3],
            cov_m2=cov[:3, :3],
            range_m=distance,
            range_sigma_m=float(np.sqrt(gradient @ cov @ gradient)),
            velocity_m_s=estimate.velocity_m_s,
            used=tuple(used),
            rejected=turned_away,
        )

    def _recent(self, kinds: frozenset[Kind], t_ns: int) -> bool:
        limit = self._config.status.recent_s * NS_PER_S
        return any(t_ns - self._last_used[kind] <= limit for kind in kinds if kind in self._last_used)

    def _stage(self, t_ns: int) -> Stage:
        if self._recent(BEAM, t_ns):
            return Stage.BOTH if self._recent(VISION, t_ns) else Stage.LASER
        return Stage.BINOCULAR

    def _systematic(self, estimate: Estimate) -> Array:
        """Errors common to all frames, the calibration's above all: they bound how certain averaging may become."""
        status, distance = self._config.status, float(np.linalg.norm(estimate.x[:3]))
        sight = estimate.x[:3] / distance
        focal_px = self._rig.focal_outside_px
        bias_m = distance**2 * status.bias_px / (focal_px * self._rig.baseline_m)
        calibration = self._calibration.at(estimate.x[:3])
        along = bias_m**2 + float(sight @ calibration @ sight)
        if self._recent(BEAM, estimate.t_ns):  # two independent ways to the same distance
            along = 1 / (1 / along + 1 / (status.laser_bias_m**2 + self._beam_variance))
        across = np.eye(3) - np.outer(sight, sight)
        common = np.zeros((len(estimate.x), len(estimate.x)))
        common[:3, :3] = across @ calibration @ across + along * np.outer(sight, sight)
        return common
