"""Rows of held levels in which a local force is linear: force residual, shape, harmonics of every response.

A force G at a place of participation p acts on the structure as −p G. With Y = φ q + y, q the coordinates of the mode
under test and of modes near it, y the part of all others, each level has the complex rows

* −D(ω) φ⁺ Y₁ of each mode of the frame, in which the force stands as p_t G₁ − D φ⁺ y,
* P Y₁ with P = 1 − φ φ⁺, the shape,
* Y_h = −Σ φ_i p_i G_h / D_i(hω) for h = 2 … H, in the output domain,

φ⁺ the pseudo-inverse that takes q out of the responses (least squares over the channels). The drive is a force −F at
each drive point, so that its part is taken off all rows; the remainder is the missing force and errors of chain and
model.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.law.modal_frame import ORDERS, ModalFrame
from nmt_diagnose.measurements.measurement import HeldLevels
from nmt_diagnose.thresholds import THRESHOLDS


class LawRows:
    """Rows of the levels of one test in one frame.

    Args:
        frame: modes of the structure.
        levels: the levels.
    """

    def __init__(self, frame: ModalFrame, levels: HeldLevels) -> None:
        self.frame, self.levels = frame, levels
        self.highest = min(levels.harmonics, ORDERS)
        self.modes = list(frame.modes)
        self.shapes = frame.sensors[:, self.modes]
        self.take_q = np.linalg.pinv(self.shapes)
        self.denominators = [frame.denominators(levels.omega, h) for h in range(ORDERS + 1)]
        self.near = self.denominators[1][:, self.modes]
        self.others = frame.others(levels.omega)
        force = np.zeros((*levels.force.shape[:2], ORDERS + 1), complex)
        force[..., : self.highest + 1] = levels.force[..., : self.highest + 1]
        drive, self.force_std = frame.drive, levels.force_std
        if levels.ratio is not None and levels.ratio_std is not None:
            # Nothing drives a decay: what stands for the drive acts on the modes of the frame alone.
            drive = np.eye(frame.omega.size)[self.modes]
            modal = 2.0 * levels.omega**2 * (self.take_q @ np.nan_to_num(levels.motion[:, :, 1]).T)
            force = np.zeros((*modal.shape, ORDERS + 1), complex)
            force[:, :, 1], self.force_std = 1j * levels.ratio * modal, levels.ratio_std * np.abs(modal)
        self.drives = list(zip(drive, -force, strict=True))

    def of_force(self, participation: FloatArray, force: ComplexArray) -> ComplexArray:
        """Rows (…, L, R) of a local force of harmonics (…, L, ORDERS + 1)."""
        sensors = self.frame.sensors
        first = force[..., 1]
        y = -np.einsum("lc,...l->...lc", self.others @ (sensors * participation).T, first)
        residual = first[..., np.newaxis] * participation[self.modes]
        return self.assembled(residual, y, self._beyond(participation, force))

    def _beyond(self, participation: FloatArray, force: ComplexArray) -> ComplexArray:
        """Harmonics 2 … H of the responses (…, L, C, H − 1) to a force at a place."""
        parts = [
            -np.einsum(
                "lc,...l->...lc", (1.0 / self.denominators[h]) @ (self.frame.sensors * participation).T, force[..., h]
            )
            for h in range(2, self.highest + 1)
        ]
        if not parts:
            return np.zeros((*force.shape[:-1], len(self.shapes), 0), complex)
        return np.stack(parts, axis=-1)

    def assembled(self, residual: ComplexArray, y: ComplexArray, beyond: ComplexArray) -> ComplexArray:
        """Rows (…, L, R) of force residuals (…, L, T), fundamentals (…, L, C) and harmonics (…, L, C, H − 1)."""
        q = y @ self.take_q.T
        parts = [residual - self.near * q, y - q @ self.shapes.T, beyond.reshape(*beyond.shape[:-2], -1)]
        return np.concatenate(parts, axis=-1)

    @cached_property
    def measured(self) -> ComplexArray:
        """Rows (L, R) as measured, the drive's part taken off."""
        motion = np.nan_to_num(self.levels.motion)
        y = motion[:, :, 1]
        rows = self.assembled(np.zeros_like(self.near), y, motion[:, :, 2 : self.highest + 1])
        for participation, force in self.drives:
            rows = rows - self.of_force(participation, force)
        return rows

    @cached_property
    def sigma(self) -> FloatArray:
        """Standard deviation (L, R) of the rows: noise, and what model and chain are smoothly off by; inf = unknown."""
        levels, limits = self.levels, THRESHOLDS.law
        std = np.where(np.isfinite(levels.motion), levels.motion_std, np.inf)
        size = np.abs(np.nan_to_num(levels.motion))
        of_each = [
            np.abs(participation[self.modes]) * np.hypot(noise, limits.force_share * np.abs(force[:, 1]))[:, np.newaxis]
            for (participation, force), noise in zip(self.drives, self.force_std, strict=True)
        ]
        drive = np.sqrt(np.sum(np.square(of_each), axis=0))
        # What a law does is known as well as the motion that it does it along.
        first = np.nan_to_num(levels.motion[:, :, 1])
        count = len(self.modes)
        missing = np.linalg.norm(self.measured[:, :count], axis=1)[:, np.newaxis]
        drive = np.hypot(drive, limits.transfer_std * missing)
        q = first @ self.take_q.T
        unexplained = first - q @ self.shapes.T
        changed = np.abs(unexplained - q[:, :1] * (unexplained[0] / q[0, 0]))
        repeats = np.hypot(std[:, :, 1], limits.shape_share * size[:, :, 1])
        q_std = np.sqrt(repeats**2 @ (self.take_q**2).T)
        residual = np.hypot(drive, np.abs(self.near) * q_std)
        shape = np.hypot(repeats, limits.transfer_std * changed)
        beyond = []
        for h in range(2, self.highest + 1):
            doubt = self.frame.tolerance(levels.omega, h, limits.mode_frequency_std, limits.mode_damping_std)
            doubt = np.hypot(doubt, limits.transfer_std)
            floor = limits.harmonic_share * size[:, :, 1]
            beyond.append(np.sqrt(std[:, :, h] ** 2 + (doubt * size[:, :, h]) ** 2 + floor**2))
        parts = [residual, shape]
        if beyond:
            parts.append(np.stack(beyond, axis=-1).reshape(levels.count, -1))
        return np.concatenate(parts, axis=1)

    def whitened(self, rows: ComplexArray) -> FloatArray:
        """Real rows (…, L, 2R) over their standard deviations."""
        scaled = rows / self.sigma
        return np.concatenate([scaled.real, scaled.imag], axis=-1)

    def coordinate(self, forces: list[tuple[FloatArray, ComplexArray]]) -> ComplexArray:
        """q of the frame's modes at each level (L, T), other forces than the drive given as participation and
        harmonics."""
        y = np.nan_to_num(self.levels.motion[:, :, 1]).copy()
        for participation, force in [*self.drives, *forces]:
            y += (self.others @ (self.frame.sensors * participation).T) * force[:, 1:2]
        return np.asarray(y @ self.take_q.T)

    def motion(self, participation: FloatArray, forces: list[tuple[FloatArray, ComplexArray]]) -> ComplexArray:
        """Harmonics (L, ORDERS + 1) of the motion of a place, m: fundamental from q, the rest by the model."""
        result = np.zeros((self.levels.count, ORDERS + 1), complex)
        for other, force in [*self.drives, *forces]:
            both = participation * other
            result[:, 1] -= (self.others @ both) * force[:, 1]
            for h in (0, *range(2, ORDERS + 1)):
                result[:, h] -= ((1.0 / self.denominators[h]) @ both) * force[:, h]
        result[:, 1] += self.coordinate(forces) @ participation[self.modes]
        # A mean of a real force is real.
        result[:, 0] = result[:, 0].real
        return result
