"""Work done in order by a thread of its own, so that a disk that hangs or encodes slowly never holds up the dive."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

PICTURES = 15  # waiting at most: about a second of them
JOBS = 3000
Clock = Callable[[], float]


@dataclass(frozen=True, slots=True)
class Job:
    work: Callable[[], None]
    given_ns: int  # in the dive's time
    picture: bool = False  # may be left out when there is too much to do
    last: bool = False  # of those that one sample brought


class Answer(NamedTuple):
    """took_s: for the job and those before it of the same sample; error: what it raised."""

    given_ns: int
    took_s: float
    error: Exception | None


class Worker:
    """Of too many jobs the oldest picture is dropped and counted; of far too many the oldest of all.

    clock: seconds, to time the work by.
    """

    def __init__(self, name: str, clock: Clock) -> None:
        self._clock = clock
        self._jobs: deque[Job] = deque()
        self._doing: Job | None = None
        self._pictures = 0
        self._answers: deque[Answer] = deque(maxlen=JOBS)
        self._changed = threading.Condition()
        self._closing = False
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def give(self, job: Job) -> None:
        with self._changed:
            self._pictures += job.picture
            self._jobs.append(job)
            if self._pictures > PICTURES:
                self._drop(next(one for one in self._jobs if one.picture))
            elif len(self._jobs) > JOBS:
                self._drop(self._jobs[0])
            self._changed.notify_all()

    def answers(self) -> list[Answer]:
        """What has been done since the last call, oldest first."""
        return [self._answers.popleft() for _ in range(len(self._answers))]

    @property
    def waiting_ns(self) -> int | None:
        """Since when the oldest undone job has waited; None where there is none."""
        with self._changed:
            oldest = self._doing or (self._jobs[0] if self._jobs else None)
        return None if oldest is None else oldest.given_ns

    def settle(self, timeout_s: float) -> bool:
        """Wait until all is done; whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: self._doing is None and not self._jobs, timeout_s)

    def close(self, timeout_s: float) -> bool:
        """Finish what waits and end the thread; False where it hangs and is given up."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _drop(self, job: Job) -> None:
        self._jobs.remove(job)
        self._pictures -= job.picture
        self.dropped += 1

    def _next(self) -> Job | None:
        with self._changed:
            self._doing = None
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._jobs or self._closing)
            if not self._jobs:
                return None
            self._doing = self._jobs.popleft()
            self._pictures -= self._doing.picture
            return self._doing

    def _run(self) -> None:
        took_s = 0.0
        while (job := self._next()) is not None:
            start_s = self._clock()
            error: Exception | None = None
            try:
                job.work()
            except Exception as raised:
                error = raised
            took_s += self._clock() - start_s
            if job.last or error is not None:
                self._answers.append(Answer(job.given_ns, took_s, error))
                took_s = 0.0
