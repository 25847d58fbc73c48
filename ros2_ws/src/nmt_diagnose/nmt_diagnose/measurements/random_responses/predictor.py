"""Frequency responses of a random test: the system linearised about its motion, smoothed as the estimator does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.observations.observables import FUNDAMENTAL, HARMONICS, Part, Rows
from nmt_diagnose.prediction.gaussian_motion import DrivenForces
from nmt_diagnose.prediction.linear_model import Fractions
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.prediction.rig_parts import RigParts
from nmt_diagnose.prediction.rig_tables import DELAY, GAIN, HIGH_PASS, LOW_PASS, sensor_gain
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_diagnose.measurements.random_responses.random_responses import RandomResponses

# |W|² of the Hann window at a line's neighbours and at itself.
HANN = np.array([1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0])
# Orders of the drive's images: the armature's resonance may amplify high ones.
IMAGES = tuple(order for n in range(1, 7) for order in (-n, n))
IMAGE_NODES = 12
# Moments of a test at which a rig that drifts is taken, of −1 to 1 (Gauss–Legendre), and their weights.
_MOMENTS, _SHARES = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True)
class Folding:
    """Where images of a zero-order hold lie, and how they come down to the lines of a test.

    Attributes:
        nodes: (IMAGE_NODES,) frequencies between which a polynomial does, Hz.
        frequencies: (images · nodes,) where responses are wanted, Hz.
        below: (images, nodes) whether an image lies below zero.
        weights: (images, nodes) share of its power.
        at_lines: (lines, 1) share of the drive at the lines themselves.
        between: (lines, nodes) from the nodes to the lines.
    """

    nodes: FloatArray
    frequencies: FloatArray
    below: NDArray[np.bool_]
    weights: FloatArray
    at_lines: FloatArray
    between: FloatArray


def folding(lines: FloatArray, rate: float) -> Folding:
    """Images of a zero-order hold of 1/``rate`` (Hz), for some lines (Hz)."""
    low, high = float(lines.min()), float(lines.max())
    nodes = 0.5 * (low + high) + 0.5 * (high - low) * np.cos(np.pi * (np.arange(IMAGE_NODES) + 0.5) / IMAGE_NODES)
    place = nodes + np.array(IMAGES)[:, None] * rate
    basis, at = (
        np.polynomial.chebyshev.chebvander((2.0 * x - low - high) / max(high - low, 1e-9), IMAGE_NODES - 1)
        for x in (nodes, lines)
    )
    return Folding(
        nodes, np.abs(place).ravel(), place <= 0.0, np.sinc(place / rate) ** 2, np.sinc(lines / rate)[:, None] ** 2,
        np.array(np.linalg.solve(basis.T, at.T).T, dtype=np.float64, order="C"),
    )  # fmt: skip


class RandomPredictor(Predictor):
    """Predicts the frequency responses of one random test.

    Args:
        test: the test.
        rows: its rows.
        settings: of the predictor.

    Raises:
        BenchError: an unknown window or reference.
    """

    def __init__(self, test: RandomResponses, rows: Rows, settings: PredictionSettings) -> None:
        if test.window not in ("hann", "none"):
            raise BenchError(f"test {test.name}: window {test.window!r} is unknown; use hann or none.")
        if test.reference not in ("force", "base", "voltage"):
            raise BenchError(f"test {test.name}: reference {test.reference!r} is unknown; use force, base or voltage.")
        self.test, self.rows, self.settings = test, rows, settings
        channels = [*test.channels]
        wanted = Quantity.FORCE if test.reference == "force" else Quantity.VOLTAGE
        name, point = ("u", 0) if wanted == Quantity.VOLTAGE else (f"f{test.drive_point}", test.drive_point)
        channels.append(MeasuredChannel(name, wanted, point))
        self.channels = tuple(channels)
        steps = np.array([-1.0, 0.0, 1.0]) if test.window == "hann" else np.array([0.0])
        self.weights = HANN if test.window == "hann" else np.ones(1)
        frequencies = np.maximum(test.lines_hz[:, None] + steps * test.resolution_hz, 0.0)
        # Neighbouring lines share their frequencies.
        quanta = np.round(frequencies / (1e-3 * test.resolution_hz)).astype(np.int64)
        _, first, inverse = np.unique(quanta.ravel(), return_index=True, return_inverse=True)
        self.frequencies = np.ascontiguousarray(frequencies.ravel()[first])
        self.index = inverse.reshape(frequencies.shape)
        self.use(Setup(test.drive_points, False, self.channels, FourierBasis.up_to(1)))
        self.seconds = 0.5 * (test.start_s + test.stop_s)
        self._parts = {
            part: (which, rows.level[which], rows.channel[which])
            for part in (*FUNDAMENTAL, *HARMONICS)
            if (which := np.flatnonzero(rows.part == part)).size
        }
        rate = test.drive_hold_hz
        held = math.isfinite(rate) and test.reference == "voltage" and test.lines_hz.size > 0
        self._folding = folding(test.lines_hz, rate) if held else None

    def use(self, setup: Setup) -> None:
        """Take the parts of rigs from a setup that other tests share."""
        self.setup = setup
        self._own = np.array(setup.index(self.channels), dtype=np.int64)

    @property
    def channel_rows(self) -> NDArray[np.int64]:
        """Rows of the test's channels and of the reference among the outputs of the linear model's channels."""
        return self._own

    def gain(self, parts: RigParts, row: int, s: complex) -> complex:
        """Complex gain of one sensor."""
        return complex(sensor_gain(s, parts.channels[row])[0])

    def responses(self, rig: Rig, cache: PartsCache) -> ComplexArray:
        """Expected estimates (lines, channels)."""
        parts = cache.parts(rig, self.setup, self.seconds)
        fractions = self._fractions(parts)
        local = self._local(parts, fractions, cache, self.seconds)
        result = self._smoothed(rig, cache, parts, local, fractions)
        if self._folding is None:
            return result
        return np.asarray(self._folding.at_lines * result + self._images(parts, local, self._folding, fractions))

    def _local(
        self, parts: RigParts, fractions: Fractions, cache: PartsCache, seconds: float
    ) -> tuple[FloatArray, FloatArray]:
        """Stiffness and damping of the local forces under the motion that the drive makes, (r,) each; see
        gaussian_motion.py. A drive of unknown size is small. Those of a slightly different rig follow from the other's.
        """
        parts.require_balanced()
        test, tables = self.test, parts.tables
        elements = tables.elements
        starts = elements.jenkins_start + elements.contacts_start + elements.sampled_start
        acting = np.diff(starts) > 0
        if not acting.any() or not test.drive_rms > 0.0 or not test.stop_s > test.start_s or test.lines_hz.size < 2:
            return parts.resting
        omega = 2.0 * np.pi * parts.clock * test.lines_hz
        powers = np.array([1.0, *((rms / test.drive_rms) ** 2 for rms in test.other_rms)])
        # An acceleration of the base is that of so many volts, which the last of the channels is.
        rms = test.drive_rms / float(parts.input_per_volt[0]) if test.reference == "base" else test.drive_rms
        driven = DrivenForces(parts.linear, tables, acting, parts.resting, fractions, omega, rms, powers, parts.keys)
        base = None if cache.base is None else cache.base.forces.get((self, seconds))
        followed = None if base is None else base.followed(driven)
        if followed is None:
            cache.forces[self, seconds] = driven
            return driven.forces
        return followed

    def _images(
        self, parts: RigParts, local: tuple[FloatArray, FloatArray], folding: Folding, fractions: Fractions
    ) -> ComplexArray:
        """What images of the drive around multiples of its rate fold onto the lines (lines, channels).

        Far above the lines the responses are smooth: a few frequencies and a polynomial between them do.
        """
        # The sensors of a rig whose drive is held act on samples, that is on what has been folded down already.
        chains = parts.channels[self._own]
        ideal = chains.copy()
        ideal[:, [DELAY, LOW_PASS, HIGH_PASS]] = 0.0
        values = self._plain(parts, local, folding.frequencies, fractions, ideal)
        total = folded(values, folding.below, folding.weights)
        total *= sensor_gains(folding.nodes * parts.clock, chains[:-1]) / chains[:-1, GAIN]
        return np.asarray(folding.between @ total)

    def _smoothed(
        self,
        rig: Rig,
        cache: PartsCache,
        parts: RigParts,
        local: tuple[FloatArray, FloatArray],
        fractions: Fractions,
    ) -> ComplexArray:
        """Responses over the reference, as the estimator mixes neighbouring lines and moments (lines, channels).

        The estimate is the cross-spectrum over the whole test by the power of the reference. Of a rig that drifts
        slowly, at each moment with the response that it has then, both are means over the test.
        """
        half = 0.5 * (self.test.stop_s - self.test.start_s)
        if not half > 0.0 or (rig.drift.stiffness_per_s == 0.0 and rig.drift.slip_force_per_s == 0.0):
            h = self._plain(parts, local, self.frequencies, fractions)
            plain: ComplexArray = windowed(h, self.index, self.weights)
            return plain
        every = []
        for moment in self.seconds + half * _MOMENTS:
            parts = cache.parts(rig, self.setup, float(moment))
            fractions = self._fractions(parts)
            local = self._local(parts, fractions, cache, float(moment))
            every.append(self._plain(parts, local, self.frequencies, fractions))
        index = np.hstack([self.index + k * self.frequencies.size for k in range(_MOMENTS.size)])
        result: ComplexArray = windowed(np.concatenate(every), index, np.outer(_SHARES, self.weights).ravel())
        return result

    def _fractions(self, parts: RigParts) -> Fractions:
        """Partial fractions of the local coordinates and of the test's channels."""
        return parts.linear.partial_fractions(
            np.concatenate((np.arange(parts.coordinates), parts.coordinates + self._own))
        )

    def _plain(
        self,
        parts: RigParts,
        local: tuple[FloatArray, FloatArray],
        frequencies: FloatArray,
        fractions: Fractions,
        chains: FloatArray | None = None,
    ) -> ComplexArray:
        """Responses to the drive at some frequencies (frequencies, channels and reference).

        ``local`` are stiffness and damping of the local forces, ``fractions`` the partial fractions of the local
        coordinates and of the channels, ``chains`` the sensor chains; None = those of the rig.
        """
        r = parts.coordinates
        h = linear_responses(
            2.0 * np.pi * frequencies * parts.clock,
            r,
            *local,
            tuple(fractions.of_inputs(parts.linear.inputs.shape[1], r + 1)),
            parts.channels[self._own] if chains is None else chains,
        )
        h *= parts.input_per_volt[0]
        if self.test.reference == "base":  # 1 V is this acceleration of the base
            h[:, -1] *= parts.input_per_volt[0]
        if math.isfinite(float(parts.saturation[0])) and self.test.reference == "voltage":
            # The reference is the command: the amplifier comes after it.
            h[:, :-1] *= amplifier_gain(self.test.drive_rms, float(parts.saturation[0]))
        return np.asarray(h)

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any] = ()) -> FloatArray:
        """Observables of the test's rows."""
        responses = self.responses(rig, cache)
        result = np.full(len(self.rows), np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            for part, (which, line, channel) in self._parts.items():
                line_response = responses[line, channel]
                if part == Part.LOG_MAGNITUDE:
                    result[which] = np.log(np.abs(line_response))
                elif part == Part.PHASE:
                    result[which] = np.angle(line_response)
                else:
                    result[which] = line_response.real if part == Part.REAL else line_response.imag
        result[np.isinf(result)] = np.nan
        return result


def amplifier_gain(rms: float, saturation: float) -> float:
    """Mean slope of V tanh(u/V) over a Gaussian u: the gain that a cross-spectrum sees (Bussgang)."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    slope = 1.0 / np.cosh(rms * nodes / saturation) ** 2
    return float(weights @ slope / weights.sum())


@njit(cache=True)
def folded(values: ComplexArray, below: NDArray[np.bool_], weights: FloatArray) -> ComplexArray:
    """Sum (nodes, c) of weighted images; ``values`` (images · nodes, c + 1) are those at positive frequencies."""
    images, nodes = weights.shape
    result = np.zeros((nodes, values.shape[1] - 1), dtype=np.complex128)
    for i in range(images):
        for k in range(nodes):
            for c in range(result.shape[1]):
                value = values[i * nodes + k, c]
                result[k, c] += weights[i, k] * (np.conj(value) if below[i, k] else value)
    return result


@njit(cache=True)
def windowed(values: ComplexArray, index: NDArray[np.int64], weights: FloatArray) -> ComplexArray:
    """Cross-spectra over the power of the reference (lines, c), both as a window mixes neighbouring lines.

    Args:
        values: (frequencies, c + 1) responses; the last is the reference.
        index: (lines, neighbours) their frequencies.
        weights: (neighbours,) of the window.
    """
    last = values.shape[1] - 1
    result = np.zeros((index.shape[0], last), dtype=np.complex128)
    for line in range(index.shape[0]):
        power = 0.0
        for k in range(weights.size):
            reference = values[index[line, k], last]
            power += weights[k] * (reference.real**2 + reference.imag**2)
            turned = weights[k] * np.conj(reference)
            for c in range(last):
                result[line, c] += values[index[line, k], c] * turned
        # As in plain floating point: a reference of nothing makes no number, not an error.
        factor = 1.0 / power if power != 0.0 else np.nan
        for c in range(last):
            result[line, c] *= factor
    return result


@njit(cache=True)
def sensor_gains(frequencies: FloatArray, channels: FloatArray) -> ComplexArray:
    """Complex gains (frequencies, c) of sensor chains (c, 4) at frequencies in Hz."""
    result = np.empty((frequencies.size, channels.shape[0]), dtype=np.complex128)
    for line in range(frequencies.size):
        s = 2j * np.pi * frequencies[line]
        for k in range(channels.shape[0]):
            result[line, k], _ = sensor_gain(s, channels[k])
    return result


@njit(cache=True)
def linear_responses(
    omega: FloatArray,
    r: int,
    stiffness: FloatArray,
    damping: FloatArray,
    fraction_tables: tuple[FloatArray, ...],
    channels: FloatArray,
) -> ComplexArray:
    """Responses (lines, c) of the channels after their sensors to the drive, local forces linear: k w + d ẇ.

    Args:
        omega: (lines,) rad/s.
        r: number of local coordinates.
        stiffness, damping: (r,) k and d.
        fraction_tables: `Fractions` of coordinates and channels as a plain tuple, which comes from Python sooner.
        channels: sensor chains (c, 4).
    """
    sums, products, constants, slopes, constant_part = Fractions(*fraction_tables)
    c = channels.shape[0]
    entries = constant_part.size
    columns = r + 1
    result = np.empty((omega.size, c), dtype=np.complex128)
    re = np.empty(entries)
    im = np.empty(entries)
    closed = np.empty((r, r + 1), dtype=np.complex128)
    for line in range(omega.size):
        w = omega[line]
        s = 1j * w
        re[:] = constant_part
        im[:] = 0.0
        for k in range(sums.size):
            a = products[k] - w * w
            b = -sums[k] * w
            size = 1.0 / (a * a + b * b)
            dr = a * size
            di = -b * size
            wr = -w * di
            wi = w * dr
            for e in range(entries):
                re[e] += constants[k, e] * dr + slopes[k, e] * wr
                im[e] += constants[k, e] * di + slopes[k, e] * wi
        for i in range(r):
            for j in range(r):
                t = stiffness[j] + s * damping[j]
                closed[i, j] = (re[i * columns + j] + 1j * im[i * columns + j]) * t
            closed[i, i] += 1.0
            closed[i, r] = re[i * columns + r] + 1j * im[i * columns + r]
        for i in range(r):
            # Small and close to the identity where the elements are soft; pivots do not vanish at a stable rest.
            pivot = 1.0 / closed[i, i]
            for row in range(r):
                if row != i and closed[row, i] != 0.0:
                    factor = closed[row, i] * pivot
                    for j in range(i, r + 1):
                        closed[row, j] -= factor * closed[i, j]
        for i in range(r):
            closed[i, r] *= (stiffness[i] + s * damping[i]) / closed[i, i]
        for k in range(c):
            first = (r + k) * columns
            value = re[first + r] + 1j * im[first + r]
            for j in range(r):
                value -= (re[first + j] + 1j * im[first + j]) * closed[j, r]
            gain, _ = sensor_gain(s, channels[k])
            result[line, k] = gain * value
    return result
