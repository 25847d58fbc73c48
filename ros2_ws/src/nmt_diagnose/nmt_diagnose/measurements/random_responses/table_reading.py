"""Observables of frequency responses that someone else has reduced, and that no amplitude was held in."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.random_responses.random_responses import RandomResponses
from nmt_diagnose.measurements.stepped_responses.table_reading import has_levels, require_base, spread_lines
from nmt_diagnose.observations.noise.scatter import neighbour_cubics
from nmt_diagnose.observations.observables import Observations, Part, Place, RowTable, empty
from nmt_diagnose.observations.tables_together import TablesTogether
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_record.exchange.sidecar.import_sidecar import TableKind


def response_table_observations(tables: TablesTogether) -> Observations | None:
    """Observables of frequency responses without a level that someone else has reduced; None of other tables.

    Raises:
        BenchError: they are over the acceleration of a base, and the model has none.
    """
    name, table, settings = tables.name, tables.tables[0], tables.settings
    if table.kind != TableKind.FRF or has_levels(table):
        return None
    require_base(tables)
    frequency = table.columns["frequency_hz"]
    response = table.responses
    size = np.abs(response)
    good = np.isfinite(size) & (size > 0.0) & (frequency > 0.0)
    if not good.any():
        return empty((f"{name}: left out: it has no usable line.",))
    scatter = np.sqrt(0.5 * (table.column("real_std") ** 2 + table.column("imag_std") ** 2))
    if not table.phase_known:
        scatter = table.column("magnitude_std")
    std = scatter / np.where(size > 0.0, size, 1.0)
    if table.noise > 0.0:
        std = np.where(np.isfinite(std), std, table.noise)
    stated = np.isfinite(std)
    std = np.where(stated, std, THRESHOLDS.noise.table_default_std)
    # Without uncertainties a coherence says something, but not how much was averaged: the line counts for less below 1.
    coherence = np.clip(table.column("coherence"), 1e-6, 1.0)
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
        drive_point=tables.view.rig.drive_point,
        channels=tables.channels[:1],
        reference=table.reference,
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
