"""What a level does besides having an amplitude: kind of test and what that kind needs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.messages.secondary_resonance import resonance_of
from nmt_core.vocabulary import AUTOMATIC, ControlKind, HarmonicsTarget, TestKind

_LONGEST = 1e6  # s

# Which fields a kind of test has; the others must be zero.
_FIELDS: dict[TestKind, tuple[str, ...]] = {
    TestKind.PHASE_RESONANCE: ("harmonics_control", "harmonics_target"),
    TestKind.RANDOM: ("band_low_hz", "band_high_hz", "duration"),
    TestKind.SWEEP: ("rate_hz_s", "frequency_end_hz"),
    TestKind.STEPPED_SINE: (),
    TestKind.RING_DOWN: ("duration", "harmonics_control", "harmonics_target"),
    TestKind.SECONDARY_RESONANCE: ("response_order", "force_order", "release"),
    TestKind.SELF_EXCITED: ("duration",),
}

MOST_HARMONICS = 50
"""Highest harmonic that can be asked for."""

PEAK_FACTOR = 4.0
"""Peak by rms that a random drive is taken to reach; Gaussian noise passes it once in some 16,000 values."""


@dataclass(frozen=True, slots=True)
class Excitation:
    """Kind of test and its settings, the same for every level of a run; as in ``nmt_msgs/RunLevels``.

    Attributes:
        test: kind of test.
        band_low_hz, band_high_hz: RANDOM: band of the noise, Hz.
        rate_hz_s: SWEEP: Hz/s, sign = direction.
        frequency_end_hz: SWEEP: Hz at which it ends.
        duration: s; RANDOM: length of the window, RING_DOWN: of the free decay in it, SELF_EXCITED: longest time that a
            free motion is waited for, and that damping lasts at the end.
        harmonics_control: harmonics 2 to this one of the force are controlled; 0 = none, 1 = as many as can be.
        harmonics_target: what they are brought to, see :class:`~nmt_core.vocabulary.HarmonicsTarget`.
        response_order, force_order: SECONDARY_RESONANCE: k and ν, see :mod:`nmt_core.messages.secondary_resonance`.
        release: SECONDARY_RESONANCE: response amplitude that a release onto an isola begins with; 0 = none.
    """

    test: TestKind = TestKind.PHASE_RESONANCE
    band_low_hz: float = 0.0
    band_high_hz: float = 0.0
    rate_hz_s: float = 0.0
    frequency_end_hz: float = 0.0
    duration: float = 0.0
    harmonics_control: int = 0
    harmonics_target: int = 0
    response_order: int = 0
    force_order: int = 0
    release: float = 0.0

    @classmethod
    def from_goal(cls, goal: Mapping[str, Any]) -> Excitation:
        """Read from the fields of an action goal; what is not there has its default.

        Raises:
            BenchError: no such kind of test.
        """
        kinds: dict[str, Any] = {item.name: type(item.default) for item in fields(cls) if item.name != "test"}
        values: dict[str, Any] = {name: kind(goal[name]) for name, kind in kinds.items() if name in goal}
        return cls(TestKind.of(int(goal["test"])), **values)

    @property
    def level_fields(self) -> dict[str, Any]:
        """All fields by name: what goes into levels."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @property
    def values(self) -> Mapping[str, float | int]:
        """All fields by name, the kind of test as a number: what goes into the action's goal."""
        return self.level_fields | {"test": int(self.test)}

    def check(self, frequencies_hz: Sequence[float], levels: int, control: int, sample_rate: float) -> None:
        """Refuse what a bench with this sample rate cannot do.

        Args:
            frequencies_hz: one per level, or none.
            levels: number of levels.
            control: what the levels are, as in ``nmt_msgs/Level``.
            sample_rate: Hz.

        Raises:
            BenchError: a setting is missing, out of range, or not of this kind of test.
        """
        label, nyquist = self.test.label.replace("_", " "), 0.5 * sample_rate
        if self.test not in _FIELDS:
            raise BenchError(f"The bench does no {label} test; choose another kind of test.")
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name == "test":
                continue
            if not math.isfinite(value):
                raise BenchError(f"The {label} test's {item.name} must be finite, got {value}.")
            if value != 0.0 and item.name not in _FIELDS[self.test]:
                raise BenchError(f"A {label} test has no {item.name}; leave it out or choose another kind of test.")
        self._check_frequencies(frequencies_hz, levels, nyquist)
        self._check_harmonics()
        if self.test.is_noise:
            if not 0.0 < self.band_low_hz < self.band_high_hz < nyquist:
                raise BenchError(
                    f"The random band of {self.band_low_hz:g} to {self.band_high_hz:g} Hz must lie between 0 and half "
                    f"the sample rate, {nyquist:g} Hz, the lower edge first."
                )
            if control != ControlKind.VOLTAGE:
                raise BenchError("A random test has levels of voltage (V rms) only; leave the control at voltage.")
        if self.test is TestKind.SELF_EXCITED and control != ControlKind.RESPONSE:
            raise BenchError("A self-excited test has levels of the response; use --control response.")
        if "duration" in _FIELDS[self.test] and not 0.0 < self.duration < _LONGEST:
            raise BenchError(
                f"A {label} test needs a duration that is positive and below 1e6 s, got {self.duration:g}."
            )
        if self.test is TestKind.SWEEP:
            self._check_sweep(frequencies_hz, nyquist)
        if self.test is TestKind.SECONDARY_RESONANCE:
            self._check_resonance(control)

    def _check_resonance(self, control: int) -> None:
        resonance = resonance_of(self.response_order, self.force_order)
        if control == ControlKind.RESPONSE:
            raise BenchError("In a secondary resonance levels are voltages or forces; choose control voltage or force.")
        if self.release < 0.0:
            raise BenchError(f"The response amplitude of a release must not be negative, got {self.release:g}.")
        if self.release > 0.0 and not resonance.needs_release:
            raise BenchError(f"A {resonance.label} resonance needs no release; leave it out.")

    def _check_harmonics(self) -> None:
        highest = self.harmonics_control
        if highest not in (0, AUTOMATIC) and not 2 <= highest <= MOST_HARMONICS:
            raise BenchError(
                f"The highest harmonic of the force to be controlled must be from 2 to {MOST_HARMONICS}, 0 for none or "
                f"auto, got {highest}."
            )
        if self.harmonics_target not in tuple(HarmonicsTarget):
            raise BenchError(f"The harmonics' target {self.harmonics_target} is not known; use 0 (force) or 1 (modal).")

    def _check_frequencies(self, frequencies_hz: Sequence[float], levels: int, nyquist: float) -> None:
        label = self.test.label.replace("_", " ")
        if self.test.is_noise and frequencies_hz:
            raise BenchError("A random test has a band and no frequencies; leave them out.")
        if self.test in (TestKind.SWEEP, TestKind.STEPPED_SINE) and not frequencies_hz:
            raise BenchError(f"A {label} test needs a frequency for every level; give frequencies_hz.")
        if frequencies_hz and len(frequencies_hz) != levels:
            raise BenchError(f"There are {len(frequencies_hz)} frequencies for {levels} levels; give one per level.")
        for frequency in frequencies_hz:
            if not 0.0 < frequency < nyquist:
                raise BenchError(
                    f"The frequency of {frequency:g} Hz must lie between 0 and half the sample rate, {nyquist:g} Hz."
                )

    def _check_sweep(self, frequencies_hz: Sequence[float], nyquist: float) -> None:
        end, rate = self.frequency_end_hz, self.rate_hz_s
        if not 0.0 < end < nyquist:
            raise BenchError(
                f"The sweep's end of {end:g} Hz must lie between 0 and half the sample rate, {nyquist:g} Hz."
            )
        if rate == 0.0:
            raise BenchError("A sweep needs a rate other than 0 Hz/s.")
        for start in frequencies_hz:
            if not 0.0 < (end - start) / rate < _LONGEST:
                raise BenchError(
                    f"A rate of {rate:g} Hz/s does not lead from {start:g} to {end:g} Hz within 1e6 s; mind its sign."
                )
