"""Real stereo in air through the command line: a ZED Mini's rectified pairs, the board boxed by hand."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from leadline.cli import main
from leadline.geometry import Camera, Pose
from leadline.rig import Rig
from leadline.wire.solutions import read_solutions

BOXES = {"05": (928, 692, 96, 68), "10": (918, 638, 56, 46), "15": (927, 612, 36, 27)}
OPENCV_M = [5.27, 10.62, 16.32]  # OpenCV's chessboard corners in both images, triangulated by OpenCV; printed 5, 10, 15


@pytest.mark.data
@pytest.mark.parametrize(("method", "within"), [("fused", 0.03), ("paper", 0.10)])
def test_a_rig_without_a_port(
    data_dir: Path, tmp_path: Path, method: str, within: float, capsys: pytest.CaptureFixture[str]
) -> None:
    lens = Camera(1400.0, 1400.0, 959.5, 539.5, 1920, 1080)
    Rig(lens, lens, Pose([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [-0.06302, 0, 0])).save(tmp_path / "rig.yaml")
    rows, boxes = ["t_s,left,right"], []
    for number, (station, box) in enumerate(BOXES.items()):
        left, right = (f"INDOOR-ZED-M-1080-{side}1-{station}.png" for side in "LR")
        for name in (left, right):
            shutil.copyfile(data_dir / "zed_mini_board_air" / name, tmp_path / name)
        rows.append(f"{10 * number}.0,{left},{right}")
        boxes.append({"image_id": left, "bbox": box, "score": 1.0})
    (tmp_path / "frames.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "boxes.json").write_text(json.dumps(boxes))
    options = ["--rig", str(tmp_path / "rig.yaml"), "--boxes", str(tmp_path / "boxes.json"), "--target", "surface"]
    arguments = [*options, "--out", str(tmp_path / "run"), "--method", method, "--no-filter"]
    assert main(["run", str(tmp_path), *arguments]) == 0
    ranges = [solution.range_m for solution in read_solutions(tmp_path / "run" / "solutions.csv")]
    assert ranges == pytest.approx(OPENCV_M, rel=within)
    assert "one pixel of disparity is 1." in capsys.readouterr().out  # metres, at the middle distance
    cost = json.loads((tmp_path / "run" / "summary.json").read_text())["pixel_cost"]
    assert cost["m_per_px"] == pytest.approx(cost["range_m"] ** 2 / (1400 * 0.06302), rel=0.02)
