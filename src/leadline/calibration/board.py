"""Calibration boards and their corners, to a twentieth of a pixel.

The classic detector of OpenCV finds the board (the sector-based one is 50 times slower and misses views that it finds;
it is asked only where the classic one fails); ``cornerSubPix`` then refines with a window that fits the squares: too
small a window is noise, one that reaches the next square is wrong by pixels.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.errors import InputError
from leadline.samples import Array, Image

WINDOW_SHARE = 0.35
"""Half the refinement's window as a share of the smallest square. On rendered boards, 0.04 px of error."""
_WINDOW_PX = (2, 20)
_SMOOTH_SHARE, _SMOOTH_PX = 0.04, 1.2
"""Smoothing before the refinement, of the smallest square and at most: it takes a fifth off the corners' noise."""
BLURRED_PX = 6.0
"""An edge that takes more pixels than this from dark to bright is called blurred."""
_SLOW_WIDTH_PX = 1000  # the sector-based detector gets images no wider than this
_UNMEASURED_PX = 1000.0  # OpenCV says 9999 where the squares are too small for it
_FEWEST = 6  # corners of a ChArUco board seen in part
_LEAST_CONTRAST = 0.5  # of the board's median
_EDGE_SIGMAS = math.sqrt(2 * math.pi)  # contrast over slope of an edge blurred by a Gaussian
_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE


@dataclass(frozen=True, slots=True)
class Charuco:
    """A board with ArUco markers in its white squares: seen in part, each corner is still known by its number."""

    dictionary: str  # OpenCV's name without DICT_, such as 5X5_100
    marker_m: float


