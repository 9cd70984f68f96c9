"""The other end of the line: what a rangefinder of each protocol sends. For simulated devices and tests."""

from __future__ import annotations

from collections.abc import Callable

from leadline.wire.laser_lightware import DISTANCE, packet
from leadline.wire.laser_protocol import LaserProtocol, LaserReading
from leadline.wire.laser_protocols import make_protocol

_COARSEST_M = 0.0051  # whole centimetres


def encode_reading(protocol: str, range_m: float, quality: float = 50.0) -> bytes:
    """One reading, as a device of that name sends it (KeyError: no such name)."""
    return _READINGS[protocol](range_m, round(quality))


def can_state(protocol: str, range_m: float) -> bool:
    """Whether a device of that name can say this distance, so that it is understood. InputError: no such name."""
    parser = make_protocol(protocol)
    try:
        heard = parser.feed(encode_reading(protocol, range_m))
    except (OverflowError, ValueError):  # more than its frame has bytes for, or no number
        return False
    return any(isinstance(one, LaserReading) and abs(one.range_m - range_m) <= _COARSEST_M for one in heard)


def encode_error(protocol: str) -> bytes:
    """The device's way of saying that too little light comes back."""
    return _ERRORS[protocol]


class Mood:
    """What a device has been told to do: ``continuous``, and how many single readings are still asked for."""

    def __init__(self, protocol: LaserProtocol) -> None:
        self._protocol = protocol
        self._heard = bytearray()
        self.continuous = protocol.name == "text" and not protocol.polled
        self.asked = 0

    def hear(self, data: bytes) -> None:
        """Bytes from the computer. The commands are few and unlike each other: the last ones said count."""
        self._heard += data
        for command, deed in (
            (self._protocol.single, self._ask),
            (self._protocol.start, self._start),
            (self._protocol.stop, self._stop),
        ):
            while command and command in self._heard:
                place = self._heard.index(command)
                del self._heard[place : place + len(command)]
                deed()
        del self._heard[:-64]

    def _ask(self) -> None:
        self.asked += 1

    def _start(self) -> None:
        self.continuous = not self._protocol.polled

    def _stop(self) -> None:
        self.continuous, self.asked = False, 0


def _jrt(register: int, payload: bytes, head: int = 0xAA) -> bytes:
    body = bytes([0, register >> 8, register & 0xFF, 0, len(payload) // 2]) + payload
    return bytes([head]) + body + bytes([sum(body) & 0xFF])


_READINGS: dict[str, Callable[[float, int], bytes]] = {
    "text": lambda r, q: f"{r:.3f}\r\n".encode(),
    "m703a": lambda r, q: f"F:{r:6.3f}m,{q:04d}\r\n".encode(),
    "jrt": lambda r, q: _jrt(0x22, round(r * 1000).to_bytes(4, "big") + q.to_bytes(2, "big")),
    "dimetix": lambda r, q: f"g0h+{round(r * 10_000):08d}\r\n".encode(),
    "lightware": lambda r, q: packet(DISTANCE, round(r * 100).to_bytes(2, "little") + q.to_bytes(2, "little")),
    "lightware-text": lambda r, q: f"ld,0:{r:.2f}\r\n".encode(),
}
_ERRORS: dict[str, bytes] = {
    "text": b"0.000\r\n",
    "m703a": b"F:Er.08!\r\n",
    "jrt": _jrt(0, (8).to_bytes(2, "big"), 0xEE),
    "dimetix": b"g0@E255\r\n",
    "lightware": packet(DISTANCE, (-100).to_bytes(2, "little", signed=True) + bytes(2)),
    "lightware-text": b"ld,0:-1.00\r\n",
}
