"""Devices as one source: each read by its own thread, all of them merged in order of arrival."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from leadline.health import Part, State
from leadline.samples import NS_PER_S, Sample, StereoFrame
from leadline.sources.base import Source, frame_size
from leadline.sources.clock import LiveClock
from leadline.sources.inbox import Inbox, Item, Refused, Report
from leadline.sources.mavlink import Mount
from leadline.sources.part import LivePart
from leadline.sources.supervisor import Supervisor
from leadline.wire.notice import NoticeKind

TICK_S, WALL_S = 0.1, 0.1
CAMERAS = (Part.LEFT, Part.RIGHT)


class LiveSource(Source):
    """Reading starts the devices; the end of the iteration, ``close`` or Ctrl-C lets go of them.

    makers: each gives a new, unopened device whenever it is called. A frame that nobody takes in time is dropped for a
    newer one and counted (``dropped``); a reading never is.
    """

    live = True

    def __init__(
        self,
        name: str,
        makers: Sequence[Callable[[], LivePart]],
        clock: LiveClock,
        *,
        frames: int = 2,
        mount: Mount | None = None,
    ) -> None:
        super().__init__(name)
        self.clock, self.mount = clock, mount or Mount()
        self.of: Source | None = None  # the dive that is given as live
        self._makers, self._frames = list(makers), frames
        self._inbox = Inbox(frames)
        self._supervisors: list[Supervisor] = []
        self._wanted = False
        self._wall_ns = 0  # when the computer's clock was last looked at

    @property
    def dropped(self) -> int:
        """Frames that were pushed out by newer ones."""
        return self._inbox.dropped

    @property
    def restarts(self) -> int:
        return sum(supervisor.restarts for supervisor in self._supervisors)

    @property
    def opened(self) -> bool:
        return all(supervisor.opened for supervisor in self._supervisors)

    @property
    def devices(self) -> list[LivePart]:
        """As they are now, while they are read."""
        return [supervisor.part for supervisor in self._supervisors]

    def read(self) -> Iterator[Sample]:
        self._inbox = Inbox(self._frames)
        self._supervisors = [Supervisor(make, self._inbox, self.clock) for make in self._makers]
        self._wanted = True
        for supervisor in self._supervisors:
            supervisor.start()
        try:
            while self._wanted:
                item = self._inbox.get(TICK_S)
                if item is None and all(supervisor.finished for supervisor in self._supervisors):
                    return
                self._look_around(idle=item is None)
                if item is None and self.idle is not None:
                    self.idle()
                elif item is not None and (sample := self._sort(item)) is not None:
                    yield sample
        finally:
            self.close()

    def close(self) -> None:
        """Stop reading; from any thread, safe to call twice."""
        self._wanted = False
        for supervisor in self._supervisors:
            supervisor.stop()
        for supervisor in self._supervisors:
            supervisor.join(1.0)

    def _sort(self, item: Item) -> Sample | None:
        if isinstance(item, BaseException):
            raise item
        if isinstance(item, Report):
            self._report(item)
        elif isinstance(item, Refused):
            if self.health is not None:
                self.health.refused(item.now_ns, item.why, garbage=item.garbage)
        elif not isinstance(item, StereoFrame) or self._keeps_size(item):
            return item
        return None

    def _report(self, report: Report) -> None:
        if report.state is not State.OK:
            self.tell(NoticeKind.LOST, f"{self.name} {'+'.join(report.parts)}", report.why)
        if self.health is not None:
            for part in report.parts:
                self.health.reported(part, report.state, report.why, report.now_ns)

    def _keeps_size(self, frame: StereoFrame) -> bool:
        self.image_size = self.image_size or frame_size(frame)
        return self.fits(frame, self.name)

    def _look_around(self, *, idle: bool) -> None:
        """The watchdog, and what the health of the parts needs to know beside the samples."""
        if self.clock.held:
            return
        now_ns = self.clock.now_ns()
        for supervisor in self._supervisors:
            supervisor.watch(now_ns)
        if self.health is None:
            return
        for t_ns, arrival_ns in self._inbox.skipped():
            self.health.skipped(CAMERAS, t_ns, arrival_ns)
        if idle:
            self._now_ns = max(self._now_ns, now_ns)  # all that had come is taken
            self.health.tick(now_ns)
        if self.of is None and now_ns - self._wall_ns > WALL_S * NS_PER_S:
            self._wall_ns = now_ns
            self.health.wall_clock(self.clock.wall_ns(), now_ns)
