"""Windows of a bag for the observations: their samples, and the channels that cannot be used with the reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import ROTATION_UNITS
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import Segment, Signals, needed_topics, read_stretches
from nmt_record.windows.window_policy import POLICIES, Consequence


@dataclass(frozen=True, eq=False)
class SampleStretch:
    """Samples of all channels between two sample indices.

    Attributes:
        first_sample: index of the first sample.
        sample_rate: Hz.
        channels: one for each row of ``data``.
        data: shape (channels, samples), NaN where samples are missing.
        cycles: phase of the excitation at each sample, cycles, unwrapped, shape (samples,); None where it is not known
            or nothing oscillates.
        faults: why a channel cannot be used over this stretch, a sentence without its full stop each, by channel name.
        cycles_before: excitation periods from the start of the bag to the middle of the stretch; NaN if not known.
    """

    first_sample: int
    sample_rate: float
    channels: tuple[MeasuredChannel, ...]
    data: FloatArray
    cycles: FloatArray | None
    faults: dict[str, str]
    cycles_before: float

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.data.shape[1])

    @property
    def start_s(self) -> float:
        """Time of the first sample on the clock of the bag, s."""
        return self.first_sample / self.sample_rate

    @property
    def stop_s(self) -> float:
        """Time of the sample after the last, s."""
        return (self.first_sample + self.samples) / self.sample_rate

    def row(self, name: str) -> FloatArray:
        """Samples of a channel, shape (samples,)."""
        names = [channel.name for channel in self.channels]
        result: FloatArray = self.data[names.index(name)]
        return result

    def find(self, quantity: Quantity, point: int | None = None) -> MeasuredChannel | None:
        """First channel of a quantity, at one point if given."""
        for channel in self.channels:
            if channel.quantity is quantity and (point is None or channel.point == point):
                return channel
        return None


def read_windows(bag: Bag, windows: Sequence[Segment]) -> list[SampleStretch | None]:
    """Usable samples of several windows, in one pass.

    Which windows can be used, and how far, says :func:`nmt_record.windows.segments.segments`; here the channels follow.

    Args:
        bag: an opened bag.
        windows: windows that are usable at least in part.

    Returns:
        One for each window; None where the bag holds no sample of it.

    Raises:
        BenchError: the bag is damaged.
    """
    topics = needed_topics(bag)
    found = read_stretches(bag, [(window.usable_first_sample, window.usable_samples) for window in windows])
    return [
        None if signals is None else _stretch(window, signals, topics)
        for window, signals in zip(windows, found, strict=True)
    ]


def _stretch(window: Segment, signals: Signals, topics: Sequence[str]) -> SampleStretch:
    policy = POLICIES[window.kind]
    by_topic: dict[str, str] = {}
    for finding in signals.findings:
        if policy.effect(finding, topics) is Consequence.CHANNELS:
            by_topic.setdefault(finding.topic, finding.reason.rstrip("."))
    faults: dict[str, str] = {}
    for name, samples in signals.channels.items():
        fault = by_topic.get(signals.topics[name]) or _fault_of(name, samples, signals)
        if fault:
            faults[name] = fault
    channels = tuple(
        MeasuredChannel(
            name, signals.quantities[name], signals.points[name], turns=signals.units[name] in ROTATION_UNITS.values()
        )
        for name in signals.channels
    )
    return SampleStretch(
        signals.first_sample,
        signals.sample_rate,
        channels,
        np.stack(list(signals.channels.values())),
        signals.oscillator,
        faults,
        signals.cycles_before,
    )


def _fault_of(name: str, samples: FloatArray, signals: Signals) -> str:
    """What is wrong with one channel; empty if nothing is."""
    finite = np.isfinite(samples)
    if not finite.all():
        where = signals.first_sample + int(np.argmin(finite))
        lost = f"{np.count_nonzero(~finite)} of {samples.size} samples"
        return f"{lost} are missing, NaN or infinite, first at sample {where}"
    if signals.quantities[name] is not Quantity.VOLTAGE and not np.ptp(samples) > 0.0:
        return "it does not move at all; is it connected?"
    return ""
