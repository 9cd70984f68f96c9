"""Three redundant ranges from one spot: they agree where all is well, and the odd one is named."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from leadline.geometry import Beam
from leadline.ranging.beam import BeamRanger, Seen
from leadline.ranging.redundant import three_ranges
from leadline.rig import Rig
from leadline.samples import Array
from leadline.target import Sphere

RIG = Rig.load("rendered")
assert RIG.laser is not None
LASER = RIG.laser
SIGMA_PX = 0.05


def seen_by(rig: Rig, length_m: float, rng: np.random.Generator) -> Seen:
    left, right = rig.project((LASER.origin_m + length_m * LASER.direction)[None])
    cov: Array = SIGMA_PX**2 * np.eye(2)
    return {"left": (left[0] + rng.normal(0, SIGMA_PX, 2), cov), "right": (right[0] + rng.normal(0, SIGMA_PX, 2), cov)}


def verdict(rig: Rig, seen: Seen, raw_m: float | None) -> str:
    found = three_ranges(rig, BeamRanger(rig, Sphere(0.34)), seen, raw_m)
    assert found is not None
    return found.verdict


def test_differences_are_as_stated() -> None:
    """120 draws at three lengths: a mean square of 1 +- 0.09. Twice or half the covariance lies outside."""
    rng, ranger, squares = np.random.default_rng(1), BeamRanger(RIG, Sphere(0.34)), []
    for i in range(120):
        length = (0.3, 0.7, 1.5)[i % 3]
        raw = LASER.raw_m(length) + rng.normal(0, LASER.range_sigma_m)
        found = three_ranges(RIG, ranger, seen_by(RIG, length, rng), raw)
        assert found is not None
        difference = np.diff(found.lengths_m)
        step = np.array([[-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])
        squares.append(difference @ np.linalg.solve(step @ found.cov_m2 @ step.T, difference) / 2)
        assert found.verdict == ""
    for factor in (0.5, 1.0, 2.0):
        assert (0.75 < np.mean(squares) / factor < 1.3) == (factor == 1.0), np.mean(squares)


def test_stereo_on_the_spot_is_worth_tenths_of_a_millimetre() -> None:
    rng, ranger = np.random.default_rng(2), BeamRanger(RIG, Sphere(0.34))
    for length, limit_m in ((0.3, 1e-4), (0.5, 3e-4)):
        found = three_ranges(RIG, ranger, seen_by(RIG, length, rng))
        assert found is not None
        assert found.cov_m2[0, 0] ** 0.5 < limit_m
        assert found.cov_m2[1, 1] ** 0.5 < limit_m


@pytest.mark.parametrize(
    ("what", "odd"),
    [("reading", "the laser's reading is off by +3"), ("laser", "the beam's place in one image is off"),
     ("camera", "stereo on the spot is off")],
)  # fmt: skip
def test_the_odd_one_is_named(what: str, odd: str) -> None:
    rig, length = RIG, 0.8
    raw = LASER.raw_m(length)
    if what == "reading":
        raw += LASER.range_scale * LASER.group_index * 0.03
    if what == "laser":  # knocked aside: along the epipolar line it looks nearer, stereo does not mind
        side = np.cross(LASER.direction, [0.0, 1.0, 0.0])
        knocked = LASER.direction + 0.012 * side / np.linalg.norm(side)
        laser = Beam(
            LASER.origin_m,
            knocked / np.linalg.norm(knocked),
            LASER.range_scale,
            LASER.range_offset_m,
            LASER.group_index,
            range_sigma_m=LASER.range_sigma_m,
        )
        rig = dataclasses.replace(RIG, laser=laser)
    if what == "camera":  # a baseline that is 3 % too long
        pose = dataclasses.replace(RIG.T_right_left, t_m=1.03 * RIG.T_right_left.t_m)
        rig = dataclasses.replace(RIG, T_right_left=pose)
    seen = seen_by(RIG, length, np.random.default_rng(3))
    assert verdict(rig, seen, raw).startswith(odd)


def test_two_that_differ_are_said_to() -> None:
    rng = np.random.default_rng(4)
    found = verdict(dataclasses.replace(RIG, T_right_left=dataclasses.replace(
        RIG.T_right_left, t_m=1.03 * RIG.T_right_left.t_m)), seen_by(RIG, 0.8, rng), None)  # fmt: skip
    assert "differ by" in found


def test_one_image_is_no_stereo() -> None:
    seen = seen_by(RIG, 0.8, np.random.default_rng(5))
    assert three_ranges(RIG, BeamRanger(RIG, Sphere(0.34)), {"left": seen["left"]}, 1.0) is None
