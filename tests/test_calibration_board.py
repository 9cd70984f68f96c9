"""Boards: printed sizes, and corners found where they are."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline.calibration.board import Board, Charuco, Corners, alike, find_corners, turned
from leadline.cli import main
from leadline.wire.board_pdf import POINTS_PER_M, Rectangle, board_page


def printed(page: tuple[float, float], rectangles: list[Rectangle], px_per_mm: float = 2.0) -> np.ndarray:
    """The page as a picture, each pixel the paper's colour at its centre."""
    scale = px_per_mm * 1e3
    width, height = (round(v * scale) for v in page)
    picture = np.full((height, width), 255, np.uint8)
    for x, y, w, h in rectangles:
        left, right = round(x * scale), round((x + w) * scale)
        top, bottom = round((page[1] - y - h) * scale), round((page[1] - y) * scale)
        picture[top:bottom, left:right] = 0
    return picture


def test_pdf_measures_right(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "board.pdf"
    assert main(["board", "--size", "11x8", "--square", "0.030", "--out", str(out)]) == 0
    text = out.read_bytes().decode("latin-1")
    rectangles = [tuple(map(float, m)) for m in re.findall(r"([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+) re f", text)]
    squares = [r for r in rectangles if min(r[2:]) > 50]
    assert len(squares) == 12 * 9 / 2
    for *_, width, height in squares:
        assert width == pytest.approx(0.030 * 72 / 0.0254, abs=1e-3)
        assert height == pytest.approx(width, abs=1e-3)
    across = {round(x / POINTS_PER_M, 6) for x, *_ in squares}
    assert max(across) - min(across) == pytest.approx(11 * 0.030, abs=1e-6)
    box = re.search(r"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", text)
    assert box is not None
    told = re.search(r"([\d.]+) x ([\d.]+) mm", capsys.readouterr().out)
    assert told is not None
    assert float(box[1]) / POINTS_PER_M * 1e3 == pytest.approx(float(told[1]), abs=0.1)
    ruler = [r for r in rectangles if 3 < r[3] / r[2] * 1e3 < 7]
    assert ruler[0][2] / POINTS_PER_M == pytest.approx(0.1, abs=1e-6)
    start = int(text.rsplit("startxref\n", 1)[1].split()[0])
    assert text[start:].startswith("xref")


def test_a_printed_board_is_found_and_numbered() -> None:
    """Corner 0 is the upper left one, also when the board is upside down."""
    board = Board(11, 8, 0.030)
    picture = printed(*board_page(board))
    corners = find_corners(picture, board)
    assert corners is not None
    spacing = 0.030 * 2e3
    steps = corners.pixels - corners.pixels[0]
    np.testing.assert_allclose(steps, board.points_m[:, :2] / 0.030 * spacing, atol=0.1)
    upside_down = find_corners(picture[::-1, ::-1].copy(), board)
    assert upside_down is not None
    last = np.array(picture.shape[::-1]) - 1
    np.testing.assert_allclose(last - upside_down.pixels, corners.pixels, atol=0.1)


@pytest.mark.parametrize("shown", [1.0, 0.7])
def test_charuco_is_found_also_in_part(shown: float) -> None:
    board = Board(7, 5, 0.03, Charuco("5X5_100", 0.02))
    picture = printed(*board_page(board), px_per_mm=4.0)
    part = picture[:, : int(shown * picture.shape[1])]
    corners = find_corners(part, board)
    assert corners is not None
    assert (len(corners.ids) == 35) == (shown == 1.0)
    whole = find_corners(picture, board)
    assert whole is not None
    np.testing.assert_allclose(corners.pixels, whole.pixels[corners.ids], atol=0.1)
    steps = whole.pixels - whole.pixels[0]
    np.testing.assert_allclose(steps, board.points_m[:, :2] / 0.03 * 120, atol=0.2)


def test_both_cameras_number_an_ambiguous_board_alike() -> None:
    board = Board(8, 6, 0.03)
    assert board.turns_into_itself
    corners = find_corners(printed(*board_page(board)), board)
    assert corners is not None
    other = turned(corners)
    np.testing.assert_array_equal(alike(corners, other).pixels, corners.pixels)
    np.testing.assert_array_equal(alike(corners, corners).pixels, corners.pixels)
    assert not Board(11, 8, 0.03).turns_into_itself


def test_colour_and_grey_give_the_same() -> None:
    board = Board(6, 5, 0.03)
    grey = printed(*board_page(board))
    a, b = find_corners(grey, board), find_corners(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), board)
    assert isinstance(a, Corners)
    assert isinstance(b, Corners)
    np.testing.assert_array_equal(a.pixels, b.pixels)


def test_nothing_is_found_where_nothing_is() -> None:
    assert find_corners(np.full((200, 300), 128, np.uint8), Board(6, 5, 0.03)) is None
    assert find_corners(np.full((200, 300), 128, np.uint8), Board(6, 5, 0.03, Charuco("4X4_50", 0.02))) is None
