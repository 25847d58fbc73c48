"""Ways to read what a drive did from what the log says it was told.

A command in a log may be held until the next one arrives or smoothed in the drive, and command or torque may be late.
Each reading gives a torque; which one fits is asked of all joints together, for a drive's clock is not a joint's
friction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from nmt_robots.log.joint_log import Array, JointLog

HELD = "held"
SMOOTH = "smooth"
LONGEST_S = 0.04
"""Lag to either side that is asked for."""


@dataclass(frozen=True)
class Reading:
    """How a log is read.

    Attributes:
        command: ``held`` or ``smooth`` between its changes.
        command_lag_s: by how much the drive has a command later than its row, s.
        torque_lag_s: by how much the torque acts later than its row, s.
        derived: whether the drive damps by the derivative of the position and not by the speed that was logged.
    """

    command: str = HELD
    command_lag_s: float = 0.0
    torque_lag_s: float = 0.0
    derived: bool = False

    def text(self) -> str:
        """In words."""
        words = ["each command held until the next" if self.command == HELD else "commands joined smoothly"]
        for what, lag in (("", self.command_lag_s), ("torque of the drive ", self.torque_lag_s)):
            if lag:
                words.append(f"{what}{1e3 * abs(lag):.3g} ms {'late' if lag > 0.0 else 'early'}")
        if self.derived:
            words.append("damping by the derivative of the position")
        return ", ".join(words)


def changes_of(command: Array) -> Array:
    """Rows in which any joint's command changes, the first one included."""
    return np.flatnonzero(np.r_[True, np.any(np.diff(command, axis=0) != 0.0, axis=1)])


def held_time(log: JointLog) -> float:
    """Mean time for which a log keeps a command, s; a row's without commands."""
    if log.position_command is None:
        return log.step_s
    rows = changes_of(log.position_command)
    return float(np.median(np.diff(rows))) * log.step_s if len(rows) > 2 else log.step_s


def late(values: Array, lag_s: float, step_s: float) -> Array:
    """Values as they were ``lag_s`` before each row; between rows on the line that joins them."""
    if lag_s == 0.0:
        return values
    rows = np.clip(np.arange(len(values)) - lag_s / step_s, 0.0, len(values) - 1.0)
    lower = np.floor(rows).astype(int)
    upper = np.minimum(lower + 1, len(values) - 1)
    share = (rows - lower)[:, None]
    result: Array = (1.0 - share) * values[lower] + share * values[upper]
    return result


def joined(command: Array) -> Array:
    """A command that runs straight from change to change instead of being held."""
    rows = changes_of(command)
    every = np.arange(len(command))
    return np.column_stack([np.interp(every, rows, command[rows, joint]) for joint in range(command.shape[1])])


@dataclass(frozen=True, eq=False)
class DriveSignals:
    """Torque of drives in one reading, and what their law made it of.

    Attributes:
        torque: N × J, or N of one joint, N·m.
        error: command minus position, rad; None where the torque was measured.
        speed_error: commanded minus measured speed, rad/s, which the velocity gain multiplies; None in the same case.
    """

    torque: Array
    error: Array | None = None
    speed_error: Array | None = None

    def of(self, joint: int) -> DriveSignals:
        """Those of one joint."""
        return self.through(lambda values: np.asarray(values[:, joint]))

    def through(self, change: Callable[[Array], Array]) -> DriveSignals:
        """All of them after the same change."""
        error, speed_error = (None if part is None else change(part) for part in (self.error, self.speed_error))
        return DriveSignals(change(self.torque), error, speed_error)


class DriveTorque:
    """Torque of the drives of a log, under any reading.

    Args:
        log: with gains and commands, or a measured torque.
    """

    def __init__(self, log: JointLog) -> None:
        self._log, self._step = log, log.step_s
        self.arithmetic = log.is_arithmetic
        self._between = {HELD: log.position_command}
        if self.arithmetic and log.position_command is not None:
            self._between[SMOOTH] = joined(log.position_command)

    def signals(self, reading: Reading) -> DriveSignals:
        """Torque under a reading, with what the gains multiply where it is computed."""
        if not self.arithmetic:
            return DriveSignals(self.torque(reading))
        return DriveSignals(self.torque(reading), self._error(reading), self._speed_error(reading))

    def _error(self, reading: Reading) -> Array:
        """Command minus position under a reading, N × J, rad; what the position gain multiplies."""
        return self.command(reading) - self._log.position

    def command(self, reading: Reading) -> Array:
        """Commanded position under a reading, N × J, rad."""
        command = self._between.get(reading.command)
        assert command is not None
        return late(command, reading.command_lag_s, self._step)

    def torque(self, reading: Reading) -> Array:
        """N × J, N·m."""
        log = self._log
        if log.torque is not None:
            return late(log.torque, reading.torque_lag_s, self._step)
        assert log.position_gain is not None
        torque: Array = log.position_gain * self._error(reading)
        if log.velocity_gain is not None:
            torque = torque + log.velocity_gain * self._speed_error(reading)
        if log.torque_command is not None:
            torque = torque + log.torque_command
        return late(torque, reading.torque_lag_s, self._step)

    def _speed_error(self, reading: Reading) -> Array:
        """Commanded minus measured speed under a reading, N × J, rad/s; what the velocity gain multiplies."""
        log = self._log
        derived = log.velocity is None or reading.derived
        velocity = np.gradient(log.position, self._step, axis=0) if derived else log.velocity
        assert velocity is not None
        return (0.0 if log.velocity_command is None else log.velocity_command) - velocity

    def candidates(self, derived: bool = False, longest_s: float = LONGEST_S) -> list[Reading]:
        """Readings that the log allows: each lag of command and of torque to both sides; of both at once only small
        ones of torque. What is early is asked for at every other step.

        Args:
            derived: whether the logged speed has a fault, so that the drive may not have damped by it.
            longest_s: largest lag, s.
        """
        step = max(0.5 * self._step, 1e-3)
        most = max(int(longest_s / step), 2)
        lags = np.r_[np.arange(-most, -2, 2), np.arange(-2, most + 1)] * step
        kinds = [HELD, SMOOTH] if self._is_held() else [HELD]
        found = [replace(Reading(kind), torque_lag_s=round(float(lag), 6)) for kind in kinds for lag in lags]
        if self.arithmetic:
            found += [
                replace(Reading(kind), command_lag_s=round(float(lag), 6), torque_lag_s=after)
                for kind in kinds
                for lag in lags
                for after in ((0.0, 0.001, 0.002) if lag >= -2.5 * step else (0.0,))
            ]
        if derived and self.arithmetic and self._log.velocity is not None:
            found += [replace(reading, derived=True) for reading in found]
        return list(dict.fromkeys(found))

    def _is_held(self) -> bool:
        """Whether the command stays the same over rows, so that it matters how it runs between its changes."""
        command = self._log.position_command
        return self.arithmetic and command is not None and len(changes_of(command)) < 0.9 * len(command)
