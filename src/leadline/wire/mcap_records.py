"""The records of an MCAP file that may be damaged: whole ones in order, over what cannot be read to the next whole one.

Byte layout: https://mcap.dev/spec. A record is its opcode (1 byte), its length (8) and its content. Chunks and
attachments carry a checksum, so that they are known again wherever they begin.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from typing import BinaryIO, NamedTuple

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
ATTACHMENT, SUMMARY_OFFSET, DATA_END = 0x09, 0x0E, 0x0F
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct(
    "<QQQII"
)  # first and last time, size and checksum unpacked, length of the compression's name
_FIXED = {FOOTER: 20, SUMMARY_OFFSET: 17, DATA_END: 4}
_BEFORE_TEXTS = {SCHEMA: 2, CHANNEL: 4}  # bytes before the three texts that fill such a record
_LONGEST_NAME = 1024
_SIGN = re.compile(rb"[\x06\x09](?=.{4}\0{4})", re.DOTALL)  # a chunk or an attachment, below 4 GiB
_WINDOW = 2**20


class Piece(NamedTuple):
    opcode: int
    offset: int  # of its first byte in the file
    content: bytes


class Skipped(NamedTuple):
    """Bytes ``start`` to ``end`` of the file cannot be read; ``at_end``: nothing whole comes after them."""

    start: int
    end: int
    at_end: bool


def walk(stream: BinaryIO, size: int, skipped: Callable[[Skipped], None]) -> Iterator[Piece]:
    """The whole records from the beginning to the footer."""
    place = len(MAGIC)
    while place < size:
        piece = piece_at(stream, place, size)
        if piece is None:
            found = _next(stream, place + 1, size)
            skipped(Skipped(place, size if found is None else found, found is None))
            if found is None:
                return
            place = found
            continue
        yield piece
        if piece.opcode == FOOTER:
            return
        place += _HEAD.size + len(piece.content)
    skipped(Skipped(size, size, True))  # it ends without its footer


def piece_at(stream: BinaryIO, place: int, size: int) -> Piece | None:
    """The record that begins there, if it is whole."""
    stream.seek(place)
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    opcode, length = _HEAD.unpack(head)
    if length > size - place - _HEAD.size or not _may_begin(opcode, length, stream, place):
        return None
    stream.seek(place + _HEAD.size)
    content = stream.read(length)
    return Piece(opcode, place, content) if len(content) == length and _sound(opcode, content) else None


def _may_begin(opcode: int, length: int, stream: BinaryIO, place: int) -> bool:
    """A look at the first bytes, before all of it is read."""
    if opcode == CHUNK:
        if length < _CHUNK_HEAD.size + 8:
            return False
        named = _CHUNK_HEAD.unpack(stream.read(_CHUNK_HEAD.size))[4]
        if named > _LONGEST_NAME or length < _CHUNK_HEAD.size + named + 8:
            return False
        stream.seek(place + _HEAD.size + _CHUNK_HEAD.size + named)
        return bool(length == _CHUNK_HEAD.size + named + 8 + int.from_bytes(stream.read(8), "little"))
    if opcode == ATTACHMENT:
        return length >= 36
    return 0 < opcode <= DATA_END


def _sound(opcode: int, content: bytes) -> bool:
    if opcode == CHUNK:
        _, _, unpacked, checksum, named = _CHUNK_HEAD.unpack_from(content)
        data = memoryview(content)[_CHUNK_HEAD.size + named + 8 :]
        return bool(named or (unpacked == len(data) and checksum in (0, zlib.crc32(data))))
    if opcode == ATTACHMENT:
        return int.from_bytes(content[-4:], "little") in (0, zlib.crc32(memoryview(content)[:-4]))
    if opcode == MESSAGE_INDEX:
        return len(content) >= 6 and len(content) == 6 + int.from_bytes(content[2:6], "little")
    if opcode in _BEFORE_TEXTS:
        end = _BEFORE_TEXTS[opcode]
        for _ in range(3):
            end += 4 + int.from_bytes(content[end : end + 4], "little")
        return end == len(content)
    return len(content) == _FIXED.get(opcode, len(content))


def _next(stream: BinaryIO, start: int, size: int) -> int | None:
    """Where the next whole chunk or attachment begins."""
    while start < size:
        stream.seek(start)
        window = stream.read(_WINDOW)
        for sign in _SIGN.finditer(window):
            if piece_at(stream, start + sign.start(), size) is not None:
                return start + sign.start()
        start += max(len(window) - _HEAD.size + 1, 1) if len(window) == _WINDOW else size
    return None


def summary_is_sound(stream: BinaryIO, size: int) -> bool:
    """Whether the file ends with a summary whose checksum holds (a checksum of 0: none was made)."""
    tail = 9 + 20 + len(MAGIC)
    if size < tail + len(MAGIC):
        return False
    stream.seek(size - tail)
    opcode, length, start, _, checksum = struct.unpack("<BQQQI", stream.read(tail - len(MAGIC)))
    if opcode != FOOTER or length != _FIXED[FOOTER] or not 0 < start < size or stream.read(8) != MAGIC:
        return False
    stream.seek(start)
    found, left = 0, size - len(MAGIC) - 4 - start
    while left > 0 and (block := stream.read(min(left, _WINDOW))):
        found, left = zlib.crc32(block, found), left - len(block)
    return checksum in (0, found)


def tail(stream: BinaryIO, definitions: bytes, schemas: int, channels: int) -> bytes:
    """What ends a sound file of uncompressed chunks: index of chunks and attachments, counts of messages, footer.

    ``definitions``: the records of its schemas and channels.
    """
    size = stream.seek(0, 2)
    index, attachments, counts = bytearray(), [], Counter[int]()
    first_ns, last_ns, chunks, place = 2**63 - 1, 0, 0, len(MAGIC)
    while place < size:
        opcode, length = _read_head(stream, place)
        if opcode == CHUNK:
            first, last, unpacked = struct.unpack("<QQQ", stream.read(24))
            offsets, behind = _message_indexes(stream, place + _HEAD.size + length, size, counts)
            places = b"".join(struct.pack("<HQ", *one) for one in offsets)
            what = struct.pack("<QQQQI", first, last, place, _HEAD.size + length, len(places))
            index += _record(0x08, what + places + struct.pack("<QIQQ", behind, 0, unpacked, unpacked))
            first_ns, last_ns, chunks = min(first_ns, first), max(last_ns, last), chunks + 1
            place += behind
        elif opcode == ATTACHMENT:
            attachments.append(_attachment_index(place, stream.read(length)))
        place += _HEAD.size + length
    entries = b"".join(struct.pack("<HQ", channel, count) for channel, count in counts.items())
    numbers = counts.total(), schemas, channels, len(attachments), 0, chunks, first_ns if chunks else 0, last_ns
    statistics = _record(0x0B, struct.pack("<QHIIIIQQI", *numbers, len(entries)) + entries)
    content = b"".join([definitions, statistics, index, *attachments])
    end = _record(DATA_END, bytes(4))
    footer = _HEAD.pack(FOOTER, 20) + struct.pack("<QQ", size + len(end), 0)
    return end + content + footer + struct.pack("<I", zlib.crc32(footer, zlib.crc32(content))) + MAGIC


def _message_indexes(
    stream: BinaryIO, place: int, size: int, counts: Counter[int]
) -> tuple[list[tuple[int, int]], int]:
    """Channel and offset of the message indexes behind a chunk, and their length in all; adds to ``counts``."""
    offsets, start = [], place
    while place < size:
        opcode, length = _read_head(stream, place)
        if opcode != MESSAGE_INDEX:
            break
        channel, entries = struct.unpack("<HI", stream.read(6))
        counts[channel] += entries // 16
        offsets.append((channel, place))
        place += _HEAD.size + length
    return offsets, place - start


def _attachment_index(place: int, content: bytes) -> bytes:
    stamps, rest = content[:16], content[16:]
    names = 4 + int.from_bytes(rest[:4], "little")
    names += 4 + int.from_bytes(rest[names : names + 4], "little")
    size = rest[names : names + 8]
    return _record(0x0A, struct.pack("<QQ", place, _HEAD.size + len(content)) + stamps + size + rest[:names])


def _read_head(stream: BinaryIO, place: int) -> tuple[int, int]:
    """Opcode and length; the stream stands at the content."""
    stream.seek(place)
    opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
    return opcode, length


def _record(opcode: int, content: bytes) -> bytes:
    return _HEAD.pack(opcode, len(content)) + content
