"""Frequency response from a measured backbone alone: single nonlinear mode plus the other linear modes (paper, eq. 9).

    (−Ω² + 2 i Ω ω̃ δ̃ + ω̃²) q e^{iΔΘ} = φ̃₁ᴴ f₁,        ω̃, δ̃, φ̃₁ functions of q.

Per frequency that is an implicit equation with up to three (or more) solutions where the curve folds. Per amplitude it
is explicit: with g = |φ̃₁ᴴ f₁|/q and X = Ω²,

    X² + 2 ω̃² (2 δ̃² − 1) X + ω̃⁴ − g² = 0    →    Ω² = ω̃² (1 − 2δ̃²) ± √(g² − 4 ω̃⁴ δ̃² (1 − δ̃²)),

so the curve is found by going along the backbone: up to two frequencies for each q, meeting at the peak where the root
vanishes. All solutions at one frequency are the crossings of that curve.

ω̃(q), δ̃(q) and φ̃₁(q) are interpolated along ln q by piecewise cubic polynomials that keep monotone stretches monotone
(PCHIP; real and imaginary parts of the shape separately). Nothing is extrapolated: beyond the measured amplitudes the
response is not known, and the result says between which frequencies.

A single exciter excites the other modes too, so the shape measured at phase resonance holds their share already. It is
taken out, φ̃₁ = (ψ̃₁ − R(ω̃) F₁)/q with the other modes' receptance R, before the synthesis adds R(Ω) f₁; otherwise it
would count twice, which turns the phase of responses far from the drive point by the ratio of that share to the whole.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from nmt_core.errors import BenchError
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import PointStatus, TestKind

_SAME = 2.0e-3  # relative distance of modal amplitudes below which two points of a backbone are averaged


def covers(test: DrivenTest) -> str:
    """What no response can be synthesised of, and what to use instead; empty = one can be."""
    if test.kind in (TestKind.PHASE_RESONANCE, TestKind.UNKNOWN):
        return ""
    if test.kind is TestKind.SELF_EXCITED:
        return (
            f"A synthesis needs a backbone with damping above zero, and {test.words} measures motions that feed "
            "themselves; use a test at phase resonance."
        )
    return f"A synthesis needs a backbone, and {test.words} gives none; use a test at phase resonance."


@dataclass(frozen=True, eq=False)
class SynthesisedBackbone:
    """Measured nonlinear mode over its amplitude.

    Attributes:
        modal_amplitude: q, m√kg, ascending, shape ``(k,)``.
        omega_rad_s: ω̃, rad/s, shape ``(k,)``.
        damping_ratio: δ̃, shape ``(k,)``.
        shape: φ̃₁, 1/√kg, shape ``(k, points)``.
        points: measurement points.
    """

    modal_amplitude: FloatArray
    omega_rad_s: FloatArray
    damping_ratio: FloatArray
    shape: ComplexArray
    points: tuple[int, ...]

    def __post_init__(self) -> None:
        q = self.modal_amplitude
        if q.size < 2 or not (np.all(np.diff(q) > 0) and q[0] > 0):
            raise BenchError("A synthesis needs a backbone of at least two different modal amplitudes above zero.")
        if not (np.all(self.damping_ratio > 0) and np.all(self.damping_ratio < 1) and np.all(self.omega_rad_s > 0)):
            raise BenchError("A synthesis needs damping ratios between 0 and 1 and positive frequencies.")

    @classmethod
    def from_points(cls, points: Sequence[ModalPoint], others: OtherModes | None = None) -> SynthesisedBackbone:
        """From extracted levels in any order; points of (nearly) the same amplitude are averaged.

        Args:
            points: the levels.
            others: other modes whose share is taken out of the measured shapes; None = shapes as measured.

        Raises:
            BenchError: fewer than two usable levels, or levels with different measurement points.
        """
        good = sorted(
            (p for p in points if p.status == PointStatus.OK and math.isfinite(p.modal_amplitude)),
            key=lambda p: p.modal_amplitude,
        )
        if len(good) < 2:
            raise BenchError(
                f"A synthesis needs a backbone of at least two levels; this run has {len(good)} that locked."
            )
        if any(p.points != good[0].points for p in good):
            raise BenchError("The levels of this backbone have different measurement points.")
        groups: list[list[ModalPoint]] = []
        for point in good:
            if groups and point.modal_amplitude <= groups[-1][0].modal_amplitude * (1.0 + _SAME):
                groups[-1].append(point)
            else:
                groups.append([point])
        mean = [
            (
                float(np.mean([p.modal_amplitude for p in group])),
                float(np.mean([p.omega_rad_s for p in group])),
                float(np.mean([p.damping_ratio for p in group])),
                np.mean([_own_shape(p, others) for p in group], axis=0),
            )
            for group in groups
        ]
        q, omega, damping, shape = (np.array(column) for column in zip(*mean, strict=True))
        return cls(q, omega, damping, shape, good[0].points)

    def at(self, modal_amplitude: FloatArray) -> tuple[FloatArray, FloatArray, ComplexArray]:
        """ω̃, δ̃ (shape of q) and φ̃₁ (q, points) at amplitudes; NaN beyond the measured ones."""
        if self._interpolation is None:
            place = np.log(self.modal_amplitude)
            table = np.column_stack((self.omega_rad_s, self.damping_ratio, self.shape.real, self.shape.imag))
            object.__setattr__(self, "_interpolation", PchipInterpolator(place, table, extrapolate=False))
        values = self._interpolation(np.log(modal_amplitude))
        count = len(self.points)
        shape = values[..., 2 : 2 + count] + 1j * values[..., 2 + count :]
        return values[..., 0], values[..., 1], shape

    _interpolation: Any = None


def _own_shape(point: ModalPoint, others: OtherModes | None) -> ComplexArray:
    """φ̃₁ of a level without the share of the other modes, 1/√kg, shape ``(points,)``."""
    if others is None:
        return point.normalised_shape
    receptance = others.receptance(np.array([point.omega_rad_s]))[0]
    share = receptance * point.force_harmonics[1] / point.modal_amplitude
    return np.asarray(point.normalised_shape - share)


@dataclass(frozen=True, eq=False)
class OtherModes:
    """What the modes besides the one under test add, as a receptance at the points for a force at the drive point.

    Attributes:
        lower: lower residual, 1/kg: receptance lower/(−Ω²); complex, shape ``(points,)``.
        upper: upper residual, m/N, shape ``(points,)``.
        frequencies_rad_s: modes added one by one, shape ``(modes,)``; may be empty.
        damping_ratios: of those, shape ``(modes,)``.
        residues: φ_r φ_r,d of those, 1/kg, shape ``(points, modes)``.
        origin: one sentence on where they come from.
    """

    lower: ComplexArray
    upper: ComplexArray
    frequencies_rad_s: FloatArray
    damping_ratios: FloatArray
    residues: FloatArray
    origin: str

    def receptance(self, omega: FloatArray) -> ComplexArray:
        """x/F, m/N, shape ``(k, points)``, at frequencies in rad/s."""
        square = (np.asarray(omega, dtype=np.float64) ** 2)[:, None]
        result = self.lower / -square + self.upper
        if self.frequencies_rad_s.size:
            w, z = self.frequencies_rad_s, self.damping_ratios
            result = result + (1.0 / (w**2 - square + 2j * z * w * omega[:, None])) @ self.residues.T
        return np.asarray(result, dtype=np.complex128)

    @classmethod
    def none(cls, points: Sequence[int]) -> OtherModes:
        """Nothing: the single nonlinear mode alone."""
        nothing = np.zeros(len(points), dtype=np.complex128)
        return cls(nothing, nothing, np.empty(0), np.empty(0), np.empty((len(points), 0)), "no other modes")

    @classmethod
    def from_modes(cls, linear: LinearDescription, points: Sequence[int]) -> OtherModes:
        """The other modes of a linear description one by one.

        Raises:
            BenchError: a point is missing in the description.
        """
        rows = _rows(linear.points, points)
        others = [mode for mode in range(len(linear.frequencies_rad_s)) if mode != linear.target_mode]
        shapes = linear.shape_matrix
        drive = shapes[_rows(linear.points, [linear.drive_point])[0]]
        nothing = np.zeros(len(points), dtype=np.complex128)
        return cls(
            nothing,
            nothing,
            np.array(linear.frequencies_rad_s)[others],
            np.array(linear.damping_ratios)[others],
            (shapes[rows] * drive)[:, others],
            f"{len(others)} other linear modes from the {'model' if linear.source == 'model' else 'linear test'}",
        )

    @classmethod
    def from_file(cls, values: Mapping[str, Any], points: Sequence[int]) -> OtherModes:
        """Residuals ``target_residuals`` of a ``linear.json``; where it has none, its other modes.

        Raises:
            BenchError: a point is missing, or the residuals are malformed.
        """
        linear = LinearDescription.from_mapping(dict(values))
        residuals = values.get("target_residuals")
        if residuals is None:
            return cls.from_modes(linear, points)
        rows = _rows(linear.points, points)
        try:
            lower, upper = (_complex(residuals[name])[rows] for name in ("lower", "upper"))
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise BenchError(
                "The linear description's 'target_residuals' must have 'lower' and 'upper', a pair [real, imaginary] "
                f"for each point: {error}."
            ) from error
        return cls(
            lower,
            upper,
            np.empty(0),
            np.empty(0),
            np.empty((len(points), 0)),
            "lower and upper residual of the linear test",
        )


def _complex(value: Any) -> ComplexArray:
    pairs = np.asarray(value, dtype=np.float64)
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise ValueError("not a list of pairs")
    return np.asarray(pairs[:, 0] + 1j * pairs[:, 1], dtype=np.complex128)


def _rows(known: Sequence[int], wanted: Sequence[int]) -> list[int]:
    try:
        return [list(known).index(point) for point in wanted]
    except ValueError:
        raise BenchError(
            f"The linear description has the points {', '.join(map(str, known))}; the synthesis needs "
            f"{', '.join(map(str, wanted))}."
        ) from None


@dataclass(frozen=True, eq=False)
class SynthesisedCurve:
    """One connected curve of the synthesis, in order along the backbone: up one flank and down the other.

    Attributes:
        omega_rad_s: Ω, rad/s, shape ``(k,)``.
        modal_amplitude: q, m√kg, shape ``(k,)``.
        displacement: x at every point relative to the force's phase, m, shape ``(k, points)``.
    """

    omega_rad_s: FloatArray
    modal_amplitude: FloatArray
    displacement: ComplexArray

    @property
    def acceleration(self) -> ComplexArray:
        """Acceleration, m/s², shape ``(k, points)``."""
        return np.asarray(-(self.omega_rad_s**2)[:, None] * self.displacement)


class Synthesis:
    """Frequency response to a harmonic force at the drive point.

    Args:
        backbone: measured nonlinear mode.
        drive_point: point of the force; must be one of the backbone's points.
        others: the other linear modes.
        force: fundamental force amplitude, N.
        points: amplitudes along the backbone that the curve is made of.

    Raises:
        BenchError: the drive point was not measured, or the force is not positive.
    """

    def __init__(
        self, backbone: SynthesisedBackbone, drive_point: int, others: OtherModes, force: float, points: int = 4000
    ) -> None:
        if drive_point not in backbone.points:
            raise BenchError(
                f"The backbone has no response at the drive point {drive_point} (it has "
                f"{', '.join(map(str, backbone.points))}), so the modal force is not known."
            )
        if not (math.isfinite(force) and force > 0):
            raise BenchError(f"The force of a synthesis must be positive, got {force:g} N.")
        self.backbone = backbone
        self.others = others
        self.force = force
        self._drive = backbone.points.index(drive_point)
        low, high = backbone.modal_amplitude[[0, -1]]
        self._grid = np.unique(np.concatenate((np.geomspace(low, high, points), self._peaks(low, high, points))))
        self._grid = np.clip(self._grid, low, high)
        self.curves = self._curves()

    # -- the curve ------------------------------------------------------------------------------------------------

    def _radicand(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, ComplexArray]:
        """Centre and radicand of Ω², and the state, at amplitudes."""
        omega, damping, shape = self.backbone.at(q)
        g = np.abs(shape[..., self._drive]) * self.force / q
        centre = omega**2 * (1.0 - 2.0 * damping**2)
        radicand = g**2 - 4.0 * omega**4 * damping**2 * (1.0 - damping**2)
        return centre, radicand, omega, shape

    def _peaks(self, low: float, high: float, points: int) -> FloatArray:
        """Amplitudes at which the two frequencies meet: ends of the curves, found to rounding."""
        grid = np.geomspace(low, high, points)
        radicand = self._radicand(grid)[1]
        found = []
        for k in np.flatnonzero(np.diff(np.sign(radicand)) != 0):
            a, b = math.log(grid[k]), math.log(grid[k + 1])
            if radicand[k] == 0.0:
                found.append(grid[k])
                continue
            root = brentq(lambda z: float(self._radicand(np.array([math.exp(z)]))[1][0]), a, b, xtol=1e-14)
            found.append(math.exp(root))
            # Near the meeting point frequencies go with the square root of the distance: refine towards it.
            side = grid[k] if radicand[k] > 0 else grid[k + 1]
            found.extend(found[-1] + (side - found[-1]) * np.geomspace(1e-9, 1.0, 60))
        return np.array(found)

    def _curves(self) -> list[SynthesisedCurve]:
        centre, radicand, _, _ = self._radicand(self._grid)
        scale = np.max(np.abs(centre)) ** 2
        inside = radicand >= -1e-12 * scale
        curves = []
        for run in np.split(np.arange(self._grid.size), np.flatnonzero(np.diff(inside.astype(int))) + 1):
            if run.size < 2 or not inside[run[0]]:
                continue
            q = self._grid[run]
            root = np.sqrt(np.maximum(radicand[run], 0.0))
            flanks = [(q, centre[run] - root), (q[::-1], (centre[run] + root)[::-1])]
            for amplitude, square in flanks if run[-1] == self._grid.size - 1 else [_joined(flanks)]:
                good = square > 0.0
                if np.count_nonzero(good) > 1:
                    curves.append(self._curve(amplitude[good], np.sqrt(square[good])))
        return curves

    def _curve(self, q: FloatArray, frequency: FloatArray) -> SynthesisedCurve:
        return SynthesisedCurve(frequency, q, self._displacement(q, frequency))

    def _displacement(self, q: FloatArray, frequency: FloatArray) -> ComplexArray:
        omega, damping, shape = self.backbone.at(q)
        modal_force = shape[:, self._drive].conj() * self.force
        impedance = omega**2 - frequency**2 + 2j * frequency * omega * damping
        turned = modal_force / impedance
        phase = turned / np.abs(turned)
        nonlinear = shape * (q * phase)[:, None]
        return np.asarray(nonlinear + self.others.receptance(frequency) * self.force)

    # -- per frequency --------------------------------------------------------------------------------------------

    def solutions(self, omega: float) -> list[tuple[float, ComplexArray]]:
        """Every solution at a frequency (rad/s): modal amplitude (m√kg) and displacements (points,) in m.

        Sorted by amplitude, largest first; empty where the backbone's measured amplitudes do not reach.
        """
        found = []
        for curve in self.curves:
            difference = curve.omega_rad_s - omega
            for k in np.flatnonzero(difference[:-1] * difference[1:] <= 0.0):
                if difference[k + 1] == 0.0 and k + 2 < difference.size:
                    continue  # counted with the next interval
                found.append(self._refine(omega, curve.modal_amplitude[k], curve.modal_amplitude[k + 1]))
        amplitudes = sorted({round(math.log(q), 9): q for q in found}.values(), reverse=True)
        return [(q, self._displacement(np.array([q]), np.array([omega]))[0]) for q in amplitudes]

    def _refine(self, omega: float, q_a: float, q_b: float) -> float:
        def residual(z: float) -> float:
            q = np.array([math.exp(z)])
            w, damping, shape = self.backbone.at(q)
            left = (w**2 - omega**2) ** 2 + 4.0 * (omega * w * damping) ** 2
            right = (abs(shape[0, self._drive]) * self.force / q) ** 2
            return float((left / right)[0] - 1.0)

        low, high = sorted((math.log(q_a), math.log(q_b)))
        span = math.log(self.backbone.modal_amplitude[-1] / self.backbone.modal_amplitude[0])
        ends = math.log(self.backbone.modal_amplitude[0]), math.log(self.backbone.modal_amplitude[-1])
        low, high = max(low - 1e-12 * span, ends[0]), min(high + 1e-12 * span, ends[1])
        a, b = residual(low), residual(high)
        if a * b > 0.0:  # the curve touches the frequency between two of its points
            return math.exp(low if abs(a) < abs(b) else high)
        return math.exp(brentq(residual, low, high, xtol=1e-13))

    def response(self, omega: FloatArray, previous: str = "largest") -> ComplexArray:
        """One displacement per frequency, m, shape ``(k, points)``; NaN where the backbone does not reach.

        Args:
            omega: frequencies, rad/s, shape ``(k,)``, in the order of a sweep.
            previous: ``largest``: the solution of the largest amplitude; ``sweep``: where the curve folds, the one
                nearest in amplitude to that of the frequency before, as a sweep in this order follows it.
        """
        result = np.full((len(omega), len(self.backbone.points)), complex(math.nan, math.nan))
        last = math.nan
        for k, frequency in enumerate(omega):
            found = self.solutions(float(frequency))
            if not found:
                continue
            chosen = found[0]
            if previous == "sweep" and math.isfinite(last):
                chosen = min(found, key=lambda item: abs(math.log(item[0] / last)))
            last, result[k] = chosen
        return result

    @property
    def frequency_range(self) -> tuple[float, float]:
        """Lowest and highest frequency of the synthesis, rad/s; NaN if there is none."""
        if not self.curves:
            return math.nan, math.nan
        return (
            min(float(curve.omega_rad_s.min()) for curve in self.curves),
            max(float(curve.omega_rad_s.max()) for curve in self.curves),
        )

    def gaps(self, low: float, high: float) -> list[str]:
        """Sentences on what the backbone does not cover between two frequencies (rad/s); empty if all is covered."""
        if not self.curves:
            return [
                f"At {self.force:g} N the measured backbone has no response at all: its modal amplitudes, "
                f"{self.backbone.modal_amplitude[0]:.3g} to {self.backbone.modal_amplitude[-1]:.3g} m√kg, do not go "
                "with this force."
            ]
        first, last = self.frequency_range
        sentences = []
        if first > low or last < high:
            sentences.append(
                f"At {self.force:g} N the synthesis goes from {first / (2 * math.pi):.2f} to "
                f"{last / (2 * math.pi):.2f} Hz: beyond, the response is smaller than the lowest measured level "
                f"(q = {self.backbone.modal_amplitude[0]:.3g} m√kg)."
            )
        if self._radicand(self.backbone.modal_amplitude[-1:])[1][0] > 0.0:
            sentences.append(
                f"At {self.force:g} N the peak lies above the highest measured level (q = "
                f"{self.backbone.modal_amplitude[-1]:.3g} m√kg); around it nothing is synthesised."
            )
        return sentences


def _joined(flanks: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    return np.concatenate([flank[0] for flank in flanks]), np.concatenate([flank[1] for flank in flanks])


# -- comparison -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ResonanceError:
    """How far a synthesised curve is from a measured one near the resonance.

    Attributes:
        channel: response compared.
        peak_amplitude: peak of the measured |x|, its unit.
        peak_frequency_hz: where, Hz.
        amplitude_error: relative error of the peak amplitude.
        frequency_error: relative error of the peak frequency.
        rms_error: root mean square of |x_s − x_m| over the half-power band of the measurement, divided by its peak;
            amplitude and phase both count.
        modulus_rms_error: the same with the magnitudes only.
        band_hz: half-power band: where |x_m| ≥ peak/√2, Hz.
        points: measured points in it.
    """

    channel: str
    peak_amplitude: float
    peak_frequency_hz: float
    amplitude_error: float
    frequency_error: float
    rms_error: float
    modulus_rms_error: float
    band_hz: tuple[float, float]
    points: int


def peak(frequency: FloatArray, amplitude: FloatArray, fit: int = 2) -> tuple[float, float]:
    """Frequency and height of the largest value; between the points by a parabola.

    The parabola goes through 1/amplitude² of 2 ``fit`` + 1 points, which it fits exactly for one linear mode.

    Args:
        frequency: shape ``(k,)``, monotone.
        amplitude: shape ``(k,)``; NaN are left out.
        fit: points to either side; plain maximum at an end.
    """
    good = np.isfinite(amplitude)
    frequency, amplitude = frequency[good], amplitude[good]
    if amplitude.size == 0:
        return math.nan, math.nan
    top = int(np.argmax(amplitude))
    part = slice(max(0, top - fit), top + fit + 1)
    if top - fit < 0 or top + fit >= amplitude.size:
        return float(frequency[top]), float(amplitude[top])
    x = frequency[part] - frequency[top]
    c0, c1, c2 = np.polynomial.polynomial.polyfit(x, (amplitude[top] / amplitude[part]) ** 2, 2)
    if not c2 > 0.0:
        return float(frequency[top]), float(amplitude[top])
    place = float(np.clip(-c1 / (2.0 * c2), x.min(), x.max()))
    lowest = c0 + c1 * place + c2 * place**2
    if not lowest > 0.0:
        return float(frequency[top]), float(amplitude[top])
    return float(frequency[top] + place), float(amplitude[top] / math.sqrt(lowest))


def resonance_error(
    channel: str,
    frequency: FloatArray,
    measured: ComplexArray,
    synthesised: ComplexArray,
    curve: tuple[FloatArray, FloatArray] | None = None,
) -> ResonanceError:
    """Compare at the measured frequencies.

    Args:
        channel: name.
        frequency: Hz, shape ``(k,)``, monotone.
        measured: complex response relative to the force, shape ``(k,)``.
        synthesised: the same from the synthesis; NaN where there is none.
        curve: frequencies (Hz) and magnitudes along the synthesised curve, for its peak; None, or fewer than 40
            measured points in the half-power band = from ``synthesised``, so that both peaks suffer alike from few
            points.
    """
    modulus = np.abs(measured)
    top = int(np.nanargmax(modulus))
    # Few points across the resonance: the nearest three; a wider parabola would span its asymmetry.
    fit = 2 if np.count_nonzero(modulus >= modulus[top] / math.sqrt(2.0)) >= 40 else 1
    peak_at, height = peak(frequency, modulus, fit)
    if curve is None or fit == 1:
        found_at, found = peak(frequency, np.abs(synthesised), fit)
    else:
        highest = int(np.argmax(curve[1]))
        found_at, found = float(curve[0][highest]), float(curve[1][highest])
    above = modulus >= height / math.sqrt(2.0)
    low = top
    while low > 0 and above[low - 1]:
        low -= 1
    high = top
    while high < frequency.size - 1 and above[high + 1]:
        high += 1
    band = slice(low, high + 1)
    difference = synthesised[band] - measured[band]
    magnitudes = np.abs(synthesised[band]) - np.abs(measured[band])
    ends = sorted((float(frequency[low]), float(frequency[high])))
    return ResonanceError(
        channel,
        height,
        peak_at,
        found / height - 1.0,
        found_at / peak_at - 1.0,
        _rms(difference) / height,
        _rms(magnitudes) / height,
        (ends[0], ends[1]),
        high + 1 - low,
    )


def _rms(values: ComplexArray | FloatArray) -> float:
    """Root mean square of those that are numbers; NaN if none is."""
    good = np.isfinite(values)
    return float(np.sqrt(np.mean(np.abs(values[good]) ** 2))) if np.any(good) else math.nan
