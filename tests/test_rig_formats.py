"""Rigs from and for OpenCV, ROS and calibmar."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from leadline.cli import main
from leadline.errors import InputError
from leadline.geometry import Camera, Pose
from leadline.rig import Rig
from leadline.rig_parameters import turn
from leadline.wire.rig_formats import read_foreign, write_camera_info, write_opencv

POINTS = np.array([[0.1, -0.05, 0.8], [-0.2, 0.1, 1.5], [0.0, 0.0, 0.4]])


@pytest.fixture
def air_rig() -> Rig:
    left = Camera(1400, 1390, 950, 530, 1920, 1080, (-0.2, 0.1, 1e-3, -2e-3, -0.02))
    right = dataclasses.replace(left, fx=1410, distortion=(-0.18, 0.07, -1e-3, 2e-3, 0.01))
    return Rig(left, right, Pose(turn([0.01, -0.03, 0.02]), [-0.063, 0.002, -0.003]))


def same_pixels(a: Rig, b: Rig) -> None:
    np.testing.assert_allclose(a.project(POINTS), b.project(POINTS), atol=1e-6)


def test_opencv_there_and_back(air_rig: Rig, tmp_path: Path) -> None:
    path = tmp_path / "stereo.yml"
    write_opencv(path, air_rig)
    same_pixels(read_foreign([path]), air_rig)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_allclose(storage.getNode("M1").mat(), air_rig.left.matrix)
    np.testing.assert_allclose(storage.getNode("T").mat().ravel(), air_rig.T_right_left.t_m)


def test_opencv_reads_what_opencv_wrote(air_rig: Rig, tmp_path: Path) -> None:
    """Names as in OpenCV's sample, in two files, without an image size."""
    inside, outside = tmp_path / "intrinsics.yml", tmp_path / "extrinsics.yml"
    for path, matrices in (
        (inside, {"M1": air_rig.left.matrix, "D1": np.array([air_rig.left.distortion])}),
        (outside, {"R": air_rig.T_right_left.R, "T": air_rig.T_right_left.t_m.reshape(3, 1)}),
    ):
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        for name, matrix in matrices.items():
            storage.write(name, matrix)
        if path == inside:
            storage.write("M2", air_rig.right.matrix)
            storage.write("D2", np.array([air_rig.right.distortion]))
        storage.release()
    same_pixels(read_foreign([inside, outside], (1920, 1080)), air_rig)
    with pytest.raises(InputError, match="--size"):
        read_foreign([inside, outside])
    with pytest.raises(InputError, match="R: is missing"):
        read_foreign([inside], (1920, 1080))


def test_ros_there_and_back(air_rig: Rig, tmp_path: Path) -> None:
    left, right = write_camera_info(tmp_path, air_rig)
    back = read_foreign([left, right])
    same_pixels(back, air_rig)
    info = yaml.safe_load(right.read_text())
    P = info["projection_matrix"]["data"]
    assert P[3] == pytest.approx(-P[0] * air_rig.baseline_m, rel=1e-9)
    with pytest.raises(InputError, match="left and the right"):
        read_foreign([left])


def test_a_rig_in_water_goes_out_as_its_pinhole(tmp_path: Path) -> None:
    rig = Rig.load("rendered")
    path = tmp_path / "stereo.yml"
    write_opencv(path, rig)
    back = read_foreign([path])
    assert back.port is None
    assert back.left.fx == pytest.approx(rig.fit_pinhole_water()[0].fx)
    assert 1.3 < back.left.fx / rig.left.fx < 1.4


def calibmar(model: str, parameters: list[float], housing: list[float], pose: Pose | None = None) -> str:
    lines = [f"model: {model}", "# fx, fy, cx, cy, k1, k2, p1, p2", f"parameters: {parameters}"]
    lines += ["non_svp_model: FLATPORT", f"non_svp_parameters: {housing}", "width: 1920", "height: 1080"]
    if pose is not None:
        T = pose.inverse()
        lines += [f"cam_to_world_rotation_rowmajor: {T.R.tolist()}", f"cam_to_world_translation: {T.t_m.tolist()}"]
    return "\n".join(lines)


def test_calibmar_flat_port(tmp_path: Path) -> None:
    rig = Rig.load("rendered")
    housing = [0.0, 0.0, 1.0, 0.010, 0.002, 1.0, 1.52, 1.335]
    lens = [1400.0, 1400.0, 940.0, 535.0, 0.0, 0.0, 0.0, 0.0]
    left, right = tmp_path / "left.yaml", tmp_path / "right.yaml"
    left.write_text(calibmar("OPENCV", lens, housing))
    right.write_text(calibmar("OPENCV", lens, housing, rig.T_right_left))
    same_pixels(read_foreign([left, right]), rig)
    out = tmp_path / "rig.yaml"
    assert main(["calibrate", "convert", str(left), str(right), "--out", str(out)]) == 0
    same_pixels(Rig.load(out), rig)


@pytest.mark.parametrize(
    ("model", "housing", "told"),
    [
        ("OPENCV_FISHEYE", [0, 0, 1, 0.01, 0.002, 1, 1.52, 1.335], "model: OPENCV_FISHEYE"),
        ("OPENCV", [0, 0, 1, 0.01], "non_svp_parameters: must be 8 numbers"),
        ("OPENCV", [0, 0, 2, 0.01, 0.002, 1, 1.52, 1.335], "unit vector"),
    ],
)
def test_calibmar_files_that_are_wrong(model: str, housing: list[float], told: str, tmp_path: Path) -> None:
    path = tmp_path / "left.yaml"
    path.write_text(calibmar(model, [1400.0, 1400.0, 940.0, 535.0, 0, 0, 0, 0], housing))
    other = tmp_path / "right.yaml"
    other.write_text(calibmar("OPENCV", [1400.0, 1400, 940, 535, 0, 0, 0, 0], [0, 0, 1, 0.01, 0.002, 1, 1.5, 1.33]))
    with pytest.raises(InputError, match=told):
        read_foreign([path, other])


def test_millimetres_are_told(air_rig: Rig, tmp_path: Path) -> None:
    path = tmp_path / "stereo.yml"
    write_opencv(path, air_rig)
    path.write_text(path.read_text().replace("-0.063", "-63.0"))
    with pytest.raises(InputError, match="metres"):
        read_foreign([path])


def test_another_file(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("a: 1\n")
    assert main(["calibrate", "convert", str(path), "--out", str(tmp_path / "y.yaml")]) == 2
    path.write_text("{")
    with pytest.raises(InputError, match="not YAML"):
        read_foreign([path])
