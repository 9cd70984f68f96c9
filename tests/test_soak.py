"""A run that goes on and on keeps no more than it needs (`python -m benchmarks.soak`)."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from benchmarks.faults_dive import Footage, footage
from benchmarks.soak import RATIO, SLOPE_MB_H, TIMES, soak

from leadline.evaluation import running
from leadline.evaluation.running import Spread, Stamps, Tally, Thinned
from leadline.pipeline.worker import PICTURES, Job, Worker
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Solution, Stage, Status, StereoFrame, Truth

KEPT = 64


@cache
def film() -> Footage:
    """A wall of noise 2.2 m away that shakes by a pixel, 320 x 180: no rendering."""
    rig = Rig.load("rendered")
    rig = rig.scaled(320 / rig.left.width)
    rng = np.random.default_rng(2)
    wall = np.kron(rng.integers(30, 220, (60, 140), np.uint8), np.ones((3, 3), np.uint8))
    height, width = rig.left.height, rig.left.width
    samples, boxes, truth = [], {}, {}
    for i in range(20):
        shift = 20 + i % 3
        left, right = (np.ascontiguousarray(wall[:height, s : s + width]) for s in (shift, shift + 8))
        t_ns = i * NS_PER_S // 10
        samples.append(StereoFrame(t_ns, left, right, name=f"{i}"))
        boxes[f"{i}"] = (130.0, 60.0, 60.0, 60.0)
        truth[t_ns] = Truth(t_ns, (0.0, 0.0, 2.2), 2.2)
    return Footage(rig, tuple(samples), boxes, truth)


def objects(monkeypatch: pytest.MonkeyPatch, seconds: int, out: Path) -> int:
    """Solutions and numbers that a run keeps, at its end."""
    kept: list[Thinned[object]] = []
    made = Thinned.__init__

    def watched(self: Thinned[object], *given: object, **named: int) -> None:
        made(self, most=KEPT)
        kept.append(self)

    monkeypatch.setattr(running.Thinned, "__init__", watched)
    result = soak(film(), seconds / 3600, out)
    assert result.steady
    return sum(len(one.values) for one in kept)


def test_a_longer_run_keeps_no_more(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Five kinds of things are kept of one method: solutions, ranges, their sigmas, times and lit points."""
    first = objects(monkeypatch, 25, tmp_path / "a")
    again = objects(monkeypatch, 50, tmp_path / "b")
    assert first <= 5 * KEPT
    assert again <= 5 * KEPT


def test_what_is_thinned_is_even_and_whole_where_it_is_short() -> None:
    assert Thinned(range(KEPT), most=KEPT).values == list(range(KEPT))
    many = Thinned(range(1000), most=KEPT)
    assert many.count == 1000
    assert KEPT / 2 <= len(many.values) <= KEPT
    assert len(set(np.diff(many.values))) == 1
    assert many.values[-1] > 1000 - 2 * 1000 / KEPT * 2


def test_a_spread_is_that_of_all() -> None:
    values = np.random.default_rng(0).normal(5, 1, 100_000)
    spread = Spread()
    for value in values:
        spread.add(float(value))
    told = spread.summary()
    assert told is not None
    assert (told["min"], told["max"]) == (values.min(), values.max())
    assert told["median"] == pytest.approx(np.median(values), abs=4 * 1.25 / np.sqrt(8192))  # false once in 16,000
    assert Spread().summary() is None


def test_counts_and_rates_are_those_of_all() -> None:
    solutions = [Solution(i, Stage.SEARCHING, Status.LOST) for i in range(20_000)]
    assert Tally(solutions).summary()["status"]["lost"] == 20_000
    assert Stamps(range(0, 20_000 * NS_PER_S, NS_PER_S)).rate_hz == pytest.approx(1.0)


def test_a_worker_that_hangs_holds_few_pictures_and_nobody_up() -> None:
    import threading  # noqa: PLC0415

    released, done = threading.Event(), []
    worker = Worker("disk", lambda: 0.0)
    worker.give(Job(lambda: released.wait(30.0) and None, 0))
    for i in range(10 * PICTURES):
        worker.give(Job(lambda i=i: done.append(i), i, picture=True))  # type: ignore[misc]
    assert worker.dropped >= 9 * PICTURES - 1
    assert worker.waiting_ns == 0
    assert not worker.close(0.05)
    released.set()
    assert worker.close(10.0)
    assert done == list(range(10 * PICTURES))[-PICTURES:]


def test_what_a_worker_raises_is_told_and_it_works_on() -> None:
    def fail() -> None:
        raise OSError("full")

    done: list[int] = []
    worker = Worker("disk", lambda: 0.0)
    worker.give(Job(fail, 1, last=True))
    worker.give(Job(lambda: done.append(2), 2, last=True))
    assert worker.close(10.0)
    assert [(one.given_ns, str(one.error)) for one in worker.answers()] == [(1, "full"), (2, "None")]
    assert done == [2]


@pytest.mark.long
def test_a_day(tmp_path: Path) -> None:
    hours = 24.0
    result = soak(footage(), hours, tmp_path / "run")
    assert result.slope_mb_h < SLOPE_MB_H
    assert result.steady
    assert result.ratio <= RATIO
    assert hours * 3600 / result.wall_s >= TIMES
