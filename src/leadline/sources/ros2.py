"""Any stereo pair and any range on ROS 2 topics, as a live part.

``ros2:?left=/cam/left/image_raw/compressed&right=/cam/right/image_raw/compressed&range=/laser`` : what is not said is
the topic that our own camera and laser nodes publish; ``range=`` is no range. A topic whose name ends in
``compressed`` is a CompressedImage, any other an Image.
"""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, ClassVar

from leadline.errors import InputError
from leadline.health import Part, State
from leadline.rig import Rig
from leadline.samples import NS_PER_S, LaserRange, StereoFrame
from leadline.sources.clock import LiveClock
from leadline.sources.inbox import Item, Refused, Report
from leadline.sources.part import LivePart
from leadline.wire import ros2_definitions as topics
from leadline.wire.images import require_same_size
from leadline.wire.ros2_images import pixels, range_m
from leadline.wire.ros2_messages import stamp_ns
from leadline.wire.ros2_node import Ros, RosNode
from leadline.wire.ros2_pairing import Pair, Pairing
from leadline.wire.ros2_rig import rig_from_camera_infos

WAIT_S = 0.2
WAITING = 64  # messages that nobody has taken yet
FRAMES = 2  # as many frames as wait anywhere for somebody who is too slow
INFO_PATIENCE_S = 10.0
CAMERAS = (Part.LEFT, Part.RIGHT)
LEFT_SIDE, RIGHT_SIDE, RANGE_SIDE = "left", "right", "range"
Came = tuple[str, Any, int]  # which topic, the message, when it came (ns)
TOPIC = re.compile(r"(~/|/)?([A-Z_a-z{][\w{}]*/)*[A-Z_a-z{][\w{}]*", re.ASCII)  # {ns}: ROS fills it in
IMAGE_NAME = r"/image[^/]*(/compressed)?$"  # the end of a topic of images
IMAGE, COMPRESSED, RANGE, INFO = (
    f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "Range", "CameraInfo")
)


@dataclass(frozen=True, slots=True)
class StereoTopics:
    """pair_s: stamps of left and right this close may be one frame. reliable: ask for lost messages again."""

    left: str = topics.LEFT_IMAGE
    right: str = topics.RIGHT_IMAGE
    range: str = topics.LASER
    left_info: str = ""
    right_info: str = ""
    pair_s: float = 0.02
    reliable: bool = False

    @classmethod
    def parsed(cls, options: Mapping[str, str], where: str) -> StereoTopics:
        """From an address's options. InputError for what is none."""
        known = {one.name for one in fields(cls)}
        unknown = sorted(set(options) - known)
        if unknown:
            raise InputError(f"no option {unknown[0]!r}", where, f"ros2: takes {', '.join(sorted(known))}")
        said: dict[str, Any] = dict(options)
        try:
            if "pair_s" in options:
                said["pair_s"] = float(options["pair_s"])
        except ValueError:
            raise InputError(f"pair_s={options['pair_s']} is not a number", where, "write pair_s=0.02") from None
        said["reliable"] = options.get("reliable", "false") in ("true", "1")
        return cls(**said).checked(where)

    def with_infos(self) -> StereoTopics:
        """Where no topic of CameraInfo is said: the one beside the images, as ROS names it."""
        left, right = (f"{re.sub(IMAGE_NAME, '', topic)}/camera_info" for topic in (self.left, self.right))
        return replace(self, left_info=self.left_info or left, right_info=self.right_info or right)

    def checked(self, where: str) -> StereoTopics:
        if not self.left or not self.right or self.left == self.right:
            raise InputError("left and right need a topic each", where, "give left=/...&right=/...")
        for topic in filter(None, (self.left, self.right, self.range, self.left_info, self.right_info)):
            if not TOPIC.fullmatch(topic):
                fix = "write it like /cam/left/image_raw: letters, digits and _ between slashes, no digit first"
                raise InputError(f"{topic!r} is no name of a topic", where, fix)
        if not 0 <= self.pair_s < 1:
            raise InputError(f"pair_s={self.pair_s:g} is not a time between two stamps", where, "write pair_s=0.02")
        return self


