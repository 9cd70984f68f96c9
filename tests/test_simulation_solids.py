"""Solids before a camera: true outlines, what hides what, and distractors that are no balls."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from leadline.simulation import props
from leadline.simulation.canvas import Canvas
from leadline.simulation.optics import WATERS
from leadline.simulation.skins import painted
from leadline.simulation.solids import (
    Placed,
    Solid,
    box,
    cone,
    cylinder,
    random_distractor,
    random_turn,
    rock,
    see,
    sphere,
    torus,
)

SIZE = (120, 160)
CAMERA = props.Camera(150.0, SIZE)
WHOLE = (slice(0, SIZE[0]), slice(0, SIZE[1]))


def seen_alpha(placed: Placed) -> np.ndarray:
    return see(placed, CAMERA.rays(WHOLE), 1 / CAMERA.focal_px).alpha.reshape(SIZE)


@pytest.mark.parametrize("centre", [(0.0, 0.0, 1.0), (0.3, -0.2, 1.0), (0.05, 0.1, 0.5)])
def test_a_ball_looks_as_the_cone_of_its_tangents_says(centre: tuple[float, float, float]) -> None:
    """A ray meets the ball where the angle to its centre is below asin(r / d); the border's pixels may differ."""
    radius = 0.2
    rays = CAMERA.rays(WHOLE)
    distance = float(np.linalg.norm(centre))
    cosine = (np.array(centre) / distance) @ rays.astype(float)
    inside = (cosine > np.cos(np.arcsin(radius / distance))).reshape(SIZE)
    alpha = seen_alpha(Placed(sphere(), np.array(centre), np.eye(3), radius))
    assert inside.sum() > 500
    kernel = np.ones((3, 3), np.uint8)
    core = cv2.erode(inside.astype(np.uint8), kernel) > 0
    far = cv2.dilate(inside.astype(np.uint8), kernel) == 0
    assert (alpha[core] > 0.99).all()
    assert (alpha[far] < 0.5).all()


def test_lengths_and_normals_of_a_ball_are_exact() -> None:
    centre, radius = np.array([0.1, 0.0, 1.0]), 0.25
    seen = see(Placed(sphere(), centre, np.eye(3), radius), CAMERA.rays(WHOLE), 1 / CAMERA.focal_px)
    hit = seen.alpha > 0.99
    points = CAMERA.rays(WHOLE)[:, hit] * seen.length_m[hit]
    away = points - centre[:, None]
    np.testing.assert_allclose(np.linalg.norm(away, axis=0), radius, atol=1e-3)  # a tenth of a pixel
    assert ((away / radius * seen.normal[:, hit]).sum(0) > 0.999).all()


@pytest.mark.parametrize(
    "solid",
    [box(np.array([0.3, 0.6, 0.9])), cylinder(0.5, 1.0), cylinder(0.8, 0.3, 0.4), torus(1, 0.3), cone(0.6, 1.4),
     rock(np.random.default_rng(0))],
)  # fmt: skip
def test_distances_are_never_too_long_and_nothing_reaches_out(solid: Solid) -> None:
    """Else a ray would step through, or the solid would be cut at its reach. Slope at most 1, outside positive."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-1.5, 1.5, (3, 20_000)).astype(np.float32)
    step = rng.normal(0, 0.02, points.shape).astype(np.float32)
    change = np.abs(solid.distance(points + step) - solid.distance(points)) / np.linalg.norm(step, axis=0)
    assert np.quantile(change, 0.99) < 1.05
    outside = np.linalg.norm(points, axis=0) > solid.reach
    assert (solid.distance(points[:, outside]) > 0).all()


def test_no_distractor_is_a_ball_from_its_side() -> None:
    """Its silhouette from some side differs from the circle of the same area."""
    rng = np.random.default_rng(2)
    for _ in range(10):
        solid = random_distractor(rng)
        worst = 1.0
        for _ in range(4):
            mask = seen_alpha(Placed(solid, np.array([0, 0, 3.0 * solid.reach]), random_turn(rng), 1.0)) > 0.5
            moments = cv2.moments(mask.astype(np.uint8))
            y, x = np.mgrid[: SIZE[0], : SIZE[1]]
            middle = moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]
            circle = np.hypot(x - middle[0], y - middle[1]) < np.sqrt(mask.sum() / np.pi)
            worst = min(worst, (mask & circle).sum() / (mask | circle).sum())
        assert worst < 0.9


def test_the_nearer_hides_the_farther_and_boxes_are_the_balls_alone() -> None:
    size, found, hidden = (100, 130), 0, 0
    for seed in range(14):
        rng = np.random.default_rng(seed)
        canvas = Canvas(
            np.full((*size, 3), 0.3, np.float32), np.full(size, 9.0, np.float32), np.ones(size, np.float32),
            np.full(size, -1, np.int16),
        )  # fmt: skip
        boxes = props.add_solids(rng, canvas, WATERS["clear"])
        assert canvas.distance_m.max() <= 9.01
        for k, (x, y, w, h) in enumerate(boxes):
            mine = np.argwhere(canvas.owner == k)
            if not len(mine):
                continue
            (top, left), (bottom, right) = mine.min(0), mine.max(0)
            assert left >= x
            assert right < x + w
            assert top >= y
            assert bottom < y + h
            found += 1
            hidden += len(mine) < 0.6 * w * h
    assert found > 8
    assert hidden


def test_paint_is_a_reflectance_and_varies() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(0, 1, (3, 500)).astype(np.float32)
    points /= np.linalg.norm(points, axis=0)
    paints = [painted(rng, points) for _ in range(60)]
    assert all(p.shape == (500, 3) and p.min() > 0 and p.max() <= 0.95 for p in paints)
    contrast = np.array([p.std(0).max() for p in paints])
    assert (contrast < 0.01).any()
    assert (contrast > 0.15).sum() > 5
