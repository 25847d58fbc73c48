"""Records of a motion that was imposed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline
from scipy.ndimage import binary_dilation, binary_opening, uniform_filter1d
from scipy.signal import savgol_coeffs, savgol_filter, welch

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_core.tolerances import TOLERANCES
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel, with_magnitudes
from nmt_diagnose.measurements.driven_record import (
    SamplePredictor,
    followed_channels,
    independent_values,
    recorded,
    refinement,
    spread_samples,
    substeps_of,
    white_noise,
)
from nmt_diagnose.measurements.measurement import LevelSeries, Observations, Record, RowTable, empty, joined
from nmt_diagnose.observations.bag_windows import BagWindow, BagWindows
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import Part, Place, Rows
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.prediction.linear_model import LinearModel, OutputRows, linear_model
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.record_kernel import MOTIONS_GIVEN, step_through, stepped_model
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    resting_response,
)
from nmt_diagnose.prediction.rig_parts import RigParts
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig, ShakingTableSection
from nmt_signals.channel_faults.clipping import clipping_level

POSITION = "displacement"


class ImposedMotion(Record):
    """A record whose motion was imposed: the model is moved as measured, and force and further responses follow.

    The input is the recorded motion of the drive point in its unit; the observables keep their means.
    """

    WORDS: ClassVar[str] = "imposed motion, its force predicted"
    unexcited: ClassVar[tuple[Part, ...]] = (Part.LINE,)
    series: ClassVar[LevelSeries] = LevelSeries(interleaved=True)

    @property
    def signals(self) -> dict[str, FloatArray]:
        """Measured channels that the strength of a force may follow; the displacement of the drive point is one."""
        return with_magnitudes({POSITION: self.motion[0], **self.followed})

    def with_zero(self, steps: float) -> FloatArray:
        """The motion with the zero of its sensor off by so many standard deviations, shape (3, n)."""
        order = MOTIONS[self.input_channel.quantity]
        moved = self.motion.copy()
        time = np.arange(self.input.size) / self.sample_rate
        for row in range(order + 1):
            moved[row] += steps * self.zeros[0] * time ** (order - row) / math.factorial(order - row)
        return moved

    def with_gain(self, steps: float) -> FloatArray:
        """The motion larger by so many standard deviations of its gain, shape (3, n)."""
        return self.motion * (1.0 + steps * self.gain_std)

    def predictor(self, rows: Rows, settings: PredictionSettings) -> ImposedMotionPredictor:
        """What predicts its rows."""
        return ImposedMotionPredictor(self, rows, settings)

    @property
    def imposed_scales(self) -> tuple[float, float] | None:
        """Displacement (m) and force (N), the largest."""
        return self.size, self.force_n

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """Motion of the drive point at its middle frequency, in the shape of the system linearised at rest."""
        probe = next(i for i, c in enumerate(channels) if c.name == f"probe {self.drive_point}")
        setup = Setup(self.drive_points, True, channels, FourierBasis.up_to(1))
        parts, omega = PartsCache(settings).parts(rig, setup), 2.0 * np.pi * self.frequency_hz
        q, y = resting_response(parts, omega)
        scale = self.size / max(abs(y[probe]), 1e-300)
        return [(parts, omega, 0.0, y * scale, q * scale)]


# -- predictor -------------------------------------------------------------------------------------------------------


_ERROR_STEP = 0.05  # of a standard deviation, for differences


class ImposedMotionPredictor(SamplePredictor):
    """Predicts force and responses of one record of an imposed motion.

    Args:
        test: the record.
        rows: its rows.
        settings: of the predictor.
    """

    test: ImposedMotion

    def __init__(self, test: ImposedMotion, rows: Rows, settings: PredictionSettings) -> None:
        self.test, self.rows, self.settings = test, rows, settings
        self.channels = tuple(test.channels)
        self.use(Setup(test.drive_points, True, self.channels, FourierBasis.up_to(1)))
        self._sample = np.clip(
            np.round((rows.time_s - test.start_s) * test.sample_rate).astype(np.int64), 0, test.input.size - 1
        )

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any] = ()) -> FloatArray:
        """Observables of the test's rows."""
        return self._of_rows(self._responses(rig, cache, self.test.motion), np.nan)

    def errors(self, rig: Rig, cache: PartsCache, chain: MeasuringChain | None) -> dict[str, FloatArray]:
        """What a standard deviation of each error of the record adds to its rows, (rows,) each.

        Args:
            rig: about whose motion they act.
            cache: of the prediction.
            chain: of the record; None = that of the bench's simulator, whose sensors have no zeros and no gains.
        """
        if chain is None or not self.test.zeros.size:
            return {}
        test = self.test
        base = self._responses(rig, cache, test.motion)
        found: dict[str, FloatArray] = {}
        name = test.input_channel.name
        # What the sensor shows too large is smaller; the gain of a channel is one error of all tests.
        for error, moved in (
            (f"zero of {name} in {test.name}", test.with_zero(_ERROR_STEP)),
            (f"gain {name}", test.with_gain(-_ERROR_STEP)),
        ):
            found[error] = self._of_rows((self._responses(rig, cache, moved) - base) / _ERROR_STEP)
        return found | self._sensor_errors(*self._raw(rig, cache, test.motion), chain)

    def _responses(self, rig: Rig, cache: PartsCache, motion: FloatArray) -> FloatArray:
        """Recorded channels, (channels, samples)."""
        raw, parts, rate = self._raw(rig, cache, motion)
        return recorded(raw, parts, self._places, rate)

    def _raw(self, rig: Rig, cache: PartsCache, motion: FloatArray) -> tuple[FloatArray, RigParts, float]:
        """Channels before their sensors, (channels, samples), parts of the rig and sampling rate by its clock, Hz."""
        test = self.test
        parts = cache.parts(rig, self.setup, test.start_s + 0.5 * test.input.size / test.sample_rate)
        rate = test.sample_rate * parts.clock
        rows = np.concatenate((np.arange(parts.coordinates), parts.coordinates + self._places))
        free = free_model(parts, self.settings)
        substeps = substeps_of(free, rate) if free.poles.size else 1
        model = stepped_model(free, parts.coordinates, rows, 1.0 / (rate * substeps))
        steps = _between(motion * np.array([1.0, parts.clock, parts.clock**2])[:, None], substeps)
        timed = parts.timed.tables(test.signals, substeps)
        raw = step_through(steps, substeps, parts.coordinates, model, parts.force_factor, parts.tables, timed=timed)
        return raw, parts, rate


