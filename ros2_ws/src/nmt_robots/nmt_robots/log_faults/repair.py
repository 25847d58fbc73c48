"""Rows, clock and units that can be put right: turns, degrees, repeated and missing rows, a clock that is not even.

What is wrong is found by :mod:`nmt_robots.log_faults.rows` and its neighbours on the log as it is; here it is mended,
so that the mechanics do not pay for it. All that follows is computed of the mended log, on an even clock.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d

from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.log_faults.finding import Finding
from nmt_robots.mechanics.motion import smoothed, window_of
from nmt_robots.mechanics.readings import held_time
from nmt_robots.model.robot_model import Joint
from nmt_robots.thresholds import THRESHOLDS

_FIELDS = ("position", "velocity", "position_command", "velocity_command", "torque_command", "torque")
_COMMANDS = ("position_command", "velocity_command", "torque_command")
_DRIFT_ROWS = 101
_STRETCHES = 20
"""Of a log, whose scatter says how certain an alternating clock is."""
_ALTERNATES = 0.05
"""Of a step, from which rows that are closer together in turn are a fault."""
_GAPS = 0.01
_WHOLE = 0.2
"""Of a row: a step that is so near to a whole number of rows is one."""


def unwrapped(log: JointLog, joints: tuple[Joint, ...]) -> tuple[JointLog, list[Finding]]:
    """The log with turns joined where angles jump by one, and the finding."""
    jumps = np.max(np.abs(np.diff(log.position, axis=0)), axis=0)
    turns = np.array([joint.turns for joint in joints])
    wrapped = np.flatnonzero(turns & (np.abs(jumps - 2.0 * np.pi) < 0.5))
    if not len(wrapped):
        return log, []
    position = log.position.copy()
    command = None if log.position_command is None else log.position_command.copy()
    for number in wrapped:
        position[:, number] = np.unwrap(position[:, number])
        joint = joints[number]
        if np.isfinite(joint.lower + joint.upper):
            away = float(np.median(position[:, number])) - 0.5 * (joint.lower + joint.upper)
            position[:, number] -= 2.0 * np.pi * np.round(away / (2.0 * np.pi))
        if command is not None:
            turned = command[:, number] - position[:, number]
            command[:, number] -= 2.0 * np.pi * np.round(turned / (2.0 * np.pi))
    names = tuple(joints[number].name for number in wrapped)
    sentence = f"Angles jump by a whole turn: {', '.join(names)}; they are read as going on."
    return replace(log, position=position, position_command=command), [Finding("wrap", sentence, joints=names)]


def in_radians(log: JointLog, joints: tuple[Joint, ...]) -> tuple[JointLog, list[Finding]]:
    """The log with angles in rad where they can only be degrees, and the finding."""
    turns = np.array([joint.turns for joint in joints])
    lower = np.array([joint.lower for joint in joints])
    upper = np.array([joint.upper for joint in joints])
    low, high = np.min(log.position, axis=0), np.max(log.position, axis=0)
    largest = np.maximum(np.abs(low), np.abs(high))
    beyond = turns & (largest > 4.0 * np.pi) & ((low < lower - 1.0) | (high > upper + 1.0) | ~np.isfinite(upper))
    in_degrees = (np.radians(low) > lower - 0.2) & (np.radians(high) < upper + 0.2)
    if not np.any(beyond) or not np.all(in_degrees[turns]):
        return log, []
    factor = np.where(turns, np.pi / 180.0, 1.0)
    changed = replace(
        log,
        position=log.position * factor,
        position_command=None if log.position_command is None else log.position_command * factor,
    )
    if log.velocity is not None:
        rate = np.gradient(smoothed(log.position, window_of(log.step_s)), log.step_s, axis=0)[:, turns]
        gain = float(np.sum(log.velocity[:, turns] * rate) / max(float(np.sum(rate**2)), 1e-300))
        if abs(gain) > 0.2:
            speed_command = None if log.velocity_command is None else log.velocity_command * factor
            changed = replace(changed, velocity=log.velocity * factor, velocity_command=speed_command)
    names = tuple(joint.name for joint in joints if joint.turns)
    sentence = "Angles are degrees where radians are stated: they fit the joints' ranges only so, and are read so."
    return changed, [Finding("degrees", sentence, joints=names)]


def stale_rows(log: JointLog, moving: Array) -> Array:
    """Rows that are the one before once more in every joint, although one moves farther than its encoder's step."""
    steps = np.abs(np.diff(log.position, axis=0))
    same = np.all(steps == 0.0, axis=1)
    if log.velocity is not None:
        same &= np.all(np.diff(log.velocity, axis=0) == 0.0, axis=1)
        return np.flatnonzero(same & np.any(moving[1:], axis=1)) + 1
    quantum = np.array([np.min(column[column > 0.0]) if np.any(column > 0.0) else np.inf for column in steps.T])
    rate = np.abs(np.diff(smoothed(log.position, window_of(log.step_s)), axis=0))
    return np.flatnonzero(same & np.any(rate > 3.0 * quantum, axis=1)) + 1


