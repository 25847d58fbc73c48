"""Observables of records: samples of the responses to any measured input.

The model is driven by the whole input, but only a part of the samples become observables. What a model leaves is
coloured by the resonance: errors of samples closer than its decay time go together. So no more samples are taken than
the record has decay times, spread with the golden ratio, in step with no period of the excitation; these are as good as
independent, and their likelihood is right without whitening. The noise is the lowest level of the response's spectrum,
and what the noise of the measured input makes of it; nonlinear distortions must not count as noise here, because they
are what is looked for. The input keeps its mean, about which a nonlinear structure works.

Between samples the input is interpolated without loss in its band (the straight lines of a first-order hold would cost
(πf/fs)²/3 of the amplitude, 4 % at nine samples a period), except that of simulated rigs, which is a straight line.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.tolerances import TOLERANCES
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.driven_record.driven_record import DrivenRecord
from nmt_diagnose.observations.bag_windows import BagWindows
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.noise.input_noise import input_noise, noise_lines, propagated_noise
from nmt_diagnose.observations.observables import Observations, Part, Place, RowTable, empty, joined
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.linear_modes import damped_modes
from nmt_signals.band_limited import finer
from nmt_signals.channel_faults.clipping import clipping_level

# Mirrored samples at either end of a resampled drive.
_PADDING_SAMPLES = 512

_FOLLOWED = (Quantity.CURRENT, Quantity.VOLTAGE, Quantity.FORCE)
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


def spread_samples(start: int, stop: int, count: int) -> NDArray[np.int64]:
    """Up to ``count`` different indices from start to stop − 1, ascending, in step with nothing."""
    length = stop - start
    if count >= length:
        return np.arange(start, stop, dtype=np.int64)
    stride = length / count
    within = np.modf(_GOLDEN * np.arange(count))[0]
    return np.unique(start + np.floor((np.arange(count) + within) * stride).astype(np.int64)).clip(start, stop - 1)


def white_noise(samples: FloatArray, sample_rate: float) -> float:
    """Standard deviation of white noise as strong as the lowest twentieth of the spectrum."""
    segment = min(samples.size, max(64, samples.size // 64))
    _, power = welch(samples - samples.mean(), sample_rate, nperseg=segment)
    return float(math.sqrt(np.quantile(power[1:-1], THRESHOLDS.reading.record_noise_quantile) * 0.5 * sample_rate))


def refinement(response: FloatArray, sample_rate: float) -> int:
    """Power of two by which the input must be finer for straight lines to do, where the response has its power."""
    frequency, power = welch(response - response.mean(), sample_rate, nperseg=min(response.size, 1024))
    share = np.cumsum(power) / np.sum(power)
    highest = float(frequency[np.searchsorted(share, 0.99)])
    wanted = math.pi * highest / math.sqrt(3.0 * THRESHOLDS.reading.record_hold_error) / sample_rate
    factor: int = 2 ** max(0, math.ceil(math.log2(max(wanted, 1e-9))))
    return min(THRESHOLDS.reading.record_finest_steps, factor)


def record_observations(name: str, stretches: Sequence[SampleStretch], bag: BagWindows) -> Observations:
    """Observables of the records of one bag, one test each.

    Args:
        name: name of the tests; numbered where there are several.
        stretches: the records.
        bag: they are of.
    """
    parts = []
    for number, stretch in enumerate(stretches):
        test_name = f"{name} {number + 1}" if len(stretches) > 1 else name
        parts.append(_one(test_name, stretch, bag, bag.settings.record_rows // len(stretches)))
    return joined(parts)


def _one(name: str, stretch: SampleStretch, bag: BagWindows, budget: int) -> Observations:
    view, channels, settings = bag.view, bag.channels, bag.settings
    linear_hold = math.isfinite(bag.hold_rate_hz)  # the input goes straight from sample to sample
    lost = [(channel, fault) for channel, fault in stretch.faults.items() if channel in channels]
    notes = [f"{name}: channel {channel} is left out: {fault}." for channel, fault in lost]
    source = stretch.find(Quantity.VOLTAGE) or stretch.find(Quantity.FORCE)
    if source is None or source.name in stretch.faults:
        why = (
            "no voltage or force was recorded"
            if source is None
            else f"its input cannot be used ({stretch.faults[source.name]})"
        )
        return empty((f"{name}: the record is left out: {why}.",))
    recorded = {model_channel.name: theirs for theirs, model_channel in channels.items()}
    present = [
        channel
        for channel in channels.values()
        if recorded[channel.name] in {c.name for c in stretch.channels} - set(stretch.faults) - {source.name}
        and channel.quantity is not Quantity.VOLTAGE
    ]
    if not present or stretch.samples < THRESHOLDS.reading.record_fewest_samples:
        why = "it has no response" if not present else f"{stretch.samples} samples are too few"
        return empty((*notes, f"{name}: the record is left out: {why}."))
    responses = np.array([stretch.row(recorded[channel.name]) for channel in present])
    first = head_of(responses, stretch.sample_rate)
    in_motion = starts_in_motion(responses, first)
    slowest = _slowest(view)
    start = start_of(slowest, stretch) if in_motion else 0
    independent = max(
        THRESHOLDS.reading.record_fewest_rows, int((stretch.samples - start) / stretch.sample_rate * slowest)
    )
    indices = spread_samples(start, stretch.samples, min(independent, max(1, budget // len(present))))
    count = max(1, min(settings.record_segments, indices.size // 20))
    bounds = np.linspace(start, stretch.samples, count + 1).round().astype(np.int64)
    level = np.searchsorted(bounds, indices, side="right") - 1
    source_samples = stretch.row(source.name)
    amplitude = [float(np.std(source_samples[low:high])) for low, high in pairwise(bounds)]
    model_channel = channels.get(source.name, source)
    propagated = _from_input(source_samples, responses, stretch.sample_rate, model_channel, present, view)
    table = RowTable()
    for row, channel in enumerate(present):
        samples = stretch.row(recorded[channel.name])
        samples = samples - samples.mean()
        noise = math.hypot(white_noise(samples, stretch.sample_rate), float(propagated[row]))
        floor = settings.floors.record * float(np.std(samples))
        for index, segment in zip(indices, level, strict=True):
            table.add(
                Part.SAMPLE, float(samples[index]), noise, floor,
                Place(int(segment), (stretch.first_sample + int(index)) / stretch.sample_rate, 0.0, amplitude[segment]),
                row,
            )  # fmt: skip
    factor = 1 if linear_hold else refinement(stretch.row(recorded[present[0].name]), stretch.sample_rate)
    fine = np.arange(factor * stretch.samples) / (factor * stretch.sample_rate)
    head = responses[:, :first] - responses.mean(axis=1, keepdims=True)
    test = DrivenRecord(
        name=name,
        drive_point=view.rig.drive_point,
        sample_rate=factor * stretch.sample_rate,
        input_channel=model_channel,
        input=finer(source_samples, factor, _PADDING_SAMPLES),
        channels=tuple(present),
        segment_bounds=factor * bounds.astype(np.float64),
        start_s=stretch.start_s,
        zeros=np.array([_zero(source_samples, model_channel), *map(_zero, responses, present)]),
        limits=np.array([clipping_level(row) for row in responses]),
        head=head,
        head_stride=factor,
        begins_in_motion=in_motion,
        followed=followed_channels(stretch, source, set(recorded.values()), fine),
        responses=responses,
    )
    return table.observations(test, notes)


def followed_channels(
    stretch: SampleStretch, source: MeasuredChannel, known: Collection[str], fine: FloatArray
) -> dict[str, FloatArray]:
    """Currents, voltages and forces that the model has not, at times from the first sample on, by quantity and name."""
    found = [
        channel
        for channel in stretch.channels
        if channel.quantity in _FOLLOWED
        and channel.name not in {*stretch.faults, source.name}
        and (channel.quantity is not Quantity.FORCE or channel.name not in known)
    ]
    quantities = [channel.quantity for channel in found]
    time = np.arange(stretch.samples) / stretch.sample_rate
    result = {}
    for channel in found:
        name = channel.quantity.name.lower()
        name += f" {channel.name}" if quantities.count(channel.quantity) > 1 else ""
        result[name] = np.interp(fine, time, stretch.row(channel.name))
    return result


def _zero(samples: FloatArray, channel: MeasuredChannel) -> float:
    """Standard deviation of the zero of a channel, in its unit.

    A voltage is that of a converter. Where a motion is zero was nobody's concern, and a force cell carries a weight.
    """
    mean = 0.0 if channel.quantity is Quantity.VOLTAGE else float(samples.mean())
    return math.hypot(TOLERANCES.zero * float(np.abs(samples).max()), mean)


def _from_input(
    source: FloatArray,
    responses: FloatArray,
    sample_rate: float,
    source_channel: MeasuredChannel,
    channels: Sequence[MeasuredChannel],
    view: ModelView,
) -> FloatArray:
    """Standard deviation of what the noise of the measured input makes of each response, (channels,)."""
    noise = input_noise(source, responses, sample_rate)
    lines = noise_lines(view.frequencies_hz, sample_rate, source.size / sample_rate)
    if source_channel.quantity is not Quantity.FORCE:
        return propagated_noise(noise, view.responses(channels, lines), lines)
    force = MeasuredChannel("force", Quantity.FORCE, view.rig.drive_point)
    over_volt = view.responses([force, *channels], lines)
    with np.errstate(divide="ignore", invalid="ignore"):
        return propagated_noise(noise, over_volt[1:] / over_volt[0], lines)


def head_of(responses: FloatArray, sample_rate: float) -> int:
    """Samples from which the state is read that a record begins in: some periods of its strongest line."""
    samples = responses.shape[1]
    centred = responses[0] - responses[0].mean()
    frequency, power = welch(centred, sample_rate, nperseg=min(samples, 4096))
    strongest = float(frequency[1:][np.argmax(power[1:])])
    wanted = math.ceil(THRESHOLDS.reading.record_head_periods * sample_rate / strongest)
    return int(
        min(max(wanted, THRESHOLDS.reading.record_head_samples), THRESHOLDS.reading.record_longest_start * samples)
    )


def starts_in_motion(responses: FloatArray, head: int) -> bool:
    """Whether some channel moves from the first samples on."""
    first = responses[:, : max(3, head // THRESHOLDS.reading.record_head_samples)]
    centre = responses.mean(axis=1, keepdims=True)
    share = np.sqrt(np.mean((first - centre) ** 2, axis=1) / np.maximum(np.var(responses, axis=1), 1e-300))
    return bool(np.any(share > THRESHOLDS.reading.record_rest_share))


def _slowest(view: ModelView) -> float:
    """Smallest decay rate of the model's modes, 1/s."""
    modes = damped_modes(view.system)
    return float(np.min(-modes.eigenvalues.real)) if modes.eigenvalues.size else 0.0


def start_of(slowest: float, stretch: SampleStretch) -> int:
    """First sample that an unknown initial state does not reach, at most a tenth of the record."""
    longest = THRESHOLDS.reading.record_longest_start * stretch.samples
    return int(
        min(
            THRESHOLDS.reading.record_decay_constants / slowest * stretch.sample_rate if slowest > 0.0 else longest,
            longest,
        )
    )
