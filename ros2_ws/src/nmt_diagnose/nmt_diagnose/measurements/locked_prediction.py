"""Locked windows as the model predicts them: phase-resonant harmonic balance, level by level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import PURE_TONE, LockedLevels, Terms
from nmt_diagnose.observations.observables import OF_THE_CHANNEL, Part, Rows
from nmt_diagnose.prediction.converter import recorded_harmonics
from nmt_diagnose.prediction.influence import Source, SourceColumn, source_vectors, with_sources
from nmt_diagnose.prediction.linear_model import LinearModel
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.periodic_kernel import (
    DRIVE_HELD,
    LOCKED,
    Balance,
    Closing,
    Limits,
    advance,
    carried,
    evaluate,
    inverted,
    newton,
    resting_angles,
    resting_response,
    scales,
    stepped,
    target_rows,
)
from nmt_diagnose.prediction.periodic_state import PeriodicState, has_coordinates, shared_unknowns
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.prediction.rig_parts import RigParts, exciter_of
from nmt_diagnose.prediction.rig_tables import channel_gains, harmonic_forces, sensor_gain
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig

# Rounds between a held amplitude and the drive that makes it.
_HELD_ROUNDS = 2


# The fundamental of the measured force is given.
FORCE_HELD = -2
_UNKNOWN_FORCES = np.zeros((0, 0, 0))


@dataclass(frozen=True)
class Tangent:
    """Solved levels with what a small change of the rig does to them, by the implicit function theorem.

    Attributes:
        states: of all levels.
        solved: positions of the levels with a solution.
        inverse: inverse Jacobians of their residuals, (solved, nz, nz).
        slopes: derivatives of their channels by their unknowns, (solved, c, n_orders, nz).
    """

    states: tuple[PeriodicState | None, ...]
    solved: tuple[int, ...]
    inverse: FloatArray
    slopes: ComplexArray


@dataclass(frozen=True)
class LevelProblem:
    """What a level asks for: phase and amplitude.

    Attributes:
        held_channel: ``DRIVE_HELD``, ``FORCE_HELD``, or a channel of the test whose fundamental has that amplitude.
        amplitude: given amplitude (of the drive: V; of the force: N; of the channel).
        phase: measured arg F₁ − arg(velocity₁), rad.
        frequency_hz: start of the solution (nominal clock), Hz.
        seconds, cycles: bench time of the window.
        terms: orders 1, 2, … of the drive of each exciter over the fundamental of the first.
    """

    held_channel: int
    amplitude: float
    phase: float
    frequency_hz: float
    seconds: float
    cycles: float
    terms: Terms = PURE_TONE


class PeriodicLevels(Predictor):
    """Phase-resonant solutions of the model at the levels of one test.

    Args:
        test: the test.
        rows: its rows.
        settings: of the predictor.

    Raises:
        BenchError: the test lacks what defines its levels.
    """

    def __init__(self, test: LockedLevels, rows: Rows, settings: PredictionSettings) -> None:
        self.test, self.rows, self.settings = test, rows, settings
        driven = max((len(term) for level in test.levels for term in level.terms), default=1)
        self.basis = FourierBasis.up_to(max(settings.harmonics, test.harmonics, driven))
        self.ideal_force = test.held == "force"
        # Channels that the phase condition needs come behind those of the test, if they were not recorded.
        channels = list(test.channels)
        names = [channel.name for channel in channels]
        force = next((i for i, channel in enumerate(channels) if channel.quantity == Quantity.FORCE), None)
        if force is None:
            channels.append(MeasuredChannel(f"f{test.drive_point}", Quantity.FORCE, test.drive_point))
            force = len(channels) - 1
        self.force = force
        if test.response_channel in names:
            self.response = names.index(test.response_channel)
        else:
            channels.append(MeasuredChannel(test.response_channel, Quantity.DISPLACEMENT, test.drive_point))
            self.response = len(channels) - 1
        self.channels = tuple(channels)
        quantity = self.channels[self.response].quantity
        if quantity not in MOTIONS:
            raise BenchError(
                f"test {test.name}: the loop controlled the phase of {test.response_channel}, which measures no motion."
            )
        self.power = 1 - MOTIONS[quantity]
        self.use(Setup(test.drive_points, self.ideal_force, self.channels, self.basis))
        self.levels = tuple(self._problem(position) for position in range(len(test.levels)))
        # Of a backbone: the range of frequencies over which its resonance moves, Hz.
        frequencies = [level.frequency_hz for level in test.levels if level.frequency_hz > 0.0]
        self._measured = (min(frequencies), max(frequencies)) if test.held == "response" and frequencies else None

    def use(self, setup: Setup) -> None:
        """Take the parts of rigs from a setup that other tests share."""
        super().use(setup)
        self.basis, self._row_of = setup.basis, setup.index(self.channels)
        self._force, self._response = self._row_of[self.force], self._row_of[self.response]
        self._voltages = [i for i, channel in enumerate(setup.channels) if channel.quantity == Quantity.VOLTAGE]

    def _problem(self, position: int) -> LevelProblem:
        level = self.test.levels[position]
        frequency = level.frequency_hz
        amplitude, held_channel = level.drive, DRIVE_HELD
        if self.ideal_force:
            amplitude, held_channel = level.force_n, FORCE_HELD
        elif self.test.held == "response":
            held_channel = 0
            # A backbone is followed from its lowest amplitude: its resonance may move to a multiple of the resting one.
            frequency = min(self.test.levels, key=lambda item: item.drive).frequency_hz
        middle = 0.5 * (level.start_s + level.stop_s)
        return LevelProblem(
            held_channel, amplitude, level.phase_error, frequency, middle, level.cycles_before, level.terms
        )  # fmt: skip

    def solve(self, rig: Rig, cache: PartsCache, start: tuple[PeriodicState | None, ...] | None) -> list[Any]:
        """One state per level; None where a level has no solution."""
        order = np.argsort([level.amplitude for level in self.levels], kind="stable")
        states: list[PeriodicState | None] = [None] * len(self.levels)
        last: PeriodicState | None = None
        for position in order:
            level = self.levels[position]
            parts = self.parts(rig, cache, level)
            state = self._level(parts, level, None if start is None else start[position], last)
            for _ in range(_HELD_ROUNDS):
                held = level if state is None else self._held(parts, [level], [state])[0]
                if state is None or held is level:
                    break
                state = self._newton(parts, held, level.amplitude, state.z) or state
            states[position] = state
            last = states[position] if states[position] is not None else last
        return states

    def _held(self, parts: RigParts, levels: list[LevelProblem], states: Sequence[PeriodicState]) -> list[LevelProblem]:
        """Levels with the phase that force and response truly had: converters that clip turn what was measured."""
        pair = [self._force, self._response]
        if self.ideal_force or not np.any(np.isfinite(parts.limits[pair, 0])):
            return levels
        first = self.basis.fundamental
        channels = np.array([state.channels[pair] for state in states])
        recorded = recorded_harmonics(channels, parts.limits[pair], self.basis)
        turned = np.angle(recorded[..., first] * np.conj(channels[..., first]))
        return [
            replace(level, phase=level.phase - float(force - response))
            for level, (force, response) in zip(levels, turned, strict=True)
        ]

    def parts(self, rig: Rig, cache: PartsCache, level: LevelProblem) -> RigParts:
        """The rig at the time of a level."""
        return cache.parts(rig, self.setup, level.seconds, level.cycles)

    def _level(
        self, parts: RigParts, level: LevelProblem, start: PeriodicState | None, last: PeriodicState | None
    ) -> PeriodicState | None:
        if not (math.isfinite(level.amplitude) and level.amplitude > 0.0 and math.isfinite(level.phase)):
            return None
        if start is not None:
            state = self._newton(parts, level, level.amplitude, self.carried(parts, level, start))
            if state is not None:
                return state
        if last is not None:
            state = self._newton(parts, level, level.amplitude, self.scaled(parts, level, last))
            if state is not None:
                return state
        state = self._newton(parts, level, level.amplitude, self.linear_start(parts, level, level.amplitude))
        if state is not None:
            return state
        # Follow the branch up from the linear range, or from the last level, in shrinking steps.
        return self._climb(parts, level, last)

    def _climb(self, parts: RigParts, level: LevelProblem, last: PeriodicState | None) -> PeriodicState | None:
        if last is None or last.drive >= level.amplitude:
            amplitude = 1e-3 * level.amplitude
            last = self._newton(parts, level, amplitude, self.linear_start(parts, level, amplitude))
            if last is None:
                return None
        factor, tries = (level.amplitude / last.drive) ** 0.25, 0
        while tries < 60:
            tries += 1
            amplitude = min(level.amplitude, last.drive * factor)
            state = self._newton(parts, level, amplitude, self.scaled(parts, level, last, amplitude))
            if state is None:
                factor = factor**0.5
                if factor < 1.005:
                    return None
                continue
            last = state
            if amplitude >= level.amplitude:
                return state
            factor = factor**1.3
        return None

    def _arguments(self, parts: RigParts, level: LevelProblem, amplitude: float) -> tuple[Any, ...]:
        """Arguments of the kernel behind the unknowns."""
        held = {DRIVE_HELD: DRIVE_HELD, FORCE_HELD: self._force}.get(level.held_channel)
        closing = Closing(
            LOCKED, self._row_of[level.held_channel] if held is None else held, self._force, self._response, self.power
        )
        return closing, target_rows(amplitude, level.phase), self._drive(parts, level, amplitude), parts.kernel_tables

    def _drive(self, parts: RigParts, level: LevelProblem, amplitude: float) -> ComplexArray:
        """Harmonics (n_orders, exciters) of the inputs per unit of the drive."""
        # Saturation is followed where the drive is what is given.
        return unit_drive(parts, amplitude if level.held_channel == DRIVE_HELD else 0.0, self.ideal_force, level.terms)

    def _newton(self, parts: RigParts, level: LevelProblem, amplitude: float, z: FloatArray) -> PeriodicState | None:
        limits = Limits(self.settings.iterations, self.settings.tolerance)
        try:
            done, solved, at = newton(z, *self._arguments(parts, level, amplitude), limits)
        except (np.linalg.LinAlgError, ZeroDivisionError):
            return None
        # A frequency far from what was measured is another resonance.
        reached = solved[-2] / (2.0 * np.pi * parts.clock)
        low, high = self._measured or (level.frequency_hz, level.frequency_hz)
        if amplitude < level.amplitude:  # on the way there it lies between the step before and what was measured
            before = z[-2] / (2.0 * np.pi * parts.clock)
            low, high = min(low, before), max(high, before)
        if not done or not (
            math.log(reached / high) < 1.5 * THRESHOLDS.prediction.resonance_search_share
            and math.log(low / reached) < 1.5 * THRESHOLDS.prediction.resonance_search_share
        ):
            return None
        if phase_slope(at.jacobian) <= 0.0:
            return None
        return PeriodicState(solved, parts.keys, amplitude, at.channels)

    def linear_start(self, parts: RigParts, level: LevelProblem, amplitude: float) -> FloatArray:
        """Unknowns of the system linearised at rest, at its phase resonance nearest to the measured frequency.

        Below the level's amplitude it may be as far off as a window may be from the modes, where none is nearer.
        """
        measured = 2.0 * np.pi * level.frequency_hz * parts.clock
        held_channel = level.held_channel == DRIVE_HELD
        drive = self._drive(parts, level, amplitude)[self.basis.fundamental]
        share = THRESHOLDS.prediction.resonance_search_share
        omega = self._linear_resonance(parts, level, drive, measured * np.linspace(1.0 - share, 1.0 + share, 161))
        if omega is None and amplitude < level.amplitude:
            far = THRESHOLDS.reading.wrong_frequency_ratio
            omega = self._linear_resonance(parts, level, drive, measured * np.geomspace(1.0 / far, far, 641))
        omega = measured if omega is None else omega
        w, channels = self._linear(parts, omega, drive)
        if not held_channel:
            index = self._force if level.held_channel == FORCE_HELD else self._row_of[level.held_channel]
            size = abs(channels[index])
            amplitude = amplitude / size if size > 0.0 else amplitude
        r, size = parts.coordinates, self.basis.size
        amplitudes = np.zeros((r, self.basis.orders.size), dtype=np.complex128)
        amplitudes[:, self.basis.fundamental] = w * amplitude
        z = np.empty(r * size + 2)
        z[:-2] = self.basis.to_real(amplitudes).ravel()
        z[-2:] = omega, math.log(amplitude)
        return z

    def _linear_resonance(
        self, parts: RigParts, level: LevelProblem, drive: ComplexArray, grid: FloatArray
    ) -> float | None:
        """Phase resonance at rest on a grid of angular frequencies, nearest to what was measured; None = none."""
        closing = Closing(LOCKED, DRIVE_HELD, self._force, self._response, self.power)
        angles = resting_angles(grid, *parts.resting, drive, parts.kernel_tables, closing, level.phase)
        # Phase resonance is where the angle rises through zero; it falls at antiresonances and jumps at nodes.
        rises = np.flatnonzero((angles[:-1] < 0.0) & (angles[1:] >= 0.0) & (np.diff(angles) < 2.0))
        if not rises.size:
            return None
        crossings = grid[rises] - angles[rises] * np.diff(grid)[rises] / np.diff(angles)[rises]
        measured = 2.0 * np.pi * level.frequency_hz * parts.clock
        return float(crossings[np.argmin(np.abs(crossings - measured))])

    def _linear(self, parts: RigParts, omega: float, drive: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Local displacements (r,) and channels (c,) of the linearised system."""
        s = 1j * omega
        w, outputs = resting_response(s, *parts.resting, drive, parts.kernel_tables)
        return w, channel_gains(s, parts.channels) * outputs

    def local_amplitudes(self, parts: RigParts, state: PeriodicState) -> ComplexArray:
        """Forces g of all coordinates (r, n_orders)."""
        r, size = parts.coordinates, self.basis.size
        w = state.z[:-2].reshape(r, size)
        forces = harmonic_forces(w, state.omega, parts.force_factor, parts.tables, False)
        return self.basis.to_complex(forces.amounts)

    @property
    def force_row(self) -> int:
        """Row of the controlled force among the channels of a state."""
        return self._force

    @property
    def response_row(self) -> int:
        """Row of the controlled response."""
        return self._response

    def own_row(self, channel: int) -> int:
        """Row of a channel of the test."""
        return self._row_of[channel]

    def gains(self, parts: RigParts, s: complex) -> ComplexArray:
        """Complex gains of all sensors (c,)."""
        return np.asarray(channel_gains(s, parts.channels))

    def phase_change(self, row: int, relative: complex) -> float:
        """Change of the phase condition by a relative change of one channel's fundamental."""
        return float((complex(relative)).imag) * ((row == self._force) - (row == self._response))

    def linearised(self, parts: RigParts, level: LevelProblem, z: FloatArray) -> Balance:
        """The balance at z with its Jacobian."""
        return cast(Balance, evaluate(z, *self._arguments(parts, level, level.amplitude), True))

    def fundamental_unknowns(
        self, parts: RigParts, states: Sequence[PeriodicState]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Fundamentals of all unknowns (states, n) and of the force at the drive point (states,), driven by sines."""
        one, system = self.basis.fundamental, parts.system
        units = [unit_drive(parts, 0.0, self.ideal_force, PURE_TONE)[one]] * len(states)
        omega = np.array([state.omega for state in states])
        amplitudes = np.array(
            [
                np.append(-self.local_amplitudes(parts, state)[:, one], unit * math.exp(state.z[-1]))
                for state, unit in zip(states, units, strict=True)
            ]
        )
        s = 1j * omega[:, None, None]
        impedance = system.stiffness + s * system.damping + s**2 * system.mass
        loads = np.einsum("nk,lk->ln", parts.inputs, amplitudes)
        chain = parts.channels[self._force]
        gains = np.array([sensor_gain(1j * w, chain)[0] for w in omega])
        force = np.array([state.channels[self._force, one] for state in states]) / gains
        shapes: ComplexArray = np.linalg.solve(impedance, loads[:, :, None])[:, :, 0].astype(np.complex128)
        return shapes, np.asarray(force, dtype=np.complex128)

    def carried(self, parts: RigParts, level: LevelProblem, state: PeriodicState) -> FloatArray:
        """A solution's unknowns on the coordinates of ``parts``; new coordinates move as the others make them."""
        if state.keys == parts.keys:
            return state.z.copy()
        shared = shared_unknowns(state.keys, parts.keys, self.basis.size)
        return cast(FloatArray, carried(state.z, *shared, *self._arguments(parts, level, state.drive)))

    def scaled(
        self, parts: RigParts, level: LevelProblem, state: PeriodicState, amplitude: float | None = None
    ) -> FloatArray:
        """Another level's solution in proportion to the amplitude."""
        wanted = level.amplitude if amplitude is None else amplitude
        ratio = wanted / state.drive
        z = self.carried(parts, level, state)
        z[:-2] *= ratio
        z[-1] += math.log(ratio)
        return z

    def stepped(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> list[PeriodicState | None]:
        """Solutions of a slightly different rig by one Newton step from ``states``."""
        result: list[PeriodicState | None] = []
        for level, state in zip(self.levels, states, strict=True):
            if state is None:
                result.append(None)
                continue
            parts = self.parts(rig, cache, level)
            z = self.carried(parts, level, state)
            closing, targets, *how = self._arguments(parts, level, level.amplitude)
            moved, channels = stepped(z[None], closing, targets[None], *how)
            result.append(PeriodicState(moved[0], parts.keys, state.drive, channels[0]))
        return result

    def tangent(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> Tangent | None:
        """What ``advanced`` needs of solved levels; None where they do not share their coordinates."""
        solved = tuple(position for position, state in enumerate(states) if state is not None)
        inverse, slopes, keys = [], [], set()
        for position in solved:
            state, level = states[position], self.levels[position]
            assert state is not None
            parts = self.parts(rig, cache, level)
            keys |= {state.keys, parts.keys}
            if len(keys) > 1:
                return None
            at = self.linearised(parts, level, state.z)
            closing, targets, *_ = self._arguments(parts, level, level.amplitude)
            try:
                inverse.append(inverted(at.jacobian, *scales(state.z, closing, targets, self.basis.size)))
            except np.linalg.LinAlgError:
                return None
            slopes.append(at.slopes)
        return Tangent(tuple(states), solved, np.array(inverse), np.array(slopes)) if solved else None

    def advanced(self, rig: Rig, cache: PartsCache, tangent: Tangent) -> list[PeriodicState | None] | None:
        """Solutions of a slightly different rig by one step with the Jacobian of the rig that was solved.

        A coordinate that the solved rig lacks has a force of the order of the change; to first order it moves as the
        others make it and what its force does is in the residuals of the others. None where a coordinate is missing.
        """
        result: list[PeriodicState | None] = [None] * len(self.levels)
        groups: dict[int, tuple[RigParts, list[int]]] = {}
        for number, position in enumerate(tangent.solved):
            parts = self.parts(rig, cache, self.levels[position])
            groups.setdefault(id(parts), (parts, []))[1].append(number)
        for parts, numbers in groups.values():
            solved = [tangent.solved[number] for number in numbers]
            states = [state for state in (tangent.states[position] for position in solved) if state is not None]
            levels = self._held(parts, [self.levels[position] for position in solved], states)
            if not has_coordinates(states[0].keys, parts.keys):
                return None
            each = [self._arguments(parts, level, level.amplitude) for level in levels]
            moved, channels = advance(
                np.array([state.z for state in states]), _UNKNOWN_FORCES,
                shared_unknowns(states[0].keys, parts.keys, self.basis.size), tangent.inverse[numbers],
                tangent.slopes[numbers], each[0][0], np.array([targets for _, targets, *_ in each]),
                np.array([drive for *_, drive, _ in each]), parts.kernel_tables,
            )  # fmt: skip
            for k, (position, state) in enumerate(zip(solved, states, strict=True)):
                result[position] = PeriodicState(moved[k], parts.keys, state.drive, channels[k])
        return result


class PhaseResonancePredictor(PeriodicLevels):
    """Predicts one test of locked windows; arguments and errors as of `PeriodicLevels`."""

    def __init__(self, test: LockedLevels, rows: Rows, settings: PredictionSettings) -> None:
        super().__init__(test, rows, settings)
        self._parts = _by_part(rows)
        if np.any(rows.harmonic > self.basis.orders[-1]):
            raise BenchError(f"test {test.name} has observables beyond harmonic {test.harmonics}.")

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> FloatArray:
        """Observables of the test's rows; NaN where a level has no solution."""
        count = len(self.levels)
        omega = np.full(count, np.nan)
        recorded = np.full((count, len(self.channels), self.basis.orders.size), np.nan, dtype=np.complex128)
        parts = self.parts(rig, cache, self.levels[0]) if count else None
        solved = [(position, state) for position, state in enumerate(states) if state is not None]
        if parts is not None and solved:
            positions = [position for position, _ in solved]
            omega[positions] = [state.omega for _, state in solved]
            channels = np.array([state.channels for _, state in solved])
            if np.any(np.isfinite(parts.saturation)) and self._voltages:
                # The voltage is recorded before the amplifier.
                channels[:, self._voltages] = 0.0
                drives = np.array([state.drive for _, state in solved])
                for row in self._voltages:
                    terms = np.array([self._terms(position, exciter_of(parts.sections[row])) for position in positions])
                    channels[:, row] = drives[:, None] * parts.channels[row, 0] * terms
            before_converter = channels[:, self._row_of]
            recorded[positions] = recorded_harmonics(before_converter, parts.limits[self._row_of], self.basis)
        if self.ideal_force:
            # Without a known drive the phases refer to the measured force.
            turn = np.angle(recorded[:, self.force, self.basis.fundamental])
            recorded = recorded * np.exp(-1j * np.outer(turn, self.basis.orders))[:, None, :]
        return self._rows_of(omega, recorded, rig, 1.0 if parts is None else parts.clock)

    def influence(
        self, rig: Rig, cache: PartsCache, states: Sequence[Any], source: Source
    ) -> tuple[FloatArray, list[SourceColumn]]:
        """What unit sources at a place would do to its rows, (rows, sources), and what each is."""
        return influence_on_levels(self, rig, cache, states, source)

    def _terms(self, position: int, exciter: int) -> ComplexArray:
        """Orders (n_orders,) of an exciter's drive at a level over the fundamental of the first."""
        return on_orders(self.levels[position].terms[exciter], self.basis)

    def _rows_of(self, omega: FloatArray, recorded: ComplexArray, rig: Rig, clock: float) -> FloatArray:
        result = np.full(len(self.rows), np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            for kind, (where, level, channel, order) in self._parts.items():
                if kind == Part.LOG_FREQUENCY:
                    values = np.log(omega[level] / clock)
                elif kind == Part.PHASE_ERROR:
                    values = _aim(rig, omega[level] / clock)
                else:
                    amplitude = recorded[level, channel, order]
                    if kind == Part.LOG_MAGNITUDE:
                        values = np.log(np.abs(amplitude))
                    elif kind == Part.PHASE:
                        values = np.angle(amplitude)
                    else:
                        quadrature = amplitude.real if kind == Part.REAL else amplitude.imag
                        values = quadrature / np.abs(recorded[level, channel, 1])
                result[where] = values
        result[np.isinf(result)] = np.nan
        return result


def on_orders(terms: tuple[complex, ...], basis: FourierBasis) -> ComplexArray:
    """Orders 1, 2, … of a drive on the orders of a basis, (n_orders,)."""
    result = np.zeros(basis.orders.size, dtype=np.complex128)
    here = (basis.orders >= 1) & (basis.orders <= len(terms))
    result[here] = np.asarray(terms)[basis.orders[here] - 1]
    return result


def _by_part(rows: Rows) -> dict[int, tuple[NDArray[np.int64], ...]]:
    """Positions, levels, channels and orders of the rows of each part that this test has."""
    result: dict[int, tuple[NDArray[np.int64], ...]] = {}
    channel = np.maximum(rows.channel, 0)
    order = np.where(rows.harmonic < 0, 1, rows.harmonic)
    for kind in (Part.LOG_FREQUENCY, Part.PHASE_ERROR, Part.LOG_MAGNITUDE, Part.PHASE, Part.REAL, Part.IMAG):
        where = np.flatnonzero(rows.part == kind)
        if where.size:
            result[int(kind)] = (where, rows.level[where], channel[where], order[where])
    return result


def phase_slope(jacobian: FloatArray) -> float:
    """d(phase)/dω at constant drive: positive at a resonance, negative at an antiresonance of the drive point."""
    local = jacobian.shape[0] - 2
    follow = np.linalg.solve(jacobian[:local, :local], jacobian[:local, local])
    return float(jacobian[local, local] - jacobian[local, :local] @ follow)


def _aim(rig: Rig, omega: FloatArray) -> FloatArray:
    """Phase that the loop holds, rad."""
    offset = float(rig.pll.get("phase_offset_rad", 0.0))
    latency = float(rig.pll.get("loop_latency_s", 0.0))
    return offset + omega * latency


def unit_drive(parts: RigParts, amplitude: float, ideal_force: bool, terms: Terms) -> ComplexArray:
    """Harmonics (n_orders, exciters) of the system's inputs per volt of drive.

    Args:
        parts: the rig.
        amplitude: fundamental of the first exciter's drive, V; 0 = amplifiers do not saturate.
        ideal_force: the drive is the force, N.
        terms: orders 1, 2, … of the drive of each exciter over the fundamental of the first.
    """
    basis = parts.basis
    result = np.stack([on_orders(each, basis) for each in terms], axis=1)
    if ideal_force:
        return result
    for exciter, saturation in enumerate(parts.saturation):
        if math.isfinite(saturation) and amplitude != 0.0:
            result[:, exciter] = _saturated(terms[exciter], float(saturation), amplitude, basis)
    return np.asarray(result * parts.input_per_volt)


def _saturated(terms: tuple[complex, ...], saturation: float, amplitude: float, basis: FourierBasis) -> ComplexArray:
    """Harmonics (n_orders,) of a drive behind an amplifier that saturates, per volt of ``amplitude``."""
    angles = 2.0 * np.pi * np.arange(256) / 256
    wave = np.zeros(angles.size)
    for order, term in enumerate(terms, start=1):
        wave += complex(term).real * np.cos(order * angles) - complex(term).imag * np.sin(order * angles)
    values = saturation * np.tanh(amplitude * wave / saturation)
    result = np.array(
        [
            (2.0 if order else 1.0)
            / 256
            * complex(np.cos(order * angles) @ values, -(np.sin(order * angles) @ values))
            / amplitude
            for order in basis.orders
        ]
    )
    # What only rounding makes is nothing: orders that are not driven cost nothing.
    result.real[np.abs(result.real) < 1e-12] = 0.0
    result.imag[np.abs(result.imag) < 1e-12] = 0.0
    return result


# -- influence -------------------------------------------------------------------------------------------------------


def influence_on_levels(
    predictor: PhaseResonancePredictor,
    rig: Rig,
    cache: PartsCache,
    states: Sequence[PeriodicState | None],
    source: Source,
) -> tuple[FloatArray, list[SourceColumn]]:
    """Columns (rows of the test, sources), one for each level at least, and what each is the response to."""
    if source.kind == "controller":
        held, levels = predictor.rows.part == Part.PHASE_ERROR, range(len(predictor.levels))
        shifts = [0.01 * (held & (predictor.rows.level == level)) for level in levels]
        return np.stack(shifts, axis=1), [SourceColumn(predictor.test.name, "level", level) for level in levels]
    columns, labels = _resonance_influence(predictor, rig, cache, states, source)
    # Lines and steps follow no excitation: only an error of their own channel adds to them.
    columns[np.isin(predictor.rows.part, OF_THE_CHANNEL)] = 0.0
    direct, more = _channel_sources(predictor, states, source)
    return np.hstack((columns, direct)), labels + more


def _resonance_influence(
    predictor: PhaseResonancePredictor,
    rig: Rig,
    cache: PartsCache,
    states: Sequence[PeriodicState | None],
    source: Source,
) -> tuple[FloatArray, list[SourceColumn]]:
    """Columns (rows of the test, sources): one for each level, order, and real and imaginary part."""
    base = predictor.values(rig, cache, list(states))
    moved: list[tuple[int, PeriodicState]] = []
    names: list[SourceColumn] = []
    models: dict[int, LinearModel] = {}
    highest = predictor.test.harmonics
    for position, (level, state) in enumerate(zip(predictor.levels, states, strict=True)):
        if state is None:
            continue
        parts = predictor.parts(rig, cache, level)
        z = predictor.carried(parts, level, state)
        at = predictor.linearised(parts, level, z)
        channels = at.channels
        force = abs(channels[predictor.force_row, 1])
        vectors = np.zeros((parts.system.size, 0))
        if source.kind not in ("force_sensor", "response_sensor"):
            vectors, measured = source_vectors(rig, parts, source)
            if id(parts) not in models:
                models[id(parts)] = with_sources(parts, vectors, measured, predictor.settings)
        for order in range(highest + 1):
            for turn in (1.0, 1j) if order else (1.0,):
                for residual, direct, vector in _level_sources(
                    predictor,
                    parts,
                    models.get(id(parts)),
                    vectors.shape[1],
                    source,
                    state,
                    order,
                    turn,
                    force,
                    channels,
                ):
                    step = -np.linalg.solve(at.jacobian, residual)
                    channels_there = channels + direct + at.slopes @ step
                    moved.append((position, PeriodicState(z + step, parts.keys, state.drive, channels_there)))
                    part: Literal["re", "im"] = "re" if turn == 1.0 else "im"
                    names.append(SourceColumn(predictor.test.name, "level", position, order, part, vector))
    columns = np.zeros((base.size, len(moved)))
    # Only the rows of its own level follow a solution: one of every level can be looked at in one go.
    turns: dict[int, int] = {}
    together: list[dict[int, int]] = []
    for column, (position, _) in enumerate(moved):
        turn_of_level = turns[position] = turns.get(position, -1) + 1
        if turn_of_level == len(together):
            together.append({})
        together[turn_of_level][position] = column
    for members in together:
        several: list[PeriodicState | None] = [None] * len(states)
        for position, column in members.items():
            several[position] = moved[column][1]
        change = predictor.values(rig, cache, several) - base
        for position, column in members.items():
            columns[:, column] = np.where(predictor.rows.level == position, change, 0.0)
    return columns, names


def _level_sources(
    predictor: PhaseResonancePredictor, parts: RigParts, model: LinearModel | None, count: int, source: Source,
    state: PeriodicState, order: int, turn: complex, force: float, channels: ComplexArray,
) -> list[tuple[FloatArray, ComplexArray, int]]:  # fmt: skip
    """Change of the residual, of the channels, and its number, for each source vector at one order."""
    nz, r, basis = state.z.size, parts.coordinates, parts.basis
    result: list[tuple[FloatArray, ComplexArray, int]] = []
    if model is None:
        row = predictor.force_row if source.kind == "force_sensor" else predictor.own_row(source.index)
        direct = np.zeros_like(channels)
        direct[row, order] = THRESHOLDS.prediction.unit_source_share * turn * channels[row, 1]
        residual = np.zeros(nz)
        if order == 1:
            residual[-2] = predictor.phase_change(row, THRESHOLDS.prediction.unit_source_share * turn)
        return [(residual, direct, 0)]
    t, _ = model.at(1j * order * state.omega)
    for k in range(count):
        amount = (
            THRESHOLDS.prediction.unit_source_share
            * force
            * turn
            * np.exp(1j * np.angle(channels[predictor.force_row, 1]))
        )
        column = t[:, parts.inputs.shape[1] + k]
        size = float(np.max(np.abs(column[: r + parts.channels.shape[0]]))) or 1.0
        residual = np.zeros(nz)
        for i in range(r):
            direct_change = -column[i] * amount
            offset = i * basis.size + basis.offsets[order]
            residual[offset] = direct_change.real
            if order:
                residual[offset + 1] = -direct_change.imag
        direct = np.zeros_like(channels)
        gains = predictor.gains(parts, 1j * order * state.omega)
        direct[:, order] = gains * column[r:] * amount
        if order == 1:
            residual[-2] = float(
                (direct[predictor.force_row, 1] / channels[predictor.force_row, 1]).imag
                - (direct[predictor.response_row, 1] / channels[predictor.response_row, 1]).imag
            )
        if size > 0.0:
            result.append((residual, direct, k))
    return result


def _channel_sources(
    predictor: PhaseResonancePredictor, states: Sequence[Any], source: Source
) -> tuple[FloatArray, list[SourceColumn]]:
    """Lines and steps of a channel, (rows of the test, sources): 1 % of its smallest fundamental, at each level."""
    empty: tuple[FloatArray, list[SourceColumn]] = np.zeros((len(predictor.rows), 0)), []
    if source.kind not in ("force_sensor", "response_sensor"):
        return empty
    channel = predictor.force_row if source.kind == "force_sensor" else predictor.own_row(source.index)
    rows = [index for index in range(len(predictor.test.channels)) if predictor.own_row(index) == channel]
    sizes = [float(abs(state.channels[channel, predictor.basis.fundamental])) for state in states if state is not None]
    columns, names = [], []
    for part in OF_THE_CHANNEL:
        selected = (predictor.rows.part == part) & np.isin(predictor.rows.channel, rows)
        for level in np.unique(predictor.rows.level[selected]) if sizes else ():
            columns.append(0.01 * min(sizes) * (selected & (predictor.rows.level == level)))
            names.append(SourceColumn(predictor.test.name, "level", int(level), unexcited=part))
    return (np.stack(columns, axis=1), names) if columns else empty