def with_fresh_rows(log: JointLog, stale: Array) -> JointLog:
    """The log with stale rows filled in from their neighbours."""
    fresh = np.setdiff1d(np.arange(log.rows), stale)
    if not len(stale) or len(fresh) < 10:
        return log
    time = np.maximum.accumulate(log.time)
    rising = fresh[np.r_[True, np.diff(time[fresh]) > 0.0]]
    changed: dict[str, Any] = {
        name: _between(time[rising], values[rising], time, held=False)
        for name in ("position", "velocity", "torque")
        if (values := getattr(log, name)) is not None
    }
    return replace(log, **changed)


def _between(at: Array, values: Array, wanted: Array, held: bool) -> Array:
    """Values between rows: on a smooth curve, or as they were last."""
    if held:
        return np.asarray(values[np.clip(np.searchsorted(at, wanted + 1e-9, side="right") - 1, 0, len(at) - 1)])
    return np.asarray(CubicSpline(at, values, axis=0)(np.clip(wanted, at[0], at[-1])))


def on_even_clock(log: JointLog, time: Array) -> JointLog:
    """The log at even steps of another time of its rows, N, s."""
    mean, step = float(time[-1] - time[0]) / (len(time) - 1), 0.5 * float(np.median(time[2:] - time[:-2]))
    # Only gaps make the steps longer on the mean.
    step = mean if abs(mean / step - 1.0) < _GAPS else step
    increasing = np.r_[True, np.diff(np.maximum.accumulate(time)) > 0.05 * step]
    at = time[increasing]
    even = np.arange(at[0], at[-1], step)
    # A command that changes with the rows moves between them, too.
    held = held_time(log) >= THRESHOLDS.held_rows * log.step_s
    changed: dict[str, Any] = {
        name: _between(at, values[increasing], even, held and name in _COMMANDS)
        for name in _FIELDS
        if (values := getattr(log, name)) is not None
    }
    return replace(log, time=even - even[0], **changed)


def steps_by_motion(log: JointLog) -> tuple[Array, Array]:
    """Steps between rows by how far the joints went at the logged speed, and their standard uncertainty; N − 1 each.

    In units of the mean step; where no joint is fast enough the uncertainty is infinite.
    """
    if log.velocity is None:
        return np.ones(log.rows - 1), np.full(log.rows - 1, np.inf)
    speed = 0.5 * (log.velocity[1:] + log.velocity[:-1])
    moved = np.diff(log.position, axis=0)
    gain = np.sum(speed * moved, axis=0) / np.maximum(np.sum(speed**2, axis=0), 1e-300) / log.step_s
    usable = np.abs(gain - 1.0) < 0.25
    if not np.any(usable):
        return np.ones(log.rows - 1), np.full(log.rows - 1, np.inf)
    speed, moved = speed[:, usable], moved[:, usable]
    noise = np.maximum(_noise(log.position[:, usable]), 1e-9)
    weight = np.sum((speed / noise) ** 2, axis=1)
    steps = np.sum(speed * moved / noise**2, axis=1) / np.maximum(weight, 1e-300) / log.step_s
    return steps, np.where(weight > 0.0, np.sqrt(2.0 / np.maximum(weight, 1e-300)) / log.step_s, np.inf)


