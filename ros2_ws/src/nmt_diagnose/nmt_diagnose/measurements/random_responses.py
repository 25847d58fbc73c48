"""Frequency responses of a low-level random test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Observations, ResponseLines
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import FUNDAMENTAL, HARMONICS, Part, Rows
from nmt_diagnose.prediction.gaussian_motion import DrivenForces
from nmt_diagnose.prediction.influence import Source, SourceColumn, source_vectors, with_sources
from nmt_diagnose.prediction.linear_model import Fractions, LinearModel
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.prediction.record_kernel import line_shares
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    noise_motion,
)
from nmt_diagnose.prediction.rig_parts import RigParts, resting_tangent
from nmt_diagnose.prediction.rig_tables import sensor_gain
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig
from nmt_rig.rig_model import inputs_per_volt


@dataclass(frozen=True)
class RandomResponses(ResponseLines):
    """Frequency responses of a low-level random test, referred to the voltage, to the force or to the base.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter.
        channels: response channels, in the order of the observables.
        reference: ``voltage``, ``force`` or ``base`` (acceleration of a shaking table).
        lines_hz: frequency lines that became observables, Hz, shape (lines,).
        resolution_hz: spacing of the lines of the estimator, Hz.
        window: ``none``: the expected estimate is the response at the line itself;
            ``hann``: the expected estimate at a line is the response averaged over the neighbouring lines with the
            weights of |W|² (1/6, 2/3, 1/6 in spacings of ``resolution_hz``).
        drive_rms: rms of the reference, V, N or m/s².
        start_s, stop_s: on the clock of its bag, s.
        drive_hold_hz: rate at which the drive went straight from sample to sample, Hz; infinite where it did not. The
            observables are responses to the samples of the drive then: smaller by sinc², and with images of the drive
            around multiples of that rate.
        resting_points: measurement points of further exciters, whose drive is taken out of the responses.
        other_rms: rms of their drive, which moves the structure too, V; empty = nothing.
    """

    WORDS: ClassVar[str] = "random, frequency response"
    unexcited: ClassVar[tuple[Part, ...]] = (Part.LINE,)
    broad_band: ClassVar[bool] = True
    noise_group: ClassVar[str] = "lines of"

    name: str
    drive_point: int
    channels: tuple[MeasuredChannel, ...]
    reference: str
    lines_hz: FloatArray
    resolution_hz: float
    window: str
    drive_rms: float
    start_s: float
    stop_s: float
    drive_hold_hz: float = math.inf
    resting_points: tuple[int, ...] = ()
    other_rms: tuple[float, ...] = ()

    def predictor(self, rows: Rows, settings: PredictionSettings) -> RandomPredictor:
        """What predicts its rows."""
        return RandomPredictor(self, rows, settings)

    @property
    def over_voltage(self) -> bool:
        """Whether its rows refer to the voltage."""
        return self.reference == "voltage"

    @property
    def divisor(self) -> MeasuredChannel | None:
        """The force that its responses are divided by."""
        if self.reference != "force":
            return None
        return MeasuredChannel(f"f{self.drive_point}", Quantity.FORCE, self.drive_point)

    @property
    def modal_hz(self) -> FloatArray | None:
        """Its lines, infinite where images of a held drive are large, which rise towards half its rate."""
        highest = THRESHOLDS.modes.least_images_share * self.drive_hold_hz
        return np.where(self.lines_hz < highest, self.lines_hz, np.inf)

    @property
    def span_s(self) -> tuple[float, float] | None:
        """Its beginning and end, s."""
        return self.start_s, self.stop_s

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """Rms of the motion over its lines, by the system linearised at rest."""
        lines, rms = 2.0 * np.pi * self.lines_hz, self.drive_rms
        if self.reference == "base":
            rms /= inputs_per_volt(rig)[0]
        return noise_motion(rig, self.drive_point, channels, settings, lines, rms, self.over_force)

    def measured_sizes(self, observations: Observations, number: int, drive: float) -> dict[str, float]:
        """Rms of each motion channel whose lines are all there."""
        rows, sizes = observations.rows, dict[str, float]()
        for index, channel in enumerate(self.channels):
            selected = (rows.test == number) & (rows.channel == index)
            selected &= (rows.part == Part.LOG_MAGNITUDE) & (rows.harmonic == 1)
            if channel.quantity in MOTIONS and int(selected.sum()) == self.lines_hz.size > 1:
                magnitude = np.empty(self.lines_hz.size)
                magnitude[rows.level[selected]] = np.exp(observations.values[selected])
                weights = np.gradient(self.lines_hz)
                sizes[channel.name] = self.drive_rms * math.sqrt(float(weights @ magnitude**2 / weights.sum()))
        return sizes

    def shifted(self, share: float) -> RandomResponses:
        """With its lines higher by a share."""
        return replace(self, lines_hz=self.lines_hz * (1.0 + share))

    def errors(self, rows: Rows, chain: MeasuringChain) -> dict[str, FloatArray]:
        """Delay of each kind of responses over the force that they are divided by."""
        found: dict[str, FloatArray] = {}
        late = math.sqrt(2.0) * chain.shared_delay_s
        for index, channel in enumerate(self.channels if self.over_force else ()):
            name = f"delay of {channel.quantity.name.lower()} over force"
            selected = (rows.channel == index) & (rows.part == Part.PHASE)
            column = found.setdefault(name, np.zeros(len(rows)))
            column[selected] = late * 2.0 * np.pi * rows.frequency_hz[selected]
        return found

    def repeat_key(self, rows: Rows, index: int) -> tuple[object, float]:
        """Frequency of the line."""
        return round(float(rows.frequency_hz[index]), 6), 0.0


# -- predictor -------------------------------------------------------------------------------------------------------


# |W|² of the Hann window at a line's neighbours and at itself.
HANN = np.array([1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0])
# Moments of a test at which a rig that drifts is taken, of −1 to 1 (Gauss–Legendre), and their weights.
_MOMENTS, _SHARES = np.polynomial.legendre.leggauss(5)


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
        self._held_hz = rate if math.isfinite(rate) and test.reference == "voltage" else None

    @property
    def channel_rows(self) -> NDArray[np.int64]:
        """Rows of the test's channels and of the reference among the outputs of the linear model's channels."""
        return self._places

    def gain(self, parts: RigParts, row: int, s: complex) -> complex:
        """Complex gain of one sensor."""
        return complex(sensor_gain(s, parts.channels[row])[0])

    def responses(self, rig: Rig, cache: PartsCache) -> ComplexArray:
        """Expected estimates (lines, channels)."""
        parts = cache.parts(rig, self.setup, self.seconds)
        fractions = self._fractions(parts)
        local = self._local(parts, fractions, cache, self.seconds)
        return self._smoothed(rig, cache, parts, local, fractions)

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
            np.concatenate((np.arange(parts.coordinates), parts.coordinates + self._places))
        )

    def _plain(
        self,
        parts: RigParts,
        local: tuple[FloatArray, FloatArray],
        frequencies: FloatArray,
        fractions: Fractions,
    ) -> ComplexArray:
        """Responses to the drive at some frequencies (frequencies, channels and reference).

        ``local`` are stiffness and damping of the local forces, ``fractions`` the partial fractions of the local
        coordinates and of the channels.
        """
        r, omega, chains = parts.coordinates, 2.0 * np.pi * frequencies * parts.clock, parts.channels[self._places]
        if self._held_hz is None:
            tables = tuple(fractions.of_inputs(parts.linear.inputs.shape[1], r + 1))
            h = linear_responses(omega, r, *local, tables, chains)
        else:
            interval = 1.0 / (self._held_hz * parts.clock)
            h = held_responses(parts.linear, r, *local, self._places, omega, interval) * sensor_gains(omega, chains)
        h *= parts.input_per_volt[0]
        if self.test.reference == "base":  # 1 V is this acceleration of the base
            h[:, -1] *= parts.input_per_volt[0]
        if math.isfinite(float(parts.saturation[0])) and self.test.reference == "voltage":
            # The reference is the command: the amplifier comes after it.
            h[:, :-1] *= amplifier_gain(self.test.drive_rms, float(parts.saturation[0]))
        return np.asarray(h)

    def influence(
        self, rig: Rig, cache: PartsCache, states: Sequence[Any], source: Source
    ) -> tuple[FloatArray, list[SourceColumn]]:
        """What unit sources at a place would do to its rows, (rows, sources), and what each is."""
        if source.kind == "controller":
            return super().influence(rig, cache, states, source)
        return influence_on_lines(self, rig, cache, source)

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
def sensor_gains(omega: FloatArray, channels: FloatArray) -> ComplexArray:
    """Complex gains (lines, c) of sensor chains (c, 4) at angular frequencies, rad/s."""
    result = np.empty((omega.size, channels.shape[0]), dtype=np.complex128)
    for line in range(omega.size):
        s = 1j * omega[line]
        for k in range(channels.shape[0]):
            result[line, k], _ = sensor_gain(s, channels[k])
    return result


def held_responses(
    model: LinearModel, r: int, stiffness: FloatArray, damping: FloatArray, channels: NDArray[np.int64],
    omega: FloatArray, interval_s: float,
) -> ComplexArray:  # fmt: skip
    """Samples of channels over samples of a drive that goes straight between them, exact for every image of the drive.

    The response of each pole to a first-order hold has a closed form (Franklin, Powell and Workman, Digital Control of
    Dynamic Systems, 1998, section 6.3.2). Sensors are ideal; local forces are linear: k w + d ẇ.

    Args:
        model: linear part; its first r inputs and outputs are those of the local forces, the next input is the drive.
        r: number of local coordinates.
        stiffness, damping: k and d, (r,) each.
        channels: numbers of the channels, counted from the first output after the local coordinates, (c,).
        omega: (lines,) rad/s.
        interval_s: from sample to sample, s.

    Returns:
        (lines, c).
    """
    rows = r + channels
    moved = model.displacement[:r]
    acting = (stiffness[:, None] + damping[:, None] * model.poles) * moved
    poles, shapes = np.linalg.eig(np.diag(model.poles) - model.inputs[:, :r] @ acting)
    driven = np.linalg.solve(shapes, model.inputs[:, r])
    position, speed, gain = (block[rows] @ shapes for block in (model.displacement, model.velocity, model.acceleration))
    forces = model.feedthrough[rows, :r] @ ((stiffness[:, None] + damping[:, None] * poles) * (moved @ shapes))
    direct = speed + gain * poles
    residues = (position + direct * poles - forces) * driven
    constant = model.feedthrough[rows, r] + direct @ driven
    z = np.exp(1j * omega * interval_s)[:, None]
    decay, early, late = line_shares(np.asarray(poles * interval_s, dtype=np.complex128))
    follow = interval_s * (early + late * z) / (z - decay)
    return np.asarray(constant + follow @ residues.T)


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


# -- influence -------------------------------------------------------------------------------------------------------


def influence_on_lines(
    predictor: RandomPredictor, rig: Rig, cache: PartsCache, source: Source
) -> tuple[FloatArray, list[SourceColumn]]:
    """Columns (rows of the test, sources): one for each line and real and imaginary part."""
    parts = cache.parts(rig, predictor.setup, predictor.seconds)
    responses = predictor.responses(rig, cache)
    rows, r = predictor.rows, parts.coordinates
    lines = predictor.test.lines_hz
    channel_rows = predictor.channel_rows
    columns: list[FloatArray] = []
    names: list[SourceColumn] = []
    model: LinearModel | None = None
    count = 1
    if source.kind not in ("force_sensor", "response_sensor"):
        vectors, measured = source_vectors(rig, parts, source)
        model = with_sources(parts, vectors, measured, predictor.settings)
        count = vectors.shape[1]
    for line in range(lines.size):
        which = np.flatnonzero(rows.level == line)
        if which.size == 0:
            continue
        omega = 2.0 * np.pi * lines[line] * parts.clock
        changes = [
            _line_change(predictor, parts, model, k, source, omega, responses[line], channel_rows, r)
            for k in range(count)
        ]
        for k, change in enumerate(changes):
            for turn in (1.0, 1j):
                # A response of zero has no logarithm to change: its rows are not used.
                there = responses[line] != 0.0
                relative = np.divide(change * turn, responses[line], out=np.zeros_like(change), where=there)
                column = np.zeros(len(rows))
                channel = rows.channel[which]
                column[which] = np.where(
                    rows.part[which] == Part.LOG_MAGNITUDE, relative[channel].real,
                    np.where(rows.part[which] == Part.PHASE, relative[channel].imag, 0.0),
                )  # fmt: skip
                columns.append(column)
                part: Literal["re", "im"] = "re" if turn == 1.0 else "im"
                names.append(SourceColumn(predictor.test.name, "line", line, part=part, vector=k))
    if not columns:
        return np.zeros((len(rows), 0)), []
    return np.column_stack(columns), names


def _line_change(
    predictor: RandomPredictor, parts: RigParts, model: LinearModel | None, k: int, source: Source, omega: float,
    responses: ComplexArray, channel_rows: Any, r: int,
) -> ComplexArray:  # fmt: skip
    """Change of the responses (channels,) by a unit source at one line."""
    change = np.zeros(responses.size, dtype=np.complex128)
    if model is None:
        for index, channel in enumerate(predictor.test.channels):
            is_force = channel.quantity == Quantity.FORCE
            if (source.kind == "force_sensor" and is_force) or (
                source.kind == "response_sensor" and not is_force and index == source.index
            ):
                change[index] = THRESHOLDS.prediction.unit_source_share * responses[index]
        return change
    s = 1j * omega
    t, _ = model.at(s)
    tangent = resting_tangent(parts, s)
    both = [r, r + parts.input_per_volt.size + k]  # the first exciter and the source
    closed = np.linalg.solve(np.eye(r) + t[:r, :r] * tangent, t[:r, both])
    full = t[r:, both] - t[r:, :r] @ (tangent[:, None] * closed)
    gains = np.array([predictor.gain(parts, row, s) for row in range(full.shape[0])])
    full = full * gains[:, None]
    # Unit: a share of the force at this line; where the channels have none, of the drive.
    force = [row for row, section in enumerate(parts.sections) if section is not None and section.quantity == "force"]
    size = abs(full[force[0], 0]) if force else 1.0
    drive = full[channel_rows[-1], 0]
    result: ComplexArray = THRESHOLDS.prediction.unit_source_share * size * full[channel_rows[:-1], 1] / drive
    return result
