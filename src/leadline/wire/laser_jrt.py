"""JRT modules (U81, U85, M88, BB2X and the M01 kind): binary frames, 19200 baud.

    head  address  register(2)  words(2)  payload(2 * words)  sum

``head`` AA, or EE for an error; the sum is of all bytes after the head, modulo 256. A reading is register 0022 with
three words: distance in mm (4 bytes, big end first) and signal quality (2), smaller is better. An error is register
0000 with one word, its code.

Source: JRT's manual of the U81 module, UART protocol, as public drivers quote it: "measure result = 0xAABBCCDD mm
(bytes 6-9), signal quality = 0x0101, the smaller the stronger"; registers and codes as in U8xLaser.h of
chandrawi/U8x_Laser_Distance (MIT); commands as in the seller's sample (IADIY/LRF-SampleCode, LRF60M3PS/README.md).
"""

from __future__ import annotations

from typing import ClassVar

from leadline.wire.laser_protocol import FrameProtocol, Heard, LaserRefusal, distance

HEAD, ERROR_HEAD = 0xAA, 0xEE
RESULT = 0x0022
MOST_WORDS = 3
STATUS = {
    1: "power voltage too low",
    2: "internal error",
    3: "module too cold",
    4: "module too hot",
    5: "target out of range",
    6: "invalid result",
    7: "background light too strong",
    8: "laser signal too weak",
    9: "laser signal too strong",
    10: "hardware fault 1",
    11: "hardware fault 2",
    12: "hardware fault 3",
    13: "hardware fault 4",
    14: "hardware fault 5",
    15: "laser signal not stable",
    16: "hardware fault 6",
    17: "hardware fault 7",
    0x81: "invalid frame",
}


class JrtLaser(FrameProtocol):
    name: ClassVar[str] = "jrt"
    baud: ClassVar[int] = 19200
    heads: ClassVar[bytes] = bytes([HEAD, ERROR_HEAD])
    start = bytes.fromhex("AA 00 00 20 00 01 00 06 27")  # continuous, fast; 04: automatic, 05: slow
    stop = b"X"
    single = bytes.fromhex("AA 00 00 20 00 01 00 00 21")

    def _size(self, buffer: bytearray) -> int | None:
        if len(buffer) < 6:
            return None
        words = buffer[4] << 8 | buffer[5]
        return 7 + 2 * words if words <= MOST_WORDS else 0

    def _whole(self, frame: bytes) -> bool:
        return sum(frame[1:-1]) & 0xFF == frame[-1]

    def _read(self, frame: bytes) -> Heard | None:
        register, payload = frame[2] << 8 | frame[3], frame[6:-1]
        if frame[0] == ERROR_HEAD:
            code = int.from_bytes(payload[:2], "big")
            return LaserRefusal(f"error {code}: {STATUS.get(code, 'unknown')}")
        if register == RESULT and len(payload) == 6:
            return distance(int.from_bytes(payload[:4], "big") / 1000, float(int.from_bytes(payload[4:], "big")))
        return None
