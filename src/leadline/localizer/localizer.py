"""The door: a sample goes in, a solution comes out. Live, simulated and replayed dives differ only before and after it.

    frame  -> box -> stereo on the target -> outline -> spot -+
    laser reading -------------------------------------------+-> one filter -> solution
    the vehicle's motion -------------------------------------+

The paper's three stages are which of these there are at the moment. No clock, no file, no network, no random number:
the time is in the sample, and the same samples give the same solutions bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leadline.config import Config
from leadline.estimation import Estimate, Filter, FilterSettings
from leadline.estimation.small import chi_square
from leadline.localizer.agreement import Agreement, Length
from leadline.localizer.blind import held
from leadline.localizer.expected import expected
from leadline.localizer.laser import LaserSight
from leadline.localizer.motion import as_of_target, skew_of, taken_ns
from leadline.localizer.sight import VISION, Counted, Sight
from leadline.localizer.witnesses import Witnesses
from leadline.recognition.finder import Finder
from leadline.recognition.track import Box, Track
from leadline.recognition.view import WholeView
from leadline.rig import Rig
from leadline.samples import (
    NS_PER_S,
    Array,
    Detection,
    Image,
    Kind,
    LaserRange,
    Measurement,
    Rejected,
    Sample,
    Solution,
    Stage,
    Status,
    StereoFrame,
    VehicleMotion,
)
from leadline.target import Surface, Target, is_known_ball, range_with_sigma

BEAM = frozenset({Kind.LASER, Kind.SPOT})
STRANGE, SURPRISE = 30.0, 9.0  # an innovation's square, in its variance: about the filter's gate; 3 sigma


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
        if isinstance(target, str):
            raise TypeError(
                f"target: a shape such as Sphere(0.34), or leadline.target.parse_target({target!r}), not text"
            )
        self._rig, self._target = rig, target or Surface()
        self._finder = detector or WholeView()
        self._config = config or Config()
        self._filtered = filtered
        self._filter = Filter(FilterSettings(**self._config.filter.model_dump()))
        self._laser = None if rig.laser is None else LaserSight(rig, self._target, self._config)
        self._sight = Sight(rig, self._target, self._config, self._laser)
        self._agreement = Agreement()
        self._witnesses = Witnesses(self._target, self._config.filter.laser_clock_sigma_s)
        self._strange: frozenset[Kind] = frozenset()  # kinds of the last frame that disagreed
        self._motion: VehicleMotion | None = None
        self._last_seen: Estimate | None = None
        self._counted = Counted()
        self._last_frame: StereoFrame | None = None
        self._newest_reading_ns, self._lag_ns = 0, 0  # how much later than readings the cameras' pictures come
        self._last_used: dict[Kind, int] = {}
        self._track = Track(self._config.track)
        self.detections: list[Detection] = []  # of the last frame, for those who draw

    def step(self, sample: Sample) -> Solution | None:
        """Take a sample; a solution at its time, or None: for a motion, for a reading that is none or has no target."""
        if isinstance(sample, LaserRange):
            return self._take_reading(sample) if 0 < sample.range_m < np.inf else None
        if isinstance(sample, VehicleMotion):
            if sample.is_finite:
                self._take_motion(sample)
            return None
        return self._take_frame(sample)

    def _take_frame(self, frame: StereoFrame) -> Solution:
        if not self._filtered:
            self._forget()
        self._expire(frame.t_ns)
        t_ns = taken_ns(frame)
        before = self._hold(self._estimate(t_ns))
        frame = self._fresh(frame)
        self._lag_ns = max(self._newest_reading_ns - frame.t_ns, 0)
        self.detections = self._finder.find(frame)
        size = self._rig.left.width, self._rig.left.height
        box = self._where(t_ns, before, [one for one in self.detections if one.is_in(*size)])
        if box is None and before is None:
            return self._solution(frame.t_ns, [], [])
        skew = skew_of(frame, self._target, before, self._motion, self._config.filter.initial_speed_m_s)
        found = self._sight.spot(frame, before, skew) if box is None else self._sight.measure(frame, box, before, skew)
        if self._laser is not None and not self._filtered:
            found += self._laser.near(t_ns)
        measurements = self._believable([one for one in found if isinstance(one, Measurement)], before)
        rejected = [one for one in found if isinstance(one, Rejected)]
        now_ns = self._witnesses.now_ns(t_ns)
        believed = before if now_ns == t_ns else self._estimate(now_ns)
        if not self._filter.alive and not self._start(t_ns, measurements):
            return self._solution(frame.t_ns, [], rejected)
        used, turned_away = self._add(t_ns, measurements, before)
        self._hear(t_ns, measurements, now_ns, believed)
        self._compare(measurements, used)
        self._look_back(before, [one for one in _positions(measurements) if one.kind in used], t_ns)
        return self._solution(frame.t_ns, used, rejected + turned_away)

    def _fresh(self, frame: StereoFrame) -> StereoFrame:
        """The frame, black where a camera gives its last picture again: pictures have noise, a live one never does."""
        last, self._last_frame = self._last_frame, frame
        if last is None or not self._filtered:
            return frame
        left, right = (
            np.zeros_like(image) if _same(image, before) else image
            for image, before in ((frame.left, last.left), (frame.right, last.right))
        )
        return frame if left is frame.left and right is frame.right else replace(frame, left=left, right=right)

    def _take_reading(self, sample: LaserRange) -> Solution | None:
        if self._laser is None:
            return None
        self._agreement.read(self._laser.length(sample), sample.arrival_ns)
        reading = replace(sample, t_ns=sample.t_ns + round(self._agreement.clock_s * NS_PER_S))
        self._laser.keep(reading)
        self._newest_reading_ns = reading.t_ns
        if not self._filtered:
            return None
        self._expire(sample.t_ns)
        before = self._hold(self._estimate(reading.t_ns))
        if before is None:
            return None
        unseen = self._laser.aside(before) if self._blind(reading.t_ns) else None
        measurement = self._laser.take(reading, unseen)
        now_ns = self._witnesses.now_ns(reading.t_ns)
        believed = before if now_ns == reading.t_ns else self._estimate(now_ns)
        used, rejected = self._filter.add(reading.t_ns, [measurement])
        self._hear(reading.t_ns, [measurement], now_ns, believed)
        return self._solution(sample.t_ns, used, rejected)

    def _hear(self, t_ns: int, found: Sequence[Measurement], now_ns: int, believed: Estimate | None) -> None:
        """What the measurements of a time say of the filter's estimate, as it is now that it had them."""
        self._witnesses.moved(t_ns, now_ns, believed, self._filter.at(now_ns))
        x = self._filter.at(t_ns)
        slack_m2 = self._laser.aside(x).variance_m2 if self._laser is not None and self._blind(t_ns) else 0.0
        seen_m2 = self._seen_m2(x) if any(one.kind is not Kind.LASER for one in found) else 0.0
        for one in found:
            said = self._witnesses.evidence(one, x, self._common_m2(one, x, seen_m2), slack_m2)
            if said is not None:
                self._witnesses.hear(said)

    def _seen_m2(self, x: Estimate) -> float:
        """The calibration's part of a distance's variance that is seen, along the sight."""
        sight = self._target.range(x.x)[1][:3]
        return float(sight @ self._sight.calibration.at(x.x[:3]) @ sight)

    def _common_m2(self, one: Measurement, x: Estimate, seen_m2: float) -> float:
        """The part of a measurement's variance, along the sight, that no averaging removes."""
        if one.kind is Kind.LASER:
            assert self._laser is not None
            return self._config.status.laser_bias_m**2 + self._laser.calibration_variance_m2
        distance, gradient = self._target.range(x.x)
        if one.kind is Kind.STEREO:
            return seen_m2 + self._matching_bias_m(distance, self._config.status.bias_px) ** 2
        return seen_m2 if one.common is None else seen_m2 + float(gradient @ one.common) ** 2

    def _matching_bias_m(self, distance_m: float, bias_px: float) -> float:
        return distance_m**2 * bias_px / (self._rig.focal_outside_px * self._rig.baseline_m)

    def _take_motion(self, sample: VehicleMotion) -> None:
        self._motion = sample
        if self._filtered:
            before = self._estimate(sample.t_ns)
            self._filter.add_motion(sample if before is None else as_of_target(sample, self._target, before.x))

    @property
    def notices(self) -> list[str]:
        """What a user should know of this dive: laser and cameras that do not agree, a clock that is off."""
        return list(self._agreement.notices.values())

    def _compare(self, found: Sequence[Measurement], used: Sequence[Kind]) -> None:
        """What the frame says of the beam's length: by its spot, else by the target where the beam meets it.

        The laser is not held against what was turned away.
        """
        if self._laser is None:
            return
        seen = {one.kind: one for one in found}
        lengths = [(kind, self._length_by(seen[kind])) for kind in (Kind.SPOT, Kind.STEREO, Kind.SIZE) if kind in seen]
        known = [(kind, length) for kind, length in lengths if length is not None]
        taken = [length for kind, length in known if kind in used]
        if taken:
            self._agreement.see(taken[0])
        if len(known) > 1 and known[0][0] is Kind.SPOT:
            self._agreement.check(known[0][1], known[1][1])

    def _length_by(self, seen: Measurement) -> Length | None:
        """The beam's length by what a frame shows."""
        assert self._laser is not None
        length = self._laser.length_by(seen, self._sight.calibration)
        if length is None or seen.kind is not Kind.STEREO:
            return length
        bias_m = self._matching_bias_m(length.length_m, self._config.status.bias_px)
        return replace(length, common_m2=length.common_m2 + bias_m**2)

    def _estimate(self, t_ns: int) -> Estimate | None:
        return self._filter.at(t_ns) if self._filter.alive else None

    def _hold(self, before: Estimate | None) -> Estimate | None:
        """The estimate, its sideways sigma bounded while nothing is seen."""
        if before is None or self._last_seen is None or not self._blind(before.t_ns):
            return before
        bound = held(before, self._last_seen, self._target, self._config.status)
        if bound is None:
            return before
        self._filter.add(before.t_ns, [bound])
        return self._filter.at(before.t_ns)

    def _add(
        self, t_ns: int, measurements: list[Measurement], before: Estimate | None
    ) -> tuple[list[Kind], list[Rejected]]:
        """To the filter, but for positions that it would refuse while all others speak for it or nothing is detected.

        It begins anew with refused positions that agree with each other: so does what stands where the target was.
        """
        strange = [] if before is None else [one for one in measurements if not self._agrees(one, before)]
        others = [one for one in measurements if all(one is not s for s in strange)]
        self._strange = frozenset(one.kind for one in strange)
        outvoted = bool(strange) and self._witnesses.blame(strange, others)
        away = _positions(strange) if outvoted or self._track.held else []
        why = "disagrees while all others agree" if outvoted else "disagrees and is not detected"
        used, rejected = self._filter.add(t_ns, [one for one in measurements if all(one is not a for a in away)])
        return used, rejected + [Rejected(one.kind, t_ns, why) for one in away]

    def _agrees(self, one: Measurement, before: Estimate) -> bool:
        """With what is believed; stricter than the filter's gate where there is a contradiction to settle."""
        expected = one.predict(before.x)
        if expected is None:
            return True
        off, H = one.z - expected[0], expected[1]
        return chi_square(off, one.cov + H @ before.cov @ H.T) < (SURPRISE if one.kind in self._strange else STRANGE)

    def _believable(self, measurements: list[Measurement], before: Estimate | None) -> list[Measurement]:
        """A spot on a target that is not seen itself tells a distance only."""
        if before is None or self._laser is None or not self._blind(before.t_ns) or _positions(measurements):
            return measurements
        unseen = self._laser.aside(before)
        return [self._laser.blindly(one, unseen) for one in measurements]

    def _look_back(self, before: Estimate | None, seen: Sequence[Measurement], t_ns: int) -> None:
        """Whether the target was seen where it was believed to be."""
        if seen:
            self._last_seen = self._filter.at(t_ns)
            self._counted.take(seen, self._sight.calibration.at(self._last_seen.x[:3]), before, self._last_seen)
            self._track.confirm(t_ns)

    def _blind(self, t_ns: int) -> bool:
        """Whether the target has not been seen for a while."""
        last = self._last_seen
        return last is not None and t_ns - last.t_ns > self._config.status.blind_after_s * NS_PER_S + self._lag_ns

    def _forget(self) -> None:
        self._filter.stop()
        self._last_used.clear()
        self._last_seen, self._counted = None, Counted()
        self._track.forget()
        self._strange = frozenset()
        self._witnesses.forget()

    def _expire(self, t_ns: int) -> None:
        """Give a target up that nothing was measured of for too long."""
        last = max(self._last_used.values(), default=t_ns)
        if self._filter.alive and t_ns - last > self._config.status.lost_after_s * NS_PER_S:
            self._forget()

    def _where(self, t_ns: int, before: Estimate | None, found: Sequence[Detection]) -> Box | None:
        """The target's box: a detection that goes on from where it was, else where it must still be."""
        outline = None
        if before is None:
            self._track.forget()
        else:
            outline = expected(self._rig, self._target, before)
        hit_px = self._sight.beam_px() if len(found) > 1 else None  # for whoever has to choose between detections
        return self._track.follow(t_ns, found, outline, hit_px)

    def _start(self, t_ns: int, measurements: Sequence[Measurement]) -> bool:
        """Begin a track: wide, where the first measurement that fixes a position has it."""
        first = next((m for m in measurements if m.kind in VISION), None)
        if first is None:
            return False
        x = np.concatenate([first.z[:3], first.z[3:] if len(first.z) > 3 else self._target.shape_mean])
        wide = np.diag(np.concatenate([np.full(3, (0.3 * np.linalg.norm(x[:3])) ** 2), self._target.shape_sigma**2]))
        self._filter.start(t_ns, x, wide, self._target.shape_walk)
        return True

    def _solution(self, t_ns: int, used: Sequence[Kind], rejected: Sequence[Rejected]) -> Solution:
        for kind in used:
            self._last_used[kind] = max(t_ns, self._last_used.get(kind, t_ns))
        turned_away = tuple(rejected)
        if not self._filter.alive or not self._last_used:
            self._filter.stop()
            self._witnesses.forget()
            return Solution(t_ns, Stage.SEARCHING, Status.LOST, used=tuple(used), rejected=turned_away)
        estimate = self._filter.at(t_ns)
        cov = self._counted.without(estimate) + self._systematic(estimate)
        distance, sigma_m = range_with_sigma(self._target, estimate.x, cov)
        status, quiet_s = self._config.status, (t_ns - max(self._last_used.values())) / NS_PER_S
        waiting = self._unconfirmed_s is not None and self._unconfirmed_s < status.alone_s
        return Solution(
            t_ns=t_ns,
            stage=self._stage(t_ns),
            status=Status.COASTING if waiting or quiet_s > status.coast_after_s else Status.VALID,
            position_m=estimate.x[:3],
            cov_m2=cov[:3, :3],
            range_m=distance,
            range_sigma_m=sigma_m,
            velocity_m_s=estimate.velocity_m_s if self._filtered else None,
            used=tuple(used),
            rejected=turned_away,
        )

    @property
    def _unconfirmed_s(self) -> float | None:
        """How long a second witness, which there may be, has been waited for; None where there is one or none to be."""
        others = self._laser is not None or is_known_ball(self._target)
        return self._witnesses.alone_s if self._filtered and others else None

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
        calibration = self._sight.calibration.at(estimate.x[:3])
        bias_px = status.bias_px if self._unconfirmed_s is None else status.alone_px
        along = self._matching_bias_m(distance, bias_px) ** 2 + float(sight @ calibration @ sight)
        if self._laser is not None and self._recent(BEAM, estimate.t_ns):  # two independent ways to the same distance
            along = 1 / (1 / along + 1 / (status.laser_bias_m**2 + self._laser.calibration_variance_m2))
            if self._blind(estimate.t_ns):
                along += self._laser.aside(estimate).variance_m2
        along += max(self._agreement.variance_m2, self._witnesses.variance_m2(estimate.t_ns))
        across = np.eye(3) - np.outer(sight, sight)
        common = np.zeros((len(estimate.x), len(estimate.x)))
        common[:3, :3] = across @ calibration @ across + along * np.outer(sight, sight)
        return common


def _positions(measurements: Sequence[Measurement]) -> list[Measurement]:
    return [one for one in measurements if one.kind in VISION]


def _same(image: Image, last: Image) -> bool:
    return image.shape == last.shape and np.array_equal(image[::64], last[::64])  # whole rows: they lie together
