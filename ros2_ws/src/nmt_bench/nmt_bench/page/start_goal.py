"""The goal of a run that is started from the page: the run before with other levels; free of ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from nmt_bench.page.bench_link import StartRequest
from nmt_core.errors import BenchError
from nmt_core.messages.excitation import MOST_HARMONICS
from nmt_core.messages.run_settings import RunSettings
from nmt_core.vocabulary import AUTOMATIC
from nmt_sequencer.level_plan import LevelLimits, parse_levels

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
    asked = RunSettings.described(before)
    LevelLimits.of(before).check(request.levels, asked.control, asked.excitation.test, "The levels")
    frequencies = asked.frequencies_hz
    if len(set(frequencies)) > 1 and len(frequencies) != len(request.levels):
        raise BenchError(
            f"The run before gave each of its {len(frequencies)} levels a frequency of its own; ask for as many levels."
        )
    if len(set(frequencies)) == 1:
        frequencies = frequencies[:1] * len(request.levels)
    excitation = asked.excitation
    if request.harmonics_control is not None:
        excitation = replace(excitation, harmonics_control=request.harmonics_control)
    return replace(
        asked,
        run_id="",
        levels=request.levels,
        frequencies_hz=frequencies,
        levels_without=frozenset(),
        window_periods=request.window_periods or asked.window_periods,
        excitation=excitation,
    ).goal
