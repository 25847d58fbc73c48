"""What the measuring chain of a test may be off by: tolerances of every channel, by the origin of the bag.

The bench's own simulator measures as the rig file says; its bags have no tolerances. A laboratory's sensors and
converters have ordinary ones: gains by the calibration sheet, phases of conditioners, delays of filters and
multiplexers, a drive that is held from sample to sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from nmt_diagnose.evidence.conditions import MeasuredChannel
from nmt_record.run_device import SIMULATED_RIG

GAIN_STD = 0.01
PHASE_STD_DEG = 0.2
DELAY_STD_S = 1e-5
SHARED_DELAY_STD_S = 1e-4


@dataclass(frozen=True)
class ChannelTolerance:
    """Standard deviations of what a channel may be off by.

    Attributes:
        gain: relative.
        phase: the same at all frequencies, rad.
        delay_s: its own, s.
    """

    gain: float = GAIN_STD
    phase: float = math.radians(PHASE_STD_DEG)
    delay_s: float = DELAY_STD_S


@dataclass(frozen=True)
class MeasuringChain:
    """Tolerances of one test.

    Attributes:
        channels: by the model's name of the channel; others have the defaults.
        voltage_gain: relative standard deviation of the recorded or commanded voltage.
        shared_delay_s: standard deviation of a delay that all sensors share against the voltage, and of one that the
            sensors of a kind share, s.
        hold_hz: rate at which the drive may have been held from sample to sample, Hz.
        mains: hum of the mains that is ordinary, over the largest fundamental of its channel.
        clock: relative standard deviation of the sampling clock.
    """

    channels: Mapping[str, ChannelTolerance] = field(default_factory=dict)
    voltage_gain: float = GAIN_STD
    shared_delay_s: float = SHARED_DELAY_STD_S
    hold_hz: float = math.inf
    mains: float = 1e-3
    clock: float = 3e-5

    def of(self, channel: str) -> ChannelTolerance:
        """Tolerance of a channel."""
        return self.channels.get(channel, ChannelTolerance())


def measuring_chain(
    run: Mapping[str, Any], channels: Mapping[str, MeasuredChannel], sample_rate: float
) -> MeasuringChain | None:
    """Tolerances by what made a bag; None for a run of the bench's own simulator.

    A run on a device has the ordinary ones.

    Args:
        run: start record of the bag; ``device`` is what it measured. The entry ``imported`` holds the sidecar, whose
            channels may have ``gain_std``, ``phase_std_deg`` and ``delay_std_s``.
        channels: the model's channel by recorded name.
        sample_rate: Hz.
    """
    imported = run.get("imported")
    if not isinstance(imported, dict):
        device = run.get("device")
        measured = isinstance(device, str) and device not in ("", SIMULATED_RIG)
        return MeasuringChain(hold_hz=sample_rate) if measured else None
    sidecar = imported.get("sidecar")
    sections = sidecar.get("channels") if isinstance(sidecar, dict) else None
    by_name: dict[str, ChannelTolerance] = {}
    voltage, shared = GAIN_STD, SHARED_DELAY_STD_S
    for section in sections if isinstance(sections, list) else ():
        if section.get("quantity") == "voltage":
            voltage = _stated(section, "gain_std", voltage)
            # Of the voltage's delay against the sensors nothing differs from one of all sensors together.
            shared = _stated(section, "delay_std_s", shared)
            continue
        own = _channel(section, channels)
        if own is not None:
            by_name[own] = ChannelTolerance(
                _stated(section, "gain_std", GAIN_STD),
                math.radians(_stated(section, "phase_std_deg", PHASE_STD_DEG)),
                _stated(section, "delay_std_s", DELAY_STD_S),
            )
    return MeasuringChain(by_name, voltage, shared, sample_rate)


def table_chain() -> MeasuringChain:
    """Tolerances of frequency responses that an analyser has reduced: its channels are sampled together."""
    return MeasuringChain(shared_delay_s=DELAY_STD_S)


def _stated(section: Mapping[str, Any], key: str, default: float) -> float:
    value = section.get(key)
    return default if value is None else float(value)


def _channel(section: Mapping[str, Any], channels: Mapping[str, MeasuredChannel]) -> str | None:
    """The model's name of a sidecar's channel."""
    recorded = section.get("name")
    if recorded in channels:
        return channels[str(recorded)].name
    place = section.get("quantity"), section.get("point", 0)
    return next((own.name for own in channels.values() if (own.quantity.name.lower(), own.point) == place), None)
