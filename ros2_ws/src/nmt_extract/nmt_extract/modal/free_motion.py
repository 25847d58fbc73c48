"""Modal properties as a free motion of a self-excited structure passes an amplitude.

The motion grows or decays by itself through the level's amplitude within the window. Short windows are fitted along it
(:mod:`nmt_extract.modal.growing_oscillation`); each gives ω̃ and δ̃ of the structure at its amplitude, the force of the
exciter's circuit taken into account. A polynomial in ln q through the windows about the level's amplitude gives the
values there.

A motion that grows with the rate g is not the periodic motion of the nonlinear mode. To first order ω̃ differs by the
share (dδ̃/d ln q) (g/ω) where damping depends on the displacement, as in van der Pol's equation, and not at all where
it depends on the velocity. The motion does not tell which, so half of it is taken out, and the bounds are part of the
uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, PointStatus, TestKind
from nmt_extract.judgement import window_judge
from nmt_extract.judgement.window_judge import Remark
from nmt_extract.modal.channel_findings import still_or_cut
from nmt_extract.modal.channels import WindowRows
from nmt_extract.modal.growing_oscillation import Phasors, modal_row, window_fit
from nmt_extract.modal.mode_identity import mode_macs, mode_sentence
from nmt_extract.modal.window import Window

SHORTEST_PERIODS = 3.0
"""Periods of the shortest fitted window; less cannot tell growth from harmonics."""
LONGEST_PERIODS = 12.0
"""Periods of the longest one."""
SPAN = 0.8
"""Change of ln q over a fitted window, where the motion is slow enough for one of at least the shortest length."""
_HARMONICS = 3  # of a fitted window
_PLACES = 25  # of fitted windows along the motion
_NEIGHBOUR = 0.05  # of ln q: amplitude next to the level that is evaluated in its place
_FEWEST = 3  # fitted windows for values
_LEVELLING = 0.1  # of the usual deviation from their median: difference of windows that does not count
_CUT_PERIODS = 10  # of a part that is searched for a cut: what grows reaches it late


def is_free_motion(window: Window) -> bool:
    """Whether a window of a self-excited structure names no whole periods: then it is a free motion."""
    return window.lock.test is TestKind.SELF_EXCITED and window.lock.window_periods == 0


class FreeMotion:
    """A window in which a free motion passes the level's amplitude, on its way to a modal point.

    Args:
        window: all channels.
        linear: linear modes.

    Raises:
        BenchError: the window cannot be evaluated.
    """

    def __init__(self, window: Window, linear: LinearDescription) -> None:
        self.window, self.linear, self.rows = window, linear, WindowRows.of(window, linear)
        self.data = window.data[[self.rows.force, *self.rows.shape]]
        if not np.isfinite(self.data).all():
            raise BenchError("Samples are missing in the free motion; release it again.")
        self._refuse_faulty_channels()
        self.drive = list(linear.points).index(linear.drive_point)
        self.inverse: FloatArray = np.linalg.pinv(linear.shape_matrix).astype(np.float64)
        self.order = MOTIONS[self.rows.shape_quantity]
        self.fits = _fits(self.data, window.sample_rate, window.lock.frequency_hz, self.inverse)
        if len(self.fits) < _FEWEST:
            raise BenchError("The free motion does not stand out of the noise, or is too short for its growth.")

    def _refuse_faulty_channels(self) -> None:
        """A motion that grows has no level before it that says what a faulty channel should be."""
        window, rows = self.window, list(self.rows.shape)
        period = window.sample_rate / window.lock.frequency_hz
        faults: dict[int, str] = {}
        for part in np.array_split(np.arange(window.samples), max(1, round(window.samples / period / _CUT_PERIODS))):
            faults |= still_or_cut(replace(window, data=window.data[:, part]), rows, dict.fromkeys(rows, period))
        if faults:
            words = "; ".join(f"{window.channels[row].name} {why}" for row, why in sorted(faults.items()))
            raise BenchError(f"A channel is faulty, and no level without it says what it should be: {words}.")

    def at_level(self, fits: Sequence[FittedWindow]) -> tuple[FittedWindow, dict[str, float], dict[str, float]]:
        """The nearest fitted window, and values and standard uncertainties at the level's amplitude."""
        phasors = [each.fit for each in fits]
        rows = np.array([modal_row(fit, self.inverse, self.drive, self.order)[0] for fit in phasors])
        lock = self.window.lock
        level = lock.level / _per_displacement(lock.level_unit, phasors, self.order)
        place, values, stds = _at_level(rows, phasors, self.inverse, self.drive, level)
        return fits[place], values, stds

    def point(self) -> ModalPoint:
        """The point; power and mode indicators are NaN, since nothing drives; the force is what the circuit takes.

        Raises:
            BenchError: the motion does not pass the amplitude within the window.
        """
        window, linear, lock = self.window, self.linear, self.window.lock
        nearest, values, stds = self.at_level(self.fits)
        fields = {**values, **{f"{name}_std": std for name, std in stds.items()}}
        remarks = self._bursts(values)
        window_judge.add_parts(fields, remarks)
        fit, operator = nearest.fit, nearest.fit.exponent**self.order if self.order else 1.0
        modal = self.inverse @ fit.coefficients[1:, 0]
        size = float(np.linalg.norm(modal / operator))
        shape = fit.coefficients[1:, 0] / operator
        participation = modal / operator / size
        reference = participation[linear.target_mode]
        turn = np.conj(reference) / abs(reference) if abs(reference) > 0.0 else 1.0 + 0.0j
        scale = values["modal_amplitude"] / size
        harmonics: ComplexArray = np.full((2, len(linear.points)), complex(math.nan, math.nan))
        harmonics[1] = shape * turn * scale
        for suffix in ("", "_std"):
            fields[f"frequency_hz{suffix}"] = fields[f"omega_rad_s{suffix}"] / (2.0 * math.pi)
            fields[f"self_excitation{suffix}"] = 2.0 * fields["omega_rad_s"] * fields[f"damping_ratio{suffix}"]
        measured: dict[str, Any] = fields
        sentences = mode_sentence(shape, linear, fields["omega_rad_s"]), window_judge.words_of(remarks, fields)
        return ModalPoint(
            level_index=lock.level_index,
            status=PointStatus.OK,
            reason=" ".join(filter(None, sentences)),
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
            mac=float(mode_macs(shape, linear)[linear.target_mode]),
            force_n=float(abs(fit.coefficients[0, 0])),
            **measured,
        )

    def _bursts(self, values: dict[str, float]) -> list[Remark]:
        """Stretches in which a channel departs from the motion; the part of each is what changes without it."""
        remarks = []
        for number, row in enumerate((self.rows.force, *self.rows.shape)):
            off = window_judge.burst_parts(
                np.array([each.fit.noise[number] for each in self.fits]),
                np.array([abs(each.fit.coefficients[number, 0]) for each in self.fits]),
            )
            if not off.any():
                continue
            times = [self.fits[k].seconds for k in np.flatnonzero(off)]
            rate = self.window.sample_rate
            first, end = (round(float(pick(times)) * rate) for pick in (np.min, np.max))
            begin = self.window.lock.window_first_sample
            parts = dict(values)
            try:
                _, without, _ = self.at_level([each for each, out in zip(self.fits, off, strict=True) if not out])
            except BenchError:
                without = dict.fromkeys(values, math.nan)
            parts = {
                name: abs(without[name] - value) if math.isfinite(without[name]) else abs(value)
                for name, value in values.items()
            }
            remarks.append(
                Remark(
                    f"{self.window.channels[row].name} departs from its free motion between "
                    f"{(begin + first) / rate:.6g} and {(begin + end) / rate:.6g} s (drop-out, hit or step); release "
                    "it again.",
                    parts,
                )
            )
        return remarks


