"""Frames and signs of what an autopilot is told, and of what it says of itself."""

from __future__ import annotations

import contextlib
import dataclasses
import socket
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="needs the extra mavlink")

from pymavlink.dialects.v20 import common

from leadline.config import GuidanceConfig
from leadline.errors import InputError
from leadline.geometry.pose import Pose
from leadline.guidance import FORWARD_LOOKING, Guide
from leadline.health import Condition, Part, State
from leadline.rig import Rig
from leadline.samples import LaserRange, Solution, Stage, Status, VehicleMotion
from leadline.sinks.mavlink import MavlinkSink
from leadline.sources.clock import LiveClock
from leadline.sources.mavlink import MavlinkMotion, Mount
from leadline.wire.mavlink import MavlinkLink, MotionReader, heartbeat
from leadline.wire.mavlink_frames import BootClock, camera_motion, frd, ned_to_frd, orientation

RIG = Rig.load("rendered")
TINY = """
name: tiny
path: {start_m: 1.0, end_m: 0.8, speed_m_s: 0.25, dwell_s: 0.0}
camera: {image_width_px: 320, rate_hz: 4.0}
laser: {dropouts: 0.0}
"""
DOWNWARD = Pose([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], [0.3, 0.0, -0.1])


def solution(t_ns=2_000_000_000, p=(0.5, 0.25, 1.0), range_m=0.98, status=Status.VALID, v=(0.0, 0.0, -0.2)) -> Solution:
    return Solution(t_ns, Stage.BOTH, status, np.array(p), np.eye(3) * 1e-4, range_m, 0.01, np.array(v))


