"""The whole of `calibrate cameras` beside OpenCV's findChessboardCorners and stereoCalibrate on the same images.

python -m benchmarks.calibration FOLDER      # with calib_air/ and calib_water/ of 20 pairs each
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from benchmarks.side_by_side import seconds
from leadline.calibration.board import Board
from leadline.pipeline.calibrate_cameras import calibrate

BOARD = Board(11, 8, 0.030)
MOST = 2.0


def opencv(folder: Path) -> None:
    """Corners without refinement, both cameras' intrinsics, then the pair, for each set."""
    points = BOARD.points_m.astype(np.float32)
    for name in ("calib_air", "calib_water"):
        found: dict[str, list[np.ndarray]] = {"left": [], "right": []}
        size = (0, 0)
        for side, sets in found.items():
            for file in sorted((folder / name).glob(f"{side}*")):
                image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
                size = (image.shape[1], image.shape[0])
                sets.append(np.asarray(cv2.findChessboardCorners(image, BOARD.size)[1], np.float32).reshape(-1, 1, 2))
        boards = [points] * len(found["left"])
        (_, K1, D1, *_), (_, K2, D2, *_) = (
            cv2.calibrateCamera(boards, found[side], size, None, None) for side in ("left", "right")
        )
        flags = cv2.CALIB_USE_INTRINSIC_GUESS
        cv2.stereoCalibrate(boards, found["left"], found["right"], K1, D1, K2, D2, size, flags=flags)


def main(folder: Path) -> bool:
    """Print both times; whether ours is within twice OpenCV's."""
    with tempfile.TemporaryDirectory() as scratch:
        rig = Path(scratch) / "rig.yaml"
        taken = seconds(
            {
                "ours": lambda: calibrate(BOARD, rig, air=folder / "calib_air", water=folder / "calib_water"),
                "OpenCV": lambda: opencv(folder),
            },
            rounds=3,
        )
    ratio = taken["ours"] / taken["OpenCV"]
    told = " and ".join(f"{name} {value:.2f} s" for name, value in taken.items())
    print(f"calibrate cameras: {told}, ratio {ratio:.2f} (at most {MOST:g})")
    return ratio <= MOST


if __name__ == "__main__":
    sys.exit(0 if main(Path(sys.argv[1])) else 1)
