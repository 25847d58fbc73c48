"""From a bag to files that others read, with the sidecar that imports them again without loss."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_text
from nmt_core.files.whole_file import write_whole, writing
from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import OscillatorPhase, Quantity
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import LevelCommand, LockEvent, LoopStatus
from nmt_core.messages.wire import LEVEL, read_status
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import LEVEL_UNITS, ROTATION_UNITS, ControlKind, TestKind
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange import FORMATS
from nmt_record.exchange.arrays import uff
from nmt_record.exchange.reduced.frf_table import read_frf_table
from nmt_record.exchange.sidecar.side_tables import BlockRow, write_block_table, write_records
from nmt_record.exchange.unit_table import coordinate_of_unit
from nmt_record.windows.segments import Segment, Signals, read_signals, segments

LATERAL = 3
"""Direction of every channel with a point: +z."""
TURNING = 6
"""The same of a rotation: about +z."""

_CSV_ROWS = 50_000
_LARGEST_MAT = 2**31


def covers(test: DrivenTest) -> str:
    """What export and import do not take of a test: nothing. Levels and lock events go with the samples as recorded."""
    return ""


@dataclass(frozen=True)
class Extent:
    """Samples from ``first`` to before ``stop``."""

    first: int
    stop: int

    @property
    def samples(self) -> int:
        """How many."""
        return self.stop - self.first


def recorded_extent(bag: Bag) -> Extent:
    """First sample of the bag and the one after the last.

    Raises:
        BenchError: the bag has no samples.
    """
    extents = [(head.first_sample, head.end_sample) for _, head in bag.heads()]
    if not extents:
        raise BenchError(f"The bag {bag.path} holds no samples to export.")
    first, stop = zip(*extents, strict=True)
    return Extent(min(first), max(stop))


@dataclass(frozen=True)
class LevelSpan:
    """A level of the plan, and the window it led to."""

    index: int
    test: TestKind
    level: float
    unit: str
    first: int
    stop: int
    command: LevelCommand | None
    locks: tuple[tuple[Segment, LockEvent], ...]


def level_spans(bag: Bag, extent: Extent) -> list[LevelSpan]:
    """Levels in the order of time with the lock events that belong to them.

    Bags without level messages (imported ones without levels) give one span for each lock event.
    """
    events = bag.lock_events()
    windows = list(zip(segments(bag), events, strict=True))
    every = list(bag.records("level", LEVEL))
    levels = [level for level in every if level.amplitude > 0.0]
    starts = [level.apply_at_sample for level in levels]
    quiet = [level.apply_at_sample for level in every if not level.amplitude > 0.0]
    spans: list[LevelSpan] = []
    known = {level.index for level in levels}
    for number, level in enumerate(levels):
        first = max(starts[number], extent.first)
        later = [start for start in (*starts[number + 1 :], *quiet) if start > starts[number]]
        stop = min([*later, extent.stop])
        own = tuple(pair for pair in windows if pair[0].level_index == level.index)
        stop = min(max([stop, *(segment.end_sample for segment, _ in own)]), extent.stop)
        unit = own[0][0].level_unit if own else _unit(level.control)
        spans.append(LevelSpan(level.index, level.test, level.amplitude, unit, first, stop, level, own))
    spans += [
        LevelSpan(
            own.level_index, own.kind, own.level, own.level_unit, own.first_sample, own.end_sample, None, ((own, e),)
        )
        for own, e in windows
        if own.level_index not in known
    ]
    return sorted(spans, key=lambda span: span.first)


def _unit(control: int) -> str:
    """Unit of a level that opened no window: that of a controlled response is not known."""
    return ControlKind(control).level_unit() if control in frozenset(ControlKind) else ""


@dataclass(frozen=True)
class ExportedRun:
    """What an export wrote.

    Attributes:
        files: names relative to the folder.
        loss: a sentence on what the recording lost; empty if nothing.
    """

    files: tuple[str, ...]
    loss: str


def export_run(
    source: Path | str, folder: Path | str, form: str = "uff", *, ascii_uff: bool = False, only: Sequence[int] = ()
) -> ExportedRun:
    """Export a recording so that other tools read it and :func:`nmt_bench.import_data` reads it back without loss.

    Args:
        source: a bag, or a folder of results; its ``frf.csv`` is exported too (``uff`` only), and its ``linear.json``
            where the bag holds no linear modes.
        folder: exists.
        form: one of :data:`nmt_record.exchange.FORMATS`.
        ascii_uff: UFF in ASCII (13 digits) instead of 58b (all bits).
        only: numbers of the segments (levels) to export, from 1, each into a folder ``segment-N``; none = the
            whole recording.

    Raises:
        BenchError: no bag, nothing to export, no such segment, or the disk refuses.
    """
    if form not in FORMATS:
        raise BenchError(f"A recording is exported as {', '.join(FORMATS)}, not as '{form}'.")
    source, folder = Path(source), Path(folder)
    responses = source / "frf.csv"
    with_responses = form == "uff" and source.is_dir() and responses.is_file()
    bag = Bag.open(source) if not with_responses or (source / "bag").exists() else None
    linear = linear_text(bag) if bag is not None else ""
    linear_file = source / "linear.json"
    if not linear and source.is_dir() and linear_file.is_file():
        linear = read_text(linear_file, "linear description")
    files = [] if bag is None else _export_samples(bag, folder, form, ascii_uff, only, linear)
    if with_responses:
        drive_point = LinearDescription.from_json(linear).drive_point if linear else 0
        export_frf(responses, folder / "frf.uff", drive_point, not ascii_uff)
        files.append("frf.uff")
    return ExportedRun(tuple(files), (bag.loss or "") if bag is not None else "")


def _export_samples(bag: Bag, folder: Path, form: str, ascii_uff: bool, only: Sequence[int], linear: str) -> list[str]:
    whole = recorded_extent(bag)
    rig = bag.rig_yaml or ""
    if not only:
        return export_bag(bag, folder, form, whole, ascii_uff, rig, linear)
    spans = level_spans(bag, whole)
    files = []
    for number in dict.fromkeys(only):
        if not 1 <= number <= len(spans):
            has = f"segments 1 to {len(spans)}" if spans else "no segments"
            raise BenchError(f"The bag {bag.path} has {has}, so there is no segment {number} to export.")
        span = spans[number - 1]
        part = folder / f"segment-{number}"
        part.mkdir()
        names = export_bag(bag, part, form, Extent(span.first, span.stop), ascii_uff, rig, linear)
        files += [f"{part.name}/{name}" for name in names]
    return files


def export_bag(
    bag: Bag, folder: Path, form: str, extent: Extent, ascii_uff: bool = False, rig: str = "", linear: str = ""
) -> list[str]:
    """Write data, side files and sidecar of a stretch of a bag.

    Args:
        bag: the bag.
        folder: exists.
        form: one of :data:`nmt_record.exchange.FORMATS`.
        extent: the stretch.
        ascii_uff: UFF in ASCII (13 digits) instead of 58b (all bits).
        rig: text of the rig file; empty = none.
        linear: ``linear.json`` to put next to; empty = none.

    Returns:
        Names of the files.

    Raises:
        BenchError: nothing to export, channels that change, or the disk refuses.
    """
    signals = read_signals(bag, extent.first, extent.samples)
    sidecar: dict[str, Any] = {}
    if bag.run_start and bag.run_start.get("run_id"):
        sidecar["run_id"] = str(bag.run_start["run_id"])
    files = []
    if rig:
        _write_text(folder / "rig.yaml", rig)
        sidecar["rig"] = "rig.yaml"
        files.append("rig.yaml")
    elif bag.run_start and bag.run_start.get("rig"):
        sidecar["rig"] = str(bag.run_start["rig"])
    sidecar["sample_rate"] = signals.sample_rate
    sidecar["file"] = f"data.{form}"
    sidecar["first_sample"] = extent.first
    if form == "uff":
        write_time_uff(folder / "data.uff", signals, not ascii_uff)
    elif form == "npz":
        _write_npz(folder / "data.npz", signals)
    elif form == "h5":
        _write_hdf5(folder / "data.h5", signals)
    elif form == "mat":
        _write_mat(folder / "data.mat", signals)
    else:
        _write_csv(folder / "data.csv", signals)
    files.append(sidecar["file"])
    sidecar["channels"] = [_channel(name, signals) for name in signals.channels]
    sidecar["segments"] = _segment_entries(bag, extent, signals.sample_rate)
    if linear:
        _write_text(folder / "linear.json", linear)
        sidecar["linear"] = "linear.json"
        files.append("linear.json")
    for key in ("extraction", "plan", "exciter_points"):
        value = (bag.run_start or {}).get(key)
        if isinstance(value, dict):
            value = {name: item for name, item in value.items() if name != "pacing"}  # that of the recording
        if isinstance(value, dict | list) and value:
            sidecar[key] = value
    blocks = _block_rows(bag, extent)
    write_block_table(folder / "oscillator.csv", blocks)
    sidecar["oscillator"] = "oscillator.csv"
    files.append("oscillator.csv")
    for key, kind, records in (
        ("loop", LoopStatus, _states(bag, extent)),
        ("levels", LevelCommand, _levels(bag, extent)),
        ("locks", LockEvent, _locks(bag, extent)),
    ):
        if records:
            write_records(folder / f"{key}.csv", kind, records)
            sidecar[key] = f"{key}.csv"
            files.append(f"{key}.csv")
    text = yaml.safe_dump(sidecar, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    _write_text(folder / "sidecar.yaml", "# ./nmt import sidecar.yaml --out DIR\n" + text)
    return [*files, "sidecar.yaml"]


def _channel(name: str, signals: Signals) -> dict[str, Any]:
    unit = signals.units[name]
    quantity = coordinate_of_unit(unit) if unit != "1" else "strain"
    entry = {"column": name, "quantity": quantity or signals.quantities[name].topic, "unit": unit, "scale": 1.0}
    if signals.points[name]:
        entry["point"] = signals.points[name]
    return {**entry, "name": name}


def _segment_entries(bag: Bag, extent: Extent, rate: float) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = []
    for span in level_spans(bag, extent):
        first, stop = max(span.first, extent.first), min(span.stop, extent.stop)
        locks = [
            pair for pair in span.locks if extent.first <= pair[0].first_sample and pair[0].end_sample <= extent.stop
        ]
        if stop <= first or (span.locks and not locks):
            continue
        head: dict[str, Any] = {"kind": span.test.label}
        if math.isfinite(span.level):
            head["level"] = span.level
        if span.unit in LEVEL_UNITS:
            head["level_unit"] = span.unit
        head["index"] = span.index
        command = span.command
        if command is not None and kind_class(span.test).is_broad_band and command.band_high_hz > 0.0:
            head["band_hz"] = [command.band_low_hz, command.band_high_hz]
        if command is not None and kind_class(span.test).sweeps:
            head["rate_hz_s"] = command.rate_hz_s
            if command.frequency_end_hz > 0.0:
                head["frequency_end_hz"] = command.frequency_end_hz
        if not locks:
            entries.append({**head, "start": first / rate, "stop": stop / rate, "locked": False})
            continue
        # Several windows of one level (slow ramps) become consecutive segments of that level.
        edges = [first, *(segment.end_sample for segment, _ in locks[:-1]), stop]
        for number, (segment, event) in enumerate(locks):
            entry = {**head, "start": edges[number] / rate, "stop": edges[number + 1] / rate}
            entry["window"] = [segment.first_sample / rate, segment.end_sample / rate]
            if segment.periods:
                entry["periods"] = segment.periods
            if segment.frequency_hz > 0.0:
                entry["frequency_hz"] = segment.frequency_hz
            if event.sample >= extent.first:
                entry["lock_time"] = event.sample / rate
            if math.isfinite(event.phase_error):
                entry["phase_error"] = event.phase_error
            entries.append(entry)
    return _without_overlap(entries)


def _without_overlap(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A window may outlast its level; the next segment then begins where it ends."""
    kept: list[dict[str, Any]] = []
    for entry in sorted(entries, key=lambda item: float(item["start"])):
        if kept and entry["start"] < kept[-1]["stop"]:
            reached = kept[-1]["window"][1] if "window" in kept[-1] else entry["start"]
            kept[-1]["stop"] = max(reached, entry["start"])
            entry["start"] = kept[-1]["stop"]
            if "window" in entry and entry["window"][0] < entry["start"]:
                raise BenchError(
                    f"The windows of levels {kept[-1]['index']} and {entry['index']} overlap; export them one by one "
                    "with --segment."
                )
        if entry["start"] < entry["stop"]:
            kept.append(entry)
    return kept


