"""Simulated calibrations: random rigs, and boards as their cameras see them."""

from __future__ import annotations

import dataclasses

import numpy as np

from leadline.calibration.board import Board, Corners
from leadline.calibration.views import SIDES, BoardView
from leadline.geometry import Camera, LayeredPort, Pose
from leadline.rig import Rig
from leadline.rig_derivatives import Medium, project
from leadline.rig_parameters import turn
from leadline.samples import Array

BOARD = Board(11, 8, 0.030)
SIZE = (1920, 1080)
FLAT = np.zeros(2)


def random_rig(rng: np.random.Generator, *, distorted: bool = True) -> Rig:
    """A rig like the rendered one: port at 10-30 mm, tilted by 0-3 degrees, lenses not quite alike."""

    def lens() -> Camera:
        k = (-0.15, 0.06, 5e-4, -5e-4, -0.005) if distorted else ()
        jitter = rng.normal(size=4) * (10, 10, 8, 8)
        return Camera(1400 + jitter[0], 1400 + jitter[1], 950 + jitter[2], 535 + jitter[3], *SIZE, k)

    tilt, way = np.radians(rng.uniform(0, 3)), rng.uniform(0, 2 * np.pi)
    normal = (np.sin(tilt) * np.cos(way), np.sin(tilt) * np.sin(way), np.cos(tilt))
    port = LayeredPort(normal, rng.uniform(0.01, 0.03), ((0.002, 1.52),), 1.338 + rng.uniform(-0.004, 0.004))
    T = Pose(turn(rng.normal(size=3) * 0.01), np.array([-0.063, 0, 0]) + rng.normal(size=3) * 0.001)
    return Rig(lens(), lens(), T, port)


def random_pose(rng: np.random.Generator, z_m: float, board: Board = BOARD) -> Pose:
    """T_left_board: anywhere in the picture, tilted by up to 35 degrees."""
    middle = board.points_m.mean(axis=0)
    R = turn(np.array([rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(-0.3, 0.3)]))
    place = np.array([rng.uniform(-0.45, 0.45), rng.uniform(-0.28, 0.28), 1.0]) * z_m
    return Pose(R, place - R @ middle)


def seen(rig: Rig, pose: Pose, medium: Medium, board: Board = BOARD, warp_m: Array = FLAT) -> list[Array] | None:
    """Pixels of all corners in both cameras; None where one is outside an image."""
    out = []
    points = board.points_m + np.outer(board.bow @ warp_m, (0, 0, 1))
    for side in SIDES:
        q, _ = project(rig, side, medium, pose.apply(points))
        if not (np.isfinite(q).all() and (q > 5).all() and (q < np.array(SIZE) - 6).all()):
            return None
        out.append(q)
    return out


def board_views(
    rig: Rig,
    medium: Medium,
    count: int,
    rng: np.random.Generator,
    *,
    sigma_px: float = 0.05,
    z_m: tuple[float, float] = (0.45, 2.0),
    board: Board = BOARD,
    warp_m: Array = FLAT,
) -> tuple[list[BoardView], list[Pose]]:
    """Boards at distances spread over ``z_m`` with noise on their corners, and their true poses."""
    views, poses = list[BoardView](), list[Pose]()
    distances = np.geomspace(*z_m, count)
    while len(views) < count:
        pose = random_pose(rng, distances[len(views)], board)
        pixels = seen(rig, pose, medium, board, warp_m)
        if pixels is None:
            continue
        poses.append(pose)
        left, right = (corners(q + sigma_px * rng.normal(size=q.shape)) for q in pixels)
        views.append(BoardView(f"left_{medium}_{len(views):02d}.png", medium, left, right))
    return views, poses


def corners(pixels: Array) -> Corners:
    return Corners(np.arange(len(pixels)), pixels, 40.0, 2.5)


def in_other_frame(rig: Rig, **changes: object) -> Rig:
    return dataclasses.replace(rig, **changes)  # type: ignore[arg-type]
