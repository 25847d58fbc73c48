"""Compares the modes that frequency responses show with the model's: is it adequate, and where does a fit start?

Lines on a narrow resonance say nothing about one that is several bandwidths away: between the two every step of a fit
leads astray. Frequencies and dampings of the modes themselves are smooth in the parameters, so that fits that begin
with them arrive. What has them in another order is not to be explained by effects; neither is a mode that the model
lacks and that no effect makes up for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig
from scipy.optimize import least_squares, linear_sum_assignment

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.effects.operating_range import LackingMode
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.fitting import Data, FitResult
from nmt_diagnose.fit.pole_slopes import PoleSlopes, RestingMatrices
from nmt_diagnose.measurements.measurement import Observations, ResponseLines
from nmt_diagnose.observations.observables import FUNDAMENTAL, Part
from nmt_diagnose.prediction.lateness import lateness
from nmt_diagnose.prediction.operating_range import receptances
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import RigParts, rig_parts, same_motion
from nmt_diagnose.prediction.rig_tables import GAIN
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig

# How near the model's modes are brought to the measured ones before lines are fitted.
_FREQUENCY_STD = 1e-3
# The same of damping, which responses show less well.
_DAMPING_STD = 0.1

# Relocations of the poles (Gustavsen and Semlyen 1999).
_VECTOR_FITTING_ROUNDS = 20
# Additional pairs of poles, which noise and modes outside of the band need.
_EXTRA_POLE_PAIRS = 3
# Of the five lines around a pole, those that a channel must have to show it.
_LINES_AROUND = 3
# Relative noise below which lines of a response count alike.
_LEAST_NOISE = 0.01
# Most steps of a search that brings modes together.
_START_STEPS = 40
# Standard deviations of modes: what moves them by less in all moves them by rounding.
_MOVES_BY_ROUNDING = 1e-6
# Step, in prior standard deviations, over which the matrices of a rig are differenced.
_MATRIX_STEP = 1e-6
# Damping ratio below which all dampings count as equal.
_LEAST_DAMPING = 1e-9
# Residual of a model that has no such modes: larger than any that has.
_UNPAIRED_RESIDUAL = 1e3


@dataclass(frozen=True)
class Modes:
    """Oscillating modes, ascending in frequency.

    Attributes:
        poles: eigenvalues with positive imaginary part, rad/s, (k,).
        shapes: of the channels of a test, in any scale, (k, channels).
    """

    poles: ComplexArray
    shapes: ComplexArray

    @property
    def frequencies_hz(self) -> FloatArray:
        """Undamped frequencies, (k,)."""
        return np.abs(self.poles) / (2.0 * np.pi)

    @property
    def dampings(self) -> FloatArray:
        """Damping ratios, (k,)."""
        return -self.poles.real / np.abs(self.poles)

    def likeness(self, other: Modes) -> FloatArray:
        """Modal assurance criterion of each mode with each of another's, (k, others)."""
        squares = [np.sum(np.abs(modes.shapes) ** 2, axis=1) for modes in (self, other)]
        return np.asarray(np.abs(self.shapes.conj() @ other.shapes.T) ** 2 / np.maximum(np.outer(*squares), 1e-300))


def side_by_side(models: Sequence[Modes]) -> Modes:
    """Modes of one structure with the channels of several tests, one after the other.

    The tests may differ by a pole next to critical damping, which rounding makes two real ones; each takes the nearest.
    """
    fewest = min(models, key=lambda each: each.poles.size)
    if not fewest.poles.size:
        return Modes(fewest.poles, np.zeros((0, sum(each.shapes.shape[1] for each in models)), dtype=complex))
    first = models[0].poles
    nearest = [np.argmin(np.abs(first[:, None] - each.poles), axis=1) for each in models]
    return Modes(first, np.hstack([each.shapes[order] for each, order in zip(models, nearest, strict=True)]))


