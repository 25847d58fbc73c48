"""Reads MCAP files by chunks: whole ones by their index, cut or damaged ones as far as their chunks are good.

A chunk that cannot be read is left out and named; the file is read on behind it.
"""

from __future__ import annotations

import copy
import itertools
import math
import struct
import zlib
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader

from nmt_core.errors import BenchError
from nmt_core.files.hardened import open_regular, yaml_value
from nmt_record.bag.message_definitions import MessageDefinition

MAGIC = b"\x89MCAP0\r\n"

_OP_FOOTER, _OP_SCHEMA, _OP_CHANNEL, _OP_MESSAGE, _OP_CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
_OP_MESSAGE_INDEX, _OP_DATA_END = 0x07, 0x0F
_RECORD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
_UINT16 = struct.Struct("<H")
_UINT32 = struct.Struct("<I")
_UINT64 = struct.Struct("<Q")
# A record longer than this is a damaged length field, and a chunk that unpacks to more is a bomb; a bench chunk has a
# few megabytes.
_LARGEST_CHUNK = 2**28
_CHUNK_HEAD = 40  # bytes in front of the records of an uncompressed chunk
_LONGEST_STRETCH = 2**22  # bytes of loose messages that are read together

# What a damaged record can raise while it is being taken apart.
_DAMAGE = (
    struct.error,
    ValueError,
    IndexError,
    KeyError,
    RuntimeError,
    OverflowError,
    MemoryError,
    zstandard.ZstdError,
    EOFError,
)


