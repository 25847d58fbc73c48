"""Modal properties of a window in a secondary resonance.

Orders and lags are those of :mod:`nmt_core.messages.secondary_resonance`. Harmonics count in the base frequency Ω/ν,
so that the force has the order ν and the resonant part of the response the order k. Modal frequency, amplitude, shape
and MAC are those of the order k. The force feeds another order than the one in resonance, so that damping follows from
the power balance over all of them: with one ξ for every order

    P = Σ_n ½ Re(v_n F̄_n) = ½ ξ Σ_n (n ω_b)² q_n²,    δ̃ = ξ / (2 k ω_b),

which is the paper's equation for ξ where one order alone vibrates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.secondary_resonance import SecondaryResonance, resonance_of
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_extract.channel_judge import ChannelHistory
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.modal import ModalQuantities, WindowEvaluation
from nmt_extract.modal_point import EVALUATED, ModalPoint, Status, bench_time_ns, rejected_point
from nmt_extract.window import Window
from nmt_signals.channel_faults import clipping

_PHASE_LIMIT = math.radians(10.0)
"""Deviation of the resonant order's phase from which on the window has a remark."""


@dataclass(frozen=True, eq=False)
class SecondaryQuantities(ModalQuantities):
    """What follows from the orders of a secondary resonance; ``omega`` is the base frequency ω_b, rad/s.

    ``shape`` and ``coordinates`` are those of the order k. Powers are over all orders, ``gamma_force`` and
    ``gamma_acceleration`` the content of the orders ν and k, ``phase_error`` is (θ − its value at resonance) / ν, of a
    hardening or a softening spring, whichever is nearer.

    Attributes:
        resonance: k:ν.
        sizes: q_n = |Φ⁺ψ_n|, m√kg, shape ``(sets, H)``.
    """

    resonance: SecondaryResonance
    sizes: FloatArray

    @cached_property
    def force_n(self) -> FloatArray:
        """|F_ν|, N."""
        return np.asarray(np.abs(self.force[:, self.resonance.force_order - 1]))

    @cached_property
    def active_power(self) -> FloatArray:
        """P over all orders, W."""
        return np.asarray(self._power.sum(axis=1))

    @cached_property
    def self_excitation(self) -> FloatArray:
        """ξ = 2 P / Σ (n ω_b q_n)², rad/s."""
        speed = np.multiply.outer(self.omega, np.arange(1, self.force.shape[1] + 1)) * self.sizes
        return np.asarray(2.0 * self.active_power / (speed**2).sum(axis=1))

    @cached_property
    def damping_ratio(self) -> FloatArray:
        """δ̃ = ξ / (2 k ω_b)."""
        return np.asarray(self.self_excitation / (2.0 * self.resonance.response_order * self.omega))

    @cached_property
    def gamma_acceleration(self) -> FloatArray:
        """Order k over rms of all orders of the drive-point acceleration."""
        acceleration = self.drive_acceleration
        resonant = np.abs(acceleration[:, self.resonance.response_order - 1])
        return np.asarray(resonant / np.sqrt(_energy(acceleration)))

    @cached_property
    def phase_error(self) -> FloatArray:
        """Deviation of the resonant order's phase, rad."""
        k, nu, lag = self.resonance
        displacement = self.velocity[:, k - 1] / 1j
        angle = self.force[:, nu - 1] ** k * np.conj(displacement) ** nu * np.exp(-1j * lag)
        return np.asarray((np.remainder(np.angle(angle) + 0.5 * np.pi, np.pi) - 0.5 * np.pi) / nu)


def secondary_quantities(
    resonance: SecondaryResonance,
    base: FloatArray,
    force: ComplexArray,
    drive: ComplexArray,
    drive_acceleration: ComplexArray,
    shapes: ComplexArray,
    linear_shapes: FloatArray,
    target_mode: int,
) -> SecondaryQuantities:
    """Powers, damping, amplitude and indicators of the orders of a window.

    Args:
        resonance: k:ν.
        base: ω_b, rad/s, shape ``(sets,)``.
        force: F_n, N, shape ``(sets, H + 1)``.
        drive: displacement of the drive point, m, same shape.
        drive_acceleration: m/s², same shape.
        shapes: ψ_n at the points of Φ, m, shape ``(sets, points, H + 1)``.
        linear_shapes: mass-normalised Φ, 1/√kg, shape ``(points, modes)``.
        target_mode: index of the mode under test.

    Raises:
        BenchError: force or resonant response vanish.
    """
    k = resonance.response_order
    coordinates = np.einsum("mp,spn->snm", np.linalg.pinv(linear_shapes), shapes[:, :, 1:])
    values = SecondaryQuantities(
        omega=base,
        force=force[:, 1:],
        velocity=1j * np.multiply.outer(base, np.arange(1, force.shape[1])) * drive[:, 1:],
        drive_acceleration=drive_acceleration[:, 1:],
        shape=shapes[:, :, k],
        linear_shape=linear_shapes[:, target_mode],
        coordinates=coordinates[:, k - 1],
        resonance=resonance,
        sizes=np.sqrt(_energy(coordinates)),
    )
    drives = np.abs(values.velocity[:, k - 1])
    if not (np.all(values.modal_amplitude > 0.0) and np.all(values.force_n > 0.0) and np.all(drives > 0.0)):
        raise BenchError("There is no force, or no response in the resonant order; check sensors and drive.")
    return values


