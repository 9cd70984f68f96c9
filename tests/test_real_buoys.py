"""A real ball by its outline in one uncalibrated camera: 100 frames of an approach, the diameter and the lens assumed.

No truth is known but that the ball comes nearer. Assumed: a field of view of 50 degrees across, no distortion (the
housing's round window is seen at the corners), a ball of 0.2 m; another assumption scales all ranges alike.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline.config import Config
from leadline.geometry import Camera, Pose
from leadline.ranging.outline import OutlineRanger
from leadline.ranging.stereo import Pair
from leadline.recognition.detector import Detector
from leadline.rig import Rig
from leadline.samples import Array, Image, Measurement, StereoFrame
from leadline.target import Sphere

BALL = Sphere(0.2)
WIDTH_PX, HEIGHT_PX = 640, 480
FOCAL_PX = WIDTH_PX / 2 / np.tan(np.deg2rad(25))
FIRST_PX = np.array([45.0, 358.0])  # the yellow one, by hand, in the first frame
LARGEST_PX = 60.0  # the detector also takes the whole scene for a ball


def lone_camera() -> Rig:
    camera = Camera(FOCAL_PX, FOCAL_PX, (WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2, WIDTH_PX, HEIGHT_PX)
    return Rig(camera, camera, Pose(np.eye(3), np.array([-0.06, 0.0, 0.0])))  # the right one is not used


def place(rig: Rig, box: Array) -> Array:
    """A ball (3,) as wide as its box, at its upper end: the lower one is the stalk."""
    x, y, width, height = box
    middle = np.array([[x + width / 2, y + min(width, height) / 2]])
    return np.asarray(rig.rays(middle)[1][0] * BALL.diameter_m * FOCAL_PX / width)


def tracked(folder: Path) -> list[tuple[Image, Array]]:
    """Every frame with the box of the same ball: the detection nearest to the last one."""
    detector, at, found = Detector(), FIRST_PX, []
    for path in sorted(folder.glob("frame*.jpg")):
        image = np.asarray(cv2.imread(str(path)), np.uint8)
        boxes = [np.array(d.box_px) for d in detector.find(StereoFrame(0, image, image)) if d.box_px[2] < LARGEST_PX]
        box = min(boxes, key=lambda b: float(np.linalg.norm(b[:2] + b[2] / 2 - at)))
        at = box[:2] + box[2] / 2
        found.append((image, box))
    return found


@pytest.mark.data
def test_the_ball_comes_nearer_through_the_last_frame(data_dir: Path) -> None:
    rig, ranger = lone_camera(), OutlineRanger(BALL, Config().outline)
    rows = []
    frames = tracked(data_dir / "buoy_approach_frames")
    assert len(frames) == 100
    for number, (image, box) in enumerate(frames):
        size = ranger.measure(number, Pair(image, image, rig), place(rig, box), sides=("left",))
        if isinstance(size, Measurement):
            range_m, gradient = BALL.range(size.z)
            rows.append((number, range_m, float(np.sqrt(gradient @ size.cov @ gradient))))
    number, range_m, sigma_m = np.array(rows).T
    assert len(rows) >= 85
    assert number[-1] == 99
    assert (sigma_m < 0.04 * range_m).all()
    assert range_m[-10:].mean() < 0.9 * range_m[:10].mean()
    farther = range_m - np.minimum.accumulate(range_m)
    assert (farther < 3 * sigma_m).all()
    smooth = np.polyval(np.polyfit(number, range_m, 4), number)
    assert np.std(range_m - smooth) < np.median(sigma_m)
