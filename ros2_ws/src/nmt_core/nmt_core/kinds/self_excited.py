"""Motions that the structure feeds by itself: held at an amplitude, or released and passed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from nmt_core.errors import BenchError
from nmt_core.kinds.kind_of_test import KindOfTest, of_plan
from nmt_core.vocabulary import ControlKind, TestKind

METHODS = ("auto", "amplitude", "feedback", "envelope")


@dataclass(frozen=True, kw_only=True)
class SelfExcitedTest(KindOfTest):
    """One window a level, of whole periods where the motion is held, about the level where it is released.

    Attributes:
        duration: longest time that a free motion is waited for, and that damping lasts at the end, s.
        method: how the amplitudes are reached, see :mod:`nmt_pll.self_excited.self_excited_loop`.
    """

    NUMBER: ClassVar[TestKind] = TestKind.SELF_EXCITED
    RIG_LEVELS: ClassVar[str] = "response_levels"
    CONTROL: ClassVar[ControlKind] = ControlKind.RESPONSE
    closes_phase_loop: ClassVar[bool] = True
    gives_modal_points: ClassVar[bool] = True
    damps_at_end: ClassVar[bool] = True
    one_exciter: ClassVar[str] = "The loop holds a self-excited motion with"
    beyond_paper_loop: ClassVar[tuple[str, str] | tuple[()]] = ("cannot hold such a motion", "a self-excited test")

    duration: float = 5.0
    method: str = of_plan("auto")

    def check(self, frequencies_hz: Sequence[float], levels: int, control: int, sample_rate: float) -> None:
        """Refuse (BenchError) levels other than of the response, and an unknown method."""
        super().check(frequencies_hz, levels, control, sample_rate)
        if control != ControlKind.RESPONSE:
            raise BenchError("A self-excited test has levels of the response; use --control response.")
        if self.method not in METHODS:
            raise BenchError(f"Method '{self.method}' is not known; use {' or '.join(METHODS)}.")
        self.check_duration(self.duration)
