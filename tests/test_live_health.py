"""Each fault is seen in time, is over in time, and is not seen where there is none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from leadline.health import Health, Part, State
from leadline.health.lateness import Lateness
from leadline.samples import (
    NS_PER_S,
    Array,
    Detection,
    Image,
    Kind,
    LaserRange,
    Rejected,
    Sample,
    Solution,
    Stage,
    StereoFrame,
)
from leadline.samples import Status as SolutionStatus
from leadline.simulation.faults import Fault, Mode, Sensor, inject

CAMERA_HZ, LASER_HZ = 10.0, 3.0
START_S, LASTS_S, AFTER_S = 25.0, 6.0, 4.0
DUE_S = {"camera": 1.0, "left": 1.0, "right": 1.0, "laser": 7 / LASER_HZ}  # 1 s or 7 periods, whichever is longer
OVER_S = 2.0

_RNG = np.random.default_rng(5)
_SCENE = cv2.resize(_RNG.integers(40, 180, (12, 40), np.uint8), (400, 48), interpolation=cv2.INTER_CUBIC)
_NOISE = _RNG.normal(0, 2, (50, 48, 64)).astype(np.float32)


def picture(shift_px: int, rng: np.random.Generator) -> Image:
    """Noise never repeats itself: one of 50 fields, pushed aside by one of 64 steps."""
    seen = _SCENE[:, 100 + shift_px : 164 + shift_px].astype(np.float32)
    return np.clip(seen + np.roll(_NOISE[rng.integers(50)], rng.integers(64), axis=1), 0, 255).astype(np.uint8)


def dive(duration_s: float, seed: int, dropouts: float = 0.02, steady: bool = False) -> Iterator[Sample]:
    """A vehicle that sways before a scene; a laser with 3 mm of noise, 1 mm of resolution and lost readings."""
    rng = np.random.default_rng(seed)
    times = [(i / CAMERA_HZ, "camera") for i in range(int(duration_s * CAMERA_HZ))]
    times += [(0.1 + i / LASER_HZ, "laser") for i in range(int(duration_s * LASER_HZ))]
    late = {"camera": 0.08, "laser": 0.03}
    coming = sorted(
        (t + late[kind] + rng.exponential(0.01 if kind == "camera" else 1e-3), t, kind) for t, kind in times
    )
    for arrival_s, t, kind in coming:
        arrival_ns, t_ns = round(arrival_s * NS_PER_S), round(t * NS_PER_S)
        if kind == "camera":
            shift = 0 if steady else round(20 * np.sin(t))
            yield StereoFrame(t_ns, picture(shift, rng), picture(shift + 9, rng), arrival_ns)
        elif rng.random() > dropouts:
            way_m = 2.0 if steady else 2.0 + 0.5 * np.sin(0.3 * t)
            yield LaserRange(t_ns, round(way_m + rng.normal(0, 0.003), 3), 0.8, arrival_ns)


@dataclass
class Seen:
    flagged_s: float | None  # after the fault's start
    over_s: float | None  # after its end
    states: set[State]
    early: list[str]  # what was flagged before


def watch(sensor: Sensor, mode: Mode, seed: int) -> Seen:
    start_s = START_S + 0.137 * seed % 1.0
    fault = Fault(sensor=sensor, mode=mode, start_s=start_s, end_s=start_s + LASTS_S)
    part = Part.LEFT if sensor == "camera" else Part(sensor)
    health = Health()
    for sample in inject(dive(start_s + LASTS_S + AFTER_S, seed), [fault], np.random.default_rng(seed)):
        health.sample(sample)
    mine = [event for event in health.events if event.part is part]
    bad = [e for e in mine if not e.ok]
    ends = [e.since_ns / NS_PER_S for e in mine if e.ok]
    over = ends[-1] - start_s - LASTS_S if ends and health.state(part) is State.OK else None
    flagged = bad[0].since_ns / NS_PER_S - start_s if bad else None
    return Seen(
        flagged, over, {e.state for e in bad}, [str(e) for e in health.events if e.since_ns / NS_PER_S < start_s]
    )


CASES: list[tuple[Sensor, Mode]] = [
    *[(side, mode) for side in ("left", "right") for mode in ("off", "stuck", "garbage")],
    *[("camera", mode) for mode in ("off", "stuck", "garbage", "slow", "delayed", "intermittent")],
    *[("laser", mode) for mode in ("off", "stuck", "garbage", "slow", "delayed", "intermittent")],
]


@pytest.mark.parametrize(("sensor", "mode"), CASES)
def test_a_fault_is_seen_and_is_over_in_time(sensor: Sensor, mode: Mode) -> None:
    """Of six random dives with 2 % of the readings lost anyway. A laser that loses half of them at random cannot be
    told from that within 7 readings: it has 6 s."""
    seen = [watch(sensor, mode, seed) for seed in range(6)]
    assert not [one.early for one in seen if one.early]
    due_s = LASTS_S if (sensor, mode) == ("laser", "intermittent") else DUE_S[sensor]
    in_time = [one for one in seen if one.flagged_s is not None and one.flagged_s <= due_s + 0.1]
    over = [one for one in seen if one.over_s is not None and one.over_s <= OVER_S + 0.1]
    assert len(in_time) >= 5 - (mode == "garbage"), [one.flagged_s for one in seen]
    assert len(over) >= 5 - (sensor == "laser"), [one.over_s for one in seen]
    assert State(mode) in set.union(*(one.states for one in seen))


@pytest.mark.parametrize("steady", [False, True])
def test_clean_data_raises_no_flag(steady: bool) -> None:
    """Three minutes here, six hours in the long suite; allowed is one an hour."""
    assert flags(180, seed=1, steady=steady) == []


@pytest.mark.long
@pytest.mark.parametrize("steady", [False, True])
def test_clean_hours(steady: bool) -> None:
    assert len(flags(6 * 3600, seed=2, steady=steady)) <= 6


def flags(duration_s: float, seed: int, *, steady: bool) -> list[str]:
    health = Health()
    for sample in dive(duration_s, seed, steady=steady):
        health.sample(sample)
    return [str(event) for event in health.events if not event.ok]


def test_a_steady_laser_that_rounds_is_not_stuck() -> None:
    health = Health()
    for sample in dive(60.0, 3, steady=True):
        health.sample(
            LaserRange(sample.t_ns, 2.0, 0.8, sample.arrival_ns) if isinstance(sample, LaserRange) else sample
        )
    assert health.state(Part.LASER) is State.OK


# -- work ----------------------------------------------------------------------------------------------------------


def worked(part: Part, answers: list[tuple[float, tuple[State, str] | None]], lag_s: float = 0.0) -> Health:
    """Twenty good answers of 20 ms at 10 Hz, then these."""
    health = Health()
    for i, (took_s, fault) in enumerate([(0.02, None)] * 20 + answers):
        now_ns = i * NS_PER_S // 10
        health.asked(part, now_ns)
        health.done(part, now_ns + 20_000_000, took_s, fault, lag_s if i >= 20 else 0.0)
    return health


BROKEN = (State.OFF, "no space left")


@pytest.mark.parametrize("part", [Part.DETECTOR, Part.DISK, Part.OUTPUT])
def test_work_that_goes_wrong(part: Part) -> None:
    assert worked(part, [(0.02, None)] * 10).state(part) is State.OK
    assert worked(part, [(0.02, BROKEN)] * 2).state(part) is State.OFF
    assert worked(part, [(0.3, None)] * 3).state(part) is State.SLOW
    assert worked(part, [(0.02, None)] * 3, lag_s=0.5).state(part) is State.DELAYED
    assert worked(part, [(0.02, BROKEN), (0.02, None)] * 3).state(part) is State.INTERMITTENT
    assert worked(part, [(0.02, (State.GARBAGE, "not what was written"))] * 2).state(part) is State.GARBAGE
    assert worked(part, [(0.02, BROKEN)] * 5 + [(0.02, None)] * 12).state(part) is State.OK


def test_work_that_never_ends() -> None:
    health = worked(Part.DISK, [])
    health.asked(Part.DISK, 2 * NS_PER_S)
    health.tick(3 * NS_PER_S)
    assert health.state(Part.DISK) is State.STUCK


def test_of_several_that_share_a_part_each_is_judged_for_itself() -> None:
    """A full disk that still takes the rows of a table: one flag while it lasts, over when the recording is well."""
    health = Health()
    for i in range(100):
        now_ns, full = i * NS_PER_S // 10, 20 <= i < 60
        health.done(Part.DISK, now_ns, 0.02, BROKEN if full else None, who="dive.mcap")
        health.done(Part.DISK, now_ns, 0.001, None, who="solutions.csv")
        if i in (25, 59):
            assert health.state(Part.DISK) is State.OFF
    assert [event.state for event in health.events if event.since_ns < 6 * NS_PER_S] == [State.OFF]
    assert health.state(Part.DISK) is State.OK


def test_one_that_is_stuck_is_not_hidden_by_another() -> None:
    health = Health()
    for i in range(20):
        now_ns = i * NS_PER_S // 10
        health.asked(Part.OUTPUT, 0, now_ns, who="MAVLink")
        health.done(Part.OUTPUT, now_ns, 0.001, who="the live page")
        assert (health.state(Part.OUTPUT) is State.STUCK) == (i > 7)
    health.left(Part.OUTPUT, "MAVLink")
    for i in range(20, 30):
        health.done(Part.OUTPUT, i * NS_PER_S // 10, 0.001, who="the live page")
    assert health.state(Part.OUTPUT) is State.OK


def boxes(moves: list[tuple[float, float] | None], expected: tuple[float, float] | None) -> State:
    health = Health()
    rng = np.random.default_rng(0)
    for i, place in enumerate([(30.0, 20.0)] * 10 + moves):
        found = [] if place is None else [Detection((place[0] - 5 + 0.01 * i, place[1] - 5, 10, 10), 0.9)]
        if i >= 10 and len(moves) > 1 and moves[0] == moves[-1] and place is not None and expected is None:
            found = [Detection((place[0], place[1], 10, 10), 0.9)]
        frame = StereoFrame(i * NS_PER_S // 10, picture(0, rng), picture(9, rng))
        health.found(frame, found, frame.t_ns, 0.02, expected)
    return health.state(Part.DETECTOR)


def test_the_detector() -> None:
    assert boxes([(30.0, 20.0 + 0.1 * i) for i in range(5)], (30.0, 20.0)) is State.OK
    assert boxes([None] * 3, (30.0, 20.0)) is State.OFF
    assert boxes([None] * 3, None) is State.OK  # nothing must be in view
    assert boxes([(30.0, 20.0)] * 5, None) is State.STUCK
    assert boxes([(900.0, 20.0), (700.0, 800.0)], None) is State.GARBAGE
    assert boxes([(55.0, 40.0), (54.0, 41.0)], (30.0, 20.0)) is State.WRONG


@pytest.mark.parametrize("late_s", [0.0, 0.6])
def test_a_detector_that_answers_of_older_pictures(late_s: float) -> None:
    """Told within a second, where the target moves by some pixels meanwhile."""
    rng, lateness, told_s = np.random.default_rng(3), Lateness(), []

    def place_px(t_s: float) -> Array:
        return np.array([160 + 20 * np.sin(t_s), 90 + 5 * np.cos(0.7 * t_s)])

    for i in range(120):
        t_s = i / 10
        seen_s = t_s - (late_s if t_s >= 6.0 else 0.0)
        middle_px = place_px(seen_s) + rng.normal(0, 0.5, 2)
        verdict = lateness.judge(round(t_s * NS_PER_S), middle_px, 40.0, place_px(t_s))
        if verdict is not None:
            assert verdict[0] is State.DELAYED
            told_s.append(t_s)
    assert bool(told_s) == (late_s > 0)
    assert all(6.0 < t_s < 7.0 for t_s in told_s[:1])


# -- clock ---------------------------------------------------------------------------------------------------------


def clocked(bend: Callable[[int, float, np.random.Generator], float], *, wall: bool) -> list[State]:
    """States of the clock while stamps are bent from 20 s on: the computer's clock (``wall``), or all sensors'."""
    health = Health()
    rng = np.random.default_rng(0)
    for sample in dive(24.0, 4):
        now_ns = sample.arrival_ns or 0
        late_s = now_ns / NS_PER_S - 20.0
        if wall:
            health.wall_clock(round(now_ns if late_s < 0 else bend(now_ns, late_s, rng)), now_ns)
        elif late_s >= 0:
            sample = replace(sample, t_ns=round(bend(sample.t_ns, late_s, rng)))  # noqa: PLW2901
        health.sample(sample)
    assert not [e for e in health.events if e.since_ns < 20 * NS_PER_S and not e.ok]
    return [e.state for e in health.events if e.part is Part.CLOCK and e.since_ns <= 22.4 * NS_PER_S]


BENT = {
    State.STUCK: lambda t, s, rng: t - s * NS_PER_S,
    State.GARBAGE: lambda t, s, rng: t + rng.normal(0, 30) * NS_PER_S,
    State.WRONG: lambda t, s, rng: t + 2 * NS_PER_S,
    State.SLOW: lambda t, s, rng: t - 0.3 * s * NS_PER_S,
}


@pytest.mark.parametrize("wall", [True, False])
@pytest.mark.parametrize("state", [State.GARBAGE, State.WRONG, State.SLOW])
def test_the_clock(state: State, wall: bool) -> None:
    assert set(clocked(BENT[state], wall=wall)) & ({state} if state is not State.SLOW else {State.SLOW, State.WRONG})


def test_a_late_camera_is_not_a_wrong_clock() -> None:
    fault = Fault(sensor="camera", mode="delayed", start_s=20.0, end_s=30.0, size=0.6)
    health = Health()
    for sample in inject(dive(29.0, 1), [fault], np.random.default_rng(0)):
        health.sample(sample)
    assert health.state(Part.LEFT) is State.DELAYED
    assert health.state(Part.CLOCK) is State.OK


# -- contradictions and words --------------------------------------------------------------------------------------


def solution(t_s: float, used: tuple[Kind, ...], rejected: tuple[Kind, ...]) -> Solution:
    t_ns = round(t_s * NS_PER_S)
    turned = tuple(Rejected(kind, t_ns, "gate", 50.0) for kind in rejected)
    return Solution(t_ns, Stage.BOTH, SolutionStatus.VALID, used=used, rejected=turned)


def test_a_laser_that_the_cameras_contradict_is_wrong() -> None:
    health = Health([Part.LEFT, Part.RIGHT, Part.LASER])
    for sample in dive(12.0, 0):
        health.sample(sample)
        bad = sample.t_s > 8.0
        if isinstance(sample, LaserRange):
            health.solved(solution(sample.t_s, () if bad else (Kind.LASER,), (Kind.LASER,) if bad else ()), 0)
        else:
            health.solved(solution(sample.t_s, (Kind.STEREO,), ()), 0)
    assert health.state(Part.LASER) is State.WRONG
    assert health.state(Part.LEFT) is State.OK


def test_images_that_stop_fitting_are_wrong_and_either_may_be() -> None:
    health = Health([Part.LEFT, Part.RIGHT])
    states = []
    for i in range(60):
        bad = 20 <= i < 40
        used = (Kind.SPOT,) if bad else (Kind.SPOT, Kind.STEREO)
        seen = solution(i / 10, used, (Kind.STEREO,) if bad else ())
        health.sample(StereoFrame(seen.t_ns, picture(i % 20, _RNG), picture(9 + i % 20, _RNG)))
        health.solved(replace(seen, range_m=1.5), seen.t_ns)
        states.append((health.state(Part.LEFT), health.state(Part.RIGHT)))
    assert states[19] == (State.OK, State.OK)
    assert states[25] == (State.WRONG, State.WRONG)
    assert states[59] == (State.OK, State.OK)


@pytest.mark.parametrize("doubted", [True, False])
def test_of_a_ball_its_outlines_tell_which_camera_is_wrong(doubted: bool) -> None:
    """A texture that is lost for seconds is no fault; a camera that does not show the ball where the other does, is."""
    health = Health([Part.LEFT, Part.RIGHT])
    states = []
    for i in range(60):
        bad = 20 <= i < 40
        seen = solution(i / 10, (Kind.SIZE,) if bad else (Kind.SIZE, Kind.STEREO), (Kind.STEREO,) if bad else ())
        if bad and doubted:
            seen = replace(seen, rejected=(*seen.rejected, Rejected(Kind.SIZE, seen.t_ns, "not there", camera="right")))
        health.sample(StereoFrame(seen.t_ns, picture(i % 20, _RNG), picture(9 + i % 20, _RNG)))
        health.solved(replace(seen, range_m=1.5), seen.t_ns)
        states.append((health.state(Part.LEFT), health.state(Part.RIGHT)))
    assert states[19] == states[59] == (State.OK, State.OK)
    assert states[25] == (State.OK, State.WRONG if doubted else State.OK)


def test_a_beam_beside_the_target_is_no_contradiction() -> None:
    health = Health([Part.LEFT, Part.RIGHT, Part.LASER])
    for sample in dive(12.0, 0):
        health.sample(sample)
        if isinstance(sample, LaserRange):
            beside = Rejected(Kind.LASER, sample.t_ns, "is beside the target, or grazes it")
            health.solved(replace(solution(sample.t_s, (), ()), rejected=(beside,)), 0)
        else:
            health.solved(solution(sample.t_s, (Kind.STEREO,), ()), 0)
    assert health.state(Part.LASER) is State.OK


def test_what_is_reported_stands_until_it_is_taken_back() -> None:
    health = Health([Part.DISK])
    health.reported(Part.DISK, State.OFF, "no space left on the device", NS_PER_S)
    (condition,) = [c for c in health.conditions if c.part is Part.DISK]
    assert (condition.state, condition.since_ns) == (State.OFF, NS_PER_S)
    assert "no space left" in str(condition)
    assert "disk" in condition.advice
    for i in range(20):
        health.reported(Part.DISK, State.OK, "", NS_PER_S + i * NS_PER_S // 10)
    assert health.ok
    assert health.summary()["flags"] == {"disk": {"off": 1}}


def test_every_state_of_every_part_says_what_to_do() -> None:
    from leadline.health.states import advice  # noqa: PLC0415

    for part in Part:
        for state in State:
            assert bool(advice(part, state)) == (state is not State.OK)


def test_a_sensor_that_never_comes_is_off() -> None:
    health = Health([Part.LASER])
    for i in range(60):
        health.tick(10 * NS_PER_S + i * NS_PER_S // 10)
    assert health.state(Part.LASER) is State.OFF
