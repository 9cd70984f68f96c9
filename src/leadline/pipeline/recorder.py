"""Recording and marks on somebody's request, between two samples and in the loop's own thread."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Thread

from leadline.pipeline import folder
from leadline.pipeline.watch import Outlet, Watch
from leadline.sinks import Sink
from leadline.sinks.control import Control, Desk, Event, Request, Wish


class Recorder:
    """sinks: the main track's, which a recording joins and leaves. open_sink: a recorder into a file. ``files``: the
    recordings of this run.
    """

    def __init__(
        self,
        out: Path,
        sinks: list[Outlet],
        control: Control,
        open_sink: Callable[[Path], Sink],
        watch: Watch,
        now_ns: Callable[[], int],
    ) -> None:
        self._out, self._sinks, self._control = out, sinks, control
        self._open_sink, self._watch, self._now_ns = open_sink, watch, now_ns
        self._open: Outlet | None = None
        self._closing: list[Thread] = []
        self._marks = 0
        self.files: tuple[Path, ...] = ()

    def start(self, path: Path) -> None:
        """InputError or OSError where the file cannot be opened."""
        sink = self._open_sink(path)
        self._open = self._watch.outlet(sink)
        self._sinks.append(self._open)
        self.files = (*self.files, path)
        self._control.desk = Desk(recording=True, files=self.files)

    def stop(self) -> None:
        """The file is finished in its own time: a disk that hangs holds up nobody."""
        if self._open is not None:
            self._sinks.remove(self._open)
            self._watch.release(self._open)
            self._closing.append(Thread(target=self._open.close, name="leadline-recorder"))
            self._closing[-1].start()
            self._open = None
            self._control.desk = Desk(files=self.files)

    def close(self) -> None:
        """Stop and wait until all is written. Safe to call twice."""
        self.stop()
        for thread in self._closing:
            thread.join()

    def poll(self) -> None:
        """Do what was asked for since the last call."""
        for request in self._control.take():
            self._do(request)

    def _do(self, request: Request) -> None:
        if request.wish is Wish.MARK:
            self._marks += 1
            self._tell(request.text or f"mark {self._marks}")
        elif request.wish is Wish.RECORD and self._open is None:
            self._begin()
        elif request.wish is Wish.STOP and self._open is not None:
            self._tell(f"{self.files[-1].name}: recording ends")
            self.stop()

    def _begin(self) -> None:
        path = folder.free_recording(self._out)
        try:
            self.start(path)
        except OSError as error:  # the dive goes on
            self._control.desk = Desk(trouble=f"{path.name} cannot be written: {error.strerror}", files=self.files)
            return
        self._tell(f"{path.name}: recording begins")

    def _tell(self, text: str) -> None:
        for sink in self._sinks:
            sink.event(Event(self._now_ns(), text))
