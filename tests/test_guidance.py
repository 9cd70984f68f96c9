"""What the pilot is told."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from leadline.config import GuidanceConfig
from leadline.geometry.pose import Pose
from leadline.guidance import FORWARD_LOOKING, Guide
from leadline.rig import Rig
from leadline.samples import Solution, Stage, Status
from leadline.wire.ros2_results import guidance_text

RIG = Rig.load("rendered")


def solution(p=(0.0, 0.0, 1.17), range_m=1.0, sigma_m=0.001, v=(0.0, 0.0, 0.0), status=Status.VALID) -> Solution:
    cov = np.diag([1e-6, 1e-6, sigma_m**2])
    return Solution(0, Stage.BOTH, status, np.array(p), cov, range_m, sigma_m, np.array(v))


def test_a_target_to_the_right_and_above_is_faced_by_turning_to_starboard_and_up() -> None:
    told = Guide(RIG).of(solution((0.5, -0.25, 1.0)))  # optical frame: x right, y down
    assert told is not None
    assert told.p_body_m == pytest.approx([1.0, -0.5, 0.25])  # forward, port, up
    assert told.bearing_rad == pytest.approx(-np.arctan(0.5))
    assert told.elevation_rad == pytest.approx(np.arctan2(0.25, np.hypot(1.0, 0.5)))


def test_the_cameras_place_on_the_vehicle_counts() -> None:
    downward = Pose([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], [0.3, 0.0, -0.1])  # looks down, its top to the bow
    rig = dataclasses.replace(RIG, T_body_left=downward)
    told = Guide(rig).of(solution((0.0, 0.0, 1.0)))
    assert told is not None
    assert told.p_body_m == pytest.approx([0.3, 0.0, -1.1])
    assert told.elevation_rad == pytest.approx(np.arctan2(-1.1, 0.3))


def test_the_covariance_turns_with_the_frame() -> None:
    told = Guide(RIG).of(solution(sigma_m=0.01))
    assert told is not None
    assert np.diag(told.cov_body_m2) == pytest.approx([1e-4, 1e-6, 1e-6])  # depth is ahead


def test_closing_speed_and_time_to_the_stand_off() -> None:
    guide = Guide(RIG, GuidanceConfig(standoff_m=0.5))
    nearing = guide.of(solution(v=(0.0, 0.0, -0.1)))
    leaving = guide.of(solution(v=(0.0, 0.0, 0.1)))
    aside = guide.of(solution(v=(0.2, 0.0, 0.0)))
    inside = guide.of(solution(range_m=0.45, v=(0.0, 0.0, -0.1)))
    assert nearing is not None
    assert leaving is not None
    assert aside is not None
    assert inside is not None
    assert (nearing.closing_m_s, nearing.standoff_s) == (pytest.approx(0.1), pytest.approx(5.0))
    assert (leaving.closing_m_s, leaving.standoff_s) == (pytest.approx(-0.1), None)
    assert aside.closing_m_s == pytest.approx(0.0)
    assert inside.standoff_s == 0.0


def test_a_closing_speed_that_nobody_knows_is_not_nought() -> None:
    told = Guide(RIG).of(dataclasses.replace(solution(), velocity_m_s=None))
    assert told is not None
    assert (told.closing_m_s, told.standoff_s) == (None, None)
    assert '"closing_m_s": null' in guidance_text(solution(), told)["data"]


@pytest.mark.parametrize(
    ("range_m", "sigma_m", "alarm", "in_reach"),
    [
        (0.19, 0.001, True, True),
        (0.21, 0.001, False, True),
        (0.21, 0.02, True, True),  # perhaps nearer than 0.2 m: the alarm is given
        (0.62, 0.001, False, True),
        (0.62, 0.02, False, False),  # perhaps out of reach: no
        (0.7, 0.001, False, False),
    ],
)
def test_alarm_and_reach_are_on_the_safe_side(range_m: float, sigma_m: float, alarm: bool, in_reach: bool) -> None:
    told = Guide(RIG).of(solution(range_m=range_m, sigma_m=sigma_m))
    assert told is not None
    assert (told.alarm, told.in_reach) == (alarm, in_reach)


def test_accurate_enough_needs_a_valid_solution_of_ten_centimetres() -> None:
    guide = Guide(RIG)
    told = [
        guide.of(one) for one in (solution(sigma_m=0.049), solution(sigma_m=0.051), solution(status=Status.COASTING))
    ]
    assert [one is not None and one.accurate for one in told] == [True, False, False]


def test_nothing_is_told_of_a_lost_target() -> None:
    assert Guide(RIG).of(Solution(0, Stage.SEARCHING, Status.LOST)) is None


def test_a_rig_that_does_not_say_looks_ahead() -> None:
    assert np.array_equal(Guide(RIG).T_body_left.R, FORWARD_LOOKING.R)