def free_model(parts: RigParts, settings: PredictionSettings) -> LinearModel:
    """Linear model of the coordinates that stay free while the motion of the drive point is given.

    Args:
        parts: of a rig with an ideal force.
        settings: reduction.

    Returns:
        Inputs are the local forces, then displacement, velocity and acceleration of the drive point; outputs as those
        of ``parts.linear``.
    """
    system, r = parts.system, parts.coordinates
    m, c, k = system.mass, system.damping, system.stiffness
    b = parts.inputs[:, r]
    p, n = _split(system.selector(system.drive_point))
    given = np.stack((k @ p, c @ p, m @ p), axis=1)
    local = parts.inputs[:, :r]
    share = float(p @ b)
    # The force as an output of q and of the inputs.
    along = p[None] / share
    force = OutputRows(along @ k, along @ c, along @ m, -along @ local)
    rows = parts.rows
    feed = rows.feedthrough[:, r : r + 1]
    whole = OutputRows(
        rows.displacement + feed @ force.displacement,
        rows.velocity + feed @ force.velocity,
        rows.acceleration + feed @ force.acceleration,
        rows.feedthrough[:, :r] + feed @ force.feedthrough,
    )
    direct = np.stack((whole.displacement @ p, whole.velocity @ p, whole.acceleration @ p), axis=1)
    feedthrough = np.hstack((whole.feedthrough, direct))
    if not n.shape[1]:
        nothing = np.zeros((rows.displacement.shape[0], 0), dtype=np.complex128)
        none = np.zeros(0, dtype=np.complex128)
        shares = np.zeros((0, r + MOTIONS_GIVEN), dtype=np.complex128)
        return LinearModel(none, nothing, nothing, nothing, shares, feedthrough.astype(np.complex128))
    # The force itself acts along p alone.
    inputs = n.T @ np.hstack((local, -given))
    reduced = replace(
        system, mass=n.T @ m @ n, damping=n.T @ c @ n, stiffness=n.T @ k @ n, exciters=(), elements=(), points={},
        structure_size=n.shape[1],
    )  # fmt: skip
    outputs = OutputRows(whole.displacement @ n, whole.velocity @ n, whole.acceleration @ n, feedthrough)
    return linear_model(reduced, inputs, outputs, settings.kept_modes, settings.full_size)


