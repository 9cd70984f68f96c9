"""Live devices: lost, hanging, frozen and slow ones; the others and the order of what comes are not touched."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from leadline.errors import InputError
from leadline.health import Health, Part, State
from leadline.samples import NS_PER_S, Image, LaserRange, Sample, StereoFrame
from leadline.sources import open_source
from leadline.sources.clock import LiveClock
from leadline.sources.inbox import Inbox, Item
from leadline.sources.laser_serial import SerialLaser
from leadline.sources.laser_simulated import SimulatedLaser
from leadline.sources.live import LiveSource
from leadline.sources.part import Finished, LivePart, Lost
from leadline.sources.supervisor import Backoff, Supervisor
from leadline.sources.uvc import FROZEN_S, CameraSettings, StereoCamera
from leadline.wire.laser_answers import encode_error, encode_reading
from leadline.wire.laser_protocols import PROTOCOLS

PATIENCE_S = 20.0  # of a test on a busy machine; what is waited for comes within a second on an idle one


def frame(t_ns: int, level: int = 0) -> StereoFrame:
    image = np.full((4, 4), level, np.uint8)
    return StereoFrame(t_ns, image, image, t_ns)


def reading(t_ns: int) -> LaserRange:
    return LaserRange(t_ns, 1.0, None, t_ns)


def until(true: Callable[[], bool]) -> bool:
    end_s = time.monotonic() + PATIENCE_S
    while not true():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.01)
    return True


class Hand(LiveClock):
    """A clock moved by hand."""

    def __init__(self, t_ns: int = NS_PER_S) -> None:
        super().__init__()
        self.t_ns = t_ns

    def now_ns(self) -> int:
        return self.t_ns

    def wall_ns(self) -> int:
        return self.t_ns


# -- inbox ---------------------------------------------------------------------------------------------------------


def test_overload_drops_the_oldest_frame_and_no_reading() -> None:
    inbox = Inbox(frames=2)
    for i in range(1, 11):
        inbox.put(frame(10 * i))
        inbox.put(reading(10 * i + 1))
    taken = [item for _ in range(12) if (item := inbox.get(0)) is not None]
    assert inbox.get(0) is None
    assert [s.t_ns for s in taken if isinstance(s, StereoFrame)] == [90, 100]
    assert [s.t_ns for s in taken if isinstance(s, LaserRange)] == [10 * i + 1 for i in range(1, 11)]
    assert inbox.dropped == 8
    assert [t_ns for t_ns, _ in inbox.skipped()] == [10 * i for i in range(1, 9)]
    assert inbox.skipped() == []


def test_arrivals_increase_strictly_so_that_a_recording_keeps_the_order() -> None:
    inbox = Inbox(frames=9)
    for arrival in (5, 5, 3, 9):
        inbox.put(frame(arrival))
    arrivals = [item.arrival_ns for _ in range(4) if isinstance(item := inbox.get(0), StereoFrame)]
    assert arrivals == [5, 6, 7, 9]


# -- supervisor ----------------------------------------------------------------------------------------------------


class Device(LivePart):
    """Does what a script says: opens, gives readings, is lost, hangs."""

    parts: ClassVar[tuple[Part, ...]] = (Part.LASER,)
    hang_s: ClassVar[float] = 0.5
    name = "device"

    def __init__(self, script: list[Any], clock: LiveClock) -> None:
        self._script, self._clock = script, clock
        self.closed = threading.Event()

    def open(self) -> None:
        if self._script and self._script[0] == "no":
            self._script.pop(0)
            raise Lost("not there")

    def read(self) -> Sequence[Item]:
        deed = self._script.pop(0) if self._script else "end"
        if deed == "end":
            raise Finished
        if deed == "lost":
            raise Lost("unplugged")
        if deed == "bug":
            raise ZeroDivisionError("a bug")
        if isinstance(deed, threading.Event):
            deed.wait(PATIENCE_S)
            return ()
        return [reading(self._clock.now_ns())]

    def close(self) -> None:
        self.closed.set()


def supervised(script: list[Any]) -> tuple[list[Item], Supervisor, list[float]]:
    clock, inbox, waits = LiveClock(), Inbox(), list[float]()
    supervisor = Supervisor(lambda: Device(script, clock), inbox, clock, wait=waits.append)
    supervisor.start()
    assert until(lambda: supervisor.finished)
    return list(iter(lambda: inbox.get(0), None)), supervisor, waits


def test_a_lost_device_is_opened_again_and_said_to_be_lost_and_found() -> None:
    items, supervisor, waits = supervised(["read", "lost", "no", "no", "read", "read", "bug", "read"])
    said = [(item.state, item.why) if hasattr(item, "state") else "read" for item in items]
    assert said == [
        "read", (State.OFF, "unplugged"), (State.OFF, "not there"), (State.OFF, "not there"), (State.OK, ""),
        "read", "read", (State.OFF, "ZeroDivisionError: a bug"), (State.OK, ""), "read",
    ]  # fmt: skip
    assert supervisor.restarts == 4
    assert waits == [0.1, 0.2, 0.4, 0.1]  # a device that has given something starts again at the shortest wait


def test_waits_grow_and_stay_within_a_second() -> None:
    backoff = Backoff()
    assert [backoff.next_s() for _ in range(6)] == [0.1, 0.2, 0.4, 0.8, 1.0, 1.0]
    backoff.reset()
    assert backoff.next_s() == 0.1


def test_a_device_that_was_never_there_is_the_users_to_mend() -> None:
    clock = LiveClock()
    source = LiveSource("test", [lambda: Device(["no"], clock)], clock)
    with pytest.raises(InputError, match="not there") as caught:
        list(source)
    assert caught.value.fix


def test_a_hanging_device_is_given_up_and_the_other_goes_on() -> None:
    clock, forever = LiveClock(), threading.Event()
    scripts = [["read", forever, "read", "read"], ["read"] * 400]

    class Slow(Device):
        parts: ClassVar[tuple[Part, ...]] = (Part.CLOCK,)

        def read(self) -> Sequence[Item]:
            time.sleep(0.01)
            return super().read()

    source = LiveSource("test", [lambda: Device(scripts[0], clock), lambda: Slow(scripts[1], clock)], clock)
    source.health = Health()
    count = len(list(source))
    forever.set()
    assert count == 1 + 2 + 400
    assert source.restarts == 1
    assert [event.state for event in source.health.events if event.part is Part.LASER][:1] == [State.OFF]


# -- camera --------------------------------------------------------------------------------------------------------


class Virtual:
    """A capture that gives what it is told to."""

    def __init__(self, pictures: Iterator[Image | None], clock: Hand | None = None, *, is_open: bool = True) -> None:
        self._pictures, self._clock, self._is_open = pictures, clock, is_open
        self._picture: Image | None = None
        self.set_to: dict[int, float] = {}
        self.released = False

    def isOpened(self) -> bool:
        return self._is_open

    def grab(self) -> bool:
        if self._clock is not None:
            self._clock.t_ns += NS_PER_S // 10
        self._picture = next(self._pictures, None)
        return self._picture is not None

    def retrieve(self) -> tuple[bool, Image | None]:
        return self._picture is not None, self._picture

    def set(self, propId: int, value: float) -> bool:
        self.set_to[propId] = value
        return True

    def get(self, propId: int) -> float:
        return 10.0 if propId == cv2.CAP_PROP_FPS else 0.0

    def release(self) -> None:
        self.released = True


def noise(count: int, width: int = 32) -> Iterator[Image]:
    rng = np.random.default_rng(0)
    for _ in range(count):
        yield rng.integers(0, 255, (16, width, 3), np.uint8)


def frames(camera: StereoCamera, count: int) -> list[StereoFrame]:
    return [item for _ in range(count) for item in camera.read() if isinstance(item, StereoFrame)]


def test_side_by_side_is_cut_in_two_and_stamped_before_it_arrives() -> None:
    clock = Hand()
    pictures = list(noise(3))
    camera = StereoCamera(["0"], clock, CameraSettings(latency_s=0.04), opener=lambda _: Virtual(iter(pictures), clock))
    camera.open()
    seen = frames(camera, 3)
    assert [np.array_equal(np.hstack([f.left, f.right]), p) for f, p in zip(seen, pictures, strict=True)] == [True] * 3
    assert [f.arrival_ns for f in seen] == [NS_PER_S + i * NS_PER_S // 10 for i in (1, 2, 3)]
    assert {f.arrival_ns - f.t_ns for f in seen if f.arrival_ns is not None} == {40_000_000}


def test_two_cameras_carry_their_own_times() -> None:
    clock = Hand()
    captures = {name: Virtual(noise(2), clock) for name in "01"}
    camera = StereoCamera(["0", "1"], clock, CameraSettings(latency_s=0.0), opener=captures.__getitem__)
    camera.open()
    (seen,) = frames(camera, 1)
    assert seen.left_t_ns is not None
    assert seen.right_t_ns is not None
    assert seen.right_t_ns - seen.left_t_ns == NS_PER_S // 10
    assert seen.t_ns == (seen.left_t_ns + seen.right_t_ns) // 2


def test_settings_reach_the_driver() -> None:
    capture = Virtual(noise(1))
    settings = CameraSettings(2560, 720, 15.0, exposure_ms=6.0, fourcc="MJPG")
    StereoCamera(["0"], Hand(), settings, opener=lambda _: capture).open()
    assert capture.set_to[cv2.CAP_PROP_FRAME_WIDTH] == 2560
    assert capture.set_to[cv2.CAP_PROP_FPS] == 15
    assert capture.set_to[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
    assert capture.set_to[cv2.CAP_PROP_EXPOSURE] == 60  # units of 0.1 ms
    assert capture.set_to[cv2.CAP_PROP_FOURCC] == cv2.VideoWriter.fourcc(*"MJPG")


def test_a_frozen_camera_is_lost_after_two_seconds_and_a_live_one_is_not() -> None:
    clock = Hand()
    still = next(noise(1))
    moving = StereoCamera(["0"], clock, opener=lambda _: Virtual(noise(60), clock))
    moving.open()
    assert len(frames(moving, 60)) == 60
    frozen = StereoCamera(["0"], clock, opener=lambda _: Virtual(iter([still] * 60), clock))
    frozen.open()
    start_ns = clock.t_ns
    with pytest.raises(Lost, match="stood still"):
        frames(frozen, 60)
    assert FROZEN_S <= (clock.t_ns - start_ns) / NS_PER_S < FROZEN_S + 0.5


def test_a_camera_that_gives_nothing_is_lost() -> None:
    clock = Hand()
    capture = Virtual(iter([]), clock)
    camera = StereoCamera(["0"], clock, opener=lambda _: capture)
    camera.open()
    with pytest.raises(Lost, match="no picture"):
        frames(camera, 10)
    camera.close()
    assert capture.released


def test_an_odd_width_is_told_with_what_to_do() -> None:
    camera = StereoCamera(["0"], Hand(), opener=lambda _: Virtual(noise(1, width=31)))
    camera.open()
    with pytest.raises(InputError, match=r"even width.*uvc:0,1"):
        camera.read()


def film(path: Path, count: int) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 32))
    for picture in noise(count, width=64):
        writer.write(cv2.resize(picture, (64, 32)))
    writer.release()
    return path


def test_a_film_is_a_camera(tmp_path: Path) -> None:
    seen = list(open_source(f"uvc:{film(tmp_path / 'dive.avi', 8)}?fps=50"))
    assert len(seen) == 8
    assert all(isinstance(s, StereoFrame) and s.left.shape == (32, 32, 3) for s in seen)
    stamps = [s.t_ns for s in seen]
    assert stamps == sorted(stamps)
    assert stamps[-1] - stamps[0] >= 6 * NS_PER_S // 50


def test_a_film_with_a_laser_merges_by_arrival(tmp_path: Path) -> None:
    path = film(tmp_path / "dive.avi", 20)
    with SimulatedLaser("jrt", rate_hz=50) as laser:
        source = open_source(f"uvc:{path}?fps=25+serial:{laser.port}?protocol=jrt")
        seen: list[Sample] = []
        for sample in source:
            seen.append(sample)
            if sum(isinstance(s, StereoFrame) for s in seen) > 10 and sum(isinstance(s, LaserRange) for s in seen) > 10:
                source.close()
    arrivals = [s.arrival_ns for s in seen]
    assert arrivals == sorted(arrivals, key=lambda a: a or 0)
    assert len(set(arrivals)) == len(arrivals)


# -- laser ---------------------------------------------------------------------------------------------------------


class Line:
    """A serial port of bytes that are there."""

    def __init__(self, *pieces: bytes) -> None:
        self._pieces = list(pieces)
        self.written = b""
        self.closed = False

    in_waiting = 0

    def read(self, size: int = 1) -> bytes:
        if not self._pieces:
            raise OSError("device disconnected")
        return self._pieces.pop(0)

    def write(self, data: bytes, /) -> int:
        self.written += data
        return len(data)

    def close(self) -> None:
        self.closed = True


def laser_on(line: Line, protocol: str = "jrt", **settings: Any) -> SerialLaser:
    laser = SerialLaser("/dev/x", Hand(10 * NS_PER_S), protocol=protocol, opener=lambda *_: line, **settings)
    laser.open()
    return laser


def test_a_reading_is_stamped_when_it_was_measured() -> None:
    """13 bytes of 10 bits at 19,200 baud take 6.8 ms; the first of two waits for the second as well."""
    two = encode_reading("jrt", 1.5) + encode_reading("jrt", 1.6)
    first, second = laser_on(Line(two), latency_s=0.1).read()
    assert isinstance(first, LaserRange)
    assert isinstance(second, LaserRange)
    late_ms = [(10 * NS_PER_S - r.t_ns) / 1e6 for r in (first, second)]
    assert late_ms == pytest.approx([100 + 26 / 1.92, 100 + 13 / 1.92], abs=0.001)


def test_errors_and_unplugging() -> None:
    line = Line(encode_error("jrt"), b"\x01\x02\x03")
    laser = laser_on(line)
    (refused,) = laser.read()
    assert not isinstance(refused, LaserRange)
    assert "too weak" in refused.why
    assert not refused.garbage
    (garbage,) = laser.read()
    assert garbage.garbage
    with pytest.raises(Lost, match="unplugged"):
        laser.read()
    laser.close()
    assert line.closed
    assert line.written == PROTOCOLS["jrt"].start + PROTOCOLS["jrt"].stop


def test_a_polled_device_is_asked_again_after_each_answer() -> None:
    line = Line(encode_reading("m703a", 1.5), encode_reading("m703a", 1.6))
    laser = laser_on(line, "m703a")
    laser.read()
    laser.read()
    assert line.written == b"OFFF"


@pytest.mark.parametrize("protocol", sorted(PROTOCOLS))
def test_each_protocol_from_end_to_end(protocol: str) -> None:
    with SimulatedLaser(protocol, lambda t_s: None if 0.2 < t_s < 0.3 else 1.0 + t_s, rate_hz=50) as device:
        source = open_source(f"serial:{device.port}?protocol={protocol}")
        seen = []
        for sample in source:
            assert isinstance(sample, LaserRange)
            seen.append(sample)
            if len(seen) == 20:
                break
        source.close()
    ranges = [s.range_m for s in seen]
    assert ranges == sorted(ranges)
    slope = np.polyfit([s.t_s - seen[0].t_s for s in seen], ranges, 1)[0]
    assert slope == pytest.approx(1.0, abs=0.15)  # the target goes away at 1 m/s: stamps and ranges fit


def test_unplug_and_replug(tmp_path: Path) -> None:
    """The port's name is a link, as udev makes them; it goes and comes back."""
    link = tmp_path / "laser"
    health = Health()
    first, second = SimulatedLaser("jrt", rate_hz=20), SimulatedLaser("jrt", lambda t_s: 3.0, rate_hz=20)
    link.symlink_to(first.port)
    source = open_source(f"serial:{link}?protocol=jrt")
    source.health = health
    states: list[State] = []
    for count, sample in enumerate(source):
        assert isinstance(sample, LaserRange)
        states.append(health.state(Part.LASER))
        if count == 10:
            link.unlink()
            first.unplug()
            threading.Timer(0.5, link.symlink_to, [second.port]).start()
        if sample.range_m == 3.0 and health.state(Part.LASER) is State.OK:
            break
    source.close()
    second.unplug()
    assert State.OFF in {event.state for event in health.events}
    assert source.notice_counts.get("lost", 0) >= 1


