"""Frequency and damping over amplitude of recorded free decays, channel by channel, without force and linear modes.

What :mod:`nmt_extract.ring_down` finds of a structure, here of each response by itself: it belongs to the structure and
all that hangs on it. Source of the equations: there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.whole_file import csv_text, write_result
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_extract.ring_down import DecaySettings, decay_of
from nmt_extract.window_judge import CONVERTER_BITS, resolution
from nmt_signals.sine_fit import strongest_line

COLUMNS = (
    "segment", "channel", "time_s", "amplitude", "unit", "frequency_hz", "frequency_hz_std", "damping_ratio",
    "damping_ratio_std",
)  # fmt: skip
"""Columns of ``decay.csv``."""


@dataclass(frozen=True, eq=False)
class FreeDecay:
    """One channel over one decay; arrays of shape ``(windows,)``.

    Attributes:
        segment: number of the segment, from 1.
        channel: its name.
        unit: of the amplitude.
        time: middle of each window after the begin of the segment, s.
        amplitude: of the channel, in its unit.
        frequency_hz, frequency_hz_std: of the decaying oscillation.
        damping_ratio, damping_ratio_std: 1.
        reason: one sentence why there is nothing; else empty.
    """

    segment: int
    channel: str
    unit: str
    time: FloatArray
    amplitude: FloatArray
    frequency_hz: FloatArray
    frequency_hz_std: FloatArray
    damping_ratio: FloatArray
    damping_ratio_std: FloatArray
    reason: str = ""

    def mean(self, name: str) -> tuple[float, float]:
        """Mean of a quantity over the decay, weighted by its uncertainties, and the standard uncertainty of it.

        Neighbouring windows overlap, so it is no smaller than that of the best window; a quantity that changes with
        amplitude adds its scatter.
        """
        values, std = getattr(self, name), getattr(self, f"{name}_std")
        weights = 1.0 / np.maximum(std, 1e-9 * np.abs(values)) ** 2
        centre = float((weights * values).sum() / weights.sum())
        scatter = math.sqrt(float((weights * (values - centre) ** 2).sum() / weights.sum()))
        return centre, math.hypot(float(std.min()), scatter)


def holds_decays_only(bag: Any) -> bool:
    """Whether a bag has free decays, no linear modes and nothing that gives modal points."""
    if (bag.run_start or {}).get("linear") is not None:
        return False
    kinds = {event.test for event in bag.lock_events()}
    return TestKind.RING_DOWN in kinds and not any(kind.gives_modal_points for kind in kinds)


def free_decays(bag: Any, settings: DecaySettings | None = None) -> list[FreeDecay]:
    """All decays of a bag.

    Args:
        bag: opened.
        settings: how decays are cut.

    Raises:
        BenchError: the bag is damaged.
    """
    from nmt_record.windows.segments import read_signals, segments

    found = []
    clock = (bag.run_start or {}).get("imported") or {}
    clock_std = float(clock.get("clock_std") or 0.0) if isinstance(clock, dict) else 0.0
    for number, segment in enumerate(segments(bag), start=1):
        if segment.kind is not TestKind.RING_DOWN:
            continue
        signals = read_signals(bag, segment.first_sample, segment.samples)
        for name, values in signals.channels.items():
            moves = any(quantity in MOTIONS for quantity in signals.quantities.values())
            quantity = signals.quantities[name]
            if quantity is Quantity.FORCE and not moves:
                quantity = Quantity.DISPLACEMENT  # of a support that the structure shakes: its phase does not matter
            if quantity in MOTIONS:
                place = number, name, signals.units[name]
                found.append(_decay(values, signals.sample_rate, quantity, place, settings, clock_std))
    return found


def _decay(
    values: FloatArray,
    rate: float,
    quantity: Quantity,
    place: tuple[int, str, str],
    settings: DecaySettings | None,
    clock_std: float,
) -> FreeDecay:
    nothing: FloatArray = np.empty(0)
    try:
        if not np.isfinite(values).all():
            raise BenchError("Samples are missing in the decay; choose a part of it without.")
        if not np.ptp(values) > 0.0:
            raise BenchError("The channel does not move.")
        centred = np.asarray(values - values.mean(), dtype=np.float64)
        frequency = strongest_line(centred, rate)
        omega = 2.0 * math.pi * frequency
        linear = LinearDescription(
            source="test", drive_point=1, target_mode=0, points=(1,), frequencies_rad_s=(omega,),
            damping_ratios=(0.01,), shapes=((1.0,),), drive_point_shape=1.0, plant_frequency_rad_s=omega,
            plant_damping_ratio=0.01, moving_mass_kg=0.0,
        )  # fmt: skip
        data = np.stack([np.zeros(values.size), centred])
        decay = decay_of(data, rate, linear, quantity, frequency, settings or DecaySettings(skip=0.0))
    except BenchError as error:
        return FreeDecay(*place, *(nothing,) * 6, reason=str(error))
    hertz = decay.apparent_omega_rad_s / (2.0 * math.pi)
    amplitude = decay.modal_amplitude * decay.apparent_omega_rad_s ** MOTIONS[quantity]
    # No less than rounding to the steps of the channel allows over the shortest window.
    step = resolution(values) or float(np.ptp(values)) / 2**CONVERTER_BITS
    least = step / math.sqrt(12.0) / amplitude / (2.0 * math.pi * (settings or DecaySettings()).fewest_periods)
    own = np.maximum(decay.apparent_omega_rad_s_std / (2.0 * math.pi), least * hertz)
    return FreeDecay(
        *place,
        time=decay.time,
        amplitude=amplitude,
        frequency_hz=hertz,
        frequency_hz_std=np.hypot(own, clock_std * hertz),
        damping_ratio=decay.apparent_damping_ratio,
        damping_ratio_std=np.maximum(decay.apparent_damping_ratio_std, least),
    )


def write_decays(decays: Sequence[FreeDecay], path: Path) -> None:
    """Write ``decay.csv``: a line for each window of each channel.

    Raises:
        BenchError: the file cannot be written.
    """
    rows: list[Sequence[object]] = [COLUMNS]
    for decay in decays:
        for k in range(decay.time.size):
            values = (
                decay.frequency_hz, decay.frequency_hz_std, decay.damping_ratio, decay.damping_ratio_std
            )  # fmt: skip
            rows.append(
                [decay.segment, decay.channel, repr(float(decay.time[k])), repr(float(decay.amplitude[k])), decay.unit]
                + [repr(float(own[k])) for own in values]
            )
    write_result(path, csv_text(rows))
