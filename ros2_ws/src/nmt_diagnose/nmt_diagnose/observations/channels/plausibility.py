"""What cannot be right in a real side: scales, signs, clipped converters, the wrong rig. Each a sentence."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.model_view import ModelView, nearest_ratio
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_signals.channel_faults.clipping import clipping_level
from nmt_signals.channel_faults.converter_faults import repeated_share
from nmt_signals.harmonics import harmonic_amplitudes


def check_frequency(name: str, frequency_hz: Sequence[float], view: ModelView) -> None:
    """Refuse windows that lie at no mode of the model.

    Raises:
        BenchError: all windows are further than 60 % from every mode.
    """
    ratios = [nearest_ratio(value, view.frequencies_hz) for value in frequency_hz if value > 0.0]
    if ratios and all(max(ratio, 1.0 / ratio) > THRESHOLDS.reading.wrong_frequency_ratio for ratio in ratios):
        modes = ", ".join(f"{value:.4g}" for value in view.frequencies_hz)
        raise BenchError(
            f"{name} was locked at {min(frequency_hz):.4g} Hz, but the model {view.rig.name} has its modes at {modes} "
            "Hz; name the rig file of the rig that was tested, or the right sampling rate."
        )


def out_of_scale(
    name: str, stretches: Sequence[tuple[SampleStretch, float]], view: ModelView, channels: dict[str, MeasuredChannel]
) -> tuple[set[str], list[str]]:
    """Channels whose size can only be a wrong unit, from windows of nearly one frequency.

    Every channel is compared with the model's linear response; the ratio of one channel to the median over quantities
    shows a wrong scale. The response is that at the frequency of the window or, where channels agree better there, at
    that of the mode next to it: a nonlinear rig is in resonance far from its linear frequency.

    Args:
        name: name of the test.
        stretches: samples and excitation frequency (Hz) of some windows, the lowest levels first.
        view: the model.
        channels: the model's channel for each recorded one.

    Returns:
        Names (in the bag) of channels to leave out, and sentences.

    Raises:
        BenchError: most channels are off, so that none can be trusted.
    """
    logs: dict[str, list[float]] = {}
    for stretch, frequency in stretches:
        names = [c.name for c in stretch.channels if c.name in channels and c.name not in stretch.faults]
        if not names or not frequency > 0.0:
            continue
        steady = np.asarray(frequency * np.arange(stretch.samples) / stretch.sample_rate, dtype=np.float64)
        cycles = steady if stretch.cycles is None else stretch.cycles
        try:
            found = harmonic_amplitudes(cycles, np.stack([stretch.row(n) for n in names]), 1)[:, 1]
        except BenchError:
            continue
        measured, amplitudes = np.abs(found), dict(zip(names, map(complex, found), strict=True))
        model_channels = [channels[n] for n in names]
        # Each exciter drives as its voltage says; without those of several exciters nothing can be expected.
        terms = [amplitudes.get(name, math.nan) for name in view.voltages(stretch.channels)]
        terms = [1.0] if len(terms) == 1 else [term / terms[0] for term in terms]
        if not np.all(np.isfinite(terms)):
            continue
        places = np.array([frequency, frequency / nearest_ratio(frequency, view.frequencies_hz)])
        expected = np.abs(view.responses(model_channels, places, terms)).T
        target_mode, next_mode = (_ratios(names, model_channels, measured, each) for each in expected)
        for recorded, value in min(target_mode, next_mode, key=_spread).items():
            logs.setdefault(recorded, []).append(value)
    ratios = {recorded: float(np.median(values)) for recorded, values in logs.items()}
    if len(ratios) < 3:
        return set(), []
    # One vote per quantity: the channels of one converter are often wrong together.
    by_quantity: dict[Quantity, list[float]] = {}
    for recorded, value in ratios.items():
        by_quantity.setdefault(channels[recorded].quantity, []).append(value)
    middle = float(np.median([np.median(values) for values in by_quantity.values()]))
    off: set[str] = set()
    notes = []
    for recorded, value in ratios.items():
        kind = channels[recorded].quantity
        # The force depends much on how near resonance is, and on the damping there.
        limit = (
            THRESHOLDS.reading.wrong_unit_ratio_force if kind is Quantity.FORCE else THRESHOLDS.reading.wrong_unit_ratio
        )
        if abs(value - middle) > math.log(limit):
            off.add(recorded)
            factor = math.exp(value - middle)
            notes.append(
                f"{name}: channel {recorded} ({kind.name.lower()}) is {factor:.3g} times as large as the others "
                f"let expect ({_guess(factor)}) and is left out; correct its unit or scale."
            )
    trusted = [recorded for recorded in ratios if recorded not in off and channels[recorded].quantity in MOTIONS]
    if not trusted or len({channels[recorded].quantity for recorded in off}) > 0.5 * len(by_quantity):
        raise BenchError(
            f"{name}: the channels do not agree on their scale with the model {view.rig.name} "
            f"({', '.join(sorted(off))} differ from the rest by factors of more than "
            f"{THRESHOLDS.reading.wrong_unit_ratio:g}); correct units "
            "and points, or name the rig file of the rig that was tested."
        )
    return off, notes


def _ratios(
    names: Sequence[str], channels: Sequence[MeasuredChannel], measured: FloatArray, expected: FloatArray
) -> dict[str, float]:
    """ln of measured over expected amplitude of the channels that are at no node, by name."""
    largest: dict[Quantity, float] = {}
    for channel, value in zip(channels, expected, strict=True):
        largest[channel.quantity] = max(largest.get(channel.quantity, 0.0), float(value))
    return {
        name: math.log(size / value)
        for name, channel, size, value in zip(names, channels, measured, expected, strict=True)
        if value > THRESHOLDS.reading.near_node_share * largest[channel.quantity] and size > 0.0
    }


def _spread(ratios: dict[str, float]) -> float:
    return max(ratios.values()) - min(ratios.values()) if ratios else math.inf


def _guess(factor: float) -> str:
    for value, text in (
        (1000.0, "mm for m, or mN for N?"),
        (1e-3, "m for mm, or N for mN?"),
        (1e6, "µm for m?"),
        (9.80665, "m/s² taken for g?"),
        (1.0 / 9.80665, "g taken for m/s²?"),
    ):
        if abs(math.log(abs(factor) / value)) < math.log(1.6):
            return text
    return "a wrong scale?"


def clipping_notes(name: str, windows: Sequence[tuple[int, SampleStretch]]) -> list[str]:
    """Sentences on clipped channels.

    The rows stay, because clipping is an effect; a window in which a converter said that it was overloaded is rejected
    before it comes here.
    """
    clipped: dict[str, list[int]] = {}
    for level, stretch in windows:
        for channel in stretch.channels:
            usable = channel.name not in stretch.faults and channel.quantity is not Quantity.VOLTAGE
            if usable and clipping_level(stretch.row(channel.name)) > 0.0:
                clipped.setdefault(channel.name, []).append(level)
    return [
        f"{name}: channel {channel} is clipped at level {', '.join(map(str, levels))}; its observables are kept, "
        "because clipping is one of the effects of the library."
        for channel, levels in clipped.items()
    ]


def repeats_notes(name: str, stretches: Sequence[SampleStretch]) -> list[str]:
    """Sentences on channels in which samples were lost and the ones before recorded again."""
    found: dict[str, list[FloatArray]] = {}
    for stretch in stretches:
        for channel in stretch.channels:
            if channel.name not in stretch.faults and channel.quantity is not Quantity.VOLTAGE:
                found.setdefault(channel.name, []).append(stretch.row(channel.name))
    shares = {channel: repeated_share(*windows) for channel, windows in found.items()}
    return [
        f"{name}: channel {channel} repeats the sample before at {100.0 * share:.2g} % of the times; samples are "
        "lost on the way, so check its converter, driver and cable."
        for channel, share in shares.items()
        if share > 0.0
    ]
