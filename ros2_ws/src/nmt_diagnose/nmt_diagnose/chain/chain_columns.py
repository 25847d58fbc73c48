"""The measuring chain as parameters: what a healthy laboratory's channels, converters and loop may be off by.

Delays that all sensors of a kind share are large: they turn the phase at which a loop truly stood, and amplitudes near
resonance go with the square of that. They are parameters of the rig like its own. Everything else is small and acts in
proportion: one column each, what a standard deviation of it adds to the observables. Columns need no new solution of
the model for other values, and are the same for windows, random tests, tables, decays and records.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from nmt_core.tolerances import TOLERANCES
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.chain.chain_tests import (
    DELAY_STEP_S,
    PHASE_STEP,
    ChainTests,
    edited,
    later,
    with_phase_step,
)
from nmt_diagnose.chain.coupled_modes import CoupledModes
from nmt_diagnose.chain.form_errors import form_errors
from nmt_diagnose.effects.calibration import CalibrationParameter
from nmt_diagnose.effects.location import LocationKind
from nmt_diagnose.measurements.measurement import (
    LockedLevel,
    Measurement,
    Observations,
    holds_amplitude,
    is_broad_band,
    locked_levels,
    with_levels,
)
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import FUNDAMENTAL, Part
from nmt_diagnose.prediction.forward import Forward, Prediction
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig, SensorSection

_PIEZOELECTRIC = (Quantity.FORCE, Quantity.ACCELERATION)  # sensors that pass no constants: their phase leads
_IMAGE = "image"
_ADDED = (_IMAGE, CoupledModes.__name__)
_OF_A_TEST = ("start ", "settling ", "phase of ", "noise of ")  # as well known as the test's own samples tell them
# Orders of images that are followed, the nearest first; those beyond them are one constant for each channel.
_IMAGE_ORDERS = (-1, 1, -2, 2)
_GAIN_STEP, _LEAD_STEP, _CLOCK_STEP, _SHIFT_STEP = 1e-3, 1e-3, 1e-5, 1e-6


@dataclass(frozen=True)
class SharedDelay(CalibrationParameter):
    """Delay that all sensors of a kind share against the drive; a parameter of the rig, θ of prior N(0, 1).

    Attributes:
        quantity: kind of the sensors.
    """

    quantity: Quantity = Quantity.UNKNOWN

    @classmethod
    def of(cls, quantity: Quantity, std: float) -> SharedDelay:
        """Delay of a kind of sensors, prior standard deviation in s."""
        name = f"chain.delay.{quantity.name.lower()}"
        place: LocationKind = "force_sensor" if quantity is Quantity.FORCE else "response_sensor"
        return cls(name, "s", (), std, place, 0.0, quantity=quantity)

    def at(self, theta: float) -> float:
        """Delay at θ, s."""
        return self.std * theta

    def moved(self, rig: Rig, before: float, theta: float) -> Rig:
        """Rig with the sensors of the kind later by the difference."""
        if theta == before:
            return rig
        kind = self.quantity.name.lower()
        sensors = [later(s, self.at(theta - before)) if s.quantity == kind else s for s in rig.sensors]
        return rig.model_copy(update={"sensors": sensors})


@dataclass(frozen=True)
class Chain:
    """Linear part of the measuring chain.

    Attributes:
        names: of the errors.
        columns: what a standard deviation of each adds to the observables, shape (m, r).
        added: whether it is added to what was measured, in proportion to that; else to what the model predicts, (r,).
    """

    names: tuple[str, ...]
    columns: FloatArray
    added: BoolArray


def is_tolerance(name: str) -> bool:
    """Whether an error of the chain has a prior before a test."""
    return not name.startswith(_OF_A_TEST)


def shared_delays(observations: Observations, rig: Rig) -> tuple[SharedDelay, ...]:
    """Delays of the kinds of sensors that refer to a voltage, or to the input of a record; none of the bench's own."""
    found: dict[Quantity, float] = {}
    for test, chain in zip(observations.tests, observations.chains, strict=False):
        driven = test.over_voltage or test.locked is not None or test.record is not None
        if chain is None or not driven:
            continue
        for channel in test.channels:
            if channel.quantity in (*MOTIONS, Quantity.FORCE):
                found[channel.quantity] = chain.shared_delay_s
    kinds = {sensor.quantity for sensor in rig.sensors}
    return tuple(SharedDelay.of(delay, std) for delay, std in found.items() if delay.name.lower() in kinds)


