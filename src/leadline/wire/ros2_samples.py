"""Decoded ROS 2 messages back to samples."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from leadline.samples import LaserRange, Sample, StereoFrame, VehicleMotion
from leadline.wire.images import decode_image, require_same_size
from leadline.wire.notice import Notice, NoticeKind
from leadline.wire.ros2_definitions import LASER, LEFT_IMAGE, MOTION, RIGHT_IMAGE, SAMPLE_INFO
from leadline.wire.ros2_images import range_m
from leadline.wire.ros2_messages import FRAME_NAME, MOTION_NAME, stamp_ns
from leadline.wire.ros2_pairing import Pairing
from leadline.wire.stamps import format_stamp, parse_stamp

_WAITING = 16  # images that wait for the description of their frame, or for their partner
_PAIR_NS = 25_000_000  # images of another recorder this close are one exposure

Times = tuple[int | None, int | None, int | None]  # arrival, left and right exposure, ns


class SampleAssembler:
    """Give it the messages in file order; it gives a sample when one is complete.

    Our own recordings say in ``sample_info``, ahead of the images, which images are one frame, and what exactly was
    read. In a recording of these topics by another tool images pair by their stamps, and a reading is a float32.
    """

    def __init__(self, where: str, tell: Callable[[Notice], None]) -> None:
        """``where``: the recording's name, for what is told."""
        self._where, self._tell = where, tell
        self._images: dict[str, dict[int, bytes]] = {LEFT_IMAGE: {}, RIGHT_IMAGE: {}}
        self._pairing: Pairing[bytes] = Pairing(_PAIR_NS)
        self._own = False
        self._announced: tuple[int, dict[str, str]] | None = None  # a frame whose images are to come
        self._motion: dict[str, str] | None = None  # of a motion whose message is to come

    def take(self, topic: str, message: Any, log_ns: int) -> Sample | None:
        """One message, logged at ``log_ns``. Raises SizeError for a pair of unequal images."""
        if topic == SAMPLE_INFO:
            self._own = True
            try:
                return self._announce(message)
            except (KeyError, ValueError, IndexError) as error:
                self._skip("sample", stamp_ns(message), f"its description cannot be read ({error})")
                return None
        if topic in self._images:
            return self._image(topic, message, log_ns)
        if topic == LASER and not self._own:
            return self._reading(message, log_ns)
        if topic == MOTION:
            return self._vehicle_motion(message, log_ns)
        return None

    def finish(self) -> None:
        """The recording is over: tell the frame whose images did not come."""
        if self._announced is not None:
            self._skip("frame", self._announced[0], "an image of it is missing")
        self._announced = None

    def _announce(self, message: Any) -> Sample | None:
        t_ns, status = stamp_ns(message), message.status[0]
        values = {pair.key: pair.value for pair in status.values}
        if status.name == MOTION_NAME:
            self._motion = values
            return None
        if status.name != FRAME_NAME:
            quality = float(values["quality"]) if "quality" in values else None
            arrival_ns = _optional(values, "arrival_s")
            return self._checked_range(LaserRange(t_ns, float(values["range_m"]), quality, arrival_ns))
        self.finish()
        self._announced = t_ns, values
        return self._complete()

    def _vehicle_motion(self, message: Any, log_ns: int) -> VehicleMotion | None:
        """A part whose variance is negative is not measured; one of 0 is of unknown certainty: the usual one."""
        t_ns, said = stamp_ns(message), self._motion
        self._motion = None
        parts: dict[str, Any] = {}
        for name, twist, sigma_name, variance in (
            ("velocity_m_s", message.twist.twist.linear, "velocity_sigma_m_s", message.twist.covariance[0]),
            ("rotation_rad_s", message.twist.twist.angular, "rotation_sigma_rad_s", message.twist.covariance[21]),
        ):
            vector = float(twist.x), float(twist.y), float(twist.z)
            if variance < 0 or not all(map(math.isfinite, vector)):
                continue
            parts[name] = vector
            if variance > 0:
                parts[sigma_name] = math.sqrt(variance)
        if said is not None:
            sigmas = {name: float(said[name]) for name in ("velocity_sigma_m_s", "rotation_sigma_rad_s")}
            return VehicleMotion(t_ns, **{**parts, **sigmas}, arrival_ns=_optional(said, "arrival_s"))
        if not {"velocity_m_s", "rotation_rad_s"} & parts.keys():
            self._skip("motion", t_ns, "neither a velocity nor a rotation")
            return None
        return VehicleMotion(t_ns, **parts, arrival_ns=log_ns)

    def _complete(self) -> StereoFrame | None:
        """The announced frame, once both images are there."""
        if self._announced is None:
            return None
        t_ns, values = self._announced
        times = _optional(values, "arrival_s"), _optional(values, "left_t_s"), _optional(values, "right_t_s")
        left_ns, right_ns = (t_ns if stamp is None else stamp for stamp in times[1:])
        lefts, rights = self._images[LEFT_IMAGE], self._images[RIGHT_IMAGE]
        if left_ns not in lefts or right_ns not in rights:
            return None
        self._announced = None
        frame = self._frame((lefts.pop(left_ns), rights.pop(right_ns)), t_ns, times, values.get("name", ""))
        switch = values.get("laser_on")
        return frame if frame is None or switch is None else replace(frame, laser_on=switch == "1")

    def _image(self, topic: str, message: Any, log_ns: int) -> StereoFrame | None:
        t_ns = stamp_ns(message)
        if self._own:
            images = self._images[topic]
            images[t_ns] = message.data
            while len(images) > _WAITING:
                del images[next(iter(images))]
            return self._complete()
        take = self._pairing.left if topic == LEFT_IMAGE else self._pairing.right
        pair = take(t_ns, message.data)
        if pair is None:
            return None
        apart = pair.left_ns != pair.right_ns
        times = (log_ns, pair.left_ns, pair.right_ns) if apart else (log_ns, None, None)
        return self._frame((pair.left, pair.right), pair.t_ns, times, "")

    def _reading(self, message: Any, log_ns: int) -> LaserRange | None:
        try:
            return LaserRange(stamp_ns(message), range_m(message), None, log_ns)
        except ValueError as error:
            self._skip("laser", stamp_ns(message), str(error))
            return None

    def _frame(self, encoded: tuple[bytes, bytes], t_ns: int, times: Times, name: str) -> StereoFrame | None:
        try:
            left, right = decode_image(encoded[0]), decode_image(encoded[1])
        except ValueError as error:
            self._skip("frame", t_ns, str(error))
            return None
        require_same_size(left, right)
        return StereoFrame(t_ns, left, right, *times, name=name, encoded=encoded)

    def _checked_range(self, reading: LaserRange) -> LaserRange | None:
        if 0 < reading.range_m < float("inf"):
            return reading
        self._skip("laser", reading.t_ns, f"range {reading.range_m} is not a distance")
        return None

    def _skip(self, sensor: str, t_ns: int, why: str) -> None:
        self._tell(Notice(NoticeKind.SKIPPED, f"{self._where} {sensor} at {format_stamp(t_ns)} s", why))


def _optional(values: dict[str, str], key: str) -> int | None:
    return parse_stamp(values[key]) if key in values else None
