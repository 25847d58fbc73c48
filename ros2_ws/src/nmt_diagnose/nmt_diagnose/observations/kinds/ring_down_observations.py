"""Observables of ring-downs: instantaneous frequency and damping ratio over amplitude, and the shape of the response.

Frequency, start and end of the decay are found in the data; the model only says which of several decaying modes it has.
What cannot be used of a decay is left out, with the reason, and the rest stays.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.conditions import MeasuredChannel, RingDownTest
from nmt_diagnose.observations.model_view import ModelView, nearest_ratio
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.row_table import Place, RowTable, empty
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_signals.decays.decay_hum import Hum, without_hum
from nmt_signals.decays.decay_nodes import Node, nodes, ratio_at
from nmt_signals.decays.decay_signal import Ridge, SlowAmplitude, demodulated, ridges, slow_amplitude
from nmt_signals.decays.half_cycles import half_cycle_nodes
from nmt_signals.thresholds import DECAYS

_ORDER = (Quantity.DISPLACEMENT, Quantity.ACCELERATION, Quantity.VELOCITY)


@dataclass(frozen=True)
class _Decay:
    """What was found in one channel."""

    slow: SlowAmplitude
    nodes: list[Node]
    good: list[Node]
    ridge: Ridge
    hum: tuple[Hum, ...]
    others: FloatArray  # motion in other modes over that in this one at each good node, squared


def ring_down_observations(
    name: str,
    stretch: SampleStretch,
    frequency_hz: float,
    view: ModelView,
    channels: dict[str, MeasuredChannel],
    settings: ObservationSettings,
    response_quantity: Quantity | None = None,
) -> Observations:
    """Observables of one free decay.

    Args:
        name: name of the test.
        stretch: samples from the switch-off or from some time before an impact on.
        frequency_hz: at the switch-off, Hz; NaN or 0 = not known.
        view: the model, driven at the test's drive point.
        channels: the model's channel for each recorded one.
        settings: settings.
        response_quantity: preferred quantity of the response.
    """
    notes: list[str] = []
    usable = [
        c for c in stretch.channels if c.name in channels and c.name not in stretch.faults and c.quantity in MOTIONS
    ]
    if not usable:
        return empty((f"{name}: the ring-down is left out: there is no usable response.",))
    order: Sequence[Quantity] = ((response_quantity,) if response_quantity is not None else ()) + _ORDER
    usable.sort(key=lambda c: (channels[c.name].point != view.rig.drive_point, order.index(c.quantity)))
    reason, decay, model_channel = "", None, usable[0]
    for model_channel in usable:
        try:
            decay = _decay(stretch, model_channel, frequency_hz, view, settings)
            break
        except BenchError as error:
            reason = reason or str(error)
    if decay is None:
        return _short_decay(name, stretch, usable[0], channels, view, settings, reason)
    others = [c for c in usable if c is not model_channel]
    table = RowTable()
    floors = settings.floors
    amplitudes = _add_nodes(table, decay.good, stretch, settings, decay.others)
    for index, other in enumerate(others, start=1):
        samples = stretch.row(other.name)
        samples, _ = without_hum(
            samples - samples.mean(), stretch.sample_rate, decay.ridge, THRESHOLDS.reading.decay_switch_off_periods
        )
        values = demodulated(samples, decay.slow.cycles, decay.slow.width)[:: decay.slow.stride]
        for level, node in enumerate(decay.good):
            ratio, std = ratio_at(node, decay.slow, values)
            if not std < THRESHOLDS.reading.decay_largest_ratio_std:
                continue
            place = Place(level, stretch.start_s + node.time_s, node.omega / (2.0 * math.pi), node.amplitude)
            size = math.log(abs(ratio) * node.amplitude)
            std = math.hypot(std, 2.0 * _shift(node, _rest(decay.good), decay.others[level]))
            table.add(Part.LOG_MAGNITUDE, size, std, floors.decay_shape, place, index, 1)
            table.add(Part.PHASE, cmath.phase(ratio), std, floors.decay_shape, place, index, 1)
    notes += _notes(name, decay)
    test = RingDownTest(
        name,
        view.rig.drive_point,
        channels[model_channel.name],
        np.array(amplitudes),
        decay.good[-1].omega / (2.0 * math.pi),
        tuple(channels[other.name] for other in others),
    )
    return table.observations(test, notes)


def _add_nodes(
    table: RowTable, good: list[Node], stretch: SampleStretch, settings: ObservationSettings, others: FloatArray
) -> list[float]:
    """Rows of frequency and damping of every node; returns their amplitudes."""
    floors, small_amplitude = settings.floors, _rest(good)
    for level, (node, bend, other) in enumerate(zip(good, _bends(good), others, strict=True)):
        place = Place(level, stretch.start_s + node.time_s, node.omega / (2.0 * math.pi), node.amplitude)
        shift = _shift(node, small_amplitude, other)
        std = math.hypot(node.omega_std / node.omega, bend * node.log_std, shift)
        table.add(Part.LOG_FREQUENCY, math.log(node.omega), std, floors.decay_log_frequency, place, 0, 1)
        # The shape follows that shift, and so the amplitude, as the other mode decays.
        more = math.hypot(
            THRESHOLDS.reading.decay_cross_shift * other * (node.damping - small_amplitude.damping),
            4.0 * node.damping * shift,
        )
        std = math.hypot(node.rate_std / node.omega, more, THRESHOLDS.reading.decay_slow_share * bend * node.damping)
        if std < max(THRESHOLDS.reading.decay_worst_damping_std * abs(node.damping), 1e-5):
            table.add(Part.DAMPING, node.damping, std, floors.decay_damping * abs(node.damping), place, 0, 1)
    return [node.amplitude for node in good]


def _rest(good: list[Node]) -> Node:
    return min(good, key=lambda node: node.amplitude)


def _shift(node: Node, small_amplitude: Node, other: float) -> float:
    """Uncertainty of ln ω at a node where other modes ring too, with ``other`` times its motion squared.

    What bends the backbone sees their motion as well, but how much of it is not known.
    """
    return abs(THRESHOLDS.reading.decay_cross_shift * other * math.log(node.omega / small_amplitude.omega))


def _short_decay(
    name: str,
    stretch: SampleStretch,
    channel: MeasuredChannel,
    channels: dict[str, MeasuredChannel],
    view: ModelView,
    settings: ObservationSettings,
    reason: str,
) -> Observations:
    """Observables of a decay of too few periods for spectra: by its turning points, where there are enough of them."""
    model_channel, lowest = channels[channel.name], float(min(view.frequencies_hz))
    if (
        stretch.samples / stretch.sample_rate * lowest
        > THRESHOLDS.reading.decay_few_spectral_periods * DECAYS.fewest_periods
    ):
        return empty((f"{name}: the ring-down is left out: {reason}.",))
    try:
        good = half_cycle_nodes(stretch.row(channel.name), stretch.sample_rate, lowest)
    except BenchError as error:
        return empty((f"{name}: the ring-down is left out: {reason}; {error}.",))
    table = RowTable()
    amplitudes = _add_nodes(table, good, stretch, settings, np.zeros(len(good)))
    note = f"{name}: the decay lasts a few periods only: frequency and damping are those between its turning points."
    test = RingDownTest(
        name, view.rig.drive_point, model_channel, np.array(amplitudes), good[-1].omega / (2.0 * math.pi)
    )
    return table.observations(test, [note])


def _decay(
    stretch: SampleStretch,
    channel: MeasuredChannel,
    frequency_hz: float,
    view: ModelView,
    settings: ObservationSettings,
) -> _Decay:
    """Amplitudes, frequencies and damping ratios of one channel's decay.

    Raises:
        BenchError: nothing of it can be used.
    """
    samples = stretch.row(channel.name)
    samples = samples - samples.mean()
    found_ridges = ridges(samples, stretch.sample_rate, channel.quantity)
    ridge = _chosen(found_ridges, frequency_hz, view, samples.size / stretch.sample_rate)
    samples, hum = without_hum(samples, stretch.sample_rate, ridge, THRESHOLDS.reading.decay_switch_off_periods)
    best: _Decay | None = None
    reason = ""
    for width in THRESHOLDS.reading.decay_widths:
        try:
            slow = slow_amplitude(samples, stretch.sample_rate, ridge, width)
        except BenchError as error:
            reason = reason or str(error)
            continue
        found = nodes(slow, settings.decay_points, THRESHOLDS.reading.decay_switch_off_periods)
        good = [
            node
            for node in found
            if node.omega > 0.0 and node.omega_std < THRESHOLDS.reading.decay_largest_log_std * node.omega
        ]
        if not good:
            reason = reason or "the decay does not stand out of the noise, or something else rings on"
            continue
        decay = _Decay(slow, found, good, ridge, hum, _in_others(good, ridge, found_ridges, hum))
        # A narrower band lets less of other modes through, but makes less of a fast decay.
        if best is None or _pays(decay, best, settings.floors.decay_log_frequency):
            best = decay
    if best is None:
        raise BenchError(reason)
    return best


def _in_others(good: list[Node], followed: Ridge, found: list[Ridge], hum: tuple[Hum, ...]) -> FloatArray:
    """Square of the motion in other modes over that in the own one at each node, shape (nodes,).

    Harmonics are no other mode, nor is the mains. Of slower modes velocities are compared, not displacements: a body
    that swings on its suspension does not strain.
    """
    total = np.zeros(followed.time_s.size)
    for ridge in found:
        ratio = ridge.late_hz / followed.late_hz
        foreign = any(abs(ridge.late_hz / line.frequency_hz - 1.0) < THRESHOLDS.reading.decay_same_line for line in hum)
        if (
            ridge is followed
            or foreign
            or abs(ratio - max(1.0, round(ratio))) < THRESHOLDS.reading.decay_same_line * ratio
        ):
            continue
        energy = np.interp(followed.time_s, ridge.time_s, np.where(ridge.clear, ridge.energy, 0.0))
        total += energy / np.maximum(followed.energy, 1e-300) / max(1.0, ratio) ** 2
    return np.asarray(np.interp([node.time_s for node in good], followed.time_s, total))


def _bends(good: list[Node]) -> FloatArray:
    """Slope of ln ω over ln A at each node, shape (nodes,): it carries over what the amplitudes are uncertain by."""
    if len(good) < 2:
        return np.zeros(len(good))
    log = np.log([node.amplitude for node in good])
    order = np.argsort(log)
    slopes = np.zeros(len(good))
    apart = np.unique(log).size == log.size
    slopes[order] = np.gradient(np.log([good[i].omega for i in order]), log[order]) if apart else 0.0
    return slopes


def _pays(narrower: _Decay, wider: _Decay, floor: float) -> bool:
    """Whether a narrower band tells far more of the frequency over most of the amplitudes that either covers.

    Fewer and longer segments are each more certain and say no more. What is known better than to the floor that
    observables have, relative, tells nothing more either: else quiet small amplitudes outvote the large ones.
    """
    ends = [end for decay in (narrower, wider) for node in decay.good for end in _reach(decay, node)]
    grid = np.linspace(min(ends), max(ends), THRESHOLDS.reading.decay_compared_amplitudes)
    gain = _covered(narrower, grid, floor) > _covered(wider, grid, floor) / THRESHOLDS.reading.decay_narrower_gain**2
    return float(np.mean(gain)) > 0.5


def _reach(decay: _Decay, node: Node) -> tuple[float, float]:
    """Smallest and largest ln of the amplitude in a node's segment."""
    log = decay.slow.log[node.first : node.stop]
    return float(log.min()), float(log.max())


