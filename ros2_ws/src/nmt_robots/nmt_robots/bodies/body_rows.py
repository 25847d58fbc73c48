"""Torque of all joints as rows of inertial parameters, thinned and whitened.

Position passes a low-pass without a lag, speed and acceleration are its differences. All columns and the torque pass a
second one, so that it takes nothing from one side that it leaves on the other; then one row in 50 ms is kept. What a
free fit leaves of rows that it has not been fitted to says how neighbouring rows and joints depend on each other:
an autoregression for each joint and the covariance of its innovations over the joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.signal import butter, sosfiltfilt

from nmt_robots.log.joint_log import Array
from nmt_robots.mechanics.motion import built_up
from nmt_robots.model.links import LinkMotion, RobotLink
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.thresholds import THRESHOLDS

_MOTION_HZ, _TORQUE_HZ, _ORDER = 20.0, 8.0, 4
_APART_S = 0.05
_FINEST_S = 0.002
_CREEP_RAD = 0.002
"""Angle over which friction builds up after a reversal."""
_STICK = 0.003
_FRICTION = 0.3
"""Prior standard deviation of friction, as a share of a joint's torque; what it may be is asked of each joint later."""
CONSTANT = 0.10
"""Prior standard deviation of a drive's constant that may be wrong, as a share."""
TILT = np.radians(5.0)
"""The same of a base that may lean, rad."""
UNSEEN = THRESHOLDS.smallest_share
"""Share of a joint's torque below which a log does not tell a change of the bodies."""
_LATE_S = 0.002
_LAGS = 3
_MOST_MEMORY = 0.8
_NOISE_FLOOR = 0.002
_AS_UNCERTAIN = 0.01
"""Of a joint's torque: error of a row in the fit whose errors on other rows are looked at."""
_KINDS = ("sticking", "creeping", "viscous", "armature", "offset", "late")
_RIPPLES = tuple(range(3, 13))
"""Waves in a turn of a joint that its gear or motor may add: slow enough to pass for gravity, not gravity's own."""
_RIPPLE = 0.005
"""Prior standard deviation of a sine or cosine of them, as a share of a joint's torque."""


@dataclass(frozen=True, eq=False)
class BodyRows:
    """Rows of J joints and the columns of L links.

    Attributes:
        links: L.
        gravity: 3, m/s²; two directions across it are those of a tilt.
        left: N × J, torque that the file's bodies and friction leave over, N·m.
        size: J, rms of the torque, N·m.
        columns: N × J × P: ten of each link, two of a tilt (per rad), one of each joint's drive (per share), and of
            what no body is, a spring at each joint.
        nuisances: N × J × K × J: friction, armature, offset, delay and ripple of each joint, per prior standard
            deviation.
        time: N, s.
    """

    links: tuple[RobotLink, ...]
    gravity: Array
    left: Array
    size: Array
    columns: Array
    nuisances: Array
    time: Array

    @property
    def tilt(self) -> slice:
        """Columns of a tilt."""
        start = 10 * len(self.links)
        return slice(start, start + 2)

    @property
    def drives(self) -> slice:
        """Columns of the drives."""
        return slice(self.tilt.stop, self.tilt.stop + self.left.shape[1])

    @property
    def springs(self) -> slice:
        """Columns of springs at single joints (per N·m/rad), which no body is."""
        return slice(self.drives.stop, self.drives.stop + self.left.shape[1])


