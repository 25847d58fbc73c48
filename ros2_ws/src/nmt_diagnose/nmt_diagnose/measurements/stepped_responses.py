"""Frequency responses at held amplitudes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.text.number_words import significant
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import HeldLevels, Measurement, Observations, ResponseLines
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.driven_lines import solve_lines
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.periodic_kernel import DRIVEN, Closing, Limits, advance, target_rows
from nmt_diagnose.prediction.periodic_state import has_coordinates, shared_unknowns
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    nearest_frequency,
    resting_frequencies,
    resting_response,
)
from nmt_diagnose.prediction.rig_parts import RigParts, sliding
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.aft import LocalTables
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig, ShakingTableSection


@dataclass(frozen=True)
class SteppedResponses(ResponseLines):
    """Frequency responses at an amplitude that was held while the frequency was stepped.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter.
        channels: response channels, in the order of the observables; the first is the one whose amplitude the model is
            given.
        reference: what the responses are divided by: ``force``, ``base`` (acceleration of a shaking table) or
            ``voltage``.
        held: what had the given amplitude: ``force``, ``base``, ``voltage``, or ``response`` (the first channel).
        lines_hz: frequencies that became observables, Hz, ascending, shape (lines,).
        levels: held amplitude at each line, in its SI unit, shape (lines,).
        measured: measured responses, shape (lines, channels): they say how large the motion was and on which branch.
        noise: relative standard uncertainty of each line's magnitude and phase (rad), shape (lines,).
        direction: +1 while the frequency rose, −1 while it fell, 0 where it is not known.
        growth: ∂ ln R / ∂ ln s of the reference R over the first channel's amplitude s, by which an error of s counts,
            shape (lines,); None = 1, that of a linear rig.
        moved: ln of the amplitude about which an error of s counts to first order, over the measured one, shape
            (lines,); None = 0.
        scale: true over recorded amplitude of the first channel.
        noise_degrees: degrees of freedom of the variance that the noise was estimated as; infinite where it is stated.
        phase_known: whether the responses have a phase; else they are magnitudes, and no observable is a phase.
        imposed: whether the motion of the drive point was a sine, and the force what it takes; else the force was one.
    """

    WORDS: ClassVar[str] = "frequency response at a held amplitude"
    held_amplitude: ClassVar[bool] = True

    name: str
    drive_point: int
    channels: tuple[MeasuredChannel, ...]
    reference: str
    held: str
    lines_hz: FloatArray
    levels: FloatArray
    measured: ComplexArray
    noise: FloatArray
    direction: int = 0
    growth: ComplexArray | None = None
    moved: FloatArray | None = None
    scale: float = 1.0
    noise_degrees: float = math.inf
    phase_known: bool = True
    imposed: bool = False

    @property
    def amplitudes(self) -> FloatArray:
        """Amplitude of the first channel at each line, in its unit; NaN where only the voltage is known, (lines,)."""
        if self.held == "response":
            return self.levels
        if self.held == self.reference:
            return np.asarray(np.abs(self.measured[:, 0]) * self.levels, dtype=np.float64)
        return np.full(self.levels.shape, math.nan)

    def predictor(self, rows: Rows, settings: PredictionSettings) -> SteppedSinePredictor:
        """What predicts its rows."""
        return SteppedSinePredictor(self, rows, settings)

    @property
    def given_channel(self) -> MeasuredChannel | None:
        """Channel at whose amplitudes the model is solved."""
        return self.channels[0]

    @property
    def over_force(self) -> bool:
        """Whether its rows are responses over what held its amplitude."""
        return self.held != "response"

    @property
    def scatter_key(self) -> object | None:
        """Sweeps of the same channels over the same have one scatter, where that is estimated."""
        return (self.channels, self.reference) if math.isfinite(self.noise_degrees) else None

    @property
    def sweep_key(self) -> object | None:
        """Drive point, channels, reference, what was held and whether there are phases."""
        return self.drive_point, frozenset(self.channels), self.reference, self.held, self.phase_known

    @property
    def level_name(self) -> str:
        """Level and direction of the frequency."""
        units = {"force": "N·m" if self.channels[0].turns else "N", "base": "m/s²", "voltage": "V"}
        level = f"{significant(float(np.median(self.levels)), 3)} {units.get(self.held, self.channels[0].unit)}"
        return level + {1: " ↑", -1: " ↓"}.get(self.direction, "")

    @property
    def imposed_scales(self) -> tuple[float, float] | None:
        """Displacement (m) and force (N) of an imposed motion, the largest."""
        if not self.imposed or self.reference != "force":
            return None
        order = MOTIONS[self.channels[0].quantity]
        force = float(np.max(self.levels / np.abs(self.measured[:, 0])))
        return float(np.max(self.levels / (2.0 * np.pi * self.lines_hz) ** order)), force

    def traced(self, states: Sequence[Any] | None) -> SteppedResponses:
        """The measurement with the noise of measured amplitudes propagated as a prediction's solutions say."""
        return self if states is None else with_growth(self, states[0])

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """Lines of largest and smallest motion, in the shape of the system linearised at rest at its resonance."""
        lead = self.channels[0]
        order = MOTIONS[lead.quantity]
        motion = self.amplitudes / (2.0 * np.pi * self.lines_hz) ** order
        if not np.any(np.isfinite(motion)):
            return []
        setup = Setup(self.drive_points, False, (*channels, lead), FourierBasis.up_to(1))
        parts, resting, found = PartsCache(settings).parts(rig, setup), resting_frequencies(rig), list[Motion]()
        for line in (int(np.nanargmax(motion)), int(np.nanargmin(motion))):
            omega = 2.0 * np.pi * nearest_frequency(resting, float(self.lines_hz[line]))
            q, y = resting_response(parts, omega)
            scale = float(motion[line]) * omega**order / max(abs(y[-1]), 1e-300)
            drive = float(self.levels[line]) if self.held == "voltage" else scale / parts.input_per_volt[0]
            found.append((parts, omega, drive, y[: len(channels)] * scale, q * scale))
        return found

    def larger(self, share: float) -> SteppedResponses:
        """With the motion of the first channel larger by a share."""
        return replace(self, scale=self.scale * (1.0 + share))

    def shifted(self, share: float) -> SteppedResponses:
        """With its lines higher by a share."""
        return replace(self, lines_hz=self.lines_hz * (1.0 + share))

    def errors(self, rows: Rows, chain: MeasuringChain) -> dict[str, FloatArray]:
        """Gain, phase and delay of each response and of the reference.

        An error of the first response is one of the amplitude at which the others are compared, too.
        """
        found: dict[str, FloatArray] = {}
        place, turned = (rows.level, rows.channel), rows.part == Part.PHASE
        omega = 2.0 * np.pi * rows.frequency_hz
        for channel, name in (*enumerate(c.name for c in self.channels), (None, f"the {self.reference}")):
            tolerance = chain.of("" if channel is None else name)
            late = math.hypot(tolerance.delay_s, chain.shared_delay_s)
            errors = (gain_error(self, channel, error)[place] for error in (1.0, 1j))
            of_gain, of_phase = (np.where(turned, e.imag, e.real) for e in errors)
            found[f"gain of {name} in responses"] = tolerance.gain * of_gain
            found[f"phase of {name} in responses"] = tolerance.phase * of_phase
            found[f"delay of {name} in responses"] = late * omega * of_phase
        return found

    def measured_responses(self, level: IntArray, channel: IntArray) -> ComplexArray | None:
        """Measured responses of rows."""
        return np.asarray(self.measured[level, channel])

    def with_scatter(self, before: FloatArray, factor: float, degrees: float) -> SteppedResponses:
        """The measurement whose lines scatter by a factor more than some standard deviations, (lines,)."""
        noise = np.sqrt(np.maximum(self.noise**2 - before**2, 0.0) + (factor * before) ** 2)
        return replace(self, noise=noise, noise_degrees=degrees)

    def held_levels(self, observations: Observations, number: int) -> HeldLevels | None:
        """Lines about the resonance at several forces as levels."""
        return levels_of_lines(self, observations, number)


