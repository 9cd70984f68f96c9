"""The analytic derivatives of a rig's pixels against differences."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from leadline.geometry import Camera, LayeredPort, Pose
from leadline.rig import Rig, Side
from leadline.rig_derivatives import Medium, by_parameters, point_sensitivity, project
from leadline.rig_parameters import get, replaced, turn

NAMES = [
    *(f"{s}.{k}" for s in ("left", "right") for k in ("fx_px", "fy_px", "cx_px", "cy_px")),
    *(f"{s}.distortion[{i}]" for s in ("left", "right") for i in range(5)),
    *(f"T_right_left.{k}[{i}]" for k in ("rotation_rad", "t_m") for i in range(3)),
    *("port.distance_m", "port.normal[0]", "port.normal[1]"),
    *(f"port.layers[{i}].{k}" for i in (0, 1) for k in ("thickness_m", "index")),
    "water.index",
]


@pytest.fixture
def rig() -> Rig:
    left = Camera(1400, 1390, 950, 530, 1920, 1080, (-0.2, 0.1, 1e-3, -2e-3, -0.02))
    right = dataclasses.replace(left, fx=1410, distortion=(-0.18, 0.07, -1e-3, 2e-3, 0.01))
    pose = Pose(turn([0.01, -0.03, 0.02]), [-0.063, 0.002, -0.003])
    normal = np.array([0.03, -0.04, 1.0])
    port = LayeredPort(normal / np.linalg.norm(normal), 0.02, ((0.004, 1.49), (0.003, 1.6)), 1.339)
    return Rig(left, right, pose, port)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("medium", list(Medium))
def test_against_differences(rig: Rig, side: Side, medium: Medium) -> None:
    points = np.array([[0.2, -0.1, 0.9], [-0.3, 0.2, 1.5], [0.01, 0.02, 0.3]])
    pixels, by_point = project(rig, side, medium, points)
    analytic = by_parameters(rig, side, medium, points, pixels, by_point, NAMES)
    values = get(rig, NAMES)
    for i, name in enumerate(NAMES):
        step = 1e-6 * max(1.0, abs(values[i]))
        up, down = (project(replaced(rig, [name], [values[i] + s]), side, medium, points)[0] for s in (step, -step))
        difference = (up - down) / (2 * step)
        tolerance = 1e-5 * max(1.0, float(np.abs(difference).max()))
        np.testing.assert_allclose(analytic[:, :, i], difference, atol=tolerance, err_msg=name)


def test_a_board_in_air_says_nothing_about_the_water(rig: Rig) -> None:
    points = np.array([[0.2, -0.1, 0.9]])
    for medium in (Medium.AIR, Medium.AIR_BEHIND_PORT):
        pixels, by_point = project(rig, "left", medium, points)
        assert not by_parameters(rig, "left", medium, points, pixels, by_point, ["water.index"]).any()


def test_a_rig_without_port_is_refused_in_water(rig: Rig) -> None:
    with pytest.raises(ValueError, match="no port"):
        project(dataclasses.replace(rig, port=None), "left", Medium.WATER, np.array([[0.0, 0.0, 1.0]]))


def test_a_triangulated_points_sensitivity_by_two_ways(rig: Rig) -> None:
    points = np.array([[0.1, -0.05, 0.6], [0.0, 0.1, 1.4]])
    seen, values = rig.project(points), get(rig, NAMES)
    analytic = point_sensitivity(rig, points, NAMES)
    for i, name in enumerate(NAMES):
        step = 1e-6 * max(1.0, abs(values[i]))
        up, down = (replaced(rig, [name], [values[i] + s]).triangulate(*seen)[0] for s in (step, -step))
        np.testing.assert_allclose(analytic[:, :, i], (up - down) / (2 * step), rtol=2e-4, atol=2e-5, err_msg=name)


@pytest.mark.parametrize("terms", [8, 12])
def test_lenses_of_more_terms(rig: Rig, terms: int) -> None:
    k = (-0.2, 0.1, 1e-3, -2e-3, -0.02, 0.05, -0.03, 0.01, 1e-3, -5e-4, 7e-4, 2e-4)[:terms]
    wide = dataclasses.replace(rig, left=dataclasses.replace(rig.left, distortion=k))
    points = np.array([[0.2, -0.1, 0.9], [-0.3, 0.2, 1.5]])
    names = [f"left.distortion[{i}]" for i in range(terms)]
    pixels, by_point = project(wide, "left", Medium.WATER, points)
    analytic = by_parameters(wide, "left", Medium.WATER, points, pixels, by_point, names)
    for i, name in enumerate(names):
        up, down = (project(replaced(wide, [name], [k[i] + s]), "left", Medium.WATER, points)[0] for s in (1e-6, -1e-6))
        np.testing.assert_allclose(analytic[:, :, i], (up - down) / 2e-6, rtol=1e-5, atol=1e-4, err_msg=name)


def test_the_normals_third_component_follows_its_others(rig: Rig) -> None:
    assert not point_sensitivity(rig, np.array([[0.1, -0.05, 0.6]]), ["port.normal[2]"]).any()


def test_a_point_behind_the_glass_has_no_sensitivity(rig: Rig) -> None:
    assert np.isnan(point_sensitivity(rig, np.array([[0.0, 0.0, 0.01]]), NAMES)).all()
