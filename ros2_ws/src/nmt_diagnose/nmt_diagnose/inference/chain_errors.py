"""Directions in which the measuring chain of imported tests moves the observables, see shared_errors.py."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.blocks import FloatArray, Quantity
from nmt_diagnose.inference.problem import BoolArray, Problem
from nmt_diagnose.inference.shared_errors import SharedErrors
from nmt_diagnose.observations.conditions import (
    MeasuredChannel,
    PhaseResonanceTest,
    RandomTest,
    RingDownTest,
    SteppedSineTest,
    Test,
)
from nmt_diagnose.observations.drive_hold import zero_order_images
from nmt_diagnose.observations.measuring_chain import MeasuringChain
from nmt_diagnose.observations.model_view import ORDER, ModelView
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.twin.forward import Forward, Prediction
from nmt_diagnose.twin.held_steps import LEAST_RISE
from nmt_diagnose.twin.stepped_sine_twin import gain_error
from nmt_rig.rig import ModalSection, Rig, SensorSection

ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.intp]

_GAIN_STEP, _DELAY_STEP_S, _DRIVE_STEP = 1e-3, 1e-6, 1e-3
_PHASE_STEP = 1e-4
_LEAD_STEP = 1e-3
# Sensors that pass no constants.
_PIEZOELECTRIC = (Quantity.FORCE, Quantity.ACCELERATION)
_IMAGE_ORDERS = tuple((order,) for order in (-1, 1, -2, 2, -3, 3, -4, 4))
# What the model's response far above its modes is off by, some 0.1, goes smoothly over some hundred lines; taken as
# noise of each line it must be larger by the root of their number not to count for more than it is. The share of it
# that differs from level to level.
_IMAGE_FLOOR, _SAME_FOR_LEVELS = 1.0, 0.2
# Samples about the step of a held drive in which it is on the way, time constants of that, what is left of the step,
# relative, and of a response at most.
_JUMP, _SMOOTH, _SMOOTHER, _JUMP_SHARE, _JUMP_FLOOR = 0.15, 0.03, 0.1, 0.05, 1e-3
# No sensor's response is flatter than this, relative: lines on top of a resonance have less noise.
_FLAT = 5e-4
# Time that such a drive takes to move on, samples; what images that are part of the model may be off by, relative.
_RISE, _KNOWN_IMAGES = 0.05, 0.01
# What the model's response to a harmonic of the drive may be off by, relative.
_DRIVEN_FLOOR = 0.03
_CLOCK_STEP = 1e-5
# Modes that a model leaves out, as shares of the static flexibility of those that it has; frequency over the
# resonance's at which that is taken.
_ABOVE, _BELOW, _STATIC = 0.2, 0.05, 0.1
_SHIFT_STEP = 1e-6
# Measured over predicted magnitude, ln, at which nothing lies between them.
_FAR = 1.0
# What a loop may hold other than it was told, for all levels and for each, rad.
_AIM_STD, _LOCK_STD = math.radians(1.0), math.radians(0.5)
_FUNDAMENTAL = (Part.LOG_MAGNITUDE, Part.PHASE)
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
    problem: Problem, rig: Rig, prediction: Prediction, scatter: FloatArray | None = None, drift: float = 0.0
) -> tuple[Problem, FloatArray]:
    """The problem with the floors of its measuring chains and scatter, and the errors of the chains, shape (m, r).

    Arguments as for :func:`with_chain_errors`; ``drift`` is the relative standard deviation of the resonance from sweep
    to sweep, see sweep_drift.py. Where there are chains, the first column is the error of the clock.
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
    """Directions for the tests of one set of observations; a sensor is the same in all of its tests."""

    def __init__(self, observations: Observations, rig: Rig, chains: dict[int, MeasuringChain]) -> None:
        self.observations, self.rig, self.chains = observations, rig, chains
        rows = observations.rows
        self.mine = np.isin(rows.test, list(chains))
        self.numbers = sorted(chains)
        renumbered = np.zeros(max(self.numbers) + 1, dtype=np.int64)
        renumbered[self.numbers] = np.arange(len(self.numbers))
        part = rows.take(self.mine)
        self.rows = replace(part, test=renumbered[part.test])
        self.tests = tuple(observations.tests[number] for number in self.numbers)
        self.forward = Forward(self.tests, self.rows)
        self.own = tuple(chains[number] for number in self.numbers)
        self.channels = {
            c.name: c
            for test in self.tests
            for c in getattr(test, "channels", ())
            if c.quantity is not Quantity.VOLTAGE
        }
        for test in self.tests:
            if isinstance(test, RandomTest) and test.reference == "force":
                name = f"f{test.drive_point}"
                self.channels.setdefault(name, MeasuredChannel(name, Quantity.FORCE, test.drive_point))
        self.images = self._images()

    def _full(self, values: FloatArray) -> FloatArray:
        result = np.zeros(len(self.observations.rows))
        result[self.mine] = values
        return result

    def columns(self, prediction: Prediction) -> FloatArray:
        """What one standard deviation of each error adds to the observables, shape (m, r)."""
        forward = self.forward
        # Measured from a solution of the same accuracy.
        base = forward.predict(self.rig, self._start(prediction))

        held = np.isin(self.rows.test, [k for k, test in enumerate(self.tests) if isinstance(test, SteppedSineTest)])

        def change(rig: Rig, step: float) -> FloatArray:
            moved = forward.difference(forward.predict(rig, base).values, base.values) / step
            return np.where(held, 0.0, moved)

        clock = self.rig.model_copy(update={"clock_error": self.rig.clock_error + _CLOCK_STEP})
        moved = forward.difference(forward.predict(clock, base).values, base.values)
        found: list[FloatArray] = [max(chain.clock for chain in self.own) * moved / _CLOCK_STEP]
        omega = 2.0 * np.pi * np.where(self.rows.frequency_hz > 0.0, self.rows.frequency_hz, self._resonance())
        tested = self._tested()
        groups: dict[Quantity, FloatArray] = {}
        for channel, own in self.channels.items():
            tolerance = next((chain.of(channel) for chain in self.own if channel in chain.channels), self.own[0].of(""))
            gain = change(_edited(self.rig, own, _louder), _GAIN_STEP)
            delay = change(_edited(self.rig, own, _later), _DELAY_STEP_S)
            groups[own.quantity] = groups.get(own.quantity, np.zeros(len(self.rows))) + delay
            found += [tolerance.gain * gain, tolerance.delay_s * delay, tolerance.phase * delay / omega]
            if own.quantity in _PIEZOELECTRIC:
                # Its high-pass leads by ω_h/ω: by the phase that is stated at the mode that is tested.
                lead = change(_edited(self.rig, own, partial(_leading, corner_hz=_LEAD_STEP * tested)), _LEAD_STEP)
                found.append(tolerance.phase * lead)
            if any(_near_step(test, channel) for test in self.tests):
                # Two of them: with the size of such an error its shape changes, too.
                for time in (_SMOOTH, _SMOOTHER):
                    smooth = partial(_smoothed, time_s=time / self._step_rate())
                    found.append(change(_edited(self.rig, own, smooth), 1.0))
        # Sensors of one kind share their conditioners; all of them together may be late against the voltage.
        shared = max(chain.shared_delay_s for chain in self.own)
        found += [shared * group for group in (*groups.values(), np.sum(list(groups.values()), axis=0))]
        # What a random test itself told of such delays stands in that test alone.
        told = [k for k, test in enumerate(self.tests) if isinstance(test, RandomTest) and test.late_s]
        if told:
            found += [shared * np.where(np.isin(self.rows.test, told), group, 0.0) for group in groups.values()]
        voltage_gain = max(chain.voltage_gain for chain in self.own)
        found += [voltage_gain * self._voltage(base), voltage_gain * self._recorded_voltage()]
        found += self._hold(self._slopes(base), base)
        found += self._aims()
        found += [*self._stepped(), *self._other_modes(base), *self._bends()]
        return np.column_stack([self._full(column) for column in found])

    def sweeps(self, prediction: Prediction) -> FloatArray:
        """Change of each sweep's rows over the relative shift of its resonance, shape (m, tests).

        A response per force is a function of the frequency over the resonance's: the lines shift the other way.
        """
        base = self.forward.predict(self.rig, self._start(prediction))
        moved = tuple(
            replace(t, lines_hz=t.lines_hz * (1.0 - _SHIFT_STEP)) if isinstance(t, SteppedSineTest) else t
            for t in self.tests
        )
        change = np.nan_to_num(self._moved(moved, base) / _SHIFT_STEP, posinf=0.0, neginf=0.0)
        result = np.zeros((len(self.observations.rows), len(self.observations.tests)))
        for number, own in enumerate(self.numbers):
            result[:, own] = self._full(change * (self.rows.test == number))
        return result

    def slopes(self, prediction: Prediction) -> FloatArray:
        """Change of the rows over that of the phase at which each level truly stood, shape (m,)."""
        return self._full(self._slopes(self.forward.predict(self.rig, self._start(prediction))))

    def _start(self, prediction: Prediction) -> Prediction:
        """The part of a prediction of all observations that belongs to these tests."""
        states = tuple(prediction.states[number] for number in self.numbers)
        return Prediction(prediction.values[self.mine], prediction.converged[self.mine], (), states)

    def _driven(self, prediction: Prediction) -> FloatArray:
        """Size of what the recorded harmonics of the drive make of each harmonic, shape (rows,)."""
        pure = tuple(
            replace(t, levels=tuple(replace(level, drive_harmonics=()) for level in t.levels))
            if isinstance(t, PhaseResonanceTest) and any(level.drive_harmonics for level in t.levels)
            else t
            for t in self.tests
        )
        result = np.zeros(len(self.rows))
        change = -np.nan_to_num(self._moved(pure, self._start(prediction)))
        for mine in self._harmonics().values():
            result[mine] = float(np.linalg.norm(change[mine]))
        return result

    def _harmonics(self) -> dict[tuple[int, ...], list[int]]:
        """Rows of the real and imaginary part of each harmonic above the first."""
        rows = self.rows
        found: dict[tuple[int, ...], list[int]] = {}
        for row in np.flatnonzero(np.isin(rows.part, (Part.REAL, Part.IMAG)) & (rows.harmonic > 1)):
            key = (int(rows.test[row]), int(rows.level[row]), int(rows.channel[row]), int(rows.harmonic[row]))
            found.setdefault(key, []).append(int(row))
        return found

    def _late(self, base: FloatArray, tests: Sequence[int]) -> FloatArray:
        """Change of harmonics above the first by half a sample of delay, in the frame of the drive."""
        result = np.zeros(len(self.rows))
        for (number, _, _, order), mine in self._harmonics().items():
            rate = self.own[number].hold_hz
            if number in tests and np.isfinite(rate) and len(mine) == 2:
                values = {int(self.rows.part[row]): row for row in mine}
                angle = -np.pi * order * self.rows.frequency_hz[mine[0]] / rate
                real, imag = values[int(Part.REAL)], values[int(Part.IMAG)]
                result[real], result[imag] = -angle * base[imag], angle * base[real]
        return np.nan_to_num(result)

    def _slopes(self, base: Prediction) -> FloatArray:
        """Change of the rows over that of the phase at which each level truly stood."""
        moved = tuple(
            replace(t, levels=tuple(replace(level, phase_error=level.phase_error + _PHASE_STEP) for level in t.levels))
            if isinstance(t, PhaseResonanceTest)
            else t
            for t in self.tests
        )
        return np.nan_to_num(self._moved(moved, base) / _PHASE_STEP)

    def _moved(self, tests: tuple[Test, ...], base: Prediction) -> FloatArray:
        """Change of the rows under other conditions; tests that stay the same object are not predicted again."""
        others = [number for number, (test, own) in enumerate(zip(tests, self.tests, strict=True)) if test is not own]
        result = np.zeros(len(self.rows))
        if not others:
            return result
        mine = np.isin(self.rows.test, others)
        part = self.rows.take(mine)
        rows = replace(part, test=np.searchsorted(others, part.test))
        start = Prediction(base.values[mine], base.converged[mine], (), tuple(base.states[number] for number in others))
        forward = Forward([tests[number] for number in others], rows)
        result[mine] = forward.difference(forward.predict(self.rig, start).values, base.values[mine])
        return result

    def _step_rate(self) -> float:
        """Rate of the held drive whose images are part of the model, Hz."""
        return min(t.drive_hold_hz for t in self.tests if isinstance(t, RandomTest) and t.sampled_at is not None)

    def _tested(self) -> float:
        """Frequency at which the phase of a channel is stated: that of the locked windows, Hz."""
        locked = [number for number, test in enumerate(self.tests) if isinstance(test, PhaseResonanceTest)]
        mine = np.isin(self.rows.test, locked) & (self.rows.frequency_hz > 0.0)
        return float(np.median(self.rows.frequency_hz[mine])) if mine.any() else self._resonance()

    def _resonance(self) -> float:
        """First frequency of the model, Hz."""
        return ModelView.of(self.rig, self.tests[0].drive_point).frequencies_hz[0]

    def _voltage(self, base: Prediction) -> FloatArray:
        """Rows over the relative error of the recorded voltage: the drive was larger than recorded."""
        moved = tuple(
            replace(t, levels=tuple(replace(level, drive=level.drive * (1.0 + _DRIVE_STEP)) for level in t.levels))
            if isinstance(t, PhaseResonanceTest)
            else t
            for t in self.tests
        )
        result = self._moved(moved, base) / _DRIVE_STEP
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
                mine = np.flatnonzero((self.rows.test == number) & self._rows_of(channel))
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

    def _other_modes(self, base: Prediction) -> list[FloatArray]:
        """What modes that a modal model leaves out add to responses over a force or at held amplitudes.

        Those above the band add a flexibility that rises towards the first of them, those below it minus one over a
        mass (Ewins, Modal Testing, 2000, section 4.3): constants that nobody states, of either sign.
        """
        structure = self.rig.structure
        if not isinstance(structure, ModalSection) or structure.residual is not None:
            return []
        found = []
        resonance = self._resonance()
        for channel, own in self.channels.items():
            if own.quantity not in ORDER:
                continue  # only motions
            columns = np.zeros((4, len(self.rows)))
            for number, test in enumerate(self.tests):
                if not _is_over_force(test):
                    continue
                mine = np.flatnonzero((self.rows.test == number) & self._rows_of(channel))
                frequency = self.rows.frequency_hz[mine]
                static = self._flexibility(test, own)
                added = static * (2j * np.pi * frequency) ** ORDER[own.quantity]
                part = self.rows.part[mine]
                relative = np.isin(part, _FUNDAMENTAL)
                added[relative] /= self._between(test, number, mine, base)[relative]
                changed = np.where(np.isin(part, (Part.PHASE, Part.IMAG)), added.imag, added.real)
                share = frequency / np.max(frequency, initial=1.0)
                columns[:3, mine] = _ABOVE * changed * share ** np.array([[0.0], [2.0], [4.0]])
                columns[3, mine] = _BELOW * changed * (resonance / frequency) ** 2
            found += list(columns)
        return found

    def _flexibility(self, test: Test, channel: MeasuredChannel) -> float:
        """Displacement at a channel far below the first mode, m over the N of the force.

        Over the V of the drive where the test refers to the voltage, or the model has no force at the drive point.
        """
        view = ModelView.of(self.rig, test.drive_point)
        frequency = _STATIC * self._resonance()
        force = MeasuredChannel(f"f{test.drive_point}", Quantity.FORCE, test.drive_point, ideal=True)
        response, reference = view.responses((channel, force), np.array([frequency]))[:, 0]
        over = 1.0 if getattr(test, "reference", "") == "voltage" or not np.isfinite(reference) else abs(reference)
        return float(abs(response) / over / (2.0 * np.pi * frequency) ** ORDER[channel.quantity])

    def _between(self, test: Test, number: int, mine: IntArray, base: Prediction) -> ComplexArray:
        """Responses of rows that a small addition is compared with: measured ones, or between those and the model's.

        ln (1 + z) is z / √(1 + z) to the second order: of a linear test the geometric mean of both responses is taken,
        without the delay between them.
        """
        if isinstance(test, SteppedSineTest):
            return np.asarray(test.measured[self.rows.level[mine], self.rows.channel[mine]])
        difference = self.forward.difference(self.observations.values[self.mine], base.values)
        apart = self._logarithms(number, mine, difference)
        frequency = self.rows.frequency_hz[mine]
        apart -= 1j * frequency * float(frequency @ apart.imag) / max(float(frequency @ frequency), 1.0)
        apart[np.abs(apart.real) > _FAR] *= 2.0
        return np.exp(self._logarithms(number, mine, base.values) + 0.5 * apart)

    def _logarithms(self, number: int, mine: IntArray, values: FloatArray) -> ComplexArray:
        """Complex logarithms of the responses of rows, from those of magnitude and phase."""
        found = np.zeros(mine.size, dtype=np.complex128)
        place = self.rows.level * (int(np.max(self.rows.channel)) + 1) + self.rows.channel
        for part, factor in zip(_FUNDAMENTAL, (1.0, 1j), strict=True):
            of_part = np.flatnonzero((self.rows.test == number) & (self.rows.part == part))
            by_place = dict(zip(place[of_part], values[of_part], strict=True))
            found += factor * np.array([by_place.get(own, 0.0) for own in place[mine]])
        return np.nan_to_num(found)

    def _referred(self) -> list[int]:
        """Tests whose observables refer to the voltage."""
        return [
            number
            for number, test in enumerate(self.tests)
            if (isinstance(test, PhaseResonanceTest) and test.held == "voltage")
            or (isinstance(test, RandomTest) and test.reference == "voltage")
        ]

    def _images(self) -> tuple[ComplexArray, ...]:
        """What images of a held drive add to ln of each fundamental, (rows,) for each of the orders."""
        result = np.zeros((len(_IMAGE_ORDERS), len(self.rows)), dtype=np.complex128)
        for number in self._referred():
            test, chain = self.tests[number], self.own[number]
            channels = getattr(test, "channels", ())
            mine = np.flatnonzero(self._linear_rows(number))
            if not mine.size or not np.isfinite(chain.hold_hz) or not chain.images:
                continue
            view = ModelView.of(self.rig, test.drive_point)
            frequency = self.rows.frequency_hz[mine]
            plain = view.responses(channels, frequency)
            place = (self.rows.channel[mine], np.arange(mine.size))
            for k, orders in enumerate(_IMAGE_ORDERS):
                images = zero_order_images(view, channels, frequency, chain.hold_hz, orders)
                result[k, mine] = np.where(frequency < 0.5 * chain.hold_hz, images[place] / plain[place], 0.0)
        return tuple(np.nan_to_num(result))

    def _linear_rows(self, number: int) -> BoolArray:
        """Rows of a test that are the fundamental or a frequency response of a channel."""
        own = np.isin(self.rows.part, _FUNDAMENTAL) & (self.rows.channel >= 0) & (self.rows.test == number)
        return np.asarray(own)

    def _parts(self, values: ComplexArray) -> FloatArray:
        """Change of ln of a response as change of its magnitude and phase rows."""
        phase = self.rows.part == Part.PHASE
        return np.where(phase, values.imag, values.real)

    def _over_fundamental(self) -> list[tuple[int, IntArray]]:
        """Of each channel at each level, the row of its fundamental's magnitude, and its harmonics, divided by that."""
        rows, found = self.rows, []
        for row in np.flatnonzero(rows.part == Part.LOG_MAGNITUDE):
            if isinstance(self.tests[int(rows.test[row])], PhaseResonanceTest):
                same = (rows.test == rows.test[row]) & (rows.level == rows.level[row])
                same &= (rows.channel == rows.channel[row]) & np.isin(rows.part, (Part.REAL, Part.IMAG))
                found.append((int(row), np.flatnonzero(same)))
        return found

    def _hold(self, slopes: FloatArray, base: Prediction) -> list[FloatArray]:
        """A drive that is held over each sample: smaller, half a sample late, and with images.

        A sampler with a delay τ of its own turns the image of order m by 2π m f_h τ, any angle; so each has an
        amplitude and a phase of its own in every channel.
        """
        found = []
        commanded = [n for n in self._referred() if getattr(self.tests[n], "commanded", False)]
        recorded = [n for n in self._referred() if n not in commanded]
        # A voltage that filters smooth before it is recorded shows the hold as the responses do; what was commanded
        # does not.
        for tests in (commanded, recorded):
            direct = np.zeros(len(self.rows), dtype=np.complex128)
            for number in tests:
                rate = self.own[number].hold_hz
                mine = self._linear_rows(number)
                if np.isfinite(rate):
                    share = self.rows.frequency_hz[mine] / rate
                    direct[mine] = np.log(np.maximum(np.sinc(share), 1e-3)) - 1j * np.pi * share
            found.append(self._parts(direct) + self._late(base.values, tests))
        found.append(self._other_steps(base, rise=_RISE))
        found += self._known_images(base)
        harmonics = self._over_fundamental()
        for channel in self.channels:
            own = self._rows_of(channel)
            for images in self.images:
                for turned in (images, 1j * images):
                    changed = self._parts(turned) * own
                    for fundamental, above in harmonics:
                        changed[above] = -base.values[above] * changed[fundamental]
                    found.append(changed + slopes * self._turned(channel, turned))
        return found

    def _rows_of(self, channel: str) -> BoolArray:
        """Rows of a channel, in whatever test."""
        own = np.zeros(len(self.rows), dtype=bool)
        for number, test in enumerate(self.tests):
            names = [c.name for c in getattr(test, "channels", ())]
            if channel in names:
                own |= (self.rows.test == number) & (self.rows.channel == names.index(channel))
        return own

    def _other_steps(self, base: Prediction, **changes: Any) -> FloatArray:
        """Change of the rows if the steps of a held drive were others, where their images are part of the model."""
        moved = tuple(
            replace(test, **changes) if isinstance(test, RandomTest) and test.sampled_at is not None else test
            for test in self.tests
        )
        return np.nan_to_num(self._moved(moved, base))

    def _known_images(self, base: Prediction) -> list[FloatArray]:
        """What images that are part of the model may be off by, in each channel of each test the same share of them."""
        change = self._without_images(base)
        if not change.any():
            return []
        other = change[self._other_part()]
        turned = self.rows.part == Part.PHASE
        images = np.where(turned, other, change) + 1j * np.where(turned, change, other)
        return [
            _KNOWN_IMAGES * self._parts(part) * self._rows_of(channel) * (self.rows.test == number)
            for channel in self.channels
            for number, test in enumerate(self.tests)
            if isinstance(test, RandomTest) and test.sampled_at is not None
            for part in (images, 1j * images)
        ]

    def _bends(self) -> list[FloatArray]:
        """What delays of channels add to images that are part of the model, beyond what is in proportion to them.

        An image of order m turns by m times the delay's share of a sample: a bend that counts. For a Gaussian delay it
        goes with the square, of which the rms is √3.
        """
        found = []
        for number, test in enumerate(self.tests):
            if not isinstance(test, RandomTest) or test.sampled_at is None:
                continue
            mine = self.rows.test == number
            own = self.rows.take(mine)
            forward = Forward((test,), replace(own, test=np.zeros_like(own.test)))
            base = forward.predict(self.rig)
            for channel in test.channels:
                delay = self.own[number].of(channel.name).delay_s
                both = np.zeros(len(own))
                for turn in (-delay, delay):
                    moved = forward.predict(_edited(self.rig, channel, partial(_later, seconds=turn)), base)
                    both += forward.difference(moved.values, base.values)
                column = np.zeros(len(self.rows))
                column[mine] = 0.5 * math.sqrt(3.0) * np.nan_to_num(both)
                found.append(column)
        return found

    def _without_images(self, base: Prediction) -> FloatArray:
        """Change of the rows if images that are part of the model were not there, and the drive held all the same."""
        change = self._other_steps(base, sampled_at=None, drive_hold_hz=math.inf)
        for number, test in enumerate(self.tests):
            if not isinstance(test, RandomTest) or test.sampled_at is None:
                continue
            mine = self._linear_rows(number)
            share = self.rows.frequency_hz / test.drive_hold_hz
            held = np.log(np.abs(np.sinc(share) * np.sinc(share * test.rise)) + 1e-300)
            late = np.pi * share * (2.0 * test.sampled_at - 1.0)
            turned = self.rows.part == Part.PHASE
            change = change + mine * np.where(turned, late, held)
            change[mine & turned] = (change[mine & turned] + np.pi) % (2.0 * np.pi) - np.pi
        return change

    def _jumps(self, base: Prediction) -> FloatArray:
        """Change of the rows of channels that are sampled near the step of a held drive from before it to after it."""
        result = np.zeros(len(self.rows))
        for number, test in enumerate(self.tests):
            if not isinstance(test, RandomTest) or test.sampled_at is None:
                continue
            for k, channel in enumerate(test.channels):
                if not _near_step(test, channel.name):
                    continue
                moment = test.sampled_at + (test.late_s[k] * test.drive_hold_hz if test.late_s else 0.0)
                sides = []
                for side in (-0.5 * LEAST_RISE, 0.5 * LEAST_RISE):
                    there = test.sampled_at + round(moment) + side - moment
                    moved = tuple(
                        replace(test, sampled_at=there, rise=LEAST_RISE) if own is test else own for own in self.tests
                    )
                    sides.append(np.nan_to_num(self._moved(moved, base)))
                change = sides[1] - sides[0]
                turned = self.rows.part == Part.PHASE
                change -= turned * 2.0 * np.pi * self.rows.frequency_hz / test.drive_hold_hz * LEAST_RISE
                size = np.hypot(change, change[self._other_part()])
                mine = (self.rows.channel == k) & self._linear_rows(number)
                result[mine] = size[mine]
        return result

    def _other_part(self) -> IntArray:
        """Of each row that is a magnitude or phase, the row of the other of the two; of others the row itself."""
        rows, result = self.rows, np.arange(len(self.rows))
        pairs: dict[tuple[int, int, int, int, float], list[int]] = {}
        for row in np.flatnonzero(np.isin(rows.part, _FUNDAMENTAL)):
            key = (rows.test[row], rows.level[row], rows.channel[row], rows.harmonic[row], rows.frequency_hz[row])
            pairs.setdefault(key, []).append(int(row))
        for pair in pairs.values():
            result[pair] = pair[::-1]
        return result

    def _turned(self, channel: str, images: ComplexArray) -> FloatArray:
        """By how much the phase between force and response truly was off at each locked row, if images were in it."""
        result = np.zeros(len(self.rows))
        for number, test in enumerate(self.tests):
            if not isinstance(test, PhaseResonanceTest):
                continue
            force = next((c.name for c in test.channels if c.quantity is Quantity.FORCE), "")
            sign = (channel == test.response_channel) - (channel == force)
            mine = (self.rows.test == number) & self._rows_of(channel) & (self.rows.part == Part.PHASE)
            for level in np.unique(self.rows.level[mine]) if sign else ():
                angle = float(images[mine & (self.rows.level == level)][0].imag)
                result[(self.rows.test == number) & (self.rows.level == level)] = sign * angle
        return result

    def _aims(self) -> list[FloatArray]:
        """What the loop of each test held: it measured with a chain of its own."""
        found = []
        size = np.sum(np.abs(self.images), axis=0)
        for number, test in enumerate(self.tests):
            if isinstance(test, PhaseResonanceTest):
                mine = self.rows.test == number
                # One of the two chains may have filters that keep images out, and the other none.
                around = float(np.max(size[mine & (self.rows.part == Part.PHASE)], initial=0.0)) / math.sqrt(2.0)
                found.append(np.hypot(_AIM_STD, around) * (mine & (self.rows.part == Part.PHASE_ERROR)))
        return found

    def between_tests(self, scatter: FloatArray) -> FloatArray:
        """A random test is one more passage: magnitudes and phases of each channel scatter as a level's do, (m, r)."""
        found = [np.zeros(len(self.rows))]
        own = scatter[self.mine]
        # Lines of a sweep scatter within a passage.
        sweeps = [k for k, test in enumerate(self.tests) if isinstance(test, SteppedSineTest)]
        for number, test in enumerate(self.tests):
            for k, channel in enumerate(test.channels if isinstance(test, RandomTest) else ()):
                levels = self._rows_of(channel.name) & ~np.isin(self.rows.test, [number, *sweeps])
                for part in _FUNDAMENTAL:
                    size = float(np.max(own[levels & (self.rows.part == part)], initial=0.0))
                    mine = (self.rows.test == number) & (self.rows.channel == k) & (self.rows.part == part)
                    found.append(size * mine)
        return np.column_stack([self._full(column) for column in found])

    def floor(self, prediction: Prediction) -> FloatArray:
        """What is added to the floors of the rows, shape (m,)."""
        size = np.sum(np.abs(self.images), axis=0)
        # The model's own error up there is the same for all levels of a run.
        result = _IMAGE_FLOOR * size + _DRIVEN_FLOOR * self._driven(prediction)
        result[self.rows.part == Part.PHASE_ERROR] = _LOCK_STD
        for number, test in enumerate(self.tests):
            if isinstance(test, PhaseResonanceTest):
                result[(self.rows.test == number) & self._linear_rows(number)] *= _SAME_FOR_LEVELS
        result += np.minimum(_JUMP_SHARE * self._jumps(self._start(prediction)), _JUMP_FLOOR)
        for number, test in enumerate(self.tests):
            if isinstance(test, RandomTest):
                mine = self._linear_rows(number)
                result[mine] = np.hypot(result[mine], _FLAT)
        result += _KNOWN_IMAGES * np.abs(self._without_images(self._start(prediction)))
        # Near zeros of a response images are as large as the response: there ln(1 + z) is far from z.
        result += 0.5 * size**2
        # Of modes that are left out the directions hold to the second order.
        others = np.zeros(len(self.rows))
        for column in self._other_modes(self._start(prediction)):
            others += np.where(np.isin(self.rows.part, _FUNDAMENTAL), column, 0.0) ** 2
        result += others**1.5 / 24.0
        values = prediction.values[self.mine]
        for fundamental, over in self._over_fundamental():
            result[over] = np.hypot(result[over], np.abs(values[over]) * result[fundamental])
        for number, chain in enumerate(self.own):
            lines = (self.rows.test == number) & (self.rows.part == Part.LINE)
            for channel in np.unique(self.rows.channel[lines]):
                same = (self.rows.test == number) & (self.rows.channel == channel)
                sizes = self.observations.values[self.mine][same & (self.rows.part == Part.LOG_MAGNITUDE)]
                if sizes.size:
                    result[lines & same] = chain.mains * float(np.exp(sizes.max()))
        return self._full(result)


