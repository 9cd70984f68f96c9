"""`calibrate cameras` and `check` on rendered and real boards: what the project promises."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from leadline.calibration.board import Board, find_corners
from leadline.calibration.cameras import CameraCalibration, CameraSettings, calibrate_cameras
from leadline.calibration.comparison import pinhole_in_water
from leadline.calibration.heldout import check_rig
from leadline.calibration.verdict import verdict
from leadline.calibration.views import BoardView
from leadline.cli import main
from leadline.pipeline.calibrate_cameras import find_boards
from leadline.rig import Rig
from leadline.rig_derivatives import Medium
from leadline.water import WaterState

pytestmark = pytest.mark.data
BOARD = Board(11, 8, 0.030)


@pytest.fixture(scope="module")
def rendered(data_dir: Path) -> Path:
    return data_dir / "rendered_dives"


@pytest.fixture(scope="module")
def views(rendered: Path) -> list[BoardView]:
    sets = [
        find_boards(rendered / name, medium, BOARD)
        for name, medium in (("calib_air", Medium.AIR), ("calib_water", Medium.WATER))
    ]
    return [view for found in sets for view in found.views]


@pytest.fixture(scope="module")
def stated(views: list[BoardView]) -> CameraCalibration:
    return calibrate_cameras(views, BOARD, (1920, 1080), CameraSettings(water_state=WaterState(20.0)))


@pytest.fixture(scope="module")
def wide(views: list[BoardView]) -> CameraCalibration:
    return calibrate_cameras(views, BOARD, (1920, 1080))


@pytest.mark.parametrize("which", ["stated", "wide"])
def test_rendered_rig_is_found(which: str, request: pytest.FixtureRequest) -> None:
    """Truth: port at 10 mm, not tilted, index 1.335; each also within three of its stated sigmas."""
    calibration: CameraCalibration = request.getfixturevalue(which)
    port, fit = calibration.rig.port, calibration.fit
    assert port is not None
    assert abs(port.distance_m - 0.010) < min(1e-3, 3 * fit.sigma("port.distance_m"))
    assert np.degrees(np.arccos(port.normal[2])) < 0.05
    for i in range(2):
        assert abs(port.normal[i]) < 3 * fit.sigma(f"port.normal[{i}]")
    assert abs(port.outside_index - 1.335) < min(1e-3, 3 * fit.sigma("water.index"))
    assert fit.sigma("water.index") < 0.5 * calibration.priors["water.index"].sigma
    assert calibration.left_out == ()


def ranged(rig: Rig, folder: Path, *, detected: bool) -> tuple[float, float]:
    """Mean depth error of the boards' middles, and mean 3D error of all corners, mm, over `ranging_water`."""
    frames = json.loads((folder / "truth.json").read_text())["frames"]
    depth, total = [], []
    for frame in frames:
        true = BOARD.points_m @ np.array(frame["R_board_left"]).T + frame["t_board_left_m"]
        pixels = [np.array(frame[f"corners_{side}_px"]) for side in ("left", "right")]
        if detected:
            found = [
                find_corners(cv2.imread(str(folder / frame[s]), cv2.IMREAD_GRAYSCALE), BOARD) for s in ("left", "right")
            ]
            assert all(found)
            pixels = [c.pixels for c in found if c is not None]
        error = (rig.triangulate(*pixels)[0] - true) * 1e3
        middle = np.argsort(np.linalg.norm(BOARD.points_m - BOARD.points_m.mean(axis=0), axis=1))[:4]
        depth.append(abs(error[middle, 2].mean()))
        total.append(np.linalg.norm(error, axis=1).mean())
    return float(np.mean(depth)), float(np.mean(total))


def test_boards_in_water_are_ranged(stated: CameraCalibration, wide: CameraCalibration, rendered: Path) -> None:
    for calibration in (stated, wide):
        depth, total = ranged(calibration.rig, rendered / "ranging_water", detected=False)
        assert depth <= 0.5
        assert total <= 1.0
    pinhole = pinhole_in_water(wide)
    assert pinhole is not None
    assert 3.0 < ranged(pinhole.rig, rendered / "ranging_water", detected=False)[1] < 6.0  # what refraction costs it


def test_boards_with_detected_corners(stated: CameraCalibration, rendered: Path) -> None:
    depth, total = ranged(stated.rig, rendered / "ranging_water", detected=True)
    assert depth <= 0.6  # 0.3 and 0.8 mm are the corners' own floor
    assert total <= 1.2


def test_near_and_far_expose_a_pinhole(views: list[BoardView]) -> None:
    """Calibrated on half of the boards and checked on the others: ours is good, the in-water pinhole is found out."""
    air, water = views[:20], views[20:]
    calibration = calibrate_cameras(air + water[:10], BOARD, (1920, 1080))
    pinhole = pinhole_in_water(calibration)
    assert pinhole is not None
    assert check_rig(calibration.rig, water[10:], BOARD, (1920, 1080)).verdict.good
    result = check_rig(pinhole.rig, water[10:], BOARD, (1920, 1080))
    assert not result.verdict.good
    assert result.focal is not None
    assert result.focal.sigmas > 5
    assert "the model is wrong" in result.verdict.doubts[0]


