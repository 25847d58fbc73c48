"""Does imported data measure what its sidecar says? Names, units, counts, doubles, gaps, and the sign of the power."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, QUANTITIES, TestKind
from nmt_record.exchange.sidecar.import_sidecar import STEADY_KINDS, ChannelSection, SignalSection
from nmt_record.exchange.source_table import SourceTable, split_name
from nmt_record.exchange.unit_table import coordinate_of_unit, plain_unit, quantity_of_unit
from nmt_signals.spectral_lines import line_amplitude, piece_spectra

_WORDS = (
    (Quantity.FORCE, r"force|kraft|load|loadcell"),
    (Quantity.ACCELERATION, r"acc|accel|acceleration|beschl\w*|accelerometer"),
    (Quantity.VELOCITY, r"vel|velocity|geschw\w*|vibrometer"),
    (Quantity.DISPLACEMENT, r"disp|displ|displacement|weg"),
    (Quantity.VOLTAGE, r"volt|voltage|spannung"),
    (Quantity.CURRENT, r"current|strom"),
)
# Peaks outside are possible, but a unit wrong by 1000 is likelier.
_USUAL = {
    Quantity.FORCE: (1e-4, 1e5),
    Quantity.ACCELERATION: (1e-3, 1e5),
    Quantity.VELOCITY: (1e-6, 1e2),
    Quantity.DISPLACEMENT: (1e-10, 0.3),
    Quantity.VOLTAGE: (1e-5, 1e3),
    Quantity.CURRENT: (1e-6, 1e3),
}
# Power factor below which the exciter would brake the structure throughout: an exchange or a sign, no phase error.
_STEADY_POWER = -0.5
# Over many lines most of the power is reactive; what is active must then be negative nearly everywhere.
_BROAD_POWER = -0.01
_BROAD_SIGN = -0.9
_LONGEST_GAP = 0.5


@dataclass(frozen=True, eq=False)
class ImportedChannel:
    """One channel in SI units on the common grid.

    Attributes:
        section: what the sidecar says.
        name: channel name in the bag.
        source: name or number of its column, for messages.
        data: SI units, NaN where samples are missing, shape ``(samples,)``.
    """

    section: ChannelSection
    name: str
    source: str
    data: FloatArray

    @property
    def quantity(self) -> Quantity:
        """What it measures."""
        return self.section.measures

    @property
    def point(self) -> int:
        """Measurement point; 0 = none."""
        return self.section.point


def check_names(channels: Sequence[ChannelSection], table: SourceTable, places: Sequence[str]) -> None:
    """Names, units and types in the file against the sidecar.

    Raises:
        BenchError: a column is named or typed as another quantity or unit than the sidecar says.
    """
    for channel, place in zip(channels, places, strict=True):
        index = table.index(channel.column, place)
        name, unit, own = table.names[index], table.units[index], table.quantities[index]
        shown = f"column {name or index + 1} of {table.file}"
        if unit and "scale" not in channel.model_fields_set:
            named = quantity_of_unit(unit)
            if named is not Quantity.UNKNOWN and plain_unit(unit) != plain_unit(channel.unit):
                raise BenchError(
                    f"{place}: {shown} has the unit {unit} by the file, but {channel.unit} by the sidecar; correct "
                    f"one of them."
                )
        if own is not Quantity.UNKNOWN and own is not channel.recorded:
            raise BenchError(
                f"{place}: {shown} holds {own.name.lower()} by its dataset, but {channel.quantity} by the sidecar; are "
                "columns swapped?"
            )
        if isinstance(channel.column, int) or quantity_of_unit(unit) is channel.recorded:
            continue  # a unit says more than a name
        hinted = hinted_quantity(split_name(name)[0], channel.point)
        if hinted not in (Quantity.UNKNOWN, channel.recorded):
            raise BenchError(
                f"{place}: {shown} is called like {_article(hinted)}, but the sidecar says {channel.quantity}; are "
                "columns swapped? (if the name misleads, give the column by its number)"
            )


def _article(quantity: Quantity) -> str:
    name = quantity.name.lower()
    return f"an {name}" if name[0] in "aeiou" else f"a {name}"


def hinted_quantity(name: str, point: int) -> Quantity:
    """Quantity that a name tells of; UNKNOWN unless it does so clearly."""
    plain = name.strip().lower()
    for quantity, words in _WORDS:
        if re.match(rf"(?:{words})(?![a-z])", plain):
            return quantity
    match = re.fullmatch(r"([fax])_?(\d+)", plain)
    if match and point and int(match.group(2)) == point:
        return QUANTITIES[match.group(1)]
    return Quantity.UNKNOWN


def check_columns(channels: Sequence[ImportedChannel], table: SourceTable, places: Sequence[str]) -> list[str]:
    """Values of each channel by themselves and against each other.

    Returns:
        Sentences on what is missing or unusual.

    Raises:
        BenchError: counts without a scale, two columns with the same numbers, or hardly any values.
    """
    notes: list[str] = []
    for channel, place in zip(channels, places, strict=True):
        index = table.index(channel.section.column, place)
        raw = table.recorded(table.columns[index])
        finite = raw[np.isfinite(raw)]
        # What a bag names has holes where it did not come.
        if finite.size < (1.0 - _LONGEST_GAP) * raw.size and not table.judged:
            raise BenchError(
                f"{place}: {raw.size - finite.size} of {raw.size} values of column {channel.source} are missing; "
                "leave the channel out or export it again."
            )
        if finite.size < raw.size:
            notes.append(_gap_note(channel, table, raw))
        stated = "scale" in channel.section.model_fields_set or table.scalings[index].has_scale
        if not stated and looks_like_counts(finite):
            raise BenchError(
                f"{place}: column {channel.source} holds whole numbers from {finite.min():.0f} to {finite.max():.0f}, "
                f"which looks like raw counts; give 'scale: …' ({channel.quantity.unit} per count, or 1 if they are "
                f"{channel.section.unit})."
            )
        notes += _unusual(channel)
    for number, channel in enumerate(channels):
        for other in channels[:number]:
            stated = all("scale" in one.section.model_fields_set for one in (channel, other))
            if not stated and _same(channel.data, other.data):
                raise BenchError(
                    f"{places[number]}: columns {other.source} and {channel.source} hold the same numbers: one was "
                    "exported twice; correct it, or state 'scale: 1' for both if they are meant so."
                )
    return notes


def _same(first: FloatArray, second: FloatArray) -> bool:
    good = np.isfinite(first) & np.isfinite(second)
    # A dead channel equals another dead channel.
    return bool(good.any() and np.ptp(first[good]) > 0.0 and np.array_equal(first[good], second[good]))


def _gap_note(channel: ImportedChannel, table: SourceTable, raw: FloatArray) -> str:
    missing = np.isnan(raw)
    first = int(np.argmax(missing))
    runs = int(np.count_nonzero(np.diff(missing.astype(np.int8), prepend=0) == 1))
    return (
        f"Column {channel.source} lacks {int(missing.sum())} values in {runs} stretches (first at "
        f"{table.place(first)}); they are marked as missing and windows over them will be rejected."
    )


def looks_like_counts(values: FloatArray) -> bool:
    """Whether a column (finite values) holds whole numbers as a converter gives them."""
    head = values[:100_000]
    if head.size < 20 or not np.array_equal(head, np.round(head)):
        return False
    return bool(np.unique(head).size >= 20 and np.abs(head).max() >= 64.0)


def _unusual(channel: ImportedChannel) -> list[str]:
    values = channel.data[np.isfinite(channel.data)]
    if not np.ptp(values) > 0.0:
        return [f"Column {channel.source} ({channel.name}) is constant; is the sensor connected?"]
    peak = float(np.abs(values - np.mean(values)).max())
    low, high = _USUAL[channel.quantity]
    if low <= peak <= high or coordinate_of_unit(channel.section.unit):
        return []
    what = "small" if peak < low else "large"
    return [
        f"Column {channel.source} ({channel.name}) peaks at {peak:.3g} {channel.quantity.unit}, unusually {what} for a "
        f"{channel.quantity.name.lower()}; check its unit ({channel.section.unit})."
    ]


class CheckedStretch(NamedTuple):
    """Window or segment on the grid: its section, name, first sample and sample after the last one."""

    segment: SignalSection
    name: str
    first: int
    stop: int


def check_physics(
    channels: Sequence[ImportedChannel],
    stretches: Sequence[CheckedStretch],
    sample_rate: float,
    linear: LinearDescription | None,
) -> list[str]:
    """Power and damping of driven segments.

    A passive structure takes power from its exciter. Exchanging force and response turns the sign of the power, as
    does a sensor mounted the other way round; errors of phase below 120° do not.

    Args:
        channels: all of them.
        stretches: of the segments that were driven.
        sample_rate: Hz.
        linear: linear modes, if known.

    Returns:
        Sentences on what is implausible.

    Raises:
        BenchError: the structure would feed the exciter.
    """
    notes: list[str] = []
    for force in (channel for channel in channels if channel.quantity is Quantity.FORCE):
        for response in channels:
            if response.quantity in MOTIONS and (response.point == force.point or not force.point):
                _check_power(force, response, stretches, sample_rate)
    if linear is not None:
        notes += _damping_notes(channels, stretches, sample_rate, linear)
    return notes


def _check_power(
    force: ImportedChannel, response: ImportedChannel, stretches: Sequence[CheckedStretch], sample_rate: float
) -> None:
    for stretch in stretches:
        steady = stretch.segment.test in STEADY_KINDS
        if not steady and stretch.segment.test not in (TestKind.RANDOM, TestKind.SWEEP):
            continue
        found = _power_factor(force, response, stretch, sample_rate, steady)
        if found is None:
            continue
        factor, sign = found
        if factor < _STEADY_POWER if steady else factor < _BROAD_POWER and sign < _BROAD_SIGN:
            raise BenchError(
                f"In {stretch.name} the exciter would take power out of the structure at point {response.point} (power "
                f"factor {factor:.2f}): columns {force.source} ({force.name}) and {response.source} ({response.name}) "
                "are swapped, or one has the wrong sign; exchange them or give one 'scale: -1'."
            )


def _power_factor(
    force: ImportedChannel, response: ImportedChannel, stretch: CheckedStretch, sample_rate: float, steady: bool
) -> tuple[float, float] | None:
    """Active over apparent power, and over the sum of its magnitudes line by line (−1 = negative everywhere).

    Of steady segments at the strongest line, else over all lines.
    """
    cut = slice(stretch.first, min(stretch.stop, stretch.first + 2_000_000))
    found = piece_spectra([force.data[cut], response.data[cut]], sample_rate, 1 if steady else 16)
    if found is None:
        return None
    frequency, (forces, responses) = found
    omega = 2.0 * np.pi * frequency
    velocity = responses * (1j * omega) ** (1 - MOTIONS[response.quantity])
    if steady:
        line = int(np.argmax(np.abs(forces[0] * velocity[0])))
        forces, velocity = forces[:, line : line + 1], velocity[:, line : line + 1]
    active = (velocity * forces.conj()).real.sum(axis=0)
    apparent = math.sqrt(float((np.abs(velocity) ** 2).sum()) * float((np.abs(forces) ** 2).sum()))
    if not apparent > 0.0:
        return None
    return float(active.sum()) / apparent, float(active.sum() / np.abs(active).sum())


def _amplitude(channel: ImportedChannel, stretch: CheckedStretch, sample_rate: float) -> tuple[float, float] | None:
    """Frequency and amplitude of the strongest line of a steady segment."""
    return line_amplitude(channel.data[stretch.first : min(stretch.stop, stretch.first + 2_000_000)], sample_rate)


def _damping_notes(
    channels: Sequence[ImportedChannel],
    stretches: Sequence[CheckedStretch],
    sample_rate: float,
    linear: LinearDescription,
) -> list[str]:
    """Force and response at the lowest level give a damping ratio; units off by 1000 put it off by as much."""
    levels = [s for s in stretches if s.segment.test is TestKind.PHASE_RESONANCE]
    forces = [c for c in channels if c.quantity is Quantity.FORCE and c.point in (0, linear.drive_point)]
    drives = [c for c in channels if c.quantity in MOTIONS and c.point == linear.drive_point]
    if not levels or not forces or not drives:
        return []
    lowest = min(levels, key=lambda stretch: stretch.segment.level or math.inf)
    force, response = _amplitude(forces[0], lowest, sample_rate), _amplitude(drives[0], lowest, sample_rate)
    if force is None or response is None or not response[1] > 0.0 or not linear.drive_point_shape:
        return []
    omega = 2.0 * math.pi * force[0]
    displacement = response[1] / omega ** MOTIONS[drives[0].quantity]
    implied = abs(force[1] * linear.drive_point_shape**2 / (2.0 * omega**2 * displacement))
    expected = linear.damping_ratios[linear.target_mode]
    if not expected > 0.0 or 1.0 / 100.0 < implied / expected < 100.0:
        return []
    return [
        f"Force and {drives[0].name} in {lowest.name} give a damping ratio near {implied:.3g}, the linear mode has "
        f"{expected:.3g}: a "
        f"unit is probably wrong by a power of ten ({forces[0].section.unit}, {drives[0].section.unit})."
    ]
