"""Modal properties as a free motion of a self-excited structure passes an amplitude.

The motion grows or decays by itself through the level's amplitude within the window. Short windows are fitted along it
(:mod:`nmt_extract.ring_down`); each gives ω̃ and δ̃ of the structure at its amplitude, the force of the exciter's circuit
taken into account. A polynomial in ln q through the windows about the level's amplitude gives the values there.

A motion that grows with the rate g is not the periodic motion of the nonlinear mode. To first order ω̃ differs by the
share (dδ̃/d ln q) (g/ω) where damping depends on the displacement, as in van der Pol's equation, and not at all where
it depends on the velocity. The motion does not tell which, so half of it is taken out, and the bounds are part of the
uncertainty.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.modal_point import ModalPoint, Status, bench_time_ns, rejected_point
from nmt_extract.ring_down import Phasors, modal_row, window_fit
from nmt_extract.window import Window

SHORTEST_PERIODS = 3.0
"""Periods of the shortest fitted window; less cannot tell growth from harmonics."""
LONGEST_PERIODS = 12.0
"""Periods of the longest one."""
SPAN = 0.8
"""Change of ln q over a fitted window, where the motion is slow enough for one of at least the shortest length."""
_HARMONICS = 3  # of a fitted window
_PLACES = 25  # of fitted windows along the motion
_BESIDE = 0.05  # of ln q: amplitude beside the level that is evaluated in its place
_FEWEST = 3  # fitted windows for values


def is_free_motion(window: Window) -> bool:
    """Whether a window names no whole periods: then it is a free motion."""
    return window.lock.window_periods == 0


def free_motion_point(
    window: Window, linear: LinearDescription, settings: ExtractionSettings | None = None
) -> ModalPoint:
    """Modal point of a window in which a free motion passes the level's amplitude.

    Args:
        window: from :class:`nmt_extract.window.WindowAssembler`.
        linear: linear modes at the response points.
        settings: None = defaults.

    Returns:
        The point; power and mode indicators are NaN, since nothing drives; the force is what the exciter's circuit
        takes. With status ``REJECTED`` and the reason if the motion does not pass the amplitude within the window.
    """
    try:
        return _point(window, linear, settings or ExtractionSettings())
    except BenchError as error:
        return rejected_point(window.lock, window.sample_rate, str(error))


def _rows(window: Window, linear: LinearDescription) -> tuple[FloatArray, Quantity]:
    """Force at the drive point and responses at the points of the modes, (1 + points, samples)."""
    found = {(channel.quantity, channel.point): row for row, channel in enumerate(window.channels)}
    force = found.get((Quantity.FORCE, linear.drive_point), found.get((Quantity.FORCE, 0)))
    for quantity in MOTIONS:
        rows = [found.get((quantity, point)) for point in linear.points]
        if force is not None and all(row is not None for row in rows):
            return window.data[[force, *[row for row in rows if row is not None]]], quantity
    raise BenchError(
        f"A free motion needs the force at point {linear.drive_point} and one kind of response at the points "
        f"{', '.join(map(str, linear.points))}."
    )


def _point(window: Window, linear: LinearDescription, settings: ExtractionSettings) -> ModalPoint:
    data, quantity = _rows(window, linear)
    if not np.isfinite(data).all():
        raise BenchError("Samples are missing in the free motion; release it again.")
    drive = list(linear.points).index(linear.drive_point)
    inverse: FloatArray = np.linalg.pinv(linear.shape_matrix).astype(np.float64)
    fits = _fits(data, window.sample_rate, window.lock.frequency_hz, inverse)
    if len(fits) < _FEWEST:
        raise BenchError("The free motion does not stand out of the noise, or is too short for its growth.")
    order = MOTIONS[quantity]
    rows = np.array([modal_row(fit, inverse, drive, order)[0] for fit in fits])
    level = window.lock.level / _per_displacement(window.lock.level_unit, fits, order)
    place, values, stds = _at_level(rows, fits, inverse, drive, order, level)
    fit = fits[place]
    modal = inverse @ fit.coefficients[1:, 0]
    operator = (fit.exponent) ** order if order else 1.0
    size = float(np.linalg.norm(modal / operator))
    shape = fit.coefficients[1:, 0] / operator
    participation = modal / operator / size
    reference = participation[linear.target_mode]
    turn = np.conj(reference) / abs(reference) if abs(reference) > 0.0 else 1.0 + 0.0j
    scale = values["modal_amplitude"] / size
    harmonics: ComplexArray = np.full((2, len(linear.points)), complex(math.nan, math.nan))
    harmonics[1] = shape * turn * scale
    target = linear.shape_matrix[:, linear.target_mode]
    mac = float(abs(target @ shape) ** 2 / ((target @ target) * np.vdot(shape, shape).real))
    measured: dict[str, Any] = {**values, **{f"{name}_std": std for name, std in stds.items()}}
    lock = window.lock
    return ModalPoint(
        level_index=lock.level_index,
        status=Status.OK,
        reason="",
        level=lock.level,
        level_unit=lock.level_unit,
        time_ns=bench_time_ns(lock.window_end - 1, window.sample_rate),
        window_first_sample=lock.window_first_sample,
        window_samples=lock.window_samples,
        window_periods=0,
        harmonics=1,
        points=linear.points,
        force_harmonics=np.array([complex(math.nan, math.nan), fit.coefficients[0, 0] * turn]),
        shape_harmonics=harmonics,
        normalised_shape=shape / size * turn,
        participation=participation * turn,
        mac=mac,
        force_n=float(abs(fit.coefficients[0, 0])),
        self_excitation=2.0 * values["omega_rad_s"] * values["damping_ratio"],
        self_excitation_std=2.0 * values["omega_rad_s"] * stds["damping_ratio"],
        **measured,
    )


def _per_displacement(unit: str, fits: list[Phasors], order: int) -> float:
    """Amplitude of the level's quantity for a unit displacement."""
    omega = float(np.median([fit.exponent.imag for fit in fits]))
    return omega ** next((power for quantity, power in MOTIONS.items() if quantity.unit == unit), order)


