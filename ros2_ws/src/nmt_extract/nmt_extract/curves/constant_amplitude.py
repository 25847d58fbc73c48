"""Modal properties from nonlinear frequency responses: the single-mode equation solved at equal modal amplitudes.

Near its resonance a structure answers a harmonic force as a single nonlinear mode (paper, eq. 9),

    −Ω² + 2 i Ω ω̃ δ̃ + ω̃² = D,        D = F₁ ψ̄_d / q² = φ̃₁ᴴF / (q e^{iΔΘ}),

with ω̃ and δ̃ functions of q alone. Every measured point of every response, at whatever force, is thus one value of both:

    ω̃² = Ω² + Re D,        2 ω̃ δ̃ = Im D / Ω.

All points of about the same q (both flanks, several forces: a cut through the responses at constant amplitude, where
the structure is as good as linear) are brought together by a locally linear, weighted fit over ln q. That is a fit of
the single-mode equation per amplitude. It needs the same knowledge as phase resonance: Φ for q, and force and motion at
the drive point.

``half_power`` is the classical evaluation of a single response at constant force. Its band of half the power is that of
*different* amplitudes, so with damping or stiffness that depend on amplitude it is wrong by construction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_extract.curves.swept_response import FrequencyResponseTable

_DERIVATIVES = {motion.letter: order for motion, order in MOTIONS.items()}
MOST_DETUNED = 2.0
"""Largest |Re D / Im D| of points that are used: twice the half-power band, beyond it other modes gain weight."""


@dataclass(frozen=True, eq=False)
class SolvedPoints:
    """Both modal properties at every usable point of responses; arrays of shape ``(k,)``.

    Attributes:
        modal_amplitude: q, m√kg.
        square: ω̃² = Ω² + Re D, (rad/s)².
        square_std: its standard uncertainty.
        twice_decay: 2 ω̃ δ̃, rad/s.
        twice_decay_std: its standard uncertainty.
    """

    modal_amplitude: FloatArray
    square: FloatArray
    square_std: FloatArray
    twice_decay: FloatArray
    twice_decay_std: FloatArray

    @classmethod
    def of(cls, parts: Sequence[SolvedPoints]) -> SolvedPoints:
        """The points of several responses together."""
        names = ("modal_amplitude", "square", "square_std", "twice_decay", "twice_decay_std")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True, eq=False)
class AmplitudeFit:
    """Modal properties over amplitude with standard uncertainties; arrays of shape ``(k,)``.

    Attributes:
        modal_amplitude: q, m√kg.
        omega_rad_s, omega_rad_s_std: ω̃, rad/s.
        damping_ratio, damping_ratio_std: δ̃.
        points: number of measured points in each fit.
    """

    modal_amplitude: FloatArray
    omega_rad_s: FloatArray
    omega_rad_s_std: FloatArray
    damping_ratio: FloatArray
    damping_ratio_std: FloatArray
    points: FloatArray


def modal_amplitudes(table: FrequencyResponseTable, linear: LinearDescription) -> FloatArray:
    """q along a response, m√kg, shape ``(k,)``.

    Raises:
        BenchError: a response point is missing.
    """
    return np.asarray(np.linalg.norm(_modal_motion(table, linear), axis=0) * table.force_n, dtype=np.float64)


def solve_points(
    table: FrequencyResponseTable, linear: LinearDescription, most_detuned: float = MOST_DETUNED
) -> SolvedPoints:
    """ω̃² and 2 ω̃ δ̃ at every point of a response near its resonance.

    Args:
        table: responses per force at one level.
        linear: linear modes at the response points.
        most_detuned: largest |Re D / Im D| that is used.

    Raises:
        BenchError: a response point is missing.
    """
    omega = 2.0 * math.pi * table.frequency_hz
    modal = _modal_motion(table, linear)
    size = np.linalg.norm(modal, axis=0)
    rows = _rows(table, linear)
    drive = rows[list(linear.points).index(linear.drive_point)]
    motion = table.frf[drive] / _operator(table.channels[drive], omega)
    stiffness = motion.conj() / size**2
    # dD/D = −Σ u n + conj(Σ (α − u) n) with independent circular noise n of the motions.
    along = (modal.conj() / size**2).T @ np.linalg.pinv(linear.shape_matrix)
    own = np.zeros_like(along)
    own[:, list(linear.points).index(linear.drive_point)] = 1.0 / motion
    noise = np.stack(
        [np.nan_to_num(table.frf_std[row]) / np.abs(_operator(table.channels[row], omega)) for row in rows], axis=1
    )
    relative = np.sqrt(np.sum(noise**2 * (np.abs(along) ** 2 + np.abs(own - along) ** 2), axis=1))
    std = np.abs(stiffness) * relative
    good = (stiffness.imag > 0.0) & (np.abs(stiffness.real) <= most_detuned * stiffness.imag)
    return SolvedPoints(
        (size * table.force_n)[good],
        (omega**2 + stiffness.real)[good],
        std[good],
        (stiffness.imag / omega)[good],
        (std / omega)[good],
    )


def fit_at_amplitudes(
    points: SolvedPoints, modal_amplitudes: Sequence[float] | FloatArray, width: float = 0.3, fewest: int = 4
) -> AmplitudeFit:
    """Modal properties at given amplitudes from the points near them.

    Args:
        points: of all responses.
        modal_amplitudes: q, m√kg; those with too few points near them are left out.
        width: points within this distance in ln q count, with a tricube weight.
        fewest: fewest points of a fit.

    Raises:
        BenchError: no amplitude has enough points.
    """
    place = np.log(points.modal_amplitude)
    rows = []
    for q in modal_amplitudes:
        distance = place - math.log(q)
        near = np.abs(distance) < width
        if np.count_nonzero(near) < fewest:
            continue
        d = distance[near]
        bell = (1.0 - np.abs(d / width) ** 3) ** 3
        # Points on one side only would make the fit extrapolate.
        sloped = d.min() < -0.25 * width and d.max() > 0.25 * width
        if not sloped and float(np.abs(d).max()) > 0.25 * width:
            continue
        square, square_std = _local(d, points.square[near], points.square_std[near], bell, sloped)
        decay, decay_std = _local(d, points.twice_decay[near], points.twice_decay_std[near], bell, sloped)
        omega = math.sqrt(square)
        twice = 2.0 * omega
        rows.append((q, omega, square_std / twice, decay / twice, decay_std / twice, near.sum()))
    if not rows:
        raise BenchError(
            f"At none of the amplitudes there are {fewest} points of the responses; measure more frequencies or forces."
        )
    return AmplitudeFit(*(np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)))


def half_power(table: FrequencyResponseTable, linear: LinearDescription) -> tuple[float, float, float]:
    """Classical evaluation of one response at constant force.

    Returns:
        q at the peak (m√kg), angular frequency of the peak (rad/s), damping ratio (Ω₂ − Ω₁)/(2 Ω_peak) from the band in
        which q is at least 1/√2 of its peak.

    Raises:
        BenchError: the band is not covered by the measured frequencies.
    """
    order = np.argsort(table.frequency_hz)
    omega = 2.0 * math.pi * table.frequency_hz[order]
    q = modal_amplitudes(table, linear)[order]
    top = int(np.argmax(q))
    peak, at = float(q[top]), float(omega[top])
    if 0 < top < q.size - 1:
        near = slice(top - 1, top + 2)
        curve = np.polynomial.Polynomial.fit(omega[near], q[near] ** -2.0, 2)
        vertex = float(curve.deriv().roots()[0].real)
        if omega[top - 1] <= vertex <= omega[top + 1]:
            at, peak = vertex, float(curve(vertex)) ** -0.5
    ratio = (peak / q) ** 2
    below, above = np.flatnonzero(ratio[: top + 1] >= 2.0), np.flatnonzero(ratio[top:] >= 2.0)
    if below.size == 0 or above.size == 0:
        raise BenchError(f"The response at {table.level:g} {table.level_unit} does not cover its half-power band.")
    low, high = int(below[-1]), top + int(above[0])
    first = np.interp(-2.0, -ratio[low : low + 2], omega[low : low + 2])
    last = np.interp(2.0, ratio[high - 1 : high + 1], omega[high - 1 : high + 1])
    return peak, at, float(last - first) / (2.0 * at)


def _local(
    distance: FloatArray, values: FloatArray, stds: FloatArray, bell: FloatArray, sloped: bool
) -> tuple[float, float]:
    """Value at distance 0 of a weighted (locally linear) fit, and the larger of propagated and scatter uncertainty."""
    typical = float(np.median(stds))
    # What is common to all points (a force held inaccurately, a bend) limits what the best of them may weigh.
    floor = max(0.3 * typical, 1e-12 * abs(float(np.mean(values))))
    weight = bell / np.maximum(stds, floor) ** 2
    design = np.stack([np.ones_like(distance), distance], axis=1)[:, : 2 if sloped else 1]
    inverse = np.linalg.inv(design.T @ (design * weight[:, None]))
    filters = inverse @ (design * weight[:, None]).T
    solution = filters @ values
    residual = values - design @ solution
    degrees_of_freedom = max(1, values.size - design.shape[1])
    variance = float(np.sum(weight * residual**2) / np.sum(weight)) * values.size / degrees_of_freedom
    propagated = float(filters[0] ** 2 @ stds**2)
    scatter = float(np.sum(filters[0] ** 2)) * variance
    return float(solution[0]), math.sqrt(max(propagated, scatter))


def _operator(channel: str, omega: FloatArray) -> ComplexArray:
    """Response over displacement, (iΩ)^n."""
    return np.asarray((1j * omega) ** _DERIVATIVES[channel[0]], dtype=np.complex128)


def _rows(table: FrequencyResponseTable, linear: LinearDescription) -> list[int]:
    """Row of each point of the linear description; accelerometers first."""
    rows = []
    for point in linear.points:
        found = [k for k, name in enumerate(table.channels) if name[1:] == str(point) and name[0] in _DERIVATIVES]
        if not found:
            raise BenchError(
                f"The responses have no channel at point {point}, which the linear modes need; they have "
                f"{', '.join(table.channels)}."
            )
        rows.append(min(found, key=lambda k: table.channels[k][0]))
    return rows


def _modal_motion(table: FrequencyResponseTable, linear: LinearDescription) -> ComplexArray:
    """Φ⁺ψ per force, shape ``(modes, k)``."""
    omega = 2.0 * math.pi * table.frequency_hz
    rows = _rows(table, linear)
    motion = np.stack([table.frf[row] / _operator(table.channels[row], omega) for row in rows])
    return np.asarray(np.linalg.pinv(linear.shape_matrix) @ motion)
