"""Observables of tables that someone else has reduced: backbones and frequency responses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.backbone_table.backbone_table import BackboneTable
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.random_responses.random_responses import RandomResponses
from nmt_diagnose.measurements.stepped_responses.table_reading import (
    has_levels,
    spread_lines,
    stepped_table_observations,
)
from nmt_diagnose.observations.model_view import ModelView, nearest_ratio
from nmt_diagnose.observations.noise.scatter import neighbour_cubics
from nmt_diagnose.observations.observables import Observations, Part, Place, RowTable, empty
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_rig.model.linear_modes import damped_modes
from nmt_rig.rig import Rig


def table_observations(
    name: str, tables: Sequence[ObservableTable], model: Rig, settings: ObservationSettings
) -> Observations:
    """Observables of one table, or of several that were measured together; a sentence where it cannot be used."""
    drive_point = tables[0].drive_point or model.drive_point
    points = model.structure.points
    notes = []
    for point, what in ((drive_point, "drive point"), *((each.point or drive_point, "point") for each in tables)):
        if point not in points:
            notes.append(f"{name}: left out: its {what} {point} is not among the model's points 1 to {points[-1]}.")
    tables = [each for each in tables if (each.point or drive_point) in points]
    if drive_point not in points or not tables:
        return empty(notes)
    table = tables[0]
    view = ModelView.of(model, (drive_point,))
    if any(each.quantity not in MOTIONS for each in tables):
        return empty(
            (
                f"{name}: left out: its amplitude is modal ({table.units.get('amplitude', 'no unit')}); the model "
                "predicts amplitudes of a point in m, m/s or m/s^2.",
            )
        )
    channels = [_channel(each, view, each.point or drive_point) for each in tables]
    if table.kind == "backbone":
        return _backbone(name, table, view, channels[0], settings)
    if has_levels(table):
        found = stepped_table_observations(name, tables, view, channels, settings)
        return replace(found, notes=(*notes, *found.notes))
    return _responses(name, table, view, channels[0], settings)


def _channel(table: ObservableTable, view: ModelView, point: int) -> MeasuredChannel:
    return next(
        (c for c in view.channels if (c.quantity, c.point) == (table.quantity, point)),
        MeasuredChannel(f"{table.quantity.letter}{point}", table.quantity, point, turns=table.turns),
    )


def _column(table: ObservableTable, name: str) -> FloatArray:
    return table.columns.get(name, np.full(table.rows, math.nan))


def _backbone(
    name: str, table: ObservableTable, view: ModelView, channel: MeasuredChannel, settings: ObservationSettings
) -> Observations:
    frequency, amplitude = table.columns["frequency_hz"], table.columns["amplitude"]
    good = np.isfinite(frequency) & (frequency > 0.0) & np.isfinite(amplitude) & (amplitude > 0.0)
    if not good.any():
        return empty((f"{name}: left out: it has no row with frequency and amplitude.",))
    ratios = [nearest_ratio(float(value), view.frequencies_hz) for value in frequency[good]]
    if all(max(ratio, 1.0 / ratio) > THRESHOLDS.reading.wrong_frequency_ratio for ratio in ratios):
        return empty((f"{name}: left out: its frequencies lie at no mode of the model {view.rig.name}.",))
    damping, damping_std = _column(table, "damping_ratio"), _column(table, "damping_ratio_std")
    frequency_std = _column(table, "frequency_hz_std")
    floors = settings.floors
    rows = RowTable()
    where = np.flatnonzero(good)
    unstated = max(floors.table_log_frequency, scatter_about_a_course(amplitude[good], np.log(frequency[good])))
    scatter = _scatter_of_damping(amplitude[good], damping[good])
    notes = [] if good.all() else [f"{name}: {int((~good).sum())} of {good.size} rows have no value and are left out."]
    # Of a damping of 0 there is no share: that of the model's damping is taken.
    model_damping = _damping_near(view, float(np.median(frequency[where])))
    for level, index in enumerate(where):
        place = Place(level, 0.0, float(frequency[index]), float(amplitude[index]))
        stated = frequency_std[index] / frequency[index]
        known = math.isfinite(stated) and stated > 0.0
        rows.add(
            Part.LOG_FREQUENCY, math.log(2.0 * math.pi * frequency[index]), stated if known else 0.0,
            floors.log_frequency if known else unstated, place, 0, 1,
        )  # fmt: skip
        if math.isfinite(damping[index]):
            known = math.isfinite(damping_std[index]) and damping_std[index] > 0.0
            share = floors.decay_damping if known else max(floors.table_damping, scatter)
            rows.add(
                Part.DAMPING, float(damping[index]), float(damping_std[index]) if known else 0.0,
                share * (abs(float(damping[index])) or model_damping), place, 0, 1,
            )  # fmt: skip
    degrees = math.inf
    if np.any(damping[where] == 0.0):
        notes.append(f"{name}: a damping of 0 is that of a motion that something drives, such as a limit cycle.")
    if not np.any(np.isfinite(frequency_std[where])):
        degrees = where.size / (2.0 * THRESHOLDS.noise.cubic_relative_std**2)
        notes.append(f"{name}: no uncertainties are given; {100 * unstated:.2g} % is taken for every frequency.")
    test = BackboneTable(name, view.rig.drive_point, channel, amplitude[where].copy(), degrees)
    return rows.observations(test, notes)


def _damping_near(view: ModelView, frequency_hz: float) -> float:
    """Damping ratio of the model's mode nearest to a frequency, Hz."""
    poles = damped_modes(view.system).eigenvalues
    poles = poles[poles.imag > 0.0]
    if not poles.size:
        return 0.0
    nearest = poles[np.argmin(np.abs(np.log(np.abs(poles) / (2.0 * math.pi * frequency_hz))))]
    return float(-nearest.real / abs(nearest))


