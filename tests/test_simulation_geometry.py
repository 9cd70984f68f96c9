"""The simulator does not vouch for itself: its geometry against an independent renderer and an oracle pixel."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from leadline.geometry import Camera, LayeredPort, Pose
from leadline.rig import Rig
from leadline.simulation.lump import Lump
from leadline.simulation.motion import rotation
from leadline.simulation.optics import Float
from leadline.simulation.renderer import Eye
from leadline.simulation.scenario import CameraPart
from leadline.simulation.shapes import Ball, Pile, Shape, Wall

DIVE = "rendered_dives/approach_ball_clear"
EVERYTHING = (slice(None), slice(None))


@pytest.fixture(scope="module")
def rendered_eye() -> Eye:
    return Eye(Rig.load("rendered"), "left", CameraPart(image_width_px=1920))


@pytest.fixture(scope="module")
def rendered(data_dir: Path) -> list[dict[str, Any]]:
    frames: list[dict[str, Any]] = json.loads((data_dir / DIVE / "truth.json").read_text())["frames"]
    return frames


def coverage(eye: Eye, shape: Shape, T_left_scene: Pose) -> Float:
    return shape.coverage(*eye.rays_in(T_left_scene), eye.pixel_rad)


def at(frame: dict[str, Any]) -> Pose:
    return Pose(np.eye(3), frame["target"]["center_left_m"])


@pytest.mark.data
def test_balls_outline_is_where_the_path_tracer_has_it(rendered_eye: Eye, rendered: list[dict[str, Any]]) -> None:
    for frame in rendered[::4]:
        mask = coverage(rendered_eye, Ball(0.17), at(frame)) > 0.5
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        box = np.array([columns[0], rows[0], columns[-1], rows[-1]])
        assert np.abs(box - frame["bbox_left_px"]).max() <= 1, frame["index"]


@pytest.mark.data
@pytest.mark.parametrize("index", [0, 10, 17])
def test_silhouette_covers_the_path_tracers_ball(
    rendered_eye: Eye, rendered: list[dict[str, Any]], data_dir: Path, index: int
) -> None:
    image = cv2.imread(str(data_dir / DIVE / rendered[index]["left"]))
    assert image is not None
    redness = np.clip(image[..., 2].astype(int) - image[..., 0] + 128, 0, 255).astype(np.uint8)
    _, orange = cv2.threshold(redness, 0, 1, cv2.THRESH_OTSU)
    orange = cv2.morphologyEx(orange, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8)) > 0
    mask = coverage(rendered_eye, Ball(0.17), at(rendered[index])) > 0.5
    assert (orange & mask).sum() / (orange | mask).sum() > 0.99


@pytest.mark.data
def test_the_beam_meets_the_ball_where_the_path_tracer_has_the_spot(rendered: list[dict[str, Any]]) -> None:
    rig = Rig.load("rendered")
    assert rig.laser is not None
    checked = 0
    for frame in rendered:
        centre = np.array(frame["target"]["center_left_m"])
        length = Ball(0.17).hit_m(rig.laser.origin_m - centre, rig.laser.direction)
        assert (length is not None) == frame["laser"]["hits_target"]
        if length is None:
            continue
        point = rig.laser.origin_m + length * rig.laser.direction
        assert abs(length - frame["laser"]["L_true_m"]) < 1e-4
        for pixel, side in zip(rig.project(point[None]), ("left", "right"), strict=True):
            if frame["laser"].get(f"spot_{side}_px"):
                assert np.abs(pixel[0] - frame["laser"][f"spot_{side}_px"]).max() < 0.1
                checked += 1
    assert checked > 20


def test_a_small_ball_appears_at_the_oracles_pixel() -> None:
    """AquaCal: f=1400, c=(960, 540), interface at 0.05 m, n=1.333, point (0.8, 0.3, 2.0) m. The window is cut out."""
    camera = Camera(1400.0, 1400.0, 960.0 - 1500, 540.0 - 700, 500, 280)
    rig = Rig(camera, camera, Pose(np.eye(3), [-0.063, 0, 0]), LayeredPort([0, 0, 1], 0.05, (), 1.333))
    cover = coverage(Eye(rig, "left", CameraPart()), Ball(0.004), Pose(np.eye(3), [0.8, 0.3, 2.0]))
    y, x = np.mgrid[:280, :500]
    centroid = np.array([(cover * x).sum(), (cover * y).sum()]) / cover.sum()
    np.testing.assert_allclose(centroid, [1755.680435 - 1500, 838.380163 - 700], atol=0.02)


def test_a_wrong_index_would_be_noticed(rendered_eye: Eye) -> None:
    """The outline tests above can fail: half a per cent of index moves the ball's limb by more than they allow."""
    rig, pose = rendered_eye.rig, Pose(np.eye(3), [-0.05, 0.03, 0.47])
    assert rig.port is not None
    port = LayeredPort(rig.port.normal, rig.port.distance_m, rig.port.layers, 1.328)
    other = Eye(Rig(rig.left, rig.right, rig.T_right_left, port), "left", CameraPart())
    right, wrong = (np.flatnonzero((coverage(eye, Ball(0.17), pose) > 0.5).any(0)) for eye in (rendered_eye, other))
    assert max(abs(int(right[0]) - int(wrong[0])), abs(int(right[-1]) - int(wrong[-1]))) > 1


