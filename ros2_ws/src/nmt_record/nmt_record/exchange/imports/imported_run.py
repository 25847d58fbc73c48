"""From a sidecar and its files to a bag of the bench."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import open_regular, read_text
from nmt_core.files.yaml_document import YamlDocument, parse_document
from nmt_core.messages.blocks import UNKNOWN_PHASE, OscillatorPhase, Quantity, SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import LevelCommand, LockEvent, LoopStatus
from nmt_core.messages.wire import LEVEL, LOCK_EVENT, BlockWriter, write_status
from nmt_core.vocabulary import ControlKind, LoopState, TestKind
from nmt_record.bag.bag_writer import BagWriter, Storage
from nmt_record.bag.bench_topics import BENCH_TOPICS
from nmt_record.bag.message_definitions import local_definitions
from nmt_record.exchange.clocks.column_clock import Clock, find_clock
from nmt_record.exchange.clocks.message_clock import ClockChoice
from nmt_record.exchange.import_table import read_table
from nmt_record.exchange.imports.channel_values import channel_values, without_delay
from nmt_record.exchange.judgement.channel_checks import (
    CheckedStretch,
    ImportedChannel,
    check_columns,
    check_names,
    check_physics,
)
from nmt_record.exchange.judgement.column_faults import check_zeros, judged_columns
from nmt_record.exchange.judgement.motions import check_motions
from nmt_record.exchange.judgement.row_continuity import doubled_blocks, phase_jump
from nmt_record.exchange.messages.ros_bag_table import is_bag, read_bag
from nmt_record.exchange.reduced.frf_checks import ShapeSign, check_responses
from nmt_record.exchange.reduced.observables import (
    OBSERVABLES_TOPIC,
    OBSERVABLES_TYPE,
    ObservableTable,
    read_observables,
)
from nmt_record.exchange.sidecar.import_sidecar import (
    STEADY_KINDS,
    Sidecar,
    SignalSection,
    TableSection,
    check_sidecar,
    read_sidecar,
    sidecar_of,
)
from nmt_record.exchange.sidecar.side_tables import BlockRow, read_block_table, read_records
from nmt_record.exchange.source_table import SourceTable

_BLOCK_SECONDS, _LEAST_BLOCK = 0.02, 200  # s, samples: each block costs a message, however slow the clock is


@dataclass(frozen=True)
class ImportedSegment:
    """A segment on the sample grid of the bag.

    Attributes:
        section: what the sidecar says.
        name: for messages.
        index: level number.
        first_sample: first sample of the segment.
        stop_sample: sample after its last one.
        window: first sample and sample after the last one of the window; None = there is none.
    """

    section: SignalSection
    name: str
    index: int
    first_sample: int
    stop_sample: int
    window: tuple[int, int] | None


@dataclass(eq=False)
class ImportedRun:
    """All that goes into the bag.

    Attributes:
        path: of the sidecar.
        sidecar: what it says.
        sample_rate: Hz; NaN without time data.
        clock_std: relative standard uncertainty of it by the digits of the file; 0 = as good as a clock.
        first_sample: index of the first sample.
        channels: in SI units on one grid.
        segments: in the order of time.
        tables: tables of others.
        blocks: phase of the excitation block by block; empty = not known.
        loop: states of the loop; empty = not known.
        levels, locks: in the order of time.
        linear: linear modes; None = not known.
        notes: sentences on what was fixed, marked or is unusual.
        sources: the files that were read, by name.
        files: name and SHA-256 of each.
    """

    path: Path
    sidecar: Sidecar
    sample_rate: float = math.nan
    clock_std: float = 0.0
    first_sample: int = 0
    channels: list[ImportedChannel] = field(default_factory=list)
    segments: list[ImportedSegment] = field(default_factory=list)
    tables: list[ObservableTable] = field(default_factory=list)
    blocks: list[BlockRow] = field(default_factory=list)
    loop: list[LoopStatus] = field(default_factory=list)
    levels: list[LevelCommand] = field(default_factory=list)
    locks: list[LockEvent] = field(default_factory=list)
    linear: LinearDescription | None = None
    notes: list[str] = field(default_factory=list)
    sources: dict[str, Path] = field(default_factory=dict)
    files: list[dict[str, str]] = field(default_factory=list)

    @property
    def samples(self) -> int:
        """Length of the time data."""
        return int(self.channels[0].data.shape[0]) if self.channels else 0

    def data_file(self, name: str, place: str) -> Path:
        """A file that the sidecar names, which becomes one of the sources.

        Raises:
            BenchError: it is not there.
        """
        path = self.path.parent / name
        if not path.is_file() and not is_bag(path):
            raise BenchError(f"{place}: there is no file {path}; names are relative to the sidecar.")
        self.sources[path.name] = path
        return path


def read_import(
    path: Path,
    describe: Callable[[Sidecar], LinearDescription | None] = lambda sidecar: None,
    shape_sign: ShapeSign = lambda point, drive_point, frequency_hz: 0.0,
) -> ImportedRun:
    """Read a sidecar and everything that it names, and check all of it.

    Args:
        path: of the sidecar.
        describe: gives the linear modes if the sidecar names no ``linear.json``; None = not known.
        shape_sign: sign of a response away from the drive point at a resonance; asked after ``describe``.

    Raises:
        BenchError: the first thing that is wrong, where, and how to fix it.
    """
    sidecar, document = read_sidecar(path)
    return _read(path, sidecar, document, describe, shape_sign)


def check_proposal(text: str, path: Path) -> None:
    """Check a sidecar that is not written yet as :func:`read_import` would.

    Args:
        text: the sidecar.
        path: where it would be, next to its data.

    Raises:
        BenchError: the import would refuse it.
    """
    document = parse_document(text, path.name, "sidecar", "file and channels")
    _read(
        path, sidecar_of(document), document, lambda sidecar: None, lambda point, drive_point, frequency_hz: 0.0, False
    )


def _read(
    path: Path,
    sidecar: Sidecar,
    document: YamlDocument,
    describe: Callable[[Sidecar], LinearDescription | None],
    shape_sign: ShapeSign,
    digests: bool = True,
) -> ImportedRun:
    check_sidecar(sidecar, document)
    run = ImportedRun(path, sidecar, sources={path.name: path})
    if sidecar.linear is None:
        run.linear = describe(sidecar)
    else:
        run.linear = _read_linear(run.data_file(sidecar.linear, document.place(("linear",))))
    if sidecar.channels:
        _read_signals(run, document)
    for number, section in enumerate(sidecar.segments):
        if isinstance(section, TableSection):
            place = document.place(("segments", number))
            file = run.data_file(section.file or sidecar.file, place)
            tables = read_observables(section, file, place)
            for table in tables:
                check_responses(section, table, place, shape_sign)
            run.tables += tables
            run.notes += [note for table in tables for note in table.notes]
    run.files = [_digest(source) for source in run.sources.values() if digests]
    return run


def write_import(run: ImportedRun, folder: Path, rig: str, rig_yaml: str, versions: dict[str, str]) -> Path:
    """Write the bag.

    Args:
        run: from :func:`read_import`.
        folder: of the bag; must not exist.
        rig: name of the rig.
        rig_yaml: rig file; empty = none.
        versions: what a result depends on.

    Raises:
        BenchError: the disk refuses.
    """
    writer = BagWriter(
        folder,
        run_json=json.dumps(_description(run, rig, versions)),
        rig_yaml=rig_yaml,
        storage=Storage(flush_interval=math.inf),
        # The same import gives the same file.
        clock=lambda: 0,
    )
    try:
        for topic in BENCH_TOPICS:
            if topic.name != "run_record":
                writer.add_topic(topic.name, topic.message_type, topic.service)
        writer.add_topic(OBSERVABLES_TOPIC, OBSERVABLES_TYPE)
        string = local_definitions().typestore.types[OBSERVABLES_TYPE]
        for number, table in enumerate(run.tables):
            writer.write_message(OBSERVABLES_TOPIC, string(data=table.to_json()), number, number)
        if run.channels:
            _Messages(run, writer, rig).write()
        end = round((run.first_sample + run.samples) / run.sample_rate * 1e9) if run.channels else 0
        writer.close("done", "imported", end)
    except BaseException:
        writer.close_quietly()
        raise
    return folder


def _description(run: ImportedRun, rig: str, versions: dict[str, str]) -> dict[str, Any]:
    levels = [segment.section.level for segment in run.segments if segment.section.level is not None]
    return {
        "run_id": run.sidecar.run_id or run.path.stem,
        "rig": rig,
        "plan": {**(run.sidecar.plan or {"levels": levels}), "pacing": "imported"},
        **({"exciter_points": points, "exciter_point": points[0]} if (points := run.sidecar.exciter_points) else {}),
        "linear": None if run.linear is None else json.loads(run.linear.to_json()),
        "extraction": run.sidecar.extraction or {},
        "versions": versions,
        "imported": {
            "sidecar": run.sidecar.model_dump(mode="json", exclude_unset=True),
            "files": run.files,
            "notes": run.notes,
            **({"clock_std": run.clock_std} if run.clock_std > 0.0 else {}),
        },
    }


# --- reading ---------------------------------------------------------------------------------------------------------


def _read_signals(run: ImportedRun, document: YamlDocument) -> None:
    sidecar = run.sidecar
    file = run.data_file(sidecar.file, document.place(("file",)))
    names = [channel.column for channel in sidecar.channels]
    if is_bag(file):
        table = read_bag(file, names, _choice(sidecar))
    else:
        table = read_table(file, [*names, *([] if sidecar.time is None else [sidecar.time])], sidecar.time)
    places = [document.place(("channels", number)) for number in range(len(sidecar.channels))]
    check_names(sidecar.channels, table, places)
    clock = find_clock(table, sidecar, document.name)
    indices = [table.index(channel.column, place) for channel, place in zip(sidecar.channels, places, strict=True)]
    _refuse_shared_columns(indices, places, table.names)
    scaled: list[str] = []
    columns, found = judged_columns(sidecar.channels, indices, table, places)
    for channel, index, column, place in zip(sidecar.channels, indices, columns, places, strict=True):
        values = clock.spread(channel_values(channel, table, index, column, place, scaled))
        if channel.delay_s != 0.0:
            values = without_delay(values, channel.delay_s * clock.sample_rate)
        run.channels.append(ImportedChannel(channel, channel.channel, table.names[index] or str(index + 1), values))
    run.sample_rate, run.clock_std = clock.sample_rate, clock.std
    run.first_sample = sidecar.first_sample
    run.notes += [*table.notes, *clock.notes, *found, *scaled]
    run.segments = _segments(run, clock, document)
    run.notes += check_columns(run.channels, table, places)
    stretches = [
        CheckedStretch(s.section, s.name, window[0] - run.first_sample, window[1] - run.first_sample)
        for s in run.segments
        for window in [s.window or (s.first_sample, s.stop_sample)]
        if s.section.locked
    ]
    _check_continuity(run, table, clock, stretches)
    if not run.sidecar.loop:
        run.loop = _made_states(run)
    run.notes += check_motions(run.channels, stretches, places, run.sample_rate)
    run.notes += check_physics(run.channels, stretches, run.sample_rate, run.linear)
    run.notes += check_zeros(run.channels, [(s.first, s.stop) for s in stretches], places)
    if sidecar.oscillator is not None:
        side = run.data_file(sidecar.oscillator, document.place(("oscillator",)))
        run.blocks = read_block_table(side, run.first_sample, run.samples)
    if sidecar.loop is not None:
        run.loop = read_records(run.data_file(sidecar.loop, document.place(("loop",))), LoopStatus)
    if sidecar.levels is not None:
        run.levels = read_records(run.data_file(sidecar.levels, document.place(("levels",))), LevelCommand)
    else:
        run.levels = [_level(run, segment) for segment in run.segments if segment.section.level is not None]
    if sidecar.locks is not None:
        run.locks = read_records(run.data_file(sidecar.locks, document.place(("locks",))), LockEvent)
    else:
        run.locks = [_lock(run, segment) for segment in run.segments if segment.window is not None]


def _choice(sidecar: Sidecar) -> ClockChoice:
    """What a sidecar says of the clock of a bag."""
    return ClockChoice(
        clock=sidecar.clock or "",
        field="" if sidecar.time is None else "/" + str(sidecar.time).lstrip("/"),
        unit=sidecar.time_unit if "time_unit" in sidecar.model_fields_set else "",
        sample_rate=sidecar.sample_rate,
        stretch=sidecar.stretch if isinstance(sidecar.stretch, int) else None,
        elements=sidecar.elements or "",
    )


def _check_continuity(run: ImportedRun, table: SourceTable, clock: Clock, stretches: Sequence[CheckedStretch]) -> None:
    """Every row once, as far as the rows themselves and the phase of steady windows tell.

    Raises:
        BenchError: rows are doubled or missing inside a window, with the place.
    """

    def row_of(sample: int) -> int:
        return sample if clock.rows is None else int(np.searchsorted(clock.rows, sample))

    for row, count in doubled_blocks(table.columns):
        sample = row if clock.rows is None else int(clock.rows[row])
        what = f"the {count} rows from {table.place(row)} on repeat the {count} rows before them, value by value"
        inside = next((name for _, name, first, stop in stretches if first < sample + count and sample < stop), None)
        if inside is not None:
            raise BenchError(
                f"In the window of {inside} {what}; take the doubled rows out, or choose a window next to them."
            )
        run.notes.append(f"Outside of the windows {what}.")
    for section, name, first, stop in stretches:
        signals = [channel.data[first:stop] for channel in run.channels]
        if section.test not in STEADY_KINDS or not all(np.isfinite(signal).all() for signal in signals):
            continue  # windows with missing samples are rejected anyway
        jump = phase_jump(signals, run.sample_rate)
        if jump is not None:
            what = "missing" if jump.rows > 0 else "doubled"
            raise BenchError(
                f"In the window of {name} the phase of the channels steps by {jump.phase:.3g} rad near "
                f"{table.place(row_of(first + jump.sample))} ({jump.sigmas:.0f} times its noise), as if about "
                f"{max(1, round(abs(jump.rows)))} rows were {what}; export the data again, or choose a window next to "
                "it."
            )


def _made_states(run: ImportedRun) -> list[LoopStatus]:
    """States that tell which levels did not lock, if some did not; one at the end of each stretch of 20 ms."""
    if all(segment.section.locked for segment in run.segments):
        return []
    size = max(_LEAST_BLOCK, round(_BLOCK_SECONDS * run.sample_rate))
    ends = np.arange(run.first_sample + size - 1, run.first_sample + run.samples + size - 1, size)
    ends = np.minimum(ends, run.first_sample + run.samples - 1)
    ends = np.union1d(ends, [segment.stop_sample - 1 for segment in run.segments if not segment.section.locked])
    states = []
    for end in ends.tolist():
        segment = next((s for s in run.segments if s.first_sample <= end < s.stop_sample), None)
        state, reason, index = LoopState.FIXED, "", 0
        if segment is not None:
            index = segment.index
            over = end + size >= segment.stop_sample
            waiting = LoopState.LOCK_LOST if over else LoopState.ACQUIRING
            state = LoopState.LOCKED if segment.section.locked else waiting
            reason = (segment.section.reason or "the sidecar says so") if state == LoopState.LOCK_LOST else ""
        states.append(
            LoopStatus(end, index, index + 1, state, 0.0, math.nan, math.nan, math.nan, "", math.nan, 0, reason)
        )
    return states


def _refuse_shared_columns(indices: list[int], places: list[str], names: tuple[str, ...]) -> None:
    for number, index in enumerate(indices):
        if index in indices[:number]:
            raise BenchError(
                f"{places[number]}: channels {indices.index(index) + 1} and {number + 1} both take column "
                f"{names[index] or index + 1}; each column is one channel."
            )


def _segments(run: ImportedRun, clock: Clock, document: YamlDocument) -> list[ImportedSegment]:
    found = []
    end = clock.start + run.samples / clock.sample_rate
    half = 0.5 / clock.sample_rate
    sections = [(n, s) for n, s in enumerate(run.sidecar.segments) if isinstance(s, SignalSection)]
    for count, (number, section) in enumerate(sorted(sections, key=lambda pair: pair[1].start)):
        name = f"segment {number + 1} ({section.kind})"
        place = document.place(("segments", number))
        if section.start < clock.start - half or section.stop > end + half:
            raise BenchError(
                f"{place}: {name} reaches from {section.start:g} to {section.stop:g} s, but the data from "
                f"{clock.start:g} to {end:g} s; correct it (or the sampling rate)."
            )

        def sample(time: float) -> int:
            return run.first_sample + clock.sample(time)

        first, stop = sample(section.start), sample(section.stop)
        window: tuple[int, int] | None = None
        if section.window is not None:
            window = sample(section.window[0]), sample(section.window[1])
        elif section.test is TestKind.RING_DOWN and section.switch_off is not None:
            window = sample(section.switch_off), stop
        elif section.test not in STEADY_KINDS:
            window = first, stop
        if window is not None and window[1] - window[0] < 2:
            raise BenchError(f"{place}: the window of {name} holds fewer than two samples; correct its times.")
        index = section.index if section.index is not None else count
        found.append(ImportedSegment(section, name, index, first, stop, window if section.locked else None))
    return found


def _read_linear(path: Path) -> LinearDescription:
    try:
        return LinearDescription.from_json(read_text(path, "linear description"))
    except BenchError as error:
        raise BenchError(f"{path}: {error}") from error


def _digest(path: Path) -> dict[str, str]:
    digest = hashlib.sha256()
    parts = sorted(part for part in path.iterdir() if part.is_file()) if path.is_dir() else [path]
    try:
        for part in parts:
            with open_regular(part, "file", 2**62) as file:
                while piece := file.read(2**20):
                    digest.update(piece)
    except OSError as error:
        raise BenchError(f"{path} cannot be read: {error.strerror or error}.") from error
    return {"name": path.name, "sha256": digest.hexdigest()}


# --- writing ---------------------------------------------------------------------------------------------------------


class _Messages:
    """The messages of a run in the order of bench time, as a recorder would have taken them down."""

    def __init__(self, run: ImportedRun, writer: BagWriter, rig: str) -> None:
        self._run = run
        self._writer = writer
        self._groups = {
            quantity: [channel for channel in run.channels if channel.quantity is quantity]
            for quantity in Quantity
            if any(channel.quantity is quantity for channel in run.channels)
        }
        self._units = {quantity: _unit(group, quantity) for quantity, group in self._groups.items()}
        self._codecs = {quantity: BlockWriter(rig) for quantity in self._groups}
        self._stacks = {
            quantity: np.array([channel.data for channel in group]) for quantity, group in self._groups.items()
        }

    def write(self) -> None:
        """Blocks, and between them levels, locks and loop states where they belong."""
        run = self._run
        levels = _by_time((level.apply_at_sample, level) for level in run.levels)
        locks = _by_time((lock.sample, lock) for lock in run.locks)
        states = _by_time((state.last_sample, state) for state in run.loop)
        for block in run.blocks or self._even_blocks():
            end = block.first_sample + block.samples
            while levels and levels[-1][0] < end:
                sample, level = levels.pop()
                self._writer.write("level", LEVEL.write(level), self._time(sample))
            self._put_block(block)
            while states and states[-1][0] < end:
                self._put_state(states.pop()[1])
            while locks and locks[-1][0] < end:
                self._put_lock(*locks.pop())
        # A lock event may name a window whose blocks are missing.
        while locks:
            self._put_lock(*locks.pop())

    def _even_blocks(self) -> list[BlockRow]:
        run = self._run
        size = max(_LEAST_BLOCK, round(_BLOCK_SECONDS * run.sample_rate))
        return [
            BlockRow(run.first_sample + first, min(size, run.samples - first), UNKNOWN_PHASE, {})
            for first in range(0, run.samples, size)
        ]

    def _time(self, sample: int) -> int:
        return round(sample / self._run.sample_rate * 1e9)

    def _put_block(self, row: BlockRow) -> None:
        first = row.first_sample - self._run.first_sample
        phase: OscillatorPhase = row.oscillator
        for quantity, group in self._groups.items():
            block = SampleBlock(
                row.first_sample,
                self._run.sample_rate,
                quantity,
                self._units[quantity],
                tuple(channel.name for channel in group),
                tuple(channel.point for channel in group),
                self._stacks[quantity][:, first : first + row.samples],
                phase,
                row.flags.get(quantity.topic, 0),
            )
            raw = self._codecs[quantity].write(block)
            self._writer.write(
                quantity.topic, raw, self._time(row.first_sample + row.samples), self._time(row.first_sample)
            )

    def _put_lock(self, sample: int, lock: LockEvent) -> None:
        self._writer.write("lock", LOCK_EVENT.write(lock), self._time(sample), self._time(sample))

    def _put_state(self, status: LoopStatus) -> None:
        time = self._time(status.last_sample)
        self._writer.write("frequency", write_status(status, self._run.sample_rate), time, time)


def _unit(group: Sequence[ImportedChannel], quantity: Quantity) -> str:
    """Unit of a topic: that of a rotation or a strain where all its channels are such, else that of lengths."""
    units = {channel.section.si_unit for channel in group}
    return units.pop() if len(units) == 1 else quantity.unit


def _level(run: ImportedRun, segment: ImportedSegment) -> LevelCommand:
    section = segment.section
    assert section.level is not None
    low, high = section.band_hz or (0.0, 0.0)
    return LevelCommand(
        sequence=segment.index + 1,
        index=segment.index,
        control=ControlKind.of_unit(section.level_unit),
        amplitude=section.level,
        apply_at_sample=segment.first_sample,
        ramp=0.0,
        frequency_hz=section.frequency_hz or 0.0,
        window_periods=section.periods,
        timeout=0.0,
        test=section.test,
        band_low_hz=low,
        band_high_hz=high,
        rate_hz_s=section.rate_hz_s or 0.0,
        frequency_end_hz=section.frequency_end_hz or 0.0,
        duration=(segment.stop_sample - segment.first_sample) / run.sample_rate,
    )


def _lock(run: ImportedRun, segment: ImportedSegment) -> LockEvent:
    section, window = segment.section, segment.window
    assert window is not None
    sample = max(segment.first_sample, window[0] - 1)
    if section.lock_time is not None:
        sample = round(section.lock_time * run.sample_rate)
    frequency = section.frequency_hz
    if frequency is None:
        frequency = 0.0 if section.test in (TestKind.RANDOM, TestKind.RECORD) else math.nan
    return LockEvent(
        level_index=segment.index,
        level=math.nan if section.level is None else section.level,
        level_unit=section.level_unit,
        sample=sample,
        frequency_hz=frequency,
        phase_error=math.nan if section.phase_error is None else section.phase_error,
        window_first_sample=window[0],
        window_samples=window[1] - window[0],
        window_periods=section.periods,
        test=section.test,
        time_ns=round(sample / run.sample_rate * 1e9),
    )


def _by_time(items: Any) -> list[Any]:
    """Sorted so that ``pop()`` gives the earliest; equal times in the given order."""
    return sorted(items, key=lambda item: item[0])[::-1] if not isinstance(items, list) else items
