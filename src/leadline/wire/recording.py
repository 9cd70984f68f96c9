"""MCAP files of ROS 2 messages: write, read (damaged ones too), recover. The only file that knows the mcap libraries.

A chunk ends with every stereo frame and at least once a second of log time, and goes to the disk at once: a killed
writer loses that much and no more. Nothing is compressed: images are compressed already.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, NamedTuple

from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Schema
from mcap.records import Message as Record
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from mcap.writer import CompressionType
from mcap.writer import Writer as PlainWriter
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as Ros2Writer

from leadline.errors import InputError
from leadline.samples import NS_PER_S
from leadline.wire.ros2_definitions import TOPIC_TYPES, definition

_CHUNK_BYTES = 64 * 2**20  # never reached: flush() ends a chunk, so that a sample's messages stay together
_MAGIC = b"\x89MCAP0\r\n"


class RecordingWriter:
    """Messages of ``TOPIC_TYPES``' topics. Not closed, the file lacks its index and is readable all the same."""

    def __init__(self, path: Path, attachments: Iterable[tuple[str, str, bytes]] = ()) -> None:
        """``attachments``: (name, media type, content), written first, so that they survive what happens later."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self._stream: BinaryIO = path.open("wb")
        self._writer = Ros2Writer(self._stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.NONE)
        self._chunks: PlainWriter = self._writer._writer  # the ROS 2 writer does not hand through flush()
        for name, media_type, content in attachments:
            self._writer.add_attachment(0, 0, name, media_type, content)
        self._schemas = {
            name: self._writer.register_msgdef(name, definition(name)) for name in set(TOPIC_TYPES.values())
        }
        self._log_ns = self._flushed_ns = 0

    def write(self, topic: str, message: dict[str, Any], *, log_ns: int, publish_ns: int) -> None:
        """``log_ns``: when it reached us, ``publish_ns``: when it was taken; the file knows no time before 0."""
        schema = self._schemas[TOPIC_TYPES[topic]]
        self._writer.write_message(topic, schema, message, max(log_ns, 0), max(publish_ns, 0))
        self._log_ns = log_ns

    def flush(self) -> None:
        """End the chunk and hand it to the system."""
        self._chunks.flush()
        self._flushed_ns = self._log_ns

    def flush_if_due(self) -> None:
        """``flush`` where the last one was a second of log time ago."""
        if self._log_ns - self._flushed_ns >= NS_PER_S:
            self.flush()

    def close(self) -> None:
        if not self._stream.closed:
            self._writer.finish()
            self._stream.close()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()


class Logged(NamedTuple):
    topic: str
    message: Any  # decoded: attributes named as the fields
    log_ns: int


class RecordingReader:
    """Reads in file order, the order in which things reached the recorder. InputError for a file that is not MCAP.

    ``on_damage`` is called, with one line, for each part that cannot be read; the rest is given.
    """

    def __init__(self, path: Path, on_damage: Callable[[str], None]) -> None:
        self.path, self._on_damage = path, on_damage
        try:
            with path.open("rb") as stream:
                magic = stream.read(len(_MAGIC))
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror})", str(path), "check the file") from None
        if magic != _MAGIC:
            raise InputError("not an MCAP file", str(path), "give a recording made with --record")
        self._summary = _read_summary(path)

    def count(self, topic: str) -> int | None:
        """Messages on a topic; None where the file's summary is missing."""
        if self._summary is None or self._summary.statistics is None:
            return None
        counts: dict[int, int] = self._summary.statistics.channel_message_counts
        return sum(counts.get(key, 0) for key, channel in self._summary.channels.items() if channel.topic == topic)

    def attachments(self) -> dict[str, bytes]:
        if self._summary is not None:
            with self.path.open("rb") as stream:
                return {one.name: one.data for one in make_reader(stream).iter_attachments()}
        return {record.name: record.data for record in self._records(lambda _: None) if isinstance(record, Attachment)}

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
                self._on_damage(f"a message on {channel.topic} cannot be decoded ({_told(error)})")
                continue
            yield Logged(channel.topic, message, record.log_time)

    def raw_messages(self) -> Iterator[tuple[Schema | None, Channel, Record]]:
        schemas = dict(self._summary.schemas) if self._summary else {}
        channels = dict(self._summary.channels) if self._summary else {}
        for record in self._records(self._on_damage):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Record) and record.channel_id in channels:
                channel = channels[record.channel_id]
                yield schemas.get(channel.schema_id), channel, record

    def _records(self, on_damage: Callable[[str], None]) -> Iterator[Any]:
        """All records up to the end, or to where the file cannot be followed any further; damaged chunks left out."""
        size = self.path.stat().st_size
        with self.path.open("rb") as stream:
            records = iter(StreamReader(stream, emit_chunks=True, record_size_limit=size).records)
            while True:
                try:
                    record = next(records, None)
                except Exception as error:  # whatever the damaged bytes make of the parser
                    return on_damage(f"cannot be read beyond byte {stream.tell()} of {size} ({_told(error)})")
                if record is None:
                    return None
                try:
                    inside = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
                except Exception as error:
                    on_damage(f"a part before byte {stream.tell()} of {size} is damaged ({_told(error)})")
                    continue
                yield from inside


def recover(path: Path, out: Path) -> list[str]:
    """Write what can be read of a damaged recording to a new, indexed file; returns one line for each part lost.

    Raises InputError where nothing can be read, or where ``out`` exists.
    """
    if out.exists():
        raise InputError("there is a file already", str(out), "give another name")
    damage: list[str] = []
    reader = RecordingReader(path, damage.append)
    part = out.with_name(out.name + ".part")
    with part.open("wb") as stream:
        count = _copy(reader, PlainWriter(stream, compression=CompressionType.NONE))
    if not count:
        part.unlink()
        raise InputError("no message can be read", str(path), "there is nothing to recover")
    part.replace(out)
    return damage


def _copy(reader: RecordingReader, writer: PlainWriter) -> int:
    writer.start(profile="ros2")
    for name, content in reader.attachments().items():
        writer.add_attachment(0, 0, name, "", content)
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    count = 0
    for schema, channel, record in reader.raw_messages():
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0), channel.metadata
            )
        writer.add_message(channels[channel.id], record.log_time, record.data, record.publish_time, record.sequence)
        count += 1
    writer.finish()
    return count


def _told(error: Exception) -> str:
    return str(error) or type(error).__name__


def _read_summary(path: Path) -> Summary | None:
    """None where the file ends without one, or it is damaged."""
    with path.open("rb") as stream:
        try:
            return make_reader(stream).get_summary()
        except Exception:  # whatever the damaged bytes make of the parser
            return None
