"""Targets of the forces of several exciters that together isolate one mode.

A nonlinear mode of the extended periodic motion concept is kept up by the force ξ M ẋ. With the modal coordinates
η_n = Φ⁺ ψ_n of harmonic n, exciters at points with the shapes Φ_e make the same modal forces when

    Φ_eᵀ F_n = ξ i n ω η_n,   hence   F_n* = F_11 · w_n / w_11,   w_n = (Φ_eᵀ)⁺ i n η_n.

The fundamental of the first exciter is the reference: its amplitude is the level, and the phase loop brings it into
phase resonance. Of every other exciter the fundamental's amplitude follows |w_j1| and its phase the velocity of its own
point, so that each is in phase resonance where it stands, also with shapes that are not quite right; the powers of the
forces then follow the modal shape. Harmonics go to w_n, or to zero.

The targets follow what is measured more slowly than forces follow their targets. A force ξ M ẋ that follows the motion
at once is negative damping, which drives up any mode that is damped less than the target. As long as the ratios of the
targets move slowly compared with the distance of the other modes, the excitation frequency keeps those modes where
they are. They begin with those of the linear mode.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_pll.force_control.force_targets import ForceTargets
from nmt_pll.thresholds import HARMONICS


def generalised_pbmif(force: ComplexArray, velocity: ComplexArray) -> float:
    """|Σ P_jn| / Σ_j S_j of all exciters and harmonics: 1 where each exciter is in phase resonance at its own point.

    For one exciter it is the usual power-based mode indicator |P| / S.

    Args:
        force: F_jn, N, shape (exciters, H).
        velocity: at their points, m/s (any common scale), shape (exciters, H).
    """
    power = float((force * velocity.conj()).real.sum())
    apparent = np.sqrt((np.abs(force) ** 2).sum(axis=1) * (np.abs(velocity) ** 2).sum(axis=1)).sum()
    return abs(power) / float(apparent) if apparent > 0.0 else 0.0


class ModeShapeTargets(ForceTargets):
    """Targets of several exciters' forces that together isolate the target mode.

    Args:
        linear: linear description with the points of several exciters.
        modal: whether harmonics go to w_n; else to zero.
        rate: κ of the forces' control, by which the targets of harmonics follow, 1/s.
        dwell_blocks: blocks over which MAC and PBMIF are judged.
        mac_limit: least MAC of the fundamental with the target mode at lock.
        pbmif_limit: least generalised PBMIF at lock.

    Attributes:
        following: rate by which the targets of fundamentals follow, 1/s.
        mac, pbmif: mode indicators of the newest block.

    Raises:
        BenchError: fewer linear modes than exciters, or an exciter where no response is measured.
    """

    def __init__(
        self,
        linear: LinearDescription,
        modal: bool,
        rate: float,
        dwell_blocks: int,
        mac_limit: float = 0.8,
        pbmif_limit: float = 0.9,
    ) -> None:
        check_exciters(linear, "Several exciters")
        self.points = linear.points
        self.following = min(rate, HARMONICS.shape_following_ratio * _nearest_mode(linear))
        self.mac = self.pbmif = math.nan
        self._modal = modal
        self._rate = rate
        self._limits = mac_limit, pbmif_limit
        shapes = linear.shape_matrix
        self._at = [linear.points.index(point) for point in linear.exciter_points]
        self._to_modes: FloatArray = np.asarray(np.linalg.pinv(shapes), dtype=np.float64)
        self._to_forces: FloatArray = np.asarray(np.linalg.pinv(shapes[self._at].T), dtype=np.float64)
        self._target_shape: FloatArray = shapes[:, linear.target_mode]
        self.linear_forces: FloatArray = self._to_forces[:, linear.target_mode]
        self._ratios: ComplexArray | None = None
        self._fundamentals: ComplexArray = self.linear_ratios
        self._indicators: deque[tuple[float, float]] = deque(maxlen=dwell_blocks)

    @property
    def linear_ratios(self) -> ComplexArray:
        """ρ = F_j1*/F_11 of the linear mode, shape (exciters,)."""
        first = self.linear_forces[0] if self.linear_forces[0] != 0.0 else 1.0
        return np.asarray(self.linear_forces / first, dtype=np.complex128)

    def clear(self) -> None:
        """The drive is at rest: targets are those of the linear mode."""
        self._ratios = None
        self._fundamentals = self.linear_ratios
        self.restart_dwell()

    def restart_dwell(self) -> None:
        """Judge what comes from now on."""
        self._indicators.clear()

    def targets(self, force: ComplexArray, response: ComplexArray, quantity: Quantity, duration: float) -> ComplexArray:
        """As of the base class, from the shape that is measured; MAC and PBMIF are those of the block."""
        order = np.arange(1, force.shape[1] + 1)
        motion = response / (1j * order) ** MOTIONS[quantity]  # displacements, but for a factor they share
        velocity = 1j * order * motion
        weights = self._to_forces @ (self._to_modes @ velocity)
        target = super().targets(force, response, quantity, duration)
        own = velocity[self._at, 0]
        first = weights[0, 0] if weights[0, 0] != 0.0 else 1.0
        size = np.abs(weights[:, 0] / first)
        # Each exciter's phase against its velocity is that of the first one's, which the phase loop brings to zero.
        turn = own * own[0].conjugate()
        turn = turn / np.maximum(np.abs(turn), 1e-300)
        side = np.where((weights[:, 0] / first * turn.conjugate()).real >= 0.0, 1.0, -1.0)
        now = side * size * turn
        before = self._fundamentals
        self._fundamentals = before + min(1.0, self.following * duration) * (now - before)
        target[1:, 0] = self._fundamentals[1:] * force[0, 0]
        if self._modal and force.shape[1] > 1 and abs(force[0, 0]) > 0.0:
            ratio = weights[:, 1:] / first
            ratio = ratio * np.minimum(1.0, HARMONICS.largest_target_ratio / np.maximum(np.abs(ratio), 1e-300))
            before = np.zeros_like(ratio) if self._ratios is None else self._ratios
            self._ratios = before + min(1.0, self._rate * duration) * (ratio - before)
            target[:, 1:] = self._ratios * force[0, 0]
        correlation = complex(self._target_shape @ motion[:, 0])
        energy = float((np.abs(motion[:, 0]) ** 2).sum() * (self._target_shape**2).sum())
        self.mac = abs(correlation) ** 2 / energy if energy > 0.0 else 0.0
        self.pbmif = generalised_pbmif(force, velocity[self._at])
        self._indicators.append((self.mac, self.pbmif))
        return target

    @property
    def _means(self) -> tuple[float, float]:
        """MAC and PBMIF over the dwell; 0 where nothing was measured yet."""
        if not self._indicators:
            return 0.0, 0.0
        mac, pbmif = np.mean(self._indicators, axis=0).tolist()
        return mac, pbmif

    @property
    def obstacle(self) -> str:
        """What keeps the shape from being that of the mode, empty if nothing does."""
        for name, value, limit in zip(
            ("MAC with the target mode", "generalised PBMIF"), self._means, self._limits, strict=True
        ):
            if value < limit:
                return f"the {name} is {value:.3f}, below {limit:g}"
        return ""

    @property
    def summary(self) -> str:
        """MAC and PBMIF."""
        mac, pbmif = self._means
        return f"MAC {mac:.4f}, PBMIF {pbmif:.4f}"


def _nearest_mode(linear: LinearDescription) -> float:
    """Least |δ_k + i (ω_k − ω)| of the modes besides the target, rad/s; infinity where there is none."""
    target = linear.frequencies_rad_s[linear.target_mode]
    others = [
        abs(ratio * omega + 1j * (omega - target))
        for k, (omega, ratio) in enumerate(zip(linear.frequencies_rad_s, linear.damping_ratios, strict=True))
        if k != linear.target_mode
    ]
    return min(others, default=math.inf)


def check_exciters(linear: LinearDescription, where: str) -> None:
    """Refuse (BenchError) a linear description that does not say enough for its exciters."""
    points = linear.exciter_points
    if len(linear.frequencies_rad_s) < len(points):
        raise BenchError(
            f"{where}: {len(points)} exciters need a linear description of as many modes, this one has "
            f"{len(linear.frequencies_rad_s)}; raise extraction.linear_modes or the modes of the linear test."
        )
    for point in points:
        if point not in linear.points:
            raise BenchError(f"{where}: no response is measured at point {point} of an exciter; add a sensor there.")
