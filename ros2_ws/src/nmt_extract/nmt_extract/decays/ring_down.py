"""Modal properties over amplitude from a free decay: tracked amplitude and phase, apparent and corrected by the force.

Around each place of the decay all channels are fitted over a short window by the same decaying oscillation,

    x(t₀ + τ) = Re[(a₀ + a₁ τ + a₂ τ²) e^{s₀ τ}] + harmonics + c₀ + c₁ τ,        s₀ = g₀ + i Ω₀,

weighted least squares with a Hann window; s₀ is iterated until a₁ of the tracked motion vanishes, so an exponential
decay is met exactly, whatever its rate, and the polynomial only has to follow how rate and frequency change over the
window. From a₀, a₁, a₂ follow the phasor, its s = a₁/a₀ + s₀ = ẋ/x and ṡ.

A mode that decays with slowly changing amplitude q and s = g + iΩ under the modal force φ̃₁ᴴF obeys

    s² + ṡ + 2 δ̃ ω̃ s + ω̃² = F ψ̄_d / q²,

so that, real and imaginary part,

    2 δ̃ ω̃ = Im(F ψ̄_d)/(Ω q²) − 2 g − Ω̇/Ω,        ω̃² = Ω² − g² − ġ − 2 δ̃ ω̃ g + Re(F ψ̄_d)/q².

The second term of the first line is the balance of power of :mod:`nmt_extract.power_balance`. Without the force the
result is *apparent*: it belongs to structure and exciter together. A shaker that is switched off still adds the mass of
table and coil, and its coil, closed over the amplifier, brakes. With the recorded force it is that of the structure.

q is the norm of Φ⁺ψ, as at phase resonance (paper, eq. 4).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS

if TYPE_CHECKING:
    from nmt_record.windows.segments import Signals

_ITERATIONS = 8


@dataclass(frozen=True)
class DecaySettings:
    """How a decay is cut into windows.

    Attributes:
        span: by how much ln q falls over a window.
        step: by how much it falls from one window to the next.
        fewest_periods: shortest window.
        most_periods: longest window.
        skip: left out after the switch-off, s: the drive's ramp to zero and what dies quickly.
        harmonics: highest order of the fit.
        worst_damping: relative standard uncertainty of the damping ratio at which the decay has reached the noise.
    """

    span: float = 0.3
    step: float = 0.1
    fewest_periods: float = 6.0
    most_periods: float = 120.0
    skip: float = 0.006
    harmonics: int = 3
    worst_damping: float = 0.25

    def __post_init__(self) -> None:
        if not (self.span > 0 and self.step > 0 and self.skip >= 0 and self.harmonics >= 1):
            raise BenchError("The decay's span, step and harmonics must be positive, its skip not negative.")
        if not 4.0 <= self.fewest_periods <= self.most_periods:
            raise BenchError("A window of a decay needs at least 4 periods, and no more than 'most_periods'.")


@dataclass(frozen=True, eq=False)
class Decay:
    """Modal properties along a decay, with standard uncertainties; every array of shape ``(k,)``.

    Neighbouring windows overlap, so neighbouring values are not independent.

    Attributes:
        time: middle of each window after the first sample, s.
        modal_amplitude: q, m√kg.
        omega_rad_s, omega_rad_s_std: ω̃ of the structure, rad/s.
        damping_ratio, damping_ratio_std: δ̃ of the structure.
        apparent_omega_rad_s, apparent_omega_rad_s_std: ω̃ of structure and exciter, rad/s.
        apparent_damping_ratio, apparent_damping_ratio_std: δ̃ of structure and exciter.
        force_n: amplitude of the force, N.
    """

    time: FloatArray
    modal_amplitude: FloatArray
    omega_rad_s: FloatArray
    omega_rad_s_std: FloatArray
    damping_ratio: FloatArray
    damping_ratio_std: FloatArray
    apparent_omega_rad_s: FloatArray
    apparent_omega_rad_s_std: FloatArray
    apparent_damping_ratio: FloatArray
    apparent_damping_ratio_std: FloatArray
    force_n: FloatArray

    @property
    def size(self) -> int:
        """Number of windows."""
        return int(self.time.size)


@dataclass(frozen=True, eq=False)
class Phasors:
    """Fit of one window.

    Attributes:
        exponent: s₀, rad/s.
        coefficients: a₀, a₁, a₂, shape ``(channels, 3)``.
        covariance: of (Re a₀, Im a₀, Re a₁, …) for unit white noise, shape ``(6, 6)``.
        noise: standard deviation of each channel's residual, shape ``(channels,)``.
    """

    exponent: complex
    coefficients: ComplexArray
    covariance: FloatArray
    noise: FloatArray


def fit_phasors(
    data: FloatArray, sample_rate: float, exponent: complex, harmonics: int = 3, *, fast: bool = False
) -> Phasors:
    """Decaying oscillation of all channels over a window, about its middle.

    Args:
        data: shape ``(channels, samples)``.
        sample_rate: Hz.
        exponent: s₀, rad/s.
        harmonics: highest order.
        fast: the growth changes fast: the amplitude has one power of time more, and harmonics go with its powers.

    Raises:
        BenchError: more unknowns than samples.
    """
    samples = data.shape[1]
    time = (np.arange(samples) - 0.5 * (samples - 1)) / sample_rate
    scale = 0.5 * samples / sample_rate
    place = time / scale
    wave = np.exp(exponent * time)
    columns = []
    for power in range(4 if fast else 3):
        columns += [place**power * wave.real, -(place**power) * wave.imag]
    for order in range(2, harmonics + 1):
        if order * abs(exponent.imag) >= math.pi * sample_rate:
            break
        high = np.exp(((order if fast else 1) * exponent.real + 1j * order * exponent.imag) * time)
        columns += [high.real, -high.imag]
    columns += [np.ones(samples), place]
    design = np.stack(columns, axis=1)
    if samples <= design.shape[1] + 2:
        raise BenchError(f"A window of {samples} samples is too short for a decaying oscillation.")
    weight = np.sin(math.pi * (np.arange(samples) + 0.5) / samples) ** 2
    weighted = design * weight[:, None]
    inverse = np.linalg.inv(design.T @ weighted)
    filters = inverse @ weighted.T
    solution = filters @ data.T
    residual = data.T - design @ solution
    degrees_of_freedom = float(weight.sum() - np.sum(filters.T * weighted))
    noise = np.sqrt(np.maximum(weight @ residual**2, 0.0) / degrees_of_freedom)
    powers = np.repeat(scale ** -np.arange(3.0), 2)
    covariance = (filters @ filters.T)[:6, :6] * np.outer(powers, powers)
    parts = solution[:6].T * powers
    return Phasors(exponent, parts[:, 0::2] + 1j * parts[:, 1::2], covariance, noise)


def ring_down(
    signals: Signals,
    linear: LinearDescription,
    quantity: Quantity,
    frequency_hz: float,
    settings: DecaySettings | None = None,
) -> Decay:
    """Modal properties along a recorded free decay.

    Args:
        signals: samples from the switch-off on.
        linear: linear modes at the response points, for q.
        quantity: of the responses: displacement, velocity or acceleration.
        frequency_hz: at the switch-off, Hz.
        settings: how to cut the decay.

    Raises:
        BenchError: a channel is missing, samples are missing, or the decay does not stand out of the noise.
    """
    force = signals.named(Quantity.FORCE, linear.drive_point)
    names = [signals.named(quantity, point) for point in linear.points]
    if not force or not all(names):
        raise BenchError(
            f"A ring-down needs the force at point {linear.drive_point} and the {quantity.name.lower()} at the points "
            f"{', '.join(map(str, linear.points))}; the recording has {', '.join(signals.channels)}."
        )
    data = np.stack([signals.channels[name] for name in (force[0], *(row[0] for row in names))])
    return decay_of(data, signals.sample_rate, linear, quantity, frequency_hz, settings)


def decay_of(
    data: FloatArray,
    sample_rate: float,
    linear: LinearDescription,
    quantity: Quantity,
    frequency_hz: float,
    settings: DecaySettings | None = None,
) -> Decay:
    """Modal properties along a free decay given as an array.

    Args:
        data: force at the drive point, then the responses at the points of ``linear``, shape ``(1 + points, samples)``.
        sample_rate: Hz.
        linear: linear modes at the response points.
        quantity: of the responses.
        frequency_hz: at the start, Hz.
        settings: how to cut the decay.

    Raises:
        BenchError: samples are missing, or the decay does not stand out of the noise.
    """
    settings = settings or DecaySettings()
    if not np.all(np.isfinite(data)):
        raise BenchError("Samples are missing in the decay; record it again.")
    if not frequency_hz > 0.0 or quantity not in MOTIONS:
        raise BenchError(
            "A ring-down needs the frequency at its start, and displacements, velocities or accelerations."
        )
    inverse: FloatArray = np.linalg.pinv(linear.shape_matrix).astype(np.float64)
    drive = list(linear.points).index(linear.drive_point)
    limits = settings.fewest_periods / frequency_hz, settings.most_periods / frequency_hz
    rows: list[tuple[float, ...]] = []
    end = data.shape[1] / sample_rate
    if settings.skip + 2.0 * limits[0] > end:
        raise BenchError(f"The decay is shorter than {2.0 * settings.fewest_periods:g} periods; record more of it.")
    # How fast it decays is not known yet: a first look decides how long the first window is.
    exponent, length, middle = 0j, 0.0, 0.0
    for factor in (2.0, 1.0):
        length = factor * limits[0]
        start = 2j * math.pi * frequency_hz
        look = window_fit(data, sample_rate, settings.skip + 0.5 * length, length, start, inverse, settings.harmonics)
        if look is not None and look[1].real < 0.0:
            exponent = look[1]
            length = min(float(np.clip(settings.span / -exponent.real, *limits)), end - settings.skip)
            middle = settings.skip + 0.5 * length
            break
    while exponent.real < 0.0:
        # Towards the end of the recording windows get shorter.
        length = min(length, 2.0 * (end - middle))
        if length < limits[0]:
            break
        window = window_fit(data, sample_rate, middle, length, exponent, inverse, settings.harmonics)
        if window is None:
            break
        fit, exponent, centre = window
        row, relative = modal_row(fit, inverse, drive, MOTIONS[quantity])
        if not relative < settings.worst_damping or not exponent.real < 0.0:
            break
        rows.append((centre, *row))
        length = float(np.clip(settings.span / -exponent.real, *limits))
        middle += settings.step / -exponent.real
    if not rows:
        raise BenchError("The decay does not stand out of the noise.")
    return Decay(*(np.array(column) for column in zip(*rows, strict=True)))


def window_fit(
    data: FloatArray,
    sample_rate: float,
    middle: float,
    length: float,
    exponent: complex,
    inverse: FloatArray,
    harmonics: int,
    *,
    fast: bool = False,
) -> tuple[Phasors, complex, float] | None:
    """Fit of a window with its exponent iterated, that exponent and the middle (s); None if nothing decays in it."""
    samples = min(round(length * sample_rate), data.shape[1])
    first = min(max(0, round(middle * sample_rate - 0.5 * samples)), data.shape[1] - samples)
    part = data[:, first : first + samples]
    fit = fit_phasors(part, sample_rate, exponent, harmonics, fast=fast)
    for _ in range(_ITERATIONS):
        modal = inverse @ fit.coefficients[1:]
        # The change that makes a₁ of the motion along its own shape vanish.
        change = complex(np.vdot(modal[:, 0], modal[:, 1]) / np.vdot(modal[:, 0], modal[:, 0]).real)
        exponent += change
        if not (math.isfinite(exponent.real) and exponent.imag > 0.0 and abs(exponent.real) < exponent.imag):
            return None
        fit = fit_phasors(part, sample_rate, exponent, harmonics, fast=fast)
        if abs(change) < 1e-9 * abs(exponent):
            break
    return fit, exponent, (first + 0.5 * (samples - 1)) / sample_rate


def modal_row(fit: Phasors, inverse: FloatArray, drive: int, order: int) -> tuple[tuple[float, ...], float]:
    """Values of a window after its time, and the relative standard uncertainty of the damping ratio.

    Uncertainties by first-order propagation of the residual's white noise.
    """
    modal = inverse @ fit.coefficients[1:, 0]
    size = float(np.linalg.norm(modal))
    along = (modal.conj() / size) @ inverse
    tracked = (along @ fit.coefficients[1:]) / size
    shape_drive = fit.coefficients[1 + drive, 0] / size
    force = fit.coefficients[0, 0]
    noise = float(np.linalg.norm(along * fit.noise[1:])) / size
    at = np.array([*np.stack((tracked.real, tracked.imag), axis=1).ravel(), force.real, force.imag])
    covariance = np.zeros((8, 8))
    covariance[:6, :6] = noise**2 * fit.covariance
    covariance[6:, 6:] = fit.noise[0] ** 2 * fit.covariance[:2, :2]

    def values(point: FloatArray) -> FloatArray:
        return _modal_values(point, fit.exponent, size, shape_drive, order)

    found = values(at)
    jacobian = _jacobian(values, at, np.sqrt(np.diag(covariance)))
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian), 0.0))
    q, omega, damping, apparent_omega, apparent_damping = (float(value) for value in found)
    row = (
        q, omega, std[1], damping, std[2], apparent_omega, std[3], apparent_damping, std[4], float(abs(force))
    )  # fmt: skip
    relative = std[2] / abs(damping) if damping else math.inf
    return tuple(float(value) for value in row), float(relative)


def _modal_values(point: FloatArray, exponent: complex, size: float, shape_drive: complex, order: int) -> FloatArray:
    """q, ω̃, δ̃, apparent ω̃ and δ̃ from (a₀, a₁, a₂ over the size of a₀, force)."""
    zero, one, two, force = point[0::2] + 1j * point[1::2]
    ratio = one / zero
    s = exponent + ratio
    change = 2.0 * two / zero - ratio**2
    # The displacement is the response divided by this operator, whose own change shifts s a little.
    operator = 1.0 if order == 0 else s if order == 1 else s * s + change
    s = s - order * change / s
    growth, omega = s.real, s.imag
    q = size * abs(zero) / abs(operator)
    displacement = size * shape_drive * zero / operator
    modal_force = force * displacement.conjugate() / q**2

    def properties(stiffness: complex) -> tuple[float, float]:
        twice = stiffness.imag / omega - 2.0 * growth - change.imag / omega
        square = omega**2 - growth**2 - change.real - twice * growth + stiffness.real
        frequency = math.sqrt(max(square, 1e-300))
        return frequency, twice / (2.0 * frequency)

    return np.array([q, *properties(modal_force), *properties(0j)])


def _jacobian(function: Callable[[FloatArray], FloatArray], at: FloatArray, steps: FloatArray) -> FloatArray:
    """∂f_i/∂x_j by central differences with steps of the size of the uncertainties."""
    columns = []
    for k in range(at.size):
        step = max(1e-3 * float(steps[k]), 1e-9 * float(np.abs(at).max()))
        move = np.zeros(at.size)
        move[k] = step
        columns.append((function(at + move) - function(at - move)) / (2.0 * step))
    return np.stack(columns, axis=1)


def average_decays(decays: Sequence[Decay], step: float = 0.2) -> Decay:
    """Mean of repeated decays on a common grid of ln q, with the standard uncertainty of the mean.

    Each is interpolated in ln q over its own range; the mean is weighted by the inverse variances. The uncertainty is
    the larger of the propagated one and, from three decays on, that from their scatter.

    Args:
        decays: at least one.
        step: of the grid in ln q.

    Raises:
        BenchError: none given.
    """
    if not decays:
        raise BenchError("There is no decay to average.")
    if len(decays) == 1:
        return decays[0]
    high = max(float(d.modal_amplitude.max()) for d in decays)
    low = min(float(d.modal_amplitude.min()) for d in decays)
    count = math.floor(math.log(high / low) / step + 1e-9) + 1
    grid: FloatArray = math.log(high) - step * np.arange(count, dtype=np.float64)
    columns: dict[str, FloatArray] = {"modal_amplitude": np.exp(grid)}
    for name in ("time", "force_n"):
        columns[name] = np.nanmean([_at(d, getattr(d, name), grid) for d in decays], axis=0)
    for name in ("omega_rad_s", "damping_ratio", "apparent_omega_rad_s", "apparent_damping_ratio"):
        values = np.array([_at(d, getattr(d, name), grid) for d in decays])
        stds = np.array([_at(d, getattr(d, f"{name}_std"), grid) for d in decays])
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
    place = np.log(decay.modal_amplitude)
    order = np.argsort(place)
    return np.asarray(np.interp(grid, place[order], values[order], left=math.nan, right=math.nan))
