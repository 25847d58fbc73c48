"""Smoothed motion of a log and the torque that its rigid bodies need.

Torque and columns pass the same filter, so smoothing takes nothing from one side that it leaves on the other: the
motion is smoothed once and what is computed of it once more, the torque of the drives twice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.ndimage import convolve1d, maximum_filter1d

from nmt_core.numerics.kernels import njit
from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.thresholds import THRESHOLDS

_ROWS = 11
_SPAN_S = 0.02
_LONGEST_S = 0.13
_ROUGH = 0.25


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of J joints on an even grid of N rows.

    Attributes:
        step_s: between rows.
        window: rows of the filter, odd.
        q, v, a: N × J, smoothed once; differences of the position.
        rigid: N × J, N·m: torque of the rigid bodies at that motion, smoothed once more.
        gravity: N × J, N·m: the same at rest.
        position: N × J, as it was logged, for what depends on the path through reversals that smoothing rounds.
        moving: N × J; rows in which a joint is fast enough not to stick.
        blocks: N; number of the second that a row belongs to.
        of_links: for each joint N × J, N·m: torque that the mass of its link takes, smoothed as ``rigid``.
    """

    step_s: float
    window: int
    q: Array
    v: Array
    a: Array
    rigid: Array
    gravity: Array
    position: Array
    moving: Array
    blocks: Array
    of_links: tuple[Array, ...] = ()

    def smooth(self, values: Array) -> Array:
        """What the filter leaves of values that were computed of the motion, N or N × J."""
        return smoothed(values, self.window)

    def smooth_twice(self, values: Array) -> Array:
        """The same of values that were logged."""
        return self.smooth(self.smooth(values))

    @property
    def moves(self) -> Array:
        """J: whether a joint moves in enough rows to be judged."""
        return np.asarray(np.mean(self.moving, axis=0) >= THRESHOLDS.moving_rows)


def smoothed(values: Array, window: int) -> Array:
    """Local parabolas over ``window`` rows; those at the ends are evaluated up to the last row."""
    middle, ends = _parabolas(window)
    half = window // 2
    result: Array = convolve1d(values, middle, axis=0, mode="nearest")
    result[:half] = np.tensordot(ends, values[:window], 1)
    result[-half:] = np.tensordot(ends[::-1, ::-1], values[-window:], 1)
    return result


@njit(cache=True)
def built_up(position: Array, reach: float) -> Array:
    """Rows × J: friction of size one that builds up over an angle, whichever way a joint turns (Prandtl's element)."""
    found = np.zeros_like(position)
    for joint in range(position.shape[1]):
        held = 0.0
        for row in range(1, len(position)):
            held = min(max(held + (position[row, joint] - position[row - 1, joint]) / reach, -1.0), 1.0)
            found[row, joint] = held
    return found


@cache
def _parabolas(window: int) -> tuple[Array, Array]:
    """Weights of the rows of a window: for its middle, (window,), and for its first half, (half, window)."""
    powers = np.vander(np.linspace(-1.0, 1.0, window), 3)
    weights = powers @ np.linalg.pinv(powers)
    half = window // 2
    return weights[half], weights[:half]


def window_of(step_s: float) -> int:
    """Rows of the filter: at least 11 and 20 ms, odd."""
    return max(_ROWS, round(_SPAN_S / step_s) | 1)


def motion_of(model: RobotModel, log: JointLog) -> Motion:
    """The motion of a log, and what it asks of the rigid bodies."""
    step, window = log.step_s, window_of(log.step_s)
    q, v, a = _derived(log.position, step, window)
    # A coarse encoder makes more acceleration than the motion has: then the filter is longer, up to its limit.
    while 2 * window + 1 <= _LONGEST_S / step and _roughness(a, window) > _ROUGH:
        window = round(1.4 * window) | 1
        q, v, a = _derived(log.position, step, window)
    still = np.zeros_like(q)
    moving = np.abs(v) > THRESHOLDS.sticking_rad_s
    edge = window // 2
    # What lies within half a window of a reversal has been smoothed over it.
    turned = np.zeros_like(moving)
    turned[1:] = np.sign(v[1:]) != np.sign(v[:-1])
    moving &= ~maximum_filter1d(turned, window, axis=0)
    moving[:edge] = False
    moving[len(moving) - edge :] = False
    return Motion(
        step, window, q, v, a, smoothed(model.torque(log.joints, q, v, a), window),
        smoothed(model.torque(log.joints, q, still, still), window), log.position, moving,
        np.floor(np.arange(len(q)) * step).astype(int),
    )  # fmt: skip


def _derived(position: Array, step: float, window: int) -> tuple[Array, Array, Array]:
    """Smoothed position, speed and acceleration."""
    q = smoothed(position, window)
    v: Array = np.gradient(q, step, axis=0)
    a: Array = np.empty_like(q)
    a[1:-1] = (q[2:] - 2.0 * q[1:-1] + q[:-2]) / step**2
    a[[0, -1]] = a[[1, -2]]
    return q, v, a


def _roughness(a: Array, window: int) -> float:
    """Share of the accelerations that one more filter takes away, largest over the joints that move at all."""
    size = np.std(a, axis=0)
    moving = size > 0.05 * float(np.max(size))
    return float(np.max((np.std(a - smoothed(a, window), axis=0) / np.maximum(size, 1e-300))[moving]))


def with_bodies(model: RobotModel, log: JointLog, motion: Motion) -> Motion:
    """The same motion with the torque that other bodies need."""
    still = np.zeros_like(motion.q)
    rigid, gravity = (
        motion.smooth(model.torque(log.joints, motion.q, *moved)) for moved in ((motion.v, motion.a), (still, still))
    )
    return replace(motion, rigid=rigid, gravity=gravity)


def with_link_masses(model: RobotModel, log: JointLog, motion: Motion) -> Motion:
    """The motion with what the mass of each joint's link takes of all torques."""
    plain = model.torque(log.joints, motion.q, motion.v, motion.a)
    parts = (model.torque(log.joints, motion.q, motion.v, motion.a, heavier=name) - plain for name in log.joints)
    return replace(motion, of_links=tuple(motion.smooth(part) for part in parts))


def with_yielding_base(model: RobotModel, log: JointLog, motion: Motion) -> Motion:
    """The same motion on a base that is pushed away by the limbs."""
    rigid = model.torque(log.joints, motion.q, motion.v, motion.a, yielding=True)
    return replace(motion, rigid=motion.smooth(rigid))
