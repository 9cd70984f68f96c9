"""MCAP files of ROS 2 messages: write, read (damaged ones too), recover. The only file that knows the mcap libraries.

A chunk ends with every stereo frame and after half a second at the latest; it goes to the disk as a whole, with its
checksum. What describes the file (schemas, channels, the attached rig) stands in it twice before the first image, so
that no single damage takes it. Nothing is compressed: images are compressed already.
"""

from __future__ import annotations

import os
import threading
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Header, MessageIndex, Schema
from mcap.records import Message as Record
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary
from mcap.writer import CompressionType
from mcap.writer import Writer as PlainWriter
from mcap_ros2._dynamic import serialize_dynamic
from mcap_ros2.decoder import DecoderFactory

from leadline.errors import InputError, in_words
from leadline.files import make_folder
from leadline.samples import NS_PER_S
from leadline.wire import mcap_records as layout
from leadline.wire.ros2_definitions import TOPIC_TYPES, definition
from leadline.wire.spool import Spool

CHUNK_S = 0.5
_UNPACKED_AT_MOST = 2**30  # bytes of a chunk: a damaged size must not take all memory
_MEDIA = {".yaml": "application/yaml", ".csv": "text/csv"}
_SPOILT_MAGIC = 2  # so many of its 8 bytes may be damaged


class RecordingWriter:
    """Messages of ``TOPIC_TYPES``' topics. Not closed, the file lacks its index and is readable all the same.

    A message that finds no room on the disk is kept for when there is some, up to 64 MiB; ``error`` says so meanwhile.
    Safe from several threads.
    """

    _first_ns: int  # of the messages in the chunk, in log time
    _last_ns: int

    def __init__(self, path: Path, attachments: Iterable[tuple[str, str, bytes]] = (), **limits: Any) -> None:
        """``attachments``: (name, media type, content). ``limits``: of the ``Spool``. Raises OSError."""
        types = sorted(set(TOPIC_TYPES.values()))
        self._schemas = [Schema(i, definition(name).encode(), "ros2msg", name) for i, name in enumerate(types, 1)]
        self._channels = {
            topic: Channel(i, topic, "cdr", {}, types.index(name) + 1)
            for i, (topic, name) in enumerate(TOPIC_TYPES.items(), 1)
        }
        self._encoders: dict[str, Callable[[Any], bytes]] = {}
        self._lock = threading.Lock()
        self._begin_chunk()
        self._define(self._chunk)
        self._spool = Spool(path, tick=self.flush, **limits)
        self._spool.append(self._head(list(attachments)))

    @property
    def lost(self) -> int:
        """Chunks that found no room, nor could be kept."""
        return self._spool.lost

    @property
    def error(self) -> OSError | None:
        """While the disk does not take what it is given: why."""
        return self._spool.error

    def write(self, topic: str, message: dict[str, Any], *, log_ns: int, publish_ns: int) -> None:
        """``log_ns``: when it reached us, ``publish_ns``: when it was taken; the file knows no time before 0."""
        channel, log_ns = self._channels[topic], max(log_ns, 0)
        data = self._encoder(topic)(message)
        with self._lock:
            self._index.setdefault(channel.id, []).append((log_ns, self._chunk.count))
            Record(channel.id, log_ns, data, max(publish_ns, 0), 0).write(self._chunk)
            self._first_ns, self._last_ns = min(self._first_ns, log_ns), max(self._last_ns, log_ns)

    def flush(self) -> None:
        """End the chunk and hand it to the disk. Raises OSError while that takes nothing."""
        with self._lock:
            if self._index:
                chunk = self._whole_chunk()
                self._begin_chunk()
                self._spool.append(chunk)

    def flush_if_due(self) -> None:
        """``flush`` where the chunk spans half a second of log time."""
        if self._last_ns - self._first_ns >= CHUNK_S * NS_PER_S:
            self.flush()

    def close(self) -> None:
        """Raises OSError where the end does not fit on the disk: the file then stays without its index."""
        if not self._spool.closed:
            with suppress(OSError):  # told again by what follows
                self.flush()
            self._spool.close(self._tail)

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def _encoder(self, topic: str) -> Callable[[Any], bytes]:
        if topic not in self._encoders:
            name = TOPIC_TYPES[topic]
            self._encoders[topic] = serialize_dynamic(name, definition(name))[name]
        return self._encoders[topic]

    def _begin_chunk(self) -> None:
        self._chunk = RecordBuilder()
        self._index: dict[int, list[tuple[int, int]]] = {}  # by channel: times and places of its messages
        self._first_ns, self._last_ns = 2**63 - 1, 0

    def _define(self, builder: RecordBuilder) -> None:
        for one in (*self._schemas, *self._channels.values()):
            one.write(builder)

    def _head(self, attachments: list[tuple[str, str, bytes]]) -> bytes:
        builder = RecordBuilder()
        builder.write(layout.MAGIC)
        Header("ros2", "leadline").write(builder)
        for name, media_type, content in attachments * 2:
            Attachment(0, 0, name, media_type, content).write(builder)
        self._define(builder)
        return bytes(builder.end())

    def _whole_chunk(self) -> bytes:
        data, builder = self._chunk.end(), RecordBuilder()
        Chunk(
            compression="",
            data=data,
            message_end_time=self._last_ns,
            message_start_time=self._first_ns,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        ).write(builder)
        for channel, places in self._index.items():
            MessageIndex(channel, places).write(builder)
        return bytes(builder.end())

    def _tail(self) -> bytes:
        """The index, of what stands in the file."""
        definitions = RecordBuilder()
        self._define(definitions)
        with self._spool.path.open("rb") as stream:
            return layout.tail(stream, definitions.end(), len(self._schemas), len(self._channels))