def _louder(sensor: SensorSection) -> SensorSection:
    return sensor.model_copy(update={"gain": sensor.gain * (1.0 + _GAIN_STEP)})


def _leading(sensor: SensorSection, corner_hz: float) -> SensorSection:
    return sensor.model_copy(update={"high_pass_hz": (sensor.high_pass_hz or 0.0) + corner_hz})


def _smoothed(sensor: SensorSection, time_s: float) -> SensorSection:
    corner = 1.0 / (2.0 * math.pi * time_s)
    return sensor.model_copy(update={"low_pass_hz": min(sensor.low_pass_hz or math.inf, corner)})


def _is_over_force(test: Test) -> bool:
    """Whether observables are responses over a force, or over what held its amplitude."""
    if isinstance(test, SteppedSineTest):
        return test.held != "response"
    return isinstance(test, RandomTest) and test.reference == "force"


def _near_step(test: Test, channel: str) -> bool:
    """Whether images are part of the model, and a channel is sampled about when the held drive moves on.

    No drive jumps at once: what is sampled at that moment sees something between.
    """
    if not isinstance(test, RandomTest) or test.sampled_at is None:
        return False
    names = [own.name for own in test.channels]
    if channel not in names:
        return False
    moment = test.sampled_at
    if test.late_s:
        moment += test.late_s[names.index(channel)] * test.drive_hold_hz
    return abs(moment - round(moment)) < _JUMP


def _later(sensor: SensorSection, seconds: float = _DELAY_STEP_S) -> SensorSection:
    return sensor.model_copy(update={"delay_s": sensor.delay_s + seconds})


def _edited(rig: Rig, channel: MeasuredChannel, change: Callable[[SensorSection], SensorSection]) -> Rig:
    """The rig with the sensor of one channel changed; where it has none, an ideal one is meant."""
    sensors = list(rig.sensors)
    if all(rig.sensor_channel(s) != channel.name for s in sensors):
        place: Any = "drive" if channel.quantity is Quantity.FORCE else channel.point
        values = {"quantity": channel.quantity.name.lower(), "point": place, "channel": channel.name}
        sensors.append(SensorSection.model_validate(values))
    changed = [change(s) if rig.sensor_channel(s) == channel.name else s for s in sensors]
    return rig.model_copy(update={"sensors": changed})