def _between(motion: FloatArray, substeps: int) -> FloatArray:
    """The motion (3, n) with steps between its samples; sample k comes to stand at ``substeps`` k."""
    if substeps == 1:
        return motion
    samples = np.arange(motion.shape[1])
    fine = np.minimum(np.arange(substeps * samples.size) / substeps, samples[-1])
    return np.asarray(CubicSpline(samples, motion, axis=1)(fine))


def _split(row: FloatArray) -> tuple[FloatArray, FloatArray]:
    """p with row · p = 1, and an orthonormal basis (n, n − 1) of the null space of the row (Householder)."""
    size = float(np.linalg.norm(row))
    pivot = int(np.argmax(np.abs(row)))
    mirror = row / size
    mirror[pivot] += np.sign(mirror[pivot])
    basis = np.eye(row.size) - 2.0 * np.outer(mirror, mirror) / float(mirror @ mirror)
    return row / size**2, np.delete(basis, pivot, axis=1)


# -- reading ---------------------------------------------------------------------------------------------------------


KINDS = (TestKind.RECORD, TestKind.STEPPED_SINE)
_PASSAGE = 0.05  # of a period that a reversal stays slow at the most; a sine takes a third of it
_DEGREE = 5  # of the polynomials: their second derivative is as good as their value is with degree 3
_PASSED = 4.0  # frequency at which the polynomials halve the power over the highest of the motion
_MOTION_UNITS = {motion.unit for motion in MOTIONS}


def imposed_channel(window: BagWindow, view: ModelView) -> MeasuredChannel | None:
    """The recorded motion of the drive point, the least differentiated; None without it or a force to predict."""
    stretch = window.stretch
    if isinstance(view.rig.exciter, ShakingTableSection) or len(view.rig.all_exciters) > 1:
        return None
    force = stretch.find(Quantity.FORCE)
    point = view.rig.drive_point
    found = [c for c in (stretch.find(quantity, point) for quantity in MOTIONS) if c is not None]
    usable = [c for c in found if c.name not in stretch.faults]
    return usable[0] if usable and force is not None and force.name not in stretch.faults else None


def reason_for_imposed(window: BagWindow, view: ModelView) -> str:
    """Why the motion of a window is taken as what was held, a clause; empty where it is not.

    It is where the sidecar says so. Where it says nothing, it is where the motion has no part in any vibration of the
    model: no mode below half of the sampling rate swings through the window, or none of them is where the motion is.
    """
    if window.held == "force" or window.segment.kind not in KINDS:
        return ""
    motion = imposed_channel(window, view)
    if window.held == "response":
        return "held: response" if motion is not None else ""
    if motion is None or window.stretch.find(Quantity.VOLTAGE) is not None:
        return ""
    stretch = window.stretch
    modes = view.swinging_hz(stretch.samples / stretch.sample_rate, 0.5 * stretch.sample_rate)
    if not modes:
        return f"no mode of the model {view.rig.name} swings within the window"
    samples = stretch.row(motion.name)
    frequency, power = welch(samples - samples.mean(), stretch.sample_rate, nperseg=min(samples.size, 4096))
    ratio = THRESHOLDS.reading.wrong_frequency_ratio
    near = np.any([(frequency > f / ratio) & (frequency < f * ratio) for f in modes], axis=0)
    share = float(power[near].sum() / max(power[1:].sum(), 1e-300))
    if share >= THRESHOLDS.reading.imposed_resonant_share:
        return ""
    level = " and its level is one of a motion" if window.segment.level_unit in _MOTION_UNITS else ""
    return f"the motion is far from every mode of the model {view.rig.name}{level}"


