"""A calibration board as a PDF of plain rectangles: it measures right on paper when it is printed at 100 %.

PDF's unit is 1/72 inch. Written by hand: rectangles and two lines of text need no library, and sizes stay exact.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from leadline.calibration.board import Board, charuco_board
from leadline.files import write_whole

POINTS_PER_M = 72 / 0.0254
_RULER_M = 0.1

Rectangle = tuple[float, float, float, float]
"""x, y from the lower left corner of the page, width, height, metres."""


def board_page(board: Board) -> tuple[tuple[float, float], list[Rectangle]]:
    """The page's width and height, m, and its black rectangles: squares (or markers) and a 100 mm ruler.

    The squares' upper left inner corner is corner 0 of ``Board.points_m``; the square above and left of it is black.
    """
    margin = max(0.6 * board.square_m, 0.012)
    columns, rows = board.columns + 1, board.rows + 1
    foot = 0.014
    width, height = columns * board.square_m + 2 * margin, rows * board.square_m + 2 * margin + foot
    top = height - margin
    s = board.square_m
    # a ChArUco board of OpenCV has its markers in the white squares; both kinds begin with black in the upper left
    rectangles = [
        (margin + c * s, top - (r + 1) * s, s, s) for r in range(rows) for c in range(columns) if (r + c) % 2 == 0
    ]
    rectangles += _markers(board, margin, top)
    ruler = min(_RULER_M, width - 2 * margin)
    rectangles += [(margin, margin * 0.5 + 0.004, ruler, 0.0005)]
    rectangles += [(margin + x, margin * 0.5 + 0.002, 0.0002, 0.004) for x in (0.0, ruler - 0.0002)]
    return (width, height), rectangles


def write_board(path: Path, board: Board) -> tuple[float, float]:
    """Write the PDF; the page's width and height, m. InputError where that cannot be done."""
    (width, height), rectangles = board_page(board)
    kind = "checkerboard" if board.charuco is None else f"ChArUco {board.charuco.dictionary}"
    told = f"{kind}, {board.columns}x{board.rows} inner corners, {board.square_m * 1e3:g} mm squares"
    margin_pt = max(0.6 * board.square_m, 0.012) * POINTS_PER_M
    drawing = [f"{' '.join(f'{v * POINTS_PER_M:.4f}' for v in r)} re f" for r in rectangles]
    note = f"{told}. Print at 100 %: the line must be {min(_RULER_M, width) * 1e3:.0f} mm long. Glue it flat."
    drawing.append(f"BT /F1 7 Tf {margin_pt:.2f} {margin_pt * 0.5:.2f} Td ({note}) Tj ET")
    write_whole(path, _pdf(width * POINTS_PER_M, height * POINTS_PER_M, "\n".join(drawing)))
    return width, height


def _markers(board: Board, margin: float, top: float) -> list[Rectangle]:
    """The black cells of the markers, in the white squares, in OpenCV's order."""
    if board.charuco is None:
        return []
    dictionary = charuco_board(board, board.charuco).getDictionary()
    cells = dictionary.markerSize + 2
    s, side = board.square_m, board.charuco.marker_m
    places = [(r, c) for r in range(board.rows + 1) for c in range(board.columns + 1) if (r + c) % 2 == 1]
    out: list[Rectangle] = []
    for number, (r, c) in enumerate(places):
        bits = np.asarray(cv2.aruco.generateImageMarker(dictionary, number, cells))
        x, y = margin + c * s + (s - side) / 2, top - r * s - (s - side) / 2
        cell = side / cells
        for i, j in np.argwhere(bits == 0):
            out.append((x + float(j) * cell, y - (float(i) + 1) * cell, cell, cell))
    return out


def _pdf(width: float, height: float, drawing: str) -> bytes:
    objects = [
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>",
        f"<< /Length {len(drawing)} >>\nstream\n{drawing}\nendstream",
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    body = b"%PDF-1.4\n"
    places = []
    for number, content in enumerate(objects, start=1):
        places.append(len(body))
        body += f"{number} 0 obj\n{content}\nendobj\n".encode("latin-1")
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    count = len(objects) + 1
    end = f"xref\n0 {count}\n0000000000 65535 f \n{table}trailer\n<< /Size {count} /Root 1 0 R >>\n"
    return body + f"{end}startxref\n{len(body)}\n%%EOF\n".encode("latin-1")
