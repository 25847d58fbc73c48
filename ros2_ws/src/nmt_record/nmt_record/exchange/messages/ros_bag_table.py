"""Numbers of any ROS 2 bag as columns of a table: topics and fields, their stamps as clock.

A column is called by topic and field, ``/imu/data.linear_acceleration.z``. What a message names is called so
(``/joint_states.position.elbow``), in whichever place it stands; other elements of arrays count from 1. What comes in
messages of its own has a clock of its own. Message types that this machine does not know are read by their definition
in the bag; those without one are left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.bench_topics import SAMPLE_BLOCK, bench_name
from nmt_record.exchange.clocks.even_grid import FEWEST, EvenGrid, even_grid, sampled_at
from nmt_record.exchange.clocks.message_clock import ClockChoice, JudgedClock, judged_clock
from nmt_record.exchange.messages.message_columns import TopicReader, structure_of
from nmt_record.exchange.messages.message_series import Series, series_of
from nmt_record.exchange.source_table import ClockQuestionError, SourceTable

_MAGICS = (b"\x89MCAP0\r\n", b"SQLite format 3\0")
_APART = 0.5  # s between the bases of two clocks: more than any sensor is late
_EARLY = 0.01  # s by which a message may be logged before its stamp
_LISTED = 12  # names in a sentence

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
    """A table for each recording with numbers, those of most messages first.

    Args:
        path: folder, .mcap or .db3 file.

    Raises:
        BenchError: it is not a bag or one of the bench's, it cannot be read, or no topic has numbers.
    """
    bag = _foreign(path)
    notes: list[str] = list(bag.left_out.values())
    tables: list[SourceTable] = []
    for one, left_out in _every_series(bag, ClockChoice(), notes):
        one.notes += left_out
        try:
            tables.append(_table_of(path, [one], ClockChoice(), bag))
        except BenchError as error:
            notes.append(str(error))
    if not tables:
        listed = ", ".join(f"/{topic} ({kind}, {count})" for topic, (kind, count) in sorted(bag.topics.items()))
        why = f" {' '.join(notes)}" if notes else ""
        raise BenchError(
            f"No topic of the bag {path.name} has numbers in at least {FEWEST} messages; it has {listed or 'none'}."
            f"{why}"
        )
    tables.sort(key=lambda table: -table.rows)
    for table in tables:
        table.notes += notes
    return tables


def recordings_of(path: Path, choice: ClockChoice) -> tuple[list[tuple[Series, JudgedClock]], list[str]]:
    """Each recording of a bag with the times of its messages as they were stamped, and notes.

    Args:
        path: folder, .mcap or .db3 file.
        choice: what its reader says of the clock.

    Raises:
        BenchError: it is not a bag or one of the bench's, or it cannot be read.
    """
    bag = _foreign(path)
    notes: list[str] = list(bag.left_out.values())
    return [(one, _judge(one, choice)) for one, _ in _every_series(bag, choice, notes)], notes


def _every_series(bag: Bag, choice: ClockChoice, notes: list[str]) -> Iterator[tuple[Series, list[str]]]:
    """The series of all topics, and for each what was left out of its topic; of a topic without any that is noted."""
    topics = [topic for topic, (_, count) in bag.topics.items() if count >= FEWEST]
    for topic, reader in _read(bag, topics, notes, choice.elements).items():
        series, left_out = series_of(f"/{bench_name(topic)}", reader, choice)
        for one in series:
            yield one, left_out
        notes += [] if series else left_out


def read_bag(path: Path, wanted: Sequence[str | int], choice: ClockChoice | None = None) -> SourceTable:
    """The columns that a sidecar names, of one recording or of several on the clock of the one with most messages.

    Args:
        path: folder, .mcap or .db3 file.
        wanted: names of columns.
        choice: what the sidecar says of the clock; None = nothing.

    Raises:
        BenchError: as :func:`bag_tables`, no such topic or column exists, or the clock must be asked for.
    """
    bag = _foreign(path)
    choice = choice or ClockChoice()
    topics: list[str] = []
    for column in wanted:
        if isinstance(column, int):
            raise BenchError(f"{path.name} is a bag: name its columns by topic and field, not by number.")
        found = [topic for topic in bag.topics if column.lstrip("/").startswith(f"{topic}.")]
        unread = [why for topic, why in bag.left_out.items() if column.lstrip("/").startswith(f"{topic}.")]
        if unread and not found:
            raise BenchError(unread[0])
        if not found:
            there = ", ".join(f"/{topic}" for topic in sorted(bag.topics))
            raise BenchError(f"{path.name} has no topic for column {column}; it has {there}.")
        topics.append(max(found, key=len))
    notes: list[str] = []
    readers = _read(bag, list(dict.fromkeys(topics)), notes, choice.elements)
    series: dict[str, list[Series]] = {}
    for topic in dict.fromkeys(topics):
        if topic not in readers:
            why = " ".join(notes) or f"Topic /{topic} of {path.name} has no numbers in at least {FEWEST} messages."
            raise BenchError(why)
        series[topic], left_out = series_of(f"/{bench_name(topic)}", readers[topic], choice)
        notes += left_out
    chosen: list[Series] = []
    for column, topic in zip(wanted, topics, strict=True):
        name = f"/{str(column).lstrip('/')}"
        one = next((one for one in series[topic] if name in one.columns), None)
        if one is None:
            names = [name for one in series[topic] for name in one.columns]
            listed = ", ".join(names[:_LISTED]) + (", …" if len(names) > _LISTED else "")
            why = f" {' '.join(notes)}" if notes else ""
            raise BenchError(f"{path.name} has no column {column}; topic /{topic} has {listed or 'no numbers'}.{why}")
        if one not in chosen:
            chosen.append(one)
    table = _table_of(path, sorted(chosen, key=lambda one: -one.samples), choice, bag)
    if table.question is not None:
        raise ClockQuestionError(*table.question)
    return table


def _foreign(path: Path) -> Bag:
    bag = Bag.open(path)
    if not is_foreign(bag):
        raise BenchError(
            f"{path.name} is a bag of the bench; it needs no import, give it to './nmt extract', "
            "or, without a run in it, to './nmt diagnose --model RIG --real'."
        )
    return bag


def _read(bag: Bag, topics: Sequence[str], notes: list[str], elements: str) -> dict[str, TopicReader]:
    """Messages of topics whose types can be read; the others are named in the notes."""
    readers: dict[str, TopicReader] = {}
    for topic in topics:
        kind, count = bag.topics[topic]
        if count < FEWEST:
            continue
        try:
            reader = TopicReader(structure_of(bag.field_definitions(topic), kind), elements)
        except BenchError as error:
            notes.append(f"Topic /{topic} ({kind}, {count} messages) was left out: {error}")
            continue
        if reader.has_numbers:
            readers[topic] = reader
    unreadable: dict[str, str] = {}
    odd: dict[str, int] = {}
    for topic, received, _, raw in bag.raw_messages(list(readers)) if readers else ():
        try:
            message = bag.deserialise(topic, raw)
        except BenchError as error:
            unreadable.setdefault(topic, str(error))
            odd[topic] = odd.get(topic, 0) + 1
            continue
        readers[topic].add(message, received)
    for topic, reader in readers.items():
        # Pictures and clouds of points have bytes, too.
        notes += [
            f"Array {path} of /{topic} holds {count} bytes and was left out; if they are numbers, one after the other, "
            f"name column /{topic}.{path} with 'elements: bytes int16' (or int32, float32 …; with 'big' behind it "
            "where the high byte comes first)."
            for path, count in reader.bytes.items()
            if path == "data" and "Multi" in bag.topics[topic][0]
        ]
    for topic in [topic for topic, reader in readers.items() if reader.is_anonymous]:
        del readers[topic]
        notes.append(f"Topic /{topic} was left out: names or lengths of arrays are other ones in each of its messages.")
    for topic, why in unreadable.items():
        if readers[topic].count < FEWEST:
            del readers[topic]
            notes.append(f"Topic /{topic} was left out: {why}")
        else:
            notes.append(f"{odd[topic]} messages of /{topic} cannot be read and were left out.")
    return readers


# --- one table -------------------------------------------------------------------------------------------------------


def _judge(one: Series, choice: ClockChoice) -> JudgedClock:
    head = f"{one.topic}."
    chosen = choice.field.removeprefix(head) if choice.field.startswith(head) else ""
    clock = ClockChoice(choice.clock, chosen, choice.unit, choice.sample_rate, choice.stretch, choice.elements)
    columns = {name.removeprefix(head): values for name, values in one.columns.items() if values.ndim == 1}
    return judged_clock(one.name, one.logged, one.stamps, columns, clock)


def _gridded(one: Series, clock: JudgedClock, origin: int, choice: ClockChoice, file: str) -> EvenGrid:
    """A series on its own even grid; of blocks, all their samples."""
    time: FloatArray = np.asarray((clock.time - origin) * 1e-9, dtype=np.float64)
    name = f"{one.name} of {file}"
    if choice.clock == "sample_rate" and choice.sample_rate is not None:
        time = np.asarray(np.arange(time.size) * (one.block / choice.sample_rate), dtype=np.float64)
    columns = [values[clock.rows] for values in one.columns.values()] if one.block == 1 else []
    grid = even_grid(time, columns, name, clock.words, clock.breaks, choice.stretch, one.block == 1)
    if one.block == 1:
        return grid
    within = np.arange(one.block)
    rows = (grid.rows[:, None] * one.block + within).ravel()
    length = grid.stretches[-1][1] * one.block
    step = grid.step / one.block
    unfolded = []
    for values in one.columns.values():
        column = np.full(length, np.nan)
        column[rows] = values[clock.rows][grid.sources].ravel()
        unfolded.append(column)
    every: FloatArray = np.asarray(grid.start + step * rows, dtype=np.float64)
    stretches = tuple((first * one.block, stop * one.block) for first, stop in grid.stretches)
    return EvenGrid(
        grid.start, step, grid.std, tuple(unfolded), grid.notes, stretches, every, rows,
        np.arange(rows.size),
    )  # fmt: skip


def _table_of(path: Path, series: Sequence[Series], choice: ClockChoice, bag: Bag) -> SourceTable:
    """One table on the grid of the first series."""
    clocks = [_judge(one, choice) for one in series]
    head = series[0]
    origin = int(clocks[0].time[0])
    grid = _gridded(head, clocks[0], origin, choice, path.name)
    question = next((clock.question for clock in clocks if clock.question is not None), None)
    notes = [*head.notes, *clocks[0].notes, *grid.notes]
    for one in series:
        if one.alternates():
            notes.append(
                f"The values of {one.name} alternate from message to message, as if two publishers without names sent "
                "on one topic; if they do, nothing that follows from them is right: record them apart."
            )
    began = origin * 1e-9 + grid.start
    notes.append(
        f"Times of {path.name} count from {began:.6f} s, the first sample of {head.name} by its {clocks[0].words}."
    )
    columns = dict(zip(head.columns, grid.columns, strict=True))
    fields = dict(head.fields)
    kinds = {name: bag.topics[bench_name(one.topic)][0] for one in series for name in one.columns}
    places: FloatArray = np.asarray(grid.start + grid.step * np.arange(grid.columns[0].size), dtype=np.float64)
    for other, clock in zip(series[1:], clocks[1:], strict=True):
        question = question or _bases_apart(head, clocks[0], other, clock)
        theirs = _gridded(other, clock, origin, ClockChoice(choice.clock, sample_rate=choice.sample_rate), path.name)
        notes += [*other.notes, *clock.notes, *theirs.notes]
        notes.append(
            f"{other.name} was interpolated at the times of {head.name}: its own {clock.words} go in steps of "
            f"{theirs.step:.6g} s. Above a fifth of its rate this changes amplitude and phase."
        )
        for name, values in zip(other.columns, theirs.columns, strict=True):
            columns[name] = sampled_at(theirs, values, places)
        fields.update(other.fields)
    used = {f"{one.topic}.{clock.used_field}" for one, clock in zip(series, clocks, strict=True)}
    names = [name for name, values in columns.items() if name not in used and np.isfinite(values).any()]
    if not names:
        raise BenchError(f"{head.name} of {path.name} has no values but its clock.")
    meant = {name: _meaning(kinds[name], fields[name]) for name in names}
    return SourceTable(
        path.name, tuple(names), tuple(columns[name] for name in names), tuple(meant[name][1] for name in names),
        tuple(meant[name][0] for name in names), notes=notes, start=0.0, step=grid.step,
        step_std=max(grid.std, *(clock.std for clock in clocks), 0.0), judged=clocks[0].words, question=question,
        fields=tuple(fields[name] for name in names), stretches=grid.stretches,
    )  # fmt: skip


def _bases_apart(head: Series, clock: JudgedClock, other: Series, others: JudgedClock) -> tuple[str, str] | None:
    """A question where the clocks of two topics do not count from the same time."""
    apart = clock.lead - others.lead
    early = min(one.lead + 5.0 * one.lead_scatter for one in (clock, others))
    if not abs(apart) > _APART and not early < -_EARLY:
        return None
    if abs(apart) <= max(5.0 * (clock.lead_scatter + others.lead_scatter), 1e-3):
        return None
    sentence = (
        f"The {clock.words} of {head.name} and the {others.words} of {other.name} count from different times "
        f"({abs(apart):.6g} s apart by their log times); say 'clock: log', or import them one by one."
    )
    return sentence, "clock"


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
