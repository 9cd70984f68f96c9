"""Sheets of what a detector got wrong: a cut-out for each, the true box beside the claimed one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from leadline.evaluation.detection import Box
from leadline.evaluation.detection_tables import FalseBox, Outcome, Picture, Seen, side_px
from leadline.recognition.track import iou
from leadline.samples import Image

COLUMNS, MOST = 4, 12
TILE_W, TILE_H, CAPTION_H, GAP = 240, 180, 34, 8
CONTEXT = 3.0  # so many times the box is shown
LEAST_PX = 96.0  # and at least so much of the picture
TRUE_BGR, CLAIMED_BGR, PAPER_BGR, INK_BGR = (80, 200, 60), (60, 60, 255), (255, 255, 255), (60, 48, 36)

Load = Callable[[Picture], Image]


def worst_misses(outcome: Outcome) -> list[Seen]:
    """The missed targets, the largest first."""
    missed = [seen for seen in outcome.seen if seen.detection is None]
    return sorted(missed, key=lambda seen: -side_px(seen.box_px))[:MOST]


def worst_false(outcome: Outcome) -> list[FalseBox]:
    """The false boxes, the surest first."""
    return outcome.false[:MOST]


def misses_sheet(outcome: Outcome, load: Load) -> Image | None:
    """The worst misses as one picture, None where nothing was missed."""
    tiles = []
    for seen in worst_misses(outcome):
        best = max(seen.picture.found, key=lambda d: (iou(d.box_px, seen.box_px), d.score), default=None)
        near = f"best box {best.score:.2f}, IoU {iou(best.box_px, seen.box_px):.2f}" if best is not None else "no box"
        caption = (Path(seen.picture.name).name, f"{seen.label}, {side_px(seen.box_px):.0f} px; {near}")
        tiles.append(_tile(load(seen.picture), seen.box_px, seen.picture, outcome.score, caption))
    return _sheet(tiles)


def false_sheet(outcome: Outcome, load: Load) -> Image | None:
    """The worst false boxes as one picture, None where there is none."""
    tiles = []
    for false in worst_false(outcome):
        box, picture = false.detection.box_px, false.picture
        closest = max((iou(box, true) for true, _ in picture.truths), default=0.0)
        caption = (Path(picture.name).name, f"{false.detection.label} {false.detection.score:.2f}, IoU {closest:.2f}")
        tiles.append(_tile(load(picture), box, picture, outcome.score, caption))
    return _sheet(tiles)


def _tile(image: Image, around: Box, picture: Picture, score: float, caption: tuple[str, str]) -> Image:
    canvas = image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    width = max(CONTEXT * max(around[2], around[3] * TILE_W / TILE_H), LEAST_PX)
    width = min(width, canvas.shape[1], canvas.shape[0] * TILE_W / TILE_H)  # never more than the picture
    scale = TILE_W / width
    middle = np.array([around[0] + around[2] / 2, around[1] + around[3] / 2])
    half = np.array([TILE_W, TILE_H]) / 2 / scale
    limit = np.array([canvas.shape[1], canvas.shape[0]]) - 0.5
    corner = np.clip(middle - half, -0.5, np.maximum(limit - 2 * half, -0.5))
    matrix = np.array([[scale, 0, -scale * corner[0] - 0.5], [0, scale, -scale * corner[1] - 0.5]])
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    if scale < 0.6:  # warpAffine does not average
        canvas = np.asarray(cv2.GaussianBlur(canvas, (0, 0), 0.35 / scale), np.uint8)
        how = cv2.INTER_LINEAR
    view = np.asarray(cv2.warpAffine(canvas, matrix, (TILE_W, TILE_H), flags=how, borderValue=PAPER_BGR), np.uint8)
    _draw(view, (box for box, _ in picture.truths), matrix, TRUE_BGR, 2)
    _draw(view, (d.box_px for d in picture.found if d.score >= score), matrix, CLAIMED_BGR, 1)
    tile = np.full((TILE_H + CAPTION_H, TILE_W, 3), PAPER_BGR, np.uint8)
    tile[:TILE_H] = view
    for row, words in enumerate(caption):
        short = words if len(words) <= 40 else f"{words[:18]}...{words[-19:]}"
        cv2.putText(tile, short, (0, TILE_H + 13 + 15 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.38, INK_BGR, 1, cv2.LINE_AA)
    return tile


def _draw(view: Image, boxes: Iterable[Box], matrix: np.ndarray, colour: tuple[int, int, int], thick: int) -> None:
    for x, y, w, h in boxes:
        corners = np.array([[x, y, 1], [x + w, y + h, 1]]) @ matrix.T
        (x0, y0), (x1, y1) = np.clip(np.rint(corners), -9, [TILE_W + 9, TILE_H + 9]).astype(int)
        cv2.rectangle(view, (int(x0), int(y0)), (int(x1), int(y1)), colour, thick)


def _sheet(tiles: Sequence[Image]) -> Image | None:
    if not tiles:
        return None
    rows = -(-len(tiles) // COLUMNS)
    columns = min(len(tiles), COLUMNS)
    high, wide = TILE_H + CAPTION_H, TILE_W + GAP
    sheet = np.full((rows * high, columns * wide - GAP, 3), PAPER_BGR, np.uint8)
    for k, tile in enumerate(tiles):
        y, x = (k // COLUMNS) * high, (k % COLUMNS) * wide
        sheet[y : y + high, x : x + TILE_W] = tile
    return sheet
