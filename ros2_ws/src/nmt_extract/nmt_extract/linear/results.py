"""What a linear modal test is asked for, and what it gives: modes, residuals and the plant with its exciters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_extract.linear.residuals import Residuals, modal_receptance
from nmt_extract.linear.stabilisation import OrderPoles, StablePole
from nmt_signals.frequency_responses import FrfEstimate
from nmt_signals.rational_fit import RationalFit


@dataclass(frozen=True)
class LinearTestSettings:
    """What to look for.

    Attributes:
        exciter_points: points of the exciters, in the order of their voltages.
        quantity: response quantity of the shapes.
        band_hz: band of the excitation.
        modes: most modes to keep (never more than response points).
        mode: number of the target mode among those fitted in the band, from 1; None = see ``rig_mode``.
        near_hz: the target is the fitted mode nearest to this frequency; goes before ``mode``.
        rig_mode: number of the target mode among all modes of the rig, a suspension mode below the band included.
        segment_s: length of an averaged segment, s; None = a tenth of the record.
    """

    exciter_points: tuple[int, ...]
    quantity: Quantity
    band_hz: tuple[float, float]
    modes: int = 2
    mode: int | None = None
    near_hz: float | None = None
    rig_mode: int = 1
    segment_s: float | None = None

    @property
    def drive_point(self) -> int:
        """Point of the first exciter."""
        return self.exciter_points[0]


@dataclass(frozen=True, eq=False)
class LinearMode:
    """One mode of the structure without exciters.

    Attributes:
        frequency_hz, damping_ratio: undamped frequency |λ|/2π and damping ratio.
        frequency_std, damping_std: their standard uncertainties.
        complex_shape: mass-normalised at the response points, 1/√kg.
        shape: its real part, 1/√kg.
        shape_std: standard uncertainty of ``shape``.
        drive_shapes, drive_shape_stds: at the exciters' points, shape ``(exciters,)``.
        products: φ_p φ_d of responses and forces as they were measured, complex, 1/kg, shape ``(outputs, exciters)``:
            the response points, then what is measured at the exciters next to them.
        product_stds: standard uncertainties of their real and of their imaginary parts.
        averaged: the stable pole it was found by, from the averaged spectra.
        coherence: share of the best response's power around the mode that the fit explains; free of leakage.
        averaged_coherence: median γ² of the best force and response around the mode, from the averaged spectra.
        fit: the fit of the whole record.
    """

    frequency_hz: float
    damping_ratio: float
    frequency_std: float
    damping_std: float
    complex_shape: ComplexArray
    shape: FloatArray
    shape_std: FloatArray
    drive_shapes: FloatArray
    drive_shape_stds: FloatArray
    products: ComplexArray
    product_stds: FloatArray
    averaged: StablePole
    coherence: float
    averaged_coherence: float
    fit: RationalFit

    @property
    def omega(self) -> float:
        """Frequency, rad/s."""
        return 2.0 * math.pi * self.frequency_hz

    @property
    def drive_shape(self) -> float:
        """At the first exciter's point, 1/√kg."""
        return float(self.drive_shapes[0])

    @property
    def drive_shape_std(self) -> float:
        """Standard uncertainty of ``drive_shape``."""
        return float(self.drive_shape_stds[0])

    @property
    def complexity(self) -> float:
        """Share of the shape that is not in phase, ‖Im ψ‖ / ‖ψ‖."""
        return float(np.linalg.norm(self.complex_shape.imag) / np.linalg.norm(self.complex_shape))


@dataclass(frozen=True)
class PlantEstimate:
    """The target mode with the exciters attached, as the phase-locked loop needs it.

    Attributes:
        frequency_hz, damping_ratio: pole of voltage to response nearest to the target mode.
        frequency_std, damping_std: their standard uncertainties.
        force_per_volt: N/V of the first exciter at the target mode's frequency, with all exciters in the ratio that
            isolates the mode.
        displacement_per_volt: m/V at its point there.
        moving_mass_kg: moving mass of the first exciter.
    """

    frequency_hz: float
    damping_ratio: float
    frequency_std: float
    damping_std: float
    force_per_volt: float
    displacement_per_volt: float
    moving_mass_kg: float


