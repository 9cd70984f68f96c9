"""Where the parts' threads put what they have, and the one reader takes it: in order of arrival, never in the way."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, replace

from leadline.health import Part, State
from leadline.samples import Sample, StereoFrame


@dataclass(frozen=True, slots=True)
class Report:
    """A part tells how it is."""

    parts: tuple[Part, ...]
    state: State
    why: str
    now_ns: int


@dataclass(frozen=True, slots=True)
class Refused:
    """The laser answered, but not with a reading."""

    why: str
    garbage: bool
    now_ns: int


Item = Sample | Report | Refused | BaseException


class Inbox:
    """Holds at most ``frames`` pictures: a new one pushes out the oldest, which is counted. Never a reading.

    Arrival times are made strictly increasing, so that a recording, which is read back by them, keeps the order.
    """

    def __init__(self, frames: int = 2) -> None:
        self._items: deque[Item] = deque()
        self._frames, self._held = frames, 0
        self._changed = threading.Condition()
        self._last_ns = 0
        self.dropped = 0  # frames, since the start
        self._skipped: deque[tuple[int, int]] = deque(maxlen=100)

    def put(self, item: Item) -> None:
        with self._changed:
            if isinstance(item, StereoFrame):
                self._make_room()
                self._held += 1
            if not isinstance(item, Report | Refused | BaseException):
                arrival_ns = item.t_ns if item.arrival_ns is None else item.arrival_ns
                if arrival_ns <= self._last_ns:
                    item = replace(item, arrival_ns=self._last_ns + 1)
                self._last_ns = max(arrival_ns, self._last_ns + 1)
            self._items.append(item)
            self._changed.notify()

    def get(self, timeout_s: float) -> Item | None:
        """The next one; None if nothing comes within the time."""
        with self._changed:
            if not self._items:
                self._changed.wait(timeout_s)
            if not self._items:
                return None
            item = self._items.popleft()
            self._held -= isinstance(item, StereoFrame)
            return item

    def skipped(self) -> list[tuple[int, int]]:
        """Stamp and arrival of the frames pushed out since the last call, for the health of their camera."""
        with self._changed:
            skipped = list(self._skipped)
            self._skipped.clear()
        return skipped

    def _make_room(self) -> None:
        if self._held < self._frames:
            return
        oldest = next(item for item in self._items if isinstance(item, StereoFrame))
        self._items.remove(oldest)
        self._held -= 1
        self.dropped += 1
        self._skipped.append((oldest.t_ns, oldest.t_ns if oldest.arrival_ns is None else oldest.arrival_ns))
