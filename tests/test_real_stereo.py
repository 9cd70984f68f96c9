"""Real stereo in air against OpenCV's triangulation of the same matched points: a ZED Mini's rectified pairs.

The printed truth is a tape's: 5, 10 and 15 m. The maker's own calibration is a pixel of disparity off, which at these
distances is metres; so the truth bounds the error to 10 %, and OpenCV on the same pixels to 0.5 %.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline.cli import main
from leadline.geometry import Camera, Pose
from leadline.localizer import Localizer
from leadline.ranging import stereo
from leadline.ranging.layout import Prediction
from leadline.ranging.shape_fit import Points
from leadline.ranging.stereo import triangulated
from leadline.ranging.surface_fit import fit_surface
from leadline.recognition.boxes import Boxes
from leadline.rig import Rig
from leadline.samples import Array, StereoFrame
from leadline.sources import open_source
from leadline.target import Surface
from leadline.wire.solutions import read_solutions

F, CX, CY, BASELINE_M = 1400.0, 959.5, 539.5, 0.06302
STATIONS = {"05": (908, 676, 104, 92), "10": (918, 640, 51, 50), "15": (921, 611, 42, 38)}  # the board, boxed by hand
PRINTED_M = [5.0, 10.0, 15.0]

pytestmark = pytest.mark.data


@pytest.fixture(scope="module")
def dive(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("zed")
    lens = Camera(F, F, CX, CY, 1920, 1080)
    Rig(lens, lens, Pose(np.eye(3), [-BASELINE_M, 0, 0])).save(folder / "rig.yaml")
    rows, boxes = ["t_s,left,right"], []
    for number, (station, box) in enumerate(STATIONS.items()):
        names = [f"INDOOR-ZED-M-1080-{side}1-{station}.png" for side in "LR"]
        for name in names:
            shutil.copyfile(data_dir / "zed_mini_board_air" / name, folder / name)
        rows.append(f"{10 * number},{names[0]},{names[1]}")
        boxes.append({"image_id": names[0], "bbox": box, "score": 1.0})
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
    (folder / "boxes.json").write_text(json.dumps(boxes))
    return folder


class Recorder:
    """Keeps the pixels and the points of the last round."""

    left_px: Array
    right_px: Array
    points: Points

    def __call__(self, rig: Rig, expected: Prediction, level: int, shift_px: Array, sigma_px: Array) -> Points:
        self.points = triangulated(rig, expected, level, shift_px, sigma_px)
        self.left_px = rig.project(self.points.p_m)[0]
        right_px = expected.warp.expected_px + shift_px[:, None] * expected.warp.along
        self.right_px = (right_px + 0.5) * 2**level - 0.5
        return self.points


def opencv_triangulates(left_px: Array, right_px: Array) -> Array:
    """Points (N, 3), by the two projection matrices alone."""
    K = np.array([[F, 0, CX], [0, F, CY], [0, 0, 1.0]])
    P_left = K @ np.eye(3, 4)
    P_right = K @ np.column_stack([np.eye(3), [-BASELINE_M, 0, 0]])
    homogeneous = cv2.triangulatePoints(P_left, P_right, left_px.T, right_px.T)
    return np.asarray((homogeneous[:3] / homogeneous[3]).T)


def test_the_same_points_as_opencv(dive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig.load(dive / "rig.yaml")
    ranger = Recorder()
    monkeypatch.setattr(stereo, "triangulated", ranger)
    localizer = Localizer(rig, Surface(), Boxes(dive / "boxes.json"), filtered=False)
    for frame in open_source(str(dive)):
        assert isinstance(frame, StereoFrame)
        solution = localizer.step(frame)
        assert solution is not None
        ours, theirs = ranger.points.p_m, opencv_triangulates(ranger.left_px, ranger.right_px)
        assert len(ours) >= 12
        assert np.linalg.norm(ours - theirs, axis=1) / ours[:, 2] == pytest.approx(0, abs=5e-4)
        length = np.linalg.norm(theirs, axis=1)
        from_opencv = Points(np.zeros_like(theirs), theirs / length[:, None], length, ranger.points.sigma_m)
        fitted = fit_surface(from_opencv, None)
        assert fitted is not None
        assert solution.range_m == pytest.approx(np.linalg.norm(fitted.x[:3]), rel=0.005)
        assert solution.range_m == pytest.approx(np.median(length), rel=0.03)  # flat: the nearest point is no nearer


def test_through_the_command_line(dive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    options = [
        "--rig",
        str(dive / "rig.yaml"),
        "--boxes",
        str(dive / "boxes.json"),
        "--target",
        "surface",
        "--no-filter",
    ]
    assert main(["run", str(dive), *options, "--out", str(out)]) == 0
    solutions = read_solutions(out / "solutions.csv")
    ranges, sigmas = (np.array([getattr(s, n) for s in solutions]) for n in ("range_m", "range_sigma_m"))
    assert ranges == pytest.approx(PRINTED_M, rel=0.10)
    assert (sigmas > 0.001 * ranges).all()  # a thousandth at 5 m is a twentieth of a pixel
    assert "one pixel of disparity" in capsys.readouterr().out
    cost = json.loads((out / "summary.json").read_text())["pixel_cost"]
    assert cost["m_per_px"] == pytest.approx(cost["range_m"] ** 2 / (F * BASELINE_M), rel=0.02)
    assert 1.0 < cost["m_per_px"] < 1.5  # at the middle one of the three, some 10 m
