"""Numbers of any ROS 2 bag as columns of a table: topics and fields, their stamps as clock.

A column is called by topic and field, ``/imu/data.linear_acceleration.z``; elements of arrays are numbered from 1 or,
in joint states, named. The clock is that of the header stamps, or of the log times where a message has none. Message
types that this machine does not know are read by their definition in the bag.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.stamped_samples import field_getter, interpolated
from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.bench_topics import SAMPLE_BLOCK, bench_name
from nmt_record.exchange.import_table import SourceTable

_MOST_ELEMENTS = 64  # of one array
_FEWEST = 16  # messages of a topic that is a recording
_EVEN = 2e-3  # of a step: scatter of stamps that is not worth a word
_SMOOTHER = 0.8  # roughness by which one reading of the stamps is better than the other
_MAGICS = (b"\x89MCAP0\r\n", b"SQLite format 3\0")

# Units by REP 103, of the fields of sensor_msgs, geometry_msgs and nav_msgs.
_FIELDS = (
    ("linear_acceleration.", Quantity.ACCELERATION, "m/s^2"),
    ("accel.linear.", Quantity.ACCELERATION, "m/s^2"),
    ("angular_velocity.", Quantity.VELOCITY, "rad/s"),
    ("accel.angular.", Quantity.ACCELERATION, "rad/s^2"),
    ("twist.linear.", Quantity.VELOCITY, "m/s"),
    ("twist.angular.", Quantity.VELOCITY, "rad/s"),
    ("force.", Quantity.FORCE, "N"),
    ("torque.", Quantity.FORCE, "N*m"),
    ("position.", Quantity.DISPLACEMENT, "m"),
    ("point.", Quantity.DISPLACEMENT, "m"),
    ("translation.", Quantity.DISPLACEMENT, "m"),
    ("range", Quantity.DISPLACEMENT, "m"),
)
_BARE = {
    "Accel": (("linear.", Quantity.ACCELERATION, "m/s^2"), ("angular.", Quantity.ACCELERATION, "rad/s^2")),
    "Twist": (("linear.", Quantity.VELOCITY, "m/s"), ("angular.", Quantity.VELOCITY, "rad/s")),
}
_KNOWN_PACKAGES = ("sensor_msgs", "geometry_msgs", "nav_msgs")
_LEFT_OUT = ("covariance", "header.", "layout.")


def is_bag(path: Path) -> bool:
    """Whether a path is a rosbag2 folder or one of its files, by what is in it."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(path.glob("*.mcap")) or any(path.glob("*.db3"))
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError:
        return False
    return head.startswith(_MAGICS)


def is_foreign(bag: Bag) -> bool:
    """Whether a bag is none of the bench's."""
    return bag.run_start is None and not any(kind == SAMPLE_BLOCK for kind, _ in bag.topics.values())


def bag_tables(path: Path) -> list[SourceTable]:
    """A table for each topic with numbers, those of most messages first.

    Args:
        path: folder, .mcap or .db3 file.

    Raises:
        BenchError: it is no bag or one of the bench's, it cannot be read, or no topic has numbers.
    """
    bag = _foreign(path)
    tables = []
    for topic, (_, count) in sorted(bag.topics.items(), key=lambda item: -item[1][1]):
        recording = _recording(bag, topic) if count >= _FEWEST else None
        if recording is not None:
            tables.append(_table_of(path, [recording]))
    if not tables:
        listed = ", ".join(f"/{topic} ({kind}, {count})" for topic, (kind, count) in sorted(bag.topics.items()))
        raise BenchError(
            f"No topic of the bag {path.name} has numbers in at least {_FEWEST} messages; it has {listed or 'none'}."
        )
    return tables


def read_bag(path: Path, wanted: Sequence[str | int]) -> SourceTable:
    """The columns that a sidecar names, of one topic or of several on the clock of the one with most messages.

    Args:
        path: folder, .mcap or .db3 file.
        wanted: names of columns.

    Raises:
        BenchError: as :func:`bag_tables`, or there is no such topic.
    """
    bag = _foreign(path)
    topics = []
    for column in wanted:
        if isinstance(column, int):
            raise BenchError(f"{path.name} is a bag: name its columns by topic and field, not by number.")
        found = [topic for topic in bag.topics if column.lstrip("/").startswith(f"{topic}.")]
        if not found:
            there = ", ".join(f"/{topic}" for topic in sorted(bag.topics))
            raise BenchError(f"{path.name} has no topic for column {column}; it has {there}.")
        topics.append(max(found, key=len))
    recordings = []
    for topic in dict.fromkeys(topics):
        recording = _recording(bag, topic)
        if recording is None:
            raise BenchError(f"Topic /{topic} of {path.name} has no numbers in at least {_FEWEST} messages.")
        recordings.append(recording)
    return _table_of(path, sorted(recordings, key=lambda own: -own.time.size))


