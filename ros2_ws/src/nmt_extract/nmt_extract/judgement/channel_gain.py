"""The gain of one channel against modes that take part: what one level cannot tell, the levels together can.

A gain is one real factor of one channel at every level. A near mode takes part as force and frequency let it: hardly
where the frequency is still that of the linear mode, and by a shape that is known. So the shapes of all levels so far
are fitted twice, with the modes alone and with one channel's gain next to them.

The reference is the linear description. Shapes of a test with the same channels have the same gains in them: such a
gain fits, and nothing is found. A channel that is not named is not thereby known to be right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_extract.judgement.moving_shape import near_modes
from nmt_extract.judgement.thresholds import THRESHOLDS

_STEPS = 6  # of the fit of a gain: each leaves a tenth of the error

MOST_LEVELS = 16
"""Levels that are fitted: of more, those whose frequency is nearest to the linear one; they say most of a gain."""


class ShapeLevel(NamedTuple):
    """A level as the fit needs it.

    Attributes:
        omega: frequency, rad/s.
        shape: fundamental displacements at the points of the description, m, shape ``(points,)``.
        std: their standard uncertainties, m, same shape; NaN = not known.
        forces: fundamental force of every exciter, N, shape ``(exciters,)``.
    """

    omega: float
    shape: ComplexArray
    std: FloatArray
    forces: ComplexArray


class ChannelGain(NamedTuple):
    """A gain that is off.

    Attributes:
        place: of the point in the shape, from 0.
        ratio: measured over true.
        std: standard uncertainty of the ratio.
        levels: how many levels say so.
    """

    place: int
    ratio: float
    std: float
    levels: int


def channel_gain(levels: Sequence[ShapeLevel], linear: LinearDescription) -> ChannelGain | None:
    """The channel whose gain is off at all levels, if that is clear; None = it is not, or there is nothing to compare.

    Args:
        levels: so far, in any order.
        linear: modes; the shapes are compared with the target and those near its frequency.
    """
    target = linear.frequencies_rad_s[linear.target_mode]
    near = near_modes(linear, target)
    if not near or len(linear.points) < len(near) + 2:
        return None
    chosen = sorted(levels, key=lambda level: abs(level.omega - target))[:MOST_LEVELS]
    fit = _Fit(chosen, linear, near)
    without = fit.misfit(np.ones(len(linear.points)))
    if without < THRESHOLDS.gain.evidence:
        return None
    gains = sorted((fit.gain(index) for index in range(len(linear.points))), key=lambda gain: gain.misfit)
    best, second = gains[0], gains[1]
    limits = THRESHOLDS.gain
    clear = (
        without - best.misfit > limits.evidence
        and second.misfit - best.misfit > limits.lead
        and best.misfit < limits.misfit * fit.freedom
        and abs(best.ratio - 1.0) > limits.smallest
    )
    return ChannelGain(best.place, best.ratio, best.std, len(chosen)) if clear else None


class _Gain(NamedTuple):
    place: int
    ratio: float
    std: float
    misfit: float


class _Fit:
    """Shapes of all levels over their target coordinate, fitted by the modes, which have errors common to all levels.

    For level l and point p, with the share c of each near mode: w = α φ₁ + Σ c φ_k + δ₁ + Σ c δ_k. Unknown are α and c
    (complex, of each level) and δ (real, of each mode); c and δ have a prior each.

    Args:
        levels: shapes.
        linear: modes.
        near: those next to the target.
    """

    def __init__(self, levels: Sequence[ShapeLevel], linear: LinearDescription, near: Sequence[int]) -> None:
        chosen = [linear.target_mode, *near]
        self.modes = linear.shape_matrix[:, chosen]
        self.levels, self.linear, self.near = levels, linear, list(near)
        points, columns = self.modes.shape
        self.freedom = 2 * len(levels) * (points - 1) - 1
        self.inverse: FloatArray = np.asarray(np.linalg.pinv(self.modes), dtype=np.float64)
        largest = np.abs(self.modes).max(axis=0)
        floor = THRESHOLDS.gain.shape_floor * largest
        stds: FloatArray = np.asarray(np.hypot(THRESHOLDS.gain.model_shape * self.modes, floor))
        if linear.shape_stds:
            known = np.array(linear.shape_stds, dtype=np.float64)[:, chosen]
            stds = np.asarray(np.where(np.isfinite(known), np.hypot(known, floor), stds))
        self.mode_stds = stds
        self.shared = points * columns

    def gain(self, index: int) -> _Gain:
        """The gain of one channel that fits best."""
        ratios, std = np.ones(len(self.linear.points)), math.nan
        for _ in range(_STEPS):
            matrix, value, slope = self._system(ratios, index)
            # The residual of the slope and of the value once all else is fitted.
            free = np.linalg.lstsq(matrix, np.stack([value, slope], axis=1), rcond=None)[0]
            value, slope = value - matrix @ free[:, 0], slope - matrix @ free[:, 1]
            size = float(slope @ slope)
            if not size > 0.0:
                return _Gain(index, 1.0, math.inf, math.inf)
            std = float(ratios[index]) / math.sqrt(size)
            # A step of the logarithm: no gain changes its sign.
            ratios[index] *= math.exp(min(max(float(slope @ value) / size, -0.5), 0.5))
        return _Gain(index, float(ratios[index]), std, self.misfit(ratios))

    def misfit(self, ratios: FloatArray) -> float:
        """Sum of squares that is left when channels are divided by gains, shape ``(points,)``."""
        matrix, value, _ = self._system(ratios, 0)
        left = value - matrix @ np.linalg.lstsq(matrix, value, rcond=None)[0]
        return float(left @ left)

    def _system(self, ratios: FloatArray, index: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rows over their standard deviations: factors of the unknown, values, and their change by ln of one gain."""
        columns = self.modes.shape[1]
        width = 2 * columns * len(self.levels) + self.shared
        blocks, values, slopes = [], [], []
        for place, level in enumerate(self.levels):
            rows, value, slope = self._rows_of(level, ratios, index)
            block = np.zeros((rows.shape[0], width))
            block[:, 2 * columns * place : 2 * columns * (place + 1)] = rows[:, : 2 * columns]
            block[:, width - self.shared :] = rows[:, 2 * columns :]
            blocks.append(block)
            values.append(value)
            slopes.append(slope)
        prior = np.zeros((self.shared, width))
        prior[:, width - self.shared :] = np.diag(1.0 / self.mode_stds.ravel())
        zeros = np.zeros(self.shared)
        return np.concatenate([*blocks, prior]), np.concatenate([*values, zeros]), np.concatenate([*slopes, zeros])

    def _rows_of(self, level: ShapeLevel, ratios: FloatArray, index: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rows of one level: real and imaginary part of every point, then those of the shares of near modes."""
        modes, (points, columns) = self.modes, self.modes.shape
        shape = level.shape / ratios
        coordinates = self.inverse @ shape
        target = complex(coordinates[0])
        shares = coordinates / target
        value = shape / target
        real, imag = self._stds(level, np.abs(target), value)
        factors = np.zeros((points, columns + self.shared), dtype=np.complex128)
        factors[:, :columns] = modes
        for point in range(points):
            factors[point, columns + point * columns : columns + (point + 1) * columns] = shares
        wide = np.concatenate([factors[:, :columns], 1j * factors[:, :columns], factors[:, columns:]], axis=1)
        slope = np.zeros(points, dtype=np.complex128)
        slope[index] = value[index]
        expected, std = self._shares(level, target)
        prior = np.zeros((columns - 1, wide.shape[1]), dtype=np.complex128)
        for k in range(columns - 1):
            prior[k, 0], prior[k, columns] = -expected[k], -1j * expected[k]
            prior[k, 1 + k], prior[k, columns + 1 + k] = 1.0, 1.0j
        matrix = np.concatenate(
            [wide.real / real[:, np.newaxis], wide.imag / imag[:, np.newaxis],
             prior.real / std[:, np.newaxis], prior.imag / std[:, np.newaxis]]
        )  # fmt: skip
        zeros = np.zeros(2 * (columns - 1))
        return (
            matrix,
            np.concatenate([value.real / real, value.imag / imag, zeros]),
            np.concatenate([slope.real / real, slope.imag / imag, zeros]),
        )

    def _stds(self, level: ShapeLevel, target: float, value: ComplexArray) -> tuple[FloatArray, FloatArray]:
        """Standard deviations of real and imaginary parts of a shape over its target coordinate.

        Modes beyond those described follow a nonlinear force, which shifts the frequency, and the exciters, whose force
        balances the damping a quarter of a period apart.
        """
        largest = float(np.abs(value).max())
        at_rest = self.linear.frequencies_rad_s[self.linear.target_mode]
        shift = abs(level.omega**2 / at_rest**2 - 1.0)
        real = np.hypot(np.nan_to_num(level.std) / target, math.hypot(THRESHOLDS.gain.shape_floor, shift) * largest)
        damping = 2.0 * self.linear.damping_ratios[self.linear.target_mode]
        return real, np.hypot(real, damping * largest)

    def _shares(self, level: ShapeLevel, target: complex) -> tuple[ComplexArray, FloatArray]:
        """Shares of the near modes that the exciters drive in the linear structure, and their standard deviations."""
        linear, omega = self.linear, level.omega
        at_rest = linear.frequencies_rad_s[linear.target_mode]
        gap = min(abs(linear.frequencies_rad_s[mode] - at_rest) for mode in self.near)
        exciters = linear.exciter_points or (linear.drive_point,)
        shift = abs(omega - at_rest) / max(gap, 1e-300)
        driven, largest = np.zeros(len(self.near), dtype=np.complex128), np.abs(self.modes[:, 1:]).max(axis=0)
        for k, mode in enumerate(self.near):
            natural = linear.frequencies_rad_s[mode]
            dynamic = natural**2 - omega**2 + 2j * linear.damping_ratios[mode] * natural * omega
            for point, force in zip(exciters, level.forces, strict=True):
                # Where no sensor stands at an exciter, its value is taken to be the largest of the shape.
                measured = point in linear.points
                size = linear.shape_matrix[linear.points.index(point), mode] if measured else largest[k]
                driven[k] += size * force / dynamic / target
        std = np.hypot(THRESHOLDS.gain.mixing * shift + THRESHOLDS.gain.mixed, THRESHOLDS.gain.driven * np.abs(driven))
        if not set(exciters) <= set(linear.points):
            std = np.hypot(std, np.abs(driven))
        return driven, np.asarray(std)