def imposed_motion_observations(bag: BagWindows) -> list[Observations]:
    """Observables of the windows of imposed motion of an import, one test each; takes them out of the others."""
    windows = [window for window in bag.windows if bag.imported and reason_for_imposed(window, bag.view)]
    if not windows:
        bag.require_responses()  # a force alone tells of an imposed motion only
        return []
    name, budget = bag.part_named(windows, "imposed"), bag.settings.record_rows // len(windows)
    parts = []
    for number, window in enumerate(windows):
        test_name = f"{name} {number + 1}" if len(windows) > 1 else name
        parts.append(_one(test_name, window, bag.view, bag.channels, bag.settings, budget))
    bag.take(windows)
    return [joined([empty(_decisions(name, windows, bag.view)), *parts])]


def _decisions(name: str, windows: Sequence[BagWindow], view: ModelView) -> list[str]:
    """One sentence for each reason by which motions are taken as imposed."""
    reasons = dict.fromkeys((reason_for_imposed(w, view), imposed_channel(w, view)) for w in windows)
    return [
        f"{name}: the motion {motion.name} is taken as what was held, and the force is predicted from it ({reason}); "
        "write held: force in the sidecar's segment if the force drives."
        for reason, motion in reasons
        if motion is not None and reason != "held: response"
    ]


