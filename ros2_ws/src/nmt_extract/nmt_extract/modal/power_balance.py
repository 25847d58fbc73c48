"""Modal properties of a window whose level still changes: the balance of power instead of a steady state.

A mode that moves with slowly changing amplitude q and frequency Ω obeys

    ω̃² − Ω² = Re(F₁ ψ̄_k,1) / q² − ξ g − g²,        P₁ = Ω d(Ω q² / 2)/dt + ξ Ω² q² / 2,

real and imaginary part of its equation of motion, with the rate of growth g = q̇ / q. Ω is the frequency of
the response, i.e. that of the excitation plus the rate of the response's phase against it. The first corrects
the frequency for a phase error of a loop that lags behind the ramp; the second is the balance of power: what
the exciter feeds goes into the energy of the mode (its action Ω q² / 2 times Ω) and into dissipation. At a
constant level in phase resonance these are eqs. 1 to 4 of the method. They hold as long as the level changes
little over a period and one mode moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray

MINIMUM_PARTS = 5


@dataclass(frozen=True)
class BalancedMode:
    """Modal properties from a balance over a window, with standard uncertainties.

    The amplitude is a mean over the window, weighted with the energy; frequency and damping are those at it.
    """

    omega_rad_s: float
    omega_rad_s_std: float
    damping_ratio: float
    damping_ratio_std: float
    modal_amplitude: float
    modal_amplitude_std: float
    self_excitation: float
    self_excitation_std: float


def part_count(periods: int) -> int:
    """Parts of whole periods that a window is cut into: at least two periods each, ten parts at most."""
    return min(10, periods // 2)


def balance(
    time: FloatArray,
    duration: float,
    omega: FloatArray,
    amplitude: FloatArray,
    power: FloatArray,
    elastic: FloatArray,
    phase: FloatArray,
) -> BalancedMode:
    """Balance over the parts of a window.

    Args:
        time: middle of each part, s since the start of the window, ``(parts,)``.
        duration: s.
        omega: mean excitation frequency Ω of each part, rad/s.
        amplitude: q, m√kg.
        power: P₁, W.
        elastic: Re(F₁ ψ̄_k,1), N m.
        phase: phase of the response against the excitation, rad, not wrapped.

    Returns:
        Properties of the window.

    Raises:
        BenchError: too few parts.
    """
    parts = time.size
    if parts < MINIMUM_PARTS:
        raise BenchError(
            f"A balance of power needs {MINIMUM_PARTS} parts of two periods, the window has {parts}; "
            "lengthen the window."
        )
    place = 2.0 * time / duration - 1.0
    degree = 3 if parts >= 8 else 2
    turning, _ = _rate(place, phase, degree, duration)
    response = omega + turning
    growth, growth_std = _rate(place, np.log(response * amplitude**2), degree, duration)
    # P₁ / E is the excitation of a steady level; growth of the action takes its share of it.
    local = 2.0 * power / (response * amplitude) ** 2 - growth
    q = float(np.average(amplitude, weights=(response * amplitude) ** 2))
    excitation, doubt = _at_amplitude(amplitude, local, q)
    excitation_std = math.hypot(_scatter_of_mean(place, local), growth_std, doubt)
    # Growth at the rate g also takes ξ g + g² from the real part; with ω̃ nearly constant, g is half of that
    # of ω̃ q².
    modal = np.sqrt(response**2 + elastic / amplitude**2 - 0.5 * growth * (local + 0.5 * growth))
    frequency, doubt = _at_amplitude(amplitude, modal, q)
    return BalancedMode(
        omega_rad_s=frequency,
        omega_rad_s_std=math.hypot(_scatter_of_mean(place, modal), doubt),
        damping_ratio=excitation / (2.0 * frequency),
        damping_ratio_std=excitation_std / (2.0 * frequency),
        modal_amplitude=q,
        modal_amplitude_std=_scatter_of_mean(place, amplitude),
        self_excitation=excitation,
        self_excitation_std=excitation_std,
    )


def _at_amplitude(amplitude: FloatArray, values: FloatArray, q: float) -> tuple[float, float]:
    """Value of a property at one amplitude of the window's range, and how far the course over it leaves that open.

    The course is a parabola or two straight lines that meet where slip begins or a gap closes, whichever is nearer to
    the values; the other one says how much depends on that choice.

    Args:
        amplitude: q of each part, m√kg.
        values: of the property in each part.
        q: amplitude that the value is wanted at, m√kg.
    """
    if float(np.ptp(amplitude)) < 1e-3 * q:
        return float(values.mean()), 0.0
    place = np.log(amplitude / q)
    ordered = np.sort(place)
    corners = 0.5 * (ordered[1:] + ordered[:-1])[1:-1]
    courses = [place**2, *(np.maximum(place - corner, 0.0) for corner in corners)]
    at_q = [0.0, *np.maximum(-corners, 0.0)]
    fitted = []
    for third, third_at_q in zip(courses, at_q, strict=True):
        columns = np.stack((np.ones_like(place), place, third), axis=1)
        solution = np.linalg.lstsq(columns, values, rcond=None)[0]
        misfit = float(np.sum((values - columns @ solution) ** 2))
        fitted.append((misfit, float(solution[0] + solution[2] * third_at_q)))
    parabola, bent = fitted[0], min(fitted[1:])
    return min(parabola, bent)[1], 0.5 * abs(parabola[1] - bent[1])


def _rate(place: FloatArray, values: FloatArray, degree: int, duration: float) -> tuple[FloatArray, float]:
    """Rate of change of values with a smooth course at each part, and the standard uncertainty of its mean.

    Args:
        place: middle of each part, −1..1 over the window.
        values: one for each part.
        degree: of the polynomial fitted.
        duration: of the window, s.
    """
    fit = np.polynomial.Polynomial.fit(place, values, degree, domain=[-1.0, 1.0])
    scatter = math.sqrt(float(np.sum((values - fit(place)) ** 2)) / (values.size - degree - 1))
    # How a scatter of the values acts on the mean rate, the difference of the fit's ends.
    ends = np.polynomial.polynomial.polyvander(np.array([1.0, -1.0]), degree)
    weights = (ends[0] - ends[1]) @ np.linalg.pinv(np.polynomial.polynomial.polyvander(place, degree))
    std = scatter * float(np.linalg.norm(weights)) / duration
    return np.asarray(fit.deriv()(place) * 2.0 / duration, dtype=np.float64), std


def _scatter_of_mean(place: FloatArray, values: FloatArray) -> float:
    """Standard uncertainty of the mean, from the scatter about a smooth (quadratic) course over the window."""
    course: Callable[[FloatArray], FloatArray] = np.polynomial.Polynomial.fit(place, values, 2, domain=[-1.0, 1.0])
    residual = values - course(place)
    return math.sqrt(float(np.sum(residual**2)) / (values.size - 3) / values.size)
