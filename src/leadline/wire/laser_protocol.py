"""What every rangefinder's protocol looks like from outside: bytes in, readings and refusals out. No I/O, no clock."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

FARTHEST_M = 1000.0
LONGEST_LINE = 80


@dataclass(frozen=True, slots=True)
class LaserReading:
    """range_m and quality as the device says them. size: bytes of its frame; behind: bytes that came after it in the
    same piece. Both are for the time at which it was taken."""

    range_m: float
    quality: float | None
    size: int = 0
    behind: int = 0


@dataclass(frozen=True, slots=True)
class LaserRefusal:
    """No reading, in the device's own words; ``garbage``: it said nothing that its protocol knows."""

    why: str
    garbage: bool = False


Heard = LaserReading | LaserRefusal
Taken = tuple[int, Heard | None, bool]  # bytes used up, what they said (None: nothing), whether they were understood


class LaserProtocol(ABC):
    """A device's command set and the parser of its answers.

    ``start`` begins continuous measurement, ``stop`` ends it, ``single`` asks for one reading; ``polled`` devices have
    no continuous mode that a serial line can start: ``single`` is sent again after each answer. ``feed`` never raises,
    whatever the bytes; after garbage it finds the frames again with the second whole one at the latest.
    """

    name: ClassVar[str]
    baud: ClassVar[int]  # as the device leaves the factory
    polled: ClassVar[bool] = False
    start: bytes = b""
    stop: bytes = b""
    single: bytes = b""
    latency_s: float = 0.0  # from the middle of the measurement to the first byte, where the data sheet says

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Heard]:
        """Take the next bytes of the line; what they complete, in order."""
        self._buffer += data
        heard: list[Heard] = []
        lost = 0
        while (taken := self._take()) is not None:
            used, said, understood = taken
            lost += 0 if understood else used
            del self._buffer[:used]
            if said is not None:
                heard.append(_placed(said, used, len(self._buffer)))
        if lost and not heard:
            heard.append(LaserRefusal(f"{lost} bytes that are not of the {self.name} protocol", garbage=True))
        return heard

    def reset(self) -> None:
        """Forget what was begun: the line was cut."""
        self._buffer.clear()

    @abstractmethod
    def _take(self) -> Taken | None:
        """Look at the buffer's beginning: one byte or more that are done with; None: not enough yet."""


def distance(range_m: float, quality: float | None = None) -> Heard:
    """A reading if it is a distance at all."""
    if math.isfinite(range_m) and 0 < range_m <= FARTHEST_M:
        return LaserReading(range_m, quality)
    return LaserRefusal(f"{range_m:g} m is not a distance")


def _placed(said: Heard, size: int, behind: int) -> Heard:
    if isinstance(said, LaserReading):
        return LaserReading(said.range_m, said.quality, size, behind)
    return said


class LineProtocol(LaserProtocol):
    """Devices that speak in lines of ASCII."""

    def _take(self) -> Taken | None:
        end = _line_end(self._buffer)
        if end < 0:
            return (len(self._buffer), _garbage(self._buffer), True) if len(self._buffer) > LONGEST_LINE else None
        line = bytes(self._buffer[:end])
        if not line.strip():
            return end + 1, None, True
        try:
            said = _garbage(line) if end > LONGEST_LINE else self._read(line.decode("ascii").strip())
        except (ValueError, OverflowError):
            said = _garbage(line)
        return end + 1, said, True

    @abstractmethod
    def _read(self, line: str) -> Heard | None:
        """One line, without its end. Raises ValueError for what is not of this protocol."""


class FrameProtocol(LaserProtocol):
    """Devices that speak in binary frames, each with a head and a checksum."""

    heads: ClassVar[bytes]

    def _take(self) -> Taken | None:
        buffer = self._buffer
        start = next((place for place, byte in enumerate(buffer) if byte in self.heads), len(buffer))
        if start:
            return start, None, False
        size = self._size(buffer) if buffer else None
        if size is None or len(buffer) < size:
            return None
        frame = bytes(buffer[:size])
        return (size, self._read(frame), True) if size and self._whole(frame) else (1, None, False)

    @abstractmethod
    def _size(self, buffer: bytearray) -> int | None:
        """How long the frame is that begins here; 0: none begins here; None: cannot be said yet."""

    @abstractmethod
    def _whole(self, frame: bytes) -> bool:
        """Whether its checksum is right."""

    @abstractmethod
    def _read(self, frame: bytes) -> Heard | None:
        """What a whole frame says."""


def _line_end(buffer: bytearray) -> int:
    ends = [place for place in (buffer.find(b"\n"), buffer.find(b"\r")) if place >= 0]
    return min(ends, default=-1)


def _garbage(data: bytes | bytearray) -> LaserRefusal:
    shown = bytes(data[:24]).decode("ascii", "backslashreplace").strip()
    return LaserRefusal(f"not understood: {shown!r}", garbage=True)
