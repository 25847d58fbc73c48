"""From the bag of a sweep or a stepped sine to frequency responses, and the model's steady responses next to them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import TestKind
from nmt_extract.curves.swept_response import FrequencyResponseTable, stepped_point, stepped_table, sweep_table
from nmt_record.windows.segments import Segment, read_signals, segments

if TYPE_CHECKING:
    from nmt_record.bag.bag_reader import Bag
    from nmt_rig.rig import Rig


@dataclass(frozen=True)
class HeldForce:
    """How well the force was held along one sweep or over the frequencies of a stepped sine.

    Attributes:
        level: N.
        worst: largest relative deviation of |F₁|, with its sign.
        worst_at_hz: where, Hz.
        rms: root mean square of the relative deviation.
        rate_hz_s: sweep rate; 0 = stepped.
    """

    level: float
    worst: float
    worst_at_hz: float
    rms: float
    rate_hz_s: float


@dataclass(frozen=True, eq=False)
class ModelResponse:
    """Steady response of the rig's model at a held force, by harmonic balance.

    Attributes:
        level: N.
        frequency_hz: along the curve, shape ``(k,)``.
        channels: names as measured.
        responses: complex amplitudes relative to the force's phase, shape ``(channels, k)``.
    """

    level: float
    frequency_hz: FloatArray
    channels: tuple[str, ...]
    responses: ComplexArray

    def at(self, channel: int, frequency_hz: FloatArray) -> ComplexArray:
        """Response at other frequencies by linear interpolation along the curve; the largest where it folds."""
        return interpolate_curve(self.frequency_hz, self.responses[channel], frequency_hz)


def interpolate_curve(curve_hz: FloatArray, values: ComplexArray, frequency_hz: FloatArray) -> ComplexArray:
    """Complex values of a curve at given frequencies, linear between its points; NaN beyond, the largest of several."""
    steps = np.diff(curve_hz)
    if np.all(steps < 0):
        curve_hz, values, steps = curve_hz[::-1], values[::-1], -steps[::-1]
    if np.all(steps > 0):
        real = np.interp(frequency_hz, curve_hz, values.real, left=math.nan, right=math.nan)
        return np.asarray(real + 1j * np.interp(frequency_hz, curve_hz, values.imag, left=math.nan, right=math.nan))
    result = np.full(len(frequency_hz), complex(math.nan, math.nan))
    for k, frequency in enumerate(frequency_hz):
        distance = curve_hz - frequency
        hits = np.flatnonzero(distance[:-1] * distance[1:] <= 0.0)
        for i in hits:
            span = distance[i + 1] - distance[i]
            share = -distance[i] / span if span else 0.0
            value = values[i] + share * (values[i + 1] - values[i])
            if not abs(result[k]) >= abs(value):
                result[k] = value
    return result


def responses_of_bag(bag: Bag, points: int = 400) -> tuple[list[FrequencyResponseTable], list[str]]:
    """Frequency responses of all levels, in their order, and sentences on levels without one.

    Args:
        bag: recording of a sweep or of stepped sines.
        points: frequencies along a sweep.

    Raises:
        BenchError: no window of a sweep or of a stepped sine in the bag.
    """
    found = [s for s in segments(bag) if s.kind in (TestKind.SWEEP, TestKind.STEPPED_SINE)]
    if not found:
        raise BenchError(
            f"The bag {bag.path} has no window of a sweep or of a stepped sine; record one with './nmt sweep'."
        )
    tables: list[FrequencyResponseTable] = []
    remarks: list[str] = []
    steps: dict[float, list[Segment]] = {}
    for segment in found:
        if segment.kind is TestKind.STEPPED_SINE:
            steps.setdefault(segment.level, []).append(segment)
            continue
        if segment.fault:
            remarks.append(f"The sweep at {segment.level:g} {segment.level_unit} is not complete: {segment.fault}.")
        if not segment.usable_samples:
            continue
        try:
            signals = read_signals(bag, segment.usable_first_sample, segment.usable_samples)
            table = sweep_table(signals, segment.level, segment.level_unit, points)
            tables.append(until_given_up(table) if segment.fault else table)
        except BenchError as error:
            remarks.append(f"Level {segment.level_index + 1}: {error}")
    for level, windows in steps.items():
        measured = []
        for segment in windows:
            if segment.fault:
                remarks.append(f"{segment.frequency_hz:.3f} Hz at {level:g} {segment.level_unit}: {segment.fault}.")
                continue
            signals = read_signals(bag, segment.first_sample, segment.samples)
            measured.append(stepped_point(signals, segment.periods, segment.frequency_hz))
        if measured:
            tables.append(stepped_table(measured, level, windows[0].level_unit))
    return tables, remarks


def until_given_up(table: FrequencyResponseTable) -> FrequencyResponseTable:
    """A sweep that was not completed without its end, where the drive goes to zero."""
    ramp = np.flatnonzero(np.abs(table.force_n / np.median(table.force_n) - 1.0) > 0.05)
    if not ramp.size or table.level_unit != "N":
        return table
    # The window of the analysis looks ahead: what it has seen of the ramp goes too.
    step = abs(float(table.frequency_hz[1] - table.frequency_hz[0]) / table.rate_hz_s)
    kept = slice(0, max(2, int(ramp[0]) - math.ceil(0.25 / step) - 1))
    return replace(
        table,
        frequency_hz=table.frequency_hz[kept],
        force_n=table.force_n[kept],
        frf=table.frf[:, kept],
        frf_std=table.frf_std[:, kept],
        voltage_v=table.voltage_v[kept],
    )


def held_force(table: FrequencyResponseTable) -> HeldForce | None:
    """Force error of a table; None if the level was no force."""
    error = table.held_error()
    if not np.all(np.isfinite(error)):
        return None
    worst = int(np.argmax(np.abs(error)))
    return HeldForce(
        table.level,
        float(error[worst]),
        float(table.frequency_hz[worst]),
        float(np.sqrt(np.mean(error**2))),
        table.rate_hz_s,
    )


def model_responses(
    rig: Rig, forces: Sequence[float], low_hz: float, high_hz: float, channels: Sequence[str], harmonics: int = 7
) -> list[ModelResponse]:
    """Steady responses of the rig's model at held forces.

    Args:
        rig: the rig.
        forces: N.
        low_hz, high_hz: Hz.
        channels: response channels such as ``a1`` (acceleration) or ``x4`` (displacement).
        harmonics: highest order of the balance.

    Raises:
        BenchError: no such point, or no solution.
    """
    from nmt_rig.model.forced_response import ForcedProblem, frequency_response
    from nmt_rig.model.fourier_basis import FourierBasis
    from nmt_rig.model.linear_modes import sticking_modes
    from nmt_rig.rig_model import (
        build_resting_elements,
        build_structure,
        build_system,
        refuse_beyond_harmonic_balance,
    )

    refuse_beyond_harmonic_balance(rig, with_exciter=True)
    structure = build_structure(rig)
    modes = sticking_modes(structure, build_resting_elements(rig, structure), rig.test.mode)
    system = build_system(rig)
    problem = ForcedProblem(system, FourierBasis.up_to(harmonics), float(modes.frequencies[rig.test.mode - 1]))
    curves = []
    for force in dict.fromkeys(forces):
        curve = frequency_response(
            problem, force, 2.0 * math.pi * low_hz, 2.0 * math.pi * high_hz, held="force", points=500
        )
        omega = curve.omega_rad_s
        turn = np.exp(-1j * np.angle(curve.force_amplitudes()))
        rows = []
        for name in channels:
            factor = {"a": -(omega**2), "v": 1j * omega, "x": np.ones_like(omega)}[name[0]]
            rows.append(curve.at_point(int(name[1:])) * turn * factor)
        curves.append(ModelResponse(force, omega / (2.0 * math.pi), tuple(channels), np.stack(rows)))
    return curves