def test_a_protocol_that_is_not_said_is_found() -> None:
    with SimulatedLaser("dimetix", lambda t_s: 1.25, rate_hz=20) as device:
        source = open_source(f"serial:{device.port}")
        sample = next(iter(source))
        source.close()
    assert isinstance(sample, LaserRange)
    assert sample.range_m == 1.25


@pytest.mark.parametrize(
    "spec",
    [
        "uvc:",
        "uvc:0,1,2",
        "uvc:0?size=big",
        "uvc:0?fps=0",
        "uvc:0?fourcc=MJ",
        "uvc:0?speed=1",
        "uvc:0+uvc:1",
        "serial:",
        "serial:/dev/x?protocol=sonar",
        "serial:/dev/x?baud=fast",
        "serial:/dev/x?protocol=jrt&scale=2",
        "serial:/dev/nothing?protocol=jrt",
        "rtsp://nowhere/x#frames=2",
    ],
)
def test_wrong_addresses_get_one_clear_line(spec: str) -> None:
    with pytest.raises(InputError) as caught:
        next(iter(open_source(spec)))
    assert "\n" not in str(caught.value)
    assert caught.value.fix


def test_a_dive_as_live_stands_alone() -> None:
    with pytest.raises(InputError, match="live: stands alone"):
        open_source("live:dive+serial:/dev/pts/0?protocol=jrt")


def test_a_stream_that_is_not_there_is_one_line_of_ours_and_none_of_ffmpegs(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "leadline", "run", "rtsp://127.0.0.1:9/x", "--rig", "rendered", "--headless"]
    done = subprocess.run([*command, "--out", str(tmp_path / "x")], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "cannot be opened" in done.stderr
