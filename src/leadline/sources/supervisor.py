"""A thread for a device, started again when it dies or hangs; the others never notice."""

from __future__ import annotations

import threading
from collections.abc import Callable

from leadline.errors import InputError
from leadline.health import State
from leadline.sources.clock import LiveClock
from leadline.sources.inbox import Inbox, Report
from leadline.sources.part import Finished, LivePart, Lost

NS_PER_S = 1_000_000_000
FIRST_WAIT_S, LONGEST_WAIT_S = 0.1, 1.0
MOST_HANGING = 3  # threads given up in a row: no more are started until one of them comes back


class Backoff:
    """How long to wait before trying again: 0.1 s, then twice as long each time, at most 1 s."""

    def __init__(self) -> None:
        self._next_s = FIRST_WAIT_S

    def next_s(self) -> float:
        wait_s, self._next_s = self._next_s, min(2 * self._next_s, LONGEST_WAIT_S)
        return wait_s

    def reset(self) -> None:
        self._next_s = FIRST_WAIT_S


class Supervisor:
    """make: gives a new, unopened object of the device each time. The first failure to open is the user's to mend."""

    def __init__(
        self,
        make: Callable[[], LivePart],
        inbox: Inbox,
        clock: LiveClock,
        *,
        wait: Callable[[float], object] | None = None,
    ) -> None:
        self._make, self._inbox, self._clock = make, inbox, clock
        self._stop = threading.Event()
        self._wait = wait or self._stop.wait
        self._part = make()
        self._backoff = Backoff()
        self._threads: list[threading.Thread] = []
        self._turn = 0  # of the thread that counts; those given up see that it is no longer theirs
        self._beat_ns: int | None = None
        self.opened = False  # once at least
        self.finished = False
        self.restarts = 0

    @property
    def part(self) -> LivePart:
        """The device as it is now."""
        return self._part

    def start(self) -> None:
        self._turn += 1
        self._beat_ns = None
        thread = threading.Thread(target=self._run, args=(self._turn,), name=self._part.name, daemon=True)
        self._threads = [t for t in self._threads if t.is_alive()] + [thread]
        thread.start()

    def watch(self, now_ns: int) -> None:
        """Give a thread up that has not come back from its device, and start another."""
        beat_ns, alive = self._beat_ns, [t for t in self._threads if t.is_alive()]
        if beat_ns is None or self.finished or now_ns - beat_ns < self._part.hang_s * NS_PER_S:
            return
        if len(alive) <= MOST_HANGING:
            self._report(State.OFF, "it does not answer; started again", now_ns)
            self.restarts += 1
            self.start()

    def stop(self) -> None:
        self._stop.set()

    def join(self, timeout_s: float) -> None:
        for thread in self._threads:
            thread.join(timeout_s)

    def _run(self, turn: int) -> None:
        while self._mine(turn):
            part = self._part = self._make()
            try:
                self._serve(part, turn)
            except Finished:
                self.finished = True
                return
            except Lost as lost:
                if not self.opened:
                    self._inbox.put(InputError(str(lost), part.name, "check the device's name, its cable and rights"))
                    return
                self._failed(turn, str(lost))
            except InputError as error:
                self._inbox.put(error)
                return
            except Exception as error:
                self._failed(turn, f"{type(error).__name__}: {error}")
            finally:
                part.close()

    def _serve(self, part: LivePart, turn: int) -> None:
        self._beat_ns = None  # opening may take its time
        part.open()
        again, self.opened = self.opened, True
        while self._mine(turn):
            self._beat_ns = self._clock.now_ns()
            for item in part.read():
                if not self._mine(turn):
                    return
                if again:
                    self._report(State.OK, "", self._clock.now_ns())
                    again = False
                self._backoff.reset()
                self._inbox.put(item)

    def _failed(self, turn: int, why: str) -> None:
        if not self._mine(turn):
            return
        self.restarts += 1
        self._report(State.OFF, why, self._clock.now_ns())
        self._beat_ns = None
        self._wait(self._backoff.next_s())

    def _mine(self, turn: int) -> bool:
        return turn == self._turn and not self._stop.is_set()

    def _report(self, state: State, why: str, now_ns: int) -> None:
        self._inbox.put(Report(self._part.parts, state, why, now_ns))
