"""A rig's structure in its modes: what forces do to the measured rows, and how its points move.

The exciter is left out: the measured force stands for it. With the modal coordinate q of the mode under test the
local force that is missing is φ G₁ = b F₁ − D(ω) q, D = ω_t² − ω² + 2iζω_tω (Ewins, Modal Testing, 2000). A mode so
near that errors of its frequency and damping would move its response belongs to the frame, too: it has a coordinate and
such an equation of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.measurements.measurement import HeldLevels
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.aft import LocalForces
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.model.local_elements.attachments import AttachmentSection
from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.structure import Structure
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_elements, build_structure, build_table
from nmt_rig.rig_sections import ShakingTableSection

ORDERS = 15
"""Highest harmonic of local forces and of the motion that they make."""


@dataclass(frozen=True)
class ModalFrame:
    """Modes of the structure with its local elements at rest, and the elements whose force is not linear.

    Attributes:
        structure: the structure.
        omega: natural frequencies, rad/s, (n,).
        zeta: damping ratios, (n,).
        shapes: mass-normalised, on all degrees of freedom, 1/√kg, (N, n).
        modes: numbers of the mode under test and, after it, of those so near that their motion is measured, too, T.
        drive: participation of the drive points, (E, n).
        sensors: participation of the channels' points, (C, n).
        elements: local elements with a nonlinear force.
        base: acceleration of the base per unit of the drive, m/s² for 1 N or 1 m/s²; 0 without a shaking table.
        carried: displacement of the channels' points per displacement of the base, in addition to that of the
            structure, (C,).
    """

    structure: Structure
    omega: FloatArray
    zeta: FloatArray
    shapes: FloatArray
    modes: tuple[int, ...]
    drive: FloatArray
    sensors: FloatArray
    elements: tuple[LocalElement, ...]
    base: float
    carried: FloatArray

    @property
    def target(self) -> int:
        """Number of the mode under test."""
        return self.modes[0]

    @classmethod
    def of(cls, rig: Rig, levels: HeldLevels) -> ModalFrame | None:
        """The frame of a rig for the levels of a test; None unless its structure alone is linear and has points."""
        if any(isinstance(section, AttachmentSection) for section in rig.local_elements):
            return None
        try:
            structure = build_structure(rig)
            elements = build_elements(rig, structure)
            modes = sticking_modes(structure, elements)
            sensors = np.array([structure.direction(channel.point) for channel in levels.channels])
            base = _base(rig, structure, levels)
            drive = _drive(structure, levels, base)
        except (BenchError, KeyError, np.linalg.LinAlgError):
            return None
        swinging = np.flatnonzero(modes.frequencies > 0.0)
        if not swinging.size:
            return None
        distance = np.abs(np.log(modes.frequencies[swinging] / np.median(levels.omega)))
        target = int(swinging[np.argmin(distance)])
        nonlinear = tuple(element for element in elements if not element.linear)
        zeta = np.where(np.isfinite(modes.damping_ratios), modes.damping_ratios, 0.0)
        shapes = modes.full_shapes
        found = cls(
            structure, modes.frequencies, zeta, shapes, (target,), drive @ shapes, sensors @ shapes, nonlinear, base,
            _carried(rig, structure, levels),
        )  # fmt: skip
        return replace(found, modes=(target, *found._near(levels)))

    def _near(self, levels: HeldLevels) -> list[int]:
        """Modes whose motion the model does not know well enough, the nearest first.

        What acts on the mode under test moves them as well. Where errors of their frequency and damping change that by
        more of the motion than forms of modes are off by, they are measured.
        """
        levels, limits = self.relative(levels), THRESHOLDS.law
        shape = self.sensors[:, self.target]
        q = np.abs(np.nan_to_num(levels.motion[:, :, 1]) @ shape) / max(float(shape @ shape), 1e-300)
        if levels.ratio is None:
            acting = np.abs(self.drive[:, self.target] @ levels.force[:, :, 1])
        else:
            acting = 2.0 * levels.ratio * levels.omega**2 * q
        ratio = np.where(q > 0.0, acting / np.where(q > 0.0, q, 1.0), 0.0)
        places = np.max(np.abs([self.at(point) for point in self.structure.point_numbers]), axis=0)
        size = np.linalg.norm(self.sensors, axis=0) * places
        if not size[self.target] > 0.0:
            return []
        error = self._errors(levels.omega, 1, limits.mode_frequency_std, limits.mode_damping_std)
        moved = ratio[:, np.newaxis] / np.abs(self.denominators(levels.omega, 1)) * size / size[self.target]
        share = np.max(moved * np.minimum(error, 1.0), axis=0)
        share[[self.target, *np.flatnonzero(self.omega == 0.0)]] = 0.0
        found = np.flatnonzero(share > limits.form_std)
        return [int(k) for k in found[np.argsort(-share[found], kind="stable")]]

    @property
    def resolution(self) -> float:
        """Least singular value of the shapes of the frame's modes at the channels, each of length 1; 0 = they cannot be
        separated."""
        shapes = self.sensors[:, list(self.modes)]
        if shapes.shape[0] < shapes.shape[1]:
            return 0.0
        lengths = np.linalg.norm(shapes, axis=0)
        return float(np.linalg.svd(shapes / np.where(lengths > 0.0, lengths, 1.0), compute_uv=False)[-1])

    def relative(self, levels: HeldLevels) -> HeldLevels:
        """The levels with the motion of the base taken off that of the channels."""
        orders = np.maximum(np.arange(levels.harmonics + 1), 1)
        base = -self.base * levels.force[0, :, : orders.size] / (levels.omega[:, np.newaxis] * orders) ** 2
        motion = levels.motion - base[:, np.newaxis] * self.carried[:, np.newaxis]
        return replace(levels, motion=motion)

    def at(self, point: int, other_point: int = 0) -> FloatArray:
        """Participation (n,) of a place: a point, or between two."""
        participation: FloatArray = self.shapes.T @ self.structure.direction(point, other_point or None)
        return participation

    def denominators(self, omega: FloatArray, order: int) -> ComplexArray:
        """D of each mode at a multiple of the frequencies, (L, n)."""
        w = order * np.asarray(omega)[:, np.newaxis]
        with np.errstate(invalid="ignore"):
            found = self.omega**2 - w**2 + 2j * self.zeta * self.omega * w
        # A mean force on a free body causes no vibration.
        return np.where(np.abs(found) > 0.0, found, np.inf)

    def others(self, omega: FloatArray) -> ComplexArray:
        """1/D at the fundamental of all modes but those of the frame, (L, n)."""
        result = 1.0 / self.denominators(omega, 1)
        result[:, list(self.modes)] = 0.0
        return result

    def tolerance(self, omega: FloatArray, order: int, frequency: float, damping: float) -> FloatArray:
        """What errors of all modes do to responses at a multiple of the frequencies, relative, (L, C).

        Args:
            omega: rad/s, (L,).
            order: harmonic.
            frequency, damping: relative standard deviations of natural frequencies and damping ratios.
        """
        d = np.abs(self.denominators(omega, order))
        # Each mode with its largest share over the structure: no place is known yet.
        weights = np.abs(self.sensors) * np.max(np.abs(self.shapes), axis=0)
        shares = weights[np.newaxis] / d[:, np.newaxis]
        errors = shares * self._errors(omega, order, frequency, damping)[:, np.newaxis]
        return np.asarray(np.sqrt((errors**2).sum(axis=2)) / np.sqrt((shares**2).sum(axis=2)))

    def _errors(self, omega: FloatArray, order: int, frequency: float, damping: float) -> FloatArray:
        """What errors of frequency and damping do to 1/D of each mode, relative, (L, n)."""
        w = order * np.asarray(omega)[:, np.newaxis]
        change = np.hypot(2.0 * self.omega**2 * frequency, 2.0 * self.zeta * self.omega * w * damping)
        return np.asarray(change / np.abs(self.denominators(omega, order)))


def _base(rig: Rig, structure: Structure, levels: HeldLevels) -> float:
    """Acceleration of the base per unit of its drive: itself, or the force that stands for it; 0 without a base."""
    if levels.over_base:
        return 1.0
    table = build_table(rig, structure) if levels.ratio is None else None
    return 0.0 if table is None else -1.0 / table.effective_mass


def _drive(structure: Structure, levels: HeldLevels, base: float) -> FloatArray:
    """What each measured force acts on, (E, N): a drive point, or all masses where it is the motion of their base.

    Raises:
        BenchError: the structure does not say how its base excites it.
    """
    if base == 0.0:
        return np.array([structure.direction(point) for point in levels.drive_points])
    if structure.base_load is None:
        raise BenchError("the structure does not say how its base excites it")
    return -base * structure.base_load[np.newaxis]


def _carried(rig: Rig, structure: Structure, levels: HeldLevels) -> FloatArray:
    """Share of the motion of the base that sensors see in addition to that of the structure, (C,)."""
    if not (isinstance(rig.exciter, ShakingTableSection) and rig.exciter.responses == "absolute"):
        return np.zeros(len(levels.channels))
    return np.array([structure.base_motion.get(channel.point, 1.0) for channel in levels.channels])


class KnownForces:
    """Nonlinear part of the forces of the model's own elements.

    Args:
        elements: the elements, of one or several directions.
        frame: modes of the structure.
    """

    def __init__(self, elements: Sequence[LocalElement], frame: ModalFrame) -> None:
        self.basis = FourierBasis.up_to(ORDERS)
        self.forces = LocalForces.gather(elements, self.basis, np.zeros(frame.shapes.shape[0]))
        self.participation = self.forces.directions @ frame.shapes
        self.stiffness, self.damping = np.zeros(len(self.participation)), np.zeros(len(self.participation))
        for element in elements:
            where = next(k for k, one in enumerate(self.forces.directions) if np.array_equal(one, element.direction))
            self.stiffness[where] += element.linear_stiffness
            self.damping[where] += element.linear_damping

    def of(self, motion: ComplexArray, omega: FloatArray, linearised: KnownForces | None = None) -> ComplexArray:
        """Harmonics of the forces less the linear ones of the elements at rest, N, (r, L, ORDERS + 1).

        Args:
            motion: harmonics at the elements' coordinates, m, (r, L, ORDERS + 1).
            omega: rad/s, (L,).
            linearised: elements whose linear part is subtracted; None = these themselves.
        """
        linear = linearised or self
        result = np.zeros(motion.shape, complex)
        orders = np.arange(ORDERS + 1)
        for k, w in enumerate(omega):
            real = np.ascontiguousarray(self.basis.to_real(motion[:, k]))
            found = self.basis.to_complex(self.forces.forces(real, float(w))[0])
            others = linear.stiffness[:, None] + 1j * w * orders * linear.damping[:, None]
            result[:, k] = found - others * motion[:, k]
        return result