def linear_chain(observations: Observations, rig: Rig, prediction: Prediction) -> Chain:
    """Columns of all errors of the measuring chains about a solution; levels without a solution add nothing.

    Args:
        observations: the real side.
        rig: an explanation of it.
        prediction: of that explanation.
    """
    chains = {
        number: chain
        for number, chain in enumerate(observations.chains)
        if chain is not None and not observations.tests[number].reduced
    }
    linear = {number: chain for number, chain in chains.items() if is_linear(observations.tests[number])}
    found = ChainBuilder(observations, rig, prediction, linear).found() if linear else {}
    found |= form_errors(ChainTests(observations, rig, chains), prediction) if chains else {}
    found.update(_unsettled(observations))
    found.update(_phase_at_lock(observations, rig, prediction))
    for name, column in record_errors(observations, rig).items():
        found[name] = found[name] + column if name in found else column
    found |= _own_delays(observations, rig, found)
    found = {name: np.nan_to_num(column, posinf=0.0, neginf=0.0) for name, column in found.items()}
    information = {name: float(np.sum((column / observations.sigma) ** 2)) for name, column in found.items()}
    kept = [name for name in found if information[name] > THRESHOLDS.misfit.least_chain_error]
    columns = np.column_stack([found[name] for name in kept]) if kept else np.zeros((len(observations.rows), 0))
    return Chain(tuple(kept), columns, np.array([name.startswith(_ADDED) for name in kept], dtype=bool))


