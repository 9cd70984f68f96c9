"""A rangefinder that is not there, on a pseudo-terminal: any program can open its port as it would a real one."""

from __future__ import annotations

import math
import os
import select
import threading
import time
import tty
from collections.abc import Callable

from leadline.errors import InputError
from leadline.wire.laser_answers import Mood, can_state, encode_error, encode_reading
from leadline.wire.laser_protocols import make_protocol

NEAREST_M = 0.01
FASTEST_HZ = 1000.0


def swaying(protocol: str, range_m: float, sway_m: float) -> Callable[[float], float]:
    """A distance at a time (s) that swings to and fro. InputError where the protocol cannot state all of it."""
    nearest_m, farthest_m = max(range_m - sway_m, NEAREST_M), range_m + sway_m
    if not all(can_state(protocol, one) for one in (nearest_m, farthest_m)):
        fix = "give --range and --sway that stay between 0.01 and 300 m"
        raise InputError(f"{protocol} cannot state {range_m:g} m, give or take {sway_m:g} m", "rangefinder", fix)
    return lambda t_s: max(range_m + sway_m * math.sin(0.5 * t_s), NEAREST_M)


class SimulatedLaser:
    """``port`` is what to open. range_m: the distance at a time (s) since the start; None: too little light.

    InputError for a protocol or a rate that is none.

    Use it in a ``with``; ``unplug`` takes the port away, a new object is another port. Linux and macOS only.
    """

    def __init__(
        self, protocol: str, range_m: Callable[[float], float | None] = lambda t_s: 2.0, rate_hz: float = 3.0
    ) -> None:
        if not 0 < rate_hz <= FASTEST_HZ:
            raise InputError(f"{rate_hz:g} is no rate", "rangefinder", f"give up to {FASTEST_HZ:g} readings a second")
        self._protocol, self._range_m, self._period_s = protocol, range_m, 1 / rate_hz
        self._mood = Mood(make_protocol(protocol))
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave: int | None = slave  # held open, or reading fails whenever nobody else has the port
        self.silent = False  # answers nothing
        self.noise = b""  # sent before each answer
        self.sent = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"simulated {protocol}", daemon=True)
        self._thread.start()

    def __enter__(self) -> SimulatedLaser:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        self._stop.set()
        self._thread.join(2.0)
        for descriptor in filter(None, (self._slave, self._master)):
            os.close(descriptor)
        self._slave, self._master = None, 0

    def wait(self) -> None:
        """Until it is unplugged."""
        self._thread.join()

    def _run(self) -> None:
        start_s = due_s = time.monotonic()
        while not self._stop.is_set():
            ready, _, _ = select.select([self._master], [], [], min(max(due_s - time.monotonic(), 0.0), 0.05))
            if ready:
                self._mood.hear(os.read(self._master, 1024))
            now_s = time.monotonic()
            if now_s < due_s:
                continue
            due_s = max(due_s + self._period_s, now_s)
            if (self._mood.continuous or self._mood.asked) and not self.silent:
                self._mood.asked = max(self._mood.asked - 1, 0)
                self._answer(now_s - start_s)

    def _answer(self, t_s: float) -> None:
        range_m = self._range_m(t_s)
        said = encode_error(self._protocol) if range_m is None else encode_reading(self._protocol, range_m)
        os.write(self._master, self.noise + said)
        self.sent += 1