class Logged(NamedTuple):
    topic: str
    message: Any  # decoded: attributes named as the fields
    log_ns: int


Raw = tuple[Schema | None, Channel, Record]


class RecordingReader:
    """Reads in file order, the order in which things reached the recorder. InputError for a file that is not MCAP.

    ``on_damage`` is called, with one line, for each part that cannot be read; the rest is given.
    """

    def __init__(self, path: Path, on_damage: Callable[[str], None]) -> None:
        self.path, self._on_damage = path, on_damage
        try:
            self._size = path.stat().st_size
            with path.open("rb") as stream:
                magic = stream.read(len(layout.MAGIC))
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror})", str(path), "check the file") from None
        if len(magic) < len(layout.MAGIC) or sum(map(int.__ne__, magic, layout.MAGIC)) > _SPOILT_MAGIC:
            raise InputError("not an MCAP file", str(path), "give a recording made with --record")
        self._summary = _read_summary(path, self._size)

    @property
    def indexed(self) -> bool:
        return self._summary is not None

    def count(self, topic: str | None = None) -> int | None:
        """Messages on a topic, or on all; None where the file's summary is missing."""
        if self._summary is None or self._summary.statistics is None:
            return None
        counts: dict[int, int] = self._summary.statistics.channel_message_counts
        channels = self._summary.channels
        return sum(counts.get(key, 0) for key, channel in channels.items() if topic in (None, channel.topic))

    def attachments(self) -> dict[str, bytes]:
        """Those that are whole."""
        found: dict[str, bytes] = {}
        with self.path.open("rb") as stream:
            for opcode, _, content in self._attachment_pieces(stream):
                if opcode == layout.ATTACHMENT:
                    one = Attachment.read(ReadDataStream(BytesIO(content)))
                    found.setdefault(one.name, one.data)
                elif opcode == layout.CHUNK and found:
                    break  # ours stand before the first chunk
        return found

    def messages(self, topics: Iterable[str]) -> Iterator[Logged]:
        """The messages on ``topics``, decoded."""
        wanted, decoders = set(topics), DecoderFactory()
        for schema, channel, record in self.raw_messages():
            if channel.topic not in wanted:
                continue
            try:
                decode = decoders.decoder_for(channel.message_encoding, schema)
                if decode is None:
                    raise ValueError(f"not a ROS 2 message but {channel.message_encoding or 'of no encoding'}")
                message = decode(record.data)
            except Exception as error:  # whatever the bytes make of the decoder
                self._on_damage(f"a message on {channel.topic} cannot be decoded ({in_words(error)})")
                continue
            yield Logged(channel.topic, message, record.log_time)

    def raw_messages(self) -> Iterator[Raw]:
        """What the checksummed parts (summary, chunks) say of schemas and channels counts more than the rest."""
        schemas = dict(self._summary.schemas) if self._summary else {}
        channels = dict(self._summary.channels) if self._summary else {}
        for record, checked in self._records():
            if isinstance(record, Schema) and (checked or record.id not in schemas):
                schemas[record.id] = record
            elif isinstance(record, Channel) and (checked or record.id not in channels):
                channels[record.id] = record
            elif isinstance(record, Record) and record.channel_id in channels:
                channel = channels[record.channel_id]
                yield schemas.get(channel.schema_id), channel, record

    def _records(self) -> Iterator[tuple[Schema | Channel | Record, bool]]:
        """Schemas, channels and messages, each with whether a chunk's checksum vouches for it."""
        chunked = False
        with self.path.open("rb") as stream:
            for opcode, offset, content in layout.walk(stream, self._size, self._skipped):
                try:
                    if opcode == layout.CHUNK:
                        chunked = True
                        yield from ((record, True) for record in _unpack(content))
                    elif opcode == layout.DATA_END:
                        break  # what follows is the summary
                    elif opcode in _OUTER and not (chunked and opcode == layout.MESSAGE):
                        yield _OUTER[opcode](content), False
                except Exception as error:  # whatever the damaged bytes make of the parser
                    self._on_damage(f"a part at byte {offset} of {self._size} is damaged ({in_words(error)})")
            else:
                return  # told already
        if self._summary is None:
            self._on_damage("its index is missing or damaged")

    def _attachment_pieces(self, stream: BinaryIO) -> Iterator[layout.Piece]:
        if self._summary is None:
            yield from layout.walk(stream, self._size, lambda _: None)
            return
        for index in self._summary.attachment_indexes:
            piece = layout.piece_at(stream, index.offset, self._size)
            if piece is not None:
                yield piece

    def _skipped(self, part: layout.Skipped) -> None:
        if part.start == self._size:
            self._on_damage("it ends without its index: the recorder was killed, or had no room")
        elif part.at_end:
            self._on_damage(f"cannot be read beyond byte {part.start} of {self._size}")
        else:
            self._on_damage(f"bytes {part.start} to {part.end} of {self._size} are damaged")


