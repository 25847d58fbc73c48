"""Observables of imposed motion: samples of the force (and of further responses) while the drive point moves as held.

The motion and its derivatives are those of polynomials over a few samples (Savitzky and Golay, Anal. Chem. 36 (1964)
1627), as many as its highest frequency allows: they do not ring where it starts or stops. What the noise of the motion
makes of the force, and what the polynomials do where it changes fast, is part of the noise of the observables. Where
the drive point stands still the force is whatever friction holds, and is no observable. No more samples are taken than
the force has independent values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import binary_dilation, binary_opening, uniform_filter1d
from scipy.signal import savgol_coeffs, savgol_filter, welch

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_core.tolerances import TOLERANCES
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.driven_record.reading import (
    followed_channels,
    refinement,
    spread_samples,
    white_noise,
)
from nmt_diagnose.measurements.imposed_motion.imposed_motion import ImposedMotion
from nmt_diagnose.observations.bag_windows import BagWindows, Window
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import Observations, Part, Place, RowTable, empty, joined
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import ShakingTableSection
from nmt_signals.channel_faults.clipping import clipping_level

KINDS = (TestKind.RECORD, TestKind.STEPPED_SINE)
_PASSAGE = 0.05  # of a period that a reversal stays slow at the most; a sine takes a third of it
_DEGREE = 5  # of the polynomials: their second derivative is as good as their value is with degree 3
_PASSED = 4.0  # frequency at which the polynomials halve the power over the highest of the motion
_MOTION_UNITS = {motion.unit for motion in MOTIONS}


def imposed_channel(window: Window, view: ModelView) -> MeasuredChannel | None:
    """The recorded motion of the drive point, the least differentiated; None without it or a force to predict."""
    stretch = window.stretch
    if isinstance(view.rig.exciter, ShakingTableSection) or len(view.rig.all_exciters) > 1:
        return None
    force = stretch.find(Quantity.FORCE)
    point = view.rig.drive_point
    found = [c for c in (stretch.find(quantity, point) for quantity in MOTIONS) if c is not None]
    usable = [c for c in found if c.name not in stretch.faults]
    return usable[0] if usable and force is not None and force.name not in stretch.faults else None


def reason_for_imposed(window: Window, view: ModelView) -> str:
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


def _decisions(name: str, windows: Sequence[Window], view: ModelView) -> list[str]:
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
    window: Window,
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
            # Nobody knows the velocity at the start: the drift that this makes is no motion.
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


def independent_values(force: FloatArray, sample_rate: float) -> int:
    """Independent values of a force: two for each period of the highest frequency that it has power at."""
    frequency, power = welch(force - force.mean(), sample_rate, nperseg=min(force.size, 1024))
    share = np.cumsum(power) / max(float(np.sum(power)), 1e-300)
    highest = float(frequency[: int(np.searchsorted(share, 0.99)) + 1][-1])
    return max(THRESHOLDS.reading.record_fewest_rows, int(2.0 * highest * force.size / sample_rate))


def _impedance_noise(
    motion: _Motion, source: MeasuredChannel, channels: Sequence[MeasuredChannel], view: ModelView
) -> FloatArray:
    """Standard deviation of what the noise of the motion makes of each channel, friction sticking, (channels,)."""
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