@dataclass(frozen=True)
class Board:
    """``columns`` x ``rows`` inner corners, ``square_m`` apart. Corner i is at column i % columns, row i // columns."""

    columns: int
    rows: int
    square_m: float
    charuco: Charuco | None = None

    def __post_init__(self) -> None:
        where = f"--board {self.columns}x{self.rows}"
        if not 3 <= min(self.columns, self.rows) <= max(self.columns, self.rows) <= 100:
            raise InputError("a board has 3 to 100 inner corners each way", where, "count corners, not squares")
        if not 0 < self.square_m < np.inf:
            raise InputError(f"a square of {self.square_m:g} m is none", "--square", "give the side in metres")
        if self.square_m > 0.5:
            raise InputError(
                f"a square of {self.square_m:g} m is too large for a board",
                "--square",
                f"give metres: {self.square_m / 1000:g} if this was millimetres",
            )
        if self.charuco is not None and not 0 < self.charuco.marker_m < self.square_m:
            raise InputError("the marker must be smaller than the square", "--marker", "give both in metres")

    @classmethod
    def parse(cls, size: str, square_m: float, charuco: Charuco | None = None) -> Board:
        """From ``11x8``, inner corners. InputError for anything else."""
        match = re.fullmatch(r"(\d+)[xX×](\d+)", size.strip())
        if match is None:
            raise InputError(f"{size!r} is not a board", "--board", "give inner corners as COLUMNSxROWS, such as 11x8")
        return cls(int(match[1]), int(match[2]), square_m, charuco)

    @property
    def size(self) -> tuple[int, int]:
        return self.columns, self.rows

    @cached_property
    def points_m(self) -> Array:
        """The corners (N, 3) in the board's frame: x along a row, y along a column, z = 0 on the paper."""
        i = np.arange(self.columns * self.rows)
        places = np.stack([i % self.columns, i // self.columns, np.zeros(len(i))], axis=1)
        points: Array = places.astype(np.float64) * self.square_m
        points.flags.writeable = False
        return points

    @cached_property
    def bow(self) -> Array:
        """How far each corner (N, 2) moves along z where the board's middle stands out by 1: a parabola along its rows
        and one along its columns, zero at the outermost corners."""
        outer = self.points_m.max(axis=0)[:2]
        bow: Array = 1.0 - (2.0 * self.points_m[:, :2] / outer - 1.0) ** 2
        bow.flags.writeable = False
        return bow

    @property
    def turns_into_itself(self) -> bool:
        """Half a turn leaves the colours as they are, so the image does not say which end is up."""
        return self.charuco is None and (self.columns + self.rows) % 2 == 0


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """What one camera sees of a board: corner numbers ``ids`` (n,) and where they are, ``pixels`` (n, 2).

    spacing_px: the smallest distance of two neighbours. edge_px: the width of the edges from dark to bright, NaN where
    it was not measured. slow: found by the second detector only, which is more often wrong.
    """

    ids: NDArray[np.int64]
    pixels: Array
    spacing_px: float
    edge_px: float = float("nan")
    slow: bool = False

    @property
    def blurred(self) -> bool:
        return self.edge_px > BLURRED_PX


def find_corners(image: Image, board: Board) -> Corners | None:
    """The board's corners in an image (H, W[, 3]) uint8; None where it is not seen (a checkerboard: not seen whole)."""
    grey = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    if board.charuco is not None:
        return _find_charuco(grey, board, board.charuco)
    quick, corners = cv2.findChessboardCorners(grey, board.size, flags=_FLAGS)
    found = np.asarray(corners, np.float64).reshape(-1, 2) if quick else _find_slowly(grey, board)
    if found is None:
        return None
    rough = found.astype(np.float32)
    spacing = _spacing_px(rough, board)
    pixels = _oriented(grey, _refined(grey, rough, spacing), board)
    edge = _edge_px(grey, pixels, board)
    return Corners(np.arange(len(pixels)), pixels, spacing, edge, slow=not quick)


def turned(corners: Corners) -> Corners:
    """The same corners numbered from the other end (half a turn of a whole board)."""
    return Corners(corners.ids, corners.pixels[::-1].copy(), corners.spacing_px, corners.edge_px, corners.slow)


def alike(left: Corners, right: Corners) -> Corners:
    """The right camera's corners, numbered from the same end as the left's: two cameras see a board alike.

    Only for whole boards that turn into themselves (``Board.turns_into_itself``); others number themselves.
    """
    along = (left.pixels[-1] - left.pixels[0]) @ (right.pixels[-1] - right.pixels[0])
    return right if along >= 0 else turned(right)


def _find_slowly(grey: Image, board: Board) -> Array | None:
    factor = min(1.0, _SLOW_WIDTH_PX / grey.shape[1])
    small = grey if factor == 1 else cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    found, corners = cv2.findChessboardCornersSB(small, board.size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    return (np.asarray(corners).reshape(-1, 2) + 0.5) / factor - 0.5 if found else None


def _spacing_px(pixels: NDArray[np.float32], board: Board) -> float:
    grid = pixels.reshape(board.rows, board.columns, 2)
    return float(min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)))


def _refined(grey: Image, rough: NDArray[np.float32], spacing_px: float, share: float = WINDOW_SHARE) -> Array:
    window = int(np.clip(round(share * spacing_px), *_WINDOW_PX))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    margin = 2 * window + 8
    low = np.maximum(np.floor(rough.min(axis=0)).astype(int) - margin, 0)
    high = np.ceil(rough.max(axis=0)).astype(int) + margin
    part = grey[low[1] : high[1], low[0] : high[0]]
    smooth = cv2.GaussianBlur(part, (0, 0), float(np.clip(_SMOOTH_SHARE * spacing_px, 0.3, _SMOOTH_PX)))
    start = (rough - low.astype(np.float32)).reshape(-1, 1, 2).copy()
    refined = cv2.cornerSubPix(smooth, start, (window, window), (-1, -1), stop)
    out: Array = np.asarray(refined, np.float64).reshape(-1, 2) + low
    return out


def _oriented(grey: Image, pixels: Array, board: Board) -> Array:
    """Numbered so that the square inside the first four corners is dark, and from the upper end where both are."""
    grid = pixels.reshape(board.rows, board.columns, 2)
    if np.linalg.det(np.stack([grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]])) < 0:
        grid = grid[:, ::-1]  # nobody sees a board's paper from behind
    if board.turns_into_itself:
        across, down = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
        upside_down = float(across.sum(axis=0)[0] + down.sum(axis=0)[1]) < 0
    else:
        upside_down = _brightness(grey, grid[:2, :2]) > _brightness(grey, grid[-2:, -2:])
    ordered = grid.reshape(-1, 2)
    return ordered[::-1].copy() if upside_down else ordered.copy()


