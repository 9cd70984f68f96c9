"""Rigs from and for other programs: calibmar's flat-port YAML, OpenCV's stereo YAML, the ROS camera_info pair.

OpenCV and ROS know no port. What they get of a rig in water is its in-water pinhole, the best they can use; what comes
from them is a rig without a port. All three are read into the same ``Rig``.

calibmar (one file a camera; the second has its pose): ``model``, ``parameters``, ``non_svp_model: FLATPORT``,
``non_svp_parameters: [Nx, Ny, Nz, int_dist, int_thick, na, ng, nw]``, ``cam_to_world_rotation_rowmajor`` and
``cam_to_world_translation`` with X_world = R X_camera + t; lengths in metres, pixels as OpenCV's. OpenCV: M1 D1 M2 D2 R
T (its samples' names) or cameraMatrix1 distCoeffs1 ...; right-from-left, T in metres. ROS: P[0, 3] of the right camera
is -fx times the baseline.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from leadline.errors import InputError
from leadline.files import write_whole
from leadline.geometry import Camera, LayeredPort, Pose
from leadline.rig import Rig
from leadline.samples import Array
from leadline.water import Water, WaterState

_OPENCV_NAMES = {
    "M1": ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "left_camera_matrix", "camera_matrix_left"),
    "D1": ("D1", "distCoeffs1", "dist_coeffs_1", "left_distortion_coefficients", "distortion_left"),
    "M2": ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "right_camera_matrix", "camera_matrix_right"),
    "D2": ("D2", "distCoeffs2", "dist_coeffs_2", "right_distortion_coefficients", "distortion_right"),
    "R": ("R", "rotation", "rotation_matrix"),
    "T": ("T", "translation", "translation_vector"),
}
_SIZES = (("image_width", "image_height"), ("imageWidth", "imageHeight"), ("width", "height"))
_CALIBMAR = {  # model -> indices of fx, fy, cx, cy and of the distortion in its parameters
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "PINHOLE": ((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3, None, None, None)),
    "RADIAL": ((0, 0, 1, 2), (3, 4, None, None)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
}
_METRES = "lengths must be in metres"


def read_foreign(files: Sequence[Path], size: tuple[int, int] | None = None) -> Rig:
    """A rig from one or two files of another program, told apart by their keys. ``size``: width and height, for an
    OpenCV file that has none. InputError names the file and what is missing."""
    read = [(path, _parsed(path)) for path in files]
    first = read[0][1]
    for marks, reader in _READERS:
        if any(mark in first for mark in marks):
            return reader(read, size)
    fix = "give calibmar's YAML, OpenCV's stereo YAML or two ROS camera_info files"
    raise InputError("is of no known format", str(files[0]), fix)


def write_opencv(path: Path, rig: Rig) -> None:
    """OpenCV's stereo YAML: M1 D1 M2 D2 R T, rectification R1 R2 P1 P2 Q, image size. InputError if it cannot be."""
    left, right = _pinholes(rig)
    R1, R2, P1, P2, Q = _rectified(rig, left, right)
    matrices = {"M1": left.matrix, "D1": _coefficients(left), "M2": right.matrix, "D2": _coefficients(right)}
    matrices |= {"R": rig.T_right_left.R, "T": rig.T_right_left.t_m.reshape(3, 1)}
    matrices |= {"R1": R1, "R2": R2, "P1": P1, "P2": P2, "Q": Q}
    parts = ["%YAML:1.0", "---", f"image_width: {left.width}", f"image_height: {left.height}"]
    for name, matrix in matrices.items():
        values = ", ".join(f"{value!r}" for value in np.asarray(matrix, np.float64).ravel().tolist())
        rows, columns = np.atleast_2d(matrix).shape
        parts += [f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d"]
        parts += [f"   data: [ {values} ]"]
    write_whole(path, "\n".join(parts) + "\n")


def write_camera_info(folder: Path, rig: Rig) -> list[Path]:
    """``left.yaml`` and ``right.yaml`` for ROS (camera_calibration_parsers). InputError where that cannot be done."""
    left, right = _pinholes(rig)
    R1, R2, P1, P2, _ = _rectified(rig, left, right)
    out = []
    for name, lens, R, P in (("left", left, R1, P1), ("right", right, R2, P2)):
        data = {
            "image_width": lens.width,
            "image_height": lens.height,
            "camera_name": name,
            "camera_matrix": _matrix(lens.matrix),
            "distortion_model": "plumb_bob" if len(lens.distortion) <= 5 else "rational_polynomial",
            "distortion_coefficients": _matrix(_coefficients(lens)),
            "rectification_matrix": _matrix(R),
            "projection_matrix": _matrix(P),
        }
        path = folder / f"{name}.yaml"
        write_whole(path, yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120))
        out.append(path)
    return out


