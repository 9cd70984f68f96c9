"""What users get wrong with a calibration is said in one line, or stands in the verdict."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration_scenes import BOARD, SIZE, board_views, random_rig
from leadline.calibration.board import Board, find_corners
from leadline.calibration.cameras import CameraCalibration, calibrate_cameras
from leadline.calibration.checks import check_sides
from leadline.calibration.heldout import check_rig
from leadline.calibration.verdict import Verdict, best_images, cross_check, verdict
from leadline.calibration.views import BoardView
from leadline.cli import main
from leadline.errors import InputError
from leadline.geometry import Pose
from leadline.pipeline.calibrate_cameras import find_boards
from leadline.rig import Rig
from leadline.rig_derivatives import Medium
from leadline.wire.calibration_folder import read_calibration_folder

Views = list[BoardView]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return random_rig(np.random.default_rng(3))


@pytest.fixture(scope="module")
def air(rig: Rig) -> Views:
    return board_views(rig, Medium.AIR, 10, np.random.default_rng(1))[0]


@pytest.fixture(scope="module")
def water(rig: Rig) -> Views:
    return board_views(rig, Medium.WATER, 10, np.random.default_rng(2))[0]


def judged(calibration: CameraCalibration) -> Verdict:
    return verdict(calibration, cross_check(calibration), best_images(calibration))


def doubts(views: Views) -> str:
    return "\n".join(judged(calibrate_cameras(views, BOARD, SIZE)).doubts)


def test_good_images_raise_no_doubt(air: Views, water: Views) -> None:
    calibration = calibrate_cameras(air + water, BOARD, SIZE)
    assert judged(calibration).good
    assert judged(calibration).doubts == ()
    assert calibration.left_out == ()


def one_line(error: pytest.ExceptionInfo[InputError]) -> str:
    line = str(error.value)
    assert "\n" not in line
    return line


def test_left_and_right_swapped(air: Views, water: Views) -> None:
    swapped = [BoardView(v.name, v.medium, v.right, v.left) for v in air + water]
    with pytest.raises(InputError) as error:
        calibrate_cameras(swapped, BOARD, SIZE)
    assert "swap the left and right images" in one_line(error)


def test_water_and_air_swapped(air: Views, water: Views) -> None:
    other = {Medium.AIR: Medium.WATER, Medium.WATER: Medium.AIR}
    with pytest.raises(InputError) as error:
        calibrate_cameras([BoardView(v.name, other[v.medium], v.left, v.right) for v in air + water], BOARD, SIZE)
    assert "swap --air and --water" in one_line(error)


def test_all_boards_on_the_dry_side_of_the_glass(rig: Rig, air: Views) -> None:
    dry, _ = board_views(rig, Medium.AIR, 8, np.random.default_rng(5))
    with pytest.raises(InputError) as error:
        calibrate_cameras(air + [dataclasses.replace(v, medium=Medium.WATER) for v in dry], BOARD, SIZE)
    assert "beyond the glass" in one_line(error)


def test_one_board_on_the_dry_side_is_left_out_by_name(rig: Rig, air: Views, water: Views) -> None:
    dry = board_views(rig, Medium.AIR, 1, np.random.default_rng(5))[0][0]
    strange = BoardView("dry.png", Medium.WATER, dry.left, dry.right)
    calibration = calibrate_cameras([*air, *water, strange], BOARD, SIZE)
    assert {o.name for o in calibration.left_out} == {"dry.png"}
    assert "dry.png" in "\n".join(judged(calibration).doubts)


def test_pairs_that_do_not_belong_together(air: Views, water: Views) -> None:
    """Right images one place late: no rig explains them."""
    rights = [v.right for v in water]
    late = [BoardView(v.name, v.medium, v.left, r) for v, r in zip(water, rights[1:] + rights[:1], strict=True)]
    result = judged(calibrate_cameras(air + late, BOARD, SIZE))
    assert not result.good
    assert "do not fit one rig: check the board and the pairs" in result.doubts[0]


def test_two_images_are_refused_and_three_doubted(air: Views, water: Views) -> None:
    with pytest.raises(InputError) as error:
        calibrate_cameras(air + water[:2], BOARD, SIZE)
    assert "found in 2 of 2 images in water" in one_line(error)
    assert "only 3 boards in water" in doubts(air + water[2:5])


def test_all_at_one_distance(rig: Rig, air: Views) -> None:
    same, _ = board_views(rig, Medium.WATER, 10, np.random.default_rng(7), z_m=(0.99, 1.01))
    assert "at about one distance" in doubts(air + same)


def test_boards_in_the_middle_only(rig: Rig) -> None:
    far, _ = board_views(rig, Medium.AIR, 40, np.random.default_rng(6), z_m=(3.0, 4.0))
    central = [v for v in far if v.left is not None and np.abs(v.left.pixels.mean(axis=0) - (960, 540)).max() < 280]
    assert "of the left image: bring them into its corners" in doubts(central)


def test_blurred_images_are_named(air: Views, water: Views) -> None:
    assert water[0].left is not None
    soft = dataclasses.replace(water[0], left=dataclasses.replace(water[0].left, edge_px=9.0))
    assert "1 images are blurred: left_water_00.png" in doubts([*air, soft, *water[1:]])


def drawn(board: Board, square_px: int = 40) -> np.ndarray:
    """The board as a picture, with a white border."""
    rows, columns = board.rows + 1, board.columns + 1
    squares = (np.add.outer(np.arange(rows), np.arange(columns)) % 2 * 255).astype(np.uint8)
    picture = np.kron(squares, np.ones((square_px, square_px), np.uint8))
    return np.pad(picture, square_px, constant_values=255)


def test_blur_is_measured() -> None:
    sharp = drawn(BOARD)
    soft = cv2.GaussianBlur(sharp, (0, 0), 4.0)
    sharp_corners, soft_corners = find_corners(sharp, BOARD), find_corners(soft, BOARD)
    assert sharp_corners is not None
    assert soft_corners is not None
    assert not sharp_corners.blurred
    assert soft_corners.blurred


def test_wrong_board_size_is_not_found() -> None:
    assert find_corners(drawn(BOARD), BOARD) is not None
    assert find_corners(drawn(BOARD), Board(10, 7, 0.03)) is None
    with pytest.raises(InputError) as error:
        calibrate_cameras([BoardView(f"{i}.png", Medium.AIR, None) for i in range(5)], BOARD, SIZE)
    assert "INNER corners" in one_line(error)


@pytest.mark.parametrize(("size", "square", "told"), [("11x8", 30.0, "0.03"), ("11", 0.03, "11x8"), ("2x8", 0.03, "3")])
def test_board_given_wrongly(size: str, square: float, told: str) -> None:
    with pytest.raises(InputError, match="--") as error:
        Board.parse(size, square)
    assert told in one_line(error)


def test_port_upside_down(rig: Rig, water: Views) -> None:
    """A housing put on the other way round: its tilt points the other way."""
    assert rig.port is not None
    tilted = dataclasses.replace(rig.port, normal=(np.sin(0.04), 0.0, np.cos(0.04)))
    turned = dataclasses.replace(rig.port, normal=(-np.sin(0.04), 0.0, np.cos(0.04)))
    truth, mistaken = (dataclasses.replace(rig, port=port) for port in (tilted, turned))
    views, _ = board_views(truth, Medium.WATER, 8, np.random.default_rng(4))
    assert check_rig(truth, views, BOARD, SIZE).verdict.good
    result = check_rig(mistaken, views, BOARD, SIZE).verdict
    assert not result.good
    assert "the rig explains the boards" in result.doubts[0]


def test_images_of_another_size(rig: Rig, water: Views) -> None:
    with pytest.raises(InputError) as error:
        check_rig(rig, water, BOARD, (1280, 720))
    assert "1280x720" in one_line(error)


def images(folder: Path, names: list[str]) -> Path:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.zeros((8, 8), np.uint8))
    return folder


def test_unpaired_images(tmp_path: Path) -> None:
    found = read_calibration_folder(images(tmp_path / "a", ["left01.png", "right01.png", "left02.png", "right03.png"]))
    assert [pair.name for pair in found.pairs] == ["left01.png"]
    assert [notice.where for notice in found.notices] == ["left02.png", "right03.png"]
    with pytest.raises(InputError, match="no right images"):
        read_calibration_folder(images(tmp_path / "b", ["left01.png", "left02.png"]))
    with pytest.raises(InputError, match="no names in common"):
        read_calibration_folder(images(tmp_path / "c", ["left1.png", "right2.png", "right3.png"]))
    with pytest.raises(InputError, match="has no images"):
        read_calibration_folder(tmp_path)


def test_pairing(tmp_path: Path) -> None:
    two = read_calibration_folder(
        images(tmp_path / "a", ["left/a2.png", "left/a10.png", "right/a2.png", "right/a10.png"])
    )
    assert [(p.left.name, p.right and p.right.name) for p in two.pairs] == [
        ("a2.png", "a2.png"),
        ("a10.png", "a10.png"),
    ]
    order = read_calibration_folder(images(tmp_path / "b", ["left_x.jpg", "right_y.jpg"]))
    assert len(order.pairs) == 1
    assert "by their order" in order.notices[0].why
    mono = read_calibration_folder(images(tmp_path / "c", ["bc1.png", "bc10.png", "bc2.png"]))
    assert mono.mono
    assert [pair.name for pair in mono.pairs] == ["bc1.png", "bc2.png", "bc10.png"]


def test_side_by_side_images(tmp_path: Path) -> None:
    """``stereo*`` files, or a dive's column ``stereo``: the left half is the left camera's."""
    rng = np.random.default_rng(1)
    both = rng.integers(0, 255, (6, 16), np.uint8)
    for folder in (tmp_path / "plain", tmp_path / "dive"):
        folder.mkdir()
        for i in range(2):
            cv2.imwrite(str(folder / f"stereo_{i}.png"), both)
    (tmp_path / "dive" / "frames.csv").write_text("t_s,stereo\n0,stereo_0.png\n1,stereo_1.png\n")
    for folder in (tmp_path / "plain", tmp_path / "dive"):
        found = read_calibration_folder(folder)
        assert not found.mono
        assert len(found.files()) == 2
        left, right = found.pairs[1].load()
        np.testing.assert_array_equal(left, both[:, :8])
        np.testing.assert_array_equal(right, both[:, 8:])
    cv2.imwrite(str(tmp_path / "plain" / "stereo_0.png"), both[:, 1:])
    with pytest.raises(InputError, match="even width"):
        read_calibration_folder(tmp_path / "plain").pairs[0].load()


def test_boards_are_found_in_side_by_side_images(tmp_path: Path) -> None:
    picture = drawn(Board(6, 5, 0.03))
    for i in range(2):
        cv2.imwrite(str(tmp_path / f"stereo_{i}.png"), np.hstack([picture, np.full_like(picture, 255 * i) | picture]))
    found = find_boards(tmp_path, Medium.AIR, Board(6, 5, 0.03))
    assert found.size == picture.shape[::-1]
    assert found.not_found == ["stereo_1.png (right)"]
    assert found.views[0].left is not None
    assert found.views[0].right is not None
    np.testing.assert_array_equal(found.views[0].left.pixels, found.views[0].right.pixels)


@pytest.mark.parametrize(
    ("t_m", "told"),
    [
        ((0.0, -0.08, 0.0), None),  # one above the other: the images do not say which is "left"
        ((0.01, 0.08, 0.0), None),
        ((0.08, 0.01, 0.0), "swap the left and right images"),
        ((-63.0, 0.0, 0.0), "--square (metres)"),
        ((-0.001, 0.0, 0.0), "--square (metres)"),
    ],
)
def test_where_the_right_camera_may_stand(t_m: tuple[float, float, float], told: str | None) -> None:
    pose = Pose(np.eye(3), t_m)
    if told is None:
        check_sides(pose)
        return
    with pytest.raises(InputError) as error:
        check_sides(pose)
    assert told in one_line(error)


def test_a_square_in_millimetres(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    call = ["calibrate", "cameras", "--air", str(tmp_path), "--board", "11x8", "--square", "30"]
    assert main([*call, "--out", str(tmp_path / "rig.yaml")]) == 2
    assert "give metres: 0.03" in capsys.readouterr().err