def write_time_uff(path: Path, signals: Signals, binary: bool = True) -> None:
    """Write every channel as a dataset 58 of function type 1; node = point, direction +z.

    Raises:
        BenchError: the file cannot be written.
    """
    functions = []
    for name, data in signals.channels.items():
        quantity, point = signals.quantities[name], signals.points[name]
        functions.append(
            uff.UffFunction(
                uff.TIME_RESPONSE,
                data,
                signals.first_sample / signals.sample_rate,
                1.0 / signals.sample_rate,
                lines=(name, f"sample rate {signals.sample_rate!r} Hz, first sample {signals.first_sample}"),
                response_node=point,
                response_direction=_direction(signals.units[name]) if point else 0,
                abscissa_axis=uff.Axis(uff.TIME, "Time", "s"),
                ordinate_axis=_axis(quantity, signals.units[name]),
            )
        )
    uff.write_uff(path, functions, binary)


def _direction(unit: str) -> int:
    """+z, or about z where the unit is that of a rotation."""
    return TURNING if unit in ROTATION_UNITS.values() else LATERAL


def _axis(quantity: Quantity, unit: str) -> uff.Axis:
    return uff.Axis(uff.DATA_TYPES.get(quantity, uff.GENERAL), quantity.name.capitalize(), unit)


