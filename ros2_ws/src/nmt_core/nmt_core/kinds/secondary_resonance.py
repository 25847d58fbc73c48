"""A resonance of an order of the response other than that of the force, held by its phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from nmt_core.errors import BenchError
from nmt_core.kinds.kind_of_test import KindOfTest
from nmt_core.messages.secondary_resonance import RESONANCES, resonance_named, resonance_of
from nmt_core.vocabulary import ControlKind, TestKind


@dataclass(frozen=True, kw_only=True)
class SecondaryResonanceTest(KindOfTest):
    """Whole periods of the base frequency.

    Attributes:
        response_order, force_order: k and ν, see :mod:`nmt_core.messages.secondary_resonance`.
        release: response amplitude at the drive point that a release onto an isola begins with, m or m/s²; 0 = none.
    """

    NUMBER: ClassVar[TestKind] = TestKind.SECONDARY_RESONANCE
    closes_phase_loop: ClassVar[bool] = True
    gives_modal_points: ClassVar[bool] = True
    stops_without_answer: ClassVar[bool] = True
    one_exciter: ClassVar[str] = "The loop holds a secondary resonance with"
    beyond_paper_loop: ClassVar[tuple[str, str] | tuple[()]] = (
        "holds the phase of the drive's own order", "secondary resonances",
    )  # fmt: skip
    beyond_backbone: ClassVar[str] = (
        "The reference is the backbone of a mode, and {words} is off it by what the force drives at other orders "
        "than the resonant "
        "order; use --reference none, or a test at phase resonance."
    )

    response_order: int = 0
    force_order: int = 0
    release: float = 0.0

    @classmethod
    def spelled(cls, **settings: Any) -> KindOfTest:
        """``resonance`` is a text as ``3:1``."""
        name = settings.pop("resonance", "")
        if not name:
            known = " or ".join(item.label for item in RESONANCES)
            raise BenchError(f"A secondary resonance test needs the resonance, {known}; other tests have none.")
        orders = resonance_named(name)
        return super().spelled(**settings, response_order=orders.response_order, force_order=orders.force_order)

    def check(self, frequencies_hz: Sequence[float], levels: int, control: int, sample_rate: float) -> None:
        """Refuse (BenchError) levels of the response, and a release that is not needed or missing."""
        super().check(frequencies_hz, levels, control, sample_rate)
        resonance = resonance_of(self.response_order, self.force_order)
        if control == ControlKind.RESPONSE:
            raise BenchError("In a secondary resonance levels are voltages or forces; choose control voltage or force.")
        if self.release < 0.0:
            raise BenchError(f"The response amplitude of a release must not be negative, got {self.release:g}.")
        if self.release > 0.0 and not resonance.needs_release:
            raise BenchError(f"A {resonance.label} resonance needs no release; leave it out.")
        if not self.release and resonance.needs_release:
            raise BenchError(
                f"A {resonance.label} resonance lies on a branch that rest does not lead to; give --release with about "
                f"half the amplitude of its tip, which './nmt synthesis --resonance {resonance.label}' tells."
            )
