"""Which board poses a set of images has, and which are still missing, while it is being taken.

A pose is where the board is in the picture, how far away, and which of its edges is tilted towards the camera. What is
wanted is what `calibrate cameras` lives on: corners in all parts of both pictures (the lens), boards near and far (the
port, the focal length) and tilted each way (focal length and principal point). Poses are those of the rig that is known
by then; at first a guess, from which they are good to a tenth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leadline.calibration.board import Board
from leadline.calibration.start import between, board_pose, camera_from, view_pose
from leadline.calibration.verdict import CELLS, covered
from leadline.calibration.views import SIDES, BoardView
from leadline.geometry import Camera, Pose
from leadline.rig import Rig, Side
from leadline.rig_derivatives import Medium
from leadline.samples import Array

BANDS = ("near", "middle", "far")
TILTS = ("top", "bottom", "left", "right")
BOARDS, EACH_BAND, EACH_TILT = 24, 5, 3
CELL_CORNERS = 3
"""Corners in a cell of the picture, with which it counts as covered."""
NEAR_M, FAR_M = 0.65, 1.2
"""Nearer than the first is near, beyond the second far."""
SQUARE_PX = 16.0
"""Smaller squares have corners so much worse than near ones that they do not fit them: far ends there."""
FARTHER = 1.35
"""Times where far begins: the distance that is advised."""
TILTED_DEG = 15.0
STEEPEST_DEG = 50.0
"""Beyond it corners are found badly."""
_FIT = 1.5  # times the distance at which the board fills the picture: with a large board that is near
_APART = 1.3  # far over near at least
_SHARED_M = 1.5  # what both cameras must see is told there
_GUESS_F, _GUESS_BASELINE_M, _WATER = 0.75, 0.063, 1.335  # f as a part of the width
_KNOWN_FROM = 4  # pairs, from which the focal length is told from the images
_SANE = (0.4, 3.0)  # f as a part of the width
_STEPS = (0.07, 0.07, np.log(1.2), 10.0, 10.0, 20.0)
"""Two poses differ by one where one of these does: place (parts of the picture), ln distance, tilts, turn (degrees)."""


@dataclass(frozen=True, slots=True)
class Stance:
    """How the board hangs before the left camera: its middle as a part of the picture (0 to 1), its distance along the
    optical axis, which edge is towards the camera (degrees; negative: the other one), its turn in the picture."""

    x: float
    y: float
    distance_m: float
    top_deg: float
    left_deg: float
    turn_deg: float

    @property
    def tilts(self) -> tuple[str, ...]:
        """Those of TILTS that it shows, none where it is tilted too steeply."""
        sizes = (self.top_deg, -self.top_deg, self.left_deg, -self.left_deg)
        if max(sizes) > STEEPEST_DEG:
            return ()
        return tuple(name for name, size in zip(TILTS, sizes, strict=True) if size >= TILTED_DEG)

    def away(self, other: Stance) -> float:
        """How unlike two poses are; 1 is different enough to be worth another image."""
        step = np.array(
            [
                self.x - other.x,
                self.y - other.y,
                np.log(self.distance_m / other.distance_m),
                self.top_deg - other.top_deg,
                self.left_deg - other.left_deg,
                (self.turn_deg - other.turn_deg + 90) % 180 - 90,
            ]
        )
        return float(np.linalg.norm(step / _STEPS))


def guessed_rig(views: Sequence[BoardView], board: Board, size: tuple[int, int], medium: Medium) -> Rig:
    """Two pinholes that see as the cameras do in ``medium``: from the images, while there are few of them a guess."""
    pairs = [(v.left, v.right) for v in views if v.left is not None and v.right is not None]
    f = _GUESS_F * size[0] * (_WATER if medium is Medium.WATER else 1.0)
    T = Pose(np.eye(3), [-_GUESS_BASELINE_M, 0.0, 0.0])
    lens = Camera(f, f, (size[0] - 1) / 2, (size[1] - 1) / 2, *size)
    if len(pairs) >= _KNOWN_FROM:
        found = camera_from([left for left, _ in pairs], board, size)
        if _SANE[0] * size[0] < found.fx < _SANE[1] * size[0]:
            lens = found
    poses = [(board_pose(lens, left, board), board_pose(lens, right, board)) for left, right in pairs]
    both = [(a, b) for a, b in poses if a is not None and b is not None]
    if both:
        T = between(*map(list, zip(*both, strict=True)))
    return Rig(lens, lens, T)


def sees_in(rig: Rig, medium: Medium) -> Medium:
    """The medium to project in: a rig without a port (a guess) has the medium in its focal length."""
    return medium if rig.port is not None else Medium.AIR


def stance_of(rig: Rig, view: BoardView, board: Board) -> Stance | None:
    """None where the corners fit no board."""
    pose = view_pose(rig, view, board)
    if pose is None or view.left is None:
        return None
    distance_m = float(pose.apply(board.points_m.mean(axis=0))[2])
    return stance_at(pose.R, distance_m, view.left.pixels, rig.left)


def stance_at(R: Array, distance_m: float, left_px: Array, camera: Camera) -> Stance:
    """R: of the board (left frame, 3x3); left_px: its corners (n, 2) in the left image."""
    x, y = 0.5 * (left_px.min(axis=0) + left_px.max(axis=0)) / (camera.width, camera.height)
    normal = R[:, 2] * np.sign(R[2, 2] or 1.0)
    top, left = np.degrees(np.arctan2(-normal[1], normal[2])), np.degrees(np.arctan2(-normal[0], normal[2]))
    turned = np.degrees(np.arctan2(R[1, 0], R[0, 0]))
    return Stance(float(x), float(y), distance_m, float(top), float(left), float(turned))


@dataclass(frozen=True, eq=False)
class Coverage:
    """What a set has. cells, needed: by side, rows x columns of the picture: covered, and such that both cameras can
    see a board there; bands, tilts: how many boards; edges_m: where near ends and far begins."""

    stances: tuple[Stance, ...]
    cells: dict[Side, NDArray[np.bool_]]
    needed: dict[Side, NDArray[np.bool_]]
    edges_m: tuple[float, float]

    @property
    def bands(self) -> dict[str, int]:
        found = [self.band(stance.distance_m) for stance in self.stances]
        return {name: found.count(name) for name in BANDS}

    @property
    def tilts(self) -> dict[str, int]:
        return {name: sum(name in stance.tilts for stance in self.stances) for name in TILTS}

    def band(self, distance_m: float) -> str:
        return BANDS[int(np.searchsorted(self.edges_m, distance_m))]

    @property
    def open_cells(self) -> dict[Side, NDArray[np.bool_]]:
        return {side: self.needed[side] & ~self.cells[side] for side in self.cells}

    @property
    def complete(self) -> bool:
        return not self.missing

    @property
    def missing(self) -> list[str]:
        """What is still to be shown, a line each; empty where nothing is."""
        out = []
        for side, cells in self.open_cells.items():
            if cells.any():
                out.append(f"{int(cells.sum())} of {int(self.needed[side].sum())} fields of the {side} picture")
        for name, count in self.bands.items():
            if count < EACH_BAND:
                out.append(f"{EACH_BAND - count} boards {self.where(name)}")
        for name, count in self.tilts.items():
            if count < EACH_TILT:
                out.append(f"{EACH_TILT - count} boards with the {name} edge tilted towards the camera")
        if len(self.stances) < BOARDS:
            out.append(f"{BOARDS - len(self.stances)} boards more in all")
        return out

    def where(self, band: str) -> str:
        near, far = self.edges_m
        return {
            "near": f"nearer than {near:.2g} m",
            "middle": f"{near:.2g} to {far:.2g} m",
            "far": f"beyond {far:.2g} m",
        }[band]

    @property
    def share(self) -> float:
        """How much of it is done, 0 to 1."""
        cells = [
            float((c & self.needed[side]).sum() / max(self.needed[side].sum(), 1)) for side, c in self.cells.items()
        ]
        bands = [min(count / EACH_BAND, 1.0) for count in self.bands.values()]
        tilts = [min(count / EACH_TILT, 1.0) for count in self.tilts.values()]
        parts = (
            sum(cells) / len(cells),
            sum(bands) / len(bands),
            sum(tilts) / len(tilts),
            min(len(self.stances) / BOARDS, 1.0),
        )
        return float(sum(parts)) / len(parts)

    def adds(self, other: Coverage, stance: Stance) -> bool:
        """Whether ``other``, this set with one more board of ``stance``, has something that is missing here."""
        short = self.bands[self.band(stance.distance_m)] < EACH_BAND or len(self.stances) < BOARDS
        tilted = any(self.tilts[name] < EACH_TILT for name in stance.tilts)
        new = any((self.open_cells[side] & other.cells[side]).any() for side in self.cells)
        return short or tilted or new


def coverage_of(views: Sequence[BoardView], board: Board, rig: Rig, size: tuple[int, int]) -> Coverage:
    """Of views with both cameras' corners. Deterministic; the rig only says how far and how tilted the boards are."""
    stances = [stance_of(rig, view, board) for view in views]
    counts = covered(views, size)
    needed = _needed(rig, size)
    cells: dict[Side, NDArray[np.bool_]] = {
        side: counts[side] >= CELL_CORNERS if side in counts else np.zeros_like(needed[side]) for side in SIDES
    }
    return Coverage(tuple(s for s in stances if s is not None), cells, needed, _edges_m(rig, board))


def _needed(rig: Rig, size: tuple[int, int]) -> dict[Side, NDArray[np.bool_]]:
    """Cells whose middle both cameras see at 1.5 m: the left picture's left edge, with cameras far apart, is not."""
    columns, rows = CELLS
    middles = (np.arange(columns) + 0.5) * size[0] / columns
    shift = rig.left.fx * abs(float(rig.T_right_left.t_m[0])) / _SHARED_M
    inside = {"left": middles > shift, "right": middles < size[0] - shift}
    return {side: np.tile(inside[side], (rows, 1)) for side in SIDES}


def _edges_m(rig: Rig, board: Board) -> tuple[float, float]:
    width, height = board.points_m.max(axis=0)[:2]
    fills = max(width * rig.left.fx / rig.left.width, height * rig.left.fy / rig.left.height)
    near = max(NEAR_M, _FIT * float(fills))
    sharp = board.square_m * rig.left.fx / SQUARE_PX / FARTHER
    return near, max(min(max(FAR_M, near * FAR_M / NEAR_M), sharp), _APART * near)
