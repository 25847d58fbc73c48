"""Harmonic force surface: the force over frequency and response amplitude, and what it foretells at constant force.

From curves at several held response amplitudes A. At each of them the dynamic stiffness Z = F e^{iϑ} / A of the
fundamental is close to Z = κ − m Ω² + i c Ω, so that real and imaginary part are fitted by polynomials of second degree
in Ω; over A the coefficients are interpolated by cubic splines of A² (Z is even in A). The force is F = A |Z|. Between
two amplitudes it is known at frequencies that were measured at both; where their bands share none, nothing is known.

At a constant force the points of a response curve lie on a contour of F(Ω, A). A contour that is closed within the
measured amplitudes is an isola. It is born where F has a minimum, and joins another branch at a saddle. It is stated
where a held amplitude lies on it: amplitudes below and above need a larger force at every frequency. Orbits are
stable where the force grows with the amplitude at their frequency, ∂F/∂A > 0; they turn over the frequency where that
passes through zero (for one mode; a loss of stability without a fold shows in Floquet exponents only). The standard
uncertainty of F has the scatter about the fits and the error of the interpolation, told by leaving out each amplitude
in turn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import contourpy
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from nmt_extract.curves import curve_checks
from nmt_extract.curves.response_curve import ResponseCurve

LEAST_CURVES = 4
"""Held amplitudes without which nothing is interpolated."""
_LEAST_POINTS = 4
_DEGREE = 2
_GRID = 241


@dataclass(frozen=True)
class Isola:
    """A branch of responses that is not joined to the one from rest.

    Attributes:
        birth_force, birth_force_std: force at which it is born, N.
        frequency_hz: where, Hz.
        response: |x| at the drive point there, m.
    """

    birth_force: float
    birth_force_std: float
    frequency_hz: float
    response: float

    @property
    def sentence(self) -> str:
        """What it is, for the report."""
        return (
            f"An isola is born at {self.birth_force:.4g} ± {self.birth_force_std:.1g} N, {self.frequency_hz:.4f} Hz "
            f"and a response of {self.response:.4g} m: beyond that force a branch exists that no sweep from rest "
            "reaches."
        )


@dataclass(frozen=True)
class ForceCut:
    """One contour of the surface at a constant force.

    Attributes:
        frequency_hz, response: Hz and m along it, ``(points,)``.
        closed: whether it is closed, an isola.
        slope: ∂F/∂A along it, N/m, ``(points,)``; the orbits are stable where it is positive.
    """

    frequency_hz: FloatArray
    response: FloatArray
    closed: bool
    slope: FloatArray

    @property
    def stable(self) -> FloatArray:
        """1 where the orbit is stable in open loop, 0 where not, ``(points,)``."""
        return np.where(self.slope > 0.0, 1.0, 0.0)

    @property
    def folds(self) -> FloatArray:
        """Frequency (Hz) and response (m) of the places where the contour turns over the frequency, ``(folds, 2)``."""
        before, after = self.slope[:-1], self.slope[1:]
        at = np.flatnonzero(np.sign(before) * np.sign(after) < 0.0)
        share = (before[at] / (before[at] - after[at]))[:, np.newaxis]
        places = np.column_stack([self.frequency_hz, self.response])
        found: FloatArray = places[at] + share * (places[at + 1] - places[at])
        return found[np.argsort(found[:, 0])]


@dataclass(frozen=True, eq=False)
class ForceSurface:
    """Force over frequency and response amplitude.

    Attributes:
        amplitude: held amplitudes, ascending, m, ``(amplitudes,)``.
        reference: frequency that the polynomials are about, rad/s.
        coefficients: of Z / its scale over (Ω / reference − 1), lowest first, N/m, ``(amplitudes, degree + 1)``.
        scatter: standard deviation of Z about its fit, N/m, ``(amplitudes,)``.
        band_hz: lowest and highest frequency measured at each amplitude, Hz, ``(amplitudes, 2)``; nothing is said of
            frequencies outside, where polynomials run away.
    """

    amplitude: FloatArray
    reference: float
    coefficients: ComplexArray
    scatter: FloatArray
    band_hz: FloatArray

    @classmethod
    def of(cls, curves: Sequence[ResponseCurve]) -> ForceSurface:
        """From curves at held response amplitudes; several of one amplitude are joined.

        Raises:
            BenchError: too few amplitudes, or points of one.
        """
        groups: dict[float, list[ResponseCurve]] = {}
        for curve in curves:
            if not curve.holds_force:
                groups.setdefault(curve.level, []).append(curve)
        if len(groups) < LEAST_CURVES:
            raise BenchError(
                f"A force surface needs curves at {LEAST_CURVES} response amplitudes or more, got {len(groups)}; run "
                "--kind response_curve --control response with more --levels."
            )
        rows = []
        for level in sorted(groups):
            joined = [np.concatenate([getattr(c, name) for c in groups[level]]) for name in _NEEDED]
            if joined[0].size < _LEAST_POINTS:
                raise BenchError(
                    f"The curve at {level:g} {groups[level][0].level_unit} has {joined[0].size} points, a force "
                    f"surface needs {_LEAST_POINTS}; give a smaller --spacing."
                )
            rows.append((joined[0], joined[1], joined[2], joined[3]))
        reference = 2.0 * math.pi * float(np.mean(np.concatenate([row[0] for row in rows])))
        fits = [_fit(*row, reference) for row in rows]
        return cls(
            np.array([float(np.mean(row[1])) for row in rows]),
            reference,
            np.array([fit[0] for fit in fits]),
            np.array([fit[1] for fit in fits]),
            np.array([[float(row[0].min()), float(row[0].max())] for row in rows]),
        )

    def stiffness(self, frequency_hz: FloatArray, response: FloatArray) -> ComplexArray:
        """Dynamic stiffness Z at frequencies (Hz) and amplitudes (m) of one shape, N/m."""
        return self._stiffness(np.arange(self.amplitude.size), frequency_hz, response)

    def force(self, frequency_hz: FloatArray, response: FloatArray) -> FloatArray:
        """F = A |Z| at frequencies (Hz) and amplitudes (m) of one shape, N."""
        return np.asarray(response * np.abs(self.stiffness(frequency_hz, response)), dtype=np.float64)

    def force_std(self, frequency_hz: FloatArray, response: FloatArray) -> FloatArray:
        """Standard uncertainty of the force, N."""
        response = np.asarray(response, dtype=np.float64)
        whole = self.force(frequency_hz, response)
        scatter = response * np.interp(response, self.amplitude, self.scatter)
        nearest = np.abs(response[..., np.newaxis] - self.amplitude).argmin(axis=-1)
        change = np.zeros_like(whole)
        for left_out in range(1, self.amplitude.size - 1):
            kept = np.delete(np.arange(self.amplitude.size), left_out)
            other = response * np.abs(self._stiffness(kept, frequency_hz, response))
            change = np.where(nearest == left_out, other - whole, change)
        return np.asarray(np.hypot(scatter, _COARSE_SHARE * change))

    def _stiffness(self, kept: IntArray, frequency_hz: FloatArray, response: FloatArray) -> ComplexArray:
        spline = CubicSpline(self.amplitude[kept] ** 2, self.coefficients[kept])
        found = spline(np.asarray(response) ** 2)
        place = 2.0 * math.pi * np.asarray(frequency_hz) / self.reference - 1.0
        powers = place[..., np.newaxis] ** np.arange(_DEGREE + 1)
        return np.asarray((found * powers).sum(axis=-1))

    def grid(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Frequencies (Hz), amplitudes (m) and forces (N) within what was measured, ``(amplitudes, frequencies)``."""
        responses = np.linspace(self.amplitude[0], self.amplitude[-1], _GRID)
        bands = np.array([self.band(float(response)) for response in responses])
        frequency = np.linspace(bands[:, 0], bands[:, 1], _GRID, axis=1)
        response = np.repeat(responses[:, np.newaxis], _GRID, axis=1)
        force = np.where(self.is_known(frequency, response), self.force(frequency, response), math.nan)
        return frequency, response, force

    def band(self, response: float) -> tuple[float, float]:
        """Lowest and highest frequency (Hz) at an amplitude (m), interpolated between those measured."""
        low, high = (float(np.interp(response, self.amplitude, edge)) for edge in self.band_hz.T)
        return low, high

    def is_known(self, frequency_hz: FloatArray, response: FloatArray) -> BoolArray:
        """Whether frequencies (Hz) were measured at both amplitudes next to responses (m) of one shape."""
        above = np.searchsorted(self.amplitude, response, side="left").clip(0, self.amplitude.size - 1)
        at = np.isclose(self.amplitude[above], response, rtol=1e-9)
        below = np.where(at, above, np.maximum(above - 1, 0))
        low = np.maximum(self.band_hz[below, 0], self.band_hz[above, 0])
        high = np.minimum(self.band_hz[below, 1], self.band_hz[above, 1])
        inside = (self.amplitude[0] <= response) & (response <= self.amplitude[-1])
        return np.asarray(inside & (low <= frequency_hz) & (frequency_hz <= high))

    @property
    def unknown_between(self) -> tuple[int, ...]:
        """Indices of held amplitudes whose band of frequencies shares nothing with that of the next one."""
        pairs = zip(self.band_hz[:-1], self.band_hz[1:], strict=True)
        return tuple(k for k, (one, other) in enumerate(pairs) if curve_checks.overlap(one, other) is None)

    def cut(self, force: float) -> tuple[ForceCut, ...]:
        """Contours at a constant force (N) within what was measured."""
        lines = contourpy.contour_generator(*self.grid()).lines(force)
        return tuple(
            ForceCut(
                line[:, 0],
                line[:, 1],
                bool(len(line) > 2 and np.array_equal(line[0], line[-1])),
                self.force_slope(line[:, 0], line[:, 1]),
            )
            for line in map(np.asarray, lines)
        )

    def force_slope(self, frequency_hz: FloatArray, response: FloatArray) -> FloatArray:
        """∂F/∂A at frequencies (Hz) and amplitudes (m) of one shape, N/m."""
        step = 1e-5 * float(self.amplitude[-1])
        ends = [self.force(frequency_hz, np.asarray(response) + sign * step) for sign in (1.0, -1.0)]
        return np.asarray((ends[0] - ends[1]) / (2.0 * step))

    def valley(self, response: float) -> tuple[float, float]:
        """Frequency (Hz) at which a response (m) needs the least force, and that force (N).

        NaN where the force has no minimum over the frequencies that are known there.
        """
        spline = CubicSpline(self.amplitude**2, self.coefficients)
        stiffness = np.polynomial.Polynomial(spline(response**2))
        size = stiffness * np.polynomial.Polynomial(stiffness.coef.conj())  # |Z|² for real places
        roots = np.polynomial.Polynomial(size.coef.real).deriv().roots()
        places = roots.real[np.abs(roots.imag) < 1e-9]
        frequencies = (1.0 + places) * self.reference / (2.0 * math.pi)
        known = self.is_known(frequencies, np.full(frequencies.size, response))
        if not known.any():
            return math.nan, math.nan
        forces = np.where(known, response * np.abs(stiffness(places)), math.inf)
        least = int(np.argmin(forces))
        return float(frequencies[least]), float(forces[least])

    def isolas(self) -> tuple[Isola, ...]:
        """Isolas on which a held amplitude lies, by ascending force at their birth.

        A minimum of the force over both is one over the amplitude along the valley of least force, which is
        interpolated through the held amplitudes alone.
        """
        valleys = np.array([self.valley(float(response)) for response in self.amplitude])
        scatter = self.amplitude * self.scatter
        found = []
        for k in curve_checks.reached_minima(valleys[:, 1], scatter):
            known = np.flatnonzero(np.isfinite(valleys[:, 1]))
            response, force = self._least_along(valleys, known, k)
            fewer = np.delete(known, np.flatnonzero(known == k)) if known.size > _LEAST_POINTS else known
            change = self._least_along(valleys, fewer, k)[1] - force
            added = (float(valleys[k, 1]) - force) / math.sqrt(3.0)
            frequency = float(CubicSpline(self.amplitude[known], valleys[known, 0])(response))
            force_std = math.hypot(float(scatter[k]), _COARSE_SHARE * change, added)
            found.append(Isola(force, force_std, frequency, response))
        return tuple(sorted(found, key=lambda item: item.birth_force))

    def _least_along(self, valleys: FloatArray, chosen: IntArray, k: int) -> tuple[float, float]:
        """Response (m) and least force (N) next to a held amplitude, on the spline through those that are chosen."""
        spline = CubicSpline(self.amplitude[chosen], valleys[chosen, 1])
        best = minimize_scalar(
            spline,
            bounds=(float(self.amplitude[k - 1]), float(self.amplitude[k + 1])),
            method="bounded",
            options={"xatol": 1e-7 * float(self.amplitude[k])},
        )
        return float(best.x), float(best.fun)


