"""ROS 2 without ROS: pairs of images, pixels of messages, samples of topics, results as messages."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from leadline.errors import InputError
from leadline.guidance import Guide
from leadline.health import Condition, Part, State
from leadline.rig import Rig
from leadline.samples import LaserRange, Solution, Stage, Status, StereoFrame
from leadline.sources import open_source
from leadline.sources.inbox import Refused, Report
from leadline.sources.ros2 import LEFT_SIDE, RANGE_SIDE, RIGHT_SIDE, StereoTopics, TopicReader
from leadline.wire import ros2_results as results
from leadline.wire.images import encode_png
from leadline.wire.ros2_images import pixels, range_m
from leadline.wire.ros2_messages import camera_infos
from leadline.wire.ros2_pairing import WAITING, Pairing
from leadline.wire.ros2_rig import rig_from_camera_infos

MS = 1_000_000


def as_message(value: Any) -> Any:
    if isinstance(value, dict):
        return SimpleNamespace(**{key: as_message(one) for key, one in value.items()})
    return [as_message(one) for one in value] if isinstance(value, list) else value


def stamped(t_ns: int, **fields: Any) -> Any:
    stamp = SimpleNamespace(sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id="x"), **fields)


def picture(t_ns: int, level: int = 7) -> Any:
    return stamped(t_ns, format="png", data=encode_png(np.full((4, 6), level, np.uint8)))


def distance(t_ns: int, reading_m: float) -> Any:
    return stamped(t_ns, range=np.float32(reading_m), min_range=0.05, max_range=5.0)


def raw(encoding: str, rows: np.ndarray, width: int, pad: int = 0) -> Any:
    rows = np.pad(rows, ((0, 0), (0, pad)))
    return SimpleNamespace(
        encoding=encoding, height=len(rows), width=width, step=rows.shape[1], data=rows.astype(np.uint8).tobytes()
    )


# -- pairing -----------------------------------------------------------------------------------------------------------


def test_images_of_one_stamp_pair_whatever_comes_between() -> None:
    pairing: Pairing[str] = Pairing(20 * MS)
    assert pairing.left(0, "l0") is None
    assert pairing.left(66 * MS, "l1") is None
    pair = pairing.right(66 * MS, "r1")
    assert pair is not None
    assert (pair.left, pair.right, pair.t_ns) == ("l1", "r1", 66 * MS)
    assert pairing.right(0, "r0") is None  # its left was given up with the pair that came after it


def test_cameras_that_expose_apart_pair_with_the_nearest() -> None:
    pairing: Pairing[int] = Pairing(20 * MS)
    pairs = []
    for number in range(5):
        t_ns = number * 66 * MS
        pairing.left(t_ns, number)
        pairs.append(pairing.right(t_ns + 9 * MS, number))
    assert all(pair is not None and pair.left == pair.right for pair in pairs)
    assert pairs[1] is not None
    assert pairs[1].right_ns - pairs[1].left_ns == 9 * MS


def test_beyond_the_tolerance_there_is_no_pair() -> None:
    pairing: Pairing[int] = Pairing(20 * MS)
    pairing.left(0, 1)
    assert pairing.right(21 * MS, 1) is None


def test_a_lost_image_at_a_high_rate_does_not_shift_all_later_pairs() -> None:
    """60 per second, 20 ms tolerance, 3 ms apart: without the half period each left would take the right before it."""
    pairing: Pairing[int] = Pairing(20 * MS)
    pairs = []
    for number in range(30):
        t_ns = number * 16 * MS
        if number != 10:
            pairs.append(pairing.left(t_ns, number))
        pairs.append(pairing.right(t_ns + 3 * MS, number))
    found = [pair for pair in pairs if pair is not None]
    assert [pair.left for pair in found] == [n for n in range(30) if n != 10]
    assert all(pair.left == pair.right for pair in found)


def test_a_camera_that_stays_away_is_not_waited_for_in_memory() -> None:
    pairing: Pairing[int] = Pairing(20 * MS)
    for number in range(1000):
        pairing.left(number * 66 * MS, number)
    assert len(pairing._waiting[0]) == WAITING


# -- pixels and readings -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("encoding", "order"), [("bgr8", [0, 1, 2]), ("rgb8", [2, 1, 0])])
@pytest.mark.parametrize("pad", [0, 5])
def test_colours_and_padded_rows(encoding: str, order: list[int], pad: int) -> None:
    image = np.arange(4 * 5 * 3).reshape(4, 5, 3)
    got, encoded = pixels(raw(encoding, image[..., order].reshape(4, 15), 5, pad))
    assert encoded is None
    np.testing.assert_array_equal(got, image)


def test_grey_alpha_and_bayer() -> None:
    grey = np.arange(20).reshape(4, 5)
    np.testing.assert_array_equal(pixels(raw("mono8", grey, 5))[0], grey)
    four = np.dstack([np.full((4, 5), level) for level in (1, 2, 3, 255)])
    assert pixels(raw("rgba8", four.reshape(4, 20), 5))[0][0, 0].tolist() == [3, 2, 1]
    red = np.zeros((8, 8))
    red[0::2, 0::2] = 200  # rggb: red at even rows and columns
    assert pixels(raw("bayer_rggb8", red, 8))[0][4, 4].tolist() == [0, 0, 200]


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (SimpleNamespace(encoding="16UC1", height=1, width=1, step=2, data=b"ab"), "encoding '16UC1'"),
        (SimpleNamespace(encoding="mono8", height=2, width=3, step=3, data=b"abcde"), "5 bytes are not 2 rows"),
        (SimpleNamespace(encoding="bgr8", height=1, width=3, step=3, data=b"abc"), "3 bytes are not 1 rows"),
        (SimpleNamespace(encoding="mono8", height=0, width=0, step=0, data=b""), "0 bytes"),
        (SimpleNamespace(format="jpeg", data=b"\xff\xd8 cut"), "cut off"),
    ],
)
def test_what_is_no_image_is_said_in_one_line(message: Any, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        pixels(message)


def test_a_float32_gives_back_the_digits_of_the_device() -> None:
    for reading_m in (0.2, 1.234, 2.0471, 0.3333333):
        assert range_m(distance(0, reading_m)) == reading_m
        assert float(np.float32(reading_m)) != reading_m


@pytest.mark.parametrize("reading_m", [0.0, -1.0, 0.01, 5.1, float("inf"), float("-inf"), float("nan")])
def test_no_echo_is_no_reading(reading_m: float) -> None:
    with pytest.raises(ValueError, match="is not a distance"):
        range_m(distance(0, reading_m))


# -- samples -----------------------------------------------------------------------------------------------------------


def test_topics_become_samples() -> None:
    reader = TopicReader(0.02)
    came = [
        (LEFT_SIDE, picture(100 * MS), 130 * MS),
        (RANGE_SIDE, distance(110 * MS, 1.234), 131 * MS),
        (RIGHT_SIDE, picture(104 * MS, 9), 140 * MS),
        (RANGE_SIDE, distance(120 * MS, 0.0), 141 * MS),
    ]
    reading, frame, refused = reader.read(came)
    assert reading == LaserRange(110 * MS, 1.234, None, 131 * MS)
    assert isinstance(frame, StereoFrame)
    assert (frame.t_ns, frame.arrival_ns, frame.left_t_ns, frame.right_t_ns) == (
        102 * MS, 140 * MS, 100 * MS, 104 * MS,
    )  # fmt: skip
    assert frame.encoded is not None
    assert (frame.left[0, 0], frame.right[0, 0]) == (7, 9)
    assert isinstance(refused, Refused)


def test_of_frames_that_piled_up_the_newest_two_are_taken_and_all_readings() -> None:
    reader = TopicReader(0.02)
    came = []
    for number in range(5):
        came += [(LEFT_SIDE, picture(number * 66 * MS), 0), (RIGHT_SIDE, picture(number * 66 * MS), 0)]
        came.append((RANGE_SIDE, distance(number * 66 * MS, 1.0 + number), 0))
    items = reader.read(came)
    assert [item.t_ns // (66 * MS) for item in items if isinstance(item, StereoFrame)] == [3, 4]
    assert len([item for item in items if isinstance(item, LaserRange)]) == 5


def test_a_broken_picture_is_told_and_taken_back() -> None:
    reader = TopicReader(0.02)
    broken = stamped(0, format="jpeg", data=b"nothing")
    (report,) = reader.read([(LEFT_SIDE, broken, 5), (RIGHT_SIDE, picture(0), 6)])
    assert isinstance(report, Report)
    assert report.state is State.GARBAGE
    well, frame = reader.read([(LEFT_SIDE, picture(66 * MS), 70), (RIGHT_SIDE, picture(66 * MS), 71)])
    assert isinstance(well, Report)
    assert well.state is State.OK
    assert isinstance(frame, StereoFrame)


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("ros2:?speed=3", "no option 'speed'"),
        ("ros2:?left=/a&right=/a", "left and right need a topic each"),
        ("ros2:?pair_s=soon", "pair_s=soon is not a number"),
        ("ros2:?pair_s=7", "pair_s=7 is not a time"),
        ("ros2:?left", "'left' is not one option"),
        ("ros2:?left=bad topic!", "'bad topic!' is no name of a topic; write it like"),
        ("ros2:?right=/cam//right", "'/cam//right' is no name of a topic"),
        ("ros2:?range=/1m", "'/1m' is no name of a topic"),
        ("ros2:?left_info=/cam/", "'/cam/' is no name of a topic"),
        ("ros2:+uvc:0", "more than one camera"),
    ],
)
def test_an_address_that_is_none_is_said_in_one_line(address: str, why: str) -> None:
    with pytest.raises(InputError, match=why):
        open_source(address)


@pytest.mark.parametrize("topic", ["/a", "a", "a/b_2", "~/image", "{ns}/image", "_a/B", ""])
def test_a_topic_as_ros_names_it_is_taken(topic: str) -> None:
    assert StereoTopics.parsed({"range": topic}, "ros2:").range == topic


def test_camera_info_is_looked_for_beside_the_images() -> None:
    wanted = StereoTopics(left="/cam/left/image_raw/compressed", right="/cam/right/image_rect").with_infos()
    assert (wanted.left_info, wanted.right_info) == ("/cam/left/camera_info", "/cam/right/camera_info")
    assert StereoTopics().with_infos().left_info == "/leadline/left/camera_info"


def test_a_rig_comes_back_from_its_camera_infos() -> None:
    rig = Rig.load("paper")
    left, right = (as_message(info) for info in camera_infos(rig))
    found = rig_from_camera_infos(left, right)
    np.testing.assert_allclose(found.T_right_left.R, rig.T_right_left.R, atol=1e-12)
    np.testing.assert_allclose(found.T_right_left.t_m, rig.T_right_left.t_m, atol=1e-12)
    lens = (rig.pinhole_water or (rig.left, rig.right))[0]
    assert (found.left.fx, found.left.width) == (lens.fx, lens.width)
    right.p[3] = 0.0
    with pytest.raises(InputError, match="not calibrated"):
        rig_from_camera_infos(left, right)


# -- results -----------------------------------------------------------------------------------------------------------


def test_quaternions_turn_as_their_matrices_do() -> None:
    rng = np.random.default_rng(5)
    rotations = [cv2.Rodrigues(rng.normal(size=3) * scale)[0] for scale in (0.01, 1.0, 3.0) for _ in range(20)]
    rotations += [np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1]), np.eye(3)]
    for R in rotations:
        x, y, z, w = results.quaternion(R)
        assert w >= 0
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        np.testing.assert_allclose(np.eye(3) + 2 * w * cross + 2 * cross @ cross, R, atol=1e-12)


def test_the_frames_of_the_rig() -> None:
    rig = Rig.load("paper")
    T_body_left = Guide(rig).T_body_left
    told = results.rig_transforms(rig, T_body_left, 5)["transforms"]
    assert (told[0]["header"]["frame_id"], told[0]["child_frame_id"]) == ("base_link", "left_camera_optical")
    right_m = told[1]["transform"]["translation"]
    assert right_m["x"] == pytest.approx(rig.baseline_m, rel=1e-3)  # to the right of the left camera
    assert told[2]["child_frame_id"] == "laser"


def test_any_beam_has_a_frame_with_x_along_it() -> None:
    for direction in ([0, 0, 1.0], [0, 1.0, 0], [0, -1.0, 0], [1.0, 0, 0], [0.6, 0.0, 0.8]):
        R = results._forward(np.array(direction))
        np.testing.assert_allclose(R[:, 0], direction, atol=1e-12)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1)


def test_health_in_diagnostics() -> None:
    conditions = [
        Condition(Part.LEFT, State.OK, 0),
        Condition(Part.LASER, State.OFF, 5, "nothing for 2.0 s", "check its power"),
        Condition(Part.DISK, State.SLOW, 5, "takes 300 ms", "use a faster disk"),
    ]
    statuses = results.health_message(conditions, 10**9)["status"]
    assert [status["level"] for status in statuses] == [0, 2, 1]
    assert statuses[1]["name"] == "leadline: laser"
    assert {"key": "advice", "value": "check its power"} in statuses[1]["values"]


def test_guidance_is_json_and_says_when_there_is_nothing_to_say() -> None:
    rig = Rig.load("paper")
    lost = Solution(3 * 10**9 + 7, Stage.SEARCHING, Status.LOST)
    said = json.loads(results.guidance_text(lost, Guide(rig).of(lost))["data"])
    assert said == {"stamp": {"sec": 3, "nanosec": 7}, "status": "lost", "stage": 0}
    near = Solution(
        4, Stage.LASER, Status.VALID, np.array([0.1, 0, 0.25]), np.eye(3) * 1e-6, 0.15, 0.001, np.array([0, 0, -0.1])
    )
    said = json.loads(results.guidance_text(near, Guide(rig).of(near))["data"])
    assert said["alarm"] is True
    assert said["in_reach"] is True
    assert said["bearing_rad"] < 0  # to starboard
    transform = results.target_transform(near)["transforms"][0]
    assert transform["transform"]["translation"] == {"x": 0.1, "y": 0.0, "z": 0.25}