def _scatter_of_damping(amplitude: FloatArray, damping: FloatArray) -> float:
    """Relative scatter of damping ratios about a smooth course over the amplitude; 0 where some are not positive."""
    known = np.isfinite(damping)
    if not known.any() or np.any(damping[known] <= 0.0):
        return 0.0
    return scatter_about_a_course(amplitude[known], np.log(damping[known]))


def scatter_about_a_course(x: FloatArray, y: FloatArray) -> float:
    """Standard deviation of y about a smooth course over x: each point against the cubic through its four neighbours.

    Args:
        x: places, any order, shape (n,).
        y: values, shape (n,).

    Returns:
        The standard deviation; 0 for fewer than seven different places.
    """
    x, first = np.unique(x, return_index=True)
    y = y[first]
    if x.size < THRESHOLDS.noise.table_fewest_for_scatter:
        return 0.0
    middle, near, weights = neighbour_cubics(x)
    residual = y[middle] - np.sum(weights * y[near], axis=1)
    return math.sqrt(float(np.mean(residual**2 / (1.0 + np.sum(weights**2, axis=1)))))


def _responses(
    name: str, table: ObservableTable, view: ModelView, channel: MeasuredChannel, settings: ObservationSettings
) -> Observations:
    frequency = table.columns["frequency_hz"]
    response = table.responses
    size = np.abs(response)
    good = np.isfinite(size) & (size > 0.0) & (frequency > 0.0)
    if not good.any():
        return empty((f"{name}: left out: it has no usable line.",))
    scatter = np.sqrt(0.5 * (_column(table, "real_std") ** 2 + _column(table, "imag_std") ** 2))
    if not table.phase_known:
        scatter = _column(table, "magnitude_std")
    std = scatter / np.where(size > 0.0, size, 1.0)
    if table.noise > 0.0:
        std = np.where(np.isfinite(std), std, table.noise)
    stated = np.isfinite(std)
    std = np.where(stated, std, THRESHOLDS.noise.table_default_std)
    # Without uncertainties a coherence says something, but not how much was averaged: the line counts for less below 1.
    coherence = np.clip(_column(table, "coherence"), 1e-6, 1.0)
    weak = ~stated & np.isfinite(coherence)
    std[weak] = np.maximum(std[weak], np.sqrt(0.5 * (1.0 - coherence[weak]) / coherence[weak]))
    # A magnitude has a corner at an antiresonance, where the response itself goes smoothly through zero.
    noise_from_lines = table.phase_known and not stated.any()
    everywhere = noise_of_weak_lines(frequency[good], response[good]) if noise_from_lines else 0.0
    std = np.hypot(std, everywhere / np.where(size > 0.0, size, 1.0))
    good &= std <= settings.largest_std
    candidates = np.flatnonzero(good)
    if candidates.size == 0:
        return empty((f"{name}: left out: no line is known to better than {100 * settings.largest_std:g} %.",))
    order = candidates[np.argsort(frequency[candidates], kind="stable")]
    spread = _spread if table.phase_known else spread_lines
    chosen = order[spread(frequency[order], response[order], settings.lines)]
    notes = []
    if not stated.any():
        noise = f"; weak lines show {everywhere:.2g} {table.units.get('real', '')} besides" if everywhere else ""
        notes.append(
            f"{name}: no uncertainties are given; {100 * THRESHOLDS.noise.table_default_std:g} % is taken for every "
            f"line{noise}."
        )
    rows = RowTable()
    level = table.level if math.isfinite(table.level) else 0.0
    for number, index in enumerate(chosen):
        place = Place(number, 0.0, float(frequency[index]), level)
        value = float(std[index])
        floors = settings.floors
        rows.add(Part.LOG_MAGNITUDE, math.log(float(size[index])), value, floors.frf, place, 0)
        if table.phase_known:
            rows.add(Part.PHASE, float(np.angle(response[index])), value, floors.frf, place, 0)
    steps = np.diff(np.sort(frequency))
    test = RandomResponses(
        name=name,
        drive_point=view.rig.drive_point,
        channels=(channel,),
        reference="force",
        lines_hz=frequency[chosen].copy(),
        resolution_hz=float(np.min(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0,
        window="none",
        drive_rms=level,
        start_s=0.0,
        stop_s=0.0,
    )
    return rows.observations(test, notes)


def noise_of_weak_lines(frequency: FloatArray, response: NDArray[np.complex128]) -> float:
    """Standard deviation of the real and of the imaginary part of the weaker half of a frequency response's lines.

    About an antiresonance a response goes smoothly through zero: what scatters there is noise that does not fall with
    the response. It is read off the median distance from the cubics through four neighbours.

    Args:
        frequency: Hz, any order, shape (n,).
        response: shape (n,).

    Returns:
        In the unit of the response; 0 for fewer than seven weak lines.
    """
    frequency, first = np.unique(frequency, return_index=True)
    response = response[first]
    if frequency.size < 2 * THRESHOLDS.noise.table_fewest_for_scatter:
        return 0.0
    middle, near, weights = neighbour_cubics(frequency)
    apart = np.abs(response[middle] - np.sum(weights * response[near], axis=1))
    apart /= np.sqrt(1.0 + np.sum(weights**2, axis=1))
    weak = np.abs(response[middle]) <= np.median(np.abs(response))
    # The distance in the plane of a complex number follows Rayleigh's law.
    return (
        float(np.median(apart[weak])) / math.sqrt(2.0 * math.log(2.0))
        if weak.sum() >= THRESHOLDS.noise.table_fewest_for_scatter
        else 0.0
    )


def _spread(frequency: FloatArray, response: NDArray[np.complex128], wanted: int) -> NDArray[np.int64]:
    """Indices evenly spread over decades and turns of the phase."""
    if frequency.size <= wanted:
        return np.arange(frequency.size, dtype=np.int64)
    turns = np.concatenate(([0.0], np.cumsum(np.abs(np.angle(response[1:] * np.conj(response[:-1]))))))
    way = np.log(frequency / frequency[0]) + turns * math.log(4.0) / math.pi
    picked = np.searchsorted(way, np.linspace(way[0], way[-1], wanted)).clip(0, way.size - 1)
    return np.unique(picked.astype(np.int64))