def body_rows(
    robot: RobotModel, joints: tuple[str, ...], position: Array, torque: Array, step_s: float,
    in_file: Sequence[tuple[float, float, float]],
) -> BodyRows:  # fmt: skip
    """Rows of a log on an even clock.

    Args:
        robot: as the file has it.
        joints: J names of the columns.
        position, torque: rows × J, rad and N·m.
        step_s: between rows.
        in_file: Coulomb friction, damping and armature of each joint in the file.
    """
    every = max(1, round(_FINEST_S / step_s))
    if every > 1:
        position, torque, step_s = position[::every], torque[::every], every * step_s
    slow = butter(_ORDER, min(_TORQUE_HZ * 2.0 * step_s, 0.8), output="sos")
    fast = butter(_ORDER, min(_MOTION_HZ * 2.0 * step_s, 0.9), output="sos")
    q = sosfiltfilt(fast, position, axis=0)
    v = np.gradient(q, step_s, axis=0)
    a = np.gradient(v, step_s, axis=0)
    keep = np.arange(round(0.25 / step_s), len(q) - round(0.25 / step_s), max(1, round(_APART_S / step_s)))

    def passed(values: Array) -> Array:
        return np.asarray(sosfiltfilt(slow, values, axis=0)[keep])

    motion = LinkMotion(robot, joints, q, v, a)
    gravity = np.array(robot.at_rest()[0].opt.gravity)
    rigid = robot.torque(joints, q, v, a)
    coulomb, damping, armature = (np.array(values) for values in zip(*in_file, strict=True))
    sticking = np.tanh(v / _STICK)
    target = passed(torque)
    bodies, rubbing, inertial = passed(rigid), passed(sticking), passed(a)
    left = target - bodies - rubbing * coulomb - passed(v) * damping - inertial * armature
    size = np.maximum(np.sqrt(np.mean(target**2, axis=0)), 1e-12)
    count, width = len(motion.links), len(joints)
    columns = np.zeros((len(keep), width, 10 * count + 2 + 2 * width))
    for (joint, link), values in motion.columns(gravity).items():
        columns[:, joint, 10 * link : 10 * link + 10] = passed(values)
    for axis, direction in enumerate(across(gravity)):
        leaning = np.cross(direction, gravity)
        for (joint, link), values in motion.columns(leaning, still=True).items():
            columns[:, joint, 10 * count + axis] += passed(values @ motion.links[link].parameters)
    turned = passed(q - np.mean(q, axis=0))
    for joint in range(width):
        for place, values in enumerate((bodies, turned)):
            columns[:, joint, 10 * count + 2 + place * width + joint] = values[:, joint]
    spread = _FRICTION * size
    nuisances = np.zeros((len(keep), width, len(_KINDS) + 2 * len(_RIPPLES), width))
    late = passed(np.gradient(torque, step_s, axis=0)) * _LATE_S
    kinds = (rubbing, passed(built_up(q, _CREEP_RAD)), passed(v), inertial, np.ones_like(target))
    for place, values in enumerate(kinds):
        scaled = spread * values / np.maximum(np.sqrt(np.mean(values**2, axis=0)), 1e-12)
        for joint in range(width):
            nuisances[:, joint, place, joint] = scaled[:, joint]
    waves = [passed(wave(turns * q)) for turns in _RIPPLES for wave in (np.sin, np.cos)]
    for joint in range(width):
        nuisances[:, joint, len(_KINDS) - 1, joint] = late[:, joint]
        for place, values in enumerate(waves, len(_KINDS)):
            nuisances[:, joint, place, joint] = _RIPPLE * size[joint] * values[:, joint]
    return BodyRows(tuple(motion.links), gravity, left, size, columns, nuisances, keep * step_s)


def across(gravity: Array) -> Array:
    """2 × 3: directions across gravity, about which a base leans; zero without gravity."""
    size = float(np.linalg.norm(gravity))
    if size == 0.0:
        return np.zeros((2, 3))
    down = gravity / size
    first = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(down, first)])


@dataclass(frozen=True, eq=False)
class Whitened:
    """Rows whose errors are independent with unit variance, as triangles; nuisances taken out with their priors.

    Attributes:
        triangle: P × P, of the columns.
        moment: P; the least squares are |triangle x − moment|² + a constant.
    """

    triangle: Array
    moment: Array


