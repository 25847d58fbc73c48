"""Clock and rows of a log: invented or jittering time, rows repeated or left out, joints that stand still."""

from __future__ import annotations

import numpy as np

from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.log_faults.finding import Finding
from nmt_robots.log_faults.repair import alternation, stale_rows
from nmt_robots.mechanics.motion import Motion
from nmt_robots.mechanics.readings import changes_of
from nmt_robots.thresholds import THRESHOLDS

_EVEN = 1e-3
_JITTER = 0.05


def row_findings(log: JointLog, motion: Motion) -> list[Finding]:
    """All findings on clock and rows."""
    found = [*_stamps(log), *_repeated(log, motion), *_spacing(log, motion), *_command(log), *_still(log, motion)]
    return [finding for finding in found if finding is not None]


def _stamps(log: JointLog) -> list[Finding]:
    """What the time column itself says."""
    steps = np.diff(log.time)
    middle = float(np.median(steps))
    rounding = float(np.spacing(np.float32(max(abs(log.time[-1]), 1.0))))
    gaps = int(np.sum(np.rint(steps[steps > 1.5 * middle] / middle) - 1)) if middle > 0.0 else 0
    found = []
    if float(np.max(np.abs(steps - middle))) <= max(_EVEN * middle, 2.0 * rounding):
        found.append(
            Finding(
                "even_clock",
                f"The time column is exactly even ({1e3 * middle:.4g} ms): it was computed and says nothing of when "
                "the rows were measured.",
                middle, 0.0, "s", fault=False,
            )
        )  # fmt: skip
    elif float(np.std(steps)) > _JITTER * middle:
        found.append(
            Finding(
                "uneven_clock",
                f"The time column is uneven by {1e3 * float(np.std(steps)):.2g} ms about {1e3 * middle:.4g} ms.",
                float(np.std(steps)), float(np.std(steps)) / np.sqrt(2 * len(steps)), "s",
            )
        )  # fmt: skip
    if gaps:
        found.append(Finding("rows_missing", f"{gaps} rows are missing by the time column.", gaps, 0.0, "rows"))
    return found


def _repeated(log: JointLog, motion: Motion) -> list[Finding]:
    """Rows that are those before them once more although joints move."""
    stale = len(stale_rows(log, motion.moving))
    share = stale / max(float(np.count_nonzero(np.any(motion.moving[1:], axis=1))), 1.0)
    if share < 0.002:
        return []
    std = float(np.sqrt(share * max(1.0 - share, 0.0) / log.rows))
    return [
        Finding(
            "rows_repeated",
            f"{100 * share:.1f} % of the rows in motion repeat the row before in every joint: the log runs faster than "
            "the robot reports.",
            share, std, "share of rows",
        )
    ]  # fmt: skip


def _spacing(log: JointLog, motion: Motion) -> list[Finding]:
    """Time between rows by the motion itself: steps of position over speed, from two disjoint groups of joints."""
    if log.velocity is None:
        return []
    movers = np.flatnonzero(motion.moves & (np.std(log.velocity, axis=0) > 0.0))
    if len(movers) < 2:
        return _alternating(log)
    estimates = [_step_by_motion(log, motion, movers[side::2]) for side in (0, 1)]
    both = np.isfinite(estimates[0]) & np.isfinite(estimates[1])
    if np.count_nonzero(both) < 100:
        return []
    first, second = (estimate[both] - np.median(estimate[both]) for estimate in estimates)
    limits = [np.quantile(np.abs(side), 0.98) for side in (first, second)]
    kept = (np.abs(first) < limits[0]) & (np.abs(second) < limits[1])
    covariance = first[kept] * second[kept]
    size = float(np.mean(covariance))
    certain = size > 5.0 * float(np.std(covariance)) / np.sqrt(np.count_nonzero(kept))
    jitter = float(np.sqrt(max(size, 0.0)))
    if not certain or jitter < _JITTER * log.step_s:
        return []
    std = float(np.std(covariance)) / np.sqrt(np.count_nonzero(kept)) / (2.0 * jitter)
    return [
        Finding(
            "hidden_jitter",
            f"Rows are {1e3 * jitter:.2g} ms (rms) off the even clock of {1e3 * log.step_s:.4g} ms: two disjoint "
            "groups of joints agree on which rows are closer together.",
            jitter, std, "s",
        )
    ]  # fmt: skip


def _alternating(log: JointLog) -> list[Finding]:
    """Rows that are closer together and farther apart in turn, which one joint alone can tell."""
    apart, std = alternation(log)
    if not apart:
        return []
    apart = abs(apart)
    step = 1e3 * log.step_s
    return [
        Finding(
            "hidden_jitter",
            f"Rows are {(1 - apart) * step:.3g} and {(1 + apart) * step:.3g} ms apart in turn beneath the even clock "
            "of the time column.",
            apart * log.step_s, std * log.step_s, "s",
        )
    ]  # fmt: skip


def _step_by_motion(log: JointLog, motion: Motion, joints: Array) -> Array:
    """Time between rows by Σ v Δq / Σ v² over some joints; NaN where they are too slow to tell."""
    assert log.velocity is not None
    # The smooth motion stands for the speed: a logged one has its own filter.
    speed = 0.5 * (motion.v[1:, joints] + motion.v[:-1, joints])
    steps = np.diff(log.position[:, joints], axis=0)
    weight = np.sum(speed**2, axis=1)
    enough = weight > 0.25 * float(np.mean(weight))
    result = np.full(len(weight), np.nan)
    result[enough] = np.sum(speed * steps, axis=1)[enough] / weight[enough]
    return result


def _command(log: JointLog) -> list[Finding]:
    """Whether the command is held over rows."""
    if log.position_command is None:
        return []
    rows = changes_of(log.position_command)
    if len(rows) < 10:
        return []
    apart = np.diff(rows[1:])
    active = apart[apart < 10 * np.median(apart)]
    mean = float(np.mean(active))
    if mean < THRESHOLDS.held_rows:
        return []
    low, high = (int(x) for x in np.quantile(active, (0.01, 0.99)))
    every = f"every {low} to {high} rows" if high > low else f"every {low} rows"
    return [
        Finding(
            "command_held",
            f"The command changes {every} only (on average {mean:.2g} rows, {1e3 * mean * log.step_s:.3g} ms): whether "
            "the drives held or smoothed it in between is asked of all joints together.",
            mean, float(np.std(active)) / np.sqrt(len(active)), "rows",
        )
    ]  # fmt: skip


def _still(log: JointLog, motion: Motion) -> list[Finding]:
    """Joints that do not move, and speeds that were not logged."""
    found = []
    still = tuple(name for name, moves in zip(log.joints, motion.moves, strict=True) if not moves)
    if still:
        found.append(
            Finding("still", f"{', '.join(still)}: moves in too few rows to be judged.", joints=still, fault=False)
        )
    if log.velocity is not None:
        silent = tuple(
            name
            for name, moves, velocity in zip(log.joints, motion.moves, log.velocity.T, strict=True)
            if moves and np.std(velocity) == 0.0
        )
        if silent:
            found.append(
                Finding("no_velocity", f"{', '.join(silent)}: moves, but its logged speed is always the same; the "
                        "damping of its control law is not in the computed torque.", joints=silent)
            )  # fmt: skip
    return found
