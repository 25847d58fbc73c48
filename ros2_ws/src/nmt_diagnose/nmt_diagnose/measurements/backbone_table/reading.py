"""Observables of backbones that someone else has reduced."""

from __future__ import annotations

import math

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.backbone_table.backbone_table import BackboneTable
from nmt_diagnose.observations.model_view import ModelView, nearest_ratio
from nmt_diagnose.observations.noise.scatter import neighbour_cubics
from nmt_diagnose.observations.observables import Observations, Part, Place, RowTable, empty
from nmt_diagnose.observations.tables_together import TablesTogether
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_record.exchange.sidecar.import_sidecar import TableKind
from nmt_rig.model.linear_modes import damped_modes


def backbone_observations(tables: TablesTogether) -> Observations | None:
    """Observables of a backbone that someone else has reduced; None of other tables."""
    name, table, view, settings = tables.name, tables.tables[0], tables.view, tables.settings
    if table.kind != TableKind.BACKBONE:
        return None
    frequency, amplitude = table.columns["frequency_hz"], table.columns["amplitude"]
    good = np.isfinite(frequency) & (frequency > 0.0) & np.isfinite(amplitude) & (amplitude > 0.0)
    if not good.any():
        return empty((f"{name}: left out: it has no row with frequency and amplitude.",))
    ratios = [nearest_ratio(float(value), view.frequencies_hz) for value in frequency[good]]
    if all(max(ratio, 1.0 / ratio) > THRESHOLDS.reading.wrong_frequency_ratio for ratio in ratios):
        return empty((f"{name}: left out: its frequencies lie at no mode of the model {view.rig.name}.",))
    damping, damping_std = table.column("damping_ratio"), table.column("damping_ratio_std")
    frequency_std = table.column("frequency_hz_std")
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
    test = BackboneTable(name, view.rig.drive_point, tables.channels[0], amplitude[where].copy(), degrees)
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
