"""Tracking between frames: misses, a second ball that crosses, false boxes, a target that is gone, the beam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from leadline.config import TrackConfig
from leadline.estimation import Estimate
from leadline.localizer import Localizer
from leadline.localizer.expected import expected
from leadline.recognition.track import Expected, Track, choose, hit, iou
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Detection, Kind, LaserRange, Sample, Solution, Status
from leadline.target import Plane, Sphere
from short_dives import samples
from track_scenes import Boxes, Spoilt, dive, empty_frames, frames, shifted, with_second_ball

BALL = Sphere(0.34)
HERE = Detection((100.0, 100.0, 40.0, 40.0), 0.5)
OTHER = Detection((200.0, 100.0, 40.0, 40.0), 0.9)
STEP_NS = NS_PER_S // 10


def at(x: float, score: float = 0.5) -> Detection:
    return Detection((x, 100.0, 40.0, 40.0), score)


# boxes alone


def test_goes_on_with_the_nearest_and_not_with_the_surest() -> None:
    track = Track(TrackConfig())
    assert track.follow(0, [HERE], None) == HERE.box_px
    assert track.follow(STEP_NS, [OTHER, at(110)], None) == at(110).box_px
    assert not track.held


def test_a_miss_is_held_and_another_target_is_not_taken_for_it() -> None:
    track = Track(TrackConfig(hold_s=0.5))
    track.follow(0, [HERE], None)
    for k in range(1, 6):
        assert track.follow(k * STEP_NS, [OTHER], None) == HERE.box_px
        assert track.held
    assert track.follow(6 * STEP_NS, [OTHER], None) == OTHER.box_px  # gone for longer: another choice
    assert not track.held


def test_what_is_gone_is_not_held_for_long_but_where_it_is_measured() -> None:
    track = Track(TrackConfig(hold_s=0.5))
    track.follow(0, [HERE], None)
    track.confirm(3 * STEP_NS)
    assert [track.follow(k * STEP_NS, [], None) is None for k in range(1, 11)] == [False] * 8 + [True] * 2


def test_the_prediction_comes_before_the_last_box() -> None:
    """A second one stands where the target was; the target is where the filter says."""
    track = Track(TrackConfig())
    track.follow(0, [HERE], None)
    there = Expected(at(160).box_px, 1.0)
    assert track.follow(STEP_NS, [at(100, 0.9), at(165, 0.3)], there) == at(165).box_px
    assert track.follow(2 * STEP_NS, [], there) == there.box  # held where it must be


def test_a_place_known_less_well_reaches_farther() -> None:
    for sigma_px, taken in ((1.0, False), (10.0, True)):
        track = Track(TrackConfig())
        track.follow(0, [HERE], None)
        box = track.follow(STEP_NS, [at(250)], Expected(at(200).box_px, sigma_px))
        assert (box == at(250).box_px) is taken


def test_a_target_expected_out_of_view_has_no_box() -> None:
    track = Track(TrackConfig())
    track.follow(0, [HERE], None)
    assert track.follow(STEP_NS, [OTHER], Expected((-0.5, 80.0, 0.0, 40.0), 1.0)) is None


def test_at_first_the_one_that_the_beam_hits() -> None:
    assert Track(TrackConfig()).follow(0, [OTHER, HERE], None, (120.0, 120.0)) == HERE.box_px
    assert Track(TrackConfig()).follow(0, [OTHER, HERE], None, (20.0, 20.0)) == OTHER.box_px
    assert hit([HERE, replace(HERE, score=0.8)], (139.0, 101.0)) == replace(HERE, score=0.8)
    assert hit([HERE], (141.0, 101.0)) is None
    assert hit([HERE], (float("nan"), 101.0)) is None


# the prediction


def estimate(x: Sequence[float], sigma_m: float = 0.001) -> Estimate:
    return Estimate(0, np.array(x, float), sigma_m**2 * np.eye(len(x)), np.zeros(3), np.eye(3), 0.0, 0.0)


def test_the_outline_is_the_true_box() -> None:
    """The simulator draws through the port: its box is the test."""
    finder = Spoilt(lambda k, boxes: boxes)
    for frame in (frames(dive())[0], frames(dive())[-1]):
        (true,) = finder.find(frame)
        found = expected(dive().rig, BALL, estimate(dive().truth_at(frame.t_ns).position_m))
        assert found is not None
        assert iou(found.box, true.box_px) > 0.97
        assert 0 < found.sigma_px < 5


def test_the_outline_is_cut_to_the_image() -> None:
    rig = dive().rig
    near = expected(rig, BALL, estimate((0.0, 0.0, 0.25)))
    assert near is not None
    assert near.box == (-0.5, -0.5, rig.left.width, rig.left.height)
    aside = expected(rig, BALL, estimate((0.55, 0.0, 0.6)))
    assert aside is not None
    assert aside.box[2] < aside.box[3] / 2
    gone = expected(rig, BALL, estimate((1.2, 0.0, 0.6)))
    assert gone is None or gone.box[2] == 0
    assert expected(rig, Plane(), estimate((0.0, 0.0, 1.0))) is None


# in the localizer


def without_laser() -> Rig:
    return replace(dive().rig, laser=None)


def steps(localizer: Localizer, inputs: Sequence[Sample]) -> list[Solution]:
    return [s for s in map(localizer.step, inputs) if s is not None]


def errors_m(solutions: Sequence[Solution]) -> list[float]:
    there = [(s.position_m, dive().truth_at(s.t_ns).position_m) for s in solutions if s.position_m is not None]
    return [float(np.linalg.norm(found - np.array(true))) for found, true in there]


def missed_at_random(seed: int) -> list[bool]:
    """One in five, but the first."""
    return [False, *(np.random.default_rng(seed).random(39) < 0.2).tolist()]


def misses(missed: Sequence[bool]) -> Boxes:
    return lambda k, boxes: [] if missed[k] else boxes


BURSTS = [k % 8 in (3, 4, 5, 6, 7) for k in range(40)]  # five in eight


@pytest.mark.parametrize("missed", [missed_at_random(1), missed_at_random(2), BURSTS], ids=["random", "more", "bursts"])
@pytest.mark.parametrize("target", [BALL, Sphere()], ids=["0.34 m", "unknown size"])
def test_missed_detections_lose_nothing(missed: list[bool], target: Sphere) -> None:
    solutions = steps(Localizer(without_laser(), target, Spoilt(misses(missed))), frames(dive()))
    assert all(s.status is Status.VALID and {Kind.STEREO, Kind.SIZE} & set(s.used) for s in solutions)
    assert max(errors_m(solutions)) < 0.01


@pytest.mark.parametrize("missed", [missed_at_random(3), BURSTS], ids=["random", "bursts"])
def test_no_jump_to_a_second_ball_that_crosses(missed: list[bool]) -> None:
    """It is in both pictures, as far away, scores higher, is never missed and passes half before the target."""
    inputs, boxes = frames(dive()), Spoilt(lambda k, found: found)
    true = [boxes.find(frame)[0].box_px for frame in inputs]
    aside = [(-2.0 + 3.5 * k / len(inputs), 0.5) for k in range(len(inputs))]

    def spoil(k: int, found: list[Detection]) -> list[Detection]:
        own = [] if missed[k] else [replace(d, score=0.4) for d in found]
        return own + ([Detection(shifted(true[k], aside[k]), 0.95)] if k >= 2 else [])

    crossed = [with_second_ball(frame, true[k], aside[k]) if k >= 2 else frame for k, frame in enumerate(inputs)]
    assert min(np.hypot(*one) for one in aside) < 0.6
    solutions = steps(Localizer(without_laser(), BALL, Spoilt(spoil)), crossed)
    assert all(s.status is Status.VALID for s in solutions)
    assert max(errors_m(solutions)) < 0.02


def test_false_boxes_of_higher_score_are_not_the_target() -> None:
    rng, missed = np.random.default_rng(5), missed_at_random(4)

    def spoil(k: int, found: list[Detection]) -> list[Detection]:
        x, y, side = rng.uniform((0, 0, 30), (500, 250, 200))
        return ([Detection((x, y, side, side), 0.99)] if k else []) + ([] if missed[k] else found)

    solutions = steps(Localizer(without_laser(), BALL, Spoilt(spoil)), frames(dive()))
    assert all(s.status is Status.VALID for s in solutions)
    assert max(errors_m(solutions)) < 0.01


@pytest.mark.parametrize("laser", [False, True])
def test_a_target_that_is_gone_is_not_invented(laser: bool) -> None:
    """Nothing there but water, and the beam, where there is one, goes on to what is behind."""
    half = len(frames(dive())) // 2
    end_ns = frames(dive())[half].t_ns
    later = [end_ns + k * STEP_NS for k in range(1, 40)]
    inputs: list[Sample] = [*frames(dive())[: half + 1], *empty_frames(later)]
    if laser:
        inputs += [s for s in samples(dive()) if isinstance(s, LaserRange) and s.t_ns <= end_ns]
        inputs += [LaserRange(t + 1, 3.0) for t in later[::3]]
        inputs.sort(key=lambda s: s.t_ns)
    localizer = Localizer(dive().rig if laser else without_laser(), BALL, Spoilt(lambda k, boxes: boxes))
    solutions = [s for s in steps(localizer, inputs) if s.t_ns > end_ns]
    quiet_s = [(s.t_ns - end_ns) / NS_PER_S for s in solutions]
    assert not any(s.used for s in solutions)
    assert all(s.status is not Status.VALID for s, t in zip(solutions, quiet_s, strict=True) if t > 1.1)
    assert all(s.status is Status.LOST for s, t in zip(solutions, quiet_s, strict=True) if t > 3.2)


def test_at_first_the_ball_that_the_beam_hits() -> None:
    """Of two equal balls, the one of the laser's last reading, though the other scores higher."""
    inputs, boxes = frames(dive())[:6], Spoilt(lambda k, found: found)
    true, aside = [boxes.find(frame)[0].box_px for frame in inputs], (1.4, 0.2)
    two = [with_second_ball(frame, box, aside) for frame, box in zip(inputs, true, strict=True)]

    def spoil(k: int, found: list[Detection]) -> list[Detection]:
        return [Detection(shifted(true[k], aside), 0.95), *found]

    first = next(s for s in samples(dive()) if isinstance(s, LaserRange))
    reading = replace(first, t_ns=two[0].t_ns - 1000, arrival_ns=None)
    with_beam = steps(Localizer(dive().rig, BALL, Spoilt(spoil)), [reading, *two])
    without = steps(Localizer(without_laser(), BALL, Spoilt(spoil)), two)
    assert max(errors_m(with_beam)) < 0.02
    assert min(errors_m(without)) > 0.1


def test_choice_without_anything_known_is_large_and_sure() -> None:
    small, large = Detection((0, 0, 10, 10), 0.9), Detection((50, 50, 40, 40), 0.5)
    assert choose([small, large]) is small  # a large box that is hardly sure is not the target ...
    assert choose([small, Detection(large.box_px, 0.6)]) is not small  # ... but a sure one is, before a small one
    assert choose([]) is None