def measured_modes(
    frequency_hz: FloatArray,
    responses: ComplexArray,
    expected: int,
    local: bool = False,
    noise: FloatArray | None = None,
) -> Modes:
    """Modes of frequency responses by vector fitting: poles that all channels share are relocated until they stay.

    Gustavsen and Semlyen, IEEE Trans. Power Delivery 14 (1999) 1052, with all channels on one set of poles. Kept are
    poles that carry much of the response at their frequency in half of the channels. Local ones, such as of a mass on a
    spring far from the force, carry a part of it in two channels; noise has no pole in common.

    Args:
        frequency_hz: lines, ascending, (n,).
        responses: motions over a force or voltage, (channels, n); not a number where a line is missing.
        expected: modes that are expected.
        local: keep local modes, too.
        noise: relative standard deviations of the responses, (channels, n); None = not known.

    Returns:
        Modes within the lines; shapes are residues over 2π times the last line, (k, channels).
    """
    scale = 2.0 * np.pi * frequency_hz[-1]
    s = 2j * np.pi * frequency_hz / scale
    poles = (
        np.geomspace(frequency_hz[0], frequency_hz[-1], expected + _EXTRA_POLE_PAIRS) / frequency_hz[-1] * (-0.01 + 1j)
    )
    known = np.isfinite(responses)
    values = np.where(known, responses, 0.0)
    noise = np.where(known, 0.0 if noise is None else noise, np.inf)
    weights = _LEAST_NOISE / np.hypot(_LEAST_NOISE, noise) / np.maximum(np.abs(values), 1e-300)
    for _ in range(_VECTOR_FITTING_ROUNDS):
        basis = _basis(s, poles)
        columns, right = [], []
        for value, weight in zip(values, weights, strict=True):
            design = np.hstack([basis, np.ones((s.size, 1)), s[:, None]])
            numerator = _real(weight[:, None] * design)
            q = np.linalg.qr(numerator)[0]
            moved = _real(-weight[:, None] * value[:, None] * basis)
            wanted = _real((weight * value)[:, None])
            columns.append(moved - q @ (q.T @ moved))
            right.append(wanted - q @ (q.T @ wanted))
        sigma = np.linalg.lstsq(np.vstack(columns), np.vstack(right)[:, 0], rcond=None)[0]
        state, share = np.zeros((2 * poles.size,) * 2), np.tile([2.0, 0.0], poles.size)
        for k, pole in enumerate(poles):
            state[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
        found = np.linalg.eigvals(state - np.outer(share, sigma))
        found = found[found.imag > 1e-9]
        poles = -np.abs(found.real) + 1j * found.imag
        if not poles.size:
            return Modes(np.zeros(0, dtype=np.complex128), np.zeros((0, len(responses)), dtype=np.complex128))
    return _kept(frequency_hz, values, weights, noise, poles, s, scale, local)


def _kept(
    frequency_hz: FloatArray, values: ComplexArray, weights: FloatArray, noise: FloatArray, poles: ComplexArray,
    s: ComplexArray, scale: float, local: bool,
) -> Modes:  # fmt: skip
    design = np.hstack([_basis(s, poles), np.ones((s.size, 1)), s[:, None]])
    residues, shares = [], []
    at = _basis(np.asarray(1j * poles.imag), poles)
    every = at.reshape(poles.size, poles.size, 2)
    for value, weight in zip(values, weights, strict=True):
        found = np.linalg.lstsq(_real(weight[:, None] * design), _real(weight * value), rcond=None)[0]
        pairs = found[: 2 * poles.size].reshape(-1, 2)
        residues.append(pairs[:, 0] + 1j * pairs[:, 1])
        parts = np.einsum("kjc,jc->kj", every, pairs)
        others = found[-2] + 1j * poles.imag * found[-1]
        # At an antiresonance the sum is zero and any pole is a large share of it; two channels have it at other lines.
        together = np.linalg.norm(np.column_stack((parts, others)), axis=1), np.abs(parts.sum(axis=1) + others)
        shares.append(np.abs(np.diag(parts)) / np.maximum(together, 1e-300))
    # A channel is asked where it has lines around a pole, whose noise is less than the share that is asked for.
    nearest = np.argmin(np.abs(poles.imag[:, None] - s.imag), axis=1)
    around = np.clip(nearest[:, None] + np.arange(-2, 3), 0, s.size - 1)
    doubt = THRESHOLDS.modes.missed_sigmas * np.sort(noise[:, around], axis=2)[:, :, _LINES_AROUND - 1]
    of_parts, of_sums = np.moveaxis(np.array(shares), 1, 0)
    damping = -poles.real / np.abs(poles)
    in_hz = scale / (2.0 * np.pi)
    wide = _wider_than_lines(-2.0 * poles.real * in_hz, poles.imag * in_hz, frequency_hz)
    inside = (poles.imag > s[0].imag) & (poles.imag < s[-1].imag)
    good = (
        inside
        & wide
        & (damping < THRESHOLDS.modes.highest_measured_damping)
        & _carries(of_parts, of_sums, doubt, local)
    )
    order = np.flatnonzero(good)[np.argsort(poles.imag[good])]
    return Modes(poles[order] * scale, np.array(residues).T[order])


def _carries(of_parts: FloatArray, of_sums: FloatArray, doubt: FloatArray, local: bool) -> NDArray[np.bool_]:
    """Whether poles carry enough of the responses to be modes.

    Args:
        of_parts: their shares of the parts of all poles, (channels, k).
        of_sums: the same of the response, which is their sum.
        doubt: shares that noise makes, (channels, k); infinite where a channel has no lines around.
        local: whether two channels are enough, or one of known noise without another part of that size.
    """
    limits = THRESHOLDS.modes
    main = np.where(doubt < limits.mode_share, of_parts, np.nan)
    main[:, np.isnan(main).all(axis=0)] = 0.0
    largely = np.asarray(np.nanmedian(main, axis=0) > limits.mode_share)
    if not local:
        return largely
    second = np.sort(np.where(doubt < limits.missing_share, of_sums, 0.0), axis=0)[-2:][0]
    clear = np.any((of_parts > np.maximum(limits.mode_share, 2.0 * doubt)) & (doubt > 0.0), axis=0)
    return np.asarray((second > limits.missing_share) | clear | largely)


def _basis(s: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """Real-coefficient partial fractions of pairs of poles, (n, 2 pairs)."""
    one, other = 1.0 / (s[:, None] - poles), 1.0 / (s[:, None] - poles.conj())
    return np.stack([one + other, 1j * (one - other)], axis=2).reshape(s.size, -1)


def _real(values: ComplexArray) -> FloatArray:
    return np.concatenate([values.real, values.imag])


def modes_that_lack(
    name: str, band_hz: tuple[float, float], found: Modes, which: np.ndarray
) -> list[tuple[float, str]]:
    """Modes that the model seems to lack: frequency in Hz and a sentence each.

    Args:
        name: of the test.
        band_hz: its first and last line; near them responses may be so small that noise passes for a mode.
        found: its modes, k of them.
        which: the model's mode of each, -1 where it has none, (k,).
    """
    low, high = THRESHOLDS.modes.edge_ratio * band_hz[0], band_hz[1] / THRESHOLDS.modes.edge_ratio
    frequency_hz = found.frequencies_hz
    return [
        (
            float(frequency_hz[k]),
            f"{name} has a mode at {frequency_hz[k]:.4g} Hz (damping {100 * found.dampings[k]:.2g} %) that the model "
            "lacks; add it to the model, or leave its band out.",
        )
        for k in np.flatnonzero((which < 0) & (frequency_hz > low) & (frequency_hz < high))
    ]


def paired(found: Modes, model: Modes, likeness: FloatArray) -> NDArray[np.int64]:
    """The model's mode of each that was found, (k,); -1 where it has none that is near or alike.

    Args:
        found: k modes of responses.
        model: those of the model.
        likeness: modal assurance criterion of each with each, (k, modes).
    """
    limits, which = THRESHOLDS.modes, np.full(found.poles.size, -1)
    if not model.poles.size:
        return which
    apart = np.abs(np.log(found.frequencies_hz[:, None] / model.frequencies_hz[None]))
    measured, modelled = linear_sum_assignment(apart + (1.0 - likeness))
    near = apart[measured, modelled]
    sure = (near < limits.near_log_frequency) | (
        (likeness[measured, modelled] > limits.unlike_mac) & (near < limits.apart_log_frequency)
    )
    which[measured[sure]] = modelled[sure]
    return which


def moved(found: Modes, model: Modes, likeness: FloatArray, which: NDArray[np.int64]) -> NDArray[np.int64]:
    """Pairs (k,) with those that lie far apart and are alike: where responses have no more modes, these have moved."""
    which = which.copy()
    alone, free = np.flatnonzero(which < 0), np.setdiff1d(np.arange(model.poles.size), which)
    if alone.size and free.size:
        measured, modelled = linear_sum_assignment(-likeness[np.ix_(alone, free)])
        alike = likeness[alone[measured], free[modelled]] > THRESHOLDS.modes.alike_mac
        which[alone[measured[alike]]] = free[modelled[alike]]
    return which


def more_modes(found: Modes, model: Modes, lines: FloatArray, which: np.ndarray) -> bool:
    """Whether responses show more resonances in their band than the model has there or just outside.

    What moves the modes that the model has, such as a mass, adds none. A mode of the model that is too narrow for the
    lines, and that no resonance is, could not have been found and does not count.

    Args:
        found: modes of the responses, k of them.
        model: those of the model.
        lines: Hz, ascending, (n,).
        which: the model's mode of each that was found, -1 where it has none, (k,).
    """
    reach, hertz = math.exp(THRESHOLDS.modes.near_log_frequency), model.frequencies_hz
    there = (hertz > lines[0] / reach) & (hertz < lines[-1] * reach)
    shown = _wider_than_lines(2.0 * model.dampings * hertz, hertz, lines)
    shown[which[which >= 0]] = True
    return found.poles.size > int((there & shown).sum())


def _wider_than_lines(width_hz: FloatArray, frequency_hz: FloatArray, lines: FloatArray) -> NDArray[np.bool_]:
    """Which resonances are wide enough for the lines to distinguish them from noise."""
    spacing = np.interp(frequency_hz, lines, np.gradient(lines))
    return np.asarray(width_hz > THRESHOLDS.modes.least_width_lines * spacing)


def disorder(name: str, found: Modes, which: np.ndarray, likeness: FloatArray) -> list[tuple[float, str]]:
    """Modes in another order than the model's, which no fit brings to each other: frequency in Hz and a sentence each.

    Args:
        name: of the test.
        found: its modes, k of them.
        which: the model's mode of each, -1 where it has none, (k,).
        likeness: modal assurance criterion of each with each of the model's, (k, modes).
    """
    frequency_hz, result = found.frequencies_hz, []
    for a, b in pairwise(np.flatnonzero(which >= 0)):
        if which[a] > which[b] and max(likeness[a, which[b]], likeness[b, which[a]]) < THRESHOLDS.modes.alike_mac:
            sentence = (
                f"{name} has the modes at {frequency_hz[a]:.4g} and {frequency_hz[b]:.4g} Hz in the other order than "
                "the model; correct the model first."
            )
            result.append((float(frequency_hz[a]), sentence))
    return result


class _Looked(NamedTuple):
    """Responses of a test and their relative noise, both (channels, lines), and the model's modes at these channels."""

    test: ResponseLines
    lines: FloatArray
    responses: ComplexArray
    noise: FloatArray
    model: Modes

    def over(self, lines: FloatArray, values: NDArray[Any]) -> NDArray[Any]:
        """Values (channels, n) over more lines, not a number where the test has none."""
        result = np.full((len(values), lines.size), np.nan, dtype=values.dtype)
        result[:, np.searchsorted(lines, self.lines)] = values
        return result


class _Together(NamedTuple):
    """Tests that meet one rig with the same modes: a mode is what all of their channels share."""

    test: ResponseLines
    name: str
    lines: FloatArray
    responses: ComplexArray
    noise: FloatArray
    model: Modes

    @classmethod
    def of(cls, looked: Sequence[_Looked]) -> _Together:
        """Of several tests: their channels one after the other over the lines of all."""
        lines = np.unique(np.concatenate([each.lines for each in looked]))
        first, others = looked[0].test.name, len(looked) - 1
        name = f"{first} with {others} more" if others else first
        model = side_by_side([each.model for each in looked])
        responses, noise = (
            np.vstack([each.over(lines, values) for each, values in zip(looked, several, strict=True)])
            for several in ([each.responses for each in looked], [each.noise for each in looked])
        )
        return cls(looked[0].test, name, lines, responses, noise, model)

    @property
    def band_hz(self) -> tuple[float, float]:
        """First and last line."""
        return float(self.lines[0]), float(self.lines[-1])

    def found(self, local: bool = False) -> Modes:
        """Modes of the responses."""
        inside = (self.model.frequencies_hz > self.lines[0]) & (self.model.frequencies_hz < self.lines[-1])
        return measured_modes(self.lines, self.responses, int(inside.sum()), local, self.noise)


class LowLevelModes:
    """Modes of the random tests and linear responses of some observations.

    Args:
        observations: the real side.
        rig: the model as given.
    """

    def __init__(self, observations: Observations, rig: Rig) -> None:
        self.rig = rig
        self.tests: list[tuple[ResponseLines, Modes, np.ndarray]] = []
        self.disordered: tuple[str, ...] = ()
        self._lacking: list[tuple[float, str]] = []
        self._looked: dict[_Key, list[_Looked]] = {}
        late = lateness(observations, rig)
        for number, test in enumerate(observations.tests):
            if test.lines is not None and (lines_hz := test.lines.modal_hz) is not None:
                self._add(number, test.lines, lines_hz, observations, late)
        self.compare()

    def _add(
        self,
        number: int,
        test: ResponseLines,
        lines: FloatArray,
        observations: Observations,
        late: dict[tuple[int, int], float],
    ) -> None:
        """Keep the modes of a test; delays of its channels (s) are taken off, as they are not poles."""
        rows = observations.rows
        responses = np.full((len(test.channels), lines.size), np.nan, dtype=np.complex128)
        noise = np.full(responses.shape, np.nan)
        for row in np.flatnonzero((rows.test == number) & (rows.part == Part.LOG_MAGNITUDE)):
            responses[rows.channel[row], rows.level[row]] = math.exp(observations.values[row])
            noise[rows.channel[row], rows.level[row]] = observations.std[row]
        for row in np.flatnonzero((rows.test == number) & (rows.part == Part.PHASE)):
            channel = int(rows.channel[row])
            advance = 2.0 * np.pi * rows.frequency_hz[row] * late.get((number, channel), 0.0)
            responses[channel, rows.level[row]] *= np.exp(1j * (observations.values[row] + advance))
        usable = np.isfinite(lines)
        lines, responses, noise = lines[usable], responses[:, usable], noise[:, usable]
        turned = rows.channel[(rows.test == number) & (rows.part == Part.PHASE)]
        kept = (np.isfinite(responses).sum(axis=1) >= THRESHOLDS.modes.fewest_lines) & np.isin(
            np.arange(len(responses)), turned
        )
        model = self.modes(self.rig, test)
        if model is None or not kept.any() or not lines.size:
            return
        self._looked.setdefault(_key(test), []).append(
            _Looked(test, lines, responses[kept], noise[kept], Modes(model.poles, model.shapes[:, kept]))
        )

    def compare(self) -> None:
        """Pair the modes that tests show together with those of the model, and keep what is paired and what is not."""
        self._together = [_Together.of(looked) for looked in self._looked.values()]
        for together in self._together:
            self._compare(together)

    def _compare(self, together: _Together) -> None:
        found, model = together.found(), together.model
        if not found.poles.size or not model.poles.size:
            return
        likeness = found.likeness(model)
        which = paired(found, model, likeness)
        if not more_modes(found, model, together.lines, which):
            which = moved(found, model, likeness, which)
        for frequency, sentence in modes_that_lack(together.name, together.band_hz, found, which):
            if all(
                abs(math.log(frequency / reported_hz)) >= THRESHOLDS.modes.same_log_frequency
                for reported_hz, _ in self._lacking
            ):
                self._lacking.append((frequency, sentence))
        self.disordered += tuple(sentence for _, sentence in disorder(together.name, found, which, likeness))[:1]
        used = which >= 0
        if used.any():
            self.tests.append((together.test, Modes(found.poles[used], found.shapes[used]), which[used]))

    @cached_property
    def missing(self) -> tuple[LackingMode, ...]:
        """Modes that make more resonances than the model has in a band, all tables over it taken together."""
        result: list[LackingMode] = []
        for together in self._together:
            test, lines, model, band_hz = together.test, together.lines, together.model, together.band_hz
            found = together.found(local=True)
            which = paired(found, model, found.likeness(model))
            if not more_modes(found, model, lines, which):
                continue
            for pole in map(complex, found.poles[which < 0]):
                apart = [abs(math.log(abs(pole) / abs(known.pole))) for known in result]
                if all(value >= THRESHOLDS.modes.same_log_frequency for value in apart):
                    receptance = receptances(self.rig, pole, test.divisor is not None)
                    result.append(LackingMode(pole, band_hz, receptance))
        return tuple(result)

    def lacking(self, data: Data, found: FitResult, certain: bool = False) -> tuple[str, ...]:
        """Sentences on modes that the model lacks: channels miss what is around them in the best fit.

        Noise, filters and effects make poles, too. A pole whose rows an explanation fits is not a lacking mode.

        Args:
            data: what was fitted.
            found: the fit.
            certain: only those that no effect can imitate.
        """
        limits = THRESHOLDS.modes
        missed_from = limits.certain_sigmas if certain else limits.missed_sigmas
        share = limits.certain_channel_share if certain else limits.mode_share
        rows, left = data.observations.rows, data.residual(found.prediction.values, found.errors.chain)
        result = []
        for frequency, sentence in self._lacking:
            with np.errstate(divide="ignore", invalid="ignore"):
                near = np.abs(np.log(rows.frequency_hz / frequency)) < THRESHOLDS.modes.around_log_frequency
            near &= data.used & np.isin(rows.part, FUNDAMENTAL) & (rows.harmonic < 0)
            missed = []
            for channel in np.unique(rows.channel[near]):
                selected = near & (rows.channel == channel)
                missed.append(math.sqrt(float(np.mean(left[selected] ** 2))) > missed_from)
            if missed and np.mean(missed) >= share:
                result.append(sentence)
        return tuple(result)

    def modes(self, rig: Rig, test: ResponseLines) -> Modes | None:
        """Modes of a rig as a test meets it, local forces at rest; None where it cannot be taken apart."""
        parts = _parts(rig, test)
        return None if parts is None else _modes_of(parts)

    def far_from(self, rig: Rig) -> bool:
        """Whether a mode of a rig lies beyond the half-power bandwidth of the measured one, or this beyond its own."""
        for test, found, which in self.tests:
            modes = self.modes(rig, test)
            if modes is None or which.max() >= modes.poles.size:
                return True
            off = np.abs(found.poles - modes.poles[which])
            if np.any(off > np.minimum(-found.poles.real, -modes.poles.real[which])):
                return True
        return False

    def residual(self, parametrisation: Parametrisation, theta: FloatArray) -> FloatArray:
        """Parameters over their prior deviations, then measured minus the model's modes over σ.

        Args:
            parametrisation: parameters.
            theta: their values.
        """
        result = [theta / parametrisation.prior_std]
        known: dict[_Key, Modes | None] = {}
        try:
            rig: Rig | None = parametrisation.rig(theta)
        except (BenchError, ValueError, ArithmeticError):
            rig = None
        for test, found, which in self.tests:
            key = _key(test)
            if key not in known:
                known[key] = None if rig is None else self.modes(rig, test)
            modes = known[key]
            if modes is None or which.max() >= modes.poles.size:
                result.append(np.full(2 * which.size, _UNPAIRED_RESIDUAL))
                continue
            result.append(np.log(found.frequencies_hz / modes.frequencies_hz[which]) / _FREQUENCY_STD)
            ratio = np.maximum(found.dampings, _LEAST_DAMPING) / np.maximum(modes.dampings[which], _LEAST_DAMPING)
            result.append(np.log(ratio) / _DAMPING_STD)
        return np.concatenate(result)

    def jacobian(self, parametrisation: Parametrisation, theta: FloatArray) -> FloatArray:
        """Derivatives of ``residual`` by the parameters, (m, n): of the poles in closed form.

        The matrices of the rig are low polynomials of most parameters; their differences are as good as derivatives.

        Args:
            parametrisation: parameters.
            theta: their values, (n,).
        """
        blocks = [np.diag(1.0 / parametrisation.prior_std)]
        known: dict[_Key, _Slopes | None] = {}
        for test, _, which in self.tests:
            key = _key(test)
            if key not in known:
                number = 1 + max(int(other.max()) for it, _, other in self.tests if _key(it) == key)
                known[key] = _slopes(parametrisation, theta, test, number)
            found = known[key]
            if found is None or which.max() >= found.poles.size:
                blocks.append(np.zeros((2 * which.size, theta.size)))
                continue
            poles, slopes = found.poles[which, None], found.slopes[which]
            # The clock divides all poles and leaves dampings as they are.
            relative = slopes / poles
            blocks.append(-(relative.real - found.clocks) / _FREQUENCY_STD)
            damped = slopes.real / poles.real - relative.real
            ratios = -poles.real / np.abs(poles)
            blocks.append(np.where(ratios > _LEAST_DAMPING, -damped, 0.0) / _DAMPING_STD)
        return np.vstack(blocks)

    def exceed_priors(self, parametrisation: Parametrisation, theta: FloatArray) -> bool:
        """Whether parameters reach the measured modes only by implausible values, or not at all."""
        return (
            float(np.sum(self.residual(parametrisation, theta) ** 2))
            > parametrisation.size + 2.0 * THRESHOLDS.comparison.credible_sigmas**2
        )

    def start(self, parametrisation: Parametrisation, theta: FloatArray) -> tuple[FloatArray, float]:
        """Parameters that bring the model's modes to the measured ones from some others, and the squared residual."""
        begin = np.where(np.isfinite(parametrisation.lower), np.maximum(theta, parametrisation.lower + 1e-6), theta)
        solved = least_squares(
            lambda values: self.residual(parametrisation, values), begin,
            lambda values: self.jacobian(parametrisation, values), bounds=(parametrisation.lower, np.inf),
            x_scale=parametrisation.prior_std,
            max_nfev=_START_STEPS,
        )  # fmt: skip
        return solved.x, 2.0 * float(solved.cost)

    def promises(
        self, parametrisation: Parametrisation, theta: FloatArray, more: Sequence[tuple[Parametrisation, FloatArray]]
    ) -> list[float]:
        """What would be left to first order with one more parameter, its effect switched on a little.

        Infinite where the effect moves no mode, such as a force that grows with a power of the motion.

        Args:
            parametrisation: parameters.
            theta: their values.
            more: parameters that continue ``parametrisation``, and their values.
        """
        now = self.residual(parametrisation, theta)
        q = np.linalg.qr(self.jacobian(parametrisation, theta))[0]
        projected = now - q @ (q.T @ now)
        result = []
        for wider, values in more:
            moved = self.residual(wider, values)
            moved = np.concatenate([moved[: parametrisation.size], moved[wider.size :]]) - now
            moved -= q @ (q.T @ moved)
            square, most = float(moved @ moved), float(projected @ projected)
            moves = square > _MOVES_BY_ROUNDING**2
            result.append(most - float(projected @ moved) ** 2 / square if moves else math.inf)
        return result


def _parts(rig: Rig, test: ResponseLines, near: RigParts | None = None) -> RigParts | None:
    """A rig under the conditions of a test, built near a similar one; None where it cannot be taken apart."""
    try:
        return rig_parts(
            rig, test.channels, FourierBasis.up_to(1), PredictionSettings(),
            _middle_s(test), ideal_force=test.divisor is not None, near=near,
        )  # fmt: skip
    except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError):
        return None


def _modes_of(parts: RigParts) -> Modes | None:
    """Modes of a rig with its local forces at rest; None where these are without bounds."""
    linear, r = parts.linear, parts.coordinates
    displacement_shapes = linear.displacement[:r]
    with np.errstate(over="ignore", invalid="ignore"):  # a search may go where a force is without bounds
        stiffness, damping = parts.resting
        state = np.diag(linear.poles) - linear.inputs[:, :r] @ (
            stiffness[:, None] * displacement_shapes + damping[:, None] * displacement_shapes * linear.poles
        )
    if not np.isfinite(state).all():
        return None
    values, rows, vectors = eig(state, left=True)
    kept = (values.imag > 0.0) & (-values.real < THRESHOLDS.modes.highest_model_damping * np.abs(values))
    order = np.flatnonzero(kept)[np.argsort(np.abs(values[kept]))]
    s = values[order]
    full = (linear.displacement[r:], linear.velocity[r:], linear.acceleration[r:])
    shapes = sum((block @ vectors[:, order]) * s**power for power, block in enumerate(full))
    # Residues: an eigenvector has any scale, and tests of other channels have another one.
    size = np.einsum("nk,nk->k", rows[:, order].conj(), vectors[:, order])
    shapes = shapes * (rows[:, order].conj().T @ linear.inputs[:, r]) / np.where(size == 0.0, 1.0, size)
    # What happens at a frequency appears at it over the rate of the clock.
    return Modes(
        np.asarray(s / parts.clock, dtype=np.complex128),
        np.asarray(np.asarray(shapes, dtype=np.complex128).T * parts.channels[:, GAIN]),
    )


_Key = tuple[int, str, float]


def _key(test: ResponseLines) -> _Key:
    """What tests that meet one rig with the same modes have in common."""
    return test.drive_point, test.reference, _middle_s(test)


class _Slopes(NamedTuple):
    """Poles (k,) of a rig, rad/s, their derivatives by its parameters, (k, n), and those of ln of its clock, (n,)."""

    poles: ComplexArray
    slopes: ComplexArray
    clocks: FloatArray


def _slopes(parametrisation: Parametrisation, theta: FloatArray, test: ResponseLines, number: int) -> _Slopes | None:
    """Derivatives of the lowest modes of a rig as a test meets it; None where it has no modes there."""
    try:
        rig = parametrisation.rig(theta)
    except (BenchError, ValueError, ArithmeticError):
        return None
    parts = _parts(rig, test)
    modes = None if parts is None else _modes_of(parts)
    if parts is None or modes is None:
        return None
    poles, matrices = modes.poles[:number] * parts.clock, RestingMatrices.of(parts)
    try:
        following = PoleSlopes(matrices, poles)
    except np.linalg.LinAlgError:
        return None
    slopes, clocks = np.zeros((poles.size, theta.size), dtype=np.complex128), np.zeros(theta.size)
    for column, step in enumerate(_MATRIX_STEP * parametrisation.prior_std):
        moved = np.array(theta, dtype=np.float64)
        moved[column] += step
        other = parametrisation.rig(moved)
        clocks[column] = math.log1p((other.clock_error - rig.clock_error) / parts.clock) / step
        if same_motion(other, rig):
            continue
        changed = _parts(other, test, parts)
        if changed is not None and changed.system.size == parts.system.size:
            slopes[:, column] = following.along(RestingMatrices.of(changed).minus(matrices)) / step
    return _Slopes(poles, slopes, clocks)


def _middle_s(test: ResponseLines) -> float:
    """Middle of a test on the clock of its bag, s."""
    return 0.5 * sum(test.span_s or (0.0, 0.0))