def _brightness(grey: Image, square: Array) -> float:
    x, y = np.rint(square.reshape(4, 2).mean(axis=0)).astype(int)
    reach = max(1, int(0.15 * np.linalg.norm(square[0, 0] - square[1, 1])))
    patch = grey[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
    return float(patch.mean()) if patch.size else 0.0


def _edge_px(grey: Image, pixels: Array, board: Board) -> float:
    corners = pixels.astype(np.float32).reshape(-1, 1, 2)
    try:
        sharpness: Any = cv2.estimateChessboardSharpness(grey, board.size, corners)[0]
    except cv2.error:  # a board at the border
        return float("nan")
    width = float(sharpness[0])
    return width if width < _UNMEASURED_PX else float("nan")


def _find_charuco(grey: Image, board: Board, charuco: Charuco) -> Corners | None:
    pixels, ids, _, _ = cv2.aruco.CharucoDetector(charuco_board(board, charuco)).detectBoard(grey)
    if ids is None or len(ids) < _FEWEST:
        return None
    numbers, found = np.asarray(ids, np.int64).ravel(), np.asarray(pixels, np.float32).reshape(-1, 2)
    places = board.points_m[numbers] / board.square_m
    if min(np.ptp(places[:, 0]), np.ptp(places[:, 1])) < 1:  # corners on one line say nothing
        return None
    apart = np.linalg.norm(found[:, None] - found[None], axis=2) + np.diag(np.full(len(found), np.inf))
    spacing = float(apart.min())
    to_marker = (1 - charuco.marker_m / board.square_m) / 2  # of a square: what is beyond would pull the corner
    refined = _refined(grey, found, spacing, min(to_marker, WINDOW_SHARE))
    contrast = _contrast(grey, refined, to_marker * spacing)
    kept = contrast > _LEAST_CONTRAST * np.median(contrast)
    if kept.sum() < _FEWEST:
        return None
    edge = _charuco_edge_px(grey, numbers[kept], refined[kept], board, to_marker * spacing)
    return Corners(numbers[kept], refined[kept], spacing, edge)


def _contrast(grey: Image, pixels: Array, reach_px: float) -> Array:
    """Brightest minus darkest around each corner (N,): nothing where glare has eaten it."""
    reach = max(2, round(reach_px))
    out = []
    for x, y in np.rint(pixels).astype(int):
        part = grey[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
        out.append(float(np.ptp(part)) if part.size else 0.0)
    return np.array(out)


def _charuco_edge_px(grey: Image, ids: NDArray[np.int64], pixels: Array, board: Board, reach_px: float) -> float:
    """The width of the edges between neighbours along a row, contrast over steepest slope; NaN where there are none.

    That is 2.5 standard deviations of a Gaussian blur, as is OpenCV's 10 to 90 % of a checkerboard.
    """
    place = {int(number): i for i, number in enumerate(ids)}
    pairs = [(i, place[n + 1]) for n, i in place.items() if (n + 1) % board.columns and n + 1 in place]
    if not pairs:
        return float("nan")
    start, end = (pixels[list(column)] for column in zip(*pairs, strict=True))
    along = (end - start) / np.linalg.norm(end - start, axis=1)[:, None]
    reach = max(reach_px, 3.0)
    steps = np.arange(-reach, reach + 0.25, 0.5)
    at = (start + end)[:, None] / 2 + steps[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1)[:, None]
    u, v = at.astype(np.float32).transpose(2, 0, 1)
    profiles = np.asarray(cv2.remap(grey, u, v, cv2.INTER_LINEAR), np.float64)
    slope = np.abs(np.diff(profiles, axis=1)).max(axis=1) / 0.5
    width = seen = float(np.median(np.ptp(profiles, axis=1) / np.maximum(slope, 1e-9)))
    for _ in range(5):  # between edge and marker the blurred white is not at its brightest
        width = seen / math.erf(reach / 2 / (math.sqrt(2) * width / _EDGE_SIGMAS))
    return width


def charuco_board(board: Board, charuco: Charuco) -> cv2.aruco.CharucoBoard:
    """OpenCV's object. InputError for a dictionary that it does not know."""
    code = getattr(cv2.aruco, f"DICT_{charuco.dictionary.upper()}", None)
    if code is None:
        raise InputError(f"{charuco.dictionary!r} is not known", "--charuco", "give a dictionary such as 5X5_100")
    dictionary = cv2.aruco.getPredefinedDictionary(code)
    squares = (board.columns + 1, board.rows + 1)
    return cv2.aruco.CharucoBoard(squares, board.square_m, charuco.marker_m, dictionary)
