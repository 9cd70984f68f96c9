"""The spot's centre: to a tenth of a pixel where it is bright, none where there is none, never a glint."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline.ranging.beam import BeamRanger
from leadline.recognition.spot import Spot, find_spot
from leadline.rig import Rig
from leadline.samples import Array, Image
from leadline.target import Sphere

HEIGHT, WIDTH = 120, 240
CURVE = np.column_stack([np.arange(20, 220, 0.5), 60 + 0.04 * np.arange(-100, 100, 0.5)])
RADIUS_PX = 3.0


def background(rng: np.random.Generator) -> Array:
    """An orange ball's weathered paint, BGR: blotches of 6 %, 8 px wide."""
    blotches = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 8.0)
    blotches *= 6 / blotches.std()
    return np.array([25.0, 70.0, 160.0]) * (1 + blotches[..., None] / 100)


def lit(centre: Array, strength: float, colour: Array, width_px: tuple[float, float] = (1.6, 1.6)) -> Array:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    glow = np.exp(-0.5 * (((x - centre[0]) / width_px[0]) ** 2 + ((y - centre[1]) / width_px[1]) ** 2))
    return np.asarray(strength * glow[..., None] * colour)


GREEN, WHITE = np.array([0.25, 1.0, 0.1]), np.array([1.0, 1.0, 1.0])


def exposed(scene: Array, rng: np.random.Generator, noise: float = 2.0) -> Image:
    return np.clip(np.round(scene + rng.normal(0, noise, scene.shape)), 0, 255).astype(np.uint8)


def on_curve(rng: np.random.Generator) -> Array:
    """Somewhere on the curve, off the grid of pixels."""
    x = rng.uniform(50, 190)
    return np.array([x, np.interp(x, CURVE[:, 0], CURVE[:, 1])])


@pytest.mark.parametrize(
    ("strength", "width_px", "rms_px"),
    [(120.0, (1.6, 1.6), 0.1), (25.0, (1.6, 1.6), 0.35), (500.0, (1.6, 1.6), 0.2), (120.0, (2.2, 1.4), 0.12)],
    ids=["bright", "dim", "saturated", "elongated"],
)
def test_centre(strength: float, width_px: tuple[float, float], rms_px: float) -> None:
    rng = np.random.default_rng(1)
    off, z = [], []
    for _ in range(40):
        centre = on_curve(rng)
        found = find_spot(exposed(background(rng) + lit(centre, strength, GREEN, width_px), rng), CURVE, RADIUS_PX)
        if found is not None:
            off.append(found.q_px - centre)
            z.append(off[-1] / np.sqrt(np.diag(found.cov_px2)))
    assert len(off) >= 38
    assert np.sqrt((np.array(off) ** 2).sum(axis=1).mean()) < rms_px
    assert np.sqrt((np.array(z) ** 2).mean()) < 1.5  # never surer than it is right


def test_no_spot() -> None:
    rng = np.random.default_rng(2)
    assert all(find_spot(exposed(background(rng), rng), CURVE, RADIUS_PX) is None for _ in range(40))


def test_no_spot_where_the_beam_is_out_of_the_picture() -> None:
    rng = np.random.default_rng(3)
    image = exposed(background(rng) + lit(np.array([120.0, 60.0]), 150, GREEN), rng)
    assert find_spot(image, CURVE + np.array([500.0, 0.0]), RADIUS_PX) is None
    assert find_spot(image, np.full_like(CURVE, np.nan), RADIUS_PX) is None


def test_two_equal_spots_are_none() -> None:
    rng = np.random.default_rng(4)
    for _ in range(10):
        scene = background(rng)
        for x in (70.0, 160.0):
            scene = scene + lit(np.array([x, np.interp(x, CURVE[:, 0], CURVE[:, 1])]), 120, GREEN)
        assert find_spot(exposed(scene, rng), CURVE, RADIUS_PX) is None


def test_a_spot_off_the_curve_is_not_the_beams() -> None:
    rng = np.random.default_rng(5)
    centre = on_curve(rng) + np.array([0.0, 25.0])
    assert find_spot(exposed(background(rng) + lit(centre, 120, GREEN), rng), CURVE, RADIUS_PX) is None


def test_a_white_glint_is_not_preferred() -> None:
    """As bright and as large as the spot, on the curve itself: the spot, or nothing, but never the glint."""
    rng = np.random.default_rng(6)
    spots = 0
    for _ in range(20):
        spot, glint = np.array([80.0, np.interp(80.0, *CURVE.T)]), np.array([160.0, np.interp(160.0, *CURVE.T)])
        scene = background(rng) + lit(spot, 120, GREEN) + lit(glint, 120, WHITE)
        found = find_spot(exposed(scene, rng), CURVE, RADIUS_PX)
        assert found is None or np.linalg.norm(found.q_px - spot) < 1
        spots += found is not None
    assert spots >= 15


def test_grey_images_will_do() -> None:
    rng = np.random.default_rng(7)
    centre = on_curve(rng)
    colour = exposed(background(rng) + lit(centre, 120, GREEN), rng)
    found = find_spot(np.asarray(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY), np.uint8), CURVE, RADIUS_PX)
    assert found is not None
    assert np.linalg.norm(found.q_px - centre) < 0.4


def rendered_spot(rig: Rig, image: Image, side: str, length_m: float) -> Spot | None:
    """As the localizer looks for it: a fifth of the length either way."""
    _, curve_px = BeamRanger(rig, Sphere(0.34)).curve(side, 0.8 * length_m, 1.25 * length_m)  # type: ignore[arg-type]
    return find_spot(image, curve_px, 0.003 * rig.left.fx * 1.335 / length_m)


@pytest.mark.data
@pytest.mark.parametrize("water", ["clear", "turbid"])
def test_rendered_spots_lie_where_the_truth_has_them(data_dir: Path, water: str) -> None:
    """From 0.4 to 1.7 m, every second frame, left and right: within 0.4 px."""
    rig, folder = Rig.load("rendered"), data_dir / "rendered_dives" / f"approach_ball_{water}"
    off: list[float] = []
    for frame in json.loads((folder / "truth.json").read_text())["frames"][::2]:
        if not 0.4 <= frame["range_z_m"] <= 1.7:
            continue
        for side in ("left", "right"):
            image = np.asarray(cv2.imread(str(folder / frame[side])), np.uint8)
            found = rendered_spot(rig, image, side, frame["laser"]["L_true_m"])
            assert found is not None, f"{frame[side]}"
            off.append(float(np.linalg.norm(found.q_px - frame["laser"][f"spot_{side}_px"])))
    assert len(off) >= 12
    assert max(off) < 0.4
