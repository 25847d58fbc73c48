"""Writes rosbag2 folders in MCAP that survive the death of the writer.

Chunks are closed and handed to the operating system every few messages or fractions of a second, so a killed
recorder loses only the newest ones. ``docs/decisions/002-bag-writing.md`` explains the choice of the writer.
"""

from __future__ import annotations

import contextlib
import io
import json
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from nmt_core.errors import BenchError
from nmt_core.files.yaml_text import yaml_text
from nmt_core.messages.records import RunRecord
from nmt_core.messages.wire import RUN_RECORD as RUN_RECORD_CODEC
from nmt_core.vocabulary import RecordKind
from nmt_record.bag.bag_keys import FAILURE_KEY, REPAIR_KEY, RIG_YAML_KEY, RUN_JSON_KEY
from nmt_record.bag.bench_topics import RUN_RECORD, Service, bench_name, qos_profile
from nmt_record.bag.chunk_messages import ChunkMessages
from nmt_record.bag.message_definitions import MessageDefinition, local_definitions

COMPRESSIONS = {"none": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}

_METADATA_VERSION = 9
_BYTES_PER_CHUNK = 4 * 2**20
_MAGIC = b"\x89MCAP0\r\n"
# End of data and a footer without summary: the shortest regular end of an MCAP file.
_BARE_END = struct.pack("<BQI", 0x0F, 4, 0) + struct.pack("<BQQQI", 0x02, 20, 0, 0, 0) + _MAGIC


def open_unbuffered(path: Path) -> io.RawIOBase:
    """Create a file whose writes reach the operating system at once."""
    return open(path, "xb", buffering=0)


@dataclass(frozen=True)
class Storage:
    """How messages lie in the files of a bag.

    Attributes:
        chunk_messages: messages after which a chunk is closed and flushed.
        flush_interval: s of wall time after which :meth:`BagWriter.write` and :meth:`BagWriter.flush_if_due` close a
            chunk.
        compression: of the chunks: ``none``, ``zstd`` or ``lz4``.
        split_bytes: size of a file after which the next one begins; 0 = one file.
        split_duration: s from the first to the newest time of reception in a file after which the next one begins;
            0 = one file.

    Raises:
        BenchError: no such compression exists.
    """

    chunk_messages: int = 500
    flush_interval: float = 0.5
    compression: str = "none"
    split_bytes: int = 0
    split_duration: float = 0.0

    def __post_init__(self) -> None:
        if self.compression not in COMPRESSIONS:
            raise BenchError(f"'{self.compression}' is not a compression of bags; choose {', '.join(COMPRESSIONS)}.")


USUAL = Storage()
"""One file, chunks not compressed."""


