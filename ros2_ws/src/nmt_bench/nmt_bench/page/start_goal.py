"""The goal of a run that is started from the page: the run before with other levels; free of ROS."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.kinds import MOST_HARMONICS
from nmt_core.kinds.kind_of_test import refuse_foreign
from nmt_core.messages.run_settings import RunSettings
from nmt_core.vocabulary import AUTOMATIC
from nmt_sequencer.level_plan import LevelLimits, parse_levels

_MOST_PERIODS = 1_000_000
_INPUT = "nmt input"
_MAY_BE_ZERO = ("harmonics_control",)  # where zero is a wish, not "as before"


@dataclass(frozen=True)
class _Input:
    """A field of the form: the name of its value in an order, what it becomes, and how the page shows it."""

    name: str
    parse: Callable[[Any], Any]
    label: str = ""
    placeholder: str = "as before"


def _levels(text: Any) -> tuple[float, ...]:
    if not isinstance(text, str) or len(text) > 10_000:
        raise BenchError("The levels must be a text such as '0.2:1:5' or '0.2, 0.5, 1'.")
    return tuple(parse_levels(text))


def _periods(number: Any) -> int:
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number <= _MOST_PERIODS:
        raise BenchError(f"The periods a window must be a whole number from 0 to {_MOST_PERIODS}.")
    return number


def _harmonics(text: Any) -> int | None:
    words = str(text).strip()[:20]
    if words in ("", "auto"):
        return AUTOMATIC if words else None
    if not words.isdecimal() or not 0 <= int(words) <= MOST_HARMONICS or int(words) == 1:
        raise BenchError(f"The harmonics must be a number from 2 to {MOST_HARMONICS}, 0 for none, or auto.")
    return int(words)


@dataclass(frozen=True)
class StartRequest:
    """A run that a person asks for; what is not said here is as in the run before, or the sequencer's.

    The fields have the names of `RunSettings` and of the settings of kinds of test; the page makes its form of them.

    Attributes:
        levels: in the order of the test, in the unit of the run before, else V.
        window_periods: whole periods a window; 0 = as before.
        harmonics_control: up to which the force's harmonics are controlled, see ``nmt_msgs/Level``; None = as before.
    """

    levels: tuple[float, ...] = field(metadata={_INPUT: _Input("levels", _levels, "New run, levels", "0.2:1:5")})
    window_periods: int = field(default=0, metadata={_INPUT: _Input("window_periods", _periods)})
    harmonics_control: int | None = field(
        default=None, metadata={_INPUT: _Input("harmonics", _harmonics, "harmonics controlled")}
    )


def _inputs() -> dict[str, _Input]:
    """The inputs by the names of their fields."""
    return {item.name: item.metadata[_INPUT] for item in fields(StartRequest)}


def start_form() -> str:
    """The inputs of the page's form as markup; a field without a label has none."""
    return "".join(
        f'<label for="start-{each.name}">{each.label}</label><input id="start-{each.name}" name="{each.name}" '
        f'autocomplete="off" placeholder="{each.placeholder}"{" size=8" if name != "levels" else ""}>'
        for name, each in _inputs().items()
        if each.label
    )


def start_request(order: Mapping[str, Any]) -> StartRequest:
    """The run that an order of the page asks for.

    Args:
        order: values by the names of the inputs; what is empty is as before.

    Raises:
        BenchError: it is not an order, or the levels are not a plan.
    """
    inputs = _inputs()
    unknown = set(order) - {each.name for each in inputs.values()}
    if unknown:
        raise BenchError(f"A run is not started with '{sorted(unknown)[0][:40]}'.")
    given = {name: each for name, each in inputs.items() if each.name in order or name == "levels"}
    return StartRequest(**{name: each.parse(order.get(each.name)) for name, each in given.items()})


def goal_of(request: StartRequest, before: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of the goal of ``nmt_msgs/RunLevels``.

    Args:
        request: what is asked for.
        before: plan of the run before, as its bag describes it; may be empty.

    Raises:
        BenchError: a level is beyond the limits of the rig, or the run before gave each a frequency of its own.
    """
    asked = RunSettings.described(before)
    LevelLimits.of(before).check(request.levels, asked.control, asked.kind, "The levels")
    frequencies = asked.frequencies_hz
    if len(set(frequencies)) > 1 and len(frequencies) != len(request.levels):
        raise BenchError(
            f"The run before gave each of its {len(frequencies)} levels a frequency of its own; ask for as many levels."
        )
    if len(set(frequencies)) == 1:
        frequencies = frequencies[:1] * len(request.levels)
    given = {name: value for name, value in vars(request).items() if value or (value == 0 and name in _MAY_BE_ZERO)}
    of_run = {name: given[name] for name in given.keys() & {item.name for item in fields(RunSettings)}}
    of_kind = {name: given[name] for name in given.keys() - of_run.keys()}
    refuse_foreign(type(asked.kind), of_kind, tuple(of_kind))
    kind = replace(asked.kind, **{name: of_kind[name] for name in of_kind.keys() & vars(asked.kind).keys()})
    changed = {"run_id": "", "frequencies_hz": frequencies, "levels_without": frozenset(), **of_run}
    return replace(asked, kind=kind, **changed).goal
