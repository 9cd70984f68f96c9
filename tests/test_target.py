"""Shapes: gradients against differences, and distances against plain geometry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leadline.samples import Array
from leadline.target import Cylinder, Plane, Sphere, Surface, Target, parse_target

CASES: list[tuple[Target, list[float]]] = [
    (Sphere(0.34), [0.1, -0.05, 1.2]),
    (Sphere(), [0.1, -0.05, 1.2, 0.2]),
    (Plane(), [0.2, 0.1, 0.9]),
    (Cylinder(0.5), [0.1, 0.05, 1.3, 0.2]),
    (Cylinder(), [0.1, 0.05, 1.3, 0.2, 0.25]),
    (Surface(), [0.1, 0.0, 0.8, 0.03]),
]
ORIGIN = np.array([[-0.04, 0.09, 0.02]])
BEAM = np.array([[0.06, -0.08, 0.995]]) / np.linalg.norm([0.06, -0.08, 0.995])


@pytest.mark.parametrize(("target", "x"), CASES, ids=lambda v: v.name if hasattr(v, "name") else "")
def test_gradients_match_differences(target: Target, x: list[float]) -> None:
    state = np.array(x)
    points = np.array([[0.05, 0.1, 1.0], [-0.1, 0.0, 1.1]])
    for f in (
        lambda y: target.distance(y, points),
        lambda y: target.beam_length(y, ORIGIN, BEAM),
        lambda y: tuple(np.atleast_1d(v) if i == 0 else v[None] for i, v in enumerate(target.range(y))),
    ):
        value, gradient = f(state)
        assert np.isfinite(value).all()
        for i, d in enumerate(1e-6 * np.eye(len(state))):
            assert gradient[:, i] == pytest.approx((f(state + d)[0] - f(state - d)[0]) / 2e-6, abs=1e-6)


@pytest.mark.parametrize(("target", "x"), CASES[:5], ids=lambda v: v.name if hasattr(v, "name") else "")
def test_beam_ends_on_the_surface(target: Target, x: list[float]) -> None:
    state = np.array(x)
    length, _ = target.beam_length(state, ORIGIN, BEAM)
    distance, _ = target.distance(state, ORIGIN + length[:, None] * BEAM)
    assert distance == pytest.approx(0, abs=1e-12)


def test_beam_past_the_target_is_nan_not_a_number_made_up() -> None:
    aside = np.array([[0.5, 0.0, 0.866]])
    for target, x in (CASES[0], CASES[3]):
        assert np.isnan(target.beam_length(np.array(x), ORIGIN, aside)[0]).all()
    back = np.array([[0.0, 0.0, -1.0]])
    assert np.isnan(Plane().beam_length(np.array([0.0, 0.0, 1.0]), ORIGIN, back)[0]).all()


@given(st.floats(-1.4, 1.4), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.5, 3))
def test_cylinder_axis_is_a_unit_vector_across_the_line_of_sight(angle: float, x: float, y: float, z: float) -> None:
    state: Array = np.array([x, y, z, angle, 0.2])
    axis = Cylinder().axis(state)
    assert np.linalg.norm(axis) == pytest.approx(1)
    assert axis @ state[:3] == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("text", ["sphere:0.34", "sphere", "plane", "cylinder:0.5", "cylinder", "surface"])
def test_parse_gives_back_its_name(text: str) -> None:
    assert parse_target(text).name == text


@pytest.mark.parametrize("text", ["ball", "sphere:big", "sphere:-1", "sphere:340", "plane:2", ""])
def test_parse_says_what_is_wrong(text: str) -> None:
    with pytest.raises(ValueError, match="is not a"):
        parse_target(text)


@pytest.mark.parametrize("shape", [Sphere, Cylinder])
@pytest.mark.parametrize("diameter_m", [-1.0, 0.0, np.nan, np.inf])
def test_a_diameter_that_there_cannot_be_is_refused(shape: type[Sphere | Cylinder], diameter_m: float) -> None:
    with pytest.raises(ValueError, match="diameter_m: must be metres above 0"):
        shape(diameter_m)
