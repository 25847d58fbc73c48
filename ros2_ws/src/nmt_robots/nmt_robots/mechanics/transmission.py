"""A transmission that gives way or has play: the link behind it is simulated with its own state.

The encoder is on the motor. Its logged angle drives the link through stiffness, damper and gap, and what they pass on
takes the place of the rigid bodies' torque::

    M(t) q_l'' = T(q − q_l, q' − q_l') − c(t) + G(t) (q − q_l)

M is the joint's own inertia at the pose, c the torque that the bodies need but for it, G its change with the angle. All
candidates are simulated at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nmt_core.numerics.kernels import njit
from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.mechanics.columns import usual_effects
from nmt_robots.mechanics.least_squares import solve_many
from nmt_robots.mechanics.motion import Motion, smoothed
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.thresholds import THRESHOLDS

_STEP_S = 5e-4
_SLOWEST, _FASTEST = 2.0 * np.pi * 3.0, 2.0 * np.pi * 100.0
"""Natural frequencies of the link behind its transmission that are searched for, rad/s."""
_NARROWED = 2
_HOPELESS = 0.8
"""Torque left by the best of a coarse grid against that of the rigid bodies, above which no finer one halves it."""
_LONG_S = 0.06
_AS_WELL = 1.5
"""Squares of a reading against those of the best, up to which its value widens the ±."""


@dataclass(frozen=True, eq=False)
class Transmission:
    """What is between the motor and the link of a joint.

    Attributes:
        stiffness, stiffness_std: N·m/rad.
        ratio: of damping of the link on it.
        inertia: of the link, kg·m².
        gap, gap_std: play from end to end, rad; zero of a transmission that only gives way.
        motion: of all joints, with what is passed on in the place of this joint's rigid torque.
        left: rms on seconds that they were not fitted to, below the frequencies of an encoder's noise, N·m.
        other: the same of the other kind: without a gap where there is one, or with one.
        rigid: the same of the rigid bodies.
    """

    stiffness: float
    stiffness_std: float
    ratio: float
    inertia: float
    gap: float
    gap_std: float
    motion: Motion
    left: float
    other: float
    rigid: float


@dataclass(frozen=True)
class _Candidates:
    """Stiffness (N·m/rad), damping ratio and gap (rad) of each, C."""

    stiffness: Array
    ratio: Array
    gap: Array

    def with_gap(self, wanted: bool) -> Array:
        """C: whether each is of one kind."""
        return np.asarray((self.gap > 0.0) == wanted)


class LinkBehindTransmission:
    """The link of one joint, driven by the motor's logged angle.

    Args:
        model: the robot.
        log: with the angles of the motors.
        motion: of all joints.
        joint: number of the column.
        bodies: rows × joints, N·m, unfiltered: torque of the bodies at rest and in motion.
    """

    def __init__(
        self, model: RobotModel, log: JointLog, motion: Motion, joint: int, bodies: tuple[Array, Array]
    ) -> None:
        self.motion, self.joint = motion, joint
        names, still = log.joints, np.zeros_like(motion.q)
        unit, turned = still.copy(), motion.q.copy()
        unit[:, joint] = 1.0
        turned[:, joint] += 1e-4
        at_rest, moving = (torque[:, joint] for torque in bodies)
        inertia = model.torque(names, motion.q, still, unit)[:, joint] - at_rest
        needed = moving - inertia * motion.a[:, joint]
        change = (model.torque(names, turned, still, still)[:, joint] - at_rest) / 1e-4
        self.inertia = float(np.median(inertia))
        parts = max(1, round(motion.step_s / _STEP_S))
        rows = np.arange(len(needed) * parts - parts + 1) / parts
        every = np.arange(len(needed))
        self._parts, self._step = parts, motion.step_s / parts
        self._angle = np.interp(rows, every, log.position[:, joint])
        self._speed = np.gradient(np.interp(rows, every, log.position[:, joint]), self._step)
        self._inverse, self._needed, self._change = (
            np.interp(rows, every, values) for values in (1.0 / np.maximum(inertia, 1e-9), needed, change)
        )

    def passed_on(self, candidates: _Candidates) -> Array:
        """Torque between motor and link, rows × C, N·m."""
        damper = 2.0 * candidates.ratio * np.sqrt(candidates.stiffness * self.inertia)
        sides = np.column_stack([candidates.stiffness, damper, 0.5 * candidates.gap])
        signals = np.column_stack([self._angle, self._speed, self._inverse, self._needed, self._change])
        result: Array = _passed_on(sides, signals, self._step, self._parts)
        # What runs away is not a candidate.
        return np.where(np.isfinite(result) & (np.abs(result) < 1e9), result, 1e9)


@njit(cache=True)
def _passed_on(sides: Array, signals: Array, step: float, parts: int) -> Array:
    """Torques at every ``parts``-th sample, rows × C; semi-implicit Euler.

    Args:
        sides: C × 3: stiffness (N·m/rad), damper (N·m·s/rad), half the gap (rad).
        signals: samples × 5: motor's angle and speed, inverse inertia, torque that is needed and its change.
        step: s.
        parts: samples in a row.
    """
    rows = (len(signals) - 1) // parts + 1
    result = np.empty((rows, len(sides)))
    for number in range(len(sides)):
        stiffness, damper, half = sides[number]
        first = signals[0, 3]
        angle = signals[0, 0] - first / stiffness - np.sign(first) * half
        speed = 0.0
        for sample in range(len(signals)):
            motor, turning, inverse, needed, change = signals[sample]
            twist = motor - angle
            beyond = twist - min(max(twist, -half), half)
            passed = stiffness * beyond
            if half == 0.0 or beyond != 0.0:
                passed += damper * (turning - speed)
            if sample % parts == 0:
                result[sample // parts, number] = passed
            speed += step * inverse * (passed - needed + change * twist)
            angle += step * speed
    return result


def torque_of_bodies(model: RobotModel, log: JointLog, motion: Motion) -> tuple[Array, Array]:
    """Torque of the bodies at rest and in motion, rows × joints each, unfiltered, N·m."""
    still = np.zeros_like(motion.q)
    at_rest, moving = (model.torque(log.joints, motion.q, *moved) for moved in ((still, still), (motion.v, motion.a)))
    return at_rest, moving


def transmission_of(link: LinkBehindTransmission, torques: list[Array]) -> Transmission | None:
    """The transmission that fits best, on seconds that it was not fitted to; None where none comes near.

    Args:
        link: of the joint.
        torques: N each, N·m, of its drive, as the log may be read.
    """
    motion, joint = link.motion, link.joint
    scorer = _Scorer(motion, joint, torques)
    candidates = _first(link.inertia)
    by_reading = scorer.scores(motion.smooth_twice(link.passed_on(candidates)))
    unmoved = scorer.scores(motion.rigid[:, [joint]])
    rigid_left = float(np.sqrt(np.min(np.mean(unmoved[0], axis=1))))
    if float(np.min(np.mean(by_reading, axis=2))) > (_HOPELESS * rigid_left) ** 2:
        return None
    for _ in range(_NARROWED):
        scores = np.min(by_reading, axis=1)
        more = _joined([_around(candidates, scores, kind) for kind in (False, True)])
        candidates = _joined([candidates, more])
        by_reading = np.concatenate([by_reading, scorer.scores(motion.smooth_twice(link.passed_on(more)))])
    lefts = {kind: _held_out(_of_best_reading(by_reading), candidates.with_gap(kind)) for kind in (False, True)}
    has_gap = lefts[True] < (1.0 - THRESHOLDS.needed_gain) * lefts[False]
    mask = candidates.with_gap(has_gap)
    best = _best(np.sum(_of_best_reading(by_reading), axis=1), mask)
    k, gap = candidates.stiffness, candidates.gap
    only = _Candidates(k[[best]], candidates.ratio[[best]], gap[[best]])
    rigid = motion.rigid.copy()
    rigid[:, joint] = motion.smooth_twice(link.passed_on(only)[:, 0])
    return Transmission(
        float(k[best]), _spread(k, by_reading, mask, best), float(candidates.ratio[best]),
        link.inertia, float(gap[best]), _spread(gap, by_reading, mask, best),
        replace(motion, rigid=rigid), lefts[has_gap], lefts[not has_gap],
        rigid_left,
    )  # fmt: skip


def _first(inertia: float) -> _Candidates:
    """A coarse grid of both kinds."""
    slow = np.geomspace(_SLOWEST, _FASTEST, 20)
    stiff = np.geomspace(0.08 * _FASTEST, _FASTEST, 5)
    elastic = [(w, z, 0.0) for w in slow for z in (0.03, 0.15)]
    loose = [(w, 0.1, gap) for w in stiff for gap in np.geomspace(0.002, 0.08, 11)]
    speed, ratio, gap = (np.array(values) for values in zip(*elastic, *loose, strict=True))
    return _Candidates(inertia * speed**2, ratio, gap)


def _around(candidates: _Candidates, scores: Array, with_gap: bool) -> _Candidates:
    """Candidates between the best of a kind and its neighbours."""
    best = _best(np.sum(scores, axis=1), candidates.with_gap(with_gap))
    k, ratio, gap = (float(values[best]) for values in (candidates.stiffness, candidates.ratio, candidates.gap))
    apart = np.sort(np.abs(np.log(np.unique(candidates.stiffness) / k)))
    wide = float(np.clip(apart[1] if len(apart) > 1 else 0.2, 0.02, 0.5))
    stiff = k * np.exp(wide * np.linspace(-0.8, 0.8, 5 if not with_gap else 3))
    ratios = ratio * np.array([0.5, 1.0, 2.0])
    gaps = gap * np.array([0.8, 0.9, 1.0, 1.12, 1.25]) if with_gap else np.zeros(1)
    grid = np.meshgrid(stiff, ratios, gaps, indexing="ij")
    return _Candidates(*(values.ravel() for values in grid))


def _joined(parts: list[_Candidates]) -> _Candidates:
    return _Candidates(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("stiffness", "ratio", "gap"))
    )


def _best(scores: Array, mask: Array) -> int:
    return int(np.argmin(np.where(mask, scores, np.inf)))


def _held_out(scores: Array, mask: Array) -> float:
    """Rms left on each half of the seconds by what fits the other best."""
    halves = [_best(scores[:, half], mask) for half in (0, 1)]
    return float(np.sqrt(0.5 * (scores[halves[1], 0] + scores[halves[0], 1])))


def _of_best_reading(by_reading: Array) -> Array:
    """C × 2: scores in the reading of the torque that suits each candidate best, of both halves together."""
    chosen = np.argmin(np.sum(by_reading, axis=2), axis=1)
    return np.asarray(by_reading[np.arange(len(chosen)), chosen])


def _spread(values: Array, by_reading: Array, mask: Array, best: int) -> float:
    """Standard uncertainty of a value: between halves and readings, and what 4 % more squares allow.

    Neighbouring rows are alike, so a count of rows says little.
    """
    scores = _of_best_reading(by_reading)
    total = np.sum(scores, axis=1)
    near = mask & (total < 1.04 * total[best])
    found = [values[_best(scores[:, half], mask)] for half in (0, 1)]
    for reading in range(by_reading.shape[1]):
        alone = np.sum(by_reading[:, reading], axis=1)
        chosen = _best(alone, mask)
        if alone[chosen] < _AS_WELL * total[best]:
            found.append(values[chosen])
    wide = max(np.max(np.abs(values[near] - values[best])), np.max(np.abs(np.array(found) - values[best])))
    # Between candidates nothing was asked, and what passes grows with the link's inertia.
    others = np.abs(values[mask] - values[best])
    apart = np.min(others[others > 0.0], initial=values[best])
    return float(np.hypot(max(wide, apart), THRESHOLDS.inertia_tolerance * values[best]))


class _Scorer:
    """Mean squares that a torque in the place of the rigid one leaves over with the usual effects, by halves.

    All passes one more and longer filter: a link behind a transmission would else win by the encoder's noise alone,
    which it does not follow.
    """

    def __init__(self, motion: Motion, joint: int, torques: list[Array]) -> None:
        self._rows = motion.moving[:, joint]
        self._window = max(motion.window, round(_LONG_S / motion.step_s) | 1)
        effects = usual_effects(motion, joint)
        self._columns = self._smooth(motion.smooth(np.column_stack([effect.columns for effect in effects])))
        self._never = np.array([effect.never_negative for effect in effects])
        self._torques = [self._smooth(motion.smooth_twice(torque)) for torque in torques]
        odd = motion.blocks[self._rows] % 2 == 1
        self._halves = (odd, ~odd)

    def _smooth(self, values: Array) -> Array:
        return smoothed(values, self._window)[self._rows]

    def scores(self, passed: Array) -> Array:
        """C × R × 2 for each candidate's torque (rows × C, smoothed twice) and each reading."""
        smooth = self._smooth(passed)
        found = np.empty((passed.shape[1], len(self._torques), 2))
        for place, half in enumerate(self._halves):
            columns = self._columns[half]
            gram = columns.T @ columns
            for reading, torque in enumerate(self._torques):
                left = torque[half, None] - smooth[half]
                moments, squares = columns.T @ left, np.sum(left**2, axis=0)
                values = solve_many(gram, moments, self._never)
                fitted = np.sum(values * (2.0 * moments - gram @ values), axis=0)
                found[:, reading, place] = np.maximum(squares - fitted, 0.0) / max(len(left), 1)
        return found
