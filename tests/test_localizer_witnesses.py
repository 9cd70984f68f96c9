"""Who else says so: accounts of what is said without one suspect, and what they make of the stated sigma."""

from __future__ import annotations

import numpy as np
import pytest

from leadline.estimation import Estimate
from leadline.localizer.witnesses import ALLOWED, SURE, Evidence, Witnesses
from leadline.samples import NS_PER_S, Array, Kind, Measurement
from leadline.target import Sphere

BALL = Sphere(0.34)
BY = {
    Kind.LASER: frozenset({"laser"}),
    Kind.SPOT: frozenset({"spot", "pictures"}),
    Kind.STEREO: frozenset({"stereo", "left", "right", "pictures"}),
    Kind.SIZE: frozenset({"outline", "pictures"}),
}


def estimate(range_m: float, t_ns: int = 0, speed_m_s: float = 0.0) -> Estimate:
    p_m, v_m_s = np.array([0.0, 0.0, range_m + 0.17]), np.array([0.0, 0.0, speed_m_s])
    return Estimate(t_ns, p_m, 1e-6 * np.eye(3), v_m_s, 1e-4 * np.eye(3), 0.0, 0.01)


def said(kind: Kind, off_m: float, sigma_m: float, common_m: float = 0.0) -> Evidence:
    return Evidence(kind, BY[kind], off_m, sigma_m**2, common_m**2)


class Dive:
    """Witnesses of a filter that is told by hand where it moves; ten instants a second."""

    def __init__(self) -> None:
        self.witnesses, self._t_ns, self._range_m = Witnesses(BALL, 0.05), 0, 1.0
        self.witnesses.moved(0, 0, None, estimate(1.0))

    def instant(self, *words: Evidence, moved_m: float = 0.0) -> float:
        """The sigma (m) that these words leave."""
        self._t_ns += NS_PER_S // 10
        before = estimate(self._range_m, self._t_ns)
        self._range_m += moved_m
        self.witnesses.moved(self._t_ns, self._t_ns, before, estimate(self._range_m, self._t_ns))
        for word in words:
            self.witnesses.hear(word)
        return float(self.witnesses.variance_m2(self._t_ns) ** 0.5)


def agreeing(count: int = 20) -> Dive:
    dive = Dive()
    for _ in range(count):
        dive.instant(said(Kind.STEREO, 0.0, 0.01, 0.001), said(Kind.LASER, 0.0, 0.003), said(Kind.SIZE, 0.0, 0.02))
    return dive


def test_a_sigma_is_a_fifth_at_least_of_what_the_others_allow() -> None:
    dive = Dive()
    sigma_m = dive.instant(said(Kind.STEREO, 0.0, 0.03), said(Kind.LASER, 0.0, 0.002))
    assert sigma_m == pytest.approx(SURE * 0.03 / ALLOWED)  # should the laser be wrong, stereo bounds it


def test_averaging_stops_at_what_all_words_of_a_kind_share() -> None:
    sigma_m = agreeing(200).instant(said(Kind.SIZE, 0.0, 0.02, 0.02))
    assert sigma_m < SURE * 0.002 / ALLOWED
    dive = Dive()
    for _ in range(200):
        sigma_m = dive.instant(said(Kind.SIZE, 0.0, 0.02, 0.02), said(Kind.LASER, 0.0, 0.001))
    assert sigma_m == pytest.approx(SURE * 0.02 / ALLOWED, rel=0.01)


def test_what_one_alone_moves_the_filter_by_stands_in_the_sigma_until_another_confirms_it() -> None:
    dive = agreeing()
    calm_m = dive.instant()
    moved_m = dive.instant(said(Kind.LASER, 0.0, 0.003), moved_m=0.3)
    assert calm_m < 0.01
    assert moved_m > SURE * 0.3 / ALLOWED
    confirmed_m = dive.instant(said(Kind.STEREO, 0.0, 0.01))
    assert confirmed_m < 0.02
    dive = agreeing()
    dive.instant(said(Kind.LASER, 0.0, 0.003), moved_m=0.3)
    for _ in range(3):
        denied_m = dive.instant(said(Kind.STEREO, -0.3, 0.01))
    assert denied_m > 0.29


