"""What is found of the channels of a window: faults, what stands in the place of a faulty one, and doubts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_extract.judgement import channel_gain, channel_noise, force_judge, moving_shape, shape_judge
from nmt_extract.judgement.channel_gain import ChannelGain, ShapeLevel
from nmt_extract.judgement.channel_history import ChannelHistory
from nmt_extract.judgement.force_judge import DriveState
from nmt_extract.modal.channels import WindowRows, derived
from nmt_extract.modal.mode_identity import other_mode
from nmt_extract.modal.periodic_motion import PeriodicMotion
from nmt_extract.modal.window import Window
from nmt_signals.channel_faults import clipping

_SINE = 0.005  # harmonics over the fundamental of a force that is held to a sine


def still_or_cut(window: Window, rows: Sequence[int], samples_per_period: Mapping[int, float]) -> dict[int, str]:
    """Channels that are dead or flat-topped, with the words why.

    Args:
        window: all channels.
        rows: that are judged.
        samples_per_period: of the main component of each channel, by row; a row that is absent is not searched for a
            cut.
    """
    faults = {}
    for row in rows:
        if np.ptp(window.data[row]) == 0.0:
            faults[row] = "is dead: it does not move"
        elif row in samples_per_period:
            flat = clipping.flat_top(window.data[row], samples_per_period[row])
            if flat is not None:
                faults[row] = f"is flat-topped at {flat:.4g} {window.channels[row].unit}"
    return faults


class ChannelFindings:
    """The channels of a window judged by what the others, the levels before and the linear modes say.

    Args:
        motion: harmonics; those of a channel that is left out are replaced.
        linear: linear modes.
        history: levels before; takes this one where no channel is faulty.

    Attributes:
        rows: with a response at the drive point that is not faulty.
        faults: words by row.
        doubt: one sentence on channels that may be off; else empty.
        gain: one sentence on a channel whose gain is off; else empty.
        other_shapes: what the shape (as it was measured) could be instead, shape ``(sets, points)`` each.
        other_amplitudes: what all harmonics could be instead, shape ``(sets, channels, H + 1)`` each.

    Raises:
        BenchError: too little is left without the faulty channels.
    """

    def __init__(self, motion: PeriodicMotion, linear: LinearDescription, history: ChannelHistory) -> None:
        self.motion, self.linear, self.history, self.rows = motion, linear, history, motion.rows
        self.faults: dict[int, str] = {}
        self.doubt = self.gain = ""
        self.other_shapes: list[ComplexArray] = []
        self.other_amplitudes: list[ComplexArray] = []
        self._judge()

    @property
    def fault_words(self) -> str:
        """What is wrong with which channel, one sentence."""
        channels = self.motion.window.channels
        return "; ".join(f"{channels[row].name} {why}" for row, why in sorted(self.faults.items())) + "."

    def _judge(self) -> None:
        motion, linear, faults, rows = self.motion, self.linear, self.faults, self.rows
        window, order = motion.window, motion.orders[0]
        faults.update(still_or_cut(window, rows.used, self._periods()))
        names = tuple(channel.name for channel in window.channels)
        history = self.history if self.history.knows(names) else None
        shape = motion.amplitudes[:, list(rows.shape), order]
        sound = [k for k, row in enumerate(rows.shape) if row not in faults]
        omega = order * float(motion.omega[0])
        near = moving_shape.near_modes(linear, omega)
        found = shape_judge.off_its_shape(
            shape[0],
            shape_std(shape, motion.parts),
            shape_judge.linear_basis(linear.shape_matrix, linear.target_mode, len(sound) - 1),
            None if history is None else history.shape,
            sound,
            [k for k in sound if history is not None and rows.shape[k] in history.faulty],
            linear.shape_matrix[:, near].astype(np.complex128) if near else None,
            None if history is None else moving_shape.shape_trend(history.shapes),
        )
        for index, (words, by_neighbour) in found.off.items():
            of = f"of level {self.history.level_index + 1}" if by_neighbour else "that the linear modes have"
            faults[rows.shape[index]] = f"{words}, by the shape {of}"
        metres = shape[0] / (1j * omega) ** MOTIONS[rows.shape_quantity]
        course = moving_shape.course_of(metres, near, linear, omega)
        doubts: Mapping[int, moving_shape.Doubt] = {}
        if near and not faults:
            doubtful = {rows.shape[index]: each for index, each in found.doubtful.items()}
            doubts = self.history.doubt(doubtful, course)
        if history is not None:
            judged = [row for row in rows.used if row not in faults]
            rms = window.data.std(axis=1)
            faults.update(channel_noise.noise_jumps(motion.noise, rms, history.noise, judged, self._unrepeated))
        drive = self._drive_state()
        # What the exciter is expected to do at resonance holds for the target mode, and where there is a force: that of
        # a self-excited motion vanishes at its limit cycle.
        driven = kind_class(window.lock.test).stops_without_answer
        right_mode = driven and motion.orders == (1, 1) and other_mode(shape[0], linear) is None
        if history is not None and right_mode and rows.force not in faults and rows.drive not in faults:
            force_gain = force_judge.force_gain(drive, history.drives, linear, rows.force in history.faulty)
            if force_gain is not None:
                faults[rows.force] = (
                    f"measures {force_gain:.2f} times what voltage and response say by the levels up to level "
                    f"{history.level_index + 1}: its gain, or that of the amplifier, has changed"
                )
        if not faults:
            if shape_judge.strange_shape(shape[0], linear.shape_matrix):
                raise BenchError(
                    "The shape is not one that the linear modes can have: look at the channels, at the points of the "
                    "linear description, and at which mode was locked."
                )
            level = self._shape_level(metres, shape) if right_mode else None
            self.history.take(names, window.lock.level_index, shape[0], motion.noise, drive, course, level)
            gain = None if level is None else channel_gain.channel_gain(self.history.levels, linear)
            if gain is not None:
                self._take_out(gain)
            else:
                self._note(doubts, near)
            return
        self._note(doubts, near)
        self.history.faulty = frozenset(faults)
        self._leave_out(history)

    def _periods(self) -> dict[int, float]:
        """Samples a period of the main component of each channel; none for a force that is held to a sine.

        The little that harmonics beyond the controlled ones make of its crest may look like a cut.
        """
        motion = self.motion
        size = np.abs(motion.amplitudes[0])
        held = size[self.rows.force]
        controlled = motion.window.lock.level_index in self.history.driven
        is_held = controlled and bool(np.linalg.norm(held[2:]) < _SINE * held[1])
        period, several = motion.samples_per_period, motion.orders != (1, 1)
        return {
            row: period / (1 + int(np.argmax(size[row, 1:])) if several else 1)
            for row in self.rows.used
            if not (is_held and row == self.rows.force)
        }

    def _shape_level(self, metres: ComplexArray, shape: ComplexArray) -> ShapeLevel:
        """This level for the fit of a gain: displacements (m), shape as it was measured ``(sets, points)``."""
        motion = self.motion
        std = shape_std(shape, motion.parts) * np.abs(metres) / np.maximum(np.abs(shape[0]), 1e-300)
        forces = motion.amplitudes[0, list(self.rows.forces), motion.orders[1]]
        return ShapeLevel(motion.orders[0] * float(motion.omega[0]), metres, std, forces)

    def _take_out(self, gain: ChannelGain) -> None:
        """Divide a channel by its gain, and put that into words and into the uncertainty."""
        motion, row = self.motion, self.rows.shape[gain.place]
        motion.divide(row, gain.ratio)
        other = motion.amplitudes.copy()
        other[:, row] *= 1.0 + gain.std / gain.ratio
        self.other_amplitudes.append(other)
        by = "this level" if gain.levels == 1 else f"{gain.levels} levels up to this one"
        self.gain = (
            f"{motion.window.channels[row].name} measures {gain.ratio:.2f} times what the other channels say, by the "
            f"linear modes of the {self.linear.source} and {by}: its gain is off, and its values are divided by this."
        )

    def _note(self, doubts: Mapping[int, moving_shape.Doubt], near: Sequence[int]) -> None:
        """Put channels that may be off into words, and what follows without their deviation into the uncertainty."""
        if not doubts:
            return
        motion, rows = self.motion, self.rows
        names = " or ".join(
            f"{motion.window.channels[row].name} measures {abs(doubt.ratio):.2f} times" for row, doubt in doubts.items()
        )
        modes = " and ".join(moving_shape.mode_words(self.linear, mode) for mode in near)
        self.doubt = (
            f"{names} what the other channels say, or {modes} takes part: {len(rows.shape)} points do not tell "
            "which, and nothing is left out. Look at the gain, or measure at more points."
        )
        for row, doubt in doubts.items():
            other = motion.amplitudes[:, list(rows.shape), motion.orders[0]].copy()
            other[:, rows.shape.index(row)] /= doubt.ratio
            self.other_shapes.append(other)

    def _unrepeated(self, row: int) -> float:
        motion = self.motion
        bounds = zip(motion.part_bounds[:-1], motion.part_bounds[1:], motion.part_amplitudes, strict=True)
        residual = np.concatenate(
            [motion.window.data[row, first:end] - motion.model(parts[row], first, end) for first, end, parts in bounds]
        )
        return channel_noise.unrepeated_rms(residual, motion.samples_per_period)

    def _drive_state(self) -> DriveState:
        motion, rows = self.motion, self.rows
        force = motion.amplitudes[:, rows.force]
        position = derived(motion.amplitudes[:, rows.drive], rows.motion_quantities[0], motion.omega, 0)
        velocity = 1j * np.multiply.outer(motion.omega, np.arange(force.shape[1])) * position
        channels = motion.window.channels
        voltages = [row for row, channel in enumerate(channels) if channel.quantity is Quantity.VOLTAGE]
        voltage = complex(motion.amplitudes[0, voltages[0], 1]) if len(voltages) == 1 else complex(math.nan)
        return DriveState(
            float(motion.omega[0]), voltage, force[0], velocity[0], shape_std(force, motion.parts),
            shape_std(velocity, motion.parts), motion.window.lock.level_index in self.history.driven,
        )  # fmt: skip

    def _leave_out(self, history: ChannelHistory | None) -> None:
        """Put the shape of the level before in the place of faulty channels; BenchError where that cannot be done."""
        motion, rows, linear, faults = self.motion, self.rows, self.linear, self.faults
        if rows.force in faults:
            raise BenchError(f"The force is not measured: {self.fault_words}")
        if len(rows.forces) > 1 and faults.keys() & {*rows.forces, *rows.motions}:
            raise BenchError(f"Force or response of an exciter is not measured: {self.fault_words}")
        self.rows = WindowRows.of(motion.window, linear, faults, f": {self.fault_words}")
        gone = [k for k, row in enumerate(rows.shape) if row in faults]
        kept = [k for k in range(len(rows.shape)) if k not in gone]
        # In a secondary resonance all orders of every point count, and a neighbour says one of them.
        one_order = motion.orders == (1, 1) and not motion.settings.power_balance
        if gone and (history is None or len(kept) < 2 or not one_order):
            raise BenchError(f"A channel is faulty, and no level without it says what it should be: {self.fault_words}")
        if not gone or history is None:
            return
        shape = motion.amplitudes[:, list(rows.shape), 1]
        neighbour = history.shape[:, np.newaxis]
        filled = shape_judge.predicted(neighbour, shape, kept)
        # As badly as the others predict one of the channels that are left, they may predict the one that is not.
        others = [[other for other in kept if other != k] for k in kept]
        guesses = [
            shape_judge.predicted(neighbour, shape[0], fitted)[k] for k, fitted in zip(kept, others, strict=True)
        ]
        misfit = float(np.abs(shape[0, kept] - guesses).max())
        away = filled * (1.0 + misfit / np.maximum(np.abs(filled), 1e-300))
        modes = shape_judge.linear_basis(linear.shape_matrix, linear.target_mode, len(kept))
        for guess in (away, shape_judge.predicted(modes, shape, kept)):
            other = shape.copy()
            other[:, gone] = guess[:, gone]
            self.other_shapes.append(other)
        missing = [rows.shape[k] for k in gone]
        motion.amplitudes[:, missing] = complex(math.nan, math.nan)
        motion.amplitudes[:, missing, 1] = filled[:, gone]


def shape_std(shape: ComplexArray, parts: int) -> FloatArray:
    """Standard uncertainty of the magnitudes of a shape, from the sets without one sub-window.

    Args:
        shape: shape ``(1 + parts, points)``.
        parts: K.
    """
    if not parts:
        return np.full(shape.shape[1], math.nan)
    away = np.abs(shape[1:] - shape[1:].mean(axis=0)) ** 2
    return np.asarray(np.sqrt((parts - 1) / parts * away.sum(axis=0)))
