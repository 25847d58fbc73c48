"""Observables of ring-downs: instantaneous frequency and damping ratio over amplitude, and the shape of the response.

Frequency, start and end of the decay are found in the data; the model only says which of several decaying modes it has.
What cannot be used of a decay is left out, with the reason, and the rest stays.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows.rows_of_channels import add_limit, believed_limits
from nmt_diagnose.measurements.recorded_decay.recorded_decay import RecordedDecay
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.model_view import ModelView, nearest_ratio
from nmt_diagnose.observations.observables import Observations, Part, Place, RowTable, empty
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_signals.channel_faults.clipping import clipping_level
from nmt_signals.decays.decay_hum import without_hum
from nmt_signals.decays.decay_nodes import Node, ratio_at
from nmt_signals.decays.decay_reading import DEMODULATION_WIDTHS, DecayReading, read_decay
from nmt_signals.decays.decay_signal import Ridge, demodulated
from nmt_signals.decays.half_cycles import half_cycle_nodes
from nmt_signals.thresholds import DECAYS

_LATE_SHARE = 0.1  # of the largest motion, below which spectra missed the beginning of a decay
_ORDER = (Quantity.DISPLACEMENT, Quantity.ACCELERATION, Quantity.VELOCITY)


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
    seconds = stretch.samples / stretch.sample_rate

    def choose(found: Sequence[Ridge]) -> Ridge:
        return _chosen(found, frequency_hz, view, seconds)

    reason, decay, model_channel = "", None, usable[0]
    for model_channel in usable:
        try:
            decay = read_decay(
                stretch.row(model_channel.name),
                stretch.sample_rate,
                model_channel.quantity,
                choose,
                settings.decay_points,
                settings.floors.decay_log_frequency,
            )
            break
        except BenchError as error:
            reason = reason or str(error)
    if decay is None and not view.frequencies_hz:
        return empty((f"{name}: the ring-down is left out: {reason}.",))
    if decay is None:
        lowest = float(min(view.frequencies_hz))
        periods = stretch.samples / stretch.sample_rate * lowest
        if periods > THRESHOLDS.reading.decay_few_spectral_periods * DECAYS.fewest_periods:
            return empty((f"{name}: the ring-down is left out: {reason}.",))
        return _short_decay(name, stretch, usable[0], channels, view, settings, reason)
    largest = 0.5 * float(np.ptp(stretch.row(model_channel.name)))
    top = max(node.amplitude for node in decay.good)
    if len(decay.good) < THRESHOLDS.reading.decay_few_nodes or top < _LATE_SHARE * largest:
        # Friction ends a decay within a few periods, however long the recording goes on.
        short = _short_decay(name, stretch, model_channel, channels, view, settings, reason)
        nodes = np.unique(short.rows.amplitude)
        if nodes.size >= THRESHOLDS.reading.decay_few_nodes and nodes.max() > 0.5 * largest:
            return short
    if close := close_mode(view, decay.good[-1].omega / (2.0 * math.pi)):
        return empty((f"{name}: the ring-down is left out: {close}.",))
    others = [c for c in usable if c is not model_channel]
    table = RowTable()
    floors = settings.floors
    amplitudes = add_nodes(table, decay.good, stretch, settings, decay.others)
    for index, other in enumerate(others, start=1):
        samples = stretch.row(other.name)
        samples, _ = without_hum(samples - samples.mean(), stretch.sample_rate, decay.ridge, DECAYS.switch_off_periods)
        values = demodulated(samples, decay.slow.cycles, decay.slow.width)[:: decay.slow.stride]
        for level, node in enumerate(decay.good):
            ratio, std = ratio_at(node, decay.slow, values)
            if not std < THRESHOLDS.reading.decay_largest_ratio_std:
                continue
            place = Place(level, stretch.start_s + node.time_s, node.omega / (2.0 * math.pi), node.amplitude)
            size = math.log(abs(ratio) * node.amplitude)
            std = math.hypot(std, 2.0 * _shift(node, _lowest(decay.good), decay.others[level]))
            table.add(Part.LOG_MAGNITUDE, size, std, floors.decay_shape, place, index, 1)
            table.add(Part.PHASE, cmath.phase(ratio), std, floors.decay_shape, place, index, 1)
    for index, recorded in enumerate((model_channel, *others)):
        if (limit := clipping_level(stretch.row(recorded.name))) > 0.0:
            first = decay.good[0]
            place = Place(0, stretch.start_s + first.time_s, first.omega / (2.0 * math.pi), first.amplitude)
            add_limit(table, limit, believed_limits(view).get(channels[recorded.name].name), place, index, 1)
    notes += notes_of(name, decay)
    test = RecordedDecay(
        name,
        view.rig.drive_point,
        channels[model_channel.name],
        np.array(amplitudes),
        decay.good[-1].omega / (2.0 * math.pi),
        tuple(channels[other.name] for other in others),
        view.rig.exciter_points[1:],
    )
    return table.observations(test, notes)


def add_nodes(
    table: RowTable, good: list[Node], stretch: SampleStretch, settings: ObservationSettings, others: FloatArray
) -> list[float]:
    """Rows of frequency and damping of every node; returns their amplitudes."""
    floors, small_amplitude = settings.floors, _lowest(good)
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


def _lowest(good: list[Node]) -> Node:
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
    try:
        good = half_cycle_nodes(stretch.row(channel.name), stretch.sample_rate, lowest)
    except BenchError as error:
        return empty((f"{name}: the ring-down is left out: {reason}; {error}.",))
    table = RowTable()
    amplitudes = add_nodes(table, good, stretch, settings, np.zeros(len(good)))
    note = f"{name}: the decay lasts a few periods only: frequency and damping are those between its turning points."
    test = RecordedDecay(
        name,
        view.rig.drive_point,
        model_channel,
        np.array(amplitudes),
        good[-1].omega / (2.0 * math.pi),
        resting_points=view.rig.exciter_points[1:],
    )
    return table.observations(test, [note])


def close_mode(view: ModelView, frequency_hz: float) -> str:
    """Which mode several exciters let ring that no window tells from the one that decays; empty = none."""
    away = sorted(view.modes_hz, key=lambda hertz: abs(hertz / frequency_hz - 1.0))[1:2]
    if len(view.rig.all_exciters) < 2 or not away or abs(away[0] / frequency_hz - 1.0) > 1.0 / max(DEMODULATION_WIDTHS):
        return ""
    return f"the model's mode at {away[0]:.4g} Hz rings so close to {frequency_hz:.4g} Hz that neither decays alone"


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


def _chosen(found: Sequence[Ridge], frequency_hz: float, view: ModelView, seconds: float) -> Ridge:
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
        if 1.0 / THRESHOLDS.reading.wrong_frequency_ratio < ratio < THRESHOLDS.reading.wrong_frequency_ratio:
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


def notes_of(name: str, decay: DecayReading) -> list[str]:
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
    if first > DECAYS.switch_off_periods:
        start = float(decay.slow.time_s[first])
        result.append(
            f"{name}: the decay is used from {start:.3g} s on; before, it still grows or something else rings with it."
        )
    return result
