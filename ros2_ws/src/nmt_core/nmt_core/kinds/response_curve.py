"""Response curves past their folds: an amplitude is held, and the phase lag is stepped along the curve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from nmt_core.errors import BenchError
from nmt_core.kinds.kind_of_test import KindOfTest, of_goal
from nmt_core.kinds.phase_resonance import PhaseLockedTest
from nmt_core.vocabulary import ControlKind, TestKind

RESONANT_LAG = 0.5 * math.pi
"""Lag of the displacement behind the force at phase resonance, rad."""
LEAST_LAG = math.radians(1.0)
"""Distance of a lag from 0 and from 180°, where it says nothing of the frequency, rad."""
LEAST_SPACING, LARGEST_SPACING = 0.01, 1.0
FLOQUET_PERIODS = 20
"""Periods of a window without which it tells no Floquet exponents."""
FLOQUET_PERTURBATION = 0.01
"""Perturbation of the drive unless another is named: small enough for a linear answer, large next to its noise."""
LARGEST_PERTURBATION = 0.1
ALONG = ("auto", "lag", "secant")
"""What a curve is stepped along, by its number in messages."""


@dataclass(frozen=True, kw_only=True)
class ResponseCurveTest(PhaseLockedTest):
    """One window of whole periods at each point of the response at a held force or response amplitude.

    A level of the plan is a curve: the lag goes from one end to the other, and back at the next level. The distance of
    two points is that of (ln x/F, `FREQUENCY_WEIGHT` ln Ω), x/F the complex drive-point displacement per force.

    Attributes:
        lag_from, lag_to: first and last phase by which the displacement of the drive point lags the force, rad.
        spacing: distance of neighbouring points.
        perturbation: rms of a multisine that changes the drive within the windows, over its amplitude, for the Floquet
            exponents; 0 = none.
        release: response amplitude at the drive point that is held at the lag of the first point before the force is,
            m or m/s²: the way onto a branch that rest does not lead to; 0 = from rest.
        along: number of `ALONG`: ``lag`` as long as that grows; ``secant``: the frequency where the orbit is stable, a
            combination of lag and response elsewhere; ``auto``: secant where another mode lies within the filter.
    """

    NUMBER: ClassVar[TestKind] = TestKind.RESPONSE_CURVE
    RIG_LEVELS: ClassVar[str] = ""
    CONTROL: ClassVar[ControlKind] = ControlKind.FORCE
    FREQUENCY_WEIGHT: ClassVar[float] = 10.0
    gives_modal_points: ClassVar[bool] = True
    is_curve: ClassVar[bool] = True
    one_exciter: ClassVar[str] = "The loop follows a response curve with"
    beyond_paper_loop: ClassVar[tuple[str, str] | tuple[()]] = ("holds phase resonance only", "response curves")
    beyond_backbone: ClassVar[str] = (
        "The backbone of a mode is passed by {words} at its tip only; compare it with the response curves of "
        "'./nmt reference RIG --forces', or use a test at phase resonance."
    )

    lag_from: float = of_goal(math.radians(10.0))
    lag_to: float = of_goal(math.radians(170.0))
    spacing: float = of_goal(0.2)
    perturbation: float = 0.0
    release: float = 0.0
    along: int = of_goal(0)

    @property
    def puts_levels_in(self) -> bool:
        """True: a curve has two points in the plan."""
        return True

    @property
    def follows_secant(self) -> bool:
        """Whether the lag is not what the curve is stepped along."""
        return ALONG[self.along] == "secant"

    @classmethod
    def spelled(cls, **settings: Any) -> KindOfTest:
        """``lag_deg`` has both ends, degrees; ``floquet`` asks for the usual perturbation; ``along`` is of `ALONG`."""
        along = settings.pop("along", None)
        if along is not None:
            if along not in ALONG:
                raise BenchError(f"A response curve is not stepped along '{along}'; use {' or '.join(ALONG)}.")
            settings["along"] = ALONG.index(along)
        if settings.pop("floquet", False):
            settings.setdefault("perturbation", FLOQUET_PERTURBATION)
        lags = settings.pop("lag_deg", None)
        if lags is not None:
            if len(lags) != 2:
                raise BenchError(f"lag_deg needs a first and a last lag in degrees, got {len(lags)} values.")
            settings |= {"lag_from": math.radians(lags[0]), "lag_to": math.radians(lags[1])}
        return super().spelled(**settings)

    @property
    def least_periods(self) -> int:
        """Periods that a window needs."""
        return FLOQUET_PERIODS if self.perturbation else super().least_periods

    def check(self, frequencies_hz: Sequence[float], levels: int, control: int, sample_rate: float) -> None:
        """Refuse (BenchError) lags out of range, a spacing out of range, and levels of voltage."""
        super().check(frequencies_hz, levels, control, sample_rate)
        least, most = math.degrees(LEAST_LAG), math.degrees(math.pi - LEAST_LAG)
        for lag in (self.lag_from, self.lag_to):
            if not LEAST_LAG <= lag <= math.pi - LEAST_LAG:
                raise BenchError(
                    f"A lag of {math.degrees(lag):g}° says too little of the frequency; give lags from {least:g} to "
                    f"{most:g}°."
                )
        if self.lag_from == self.lag_to:
            raise BenchError("A response curve leads from one lag to another; give two different ones as in 20:160.")
        if not LEAST_SPACING <= self.spacing <= LARGEST_SPACING:
            raise BenchError(
                f"The spacing of points along a response curve must be from {LEAST_SPACING:g} to {LARGEST_SPACING:g}, "
                f"got {self.spacing:g}."
            )
        if not 0.0 <= self.perturbation <= LARGEST_PERTURBATION:
            raise BenchError(
                f"The perturbation of the drive must be from 0 (none) to {LARGEST_PERTURBATION:g} of its amplitude, "
                f"got {self.perturbation:g}."
            )
        if self.release < 0.0:
            raise BenchError(f"The response amplitude of a release must not be negative, got {self.release:g}.")
        if self.release and control == ControlKind.RESPONSE:
            raise BenchError(
                "At a held response amplitude no release is needed, as the loop holds every amplitude; leave out "
                "--release."
            )
        if not 0 <= self.along < len(ALONG):
            raise BenchError(f"A response curve is stepped along 0 to {len(ALONG) - 1} of {ALONG}, got {self.along}.")
        if control == ControlKind.VOLTAGE:
            raise BenchError(
                "A response curve has levels of force or response, as at a held voltage the force follows the "
                "response; use --control force or response."
            )
        if frequencies_hz:
            raise BenchError("The frequency of a response curve follows from its lag; leave out the frequencies.")

    def steps(self, levels: Sequence[float], backwards: bool = False) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Each level at both ends of its curve, there and back; see `KindOfTest.steps`."""
        ends = [lag - RESONANT_LAG for lag in (self.lag_from, self.lag_to)]
        amplitudes, phases = [], []
        for place, level in enumerate(levels):
            amplitudes += [level, level]
            phases += ends[::-1] if (place % 2 == 1) != backwards else ends
        return tuple(amplitudes), tuple(phases)