def test_command_line(rendered: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig_file = tmp_path / "rig.yaml"
    board = ["--board", "11x8", "--square", "0.030"]
    folders = ["--air", str(rendered / "calib_air"), "--water", str(rendered / "calib_water")]
    assert main(["calibrate", "cameras", *folders, *board, "--out", str(rig_file)]) == 0
    told = capsys.readouterr().out
    for part in ("water's index 1.335", "in-water pinhole", "verdict: good", "next: "):
        assert part in told
    rig = Rig.load(rig_file)
    assert rig.pinhole_water is not None
    assert "port.distance_m" in rig.covariance.names
    assert set(rig.provenance["inputs"]) == {"air", "water"}
    page = rig_file.with_suffix(".html").read_text()
    for part in ("Where the boards were", "Residuals", "Depth error by distance", "What limits it", "<svg"):
        assert part in page
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")  # nothing is fetched
    assert main(["calibrate", "check", "--rig", str(rig_file), "--dive", str(rendered / "ranging_water"), *board]) == 0
    assert "verdict: good" in capsys.readouterr().out


def test_nothing_is_written_where_the_call_is_wrong(rendered: Path, tmp_path: Path) -> None:
    rig_file = tmp_path / "rig.yaml"
    call = ["calibrate", "cameras", "--board", "11x8", "--square", "0.030", "--out", str(rig_file)]
    assert main(call) == 2
    assert main([*call, "--air", str(tmp_path / "no")]) == 2
    assert list(tmp_path.iterdir()) == []


def test_real_stereo_pairs(data_dir: Path) -> None:
    board = Board(9, 6, 0.03)
    found = find_boards(data_dir / "stereo_chessboard_air", Medium.AIR, board)
    assert found.not_found == []
    calibration = calibrate_cameras(found.views, board, found.size)
    assert calibration.rig.port is None
    assert calibration.fit.rms_px <= 0.5
    assert calibration.rig.baseline_m / board.square_m == pytest.approx(3.344, rel=0.01)


@pytest.fixture(scope="module")
def flat_port(data_dir: Path) -> tuple[list[BoardView], list[BoardView]]:
    board, folder = Board(5, 6, 0.0338), data_dir / "flat_port_board_air_water"
    air, water = (find_boards(folder / m, m, board) for m in (Medium.AIR, Medium.WATER))
    return list(air.views), list(water.views)


def test_real_port_one_camera(flat_port: tuple[list[BoardView], list[BoardView]]) -> None:
    air, water = flat_port
    board = Board(5, 6, 0.0338)
    settings = CameraSettings(port_thickness_m=0.0)
    calibration = calibrate_cameras(air + water, board, (648, 486), settings)
    assert calibration.mono
    assert calibration.rig.port is not None
    assert calibration.rig.port.outside_index == pytest.approx(1.333, abs=0.01)
    assert calibration.fit.rms_px <= 0.4
    assert sum(v.medium is Medium.AIR for v in calibration.views) == 13
    assert sum(v.medium is Medium.WATER for v in calibration.views) == 4


def test_a_bad_corner_set_is_caught(data_dir: Path, flat_port: tuple[list[BoardView], list[BoardView]]) -> None:
    """The sector-based detector finds bc1, wrongly; alone it moves fx by 10 px and the index to 1.29."""
    air, water = flat_port
    board = Board(5, 6, 0.0338)
    file = data_dir / "flat_port_board_air_water" / "air" / "bc1.png"
    bad = find_corners(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), board)
    assert bad is not None
    assert bad.slow
    views = [BoardView("bc1.png", Medium.AIR, bad), *(v for v in air if v.name != "bc1.png"), *water]
    calibration = calibrate_cameras(views, board, (648, 486), CameraSettings(port_thickness_m=0.0))
    assert [o.name for o in calibration.left_out] == ["bc1.png"]
    assert calibration.rig.left.fx == pytest.approx(692, abs=3)
    assert calibration.rig.port is not None
    assert calibration.rig.port.outside_index == pytest.approx(1.333, abs=0.01)


def test_one_cameras_file(data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = data_dir / "flat_port_board_air_water"
    out = tmp_path / "camera.yaml"
    call = ["--air", str(folder / "air"), "--water", str(folder / "water"), "--board", "5x6", "--square", "0.0338"]
    assert main(["calibrate", "cameras", *call, "--port-thickness", "0", "--out", str(out)]) == 0
    assert "only 4 boards in water" in capsys.readouterr().out
    data = yaml.safe_load(out.read_text())
    assert data["format"] == "leadline-camera"
    assert data["camera"]["fx_px"] == pytest.approx(692, abs=3)
    assert len(data["covariance"]["matrix"]) == len(data["covariance"]["names"])


def test_air_only_and_water_only(views: list[BoardView]) -> None:
    air = calibrate_cameras(views[:20], BOARD, (1920, 1080))
    assert air.rig.port is None
    assert air.rig.left.fx == pytest.approx(1400, abs=1)
    water = calibrate_cameras(views[20:], BOARD, (1920, 1080), CameraSettings(water_state=WaterState(20.0)))
    assert water.rig.port is not None
    assert abs(water.rig.port.distance_m - 0.010) < 3 * water.fit.sigma("port.distance_m")
    told = next(line for line in verdict(water, None, None).doubts if "no images in air" in line)
    alone, both = map(float, re.findall(r"([\d.]+) mm", told))
    assert 0 < both < 0.8 * alone  # told how much worse, in mm
    assert any("no images in water" in line for line in verdict(air, None, None).doubts)
