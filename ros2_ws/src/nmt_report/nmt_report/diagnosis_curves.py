"""Measured and computed observables as curves: what a report draws and ``observables.csv`` lists."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nmt_core.files.whole_file import csv_text
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.measurement import Measurement, Observations
from nmt_diagnose.observations.observables import HARMONICS, Part
from nmt_diagnose.say.residual_map import channel_name
from nmt_report.quantity_format import engineering_exponent, power_of_ten

_FEW_LINES = 12
_TAU = 2.0 * math.pi


@dataclass(frozen=True)
class Models:
    """Observables of the model as given, with its parameters re-fitted, and of the outcome, (m,) each."""

    as_given: FloatArray
    refitted: FloatArray
    final: FloatArray


@dataclass(frozen=True)
class Course:
    """One observable along levels, lines, amplitudes or time.

    Attributes:
        title: what it is.
        x, x_label: abscissa, (k,), ascending unless levels go down again.
        unit: of the values.
        measured, sigma: measured values and their standard deviation, (k,).
        given, refitted, final: values of the three models, (k,).
        deviation_unit: of the deviations.
        deviations: measured − model of the three models and the standard deviation, in ``deviation_unit``, (4, k).
        logarithmic: whether the values are shown on a logarithmic axis.
        joined: whether neighbours are close enough for a line between them.
        exponent: power of ten in ``unit``.
        turn: a whole turn in ``unit``; 0 where the values are no phase.
    """

    title: str
    x: FloatArray
    x_label: str
    unit: str
    measured: FloatArray
    sigma: FloatArray
    given: FloatArray
    refitted: FloatArray
    final: FloatArray
    deviation_unit: str
    deviations: FloatArray
    logarithmic: bool = False
    joined: bool = True
    exponent: int = 0
    turn: float = 0.0

    def moved(self, factor: float, offset: float, **changes: Any) -> Course:
        """The course with its values (not the deviations) times a factor, and an offset added."""
        names = ("measured", "given", "refitted", "final")
        return replace(self, **{name: factor * getattr(self, name) + offset for name in names}, **changes)


@dataclass(frozen=True)
class HarmonicCourse:
    """Magnitudes of the harmonics of one channel over the level, relative to the fundamental.

    Attributes:
        title: channel.
        x: level of excitation, (k,).
        orders: orders n, (h,).
        measured, sigma, given, refitted, final: magnitudes relative to the measured fundamental, (h, k).
    """

    title: str
    x: FloatArray
    x_label: str
    orders: tuple[int, ...]
    measured: FloatArray
    sigma: FloatArray
    given: FloatArray
    refitted: FloatArray
    final: FloatArray


def level_names(tests: Sequence[Measurement]) -> list[str]:
    """Names of stepped sines of the same channels: level and direction of the frequency, a number if need be."""
    names: list[str] = []
    for test in tests:
        level = test.name if test.lines is None else test.lines.level_name
        if test.lines is None or test.lines.sweep_key is None:
            names.append(level)
            continue
        before = sum(name.split(" (")[0] == level for name in names)
        names.append(f"{level} ({before + 1})" if before else level)
    return names


def on_one_scale(panel: Sequence[Course | None]) -> list[Course | None]:
    """Courses of one panel in the unit of the one with the largest power of ten, phases within half a turn.

    Args:
        panel: courses of the same channel and part; None stays.
    """
    there = [course for course in panel if course is not None]
    if not there:
        return list(panel)
    first, largest = there[0], max(there, key=lambda course: course.exponent)
    found: list[Course | None] = []
    for course in panel:
        if course is None:
            found.append(None)
            continue
        apart = float(np.nanmedian(first.measured) - np.nanmedian(course.measured))
        offset = round(apart / first.turn) * first.turn if first.turn and math.isfinite(apart) else 0.0
        factor = 10.0 ** (course.exponent - largest.exponent)
        found.append(course.moved(factor, offset, unit=largest.unit, exponent=largest.exponent))
    return found


def courses(observations: Observations, models: Models, test: int, part: Part) -> list[Course]:
    """Courses of one part of one test, one per channel that has it; harmonics aside."""
    rows = observations.rows
    mine = (rows.test == test) & (rows.part == part)
    kind = observations.tests[test]
    found = []
    for channel in np.unique(rows.channel[mine]):
        which = np.flatnonzero(mine & (rows.channel == channel) & ((rows.harmonic == 1) | (rows.harmonic < 0)))
        if which.size == 0:
            continue
        along = rows.time_s if kind.record is not None else rows.level
        which = which[np.argsort(along[which], kind="stable")]
        found.append(_course(observations, models, test, which, part))
    return found


def _course(observations: Observations, models: Models, test: int, which: np.ndarray, part: Part) -> Course:
    rows, kind = observations.rows, observations.tests[test]
    measured, sigma = observations.values[which], observations.sigma[which]
    computed = [values[which] for values in (models.as_given, models.refitted, models.final)]
    channel = int(rows.channel[which[0]])
    own = kind.channels[channel] if channel >= 0 else None
    x = kind.axis.abscissa(rows, which)
    facts = part.facts
    unit_of_channel = own.unit if own is not None else ""
    unit, deviation_unit = facts.axis or unit_of_channel, facts.unit or unit_of_channel
    differences = np.array([measured - values for values in computed] + [sigma])
    if facts.angle:
        deviation_unit = unit
        differences[:3] -= np.round(differences[:3] / _TAU) * _TAU
        measured = facts.drawn(measured)
        computed = [measured - np.degrees(row) for row in differences[:3]]
    else:
        measured, *computed = (facts.drawn(values) for values in (measured, *computed))
    if facts.logarithmic:
        unit = "" if own is None else kind.axis.magnitude_unit(own)
    joined = kind.lines is None or x.size >= _FEW_LINES
    exponent = engineering_exponent(measured) if facts.scaled else 0
    if exponent:
        unit = f"{power_of_ten(exponent)} {unit}"
        measured, *computed = (values / 10.0**exponent for values in (measured, *computed))
    given, refitted, final = computed
    title = facts.title or (own.name if own is not None else "")
    return Course(
        title, x, kind.axis.label, unit, measured, sigma, given, refitted,
        final, deviation_unit, facts.factor * differences, facts.logarithmic, joined, exponent,
        360.0 if facts.angle else 0.0,
    )  # fmt: skip


def harmonic_courses(observations: Observations, models: Models, test: int) -> list[HarmonicCourse]:
    """Harmonics of every channel of a test that has some."""
    rows, kind = observations.rows, observations.tests[test]
    higher = (rows.test == test) & np.isin(rows.part, HARMONICS)
    found = []
    for channel in np.unique(rows.channel[higher]):
        mine = higher & (rows.channel == channel)
        orders = tuple(int(n) for n in np.unique(rows.harmonic[mine]) if n > 1)
        levels = np.unique(rows.level[mine])
        if not orders or levels.size < 2:
            continue
        magnitudes = np.full((5, len(orders), levels.size), np.nan)
        x = np.empty(levels.size)
        for column, level in enumerate(levels):
            here = mine & (rows.level == level)
            x[column] = rows.amplitude[here][0]
            for row, order in enumerate(orders):
                which = np.flatnonzero(here & (rows.harmonic == order))
                for index, values in enumerate(
                    (observations.values, None, models.as_given, models.refitted, models.final)
                ):
                    if values is None:
                        magnitudes[index, row, column] = float(np.sqrt(np.mean(observations.sigma[which] ** 2)))
                    else:
                        magnitudes[index, row, column] = float(np.sqrt(np.sum(values[which] ** 2)))
        name = channel_name(observations, test, int(channel))
        found.append(HarmonicCourse(name, x, kind.axis.label, orders, *magnitudes))
    return found


def observables_csv(observations: Observations, models: Models) -> str:
    """Text of ``observables.csv``: every observable, measured and of the three models."""
    rows = observations.rows
    table: list[list[object]] = [
        ["test", "level", "amplitude", "frequency_hz", "time_s", "channel", "harmonic", "part", "measured", "std",
         "floor", "model_as_given", "model_refitted", "model_final"]
    ]  # fmt: skip
    for k in range(len(rows)):
        channel = int(rows.channel[k])
        name = channel_name(observations, int(rows.test[k]), channel) if channel >= 0 else ""
        harmonic = int(rows.harmonic[k])
        numbers = (
            observations.values[k], observations.std[k], observations.floor[k], models.as_given[k], models.refitted[k],
            models.final[k],
        )  # fmt: skip
        table.append(
            [
                observations.tests[int(rows.test[k])].name, int(rows.level[k]), repr(float(rows.amplitude[k])),
                repr(float(rows.frequency_hz[k])), repr(float(rows.time_s[k])), name,
                harmonic if harmonic >= 0 else "", Part(int(rows.part[k])).facts.column,
                *(repr(float(value)) for value in numbers),
            ]
        )  # fmt: skip
    return csv_text(table)
