"""Amplitudes and phases of several exciters that together isolate one mode.

A nonlinear mode of the extended periodic motion concept is kept up by the force ξ M ẋ. With the modal coordinates
η_n = Φ⁺ ψ_n of harmonic n, exciters at points with the shapes Φ_e make the same modal forces when

    Φ_eᵀ F_n = ξ i n ω η_n,   hence   F_n* = F_11 · w_n / w_11,   w_n = (Φ_eᵀ)⁺ i n η_n.

The fundamental of the first exciter is the reference: its amplitude is the level, and the phase loop brings it into
phase resonance. Of every other exciter the fundamental's amplitude follows |w_j1| and its phase the velocity of its own
point, so that each is in phase resonance where it stands, also with shapes that are not quite right; the powers of the
forces then follow the modal shape. Harmonics go to w_n, or to zero.

With the drive u_j = V Re Σ r_jn exp(i n θ) every ratio r_jn is integrated against the deviation of its force,

    V dr_n/dt = −κ Ĝ_n⁻¹ (F_n − F_n*),

with the force per volt Ĝ_n (exciters, exciters) at n f, and κ as for the harmonics of one exciter. At resonance
the force follows the voltage as (s + δ_s)/(s + δ_p), slowly with little and at once with much. For the fundamental Ĝ is
therefore diagonal, with the phase of the force per volt beside the resonance and the size

    |Ĝ_j| = max over |ν| ≥ κ of κ/|ν| Σ_i |G_ji(ω + ν) − ρ_j G_1i(ω + ν)|,   ρ = F*/F_1,

so that the loop's gain is at most one from κ on, where filter and dead time count. Below, its phase stays within ±90°
of an integrator's because exciter and structure are passive.

The targets follow what is measured more slowly than forces follow their targets. A force ξ M ẋ that follows the motion
at once is negative damping, which drives up any mode that is damped less than the target. As long as the ratios of the
targets move slowly beside the distance of the other modes, the excitation frequency keeps those modes where they are.
They begin with those of the linear mode.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import json_value
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import DriveTerm
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_pll.harmonics.deviation_record import DeviationRecord
from nmt_pll.harmonics.harmonics_control import integral_rate
from nmt_pll.thresholds import HARMONICS

ForceMatrix = Callable[[FloatArray], ComplexArray]
"""Force at every exciter per volt of every exciter, N/V, (k, exciters, exciters), at frequencies in Hz (k,)."""


@dataclass(frozen=True, slots=True)
class AppropriationSetup:
    """How the exciters are controlled.

    Attributes:
        highest: H; harmonics 2 to H of every force are controlled, 1 = none.
        modal: whether their targets are those of the modal shape; else zero.
        cutoff: ω_LP of the filter that the amplitudes come from, rad/s.
        block_duration: s.
        dead_time: mean delay between measurement and its effect, s.
        dwell_blocks: blocks over which what is settled is judged.
        voltage_limit: V that an exciter's terms must stay below together; 0 = none.
        mac_limit: least MAC of the fundamental with the target mode at lock.
        pbmif_limit: least generalised PBMIF at lock.
        tolerance: deviation that counts as settled, of the first exciter's fundamental.
    """

    highest: int
    modal: bool
    cutoff: float
    block_duration: float
    dead_time: float
    dwell_blocks: int
    voltage_limit: float = 0.0
    mac_limit: float = 0.8
    pbmif_limit: float = 0.9
    tolerance: float = HARMONICS.settled_share


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


class ExciterAppropriation:
    """Ratios of all exciters' voltages to the first one's fundamental.

    Args:
        setup: how.
        linear: linear description with the points of several exciters.
        force_per_volt: G(f).

    Attributes:
        ratios: r_jn, shape (exciters, H); r_11 stays 1.
        mac, pbmif: mode indicators of the newest block.

    Raises:
        BenchError: fewer linear modes than exciters, or an exciter where no response is measured.
    """

    def __init__(self, setup: AppropriationSetup, linear: LinearDescription, force_per_volt: ForceMatrix) -> None:
        check_exciters(linear, "Several exciters")
        self.setup = setup
        self.linear = linear
        self.rate = integral_rate(setup.cutoff, setup.dead_time)
        self.mac = self.pbmif = math.nan
        self._force_per_volt = force_per_volt
        shapes = linear.shape_matrix
        self._at = [linear.points.index(point) for point in linear.exciter_points]
        self._to_modes: FloatArray = np.asarray(np.linalg.pinv(shapes), dtype=np.float64)
        self._to_forces: FloatArray = np.asarray(np.linalg.pinv(shapes[self._at].T), dtype=np.float64)
        self._target_shape: FloatArray = shapes[:, linear.target_mode]
        count = len(self._at)
        self.ratios: ComplexArray = np.zeros((count, setup.highest), complex)
        self._ratio_target: ComplexArray | None = None
        self._fundamental_target: ComplexArray = np.zeros(count, complex)
        self.following = min(self.rate, HARMONICS.shape_following_ratio * _nearest_mode(linear))
        shape = count, setup.highest
        self._record = DeviationRecord(setup.dwell_blocks, shape, setup.cutoff, setup.block_duration)
        self._indicators: FloatArray = np.zeros((self._record.blocks, 2))
        self.clear()
        self._fundamental_gain = self._largest_gain()

    @property
    def exciters(self) -> int:
        """Number of exciters."""
        return int(self.ratios.shape[0])

    # -- levels --------------------------------------------------------------------------------------------------

    def clear(self) -> None:
        """The drive is at rest: ratios are those that the linear modes ask for."""
        self.ratios[:] = 0.0
        self.ratios[:, 0] = self._linear_ratios()
        self._ratio_target = None
        wanted = self._to_forces[:, self.linear.target_mode]
        first = wanted[0] if wanted[0] != 0.0 else 1.0
        self._fundamental_target = (wanted / first).astype(complex)
        self.start_level()

    def start_level(self) -> None:
        """A new level begins; the ratios stay."""
        self._record.restart()

    def _linear_ratios(self) -> ComplexArray:
        """V_j / V_1 that isolate the linear mode at its frequency, with the first exciter as reference."""
        wanted = self._to_forces[:, self.linear.target_mode].astype(complex)
        gain = self._force_per_volt(np.array([self.linear.frequency_hz]))[0]
        voltages = np.linalg.solve(gain, wanted)
        if not abs(voltages[0]) > 0.0 or not np.isfinite(voltages).all():
            return np.asarray(np.eye(1, self.exciters)[0], dtype=np.complex128)
        return np.asarray(voltages / voltages[0], dtype=np.complex128)

    def _largest_gain(self) -> ComplexArray:
        """Ĝ_j of the fundamental, N/V, shape (exciters,); see the module's text."""
        frequency = self.linear.frequency_hz
        least = self.rate / (2.0 * math.pi)
        away = np.geomspace(least, max(HARMONICS.resonance_band_ratio - 1.0, 2.0 * least / frequency) * frequency, 200)
        both = np.concatenate([frequency - away[away < 0.5 * frequency], frequency + away])
        gains = self._force_per_volt(both)
        ratio = self._fundamental_target
        rows = np.abs(gains[:, :, 1:] - ratio[:, None] * gains[:, :1, 1:]).sum(axis=2)
        size = (least / np.abs(both - frequency)[:, None] * rows).max(axis=0)
        beside = np.diagonal(self._force_per_volt(np.array([HARMONICS.resonance_band_ratio * frequency]))[0])
        return np.asarray(size * beside / np.maximum(np.abs(beside), 1e-300), dtype=np.complex128)

    # -- one block -----------------------------------------------------------------------------------------------

    def targets(self, force: ComplexArray, response: ComplexArray, quantity: Quantity, duration: float) -> ComplexArray:
        """F_jn*, N, shape (exciters, H), for what is measured.

        Args:
            force: F_jn, N, shape (exciters, H).
            response: harmonics at the points of the linear description, any unit, shape (points, H).
            quantity: what the response is.
            duration: s since the last block.
        """
        order = np.arange(1, force.shape[1] + 1)
        motion = response / (1j * order) ** MOTIONS[quantity]  # displacements, but for a factor they share
        velocity = 1j * order * motion
        weights = self._to_forces @ (self._to_modes @ velocity)
        target = np.zeros_like(force)
        target[0, 0] = force[0, 0]
        own = velocity[self._at, 0]
        first = weights[0, 0] if weights[0, 0] != 0.0 else 1.0
        size = np.abs(weights[:, 0] / first)
        # Each exciter's phase against its velocity is that of the first one's, which the phase loop brings to zero.
        turn = own * own[0].conjugate()
        turn = turn / np.maximum(np.abs(turn), 1e-300)
        side = np.where((weights[:, 0] / first * turn.conjugate()).real >= 0.0, 1.0, -1.0)
        now = side * size * turn
        before = self._fundamental_target
        self._fundamental_target = before + min(1.0, self.following * duration) * (now - before)
        target[1:, 0] = self._fundamental_target[1:] * force[0, 0]
        if self.setup.modal and force.shape[1] > 1 and abs(force[0, 0]) > 0.0:
            ratio = weights[:, 1:] / first
            ratio = ratio * np.minimum(1.0, HARMONICS.largest_target_ratio / np.maximum(np.abs(ratio), 1e-300))
            before = np.zeros_like(ratio) if self._ratio_target is None else self._ratio_target
            self._ratio_target = before + min(1.0, self.rate * duration) * (ratio - before)
            target[:, 1:] = self._ratio_target * force[0, 0]
        correlation = complex(self._target_shape @ motion[:, 0])
        energy = float((np.abs(motion[:, 0]) ** 2).sum() * (self._target_shape**2).sum())
        self.mac = abs(correlation) ** 2 / energy if energy > 0.0 else 0.0
        self.pbmif = generalised_pbmif(force, velocity[self._at])
        return target

    def update(
        self, force: ComplexArray, response: ComplexArray, quantity: Quantity, frequency_hz: float, amplitude: float
    ) -> None:
        """One block of control; ``ratios`` are those of the next block.

        Args:
            force, response, quantity: as of :meth:`targets`, behind the adaptive filter.
            frequency_hz: of the fundamental.
            amplitude: of the first exciter's fundamental, V.
        """
        duration = self.setup.block_duration
        deviation = force - self.targets(force, response, quantity, duration)
        scale = max(abs(force[0, 0]), 1e-300)
        self._indicators[self._record.count % self._record.blocks] = self.mac, self.pbmif
        self._record.add(deviation / scale)
        step = np.zeros_like(self.ratios)
        step[1:, 0] = deviation[1:, 0] / self._fundamental_gain[1:]
        if self.ratios.shape[1] > 1:
            gains = self._force_per_volt(frequency_hz * np.arange(2, self.ratios.shape[1] + 1))
            step[:, 1:] = np.linalg.solve(gains, deviation[:, 1:].T[:, :, None])[:, :, 0].T
        step *= -self.rate * duration / amplitude
        size = np.abs(step)
        step *= np.minimum(1.0, HARMONICS.largest_step_share / np.maximum(size, 1e-300))
        self.ratios = self.ratios + step
        self.fit(amplitude)

    def fit(self, amplitude: float) -> None:
        """Keep every exciter's terms within the voltage limit beside a drive of this amplitude, V."""
        limit = HARMONICS.voltage_limit_share * self.setup.voltage_limit
        if not limit > 0.0 or not amplitude > 0.0:
            return
        sums = np.abs(self.ratios).sum(axis=1)
        for j in np.flatnonzero(sums * amplitude > limit):
            fixed = 1.0 if j == 0 else 0.0
            share = max(0.0, limit / amplitude - fixed) / max(float(sums[j]) - fixed, 1e-300)
            self.ratios[j] *= min(1.0, share)
            if j == 0:
                self.ratios[0, 0] = 1.0

    # -- judgement -----------------------------------------------------------------------------------------------

    @property
    def obstacle(self) -> str:
        """What keeps the exciters from being settled, empty if nothing does."""
        if not self._record.is_full:
            return "the exciters have not been controlled for a dwell yet"
        mean, noise = self._record.mean_and_noise()
        allowed = self.setup.tolerance + HARMONICS.noise_sigmas * self._record.mean_std(noise)
        excess = np.abs(mean) / allowed
        if excess.max() > 1.0:
            j, n = np.unravel_index(int(np.argmax(excess)), excess.shape)
            return (
                f"harmonic {n + 1} of the force of exciter {j + 1} is {100.0 * abs(mean[j, n]):.2g} % of the "
                "fundamental off its target"
            )
        mac, pbmif = self._indicators.mean(axis=0)
        if mac < self.setup.mac_limit:
            return f"the MAC with the target mode is {mac:.3f}, below {self.setup.mac_limit:g}"
        if pbmif < self.setup.pbmif_limit:
            return f"the generalised PBMIF is {pbmif:.3f}, below {self.setup.pbmif_limit:g}"
        return ""

    @property
    def summary(self) -> str:
        """How the exciters are: the greatest deviation, MAC and PBMIF."""
        mean, _ = self._record.mean_and_noise()
        mac, pbmif = self._indicators.mean(axis=0)
        worst = 100.0 * float(np.abs(mean).max())
        return (
            f"forces of {self.exciters} exciters within {worst:.2g} % of the fundamental, MAC {mac:.4f}, "
            f"PBMIF {pbmif:.4f}"
        )

    @property
    def terms(self) -> tuple[DriveTerm, ...]:
        """Terms of the drive, as in :class:`~nmt_core.records.DriveCommand`."""
        return tuple(
            DriveTerm(j + 1, n + 1, complex(self.ratios[j, n]))
            for j in range(self.ratios.shape[0])
            for n in range(self.ratios.shape[1])
            if (j, n) != (0, 0)
        )


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