class TopicReader:
    """Messages in, samples out; no ROS. Each message with the time when it came."""

    def __init__(self, pair_s: float) -> None:
        self._pairing: Pairing[Any] = Pairing(round(pair_s * NS_PER_S))
        self._broken = False

    def read(self, came: Sequence[Came]) -> list[Item]:
        """In the order in which they were complete. Of frames that have piled up only the newest two are decoded."""
        complete: list[tuple[Any, int]] = []
        for side, message, now_ns in came:
            if side == RANGE_SIDE:
                complete.append((message, now_ns))
                continue
            take = self._pairing.left if side == LEFT_SIDE else self._pairing.right
            if (pair := take(stamp_ns(message), message)) is not None:
                complete.append((pair, now_ns))
        pairs = [one for one, _ in complete if isinstance(one, Pair)]
        old = {id(pair) for pair in pairs[:-FRAMES]}
        return [item for one, now_ns in complete if id(one) not in old for item in self._items(one, now_ns)]

    def _items(self, one: Any, now_ns: int) -> list[Item]:
        if isinstance(one, Pair):
            return self._frame(one, now_ns)
        try:
            return [LaserRange(stamp_ns(one), range_m(one), None, now_ns)]
        except ValueError as error:
            return [Refused(str(error), garbage=False, now_ns=now_ns)]

    def _frame(self, pair: Pair[Any], now_ns: int) -> list[Item]:
        was_broken, self._broken = self._broken, False
        try:
            (left, left_bytes), (right, right_bytes) = pixels(pair.left), pixels(pair.right)
            require_same_size(left, right)
        except ValueError as error:
            self._broken = True
            return [Report(CAMERAS, State.GARBAGE, str(error), now_ns)]
        encoded = None if left_bytes is None or right_bytes is None else (left_bytes, right_bytes)
        left_ns, right_ns = (None, None) if pair.left_ns == pair.right_ns else (pair.left_ns, pair.right_ns)
        frame = StereoFrame(pair.t_ns, left, right, now_ns, left_ns, right_ns, encoded=encoded)
        return [Report(CAMERAS, State.OK, "", now_ns), frame] if was_broken else [frame]


class Tap:
    """Subscribes, and keeps what comes until it is taken. The node is not spun here."""

    def __init__(self, node: RosNode, wanted: StereoTopics, clock: LiveClock) -> None:
        self._clock = clock
        self._came: deque[Came] = deque(maxlen=WAITING)
        self._changed = threading.Condition()
        for side, topic in ((LEFT_SIDE, wanted.left), (RIGHT_SIDE, wanted.right), (RANGE_SIDE, wanted.range)):
            if topic:
                node.subscribe(topic, _kind(side, topic), partial(self._take, side), reliable=wanted.reliable)

    def wait(self, timeout_s: float) -> list[Came]:
        """All that has come; waits for the first."""
        with self._changed:
            if not self._came:
                self._changed.wait(timeout_s)
            came = list(self._came)
            self._came.clear()
        return came

    def _take(self, side: str, message: Any) -> None:
        with self._changed:
            self._came.append((side, message, self._clock.now_ns()))
            self._changed.notify()


class RosTopics(LivePart):
    """connect: gives the tap and what closes it again. Silence is no loss here: whoever publishes may come back."""

    parts: ClassVar[tuple[Part, ...]] = (*CAMERAS, Part.LASER)

    def __init__(self, name: str, connect: Callable[[], tuple[Tap, Callable[[], None]]], pair_s: float) -> None:
        self.name = name
        self._connect, self._reader = connect, TopicReader(pair_s)
        self._tap: Tap | None = None
        self._disconnect: Callable[[], None] = lambda: None

    def open(self) -> None:
        self._tap, self._disconnect = self._connect()

    def read(self) -> Sequence[Item]:
        assert self._tap is not None
        return self._reader.read(self._tap.wait(WAIT_S))

    def close(self) -> None:
        disconnect, self._disconnect = self._disconnect, lambda: None
        disconnect()


def own_node(wanted: StereoTopics, clock: LiveClock) -> tuple[Tap, Callable[[], None]]:
    """A tap with a node of its own, spun by a thread of its own."""
    ros = Ros()
    tap = Tap(ros.node("leadline"), wanted, clock)
    ros.start()
    return tap, ros.close


class CameraInfos:
    """Waits for one of each camera; ``rig`` is None until both have come."""

    def __init__(self, node: RosNode, wanted: StereoTopics) -> None:
        self._infos: dict[str, Any] = {}
        for side, topic in ((LEFT_SIDE, wanted.left_info), (RIGHT_SIDE, wanted.right_info)):
            node.subscribe(topic, INFO, partial(self._infos.__setitem__, side), reliable=wanted.reliable)

    @property
    def rig(self) -> Rig | None:
        """InputError where they are of a pair that is not calibrated."""
        if len(self._infos) < 2:
            return None
        return rig_from_camera_infos(self._infos[LEFT_SIDE], self._infos[RIGHT_SIDE])


def rig_from_topics(wanted: StereoTopics, patience_s: float = INFO_PATIENCE_S) -> Rig:
    """InputError where nothing comes on the two topics."""
    ros = Ros()
    try:
        infos = CameraInfos(ros.node("leadline_camera_info"), wanted)
        ros.start()
        end_s = time.monotonic() + patience_s
        while (rig := infos.rig) is None:
            if time.monotonic() > end_s:
                where = f"{wanted.left_info} and {wanted.right_info}"
                raise InputError(f"no CameraInfo within {patience_s:g} s", where, "check the topics, or give --rig")
            time.sleep(0.05)
        return rig
    finally:
        ros.close()


def _kind(side: str, topic: str) -> str:
    if side == RANGE_SIDE:
        return RANGE
    return COMPRESSED if topic.endswith("compressed") else IMAGE
