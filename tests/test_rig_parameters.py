"""A rig's parameters by name: read, replaced, and every name that a rig file may use."""

from __future__ import annotations

import numpy as np
import pytest

from leadline.geometry import Pose
from leadline.rig import Rig
from leadline.rig_parameters import get, replaced, turn
from leadline.rig_schema import PARAMETER

SIDES = [f"{s}.{k}" for s in ("left", "right") for k in ("fx_px", "fy_px", "cx_px", "cy_px", "distortion[2]")]
NAMES = [
    *SIDES,
    *(f"T_right_left.t_m[{i}]" for i in range(3)),
    *("port.distance_m", "port.normal[0]", "port.normal[1]", "port.layers[0].thickness_m", "port.layers[0].index"),
    *("water.index", "water.group_index", "laser.origin_m[1]", "laser.range_scale", "laser.range_offset_m"),
]


@pytest.fixture
def rig() -> Rig:
    return Rig.load("rendered")


@pytest.mark.parametrize("name", NAMES)
def test_one_parameter_is_replaced_and_the_others_stay(rig: Rig, name: str) -> None:
    assert PARAMETER.fullmatch(name)
    before = get(rig, NAMES)
    i = NAMES.index(name)
    after = get(replaced(rig, [name], [before[i] + 1e-3]), NAMES)
    expected = before.copy()
    expected[i] += 1e-3
    np.testing.assert_allclose(after, expected, atol=1e-12)


def test_all_at_once_equals_one_by_one(rig: Rig) -> None:
    values = get(rig, NAMES) + 1e-4
    points = np.array([[0.1, -0.05, 1.0], [-0.2, 0.1, 0.5]])
    step = rig
    for name, value in zip(NAMES, values, strict=True):
        step = replaced(step, [name], [value])
    np.testing.assert_allclose(replaced(rig, NAMES, values).project(points), step.project(points), atol=1e-9)


def test_index_moves_the_port_and_the_water_together(rig: Rig) -> None:
    other = replaced(rig, ["water.index"], [1.34])
    assert other.port is not None
    assert other.water is not None
    assert (other.port.outside_index, other.water.index) == (1.34, pytest.approx(1.34))


def test_rotation_is_a_turn_put_before(rig: Rig) -> None:
    names = [f"T_right_left.rotation_rad[{i}]" for i in range(3)]
    w = np.array([0.01, -0.02, 0.03])
    turned = replaced(replaced(rig, names, w), names, -w)
    assert get(rig, names).tolist() == [0, 0, 0]
    np.testing.assert_allclose(turned.T_right_left.R, rig.T_right_left.R, atol=1e-12)
    np.testing.assert_allclose(replaced(rig, names, w).T_right_left.R, Pose(turn(w), np.zeros(3)).R, atol=1e-12)


def test_directions_stay_unit_vectors(rig: Rig) -> None:
    laser = replaced(rig, ["laser.direction[0]"], [0.3]).laser
    port = replaced(rig, ["port.normal[0]", "port.normal[1]"], [0.03, -0.02]).port
    assert laser is not None
    assert port is not None
    assert np.linalg.norm(laser.direction) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(port.normal[:2], [0.03, -0.02], atol=1e-12)


@pytest.mark.parametrize("name", ["left.skew", "port.layers[3].index", "nothing.x", "laser.direction[7]"])
def test_a_name_that_is_not_there(rig: Rig, name: str) -> None:
    with pytest.raises(ValueError, match="no such parameter"):
        replaced(rig, [name], [1.0])


def test_a_rig_without_port_has_no_index() -> None:
    rig = Rig.load("rendered")
    air = Rig(rig.left, rig.right, rig.T_right_left)
    with pytest.raises(ValueError, match="no such parameter"):
        get(air, ["water.index"])
