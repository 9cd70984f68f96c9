"""The time of live samples: nanoseconds since 1970 as they were at the start, counted on by a clock nobody can set."""

from __future__ import annotations

import time


class LiveClock:
    """A step of the computer's own clock (NTP) moves no stamp; ``wall_ns`` shows it, for the health of the clock.

    held: stands still until ``start_at``: for a dive that is replayed in its own time.
    """

    def __init__(self, *, held: bool = False) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()
        self.held = held

    def now_ns(self) -> int:
        return 0 if self.held else time.monotonic_ns() + self._offset_ns

    def wall_ns(self) -> int:
        return time.time_ns()

    def start_at(self, t_ns: int) -> None:
        """Now is ``t_ns``."""
        self._offset_ns = t_ns - time.monotonic_ns()
        self.held = False
