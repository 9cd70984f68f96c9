"""People who take calibration images: one follows the advice, others do not; what their cameras see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from calibration_scenes import BOARD, SIZE, corners, random_pose, seen
from leadline.calibration.board import Board
from leadline.calibration.cameras import CameraSettings
from leadline.calibration.guide import Guide
from leadline.calibration.trial import trial
from leadline.calibration.views import BoardView
from leadline.geometry import Camera, Pose
from leadline.rig import Rig
from leadline.rig_derivatives import SIDES, Medium, project
from leadline.rig_parameters import turn
from leadline.samples import Image, StereoFrame

SIGMA_PX = 0.05
Hand = Callable[[Guide, np.random.Generator], Pose]
LATER = CameraSettings()


def obeys(guide: Guide, rng: np.random.Generator) -> Pose:
    """As advised, as well as hands can: 6 % in distance, 2 % of it sideways, 5 degrees."""
    assert guide.advice is not None
    pose, middle = guide.advice.pose, BOARD.points_m.mean(axis=0)
    place = pose.apply(middle) * np.exp(0.06 * rng.normal())
    place[:2] += 0.02 * place[2] * rng.normal(size=2)
    R = turn(np.radians([5, 5, 6]) * rng.normal(size=3)) @ pose.R
    return Pose(R, place - R @ middle)


def wanders(guide: Guide, rng: np.random.Generator) -> Pose:
    """Anywhere, at any distance: nobody looks at the advice."""
    return random_pose(rng, float(np.exp(rng.uniform(np.log(0.45), np.log(2.0)))))


def stands(guide: Guide, rng: np.random.Generator) -> Pose:
    """The same pose all the time."""
    middle = BOARD.points_m.mean(axis=0)
    R = turn(0.02 * rng.normal(size=3))
    return Pose(R, np.array([0.0, 0.0, 0.8]) + 0.01 * rng.normal(size=3) - R @ middle)


def faces(guide: Guide, rng: np.random.Generator) -> Pose:
    """Everywhere, but always square to the camera."""
    pose, middle = wanders(guide, rng), BOARD.points_m.mean(axis=0)
    R = turn(0.03 * rng.normal(size=3))
    return Pose(R, pose.apply(middle) - R @ middle)


def centres(guide: Guide, rng: np.random.Generator) -> Pose:
    """Tilted each way, near and far, but always in the middle of the picture."""
    pose, middle = wanders(guide, rng), BOARD.points_m.mean(axis=0)
    distance = pose.apply(middle)[2]
    return Pose(pose.R, np.array([0.03, 0.0, 1.0]) * distance - pose.R @ middle)


def drawn_in(pose: Pose, misses: int) -> Pose:
    """The page says when a board is cut off: each time its owner moves it to the middle and away from the camera."""
    middle = BOARD.points_m.mean(axis=0)
    place = pose.apply(middle) * (0.92**misses, 0.92**misses, 1.02**misses)
    return Pose(pose.R, place - pose.R @ middle)


@dataclass(frozen=True, slots=True)
class Session:
    guide: Guide
    shown: int  # boards held up


def session(rig: Rig, medium: Medium, hand: Hand, rng: np.random.Generator, *, at_most: int = 60) -> Session:
    """Boards are held up until it is enough, or somebody has lost patience."""
    guide, misses = Guide(BOARD, medium, SIZE), 0
    for shown in range(at_most):
        if guide.wants_trial and guide.coverage.complete:
            names = guide.names
            guide.take(trial(guide.views, BOARD, SIZE, LATER), names)
        if guide.enough:
            return Session(guide, shown)
        pixels = seen(rig, drawn_in(hand(guide, rng), misses), medium)
        misses = misses + 1 if pixels is None else 0
        if pixels is None:
            continue
        left, right = (corners(q + SIGMA_PX * rng.normal(size=q.shape)) for q in pixels)
        view = BoardView(f"{medium}_{shown:03d}", medium, left, right)
        stance = guide.stance(view)
        if stance is not None and not guide.useless(view, stance):
            guide.add(view)
    return Session(guide, at_most)


# -- pictures ----------------------------------------------------------------------------------------------------------

SMALL = Board(7, 5, 0.040)
_PX = 30  # of a square in the drawn board
_RIM = 1  # squares of white around the outermost squares


def small_rig() -> Rig:
    lens = Camera(480.0, 480.0, 319.5, 179.5, 640, 360)
    return Rig(lens, lens, Pose(np.eye(3), [-0.063, 0.0, 0.0]))


def paper(board: Board = SMALL) -> Image:
    """The board as it is printed, _PX to the square; corner (0, 0) is (1 + _RIM) squares inside its edge."""
    rows, columns = board.rows + 1, board.columns + 1
    squares = np.indices((rows, columns)).sum(axis=0) % 2 * 255
    image = np.kron(squares, np.ones((_PX, _PX))).astype(np.uint8)
    return cv2.copyMakeBorder(image, *[_RIM * _PX] * 4, cv2.BORDER_CONSTANT, value=(255,))  # type: ignore[return-value]


def picture(
    rig: Rig, side: str, pose: Pose, rng: np.random.Generator, board: Board = SMALL, light: float = 0.8
) -> Image:
    """A pinhole's picture of the board at ``pose`` (T_left_board), in air, before a grey wall."""
    sheet = paper(board)
    height, width = sheet.shape
    at = (np.array([[0, 0], [width, 0], [width, height], [0, height]]) / _PX - (1 + _RIM)) * board.square_m
    points = np.column_stack([at, np.zeros(4)])
    name = SIDES[side == "right"]
    pixels = project(rig, name, Medium.AIR, pose.apply(points))[0]
    twice = 2 * pixels + 0.5  # drawn at twice the size: smooth edges
    edges = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])
    H = cv2.getPerspectiveTransform(edges.astype(np.float32), twice.astype(np.float32))
    size = rig.left.width, rig.left.height
    wall = np.full((2 * size[1], 2 * size[0]), 110, np.uint8)
    cv2.warpPerspective(sheet, H, (2 * size[0], 2 * size[1]), wall, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT)
    image = light * cv2.resize(wall, size, interpolation=cv2.INTER_AREA) + 2 * rng.normal(size=size[::-1])
    return np.clip(np.rint(cv2.GaussianBlur(image, (0, 0), 0.6)), 0, 255).astype(np.uint8)


def frame_of(rig: Rig, pose: Pose, t_s: float, rng: np.random.Generator) -> StereoFrame:
    left, right = (picture(rig, side, pose, rng) for side in SIDES)
    return StereoFrame(round(t_s * 1e9), left, right)


def held(distance_m: float = 0.7, x_m: float = 0.0, y_m: float = 0.0, tilt: tuple[float, float] = (0.0, 0.0)) -> Pose:
    """T_left_board with the board's middle there."""
    R, middle = turn(np.radians([*tilt, 0.0])), SMALL.points_m.mean(axis=0)
    return Pose(R, np.array([x_m, y_m, distance_m]) - R @ middle)
