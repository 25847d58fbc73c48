"""Alternating frequency/time: Fourier coefficients of the local forces of a periodic motion, with analytic
derivatives.

Jenkins elements and stops are switched exactly (piecewise_forces.py); smooth elements are sampled over one
period, with enough samples that polynomial forces are free of aliasing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_core.numerics.kernels import njit
from nmt_rig.model.element_kernels import response
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements.element import PARAMETER_COUNT, LocalElement
from nmt_rig.model.piecewise_forces import add_piecewise_forces


class ElementTables(NamedTuple):
    """Local elements of each coordinate, sorted by how their forces are computed.

    Attributes:
        jenkins: (n_j, 2) k_t (N/m), μN (N); rows jenkins_start[i] … jenkins_start[i + 1] act on coordinate i.
        contacts: (n_c, 3) stiffness (N/m), gap (m), side; likewise.
        kinds, parameters: (n_s,), (n_s, PARAMETER_COUNT) of the sampled elements; likewise.
    """

    jenkins: FloatArray
    jenkins_start: IntArray
    contacts: FloatArray
    contacts_start: IntArray
    kinds: IntArray
    parameters: FloatArray
    sampled_start: IntArray


class LocalTables(NamedTuple):
    """Local elements and the Fourier basis of their motion, for compiled functions.

    Attributes:
        orders, offsets: of the basis.
        slope_basis: (·, size) brackets the turning points of w.
        jenkins … sampled_start: as in `ElementTables`; not a tuple within, which compiled functions unpack at a price.
        values, slopes: (samples, size) basis functions and their derivatives with respect to θ.
    """

    orders: IntArray
    offsets: IntArray
    slope_basis: FloatArray
    jenkins: FloatArray
    jenkins_start: IntArray
    contacts: FloatArray
    contacts_start: IntArray
    kinds: IntArray
    parameters: FloatArray
    sampled_start: IntArray
    values: FloatArray
    slopes: FloatArray

    @property
    def elements(self) -> ElementTables:
        """The elements without the basis."""
        return ElementTables(
            self.jenkins, self.jenkins_start, self.contacts, self.contacts_start, self.kinds, self.parameters,
            self.sampled_start,
        )  # fmt: skip


class ScaledForces(NamedTuple):
    """Local forces of a motion, per scale, and their derivatives by the motion's coefficients, ω and log10 scale.

    Attributes:
        force: (r, size).
        by_displacement: (r, size, size).
        by_frequency, by_scale: (r, size).
    """

    force: FloatArray
    by_displacement: FloatArray
    by_frequency: FloatArray
    by_scale: FloatArray


def element_rows(
    groups: Sequence[Sequence[LocalElement]], highest: int, least: int, fitted: bool
) -> tuple[ElementTables, int]:
    """Tables of the elements of each coordinate.

    Args:
        groups: elements of each coordinate.
        highest: harmonic order.
        least: samples per period.
        fitted: samples of smooth elements as a model needs them that is fitted, not a reference.

    Returns:
        The tables, and the samples per period that the elements need.

    Raises:
        BenchError: an element that harmonic balance does not cover.
    """
    jenkins: list[tuple[float, float]] = []
    contacts: list[tuple[float, float, float]] = []
    kinds: list[int] = []
    parameters: list[FloatArray] = []
    starts: tuple[list[int], list[int], list[int]] = ([0], [0], [0])
    for group in groups:
        for element in group:
            jenkins.extend(element.sliders)
            contacts.extend(element.contacts)
            if element.degree or element.samples[fitted]:
                kinds.append(element.kind)
                parameters.append(element.parameters)
                least = max(least, (element.degree + 1) * highest + 1 if element.degree else element.samples[fitted])
            elif not element.sliders and not element.contacts:
                raise BenchError(
                    f"harmonic balance does not cover a {type(element).__name__}; leave it out of the model."
                )
        for start, rows in zip(starts, (len(jenkins), len(contacts), len(kinds)), strict=True):
            start.append(rows)
    return ElementTables(
        np.array(jenkins, dtype=np.float64).reshape(-1, 2),
        np.array(starts[0], dtype=np.int64),
        np.array(contacts, dtype=np.float64).reshape(-1, 3),
        np.array(starts[1], dtype=np.int64),
        np.array(kinds, dtype=np.int64),
        np.array(parameters, dtype=np.float64).reshape(-1, PARAMETER_COUNT),
        np.array(starts[2], dtype=np.int64),
    ), least


@dataclass(frozen=True)
class LocalForces:
    """Local elements gathered by the coordinates they act on, ready for the compiled kernels.

    Elements of equal direction share one coordinate w_i = directions[i] · q.

    Attributes:
        directions: (r, n) directions of the coordinates.
        basis: Fourier basis of w and g.
        elements: tables of them.
        slope_basis: (·, size) brackets the turning points of w.
        samples: number of samples per period of the sampled elements.
        values, slopes: (samples, size) basis functions and their derivatives with respect to θ.
    """

    directions: FloatArray
    basis: FourierBasis
    elements: ElementTables
    slope_basis: FloatArray
    samples: int
    values: FloatArray
    slopes: FloatArray

    @classmethod
    def gather(
        cls,
        elements: Sequence[LocalElement],
        basis: FourierBasis,
        idle_direction: FloatArray | None = None,
    ) -> LocalForces:
        """Sort the elements by direction and kind.

        Args:
            elements: local elements, directions of equal length.
            basis: harmonic orders kept.
            idle_direction: (n,) coordinate to keep (without force) without any element.

        Raises:
            BenchError: an element that harmonic balance does not cover, or there are neither elements nor an idle
                direction.
        """
        directions: list[FloatArray] = []
        members: list[list[LocalElement]] = []
        for element in elements:
            for position, direction in enumerate(directions):
                if np.array_equal(direction, element.direction):
                    members[position].append(element)
                    break
            else:
                directions.append(np.asarray(element.direction, dtype=np.float64))
                members.append([element])
        if not directions:
            if idle_direction is None:
                raise BenchError("harmonic balance needs a local element or an idle direction; the rig has none.")
            directions, members = [np.asarray(idle_direction, dtype=np.float64)], [[]]

        highest = int(basis.orders[-1])
        rows, needed = element_rows(members, highest, 64, fitted=False)
        count = 1 << (needed - 1).bit_length()
        return cls(
            np.array(directions),
            basis,
            rows,
            slope_basis=basis.sampled_slope(max(64, 8 * highest)),
            samples=count,
            values=basis.sampled(count),
            slopes=basis.sampled_slope(count),
        )

    @property
    def coordinates(self) -> int:
        """Number r of local coordinates."""
        return int(self.directions.shape[0])

    def forces(self, displacement: FloatArray, angular_frequency: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Fourier coefficients of the local forces and their derivatives.

        Args:
            displacement: (r, size) coefficients of w, m.
            angular_frequency: ω, rad/s.

        Returns:
            G (r, size) in N, ∂G/∂w (r, size, size) in N/m, ∂G/∂ω (r, size) in N s.
        """
        result: tuple[FloatArray, FloatArray, FloatArray] = local_forces(
            np.ascontiguousarray(displacement, dtype=np.float64), angular_frequency, self.tables
        )
        return result

    @cached_property
    def tables(self) -> LocalTables:
        """What the compiled kernels need to know of the elements."""
        return LocalTables(
            self.basis.orders, self.basis.offsets, self.slope_basis, *self.elements, self.values, self.slopes
        )


