"""Where to hold the board next: of poses at nine places, three distances and five tilts, the one that brings most."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from leadline.calibration.board import Board
from leadline.calibration.coverage import (
    BANDS,
    CELL_CORNERS,
    EACH_BAND,
    EACH_TILT,
    FARTHER,
    Coverage,
    Stance,
    sees_in,
    stance_at,
)
from leadline.calibration.verdict import cell_counts
from leadline.geometry import Pose
from leadline.rig import Rig, Side
from leadline.rig_derivatives import SIDES, Medium, project
from leadline.rig_parameters import turn
from leadline.samples import Array

PLACES = {
    "in the middle": (0, 0), "on the left": (-1, 0), "on the right": (1, 0), "at the top": (0, -1),
    "at the bottom": (0, 1), "in the upper left": (-1, -1), "in the upper right": (1, -1),
    "in the lower left": (-1, 1), "in the lower right": (1, 1),
}  # fmt: skip
ADVISED_DEG = 25.0
_TURNS = {None: (0.0, 0.0), "top": (1.0, 0.0), "bottom": (-1.0, 0.0), "left": (0.0, -1.0), "right": (0.0, 1.0)}
_BORDER = 0.7  # of a square, around the outermost corners: what must be in the picture, for a corner to be found
_MARGIN = 0.01  # of the picture's width
_CELL_WORTH = 0.5  # of a missing cell, beside a missing distance or tilt
_NEW, _REFUSED = 1.4, 100.0  # what is hardly unlike one that is there would be refused: the last thing to advise
_NEW_WORTH = 0.3  # of each step by which it differs from all that there is, to three
_ROUNDS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Advice:
    """A pose to show next: T_left_board, in words, and where its corners, and what must be seen around them, would be
    in both pictures, four points (4, 2) each, px."""

    pose: Pose
    place: str
    band: str
    distance_m: float
    tilt: str | None
    outline_px: dict[Side, Array]

    @property
    def words(self) -> str:
        how = "square to the camera" if self.tilt is None else f"its {self.tilt} edge tilted towards the camera"
        return f"Hold the board {self.place} of the picture, about {self.distance_m:.1f} m away, {how}"


def advised(coverage: Coverage, rig: Rig, board: Board, medium: Medium) -> Advice | None:
    """None where no such pose fits both pictures. Deterministic: of equals the first."""
    best: tuple[float, Posed, tuple[str, str, str | None]] | None = None
    for band, (place, way) in product(BANDS, PLACES.items()):
        posed_boards = pushed(rig, board, medium, way, _distance_m(coverage, band))
        for tilt, posed in posed_boards.items():
            worth = _worth(coverage, posed.pixels, band, tilt, (rig.left.width, rig.left.height))
            newness = _newness(coverage, posed, rig)
            worth += _NEW_WORTH * min(newness, 3.0) - (_REFUSED if newness < _NEW else 0.0)
            if best is None or worth > best[0] + 1e-9:
                best = worth, posed, (place, band, tilt)
    if best is None:
        return None
    _, posed, (place, band, tilt) = best
    rim = _pixels(rig, medium, posed.pose.apply(_rim_m(board, _BORDER)))
    return Advice(posed.pose, place, band, float(posed.middle_m[2]), tilt, rim)


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """A board with its middle at middle_m (3,), turned by R (left frame), and its corners' pixels."""

    R: Array
    middle_m: Array
    board: Board
    pixels: dict[Side, Array]

    @property
    def pose(self) -> Pose:
        """T_left_board."""
        return Pose(self.R, self.middle_m - self.R @ self.board.points_m.mean(axis=0))


def pushed(rig: Rig, board: Board, medium: Medium, way: tuple[int, int], distance_m: float) -> dict[str | None, Posed]:
    """Boards at a distance, square and tilted each way, pushed into a corner (``way``: left or right, up or down; 0 the
    middle) of what both cameras see; those that do not fit are left out."""
    R = np.array([turn(np.radians(ADVISED_DEG) * np.array([*tilt, 0.0])) for tilt in _TURNS.values()])
    middle = board.points_m.mean(axis=0)
    rims = (_rim_m(board, _BORDER) - middle) @ R.transpose(0, 2, 1)
    places = np.tile([0.0, 0.0, distance_m], (len(R), 1))
    size = np.array([rig.left.width, rig.left.height])
    margin = _MARGIN * size[0]
    for _ in range(_ROUNDS):
        low, high = _bounds(rig, medium, rims + places[:, None])
        goals = np.stack([margin - low, (size - low - high) / 2, size - 1 - margin - high], axis=1)
        shift = np.nan_to_num(goals[:, np.array(way) + 1, (0, 1)])
        places[:, :2] += shift * distance_m / (rig.left.fx, rig.left.fy) / _index(rig, medium)
    low, high = _bounds(rig, medium, rims + places[:, None])
    fits = np.asarray((low > -2).all(axis=1) & (high < size + 1).all(axis=1))
    points = (board.points_m - middle) @ R.transpose(0, 2, 1) + places[:, None]
    pixels = {
        side: q.reshape(points.shape[0], -1, 2) for side, q in _pixels(rig, medium, points.reshape(-1, 3)).items()
    }
    return {
        tilt: Posed(R[i], places[i], board, {side: q[i] for side, q in pixels.items()})
        for i, tilt in enumerate(_TURNS)
        if fits[i]
    }


def _index(rig: Rig, medium: Medium) -> float:
    return rig.port.outside_index if rig.port is not None and medium is Medium.WATER else 1.0


def _pixels(rig: Rig, medium: Medium, points_m: Array) -> dict[Side, Array]:
    return {side: project(rig, side, sees_in(rig, medium), points_m)[0] for side in SIDES}


def _bounds(rig: Rig, medium: Medium, points_m: Array) -> tuple[Array, Array]:
    """Of groups of points (k, n, 3): the least and the greatest pixel (k, 2) in either picture."""
    both = [q.reshape(len(points_m), -1, 2) for q in _pixels(rig, medium, points_m.reshape(-1, 3)).values()]
    together = np.concatenate(both, axis=1)
    return together.min(axis=1), together.max(axis=1)


def _distance_m(coverage: Coverage, band: str) -> float:
    near, far = coverage.edges_m
    places: dict[str, float] = {"near": 0.8 * near, "middle": (near * far) ** 0.5, "far": FARTHER * far}
    return places[band]


def _worth(coverage: Coverage, pixels: dict[Side, Array], band: str, tilt: str | None, size: tuple[int, int]) -> float:
    """How many of the missing things a board there would bring."""
    cells = sum(
        float(((cell_counts(pixels[side], size) >= CELL_CORNERS) & open_).sum())
        for side, open_ in coverage.open_cells.items()
    )
    short: float = max(1 - coverage.bands[band] / EACH_BAND, 0.0)
    flat: float = 0.0 if tilt is None else max(1 - coverage.tilts[tilt] / EACH_TILT, 0.0)
    return float(_CELL_WORTH * cells + 2 * short + 2 * flat)


def _newness(coverage: Coverage, posed: Posed, rig: Rig) -> float:
    """How unlike all that there is."""
    stance: Stance = stance_at(posed.R, float(posed.middle_m[2]), posed.pixels["left"], rig.left)
    return min((stance.away(other) for other in coverage.stances), default=3.0)


def _rim_m(board: Board, squares: float) -> Array:
    """Four points (4, 3) around the corners, so many squares outside of them."""
    (x, y), out = board.points_m.max(axis=0)[:2], squares * board.square_m
    return np.array([[-out, -out, 0], [x + out, -out, 0], [x + out, y + out, 0], [-out, y + out, 0]])
