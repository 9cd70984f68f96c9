"""The rig file: shipped examples, round trip, faults by their path; the rig's views; the rendered boards as a check."""

from __future__ import annotations

import copy
import dataclasses
import json
import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from leadline.errors import InputError
from leadline.geometry import Camera, LayeredPort, Pose
from leadline.rig import Rig, shipped_rigs
from leadline.rig_covariance import RigCovariance
from leadline.water import Water, WaterState

POINTS = np.array([[0.0, 0.0, 1.0], [0.3, -0.1, 0.7], [-0.05, 0.1, 2.2]])


def data(name: str = "rendered") -> dict[str, Any]:
    import leadline.rig  # noqa: PLC0415

    loaded: dict[str, Any] = yaml.safe_load((Path(leadline.rig.__file__).parent / "rigs" / f"{name}.yaml").read_text())
    return loaded


def write(folder: Path, content: dict[str, Any]) -> Path:
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def put(content: dict[str, Any], where: str, value: Any) -> dict[str, Any]:
    """A copy with one entry changed: `port.layers.0.index`; the value `...` removes it."""
    content = copy.deepcopy(content)
    *path, last = [int(part) if part.isdigit() else part for part in where.split(".")]
    place: Any = content
    for part in path:
        place = place[part]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return content


def test_the_rendered_rig_is_the_one_of_its_readme() -> None:
    rig = Rig.load("rendered")
    assert (rig.left.fx, rig.left.cx, rig.left.cy, rig.left.distortion) == (1400.0, 940.0, 535.0, ())
    assert rig.baseline_m == 0.063
    assert rig.port is not None
    assert (rig.port.distance_m, rig.port.layers, rig.port.outside_index) == (0.01, ((0.002, 1.52),), 1.335)
    assert rig.laser is not None
    assert (rig.laser.range_scale, rig.laser.range_offset_m, rig.laser.group_index) == (1.004, 0.012, 1.35656)


def test_the_paper_s_rig_gives_the_paper_s_focal_length_in_water() -> None:
    """Table 1: 1401.8 px in air, 1869.3 px in water. Refraction alone, from the first, gives the second to 0.2 %."""
    rig = Rig.load("paper")
    left, right = rig.fit_pinhole_water()
    assert rig.pinhole_water is not None
    assert left.fx == pytest.approx(rig.pinhole_water[0].fx, rel=2e-3)
    assert right.fy == pytest.approx(rig.pinhole_water[1].fy, rel=3e-3)