def _noise(position: Array) -> Array:
    """J: standard deviation of the noise of positions, quantised or not, by their third differences."""
    third = np.abs(np.diff(position, 3, axis=0))
    quantised = np.array([np.mean(column == 0.0) > 0.3 for column in third.T])
    steps = np.array([np.min(column[column > 0.0]) if np.any(column > 0.0) else 0.0 for column in third.T])
    noise: Array = np.where(quantised, steps / np.sqrt(12.0), np.median(third, axis=0) / (0.6745 * np.sqrt(20.0)))
    return noise


def alternation(log: JointLog) -> tuple[float, float]:
    """By what share of a step rows are farther apart and closer together in turn, and its standard uncertainty.

    Σ ± v Δq over Σ v Δq of stretches of the log: single rows need not tell, and a noise of the position adds nothing.
    Zero where it is small or not certain.
    """
    nothing = 0.0, float("nan")
    if log.velocity is None:
        return nothing
    moved = np.sum(0.5 * (log.velocity[1:] + log.velocity[:-1]) * np.diff(log.position, axis=0), axis=1)
    rows = len(moved) // _STRETCHES // 2 * 2
    if rows < 50:
        return nothing
    each = moved[: rows * _STRETCHES].reshape(_STRETCHES, rows)
    sides = np.array([np.sum(each[:, ::2], axis=1), np.sum(each[:, 1::2], axis=1)])
    way = np.sum(sides, axis=0)
    going = way > 0.1 * float(np.mean(way))
    if np.count_nonzero(going) < 3:
        return nothing
    shares = ((sides[0] - sides[1]) / np.where(going, way, 1.0))[going]
    apart, std = float(np.mean(shares)), float(np.std(shares, ddof=1) / np.sqrt(len(shares)))
    return (apart, std) if abs(apart) > max(_ALTERNATES, 5.0 * std) else nothing


def time_with_missing_rows(log: JointLog) -> tuple[Array, int]:
    """Time of the rows where some between them are missing on a clock that hides it, and how many; 0 = none."""
    steps, std = steps_by_motion(log)
    certain = std < 0.1
    if np.count_nonzero(certain) < 100:
        return log.time, 0
    # The mean step is too long by the rows that are missing.
    steps = steps / float(np.median(steps[certain]))
    number = np.maximum(np.rint(steps), 1.0)
    near_whole = np.abs(steps - number) < _WHOLE
    more = certain & (number > 1.0)
    share = float(np.mean(more[certain]))
    if float(np.mean(near_whole[certain])) < 0.95 or not 0.003 < share < 0.4:
        return log.time, 0
    number[~certain] = 1.0
    return np.r_[0.0, np.cumsum(number)] * log.step_s, int(np.sum(number - 1.0))


def time_by_motion(log: JointLog) -> Array:
    """Time of rows that are off an even clock, N, s; without the drift of the estimate."""
    apart = alternation(log)[0]
    if apart:
        off = np.where(np.arange(log.rows) % 2, 0.5 * apart, -0.5 * apart)
    else:
        steps, std = steps_by_motion(log)
        steps = np.where(std < 0.3, np.clip(steps, 0.0, 3.0), 1.0)
        off = np.r_[0.0, np.cumsum(steps - 1.0)]
        off -= uniform_filter1d(off, _DRIFT_ROWS)
        off[np.r_[std, np.inf] > 0.3] = 0.0
    time: Array = (np.arange(log.rows) + off) * log.step_s
    return time


def stamps_agree(log: JointLog) -> bool:
    """Whether the motion follows the uneven time column rather than an even clock."""
    steps, std = steps_by_motion(log)
    certain = std < 0.3
    if np.count_nonzero(certain) < 50:
        return True
    stamped = np.diff(log.time)[certain] / log.step_s
    return float(np.mean((steps[certain] - stamped) ** 2)) < float(np.mean((steps[certain] - 1.0) ** 2))
