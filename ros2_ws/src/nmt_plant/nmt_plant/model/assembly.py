"""Structure, local elements and shaker as one system of equations with one input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .local_elements import LocalElement
from .shaker import ElectrodynamicShaker
from .structure import Array, Structure


@dataclass(frozen=True)
class OutputRow:
    """Linear output of the system.

    y = acceleration · q̈ + velocity · q̇ + displacement · q + feedthrough · input; rows have shape (n,).
    """

    acceleration: Array
    velocity: Array
    displacement: Array
    feedthrough: float


@dataclass(frozen=True)
class ElectromechanicalSystem:
    """M q̈ + C q̇ + K q + Σ d_j g_j = b · input.

    With a shaker q = [structure…, coil displacement (m), current (A)] and the input is the voltage u (V); the
    row of the current has no mass (inductance in `damping`, resistance in `stiffness`). Without a shaker q is
    the structure's and the input is the force (N) at the drive point.

    Attributes:
        mass, damping, stiffness: (n, n).
        input_vector: b, (n,).
        elements: local elements with directions of shape (n,).
        points: point number -> index of its lateral displacement.
        drive_point: point number the exciter acts on.
        force: output row set of the (stinger) force on the structure, N.
        structure_size: number of degrees of freedom of the structure; they come first.
        coil, current: index of coil displacement and current, None without a shaker.
    """

    mass: Array
    damping: Array
    stiffness: Array
    input_vector: Array
    elements: tuple[LocalElement, ...]
    points: dict[int, int]
    drive_point: int
    force: OutputRow
    structure_size: int
    coil: int | None = None
    current: int | None = None

    @property
    def size(self) -> int:
        """Number of unknowns n."""
        return int(self.mass.shape[0])

    @property
    def mechanical_size(self) -> int:
        """Number of unknowns with inertia; the current, if any, comes last."""
        return self.size - (0 if self.current is None else 1)

    def selector(self, point: int) -> Array:
        """Unit vector (n,) of the lateral displacement of `point`.

        Raises:
            KeyError: no such point.
        """
        if point not in self.points:
            raise KeyError(f"no point {point}; the structure has points {sorted(self.points)}")
        vector = np.zeros(self.size)
        vector[self.points[point]] = 1.0
        return vector

    def sticking_stiffness(self) -> Array:
        """(n, n) stiffness with the local elements' tangent at rest (Jenkins elements stick)."""
        result = self.stiffness.copy()
        for element in self.elements:
            result += element.linear_stiffness * np.outer(element.direction, element.direction)
        return result

    def resting_damping(self) -> Array:
        """(n, n) damping with the local elements' tangent at rest."""
        result = self.damping.copy()
        for element in self.elements:
            result += element.linear_damping * np.outer(element.direction, element.direction)
        return result

    def impedance(self, frequency: float, sticking: bool = True) -> Array:
        """Complex dynamic stiffness S(iω) (n, n) at ω (rad/s); at rest or without local elements."""
        stiffness = self.sticking_stiffness() if sticking else self.stiffness
        damping = self.resting_damping() if sticking else self.damping
        result: Array = stiffness + 1j * frequency * damping - frequency**2 * self.mass
        return result

    def response(self, frequency: float, sticking: bool = True) -> tuple[Array, complex]:
        """Complex amplitudes of q (n,) and of the drive-point force (N) for a unit input at ω (rad/s)."""
        q = np.linalg.solve(self.impedance(frequency, sticking), self.input_vector.astype(complex))
        s = 1j * frequency
        row = s * s * self.force.acceleration + s * self.force.velocity + self.force.displacement
        return q, complex(row @ q + self.force.feedthrough)


def displacement_output(system: ElectromechanicalSystem, point: int) -> OutputRow:
    """Lateral displacement of `point`, m (KeyError where there is no such point)."""
    zero = np.zeros(system.size)
    return OutputRow(zero, zero, system.selector(point), 0.0)


def velocity_output(system: ElectromechanicalSystem, point: int) -> OutputRow:
    """Lateral velocity of `point`, m/s (KeyError where there is no such point)."""
    zero = np.zeros(system.size)
    return OutputRow(zero, system.selector(point), zero, 0.0)