# -- predictor -------------------------------------------------------------------------------------------------------


HARMONICS = 5


@dataclass(frozen=True)
class SteppedSineState:
    """Solutions of all lines of a test.

    Attributes:
        keys: identity of the coordinates.
        tables: local elements and clock that the forces belong to.
        z, forces, inverses, slopes: as the kernel gives them; NaN in ``z`` where a line has no solution.
        responses: (lines, channels) over the reference.
        growth: ∂ ln R / ∂ ln s of each line, complex, (lines,).
        moved: ln of the amplitude given over the measured one, (lines,).
    """

    keys: tuple[str, ...]
    tables: LocalTables
    clock: float
    z: FloatArray
    forces: FloatArray
    inverses: FloatArray
    slopes: ComplexArray
    responses: ComplexArray
    growth: ComplexArray
    moved: FloatArray


class SteppedSinePredictor(Predictor):
    """Predicts one test of frequency responses at a held amplitude.

    Args:
        test: the test.
        rows: its rows; ``level`` is the line.
        settings: of the predictor.

    Raises:
        BenchError: an unknown reference, or one that was held in a way the model cannot follow.
    """

    def __init__(self, test: SteppedResponses, rows: Rows, settings: PredictionSettings) -> None:
        if test.reference not in ("force", "base", "voltage"):
            raise BenchError(f"test {test.name}: reference {test.reference!r} is unknown; use force, base or voltage.")
        if test.held not in (test.reference, "response"):
            raise BenchError(
                f"test {test.name}: {test.held} was held, but the responses refer to the {test.reference}; give "
                "responses over what was held, or the measured amplitude of the reference at each line."
            )
        self.test, self.rows, self.settings = test, rows, settings
        channels = [*test.channels]
        if test.reference == "force":
            channels.append(force_channel(test))
        self.channels = tuple(channels)
        self.moved = moved_of(test)
        self.amplitudes = test.amplitudes * test.scale * np.exp(self.moved)
        self.growth = growth_of(test)
        # A motion that is imposed has no harmonics, whatever the force has.
        basis = FourierBasis.up_to(1 if test.imposed else HARMONICS)
        self.use(Setup(test.drive_points, test.reference == "force", self.channels, basis))

    @property
    def levels(self) -> tuple[SteppedResponses, ...]:
        """One set of lines."""
        return (self.test,)

    def parts(self, rig: Rig, cache: PartsCache) -> RigParts:
        """The rig taken apart.

        Raises:
            BenchError: the responses refer to a base that the model does not have.
        """
        if self.test.reference == "base" and not isinstance(rig.exciter, ShakingTableSection):
            raise BenchError(
                f"test {self.test.name} is over the acceleration of the base, but the exciter of rig {rig.name} is "
                "not a shaking table; write exciter: {kind: shaking_table, point: …} in the model."
            )
        return cache.parts(rig, self.setup)

    def solve(
        self, rig: Rig, cache: PartsCache, start: tuple[SteppedSineState | None, ...] | None
    ) -> list[SteppedSineState | None]:
        """One state for all lines."""
        parts = self.parts(rig, cache)
        before = start[0] if start else None
        lines = self.amplitudes.size
        size = parts.coordinates * parts.basis.size + 2
        if before is not None and before.keys == parts.keys:
            known = np.isfinite(before.z[:, 0])
            first = np.where(known[:, None], before.z, 0.0)
        else:
            known, first = np.zeros(lines, dtype=bool), np.zeros((lines, size))
        asked = self._closing, self._targets(parts)
        how = parts.first_input, parts.kernel_tables, Limits(self.settings.iterations, self.settings.tolerance)
        good, z, forces, inverses, values, slopes = solve_lines(first, known, *asked, *parts.resting, *how)
        if not good.all() and parts.tables.elements.jenkins.size:
            # Far beyond the slip of a stiff contact nothing leads there from rest.
            unknown = np.zeros_like(known)
            other, *found = solve_lines(np.zeros_like(first), unknown, *asked, *sliding(parts), *how)
            taken = other & ~good
            for kept, more in zip((z, forces, inverses, values, slopes), found, strict=True):
                kept[taken] = more[taken]
            good = good | taken
        z[~good] = np.nan
        responses, reference = self._over_reference(parts, z, values)
        # The closure's rows are its real and imaginary part: one of the real one is the change by s.
        local = size - 2
        along = inverses[:, :, local] * self.amplitudes[:, None]
        change = along[:, local] + 1j * along[:, local + 1]
        if self.test.reference == "force":
            change = np.einsum("lk,lk->l", slopes[:, self._places[-1], 0], along)
        elif self.test.reference == "voltage":
            change = change / parts.input_per_volt[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            growth = change / reference
        growth = np.asarray(growth)
        keys, tables, clock = parts.keys, parts.tables, parts.clock
        state = SteppedSineState(keys, tables, clock, z, forces, inverses, slopes, responses, growth, self.moved)
        return [state]

    def stepped(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> list[SteppedSineState | None]:
        """Solutions of a slightly different rig by one Newton step from ``states``."""
        state = states[0]
        assert state is not None
        parts = self.parts(rig, cache)
        if not has_coordinates(state.keys, parts.keys):
            # A coordinate with a force is gone: nothing of the Jacobians can be kept.
            return self.solve(rig, cache, None)
        same = parts.keys == state.keys and parts.clock == state.clock and _same_tables(parts.tables, state.tables)
        shared = shared_unknowns(state.keys, parts.keys, parts.basis.size)
        z, values = advance(
            state.z, state.forces if same else state.forces[:0], shared, state.inverses, state.slopes, self._closing,
            self._targets(parts), parts.first_input[None], parts.kernel_tables,
        )  # fmt: skip
        responses, _ = self._over_reference(parts, z, values)
        return [replace(state, keys=parts.keys, z=z, responses=responses)]

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> FloatArray:
        """Observables of the test's rows; see the module."""
        state = states[0]
        result = np.full(len(self.rows), np.nan)
        if state is None:
            return result
        magnitude, phase = self.predicted(state)
        rows = self.rows
        for part, values in ((Part.LOG_MAGNITUDE, magnitude), (Part.PHASE, phase)):
            which = rows.part == part
            result[which] = values[rows.level[which], rows.channel[which]]
        result[np.isinf(result)] = np.nan
        return result

    def predicted(self, state: SteppedSineState) -> tuple[FloatArray, FloatArray]:
        """ln of the magnitudes and phases (rad) that the rows predict, each (lines, channels)."""
        measured = self.test.measured
        with np.errstate(divide="ignore", invalid="ignore"):
            log_ratio = np.log(measured / state.responses)
        if self.test.held == "response":
            left = log_ratio
        else:
            left = whitened_difference(at_measured(log_ratio, self.growth, self.moved), self.growth, self.test.noise)
        return np.log(np.abs(measured)) - left.real, np.angle(measured) - left.imag

    @property
    def _closing(self) -> Closing:
        return Closing(DRIVEN, int(self._places[0]))

    def _targets(self, parts: RigParts) -> FloatArray:
        return target_rows(self.amplitudes, omega=2.0 * np.pi * self.test.lines_hz * parts.clock)

    def _over_reference(
        self, parts: RigParts, z: FloatArray, values: ComplexArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """Responses (lines, channels) over the reference, and the reference (lines,)."""
        if self.test.reference == "force":
            reference = values[:, self._places[-1], 0]
        else:
            reference = z[:, -2] + 1j * z[:, -1]
            if self.test.reference == "voltage":
                reference = reference / parts.input_per_volt[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            return values[:, self._places[: len(self.test.channels)], 0] / reference[:, None], reference


def force_channel(test: SteppedResponses) -> MeasuredChannel:
    """The force that the responses of a test are divided by."""
    return MeasuredChannel(f"f{test.drive_point}", Quantity.FORCE, test.drive_point)


def growth_of(test: SteppedResponses) -> ComplexArray:
    """∂ ln R / ∂ ln s that a test's noise is propagated by, (lines,): 1 of a linear rig."""
    return np.ones(test.lines_hz.size, dtype=np.complex128) if test.growth is None else test.growth


def moved_of(test: SteppedResponses) -> FloatArray:
    """ln of the amplitude that a model is given over the measured one, (lines,)."""
    return np.zeros(test.lines_hz.size) if test.moved is None else test.moved


def with_growth(test: SteppedResponses, state: SteppedSineState) -> SteppedResponses:
    """The test with its noise propagated as a solution says; lines without a solution as they were.

    An amplitude that is within its noise is moved to where the solution has it.
    """
    solved = np.isfinite(state.growth)
    growth = np.where(solved, state.growth, growth_of(test))
    if test.held == "response":
        return replace(test, growth=growth)
    # The amplitude that suits its own measurement, the level and the phase: amplitude and level alone may suit two.
    slope, turn = growth.real, -growth.imag * test.phase_known
    with np.errstate(divide="ignore", invalid="ignore"):
        log_ratio = np.log(test.measured[:, 0] / state.responses[:, 0])
    further = -slope * (log_ratio.real + state.moved) + turn * log_ratio.imag - state.moved
    moved = state.moved + further / (slope**2 + turn**2 + 1.0)
    # A deviation of many times the noise is not an error of the amplitude.
    moved = np.where(
        np.isfinite(moved),
        moved / (1.0 + (moved / (THRESHOLDS.prediction.largest_magnitude_sigmas * test.noise)) ** 4),
        0.0,
    )
    return replace(test, growth=growth, moved=np.where(solved, moved, moved_of(test)))


def at_measured(log_ratio: ComplexArray, growth: ComplexArray, moved: FloatArray) -> ComplexArray:
    """ln of measured over predicted responses at the measured amplitude, from there where the model was given another.

    Args:
        log_ratio: the same at the amplitude that the model was targets, (lines, channels).
        growth: ∂ ln R / ∂ ln s there, (lines,); the responses over R then go as 1 − growth.
        moved: ln of that amplitude over the measured one, (lines,).
    """
    return np.asarray(log_ratio + ((1.0 - growth) * moved)[:, None])


def gain_error(test: SteppedResponses, channel: int | None = None, error: complex = 1.0) -> ComplexArray:
    """Change of ln H that a relative error of a gain makes of the rows, (lines, channels).

    Real parts are rows for magnitudes, imaginary ones for phases. The amplitude that the model is given stays as it is:
    an error of that is one of the scale of all strengths, which no row shows.

    Args:
        test: the test.
        channel: the response whose gain is off; None = that of the reference, by which all are divided.
        error: of ln of the gain; i is an error of the phase.
    """
    log_ratio = np.full_like(test.measured, error)
    if channel is not None:
        log_ratio[:, np.arange(log_ratio.shape[1]) != channel] = 0.0
    return log_ratio if test.held == "response" else whitened_difference(log_ratio, growth_of(test))


def whitened_difference(log_ratio: ComplexArray, growth: ComplexArray, noise: FloatArray | None = None) -> ComplexArray:
    """What a response at the held level differs by from the measured one, ln of magnitude and phase in rad.

    Args:
        log_ratio: ln of the measured response over the one that the model has at the measured amplitude of the first
            channel, (lines, channels).
        growth: ∂ ln R / ∂ ln s, (lines,).
        noise: standard uncertainty of the magnitudes, (lines,): a difference many times as large is not an error of the
            amplitude, and corrects no other row; None = corrections are not bounded.

    Returns:
        (lines, channels); no component has a larger variance than the measured one's errors.
    """
    slope, turn = growth.real, -growth.imag
    sharpness = np.maximum(slope**2, 1.0)
    lead = log_ratio[:, 0].real / np.sqrt(sharpness)
    # The error of the first channel's magnitude, as far as the level determines it, and its unknown rest.
    error = (log_ratio[:, 0].real * slope / sharpness)[:, None]
    if noise is not None:
        most = THRESHOLDS.prediction.largest_magnitude_sigmas * noise[:, None]
        error = most * np.tanh(error / most)
    unknown = 1.0 - slope**2 / sharpness
    # Other responses follow the first in proportion: ∂ ln H ≈ 1 − ∂ ln R.
    fall = 1.0 - slope
    sizes = (log_ratio.real + fall[:, None] * error) / np.sqrt(1.0 + fall**2 * unknown)[:, None]
    phases = (log_ratio.imag + turn[:, None] * error) / np.sqrt(1.0 + turn**2 * unknown)[:, None]
    sizes[:, 0] = lead
    return np.asarray(sizes + 1j * phases)


def _same_tables(a: LocalTables, b: LocalTables) -> bool:
    """Whether two tables hold the same elements."""
    # Elements and their coordinates, and the number of samples; the rest follows from these.
    if a is b:
        return True
    pairs = zip((*a.elements, a.values), (*b.elements, b.values), strict=True)
    return all(x is y or (x.shape == y.shape and bool((x == y).all())) for x, y in pairs)


# -- levels ----------------------------------------------------------------------------------------------------------


_LINES = 6
"""Lines of a response at one force: half of the motion of its peak and more, evenly over its logarithm."""
_BAND = 0.15
"""Of a mode, relative: a peak that moves further is not that of one level."""


def levels_of_lines(first: SteppedResponses, observations: Observations, number: int) -> HeldLevels | None:
    """Lines of all responses to a held force or base over the same channels as levels; None but for the first test."""
    same = [other for other, test in enumerate(observations.tests) if _alike(first, test)]
    same = [other for other in same if np.any(observations.rows.test == other)]
    if not same or same[0] != number or first.held != first.reference or first.reference not in ("force", "base"):
        return None
    tests = [_in_order(first, observations.tests[other]) for other in same]
    if any(channel.quantity not in MOTIONS for channel in first.channels):
        return None
    forces = {round(float(np.log(np.max(test.levels))), 2) for test in tests}
    powers = np.array([MOTIONS[channel.quantity] for channel in first.channels])
    size = [np.abs(test.measured[:, 0]) * test.levels / (2.0 * np.pi * test.lines_hz) ** powers[0] for test in tests]
    if len(forces) < 2:  # a law has to change with the amplitude
        return None
    loudest = max(range(len(tests)), key=lambda k: float(size[k].max()))
    peak = tests[loudest].lines_hz[int(np.argmax(size[loudest]))]
    parts: list[tuple[FloatArray, ...]] = []
    for test, moved in zip(tests, size, strict=True):
        near = np.flatnonzero(np.abs(np.log(test.lines_hz / peak)) < _BAND)
        near = near[moved[near] >= 0.5 * moved[near].max()] if near.size else near
        order = near[np.argsort(moved[near], kind="stable")]
        chosen = order[np.unique(np.linspace(0, order.size - 1, min(order.size, _LINES)).round().astype(int))]
        if order.size:
            force = test.levels[chosen]
            amplitude = test.measured[chosen] * force[:, np.newaxis]
            parts.append((test.lines_hz[chosen], force, amplitude, test.noise[chosen], moved[chosen]))
    lines, force, amplitude, noise, moved = (np.concatenate(part) for part in zip(*parts, strict=True))
    omega = 2.0 * np.pi * lines
    motion = np.zeros((*amplitude.shape, 2), complex)
    motion[:, :, 1] = first.scale * amplitude / (1j * omega[:, np.newaxis]) ** powers
    driven = np.zeros((1, lines.size, 2), complex)
    driven[0, :, 1] = force
    chain = observations.chains[number] if observations.chains else None
    more = f" and {len(tests) - 1} more" if len(tests) > 1 else ""
    found = HeldLevels(
        f"{first.name}{more}", first.drive_points, tuple(range(lines.size)), omega, driven, np.zeros((1, lines.size)),
        tuple(first.channels), motion, np.abs(motion) * noise[:, np.newaxis, np.newaxis], chain,
        over_base=first.reference == "base", alone=True,
    )  # fmt: skip
    return found.take([int(k) for k in np.argsort(moved, kind="stable")])


def _alike(first: SteppedResponses, test: Measurement) -> bool:
    """Whether a test is another response at the same drive and channels as the first, with phases."""
    if test.lines is None or test.lines.sweep_key != first.sweep_key:
        return False
    other = cast(SteppedResponses, test)
    return other.phase_known and not first.imposed and not other.imposed


def _in_order(first: SteppedResponses, test: Measurement) -> SteppedResponses:
    """The test with the channels of the first, in their order."""
    other = cast(SteppedResponses, test)
    order = [other.channels.index(channel) for channel in first.channels]
    return replace(other, channels=first.channels, measured=other.measured[:, order])
