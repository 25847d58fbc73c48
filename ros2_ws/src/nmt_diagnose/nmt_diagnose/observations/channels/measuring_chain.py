"""What the measuring chain of a test may be off by: tolerances of every channel, by the origin of the bag.

The bench's own simulator measures as the rig file says; its bags have no tolerances. A laboratory's sensors and
converters have ordinary ones: gains by the calibration sheet, phases of conditioners, delays of filters and
multiplexers, a zero-order hold of the drive.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from nmt_core.messages.blocks import Quantity
from nmt_core.tolerances import TOLERANCES
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet
from nmt_record.exchange.sidecar.channel_tolerances import (
    ChannelTolerance,
    Tolerances,
    is_simulated,
    tolerances,
)

_VOLTAGE = Quantity.VOLTAGE


@dataclass(frozen=True)
class MeasuringChain:
    """Tolerances of one test.

    Attributes:
        channels: by the model's name of the channel; others have the defaults.
        voltage_gain: relative standard deviation of the recorded or commanded voltage.
        shared_delay_s: standard deviation of a delay that all sensors share against the voltage, and of one that the
            sensors of a kind share, s.
        hold_hz: rate at which the drive may have been held from sample to sample, Hz.
        images: whether images of a drive so held may be in the channels in a way that is not known.
        mains: hum of the mains that is ordinary, over the largest fundamental of its channel.
        clock: relative standard deviation of the sampling clock.
    """

    channels: Mapping[str, ChannelTolerance] = field(default_factory=dict)
    voltage_gain: float = TOLERANCES.gain
    shared_delay_s: float = TOLERANCES.shared_delay_s
    hold_hz: float = math.inf
    images: bool = True
    mains: float = TOLERANCES.mains
    clock: float = TOLERANCES.clock

    def of(self, channel: str) -> ChannelTolerance:
        """Tolerance of a channel."""
        return self.channels.get(channel, ChannelTolerance())


def measuring_chain(
    run: Mapping[str, Any],
    channels: Mapping[str, MeasuredChannel],
    sample_rate: float,
    rig_yaml: str | None = None,
    sheet: CalibrationSheet | None = None,
) -> MeasuringChain | None:
    """Tolerances by what made a bag; None for a run of the bench's own simulator without a calibration sheet.

    A run on a device has the ordinary ones, or those of its rig file's section ``device``.

    Args:
        run: start record of the bag; ``device`` is what it measured. The entry ``imported`` holds the sidecar, whose
            channels may have ``gain_std``, ``phase_std_deg`` and ``delay_std_s``.
        channels: the model's channel by recorded name.
        sample_rate: Hz.
        rig_yaml: rig file in the bag.
        sheet: calibration sheet; counts before what the bag says.
    """
    if is_simulated(run) and sheet is None:
        return None
    stated = tolerances(run, rig_yaml, sheet)
    by_name = {
        tolerance.name: stated.of(tolerance.quantity, tolerance.point)
        for tolerance in channels.values()
        if tolerance.quantity is not _VOLTAGE
    }
    usual = ChannelTolerance()
    named = {name: tolerance for name, tolerance in by_name.items() if tolerance != usual}
    voltage = stated.of(_VOLTAGE, 0)
    return MeasuringChain(named, voltage.gain, _shared_delay(stated), sample_rate, clock=stated.clock)


def table_chain(channels: Sequence[MeasuredChannel] = (), sheet: CalibrationSheet | None = None) -> MeasuringChain:
    """Tolerances of frequency responses that an analyser has reduced.

    Its inputs are sampled together; sensors of different kinds are late by their own conditioners all the same.

    Args:
        channels: of the table.
        sheet: calibration sheet of the analyser's sensors; None = ordinary tolerances.
    """
    if sheet is None:
        return MeasuringChain()
    stated = tolerances({"imported": {}}, None, sheet)
    named = {channel.name: stated.of(channel.quantity, channel.point) for channel in channels}
    return MeasuringChain(named, shared_delay_s=_shared_delay(stated), clock=stated.clock)


def _shared_delay(stated: Tolerances) -> float:
    """Of the voltage's delay against the sensors nothing differs from one of all sensors together."""
    delay_s = stated.of(_VOLTAGE, 0).delay_s
    return delay_s if delay_s != TOLERANCES.delay_s else TOLERANCES.shared_delay_s