@dataclass(frozen=True, slots=True)
class Recovery:
    """What a damaged recording gave: messages by topic, how long it is, and a line for each part that was lost."""

    counts: dict[str, int]
    length_s: float
    lost: list[str]
    attachments: list[str]


def recover(path: Path, out: Path) -> Recovery:
    """Write what can be read of a damaged recording to a new, indexed file, and read that back before it gets its name.

    Raises InputError where nothing can be read, or where ``out`` exists; OSError where the disk does not take it.
    """
    if out.exists():
        raise InputError("there is a file already", str(out), "give another name with --out")
    damage: list[str] = []
    reader = RecordingReader(path, damage.append)
    make_folder(out.parent)
    part = out.with_name(out.name + ".part")
    opened = _opened(part)
    try:
        with opened as stream:
            recovery = _copy(reader, PlainWriter(stream, compression=CompressionType.NONE), damage)
            stream.flush()
            os.fsync(stream.fileno())
        if not recovery.counts:
            raise InputError("no message can be read", str(path), "there is nothing to recover")
        _read_back(part, recovery)
        part.replace(out)
    except OSError as error:
        if error.filename is None:
            error.filename = str(part)
        raise
    finally:
        part.unlink(missing_ok=True)
    return recovery


def _opened(part: Path) -> BinaryIO:
    try:
        return part.open("wb")
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", str(part), "give another name with --out") from error