@dataclass(frozen=True, eq=False)
class LinearTest:
    """Result of the test.

    Attributes:
        points: response points, rows of the shapes.
        forces, outputs: names of the channels: forces, responses and what is measured at the exciters next to them.
        modes: kept modes, ascending frequency.
        further_modes: modes found in the band that were not kept.
        target: index of the target mode among ``modes``.
        plant: the target with exciters; None without a voltage channel.
        residuals: of everything but the kept modes; rows are the responses to the first force, then the next.
        target_residuals: of everything but the target mode.
        force_frfs: each force to responses, the other forces at zero.
        voltage_frfs: each voltage to forces and responses; empty without voltage channels.
        diagrams: stabilisation diagrams, that of the whole band first.
        stable: poles that the diagrams give.
        remarks: sentences on what was left out or noticed.
        suspension_below_band: whether a mass line below the first mode shows a suspension (rigid body) mode.
        settings: what was asked for.
        duration_s: length of the record.
        quantity: of the responses.
        reference: ``voltage`` or ``force``: input of the fits.
    """

    points: tuple[int, ...]
    forces: tuple[str, ...]
    outputs: tuple[str, ...]
    modes: tuple[LinearMode, ...]
    further_modes: tuple[LinearMode, ...]
    target: int
    plant: PlantEstimate | None
    residuals: Residuals
    target_residuals: Residuals
    force_frfs: tuple[FrfEstimate, ...]
    voltage_frfs: tuple[FrfEstimate, ...]
    diagrams: tuple[tuple[OrderPoles, ...], ...]
    stable: tuple[StablePole, ...]
    remarks: tuple[str, ...]
    suspension_below_band: bool
    settings: LinearTestSettings
    duration_s: float
    quantity: Quantity
    reference: str

    @property
    def shapes(self) -> FloatArray:
        """Φ of the kept modes, 1/√kg, shape ``(points, modes)``."""
        return np.column_stack([mode.shape for mode in self.modes])

    @property
    def target_mode(self) -> LinearMode:
        """The mode under test."""
        return self.modes[self.target]

    @property
    def frequency_hz(self) -> FloatArray:
        """Lines of the averaged responses, Hz."""
        return self.force_frfs[0].frequency_hz

    def receptance(self) -> ComplexArray:
        """Measured receptance of the responses, m/N, shape ``(exciters, points, lines)``."""
        return np.array([receptance_of(frf, self.quantity)[: len(self.points)] for frf in self.force_frfs])

    def synthesis(self) -> ComplexArray:
        """Receptance of kept modes and residuals, m/N, shape ``(exciters, points, lines)``."""
        total = self.residuals.receptance(self.frequency_hz)
        for mode in self.modes:
            total = total + modal_receptance(*modal_term(mode), self.frequency_hz)
        return total.reshape(len(self.force_frfs), len(self.points), -1)

    def force_per_volt(self) -> tuple[ComplexArray, FloatArray]:
        """Forces per volt of every exciter, N/V, shape ``(lines, forces, voltages)``, and their partial coherence."""
        names = [frf.input for frf in self.force_frfs]
        rows = [[frf.outputs.index(name) for name in names] for frf in self.voltage_frfs]
        pairs = list(zip(self.voltage_frfs, rows, strict=True))
        values = np.array([frf.h1[row] for frf, row in pairs]).transpose(2, 1, 0)
        return values, np.array([frf.coherence[row] for frf, row in pairs]).transpose(2, 1, 0)


def receptance_of(frf: FrfEstimate, quantity: Quantity) -> ComplexArray:
    """Receptance of a response of some quantity, m/N, shape ``(outputs, lines)``."""
    return np.asarray(frf.best / (2j * np.pi * frf.frequency_hz) ** MOTIONS[quantity])


def modal_term(mode: LinearMode) -> tuple[FloatArray, float, float]:
    """φ φ_d of all responses to the first force, then the next, ω_r and ζ."""
    return np.outer(mode.drive_shapes, mode.shape).ravel(), mode.omega, mode.damping_ratio
