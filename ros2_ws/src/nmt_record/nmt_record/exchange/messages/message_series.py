"""What came in one topic, sorted into series: columns that share their messages and with them a clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_record.exchange.clocks.even_grid import FEWEST
from nmt_record.exchange.clocks.message_clock import ClockChoice
from nmt_record.exchange.messages.message_columns import (
    MOST_ELEMENTS,
    Column,
    Layout,
    TopicReader,
    columns_by_name,
    is_time_label,
)

_CONSECUTIVE = 0.8  # share of the messages of a series that follow each other
_ALTERNATING = 0.2  # change over two messages, in that over one
_FEWEST_SAMPLES = 8  # elements of an array that may be samples
_SMOOTH_SEAM = 2.0  # last to first element of the next message, in steps within one
_FAR_ACROSS = 1.0  # the same element from message to message, in steps within one
_MOST_IN_TURN = 16  # channels
_ALIKE = 0.5  # change over all channels, in that from one to the next
_SMOOTH = 0.5  # step within a message over the spread of all values


@dataclass(eq=False)
class Series:
    """Columns of one topic with a clock of their own.

    Attributes:
        topic: with its slash.
        name: topic, and what is in it where the topic has several series.
        logged: time of reception of each message, ns.
        stamps: of each message, ns; None where they have none.
        columns: by full name, shape (n,); of blocks (n, samples).
        fields: bare fields of the columns, for what they mean.
        block: samples in each message.
        notes: what was found.
    """

    topic: str
    name: str
    numbers: IntArray
    logged: IntArray
    stamps: IntArray | None
    columns: dict[str, FloatArray]
    fields: dict[str, str]
    block: int = 1
    notes: list[str] = field(default_factory=list)

    def alternates(self) -> bool:
        """Whether every other message is like the one before the last, and unlike the last."""
        if self.block > 1:
            return False
        verdicts = []
        for values in self.columns.values():
            next_one, after_next = np.abs(np.diff(values)), np.abs(values[2:] - values[:-2])
            if np.isfinite(next_one).sum() >= FEWEST and np.nanmedian(next_one) > 0.0:
                verdicts.append(float(np.nanmedian(after_next)) < _ALTERNATING * float(np.nanmedian(next_one)))
        return bool(verdicts) and all(verdicts)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.logged.size * self.block


def series_of(topic: str, reader: TopicReader, choice: ClockChoice) -> tuple[list[Series], list[str]]:
    """All series of a topic with enough messages, those of most samples first, and notes on what was left out.

    Args:
        topic: with its slash.
        reader: that has taken its messages.
        choice: says what elements of arrays without names are.
    """
    layouts = reader.layouts
    tables = [np.frombuffer(layout.values).reshape(len(layout.numbers), -1) for layout in layouts]
    names = {layout.label for layout in layouts}
    # What is different in each message is not a name.
    labelled = len(names) > 1 and reader.count >= FEWEST * len(names)
    notes: list[str] = []
    places: dict[str, dict[int, int]] = {}
    example: dict[str, Column] = {}
    arrays: dict[str, dict[int, list[int]]] = {}
    for name, column, number, position in columns_by_name(layouts, labelled):
        places.setdefault(name, {}).setdefault(number, position)
        example.setdefault(name, column)
        if column.array:
            head = name[: len(name) - len(column.name)]
            arrays.setdefault(head + column.array, {}).setdefault(number, []).append(position)
    groups: list[Series] = []
    taken: set[str] = set()
    for path, positions in arrays.items():
        blocks, left_out = _blocks(topic, path, positions, layouts, tables, choice, notes)
        if blocks is not None or left_out:
            size = max(map(len, positions.values()))
            taken |= {f"{path}.{number + 1}" for number in range(size)}
        if blocks is not None:
            groups.append(blocks)
    by_key: dict[tuple[frozenset[int], str], list[str]] = {}
    for name, positions_of in places.items():
        if name not in taken:
            by_key.setdefault((frozenset(positions_of), example[name].stamp), []).append(name)
    for (numbers, _), columns in by_key.items():
        groups.append(_gathered(topic, columns, sorted(numbers), places, example, layouts, tables))
    groups = [_once(one) for one in groups]
    joined = _joined(sorted(groups, key=lambda one: -one.logged.size))
    kept = [one for one in joined if one.logged.size >= FEWEST]
    brief = [name.removeprefix(f"{topic}.") for one in joined if one.logged.size < FEWEST for name in one.columns]
    if brief and kept:
        listed = ", ".join(brief[:6]) + (", …" if len(brief) > 6 else "")
        notes.append(f"{listed} of {topic} came in fewer than {FEWEST} messages and were left out.")
    if len(kept) > 1:
        for one in kept:
            first = next(iter(one.columns)).removeprefix(f"{topic}.")
            one.name = f"{topic} ({first}{', …' if len(one.columns) > 1 else ''})"
    return sorted(kept, key=lambda one: -one.samples), notes


def _stamps_of(layout: Layout, name: str) -> IntArray | None:
    if not name or name not in layout.stamps:
        return None
    table = np.frombuffer(layout.times, dtype=np.int64).reshape(-1, len(layout.stamps))
    return np.asarray(table[:, layout.stamps.index(name)])


def _gathered(
    topic: str,
    names: Sequence[str],
    numbers: Sequence[int],
    places: dict[str, dict[int, int]],
    example: dict[str, Column],
    layouts: Sequence[Layout],
    tables: Sequence[FloatArray],
) -> Series:
    """Columns that are in the same layouts, as one series in the order of the messages."""
    messages = np.concatenate([np.frombuffer(layouts[number].numbers, dtype=np.int64) for number in numbers])
    order = np.argsort(messages, kind="stable")
    logged = np.concatenate([np.frombuffer(layouts[number].logged, dtype=np.int64) for number in numbers])[order]
    stamps = [_stamps_of(layouts[number], example[names[0]].stamp) for number in numbers]
    there = [one for one in stamps if one is not None]
    columns = {
        f"{topic}.{name}": np.concatenate([tables[number][:, places[name][number]] for number in numbers])[order]
        for name in names
    }
    return Series(
        topic, topic, messages[order], logged, np.concatenate(there)[order] if len(there) == len(stamps) else None,
        columns, {f"{topic}.{name}": example[name].field for name in names},
    )  # fmt: skip


def _once(one: Series) -> Series:
    """A series without the messages that came twice: with the same stamp and the same values."""
    if one.stamps is None or one.stamps.size < 2:
        return one
    order = np.lexsort((one.numbers, one.stamps))
    same = np.zeros(order.size, dtype=bool)
    same[1:] = (np.diff(one.stamps[order]) == 0) & (one.stamps[order][1:] > 0)
    for values in one.columns.values():
        if not same.any():
            return one
        ordered = values[order]
        equal = (ordered[1:] == ordered[:-1]) | (np.isnan(ordered[1:]) & np.isnan(ordered[:-1]))
        same[1:] &= equal if equal.ndim == 1 else equal.all(axis=1)
    kept = np.sort(order[~same])
    return Series(
        one.topic, one.name, one.numbers[kept], one.logged[kept], one.stamps[kept],
        {name: values[kept] for name, values in one.columns.items()}, one.fields, one.block,
        [*one.notes, f"{int(same.sum())} messages of {one.topic} came twice; they count once."],
    )  # fmt: skip


def _joined(groups: Sequence[Series]) -> list[Series]:
    """Series of one publisher, whose messages hold now this and now that, as one; those of several stay apart."""
    result: list[Series] = []
    for group in groups:
        for position, other in enumerate(result):
            if group.block == other.block and (union := _union(other, group)) is not None:
                result[position] = union
                break
        else:
            result.append(group)
    return result


def _union(first: Series, second: Series) -> Series | None:
    """Both as one series with holes; None where they are two."""
    if np.array_equal(first.numbers, second.numbers):
        same = first.stamps is second.stamps or (
            first.stamps is not None and second.stamps is not None and np.array_equal(first.stamps, second.stamps)
        )
        if not same:
            return None
        return Series(
            first.topic, first.name, first.numbers, first.logged, first.stamps, {**first.columns, **second.columns},
            {**first.fields, **second.fields}, first.block, [*first.notes, *second.notes],
        )  # fmt: skip
    if (first.stamps is None) != (second.stamps is None):
        return None
    numbers = np.union1d(first.numbers, second.numbers)
    at = [np.searchsorted(numbers, one.numbers) for one in (first, second)]
    if any(one.size < 2 or float((np.diff(one) == 1).mean()) < _CONSECUTIVE for one in at):
        return None
    stamps: IntArray | None = None
    if first.stamps is not None and second.stamps is not None:
        stamps = np.zeros(numbers.size, dtype=np.int64)
        stamps[at[0]] = first.stamps
        both = np.isin(second.numbers, first.numbers)
        if (stamps[at[1]][both] != second.stamps[both]).any():
            return None
        stamps[at[1]] = second.stamps
    logged = np.zeros(numbers.size, dtype=np.int64)
    logged[at[0]], logged[at[1]] = first.logged, second.logged
    columns: dict[str, FloatArray] = {}
    for one, where in zip((first, second), at, strict=True):
        for name, values in one.columns.items():
            columns[name] = np.full((numbers.size, *values.shape[1:]), np.nan)
            columns[name][where] = values
    return Series(
        first.topic, first.name, numbers, logged, stamps, columns, {**first.fields, **second.fields}, first.block,
        [*first.notes, *second.notes],
    )  # fmt: skip


# --- arrays that hold samples one after the other ---------------------------------------------------------------------


def _blocks(
    topic: str,
    path: str,
    positions: dict[int, list[int]],
    layouts: Sequence[Layout],
    tables: Sequence[FloatArray],
    choice: ClockChoice,
    notes: list[str],
) -> tuple[Series | None, bool]:
    """An array without names as samples of one or several channels; or whether it is to be left out."""
    sizes = {len(one) for one in positions.values()}
    number = max(positions, key=lambda one: len(layouts[one].numbers))
    size = len(positions[number])
    bare = layouts[number].columns[positions[number][0]].array
    dimensions = layouts[number].shapes.get(bare, ())
    channels, across = _shape(dimensions, size)
    label = dimensions[0][0] if len(dimensions) == 1 else ""
    values = tables[number][:, positions[number][0] : positions[number][0] + size]
    words_of_choice = choice.elements.split()
    if words_of_choice[:1] == ["interleaved"] and not channels and size % int(words_of_choice[1]) == 0:
        channels, across = int(words_of_choice[1]), False
    meant = choice.elements == "samples" or words_of_choice[:1] == ["bytes"]
    samples = channels > 0 or is_time_label(label) or (meant and size > 1)
    words = f"Array {path} of {topic} ({size} elements)"
    if not samples and choice.elements != "channels" and size >= _FEWEST_SAMPLES and _goes_on(values):
        samples = True
        notes.append(
            f"{words} goes on from message to message: its elements are samples, one after the other ('elements: "
            "channels' if they are not)."
        )
    if not samples:
        if size <= MOST_ELEMENTS and (len(sizes) <= 2 or choice.elements == "channels"):
            return None, False
        what = "changes its length from message to message" if len(sizes) > 2 else "says not what its elements are"
        notes.append(
            f"{words} {what} and was left out; if they are samples, one after the other, say 'elements: samples', of "
            f"channels in turn 'elements: interleaved {_in_turn(values) or 2}'."
        )
        return None, True
    if meant and (turn := _in_turn(values)):
        notes.append(
            f"{words} repeats itself after {turn} elements more closely than after one: channels in turn? Then say "
            f"'elements: interleaved {turn}'."
        )
    if len(sizes) > 1:
        notes.append(f"The blocks of {topic} have unequal lengths ({min(sizes)}, {max(sizes)}); record equal ones.")
        return None, True
    every = sorted(positions)
    messages = np.concatenate([np.frombuffer(layouts[one].numbers, dtype=np.int64) for one in every])
    order = np.argsort(messages, kind="stable")
    table = np.concatenate([tables[one][:, positions[one][0] : positions[one][0] + size] for one in every])[order]
    logged = np.concatenate([np.frombuffer(layouts[one].logged, dtype=np.int64) for one in every])[order]
    stamp = layouts[number].columns[positions[number][0]].stamp
    stamps = [_stamps_of(layouts[one], stamp) for one in every]
    there = [one for one in stamps if one is not None]
    cube = table.reshape(-1, channels, size // channels) if across else table.reshape(
        -1, size // max(channels, 1), max(channels, 1)).transpose(0, 2, 1)  # fmt: skip
    columns = {
        f"{topic}.{path}.{channel + 1}" if channels else f"{topic}.{path}": cube[:, channel]
        for channel in range(cube.shape[1])
    }
    field_name = layouts[number].columns[positions[number][0]].field
    return Series(
        topic, topic, messages[order], logged, np.concatenate(there)[order] if len(there) == len(stamps) else None,
        columns, dict.fromkeys(columns, field_name), cube.shape[2],
    ), True  # fmt: skip


def _shape(dimensions: tuple[tuple[str, int], ...], size: int) -> tuple[int, bool]:
    """Channels of an array of two dimensions, and whether they are the first; 0 where it has others."""
    if len(dimensions) != 2 or dimensions[0][1] * dimensions[1][1] != size or min(d[1] for d in dimensions) < 1:
        return 0, False
    first = "channel" in dimensions[0][0].lower() or (
        is_time_label(dimensions[1][0]) and not is_time_label(dimensions[0][0])
    )
    return dimensions[0 if first else 1][1], first


def _in_turn(values: FloatArray) -> int:
    """Channels whose samples come in turn, by the smallest distance at which elements are alike; 0 where they do not.

    Args:
        values: shape (messages, elements).
    """
    if values.shape[1] < 2 * _MOST_IN_TURN or not np.isfinite(values).all():
        return 0
    steps = [float(np.median(np.abs(values[:, k:] - values[:, :-k]))) for k in range(1, _MOST_IN_TURN + 1)]
    best = min(range(1, _MOST_IN_TURN), key=lambda k: steps[k])
    return best + 1 if steps[best] < _ALIKE * steps[0] else 0


def _goes_on(values: FloatArray) -> bool:
    """Whether the elements of arrays are samples: smooth within a message and into the next, but not across."""
    if values.shape[0] < 4 or not np.isfinite(values).all():
        return False
    within = float(np.median(np.abs(np.diff(values, axis=1))))
    seam = float(np.median(np.abs(values[1:, 0] - values[:-1, -1])))
    across = float(np.median(np.abs(np.diff(values, axis=0))))
    spread = float(np.std(values))
    smooth = 0.0 < within < _SMOOTH * spread and seam < _SMOOTH_SEAM * within
    return smooth and across > _FAR_ACROSS * within
