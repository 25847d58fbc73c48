"""Frequency and damping over amplitude of recorded free decays, channel by channel, without force and linear modes.

Each response is read by itself, as the diagnosis reads it (:mod:`nmt_signals.decays.decay_reading`): what is found
belongs to the structure and all that hangs on it. With the decay rate σ of the displacement and the instantaneous
frequency Ω, a vibration whose amplitude changes slowly has ω̃² = Ω² + σ² + (2 δ̃ ω̃ − 2 σ) σ and 2 δ̃ ω̃ = 2 σ − Ω̇/Ω.
The amplitude of a velocity or acceleration changes with Ω too: its own rate is σ − n Ω̇/Ω, n = 1 or 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.whole_file import csv_text, write_result
from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_signals.channel_faults.converter_faults import CONVERTER_BITS, resolution

if TYPE_CHECKING:
    from nmt_signals.decays.decay_nodes import Node
    from nmt_signals.decays.decay_signal import Ridge

COLUMNS = (
    "segment", "channel", "time_s", "amplitude", "unit", "frequency_hz", "frequency_hz_std", "damping_ratio",
    "damping_ratio_std",
)  # fmt: skip
"""Columns of ``decay.csv``."""
_AMPLITUDES = 12  # of a decay, at most
_FLOOR = 1e-5  # uncertainty of ln ω below which a narrower band tells nothing more


@dataclass(frozen=True, eq=False)
class FreeDecay:
    """One channel over one decay; arrays of shape ``(segments,)``.

    Attributes:
        segment: number of the segment, from 1.
        channel: its name.
        unit: of the amplitude.
        time: middle of each segment after the begin of the segment, s.
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

        It is not smaller than that of the best segment; a quantity that changes with
        amplitude adds its scatter.
        """
        values, std = getattr(self, name), getattr(self, f"{name}_std")
        weights = 1.0 / np.maximum(std, 1e-9 * np.abs(values)) ** 2
        centre = float((weights * values).sum() / weights.sum())
        scatter = math.sqrt(float((weights * (values - centre) ** 2).sum() / weights.sum()))
        return centre, math.hypot(float(std.min()), scatter)


def holds_decays_only(bag: Any) -> bool:
    """Whether a bag has free decays and nothing that gives modal points."""
    kinds = {event.test for event in bag.lock_events()}
    return TestKind.RING_DOWN in kinds and not any(kind_class(kind).gives_modal_points for kind in kinds)


def free_decays(bag: Any) -> list[FreeDecay]:
    """All decays of a bag.

    Args:
        bag: opened.

    Raises:
        BenchError: the bag is damaged.
    """
    from nmt_record.windows.segments import read_signals, segments
    from nmt_signals.decays.half_cycles import undriven_from

    found = []
    clock = (bag.run_start or {}).get("imported") or {}
    clock_std = float(clock.get("clock_std") or 0.0) if isinstance(clock, dict) else 0.0
    for number, segment in enumerate(segments(bag), start=1):
        if segment.kind is not TestKind.RING_DOWN:
            continue
        signals = read_signals(bag, segment.first_sample, segment.samples)
        drives = [values for name, values in signals.channels.items() if signals.quantities[name] is Quantity.VOLTAGE]
        begin = undriven_from(drives)
        for name, values in signals.channels.items():
            moves = any(quantity in MOTIONS for quantity in signals.quantities.values())
            quantity = signals.quantities[name]
            if quantity is Quantity.FORCE and not moves:
                quantity = Quantity.DISPLACEMENT  # of a support that the structure shakes: its phase does not matter
            if quantity in MOTIONS:
                place = number, name, signals.units[name]
                found.append(channel_decay(values, signals.sample_rate, quantity, place, clock_std, begin))
    return found


def channel_decay(
    values: FloatArray,
    rate: float,
    quantity: Quantity,
    place: tuple[int, str, str],
    clock_std: float,
    begin: int = 0,
) -> FreeDecay:
    """The decay of one channel.

    Args:
        values: samples from the switch-off, or from some time before an impact on, shape ``(samples,)``.
        rate: Hz.
        quantity: displacement, velocity or acceleration.
        place: number of the segment, name of the channel, its unit.
        clock_std: relative standard uncertainty of the rate.
        begin: sample at which the drive has come to rest.

    Returns:
        The decay; without values, and with the reason, where there is none to be read.
    """
    from nmt_signals.decays.decay_reading import read_decay  # late: scipy, which other bags do not need
    from nmt_signals.decays.half_cycles import half_cycle_nodes, strongest_frequency
    from nmt_signals.thresholds import DECAYS

    nothing: FloatArray = np.empty(0)
    reason = ""
    if not np.isfinite(values).all():
        reason = "Samples are missing in the decay; choose a part of it without."
    elif not np.ptp(values) > 0.0:
        reason = "The channel does not move."
    else:
        values = np.asarray(values, dtype=np.float64)
        frequency_hz = strongest_frequency(values, rate)
        readings: tuple[Callable[[], list[Node]], ...] = (
            lambda: read_decay(values, rate, quantity, strongest_ridge, _AMPLITUDES, _FLOOR).good,
            lambda: [
                replace(node, time_s=node.time_s + begin / rate)
                for node in half_cycle_nodes(values[begin:], rate, frequency_hz)
            ],
        )
        # Over a few periods spectra tell nothing, but turning points do.
        short = values.size / rate * frequency_hz < DECAYS.fewest_periods
        reasons = []
        for reading in readings[::-1] if short else readings:
            try:
                good = reading()
                break
            except BenchError as error:
                reasons.append(str(error))
        else:
            reason = f"The decay cannot be read: {'; '.join(reasons)}."
    if reason:
        return FreeDecay(*place, *(nothing,) * 6, reason=reason)
    time, amplitude, omega, omega_std, sigma, sigma_std, periods = np.array(
        [(n.time_s, n.amplitude, n.omega, n.omega_std, n.rate, n.rate_std, max(n.stop - n.first, 1)) for n in good]
    ).T
    undamped, damping, damping_std = decaying_mode(good, MOTIONS[quantity])
    # No less than rounding to the steps of the channel allows over the segment.
    step = resolution(values) or float(np.ptp(values)) / 2**CONVERTER_BITS
    least = step / math.sqrt(12.0) / amplitude / (2.0 * math.pi * periods)
    hertz, relative = undamped / (2.0 * math.pi), np.hypot(omega_std / omega, sigma * sigma_std / omega**2)
    return FreeDecay(
        *place,
        time=time,
        amplitude=amplitude,
        frequency_hz=hertz,
        frequency_hz_std=hertz * np.hypot(np.maximum(relative, least), clock_std),
        damping_ratio=damping,
        damping_ratio_std=np.maximum(damping_std, least),
    )


def decaying_mode(
    nodes: Sequence[Node], order: int, pull: ComplexArray | complex = 0j
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """ω̃, rad/s, δ̃ and its standard uncertainty of the mode that decays, each of shape ``(nodes,)``.

    Args:
        nodes: of one decay, in time.
        order: 0 where they are of a displacement, 1 of a velocity, 2 of an acceleration.
        pull: F ψ̄_d / q² of a force that acts on the mode, 1/s²: real and imaginary part add to ω̃² and 2 δ̃ ω̃ Ω.
    """
    time, omega, omega_std, sigma, sigma_std = np.array(
        [(n.time_s, n.omega, n.omega_std, n.rate, n.rate_std) for n in nodes]
    ).T
    turning, changing = np.zeros(time.size), np.zeros(time.size)  # Ω̇/Ω and its standard uncertainty
    if time.size > 1:
        slopes: FloatArray = np.asarray(np.gradient(np.eye(time.size), time, axis=0, edge_order=min(2, time.size - 1)))
        turning, changing = slopes @ omega / omega, np.sqrt(slopes**2 @ omega_std**2) / omega
    sigma = sigma + order * turning
    braking = np.imag(pull) / omega
    twice = 2.0 * sigma - turning + braking  # 2 δ̃ ω̃
    undamped = np.sqrt(omega**2 + sigma**2 - turning * sigma + braking * sigma + np.real(pull))
    damping_std = np.hypot(sigma_std, abs(order - 0.5) * changing) / undamped
    return undamped, 0.5 * twice / undamped, damping_std


def strongest_ridge(found: Sequence[Ridge]) -> Ridge:
    """The first of those that were found, strongest first.

    Raises:
        BenchError: there is none.
    """
    if not found:
        raise BenchError("nothing in it oscillates")
    return found[0]


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
