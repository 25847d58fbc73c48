"""Directions in which the measuring chain of imported tests moves the observables, see shared_errors.py."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_core.blocks import Quantity
from nmt_diagnose.inference.chain_tests import DELAY_STEP_S, FUNDAMENTAL, ChainTests, edited, later
from nmt_diagnose.inference.held_drive_errors import IMAGE_FLOOR, SAME_FOR_LEVELS, HeldDrive, near_step
from nmt_diagnose.inference.modes_left_out import ModesLeftOut
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.shape_errors import ShapeErrors
from nmt_diagnose.inference.shared_errors import SharedErrors
from nmt_diagnose.observations.conditions import (
    PhaseResonanceTest,
    RandomTest,
    RingDownTest,
    SteppedSineTest,
    Test,
)
from nmt_diagnose.observations.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.twin.forward import Prediction
from nmt_diagnose.twin.stepped_sine_twin import gain_error
from nmt_rig.rig import Rig, SensorSection

_GAIN_STEP, _DRIVE_STEP, _LEAD_STEP, _CLOCK_STEP, _SHIFT_STEP = 1e-3, 1e-3, 1e-3, 1e-5, 1e-6
# Sensors that pass no constants.
_PIEZOELECTRIC = (Quantity.FORCE, Quantity.ACCELERATION)
# Time constants, samples, of what a channel sees of a step that is on its way.
_SMOOTH, _SMOOTHER = 0.03, 0.1
# No sensor's response is flatter than this, relative: lines on top of a resonance have less noise.
_FLAT = 5e-4
# What the model's response to a harmonic of the drive may be off by, relative.
_DRIVEN_FLOOR = 0.03
# What a loop may hold other than it was told, for each level, rad.
_LOCK_STD = math.radians(0.5)
# What responses at held amplitudes are divided by.
_REFERENCE = {"force": Quantity.FORCE, "base": Quantity.ACCELERATION, "voltage": Quantity.VOLTAGE}


def with_chain_errors(problem: Problem, rig: Rig, prediction: Prediction, scatter: FloatArray | None = None) -> Problem:
    """The problem with the tolerances of its tests' measuring chains as part of the noise; itself without any.

    Args:
        problem: observations and model.
        rig: the model as given.
        prediction: its prediction of the observations.
        scatter: of each row from test to test, shape (m,), see scatter.py; None = none.
    """
    changed, columns = chain_errors(problem, rig, prediction, scatter)
    return with_shared(changed, columns)


def with_shared(problem: Problem, columns: FloatArray) -> Problem:
    """The problem with errors that rows share, one standard deviation of each a column, (m, r); itself without any."""
    columns = columns[:, np.any(columns != 0.0, axis=0)]
    if not columns.shape[1]:
        return problem
    return replace(problem, shared=SharedErrors.of(problem.whitened(columns)))


def chain_errors(
    problem: Problem,
    rig: Rig,
    prediction: Prediction,
    scatter: FloatArray | None = None,
    drift: float = 0.0,
    known: FloatArray | None = None,
) -> tuple[Problem, FloatArray]:
    """The problem with the floors of its measuring chains and scatter, and the errors of the chains, shape (m, r).

    Arguments as for :func:`with_chain_errors`; ``drift`` is the relative standard deviation of the resonance from sweep
    to sweep, see sweep_drift.py. Where there are chains, the first column is the error of the clock. Errors that are
    ``known`` are not found anew.
    """
    observations = problem.observations
    chains = _chains(observations)
    unsettled = _unsettled(observations)
    if not chains:
        if scatter is not None and scatter.any():
            problem = replace(problem, observations=replace(observations, floor=np.hypot(observations.floor, scatter)))
        return problem, unsettled
    builder = _Columns(observations, rig, chains)
    # A level that has no solution tells nothing of its errors.
    floor = np.hypot(observations.floor, np.nan_to_num(builder.floor(prediction), posinf=0.0))
    if scatter is not None:
        floor = np.hypot(floor, scatter)
    problem = replace(problem, observations=replace(observations, floor=floor))
    if known is not None:
        return problem, known
    columns = np.nan_to_num(builder.columns(prediction), posinf=0.0, neginf=0.0)
    if scatter is not None:
        columns = np.hstack([columns, builder.between_tests(scatter)])
    if drift > 0.0:
        columns = np.hstack([columns, drift * builder.sweeps(prediction)])
    return problem, np.hstack([columns, unsettled])


def _unsettled(observations: Observations) -> FloatArray:
    """Amplitudes of locked windows that had not settled, one error for each level, shape (m, levels)."""
    rows, found = observations.rows, []
    for number, test in enumerate(observations.tests):
        if not isinstance(test, PhaseResonanceTest):
            continue
        for position, level in enumerate(test.levels):
            if any(level.amplitude_leans):
                mine = (rows.test == number) & (rows.level == position) & (rows.part == Part.LOG_MAGNITUDE)
                mine &= rows.channel >= 0
                column = np.zeros(len(rows))
                column[mine] = np.array(level.amplitude_leans)[rows.channel[mine]]
                found.append(column)
    return np.column_stack(found) if found else np.zeros((len(rows), 0))


def lock_slopes(observations: Observations, rig: Rig, prediction: Prediction) -> FloatArray:
    """Change of the rows of locked windows over the phase at which each of them truly stood, shape (m,).

    Args:
        observations: the real side.
        rig: an explanation of it.
        prediction: of that explanation.
    """
    own = _columns_with(observations, rig, PhaseResonanceTest)
    return np.zeros(len(observations.rows)) if own is None else own.slopes(prediction)


def sweep_directions(observations: Observations, rig: Rig, prediction: Prediction) -> FloatArray:
    """What a relative shift of the resonance does to the rows of each sweep at a held amplitude, shape (m, tests).

    Args:
        observations: the real side.
        rig: an explanation of it.
        prediction: of that explanation.
    """
    own = _columns_with(observations, rig, SteppedSineTest)
    return np.zeros((len(observations.rows), len(observations.tests))) if own is None else own.sweeps(prediction)


def _columns_with(observations: Observations, rig: Rig, kind: type[Test]) -> _Columns | None:
    """Directions of the tests that have measuring chains; None where no test of a kind is among them."""
    chains = _chains(observations)
    found = any(isinstance(observations.tests[number], kind) for number in chains)
    return _Columns(observations, rig, chains) if found else None


def _chains(observations: Observations) -> dict[int, MeasuringChain]:
    """Measuring chains of the tests that tell of them, by number of the test."""
    return {
        number: chain
        for number, chain in enumerate(observations.chains)
        if chain is not None
        and isinstance(observations.tests[number], PhaseResonanceTest | RandomTest | RingDownTest | SteppedSineTest)
    }


class _Columns:
    """Directions for the tests of one set of observations."""

    def __init__(self, observations: Observations, rig: Rig, chains: dict[int, MeasuringChain]) -> None:
        self.chain = ChainTests(observations, rig, chains)
        self.rows = self.chain.rows
        self.tests = self.chain.tests
        self.rig = self.chain.rig
        self.own = self.chain.own
        self.channels = self.chain.channels
        self.forward = self.chain.forward
        self.observations = self.chain.observations
        self.mine = self.chain.mine
        self.numbers = self.chain.numbers
        self.held = HeldDrive(self.chain)
        self.modes = ModesLeftOut(self.chain)
        self.shapes = ShapeErrors(self.chain)

    def columns(self, prediction: Prediction) -> FloatArray:
        """What one standard deviation of each error adds to the observables, shape (m, r)."""
        forward = self.forward
        # Measured from a solution of the same accuracy.
        base = forward.predict(self.rig, self.chain.start(prediction))

        held = np.isin(self.rows.test, [k for k, test in enumerate(self.tests) if isinstance(test, SteppedSineTest)])

        def change(rig: Rig, step: float) -> FloatArray:
            moved = forward.difference(forward.predict(rig, base).values, base.values) / step
            return np.where(held, 0.0, moved)

        clock = self.rig.model_copy(update={"clock_error": self.rig.clock_error + _CLOCK_STEP})
        moved = forward.difference(forward.predict(clock, base).values, base.values)
        found: list[FloatArray] = [max(chain.clock for chain in self.own) * moved / _CLOCK_STEP]
        omega = 2.0 * np.pi * np.where(self.rows.frequency_hz > 0.0, self.rows.frequency_hz, self.chain.resonance())
        tested = self.chain.tested()
        groups: dict[Quantity, FloatArray] = {}
        for channel, own in self.channels.items():
            tolerance = next((chain.of(channel) for chain in self.own if channel in chain.channels), self.own[0].of(""))
            gain = change(edited(self.rig, own, _louder), _GAIN_STEP)
            delay = change(edited(self.rig, own, later), DELAY_STEP_S)
            groups[own.quantity] = groups.get(own.quantity, np.zeros(len(self.rows))) + delay
            found += [tolerance.gain * gain, tolerance.delay_s * delay, tolerance.phase * delay / omega]
            if own.quantity in _PIEZOELECTRIC:
                # Its high-pass leads by ω_h/ω: by the phase that is stated at the mode that is tested.
                lead = change(edited(self.rig, own, partial(_leading, corner_hz=_LEAD_STEP * tested)), _LEAD_STEP)
                found.append(tolerance.phase * lead)
            if any(near_step(test, channel) for test in self.tests):
                # Two of them: with the size of such an error its shape changes, too.
                for time in (_SMOOTH, _SMOOTHER):
                    smooth = partial(_smoothed, time_s=time / self._step_rate())
                    found.append(change(edited(self.rig, own, smooth), 1.0))
        # Sensors of one kind share their conditioners; all of them together may be late against the voltage.
        shared = max(chain.shared_delay_s for chain in self.own)
        found += [shared * group for group in (*groups.values(), np.sum(list(groups.values()), axis=0))]
        # What a random test itself told of such delays stands in that test alone.
        told = [k for k, test in enumerate(self.tests) if isinstance(test, RandomTest) and test.late_s]
        if told:
            found += [shared * np.where(np.isin(self.rows.test, told), group, 0.0) for group in groups.values()]
        voltage_gain = max(chain.voltage_gain for chain in self.own)
        found += [voltage_gain * self._voltage(base), voltage_gain * self._recorded_voltage()]
        found += self.held.columns(self.chain.slopes(base), base)
        found += self.held.aims(base)
        found += [*self._stepped(), *self.modes.columns(base), *self.shapes.columns(base), *self.held.bends()]
        return np.column_stack([self.chain.full(column) for column in found])

    def sweeps(self, prediction: Prediction) -> FloatArray:
        """Change of each sweep's rows over the relative shift of its resonance, shape (m, tests).

        A response per force is a function of the frequency over the resonance's: the lines shift the other way.
        """
        base = self.forward.predict(self.rig, self.chain.start(prediction))
        moved = tuple(
            replace(t, lines_hz=t.lines_hz * (1.0 - _SHIFT_STEP)) if isinstance(t, SteppedSineTest) else t
            for t in self.tests
        )
        change = np.nan_to_num(self.chain.moved(moved, base) / _SHIFT_STEP, posinf=0.0, neginf=0.0)
        result = np.zeros((len(self.observations.rows), len(self.observations.tests)))
        for number, own in enumerate(self.numbers):
            result[:, own] = self.chain.full(change * (self.rows.test == number))
        return result

    def slopes(self, prediction: Prediction) -> FloatArray:
        """Change of the rows over that of the phase at which each level truly stood, shape (m,)."""
        return self.chain.full(self.chain.slopes(self.forward.predict(self.rig, self.chain.start(prediction))))

    def _driven(self, prediction: Prediction) -> FloatArray:
        """Size of what the recorded harmonics of the drive make of each harmonic, shape (rows,)."""
        pure = tuple(
            replace(t, levels=tuple(replace(level, drive_harmonics=()) for level in t.levels))
            if isinstance(t, PhaseResonanceTest) and any(level.drive_harmonics for level in t.levels)
            else t
            for t in self.tests
        )
        result = np.zeros(len(self.rows))
        change = -np.nan_to_num(self.chain.moved(pure, self.chain.start(prediction)))
        for mine in self.chain.harmonics().values():
            result[mine] = float(np.linalg.norm(change[mine]))
        return result

    def _step_rate(self) -> float:
        """Rate of the held drive whose images are part of the model, Hz."""
        return min(t.drive_hold_hz for t in self.tests if isinstance(t, RandomTest) and t.sampled_at is not None)

    def _voltage(self, base: Prediction) -> FloatArray:
        """Rows over the relative error of the recorded voltage: the drive was larger than recorded."""
        moved = tuple(
            replace(t, levels=tuple(replace(level, drive=level.drive * (1.0 + _DRIVE_STEP)) for level in t.levels))
            if isinstance(t, PhaseResonanceTest)
            else t
            for t in self.tests
        )
        result = self.chain.moved(moved, base) / _DRIVE_STEP
        for number, test in enumerate(self.tests):
            if isinstance(test, RandomTest) and test.reference == "voltage":
                result[(self.rows.test == number) & (self.rows.part == Part.LOG_MAGNITUDE)] = 1.0
        return result

    def _recorded_voltage(self) -> FloatArray:
        """Rows over the gain of the recorded voltage where other tests say what was commanded."""
        result = np.zeros(len(self.rows))
        if any(isinstance(test, PhaseResonanceTest) and test.commanded for test in self.tests):
            for number, test in enumerate(self.tests):
                if isinstance(test, RandomTest) and test.reference == "voltage":
                    result[(self.rows.test == number) & (self.rows.part == Part.LOG_MAGNITUDE)] = 1.0
        return result

    def _stepped(self) -> list[FloatArray]:
        """Gain, phase and delay of responses over their reference, at held amplitudes."""
        found = self._late_kinds()
        for channel in self.channels:
            tolerance = self.own[0].of(channel)
            columns = np.zeros((3, len(self.rows)))
            for number, test in enumerate(self.tests):
                if not isinstance(test, SteppedSineTest):
                    continue
                mine = np.flatnonzero((self.rows.test == number) & self.chain.rows_of(channel))
                error = gain_error(test)[self.rows.level[mine], self.rows.channel[mine]]
                omega = 2.0 * np.pi * self.rows.frequency_hz[mine]
                turned = self.rows.part[mine] == Part.PHASE
                columns[0, mine] = np.where(turned, error.imag, error.real)
                # The phase corrects no magnitude.
                columns[1, mine] = np.where(turned, 1.0, 0.0)
                columns[2, mine] = np.where(turned, omega, 0.0)
            # Both channels of the quotient.
            sizes = math.sqrt(2.0) * np.array([tolerance.gain, tolerance.phase, tolerance.delay_s])
            found += list(sizes[:, None] * columns)
        return found

    def _late_kinds(self) -> list[FloatArray]:
        """Delay that the sensors of a kind share, and the reference's, in responses at held amplitudes."""
        stepped = [k for k, test in enumerate(self.tests) if isinstance(test, SteppedSineTest)]
        turned = np.isin(self.rows.test, stepped) & (self.rows.part == Part.PHASE)
        if not turned.any():
            return []
        shared = max(self.own[number].shared_delay_s for number in stepped)
        late: dict[Quantity, FloatArray] = {}
        for number in stepped:
            test = self.tests[number]
            assert isinstance(test, SteppedSineTest)
            for k, channel in enumerate(test.channels):
                mine = turned & (self.rows.test == number) & (self.rows.channel == k)
                for kind, sign in ((channel.quantity, 1.0), (_REFERENCE[test.reference], -1.0)):
                    late.setdefault(kind, np.zeros(len(self.rows)))[mine] += sign
        return [shared * 2.0 * np.pi * self.rows.frequency_hz * column for column in late.values() if column.any()]

    def between_tests(self, scatter: FloatArray) -> FloatArray:
        """A random test is one more passage: magnitudes and phases of each channel scatter as a level's do, (m, r)."""
        found = [np.zeros(len(self.rows))]
        own = scatter[self.mine]
        # Lines of a sweep scatter within a passage.
        sweeps = [k for k, test in enumerate(self.tests) if isinstance(test, SteppedSineTest)]
        for number, test in enumerate(self.tests):
            for k, channel in enumerate(test.channels if isinstance(test, RandomTest) else ()):
                levels = self.chain.rows_of(channel.name) & ~np.isin(self.rows.test, [number, *sweeps])
                for part in FUNDAMENTAL:
                    size = float(np.max(own[levels & (self.rows.part == part)], initial=0.0))
                    mine = (self.rows.test == number) & (self.rows.channel == k) & (self.rows.part == part)
                    found.append(size * mine)
        return np.column_stack([self.chain.full(column) for column in found])

    def floor(self, prediction: Prediction) -> FloatArray:
        """What is added to the floors of the rows, shape (m,)."""
        values = prediction.values[self.mine]
        size = self.held.size(values)
        # The model's own error up there is the same for all levels of a run.
        result = IMAGE_FLOOR * size + _DRIVEN_FLOOR * self._driven(prediction)
        result[self.rows.part == Part.PHASE_ERROR] = _LOCK_STD
        for number, test in enumerate(self.tests):
            if isinstance(test, PhaseResonanceTest):
                result[(self.rows.test == number) & self.chain.linear_rows(number)] *= SAME_FOR_LEVELS
        result += self.held.jumps(self.chain.start(prediction))
        for number, test in enumerate(self.tests):
            if isinstance(test, RandomTest):
                mine = self.chain.linear_rows(number)
                result[mine] = np.hypot(result[mine], _FLAT)
        result += self.held.known_images(self.chain.start(prediction))
        # Near zeros of a response images are as large as the response: there ln(1 + z) is far from z.
        result += 0.5 * size**2
        # Of modes that are left out the directions hold to the second order.
        others = np.zeros(len(self.rows))
        for column in self.modes.columns(self.chain.start(prediction)):
            others += np.where(np.isin(self.rows.part, FUNDAMENTAL), column, 0.0) ** 2
        result += others**1.5 / 24.0
        for fundamental, over in self.chain.over_fundamental():
            result[over] = np.hypot(result[over], np.abs(values[over]) * result[fundamental])
        for number, chain in enumerate(self.own):
            lines = (self.rows.test == number) & (self.rows.part == Part.LINE)
            for channel in np.unique(self.rows.channel[lines]):
                same = (self.rows.test == number) & (self.rows.channel == channel)
                sizes = self.observations.values[self.mine][same & (self.rows.part == Part.LOG_MAGNITUDE)]
                if sizes.size:
                    result[lines & same] = chain.mains * float(np.exp(sizes.max()))
        return self.chain.full(result)


def _louder(sensor: SensorSection) -> SensorSection:
    return sensor.model_copy(update={"gain": sensor.gain * (1.0 + _GAIN_STEP)})


def _leading(sensor: SensorSection, corner_hz: float) -> SensorSection:
    return sensor.model_copy(update={"high_pass_hz": (sensor.high_pass_hz or 0.0) + corner_hz})


def _smoothed(sensor: SensorSection, time_s: float) -> SensorSection:
    corner = 1.0 / (2.0 * math.pi * time_s)
    return sensor.model_copy(update={"low_pass_hz": min(sensor.low_pass_hz or math.inf, corner)})