def _own_delays(observations: Observations, rig: Rig, found: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Delays of the channels of a kind without what they have in common, which is the delay that the kind shares.

    That one is exact and these are of the first order: one against the other they would make a filter.
    """
    result: dict[str, FloatArray] = {}
    channels = {channel.name: channel.quantity for test in observations.tests for channel in test.channels}
    for shared in shared_delays(observations, rig):
        names = [f"delay {name}" for name, quantity in channels.items() if quantity is shared.quantity]
        names = [name for name in names if name in found]
        if len(names) > 1:
            common = sum(found[name] for name in names) / len(names)
            result |= {name: found[name] - common for name in names}
    return result


def _unsettled(observations: Observations) -> dict[str, FloatArray]:
    """Amplitudes of locked windows that had not settled, one error for each level."""
    rows, found = observations.rows, {}
    for number, test in enumerate(observations.tests):
        for position, level in enumerate(locked_levels([test])):
            if any(level.amplitude_leans):
                selected = (rows.test == number) & (rows.level == position) & (rows.part == Part.LOG_MAGNITUDE)
                selected &= rows.channel >= 0
                column = np.zeros(len(rows))
                column[selected] = np.array(level.amplitude_leans)[rows.channel[selected]]
                found[f"settling {test.name} {position}"] = column
    return found


def _phase_at_lock(observations: Observations, rig: Rig, prediction: Prediction) -> dict[str, FloatArray]:
    """Phase at which the loop truly stood in each window, as far as the window determines it.

    The loop holds the phase that it measures: noise of force and response moves the excitation off phase resonance,
    and frequency, amplitudes and phases of all channels together.
    """
    if not locked_levels(observations.tests):
        return {}
    forward = Forward(observations.tests, observations.rows)
    base = forward.predict(rig, prediction)
    moved = with_levels(observations.tests, with_phase_step)
    slopes = forward.difference(Forward(moved, observations.rows).predict(rig, base).values, base.values) / PHASE_STEP
    rows, found = observations.rows, {}
    for number, test in enumerate(observations.tests):
        for position, level in enumerate(locked_levels([test])):
            selected = (rows.test == number) & (rows.level == position) & (rows.part != Part.PHASE_ERROR)
            found[f"phase of {test.name} {position}"] = np.where(selected, level.phase_error_std * slopes, 0.0)
    return found


def scale_columns(observations: Observations, rig: Rig, prediction: Prediction) -> FloatArray:
    """What a standard deviation of the gain of each channel whose amplitudes a test gives moves, (m, r).

    The model is solved at these amplitudes. A gain that is off by 1 % makes a cubic stiffness off by 2 %, and no
    observable shows it: it is an error that is considered, not one that is fitted (Schmidt, Adv. Control Syst. 3
    (1966) 293). Decays have it among the chain's columns, where the other tests tell it too.
    """
    found: dict[str, FloatArray] = {}
    for number, test in enumerate(observations.tests):
        chain = observations.chains[number] if number < len(observations.chains) else None
        state = prediction.states[number]
        larger, channel = test.larger(_GAIN_STEP), test.given_channel
        if larger is None or channel is None or state is None or (chain is None and not test.reduced):
            continue
        gain = TOLERANCES.amplitude_scale if chain is None else chain.of(channel.name).gain
        selected = observations.rows.test == number
        rows = observations.rows.take(selected)
        rows = replace(rows, test=np.zeros_like(rows.test))
        start = Prediction(prediction.values[selected], prediction.converged[selected], (), (state,))
        plain = Forward((test,), rows)
        base = plain.predict(rig, start)
        moved = Forward((larger,), rows).predict(rig, base)
        column = found.setdefault(f"scale of {channel.name}", np.zeros(len(observations.rows)))
        column[selected] = np.nan_to_num(gain * plain.difference(moved.values, base.values) / _GAIN_STEP)
    return np.column_stack([*found.values()]) if found else np.zeros((len(observations.rows), 0))


class ChainBuilder:
    """Columns for the tests that have measuring chains."""

    def __init__(
        self, observations: Observations, rig: Rig, prediction: Prediction, chains: dict[int, MeasuringChain]
    ) -> None:
        self.tests = ChainTests(observations, rig, chains)
        self.rows, self.rig = self.tests.rows, self.tests.rig
        # Differences are taken from a solution of the same accuracy.
        self.base = self.tests.forward.predict(self.rig, self.tests.start(prediction))
        self.slopes = self.tests.slopes(self.base)

    def found(self) -> dict[str, FloatArray]:
        """All columns by name, of all rows."""
        found = self._channels() | self._clock() | self._voltage() | self._hold() | self._images()
        found |= self.aims() | self._harmonics() | self._sweeps()
        return {name: self.tests.full(column) for name, column in found.items()}

    def _changed(self, rig: Rig, step: float) -> FloatArray:
        """Rows over a change of the rig; responses at held amplitudes have columns of their own."""
        forward = self.tests.forward
        moved = forward.difference(forward.predict(rig, self.base).values, self.base.values) / step
        return np.where(self._where(holds_amplitude), 0.0, moved)

    def _where(self, which: Callable[[Measurement], bool]) -> BoolArray:
        """Rows of the tests that are asked for."""
        numbers = [number for number, test in enumerate(self.tests.tests) if which(test)]
        return np.isin(self.rows.test, numbers)

    def _on_fundamentals(self, column: FloatArray) -> FloatArray:
        """A column of windows and random tests on magnitudes and phases of fundamentals and lines alone."""
        fundamentals = np.isin(self.rows.part, FUNDAMENTAL) & ~self._where(holds_amplitude)
        return np.where(fundamentals, column, 0.0)

    def _clock(self) -> dict[str, FloatArray]:
        moved = self.rig.model_copy(update={"clock_error": self.rig.clock_error + _CLOCK_STEP})
        return {"clock": max(chain.clock for chain in self.tests.measuring_chains) * self._changed(moved, _CLOCK_STEP)}

    def _channels(self) -> dict[str, FloatArray]:
        """Gain, delay and lead of each channel."""
        found: dict[str, FloatArray] = {}
        for name, channel in self.tests.channels.items():
            tolerance = next(
                (c.of(name) for c in self.tests.measuring_chains if name in c.channels),
                self.tests.measuring_chains[0].of(""),
            )
            louder = edited(self.rig, channel, _louder)
            found[f"gain {name}"] = tolerance.gain * self._changed(louder, _GAIN_STEP)
            delayed = edited(self.rig, channel, later)
            found[f"delay {name}"] = tolerance.delay_s * self._changed(delayed, DELAY_STEP_S)
            turned = 1j * self.tests.rows_of(name).astype(np.complex128)
            found[f"phase {name}"] = tolerance.phase * (
                self._on_fundamentals(self.tests.parts(turned)) + self.slopes * self._turned(name, turned)
            )
            if channel.quantity in _PIEZOELECTRIC:
                corner = _LEAD_STEP * self.tests.tested()
                leading = edited(self.rig, channel, partial(_leading, corner_hz=corner))
                found[f"lead {name}"] = tolerance.phase * self._changed(leading, _LEAD_STEP)
        return found | self._of_responses()

    def _of_responses(self) -> dict[str, FloatArray]:
        """Errors that the responses of single tests have."""
        found: dict[str, FloatArray] = {}
        for number, test in enumerate(self.tests.tests):
            if test.lines is None:
                continue
            rows = np.flatnonzero(self.tests.linear_rows(number))
            errors = test.lines.errors(self.rows.take(rows), self.tests.measuring_chains[number])
            for name, column in errors.items():
                found.setdefault(name, np.zeros(len(self.rows)))[rows] = column
        return found

    def _voltage(self) -> dict[str, FloatArray]:
        """Gain of the drive's voltage, recorded or commanded."""
        size = max(chain.voltage_gain for chain in self.tests.measuring_chains)
        moved = with_levels(self.tests.tests, _driven_more)
        both = self.tests.moved(moved, self.base) / _GAIN_STEP
        recorded = np.zeros(len(self.rows))
        commanded = any(_is_commanded(test) for test in self.tests.tests)
        for number, test in enumerate(self.tests.tests):
            if is_broad_band(test) and test.over_voltage:
                recorded[(self.rows.test == number) & (self.rows.part == Part.LOG_MAGNITUDE)] = 1.0
        found = {"gain of the drive": size * (both + recorded)}
        return found | ({"gain of the recorded voltage": size * recorded} if commanded else {})

    def _hold(self) -> dict[str, FloatArray]:
        """Zero-order hold of the drive: it is smaller and half a sample late."""
        found = {}
        for commanded in (True, False):
            direct = np.zeros(len(self.rows), dtype=np.complex128)
            for number in self.tests.referred():
                rate = self.tests.measuring_chains[number].hold_hz
                if _is_commanded(self.tests.tests[number]) is commanded and math.isfinite(rate):
                    selected = self.tests.linear_rows(number)
                    share = self.rows.frequency_hz[selected] / rate
                    direct[selected] = np.log(np.maximum(np.sinc(share), 1e-3)) - 1j * np.pi * share
            late = self.tests.harmonics(np.zeros(len(self.rows)), direct.imag)
            found[f"hold of the {'commanded' if commanded else 'recorded'} drive"] = self.tests.parts(direct) + late
        return found

    def _images(self) -> dict[str, FloatArray]:
        """Images of a zero-order hold in channels without filters.

        The image of order m is sin(πx) e^{-iπx} A(m + x) e^{-2πi m u}/(π (m + x)), x the frequency over the rate, u the
        moment of sampling and A the model's response at that frequency, such as of a coil on its resonance; what the
        filters of a channel leave of each is a complex constant. The channel's own delay turns them as its response.
        """
        found: dict[str, FloatArray] = {}
        self._image_size = np.zeros(len(self.rows))
        for number in self.tests.referred():
            rate = self.tests.measuring_chains[number].hold_hz
            for name in self.tests.channels if math.isfinite(rate) else ():
                selected = np.flatnonzero(self.tests.linear_rows(number) & self.tests.rows_of(name))
                if not selected.size:
                    continue
                images = self._images_of(number, name, selected)
                self._image_size = np.maximum(self._image_size, np.sqrt(np.sum(np.abs(images) ** 2, axis=0)))
                for k, image in enumerate(images):
                    for part, turned in (("re", image), ("im", 1j * image)):
                        # Generators of two tests may hold at different rates.
                        key = f"{_IMAGE} {k} {part} {name} in {self.tests.tests[number].name}"
                        found[key] = self.tests.parts(turned) + self.slopes * self._turned(name, turned)
                        found[key] += self.tests.harmonics(-turned.real)
        return found

    def _images_of(self, number: int, name: str, selected: IntArray) -> ComplexArray:
        """Images over what was measured, of a standard deviation of each constant, (constants, rows)."""
        test, rate = self.tests.tests[number], self.tests.measuring_chains[number].hold_hz
        late = next((s.delay_s for s in self.rig.sensors if self.rig.sensor_channel(s) == name), 0.0)
        channel, view = self.tests.channels[name], ModelView.of(self.rig, test.drive_points)
        frequency = self.rows.frequency_hz[selected]
        share = frequency / rate
        turned = np.exp(-1j * np.pi * (share + 2.0 * frequency * late))
        image = np.where(frequency < 0.5 * rate, np.sin(np.pi * share) * turned / self._measured(number, selected), 0.0)
        images = np.zeros((len(_IMAGE_ORDERS) + 1, len(self.rows)), dtype=np.complex128)
        size = float(np.max(np.abs(view.responses([channel], rate * np.array([0.9, 1.1, 1.9, 2.1])))))
        images[-1, selected] = TOLERANCES.image_share * size * image
        for k, order in enumerate(_IMAGE_ORDERS):
            there = view.responses([channel], np.abs(order + share) * rate)[0]
            there = np.where(order + share < 0.0, np.conj(there), there)
            images[k, selected] = math.sqrt(0.5) * image * np.nan_to_num(there) / (np.pi * (order + share))
        return images

    def _measured(self, number: int, selected: Any) -> ComplexArray:
        """Fundamentals per volt as they were measured, by the other of magnitude and phase, shape of ``selected``."""
        values = self.tests.observations.values[self.tests.selected]
        other, turned = values[self.tests.other_part()], self.rows.part == Part.PHASE
        size, angle = np.where(turned, other, values), np.where(turned, values, other)
        result = np.exp(size[selected] + 1j * angle[selected])
        if self.tests.tests[number].locked is not None:
            result = result / self.rows.amplitude[selected]
        return np.asarray(result)

    def _turned(self, name: str, images: ComplexArray) -> FloatArray:
        """By how much the phase between force and response truly was off at each locked row, if images were in it."""
        result = np.zeros(len(self.rows))
        for number, test in enumerate(self.tests.tests):
            sign = 0 if test.locked is None else test.locked.turned_by(name)
            selected = (self.rows.test == number) & self.tests.rows_of(name) & (self.rows.part == Part.PHASE)
            for level in np.unique(self.rows.level[selected]) if sign else ():
                angle = float(images[selected & (self.rows.level == level)][0].imag)
                result[(self.rows.test == number) & (self.rows.level == level)] = sign * angle
        return result

    def aims(self) -> dict[str, FloatArray]:
        """What the loop of each test held, all levels alike: it measured with a chain of its own.

        One of the two chains may have filters that keep images out, and the other none.
        """
        found = {}
        for number, test in enumerate(self.tests.tests):
            if test.locked is not None:
                selected = self.rows.test == number
                size = float(np.max(self._image_size[selected & (self.rows.part == Part.PHASE)], initial=0.0))
                found[f"aim {test.name}"] = math.hypot(math.radians(TOLERANCES.loop_phase_deg), size) * (
                    selected & (self.rows.part == Part.PHASE_ERROR)
                )
        return found

    def _harmonics(self) -> dict[str, FloatArray]:
        """Harmonics of the drive beyond what was recorded of them."""
        found = {}
        for order in (2, 3):
            for part, share in (("re", 1.0), ("im", 1j)):
                moved = with_levels(self.tests.tests, partial(distorted, order=order, share=share))
                found[f"harmonic {order} of the drive {part}"] = self.tests.moved(moved, self.base)
        return found

    def _sweeps(self) -> dict[str, FloatArray]:
        """Shift of the resonance from test to test, as temperature makes it; locked windows have none."""
        found = {}
        for number, test in enumerate(self.tests.tests):
            if test.lines is not None:
                lower = test.lines.shifted(-_SHIFT_STEP)
                shifted = tuple(lower if other is test else other for other in self.tests.tests)
                slope = self.tests.moved(shifted, self.base) / _SHIFT_STEP
            else:
                frequencies = (self.rows.test == number) & (self.rows.part == Part.LOG_FREQUENCY)
                slope = (test.free * frequencies).astype(np.float64)
            if not slope.any():
                continue
            found[f"resonance in {test.name}"] = TOLERANCES.resonance_shift * slope
        return found


def is_linear(test: Measurement) -> bool:
    """Whether errors of its measuring chain act on magnitudes and phases, a column each."""
    return test.record is None and not test.reduced


def _is_commanded(test: Measurement) -> bool:
    return test.locked is not None and test.locked.commanded


def _driven_more(level: LockedLevel) -> LockedLevel:
    return replace(level, drive=level.drive * (1.0 + _GAIN_STEP))


def distorted(level: LockedLevel, order: int, share: complex) -> LockedLevel:
    """A level whose drives have a thousandth of ``share`` more of a harmonic."""
    terms = []
    for exciter in level.terms:
        several = [*exciter, *[0j] * max(0, order - len(exciter))]
        several[order - 1] += TOLERANCES.drive_harmonic * share * exciter[0]
        terms.append(tuple(several))
    return replace(level, terms=tuple(terms))


def _louder(sensor: SensorSection) -> SensorSection:
    return sensor.model_copy(update={"gain": sensor.gain * (1.0 + _GAIN_STEP)})


def _leading(sensor: SensorSection, corner_hz: float) -> SensorSection:
    return sensor.model_copy(update={"high_pass_hz": (sensor.high_pass_hz or 0.0) + corner_hz})


def record_errors(observations: Observations, rig: Rig) -> dict[str, FloatArray]:
    """What a standard deviation of each error adds to the observables, (m,) each, about the motion of a rig.

    Sensors of the bench's own simulator have neither zeros nor gains that are off. The zero of a sensor is one for all
    records, which it drifts about: it is small relative to a loud record and large relative to a quiet one.

    Args:
        observations: the real side.
        rig: an explanation of it.
    """
    rows, settings = observations.rows, PredictionSettings()
    cache = PartsCache(settings)
    found: dict[str, FloatArray] = {}
    by_sensor: dict[str, list[tuple[float, FloatArray]]] = {}
    chains = (*observations.chains, *[None] * len(observations.tests))
    for number, (test, chain) in enumerate(zip(observations.tests, chains, strict=False)):
        if test.record is None:
            continue
        selected = rows.test == number
        part = rows.take(selected)
        part = replace(part, test=np.zeros_like(part.test))
        errors, zeros = test.record.errors(part, rig, cache, settings, chain)
        for name, column in errors.items():
            found.setdefault(name, np.zeros(len(rows)))[selected] = column
            if name in zeros:
                by_sensor.setdefault(name.removesuffix(f" in {test.name}"), []).append((zeros[name], found[name]))
    for name, columns in by_sensor.items():
        largest = max(std for std, _ in columns)
        if len(columns) > 1:
            found[name] = np.sum([largest / std * column for std, column in columns if std > 0.0], axis=0)
    return found