class Ear:
    """A ground station on the loopback."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(2.0)
        self.url = f"udpout:127.0.0.1:{self.socket.getsockname()[1]}"
        self._codec = common.MAVLink(None)

    def hear(self, count: int) -> dict[str, common.MAVLink_message]:
        """The next messages by type (and name)."""
        heard: list[common.MAVLink_message] = []
        while len(heard) < count:
            heard += self._codec.parse_buffer(self.socket.recv(4096)) or []
        return {f"{m.get_type()} {getattr(m, 'name', '')}".strip(): m for m in heard}

    def all(self, kind: str) -> list[common.MAVLink_message]:
        """All that wait, of one type."""
        self.socket.settimeout(0.2)
        heard: list[common.MAVLink_message] = []
        with contextlib.suppress(TimeoutError):
            while True:
                heard += self._codec.parse_buffer(self.socket.recv(4096)) or []
        return [message for message in heard if message.get_type() == kind]

    def quiet(self) -> bool:
        self.socket.settimeout(0.1)
        try:
            self.socket.recv(4096)
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(2.0)
        return False


@pytest.fixture
def ear():
    one = Ear()
    yield one
    one.socket.close()


@pytest.fixture
def sink(ear):
    one = MavlinkSink(MavlinkLink(ear.url), Guide(RIG, GuidanceConfig()))
    yield one
    one.close()


def test_a_solution_in_forward_right_down(ear, sink) -> None:
    sink.solution(solution())
    heard = ear.hear(10)
    target = heard["LANDING_TARGET"]
    assert target.get_srcComponent() == 191
    assert (target.x, target.y, target.z) == pytest.approx((1.0, 0.5, 0.25))  # ahead, to starboard, below
    assert (target.frame, target.position_valid, target.time_usec) == (12, 1, 2_000_000)
    assert (target.angle_x, target.angle_y) == pytest.approx((np.arctan(0.5), np.arctan(0.25)))
    assert target.distance == pytest.approx(0.98)
    distance = heard["DISTANCE_SENSOR"]
    assert (distance.current_distance, distance.orientation, distance.covariance) == (98, 0, 1)
    value = {name.split()[1]: m.value for name, m in heard.items() if name.startswith("NAMED_VALUE_FLOAT")}
    assert value["LL_BEARING"] == pytest.approx(np.arctan(0.5))  # turn to starboard
    assert value["LL_CLOSING"] == pytest.approx(0.2 / np.linalg.norm([0.5, 0.25, 1.0]))
    assert value["LL_T_STOP"] == pytest.approx((0.98 - 0.5) / value["LL_CLOSING"])
    assert (value["LL_ALARM"], value["LL_REACH"], value["LL_ACCUR"]) == (0.0, 0.0, 1.0)
    assert value["LL_RANGE"] == pytest.approx(0.98)
    assert value["LL_SIGMA"] == pytest.approx(0.01)


def test_a_closing_speed_that_nobody_knows_is_nan(ear, sink) -> None:
    sink.solution(dataclasses.replace(solution(), velocity_m_s=None))
    heard = ear.hear(10)
    value = {name.split()[1]: m.value for name, m in heard.items() if name.startswith("NAMED_VALUE_FLOAT")}
    assert np.isnan([value["LL_CLOSING"], value["LL_T_STOP"]]).all()


def test_what_is_not_valid_is_said_not_to_be(ear, sink) -> None:
    sink.solution(solution(status=Status.COASTING))
    heard = ear.hear(9)
    assert heard["LANDING_TARGET"].position_valid == 0
    assert "DISTANCE_SENSOR" not in heard
    sink.solution(Solution(3_000_000_000, Stage.SEARCHING, Status.LOST))
    assert ear.quiet()


def test_a_heartbeat_a_second_an_alarm_once_and_failing_parts_in_words(ear, sink) -> None:
    for t_s in (0.0, 0.5, 0.9, 1.0):
        sink.sample(LaserRange(round(t_s * 1e9), 1.0))
    assert [m.get_type() for m in ear.hear(1).values()] == ["HEARTBEAT"]
    assert [m.get_type() for m in ear.hear(1).values()] == ["HEARTBEAT"]
    assert ear.quiet()
    sink.solution(solution(p=(0.0, 0.0, 0.2), range_m=0.19))
    assert ear.hear(11)["STATUSTEXT"].text == "leadline: 0.19 m to the target"
    sink.solution(solution(p=(0.0, 0.0, 0.2), range_m=0.19))
    assert "STATUSTEXT" not in ear.hear(10)
    sink.health([Condition(Part.LASER, State.OFF, 0, "silent", "look")], 1_100_000_000)
    told = ear.hear(1)["STATUSTEXT"]
    assert (told.text, told.severity) == ("leadline: laser off", 1)
    sink.health([Condition(Part.LASER, State.OFF, 0, "silent", "look")], 1_200_000_000)
    assert ear.quiet()


def test_which_way_the_camera_looks() -> None:
    assert orientation(FORWARD_LOOKING) == 0
    assert orientation(DOWNWARD) == 25  # MAV_SENSOR_ROTATION_PITCH_270: down


def test_frd_is_its_own_inverse() -> None:
    assert frd([1.0, 2.0, 3.0]) == pytest.approx([1.0, -2.0, -3.0])
    assert frd(frd([1.0, 2.0, 3.0])) == pytest.approx([1.0, 2.0, 3.0])


def test_velocity_over_ground_by_the_attitude() -> None:
    assert ned_to_frd([1.0, 0.0, 0.0], 0.0, 0.0, np.pi / 2) == pytest.approx([0.0, -1.0, 0.0])  # north, heading east
    assert ned_to_frd([0.0, 0.0, 1.0], 0.0, np.pi / 2, 0.0) == pytest.approx([-1.0, 0.0, 0.0])  # sinks, bow up
    assert ned_to_frd([0.0, 1.0, 0.0], np.pi / 2, 0.0, 0.0) == pytest.approx([0.0, 0.0, -1.0])  # east, starboard down


def test_a_turning_vehicle_swings_its_camera() -> None:
    ahead = Pose(FORWARD_LOOKING.R, [0.5, 0.0, 0.0])
    rotation, velocity = camera_motion(ahead, [0.0, 0.0, 0.2], [0.1, 0.0, 0.0])  # yaws to starboard
    assert rotation == pytest.approx([0.0, 0.2, 0.0])  # about the camera's y, which is down
    assert velocity == pytest.approx([0.1, 0.0, 0.1])  # to the right at 0.5 m times 0.2 rad/s, and ahead
    still = np.array([0.0, 0.0, 2.0])
    assert -velocity - np.cross(rotation, still) == pytest.approx([-0.5, 0.0, -0.1])  # it moves to the left in view


def attitude(boot_ms=1000, rates=(0.0, 0.0, 0.2), component=1):
    message = common.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 0.0, *rates)
    return sent(message, component)


def sent(message, component=1):
    codec = common.MAVLink(None, srcSystem=1, srcComponent=component)
    return common.MAVLink(None).parse_buffer(message.pack(codec))[0]


def test_attitude_and_velocity_become_the_cameras_motion_once() -> None:
    reader = MotionReader(FORWARD_LOOKING)
    velocity = sent(common.MAVLink_local_position_ned_message(990, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0))
    assert reader.read(velocity, 5_000_000_000) is None
    first = reader.read(attitude(), 5_010_000_000)
    second = reader.read(attitude(1020), 5_030_000_000)
    assert isinstance(first, VehicleMotion)
    assert isinstance(second, VehicleMotion)
    assert first.velocity_m_s == pytest.approx((0.0, 0.0, 0.3))
    assert first.rotation_rad_s == pytest.approx((0.0, 0.2, 0.0))
    assert second.velocity_m_s is None  # the same velocity again is no news


def test_others_and_numbers_that_are_none_are_not_believed() -> None:
    reader = MotionReader(FORWARD_LOOKING)
    assert reader.read(attitude(component=100), 0) is None
    assert reader.read(attitude(rates=(float("nan"), 0.0, 0.0)), 0) is None


def test_stamps_follow_the_quickest_message_and_a_restart() -> None:
    clock = BootClock()
    assert clock.stamp_ns(1000, 7_000_000_000) == 7_000_000_000
    assert clock.stamp_ns(1100, 7_150_000_000) == pytest.approx(7_100_000_000, abs=2000)  # 50 ms late
    assert clock.stamp_ns(1200, 7_190_000_000) == 7_190_000_000  # 10 ms quicker than the first
    assert clock.stamp_ns(50, 9_000_000_000) == 9_000_000_000  # it counts from its start again


def test_motion_comes_over_the_link_and_garbage_does_not_matter() -> None:
    probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    probe.bind(("127.0.0.1", 0))
    port = probe.getsockname()[1]
    probe.close()
    part = MavlinkMotion(f"udpin:127.0.0.1:{port}", LiveClock(), Mount())
    part.open()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        codec = common.MAVLink(None, srcSystem=1, srcComponent=1)
        autopilot.sendto(bytes(range(256)), ("127.0.0.1", port))
        autopilot.sendto(common.MAVLink_attitude_message(10, 0, 0, 0, 0, 0, 0.2).pack(codec), ("127.0.0.1", port))
        found = [*part.read(), *part.read(), *part.read()]
    part.close()
    part.close()
    assert len(found) == 1
    assert isinstance(found[0], VehicleMotion)


@pytest.mark.parametrize("url", ["nonsense:1:2", "udpout:nowhere", "udpout:127.0.0.1:x", ""])
def test_an_address_that_is_none(url: str) -> None:
    with pytest.raises(InputError, match="MAVLink"):
        MavlinkLink(url)


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("udpout:127.0.0.1:99999", "udpout:127.0.0.1:99999: there is no port 99999; give one up to 65535"),
        ("udpout:udp.invalid:14550", "no host of the name udp.invalid is known"),
        ("udpout:.a..:14550", "no host of the name .a.. is known"),
    ],
)
def test_an_address_that_nobody_has_is_one_line_before_anything_is_written(
    url: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from leadline.cli import main  # noqa: PLC0415

    (tmp_path / "tiny.yaml").write_text(TINY)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "solutions.csv").write_text("of an earlier run")
    arguments = ["--target", "plane", "--out", str(tmp_path / "run"), "--mavlink", url]
    assert main(["run", f"sim:{tmp_path / 'tiny.yaml'}", *arguments]) == 2
    complaint = capsys.readouterr().err
    assert told in complaint
    assert complaint.count("\n") == 1
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["solutions.csv"]
    assert (tmp_path / "run" / "solutions.csv").read_text() == "of an earlier run"


def test_a_host_is_looked_up_once(ear, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def known(host: str) -> str:
        asked.append(host)
        return "127.0.0.1"

    monkeypatch.setattr(socket, "gethostbyname", known)
    link = MavlinkLink(ear.url.replace("127.0.0.1", "udp"))  # a name that is also part of the way
    link.open()
    for _ in range(5):
        link.send(heartbeat())
    link.close()
    assert asked.count("udp") == 1
    assert len(ear.all("HEARTBEAT")) == 5


def test_a_run_tells_the_autopilot_and_takes_what_it_says(tmp_path, ear) -> None:
    """End to end: the dive's positions arrive, in the frame of the camera's place on the vehicle."""
    from leadline.cli import main  # noqa: PLC0415

    scenario = tmp_path / "tiny.yaml"
    scenario.write_text(TINY)
    assert (
        main(
            ["run", f"sim:{scenario}", "--target", "sphere:0.34", "--out", str(tmp_path / "run"), "--mavlink", ear.url]
        )
        == 0
    )
    rows = [line.split(",") for line in (tmp_path / "run" / "solutions.csv").read_text().splitlines()[1:]]
    told = [row for row in rows if row[2] == "valid"]
    heard = ear.all("LANDING_TARGET")
    assert len(heard) >= len(told) > 0
    last, x, y, z = heard[-1], *(float(v) for v in told[-1][3:6])
    assert (last.x, last.y, last.z) == pytest.approx((z, x, y), abs=1e-4)


def test_a_source_with_an_autopilot_knows_where_the_camera_sits(tmp_path) -> None:
    from leadline.sources import open_source  # noqa: PLC0415
    from leadline.sources.live import LiveSource  # noqa: PLC0415

    source = open_source("mavlink:udpin:127.0.0.1:0")
    assert isinstance(source, LiveSource)
    assert np.array_equal(source.mount.T_body_left.R, FORWARD_LOOKING.R)
    with pytest.raises(InputError, match="more than one mavlink"):
        open_source("mavlink:udpin:127.0.0.1:1+mavlink:udpin:127.0.0.1:2")
