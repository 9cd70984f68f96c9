"""A rangefinder on a serial line (pyserial).

A reading's stamp is when it was measured: the arrival of its piece, less the time that the line took for its bytes and
those behind it, less the device's latency (``latency=``, seconds; a USB converter adds up to 16 ms of its own).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from typing import ClassVar, Protocol

from leadline.errors import InputError, in_words
from leadline.health import Part
from leadline.samples import NS_PER_S, LaserRange
from leadline.sources.clock import LiveClock
from leadline.sources.inbox import Item, Refused
from leadline.sources.part import LivePart, Lost
from leadline.wire.laser_protocol import Heard, LaserReading
from leadline.wire.laser_protocols import PROTOCOLS, make_protocol

BITS_PER_BYTE = 10  # 8 data bits, a start and a stop bit
WAIT_S = 0.1
SILENCE_S = 1.0  # then it is asked, or started, once more
PATIENCE_S = 2.5  # so long a protocol that is only guessed may go without a reading


class Port(Protocol):
    """What is used of ``serial.Serial``."""

    @property
    def in_waiting(self) -> int: ...
    def read(self, size: int = 1) -> bytes: ...
    def write(self, data: bytes, /) -> int | None: ...
    def close(self) -> None: ...


class Guess:
    """A device whose protocol the user has not said: one after the other, until one gives a reading."""

    def __init__(self) -> None:
        self._names = cycle(name for name in PROTOCOLS if name != "text")  # text would read a number into anything
        self.name = next(self._names)
        self.sure = False

    def wrong(self) -> None:
        self.name = next(self._names)


class SerialLaser(LivePart):
    """port: /dev/ttyUSB0, COM3, or any URL of pyserial (socket://host:port). options: of the protocol."""

    parts: ClassVar[tuple[Part, ...]] = (Part.LASER,)

    def __init__(
        self,
        port: str,
        clock: LiveClock,
        *,
        protocol: str | Guess,
        baud: int | None = None,
        latency_s: float | None = None,
        options: Mapping[str, str] | None = None,
        opener: Callable[[str, int], Port] | None = None,
    ) -> None:
        self.name = f"serial:{port}"
        self._port_name, self._clock = port, clock
        self._guess = protocol if isinstance(protocol, Guess) else None
        name = protocol.name if isinstance(protocol, Guess) else protocol
        self._protocol = make_protocol(name, options)
        self._baud = baud or self._protocol.baud
        self._latency_s = self._protocol.latency_s if latency_s is None else latency_s
        self._opener = opener or _open_port
        self._port: Port | None = None
        self._spoken_ns = self._opened_ns = 0

    @property
    def protocol(self) -> str:
        """The one in use, be it a guess."""
        return self._protocol.name

    def open(self) -> None:
        self._protocol.reset()
        self._opened_ns = self._clock.now_ns()
        try:
            self._port = self._opener(self._port_name, self._baud)
            self._send(self._protocol.start)
            self._ask()
        except (OSError, ValueError) as error:  # serial.SerialException is an OSError
            raise Lost(f"cannot be opened: {in_words(error)}") from error

    def read(self) -> Sequence[Item]:
        assert self._port is not None
        try:
            data = self._port.read(max(1, self._port.in_waiting))
            arrival_ns = self._clock.now_ns()
            heard = self._protocol.feed(data)
            if heard and self._protocol.polled:
                self._ask()
            elif arrival_ns - self._spoken_ns > SILENCE_S * NS_PER_S:
                self._wake(silent=not data)
        except (OSError, TypeError) as error:  # pyserial raises TypeError where a port vanishes while it is read
            raise Lost(f"unplugged: {in_words(error)}") from error
        if heard:
            self._spoken_ns = arrival_ns
        self._reconsider(heard, arrival_ns)
        return [self._item(one, arrival_ns) for one in heard]

    def close(self) -> None:
        port, self._port = self._port, None
        if port is None:
            return
        try:
            port.write(self._protocol.stop)
        except Exception:  # it may be gone already
            pass
        finally:
            _close_quietly(port)

    def _item(self, heard: Heard, arrival_ns: int) -> Item:
        if not isinstance(heard, LaserReading):
            return Refused(heard.why, heard.garbage, arrival_ns)
        line_s = (heard.size + heard.behind) * BITS_PER_BYTE / self._baud
        t_ns = arrival_ns - round((line_s + self._latency_s) * NS_PER_S)
        return LaserRange(t_ns, heard.range_m, heard.quality, arrival_ns)

    def _reconsider(self, heard: Sequence[Heard], now_ns: int) -> None:
        guess = self._guess
        if guess is None or guess.sure:
            return
        if any(isinstance(one, LaserReading) for one in heard):
            guess.sure = True
        elif now_ns - self._opened_ns > PATIENCE_S * NS_PER_S:
            guess.wrong()
            raise Lost(f"no reading as {self._protocol.name} at {self._baud} baud: trying {guess.name}")

    def _wake(self, *, silent: bool) -> None:
        """An error may have ended the continuous mode, a lost answer the questions."""
        if silent:
            self._send(self._protocol.start)
        self._ask()

    def _ask(self) -> None:
        if self._protocol.polled:
            self._send(self._protocol.single)
        self._spoken_ns = self._clock.now_ns()

    def _send(self, data: bytes) -> None:
        assert self._port is not None
        if data:
            self._port.write(data)


def _open_port(name: str, baud: int) -> Port:
    try:
        import serial  # noqa: PLC0415  an extra
    except ImportError:
        raise InputError("a serial line needs pyserial", f"serial:{name}", "pip install 'leadline[live]'") from None
    port: Port = serial.serial_for_url(name, baudrate=baud, timeout=WAIT_S, write_timeout=1.0)
    return port


def _close_quietly(port: Port) -> None:
    try:
        port.close()
    except Exception:
        return