class BagWriter:
    """One rosbag2 folder being written.

    The first message is the start record of the run, the last one the stop record. Topics appear in the bag
    with their first message.

    Args:
        path: folder to create; the file in it is ``<folder>_0.mcap``, further ones count up.
        run_json: self-description of the run, a JSON object; empty = none.
        rig_yaml: the rig file as used.
        records: write start and stop record; off for copies, which have them already.
        storage: how messages lie in its files.
        repair_json: what a repaired copy has lost, a JSON object; empty = it is not a repaired copy.
        open_file: opens the MCAP file; must return an unbuffered file.
        clock: time of reception of messages that come without one, ns; None = the wall clock.

    Attributes:
        state: ``open``, ``closed`` or ``failed``.
        failure: why writing ended early, one sentence; None as long as all is well.
        counts: messages handed in by topic.

    Raises:
        BenchError: the folder exists, cannot be created or written, or ``run_json`` is not a JSON object.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        run_json: str = "",
        rig_yaml: str = "",
        records: bool = True,
        storage: Storage = USUAL,
        repair_json: str = "",
        open_file: Callable[[Path], Any] = open_unbuffered,
        clock: Callable[[], int] | None = None,
    ) -> None:
        self.path = Path(path)
        self.state = "open"
        self.failure: str | None = None
        self.counts: dict[str, int] = {}
        self._run = parse_run(run_json)
        self._custom = {RUN_JSON_KEY: run_json, RIG_YAML_KEY: rig_yaml, REPAIR_KEY: repair_json}
        self._custom = {key: text for key, text in self._custom.items() if text}
        self._records = records
        self._clock = clock or (lambda: time.time_ns())
        self._storage = storage
        self._split_ns = round(storage.split_duration * 1e9)
        self._open_file = open_file
        self._files: list[_FileSpan] = []
        self._channels: dict[str, int] = {}
        self._topics: dict[str, dict[str, Any]] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._known: dict[str, tuple[str, MessageDefinition, list[dict[str, Any]]]] = {}
        self._pending = 0
        self._pending_bytes = 0
        self._chunk_opened = time.monotonic()
        self._newest = 0
        self._times: tuple[int, int] | None = None
        self._safe = _State()
        if not hasattr(Writer, "flush"):
            raise BenchError("The installed 'mcap' package cannot flush a chunk; install mcap 1.6.0 or newer.")
        self._open()
        if records:
            self.add_topic("run_record", RUN_RECORD, Service.STATE)
            try:
                self._write_record(RecordKind.START, run_json, rig_yaml, 0)
                self.flush()
            except BenchError as error:
                self._remove()
                cause = error.__cause__
                why = cause.strerror or cause if isinstance(cause, OSError) else error
                raise BenchError(f"The bag {self.path} cannot be created: {why}.") from error

    @property
    def messages(self) -> int:
        """Messages handed in so far."""
        return sum(self.counts.values())

    def add_topic(
        self,
        topic: str,
        message_type: str,
        service: Service = Service.DEFAULT,
        definition: MessageDefinition | None = None,
        offered_qos: list[dict[str, Any]] | None = None,
    ) -> None:
        """Make a topic known; it appears in the bag with its first message.

        Args:
            topic: name, with or without leading slash.
            message_type: ``package/msg/Name``.
            service: quality of service to note.
            definition: None = look it up on this machine.
            offered_qos: profiles as rosbag2 writes them, in place of ``service``.

        Raises:
            BenchError: the definition is not to be found.
        """
        definition = definition or local_definitions().definition(message_type)
        profiles = [qos_profile(service)] if offered_qos is None else offered_qos
        self._known[bench_name(topic)] = (message_type, definition, profiles)

    def write(
        self, topic: str, raw: bytes, receive_time_ns: int | None = None, publish_time_ns: int | None = None
    ) -> None:
        """Append one serialised message.

        Args:
            topic: a topic made known by :meth:`add_topic`.
            raw: CDR with its encapsulation header.
            receive_time_ns: time of reception; None = now, never before the message ahead of it.
            publish_time_ns: the message's own stamp; None = the time of reception.

        Raises:
            BenchError: the disk refuses; the bag has then been closed with all whole chunks in it.
                Also if the bag is no longer open.
        """
        if self.state != "open":
            raise BenchError(self.failure or f"The bag {self.path} is closed; a closed bag takes no more messages.")
        if receive_time_ns is None:
            # The wall clock may be set back; the order of the file must stay the order of reception.
            receive_time_ns = max(self._clock(), self._newest)
        if receive_time_ns > self._newest:
            self._newest = receive_time_ns
        try:
            channel = self._channels.get(topic)
            if channel is None:
                channel = self._register(topic)
        except OSError as error:
            raise self._fail(error) from error
        # This only appends to memory: the disk is touched by flush() alone.
        self._chunk.add(channel, receive_time_ns, receive_time_ns if publish_time_ns is None else publish_time_ns, raw)
        self.counts[topic] += 1
        if not self._pending:
            self._chunk_opened = time.monotonic()
        self._pending += 1
        self._pending_bytes += len(raw)
        if (
            self._pending >= self._storage.chunk_messages
            or self._pending_bytes >= _BYTES_PER_CHUNK
            or time.monotonic() - self._chunk_opened >= self._storage.flush_interval
        ):
            self.flush()

    def write_message(
        self, topic: str, message: Any, receive_time_ns: int | None = None, publish_time_ns: int | None = None
    ) -> None:
        """Serialise a message of the local type store (:func:`local_definitions`) and append it."""
        store = local_definitions().typestore
        raw = bytes(store.serialize_cdr(message, self._known[bench_name(topic)][0]))
        self.write(bench_name(topic), raw, receive_time_ns, publish_time_ns)

    def flush_if_due(self) -> None:
        """Flush if the oldest unwritten message has waited for the flush interval."""
        due = time.monotonic() - self._chunk_opened >= self._storage.flush_interval
        if self.state == "open" and self._pending and due:
            self.flush()

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system.

        Raises:
            BenchError: the disk refuses; the bag has then been closed with all whole chunks in it.
        """
        if self.state != "open":
            return
        try:
            self._hand_over()
            self.mcap.flush()
        except OSError as error:
            raise self._fail(error) from error
        self._file.keep()
        self._pending = 0
        self._pending_bytes = 0
        self._safe = _State(dict(self.counts), self._times, self._files[-1])
        if self._file_is_full():
            try:
                self._end_file()
                self._begin_file()
            except OSError as error:
                raise self._fail(error) from error

    def _hand_over(self) -> None:
        """Give the messages that wait to the MCAP writer, and count them to their file."""
        given = self._chunk.hand_over()
        if given is not None:
            number, first, last = given
            self._times = _joined(self._times, first, last)
            self._files[-1] = self._files[-1].with_messages(number, first, last)

    def close(self, exit_state: str = "done", reason: str = "", stamp_ns: int = 0, **extra: Any) -> None:
        """Write the stop record, the index and ``metadata.yaml``. A second call does nothing.

        Args:
            exit_state: how the run ended, in one word.
            reason: the same in a sentence; may be empty.
            stamp_ns: bench time of the stop record, ns.
            **extra: further entries of the stop record (gaps, …).

        Raises:
            BenchError: the disk refuses; what had been written before remains readable.
        """
        if self.state != "open":
            return
        if self._records:
            self.add_stop(exit_state, reason, stamp_ns, **extra)
        self.flush()
        try:
            self._end_file()
            self._write_metadata()
        except OSError as error:
            raise self._fail(error) from error
        self.state = "closed"

    def add_stop(self, exit_state: str, reason: str, stamp_ns: int = 0, **extra: Any) -> None:
        """Append a stop record; :meth:`close` does so unless the writer was told to write no records.

        Raises:
            BenchError: as :meth:`write`.
        """
        if "run_record" not in self._known:
            self.add_topic("run_record", RUN_RECORD, Service.STATE)
        stop = {
            **self._run,
            "exit": {"state": exit_state, "reason": reason},
            **extra,
            "counts": dict(self.counts),
        }
        self._write_record(RecordKind.STOP, json.dumps(stop), "", stamp_ns)

    def close_quietly(self) -> None:
        """Close whatever is still open without raising; for use while another error is on its way."""
        if self.state == "open":
            with contextlib.suppress(BenchError):
                self.close("failed")

    def discard(self) -> None:
        """Remove a bag that is still open: nothing worth keeping was written."""
        if self.state == "open":
            self._remove()

    @property
    def file_path(self) -> Path:
        """The file that is being written."""
        return self.path / self._files[-1].name

    def _open(self) -> None:
        if self.path.exists():
            raise BenchError(f"The bag folder {self.path} exists already; name another one or remove it.")
        try:
            self.path.mkdir(parents=True)
            self._begin_file()
        except OSError as error:
            self._remove()
            raise BenchError(f"The bag {self.path} cannot be created: {error.strerror or error}.") from error

    def _begin_file(self) -> None:
        self._files.append(_FileSpan(f"{self.path.name}_{len(self._files)}.mcap"))
        self._safe = _State(dict(self.counts), self._times, self._files[-1])
        self._channels, self._schemas = {}, {}
        self._file = _ChunkFile(self._open_file(self.file_path))
        # One chunk is as large as flush() lets it become. Uncompressed by default: samples of noise hardly compress.
        self.mcap = Writer(self._file, chunk_size=2**62, compression=COMPRESSIONS[self._storage.compression])
        self._chunk = ChunkMessages(self.mcap)
        self.mcap.start(profile="ros2", library="nmt_record")
        self._file.keep()

    def _end_file(self) -> None:
        metadata = yaml_text(self._metadata(), sort_keys=True, ascii_only=True).strip()
        self.mcap.add_metadata("rosbag2", {"serialized_metadata": metadata})
        self.mcap.finish()
        self._file.keep()
        self._file.close()

    def _file_is_full(self) -> bool:
        span = self._files[-1]
        too_large = 0 < self._storage.split_bytes <= self._file.tell()
        too_long = span.times is not None and 0 < self._split_ns <= span.times[1] - span.times[0]
        return span.messages > 0 and (too_large or too_long)

    def _register(self, topic: str) -> int:
        if topic not in self._known:
            raise BenchError(f"Topic '{topic}' has not been made known to the bag {self.path}; call add_topic first.")
        self._hand_over()  # what a channel is stands behind the messages before its own
        message_type, definition, profiles = self._known[topic]
        key = (message_type, definition.text)
        if key not in self._schemas:
            self._schemas[key] = self.mcap.register_schema(
                message_type, definition.encoding if definition.text else "", definition.text.encode()
            )
        metadata = {
            "offered_qos_profiles": yaml_text(profiles, sort_keys=True, ascii_only=True).strip() if profiles else "",
            "topic_type_hash": definition.type_hash,
        }
        channel = self.mcap.register_channel(f"/{topic}", "cdr", self._schemas[key], metadata)
        self._channels[topic] = channel
        self._topics[topic] = {
            "name": f"/{topic}",
            "type": message_type,
            "serialization_format": "cdr",
            "offered_qos_profiles": profiles,
            "type_description_hash": definition.type_hash,
        }
        self.counts.setdefault(topic, 0)
        return int(channel)

    def _write_record(self, kind: RecordKind, run_json: str, rig_yaml: str, stamp_ns: int) -> None:
        self.write("run_record", RUN_RECORD_CODEC.write(RunRecord(kind, run_json, rig_yaml, stamp_ns)), None, stamp_ns)

    def _fail(self, error: OSError) -> BenchError:
        """Keep all whole chunks, give the file a regular end if there is room, and say what happened."""
        self.state = "failed"
        self.counts, self._times = dict(self._safe.counts), self._safe.times
        if self._safe.file is not None:
            self._files[-1] = self._safe.file
        self.failure = (
            f"The bag {self.path} could not be written further ({error.strerror or error}); its first "
            f"{self.messages} messages are kept: make room on the disk and repeat the run."
        )
        self._custom[FAILURE_KEY] = self.failure
        self._file.end_early(_BARE_END)
        with contextlib.suppress(OSError):
            self._write_metadata()
        return BenchError(self.failure)

    def _metadata(self) -> dict[str, Any]:
        whole = _FileSpan("", self.messages, self._times).description()
        return {
            "version": _METADATA_VERSION,
            "storage_identifier": "mcap",
            "relative_file_paths": [file.name for file in self._files],
            **{key: whole[key] for key in ("starting_time", "duration", "message_count")},
            "topics_with_message_count": [
                {"topic_metadata": self._topics[topic], "message_count": count} for topic, count in self.counts.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "files": [file.description() for file in self._files],
            "custom_data": self._custom or None,
            "ros_distro": "jazzy",
        }

    def _write_metadata(self) -> None:
        target = self.path / "metadata.yaml"
        part = self.path / "metadata.yaml.part"
        text = yaml_text({"rosbag2_bagfile_information": self._metadata()}, ascii_only=True)
        try:
            part.write_text(text, encoding="utf-8")
            part.replace(target)
        except OSError:
            with contextlib.suppress(OSError):
                part.unlink()
            raise

    def _remove(self) -> None:
        self.state = "failed"
        with contextlib.suppress(OSError, AttributeError):
            self._file.close()
        for name in (*(file.name for file in self._files), "metadata.yaml"):
            with contextlib.suppress(OSError):
                (self.path / name).unlink()
        with contextlib.suppress(OSError):
            self.path.rmdir()


@dataclass(frozen=True, slots=True)
class _FileSpan:
    """One file of the bag: name, messages, first and last time of reception (ns)."""

    name: str
    messages: int = 0
    times: tuple[int, int] | None = None

    def with_messages(self, number: int, first: int, last: int) -> _FileSpan:
        return _FileSpan(self.name, self.messages + number, _joined(self.times, first, last))

    def description(self) -> dict[str, Any]:
        first, last = self.times or (0, 0)
        return {
            "path": self.name,
            "starting_time": {"nanoseconds_since_epoch": first},
            "duration": {"nanoseconds": last - first},
            "message_count": self.messages,
        }


def _joined(times: tuple[int, int] | None, first: int, last: int) -> tuple[int, int]:
    return (first, last) if times is None else (min(times[0], first), max(times[1], last))


@dataclass(frozen=True, slots=True)
class _State:
    """What is whole on the disk: counts by topic, times, and the newest file."""

    counts: dict[str, int] = field(default_factory=dict)
    times: tuple[int, int] | None = None
    file: _FileSpan | None = None


class _ChunkFile:
    """Unbuffered output that knows how much of it is whole and can go back to that."""

    def __init__(self, file: Any) -> None:
        self._raw = file
        self._position = 0
        self._whole = 0

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            written = self._raw.write(view)
            if not written:
                raise OSError("the file takes no more data")
            self._position += written
            view = view[written:]
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Nothing is buffered."""

    def keep(self) -> None:
        """All that has been written so far is whole."""
        self._whole = self._position

    def end_early(self, tail: bytes) -> None:
        """Cut off what is not whole, append ``tail`` if there is room for it, and close."""
        if self._raw.closed:
            return
        with contextlib.suppress(OSError):
            self._cut()
            try:
                self.write(tail)
            except OSError:
                self._cut()
        with contextlib.suppress(OSError):
            self.close()

    def close(self) -> None:
        self._raw.close()

    def _cut(self) -> None:
        self._raw.truncate(self._whole)
        self._raw.seek(self._whole)
        self._position = self._whole


def parse_run(run_json: str) -> dict[str, Any]:
    """Read the self-description of a run; empty text = none.

    Raises:
        BenchError: it is not a JSON object.
    """
    if not run_json:
        return {}
    try:
        run = json.loads(run_json)
    except ValueError as error:
        raise BenchError(f"The description of the run (run_json) is not JSON: {error}.") from error
    if not isinstance(run, dict):
        raise BenchError("The description of the run (run_json) must be a JSON object.")
    return run
