"""Observables of imported stepped sines and of response curves: responses over the measured force of each line.

The model takes every line at its measured amplitude, which has one solution on whatever branch. So the points of a
response curve are lines as those of stepped sines are, the unstable ones too. They stay in the order in which they were
measured, along the curve, which has no jump.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows.locked_window import LockedWindow, analyse_window
from nmt_diagnose.measurements.stepped_responses.stepped_responses import SteppedResponses
from nmt_diagnose.measurements.stepped_responses.table_reading import jump_note, jumps_of
from nmt_diagnose.observations.bag_windows import BagWindows, Window
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import Observations, Part, Place, RowTable, empty, joined
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.thresholds import THRESHOLDS

_WAYS = {1: " up", -1: " down", 0: ""}


def stepped_sine_observations(name: str, windows: Sequence[Window], bag: BagWindows) -> Observations:
    """Observables of stepped-sine windows: a test for each level and direction, of response curves for each curve.

    The level of a line is its measured force, whatever was held. Lines of stepped sines on both sides of a jump are
    left out.

    Args:
        name: of the tests.
        windows: the windows and their samples, in time.
        bag: they are of.
    """
    notes: list[str] = []
    analysed: list[LockedWindow] = []
    for window in windows:
        try:
            analysed.append(analyse_window(window.segment, window.stretch, bag.settings, bag.view))
        except BenchError as error:
            notes.append(f"{name}: {error}")
    parts = []
    groups = _groups(analysed)
    for number, group in enumerate(groups):
        direction = 0 if _is_curve(group[0]) else _direction(group)
        test_name = name
        if len(groups) > 1:
            level = group[0].segment.level
            text = f" at {level:g} {group[0].segment.level_unit}" if math.isfinite(level) else f" {number + 1}"
            test_name = f"{name}{text}{_WAYS[direction]}"
        if len(group) < THRESHOLDS.reading.stepped_fewest_lines:
            notes.append(
                f"{test_name}: {len(group)} lines are no frequency response; measure "
                f"{THRESHOLDS.reading.stepped_fewest_lines} or more."
            )
            continue
        parts.append(_one(test_name, group, direction, bag.view, bag.channels, bag.settings))
    return joined([empty(notes), *parts])


def _groups(windows: Sequence[LockedWindow]) -> list[list[LockedWindow]]:
    """Windows of one level and one direction of the frequency, in time."""
    result: list[list[LockedWindow]] = []
    for window in windows:
        last = result[-1] if result else []
        same = bool(last) and _level(window) == _level(last[-1])
        if same and len(last) > 1 and not _is_curve(window):
            turn = (window.frequency_hz - last[-1].frequency_hz) * (last[1].frequency_hz - last[0].frequency_hz)
            same = turn > 0.0
        if same:
            last.append(window)
        else:
            result.append([window])
    return result


def _level(window: LockedWindow) -> float | None:
    level = window.segment.level
    return float(f"{level:.3g}") if math.isfinite(level) else None


def _is_curve(window: LockedWindow) -> bool:
    return window.segment.kind is TestKind.RESPONSE_CURVE


def _direction(group: Sequence[LockedWindow]) -> int:
    return 1 if group[-1].frequency_hz >= group[0].frequency_hz else -1


def _one(
    name: str,
    group: Sequence[LockedWindow],
    direction: int,
    view: ModelView,
    channels: dict[str, MeasuredChannel],
    settings: ObservationSettings,
) -> Observations:
    force = group[0].stretch.find(Quantity.FORCE)
    assert force is not None
    curve = direction == 0
    order = list(group) if curve else sorted(group, key=lambda window: window.frequency_hz)
    common = [k for k, c in channels.items() if c.quantity in MOTIONS and all(k in window.rows for window in order)]
    if not common:
        return empty((f"{name}: no response channel is usable in all windows; left out.",))
    # The channel that moves most in its own noise says how large the motion was.
    found = {key: _responses(order, key, force.name) for key in common}
    common.sort(key=lambda key: float(np.median(found[key][1])))
    kept = np.all([std <= settings.largest_std for _, std in found.values()], axis=0)
    notes = []
    for first, last in () if curve else jumps_of(found[common[0]][0]):
        kept[first : last + 1] = False
        notes.append(jump_note(name, order[first].frequency_hz, order[last].frequency_hz))
    lines = np.flatnonzero(kept)
    if lines.size < THRESHOLDS.reading.stepped_fewest_lines:
        return empty((*notes, f"{name}: left out: {lines.size} of its lines can be used."))
    frequency = np.array([order[k].frequency_hz for k in lines])
    level = np.array([abs(order[k].amplitudes[order[k].row(force.name), 1]) for k in lines])
    floor = settings.floors.stepped
    rows = RowTable()
    for number, k in enumerate(lines):
        window = order[k]
        middle = (window.segment.usable_first_sample + 0.5 * window.segment.usable_samples) / window.stretch.sample_rate
        place = Place(number, middle, window.frequency_hz, float(level[number]))
        for channel, key in enumerate(common):
            response, std = found[key]
            rows.add(Part.LOG_MAGNITUDE, math.log(abs(response[k])), float(std[k]), floor, place, channel, 1)
            rows.add(Part.PHASE, float(np.angle(response[k])), float(std[k]), floor, place, channel, 1)
    test = SteppedResponses(
        name=name,
        drive_point=view.rig.drive_point,
        channels=tuple(channels[key] for key in common),
        reference="force",
        held="force" if not curve or group[0].segment.level_unit == "N" else "response",
        lines_hz=frequency,
        levels=level,
        measured=np.column_stack([found[key][0][lines] for key in common]),
        noise=np.hypot(found[common[0]][1][lines], floor),
        direction=direction,
    )
    return rows.observations(test, notes)


def _responses(windows: Sequence[LockedWindow], channel: str, force: str) -> tuple[ComplexArray, FloatArray]:
    """Fundamental over that of the force in each window, and its relative standard uncertainty (jackknife)."""
    responses, deviations = [], []
    for window in windows:
        row, below = window.row(channel), window.row(force)
        responses.append(window.amplitudes[row, 1] / window.amplitudes[below, 1])
        without = np.log(window.without[:, row, 1] / window.without[:, below, 1] / responses[-1])
        count = without.size
        spread = without - without.mean()
        variance = (count - 1) / count * float(np.sum(np.abs(spread) ** 2))
        deviations.append(math.sqrt(0.5 * variance))
    return np.array(responses), np.array(deviations)
