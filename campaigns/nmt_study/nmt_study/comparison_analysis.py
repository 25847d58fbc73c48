"""Modal properties over amplitude from a ring-down, a sweep or stepped sines: what other methods find."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import PointStatus, TestKind
from nmt_extract.curves.constant_amplitude import SolvedPoints, fit_at_amplitudes, half_power, solve_points
from nmt_extract.curves.swept_response import FrequencyResponseTable, stepped_point, stepped_table, sweep_table
from nmt_extract.decays.structure_decay import Decay, structure_decay
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import Segment, Signals, read_signals, segments
from nmt_rig.linear_description import linear_description
from nmt_study.case import StudyCase
from nmt_study.case_reference import case_rig

SWEEP_POINTS = 200
_WIDTH = 0.3
_OWN_LEVEL_WIDTH = 0.1
"""In ln q: points of one held response amplitude lie closer together than neighbouring amplitudes."""


def compared_methods_of(case: StudyCase, bag: Path, modal_amplitudes: FloatArray) -> dict[str, Any]:
    """Every method's evaluation of a case's recording.

    Args:
        case: a ring-down, a sweep or stepped sines.
        bag: its recording.
        modal_amplitudes: q at which responses are evaluated, m√kg.

    Returns:
        ``methods``: name → ``levels`` (rows as those of a run) and ``bench_time_s`` (None = that of the run); and
        ``remarks``, sentences on what failed.
    """
    rig = case_rig(case)
    linear = linear_description(rig)
    recorded = Bag.open(bag)
    remarks: list[str] = []
    windows = []
    for segment in segments(recorded):
        if segment.fault:
            remarks.append(f"Level {segment.level_index + 1}: {segment.fault}.")
        elif segment.kind in (TestKind.RING_DOWN, TestKind.SWEEP, TestKind.STEPPED_SINE):
            windows.append(segment)
    methods: dict[str, Any] = {}
    if windows and case.test == "ring_down":
        quantity = Quantity[rig.extraction.quantity.upper()]
        methods = _ring_downs(recorded, windows, linear, quantity, remarks)
    elif windows:
        methods = _responses(case, _tables(recorded, windows), linear, modal_amplitudes, remarks)
    return {"methods": methods, "remarks": remarks}


def _ring_downs(
    bag: Bag, windows: Sequence[Segment], linear: LinearDescription, quantity: Quantity, remarks: list[str]
) -> dict[str, Any]:
    decays: list[Decay] = []
    rate = 1.0
    for segment in windows:
        signals = read_signals(bag, segment.first_sample, segment.samples)
        rate = signals.sample_rate
        try:
            decays.append(structure_decay(signals, linear, quantity))
        except BenchError as error:
            remarks.append(f"Level {segment.level_index + 1}: {error}")
    if not decays:
        return {}
    mean = average_decays(decays)
    return {
        "ring_downs": {"levels": _decay_rows(mean, ""), "bench_time_s": None},
        "ring_down": {"levels": _decay_rows(decays[0], ""), "bench_time_s": windows[0].end_sample / rate},
        "apparent": {"levels": _decay_rows(mean, "apparent_"), "bench_time_s": None},
    }


def average_decays(decays: Sequence[Decay]) -> Decay:
    """Mean of repeated decays at the amplitudes of the one with the most, with the standard uncertainty of the mean.

    Each is interpolated in ln q over its own range; the mean is weighted by the inverse variances. The uncertainty is
    the larger of the propagated one and, from three decays on, that from their scatter.

    Args:
        decays: at least one.
    """
    fullest = max(decays, key=lambda decay: decay.time.size)
    grid: FloatArray = np.log(fullest.modal_amplitude)
    columns: dict[str, FloatArray] = {"time": fullest.time, "modal_amplitude": fullest.modal_amplitude}
    for name in ("omega_rad_s", "damping_ratio", "apparent_omega_rad_s", "apparent_damping_ratio"):
        values = np.array([_at(decay, getattr(decay, name), grid) for decay in decays])
        stds = np.array([_at(decay, getattr(decay, f"{name}_std"), grid) for decay in decays])
        weights = np.where(np.isfinite(values), stds**-2.0, 0.0)
        total = weights.sum(axis=0)
        known = np.count_nonzero(weights, axis=0)
        mean = np.nansum(weights * np.nan_to_num(values), axis=0) / total
        scatter = np.sum(weights * (np.nan_to_num(values) - mean) ** 2, axis=0) / total
        outer = np.where(known >= 3, np.sqrt(scatter / np.maximum(known - 1, 1)), 0.0)
        columns[name] = mean
        columns[f"{name}_std"] = np.maximum(total**-0.5, outer)
    return Decay(**columns)


def _at(decay: Decay, values: FloatArray, grid: FloatArray) -> FloatArray:
    """Values of a decay at ln q; NaN beyond its amplitudes."""
    order = np.argsort(decay.modal_amplitude)
    place = np.log(decay.modal_amplitude[order])
    return np.asarray(np.interp(grid, place, values[order], left=np.nan, right=np.nan))


def _decay_rows(decay: Decay, prefix: str) -> list[dict[str, Any]]:
    names = ("omega_rad_s", "omega_rad_s_std", "damping_ratio", "damping_ratio_std")
    columns = [getattr(decay, prefix + name) for name in names]
    return _rows(decay.modal_amplitude, *columns)


def _responses(
    case: StudyCase,
    tables: Sequence[FrequencyResponseTable],
    linear: LinearDescription,
    modal_amplitudes: FloatArray,
    remarks: list[str],
) -> dict[str, Any]:
    points = SolvedPoints.of([solve_points(table, linear) for table in tables])
    if case.control == "response":
        modal_amplitudes = np.array(
            [float(np.median(solve_points(t, linear, np.inf).modal_amplitude)) for t in tables], dtype=np.float64
        )
        name, width = "held_response", _OWN_LEVEL_WIDTH
    else:
        name, width = "sweeps" if case.test == "sweep" else "stepped", _WIDTH
    methods: dict[str, Any] = {}

    def found(key: str, rows: Callable[[], list[dict[str, Any]]]) -> None:
        try:
            methods[key] = {"levels": rows(), "bench_time_s": None}
        except BenchError as error:
            remarks.append(f"{key}: {error}")

    def fitted() -> list[dict[str, Any]]:
        fit = fit_at_amplitudes(points, modal_amplitudes, width)
        return _rows(
            fit.modal_amplitude, fit.omega_rad_s, fit.omega_rad_s_std, fit.damping_ratio, fit.damping_ratio_std
        )

    found(name, fitted)
    if case.test == "sweep":
        found("half_power", lambda: _half_power_rows(tables, linear, remarks))
    return methods


def _half_power_rows(
    tables: Sequence[FrequencyResponseTable], linear: LinearDescription, remarks: list[str]
) -> list[dict[str, Any]]:
    found = []
    for table in tables:
        try:
            found.append(half_power(table, linear))
        except BenchError as error:
            remarks.append(str(error))
    unknown = np.full(len(found), np.nan)
    columns = np.array(found, dtype=np.float64).reshape(-1, 3)
    return _rows(columns[:, 0], columns[:, 1], unknown, columns[:, 2], unknown)


def _rows(
    q: FloatArray, omega: FloatArray, omega_std: FloatArray, damping: FloatArray, damping_std: FloatArray
) -> list[dict[str, Any]]:
    """Rows as those of a run's levels; the level is the modal acceleration ω̃²q."""
    rows = []
    for k, order in enumerate(np.argsort(q)):
        rows.append(
            {
                "level_index": k,
                "level": float(omega[order] ** 2 * q[order]),
                "status": int(PointStatus.OK),
                "reason": "",
                "window_periods": 0,
                "participation_real": [],
                "participation_imag": [],
                "modal_amplitude": float(q[order]),
                "omega_rad_s": float(omega[order]),
                "omega_rad_s_std": float(omega_std[order]),
                "damping_ratio": float(damping[order]),
                "damping_ratio_std": float(damping_std[order]),
            }
        )
    return rows


