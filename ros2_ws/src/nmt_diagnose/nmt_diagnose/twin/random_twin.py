"""Frequency responses of a low-level random test: the system linearised at rest, smoothed as the estimator does."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nmt_core.blocks import FloatArray, Quantity
from nmt_core.errors import BenchError
from nmt_diagnose.evidence.conditions import MeasuredChannel, RandomTest
from nmt_diagnose.evidence.observables import Part, Rows
from nmt_diagnose.twin.linear_model import ComplexArray
from nmt_diagnose.twin.parts_cache import PartsCache, Setup
from nmt_diagnose.twin.periodic_kernel import sensor_gain
from nmt_diagnose.twin.phase_resonance_twin import resting_tangent
from nmt_diagnose.twin.rig_parts import RigParts
from nmt_diagnose.twin.settings import TwinSettings
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig

# |W|² of the Hann window at a line's neighbours and at itself.
HANN = np.array([1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0])
# Orders of the drive's images: the armature's resonance may amplify high ones.
IMAGES = tuple(order for n in range(1, 7) for order in (-n, n))
IMAGE_NODES = 12


class RandomTwin:
    """Predicts the frequency responses of one random test.

    Args:
        test: the test.
        rows: its rows.
        settings: of the twin.

    Raises:
        BenchError: an unknown window or reference.
    """

    def __init__(self, test: RandomTest, rows: Rows, settings: TwinSettings) -> None:
        if test.window not in ("hann", "none"):
            raise BenchError(f"test {test.name}: window {test.window!r} is unknown; use hann or none.")
        if test.reference not in ("voltage", "force"):
            raise BenchError(f"test {test.name}: reference {test.reference!r} is unknown; use voltage or force.")
        self.test, self.rows, self.settings = test, rows, settings
        channels = [*test.channels]
        wanted = Quantity.VOLTAGE if test.reference == "voltage" else Quantity.FORCE
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
        self.use(Setup(test.drive_point, False, self.channels, FourierBasis.up_to(1)))
        self.seconds = 0.5 * (test.start_s + test.stop_s)

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
        return complex(sensor_gain(s, *parts.channels[row])[0])

    def responses(self, rig: Rig, cache: PartsCache) -> ComplexArray:
        """Expected estimates (lines, channels)."""
        parts = cache.parts(rig, self.setup, self.seconds)
        fractions = parts.linear.partial_fractions(
            np.concatenate((np.arange(parts.coordinates), parts.coordinates + self._own))
        )
        result = self._smoothed(parts, self.frequencies, fractions)
        rate = self.test.drive_hold_hz
        if math.isinf(rate) or self.test.reference != "voltage":
            return result
        lines = self.test.lines_hz
        return np.asarray(np.sinc(lines / rate)[:, None] ** 2 * result + self._images(parts, lines, rate, fractions))

    def _images(
        self, parts: RigParts, lines: FloatArray, rate: float, fractions: tuple[FloatArray, ...]
    ) -> ComplexArray:
        """What images of the drive around multiples of its rate fold onto the lines (lines, channels).

        Far above the lines the responses are smooth: a few frequencies and a polynomial between them do.
        """
        low, high = float(lines.min()), float(lines.max())
        nodes = 0.5 * (low + high) + 0.5 * (high - low) * np.cos(np.pi * (np.arange(IMAGE_NODES) + 0.5) / IMAGE_NODES)
        # The sensors of a rig whose drive is held act on samples, that is on what has been folded down already.
        ideal = parts.channels[self._own].copy()
        ideal[:, 1:] = 0.0
        place = nodes + np.array(IMAGES)[:, None] * rate
        values = self._plain(parts, np.abs(place).ravel(), fractions, ideal)[:, :-1].reshape(*place.shape, -1)
        values = np.where(place[..., None] > 0.0, values, np.conj(values))
        total = np.einsum("ok,okc->kc", np.sinc(place / rate) ** 2, values)
        total *= sensor_gains(nodes * parts.clock, parts.channels[self._own[:-1]]) / parts.channels[self._own[:-1], 0]
        basis = np.polynomial.chebyshev.chebvander((2.0 * nodes - low - high) / max(high - low, 1e-9), IMAGE_NODES - 1)
        at = np.polynomial.chebyshev.chebvander((2.0 * lines - low - high) / max(high - low, 1e-9), IMAGE_NODES - 1)
        return np.asarray(at @ np.linalg.solve(basis, total))

    def _smoothed(self, parts: RigParts, frequencies: FloatArray, fractions: tuple[FloatArray, ...]) -> ComplexArray:
        """Responses over the reference, as the estimator's window mixes neighbouring lines (lines, channels)."""
        h = self._plain(parts, frequencies, fractions)
        reference = h[:, -1]
        cross = (h[:, :-1] * np.conj(reference)[:, None])[self.index]
        power = (np.abs(reference) ** 2)[self.index]
        result: ComplexArray = np.einsum("k,lkc->lc", self.weights, cross) / (power @ self.weights)[:, None]
        return result

    def _plain(
        self,
        parts: RigParts,
        frequencies: FloatArray,
        fractions: tuple[FloatArray, ...],
        chains: FloatArray | None = None,
    ) -> ComplexArray:
        """Responses to the drive at some frequencies (frequencies, channels and reference).

        ``fractions`` are the partial fractions of the local coordinates and of the channels, ``chains`` the sensor
        chains; None = those of the rig.
        """
        r = parts.coordinates
        stiffness = resting_tangent(parts, 0j).real.copy()
        damping = resting_tangent(parts, 1.0 + 0j).real - stiffness
        h = linear_responses(
            2.0 * np.pi * frequencies * parts.clock,
            r,
            stiffness,
            damping,
            *fractions,
            parts.channels[self._own] if chains is None else chains,
        )
        h *= parts.input_per_volt
        if math.isfinite(parts.saturation) and self.test.reference == "voltage":
            # The reference is the command: the amplifier comes after it.
            h[:, :-1] *= amplifier_gain(self.test.drive_rms, parts.saturation)
        return np.asarray(h)

    def values(self, rig: Rig, cache: PartsCache) -> FloatArray:
        """Observables of the test's rows."""
        responses = self.responses(rig, cache)
        rows = self.rows
        own = responses[rows.level, rows.channel]
        result = np.full(len(rows), np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            for kind, values in (
                (Part.LOG_MAGNITUDE, np.log(np.abs(own))),
                (Part.PHASE, np.angle(own)),
                (Part.REAL, own.real),
                (Part.IMAG, own.imag),
            ):
                which = rows.part == kind
                result[which] = values[which]
        result[np.isinf(result)] = np.nan
        return result


def amplifier_gain(rms: float, saturation: float) -> float:
    """Mean slope of V tanh(u/V) over a Gaussian u: the gain that a cross-spectrum sees (Bussgang)."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    slope = 1.0 / np.cosh(rms * nodes / saturation) ** 2
    return float(weights @ slope / weights.sum())


@njit(cache=True)
def sensor_gains(frequencies: FloatArray, channels: FloatArray) -> ComplexArray:
    """Complex gains (frequencies, c) of sensor chains (c, 4) at frequencies in Hz."""
    result = np.empty((frequencies.size, channels.shape[0]), dtype=np.complex128)
    for line in range(frequencies.size):
        s = 2j * np.pi * frequencies[line]
        for k in range(channels.shape[0]):
            result[line, k], _ = sensor_gain(s, channels[k, 0], channels[k, 1], channels[k, 2], channels[k, 3])
    return result


@njit(cache=True)
def linear_responses(
    omega: FloatArray,
    r: int,
    stiffness: FloatArray,
    damping: FloatArray,
    sums: FloatArray,
    products: FloatArray,
    constants: FloatArray,
    slopes: FloatArray,
    rest: FloatArray,
    channels: FloatArray,
) -> ComplexArray:
    """Responses (lines, c) of the channels after their sensors to the drive, local forces linear: k w + d ẇ.

    Args:
        omega: (lines,) rad/s.
        r: number of local coordinates.
        stiffness, damping: (r,) k and d.
        sums, products, constants, slopes, rest: ``LinearModel.partial_fractions`` of coordinates and channels.
        channels: sensor chains (c, 4).
    """
    c = channels.shape[0]
    entries = rest.size
    columns = r + 1
    result = np.empty((omega.size, c), dtype=np.complex128)
    re = np.empty(entries)
    im = np.empty(entries)
    closed = np.empty((r, r + 1), dtype=np.complex128)
    for line in range(omega.size):
        w = omega[line]
        s = 1j * w
        re[:] = rest
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
            gain, _ = sensor_gain(s, channels[k, 0], channels[k, 1], channels[k, 2], channels[k, 3])
            result[line, k] = gain * value
    return result
