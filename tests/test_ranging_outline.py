"""A ball by its outline: refraction-true, with and without its size, with no texture at all."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from leadline.config import Config
from leadline.ranging.outline import OutlineRanger
from leadline.ranging.stereo import Pair
from leadline.samples import Array, Measurement, Rejected, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from leadline.target import Sphere

RADIUS_M = 0.17
SETTINGS = Config().outline


@cache
def dive(contrast: float) -> SimulatedDive:
    """A ball at rest 0.9 m away, its paint smooth or weathered, no laser on it."""
    base = Scenario.load("demo")
    return SimulatedDive(
        base.model_copy(
            update={
                "target": base.target.model_copy(update={"contrast": contrast, "detail": contrast}),
                "path": base.path.model_copy(update={"start_m": 0.9, "end_m": 0.9, "dwell_s": 1.0}),
                "camera": base.camera.model_copy(update={"rate_hz": 4.0}),
                "laser": base.laser.model_copy(update={"power": 0.0}),
            }
        ),
        seed=5,
    )


@cache
def frames(contrast: float) -> tuple[StereoFrame, ...]:
    return tuple(s for s in dive(contrast).samples() if isinstance(s, StereoFrame))


def truth(contrast: float, frame: StereoFrame) -> Array:
    return np.array([*dive(contrast).truth_at(frame.t_ns).position_m, RADIUS_M])


def measure(contrast: float, frame: StereoFrame, ball: Sphere, factor: float) -> Measurement | Rejected:
    """From a start that is off by a factor in distance, and in size where that is not known."""
    x = truth(contrast, frame) * factor
    ranger = OutlineRanger(ball, SETTINGS)
    return ranger.measure(frame.t_ns, Pair(frame.left, frame.right, dive(0.8).rig), x[: 3 + len(ball.shape_mean)])


@pytest.mark.parametrize("factor", [0.98, 1.0, 1.02])
@pytest.mark.parametrize("ball", [Sphere(2 * RADIUS_M), Sphere()], ids=["known", "unknown"])
@pytest.mark.parametrize("contrast", [0.8, 0.0], ids=["weathered", "featureless"])
def test_the_ball_within_what_is_stated(contrast: float, ball: Sphere, factor: float) -> None:
    for frame in frames(contrast):
        found = measure(contrast, frame, ball, factor)
        assert isinstance(found, Measurement)
        error = found.z - truth(contrast, frame)[: len(found.z)]
        sigma = np.sqrt(np.diag(found.cov))
        assert (np.abs(error) < 3 * sigma).all()
        gradient = ball.range(found.z)[1]
        range_error, range_sigma = gradient @ error, np.sqrt(gradient @ found.cov @ gradient)
        assert abs(range_error) < 3 * range_sigma
        assert range_sigma < (0.006 if len(found.z) == 3 else 0.05)


def test_where_it_starts_does_not_matter() -> None:
    frame = frames(0.8)[0]
    low, high = (measure(0.8, frame, Sphere(2 * RADIUS_M), factor) for factor in (0.98, 1.02))
    assert isinstance(low, Measurement)
    assert isinstance(high, Measurement)
    assert low.z == pytest.approx(high.z, abs=5e-4)


@pytest.mark.parametrize("kind", ["black", "even", "noise", "grey noise"])
def test_a_picture_without_a_ball_is_turned_away(kind: str) -> None:
    frame, rng = frames(0.8)[0], np.random.default_rng(1)
    shape = frame.left.shape if kind != "grey noise" else frame.left.shape[:2]
    noise = rng.normal(0, 2.0, shape) if "noise" in kind else np.zeros(shape)
    image = np.asarray(np.round(noise + (0 if kind == "black" else 90)), np.uint8)
    ranger = OutlineRanger(Sphere(2 * RADIUS_M), SETTINGS)
    assert isinstance(ranger.measure(0, Pair(image, image, dive(0.8).rig), truth(0.8, frame)[:3]), Rejected)


def test_a_ball_that_fills_the_view_has_no_outline() -> None:
    frame = frames(0.8)[0]
    ranger = OutlineRanger(Sphere(2 * RADIUS_M), SETTINGS)
    near = truth(0.8, frame)[:3] * 0.2
    assert isinstance(ranger.measure(0, Pair(frame.left, frame.right, dive(0.8).rig), near), Rejected)