@njit(cache=True)
def local_forces(
    displacement: FloatArray,
    angular_frequency: float,
    tables: LocalTables,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compiled body of ``LocalForces.forces``."""
    count, size = displacement.shape
    force = np.zeros((count, size))
    derivative = np.zeros((count, size, size))
    frequency_derivative = np.zeros((count, size))
    _add_local_forces(displacement, angular_frequency, tables, force, derivative, frequency_derivative)
    return force, derivative, frequency_derivative


@njit(cache=True)
def forces_alone(displacement: FloatArray, angular_frequency: float, tables: LocalTables) -> FloatArray:
    """The forces of :func:`local_forces` without their derivatives, which cost many times as much."""
    count, size = displacement.shape
    force = np.zeros((count, size))
    _add_local_forces(displacement, angular_frequency, tables, force, np.zeros((count, 0, 0)), np.zeros((count, 0)))
    return force


@njit(cache=True)
def _add_local_forces(
    displacement: FloatArray,
    angular_frequency: float,
    tables: LocalTables,
    force: FloatArray,
    derivative: FloatArray,
    frequency_derivative: FloatArray,
) -> None:
    """Add forces (r, size), and their derivatives where there is room for them."""
    orders, offsets, slope_basis, values, slopes = (
        tables.orders, tables.offsets, tables.slope_basis, tables.values, tables.slopes,
    )  # fmt: skip
    jenkins, jenkins_start, contacts, contacts_start, kinds, parameters, sampled_start = (
        tables.jenkins, tables.jenkins_start, tables.contacts, tables.contacts_start, tables.kinds, tables.parameters,
        tables.sampled_start,
    )  # fmt: skip
    count, size = displacement.shape
    samples = values.shape[0]
    wanted = derivative.size > 0
    stiffness_row = np.zeros(size)
    for i in range(count):
        if jenkins_start[i + 1] > jenkins_start[i] or contacts_start[i + 1] > contacts_start[i]:
            add_piecewise_forces(
                displacement[i],
                orders,
                offsets,
                slope_basis,
                jenkins[jenkins_start[i] : jenkins_start[i + 1]],
                contacts[contacts_start[i] : contacts_start[i + 1]],
                force[i],
                derivative[i],
            )
        if sampled_start[i + 1] == sampled_start[i]:
            continue
        for j in range(samples):
            w = 0.0
            slope = 0.0
            for a in range(size):
                w += values[j, a] * displacement[i, a]
                slope += slopes[j, a] * displacement[i, a]
            g = 0.0
            stiffness = 0.0
            damping = 0.0
            for e in range(sampled_start[i], sampled_start[i + 1]):
                g_e, k_e, c_e = response(kinds[e], parameters, e, w, angular_frequency * slope)
                g += g_e
                stiffness += k_e
                damping += c_e
            if wanted:
                for a in range(size):
                    stiffness_row[a] = stiffness * values[j, a] + damping * angular_frequency * slopes[j, a]
            for a in range(size):
                projection = 2.0 * values[j, a] / samples
                if a == 0 and orders[0] == 0:
                    projection = 1.0 / samples
                force[i, a] += projection * g
                if wanted:
                    frequency_derivative[i, a] += projection * damping * slope
                    for b in range(size):
                        derivative[i, a, b] += projection * stiffness_row[b]


@njit(cache=True)
def scaled_local_forces(
    displacement: FloatArray, scale: float, angular_frequency: float, tables: LocalTables
) -> ScaledForces:
    """Local forces of the motion scale · displacement, per scale.

    Args:
        displacement: (r, size) coefficients of w / scale.
        scale: m per unit of ``displacement``.
        angular_frequency: ω, rad/s.
        tables: ``LocalForces.tables``.
    """
    force, derivative, by_frequency = local_forces(displacement * scale, angular_frequency, tables)
    force /= scale
    by_frequency /= scale
    by_scale = -force
    for i in range(displacement.shape[0]):
        by_scale[i] += derivative[i] @ displacement[i]
    by_scale *= np.log(10.0)
    return ScaledForces(force, derivative, by_frequency, by_scale)
