"""Each fault mode does what it says, within its window and to its sensor alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from pydantic import ValidationError

from leadline.samples import NS_PER_S, LaserRange, Sample, StereoFrame
from leadline.simulation.faults import Fault, Mode, Sensor, inject

START, END = 2.0, 4.0


def stream() -> Iterator[Sample]:
    """Six seconds at 10 Hz of both sensors, each sample told from every other."""
    for i in range(60):
        t_ns = i * NS_PER_S // 10
        image = np.full((4, 20, 3), i, np.uint8)
        image[:, 5] = 200
        yield StereoFrame(t_ns, image, image + 1, arrival_ns=t_ns + 80_000_000, name=f"{i}")
        yield LaserRange(t_ns + 1, 1.0 + i / 100, 0.9, arrival_ns=t_ns + 90_000_000)


def run(sensor: Sensor, mode: Mode, size: float | None = None, seed: int = 0) -> list[Sample]:
    fault = Fault(sensor=sensor, mode=mode, start_s=START, end_s=END, size=size)
    return list(inject(stream(), [fault], np.random.default_rng(seed)))


def inside(samples: list[Sample], kind: type) -> list[Sample]:
    return [s for s in samples if isinstance(s, kind) and START <= s.t_s < END]


def same(a: Sample, b: Sample) -> bool:
    if isinstance(a, StereoFrame) and isinstance(b, StereoFrame):
        return a.t_ns == b.t_ns and np.array_equal(a.left, b.left) and np.array_equal(a.right, b.right)
    return a == b


@pytest.mark.parametrize("mode", ["off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent"])
@pytest.mark.parametrize("sensor", ["camera", "laser"])
def test_outside_its_window_and_sensor_nothing_changes(sensor: Sensor, mode: Mode) -> None:
    kind = LaserRange if sensor == "laser" else StereoFrame
    before = {(type(s), s.t_ns): s for s in stream()}
    after = run(sensor, mode)
    kept = [s for s in after if not (isinstance(s, kind) and START <= s.t_s < END)]
    assert len(kept) == 120 - 20
    assert all(same(s, before[type(s), s.t_ns]) for s in kept)
    arrivals = [s.arrival_ns for s in after if s.arrival_ns is not None]
    assert arrivals == sorted(arrivals)
    assert len(inside(after, kind)) < 20 or not all(
        same(s, before[type(s), s.t_ns]) and s.arrival_ns == before[type(s), s.t_ns].arrival_ns
        for s in inside(after, kind)
    )


def test_off() -> None:
    assert inside(run("laser", "off"), LaserRange) == []
    assert inside(run("camera", "off"), StereoFrame) == []


def test_one_camera_off_is_black() -> None:
    frames = inside(run("left", "off"), StereoFrame)
    assert len(frames) == 20
    assert all(isinstance(f, StereoFrame) and not f.left.any() and f.right.any() for f in frames)


def test_stuck_repeats_the_last_good_value_with_fresh_stamps() -> None:
    ranges = inside(run("laser", "stuck"), LaserRange)
    assert {s.range_m for s in ranges if isinstance(s, LaserRange)} == {1.0 + 19 / 100}
    assert len({s.t_ns for s in ranges}) == 20
    for frame in inside(run("right", "stuck"), StereoFrame):
        assert isinstance(frame, StereoFrame)
        assert frame.right[0, 0, 0] == 20
        assert frame.left[0, 0, 0] == round(frame.t_s * 10)


def test_garbage_has_nothing_of_the_truth() -> None:
    ranges = np.array([s.range_m for s in inside(run("laser", "garbage"), LaserRange) if isinstance(s, LaserRange)])
    assert ranges.std() > 1
    frames = inside(run("camera", "garbage"), StereoFrame)
    assert all(isinstance(f, StereoFrame) and f.left.std() > 50 and f.right.std() > 50 for f in frames)


def test_wrong_is_off_by_its_size() -> None:
    for s in inside(run("laser", "wrong", 0.25), LaserRange):
        assert isinstance(s, LaserRange)
        assert s.range_m == pytest.approx(1.0 + round(s.t_s * 10) / 100 + 0.25)
    for f in inside(run("camera", "wrong", 3), StereoFrame):
        assert isinstance(f, StereoFrame)
        assert f.left[0, 5, 0] == 200
        assert f.right[0, 8, 0] == 201


def test_slow_keeps_each_nth() -> None:
    kept = inside(run("laser", "slow", 5), LaserRange)
    assert [round(s.t_s * 10) for s in kept] == [20, 25, 30, 35]
    assert len(inside(run("camera", "slow", 1), StereoFrame)) == 20


def test_delayed_arrives_later_and_in_order() -> None:
    samples = run("camera", "delayed", 0.35)
    for s in inside(samples, StereoFrame):
        assert s.arrival_ns == s.t_ns + 430_000_000
    order = [s.arrival_ns for s in samples if s.arrival_ns is not None]
    assert order == sorted(order)
    assert len(samples) == 120
    stamps = [s.t_ns for s in samples]
    assert stamps != sorted(stamps)


def test_intermittent_loses_its_share() -> None:
    lost = 20 - np.mean([len(inside(run("laser", "intermittent", 0.5, seed), LaserRange)) for seed in range(40)])
    assert abs(lost - 10) < 3 * (20 * 0.25 / 40) ** 0.5


def test_faults_add_up_and_repeat_by_seed() -> None:
    faults = [Fault(sensor="laser", mode="intermittent"), Fault(sensor="camera", mode="garbage", end_s=1.0)]
    first, again = (list(inject(stream(), faults, np.random.default_rng(1))) for _ in range(2))
    assert len(first) == len(again) < 120
    assert all(same(a, b) for a, b in zip(first, again, strict=True))


@pytest.mark.parametrize(
    "values",
    [
        {"sensor": "laser", "mode": "melted"},
        {"sensor": "sonar", "mode": "off"},
        {"sensor": "laser", "mode": "off", "start_s": 3.0, "end_s": 2.0},
        {"sensor": "laser", "mode": "slow", "size": 0.2},
    ],
)
def test_faults_that_make_no_sense_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Fault.model_validate(values)


@pytest.mark.parametrize(("mode", "old_s"), [("slow", 0.3), ("intermittent", 0.1), ("delayed", 0.5)])
def test_one_camera_of_two_gives_older_pictures_with_their_own_stamps(mode: Mode, old_s: float) -> None:
    before = {s.t_ns: s for s in stream() if isinstance(s, StereoFrame)}
    frames = [s for s in inside(run("left", mode), StereoFrame) if isinstance(s, StereoFrame)]
    assert len(frames) == 20
    ages_s = []
    for frame in frames:
        taken_ns = frame.t_ns if frame.left_t_ns is None else frame.left_t_ns
        assert np.array_equal(frame.left, before[taken_ns].left)
        assert np.array_equal(frame.right, before[frame.t_ns].right)
        assert frame.right_t_ns in (None, frame.t_ns)
        ages_s.append((frame.t_ns - taken_ns) / NS_PER_S)
    assert max(ages_s) >= old_s
    assert (min(ages_s) == old_s) if mode == "delayed" else (min(ages_s) == 0)
