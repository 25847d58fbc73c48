"""What a run is asked for: one record, from the options of a command to action goal, sequencer, run.json and page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from nmt_core.kinds import KINDS, KindOfTest, PhaseResonanceTest, goal_fields, kind_of_goal
from nmt_core.vocabulary import ControlKind


@dataclass(frozen=True)
class RunSettings:
    """A run as asked for; the fields are those of the goal of ``nmt_msgs/RunLevels``.

    Attributes:
        run_id: name of the run; empty = the sequencer makes one.
        levels: target amplitudes in order, in the unit of ``control``.
        control: what the levels are, see :class:`~nmt_core.vocabulary.ControlKind`.
        ramp: half-cosine between levels, s; 0 = the sequencer's parameter.
        window_periods: whole periods to capture; 0 = the sequencer's parameter.
        timeout: bench time a level may take to lock, s; 0 = the sequencer's parameter.
        stop_on_lost_lock: end the run at the first level that does not lock.
        kind: kind of test with its settings, the same for every level.
        frequencies_hz: frequency of each level, Hz; empty = none given.
        levels_without: indices of levels without control of the force's harmonics.
    """

    run_id: str = ""
    levels: tuple[float, ...] = ()
    control: int = ControlKind.VOLTAGE
    ramp: float = 0.0
    window_periods: int = 0
    timeout: float = 0.0
    stop_on_lost_lock: bool = False
    kind: KindOfTest = field(default_factory=PhaseResonanceTest)
    frequencies_hz: tuple[float, ...] = ()
    levels_without: frozenset[int] = frozenset()

    @classmethod
    def of_goal(cls, goal: Mapping[str, Any]) -> RunSettings:
        """Read from the fields of an action goal, or of a run's description; what is not there has its default.

        Raises:
            BenchError: no such kind of test, or a setting of another kind.
        """
        given: dict[str, Any] = {item.name: goal[item.name] for item in fields(RunSettings) if item.name in goal}
        for name in ("levels", "frequencies_hz"):
            given[name] = tuple(given.get(name) or ())
        given["levels_without"] = frozenset(int(index) for index in given.get("levels_without") or ())
        given["control"] = int(given.get("control", 0)) or ControlKind.VOLTAGE
        return RunSettings(kind=kind_of_goal(goal), **given)

    @classmethod
    def described(cls, description: Mapping[str, Any]) -> RunSettings:
        """Read from the plan in a run's description of itself, which has the kind of test as a word."""
        numbers = {kind.label(): int(number) for number, kind in KINDS.items()}
        control = description.get("control")
        named = {"control": ControlKind.named(control)} if isinstance(control, str) else {}
        return cls.of_goal({**description, **named, "test": numbers.get(str(description.get("test")), 0)})

    @property
    def values(self) -> dict[str, Any]:
        """Every field by its name."""
        return {item.name: getattr(self, item.name) for item in fields(RunSettings)}

    @property
    def goal(self) -> dict[str, Any]:
        """Fields of the action goal."""
        values = {**self.values, **goal_fields(self.kind), "control": int(self.control)}
        del values["kind"]
        for name, value in values.items():
            if isinstance(value, tuple | frozenset):
                values[name] = sorted(value) if isinstance(value, frozenset) else list(value)
        return values

    @property
    def description(self) -> dict[str, Any]:
        """The plan in a run's description of itself, for JSON."""
        goal = self.goal
        del goal["run_id"]
        return goal | {"test": self.kind.label()}