def _foreign(path: Path) -> Bag:
    bag = Bag.open(path)
    if not is_foreign(bag):
        raise BenchError(f"{path.name} is a bag of the bench; it needs no import, give it to './nmt extract'.")
    return bag


@dataclass(frozen=True, eq=False)
class _Recording:
    """One topic.

    Attributes:
        topic: with its slash.
        time: of each message, ns since 1970, ascending.
        clock: what the times are, for messages.
        columns: by field.
        units, quantities: by field, as far as the type tells.
        notes: what was found.
    """

    topic: str
    time: IntArray
    clock: str
    columns: dict[str, FloatArray]
    units: dict[str, str]
    quantities: dict[str, Quantity]
    notes: list[str]


def _recording(bag: Bag, topic: str) -> _Recording | None:
    """All numbers of a topic; None if it has none."""
    name, kind = f"/{bench_name(topic)}", bag.topics[topic][0]
    getters: list[tuple[str, Callable[[Any], Any]]] = []
    rows: list[list[float]] = []
    logged: list[int] = []
    stamped: list[int] = []
    blocks: list[int] = []
    odd = 0
    for _, received, raw in ((t, r, raw) for t, r, _, raw in bag.raw_messages([topic])):
        message = bag.deserialise(topic, raw)
        if not getters:
            getters = list(_numbers(message, ""))
            if not getters:
                return None
        block = _block_of(message)
        try:
            values = block if block is not None else [[float(get(message)) for _, get in getters]]
        except (IndexError, TypeError, ValueError, AttributeError):
            odd += 1
            continue
        stamp = getattr(getattr(message, "header", None), "stamp", None) or getattr(message, "stamp", None)
        stamped.append(0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec))
        logged.append(int(received))
        blocks.append(len(values))
        rows += values
    if len(logged) < 3:
        return None
    names = [field for field, _ in getters]
    if rows and len(rows[0]) != len(names):
        names = [f"data.{number + 1}" for number in range(len(rows[0]))]
    notes = [f"{odd} messages of {name} have another shape than the first; they were left out."] if odd else []
    times, clock = _times(name, stamped, logged, notes)
    table = np.array([row for row in rows if len(row) == len(names)], dtype=np.float64)
    if table.shape[0] != len(rows):
        raise BenchError(
            f"The arrays of {name} change their length from message to message; record them of one length."
        )
    order = np.argsort(times, kind="stable")
    if (order != np.arange(order.size)).any():
        notes.append(f"Messages of {name} are not in the order of their stamps; they were sorted.")
    if max(blocks) > 1:
        times, table = _unfolded(name, times, table, blocks)
    else:
        times, table = times[order], table[order]
    columns = {field: np.ascontiguousarray(column) for field, column in zip(names, table.T, strict=True)}
    told = {field: _meaning(kind, field) for field in names}
    return _Recording(
        name, times, clock, columns, {f: unit for f, (_, unit) in told.items()}, {f: q for f, (q, _) in told.items()},
        notes,
    )  # fmt: skip


def _times(name: str, stamped: list[int], logged: list[int], notes: list[str]) -> tuple[IntArray, str]:
    """Header stamps, or log times where there are none that rise."""
    stamps, logs = np.array(stamped, dtype=np.int64), np.array(logged, dtype=np.int64)
    if not stamps.any():
        return logs, "log times"
    if np.unique(stamps).size < stamps.size or (stamps <= 0).any():
        notes.append(f"The header stamps of {name} repeat or are zero; the log times are its clock.")
        return logs, "log times"
    spans = float(np.ptp(stamps)), float(np.ptp(logs))
    if min(spans) > 0.0 and abs(spans[0] / spans[1] - 1.0) > 0.01:
        notes.append(
            f"The header stamps of {name} take {1e-9 * spans[0]:.6g} s, the log times {1e-9 * spans[1]:.6g} s (a clock "
            "that is off, or a recording that was played at another speed); the header stamps are its clock."
        )
    return stamps, "header stamps"


