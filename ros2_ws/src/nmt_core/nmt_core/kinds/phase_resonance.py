"""Phase resonance and ring-down: sines whose frequency follows the phase, with the force's harmonics controlled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from nmt_core.errors import BenchError
from nmt_core.kinds.kind_of_test import KindOfTest, of_goal, of_plan
from nmt_core.vocabulary import AUTOMATIC, ControlKind, HarmonicsTarget, TestKind

MOST_HARMONICS = 50
"""Highest harmonic that can be asked for."""
STRATEGIES = ("stepped", "ramp")


@dataclass(frozen=True, kw_only=True)
class PhaseLockedTest(KindOfTest):
    """Phase-locked excitation.

    Attributes:
        harmonics_control: harmonics 2 to this one of the force are controlled; 0 = none, 1 = as many as can be.
        harmonics_target: what they are brought to, see :class:`~nmt_core.vocabulary.HarmonicsTarget`.
    """

    RIG_LEVELS: ClassVar[str] = "levels"
    FROM_RIG: ClassVar[tuple[str, ...]] = ("harmonics_control", "harmonics_target")
    closes_phase_loop: ClassVar[bool] = True

    harmonics_control: int = 0
    harmonics_target: int = 0

    @classmethod
    def spelled(cls, **settings: Any) -> KindOfTest:
        """``harmonics_control`` is a number or ``auto``, ``harmonics_target`` is ``force`` or ``modal``."""
        control = _highest(settings.pop("harmonics_control", 0))
        target = HarmonicsTarget.named(str(settings.pop("harmonics_target", "force")))
        return super().spelled(**settings, harmonics_control=control, harmonics_target=int(target) if control else 0)

    @property
    def controlled_harmonics(self) -> int:
        """Highest harmonic of the force that is controlled."""
        return self.harmonics_control

    def check(self, frequencies_hz: Sequence[float], levels: int, control: int, sample_rate: float) -> None:
        """Refuse (BenchError) an unknown target and more harmonics than can be."""
        super().check(frequencies_hz, levels, control, sample_rate)
        highest = self.harmonics_control
        if highest not in (0, AUTOMATIC) and not 2 <= highest <= MOST_HARMONICS:
            raise BenchError(_not_so_many(highest))
        if self.harmonics_target not in tuple(HarmonicsTarget):
            raise BenchError(f"The harmonics' target {self.harmonics_target} is not known; use 0 (force) or 1 (modal).")


def _not_so_many(highest: int) -> str:
    return (
        f"The highest harmonic of the force to be controlled must be from 2 to {MOST_HARMONICS}, 0 for none or auto, "
        f"got {highest}."
    )


def _highest(asked: Any) -> int:
    if asked == "auto":
        return AUTOMATIC
    try:
        highest = int(asked)
    except ValueError:
        raise BenchError(f"Harmonics to be controlled: '{asked}' is not a number; give a number or auto.") from None
    if highest == AUTOMATIC:  # the message's number for auto, and no harmonic of a person
        raise BenchError(_not_so_many(highest))
    return highest


@dataclass(frozen=True, kw_only=True)
class PhaseResonanceTest(PhaseLockedTest):
    """One window of whole periods at each level.

    Attributes:
        refinement: relative deviation of the frequency from a straight backbone above which levels are put in between;
            0 = none.
        strategy: ``stepped``: wait at every level for lock; ``ramp``: lock once, then ramp from level to level as long
            as a window lasts and extract during the ramps by the balance of power.
    """

    NUMBER: ClassVar[TestKind] = TestKind.PHASE_RESONANCE
    gives_modal_points: ClassVar[bool] = True
    stops_without_answer: ClassVar[bool] = True

    refinement: float = of_goal(0.0)
    strategy: str = of_plan("stepped")

    @property
    def puts_levels_in(self) -> bool:
        """Whether the backbone is refined."""
        return self.refinement > 0.0

    def check(self, frequencies_hz: Sequence[float], levels: int, control: int, sample_rate: float) -> None:
        """Refuse (BenchError) an unknown strategy, ramps of a held amplitude, levels inserted in ramps."""
        super().check(frequencies_hz, levels, control, sample_rate)
        if self.strategy not in STRATEGIES:
            raise BenchError(f"Strategy '{self.strategy}' is not known; use {' or '.join(STRATEGIES)}.")
        if not 0.0 <= self.refinement < 1.0:
            raise BenchError(f"The refinement must be from 0 (none) to below 1, got {self.refinement}.")
        if self.refinement and self.strategy == "ramp":
            raise BenchError("Levels are put in between in stepped tests only; leave out the refinement.")
        if self.strategy == "ramp" and control in (ControlKind.RESPONSE, ControlKind.FORCE):
            raise BenchError(
                "The strategy ramp measures while the voltage changes and holds neither response nor force; use "
                "--control voltage, or --strategy stepped."
            )
        if self.refinement and frequencies_hz:
            raise BenchError("Levels can be put in only where all are done alike: leave out the frequencies.")


@dataclass(frozen=True, kw_only=True)
class RingDownTest(PhaseLockedTest):
    """Excitation that is switched off at the lock; the window is the free decay.

    Attributes:
        duration: of the decay, s.
    """

    NUMBER: ClassVar[TestKind] = TestKind.RING_DOWN
    beyond_paper_loop: ClassVar[tuple[str, str] | tuple[()]] = ("does not switch off", "a ring-down test")
    beyond_backbone: ClassVar[str] = (
        "The reference is compared with modal points, and {words} gives free decays; plot reference.csv over "
        "decay.csv, or use a test at phase resonance."
    )

    duration: float = 0.0

    @property
    def window_s(self) -> float:
        """Length of the decay, s."""
        return self.duration

    def check(self, frequencies_hz: Sequence[float], levels: int, control: int, sample_rate: float) -> None:
        """Refuse (BenchError) a decay without a length."""
        super().check(frequencies_hz, levels, control, sample_rate)
        self.check_duration(self.duration)