def _one(
    name: str,
    window: BagWindow,
    view: ModelView,
    channels: dict[str, MeasuredChannel],
    settings: ObservationSettings,
    budget: int,
) -> Observations:
    source, stretch = imposed_channel(window, view), window.stretch
    assert source is not None
    if stretch.samples < THRESHOLDS.reading.imposed_fewest_samples:
        return empty((f"{name}: the record is left out: {stretch.samples} samples are too few.",))
    rate, order = stretch.sample_rate, MOTIONS[source.quantity]
    found = _Motion.of(stretch.row(source.name), rate, order)
    motion = found.samples
    force = stretch.find(Quantity.FORCE)
    if force is not None and not any(channel.quantity is Quantity.FORCE for channel in channels.values()):
        # A rig file without a force sensor means an ideal one.
        channels = {force.name: force, **channels}
    recorded = {model_channel.name: theirs for theirs, model_channel in channels.items()}
    usable = {c.name for c in stretch.channels} - set(stretch.faults) - {source.name}
    present = [c for c in channels.values() if recorded[c.name] in usable and c.quantity in (Quantity.FORCE, *MOTIONS)]
    present.sort(key=lambda channel: channel.quantity is not Quantity.FORCE)
    responses = np.array([stretch.row(recorded[channel.name]) for channel in present])
    start = _start(motion[0], rate)
    moving = _moving(found, start, rate)
    count = independent_values(responses[0][start:], rate)
    indices = spread_samples(0, moving.size, min(count, max(1, budget // len(present)), moving.size))
    indices = moving[indices]
    if indices.size < THRESHOLDS.reading.stretch_fewest_samples:
        return empty((f"{name}: the record is left out: the drive point hardly moves.",))
    segments = max(1, min(settings.record_segments, indices.size // 20))
    bounds = np.linspace(start, stretch.samples, segments + 1).round().astype(np.int64)
    level = np.searchsorted(bounds, indices, side="right") - 1
    amplitude = [float(np.std(motion[0][low:high])) for low, high in pairwise(bounds)]
    impedance = _impedance_noise(found, source, present, view)
    bias = _force_bias(found, view)
    observed = np.full(stretch.samples, np.nan)
    observed[moving] = responses[0][moving]
    table = RowTable()
    for row in range(len(present)):
        noise = math.hypot(white_noise(responses[row], rate), float(impedance[row]))
        of_force = present[row].quantity is Quantity.FORCE
        floor = settings.floors.record * float(np.sqrt(np.mean(responses[row] ** 2)))
        for index, segment in zip(indices, level, strict=True):
            table.add(
                Part.SAMPLE, float(responses[row, index]), math.hypot(noise, of_force * bias[index]), floor,
                Place(int(segment), (stretch.first_sample + int(index)) / rate, 0.0, amplitude[segment]),
                row,
            )  # fmt: skip
    factor = refinement(motion[0], rate)
    fine = np.arange(factor * stretch.samples) / (factor * rate)
    # Beyond the last sample a spline runs away: it stays.
    fine = np.minimum(fine, (stretch.samples - 1) / rate)
    test = ImposedMotion(
        name=name,
        drive_point=view.rig.drive_point,
        sample_rate=factor * rate,
        input_channel=channels.get(source.name, source),
        input=found.orders[order](fine),
        channels=tuple(present),
        segment_bounds=factor * bounds.astype(np.float64),
        start_s=stretch.start_s,
        zeros=TOLERANCES.zero * np.array([np.abs(stretch.row(source.name)).max(), *np.abs(responses).max(axis=1)]),
        limits=np.array([clipping_level(row) for row in responses]),
        motion=np.stack([spline(fine) for spline in found.orders]),
        gain_std=TOLERANCES.gain,
        frequency_hz=found.frequency_hz,
        size=0.5 * float(np.ptp(motion[0])),
        force_n=float(np.abs(responses[0]).max()),
        force=observed,
        followed=followed_channels(stretch, source, set(recorded.values()), fine),
    )
    return table.observations(test)


@dataclass(frozen=True)
class _Motion:
    """A measured motion as functions of time from its first sample, s.

    Attributes:
        orders: displacement, velocity and acceleration.
        samples: of these at the samples, (3, n).
        bias: what the smoothing may have made of these, one standard deviation, (3, n).
        density: of the white noise of the measured motion, one-sided, its unit squared per Hz.
        bandwidth_hz: up to which that noise stays in it, Hz.
        reach: samples on either side that a sample of it was made of.
    """

    orders: tuple[BSpline, ...]
    samples: FloatArray
    bias: FloatArray
    density: float
    bandwidth_hz: float
    reach: int

    @property
    def frequency_hz(self) -> float:
        """Middle frequency of the motion, rms velocity over rms displacement, Hz."""
        return float(np.std(self.samples[1]) / max(np.std(self.samples[0]), 1e-300)) / (2.0 * math.pi)

    @classmethod
    def of(cls, samples: FloatArray, sample_rate: float, order: int) -> _Motion:
        """Motion whose displacement, differentiated ``order`` times, has these samples at a rate in Hz."""
        noise = white_noise(samples, sample_rate)
        density = 2.0 * noise**2 / sample_rate
        segment = max(64, min(samples.size // 8, 1024))
        frequency, power = welch(samples - samples.mean(), sample_rate, nperseg=segment)
        above = frequency[power > THRESHOLDS.reading.imposed_noise_ratio * density]
        bandwidth = _PASSED * float(above.max(initial=frequency[1]))
        # Half width of polynomials that halve the power at a frequency (Schafer, IEEE Signal Process. Mag. 28 (2011)
        # 111).
        half = int(((_DEGREE + 1) * 0.5 * sample_rate / bandwidth + 4.6) / 3.2)
        half = min(half, (samples.size - 1) // 2)
        time = np.arange(samples.size) / sample_rate
        wanted = range(3 - order)
        if half <= _DEGREE:
            half, bandwidth = 1, 0.5 * sample_rate
            spline = make_interp_spline(time, samples, 5)
            found = [spline.derivative(k) if k else spline for k in wanted]
            bias = [np.zeros(samples.size) for _ in wanted]
        else:
            found = [make_interp_spline(time, _smoothed(samples, half, k, sample_rate), 3) for k in wanted]
            bias = [_bias(samples, half, k, sample_rate, noise) for k in wanted]
        for _ in range(order):
            found.insert(0, found[0].antiderivative())
            bias.insert(0, np.zeros(samples.size))
        if order == 2:
            # The initial velocity is unknown: the drift that it causes is not a motion and is taken out.
            drift = np.polyfit(time, found[0](time), 1)
            found[0], found[1] = _without(found[0], time, drift), _without(found[1], time, drift[:1])
        values = np.array([spline(time) for spline in found])
        return cls(tuple(found), values, np.array(bias), density, bandwidth, half + 1)


def _smoothed(samples: FloatArray, half: int, order: int, sample_rate: float) -> FloatArray:
    """Derivative of polynomials over samples on either side."""
    return np.asarray(savgol_filter(samples, 2 * half + 1, _DEGREE, order, 1.0 / sample_rate))


def _bias(samples: FloatArray, half: int, order: int, sample_rate: float, noise: float) -> FloatArray:
    """What half as many samples would change beyond what their noise does, about each sample, (n,)."""
    narrow = max(half // 2, (_DEGREE + 1) // 2)
    change = _smoothed(samples, narrow, order, sample_rate) - _smoothed(samples, half, order, sample_rate)
    weights = savgol_coeffs(2 * half + 1, _DEGREE, order, 1.0 / sample_rate)
    inner = savgol_coeffs(2 * narrow + 1, _DEGREE, order, 1.0 / sample_rate)
    weights[half - narrow : half + narrow + 1] -= inner
    by_noise = noise**2 * float(weights @ weights)
    square = uniform_filter1d(change**2, 2 * half + 1) - 2.0 * by_noise
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _without(spline: BSpline, time: FloatArray, drift: FloatArray) -> BSpline:
    """A spline less a polynomial."""
    return make_interp_spline(time, spline(time) - np.polyval(drift, time), 3)


def _start(displacement: FloatArray, sample_rate: float) -> int:
    """First sample that the unknown state of friction before the record does not reach, at most a tenth of it."""
    span = float(np.ptp(displacement))
    travelled = np.cumsum(np.abs(np.diff(displacement, prepend=displacement[0])))
    longest = int(THRESHOLDS.reading.record_longest_start * displacement.size)
    return min(int(np.searchsorted(travelled, span)), longest)


def _moving(motion: _Motion, start: int, sample_rate: float) -> IntArray:
    """Samples from the start on at which the drive point does not stand still, nor is made smooth with such samples.

    A speed passes through zero in a few hundredths of a period of the motion; what lasts longer is a standstill.
    """
    speed = np.abs(motion.samples[1])
    resting = speed <= THRESHOLDS.reading.imposed_rest_share * float(speed.max(initial=0.0))
    passage = _PASSAGE / max(motion.frequency_hz, 1e-300) * sample_rate
    still = binary_opening(resting, np.ones(max(3, min(math.ceil(passage), resting.size))))
    resting |= binary_dilation(still, iterations=motion.reach)
    resting[:start] = True
    return np.flatnonzero(~resting)


def _impedance_noise(
    motion: _Motion, source: MeasuredChannel, channels: Sequence[MeasuredChannel], view: ModelView
) -> FloatArray:
    """Standard deviation of each channel caused by the noise of the motion, friction sticking, (channels,)."""
    lines = np.asarray(motion.bandwidth_hz * np.arange(1, 201) / 200.0, dtype=np.float64)
    over = view.responses([source, *channels], lines)
    with np.errstate(divide="ignore", invalid="ignore"):
        gains = np.nan_to_num(np.abs(over[1:] / over[0]) ** 2, posinf=0.0)
    return np.asarray(np.sqrt(motion.density * gains.mean(axis=1) * motion.bandwidth_hz))


def _force_bias(motion: _Motion, view: ModelView) -> FloatArray:
    """What the smoothing of the motion may have made of the force of the drive point's own mass and springs, (n,)."""
    system = view.system
    row = system.selector(system.drive_point)
    along = row / float(row @ row)
    shares = [
        float(along @ matrix @ along) for matrix in (system.sticking_stiffness(), system.resting_damping(), system.mass)
    ]
    return np.asarray(np.sqrt(np.sum((np.array(shares)[:, None] * motion.bias) ** 2, axis=0)))