def surface_sentences(curves: Sequence[ResponseCurve]) -> list[str]:
    """What the surface of held responses foretells; nothing where the force was held or the amplitudes are too few."""
    held = [curve for curve in curves if not curve.holds_force]
    if len({curve.level for curve in held}) < LEAST_CURVES:
        return []
    try:
        surface = ForceSurface.of(held)
        isolas = surface.isolas()
    except BenchError as error:
        return [str(error)]
    apart = _words_of_unknown(surface)
    words = [_words_of(surface, isola) for isola in isolas] or [
        "Within what was measured no held amplitude lies on an isola."
    ]
    return [*words, *filter(None, [apart])]


def _words_of_unknown(surface: ForceSurface) -> str:
    """Between which amplitudes nothing is known; empty where all bands overlap."""
    pairs = surface.unknown_between
    if not pairs:
        return ""
    a, band, first = surface.amplitude, surface.band_hz, pairs[0]
    where = f"{a[first]:.3g} and {a[first + 1]:.3g} m"
    if len(pairs) > 1:
        where = f"{len(pairs)} of {a.size - 1} pairs of neighbouring amplitudes, as {where}"
    return (
        f"Of the force between {where} nothing is said: their frequencies, {band[first, 0]:.4g} to "
        f"{band[first, 1]:.4g} Hz and {band[first + 1, 0]:.4g} to {band[first + 1, 1]:.4g} Hz, do not overlap. Give "
        "levels closer together, or lags further apart."
    )


