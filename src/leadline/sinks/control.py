"""What somebody at the page asks of a running dive: the loop takes it between two samples, from its own thread."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

ASKED_AT_MOST = 50  # what is asked beyond, before the loop has looked, is dropped
TEXT_AT_MOST = 200  # characters of an event


class Wish(StrEnum):
    RECORD = "record"
    STOP = "stop"
    MARK = "mark"
    KEEP = "keep"  # guided capture: this picture, whatever is thought of it
    UNDO = "undo"  # guided capture: take the last one out again
    END = "end"  # guided capture


@dataclass(frozen=True, slots=True)
class Request:
    wish: Wish
    text: str = ""  # of a mark


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth finding again: a mark, the begin or the end of a recording; ``t_ns`` in the dive's time."""

    t_ns: int
    text: str


@dataclass(frozen=True, slots=True)
class Desk:
    """What became of the requests: recording, if one is written; trouble: why not; files: of all recordings."""

    recording: bool = False
    trouble: str = ""
    files: tuple[Path, ...] = ()


class Control:
    """Asked by any thread, taken and answered (``desk``) by the loop's."""

    def __init__(self) -> None:
        self._asked: deque[Request] = deque()
        self.desk = Desk()  # replaced as a whole

    def ask(self, wish: Wish, text: str = "") -> None:
        if len(self._asked) < ASKED_AT_MOST:
            self._asked.append(Request(wish, plain(text)))

    def take(self) -> list[Request]:
        return [self._asked.popleft() for _ in range(len(self._asked))]


def plain(text: str) -> str:
    """One short line, whatever came over the network."""
    return " ".join("".join(c if c.isprintable() else " " for c in text[:TEXT_AT_MOST]).split())
