"""Directions in which the measuring chain of imported tests moves the observables, see shared_errors.py."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nmt_core.blocks import FloatArray, Quantity
from nmt_diagnose.evidence.conditions import PhaseResonanceTest, RandomTest
from nmt_diagnose.evidence.drive_hold import zero_order_images
from nmt_diagnose.evidence.measuring_chain import MeasuringChain
from nmt_diagnose.evidence.model_view import ModelView
from nmt_diagnose.evidence.observables import Evidence, Part
from nmt_diagnose.inference.problem import BoolArray, Problem
from nmt_diagnose.inference.shared_errors import SharedErrors
from nmt_diagnose.twin.forward import Forward, Prediction
from nmt_rig.rig import Rig, SensorSection

ComplexArray = NDArray[np.complex128]

_GAIN_STEP, _DELAY_STEP_S, _DRIVE_STEP = 1e-3, 1e-6, 1e-3
_PHASE_STEP = 1e-4
_IMAGE_ORDERS = ((-1,), (1,), (-2, 2, -3, 3, -4, 4))
# What the model's response far above its modes may be off by from line to line, and the share of it that differs from
# level to level.
_IMAGE_FLOOR, _SAME_FOR_LEVELS = 0.1, 0.2
# What the model's response to a harmonic of the drive may be off by, relative.
_DRIVEN_FLOOR = 0.03
_CLOCK_STEP = 1e-5
# What a loop may hold other than it was told, for all levels and for each, rad.
_AIM_STD, _LOCK_STD = math.radians(1.0), math.radians(0.5)
_FUNDAMENTAL = (Part.LOG_MAGNITUDE, Part.PHASE)


def with_chain_errors(problem: Problem, rig: Rig, prediction: Prediction, scatter: FloatArray | None = None) -> Problem:
    """The problem with the tolerances of its tests' measuring chains as part of the noise; itself without any.

    Args:
        problem: evidence and model.
        rig: the model as given.
        prediction: its prediction of the evidence.
        scatter: of each row from test to test, shape (m,), see scatter.py; None = none.
    """
    evidence = problem.evidence
    chains = {
        number: chain
        for number, chain in enumerate(evidence.chains)
        if chain is not None and isinstance(evidence.tests[number], PhaseResonanceTest | RandomTest)
    }
    if not chains:
        return problem
    builder = _Columns(evidence, rig, chains)
    floor = np.hypot(evidence.floor, builder.floor(prediction))
    if scatter is not None:
        floor = np.hypot(floor, scatter)
    problem = replace(problem, evidence=replace(evidence, floor=floor))
    columns = np.nan_to_num(builder.columns(prediction), posinf=0.0, neginf=0.0)
    if scatter is not None:
        columns = np.hstack([columns, builder.between_tests(scatter)])
    columns = columns[:, np.any(columns != 0.0, axis=0)]
    return replace(problem, shared=SharedErrors.of(problem.whitened(columns)))


class _Columns:
    """Directions for the tests of one piece of evidence; a sensor is the same in all of its tests."""

    def __init__(self, evidence: Evidence, rig: Rig, chains: dict[int, MeasuringChain]) -> None:
        self.evidence, self.rig, self.chains = evidence, rig, chains
        rows = evidence.rows
        self.mine = np.isin(rows.test, list(chains))
        # Records and decays cost much to predict and are not asked for.
        self.numbers = sorted(chains)
        renumbered = np.zeros(max(self.numbers) + 1, dtype=np.int64)
        renumbered[self.numbers] = np.arange(len(self.numbers))
        part = rows.take(self.mine)
        self.rows = replace(part, test=renumbered[part.test])
        self.tests = tuple(evidence.tests[number] for number in self.numbers)
        self.forward = Forward(self.tests, self.rows)
        self.own = tuple(chains[number] for number in self.numbers)
        self.channels = {
            c.name: c.quantity
            for test in self.tests
            for c in getattr(test, "channels", ())
            if c.quantity is not Quantity.VOLTAGE
        }
        self.images = self._images()

    def _full(self, values: FloatArray) -> FloatArray:
        result = np.zeros(len(self.evidence.rows))
        result[self.mine] = values
        return result

    def columns(self, prediction: Prediction) -> FloatArray:
        """What one standard deviation of each error adds to the observables, shape (m, r)."""
        forward = self.forward
        # Measured from a solution of the same accuracy.
        base = forward.predict(self.rig, self._start(prediction))

        def change(rig: Rig, step: float) -> FloatArray:
            return forward.difference(forward.predict(rig, base).values, base.values) / step

        found: list[FloatArray] = []
        omega = 2.0 * np.pi * self.rows.frequency_hz
        groups: dict[Quantity, FloatArray] = {}
        for channel in self.channels:
            tolerance = next((chain.of(channel) for chain in self.own if channel in chain.channels), self.own[0].of(""))
            gain = change(_edited(self.rig, channel, _louder), _GAIN_STEP)
            delay = change(_edited(self.rig, channel, _later), _DELAY_STEP_S)
            quantity = self.channels[channel]
            groups[quantity] = groups.get(quantity, np.zeros(len(self.rows))) + delay
            found += [tolerance.gain * gain, tolerance.delay_s * delay, tolerance.phase * delay / omega]
        # Sensors of one kind share their conditioners; all of them together may be late against the voltage.
        shared = max(chain.shared_delay_s for chain in self.own)
        found += [shared * group for group in (*groups.values(), np.sum(list(groups.values()), axis=0))]
        found.append(max(chain.voltage_gain for chain in self.own) * self._voltage(base))
        found += self._hold(self._slopes(base), self._late(base.values))
        clock = self.rig.model_copy(update={"clock_error": self.rig.clock_error + _CLOCK_STEP})
        found.append(max(chain.clock for chain in self.own) * change(clock, _CLOCK_STEP))
        found += self._aims()
        return np.column_stack([self._full(column) for column in found])

    def _start(self, prediction: Prediction) -> Prediction:
        """The part of a prediction of all evidence that belongs to these tests."""
        states = tuple(prediction.states[number] for number in self.numbers)
        return Prediction(prediction.values[self.mine], prediction.converged[self.mine], (), states)

    def _driven(self, prediction: Prediction) -> FloatArray:
        """Size of what the recorded harmonics of the drive make of each harmonic, shape (rows,)."""
        pure = tuple(
            replace(t, levels=tuple(replace(level, drive_harmonics=()) for level in t.levels))
            if isinstance(t, PhaseResonanceTest)
            else t
            for t in self.tests
        )
        result = np.zeros(len(self.rows))
        if pure == self.tests:
            return result
        start = self._start(prediction)
        without = Forward(pure, self.rows).predict(self.rig, start)
        change = np.nan_to_num(self.forward.difference(start.values, without.values))
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

    def _late(self, base: FloatArray) -> FloatArray:
        """Change of harmonics above the first by half a sample of delay, in the frame of the drive."""
        result = np.zeros(len(self.rows))
        for (number, _, _, order), mine in self._harmonics().items():
            rate = self.own[number].hold_hz
            if number in self._referred() and np.isfinite(rate) and len(mine) == 2:
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
        result = Forward(moved, self.rows).predict(self.rig, base)
        return np.nan_to_num(self.forward.difference(result.values, base.values) / _PHASE_STEP)

    def _voltage(self, base: Prediction) -> FloatArray:
        """Rows over the relative error of the recorded voltage: the drive was larger than recorded."""
        moved = tuple(
            replace(t, levels=tuple(replace(level, drive=level.drive * (1.0 + _DRIVE_STEP)) for level in t.levels))
            if isinstance(t, PhaseResonanceTest)
            else t
            for t in self.tests
        )
        forward = Forward(moved, self.rows)
        result = forward.difference(forward.predict(self.rig, base).values, base.values) / _DRIVE_STEP
        for number, test in enumerate(self.tests):
            if isinstance(test, RandomTest) and test.reference == "voltage":
                result[(self.rows.test == number) & (self.rows.part == Part.LOG_MAGNITUDE)] = 1.0
        return result

    def _referred(self) -> list[int]:
        """Tests whose observables refer to the voltage."""
        return [
            number
            for number, test in enumerate(self.tests)
            if (isinstance(test, PhaseResonanceTest) and test.held == "voltage")
            or (isinstance(test, RandomTest) and test.reference == "voltage")
        ]

    def _images(self) -> tuple[ComplexArray, ...]:
        """What images of a held drive add to ln of each fundamental, of orders −1, 1 and the rest, (rows,) each."""
        result = np.zeros((len(_IMAGE_ORDERS), len(self.rows)), dtype=np.complex128)
        for number in self._referred():
            test, chain = self.tests[number], self.own[number]
            channels = getattr(test, "channels", ())
            mine = np.flatnonzero(self._linear_rows(number))
            if not mine.size or not np.isfinite(chain.hold_hz):
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

    def _hold(self, slopes: FloatArray, late: FloatArray) -> list[FloatArray]:
        """A drive that is held over each sample: smaller, half a sample late, and with images.

        A sampler with a delay τ of its own turns the image of order m by 2π m f_h τ, any angle; so each has an
        amplitude and a phase of its own in every channel.
        """
        direct = np.zeros(len(self.rows), dtype=np.complex128)
        for number in self._referred():
            rate = self.own[number].hold_hz
            mine = self._linear_rows(number)
            if np.isfinite(rate):
                share = self.rows.frequency_hz[mine] / rate
                direct[mine] = np.log(np.maximum(np.sinc(share), 1e-3)) - 1j * np.pi * share
        found = [self._parts(direct) + late]
        for channel in self.channels:
            own = self._rows_of(channel)
            for images in self.images:
                found += [self._parts(t * images) * own + slopes * self._turned(channel, t * images) for t in (1, 1j)]
        return found

    def _rows_of(self, channel: str) -> BoolArray:
        """Rows of a channel, in whatever test."""
        own = np.zeros(len(self.rows), dtype=bool)
        for number, test in enumerate(self.tests):
            names = [c.name for c in getattr(test, "channels", ())]
            if channel in names:
                own |= (self.rows.test == number) & (self.rows.channel == names.index(channel))
        return own

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
                around = 2.0 * float(np.max(size[mine], initial=0.0))
                found.append(np.hypot(_AIM_STD, around) * (mine & (self.rows.part == Part.PHASE_ERROR)))
        return found

    def between_tests(self, scatter: FloatArray) -> FloatArray:
        """A random test is one more passage: magnitudes and phases of each channel scatter as a level's do, (m, r)."""
        found = [np.zeros(len(self.rows))]
        own = scatter[self.mine]
        for number, test in enumerate(self.tests):
            for k, channel in enumerate(test.channels if isinstance(test, RandomTest) else ()):
                levels = self._rows_of(channel.name) & (self.rows.test != number)
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
        for number, chain in enumerate(self.own):
            if isinstance(self.tests[number], PhaseResonanceTest):
                result[(self.rows.test == number) & self._linear_rows(number)] *= _SAME_FOR_LEVELS
            lines = (self.rows.test == number) & (self.rows.part == Part.LINE)
            for channel in np.unique(self.rows.channel[lines]):
                same = (self.rows.test == number) & (self.rows.channel == channel)
                sizes = self.evidence.values[self.mine][same & (self.rows.part == Part.LOG_MAGNITUDE)]
                if sizes.size:
                    result[lines & same] = chain.mains * float(np.exp(sizes.max()))
        return self._full(result)


def _louder(sensor: SensorSection) -> SensorSection:
    return sensor.model_copy(update={"gain": sensor.gain * (1.0 + _GAIN_STEP)})


def _later(sensor: SensorSection) -> SensorSection:
    return sensor.model_copy(update={"delay_s": sensor.delay_s + _DELAY_STEP_S})


def _edited(rig: Rig, channel: str, change: Callable[[SensorSection], SensorSection]) -> Rig:
    """The rig with the sensor of one channel changed."""
    sensors = [change(s) if rig.sensor_channel(s) == channel else s for s in rig.sensors]
    return rig.model_copy(update={"sensors": sensors})
