"""Directions in which the measuring chain of imported tests moves the observables, see shared_errors.py."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from nmt_core.blocks import FloatArray
from nmt_diagnose.evidence.conditions import PhaseResonanceTest, RandomTest
from nmt_diagnose.evidence.drive_hold import zero_order_images
from nmt_diagnose.evidence.measuring_chain import MeasuringChain
from nmt_diagnose.evidence.model_view import ModelView
from nmt_diagnose.evidence.observables import Evidence, Part
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.shared_errors import SharedErrors
from nmt_diagnose.twin.forward import Forward, Prediction
from nmt_rig.rig import Rig, SensorSection

_GAIN_STEP, _DELAY_STEP_S, _DRIVE_STEP = 1e-3, 1e-6, 1e-3
# What the model's response far above its modes may be off by: as a whole, and from line to line.
_IMAGE_STD, _IMAGE_FLOOR = 0.3, 0.1
_FUNDAMENTAL = (Part.LOG_MAGNITUDE, Part.PHASE)


def with_chain_errors(problem: Problem, rig: Rig, prediction: Prediction) -> Problem:
    """The problem with the tolerances of its tests' measuring chains as part of the noise; itself without any.

    Args:
        problem: evidence and model.
        rig: the model as given.
        prediction: its prediction of the evidence.
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
    floor = np.hypot(evidence.floor, builder.floor())
    problem = replace(problem, evidence=replace(evidence, floor=floor))
    columns = np.nan_to_num(builder.columns(prediction), posinf=0.0, neginf=0.0)
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
        self.own = tuple(chains[number] for number in self.numbers)
        self.images = self._images()

    def _full(self, values: FloatArray) -> FloatArray:
        result = np.zeros(len(self.evidence.rows))
        result[self.mine] = values
        return result

    def columns(self, prediction: Prediction) -> FloatArray:
        """What one standard deviation of each error adds to the observables, shape (m, r)."""
        forward = Forward(self.tests, self.rows)
        start = Prediction(
            prediction.values[self.mine],
            prediction.converged[self.mine],
            (),
            tuple(prediction.states[number] for number in self.numbers),
        )
        # Measured from a solution of the same accuracy.
        base = forward.predict(self.rig, start)

        def change(rig: Rig, step: float) -> FloatArray:
            return forward.difference(forward.predict(rig, base).values, base.values) / step

        found: list[FloatArray] = []
        omega = 2.0 * np.pi * self.rows.frequency_hz
        common = np.zeros(len(self.rows))
        for channel in sorted({c.name for test in self.tests for c in getattr(test, "channels", ())}):
            tolerance = next((chain.of(channel) for chain in self.own if channel in chain.channels), self.own[0].of(""))
            gain = change(_edited(self.rig, channel, _louder), _GAIN_STEP)
            delay = change(_edited(self.rig, channel, _later), _DELAY_STEP_S)
            common += delay
            found += [tolerance.gain * gain, tolerance.delay_s * delay, tolerance.phase * delay / omega]
        found.append(max(chain.shared_delay_s for chain in self.own) * common)
        found.append(max(chain.voltage_gain for chain in self.own) * self._voltage(base))
        found += self._hold()
        return np.column_stack([self._full(column) for column in found])

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

    def _images(self) -> FloatArray:
        """What images of a held drive add to ln of each fundamental, complex, shape (rows,)."""
        result = np.zeros(len(self.rows), dtype=np.complex128)
        for number in self._referred():
            test, chain = self.tests[number], self.own[number]
            channels = getattr(test, "channels", ())
            mine = np.flatnonzero((self.rows.test == number) & self._linear_rows(number))
            if not mine.size or not np.isfinite(chain.hold_hz):
                continue
            view = ModelView.of(self.rig, test.drive_point)
            frequency = self.rows.frequency_hz[mine]
            inside = frequency < 0.5 * chain.hold_hz
            images = zero_order_images(view, channels, frequency, chain.hold_hz)
            plain = view.responses(channels, frequency)
            place = (self.rows.channel[mine], np.arange(mine.size))
            result[mine] = np.where(inside, images[place] / plain[place], 0.0)
        return np.nan_to_num(result)

    def _linear_rows(self, number: int) -> FloatArray:
        """Rows of a test that are the fundamental or a frequency response of a channel."""
        own = np.isin(self.rows.part, _FUNDAMENTAL) & (self.rows.channel >= 0) & (self.rows.test == number)
        return np.asarray(own)

    def _parts(self, values: FloatArray) -> FloatArray:
        """Change of ln of a response as change of its magnitude and phase rows."""
        phase = self.rows.part == Part.PHASE
        return np.where(phase, values.imag, values.real)

    def _hold(self) -> list[FloatArray]:
        """A drive that is held over each sample: smaller, half a sample late, and with images."""
        direct = np.zeros(len(self.rows), dtype=np.complex128)
        for number in self._referred():
            rate = self.own[number].hold_hz
            mine = self._linear_rows(number)
            if np.isfinite(rate):
                share = self.rows.frequency_hz[mine] / rate
                direct[mine] = np.log(np.maximum(np.sinc(share), 1e-3)) - 1j * np.pi * share
        found = [self._parts(direct + self.images)]
        for channel in sorted({c.name for test in self.tests for c in getattr(test, "channels", ())}):
            own = np.zeros(len(self.rows), dtype=bool)
            for number, test in enumerate(self.tests):
                names = [c.name for c in getattr(test, "channels", ())]
                if channel in names:
                    own |= (self.rows.test == number) & (self.rows.channel == names.index(channel))
            found += [_IMAGE_STD * self._parts(turn * self.images) * own for turn in (1.0, 1j)]
        return found

    def floor(self) -> FloatArray:
        """What is added to the floors of the rows, shape (m,)."""
        result = _IMAGE_FLOOR * np.abs(self.images)
        for number, chain in enumerate(self.own):
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