@dataclass(frozen=True, slots=True)
class McapChannel:
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
        packing: compression, size packed and size unpacked as the index has them; None = the chunk says so itself.
        fault: why it cannot be read, as far as that was found out when the file was opened; empty if it can.
        first_time: earliest log time in it, ns.
    """

    offset: int
    length: int
    chunk: bool
    channels: frozenset[int]
    packing: tuple[str, int, int] | None = None
    fault: str = ""
    first_time: int = 0


@dataclass(frozen=True, slots=True)
class LostStretch:
    """Part of a file that could not be read.

    Attributes:
        path: of the file.
        offset: of its first byte.
        length: bytes.
        reason: a clause.
        counts: messages lost by channel id, as far as the index tells; empty if it does not.
    """

    path: Path
    offset: int
    length: int
    reason: str
    counts: dict[int, int]


@dataclass(slots=True)
class McapFile:
    """An opened MCAP file; the file itself is open only while messages are read.

    Attributes:
        path: of the file.
        channels: by id.
        stretches: in the order of the file.
        counts: messages by channel id.
        lost_bytes: bytes at the end that could not be used.
        damage: why the end or the index could not be used, a clause; None if both could.
        cut: whether the file ends before its regular end.
    """

    path: Path
    channels: dict[int, McapChannel] = field(default_factory=dict)
    stretches: list[Stretch] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    lost_bytes: int = 0
    damage: str | None = None
    cut: bool = False
    _end_is_whole: bool = False
    _read_whole: set[int] = field(default_factory=set)

    @classmethod
    def open(cls, path: Path) -> McapFile:
        """Open a file, whole, cut or damaged.

        Raises:
            BenchError: it cannot be read, is empty, or is not MCAP.
        """
        bag = cls(path)
        try:
            with open_regular(path, "bag file", 2**62) as file:
                check_magic(path, file.read(16))
                if not bag._read_index(file):
                    bag._scan(file, path.stat().st_size)
        except OSError as error:
            raise BenchError(f"The bag file {path} cannot be read: {error.strerror or error}.") from error
        return bag

    def raw_messages(self, wanted: set[int] | None = None) -> Iterator[tuple[int, int, int, bytes]]:
        """Messages in the order of their log time, equal ones in that of the file; those in stretches that cannot be
        read are left out.

        A file that was merged or converted may hold them in another order; what overlaps is kept until it is complete.

        Args:
            wanted: ids of channels; None = all.

        Yields:
            Channel id, log time (ns), publish time (ns), serialised message.

        Raises:
            BenchError: the file cannot be read.
        """
        wanted = set(self.channels) if wanted is None else wanted & set(self.channels)
        held = [item for item in self.stretches if item.fault or not wanted.isdisjoint(item.channels)]
        waiting: list[tuple[int, int, int, bytes]] = []
        # Before the earliest time still to be read, nothing more can come.
        firsts = [math.inf if item.fault else item.first_time for item in held]
        bounds = [*itertools.accumulate([math.inf, *firsts[:0:-1]], min)][::-1] if held else []
        for part, bound in zip(self._read(held, wanted), bounds, strict=True):
            waiting = _in_order(waiting, [] if isinstance(part, LostStretch) else part)
            count = (
                len(waiting) if not waiting or waiting[-1][1] <= bound else bisect_right(waiting, bound, key=_log_time)
            )
            yield from waiting[:count]
            waiting = waiting[count:]

    def parts(self, wanted: set[int] | None = None) -> Iterator[list[tuple[int, int, int, bytes]] | LostStretch]:
        """Stretch by stretch, the messages as :meth:`raw_messages` gives them, or what was lost.

        Raises:
            BenchError: the file cannot be read.
        """
        wanted = set(self.channels) if wanted is None else wanted & set(self.channels)
        held = [item for item in self.stretches if item.fault or not wanted.isdisjoint(item.channels)]
        yield from self._read(held, wanted)

    def _read(
        self, stretches: list[Stretch], wanted: set[int]
    ) -> Iterator[list[tuple[int, int, int, bytes]] | LostStretch]:
        """The wanted messages of some stretches, or what was lost; see :meth:`parts`."""
        try:
            with self.path.open("rb") as file:
                for stretch in stretches:
                    try:
                        if stretch.fault:
                            raise ValueError(stretch.fault)
                        content = _read_exact(file, stretch.offset, stretch.length)
                        data = _unpack_chunk(content, stretch.packing) if stretch.chunk else content
                        messages = list(_messages(data, wanted))
                    except _DAMAGE as error:
                        yield LostStretch(
                            self.path, stretch.offset, stretch.length, str(error), self._indexed_counts(file, stretch)
                        )
                    else:
                        self._read_whole.add(stretch.offset)
                        yield messages
        except OSError as error:
            raise BenchError(f"The bag file {self.path} cannot be read: {error.strerror or error}.") from error

    def has_lost(self) -> bool:
        """Whether a stretch cannot be read. Those that were read whole before are not read again.

        Raises:
            BenchError: the file cannot be read.
        """
        unread = [stretch for stretch in self.stretches if stretch.offset not in self._read_whole]
        return any(isinstance(part, LostStretch) for part in self._read(unread, set()))

    def custom_data(self) -> str:
        """Content of ``metadata.yaml`` that rosbag2 keeps inside the file; empty if there is none to be read."""
        if self.damage:
            return ""
        try:
            with self.path.open("rb") as file:
                for item in make_reader(file).iter_metadata():
                    if item.name == "rosbag2":
                        return str(item.metadata.get("serialized_metadata", ""))
        except (OSError, McapError, *_DAMAGE):
            return ""
        return ""

    def _indexed_counts(self, file: Any, stretch: Stretch) -> dict[int, int]:
        """Messages by channel as the index records behind a chunk count them."""
        counts: dict[int, int] = {}
        if not stretch.chunk or stretch.packing is None:
            return counts
        position = stretch.offset + stretch.length
        try:
            while True:
                opcode, length = _RECORD.unpack(_read_exact(file, position, _RECORD.size))
                if opcode != _OP_MESSAGE_INDEX:
                    return counts
                channel, size = struct.unpack("<HI", _read_exact(file, position + _RECORD.size, 6))
                if size + 6 != length or size % 16 or channel not in self.channels:
                    return {}
                counts[channel] = size // 16
                position += _RECORD.size + length
        except _DAMAGE:
            return {}

    def _read_index(self, file: Any) -> bool:
        """Take channels and chunks from the summary; False if there is none to rely on."""
        size = file.seek(0, 2)
        tail = 8 + 29  # magic, footer
        if size < len(MAGIC) + tail or _read_exact(file, size - 8, 8) != MAGIC:
            return False
        try:
            opcode, length, start, _, checksum = _FOOTER.unpack(_read_exact(file, size - tail, _FOOTER.size))
            if opcode != _OP_FOOTER or length != 20:
                return False
            if start:
                summary_bytes = _read_exact(file, start, size - len(MAGIC) - 4 - start)
                if checksum and zlib.crc32(summary_bytes) != checksum:
                    return False
            file.seek(0)
            summary = make_reader(file).get_summary()
        except (McapError, *_DAMAGE):  # the scan decides how far the file is good
            return False
        statistics = summary and summary.statistics
        self._end_is_whole = True
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
            packing = (index.compression, index.compressed_size, index.uncompressed_size)
            self.stretches.append(
                Stretch(
                    index.chunk_start_offset + _RECORD.size,
                    index.chunk_length - _RECORD.size,
                    True,
                    seen,
                    packing,
                    first_time=index.message_start_time,
                )
            )
        self.counts = {cid: int(statistics.channel_message_counts.get(cid, 0)) for cid in self.channels}
        return True

    def _scan(self, file: Any, size: int) -> None:
        """Walk through the records up to the end of the data, past chunks whose content is damaged.

        Where the head of a record is damaged, the file ends as if it were cut there.
        """
        schemas: dict[int, tuple[str, str, str]] = {}
        position = len(MAGIC)
        while position < size:
            opcode, end = 0, position
            try:
                opcode, length = _RECORD.unpack(_read_exact(file, position, _RECORD.size))
                start, end = position + _RECORD.size, position + _RECORD.size + length
                if opcode == _OP_DATA_END and length == 4:
                    self._check_end(file, size)
                    return
                if not 0 < opcode <= _OP_DATA_END and opcode < 0x80:
                    raise ValueError(f"unknown record {opcode:#04x}")
                if end > size:
                    raise ValueError("the last record is incomplete")
                if opcode == _OP_CHUNK:
                    data = _unpack_chunk(_read_exact(file, start, length))
                    seen, first = self._take(data, schemas)
                    self._add(Stretch(start, length, True, frozenset(seen), first_time=first))
                elif opcode in (_OP_SCHEMA, _OP_CHANNEL, _OP_MESSAGE):
                    data = _read_exact(file, position, _RECORD.size + length)
                    seen, first = self._take(data, schemas)
                    if seen:
                        self._add(Stretch(position, len(data), False, frozenset(seen), first_time=first))
            except _DAMAGE as error:
                if opcode != _OP_CHUNK or not position < end < size:
                    self._lose_end(file, position, size, str(error))
                    return
                self.stretches.append(Stretch(position, end - position, False, frozenset(), fault=str(error)))
            position = end
        self.damage, self.cut = "the file ends without its index", True

    def _lose_end(self, file: Any, position: int, size: int, reason: str) -> None:
        """Nothing behind a place can be read: either it is damaged, or the file is cut."""
        if size - position > 37 and self._has_tail(file, size):
            self.stretches.append(Stretch(position, size - position, False, frozenset(), fault=reason))
            self.damage = "its index is damaged"
            return
        self.damage, self.cut = reason, True
        self.lost_bytes = size - position

    def _add(self, stretch: Stretch) -> None:
        before = self.stretches[-1] if self.stretches else None
        loose = before is not None and not before.chunk and not before.fault and not stretch.chunk
        if before and loose and before.offset + before.length == stretch.offset and before.length < _LONGEST_STRETCH:
            self.stretches[-1] = Stretch(
                before.offset,
                before.length + stretch.length,
                False,
                before.channels | stretch.channels,
                first_time=min(before.first_time, stretch.first_time),
            )
        else:
            self.stretches.append(stretch)

    def _check_end(self, file: Any, size: int) -> None:
        if self._end_is_whole:  # there is just no index of chunks in it
            return
        self.cut = not self._has_tail(file, size)
        self.damage = "its index is incomplete" if self.cut else "its index is damaged"

    @staticmethod
    def _has_tail(file: Any, size: int) -> bool:
        """Whether the file ends as a closed one does; one of footer and magic may be damaged."""
        try:
            footer = _RECORD.unpack(_read_exact(file, size - 37, _RECORD.size))
            return footer == (_OP_FOOTER, 20) or _read_exact(file, size - 8, 8) == MAGIC
        except _DAMAGE:
            return False

    def _take(self, data: bytes | memoryview, schemas: dict[int, tuple[str, str, str]]) -> tuple[set[int], int]:
        """Note schemas, channels and counts of some records, all or nothing; the channels seen and first log time."""
        new_channels: dict[int, McapChannel] = {}
        counts: dict[int, int] = {}
        times: list[int] = []
        for opcode, start, end in _records(data):
            if opcode == _OP_MESSAGE:
                channel_id, _, log_time, _ = _MESSAGE.unpack_from(data, start)
                times.append(log_time)
                if channel_id not in self.channels and channel_id not in new_channels:
                    continue  # its channel was described in a chunk that is lost
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
        return set(counts), min(times, default=0)


def _log_time(message: tuple[int, int, int, bytes]) -> int:
    return message[1]


def _in_order(
    waiting: list[tuple[int, int, int, bytes]], part: list[tuple[int, int, int, bytes]]
) -> list[tuple[int, int, int, bytes]]:
    """Messages of a part behind those that wait, by log time."""
    joined = waiting + part if waiting else part
    if all(one[1] <= other[1] for one, other in itertools.pairwise(joined)):
        return joined
    return sorted(joined, key=_log_time)  # stable


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
    # One damaged byte does not make it another kind of file.
    if sum(a != b for a, b in zip(MAGIC, head, strict=False)) > 1:
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


def _unpack_chunk(content: bytes, packing: tuple[str, int, int] | None = None) -> bytes | memoryview:
    """Records in a chunk, checked by size and checksum.

    Args:
        content: of the chunk's record.
        packing: what the index says of it, instead of the chunk's own values; see :class:`Stretch`.
    """
    _, _, size, checksum = _CHUNK.unpack_from(content)
    if packing is not None:
        compression, length, size = packing
        at = len(content) - length
        if at < _CHUNK_HEAD:
            raise ValueError("a chunk claims another size than it has")
    else:
        compression, at = _string(content, _CHUNK.size, len(content))
        (length,) = _UINT64.unpack_from(content, at)
        at += 8
        if length != len(content) - at:
            raise ValueError("a chunk claims another size than it has")
    if size > _LARGEST_CHUNK:
        raise ValueError(f"a chunk claims to unpack to {size} bytes")
    data: bytes | memoryview = memoryview(content)[at:]  # without a copy
    if compression == "zstd":
        # The size in the frame itself is not trusted: it would be allocated unseen.
        with zstandard.ZstdDecompressor(max_window_size=2**27).stream_reader(data) as reader:
            data = reader.read(size + 1)
    elif compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(bytes(data), max_length=size + 1)
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


def _messages(data: bytes | memoryview, wanted: set[int]) -> Iterator[tuple[int, int, int, bytes]]:
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
            if channel in wanted:
                # A copy of its own is aligned, so arrays in it are, too.
                yield channel, log_time, publish_time, bytes(data[start + 22 : position])


def _string(data: bytes | memoryview, position: int, end: int) -> tuple[str, int]:
    (length,) = _UINT32.unpack_from(data, position)
    stop = position + 4 + length
    if stop > end:
        raise ValueError("a text reaches beyond its record")
    return str(data[position + 4 : stop], "utf-8"), stop


@lru_cache(maxsize=64)
def _profiles(text: str) -> Any:
    """Profiles of quality of service; most topics of most bags have the same few."""
    try:
        return yaml_value(text, "offered_qos_profiles") or []
    except BenchError:
        return []


def _channel(topic: str, serialization: str, metadata: dict[str, str], schema: tuple[str, str, str]) -> McapChannel:
    name, encoding, text = schema
    profiles = copy.deepcopy(_profiles(metadata.get("offered_qos_profiles", "")))
    definition = MessageDefinition(text, metadata.get("topic_type_hash", ""), encoding)
    return McapChannel(topic, name, definition, serialization, profiles if isinstance(profiles, list) else [])
