"""Stereo cameras by OpenCV: one that gives both images side by side (ZED Mini), or two; on USB, or as RTSP streams.

A frame's stamp is its driver's (V4L2 stamps each buffer by the monotonic clock), else its arrival less ``latency``: one
frame period unless declared. Two cameras are grabbed one right after the other, and each image carries its own time.
A camera that gives the same picture for 2 s, or none, is closed and opened again.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol

import cv2

from leadline.errors import InputError
from leadline.health import Part
from leadline.samples import NS_PER_S, Image, StereoFrame
from leadline.sources.clock import LiveClock
from leadline.sources.inbox import Item
from leadline.sources.part import Finished, LivePart, Lost
from leadline.wire.dive_folder import split_side_by_side
from leadline.wire.images import SizeError, quiet

FROZEN_S = 2.0
MISSES = 5  # frames in a row that do not come
STAMP_AGE_S = 1.0  # a driver's stamp older than this is of another clock
OPEN_MS, READ_MS = 5000, 2000
FFMPEG_OPTIONS = "rtsp_transport;tcp|fflags;nobuffer|flags;low_delay|max_delay;200000"


class Capture(Protocol):
    """What is used of ``cv2.VideoCapture``."""

    def isOpened(self) -> bool: ...
    def grab(self) -> bool: ...
    def retrieve(self) -> tuple[bool, Any]: ...
    def set(self, propId: int, value: float) -> bool: ...
    def get(self, propId: int) -> float: ...
    def release(self) -> None: ...


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """None: as the camera has it. exposure_ms: None leaves it to the camera, 0 lets it choose all the time."""

    width: int | None = None
    height: int | None = None
    fps: float | None = None
    exposure_ms: float | None = None
    latency_s: float | None = None
    fourcc: str | None = None


Opener = Callable[[str], Capture]


class StereoCamera(LivePart):
    """devices: one name (side by side) or two (left, right): a number, a device, a stream's URL, or a film's file."""

    parts: ClassVar[tuple[Part, ...]] = (Part.LEFT, Part.RIGHT)

    def __init__(
        self,
        devices: Sequence[str],
        clock: LiveClock,
        settings: CameraSettings | None = None,
        *,
        opener: Opener | None = None,
    ) -> None:
        self.name = ",".join(devices) if "://" in devices[0] else f"uvc:{','.join(devices)}"
        self._devices, self._clock = list(devices), clock
        self._settings = settings or CameraSettings()
        self._opener = opener or open_capture
        self._captures: list[Capture] = []
        self._period_s = 1 / 30
        self._misses = 0
        self._last: tuple[bytes, int] | None = None  # picture and since when
        self._due_ns: int | None = None  # of a film's next frame

    def open(self) -> None:
        for device in self._devices:
            capture = self._opener(device)
            self._captures.append(capture)
            if not capture.isOpened():
                raise Lost(f"camera {device} cannot be opened")
            self._set(capture)
        fps = self._settings.fps or self._captures[0].get(cv2.CAP_PROP_FPS)
        self._period_s = 1 / fps if 1 <= fps <= 1000 else 1 / 30

    def read(self) -> Sequence[Item]:
        if self._is_film() and not self._film_is_due():
            return ()
        times_ns = []
        for capture in self._captures:
            if not capture.grab():
                return self._missed()
            times_ns.append((self._taken_ns(capture), self._clock.now_ns()))
        pictures = [capture.retrieve() for capture in self._captures]
        if not all(good for good, _ in pictures):
            return self._missed()
        self._misses = 0
        return [self._frame([picture for _, picture in pictures], times_ns)]

    def close(self) -> None:
        captures, self._captures = self._captures, []
        for capture in captures:
            capture.release()

    def _set(self, capture: Capture) -> None:
        """In the order in which drivers want it: format, size, rate, then exposure."""
        wanted = self._settings
        if wanted.fourcc:
            capture.set(cv2.CAP_PROP_FOURCC, float(cv2.VideoWriter.fourcc(*wanted.fourcc)))
        if wanted.width and wanted.height:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, wanted.width)
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, wanted.height)
        if wanted.fps:
            capture.set(cv2.CAP_PROP_FPS, wanted.fps)
        if wanted.exposure_ms is not None:
            manual, automatic = 1.0, 3.0  # V4L2_EXPOSURE_MANUAL, V4L2_EXPOSURE_APERTURE_PRIORITY
            capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, manual if wanted.exposure_ms else automatic)
            if wanted.exposure_ms:
                capture.set(cv2.CAP_PROP_EXPOSURE, wanted.exposure_ms * 10)  # V4L2: units of 0.1 ms
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest frame, not the oldest

    def _taken_ns(self, capture: Capture) -> int:
        """The middle of the exposure, as well as it can be known."""
        now_ns = self._clock.now_ns()
        if self._settings.latency_s is not None:
            return now_ns - round(self._settings.latency_s * NS_PER_S)
        if not self._is_film() and "://" not in self.name:
            age_s = time.monotonic() - capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
            if 0 <= age_s < STAMP_AGE_S:
                return now_ns - round(age_s * NS_PER_S)
        return now_ns - round(self._period_s * NS_PER_S)

    def _frame(self, pictures: list[Image], times_ns: list[tuple[int, int]]) -> StereoFrame:
        self._look(pictures[0], times_ns[-1][1])
        arrival_ns = times_ns[-1][1]
        if len(pictures) == 2:
            left_ns, right_ns = times_ns[0][0], times_ns[1][0]
            if pictures[0].shape != pictures[1].shape:
                raise InputError("the two cameras' images differ in size", self.name, "give both the same ?size=")
            return StereoFrame((left_ns + right_ns) // 2, pictures[0], pictures[1], arrival_ns, left_ns, right_ns)
        try:
            left, right = split_side_by_side(pictures[0])
        except SizeError as error:
            raise InputError(
                str(error), self.name, "give two cameras (uvc:0,1), or one that is side by side"
            ) from error
        return StereoFrame(times_ns[0][0], left, right, arrival_ns)

    def _look(self, picture: Image, now_ns: int) -> None:
        """Noise never repeats itself: the same picture again and again is the driver's last one."""
        few = picture[4::8, 4::8].tobytes()
        if self._last is None or self._last[0] != few:
            self._last = few, now_ns
        elif now_ns - self._last[1] > FROZEN_S * NS_PER_S:
            raise Lost(f"the picture has stood still for {FROZEN_S:.0f} s")

    def _missed(self) -> Sequence[Item]:
        if self._is_film():
            raise Finished
        self._misses += 1
        if self._misses >= MISSES:
            raise Lost("no picture comes")
        time.sleep(min(self._period_s, 0.1))
        return ()

    def _is_film(self) -> bool:
        return all(Path(device).suffix and Path(device).is_file() for device in self._devices)

    def _film_is_due(self) -> bool:
        now_ns = self._clock.now_ns()
        due_ns = now_ns if self._due_ns is None else self._due_ns
        time.sleep(min(max((due_ns - now_ns) / NS_PER_S, 0.0), 0.1))
        if self._clock.now_ns() < due_ns:
            return False
        self._due_ns = max(due_ns + round(self._period_s * NS_PER_S), now_ns)
        return True


def open_capture(device: str) -> Capture:
    """OpenCV's: a number or /dev/video* by the system's own interface, the rest by FFmpeg with little buffering."""
    quiet()
    if device.isdigit():
        return cv2.VideoCapture(int(device))
    if "://" not in device:
        return cv2.VideoCapture(device)
    os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", FFMPEG_OPTIONS)
    timeouts = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, OPEN_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, READ_MS]
    return cv2.VideoCapture(device, cv2.CAP_FFMPEG, timeouts)