def _write_npz(path: Path, signals: Signals) -> None:
    arrays: dict[str, Any] = {**signals.channels, "sample_rate": np.array(signals.sample_rate)}
    with writing(path):
        np.savez(path, **arrays)


def _write_hdf5(path: Path, signals: Signals) -> None:
    """One data set a channel, with unit and point as attributes."""
    import h5py

    with writing(path), h5py.File(path, "w") as file:
        file.attrs["sample_rate_hz"] = signals.sample_rate
        file.attrs["first_sample"] = signals.first_sample
        for name, values in signals.channels.items():
            data = file.create_dataset(name, data=values)
            data.attrs["unit"] = signals.units[name]
            data.attrs["quantity"] = signals.quantities[name].topic
            data.attrs["point"] = signals.points[name]


def _write_mat(path: Path, signals: Signals) -> None:
    """MATLAB's format 5: one column vector a channel, and ``sample_rate``."""
    from scipy.io import savemat

    if any(values.nbytes >= _LARGEST_MAT for values in signals.channels.values()):
        raise BenchError(f"{path.name}: a channel is larger than a MATLAB file of version 5 can hold; export h5.")
    with writing(path):
        savemat(path, {**signals.channels, "sample_rate": signals.sample_rate}, oned_as="column")


def _write_csv(path: Path, signals: Signals) -> None:
    time = (signals.first_sample + np.arange(signals.samples)) / signals.sample_rate
    names = ["time [s]", *(f"{name} [{signals.units[name]}]" for name in signals.channels)]
    columns: list[FloatArray] = [time, *signals.channels.values()]
    with writing(path), path.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(names) + "\n")
        for first in range(0, signals.samples, _CSV_ROWS):
            part = [column[first : first + _CSV_ROWS].tolist() for column in columns]
            # repr gives the shortest digits that read back to the same bits.
            file.writelines(",".join(map(repr, row)) + "\n" for row in zip(*part, strict=True))