def _words_of(surface: ForceSurface, isola: Isola) -> str:
    """An isola at its birth, and its two folds a tenth of the force beyond, where it is closed there."""
    force = _BEYOND * isola.birth_force
    for cut in surface.cut(force):
        around = cut.frequency_hz.min() <= isola.frequency_hz <= cut.frequency_hz.max()
        if cut.closed and around and len(cut.folds) == 2:
            words = " and ".join(f"{hertz:.4f} Hz ({response:.4g} m)" for hertz, response in cut.folds)
            return (
                f"{isola.sentence} At {force:.4g} N its folds lie at {words}; between them the orbits with the larger "
                "response are stable, those with the smaller one are not."
            )
    return isola.sentence


_BEYOND = 1.1  # of the force at birth, at which folds are named
_NEEDED = ("frequency_hz", "response", "force", "lag")
_COARSE_SHARE = 0.2  # of the change without an amplitude: its neighbours are then twice as far apart


def _fit(
    frequency_hz: FloatArray, response: FloatArray, force: FloatArray, lag: FloatArray, reference: float
) -> tuple[ComplexArray, float]:
    """Coefficients of Z over (Ω / reference − 1), and the standard deviation about them, N/m."""
    stiffness = force / response * np.exp(1j * lag)
    place = 2.0 * math.pi * frequency_hz / reference - 1.0
    powers = place[:, np.newaxis] ** np.arange(_DEGREE + 1)
    coefficients = np.linalg.lstsq(powers.astype(np.complex128), stiffness, rcond=None)[0]
    rest = stiffness - powers @ coefficients
    freedom = max(1, frequency_hz.size - _DEGREE - 1)
    return coefficients, float(np.sqrt((np.abs(rest) ** 2).sum() / freedom / 2.0))
