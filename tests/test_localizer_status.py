"""Stage and status: what a run says of itself when detections, pictures or readings stop, and how it finds back."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from leadline.config import Config
from leadline.localizer import Localizer
from leadline.samples import (
    NS_PER_S,
    Detection,
    Kind,
    LaserRange,
    Sample,
    Solution,
    Stage,
    Status,
    StereoFrame,
    VehicleMotion,
)
from leadline.target import Sphere
from short_dives import TrueBoxes, cut, samples

DIVE = cut("demo", 0.9, 0.4, 2.5, 0.1)  # 13 frames in 5 s
BALL = Sphere(0.34)
STOP_S = 1.5
STATUS = Config().status


class UpTo:
    """True boxes until a time, then none at all."""

    def __init__(self, end_s: float) -> None:
        self._end_s, self._boxes = end_s, TrueBoxes(DIVE)

    def find(self, frame: StereoFrame) -> list[Detection]:
        return self._boxes.find(frame) if frame.t_s < self._end_s else []


def frames() -> list[StereoFrame]:
    return [sample for sample in samples(DIVE) if isinstance(sample, StereoFrame)]


def darkened(sample: StereoFrame) -> StereoFrame:
    return dataclasses.replace(sample, left=np.zeros_like(sample.left), right=np.zeros_like(sample.right))


def steps(localizer: Localizer, inputs: list[Sample]) -> list[Solution]:
    return [s for s in map(localizer.step, inputs) if s is not None]


def test_without_a_target_every_frame_is_lost_and_a_reading_is_nothing() -> None:
    localizer = Localizer(DIVE.rig, BALL, UpTo(0.0))
    for sample in samples(DIVE):
        solution = localizer.step(sample)
        if isinstance(sample, LaserRange):
            assert solution is None
            continue
        assert solution is not None
        assert (solution.t_ns, solution.stage, solution.status) == (sample.t_ns, Stage.SEARCHING, Status.LOST)
        numbers = ("position_m", "cov_m2", "range_m", "range_sigma_m", "velocity_m_s")
        assert all(getattr(solution, name) is None for name in numbers)
        assert not solution.used


def test_a_reading_before_the_first_target_gives_nothing() -> None:
    localizer = Localizer(DIVE.rig, BALL, TrueBoxes(DIVE))
    assert localizer.step(LaserRange(0, 1.5)) is None
    first = localizer.step(dataclasses.replace(frames()[0], t_ns=100_000_000))
    assert first is not None
    assert first.status is Status.VALID


def test_the_stage_is_what_there_is() -> None:
    """Frames alone, but for their spots: without a laser on the rig there is only stage 1."""
    localizer = Localizer(dataclasses.replace(DIVE.rig, laser=None), BALL, TrueBoxes(DIVE))
    solutions = steps(localizer, list(samples(DIVE))[:8])
    assert {solution.stage for solution in solutions} == {Stage.BINOCULAR}
    assert {kind for solution in solutions for kind in solution.used} == {Kind.STEREO, Kind.SIZE}


def test_detections_stop_and_it_goes_on_where_the_target_must_be() -> None:
    late = [s for s in steps(Localizer(DIVE.rig, BALL, UpTo(STOP_S)), list(samples(DIVE))) if s.t_s > STOP_S]
    pictures = [s for s in late if s.t_ns in {f.t_ns for f in frames()}]
    assert all(Kind.STEREO in s.used or Kind.SIZE in s.used for s in pictures)
    assert all(s.status is Status.VALID and s.stage is Stage.BOTH for s in late)
    for s in pictures:
        assert s.range_m == pytest.approx(DIVE.truth_at(s.t_ns).range_m, abs=0.010)


@pytest.mark.parametrize("far", [1e-3, 1e3, 1e9, np.nan, np.inf])
@pytest.mark.parametrize("since_s", [0.0, STOP_S])
def test_boxes_that_are_none_are_as_if_there_were_none(since_s: float, far: float) -> None:
    class Mad:
        """True boxes until a time, then of any size, also below nothing, and anywhere."""

        def __init__(self) -> None:
            self._boxes, self._rng = TrueBoxes(DIVE), np.random.default_rng(0)

        def find(self, frame: StereoFrame) -> list[Detection]:
            if frame.t_s < since_s:
                return self._boxes.find(frame)
            x, y, width, height = (float(v) for v in 700 + far * self._rng.uniform(-3, 3, 4))
            negative = [(x, y, -width, height), (x, y, width, -height), (x, y, -width, -height)]
            return [Detection(box, 0.9) for box in negative]

    solutions = [steps(Localizer(DIVE.rig, BALL, finder), samples(DIVE)) for finder in (UpTo(since_s), Mad())]
    assert [one.range_m for one in solutions[0]] == [one.range_m for one in solutions[1]]


def test_samples_that_are_no_numbers_are_as_if_there_were_none() -> None:
    spoilt: list[Sample] = []
    for one in samples(DIVE):
        spoilt.append(one)
        spoilt += [LaserRange(one.t_ns, range_m) for range_m in (np.nan, np.inf, 0.0, -1.0)]
        spoilt.append(VehicleMotion(one.t_ns, velocity_m_s=(0.0, np.nan, 0.0), rotation_rad_s=(np.inf, 0.0, 0.0)))
    dives = [steps(Localizer(DIVE.rig, BALL, TrueBoxes(DIVE)), inputs) for inputs in (samples(DIVE), spoilt)]
    assert [one.range_m for one in dives[0]] == [one.range_m for one in dives[1]]


def test_everything_stops_coasting_then_lost_within_the_configured_times() -> None:
    inputs: list[Sample] = [darkened(f) if f.t_s > STOP_S else f for f in frames()]
    solutions = steps(Localizer(DIVE.rig, BALL, TrueBoxes(DIVE)), inputs)
    last_s = max(s.t_s for s in solutions if s.used)
    assert last_s <= STOP_S
    for s in solutions:
        quiet_s = s.t_s - last_s
        expected = Status.VALID if quiet_s <= STATUS.coast_after_s else Status.COASTING
        assert s.status is (Status.LOST if quiet_s > STATUS.lost_after_s else expected)
        assert (s.range_m is None) == (s.status is Status.LOST)
    assert {s.status for s in solutions} == set(Status)
    sigmas = [s.range_sigma_m for s in solutions if s.t_s >= last_s and s.range_sigma_m is not None]
    assert np.all(np.diff(sigmas) > 0)


def test_the_laser_alone_goes_on_and_owns_what_it_does_not_know() -> None:
    """Stage 3: pictures turn black, readings go on. A beam says nothing of where on the ball it is: the sideways
    covariance grows, and with it, on a ball, that of the range."""
    inputs = [darkened(s) if isinstance(s, StereoFrame) and s.t_s > STOP_S else s for s in samples(DIVE)]
    solutions = steps(Localizer(DIVE.rig, BALL, TrueBoxes(DIVE)), inputs)
    seen = [s for s in solutions if Kind.STEREO in s.used]
    alone = [s for s in solutions if s.t_s > seen[-1].t_s + STATUS.recent_s + 0.1 and s.range_m is not None]
    assert len(alone) >= 8
    assert sum(Kind.LASER in s.used for s in alone) >= 4
    assert {(s.stage, s.status) for s in alone} == {(Stage.LASER, Status.VALID)}
    sideways = [float(np.sqrt(np.trace(s.cov_m2[:2, :2]))) for s in (seen[-1], *alone) if s.cov_m2 is not None]
    assert min(sideways[1:]) > 10 * sideways[0]
    for s in alone:
        assert abs(s.range_m - DIVE.truth_at(s.t_ns).range_m) < 3 * s.range_sigma_m  # type: ignore[operator]
        if s.t_s < seen[-1].t_s + 2.0:
            assert s.range_m == pytest.approx(DIVE.truth_at(s.t_ns).range_m, abs=0.03)


@pytest.mark.parametrize("far_first", [True, False])
def test_finds_back_after_a_jump_of_the_target(far_first: bool) -> None:
    """The ball is suddenly at another place and stays there: turned away at first and told, then believed.

    Refused positions are believed once they have agreed for 0.3 s (four frames); at the jump itself an edge inside the
    ball, now so much larger, may be taken for its outline: that frame is lost.
    """
    far, near = frames()[:5], frames()[-5:]
    before, after = (far, near) if far_first else (near, far)
    step_ns = NS_PER_S // 10
    inputs = [dataclasses.replace(f, t_ns=i * step_ns) for i, f in enumerate([*before, *after])]
    solutions = steps(Localizer(DIVE.rig, BALL, TrueBoxes(DIVE)), list(inputs))
    at_jump, at_end = solutions[len(before)], solutions[-1]
    assert at_jump.rejected
    assert at_end.range_m == pytest.approx(DIVE.truth_at(after[-1].t_ns).range_m, abs=0.02)


def test_every_frame_alone_remembers_nothing() -> None:
    """The order of frames does not matter without the filter."""
    make: Callable[[], Localizer] = lambda: Localizer(DIVE.rig, BALL, TrueBoxes(DIVE), filtered=False)  # noqa: E731
    three = frames()[2:5]
    forward, backward = steps(make(), list(three)), steps(make(), list(reversed(three)))
    assert [s.range_m for s in forward] == [s.range_m for s in reversed(backward)]
    assert all(s.range_m is not None and s.velocity_m_s is None for s in forward)  # a frame has no velocity
