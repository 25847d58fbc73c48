"""The goal of a run that is started from the page: the run before with other levels; free of ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from nmt_bench.page.bench_link import StartRequest
from nmt_core.errors import BenchError
from nmt_core.messages.excitation import MOST_HARMONICS, Excitation
from nmt_core.vocabulary import AUTOMATIC, TestKind
from nmt_sequencer.level_plan import LevelLimits, parse_levels

_KEPT = (
    "control",
    "ramp",
    "window_periods",
    "timeout",
    "stop_on_lost_lock",
    *(item.name for item in fields(Excitation) if item.name != "test"),
)
_MOST_PERIODS = 1_000_000


def start_request(order: Mapping[str, Any]) -> StartRequest:
    """The run that an order of the page asks for.

    Args:
        order: ``levels`` in the notation of the command line, ``window_periods``, and ``harmonics`` to be controlled:
            a number, ``auto``, or empty = as before.

    Raises:
        BenchError: it is not an order, or the levels are not a plan.
    """
    unknown = set(order) - {"levels", "window_periods", "harmonics"}
    if unknown:
        raise BenchError(f"A run is not started with '{sorted(unknown)[0][:40]}'.")
    levels, periods = order.get("levels"), order.get("window_periods", 0)
    if not isinstance(levels, str) or len(levels) > 10_000:
        raise BenchError("The levels must be a text such as '0.2:1:5' or '0.2, 0.5, 1'.")
    if not isinstance(periods, int) or isinstance(periods, bool) or not 0 <= periods <= _MOST_PERIODS:
        raise BenchError(f"The periods a window must be a whole number from 0 to {_MOST_PERIODS}.")
    return StartRequest(tuple(parse_levels(levels)), periods, _harmonics(order.get("harmonics", "")))


def _harmonics(text: Any) -> int | None:
    """Number of harmonics from the page's words; BenchError where they are none."""
    words = str(text).strip()[:20]
    if words in ("", "auto"):
        return AUTOMATIC if words else None
    if not words.isdecimal() or not 0 <= int(words) <= MOST_HARMONICS or int(words) == 1:
        raise BenchError(f"The harmonics must be a number from 2 to {MOST_HARMONICS}, 0 for none, or auto.")
    return int(words)


def goal_of(request: StartRequest, before: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of the goal of ``nmt_msgs/RunLevels``.

    Args:
        request: what is asked for.
        before: plan of the run before, as its bag describes it; may be empty.

    Raises:
        BenchError: a level is beyond the limits of the rig, or the run before gave each a frequency of its own.
    """
    goal: dict[str, Any] = {name: before[name] for name in _KEPT if name in before}
    label = before.get("test")
    goal["test"] = int(next((kind for kind in TestKind if kind and kind.label == label), TestKind.PHASE_RESONANCE))
    LevelLimits.of(before).check(request.levels, goal.get("control", 0), TestKind(goal["test"]), "The levels")
    frequencies = list(before.get("frequencies_hz") or ())
    if frequencies and len(set(frequencies)) > 1 and len(frequencies) != len(request.levels):
        raise BenchError(
            f"The run before gave each of its {len(frequencies)} levels a frequency of its own; ask for as many levels."
        )
    if len(set(frequencies)) == 1:
        frequencies = frequencies[:1] * len(request.levels)
    goal.update(levels=list(request.levels), frequencies_hz=frequencies, run_id="")
    if request.window_periods:
        goal["window_periods"] = request.window_periods
    if request.harmonics_control is not None:
        goal["harmonics_control"] = request.harmonics_control
    return goal
