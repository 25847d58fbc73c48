"""Which reading of the log fits all joints together, and which others fit as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_robots.log.joint_log import Array
from nmt_robots.mechanics.columns import usual_effects
from nmt_robots.mechanics.least_squares import solve_many
from nmt_robots.mechanics.motion import Motion
from nmt_robots.mechanics.readings import LONGEST_S, DriveTorque, Reading
from nmt_robots.thresholds import THRESHOLDS

_GROUPS = 4
_EARLY_S, _EXPLAINS_MOST = 0.005, 0.3
"""Time by which something may be early as anything else, s; squared residual it needs beyond, against that without."""
_AT_ONCE = 32
"""Readings whose torques are held at a time."""
_OTHER_KIND = 4.0
"""Squared residual against that of the best up to which a reading of the other kind still widens every ±."""


@dataclass(frozen=True, eq=False)
class ReadingScores:
    """How well each reading lets the usual effects explain the torque of all joints.

    Attributes:
        readings: R.
        relative: R; mean over joints of residual over torque, both squared, on seconds that no fit has seen.
        by_group: R × G; the same, of groups of seconds each by itself.
        by_joint: R × J.
        step_s: between rows.
    """

    readings: tuple[Reading, ...]
    relative: Array
    by_group: Array
    by_joint: Array
    step_s: float

    @property
    def best(self) -> Reading:
        """The one with the least relative residual whose lags are not the largest that were asked."""
        return self.readings[self.first]

    @property
    def first(self) -> int:
        """Its number."""
        return int(np.argmin(np.where(self._at_edge() | self._doubtful(), np.inf, self.relative)))

    @property
    def is_beyond(self) -> bool:
        """Whether a lag that is the largest that was asked fits better than all others, so that none is known."""
        return bool(self._at_edge()[np.argmin(np.where(self._doubtful(), np.inf, self.relative))])

    def _at_edge(self) -> Array:
        """R: whether a lag is the first or the last that was asked of its kind."""
        lags = np.array([[item.command_lag_s, item.torque_lag_s] for item in self.readings])
        low, high = np.min(lags, axis=0), np.max(lags, axis=0)
        return np.asarray(np.any(((lags == low) | (lags == high)) & (np.abs(lags) > 0.5 * LONGEST_S), axis=1))

    def _doubtful(self) -> Array:
        """R: whether a signal is far early, which few loggers make, without explaining most of the remaining torque."""
        early = np.array([min(item.command_lag_s, item.torque_lag_s) < -_EARLY_S for item in self.readings])
        usual = float(np.min(self.relative[~early])) if np.any(~early) else np.inf
        return early & (self.relative > _EXPLAINS_MOST * usual)

    @property
    def plain(self) -> int:
        """Number of the reading that takes the log as it is."""
        return self.readings.index(Reading())

    def among(self, command: str, late: str) -> tuple[Array, Array]:
        """Lags (s) and numbers of the readings with one kind of command and one thing late, damped as the best."""
        other = "torque_lag_s" if late == "command_lag_s" else "command_lag_s"
        numbers = np.array(
            [
                number
                for number, reading in enumerate(self.readings)
                if reading.command == command
                and getattr(reading, other) == getattr(self.best, other)
                and reading.derived == self.best.derived
            ],
            dtype=int,
        )
        lags = np.array([getattr(self.readings[n], late) for n in numbers])
        order = np.argsort(lags)
        return lags[order], numbers[order]

    def lag(self, command: str, late: str) -> tuple[float, float]:
        """Best lag of a kind and its standard uncertainty by groups of seconds, s."""
        lags, numbers = self.among(command, late)
        groups = np.array([_lowest(lags, self.by_group[numbers, g]) for g in range(self.by_group.shape[1])])
        std = float(np.std(groups, ddof=1) / np.sqrt(len(groups)))
        return _lowest(lags, self.relative[numbers]), std

    def fit_as_well(self) -> list[Reading]:
        """Readings that cannot be told from the best one: the best itself comes first."""
        first, at_edge = self.first, self._at_edge() | self._doubtful()
        found = [self.readings[first]]
        for number, reading in enumerate(self.readings):
            if at_edge[number]:
                continue
            apart = np.log(self.by_group[number] / self.by_group[first])
            std = float(np.std(apart, ddof=1) / np.sqrt(len(apart)))
            allowed = THRESHOLDS.fits_as_well + 2.0 * min(std, THRESHOLDS.fits_as_well)
            if number != first and self.relative[number] <= self.relative[first] * (1.0 + allowed):
                found.append(reading)
        return found + [reading for reading in self._of_other_kind() if reading not in found]

    def alike(self, reading: Reading, other: Reading) -> bool:
        """Whether two readings fit about as well."""
        first, second = (float(self.relative[self.readings.index(item)]) for item in (reading, other))
        return abs(first - second) <= 3.0 * THRESHOLDS.fits_as_well * min(first, second)

    def _of_other_kind(self) -> list[Reading]:
        """The best readings with only the command, and with only the torque late, where something is late.

        To first order a late loop is damping and armature, so the fit alone tells the two apart too surely.
        """
        first = self.first
        best = self.readings[first]
        if max(abs(best.command_lag_s), abs(best.torque_lag_s)) <= THRESHOLDS.lag_s:
            return []
        found = []
        for commanded in (True, False):
            at_edge = self._at_edge() | self._doubtful()
            numbers = [
                n
                for n, reading in enumerate(self.readings)
                if bool(reading.command_lag_s) == commanded and not at_edge[n]
            ]
            if numbers:
                number = min(numbers, key=lambda n: self.relative[n])
                if self.relative[number] < _OTHER_KIND * self.relative[first]:
                    found.append(self.readings[number])
        return found


def _lowest(lags: Array, scores: Array) -> float:
    """Where scores are lowest, by the parabola through the lowest and its neighbours."""
    lowest = int(np.argmin(scores))
    if lowest in (0, len(lags) - 1):
        return float(lags[lowest])
    left, middle, right = scores[lowest - 1 : lowest + 2]
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend > 0.0 else 0.0
    return float(lags[lowest] + shift * (lags[1] - lags[0]))


def compare_readings(
    motion: Motion, drive: DriveTorque, derived: bool = False, some: Sequence[Reading] = ()
) -> ReadingScores:
    """Score every reading that the log allows, or some; ``derived`` as in :meth:`DriveTorque.candidates`."""
    readings = list(some) or drive.candidates(derived)
    joints = np.flatnonzero(motion.moves)
    sides = [_Sides(motion, int(joint)) for joint in joints]
    by_joint = np.full((len(readings), motion.q.shape[1]), np.nan)
    groups = np.full((len(readings), _GROUPS, len(joints)), np.nan)
    for first in range(0, len(readings), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        torques = np.stack([motion.smooth_twice(drive.torque(reading)) for reading in readings[part]], axis=-1)
        for place, joint in enumerate(joints):
            by_joint[part, joint], groups[part, :, place] = sides[place].scores(torques[:, joint])
    pooled, grouped = np.nanmean(by_joint, axis=1), np.nanmean(groups, axis=2)
    return ReadingScores(tuple(readings), pooled, grouped, by_joint, motion.step_s)


class _Sides:
    """The usual columns of one joint, in groups of seconds."""

    def __init__(self, motion: Motion, joint: int) -> None:
        rows = motion.moving[:, joint]
        effects = usual_effects(motion, joint)
        columns = motion.smooth(np.column_stack([effect.columns for effect in effects]))
        self._never = np.concatenate([[e.never_negative] * e.parameters for e in effects]).astype(bool)
        self._rigid = motion.rigid[:, joint]
        self._groups = [np.flatnonzero(rows & (motion.blocks % _GROUPS == group)) for group in range(_GROUPS)]
        self._columns = [columns[numbers] for numbers in self._groups]
        self._grams = [part.T @ part for part in self._columns]

    def scores(self, torques: Array) -> tuple[Array, Array]:
        """Relative residual on seconds left out of the fit, for each of R torques (N × R): of all, R, and of each
        group, R × G.
        """
        left = torques - self._rigid[:, None]
        parts = [left[numbers] for numbers in self._groups]
        moments = [column.T @ part for part, column in zip(parts, self._columns, strict=True)]
        gram, moment = np.sum(self._grams, axis=0), np.sum(moments, axis=0)
        lost, size = np.zeros((2, torques.shape[1], _GROUPS))
        for group, numbers in enumerate(self._groups):
            if not len(numbers):
                continue
            values = solve_many(gram - self._grams[group], moment - moments[group], self._never)
            lost[:, group] = np.sum((parts[group] - self._columns[group] @ values) ** 2, axis=0)
            size[:, group] = len(numbers) * np.var(torques[numbers], axis=0)
        return np.sum(lost, axis=1) / np.maximum(np.sum(size, axis=1), 1e-300), lost / np.maximum(size, 1e-300)