def _fits(data: FloatArray, rate: float, frequency_hz: float, inverse: FloatArray) -> list[Phasors]:
    """Fitted windows along the motion, in time."""
    seconds = data.shape[1] / rate
    found: list[Phasors] = []
    start = 2j * math.pi * frequency_hz
    longest = min(LONGEST_PERIODS / frequency_hz, 0.6 * seconds)
    shortest = min(SHORTEST_PERIODS / frequency_hz, longest)
    look = window_fit(data, rate, 0.5 * seconds, min(2.0 * shortest, seconds), start, inverse, _HARMONICS, fast=True)
    exponent = start if look is None else look[1]
    for middle in np.linspace(0.5 * shortest, seconds - 0.5 * shortest, _PLACES):
        length = min(max(SPAN / max(abs(exponent.real), 1e-9), shortest), longest)
        length = min(length, 2.0 * middle, 2.0 * (seconds - middle))
        if length < shortest * (1.0 - 1e-9):
            continue
        window = window_fit(data, rate, float(middle), length, exponent, inverse, _HARMONICS, fast=True)
        if window is None:
            continue
        fit, exponent, _ = window
        found.append(fit)
    return found


def _at_level(
    rows: FloatArray, fits: list[Phasors], inverse: FloatArray, drive: int, order: int, level: float
) -> tuple[int, dict[str, float], dict[str, float]]:
    """The nearest fitted window, and values and standard uncertainties at the level's amplitude.

    Raises:
        BenchError: the motion does not pass that amplitude.
    """
    q = rows[:, 0]
    rows = rows.copy()
    rows[:, 5] = [fit.exponent.imag for fit in fits]  # the motion's own frequency, with the growth that it has
    displacements = []
    for fit in fits:
        modal = inverse @ fit.coefficients[1:, 0]
        displacements.append(abs(fit.coefficients[1 + drive, 0]) / float(np.linalg.norm(modal)))
    wanted = level / float(np.median(displacements))
    place = int(np.argmin(np.abs(np.log(q / wanted))))
    if not q.min() <= wanted <= q.max() and abs(math.log(q[place] / wanted)) < _BESIDE:
        wanted = float(q[place])  # a motion that hardly grows stays beside the level
    if not q.min() <= wanted <= q.max():
        raise BenchError(
            f"The free motion passes q = {q.min():.4g} to {q.max():.4g} m√kg in this window, not the level's "
            f"{wanted:.4g}."
        )
    near = np.flatnonzero(np.abs(np.log(q / wanted)) < 0.7)
    if near.size < _FEWEST:
        near = np.argsort(np.abs(np.log(q / wanted)))[:_FEWEST]
    degree = min(3, near.size - 1)
    x = np.log(q[near] / wanted)
    values, stds, slope = {}, {}, 0.0
    for name, column in (("omega_rad_s", 1), ("damping_ratio", 3), ("frequency_hz", 5)):
        weights = 1.0 / np.maximum(rows[near, column + 1], 1e-12 * np.abs(rows[near, column]).max() + 1e-300)
        weights = np.minimum(weights / weights.max(), 1.0)
        coefficients = np.polynomial.polynomial.polyfit(x, rows[near, column], degree, w=np.maximum(weights, 0.2))
        scatter = rows[near, column] - np.polynomial.polynomial.polyval(x, coefficients)
        values[name] = float(coefficients[0])
        slope = float(coefficients[1]) if name == "damping_ratio" else slope
        stds[name] = float(math.hypot(rows[place, column + 1], float(scatter.std())))
    # A force c(w) v of a motion that grows has a part in phase with w, another than c(v) v; which one it is stays open.
    share = float(-0.5 * slope * rows[place, 7])
    values["omega_rad_s"] = float(values["omega_rad_s"] * (1.0 - share))
    stds["omega_rad_s"] = math.hypot(stds["omega_rad_s"], values["omega_rad_s"] * share / math.sqrt(3.0))
    for scaled in (values, stds):
        scaled["frequency_hz"] /= 2.0 * math.pi
    values["modal_amplitude"] = wanted
    stds["modal_amplitude"] = float(wanted * rows[place, 4])
    return place, values, stds