def _pinholes(rig: Rig) -> tuple[Camera, Camera]:
    return rig.pinhole_water or rig.fit_pinhole_water()


def _rectified(rig: Rig, left: Camera, right: Camera) -> tuple[Array, ...]:
    found = cv2.stereoRectify(
        left.matrix, _coefficients(left), right.matrix, _coefficients(right), (left.width, left.height),
        rig.T_right_left.R, rig.T_right_left.t_m.reshape(3, 1), alpha=0,
    )  # fmt: skip
    return tuple(np.asarray(matrix, np.float64) for matrix in found[:5])


def _coefficients(lens: Camera) -> Array:
    count = 5 if len(lens.distortion) <= 5 else 8
    return np.array([[*lens.distortion, *(0.0,) * (count - len(lens.distortion))]])


def _matrix(values: Array) -> dict[str, Any]:
    rows, columns = np.atleast_2d(values).shape
    return {"rows": rows, "cols": columns, "data": np.asarray(values).ravel().tolist()}


def _parsed(path: Path) -> dict[str, Any]:
    """YAML, also OpenCV's kind (its first line and its tag are not YAML 1.1)."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("cannot be read", str(path), "check the path") from error
    text = re.sub(r"^%YAML.*\n(---\s*\n)?", "", text).replace("!!opencv-matrix", "")
    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InputError("is not YAML", str(path), str(error)) from error
    if not isinstance(data, dict):
        raise InputError("is not a calibration", str(path), "give a YAML file with named values")
    return data


def _values(path: Path, data: dict[str, Any], name: str, count: int | None = None) -> Array:
    """The numbers of a matrix (``data`` within) or of a list. InputError names what is missing."""
    value = data.get(name)
    value = value.get("data") if isinstance(value, dict) else value
    try:
        numbers = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        numbers = np.full(1, np.nan)
    if not np.isfinite(numbers).all() or (count is not None and len(numbers) != count):
        raise InputError(f"{name}: must be {count or 'some'} numbers", str(path), "correct the file")
    return numbers


Read = list[tuple[Path, dict[str, Any]]]


def _made(path: Path, make: Callable[[], Rig]) -> Rig:
    try:
        rig = make()
    except ValueError as error:
        raise InputError(str(error), str(path), "correct the file") from error
    if not 0 < rig.baseline_m < 10:
        raise InputError(f"the baseline comes out {rig.baseline_m:g} m", str(path), _METRES)
    return rig


def _from_opencv(read: Read, size: tuple[int, int] | None) -> Rig:
    path, data = read[0][0], {key: value for _, part in read for key, value in part.items()}
    named = {name: next((k for k in others if k in data), None) for name, others in _OPENCV_NAMES.items()}
    missing = [name for name, key in named.items() if key is None]
    if missing:
        fix = "give the file with the stereo calibration; OpenCV's sample writes two, name both"
        raise InputError(f"{missing[0]}: is missing", str(path), fix)
    key = {name: str(found) for name, found in named.items()}
    width, height = size or _size(path, data)

    def lens(matrix: str, distortion: str) -> Camera:
        fx, _, cx, _, fy, cy, *_ = _values(path, data, key[matrix], 9)
        return Camera(fx, fy, cx, cy, width, height, tuple(_values(path, data, key[distortion])))

    def make() -> Rig:
        R = _values(path, data, key["R"])
        pose = Pose(cv2.Rodrigues(R)[0] if len(R) == 3 else R.reshape(3, 3), _values(path, data, key["T"], 3))
        return Rig(lens("M1", "D1"), lens("M2", "D2"), pose)

    return _made(path, make)


def _size(path: Path, data: dict[str, Any]) -> tuple[int, int]:
    for width, height in _SIZES:
        if width in data and height in data:
            return int(data[width]), int(data[height])
    for name in ("size", "imageSize", "image_size"):
        if name in data:
            width_px, height_px = _values(path, data, name, 2)
            return int(width_px), int(height_px)
    raise InputError("has no image size", str(path), "give --size, such as 1920x1080")


def _from_ros(read: Read, _size_given: tuple[int, int] | None) -> Rig:
    if len(read) != 2:
        raise InputError("is one camera's", str(read[0][0]), "give the left and the right camera_info file")
    (path, left), (path_right, right) = read

    def lens(file: Path, data: dict[str, Any]) -> Camera:
        fx, _, cx, _, fy, cy, *_ = _values(file, data, "camera_matrix", 9)
        model = data.get("distortion_model", "plumb_bob")
        if model not in ("plumb_bob", "rational_polynomial"):
            raise InputError(f"distortion_model: {model!r} is not known", str(file), "calibrate again as plumb_bob")
        return Camera(fx, fy, cx, cy, *_size(file, data), tuple(_values(file, data, "distortion_coefficients")))

    def make() -> Rig:
        P = _values(path_right, right, "projection_matrix", 12)
        R1, R2 = (_values(f, d, "rectification_matrix", 9).reshape(3, 3) for f, d in read)
        return Rig(lens(path, left), lens(path_right, right), Pose(R2.T @ R1, R2.T @ np.array([P[3] / P[0], 0.0, 0.0])))

    return _made(path_right, make)


def _from_calibmar(read: Read, _size_given: tuple[int, int] | None) -> Rig:
    if len(read) != 2:
        raise InputError("is one camera's", str(read[0][0]), "give the left and the right camera's file")
    (path, left), (path_right, right) = read

    def make() -> Rig:
        port = _calibmar_port(path, left)
        pose = _calibmar_pose(path_right, right) @ _calibmar_pose(path, left).inverse()
        if port is None:
            return Rig(_calibmar_lens(path, left), _calibmar_lens(path_right, right), pose)
        like = Water.from_state(WaterState(20.0))
        shift = port.outside_index - like.index
        water = Water(like.blue + shift, like.green + shift, like.red + shift, like.group_index + shift)
        return Rig(_calibmar_lens(path, left), _calibmar_lens(path_right, right), pose, port, water)

    return _made(path_right, make)


def _calibmar_lens(path: Path, data: dict[str, Any]) -> Camera:
    model = str(data.get("model"))
    if model not in _CALIBMAR:
        raise InputError(f"model: {model} is not known here", str(path), f"use one of {', '.join(_CALIBMAR)}")
    focal, distortion = _CALIBMAR[model]
    values = _values(path, data, "parameters", max(i for i in (*focal, *distortion) if i is not None) + 1)
    fx, fy, cx, cy = (float(values[i]) for i in focal)
    k = tuple(0.0 if i is None else float(values[i]) for i in distortion)
    return Camera(fx, fy, cx, cy, *_size(path, data), k)


def _calibmar_port(path: Path, data: dict[str, Any]) -> LayeredPort | None:
    kind = str(data.get("non_svp_model", "NONE"))
    if kind.upper() == "NONE":
        return None
    if kind.upper() != "FLATPORT":
        raise InputError(f"non_svp_model: {kind} is not a flat port", str(path), "this program knows flat ports")
    *normal, distance, thickness, air, glass, water = _values(path, data, "non_svp_parameters", 8)
    # indices relative to the air inside, as everywhere here
    return LayeredPort(np.array(normal), distance, ((thickness, glass / air),), water / air)


def _calibmar_pose(path: Path, data: dict[str, Any]) -> Pose:
    """T_camera_world; the identity for the camera without a pose, which is the world."""
    if "cam_to_world_rotation_rowmajor" not in data:
        return Pose.identity()
    R = _values(path, data, "cam_to_world_rotation_rowmajor", 9).reshape(3, 3)
    return Pose(R, _values(path, data, "cam_to_world_translation", 3)).inverse()


_READERS: tuple[tuple[tuple[str, ...], Callable[[Read, tuple[int, int] | None], Rig]], ...] = (
    (("non_svp_model", "parameters"), _from_calibmar),
    (("projection_matrix", "rectification_matrix"), _from_ros),
    (tuple(name for names in _OPENCV_NAMES.values() for name in names), _from_opencv),
)