def _tables(bag: Bag, windows: Sequence[Segment]) -> list[FrequencyResponseTable]:
    """One table for each sweep, or for each level of the stepped sines."""
    if windows[0].kind is TestKind.SWEEP:
        return [
            sweep_table(read_signals(bag, s.first_sample, s.samples), s.level, s.level_unit, SWEEP_POINTS)
            for s in windows
        ]
    first = min(segment.first_sample for segment in windows)
    # One pass over the recording instead of one for each window.
    whole = read_signals(bag, first, max(segment.end_sample for segment in windows) - first)
    steps: dict[float, list[Segment]] = {}
    for segment in windows:
        steps.setdefault(segment.level, []).append(segment)
    return [
        stepped_table(
            [stepped_point(_cut(whole, segment), segment.periods, segment.frequency_hz) for segment in level],
            level[0].level,
            level[0].level_unit,
        )
        for level in steps.values()
    ]


def _cut(whole: Signals, segment: Segment) -> Signals:
    """The samples of a window out of a longer stretch."""
    first = segment.first_sample - whole.first_sample
    part = slice(first, first + segment.samples)
    return replace(
        whole,
        first_sample=segment.first_sample,
        channels={name: samples[part] for name, samples in whole.channels.items()},
        oscillator=None if whole.oscillator is None else whole.oscillator[part],
    )
