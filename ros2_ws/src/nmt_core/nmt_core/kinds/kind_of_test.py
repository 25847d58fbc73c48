"""What every kind of test has: its number, what applies to it, its settings, and what it refuses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

from nmt_core.errors import BenchError
from nmt_core.vocabulary import ControlKind, TestKind

LONGEST = 1e6
"""Longest time that a setting may name, s."""

_TRAVELS = "travels"


def of_goal(default: Any) -> Any:
    """A setting that the goal of a run has and the single level has not."""
    return field(default=default, metadata={_TRAVELS: "goal"})


def of_plan(default: Any) -> Any:
    """A setting that the plan of a test has and no message."""
    return field(default=default, metadata={_TRAVELS: "plan"})


@dataclass(frozen=True, kw_only=True)
class KindOfTest:
    """A kind of test with its settings, the same for every level of a run.

    The fields of a class are its settings, with the names that ``nmt_msgs/Level`` and ``nmt_msgs/RunLevels`` have for
    them. Messages are flat: a setting of another kind is zero there.

    Attributes:
        NUMBER: its number in messages.
        RIG_LEVELS: where a rig's section ``test`` has levels for it; empty = nowhere, they must be given.
        CONTROL: what its levels are unless the test says otherwise.
        FROM_RIG: settings that a rig's section ``test`` may give.
        closes_phase_loop: the frequency is controlled by the phase, which needs a linear description.
        gives_modal_points: its windows are extracted while the test runs.
        levels_are_rms: levels are the drive's root mean square, and its peaks are larger by :data:`PEAK_FACTOR`.
        has_phase: the drive has an excitation phase, and windows are counted in its periods.
        is_broad_band: the drive has a band and no one frequency; frequency responses are averages of spectra.
        sweeps: the frequency moves through the window.
        needs_frequencies: every level needs a frequency.
        is_curve: its windows are points of response curves: any phase is held, and orbits may be unstable without the
            loop.
        one_exciter: how a sentence begins that says it drives one exciter; empty = it drives several.
        beyond_paper_loop: what the paper's loop does instead, and what it is to be left for; empty = it does it.
        beyond_backbone: sentence about ``{words}`` that says why no backbone is its reference; empty = one is.
        damps_at_end: the loop damps the motion after the last level, and says how that went.
        stops_without_answer: a run ends where a higher level would follow one that had no force or no response.
    """

    NUMBER: ClassVar[TestKind]
    RIG_LEVELS: ClassVar[str] = ""
    CONTROL: ClassVar[ControlKind] = ControlKind.VOLTAGE
    FROM_RIG: ClassVar[tuple[str, ...]] = ()
    closes_phase_loop: ClassVar[bool] = False
    gives_modal_points: ClassVar[bool] = False
    levels_are_rms: ClassVar[bool] = False
    has_phase: ClassVar[bool] = True
    is_broad_band: ClassVar[bool] = False
    sweeps: ClassVar[bool] = False
    needs_frequencies: ClassVar[bool] = False
    stops_without_answer: ClassVar[bool] = False
    damps_at_end: ClassVar[bool] = False
    is_curve: ClassVar[bool] = False
    one_exciter: ClassVar[str] = ""
    beyond_paper_loop: ClassVar[tuple[str, str] | tuple[()]] = ()
    beyond_backbone: ClassVar[str] = ""

    @classmethod
    def label(cls) -> str:
        """Name in small letters, as in commands and run.json."""
        return cls.NUMBER.label

    @classmethod
    def words(cls) -> str:
        """Name as in a sentence, ``phase resonance``."""
        return cls.label().replace("_", " ")

    @classmethod
    def spelled(cls, **settings: Any) -> KindOfTest:
        """The kind with settings in the words of commands and of Python.

        Raises:
            BenchError: it has no such setting, or the words are not understood.
        """
        known = {item.name for item in fields(cls)}
        for name in settings:
            if name not in known:
                raise BenchError(_lacks(cls, name))
        return cls(**settings)

    @classmethod
    def travelling(cls, *ways: str) -> tuple[str, ...]:
        """Settings that travel with every level (``level``), with the goal of a run (``goal``) or not (``plan``)."""
        return tuple(item.name for item in fields(cls) if item.metadata.get(_TRAVELS, "level") in ways)

    @property
    def level_fields(self) -> dict[str, Any]:
        """Fields of ``nmt_msgs/Level``; those of other kinds are left out."""
        return {name: getattr(self, name) for name in self.travelling("level")} | {"test": self.NUMBER}

    @property
    def controlled_harmonics(self) -> int:
        """Highest harmonic of the force that is controlled; 0 = none, 1 = as many as can be."""
        return 0

    @property
    def puts_levels_in(self) -> bool:
        """Whether levels are put between those of the plan while it runs."""
        return False

    @property
    def window_s(self) -> float:
        """Length of the window where it is not a number of periods, s; 0 = it is."""
        return 0.0

    @property
    def least_periods(self) -> int:
        """Periods that a window of periods needs."""
        return 3

    def steps(self, levels: Sequence[float], backwards: bool = False) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """What a run begins with at these levels, before anything is put in: an amplitude for each step, and its phase.

        Args:
            levels: of the plan.
            backwards: whether the first of several steps of a level comes last.

        Returns:
            Amplitudes, and the phase by which the held force leads the velocity, rad; no phases = phase resonance.
        """
        del backwards
        return tuple(levels), ()

    def check(self, frequencies_hz: Sequence[float], levels: int, control: int, sample_rate: float) -> None:
        """Refuse what a bench with this sample rate cannot do.

        Args:
            frequencies_hz: one per level, or none.
            levels: number of levels.
            control: what the levels are, as in ``nmt_msgs/Level``.
            sample_rate: Hz.

        Raises:
            BenchError: a setting is missing or out of range.
        """
        for item in fields(self):
            value = getattr(self, item.name)
            if not isinstance(value, str) and not math.isfinite(value):
                raise BenchError(f"The {self.words()} test's {item.name} must be finite, got {value}.")
        self.check_frequencies(frequencies_hz, levels, 0.5 * sample_rate)

    def check_frequencies(self, frequencies_hz: Sequence[float], levels: int, nyquist: float) -> None:
        """Refuse (BenchError) frequencies that are missing, too many, or not below half the sample rate (Hz)."""
        if self.needs_frequencies and not frequencies_hz:
            raise BenchError(f"A {self.words()} test needs a frequency for every level; give frequencies_hz.")
        if frequencies_hz and len(frequencies_hz) != levels:
            raise BenchError(f"There are {len(frequencies_hz)} frequencies for {levels} levels; give one per level.")
        for frequency in frequencies_hz:
            if not 0.0 < frequency < nyquist:
                raise BenchError(
                    f"The frequency of {frequency:g} Hz must lie between 0 and half the sample rate, {nyquist:g} Hz."
                )

    def check_duration(self, duration: float) -> None:
        """Refuse (BenchError) a duration that is not positive or too long."""
        if not 0.0 < duration < LONGEST:
            raise BenchError(
                f"A {self.words()} test needs a duration that is positive and below 1e6 s, got {duration:g}."
            )


def _lacks(kind: type[KindOfTest], name: str) -> str:
    return f"A {kind.words()} test has no {name}; leave it out or choose another kind of test."


def refuse_foreign(kind: type[KindOfTest], values: Mapping[str, Any], names: Sequence[str]) -> None:
    """Refuse (BenchError) the first of the names that belongs to another kind and has a value other than zero."""
    for name in names:
        if values.get(name) and name not in kind.travelling("level", "goal"):
            raise BenchError(_lacks(kind, name))