def _covered(decay: _Decay, log: FloatArray, floor: float) -> FloatArray:
    """What a decay tells of ln ω per unit of ln A, shape of ``log``; 0 where it has no segment."""
    covered = np.zeros(log.shape)
    for node in decay.good:
        low, high = _reach(decay, node)
        inside = (log >= low) & (log <= high)
        covered[inside] = 1.0 / (math.hypot(node.omega_std / node.omega, floor) ** 2 * max(high - low, 1e-9))
    return covered


def _chosen(found: list[Ridge], frequency_hz: float, view: ModelView, seconds: float) -> Ridge:
    """The ridge of the mode that was excited; else the strongest that the model has a mode for.

    Raises:
        BenchError: none oscillates at a mode of the model.
    """
    if not found:
        raise BenchError("nothing in it oscillates")
    if frequency_hz > 0.0:
        return min(found, key=lambda ridge: abs(math.log(ridge.frequency_hz[0] / frequency_hz)))
    for ridge in found:
        ratio = nearest_ratio(ridge.late_hz, view.frequencies_hz)
        if (
            1.0 / THRESHOLDS.reading.decay_wrong_frequency_ratio
            < ratio
            < THRESHOLDS.reading.decay_wrong_frequency_ratio
        ):
            return ridge
    frequencies = ", ".join(f"{ridge.late_hz:.4g}" for ridge in found)
    lowest = float(min(view.frequencies_hz))
    if seconds * lowest < DECAYS.fewest_periods:
        raise BenchError(
            f"its {seconds:.4g} s are {seconds * lowest:.2g} periods of the mode at {lowest:.4g} Hz, and a decay needs "
            f"{DECAYS.fewest_periods}"
        )
    modes = ", ".join(dict.fromkeys(f"{value:.4g}" for value in view.frequencies_hz[:4]))
    raise BenchError(f"it decays at {frequencies} Hz, where the model {view.rig.name} has no mode (it has {modes} Hz)")


