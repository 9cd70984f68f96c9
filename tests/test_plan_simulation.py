"""The plan against the simulator's pictures: predicted sigma of one frame beside the scatter of what the rangers find.

A ball at a distance, 640 x 360, seen from a little elsewhere in every frame. What the plan has to be told, the noise
and the texture, is measured in the pictures; the surface is as smooth as the simulator makes it (no roughness). The
scatter of N errors is itself uncertain by 1 / sqrt(2 N): the bound is 10 % and 2.6 of these (99 %).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import pytest

from leadline.config import Config
from leadline.evaluation.plan_sight import Conditions, box_of, expected_size, expected_stereo
from leadline.localizer import Localizer
from leadline.samples import Array, Detection, Kind, Measurement, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from leadline.target import Sphere

BALL = Sphere(0.34)
AGREES = 0.10
CONFIG = Config()
CONFIG = CONFIG.model_copy(update={"stereo": CONFIG.stereo.model_copy(update={"roughness_m": 0.0})})


@dataclass(frozen=True)
class Scatter:
    """Range errors (N,) by kind, their stated sigmas, and what the pictures are like."""

    error_m: dict[Kind, Array]
    stated_m: dict[Kind, Array]
    noise_grey: float
    texture_grey_px: float
    dive: SimulatedDive

    def expected(self, kind: Kind) -> float:
        """Predicted sigma of the range, m."""
        conditions = Conditions(self.noise_grey, self.texture_grey_px, attenuation_per_m=0.0)
        x = np.array(self.dive.truth[0].position_m)
        if kind is Kind.STEREO:
            one = expected_stereo(self.dive.rig, BALL, CONFIG.stereo, conditions, x)
        else:
            one = expected_size(self.dive.rig, BALL, CONFIG.outline, x)
        assert one is not None
        _, gradient = BALL.range(x)
        return float(np.sqrt(gradient @ one.cov @ gradient))


def dive_at(distance_m: float, frames: int, seed: int, *, noisy: bool = True) -> SimulatedDive:
    scenario = Scenario.load("approach")
    way = {"start_m": distance_m, "end_m": distance_m, "dwell_s": 0.5 * frames - 0.01, "sway_s": 3.0}
    camera = {"rate_hz": 2.0, "exposure_s": 0.0} | ({} if noisy else {"shot_noise": 0.0, "read_noise": 0.0})
    changes = {
        "path": scenario.path.model_copy(update=way),
        "camera": scenario.camera.model_copy(update=camera),
        "laser": scenario.laser.model_copy(update={"power": 0.0}),
    }
    return SimulatedDive(scenario.model_copy(update=changes), seed=seed)


def frames_of(dive: SimulatedDive) -> list[StereoFrame]:
    return [sample for sample in dive.samples() if isinstance(sample, StereoFrame)]


class TrueBox:
    def __init__(self, dive: SimulatedDive) -> None:
        self._dive = dive

    def find(self, frame: StereoFrame) -> list[Detection]:
        box = box_of(self._dive.rig, BALL, np.array(self._dive.truth_at(frame.t_ns).position_m))
        assert box is not None
        return [Detection(box, 1.0)]


def pictures(dive: SimulatedDive, distance_m: float, seed: int) -> tuple[float, float]:
    """Noise of a pixel, and RMS slope along a row of the image as it is matched, about its mean over a patch (grey).

    Over the places whose patches stand wholly on the ball.
    """
    first = frames_of(dive)[0]
    clean = frames_of(dive_at(distance_m, 1, seed, noisy=False))[0].left
    a, b = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(float) for image in (first.left, clean))
    box = np.array(TrueBox(dive).find(first)[0].box_px)
    noise = float((a - b)[_inside(a, box)].std())
    for _ in range(max(0, round(np.log2(box[2:].max() / CONFIG.stereo.target_px)))):
        b, box = cv2.resize(b, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), box / 2
    slope, side = np.gradient(b, axis=1), 2 * CONFIG.stereo.half_px + 1
    local = cv2.blur(slope**2, (side, side)) - cv2.blur(slope, (side, side)) ** 2
    return noise, float(np.sqrt(local[_inside(b, box, side)].mean()))


def _inside(image: Array, box: Array, patch_px: int = 0) -> np.ndarray:
    """The pixels that stand on the ball, with a patch around them."""
    x, y, w, h = box
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    across, down = 2 * (u - x - w / 2) / (w - patch_px), 2 * (v - y - h / 2) / (h - patch_px)
    whole = (
        (np.minimum(u, v) > patch_px / 2) & (u < image.shape[1] - patch_px / 2) & (v < image.shape[0] - patch_px / 2)
    )
    return np.asarray((across**2 + down**2 < 0.9) & whole)


@cache
def scatter(distance_m: float, frames: int, seeds: tuple[int, ...]) -> Scatter:
    error: dict[Kind, list[float]] = {Kind.STEREO: [], Kind.SIZE: []}
    stated: dict[Kind, list[float]] = {Kind.STEREO: [], Kind.SIZE: []}
    seen = []
    for seed in seeds:
        dive = dive_at(distance_m, frames, seed)
        seen.append(pictures(dive, distance_m, seed))
        localizer = Localizer(dive.rig, BALL, TrueBox(dive), CONFIG, filtered=False)
        found: list[Measurement] = []
        told = localizer._sight.measure
        localizer._sight.measure = lambda *a, told=told, found=found: _kept(told(*a), found)  # type: ignore[method-assign]
        for frame in frames_of(dive):
            found.clear()
            localizer.step(frame)
            for one in found:
                if one.kind in error:
                    range_m, gradient = BALL.range(one.z)
                    error[one.kind].append(range_m - dive.truth_at(frame.t_ns).range_m)
                    stated[one.kind].append(float(np.sqrt(gradient @ one.cov @ gradient)))
    noise, texture = np.mean(seen, axis=0)
    as_arrays = [{kind: np.array(values) for kind, values in table.items()} for table in (error, stated)]
    return Scatter(as_arrays[0], as_arrays[1], float(noise), float(texture), dive)


def _kept(found: list[object], into: list[Measurement]) -> list[object]:
    into += [one for one in found if isinstance(one, Measurement)]
    return found


def agrees(found: Scatter) -> tuple[float, float]:
    """Predicted over sampled sigma of stereo, and the bound of its logarithm."""
    error = found.error_m[Kind.STEREO]
    return found.expected(Kind.STEREO) / float(error.std(ddof=1)), AGREES + 2.6 / np.sqrt(2 * len(error))


@pytest.mark.parametrize("distance_m", [0.75, 1.5])
def test_stereo_scatters_as_predicted(distance_m: float) -> None:
    ratio, bound = agrees(scatter(distance_m, 30, (1,)))
    assert abs(np.log(ratio)) < bound, f"predicted over sampled: {ratio:.2f}"


@pytest.mark.long
@pytest.mark.parametrize("distance_m", [0.5, 0.75, 1.0, 1.5, 2.0])
def test_stereo_scatters_as_predicted_on_many_textures(distance_m: float) -> None:
    ratio, bound = agrees(scatter(distance_m, 50, (1, 2, 3, 4)))
    assert abs(np.log(ratio)) < bound, f"predicted over sampled: {ratio:.2f}"


def test_the_plan_states_what_the_outline_states() -> None:
    """Its sigma is a bias that all edges share: what it scatters by from frame to frame is far less."""
    found = scatter(0.75, 30, (1,))
    stated, error = float(np.median(found.stated_m[Kind.SIZE])), found.error_m[Kind.SIZE]
    assert found.expected(Kind.SIZE) == pytest.approx(stated, rel=AGREES)
    assert np.sqrt((error**2).mean()) < stated
    assert error.std() < 0.3 * stated