def _copy(reader: RecordingReader, writer: PlainWriter, damage: list[str]) -> Recovery:
    """``damage``: the list to which the reader adds its lines."""
    writer.start(profile="ros2", library="leadline")
    attached = reader.attachments()
    for name, content in attached.items():
        writer.add_attachment(0, 0, name, _MEDIA.get(Path(name).suffix, ""), content)
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    counts: Counter[str] = Counter()
    lost: list[str] = []
    first_ns = last_ns = 0
    for schema, channel, record in reader.raw_messages():
        first_ns = first_ns if counts else record.log_time
        lost += [f"{line}: {_between(last_ns - first_ns, record.log_time - first_ns)}" for line in damage]
        damage.clear()
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0), channel.metadata
            )
        writer.add_message(channels[channel.id], record.log_time, record.data, record.publish_time, record.sequence)
        counts[channel.topic] += 1
        last_ns = max(last_ns, record.log_time)
    writer.finish()
    lost += [f"{line}; the last message is of {(last_ns - first_ns) / NS_PER_S:.2f} s" for line in damage]
    expected = reader.count()
    if expected is not None and expected != counts.total():
        lost.append(f"{expected - counts.total()} of {expected} messages")
    return Recovery(dict(counts), (last_ns - first_ns) / NS_PER_S, lost, sorted(attached))


def _between(start_ns: int, end_ns: int) -> str:
    return f"nothing between {max(start_ns, 0) / NS_PER_S:.2f} s and {end_ns / NS_PER_S:.2f} s of the recording"


def _read_back(part: Path, recovery: Recovery) -> None:
    """Every message is there and can be decoded, as often as the damaged file's could be. RuntimeError if not."""
    damage: list[str] = []
    reader = RecordingReader(part, damage.append)
    counts = Counter(channel.topic for _, channel, _ in reader.raw_messages())
    indexed = {topic: reader.count(topic) for topic in counts}
    if damage or not dict(counts) == indexed == recovery.counts:
        raise RuntimeError(f"{part}: what was written is not what can be read: {damage[:1]} {indexed}")
    undecodable = Counter[str]()
    decoding = RecordingReader(part, lambda line: undecodable.update([line]))
    decoded = Counter(one.topic for one in decoding.messages(recovery.counts))
    if decoded.total() + undecodable.total() != counts.total():
        raise RuntimeError(f"{part}: {counts.total() - decoded.total()} messages cannot be decoded")
    recovery.lost.extend(f"{line}, {count} times" for line, count in undecodable.items())


_OUTER: dict[int, Callable[[bytes], Schema | Channel | Record]] = {
    layout.SCHEMA: lambda content: Schema.read(ReadDataStream(BytesIO(content))),
    layout.CHANNEL: lambda content: Channel.read(ReadDataStream(BytesIO(content))),
    layout.MESSAGE: lambda content: Record.read(ReadDataStream(BytesIO(content)), len(content)),
}


def _unpack(content: bytes) -> list[Any]:
    """The records of a chunk."""
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    if chunk.uncompressed_size > _UNPACKED_AT_MOST:
        raise ValueError(f"{chunk.uncompressed_size} bytes are no size of a part")
    # one that is not compressed is checked on the way here
    return list(breakup_chunk(chunk, validate_crc=bool(chunk.compression)))


def _read_summary(path: Path, size: int) -> Summary | None:
    """None where the file ends without one, or it is damaged."""
    with path.open("rb") as stream:
        try:
            if not layout.summary_is_sound(stream, size):
                return None
            stream.seek(0)
            return make_reader(stream).get_summary()
        except Exception:  # whatever the damaged bytes make of the parser
            return None
