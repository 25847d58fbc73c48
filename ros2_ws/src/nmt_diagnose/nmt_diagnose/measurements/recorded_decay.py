"""Free decays: frequency and damping over amplitude, as they are read and as the model predicts them.

Frequency, start and end of a decay are found in the data; the model only says which of several decaying modes it has.
What cannot be used of a decay is left out, with the reason.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.measurements.backbone_table import levels_over_amplitude
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_reading import add_limit, believed_limits
from nmt_diagnose.measurements.measurement import (
    CurveAxis,
    Driven,
    HeldLevels,
    LevelSeries,
    Observations,
    RowTable,
    axis_of_amplitudes,
    empty,
)
from nmt_diagnose.observations.bag_windows import BagWindows
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.model_view import ModelView, nearest_ratio
from nmt_diagnose.observations.observables import FUNDAMENTAL, Part, Place, Rows
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.prediction.decay_kernel import free_rows, observed_ratios
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.periodic_kernel import (
    FREE,
    Closing,
    Limits,
    at_pole,
    carried,
    channels_of,
    newton,
    resting_response,
    stepped,
)
from nmt_diagnose.prediction.periodic_state import PeriodicState, shared_unknowns
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.prediction.resting_motion import Motion, motion_at_amplitudes
from nmt_diagnose.prediction.rig_parts import RigParts, sliding
from nmt_diagnose.prediction.rig_tables import sensor_gain
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig
from nmt_signals.channel_faults.clipping import clipping_level
from nmt_signals.channel_faults.mains_lines import MAINS_HZ
from nmt_signals.decays.decay_hum import Hum, without_hum
from nmt_signals.decays.decay_nodes import Node, ratio_at
from nmt_signals.decays.decay_reading import DEMODULATION_WIDTHS, DecayReading, read_decay
from nmt_signals.decays.decay_signal import Ridge, demodulated
from nmt_signals.decays.half_cycles import half_cycle_nodes, undriven_from
from nmt_signals.thresholds import DECAYS


@dataclass(frozen=True)
class RecordedDecay(Driven):
    """Free decay after switch-off or impact: frequency and decay rate of a response over its amplitude.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter (it stays attached, at zero volts).
        channel: response channel that the amplitudes are of.
        amplitudes: fundamental amplitude in the channel's unit at which the observables stand, shape (k,), falling.
        frequency_hz: at the smallest amplitude, Hz; it identifies the mode.
        others: further response channels; magnitude and phase of their fundamentals stand relative to the first one's.
        resting_points: measurement points of further exciters, at zero volts too.
    """

    WORDS: ClassVar[str] = "ring-down"
    free: ClassVar[bool] = True
    series: ClassVar[LevelSeries] = LevelSeries(interleaved=True, rising=True)
    unexcited: ClassVar[tuple[Part, ...]] = (Part.LIMIT, Part.LINE)

    name: str
    drive_point: int
    channel: MeasuredChannel
    amplitudes: FloatArray
    frequency_hz: float
    others: tuple[MeasuredChannel, ...] = ()
    resting_points: tuple[int, ...] = ()

    @property
    def channels(self) -> tuple[MeasuredChannel, ...]:
        """All channels, in the order of the observables."""
        return (self.channel, *self.others)

    def predictor(self, rows: Rows, settings: PredictionSettings) -> RingDownPredictor:
        """What predicts its rows."""
        return RingDownPredictor(self, rows, settings)

    @property
    def given_channel(self) -> MeasuredChannel | None:
        """Channel at whose amplitudes the model is solved."""
        return self.channel

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """Largest and smallest amplitude, by the system linearised at rest."""
        if not self.amplitudes.size:
            return []
        points, channel = self.drive_points, self.channel
        return motion_at_amplitudes(rig, points, channel, self.amplitudes, channels, settings, self.frequency_hz)

    def repeat_key(self, rows: Rows, index: int) -> tuple[object, float]:
        """Number of the amplitude."""
        return int(rows.level[index]), 0.0

    @property
    def axis(self) -> CurveAxis:
        """Amplitude of the first channel."""
        return axis_of_amplitudes(self.channel, self.amplitudes)

    def held_levels(self, observations: Observations, number: int) -> HeldLevels | None:
        """Its amplitudes as levels."""
        return levels_over_amplitude(self.drive_points, self.channels, self.amplitudes, observations, number)


# -- predictor -----------------------------------------------------------------------------------------------------

# Step of a decay over which frequency and damping are as good as constant.
_LARGEST_STEP = 0.05


_OFF_POLE = 1e-8
_TOLERANCE = 1e-10
_NO_CHANNELS = np.zeros((0, 0), dtype=np.complex128)
_DEEPEST = 3


class RingDownPredictor(Predictor):
    """Predicts one free decay: structure and exciter at zero volts.

    Args:
        test: the decay.
        rows: its rows.
        settings: of the predictor.
    """

    SOLUTION: ClassVar[str] = "decay"

    def __init__(self, test: RecordedDecay, rows: Rows, settings: PredictionSettings) -> None:
        self.test, self.rows, self.settings = test, rows, settings
        self.channels = test.channels
        self.use(Setup(test.drive_points, False, self.channels, FourierBasis.up_to(settings.harmonics)))

    def use(self, setup: Setup) -> None:
        """Take the parts of rigs from a setup that other tests share."""
        super().use(setup)
        self._given = int(self._places[0])

    def solve(self, rig: Rig, cache: PartsCache, start: tuple[PeriodicState | None, ...] | None) -> list[Any]:
        """One state per amplitude; None where none was found."""
        parts = cache.parts(rig, self.setup)
        states: list[PeriodicState | None] = [None] * self.test.amplitudes.size
        last: PeriodicState | None = None
        for position in np.argsort(self.test.amplitudes, kind="stable"):
            amplitude = float(self.test.amplitudes[position])
            for guess in (None if start is None else start[position], last, None):
                states[position] = self._continued(parts, guess, amplitude)
                if states[position] is not None:
                    break
            else:
                # Far beyond the slip of a stiff contact nothing leads there from rest.
                states[position] = self._newton(parts, self._linear_start(parts, amplitude, sliding(parts)), amplitude)
            last = states[position] or last
        return states

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> FloatArray:
        """Observables of the test's rows."""
        clock = 1.0 + rig.clock_error
        log_omega = np.array([math.nan if s is None else math.log(s.omega / clock) for s in states])
        parts = cache.parts(rig, self.setup)
        solved = [position for position, state in enumerate(states) if state is not None]
        ratio = np.full(len(states), np.nan)
        shapes = np.full((len(states), len(self.channels)), np.nan, dtype=np.complex128)
        shape = np.isin(self.rows.part, FUNDAMENTAL)
        if solved:
            z = np.array([state.z for state in states if state is not None])
            # Not at the pole of the linear system itself, where transfer functions are infinite.
            z[:, -2] *= 1.0 + _OFF_POLE
            asked = self._arguments(parts, z, np.array([state.drive for state in states if state is not None]))
            ratio[solved] = observed_ratios(z, *asked)
            if shape.any():
                motions = channels_of(z, *asked)[:, self._places, 0]
                shapes[solved] = motions / motions[:, :1]
        result = np.full(len(self.rows), np.nan)
        for kind, values in ((Part.LOG_FREQUENCY, log_omega), (Part.DAMPING, ratio)):
            which = self.rows.part == kind
            result[which] = values[self.rows.level[which]]
        if shape.any():
            picked = shapes[self.rows.level[shape], self.rows.channel[shape]]
            log_size = np.log(np.abs(picked) * self.test.amplitudes[self.rows.level[shape]])
            result[shape] = np.where(self.rows.part[shape] == Part.PHASE, np.angle(picked), log_size)
        return result

    def stepped(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> list[PeriodicState | None]:
        """Solutions of a slightly different rig by one Newton step."""
        parts = cache.parts(rig, self.setup)
        result: list[PeriodicState | None] = [None] * len(states)
        solved = [(position, state) for position, state in enumerate(states) if state is not None]
        if not solved:
            return result
        z = np.array([self._carried(parts, state, state.drive) for _, state in solved])
        # Not at the pole of the linear system itself, where transfer functions are infinite.
        z[:, -2] *= 1.0 + _OFF_POLE
        moved, _ = stepped(z, *self._arguments(parts, z, np.array([state.drive for _, state in solved])))
        for (position, state), unknowns in zip(solved, moved, strict=True):
            result[position] = PeriodicState(unknowns, parts.keys, state.drive, _NO_CHANNELS)
        return result

    def _arguments(self, parts: RigParts, z: FloatArray, amplitudes: FloatArray) -> tuple[Any, ...]:
        """Arguments of the kernel behind the unknowns (levels, nz)."""
        closing = Closing(FREE, self._given)
        return closing, free_rows(z, amplitudes, closing, parts.kernel_tables), parts.first_input, parts.kernel_tables

    def _continued(
        self, parts: RigParts, guess: PeriodicState | None, amplitude: float, depth: int = _DEEPEST
    ) -> PeriodicState | None:
        """Solution from a similar one, by way of amplitudes between the two where Newton's method does not reach it."""
        z = (
            self._linear_start(parts, amplitude, parts.resting)
            if guess is None
            else self._carried(parts, guess, amplitude)
        )
        found = self._newton(parts, z, amplitude)
        if found is not None or guess is None or depth == 0 or amplitude == guess.drive:
            return found
        between = self._continued(parts, guess, math.sqrt(amplitude * guess.drive), depth - 1)
        return None if between is None else self._continued(parts, between, amplitude, depth - 1)

    def _newton(self, parts: RigParts, z: FloatArray | None, amplitude: float) -> PeriodicState | None:
        if z is None:
            return None
        closing, targets, *how = self._arguments(parts, z[None], np.array([amplitude]))
        limits = Limits(self.settings.iterations, _TOLERANCE, _LARGEST_STEP)
        done = at_pole(z, closing, targets[0], parts.kernel_tables)
        try:
            if not done:
                done, z, _ = newton(z, closing, targets[0], *how, limits)
        except np.linalg.LinAlgError:
            return None
        return PeriodicState(z, parts.keys, amplitude, _NO_CHANNELS) if done else None

    def _linear_start(
        self, parts: RigParts, amplitude: float, tangents: tuple[FloatArray, FloatArray]
    ) -> FloatArray | None:
        """Pole of the linearised system nearest to the frequency of the switch-off, and its shape; None without one.

        Args:
            parts: of the rig.
            amplitude: of the channel.
            tangents: stiffness and damping of each coordinate's forces, (r,) each.
        """
        basis = self.setup.basis
        s = 2j * np.pi * self.test.frequency_hz * parts.clock
        # Not at the pole itself: without tangents at rest it is one of the transfer functions too.
        pole = self._pole(parts, s, tangents)
        if pole is None:
            return None
        s = pole * (1.0 + 1e-5)
        w, outputs = resting_response(s, *tangents, parts.first_input[basis.fundamental], parts.kernel_tables)
        gain, _ = sensor_gain(1j * s.imag, parts.channels[self._given])
        amplitudes = np.zeros((parts.coordinates, basis.orders.size), dtype=np.complex128)
        amplitudes[:, basis.fundamental] = w / outputs[self._given] * amplitude / abs(gain)
        return np.concatenate((basis.to_real(amplitudes).ravel(), [s.imag, -s.real / s.imag]))

    @staticmethod
    def _pole(parts: RigParts, near: complex, tangents: tuple[FloatArray, FloatArray]) -> complex | None:
        system = parts.system
        n, mechanical = system.size, system.mechanical_size
        stiffness, damping = system.stiffness.copy(), system.damping.copy()
        for k, c, direction in zip(*tangents, parts.inputs.T[: parts.coordinates], strict=True):
            outer = np.outer(direction, direction)
            stiffness += k * outer
            damping += c * outer
        a = np.zeros((n + mechanical, n + mechanical))
        b = np.zeros_like(a)
        a[:n, :n], b[:n, :n], b[:n, n:] = -stiffness, damping, system.mass[:, :mechanical]
        a[n:, n:] = b[n:, :mechanical] = np.eye(mechanical)
        poles = np.linalg.eigvals(np.linalg.solve(b, a))
        poles = poles[poles.imag > 0.0]
        return complex(poles[np.argmin(np.abs(poles.imag - near.imag))]) if poles.size else None

    def _carried(self, parts: RigParts, state: PeriodicState, amplitude: float) -> FloatArray:
        z = state.z.copy()
        z[:-2] *= amplitude / state.drive
        if state.keys == parts.keys:
            return z
        # A state of the linear system may be its pole to the last bit.
        z[-2] *= 1.0 + _OFF_POLE
        closing, targets, *how = self._arguments(parts, z[None], np.array([amplitude]))
        shared = shared_unknowns(state.keys, parts.keys, self.setup.basis.size)
        return cast(FloatArray, carried(z, *shared, closing, targets[0], *how))


# -- reading -------------------------------------------------------------------------------------------------------

_LATE_SHARE = 0.1  # of the largest motion, below which spectra missed the beginning of a decay
_ORDER = (Quantity.DISPLACEMENT, Quantity.ACCELERATION, Quantity.VELOCITY)


def decays_of(bag: BagWindows) -> list[Observations]:
    """Windows of free decays, a test each."""
    return [
        ring_down_observations(
            name, window.stretch, window.segment.frequency_hz, bag.view, bag.of_decays, bag.settings,
            bag.controlled_quantity,
        )
        for name, window in bag.each([TestKind.RING_DOWN])
    ]  # fmt: skip


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
    largest = 0.5 * float(np.ptp(_undriven(stretch).row(model_channel.name)))
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
    hum = {model_channel.name: decay.hum}
    for index, other in enumerate(others, start=1):
        samples = stretch.row(other.name)
        samples, lines = without_hum(
            samples - samples.mean(), stretch.sample_rate, decay.ridge, DECAYS.switch_off_periods
        )
        hum[other.name] = lines
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
    first = decay.good[0]
    place = Place(0, stretch.start_s + first.time_s, first.omega / (2.0 * math.pi), first.amplitude)
    for index, recorded in enumerate((model_channel, *others)):
        samples = stretch.row(recorded.name)
        if (limit := clipping_level(samples)) > 0.0:
            add_limit(table, limit, believed_limits(view).get(channels[recorded.name].name), place, index, 1)
        for hertz, line in _mains_of(hum[recorded.name]):
            floor = floors.harmonic * 0.5 * float(np.ptp(samples))
            table.add(Part.LINE, line.amplitude, line.std, floor, place._replace(frequency_hz=hertz), index, 1)
    notes += notes_of(name, decay, hum)
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


def _mains_of(lines: Sequence[Hum]) -> list[tuple[float, Hum]]:
    """Lines at the fundamental of the mains, each with its nominal frequency in Hz."""
    return [
        (hertz, line)
        for line in lines
        for hertz in MAINS_HZ
        if abs(line.frequency_hz / hertz - 1.0) < THRESHOLDS.prediction.line_width
    ]


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
    stretch = _undriven(stretch)
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


def _undriven(stretch: SampleStretch) -> SampleStretch:
    """The stretch from where its drive has come to rest."""
    begin = undriven_from(stretch.row(c.name) for c in stretch.channels if c.quantity is Quantity.VOLTAGE)
    if not begin:
        return stretch
    cycles = None if stretch.cycles is None else stretch.cycles[begin:]
    return replace(stretch, first_sample=stretch.first_sample + begin, data=stretch.data[:, begin:], cycles=cycles)


def close_mode(view: ModelView, frequency_hz: float) -> str:
    """Mode that several exciters let ring and that no window separates from the decaying one; empty = none."""
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


def notes_of(name: str, decay: DecayReading, hum: Mapping[str, Sequence[Hum]]) -> list[str]:
    """What of a decay is not used, and why; ``hum`` has the lines that were taken out of each channel."""
    result = []
    if len(decay.good) < THRESHOLDS.reading.decay_few_nodes:
        result.append(
            f"{name}: frequency and damping could be read at {len(decay.good)} of the decay's amplitudes only, which "
            "say little about changes with the amplitude: hit harder, or record nearer to where the mode moves."
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
        f"{name}: a line of the mains is taken out of channel {channel}: {line.frequency_hz:.5g} Hz, amplitude "
        f"{line.amplitude:.3g} in the channel's unit."
        for channel, lines in hum.items()
        for line in lines
    ]
    first = decay.nodes[0].first
    if first > DECAYS.switch_off_periods:
        start = float(decay.slow.time_s[first])
        result.append(
            f"{name}: the decay is used from {start:.3g} s on; before, it still grows or something else rings with it."
        )
    return result
