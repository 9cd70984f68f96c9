"""What the page of a guided capture is told: pictures, what is thought of them, what is missing."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from threading import Lock
from typing import Any

from leadline.samples import StereoFrame
from leadline.sinks.control import Control
from leadline.sinks.web_page import Seen


@dataclass(frozen=True, slots=True)
class Wanted:
    """One line of the checklist: so many are there, so many are wanted."""

    name: str
    have: int
    want: int


@dataclass(frozen=True, slots=True)
class Status:
    """What a capture has come to.

    next: what to do, one sentence; pose: the same for a drawing (tilt, or ""); cells: by picture, rows of "yes", "no"
    or "idle" (not needed); lists: the checklist by title; quality: what the images are good for by now; outline: by
    picture, four points, px, where to hold the board.
    """

    count: int
    want: int
    share: float
    next: str
    tilt: str = ""
    cells: dict[str, list[list[str]]] = field(default_factory=dict)
    lists: dict[str, list[Wanted]] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    quality: str = ""
    enough: bool = False
    outline: dict[str, list[Any]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Look:
    """What is thought of a frame. state: ``bad``, ``wait``, ``same`` or ``saved``. By picture, px: dots, the corners
    found (x, y); boxes (x, y, width, height)."""

    state: str
    words: str
    dots: dict[str, list[Any]] = field(default_factory=dict)
    boxes: dict[str, list[Any]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A frame, numbered, with what is drawn over it."""

    number: int
    frame: StereoFrame
    look: Look
    outline: dict[str, list[Any]]


class CaptureSink:
    """``Shown``. what: "board" or "target"; name: of the source; aim: what is captured, in words."""

    page = "capture.html"

    def __init__(self, what: str, name: str, aim: str, control: Control) -> None:
        self.control = control
        self._about = {"kind": "hello", "run": str(time.time_ns()), "what": what, "name": name, "aim": aim}
        self._lock = Lock()
        self._status: Status | None = None
        self._size: tuple[int, int] | None = None
        self._version = self._told = 0
        self._tale = ""
        self._ended: list[str] | None = None
        self._heard_s = time.monotonic()
        self.picture: Judged | None = None

    def show(self, frame: StereoFrame, look: Look, status: Status) -> None:
        with self._lock:
            number = 1 if self.picture is None else self.picture.number + 1
            self.picture = Judged(number, frame, look, status.outline)
            self._size = frame.left.shape[1], frame.left.shape[0]
            self._status = status
            self._heard_s = time.monotonic()
            self._version += 1

    def tell(self, words: str, status: Status | None = None) -> None:
        """Something that has happened: one saved, taken out, set aside."""
        with self._lock:
            self._told += 1
            self._tale = words
            self._status = status or self._status
            self._version += 1

    def ended(self, words: Sequence[str]) -> None:
        with self._lock:
            self._ended = list(words)
            self._version += 1

    @property
    def silent_s(self) -> float:
        return 0.0 if self._ended is not None else time.monotonic() - self._heard_s

    def hello(self) -> dict[str, Any]:
        return dict(self._about)

    def news(self, seen: Seen) -> dict[str, Any] | None:
        with self._lock:
            if seen.version == self._version:
                return None
            seen.version = self._version
            return {
                "kind": "news",
                "size": self._size,
                "status": None if self._status is None else asdict(self._status),
                "look": None if self.picture is None else [self.picture.look.state, self.picture.look.words],
                "told": [self._told, self._tale],
                "ended": self._ended,
            }

    def scene(self, picture: Judged) -> dict[str, Any]:
        look = picture.look
        return {"state": look.state, "dots": look.dots, "boxes": look.boxes, "outline": picture.outline}
