"""Tests whose measuring chains have tolerances: their rows, and how other conditions move them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import LockedLevel, Measurement, Observations, with_levels
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.model_view import RIGID, ModelView
from nmt_diagnose.observations.observables import FUNDAMENTAL, HARMONICS, Part
from nmt_diagnose.prediction.forward import Forward, Prediction
from nmt_rig.rig import Rig, SensorSection

DELAY_STEP_S = 1e-6
PHASE_STEP = 1e-4


class ChainTests:
    """The tests of a set of observations that have measuring chains; a sensor is the same in all of them.

    Args:
        observations: the real side.
        rig: the model.
        chains: measuring chains, by number of the test.

    Attributes:
        selected: rows of these tests among all, shape (m,).
        numbers: of the tests among all.
        rows: of these tests, which are numbered anew, (n,).
        tests: the tests.
        measuring_chains: of the tests.
        forward: predicts their rows.
        channels: their sensors by name; the drive's voltage is none.
    """

    def __init__(self, observations: Observations, rig: Rig, chains: dict[int, MeasuringChain]) -> None:
        self.observations, self.rig = observations, rig
        rows = observations.rows
        self.selected = np.isin(rows.test, list(chains))
        self.numbers = sorted(chains)
        renumbered = np.zeros(max(self.numbers) + 1, dtype=np.int64)
        renumbered[self.numbers] = np.arange(len(self.numbers))
        part = rows.take(self.selected)
        self.rows = replace(part, test=renumbered[part.test])
        self.tests = tuple(observations.tests[number] for number in self.numbers)
        self.forward = Forward(self.tests, self.rows)
        self.measuring_chains = tuple(chains[number] for number in self.numbers)
        self.channels = {c.name: c for test in self.tests for c in test.channels if c.quantity is not Quantity.VOLTAGE}
        for test in self.tests:
            if test.lines is not None and (divisor := test.lines.divisor) is not None:
                self.channels.setdefault(divisor.name, divisor)

    def full(self, values: FloatArray) -> FloatArray:
        """Values of these rows among all, zero elsewhere, shape (m,)."""
        result = np.zeros(len(self.observations.rows))
        result[self.selected] = values
        return result

    def start(self, prediction: Prediction) -> Prediction:
        """The part of a prediction of all observations that belongs to these tests."""
        states = tuple(prediction.states[number] for number in self.numbers)
        return Prediction(prediction.values[self.selected], prediction.converged[self.selected], (), states)

    def moved(self, tests: tuple[Measurement, ...], base: Prediction) -> FloatArray:
        """Change of the rows under other conditions; tests that stay the same object are not predicted again."""
        others = [
            number for number, (test, before) in enumerate(zip(tests, self.tests, strict=True)) if test is not before
        ]
        result = np.zeros(len(self.rows))
        if not others:
            return result
        selected = np.isin(self.rows.test, others)
        part = self.rows.take(selected)
        rows = replace(part, test=np.searchsorted(others, part.test))
        start = Prediction(
            base.values[selected], base.converged[selected], (), tuple(base.states[number] for number in others)
        )
        forward = Forward([tests[number] for number in others], rows)
        result[selected] = forward.difference(forward.predict(self.rig, start).values, base.values[selected])
        return result

    def slopes(self, base: Prediction) -> FloatArray:
        """Change of the rows over that of the phase at which each level truly stood."""
        moved = with_levels(self.tests, with_phase_step)
        return np.nan_to_num(self.moved(moved, base) / PHASE_STEP)

    @cached_property
    def frequencies_hz(self) -> FloatArray:
        """Those of the rows, and the band of each record, Hz."""
        known = self.rows.frequency_hz[self.rows.frequency_hz > 0.0]
        bands = [test.record.band_hz for test in self.tests if test.record is not None]
        return np.concatenate([known, *bands])

    def rows_of(self, channel: str) -> BoolArray:
        """Rows of a channel, in whatever test."""
        selected = np.zeros(len(self.rows), dtype=bool)
        for number, test in enumerate(self.tests):
            names = [c.name for c in test.channels]
            if channel in names:
                selected |= (self.rows.test == number) & (self.rows.channel == names.index(channel))
        return selected

    def linear_rows(self, number: int) -> BoolArray:
        """Rows of a test that are the fundamental or a frequency response of a channel."""
        linear = np.isin(self.rows.part, FUNDAMENTAL) & (self.rows.channel >= 0) & (self.rows.test == number)
        return np.asarray(linear)

    def parts(self, values: ComplexArray) -> FloatArray:
        """Change of ln of a response as change of its magnitude and phase rows."""
        phase = self.rows.part == Part.PHASE
        return np.where(phase, values.imag, values.real)

    def harmonics(self, larger: FloatArray, turned: FloatArray | None = None) -> FloatArray:
        """Change of the harmonics of locked windows by changes of their fundamentals, to first order.

        Args:
            larger: relative change of each harmonic over the amplitude of the fundamental, at the row of that, (n,).
            turned: angle by which the fundamental turns, and a harmonic of order k by k times as much, rad, (n,).
        """
        rows, result = self.rows, np.zeros(len(self.rows))
        values = self.observations.values[self.selected]
        at, of, partner = self._harmonic_rows
        imaginary = rows.part[at] == Part.IMAG
        other = np.where(partner >= 0, values[partner], 0.0)
        harmonic = np.where(imaginary, other + 1j * values[at], values[at] + 1j * other)
        factor = larger[of] + 1j * (0.0 if turned is None else rows.harmonic[at] * turned[of])
        change = harmonic * factor
        result[at] = np.where(imaginary, change.imag, change.real)
        return result

    @cached_property
    def _harmonic_rows(self) -> tuple[IntArray, IntArray, IntArray]:
        """Rows of harmonics, that of the amplitude of the fundamental of each, and the other part's, −1 without."""
        rows = self.rows
        keys = list(zip(rows.test, rows.level, rows.channel, rows.harmonic, strict=True))
        found = {(*keys[row], int(rows.part[row])): int(row) for row in range(len(rows))}
        at, of, partner = [], [], []
        for row in np.flatnonzero(np.isin(rows.part, HARMONICS)):
            test, level, channel, order = keys[row]
            fundamental = found.get((test, level, channel, 1, int(Part.LOG_MAGNITUDE)), -1)
            if fundamental >= 0:
                at.append(int(row))
                of.append(fundamental)
                other = Part.IMAG if rows.part[row] == Part.REAL else Part.REAL
                partner.append(found.get((test, level, channel, order, int(other)), -1))
        return np.array(at, dtype=np.int64), np.array(of, dtype=np.int64), np.array(partner, dtype=np.int64)

    def other_part(self) -> IntArray:
        """Of each row that is a magnitude or phase, the row of the other of the two; of others the row itself."""
        rows, result = self.rows, np.arange(len(self.rows))
        pairs: dict[tuple[int, int, int, int, float], list[int]] = {}
        for row in np.flatnonzero(np.isin(rows.part, FUNDAMENTAL)):
            key = (rows.test[row], rows.level[row], rows.channel[row], rows.harmonic[row], rows.frequency_hz[row])
            pairs.setdefault(key, []).append(int(row))
        for pair in pairs.values():
            result[pair] = pair[::-1]
        return result

    def referred(self) -> list[int]:
        """Tests whose observables refer to the voltage."""
        return [number for number, test in enumerate(self.tests) if test.over_voltage]

    def tested(self) -> float:
        """Frequency at which the phase of a channel is stated: that of the locked windows, Hz."""
        locked = [number for number, test in enumerate(self.tests) if test.locked is not None]
        selected = np.isin(self.rows.test, locked) & (self.rows.frequency_hz > 0.0)
        return float(np.median(self.rows.frequency_hz[selected])) if selected.any() else self.resonance()

    def resonance(self) -> float:
        """First frequency of the model at which it strains, Hz: a free body moves at 0 Hz, too.

        Of one that never swings the middle of the rows', where they have any.
        """
        frequencies = ModelView.of(self.rig, self.tests[0].drive_points).frequencies_hz
        if not frequencies:
            known = self.rows.frequency_hz[self.rows.frequency_hz > 0.0]
            return float(np.median(known)) if known.size else 1.0
        return next((value for value in frequencies if value > RIGID * frequencies[-1]), frequencies[-1])


def with_phase_step(level: LockedLevel) -> LockedLevel:
    """The level with its phase off by `PHASE_STEP`."""
    return replace(level, phase_error=level.phase_error + PHASE_STEP)


def edited(rig: Rig, channel: MeasuredChannel, change: Callable[[SensorSection], SensorSection]) -> Rig:
    """The rig with the sensor of one channel changed; where it has none, an ideal one is meant."""
    sensors = list(rig.sensors)
    if all(rig.sensor_channel(s) != channel.name for s in sensors):
        place: Any = "drive" if channel.quantity is Quantity.FORCE else channel.point
        # Its name is that of a recording, which a rig file need not allow.
        quantity: Any = channel.quantity.name.lower()
        sensors.append(SensorSection.model_construct(quantity=quantity, point=place, channel=channel.name))
    changed = [change(s) if rig.sensor_channel(s) == channel.name else s for s in sensors]
    return rig.model_copy(update={"sensors": changed})


def later(sensor: SensorSection, seconds: float = DELAY_STEP_S) -> SensorSection:
    """The sensor with more delay, s."""
    return sensor.model_copy(update={"delay_s": sensor.delay_s + seconds})