def whitened(rows: BodyRows, free: Array, part: Array | None = None) -> Whitened:
    """Rows with the dependence of their errors taken out.

    Args:
        rows: of a log.
        free: P, prior standard deviations of the columns in a fit in which all may move.
        part: N; rows that are used; None = all.
    """
    count, width, many = rows.columns.shape
    loose = rows.nuisances.reshape(count, width, -1)
    k = loose.shape[2]
    half = np.arange(count) < count // 2
    lost = np.empty((count, width))
    scaled = np.concatenate([loose, rows.columns * free, rows.left[:, :, None]], axis=2)
    for test in (half, ~half):
        known = (scaled[~test] / rows.size[:, None]).reshape(-1, scaled.shape[2])
        gram = known.T @ known / _AS_UNCERTAIN**2
        values = np.linalg.solve(gram[:-1, :-1] + np.eye(len(gram) - 1), gram[:-1, -1])
        lost[test] = scaled[test, :, -1] - scaled[test, :, :-1] @ values
    memory = np.array([_memory(lost[:, joint], (half, ~half)) for joint in range(width)])
    covariance = np.cov(_innovations(lost, memory).T, bias=True).reshape(width, width)
    covariance += np.diag((_NOISE_FLOOR * rows.size) ** 2)
    used = np.ones(count, dtype=bool) if part is None else part
    every = np.concatenate([loose, rows.columns, rows.left[:, :, None]], axis=2)[used]
    white = np.moveaxis(_innovations(every, memory), 1, 0)
    white = solve_triangular(np.linalg.cholesky(covariance), white.reshape(width, -1), lower=True)
    prior = np.eye(k, k + many + 1)
    stacked = np.vstack([prior, white.reshape(-1, k + many + 1)])
    triangle = np.asarray(np.linalg.qr(stacked, mode="r"))[k:, k:]
    return Whitened(triangle[:many, :many], triangle[:many, -1])


def _memory(values: Array, parts: Sequence[Array]) -> Array:
    """Coefficients of an autoregression, whose sum stays below a limit: beyond it statics are lost."""
    past, now = [], []
    for part in parts:
        piece = values[part]
        past.append(np.column_stack([piece[_LAGS - lag : len(piece) - lag] for lag in range(1, _LAGS + 1)]))
        now.append(piece[_LAGS:])
    matrix, target = np.vstack(past), np.concatenate(now)
    found: Array = np.linalg.lstsq(matrix, target, rcond=1e-10)[0]
    total = float(np.sum(found))
    return found * (_MOST_MEMORY / total) if total > _MOST_MEMORY else found


def _innovations(values: Array, memory: Array) -> Array:
    """Rows without what the rows before foretell, of N × J or N × J × K."""
    found: Array = values[_LAGS:].copy()
    extra = (1,) * (values.ndim - 2)
    for lag in range(1, _LAGS + 1):
        found -= memory[:, lag - 1].reshape(-1, *extra) * values[_LAGS - lag : len(values) - lag]
    return found


def free_spread(rows: BodyRows) -> Array:
    """P: prior standard deviations of all columns where everything may be wrong, by first order."""
    found = np.zeros(rows.columns.shape[2])
    for number, link in enumerate(rows.links):
        mass, length = max(link.mass, 1e-6), link.length
        found[10 * number] = 0.25 * mass
        found[10 * number + 1 : 10 * number + 4] = 0.25 * mass * length
        found[10 * number + 4 : 10 * number + 10] = 0.25 * mass * length**2
    found[rows.tilt], found[rows.drives] = TILT, CONSTANT
    found[rows.springs] = spring_spread(rows)
    return found


def spring_spread(rows: BodyRows) -> Array:
    """J: prior standard deviation of a spring that may be there, N·m/rad."""
    turned = np.diagonal(rows.columns[:, :, rows.springs], axis1=1, axis2=2)
    return np.asarray(_FRICTION * rows.size / np.maximum(np.sqrt(np.mean(turned**2, axis=0)), 1e-12))