@pytest.mark.parametrize("name", shipped_rigs())
def test_a_saved_rig_reads_back_the_same(name: str, tmp_path: Path) -> None:
    rig = Rig.load(name)
    names = ("left.fx_px", "laser.direction[1]", "water.index")
    rig = dataclasses.replace(rig, covariance=RigCovariance(names, np.diag([0.3, 1e-6, 2e-8])))
    rig.save(tmp_path / "a.yaml")
    again = Rig.load(tmp_path / "a.yaml")
    again.save(tmp_path / "b.yaml")
    assert (tmp_path / "a.yaml").read_text() == (tmp_path / "b.yaml").read_text()
    for mine, theirs in zip(rig.project(POINTS), again.project(POINTS), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_array_equal(again.laser_point(1.0)[1], rig.laser_point(1.0)[1])
    assert again.provenance == rig.provenance
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.yaml", "b.yaml"]


def test_saving_is_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "rig.yaml"
    Rig.load("paper").save(path)
    before = path.read_text()

    def full_disk(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[:100])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(InputError, match="No space left"):
        Rig.load("rendered").save(path)
    assert path.read_text() == before
    assert [p.name for p in tmp_path.iterdir()] == ["rig.yaml"]


FAULTS = [
    ("port.layers.0.index", 1.0, r"port\.layers\[0\]\.index: must be greater than 1"),
    ("port.layers.0.thickness_m", -0.002, r"port\.layers\[0\]\.thickness_m"),
    ("port.layers.0.thickness_m", 2.5, r"port\.layers\[0\]\.thickness_m"),
    ("port.normal", [0, 0, 2], r"port\.normal: must be a unit vector"),
    ("port.normal", [0, 0, -1], r"port\.normal: must point away"),
    ("port.normal", [0, 0], r"port\.normal\[2\]: is missing"),
    ("port.distance_m", -0.01, r"port\.distance_m"),
    ("port.glass", 1, r"port\.glass: this key is not known"),
    ("left.fx_px", float("nan"), r"left\.fx_px: must be a finite number"),
    ("left.fx_px", -1400, r"left\.fx_px: must be greater than 0"),
    ("left.fx_px", True, r"left\.fx_px: must be a number"),
    ("left.fx_px", "wide", r"left\.fx_px: must be a valid number"),
    ("left.distortion", [0.1, 0.2], r"left\.distortion: must have 0, 4, 5, 8 or 12"),
    ("left.distortion", [0.1, float("inf"), 0, 0], r"left\.distortion\[1\]"),
    ("left.model", "fisheye", r"left\.model"),
    ("right.width_px", 0, r"right\.width_px"),
    ("right.width_px", ..., r"right\.width_px: is missing"),
    ("T_right_left.R.0.0", 0.5, r"T_right_left\.R: must be a rotation"),
    ("T_right_left.t_m", [0, 0, 0], r"T_right_left\.t_m: its length, the baseline"),
    ("T_right_left.t_m", [-63.0, 0, 0], r"T_right_left\.t_m: its length, the baseline"),
    ("T_right_left.t_m", [-0.063, 0, -0.02], r"port \(seen from the right camera\)\.distance_m"),
    ("water.index", 0.99, r"water\.index\.blue: must be greater than 1"),
    ("water.group_index", ..., r"water\.group_index: is missing"),
    ("water", {}, r"water: give temperature_c"),
    ("water", {"temperature_c": 90}, r"water\.temperature_c: 90 is outside"),
    ("water", {"index": 1.335, "group_index": 1.35, "salinity": 35}, r"water: salinity and depth_m need temperature_c"),
    ("port", ..., r"port: is missing, and a rig in water has one"),
    ("laser.direction", [0, 0, 0.5], r"laser\.direction: must be a unit vector"),
    ("laser.direction_medium", "glass", r"laser\.direction_medium"),
    ("laser.range_scale", 0, r"laser\.range_scale"),
    ("laser.wavelength_nm", 1064, r"laser\.wavelength_nm"),
    ("T_body_left", {"R": [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "t_m": [0, 0, 0]}, r"T_body_left\.R: must be a rotation"),
    (
        "covariance",
        {"names": ["left.zoom"], "matrix": [[1]]},
        r"covariance\.names\[0\]: 'left.zoom' is not a parameter",
    ),
    ("covariance", {"names": ["left.fx_px"] * 2, "matrix": [[1, 0], [0, 1]]}, r"covariance\.names: one stands twice"),
    ("covariance", {"names": ["left.fx_px"], "matrix": [[1, 2]]}, r"covariance\.matrix: must be 1x1"),
    ("covariance", {"names": ["left.fx_px"], "matrix": [[-1]]}, r"covariance\.matrix: has a variance below 0"),
    (
        "covariance",
        {"names": ["left.fx_px", "water.index"], "matrix": [[1, 2e-3], [2e-3, 1e-6]]},
        r"covariance\.matrix: is not positive semidefinite",
    ),
    (
        "covariance",
        {"names": ["left.fx_px", "water.index"], "matrix": [[1, 2e-4], [0, 1e-6]]},
        r"covariance\.matrix: is not symmetric",
    ),
    ("version", 2, r"version: 2 is not known"),
    ("format", "calibmar", "is not a rig file"),
    ("speed", 1, "speed: this key is not known"),
]


@pytest.mark.parametrize(("where", "value", "message"), FAULTS, ids=[f"{w}={v!s:.24}" for w, v, _ in FAULTS])
def test_a_fault_is_named_by_its_path_in_one_line(where: str, value: Any, message: str, tmp_path: Path) -> None:
    whole = "." not in where and value is not ...
    content = data() | {where: value} if whole else put(data(), where, value)
    path = write(tmp_path, content)
    with pytest.raises(InputError, match=message) as caught:
        Rig.load(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"left: [1, 2", "is not YAML"),
        (b"", "is not a rig file"),
        (b"- 1\n", "is not a rig file"),
        (b"\xff\xfe\x00", "text|YAML"),
    ],
)
def test_a_file_that_is_no_rig_file(text: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_bytes(text)
    with pytest.raises(InputError, match=message):
        Rig.load(path)


def test_a_missing_file_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        Rig.load(tmp_path / "none.yaml")


def test_numbers_that_yaml_takes_for_text_are_read(tmp_path: Path) -> None:
    """YAML 1.1 wants a point in 1.0e-2; people write 1e-2."""
    path = write(tmp_path, put(data(), "port.distance_m", "1e-2"))
    port = Rig.load(path).port
    assert port is not None
    assert port.distance_m == 0.01


def test_almost_unit_vectors_are_put_right(tmp_path: Path) -> None:
    rig = Rig.load(write(tmp_path, put(data(), "laser.direction", [-0.061, -0.026, 0.998])))
    assert rig.laser is not None
    assert np.linalg.norm(rig.laser.direction) == pytest.approx(1, abs=1e-15)


def test_a_direction_measured_in_air_bends_at_a_slanted_window(tmp_path: Path) -> None:
    content = put(data(), "laser.direction_medium", "air")
    content["laser"]["direction"] = [0.0, 0.0, 1.0]
    a = np.radians(5)
    content["laser"]["window_normal"] = [float(np.sin(a)), 0.0, float(np.cos(a))]
    rig = Rig.load(write(tmp_path, content))
    assert rig.laser is not None
    bent = a - np.arcsin(np.sin(a) / 1.335)  # towards the normal
    np.testing.assert_allclose(rig.laser.direction, [np.sin(bent), 0, np.cos(bent)], atol=1e-12)
    del content["laser"]["window_normal"]  # square to its window: as it is
    straight = Rig.load(write(tmp_path, content)).laser
    assert straight is not None
    np.testing.assert_allclose(straight.direction, [0, 0, 1])


def test_an_in_air_rig_has_no_port_and_no_water(tmp_path: Path) -> None:
    content = put(put(data(), "port", ...), "water", ...)
    rig = Rig.load(write(tmp_path, content))
    left, right = rig.project([[0.1, 0.2, 1.0]])
    np.testing.assert_allclose(left, [[940 + 140, 535 + 280]])
    np.testing.assert_allclose(right, [[940 + 140 - 88.2, 535 + 280]])
    assert rig.laser is not None
    assert rig.laser.group_index == 1.0
    origins, directions = rig.rays(right, "right")
    np.testing.assert_allclose(origins, [[0.063, 0, 0]])
    assert np.linalg.norm(np.cross(directions, np.array([[0.1, 0.2, 1.0]]) - origins)) < 1e-12
    assert rig.fit_pinhole_water() == (rig.left, rig.right)


def test_a_port_without_water_stands_in_air(tmp_path: Path) -> None:
    rig = Rig.load(write(tmp_path, put(data(), "water", ...)))
    assert rig.port is not None
    assert rig.port.outside_index == 1.0


def test_a_state_gives_the_indices_and_a_fitted_index_wins(tmp_path: Path) -> None:
    state = {"temperature_c": 20.0, "salinity": 35.0, "depth_m": 0.0}
    water = Rig.load(write(tmp_path, data() | {"water": state})).water
    assert water is not None
    assert (round(water.index, 5), round(water.group_index, 5)) == (1.34151, 1.36380)
    fitted = Rig.load(write(tmp_path, data() | {"water": state | {"index": 1.3401}})).water
    assert fitted is not None
    assert (fitted.index, round(fitted.group_index, 5)) == (1.3401, 1.36380)


def test_other_water_changes_port_and_laser() -> None:
    sea = Rig.load("rendered").in_water(Water.from_state(WaterState(20.0, 35.0)))
    assert sea.port is not None
    assert sea.laser is not None
    assert round(sea.port.outside_index, 5) == 1.34151
    assert round(sea.laser.group_index, 5) == 1.36380


def skewed() -> Rig:
    rig = Rig.load("paper")
    R = cv2.Rodrigues(np.array([0.01, -0.03, 0.02]))[0]
    normal = np.array([0.12, -0.09, 1.0])
    port = LayeredPort(normal / np.linalg.norm(normal), 0.012, ((0.004, 1.49),), 1.34)
    return dataclasses.replace(rig, T_right_left=Pose(R, (-0.0628, 0.0007, -0.0011)), port=port)


@pytest.mark.parametrize("camera", ["left", "right"])
def test_rays_of_both_cameras_pass_through_the_point_in_the_left_frame(camera: Any) -> None:
    rig = skewed()
    pixels = rig.project(POINTS)[0 if camera == "left" else 1]
    origins, directions = rig.rays(pixels, camera)
    along = np.einsum("ij,ij->i", POINTS - origins, directions)
    np.testing.assert_allclose(origins + along[:, None] * directions, POINTS, atol=1e-12)
    assert rig.port is not None
    np.testing.assert_allclose(origins @ rig.port.normal, rig.port.outer_distance_m, atol=1e-15)


@pytest.mark.parametrize("camera", ["left", "right"])
@pytest.mark.parametrize("in_air", [False, True])
def test_jacobian_is_in_the_left_frame(camera: Any, in_air: bool) -> None:
    rig = dataclasses.replace(skewed(), port=None, water=None) if in_air else skewed()
    pixels, jacobian = rig.project_with_jacobian(POINTS, camera)
    side, h = (0 if camera == "left" else 1), 1e-6
    np.testing.assert_allclose(pixels, rig.project(POINTS)[side], atol=1e-10)
    slopes = [(rig.project(POINTS + h * e)[side] - rig.project(POINTS - h * e)[side]) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(jacobian, np.stack(slopes, axis=2), rtol=1e-6, atol=1e-3)


def test_a_third_camera_is_refused() -> None:
    with pytest.raises(ValueError, match="camera"):
        Rig.load("paper").rays([[0.0, 0.0]], "middle")  # type: ignore[arg-type]


def test_scaled_rig_sees_the_same_scaled() -> None:
    rig = skewed()
    for whole, half in zip(rig.project(POINTS), rig.scaled(0.5).project(POINTS), strict=True):
        np.testing.assert_allclose(half, (whole + 0.5) / 2 - 0.5, atol=1e-9)
    assert rig.scaled(0.5).virtual_focal_px == (812.5, 815.0)
    cov = RigCovariance(("left.fx_px", "port.distance_m"), np.array([[4.0, 0.1], [0.1, 0.01]]))
    scaled = dataclasses.replace(rig, covariance=cov).scaled(0.5).covariance
    np.testing.assert_allclose(scaled.matrix, [[1.0, 0.05], [0.05, 0.01]])


def test_laser_point_carries_the_calibration_s_covariance() -> None:
    rig = Rig.load("rendered")
    assert rig.laser is not None
    _, reading = rig.laser_point(2.0)
    names = ("laser.origin_m[0]", "water.index", "laser.direction[1]")
    known = dataclasses.replace(rig, covariance=RigCovariance(names, np.diag([1e-6, 1.0, 4e-6])))
    point, cov = known.laser_point(2.0)
    length = rig.laser.length_m(2.0)
    expected = np.diag([1e-6, 0, 0]) + length**2 * 4e-6 * np.outer(
        v := np.array([0.0, 1, 0]) - rig.laser.direction[1] * rig.laser.direction, v
    )
    np.testing.assert_allclose(cov - reading, expected, atol=1e-12)
    np.testing.assert_allclose(point, rig.laser.point_m(2.0))
    with pytest.raises(ValueError, match="no laser"):
        dataclasses.replace(rig, laser=None).laser_point(1.0)


def test_a_pinhole_fitted_in_water_imitates_the_port() -> None:
    """Within 2 px over the image at the distances of the fit when the pupil may move, as a board's pose lets it."""
    rig = Rig.load("rendered")
    left, right = rig.fit_pinhole_water()
    assert left == right
    assert 1400 * 1.335 < left.fx < 1400 * 1.34
    assert (left.cx, left.cy) == (pytest.approx(940, abs=0.1), pytest.approx(535, abs=0.1))
    air = Camera(1400, 1400, 940, 535, 1920, 1080)
    seen, _ = rig.project(POINTS)
    assert np.abs(left.project(POINTS) - seen).max() < 30 < np.abs(air.project(POINTS) - seen).max()


def test_a_rig_can_be_sent_to_another_process() -> None:
    rig = pickle.loads(pickle.dumps(Rig.load("paper")))
    np.testing.assert_array_equal(rig.project(POINTS)[1], Rig.load("paper").project(POINTS)[1])


# The renderer's boards: refraction that comes from traced light, not from our formula.

BOARD = np.array([(i * 0.03, j * 0.03, 0.0) for j in range(8) for i in range(11)])


def board_misfit_px(rig: Rig, folder: Path) -> float:
    """RMS of all corners of all boards against the renderer's true pixels."""
    errors = []
    for frame in json.loads((folder / "truth.json").read_text())["frames"]:
        points = Pose(frame["R_board_left"], frame["t_board_left_m"]).apply(BOARD)
        left, right = rig.project(points)
        errors += [left - np.array(frame["corners_left_px"]), right - np.array(frame["corners_right_px"])]
    return float(np.sqrt(np.mean(np.square(errors))))


def with_port(rig: Rig, **change: Any) -> Rig:
    assert rig.port is not None
    return dataclasses.replace(rig, port=dataclasses.replace(rig.port, **change))


@pytest.mark.data
def test_the_right_rig_fits_the_rendered_boards_and_injected_errors_show(data_dir: Path) -> None:
    rig, folder = Rig.load("rendered"), data_dir / "rendered_dives" / "calib_water"
    assert board_misfit_px(rig, folder) < 0.03
    a = np.radians(3)
    wrong = {
        "index 0.01 too high": with_port(rig, outside_index=1.345),
        "port tilted by 3 degrees": with_port(rig, normal=(np.sin(a), 0, np.cos(a))),
        "port 5 mm further": with_port(rig, distance_m=0.015),
        "no glass": with_port(rig, layers=()),
        "baseline 0.5 mm longer": dataclasses.replace(rig, T_right_left=Pose(np.eye(3), (-0.0635, 0, 0))),
    }
    misfits = {name: board_misfit_px(other, folder) for name, other in wrong.items()}
    assert min(misfits.values()) > 0.06, misfits  # 2 mm of glass left out is the smallest
    assert misfits["index 0.01 too high"] > 1
    assert misfits["port tilted by 3 degrees"] > 5


@pytest.mark.data
def test_without_a_port_the_air_boards_fit(data_dir: Path) -> None:
    rig, folder = Rig.load("rendered"), data_dir / "rendered_dives" / "calib_air"
    assert board_misfit_px(dataclasses.replace(rig, port=None, water=None), folder) < 0.03
    assert board_misfit_px(rig, folder) > 100


@pytest.mark.data
def test_corners_found_in_the_rendered_pictures_lie_where_the_rig_says(data_dir: Path) -> None:
    """The pictures themselves (their truth file could share a formula with us): three boards, OpenCV's detector."""
    rig, folder = Rig.load("rendered"), data_dir / "rendered_dives" / "calib_water"
    tilted = with_port(rig, normal=(np.sin(np.radians(3)), 0, np.cos(np.radians(3))))
    misfits = {"right": [], "index": [], "tilt": []}  # type: dict[str, list[float]]
    for frame in json.loads((folder / "truth.json").read_text())["frames"][:3]:
        image = cv2.imread(str(folder / frame["left"]), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        found, corners = cv2.findChessboardCornersSB(image, (11, 8), flags=cv2.CALIB_CB_ACCURACY)
        assert found
        corners = corners.reshape(-1, 2)  # OpenCV 4 gives (N, 1, 2), OpenCV 5 (N, 2)
        corners = corners if corners[0, 0] < corners[-1, 0] else corners[::-1]
        points = Pose(frame["R_board_left"], frame["t_board_left_m"]).apply(BOARD)
        for name, other in {"right": rig, "index": with_port(rig, outside_index=1.345), "tilt": tilted}.items():
            misfits[name].append(float(np.sqrt(np.mean((other.project(points)[0] - corners) ** 2))))
    assert max(misfits["right"]) < 0.2, misfits
    assert np.mean(misfits["index"]) > 1, misfits
    assert min(misfits["tilt"]) > 5, misfits


@pytest.mark.parametrize("name", ["rendered", "paper"])
def test_with_target_motion_the_right_camera_sees_the_target_where_it_went(name: str) -> None:
    """Projection, its derivative and the right rays agree; triangulation gives the place at the left exposure."""
    rig = Rig.load(name)
    d_m, p_m = np.array([0.004, -0.003, -0.006]), np.array([[0.05, 0.1, 0.9], [-0.1, 0.0, 0.5]])
    moved = rig.with_target_motion(d_m)
    left_px, right_px = rig.project(p_m)[0], rig.project(p_m + d_m)[1]
    np.testing.assert_allclose(moved.project(p_m), (left_px, right_px), atol=1e-9)
    seen_px, jacobian = moved.project_with_jacobian(p_m, "right")
    np.testing.assert_allclose(seen_px, right_px, atol=1e-9)
    np.testing.assert_allclose(jacobian, rig.project_with_jacobian(p_m + d_m, "right")[1])
    origins, directions = moved.rays(right_px, "right")
    np.testing.assert_allclose(np.cross(p_m - origins, directions), 0, atol=1e-9)
    np.testing.assert_allclose(moved.triangulate(left_px, right_px)[0], p_m, atol=1e-7)
    assert np.abs(rig.triangulate(left_px, right_px)[0] - p_m).max() > 0.01
    assert moved.laser is rig.laser
