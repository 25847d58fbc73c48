"""What a diagnosis is asked to do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from nmt_core.kinds.request import TestRequest
from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet

MATTERS: dict[str, float] = {"frequency": 5e-4, "damping": 0.02, "response": 0.02, "harmonics": 1e-3}
"""Smallest relative size that matters: of a frequency, a damping ratio, a response, a harmonic over the fundamental."""


@dataclass(frozen=True)
class DiagnosisSettings:
    """How a diagnosis goes about.

    Attributes:
        withheld: effects that are left out of the library.
        seed: of the bootstrap.
        look_ahead: whether to compute the tests that would decide between the remaining explanations, and the weakest
            effects that would show.
        put_off_detectable: leave the weakest effects that would show to ``DiagnosisOutcome.completed``: they take a
            scan of all candidates, and the answer does not contain them.
        hold_out: names of tests (or of their bags) that no fit sees and the gap is judged by; empty = levels and whole
            tests in turn.
        jobs: processes that share the work; the result is the same for any number.
        allow_own_model: take recordings that the model itself made for a real side, too.
        calibration: sheet of the measuring chain of the real side; None = what its bags say.
        plan: levels of the real rig's plan, which no proposed test goes beyond; empty = up to twice those measured.
        other_kinds: propose a decay, a response curve and noise at the highest level, too. They tell less for their
            bench time than levels elsewhere where those can be made.
        command: writes the command of a proposed test; empty where none does it.
        matters: smallest relative size of a gap that matters, by kind of observable (frequency, damping, response,
            harmonics); a kind that is left out matters at any size.
    """

    withheld: tuple[str, ...] = ()
    seed: int = 0
    look_ahead: bool = True
    put_off_detectable: bool = False
    hold_out: tuple[str, ...] = ()
    jobs: int = 1
    allow_own_model: bool = False
    calibration: CalibrationSheet | None = None
    plan: tuple[float, ...] = ()
    other_kinds: bool = False
    command: Callable[[TestRequest], str] = lambda _: ""
    matters: Mapping[str, float] = field(default_factory=lambda: dict(MATTERS))
