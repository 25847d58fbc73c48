"""Drifts, drop-outs and steps in the samples of a window, and what resolution leaves open."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from nmt_core.messages.modal_point import QUANTITIES
from nmt_core.numerics.arrays import FloatArray
from nmt_signals.channel_faults.converter_faults import CONVERTER_BITS, resolution
from nmt_signals.harmonics import segment_moments, solve_moments, synthesise

_LEAK = 1e-5  # of the fundamental: what a drift may add to it unseen
_SURE = 6.0  # standard deviations
_ROUNDED = math.sqrt(2.0 * 1.2020569) / math.pi**2  # of a step and of the root of it next to the amplitude, see below


def drifting(means: FloatArray, fundamental: FloatArray, noise: FloatArray, samples: int, periods: int) -> list[int]:
    """Channels whose mean changes over the window by so much that it leaks into the fundamental.

    A ramp of height D over N periods adds D/(π N) to the amplitude of the fundamental.

    Args:
        means: of each part of the window, shape ``(parts, channels)``.
        fundamental: amplitude of each channel, shape ``(channels,)``.
        noise: rms of each channel that no harmonic explains, same shape.
        samples: in the window.
        periods: in the window.
    """
    height = np.ptp(means, axis=0)
    scatter = noise / math.sqrt(samples / means.shape[0])
    leaks = height / (math.pi * periods) > _LEAK * fundamental
    return [int(row) for row in np.flatnonzero(leaks & (height > _SURE * scatter) & (fundamental > 0.0))]


def drift_orders(periods: int) -> tuple[int, int]:
    """Order of the polynomial that is taken out, and of the one that it is compared with."""
    order = min(3, max(1, periods // 4))
    return order, order + 2


def without_drift(cycles: FloatArray, data: FloatArray, harmonics: int, order: int) -> FloatArray:
    """Channels without the polynomial of time that least squares finds together with their harmonics.

    Args:
        cycles: excitation phase at each sample, shape ``(samples,)``.
        data: shape ``(channels, samples)``.
        harmonics: H.
        order: of the polynomial; its mean stays.
    """
    place = np.linspace(-1.0, 1.0, data.shape[1])
    columns = np.stack([np.polynomial.legendre.Legendre.basis(power)(place) for power in range(1, order + 1)])
    bounds = np.array([0, data.shape[1]], dtype=np.int64)
    explained = solve_moments(segment_moments(cycles, columns, harmonics, bounds))[0]
    free = columns - np.stack([synthesise(cycles, amplitudes) for amplitudes in explained])
    weights = np.linalg.solve(np.einsum("is,js->ij", free, free), np.einsum("is,cs->ic", free, data))
    return np.asarray(data - np.einsum("ic,is->cs", weights, columns), dtype=np.float64)


def places_of_period(cycles: FloatArray) -> int:
    """At how many different places of the period the samples lie: few where a period is a round number of samples."""
    return int(np.unique(np.round(np.mod(cycles, 1.0), 5) % 1.0).size)


def resolution_floor(values: FloatArray, places: int, noise: float) -> float:
    """Least standard uncertainty of the amplitude of a fundamental, in the unit of the channel.

    Rounding to steps of d has the standard deviation d/√12. Where the samples of all periods fall on the same places
    of the sine it repeats, so only those of one period average, and of them, by the symmetry of the sine, a quarter.
    Under noise of more than half a step it does not, and
    the scatter of the parts of the window shows it. Of values on no grid that can be seen, d is the step of a
    converter of ``CONVERTER_BITS`` over their range.

    However many places there are, a sine of amplitude A that is rounded has the fundamental A + Σ (2 d/(π m)) (−1)ᵐ
    J₁(2 π m A/d), off by √(2 ζ(3)) d/π² √(d/A) in the mean of squares over A.

    Args:
        values: of the channel.
        places: of the period at which samples lie.
        noise: rms without the harmonics.
    """
    step = resolution(values)
    if noise > 0.5 * step > 0.0:
        return 0.0
    step = step or float(np.ptp(values)) / 2**CONVERTER_BITS
    repeats = 4.0 if 2 * places < values.size else 1.0
    scatter = step / math.sqrt(12.0) * math.sqrt(2.0 * repeats / max(places, 2))
    size = 0.5 * float(np.ptp(values))
    return max(scatter, _ROUNDED * step * math.sqrt(step / size)) if size > 0.0 else scatter


def floors(
    force: float, drive: float, shape: float, values: Mapping[str, float], periods: int, indicators: bool
) -> dict[str, float]:
    """Least standard uncertainties of a point, by quantity.

    Args:
        force, drive, shape: least relative uncertainties of the fundamentals.
        values: of the point, by name.
        periods: in the window.
        indicators: mode indicators too. Resolution moves them in second order only; of samples that come from elsewhere
            only their resolution is known.
    """
    relative = {"omega_rad_s": force / (2.0 * math.pi * periods)}
    for quantity in QUANTITIES:
        if quantity.powers is not None and (indicators or not quantity.second_order):
            parts = zip(quantity.powers, (force, drive, shape), strict=True)
            relative[quantity.name] = math.hypot(*(abs(power) * part for power, part in parts if power))
    least = {name: share * abs(values[name]) for name, share in relative.items()}
    least["phase_error"] = math.hypot(force, drive)
    return least