def _block_rows(bag: Bag, extent: Extent) -> list[BlockRow]:
    """Blocks of the topic whose phase the extraction uses; cut blocks keep the phase of their first sample."""
    names = bag.sample_topics
    leading = "force" if "force" in names else names[0]
    rows: dict[int, BlockRow] = {}
    flags: list[tuple[str, int, int, int]] = []
    for topic, block in bag.heads():
        first, stop = max(block.first_sample, extent.first), min(block.end_sample, extent.stop)
        if stop <= first:
            continue
        if block.flags:
            flags.append((topic, first, stop, block.flags))
        if topic == leading:
            skipped = (first - block.first_sample) / block.sample_rate
            phase = block.oscillator
            if skipped > 0.0:
                cycles = phase.cycles + skipped * (phase.frequency_hz + 0.5 * phase.rate_hz_s * skipped)
                phase = OscillatorPhase(cycles % 1.0, phase.frequency_hz + phase.rate_hz_s * skipped, phase.rate_hz_s)
            rows[first] = BlockRow(first, stop - first, phase)
    for topic, first, stop, value in flags:
        for row in rows.values():
            if row.first_sample < stop and first < row.first_sample + row.samples:
                row.flags[topic] = row.flags.get(topic, 0) | value
    return [rows[first] for first in sorted(rows)]


