"""What is wrong with a pair of pictures of a board, told at once: before it is saved, not when it is too late."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from leadline.calibration.board import Board, Corners
from leadline.samples import Array, Image

BURNT_GREY = 250.0
BURNT_SHARE = 0.5
"""Of the board's white squares, as bright as a pixel can be."""
FAINT_GREY = 25.0
"""White less black, grey values."""
GLARE = 0.4
"""A black square that is brighter than the others by this part of white less black has a reflection on it."""
STRAY = 0.3  # of a square's side: how much of its middle is looked at


class Fault(StrEnum):
    NONE = "none seen"
    ONE = "one camera"
    FAINT = "faint"
    BURNT = "burnt"
    GLARE = "glare"
    BLUR = "blur"


@dataclass(frozen=True, slots=True)
class Amiss:
    """What, and in words what to do about it."""

    fault: Fault
    words: str


def amiss(left: tuple[Image, Corners | None], right: tuple[Image, Corners | None], board: Board) -> Amiss | None:
    """The gravest fault of a pair, each a picture (H, W[, 3]) and the corners found in it; None where it is good."""
    both = {"left": left, "right": right}
    unseen = [side for side, (_, corners) in both.items() if corners is None]
    if len(unseen) == 2:
        whole = "" if board.charuco else "whole "
        return Amiss(Fault.NONE, f"No board is seen: show the {whole}board, with its white rim, to both cameras.")
    if unseen:
        return Amiss(Fault.ONE, f"The {unseen[0]} camera does not see the whole board: bring it into both pictures.")
    for side, (image, corners) in both.items():
        assert corners is not None
        if corners.blurred:
            return Amiss(
                Fault.BLUR,
                f"Blurred in the {side} picture (edges {corners.edge_px:.0f} px wide): hold still, give more light, "
                "or check the focus.",
            )
        if board.charuco is None and (wrong := _light(image, corners, board, side)) is not None:
            return wrong
    return None


def _light(image: Image, corners: Corners, board: Board, side: str) -> Amiss | None:
    dark, bright = _squares(image, corners, board)
    contrast = float(np.median(bright) - np.median(dark))
    if contrast < FAINT_GREY:
        return Amiss(Fault.FAINT, f"The board is hardly seen in the {side} picture: more light, clearer water, nearer.")
    if float(np.mean(bright >= BURNT_GREY)) > BURNT_SHARE:
        return Amiss(Fault.BURNT, f"Too bright in the {side} picture: less light or a shorter exposure.")
    if float(dark.max() - np.median(dark)) > GLARE * contrast:
        return Amiss(Fault.GLARE, f"Glare on the board in the {side} picture: turn it out of the reflection.")
    return None


def _squares(image: Image, corners: Corners, board: Board) -> tuple[Array, Array]:
    """Mean grey value of the middle of each dark and of each bright square between the inner corners."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    grid = corners.pixels.reshape(board.rows, board.columns, 2)
    middles = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    size = max(1, int(STRAY * corners.spacing_px))
    levels = cv2.blur(grey, (size, size))
    x, y = np.rint(middles).astype(int).transpose(2, 0, 1)
    values: Array = levels[y.clip(0, grey.shape[0] - 1), x.clip(0, grey.shape[1] - 1)].astype(np.float64)
    even = np.indices(values.shape).sum(axis=0) % 2 == 0
    first, second = values[even], values[~even]
    return (first, second) if np.median(first) <= np.median(second) else (second, first)