class FittedWindow(NamedTuple):
    """A fit, and the time of its begin and end after the first sample, s."""

    fit: Phasors
    seconds: tuple[float, float]


def _per_displacement(unit: str, fits: Sequence[Phasors], order: int) -> float:
    """Amplitude of the level's quantity for a unit displacement."""
    omega = float(np.median([fit.exponent.imag for fit in fits]))
    return omega ** next((power for quantity, power in MOTIONS.items() if quantity.accepts(unit)), order)


def _fits(data: FloatArray, rate: float, frequency_hz: float, inverse: FloatArray) -> list[FittedWindow]:
    """Fitted windows along the motion, in time."""
    seconds = data.shape[1] / rate
    found: list[FittedWindow] = []
    start = 2j * math.pi * frequency_hz
    longest = min(LONGEST_PERIODS / frequency_hz, 0.6 * seconds)
    shortest = min(SHORTEST_PERIODS / frequency_hz, longest)
    look = window_fit(data, rate, 0.5 * seconds, min(2.0 * shortest, seconds), start, inverse, _HARMONICS)
    exponent = start if look is None else look[1]
    for middle in np.linspace(0.5 * shortest, seconds - 0.5 * shortest, _PLACES):
        length = min(max(SPAN / max(abs(exponent.real), 1e-9), shortest), longest)
        length = min(length, 2.0 * middle, 2.0 * (seconds - middle))
        if length < shortest * (1.0 - 1e-9):
            continue
        window = window_fit(data, rate, float(middle), length, exponent, inverse, _HARMONICS)
        if window is None:
            continue
        fit, exponent, centre = window
        found.append(FittedWindow(fit, (centre - 0.5 * length, centre + 0.5 * length)))
    return found


