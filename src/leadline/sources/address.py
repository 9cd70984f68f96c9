"""Live addresses: ``uvc:0+serial:/dev/ttyUSB0?protocol=jrt&baud=115200``, ``uvc:0,1``, ``rtsp://camera/stereo#fps=25``.

Devices are joined by ``+``. Options stand after ``?`` and are joined by ``&``; after ``#`` in a stream's URL, which may
have a ``?`` of its own. A laser's protocol that is not said is found by trying.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeVar
from urllib.parse import unquote

from leadline.errors import InputError
from leadline.rig import Rig
from leadline.sources.clock import LiveClock
from leadline.sources.mavlink import MavlinkMotion, Mount
from leadline.sources.part import LivePart

CAMERA_OPTIONS = ("size", "fps", "exposure", "latency", "fourcc")
LASER_OPTIONS = ("protocol", "baud", "latency")
SCHEMES = ("uvc", "rtsp", "serial", "mavlink", "ros2")
_Number = TypeVar("_Number", int, float)


def joined(text: str) -> list[str]:
    """The addresses of the devices that ``+`` joins: a ``+`` in a file's name joins nothing."""
    return re.split(rf"\+(?=(?:{'|'.join(SCHEMES)}):)", text)


def makers(text: str, clock: LiveClock, mount: Mount) -> list[Callable[[], LivePart]]:
    """For each part, what makes a new object of it; InputError for an address that is none."""
    found, kinds = [], []
    for part in joined(text):
        scheme, _, rest = part.partition(":")
        make, kind = _part(scheme, rest, clock, mount, part)
        make()  # complains at once
        found.append(make)
        kinds.append(kind)
    for kind in ("serial", "camera", "mavlink"):
        if kinds.count(kind) > 1:
            raise InputError(f"more than one {kind}", text, "give one of each (two cameras: uvc:0,1)")
    return found


def _part(scheme: str, rest: str, clock: LiveClock, mount: Mount, where: str) -> tuple[Callable[[], LivePart], str]:
    if scheme == "serial":
        return _laser(rest, clock, where), "serial"
    if scheme == "mavlink":
        return lambda: MavlinkMotion(rest, clock, mount), "mavlink"
    if scheme == "ros2":
        return _topics(rest, clock, where), "camera"
    return _camera(scheme, rest, clock, where), "camera"


def _topics(rest: str, clock: LiveClock, where: str) -> Callable[[], LivePart]:
    from leadline.sources.ros2 import RosTopics, StereoTopics, own_node  # noqa: PLC0415

    wanted = StereoTopics.parsed(_options(rest, "?", where)[1], where)
    return lambda: RosTopics(where, lambda: own_node(wanted, clock), wanted.pair_s)


def rig_of(text: str) -> Rig | None:
    """Of a ``ros2:`` address that names the cameras' CameraInfo; waits for it, InputError where it does not come."""
    found = re.search(r"(?:^|\+)(ros2:.*?)(?=\+\w+:|$)", text)
    if found is None:
        return None
    from leadline.sources.ros2 import StereoTopics, rig_from_topics  # noqa: PLC0415

    wanted = StereoTopics.parsed(_options(found[1].removeprefix("ros2:"), "?", text)[1], text)
    return rig_from_topics(wanted) if wanted.left_info and wanted.right_info else None


def _laser(rest: str, clock: LiveClock, where: str) -> Callable[[], LivePart]:
    from leadline.sources.laser_serial import Guess, SerialLaser  # noqa: PLC0415

    port, options = _options(rest, "?", where)
    own = {key: options.pop(key) for key in LASER_OPTIONS if key in options}
    if not port:
        raise InputError("no port", where, "give one: serial:/dev/ttyUSB0?protocol=jrt")
    baud = _number(own, "baud", int, where)
    latency_s = _number(own, "latency", float, where)
    protocol = own.get("protocol") or Guess()
    return lambda: SerialLaser(port, clock, protocol=protocol, baud=baud, latency_s=latency_s, options=options)


def _camera(scheme: str, rest: str, clock: LiveClock, where: str) -> Callable[[], LivePart]:
    from leadline.sources.uvc import CameraSettings, StereoCamera  # noqa: PLC0415

    stream = scheme == "rtsp"
    names, options = _options(f"rtsp:{rest}" if stream else rest, "#" if stream else "?", where)
    devices = re.split(r",(?=rtsp:)", names) if stream else names.split(",")
    if not all(devices) or len(devices) > 2:
        raise InputError("one camera side by side, or two", where, "give uvc:0 or uvc:0,1")
    unknown = sorted(set(options) - set(CAMERA_OPTIONS))
    if unknown:
        raise InputError(f"no option {unknown[0]!r}", where, f"a camera takes {', '.join(CAMERA_OPTIONS)}")
    width, height = _size(options.get("size"), where)
    exposure = 0.0 if options.get("exposure") == "auto" else _number(options, "exposure", float, where)
    settings = CameraSettings(
        width,
        height,
        _number(options, "fps", float, where),
        exposure,
        _number(options, "latency", float, where),
        _fourcc(options.get("fourcc"), where),
    )
    return lambda: StereoCamera(devices, clock, settings)


def _options(text: str, mark: str, where: str) -> tuple[str, dict[str, str]]:
    name, _, rest = text.partition(mark)
    options: dict[str, str] = {}
    for pair in filter(None, rest.split("&")):
        key, equals, value = pair.partition("=")
        if not equals or key in options:
            raise InputError(f"'{pair}' is not one option", where, f"write {mark}name=value&name=value")
        options[key] = unquote(value)
    return name, options


def _number(options: dict[str, str], key: str, kind: type[_Number], where: str) -> _Number | None:
    if key not in options:
        return None
    try:
        value = kind(options[key])
    except ValueError:
        value = kind(-1)
    if value < 0 or (key in ("baud", "fps") and value == 0):
        raise InputError(f"{key}={options[key]} is not a number for it", where, f"give {key} as a number")
    return value


def _size(text: str | None, where: str) -> tuple[int | None, int | None]:
    if text is None:
        return None, None
    found = re.fullmatch(r"(\d{2,5})x(\d{2,5})", text)
    if found is None:
        raise InputError(f"size={text} is not a size", where, "write size=2560x720 (both images, if side by side)")
    return int(found[1]), int(found[2])


def _fourcc(text: str | None, where: str) -> str | None:
    if text is not None and not re.fullmatch(r"[A-Za-z0-9]{4}", text):
        raise InputError(f"fourcc={text} is not four letters", where, "write fourcc=MJPG or YUYV")
    return text