def _shapes() -> list[tuple[str, Shape]]:
    tilt = rotation(np.array([0.1, -0.2, 0.0]))
    return [
        ("ball", Ball(0.17)),
        ("wall", Wall(tilt @ [0, 0, -1.0], tilt @ [1.0, 0, 0])),
        ("pile", Pile(0.25, tilt @ [0, 1.0, 0])),
        ("lump", Lump(0.25, 0.3, np.random.default_rng(5))),
    ]


def _rays(eye_m: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(1)
    towards = rng.normal(0, 0.12, (count, 3)) - eye_m
    return towards / np.linalg.norm(towards, axis=1, keepdims=True)


@pytest.mark.parametrize(("name", "shape"), _shapes(), ids=[name for name, _ in _shapes()])
def test_images_of_rays_agree_with_single_rays(name: str, shape: Shape) -> None:
    eye_m = np.array([0.06, -0.04, -0.9])
    directions = _rays(eye_m, 600)
    lengths = [shape.hit_m(eye_m, d) for d in directions]
    images = directions.T.astype(np.float32)[:, :, None]
    origins = np.broadcast_to(eye_m.astype(np.float32)[:, None, None], images.shape)
    trace = shape.trace(origins, images, np.full((600, 1), 1e-5, np.float32))
    hit = np.array([length is not None for length in lengths])
    assert hit.sum() > 200
    agree = (trace.coverage[:, 0] > 0.5) == hit
    assert agree.mean() > 0.99  # a bumpy limb is only nearly right
    sure = hit & (trace.coverage[:, 0] == 1) & (-(trace.normal[:, :, 0] * images[:, :, 0]).sum(0) > 0.2)
    exact = np.array([length or 0.0 for length in lengths])
    np.testing.assert_allclose(trace.distance_m[sure, 0], exact[sure], atol=2e-5)
    points = eye_m + exact[:, None] * directions
    normals = np.array([shape.normal_at(p) for p in points[sure]])
    np.testing.assert_allclose(trace.normal[:, sure, 0].T, normals, atol=2e-3)


@pytest.mark.parametrize(("name", "shape"), _shapes(), ids=[name for name, _ in _shapes()])
def test_nearest_point_is_nearest(name: str, shape: Shape) -> None:
    """Against the nearest hit of rays all around, refined by a general optimiser."""
    for eye_m in ([0.05, 0.03, -0.6], [-0.1, 0.2, -1.5], [0.3, -0.2, -4.0]):
        eye = np.array(eye_m)
        nearest = shape.nearest_m(eye)
        towards = (nearest - eye) / np.linalg.norm(nearest - eye)
        across = np.linalg.svd(towards[None, :])[2][1:]

        def length(q: NDArray[np.float64]) -> float:
            d = towards + q @ across  # noqa: B023
            hit = shape.hit_m(eye, d / np.linalg.norm(d))  # noqa: B023
            return 9.0 if hit is None else hit

        starts = np.random.default_rng(0).normal(0, 0.15 / np.linalg.norm(eye), (6, 2))
        best = min(
            minimize(length, q, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10}).fun for q in starts
        )
        assert float(np.linalg.norm(nearest - eye)) == pytest.approx(best, abs=2e-6)
        np.testing.assert_allclose(shape.normal_at(nearest), -towards, atol=1e-4)


def test_positions_are_the_contracts() -> None:
    eye = np.array([0.2, 0.1, -1.0])
    assert np.allclose(Ball(0.17).position_m(eye), 0)
    _, pile = _shapes()[2]
    assert isinstance(pile, Pile)
    axis_point = pile.position_m(eye)
    assert abs((axis_point - eye) @ pile.axis) < 1e-12
    assert np.allclose(np.cross(axis_point, pile.axis), 0)
    _, wall = _shapes()[1]
    assert isinstance(wall, Wall)
    foot = wall.position_m(eye)
    assert np.allclose(np.cross(foot - eye, wall.normal), 0)
    assert abs(foot @ wall.normal) < 1e-12