def secondary_point(
    window: Window, linear: LinearDescription, settings: ExtractionSettings | None = None
) -> ModalPoint:
    """Modal properties of a window in a secondary resonance, with their standard uncertainties.

    Uncertainties are those of :func:`nmt_extract.modal.modal_point`. A channel that is dead or flat-topped makes the
    window a rejected one.

    Args:
        window: its lock event names the resonance.
        linear: linear modes Φ at the response points.
        settings: None = defaults.
    """
    try:
        resonance = resonance_of(window.lock.response_order, window.lock.force_order)
        return _SecondaryEvaluation(window, linear, settings or ExtractionSettings(), resonance).point()
    except BenchError as error:
        return rejected_point(window.lock, window.sample_rate, str(error))


class _SecondaryEvaluation(WindowEvaluation):
    """One window; set 0 is the whole window, set k lacks sub-window k."""

    def __init__(
        self, window: Window, linear: LinearDescription, settings: ExtractionSettings, resonance: SecondaryResonance
    ) -> None:
        self.resonance = resonance
        super().__init__(window, linear, settings, ChannelHistory())

    def _find_phase(self) -> None:
        super()._find_phase()
        nu = self.resonance.force_order
        self.cycles = self.cycles / nu
        self.advance /= nu
        self.periods = round(self.advance)
        if self.periods < self.settings.minimum_periods:
            raise BenchError(
                f"The window holds {self.periods} whole periods of the subharmonic; at least "
                f"{self.settings.minimum_periods} are needed."
            )

    def _judge_channels(self) -> None:
        """Refuse dead and flat-topped channels; a shape has no neighbour here that could take their place."""
        window = self.window
        assert self.force_row is not None
        if self.harmonics < max(self.resonance[:2]):
            raise BenchError(
                f"A {self.resonance.label} resonance needs {max(self.resonance[:2])} orders, {self.harmonics} are "
                "extracted; set extraction.harmonics of the rig."
            )
        for row in sorted({self.force_row, self.drive_row, self.gamma_row, *self.shape_rows}):
            name = window.channels[row].name
            if np.ptp(window.data[row]) == 0.0:
                raise BenchError(f"{name} is dead: it does not move.")
            samples = window.samples / (self.advance * self.resonance.response_order)
            flat = clipping.flat_top(window.data[row], samples)
            if flat is not None and row != self.force_row:
                raise BenchError(f"{name} is flat-topped at {flat:.4g} {window.channels[row].quantity.unit}.")

    def point(self) -> ModalPoint:
        linear, lock = self.linear, self.window.lock
        k, nu = self.resonance[:2]
        base = 2.0 * np.pi * self.frequency_hz
        force = self.amplitudes[:, self.force_row]
        shapes = self._integrated(self.amplitudes[:, self.shape_rows], self.shape_quantity, base, 0)
        values = secondary_quantities(
            self.resonance,
            base,
            force,
            self._integrated(self.amplitudes[:, self.drive_row], self.drive_quantity, base, 0),
            self._integrated(self.amplitudes[:, self.gamma_row], self.gamma_quantity, base, 2),
            shapes,
            linear.shape_matrix,
            linear.target_mode,
        )
        measured = {name: getattr(values, name) for name in EVALUATED}
        fields = {name: float(value[0]) for name, value in measured.items()}
        fields.update({f"{name}_std": self._uncertainty(name, value) for name, value in measured.items()})
        fields["frequency_hz"] = k * float(self.frequency_hz[0])
        fields["frequency_hz_std"] = k * self.frequency_std
        fields["omega_rad_s"] = k * float(base[0])
        phase = math.hypot(fields["phase_error"], fields["phase_error_std"])
        fields["omega_rad_s_std"] = math.hypot(
            2.0 * math.pi * k * self.frequency_std, fields["damping_ratio"] * fields["omega_rad_s"] * phase
        )
        told = ""
        if abs(fields["phase_error"]) > _PHASE_LIMIT:
            told = (
                f"The resonant order is {math.degrees(fields['phase_error']):.1f}° off its phase at resonance "
                f"(limit {math.degrees(_PHASE_LIMIT):.0f}°)."
            )
        reference = values.participation[0, linear.target_mode]
        turn = np.exp(-1j * np.angle(reference) / k)  # of the base, so that the target mode is real in the order k
        turns = turn ** np.arange(self.harmonics + 1)
        return ModalPoint(
            level_index=lock.level_index,
            status=Status.OK,
            reason=told,
            level=lock.level,
            level_unit=lock.level_unit,
            time_ns=bench_time_ns(lock.window_end - 1, self.window.sample_rate),
            window_first_sample=lock.window_first_sample,
            window_samples=lock.window_samples,
            window_periods=nu * self.periods,
            harmonics=self.harmonics,
            points=linear.points,
            force_harmonics=force[0] * turns,
            shape_harmonics=(shapes[0] * turns).T,
            normalised_shape=values.normalised_shape[0] * turn**k,
            participation=values.participation[0] * turn**k,
            harmonics_control=0,
            response_order=k,
            force_order=nu,
            exciter_points=(),
            exciter_forces=np.empty(0, dtype=np.complex128),
            **fields,
        )


def _energy(values: ComplexArray) -> FloatArray:
    """Σ |x|² over the last axis."""
    return np.asarray((values.real**2 + values.imag**2).sum(axis=-1), dtype=np.float64)