def _notes(name: str, decay: _Decay) -> list[str]:
    """What of a decay is not used, and why."""
    result = []
    if len(decay.good) < THRESHOLDS.reading.decay_few_nodes:
        result.append(
            f"{name}: frequency and damping could be read at {len(decay.good)} of the decay's amplitudes only, which "
            "say little of what changes with the amplitude: hit harder, or record nearer to where the mode moves."
        )
    most = math.sqrt(float(decay.others.max()))
    if most > THRESHOLDS.reading.decay_other_mode_share:
        result.append(
            f"{name}: other modes ring too, with {100.0 * most:.0f} % of the mode's motion at its "
            "largest amplitude; what they change is part of the stated uncertainties."
        )
    left = [node for node in decay.nodes if node not in decay.good]
    if left:
        worst = max((node.omega_std / abs(node.omega) for node in left), default=math.inf)
        result.append(
            f"{name}: {len(left)} of {len(decay.nodes)} amplitudes of the decay are left out, because something else "
            f"or noise covers the mode there (frequency known to {100.0 * worst:.2g} % only)."
        )
    result += [
        f"{name}: a line of the mains beside the decaying mode is taken out: {hum.frequency_hz:.5g} Hz, amplitude "
        f"{hum.amplitude:.3g} in the channel's unit."
        for hum in decay.hum
    ]
    first = decay.nodes[0].first
    if first > THRESHOLDS.reading.decay_switch_off_periods:
        start = float(decay.slow.time_s[first])
        result.append(
            f"{name}: the decay is used from {start:.3g} s on; before, it still grows or something else rings with it."
        )
    return result