def matrix_table(rows: Sequence[Sequence[float]], exciters: int) -> ForceMatrix:
    """G(f) from rows of frequency (Hz) and, row by row, real and imaginary parts of G (N/V); straight in between.

    Beyond the rows the nearest counts.

    Raises:
        BenchError: no rows, or rows of another length.
    """
    table = np.array(sorted(map(tuple, rows)), float)
    if table.ndim != 2 or table.shape[1] != 1 + 2 * exciters**2 or not np.isfinite(table).all():
        raise BenchError(
            f"The force per volt of {exciters} exciters must be rows of {1 + 2 * exciters**2} finite numbers: "
            "frequency in Hz, then real and imaginary part in N/V, row by row."
        )
    frequency = table[:, 0].copy()
    values = table[:, 1::2] + 1j * table[:, 2::2]

    def value(frequency_hz: FloatArray) -> ComplexArray:
        columns = [np.interp(frequency_hz, frequency, column) for column in values.T]
        return np.asarray(np.stack(columns, axis=-1), complex).reshape(-1, exciters, exciters)

    return value


def matrix_table_from_json(text: str, exciters: int) -> ForceMatrix:
    """`matrix_table` of the rows of a JSON text.

    Raises:
        BenchError: it is not JSON, or not such rows.
    """
    rows = json_value(text, "The force per volt")
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise BenchError("The force per volt of several exciters must be a list of rows of numbers.")
    return matrix_table(rows, exciters)
