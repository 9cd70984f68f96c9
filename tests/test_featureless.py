"""Targets without texture and balls lit from one side: what is still known is stated, and no more."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from leadline.config import Config
from leadline.localizer import Localizer
from leadline.ranging.outline import OutlineRanger
from leadline.ranging.stereo import Pair, Prior, StereoRanger
from leadline.samples import Array, Image, Kind, Measurement, Rejected, Solution, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from leadline.target import Plane, Sphere, Target
from short_dives import TrueBoxes

BALL = Sphere(0.34)


@cache
def dive(name: str, contrast: float) -> SimulatedDive:
    """From 1.2 to 0.5 m; contrast 0: one even colour, and the seabed's light patterns left out."""
    base = Scenario.load(name)
    path = base.path.model_copy(update={"start_m": 1.2, "end_m": 0.5, "speed_m_s": 0.3, "dwell_s": 0.0})
    skin = base.target.model_copy(update={"contrast": contrast, "detail": contrast})
    light = base.light.model_copy(update={"caustics": base.light.caustics * (contrast > 0)})
    camera = base.camera.model_copy(update={"rate_hz": 4.0})
    parts = {"path": path, "target": skin, "light": light, "camera": camera}
    return SimulatedDive(base.model_copy(update=parts), seed=4)


@cache
def solutions(name: str, target: Target, contrast: float) -> tuple[Solution, ...]:
    of = dive(name, contrast)
    localizer = Localizer(of.rig, target, TrueBoxes(of) if isinstance(target, Sphere) else None)
    return tuple(s for sample in of.samples() if (s := localizer.step(sample)) is not None)


def test_the_outline_and_the_laser_carry_a_featureless_ball() -> None:
    of, found = dive("demo", 0.0), solutions("demo", BALL, 0.0)
    ranged = [s for s in found if s.range_m is not None]
    assert len(ranged) > 0.9 * len(found)
    used = {kind for s in ranged for kind in s.used}
    assert {Kind.SIZE, Kind.LASER} <= used
    for s in ranged:
        error_m = abs(s.range_m - of.truth_at(s.t_ns).range_m)  # type: ignore[operator]
        assert error_m < max(5 * float(s.range_sigma_m or 0.0), 0.020)


@pytest.mark.parametrize(("name", "target"), [("demo", BALL), ("hull", Plane())], ids=["ball", "hull"])
def test_stereo_on_a_featureless_target_says_so(name: str, target: Target) -> None:
    """Turned away, or less certain than on the same target with its texture, and right within what it says."""
    sigma: dict[float, list[float]] = {0.0: [], 1.0: []}
    for contrast, stated in sigma.items():
        of = dive(name, contrast)
        boxes = TrueBoxes(of)
        for frame in (s for s in of.samples() if isinstance(s, StereoFrame)):
            truth = of.truth_at(frame.t_ns)
            prior = Prior(np.array(truth.position_m), 0.01)
            box = boxes.find(frame)[0].box_px
            seen = StereoRanger(of.rig, target, Config().stereo).measure(
                0, Pair(frame.left, frame.right, of.rig), box, prior
            )
            if isinstance(seen, Rejected):
                assert seen.reason
                stated.append(np.inf)
                continue
            range_m, gradient = target.range(seen.z)
            stated.append(float(np.sqrt(gradient @ seen.cov @ gradient)))
            assert abs(range_m - truth.range_m) < max(5 * stated[-1], 0.020)
    assert np.median(sigma[0.0]) > 3 * np.median(sigma[1.0])


def shaded(image: Image, side: int, depth: float) -> Image:
    """Lit from one side: it falls off evenly across the picture, on target and water alike."""
    across = np.linspace(1.0, 1.0 - depth, image.shape[1])[::side]
    return np.asarray(np.round(image * across[None, :, None]), np.uint8)


def half_dark(image: Image, ball_px: Array, radius_px: float, side: int) -> Image:
    """The ball itself dark on one side as a moon is, by Lambert's law: a lamp far out to one side."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    x, y = (u - ball_px[0]) / radius_px, (v - ball_px[1]) / radius_px
    depth = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    light = np.clip(0.75 * side * x + 0.66 * depth, 0.15, 1)
    return np.asarray(np.where((x**2 + y**2 < 1)[:, :, None], image * light[:, :, None], image).round(), np.uint8)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("lamp", ["fall-off", "moon"])
@pytest.mark.parametrize("cut", [0.0, 0.4, 0.8], ids=["whole", "cut", "mostly cut"])
def test_an_outline_partly_lit_and_partly_out_of_view_is_honest(side: int, lamp: str, cut: float) -> None:
    """cut: how much of the ball's radius lies beyond the picture's edge."""
    of = dive("demo", 0.8)
    for frame in [s for s in of.samples() if isinstance(s, StereoFrame)][::2]:
        true_m = np.array(of.truth_at(frame.t_ns).position_m)
        images = []
        middles = of.rig.project(true_m[None])
        radius_px = of.rig.focal_outside_px * 0.17 / true_m[2]
        for image, middle in zip((frame.left, frame.right), middles, strict=True):
            lit = shaded(image, side, 0.7) if lamp == "fall-off" else half_dark(image, middle[0], radius_px, side)
            if cut:  # the housing's edge, black, over one side
                lit[:, : int(middle[0, 0] - (1 - cut) * radius_px)] = 0
            images.append(lit)
        pair = Pair(images[0], images[1], of.rig)
        found = OutlineRanger(BALL, Config().outline).measure(0, pair, true_m * 1.01)
        assert isinstance(found, Measurement)
        gradient = BALL.range(found.z)[1]
        sigma_m = float(np.sqrt(gradient @ found.cov @ gradient))
        assert abs(gradient @ (found.z - true_m)) < 3 * sigma_m
        assert sigma_m < 0.008
