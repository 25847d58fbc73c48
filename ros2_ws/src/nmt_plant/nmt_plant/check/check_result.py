"""What a check of every channel and of the loop finds."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from nmt_core.files.plain_json import plain_json


class CheckFinding(NamedTuple):
    """Something that is not right.

    Attributes:
        name: of the kind: noise, mains, offset, overload, open, short, icp, sign, force_response, permuted,
            sensitivity, late, no_drive, headroom, rate, delay, resonance, losses, limit.
        channels: that have it; empty = the whole bench.
        sentence: what was found.
        remedy: what fixes it.
    """

    name: str
    channels: tuple[str, ...]
    sentence: str
    remedy: str


@dataclass(frozen=True)
class ChannelFigures:
    """What was found of a channel, at its port.

    Attributes:
        channel, port, unit: as in the channel map.
        noise_v: rms without mains and mean, V.
        noise: the same in the sensor's unit.
        mains_v: amplitude at the mains' frequency, V.
        offset_v: mean, V.
        coherence: with the drive, median over the band.
        gain: measured over expected, 1; NaN where it does not follow the drive. Negative = wrong sign.
        gain_std: its standard uncertainty; NaN where the channel was not fitted, as for those that follow.
        delay, delay_std: later than the median of the channels, s.
        damping_error, frequency_error: relative errors of δ̃ and ω̃ that this gain and this delay make in a test.
        headroom: share of the range that the planned levels reach by linear reckoning; NaN as above.
    """

    channel: str
    port: str
    unit: str
    noise_v: float
    noise: float
    mains_v: float
    offset_v: float
    coherence: float
    gain: float
    headroom: float
    gain_std: float = math.nan
    delay: float = math.nan
    delay_std: float = math.nan
    damping_error: float = math.nan
    frequency_error: float = math.nan


@dataclass(frozen=True)
class ModeFigures:
    """A mode of the model as the responses have it, with standard uncertainties.

    Attributes:
        number: in the model, from 1.
        frequency_hz, frequency_std: Hz; model_hz: the model's.
        damping_ratio, damping_std: 1; model_damping: the model's.
    """

    number: int
    frequency_hz: float
    frequency_std: float
    model_hz: float
    damping_ratio: float
    damping_std: float
    model_damping: float


@dataclass(frozen=True)
class CheckResult:
    """Outcome of a check.

    Attributes:
        findings: what is not right; empty = passed.
        channels: figures of every channel.
        drive_peak_v: largest magnitude put out, V; drive_limit_v: what a hundredth of the limit is.
        delay_samples, round_trip_samples, stated_samples: see `hardware_rig.ConverterFigures`.
        clock_ppm: of the converter against the computer; NaN where it was not measured.
        frequency_hz, expected_hz: of the target mode with exciter, found and expected, Hz.
        lost_blocks: blocks with lost samples.
        modes: of the model, in the band of the check.
    """

    findings: tuple[CheckFinding, ...]
    channels: tuple[ChannelFigures, ...]
    drive_peak_v: float
    drive_limit_v: float
    delay_samples: int
    round_trip_samples: int
    stated_samples: int
    clock_ppm: float
    frequency_hz: float
    expected_hz: float
    lost_blocks: int
    modes: tuple[ModeFigures, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    def to_mapping(self) -> dict[str, Any]:
        """As JSON takes it; not-a-number becomes None."""
        values = {**asdict(self), "findings": [each._asdict() for each in self.findings], "passed": self.passed}
        cleaned: dict[str, Any] = plain_json(values)
        return cleaned