def _block_of(message: Any) -> list[list[float]] | None:
    """Samples of an array with two dimensions, samples first; None if a message is one sample."""
    layout = getattr(message, "layout", None)
    dimensions = list(getattr(layout, "dim", ()) or ())
    if len(dimensions) != 2 or not hasattr(message, "data"):
        return None
    samples, channels = (int(dimension.size) for dimension in dimensions)
    data = np.asarray(message.data, dtype=np.float64)
    if samples < 1 or channels < 1 or data.size != samples * channels:
        return None
    if "channel" in str(dimensions[0].label).lower():
        return [list(row) for row in data.reshape(samples, channels).T]
    return [list(row) for row in data.reshape(samples, channels)]


def _unfolded(name: str, times: IntArray, table: FloatArray, blocks: list[int]) -> tuple[IntArray, FloatArray]:
    """Times of all samples of messages that hold several; a stamp is that of a message's first sample."""
    size = blocks[0]
    if len(set(blocks)) > 1:
        raise BenchError(f"The blocks of {name} have unequal lengths ({size}, {max(blocks)}); record equal ones.")
    step = float(np.median(np.diff(times))) / size
    return np.asarray((times[:, None] + np.round(step * np.arange(size)).astype(np.int64)).ravel()), table


def _numbers(value: Any, prefix: str) -> list[tuple[str, Callable[[Any], Any]]]:
    """Paths of all numbers of a message, with what fetches each."""
    found: list[tuple[str, Callable[[Any], Any]]] = []
    if not is_dataclass(value):
        return found
    names = getattr(value, "name", None)
    for item in fields(value):
        path, own = f"{prefix}{item.name}", getattr(value, item.name, None)
        if item.name.startswith("__") or any(f"{path}.".startswith(left) or left in path for left in _LEFT_OUT):
            continue
        if isinstance(own, bool | str | bytes):
            continue
        if isinstance(own, int | float | np.integer | np.floating):
            found.append((path, field_getter(path)))
        elif isinstance(own, np.ndarray) and own.dtype.kind in "iuf" and own.size <= _MOST_ELEMENTS:
            labels = [str(label) for label in names] if isinstance(names, list) and len(names) == own.size else None
            for number in range(own.size):
                label = labels[number] if labels else str(number + 1)
                found.append((f"{path}.{label}", field_getter(path, number)))
        elif isinstance(own, list) and own and is_dataclass(own[0]) and len(own) <= _MOST_ELEMENTS:
            for number, member in enumerate(own):
                for inner, get in _numbers(member, ""):
                    found.append((f"{path}.{number + 1}.{inner}", _within(path, number, get)))
        elif is_dataclass(own):
            found += _numbers(own, f"{path}.")
    return found


def _within(path: str, number: int, inner: Callable[[Any], Any]) -> Callable[[Any], Any]:
    outer = field_getter(path)
    return lambda message: inner(outer(message)[number])


def _meaning(kind: str, field: str) -> tuple[Quantity, str]:
    """Quantity and unit of a field by its type; unknown and empty where the type does not tell."""
    package, _, name = kind.partition("/")
    if package not in _KNOWN_PACKAGES or name.endswith("JointState"):
        return Quantity.UNKNOWN, ""
    rules = _BARE.get(name.rpartition("/")[2], ()) + _FIELDS
    for part, quantity, unit in rules:
        if f".{field}".find(f".{part}") >= 0:
            return quantity, unit
    return Quantity.UNKNOWN, ""


# --- the grid --------------------------------------------------------------------------------------------------------


