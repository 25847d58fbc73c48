"""Reads bags, whole, cut off or damaged, without ROS.

The message definitions come from the bag itself, so it opens where the bench's messages were never installed, and
whichever release recorded it: :mod:`nmt_record.bag.stored_messages`.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

from nmt_core.errors import BenchError
from nmt_core.files.hardened import json_value, open_regular, read_text, yaml_value
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.cdr import MessageCodec, Record
from nmt_core.messages.records import LockEvent
from nmt_core.messages.wire import LOCK_EVENT, RUN_RECORD, BlockHead, BlockReader
from nmt_core.processes.work_progress import counted
from nmt_core.vocabulary import RecordKind
from nmt_record.bag.bag_keys import FAILURE_KEY, REPAIR_KEY, RIG_YAML_KEY, RUN_JSON_KEY
from nmt_record.bag.bench_topics import SAMPLE_BLOCK, bench_name
from nmt_record.bag.mcap_file import LostStretch, McapChannel, McapFile, check_magic
from nmt_record.bag.message_definitions import MessageDefinition, local_definitions, typestore_of
from nmt_record.bag.stored_messages import Translation, is_translated, translation

_SQLITE_MAGIC = b"SQLite format 3\0"
_ENCODINGS = {"MSG": "ros2msg", "IDL": "ros2idl"}  # by the name of the format in rosbags

RawMessage = tuple[str, int, int, bytes]


@dataclass(frozen=True)
class LostSpan:
    """What a damaged part of a bag held, as far as the parts before and behind it tell.

    Attributes:
        file: name of the file.
        offset: of the first damaged byte.
        length: bytes.
        reason: why it could not be read, a clause.
        samples: topic -> first sample lost and sample after the last one; -1 = to the end of the recording.
        messages: topic -> number of messages lost; empty if the index does not say.
    """

    file: str
    offset: int
    length: int
    reason: str
    samples: dict[str, tuple[int, int]]
    messages: dict[str, int]

    def touches(self, first_sample: int, stop_sample: int) -> bool:
        """Whether samples from ``first_sample`` to before ``stop_sample`` are lost on any topic."""
        return any(first < stop_sample and (stop < 0 or stop > first_sample) for first, stop in self.samples.values())

    def __str__(self) -> str:
        by_span: dict[tuple[int, int], list[str]] = {}
        for topic, span in self.samples.items():
            by_span.setdefault(span, []).append(topic)
        parts = [
            (f"samples {first} to {stop - 1}" if stop >= 0 else f"samples from {first} on")
            + f" of {', '.join(sorted(topics))}"
            for (first, stop), topics in sorted(by_span.items())
        ]
        others = [f"{count} of {topic}" for topic, count in self.messages.items() if topic not in self.samples]
        parts += [f"messages: {', '.join(sorted(others))}"] if others else []
        held = "; ".join(parts) or "no samples that the rest of the bag would miss"
        return f"{self.length} bytes at byte {self.offset} of {self.file} ({self.reason}), with {held}"


class Bag:
    """An opened bag. No file stays open between reads.

    Topics are named without leading slash, and messages come in the order of reception. Messages in damaged parts are
    left out; ``lost_spans`` and ``loss`` say which, and read what has not been read before to find out.

    Attributes:
        path: what was opened.
        topics: message type and number of messages by topic.
        left_out: topics of a foreign bag that cannot be read, each with a sentence that says why.
        run_start: the run's self-description from the start record; None if the bag has none.
        run_stop: the stop record; None if the bag has none.
        rig_yaml: the rig file as used; None if the bag has none.
    """

    def __init__(self, path: Path, source: _Source, custom: dict[str, str]) -> None:
        self.path = path
        self._source = source
        self._custom = custom
        self._types: dict[str, str] = {}
        self.topics: dict[str, tuple[str, int]] = {}
        self.left_out: dict[str, str] = {}
        for channel, count in source.channels():
            name = bench_name(channel.topic)
            if channel.serialization != "cdr":
                self.left_out[name] = (
                    f"The bag {path} holds '{channel.serialization}' messages on topic '{name}', not "
                    "ROS 2 ones (cdr); convert it with 'rosbags-convert'."
                )
            elif self._types.setdefault(name, channel.message_type) != channel.message_type:
                self.left_out[name] = f"The bag {path} holds two types of message on topic '{name}'; split it by type."
            self.topics[name] = (channel.message_type, self.topics.get(name, ("", 0))[1] + count)
        # A bench's own recording has every topic or none: what reads it counts on that.
        if self.left_out and (SAMPLE_BLOCK in self._types.values() or self.left_out.keys() == self.topics.keys()):
            raise BenchError(next(iter(self.left_out.values())))
        for name in self.left_out:
            del self.topics[name]
            self._types.pop(name, None)
        self._typestores: dict[str, Any] = {}
        self.run_start: dict[str, Any] | None = None
        self.run_stop: dict[str, Any] | None = None
        self.rig_yaml: str | None = None
        self._read_records()

    @classmethod
    def open(cls, path: Path | str) -> Bag:
        """Open a rosbag2 folder (MCAP or SQLite), an ``.mcap`` or ``.db3`` file, or a run's output folder.

        A cut or damaged MCAP file is read as far as its chunks are whole; ``loss`` then says what is missing.

        Raises:
            BenchError: nothing there, empty, a ROS 1 bag, no bag at all, or nothing readable in it.
        """
        path = Path(path)
        if not os.path.exists(path):  # unlike Path.exists it does not raise for a name that is too long
            raise BenchError(f"There is no bag at {path}; check the path.")
        try:
            source, custom = _open_folder(path) if path.is_dir() else _open_file(path)
        except OSError as error:
            raise BenchError(f"The bag {path} cannot be read: {error.strerror or error}.") from error
        return cls(path, source, custom)

    def require_topics(self, *names: str) -> None:
        """Check that topics are there and not empty.

        Raises:
            BenchError: names the missing ones and those that the bag has.
        """
        missing = [name for name in map(bench_name, names) if self.topics.get(name, ("", 0))[1] == 0]
        if missing:
            has = ", ".join(sorted(name for name, (_, count) in self.topics.items() if count)) or "no messages at all"
            raise BenchError(
                f"The bag {self.path} has no messages on {', '.join(missing)} (it has {has}); "
                "record a run of the bench or name another bag."
            )

    def raw_messages(self, topics: Iterable[str] | None = None, *, as_stored: bool = False) -> Iterator[RawMessage]:
        """Serialised messages, those of the bench by the definitions of today.

        Args:
            topics: names; None = all.
            as_stored: by the definitions in the bag, as a copy of it needs them.

        Yields:
            Topic, time of reception (ns), publish time (ns; bench time on the bench's stamped topics), CDR.

        Raises:
            BenchError: the bag cannot be read.
        """
        wanted = None if topics is None else {bench_name(name) for name in topics}
        if self.left_out:
            wanted = set(self.topics) if wanted is None else wanted & set(self.topics)
        total = sum(count for topic, (_, count) in self.topics.items() if wanted is None or topic in wanted)
        return iter(counted(f"reading {self.path.name}", self._source.raw(wanted, as_stored), total))

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[tuple[str, int, Any]]:
        """Messages as objects of the ``rosbags`` reader (arrays are read-only), as :meth:`raw_messages` gives them.

        Args:
            topics: names; None = all.

        Yields:
            Topic, time of reception (ns), message.

        Raises:
            BenchError: the bag or a message is damaged.
        """
        for topic, received, _, raw in self.raw_messages(topics):
            yield topic, received, self.deserialise(topic, raw)

    def blocks(
        self, topic: str, first_sample: int | None = None, stop_sample: int | None = None
    ) -> Iterator[SampleBlock]:
        """Blocks of samples of one topic, uncut.

        Args:
            topic: a topic of type ``nmt_msgs/SampleBlock``.
            first_sample: leave out blocks that end before this sample.
            stop_sample: leave out blocks that begin at or after this sample.

        Raises:
            BenchError: the topic is missing or holds something else, or the bag is damaged.
        """
        topic = bench_name(topic)
        if self._types.get(topic, SAMPLE_BLOCK) != SAMPLE_BLOCK:
            raise BenchError(f"Topic '{topic}' of the bag {self.path} holds {self._types[topic]}, not samples.")
        self.require_topics(topic)
        cut = first_sample is not None or stop_sample is not None
        read = BlockReader().read
        head_of = BlockReader().head
        for _, _, _, raw in self.raw_messages([topic]):
            try:
                if cut:
                    extent = head_of(raw)
                    if first_sample is not None and extent.end_sample <= first_sample:
                        continue
                    if stop_sample is not None and extent.first_sample >= stop_sample:
                        continue
                yield read(raw)
            except ValueError as error:
                raise BenchError(
                    f"A block of topic '{topic}' in the bag {self.path} cannot be used: {error}."
                ) from error

    @property
    def sample_topics(self) -> list[str]:
        """Topics that hold blocks of samples."""
        return [name for name, (kind, count) in self.topics.items() if kind == SAMPLE_BLOCK and count]

    def heads(self) -> Iterator[tuple[str, BlockHead]]:
        """Topic of every block of samples, and the block without its samples; those that cannot be read are left out.

        Raises:
            BenchError: the bag cannot be read.
        """
        readers = {name: BlockReader() for name in self.sample_topics}
        for topic, _, _, raw in self.raw_messages(readers) if readers else ():
            try:
                head = readers[topic].head(raw)
            except ValueError:
                continue
            yield topic, head

    def lock_events(self) -> list[LockEvent]:
        """All lock events, in order; empty if the loop never locked.

        Raises:
            BenchError: one is damaged, or of a kind of test that is not known.
        """
        return list(self.records("lock", LOCK_EVENT))

    def records(self, topic: str, codec: MessageCodec[Record]) -> Iterator[Record]:
        """All messages of one topic as the bench's own records, in order; none if the topic is missing.

        Args:
            topic: its name.
            codec: of its message type, from :mod:`nmt_core.messages.wire`.

        Raises:
            BenchError: a message is damaged, or the topic holds another type.
        """
        topic = bench_name(topic)
        kind = f"nmt_msgs/msg/{codec.name}"
        if self._types.get(topic, kind) != kind:
            raise BenchError(f"Topic '{topic}' of the bag {self.path} holds {self._types[topic]}, not {kind}.")
        for _, _, _, raw in self.raw_messages([topic]):
            try:
                yield codec.read(raw)
            except ValueError as error:
                raise BenchError(
                    f"A message of topic '{topic}' in the bag {self.path} cannot be read: {error}."
                ) from error

    @cached_property
    def lost_spans(self) -> tuple[LostSpan, ...]:
        """What damage took out of the bag, in the order of the files; the end of a bag that was cut is not among it.

        Raises:
            BenchError: the bag cannot be read.
        """
        spans = [*self._repaired_spans()]
        names = {name for name, (kind, _) in self.topics.items() if kind == SAMPLE_BLOCK}
        ends: dict[str, int] = {}
        open_spans: list[LostSpan] = []
        readers = {name: BlockReader() for name in names}
        for part in self._source.parts(names) if self._source.has_lost() else ():
            if isinstance(part, LostSpan):
                # Where the recording of a topic stood; the next block of the topic says where it goes on.
                part.samples.update({topic: (ends.get(topic, 0), -1) for topic in names})
                open_spans.append(part)
                spans.append(part)
                continue
            for topic, _, _, raw in part:
                try:
                    extent = readers[topic].head(raw)
                except ValueError:
                    continue
                for span in open_spans:
                    first, stop = span.samples.get(topic, (0, 0))
                    if stop < 0:
                        span.samples[topic] = (first, extent.first_sample)
                ends[topic] = max(ends.get(topic, 0), extent.end_sample)
        for span in spans:
            for topic, (first, stop) in list(span.samples.items()):
                # The index says that no block of the topic was in it, or the blocks around it join.
                if 0 <= stop <= first or (span.messages and topic not in span.messages):
                    del span.samples[topic]
        return tuple(spans)

    @cached_property
    def loss(self) -> str | None:
        """One sentence on what is missing from the bag; None if nothing is.

        Raises:
            BenchError: the bag cannot be read.
        """
        clauses = []
        if self._repair:
            clauses.append(str(self._repair.get("sentence", "")).rstrip("."))
        fresh = [span for span in self.lost_spans if span.file]
        if fresh:
            what = "1 part of it" if len(fresh) == 1 else f"{len(fresh)} parts of it"
            clauses.append(f"The bag {self.path} is damaged, {what} could not be read: " + "; ".join(map(str, fresh)))
        end = self._describe_end()
        if end:
            clauses.append(end)
        return "; ".join(clauses) + "." if clauses else None

    def repair(self, destination: Path | str) -> Path:
        """Write what can be read to a new, regularly closed bag, with a record of the losses.

        Args:
            destination: folder to create.

        Returns:
            The folder.

        Raises:
            BenchError: the folder exists, the disk is full, or this bag cannot be read.
        """
        from nmt_record.bag.bag_writer import BagWriter  # late: whoever only reads starts faster

        destination = Path(destination)
        writer = BagWriter(
            destination,
            run_json=json.dumps(self.run_start) if self.run_start else "",
            rig_yaml=self.rig_yaml or "",
            records=False,
            repair_json=json.dumps(self.repair_record()) if self.loss else "",
        )
        try:
            for channel, _ in self._source.channels():
                writer.add_topic(
                    channel.topic,
                    channel.message_type,
                    definition=channel.definition,
                    offered_qos=channel.offered_qos,
                )
            for topic, received, published, raw in self.raw_messages(as_stored=True):
                writer.write(topic, raw, received, published)
            if self.run_start is not None and self.run_stop is None:
                writer.add_stop("repaired", self.loss or "")
            writer.close()
        except BaseException:
            writer.close_quietly()
            shutil.rmtree(destination, ignore_errors=True)
            raise
        return destination

    def repair_record(self) -> dict[str, Any]:
        """What a repaired copy says of itself: ``source``, ``sentence``, ``lost`` and ``kept`` (messages by topic)."""
        kept: dict[str, int] = {}
        for topic, _, _, _ in self.raw_messages():
            kept[topic] = kept.get(topic, 0) + 1
        return {
            "source": str(self.path),
            "sentence": self.loss or "",
            "lost": [asdict(span) for span in self.lost_spans],
            "kept": kept,
        }

    def _repaired_spans(self) -> Iterator[LostSpan]:
        """What had been lost before a repair; without a file, since the damaged bytes are no longer there."""
        lost = self._repair.get("lost")
        for item in lost if isinstance(lost, list) else []:
            try:
                samples = {str(topic): (int(span[0]), int(span[1])) for topic, span in item["samples"].items()}
                messages = {str(topic): int(count) for topic, count in item["messages"].items()}
                yield LostSpan("", int(item["offset"]), int(item["length"]), str(item["reason"]), samples, messages)
            except (KeyError, TypeError, ValueError, IndexError, AttributeError):
                continue

    def deserialise(self, topic: str, raw: bytes) -> Any:
        """The message in the bytes that :meth:`raw_messages` gives for a topic.

        Raises:
            BenchError: the bytes do not fit the definition in the bag, or that is malformed.
        """
        typestore = self._typestore(self._types[topic])
        try:
            return typestore.deserialize_cdr(raw, self._types[topic])
        except Exception as error:  # generated code raises whatever the bytes lead it to
            raise BenchError(
                f"A message of topic '{topic}' in the bag {self.path} cannot be read ({error}); it does "
                f"not fit the definition of {self._types[topic]} in the bag."
            ) from error

    def field_definitions(self, topic: str) -> Any:
        """Fields by message type, of the type of a topic and all that it contains, as ``rosbags`` has them.

        Raises:
            BenchError: there is not a definition of the type in the bag or on this machine, or it is malformed.
        """
        return self._typestore(self._types[bench_name(topic)]).fielddefs

    def _typestore(self, kind: str) -> Any:
        """Type store of one message type: what another lacks does not close it."""
        if kind not in self._typestores:
            every = [channel.definition for channel, _ in self._source.channels() if channel.message_type == kind]
            definition = next((one for one in every if one.text), every[0])
            if is_translated(kind, definition):
                definition = local_definitions().definition(kind)
            self._typestores[kind] = typestore_of({kind: definition}, str(self.path))
        return self._typestores[kind]

    def _read_records(self) -> None:
        run_json, rig_yaml = self._custom.get(RUN_JSON_KEY), self._custom.get(RIG_YAML_KEY)
        if "run_record" in self.topics:
            for record in self._run_records():
                if record.kind == RecordKind.START and self.run_start is None:
                    self.run_start = self._parse(record.run_json)
                    rig_yaml = record.rig_yaml or rig_yaml
                elif record.kind == RecordKind.STOP:
                    self.run_stop = self._parse(record.run_json)
        if self.run_start is None and run_json:
            self.run_start = self._parse(run_json)
        self.rig_yaml = rig_yaml or None
        self._repair = self._parse(self._custom.get(REPAIR_KEY, ""))

    def _run_records(self) -> Iterator[Any]:
        """Start and stop records; those of another's type are read by the definitions in the bag."""
        if self._types["run_record"] == f"nmt_msgs/msg/{RUN_RECORD.name}":
            yield from self.records("run_record", RUN_RECORD)
        else:
            yield from (record for _, _, record in self.messages(["run_record"]))

    def _parse(self, text: str) -> dict[str, Any]:
        if not text:
            return {}
        record = json_value(text, f"The run record in the bag {self.path}", bounded=False)
        if not isinstance(record, dict):
            raise BenchError(f"The run record in the bag {self.path} is not a JSON object.")
        return record

    def _describe_end(self) -> str | None:
        damage, lost = self._source.damage, ""
        if damage is not None and not self._source.cut:
            if self.run_stop is not None or self.run_start is None:
                return f"The index of the bag {self.path} could not be used; its messages were found without it"
        elif damage is None and FAILURE_KEY in self._custom:
            damage = "the recorder could not write on"
        if damage is None and self.run_start is not None and self.run_stop is None:
            if any(span.file for span in self.lost_spans):
                return "its stop record is not among what could be read"
            damage = "it has no stop record"
        if damage is None:
            lacks = float((self.run_stop or {}).get("lacks_s", 0.0))
            return (
                f"The bag {self.path} lacks {lacks:.3f} s of bench time, at its end or in gaps" if lacks > 0 else None
            )
        if self._source.lost_bytes:
            lost = f", {self._source.lost_bytes} bytes at its end are lost"
        last = self._newest_block()
        if last is None or not last.sample_rate > 0:
            kept = "it holds no samples"
        else:
            time = last.end_sample / last.sample_rate
            kept = f"the last sample in it is {last.end_sample - 1} ({time:.3f} s of bench time)"
        how = "is cut off: it was not closed" if self._source.cut else "was not closed"
        return f"The bag {self.path} {how} ({damage}){lost}; {kept}"

    def _newest_block(self) -> BlockHead | None:
        heads = (head for _, head in self.heads())
        return max(heads, key=lambda head: head.end_sample, default=None)

    @property
    def end_time_s(self) -> float:
        """Bench time after the newest sample, s; 0 where there is none.

        Raises:
            BenchError: the bag cannot be read.
        """
        last = self._newest_block()
        return 0.0 if last is None or not last.sample_rate > 0 else last.end_sample / last.sample_rate


class _Source(Protocol):
    damage: str | None
    cut: bool
    lost_bytes: int

    def channels(self) -> list[tuple[McapChannel, int]]: ...

    def raw(self, wanted: set[str] | None, as_stored: bool = False) -> Iterator[RawMessage]:
        """Messages by the definitions of today, or as they are stored."""
        ...

    def parts(self, wanted: set[str]) -> Iterator[list[RawMessage] | LostSpan]: ...

    def has_lost(self) -> bool:
        """Whether :meth:`parts` would give a lost span; reads only what has not been read yet."""
        ...


class _McapSource:
    """The MCAP files of one bag, in order."""

    def __init__(self, files: list[McapFile]) -> None:
        self._files = files
        # Only the end of the last file is the end of the recording; what another one lacks is lost between two.
        damaged = [file for file in files if file.damage and (file is files[-1] or not file.cut)]
        self.damage = damaged[-1].damage if damaged else None
        self.cut = files[-1].cut
        self.lost_bytes = files[-1].lost_bytes

    def channels(self) -> list[tuple[McapChannel, int]]:
        return [(channel, file.counts.get(key, 0)) for file in self._files for key, channel in file.channels.items()]

    def raw(self, wanted: set[str] | None, as_stored: bool = False) -> Iterator[RawMessage]:
        for file in self._files:
            names = {key: bench_name(channel.topic) for key, channel in file.channels.items()}
            keys = None if wanted is None else {key for key, name in names.items() if name in wanted}
            translated = {} if as_stored else _translations(file, keys)
            for key, received, published, raw in file.raw_messages(keys):
                yield names[key], received, published, translated[key](raw) if key in translated else raw

    def parts(self, wanted: set[str]) -> Iterator[list[RawMessage] | LostSpan]:
        for file in self._files:
            names = {key: bench_name(channel.topic) for key, channel in file.channels.items()}
            translated = _translations(file, {key for key, name in names.items() if name in wanted})
            for part in file.parts():
                if isinstance(part, LostStretch):
                    counts = {names[key]: count for key, count in part.counts.items()}
                    yield LostSpan(part.path.name, part.offset, part.length, part.reason, {}, counts)
                else:
                    yield [
                        (names[key], at, published, translated[key](raw) if key in translated else raw)
                        for key, at, published, raw in part
                        if names[key] in wanted
                    ]
            if file.cut and file is not self._files[-1]:
                size = file.path.stat().st_size
                yield LostSpan(file.path.name, size - file.lost_bytes, file.lost_bytes, file.damage or "", {}, {})

    def has_lost(self) -> bool:
        return any(file.has_lost() or (file.cut and file is not self._files[-1]) for file in self._files)


def _translations(file: McapFile, keys: set[int] | None) -> dict[int, Translation]:
    """What makes messages of today of those of some channels of a file, where they are stored in another form."""
    found = {
        key: translation(channel.message_type, channel.definition, str(file.path))
        for key, channel in file.channels.items()
        if keys is None or key in keys
    }
    return {key: translate for key, translate in found.items() if translate is not None}


class _RosbagsSource:
    """Whatever else the ``rosbags`` reader opens: SQLite, compressed messages."""

    damage: str | None = None
    cut = False
    lost_bytes = 0

    def __init__(self, path: Path) -> None:
        self._path = path
        self._channels: list[tuple[McapChannel, int]] = []
        with self._reader() as reader:
            for item in reader.connections:
                definition = MessageDefinition(
                    item.msgdef.data, item.digest, _ENCODINGS.get(item.msgdef.format.name, "")
                )
                channel = McapChannel(item.topic, item.msgtype, definition, item.ext.serialization_format, [])
                self._channels.append((channel, item.msgcount))

    def channels(self) -> list[tuple[McapChannel, int]]:
        return self._channels

    def raw(self, wanted: set[str] | None, as_stored: bool = False) -> Iterator[RawMessage]:
        translated: dict[str, Translation] = {}
        for channel, _ in () if as_stored else self._channels:
            translate = translation(channel.message_type, channel.definition, str(self._path))
            if translate is not None:
                translated[channel.topic] = translate
        with self._reader() as reader:
            chosen = [c for c in reader.connections if wanted is None or bench_name(c.topic) in wanted]
            messages = reader.messages(chosen) if chosen else iter(())
            while True:
                try:
                    connection, received, raw = next(messages)
                except StopIteration:
                    return
                except Exception as error:
                    raise BenchError(f"The bag {self._path} is damaged: {error}.") from error
                message = bytes(raw)
                if connection.topic in translated:
                    message = translated[connection.topic](message)
                yield bench_name(connection.topic), received, received, message

    def parts(self, wanted: set[str]) -> Iterator[list[RawMessage] | LostSpan]:
        """Nothing: what these stores lose they do not survive."""
        return iter(())

    def has_lost(self) -> bool:
        return False

    def _reader(self) -> Any:
        from rosbags.rosbag2 import Reader  # here: the bench's own bags are read without it

        try:
            reader = Reader(self._path)
            reader.open()
        except Exception as error:  # storage back ends raise their own kinds
            raise BenchError(f"The bag {self._path} cannot be opened: {str(error).rstrip('.')}.") from error
        return contextlib.closing(reader)


def _open_file(path: Path) -> tuple[_Source, dict[str, str]]:
    if path.name == "metadata.yaml":
        return _open_folder(path.parent)
    with open_regular(path, "bag file", 2**62) as file:
        head = file.read(16)
    if head == _SQLITE_MAGIC:
        return _RosbagsSource(path), {}
    check_magic(path, head)
    files = _readable([McapFile.open(path)], path)
    return _McapSource(files), _custom_of(_information(files[0].custom_data(), str(path)))


def _open_folder(folder: Path) -> tuple[_Source, dict[str, str]]:
    names = {entry.name for entry in folder.iterdir()}
    if not names:
        raise BenchError(f"The folder {folder} is empty; nothing was recorded into it.")
    metadata = _read_metadata(folder) if "metadata.yaml" in names else {}
    custom = _custom_of(metadata)
    compressed = str(metadata.get("compression_mode") or "").lower() in ("file", "message")
    if compressed or metadata.get("storage_identifier") == "sqlite3":
        return _RosbagsSource(folder), custom
    # The folder may have been renamed or split: the names in metadata.yaml give the order, no more.
    listed = metadata.get("relative_file_paths")
    paths = [folder / Path(str(name)).name for name in listed] if isinstance(listed, list) else []
    missing = [path.name for path in paths if not path.is_file()]
    found = sorted((folder / name for name in names if name.endswith(".mcap")), key=_natural)
    if missing and len(found) >= len(paths):
        paths = []  # all files are there, and metadata.yaml, damaged, calls them otherwise
    elif missing:
        raise BenchError(f"The bag {folder} lacks its file {missing[0]}; copy the whole folder again.")
    paths = paths or found
    if paths:
        return _McapSource(_readable([McapFile.open(path) for path in paths], folder)), custom
    if any(name.endswith(".db3") for name in names):
        return _RosbagsSource(min(folder / name for name in names if name.endswith(".db3"))), custom
    if (folder / "bag").is_dir():
        return _open_folder(folder / "bag")
    if any(name.endswith(".bag") for name in names):
        raise BenchError(f"The folder {folder} holds a ROS 1 bag; convert it with 'rosbags-convert'.")
    raise BenchError(f"The folder {folder} is not a bag; a rosbag2 folder or an .mcap file is needed.")


def _readable(files: list[McapFile], path: Path) -> list[McapFile]:
    if any(file.damage for file in files) and not any(file.channels for file in files):
        raise BenchError(f"The bag {path} was cut off before its first whole chunk; nothing in it can be read.")
    return files


def _read_metadata(folder: Path) -> dict[str, Any]:
    """Content of ``metadata.yaml``; empty if it is damaged, since the bag file explains itself."""
    try:
        return _information(read_text(folder / "metadata.yaml", "description of the bag"), "metadata.yaml")
    except BenchError:
        return {}


def _information(text: str, name: str) -> dict[str, Any]:
    try:
        content = yaml_value(text, name)
    except BenchError:
        return {}
    information = content.get("rosbag2_bagfile_information", content) if isinstance(content, dict) else None
    return information if isinstance(information, dict) else {}


def _custom_of(information: dict[str, Any]) -> dict[str, str]:
    custom = information.get("custom_data")
    return {str(key): str(value) for key, value in custom.items()} if isinstance(custom, dict) else {}


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]
