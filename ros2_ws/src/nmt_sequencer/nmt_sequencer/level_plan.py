"""Plans of excitation levels: parsing, spacing and direction; the plan of a run."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import PEAK_FACTOR, KindOfTest
from nmt_core.messages.run_settings import RunSettings
from nmt_core.settings import parameters_of, setting
from nmt_core.vocabulary import ControlKind

DIRECTIONS = ("up", "down", "both")
SPACINGS = ("geometric", "linear")
MAX_LEVELS = 1000
MAX_LEVEL = 1e6  # in any unit: no laboratory has more

_DECIMAL_COMMA = re.compile(r"(?<![\d.])0,\d|\d,\d+:|:\d+,\d")
_SYNTAX = "write 'a:b:n' for n levels from a to b in geometric steps, 'a:b:n:linear' for equal steps, or a list 'a,b,c'"


def parse_levels(text: str) -> list[float]:
    """Levels from the command line's notation.

    Args:
        text: ``a:b:n`` (geometric), ``a:b:n:linear``, ``a:b:n:geometric`` or ``a,b,c``.

    Returns:
        Levels in the order given, in the unit of the test (volts unless the rig says otherwise).

    Raises:
        BenchError: the text is not a plan, or a level is not positive and finite.
    """
    where = f"Levels '{text}'"
    if _DECIMAL_COMMA.search(text):
        raise BenchError(
            f"{where}: decimals have a point, as in 0.5; a comma separates levels, and none of them is zero."
        )
    if ":" in text:
        parts = [part.strip() for part in text.split(":")]
        if len(parts) not in (3, 4) or (len(parts) == 4 and parts[3] not in SPACINGS):
            raise BenchError(f"{where} are not a plan: {_SYNTAX}.")
        first, last = (_number(part, where) for part in parts[:2])
        # Longer numbers are too large anyway, and some digits ('²') are no decimal ones.
        if not parts[2].isdecimal() or len(parts[2]) > 9 or not 1 <= int(parts[2]) <= MAX_LEVELS:
            raise BenchError(f"{where}: the number of levels must be a whole number from 1 to {MAX_LEVELS}.")
        return spaced_levels(first, last, int(parts[2]), parts[3] if len(parts) == 4 else "geometric")
    levels = [_number(part, where) for part in text.split(",")]
    return check_levels(levels, where)


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise BenchError(f"{where}: '{text.strip()}' is not a number; {_SYNTAX}.") from None


def spaced_levels(first: float, last: float, count: int, spacing: str = "geometric") -> list[float]:
    """``count`` levels from ``first`` to ``last``, both included exactly.

    Raises:
        BenchError: a level is not positive and finite, or the spacing is unknown.
    """
    check_levels([first, last], "Levels")
    if spacing not in SPACINGS:
        raise BenchError(f"Spacing '{spacing}' is not known; use {' or '.join(SPACINGS)}.")
    if count == 1:
        return [first]
    space = np.geomspace if spacing == "geometric" else np.linspace
    levels = [float(level) for level in space(first, last, count)]
    levels[0], levels[-1] = first, last
    return levels


def check_levels(levels: Sequence[Any], where: str) -> list[float]:
    """The levels as a list of numbers.

    Raises:
        BenchError: none, too many, or one that is not a number, not positive or not finite.
    """
    if not levels or len(levels) > MAX_LEVELS:
        raise BenchError(f"{where}: a plan needs 1 to {MAX_LEVELS} levels, got {len(levels)}.")
    for level in levels:
        if isinstance(level, bool) or not isinstance(level, int | float):
            raise BenchError(f"{where}: every level must be a number, got {str(level)[:40]!r}.")
        if not 0 < level < math.inf:
            raise BenchError(f"{where}: every level must be positive and finite, got {level}.")
        if level > MAX_LEVEL:
            raise BenchError(f"{where}: every level must be at most {MAX_LEVEL:g}, got {str(level)[:40]}.")
    return [float(level) for level in levels]


@dataclass(frozen=True)
class LevelLimits:
    """Largest levels that a rig allows, V, N and the unit of its response; 0 = none is given.

    Whoever takes levels asks here: the plan of a test, the goal of a run, a request to steer, the page.
    """

    largest_voltage: float = setting(
        0.0, "Largest level of voltage that the rig allows; 0 = none is given.", unit="V", low=0.0
    )
    largest_force: float = setting(
        0.0, "Largest level of force that the rig allows; 0 = none is given.", unit="N", low=0.0
    )
    largest_response: float = setting(
        0.0,
        "Largest level of response that the rig allows; 0 = none is given.",
        unit="unit of the response",
        low=0.0,
    )

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> LevelLimits:
        """From the description of a run; a missing entry is not a limit."""
        return cls(*(float(values.get(parameter.name) or 0.0) for parameter in parameters_of(cls)))

    def check(self, levels: Sequence[Any], control: int, test: KindOfTest, where: str = "Plan") -> list[float]:
        """The levels as a list of numbers.

        Args:
            levels: in the unit of the control.
            control: what they are, as in ``nmt_msgs/Level``.
            test: kind of test; the peaks of a random drive count.
            where: what the sentence begins with.

        Raises:
            BenchError: as :func:`check_levels`, or one is beyond the limit.
        """
        checked = check_levels(levels, where)
        kind = ControlKind(control or ControlKind.VOLTAGE)
        limit = getattr(self, f"largest_{kind.label}", 0.0)
        key, unit = {ControlKind.VOLTAGE: ("limits.voltage_v", " V"), ControlKind.FORCE: ("limits.force_n", " N")}.get(
            kind, ("its limit of the response", "")
        )
        highest = max(checked)
        if not limit or highest * (PEAK_FACTOR if test.levels_are_rms else 1.0) <= limit:
            return checked
        if test.levels_are_rms:
            raise BenchError(
                f"{where}: peaks of a random drive of {highest:g} V rms reach {PEAK_FACTOR:g} times as much, beyond "
                f"the limit of the rig (limits.voltage_v: {limit:g} V); lower the level."
            )
        raise BenchError(
            f"{where}: level {highest:g}{unit} is beyond the limit of the rig ({key}: {limit:g}{unit}); "
            "lower the level."
        )


NO_LIMITS = LevelLimits()


def directed(levels: Sequence[float], direction: str) -> list[float]:
    """The plan run up, down, or up and then down again (the turning level once).

    Raises:
        BenchError: unknown direction.
    """
    up = sorted(levels)
    if direction == "up":
        return up
    if direction == "down":
        return up[::-1]
    if direction == "both":
        return up + up[-2::-1]
    raise BenchError(f"Direction '{direction}' is not known; use {', '.join(DIRECTIONS)}.")


@dataclass(frozen=True)
class RunPlan(RunSettings):
    """What to run: what was asked for, with the sequencer's parameters instead of open values.

    Attributes:
        timeout: bench time a level may take to lock, s; 0 = no limit.
        phases: phase of each level by which the held force leads the velocity, rad; empty = phase resonance, or as the
            kind of test begins.
        open_loop_abort: end the run where a higher level would follow one that was lost without force or response.
    """

    ramp: float = 0.5
    window_periods: int = 200
    timeout: float = 30.0
    phases: tuple[float, ...] = ()
    open_loop_abort: bool = True

    def __post_init__(self) -> None:
        check_levels(self.levels, "Plan")
        if not self.phases:
            levels, phases = self.kind.steps(self.levels)
            object.__setattr__(self, "levels", levels)
            object.__setattr__(self, "phases", phases)
        if self.control not in (ControlKind.VOLTAGE, ControlKind.RESPONSE, ControlKind.FORCE):
            raise BenchError(f"Control {self.control} is not known; use 1 (voltage), 2 (response) or 3 (force).")
        if not 0.0 <= self.ramp < 1e6:
            raise BenchError(f"The ramp must be finite and >= 0 s, got {self.ramp}.")
        if not 0.0 <= self.timeout < 1e9:
            raise BenchError(f"The time-out must be finite and >= 0 s, got {self.timeout}.")
        if self.window_periods < 1:
            raise BenchError(f"A window needs at least one period, got {self.window_periods}.")
        if (self.kind.puts_levels_in or self.phases) and self.levels_without:
            raise BenchError("Levels can be put in only where all are done alike: leave out --compare.")

    def check(self, sample_rate: float, limits: LevelLimits = NO_LIMITS) -> None:
        """Refuse (BenchError) what a bench of this sample rate (Hz) cannot do, and what its rig does not allow."""
        limits.check(self.levels, self.control, self.kind)
        self.kind.check(self.frequencies_hz, len(self.levels), self.control, sample_rate)