def _table_of(path: Path, recordings: Sequence[_Recording]) -> SourceTable:
    """One table on the grid of the first recording."""
    head = recordings[0]
    origin = int(head.time[0])
    time: FloatArray = np.asarray((head.time - origin) * 1e-9, dtype=np.float64)
    grid = even_grid(time, list(head.columns.values()), f"{head.topic} of {path.name}", head.clock)
    notes = [*head.notes, *grid.notes]
    notes.append(
        f"Times of {path.name} count from its first message of {head.topic}, {origin * 1e-9:.6f} s since 1970."
    )
    names = [f"{head.topic}.{field}" for field in head.columns]
    units, quantities = list(head.units.values()), list(head.quantities.values())
    columns = list(grid.columns)
    places: FloatArray = np.asarray(grid.start + grid.step * np.arange(columns[0].size), dtype=np.float64)
    for other in recordings[1:]:
        own: FloatArray = np.asarray((other.time - origin) * 1e-9, dtype=np.float64)
        notes += other.notes
        notes.append(
            f"{other.topic} was interpolated at the times of {head.topic}: its own {other.clock} go in steps of "
            f"{float(np.median(np.diff(own))):.6g} s. Above a fifth of its rate this changes amplitude and phase."
        )
        for field, values in other.columns.items():
            names.append(f"{other.topic}.{field}")
            units.append(other.units[field])
            quantities.append(other.quantities[field])
            columns.append(interpolated(own, values, places))
    return SourceTable(
        path.name, tuple(names), tuple(columns), tuple(units), tuple(quantities), notes=notes, start=grid.start,
        step=grid.step, step_std=grid.std,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class EvenGrid:
    """Samples at equal steps.

    Attributes:
        start: time of the first, s.
        step: s.
        std: relative standard uncertainty of the step.
        columns: NaN where samples are missing.
        notes: what was done.
    """

    start: float
    step: float
    std: float
    columns: tuple[FloatArray, ...]
    notes: list[str]


def even_grid(time: FloatArray, columns: Sequence[FloatArray], name: str, clock: str) -> EvenGrid:
    """Put samples with stamps on an even grid.

    Stamps scatter because samples were taken at uneven times, or because they were stamped late. Which it is, the
    signals tell: read the right way they are smoother.

    Args:
        time: stamp of each sample, s, ascending.
        columns: each of that length.
        name, clock: for the notes.

    Raises:
        BenchError: more than a third of the samples is missing.
    """
    steps = np.diff(time)
    typical = float(np.median(steps))
    count = time.size
    plain = np.arange(count)
    index, (start, step, scatter) = plain, _line(plain, time)
    if typical > 0.0:
        counted = np.concatenate(([0], np.cumsum(np.maximum(1.0, np.round(steps / typical)))))
        fitted = _line(counted, time)
        if fitted[2] < 0.5 * scatter:
            index, (start, step, scatter) = counted.astype(np.int64), fitted
    if not step > 0.0:
        raise BenchError(f"The {clock} of {name} stand still; a recording needs a clock.")
    length = int(index[-1]) + 1
    if length > 1.5 * count:
        raise BenchError(f"Of {name} {length - count} of {length} samples are missing by its {clock}; record it again.")
    notes = []
    # The slope of a line through stamps with that scatter.
    std = math.sqrt(12.0 / count) * scatter / (step * length)
    columns = [_placed(values, index, length) for values in columns] if length > count else list(columns)
    if length > count:
        holes = int((np.diff(index) > 1).sum())
        notes.append(
            f"{length - count} samples of {name} are missing at {holes} places by its {clock} (first after "
            f"{float(time[int(np.argmax(np.diff(index) > 1))]) - float(time[0]):.6g} s); they are marked as missing."
        )
    if scatter > _EVEN * step:
        ahead = (
            f"The {clock} of {name} scatter by {1e3 * scatter:.3g} ms about an even clock ({100 * scatter / step:.2g} "
        )
        ahead += "% of a step)"
        places: FloatArray = np.asarray(start + step * np.arange(length), dtype=np.float64)
        again = [interpolated(time, own[index] if length > count else own, places) for own in columns]
        ratios = [_roughness(new) / _roughness(old) for new, old in zip(again, columns, strict=True) if _roughness(old)]
        if ratios and float(np.median(ratios)) < _SMOOTHER:
            columns = [np.where(np.isnan(old), np.nan, new) for new, old in zip(again, columns, strict=True)]
            notes.append(f"{ahead}; the signals are smoother by their stamps and were interpolated at even times.")
        else:
            notes.append(f"{ahead}; the signals are smoother at even times, so the stamps give the rate only.")
        notes.append(f"The rate of {name} is known to {100 * std:.2g} %.")
    return EvenGrid(float(start), float(step), std, tuple(columns), notes)


def _line(index: IntArray | FloatArray, time: FloatArray) -> tuple[float, float, float]:
    """Start, step and rms scatter of times about a straight line over their numbers."""
    centred = index - index.mean()
    step = float((centred * (time - time.mean())).sum() / (centred * centred).sum())
    start = float(time.mean() - step * index.mean())
    return start, step, float(np.sqrt(np.mean((time - start - step * index) ** 2)))


def _placed(values: FloatArray, index: IntArray, length: int) -> FloatArray:
    result = np.full(length, np.nan)
    result[index] = values
    return result


def _roughness(values: FloatArray) -> float:
    """rms of the fourth differences."""
    differences = np.diff(values, 4)
    known = differences[np.isfinite(differences)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0
