"""What the page's server needs of whatever it shows."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, Protocol

from leadline.samples import StereoFrame
from leadline.sinks.control import Control

ROWS_KEPT = 6000  # of the curves: minutes, for whoever opens the page late
EVENTS_KEPT = 200


class History:
    """The newest rows, and how many there were in all: a client asks for those that came since it last asked."""

    def __init__(self, kept: int = ROWS_KEPT) -> None:
        self._rows: deque[list[Any]] = deque(maxlen=kept)
        self.count = 0

    def add(self, row: list[Any]) -> None:
        self._rows.append(row)
        self.count += 1

    def since(self, count: int) -> list[list[Any]]:
        new = min(self.count - count, len(self._rows))
        return [self._rows[i] for i in range(len(self._rows) - new, len(self._rows))]


@dataclass(slots=True)
class Seen:
    """How far one client has come."""

    rows: int = 0
    readings: int = 0
    events: int = 0
    picture: int = 0
    version: int = -1


class Shot(Protocol):
    """A frame as it is shown; pictures are told apart by their number."""

    @property
    def number(self) -> int: ...
    @property
    def frame(self) -> StereoFrame: ...


class Shown(Protocol):
    """``page``: the file that is served for it. All of it is called by the server's thread."""

    page: str
    control: Control

    @property
    def picture(self) -> Any:
        """The newest ``Shot``; None before the first."""

    @property
    def silent_s(self) -> float:
        """How long no sample has come, seconds."""

    def hello(self) -> dict[str, Any]:
        """What does not change."""

    def news(self, seen: Seen) -> dict[str, Any] | None:
        """What is new since ``seen``, which is brought up to date; None where nothing is."""

    def scene(self, picture: Any) -> dict[str, Any]:
        """What to draw over a picture."""