def test_a_liar_among_many_costs_nothing() -> None:
    dive = agreeing()
    before_m = dive.instant()
    for _ in range(20):
        sigma_m = dive.instant(
            said(Kind.STEREO, 0.0, 0.01, 0.001), said(Kind.SIZE, 0.0, 0.02), said(Kind.LASER, 0.3, 0.003)
        )
    assert sigma_m < 2 * before_m + SURE * 0.01 / ALLOWED


def test_one_word_against_another_leaves_both() -> None:
    dive = Dive()
    for _ in range(20):
        sigma_m = dive.instant(said(Kind.STEREO, 0.0, 0.005), said(Kind.LASER, 0.1, 0.003))
    assert sigma_m > 0.09


def test_a_single_stray_word_is_not_heard() -> None:
    dive = agreeing()
    assert dive.instant(said(Kind.LASER, 3.0, 0.003)) < 0.01


def measurement(kind: Kind, cameras: frozenset[str] = frozenset()) -> Measurement:
    def straight(x: Array) -> tuple[Array, Array]:
        return x[:3], np.eye(3)

    return Measurement(kind, 0, np.array([0.0, 0.0, 1.5]), 1e-6 * np.eye(3), straight, cameras=cameras)


def test_a_contradiction_is_blamed_on_one_suspect_while_another_speaks_for_the_filter() -> None:
    stereo, size = measurement(Kind.STEREO, frozenset({"left", "right"})), measurement(Kind.SIZE)
    right_alone = measurement(Kind.SPOT, frozenset({"right"}))
    dive = agreeing()
    assert dive.witnesses.blame([stereo], [])
    assert dive.witnesses.blame([stereo, right_alone], [])  # the right camera is behind both
    assert dive.witnesses.blame([stereo, size], [])  # pictures, against the laser
    for _ in range(15):
        dive.instant()
    assert not dive.witnesses.blame([stereo], [])  # the laser has been silent
    assert dive.witnesses.blame([stereo], [size])  # but the same frame's outline agrees
    assert not dive.witnesses.blame([stereo, size], [])  # nobody is left
    dive.instant(said(Kind.LASER, 0.3, 0.003))
    assert not dive.witnesses.blame([stereo], [])  # the laser says so, too: the filter is wrong


def test_who_is_alone_is_told_until_another_confirms() -> None:
    dive = Dive()
    dive.instant(said(Kind.STEREO, 0.0, 0.01))
    dive.instant()
    assert dive.witnesses.alone_s == pytest.approx(0.2)
    dive.instant(said(Kind.LASER, 0.0, 0.003))
    assert dive.witnesses.alone_s is None


def test_words_are_along_the_sight_and_the_lasers_clock_counts() -> None:
    x = estimate(1.0, speed_m_s=-0.3)
    z = np.array([0.0, 0.0, 1.27])
    stereo = Measurement(Kind.STEREO, 0, z, np.diag([1.0, 1.0, 4e-4]), lambda y: (y, np.eye(3)))
    word = Witnesses(BALL, 0.05).evidence(stereo, x, 0.0)
    assert word is not None
    assert (word.off_m, word.variance_m2) == pytest.approx((0.1, 4e-4))
    reading = Measurement(
        Kind.LASER, 0, np.array([2.1]), np.array([[1e-6]]), lambda y: (y[2:3] * 2, np.array([[0.0, 0.0, 2.0]]))
    )
    word = Witnesses(BALL, 0.05).evidence(reading, x, 0.0)
    assert word is not None
    assert word.off_m == pytest.approx(1.05 - 1.17)
    assert word.common_m2 == pytest.approx((0.05 * 0.3) ** 2)
    assert (
        Witnesses(BALL, 0.05).evidence(
            Measurement(Kind.LASER, 0, np.array([2.1]), np.array([[1e-6]]), lambda y: None), x, 0.0
        )
        is None
    )


def test_a_time_before_the_last_correction_is_without_it() -> None:
    dive = agreeing()
    dive.instant(said(Kind.LASER, 0.0, 0.003), moved_m=-0.3)
    dive.instant(said(Kind.STEREO, 0.0, 0.001), said(Kind.SIZE, 0.0, 0.01))
    now_ns = 22 * NS_PER_S // 10
    late_m, now_m = (dive.witnesses.variance_m2(t_ns) ** 0.5 for t_ns in (now_ns - NS_PER_S // 5, now_ns))
    assert now_m < 0.01
    assert late_m == pytest.approx(0.3)
