"""`leadline capture`: frames of a source are judged one by one, the good and missing ones saved, until it is enough."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from leadline.errors import InputError
from leadline.pipeline.capture_files import CaptureFolder
from leadline.samples import StereoFrame
from leadline.sinks.control import Control, Wish
from leadline.sinks.web_capture import CaptureSink, Look, Status
from leadline.sources import Source, open_source
from leadline.sources.stills import StillsSource

Say = Callable[[str], None]


class Capture(Protocol):
    """Board images or target images: what is good, what is missing, and where it is written."""

    what: str
    folder: CaptureFolder

    @property
    def enough(self) -> bool: ...
    @property
    def missing(self) -> tuple[str, ...]: ...
    def take(self, frame: StereoFrame) -> Look:
        """Judge a frame, and save it if it is good and brings something."""

    def keep(self, frame: StereoFrame) -> str:
        """Save it whatever is thought of it; in words what was done."""

    def tales(self) -> list[str]:
        """What has happened by itself since the last call."""

    def undo(self) -> str:
        """Take the last one out again; in words what was done."""

    def status(self) -> Status: ...
    def finish(self) -> list[str]:
        """Write the rest; the next step, a line each."""


@dataclass(frozen=True, slots=True)
class CaptureReport:
    """``missing``: empty where it is enough. ``looked_at``: frames. ``last``: what was wrong with the last one."""

    out: Path
    count: int
    looked_at: int
    enough: bool
    missing: tuple[str, ...]
    next: tuple[str, ...]
    last: str


def open_pictures(spec: str, *, real_time: bool = False, seed: int = 0) -> Source:
    """Any source of frames; a folder of calibration images too."""
    path = Path(spec)
    if path.is_dir() and not (path / "frames.csv").exists() and not list(path.glob("*.mcap")):
        return StillsSource(path, real_time=real_time)
    return open_source(spec, seed=seed, real_time=real_time)


def capture(
    source: Source,
    task: Capture,
    sink: CaptureSink,
    *,
    say: Say = lambda words: None,
    hold_s: float = 0.0,
) -> CaptureReport:
    """Until it is enough, the source ends, or somebody ends it (the page, Ctrl-C).

    say: what has happened and what is next, a line each; hold_s: how long a saved picture stands. InputError where the
    source's pictures are of no use at all.
    """
    session = _Session(source, task, sink, say)
    try:
        session.run(hold_s)
    except KeyboardInterrupt:
        pass
    finally:
        source.close()
        following = task.finish()
    if not (session.looked_at or session.ended or task.enough or source.live):
        raise InputError("has no picture that can be read", source.name, "give a source with stereo images")
    count = task.status().count
    return CaptureReport(
        task.folder.out, count, session.looked_at, task.enough, task.missing, tuple(following), session.last
    )


class _Session:
    def __init__(self, source: Source, task: Capture, sink: CaptureSink, say: Say) -> None:
        self._source, self._task, self._sink, self._say = source, task, sink, say
        self._newest: StereoFrame | None = None
        self.looked_at = 0
        self.ended = False
        self.last = ""

    def run(self, hold_s: float) -> None:
        self._source.idle = self._poll
        for sample in self._source:
            self._poll()
            if self.ended or self._task.enough:
                return
            if not isinstance(sample, StereoFrame):
                continue
            self._newest = sample
            look = self._task.take(sample)
            self.looked_at += 1
            for tale in self._task.tales():
                self._tell(tale)
            self.last = look.words
            self._sink.show(sample, look, self._task.status())
            if look.state == "saved":
                self._tell(look.words)
                time.sleep(hold_s)

    def _poll(self) -> None:
        """What somebody at the page asked for since the last call."""
        for request in self._sink.control.take():
            if request.wish is Wish.UNDO:
                self._tell(self._task.undo())
            elif request.wish is Wish.KEEP and self._newest is not None:
                self._tell(self._task.keep(self._newest))
            elif request.wish is Wish.END:
                self.ended = True
                self._source.close()

    def _tell(self, words: str) -> None:
        status = self._task.status()
        self._sink.tell(words, status)
        self._say(f"{words} {status.count} of {status.want}. {status.next}")


def new_sink(task: Capture, source: Source, aim: str) -> CaptureSink:
    return CaptureSink(task.what, Path(source.name).name or source.name, aim, Control())
