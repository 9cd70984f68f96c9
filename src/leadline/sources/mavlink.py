"""The vehicle's own motion, from its autopilot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from leadline.geometry.pose import Pose
from leadline.guidance import FORWARD_LOOKING
from leadline.health import Part
from leadline.sources.clock import LiveClock
from leadline.sources.inbox import Item
from leadline.sources.part import LivePart, Lost
from leadline.wire.mavlink import MavlinkLink, MotionReader

WAIT_S = 0.2


@dataclass(slots=True)
class Mount:
    """Where the camera sits on the vehicle: known when the rig is, which may be after the source was opened."""

    T_body_left: Pose = FORWARD_LOOKING


class MavlinkMotion(LivePart):
    """url: as for ``--mavlink``."""

    parts: ClassVar[tuple[Part, ...]] = ()

    def __init__(self, url: str, clock: LiveClock, mount: Mount) -> None:
        self.name = f"mavlink:{url}"
        self._clock, self._mount, self._link = clock, mount, MavlinkLink(url)
        self._reader = MotionReader(mount.T_body_left)

    def open(self) -> None:
        self._reader = MotionReader(self._mount.T_body_left)
        try:
            self._link.open()
        except OSError as error:
            raise Lost(f"cannot be opened: {error}") from error

    def read(self) -> Sequence[Item]:
        try:
            self._link.wait(WAIT_S)
            messages = self._link.receive()
        except OSError as error:
            raise Lost(f"gone: {error}") from error
        now_ns = self._clock.now_ns()
        return [motion for message in messages if (motion := self._reader.read(message, now_ns)) is not None]

    def close(self) -> None:
        try:
            self._link.close()
        except OSError:
            return
