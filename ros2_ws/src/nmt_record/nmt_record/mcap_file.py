"""Reads MCAP files by chunks, whole ones by their index and truncated ones as far as they go."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import yaml
import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader

from nmt_core.errors import BenchError
from nmt_record.message_definitions import MessageDefinition

MAGIC = b"\x89MCAP0\r\n"

_OP_FOOTER, _OP_SCHEMA, _OP_CHANNEL, _OP_MESSAGE, _OP_CHUNK, _OP_DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
_UINT16 = struct.Struct("<H")
_UINT32 = struct.Struct("<I")
_UINT64 = struct.Struct("<Q")
# A record longer than this is a damaged length field; a bench chunk has a few megabytes.
_LARGEST_CHUNK = 2**31

# What a damaged record can raise while it is being taken apart.
_DAMAGE = (
    struct.error,
    ValueError,
    IndexError,
    KeyError,
    RuntimeError,
    MemoryError,
    zstandard.ZstdError,
    EOFError,
)


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic as the file describes it."""

    topic: str
    message_type: str
    definition: MessageDefinition
    serialization: str
    offered_qos: list[dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Stretch:
    """Consecutive records in the file: the content of one chunk, or messages outside of chunks.

    Attributes:
        offset: of the chunk's content, or of the first record.
        length: bytes.
        chunk: whether it is a chunk.
        channels: ids of the channels with messages in it.
    """

    offset: int
    length: int
    chunk: bool
    channels: frozenset[int]


@dataclass(slots=True)
class McapFile:
    """An opened MCAP file; the file itself is open only while messages are read.

    Attributes:
        path: of the file.
        channels: by id.
        stretches: in the order of the file.
        counts: messages by channel id.
        lost_bytes: bytes at the end that could not be used.
        damage: why they could not, a clause; None if the file is whole.
    """

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    stretches: list[Stretch] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    lost_bytes: int = 0
    damage: str | None = None

    @classmethod
    def open(cls, path: Path) -> McapFile:
        """Open a file, whole or truncated.

        Raises:
            BenchError: it cannot be read, is empty, or is not MCAP.
        """
        bag = cls(path)
        try:
            with path.open("rb") as file:
                check_magic(path, file.read(16))
                if not bag._read_index(file):
                    bag._scan(file, path.stat().st_size)
        except OSError as error:
            raise BenchError(f"The bag file {path} cannot be read: {error.strerror or error}.") from error
        return bag

    def raw_messages(self, wanted: set[int] | None = None) -> Iterator[tuple[int, int, int, bytes]]:
        """Messages in the order of the file.

        Args:
            wanted: ids of channels; None = all.

        Yields:
            Channel id, log time (ns), publish time (ns), serialised message.

        Raises:
            BenchError: a chunk is damaged or cannot be read.
        """
        try:
            with self.path.open("rb") as file:
                for stretch in self.stretches:
                    if wanted is not None and wanted.isdisjoint(stretch.channels):
                        continue
                    try:
                        content = _read_exact(file, stretch.offset, stretch.length)
                        data = _unpack_chunk(content) if stretch.chunk else content
                        messages = list(_messages(data, wanted))
                    except _DAMAGE as error:
                        raise BenchError(
                            f"The bag file {self.path} is damaged at byte {stretch.offset} ({error}); "
                            "take it from its source again."
                        ) from error
                    yield from messages
        except OSError as error:
            raise BenchError(f"The bag file {self.path} cannot be read: {error.strerror or error}.") from error

    def _read_index(self, file: Any) -> bool:
        """Take channels and chunks from the summary; False if there is none to rely on."""
        size = file.seek(0, 2)
        tail = 8 + 29  # magic, footer
        if size < len(MAGIC) + tail or _read_exact(file, size - 8, 8) != MAGIC:
            return False
        try:
            opcode, length = _RECORD.unpack(_read_exact(file, size - tail, 9))
            if opcode != _OP_FOOTER or length != 20:
                return False
            file.seek(0)
            summary = make_reader(file).get_summary()
        except (McapError, *_DAMAGE):  # the scan decides how far the file is good
            return False
        statistics = summary and summary.statistics
        if not summary or not statistics or (statistics.message_count and not summary.chunk_indexes):
            return False
        if len(summary.channels) != statistics.channel_count or len(summary.schemas) != statistics.schema_count:
            return False
        try:
            for channel in summary.channels.values():
                schema = summary.schemas.get(channel.schema_id)
                self.channels[channel.id] = _channel(
                    channel.topic,
                    channel.message_encoding,
                    channel.metadata,
                    (schema.name, schema.encoding, schema.data.decode()) if schema else ("", "", ""),
                )
        except _DAMAGE:
            self.channels.clear()
            return False
        for index in sorted(summary.chunk_indexes, key=lambda item: item.chunk_start_offset):
            seen = frozenset(index.message_index_offsets) or frozenset(self.channels)
            self.stretches.append(
                Stretch(index.chunk_start_offset + _RECORD.size, index.chunk_length - _RECORD.size, True, seen)
            )
        self.counts = {cid: int(statistics.channel_message_counts.get(cid, 0)) for cid in self.channels}
        return True

    def _scan(self, file: Any, size: int) -> None:
        """Walk through the records up to the end of the data or the first broken record."""
        schemas: dict[int, tuple[str, str, str]] = {}
        position = len(MAGIC)
        while position < size:
            try:
                opcode, length = _RECORD.unpack(_read_exact(file, position, _RECORD.size))
                start, end = position + _RECORD.size, position + _RECORD.size + length
                if opcode == _OP_DATA_END:
                    self._check_end(file, size)
                    return
                if not 0 < opcode <= _OP_DATA_END and opcode < 0x80:
                    raise ValueError(f"unknown record {opcode:#04x}")
                if end > size:
                    raise ValueError("the last record is incomplete")
                if opcode == _OP_CHUNK:
                    data = _unpack_chunk(_read_exact(file, start, length))
                    self._add(Stretch(start, length, True, frozenset(self._take(data, schemas))))
                elif opcode in (_OP_SCHEMA, _OP_CHANNEL, _OP_MESSAGE):
                    data = _read_exact(file, position, _RECORD.size + length)
                    seen = frozenset(self._take(data, schemas))
                    if seen:
                        self._add(Stretch(position, len(data), False, seen))
            except _DAMAGE as error:
                self.damage = str(error)
                self.lost_bytes = size - position
                return
            position = end
        self.damage = "the file ends without its index"

    def _add(self, stretch: Stretch) -> None:
        before = self.stretches[-1] if self.stretches else None
        if before and not before.chunk and not stretch.chunk and before.offset + before.length == stretch.offset:
            self.stretches[-1] = Stretch(
                before.offset, before.length + stretch.length, False, before.channels | stretch.channels
            )
        else:
            self.stretches.append(stretch)

    def _check_end(self, file: Any, size: int) -> None:
        if _read_exact(file, size - 8, 8) != MAGIC:
            self.damage = "its index is incomplete"

    def _take(self, data: bytes | memoryview, schemas: dict[int, tuple[str, str, str]]) -> set[int]:
        """Note schemas, channels and counts of some records, all or nothing; returns the channels seen."""
        new_channels: dict[int, Channel] = {}
        counts: dict[int, int] = {}
        for opcode, start, end in _records(data):
            if opcode == _OP_MESSAGE:
                (channel_id,) = _UINT16.unpack_from(data, start)
                if channel_id not in self.channels and channel_id not in new_channels:
                    raise ValueError("a message belongs to no channel")
                counts[channel_id] = counts.get(channel_id, 0) + 1
            elif opcode == _OP_SCHEMA:
                (schema_id,) = _UINT16.unpack_from(data, start)
                name, at = _string(data, start + 2, end)
                encoding, at = _string(data, at, end)
                text, _ = _string(data, at, end)
                schemas[schema_id] = (name, encoding, text)
            elif opcode == _OP_CHANNEL:
                channel_id, schema_id = struct.unpack_from("<HH", data, start)
                topic, at = _string(data, start + 4, end)
                message_encoding, at = _string(data, at, end)
                (map_length,) = _UINT32.unpack_from(data, at)
                at, stop, metadata = at + 4, at + 4 + map_length, {}
                while at < stop:
                    key, at = _string(data, at, end)
                    metadata[key], at = _string(data, at, end)
                new_channels[channel_id] = _channel(
                    topic, message_encoding, metadata, schemas.get(schema_id, ("", "", ""))
                )
        self.channels.update(new_channels)
        for channel_id, count in counts.items():
            self.counts[channel_id] = self.counts.get(channel_id, 0) + count
        return set(counts)


def check_magic(path: Path, head: bytes) -> None:
    """Refuse what is not MCAP.

    Raises:
        BenchError: with what the file is instead, as far as its first bytes tell.
    """
    if not head:
        raise BenchError(f"The bag file {path} is empty; nothing was recorded into it.")
    if head.startswith(b"#ROSBAG V"):
        raise BenchError(
            f"The file {path} is a ROS 1 bag; convert it with 'rosbags-convert --src {path.name} --dst …'."
        )
    if not MAGIC.startswith(head[: len(MAGIC)]):
        raise BenchError(f"The file {path} is not a bag; a rosbag2 folder or an .mcap file is needed.")
    if len(head) < len(MAGIC):
        raise BenchError(f"The bag file {path} ends after {len(head)} bytes; nothing was recorded into it.")


def _read_exact(file: Any, offset: int, length: int) -> bytes:
    if not 0 <= length <= _LARGEST_CHUNK:
        raise ValueError(f"a record claims {length} bytes")
    file.seek(offset)
    data: bytes = file.read(length)
    if len(data) != length:
        raise ValueError("the last record is incomplete")
    return data


def _unpack_chunk(content: bytes) -> bytes | memoryview:
    """Records in a chunk, checked by size and checksum."""
    _, _, size, checksum = _CHUNK.unpack_from(content)
    compression, at = _string(content, _CHUNK.size, len(content))
    (length,) = _UINT64.unpack_from(content, at)
    at += 8
    if length != len(content) - at or size > _LARGEST_CHUNK:
        raise ValueError("a chunk claims another size than it has")
    data: bytes | memoryview = memoryview(content)[at:]  # without a copy
    if compression == "zstd":
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    elif compression == "lz4":
        data = lz4.frame.decompress(data)
    elif compression:
        raise ValueError(f"compression {compression!r} is not known")
    if len(data) != size or (checksum and zlib.crc32(data) != checksum):
        raise ValueError("the checksum of a chunk is wrong")
    return data


def _records(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """Opcode, begin and end of the content of each record."""
    position, size = 0, len(data)
    while position < size:
        opcode, length = _RECORD.unpack_from(data, position)
        start = position + 9
        position = start + length
        if position > size:
            raise ValueError("a record reaches beyond its chunk")
        yield opcode, start, position


def _messages(data: bytes | memoryview, wanted: set[int] | None) -> Iterator[tuple[int, int, int, bytes]]:
    record, message, size = _RECORD.unpack_from, _MESSAGE.unpack_from, len(data)
    position = 0
    while position < size:
        opcode, length = record(data, position)
        start = position + 9
        position = start + length
        if position > size:
            raise ValueError("a record reaches beyond its chunk")
        if opcode == _OP_MESSAGE:
            channel, _, log_time, publish_time = message(data, start)
            if wanted is None or channel in wanted:
                # A copy of its own is aligned, so arrays in it are, too.
                yield channel, log_time, publish_time, bytes(data[start + 22 : position])


def _string(data: bytes | memoryview, position: int, end: int) -> tuple[str, int]:
    (length,) = _UINT32.unpack_from(data, position)
    stop = position + 4 + length
    if stop > end:
        raise ValueError("a text reaches beyond its record")
    return str(data[position + 4 : stop], "utf-8"), stop


def _channel(topic: str, serialization: str, metadata: dict[str, str], schema: tuple[str, str, str]) -> Channel:
    name, encoding, text = schema
    try:
        profiles = yaml.safe_load(metadata.get("offered_qos_profiles", "")) or []
    except yaml.YAMLError:
        profiles = []
    definition = MessageDefinition(text, metadata.get("topic_type_hash", ""), encoding)
    return Channel(topic, name, definition, serialization, profiles if isinstance(profiles, list) else [])