def acceleration_output(system: ElectromechanicalSystem, point: int) -> OutputRow:
    """Lateral acceleration of `point`, m/s² (KeyError where there is no such point)."""
    zero = np.zeros(system.size)
    return OutputRow(system.selector(point), zero, zero, 0.0)


def input_output(system: ElectromechanicalSystem) -> OutputRow:
    """The input itself: voltage (V) with a shaker, force (N) without."""
    zero = np.zeros(system.size)
    return OutputRow(zero, zero, zero, 1.0)


def current_output(system: ElectromechanicalSystem) -> OutputRow:
    """Coil current, A.

    Raises:
        ValueError: the system has no shaker.
    """
    if system.current is None:
        raise ValueError("the system has no shaker, hence no coil current")
    zero = np.zeros(system.size)
    row = np.zeros(system.size)
    row[system.current] = 1.0
    return OutputRow(zero, zero, row, 0.0)


def _extended(direction: Array, size: int) -> Array:
    result = np.zeros(size)
    result[: direction.shape[0]] = direction
    return result


def assemble(
    structure: Structure,
    elements: Sequence[LocalElement],
    drive_point: int,
    shaker: ElectrodynamicShaker | None = None,
) -> ElectromechanicalSystem:
    """Join structure, local elements and exciter.

    The stinger (1.32e14 N/m in the paper) is a rigid link: table and drive point share a degree of
    freedom, and the stinger force stays available as
    f = -(m_T ẍ + d_T ẋ + k_T x + k_C (x - x_C) + d_C (ẋ - ẋ_C)).

    Raises:
        KeyError: the structure has no such drive point.
        ValueError: an element's direction does not fit the structure.
    """
    n = structure.size
    for element in elements:
        if element.direction.shape != (n,):
            raise ValueError(f"direction of {type(element).__name__} must have shape ({n},)")
    drive = structure.selector(drive_point)
    if shaker is None:
        zero = np.zeros(n)
        return ElectromechanicalSystem(
            mass=structure.mass.copy(),
            damping=structure.damping.copy(),
            stiffness=structure.stiffness.copy(),
            input_vector=drive,
            elements=tuple(elements),
            points=dict(structure.points),
            drive_point=drive_point,
            force=OutputRow(zero, zero, zero, 1.0),
            structure_size=n,
        )
    size = n + 2
    coil, current = n, n + 1
    x = structure.points[drive_point]
    mass, damping, stiffness = (np.zeros((size, size)) for _ in range(3))
    mass[:n, :n] = structure.mass
    damping[:n, :n] = structure.damping
    stiffness[:n, :n] = structure.stiffness

    mass[x, x] += shaker.table_mass
    mass[coil, coil] = shaker.coil_mass
    damping[x, x] += shaker.table_damping
    stiffness[x, x] += shaker.table_stiffness
    for matrix, value in ((damping, shaker.coil_damping), (stiffness, shaker.coil_stiffness)):
        matrix[x, x] += value
        matrix[coil, coil] += value
        matrix[x, coil] -= value
        matrix[coil, x] -= value
    stiffness[coil, current] = -shaker.force_factor
    damping[current, coil] = shaker.force_factor
    damping[current, current] = shaker.inductance
    stiffness[current, current] = shaker.resistance

    voltage = np.zeros(size)
    voltage[current] = 1.0
    rows = np.zeros((3, size))
    rows[0, x] = -shaker.table_mass
    rows[1, x] = -(shaker.table_damping + shaker.coil_damping)
    rows[1, coil] = shaker.coil_damping
    rows[2, x] = -(shaker.table_stiffness + shaker.coil_stiffness)
    rows[2, coil] = shaker.coil_stiffness
    return ElectromechanicalSystem(
        mass=mass,
        damping=damping,
        stiffness=stiffness,
        input_vector=voltage,
        elements=tuple(element.along(_extended(element.direction, size)) for element in elements),
        points=dict(structure.points),
        drive_point=drive_point,
        force=OutputRow(rows[0], rows[1], rows[2], 0.0),
        structure_size=n,
        coil=coil,
        current=current,
    )