def _levels(bag: Bag, extent: Extent) -> list[LevelCommand]:
    """Levels of the stretch; one that began before the recording belongs to its first sample."""
    begin = recorded_extent(bag).first
    found = bag.records("level", LEVEL)
    return [level for level in found if extent.first <= max(level.apply_at_sample, begin) < extent.stop]


def _locks(bag: Bag, extent: Extent) -> list[LockEvent]:
    found = bag.lock_events()
    return [lock for lock in found if extent.first <= lock.window_first_sample and lock.window_end <= extent.stop]


def _states(bag: Bag, extent: Extent) -> list[LoopStatus]:
    found = []
    for _, _, _, raw in bag.raw_messages(["frequency"]):
        try:
            status = read_status(raw)
        except ValueError:
            continue
        if extent.first <= status.last_sample < extent.stop:
            found.append(status)
    return found


def export_frf(table: Path, path: Path, drive_point: int, binary: bool = True) -> int:
    """Write the frequency responses of ``frf.csv`` as datasets 58 of function type 4.

    Node = response point, reference node = drive point, both in +z; SI units.

    Args:
        table: ``frf.csv``.
        path: of the UFF file.
        drive_point: of the force; 0 = not known.
        binary: 58b where the frequencies are even, else ASCII.

    Returns:
        Number of functions.

    Raises:
        BenchError: the table is not one of frequency responses or the file cannot be written.
    """
    functions = []
    for response in read_frf_table(table, drive_point):
        even = _even(response.frequency_hz)
        functions.append(
            uff.UffFunction(
                uff.FREQUENCY_RESPONSE,
                response.values,
                float(response.frequency_hz[0]),
                float(response.frequency_hz[-1] - response.frequency_hz[0]) / max(1, response.frequency_hz.size - 1),
                None if even else response.frequency_hz,
                (response.name, "response over force", response.estimator),
                response.point,
                LATERAL,
                response.drive_point,
                LATERAL,
                uff.Axis(uff.FREQUENCY, "Frequency", "Hz"),
                _axis(response.quantity, response.quantity.unit),
                uff.Axis(uff.FORCE, "Force", "N"),
            )
        )
    # In 58b readers differ on the precision of an uneven abscissa; in ASCII there is one form.
    uff.write_uff(path, functions, binary and all(function.abscissa is None for function in functions))
    return len(functions)


def _even(frequency: FloatArray) -> bool:
    steps = np.diff(frequency)
    return bool(steps.size and np.abs(steps - steps.mean()).max() <= 1e-3 * steps.mean())


def linear_text(bag: Bag) -> str:
    """The linear description in a bag as ``linear.json``; empty if it has none."""
    linear = (bag.run_start or {}).get("linear")
    return json.dumps(linear) if isinstance(linear, dict) else ""


def _write_text(path: Path, text: str) -> None:
    with writing(path):
        write_whole(path, text)
