"""LightWare LW20/SF20: the binary LWNX protocol, and the plain text that the SF11 and the LW20 speak too.

    AA  flags(2)  id  data...  crc(2)       flags: bits 6-15 the payload's length (id and data), bit 0 write

Distance data (44) holds what Distance output (27) asks for: here the median of the first return (bit 2, int16, cm) and
its strength (bit 4, int16, %). Stream (30) = 5 sends it at the measuring rate. The checksum is CRC-16-CCITT 0x1021 from
0 (XMODEM). A distance of 0 or less is a lost signal.

Source: LightWare's own documents, LW20-docs/serial.md ("Packets", "Checksum") and command_detail.md (27, 30, 44). Text:
"SF11 product manual", Appendix E, page 19 (``?LD`` -> ``?LD 98.67``, ``d`` -> ``98.67``), "LW20 / SF20 product manual",
Appendix C, pages 24-26 (``?LD`` -> ``ld,0:23.67``, ``d`` -> ``78.32``).
"""

from __future__ import annotations

import binascii
import re
from typing import ClassVar

from leadline.wire.laser_protocol import FrameProtocol, Heard, LaserRefusal, LineProtocol, distance

HEAD = 0xAA
PRODUCT, OUTPUT, STREAM, DISTANCE = 0, 27, 30, 44
MEDIAN_AND_STRENGTH = 1 << 2 | 1 << 4
SIZES = {PRODUCT: (1, 17), OUTPUT: (1, 5), STREAM: (1, 5), DISTANCE: (1, 5), 50: (1, 2)}  # payloads that are ours


def packet(command: int, data: bytes = b"", *, write: bool = False) -> bytes:
    """A request or an answer."""
    flags = (1 + len(data)) << 6 | write
    head = bytes([HEAD, flags & 0xFF, flags >> 8, command]) + data
    return head + binascii.crc_hqx(head, 0).to_bytes(2, "little")


def _set(command: int, value: int) -> bytes:
    return packet(command, value.to_bytes(4, "little"), write=True)


class LightwareLaser(FrameProtocol):
    """The first packets only wake the device up (serial.md, "Initiating communication")."""

    name: ClassVar[str] = "lightware"
    baud: ClassVar[int] = 115200
    heads: ClassVar[bytes] = bytes([HEAD])
    start = packet(PRODUCT) * 2 + _set(OUTPUT, MEDIAN_AND_STRENGTH) + packet(STREAM, b"\x05", write=True)
    stop = packet(STREAM, b"\x00", write=True)
    single = packet(DISTANCE)

    def _size(self, buffer: bytearray) -> int | None:
        if len(buffer) < 4:
            return None
        length = (buffer[1] | buffer[2] << 8) >> 6
        return length + 5 if not buffer[1] & 0x3E and length in SIZES.get(buffer[3], ()) else 0

    def _whole(self, frame: bytes) -> bool:
        return binascii.crc_hqx(frame[:-2], 0) == int.from_bytes(frame[-2:], "little")

    def _read(self, frame: bytes) -> Heard | None:
        payload = frame[3:-2]
        if payload[0] != DISTANCE or len(payload) != 5:
            return None
        centimetres = int.from_bytes(payload[1:3], "little", signed=True)
        if centimetres <= 0:
            return LaserRefusal("signal lost")
        return distance(centimetres / 100, float(int.from_bytes(payload[3:5], "little", signed=True)))

    def _silent(self, used: int) -> bool:
        return used >= 6


_TEXT = re.compile(r"(?:\?LD[ !]?|l?ld?(?:,\d)?:)?(-?\d{1,3}\.\d{1,2})(?: ?m)?")


class LightwareTextLaser(LineProtocol):
    """Asked with ``?LD`` again and again; understands the old plain output as well."""

    name: ClassVar[str] = "lightware-text"
    baud: ClassVar[int] = 115200
    polled: ClassVar[bool] = True
    start = b"\r\n"  # the first one only tells the device that it is on a serial line
    single = b"?LD\r\n"

    def _read(self, line: str) -> Heard | None:
        found = _TEXT.fullmatch(line)
        if found is None:
            if re.fullmatch(r"[?#$%]?[A-Za-z]{1,4}[ -~]{0,28}", line):
                return None
            raise ValueError(line)
        range_m = float(found[1])
        return LaserRefusal("signal lost") if range_m <= 0 else distance(range_m)