def _at_level(
    rows: FloatArray, fits: Sequence[Phasors], inverse: FloatArray, drive: int, level: float
) -> tuple[int, dict[str, float], dict[str, float]]:
    """The nearest fitted window, and values and standard uncertainties at the level's amplitude.

    Raises:
        BenchError: the motion does not pass that amplitude.
    """
    q = rows[:, 0]
    displacements = []
    for fit in fits:
        modal = inverse @ fit.coefficients[1:, 0]
        displacements.append(abs(fit.coefficients[1 + drive, 0]) / float(np.linalg.norm(modal)))
    wanted = level / float(np.median(displacements))
    place = int(np.argmin(np.abs(np.log(q / wanted))))
    if not q.min() <= wanted <= q.max() and abs(math.log(q[place] / wanted)) < _NEIGHBOUR:
        wanted = float(q[place])  # a motion that hardly grows stays next to the level
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
    for name, column in (("omega_rad_s", 1), ("damping_ratio", 3)):
        found = rows[near, column]
        # Windows of small uncertainty differ by how well a polynomial holds, not by their noise.
        typical = _LEVELLING * float(np.median(np.abs(found - np.median(found)))) + 1e-12 * float(np.abs(found).max())
        doubt = np.hypot(rows[near, column + 1], typical + 1e-300)
        weights = doubt.min() / doubt
        powers = np.polynomial.polynomial.polyvander(x, degree)
        coefficients = np.polynomial.polynomial.polyfit(x, found, degree, w=weights)
        scatter = found - powers @ coefficients
        squares = weights**2 / float((weights**2).sum())
        spread = np.linalg.pinv(powers * weights[:, np.newaxis])[0] * weights * rows[near, column + 1]
        values[name] = float(coefficients[0])
        slope = float(coefficients[1]) if name == "damping_ratio" else slope
        # Neighbouring windows share samples: their noise does not average.
        noise = max(float(np.sqrt(squares @ rows[near, column + 1] ** 2)), float(np.linalg.norm(spread)))
        stds[name] = math.hypot(noise, float(np.sqrt(squares @ scatter**2)))
    # A force c(w) v of a motion that grows has a part in phase with w, another than c(v) v; which one it is stays open.
    share = float(-0.5 * slope * rows[place, 7])
    values["omega_rad_s"] = float(values["omega_rad_s"] * (1.0 - share))
    stds["omega_rad_s"] = math.hypot(stds["omega_rad_s"], values["omega_rad_s"] * share / math.sqrt(3.0))
    values["modal_amplitude"] = wanted
    # The level is that of the drive point: how it goes with q is as uncertain as it differs from window to window.
    apart = float(np.std(np.log([displacements[k] for k in near])))
    stds["modal_amplitude"] = wanted * math.hypot(float(rows[place, 4]), apart)
    return place, values, stds
