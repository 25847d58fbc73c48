"""All thresholds of the room of signals: value, unit, reason, and the test that fails when it moves."""

from __future__ import annotations

from dataclasses import dataclass, field

from nmt_signals.thresholds.channel_faults import ChannelFaultThresholds
from nmt_signals.thresholds.decays import DecayThresholds
from nmt_signals.thresholds.fits import SignalFitThresholds


@dataclass(frozen=True)
class SignalThresholds:
    """Thresholds by theme; what a field means stands with it (:mod:`nmt_core.threshold`).

    Attributes:
        channel_faults: clipping, steps of the converter, repeated samples and lines of the mains.
        decays: frequency and damping of decays over their amplitude.
        fits: fits of sines and of rational functions, and averages of frequency responses.
    """

    channel_faults: ChannelFaultThresholds = field(default_factory=ChannelFaultThresholds)
    decays: DecayThresholds = field(default_factory=DecayThresholds)
    fits: SignalFitThresholds = field(default_factory=SignalFitThresholds)


THRESHOLDS = SignalThresholds()
"""The values that are in force."""
CHANNEL_FAULTS, DECAYS, SIGNAL_FITS = THRESHOLDS.channel_faults, THRESHOLDS.decays, THRESHOLDS.fits
"""Their themes."""
