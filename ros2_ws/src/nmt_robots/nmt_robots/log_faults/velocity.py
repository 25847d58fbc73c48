"""Logged speed against the derivative of the logged position: factor, delay, filter, sign, unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.log_faults.finding import Finding
from nmt_robots.mechanics.least_squares import fitted
from nmt_robots.mechanics.motion import Motion
from nmt_robots.thresholds import THRESHOLDS

_ORDINARY_S = 0.002
"""Delay of a speed by an ordinary filter, s."""


def velocity_findings(log: JointLog, motion: Motion) -> list[Finding]:
    """What the speeds of a log say next to its positions."""
    if log.velocity is None:
        return [
            Finding(
                "velocity_missing",
                "No speeds were logged: they follow from the positions, and so does the damping of the control law.",
                fault=False,
            )
        ]
    smooth = motion.smooth(log.velocity)
    names, factors, lags = [], [], []
    for joint, name in enumerate(log.joints):
        if not motion.moves[joint] or np.std(log.velocity[:, joint]) == 0.0:
            continue
        rows = motion.moving[:, joint]
        # A filter of time constant T gives v − T a + T² times the jerk: the last one would else be a factor.
        jerk = motion.smooth(np.gradient(motion.a[:, joint], motion.step_s))
        columns = motion.v[rows, joint], -motion.a[rows, joint], jerk[rows], np.ones(np.count_nonzero(rows))
        fit = fitted(np.column_stack(columns), smooth[rows, joint], np.zeros(4, dtype=bool), motion.blocks[rows])
        names.append(name)
        factors.append((fit.values[0], fit.std[0]))
        lags.append((fit.values[1] / fit.values[0], fit.std[1] / abs(fit.values[0])))
    if not names:
        return []
    quick = float(np.median(np.std(motion.a, axis=0) / np.maximum(np.std(motion.v, axis=0), 1e-300)))
    # What a filter of that lag takes of the amplitude is not a factor.
    taken = min((float(np.median([lag for lag, _ in lags])) * quick) ** 2, 0.2)
    return [*_factors(names, np.array(factors), taken), *_lag(names, np.array(lags), log.step_s)]


def with_right_speeds(log: JointLog, motion: Motion) -> JointLog:
    """The log with speeds of a wrong sign or unit put right; factors near one stay as they are."""
    if log.velocity is None:
        return log
    gains = np.sum(log.velocity * motion.v, axis=0) / np.maximum(np.sum(motion.v**2, axis=0), 1e-300)
    wrong = motion.moves & ((gains < -0.5) | (np.abs(gains) > 3.0) | ((np.abs(gains) < 1.0 / 3.0) & (gains != 0.0)))
    wrong &= np.std(log.velocity, axis=0) > 0.0
    return replace(log, velocity=log.velocity / np.where(wrong, gains, 1.0))


def _factors(names: list[str], factors: Array, taken: float) -> list[Finding]:
    """Speeds with a factor, beyond what their filter takes."""
    limit = THRESHOLDS.velocity_gain + taken
    middle = float(np.median(factors[:, 0]))
    if middle < 0.0 and np.all(factors[:, 0] < 0.0):
        return [
            Finding("velocity_sign", "All speeds have the sign opposite to that of the positions.", middle, 0.0, "1")
        ]
    found = []
    shared = len(names) > 2 and abs(middle - 1.0) > limit
    spread = float(np.median(np.abs(factors[:, 0] - middle)))
    if shared and spread < abs(middle - 1.0) / 3.0:
        std = 1.4826 * spread / np.sqrt(len(names))
        found.append(
            Finding(
                "clock_factor",
                f"All speeds are {middle:.4f} ± {std:.4f} of those by positions and clock: "
                f"{_factor_of(middle)}, or the clock runs at another rate than stated.",
                middle, std, "1",
            )
        )  # fmt: skip
    else:
        middle = 1.0
    for name, (factor, std) in zip(names, factors, strict=True):
        off = factor / middle - 1.0
        if abs(off) > limit and abs(off) > THRESHOLDS.certain * std:
            words = _factor_of(factor)
            clock = len(names) == 1 and words == _NEAR_ONE
            if clock:
                words += ", or the clock runs at another rate than stated: a second joint tells the two apart"
            found.append(
                Finding(
                    "velocity_factor",
                    f"{name}: its speed is {factor:.3f} ± {std:.3f} of the derivative of its position: {words}.",
                    float(factor), float(std), "1", joints=(name,), instead=("clock_factor",) if clock else (),
                )
            )  # fmt: skip
    return found


def _factor_of(factor: float) -> str:
    """What a factor may be."""
    if factor < 0.0:
        return "one of the two has the opposite sign"
    if abs(factor * np.pi / 180.0 - 1.0) < 0.05 or abs(factor * 180.0 / np.pi - 1.0) < 0.05:
        return "one of the two is in degrees"
    if factor > 3.0 or factor < 1.0 / 3.0:
        return "one of the two is on the other side of the gear, or in another unit"
    return _NEAR_ONE


_NEAR_ONE = "a wrong factor or a transmission that is not at constant ratio"


def _lag(names: list[str], lags: Array, step_s: float) -> list[Finding]:
    """Speeds that are late."""
    middle = float(np.median(lags[:, 0]))
    scatter = 1.4826 * float(np.median(np.abs(lags[:, 0] - middle)))
    std = float(np.hypot(scatter, np.median(lags[:, 1])) / np.sqrt(len(names)))
    if abs(middle) < max(THRESHOLDS.lag_s, 0.2 * step_s) or abs(middle) < THRESHOLDS.certain * std:
        return []
    words = "late, as a filter or an estimate by differences makes it" if middle > 0.0 else "early"
    return [
        Finding(
            "velocity_late",
            f"The logged speeds are {1e3 * abs(middle):.2g} ± {1e3 * std:.1g} ms {words} against the positions.",
            middle, std, "s", fault=not 0.0 < middle < 1.5 * _ORDINARY_S,
        )
    ]  # fmt: skip
