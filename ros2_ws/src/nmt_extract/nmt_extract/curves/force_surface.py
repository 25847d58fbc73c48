"""Harmonic force surface: the force over frequency and response amplitude, and what it foretells at constant force.

From curves at several held response amplitudes A. At each of them the dynamic stiffness Z = F e^{iϑ} / A of the
fundamental is close to Z = κ − m Ω² + i c Ω, so that real and imaginary part are fitted by polynomials of second degree
in Ω; over A the coefficients are interpolated by cubic splines of A² (Z is even in A). The force is F = A |Z|.

At a constant force the points of a response curve lie on a contour of F(Ω, A). A contour that is closed within the
measured amplitudes is an isola. It is born where F has a minimum, and joins another branch at a saddle. Orbits are
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
from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
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
        return frequency, response, self.force(frequency, response)

    def band(self, response: float) -> tuple[float, float]:
        """Lowest and highest frequency (Hz) of which something is known at an amplitude (m)."""
        low, high = (float(np.interp(response, self.amplitude, edge)) for edge in self.band_hz.T)
        return low, high

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
        """Frequency (Hz) within what was measured at which a response (m) needs the least force, and that force (N)."""
        spline = CubicSpline(self.amplitude**2, self.coefficients)
        stiffness = np.polynomial.Polynomial(spline(response**2))
        size = stiffness * np.polynomial.Polynomial(stiffness.coef.conj())  # |Z|² for real places
        roots = np.polynomial.Polynomial(size.coef.real).deriv().roots()
        ends = [2.0 * math.pi * hertz / self.reference - 1.0 for hertz in self.band(response)]
        inner = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > ends[0]) & (roots.real < ends[1])]
        places = np.array([*ends, *inner])
        forces = response * np.abs(stiffness(places))
        least = int(np.argmin(forces))
        return (1.0 + float(places[least])) * self.reference / (2.0 * math.pi), float(forces[least])

    def isolas(self) -> tuple[Isola, ...]:
        """Isolas by the minima of the force within what was measured, by ascending force at their birth.

        A minimum over both is one over the amplitude along the valley of least force.
        """
        responses = np.linspace(self.amplitude[0], self.amplitude[-1], _GRID)
        forces = np.array([self.valley(float(response))[1] for response in responses])
        found = []
        for k in 1 + np.flatnonzero((forces[1:-1] < forces[:-2]) & (forces[1:-1] < forces[2:])):
            best = minimize_scalar(
                lambda response: self.valley(float(response))[1],
                bounds=(float(responses[k - 1]), float(responses[k + 1])),
                method="bounded",
                options={"xatol": 1e-7 * float(responses[k])},
            )
            response = float(best.x)
            frequency, force = self.valley(response)
            std = float(self.force_std(np.array([frequency]), np.array([response]))[0])
            found.append(Isola(force, std, frequency, response))
        return tuple(sorted(found, key=lambda item: item.birth_force))


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
    return [_words_of(surface, isola) for isola in isolas] or [
        "Within the measured amplitudes the force surface has no isola."
    ]


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
_COARSE_SHARE = 0.2  # of what changes without an amplitude: its neighbours are then twice as far apart


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
