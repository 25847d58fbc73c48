"""Structure, local elements and exciters as one system of equations with an input for each exciter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from nmt_rig.model.couplings import FORCE_FACTOR, Coupling, coupling_parameters
from nmt_rig.model.exciter import Exciter, OutputRow, moved_to
from nmt_rig.model.local_elements.attachments import Attachment
from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.shaker import ElectrodynamicShaker
from nmt_rig.model.shaking_table import BaseMotion, ShakingTable
from nmt_rig.model.structure import Array, PointMotion, Structure

# Share of entries that are not zero up to which sparse factors are the faster ones.
_FEW_ENTRIES = 0.05


@dataclass(frozen=True)
class ElectromechanicalSystem(PointMotion):
    """M q̈ + C q̇ + K q + Σ d_j g_j + Σ c_k f_k = Σ b_e · input_e.

    With shakers q = [structure…, coil displacements (m), currents (A)] and their inputs are voltages (V); the
    row of a current has no mass (inductance in `damping`, resistance in `stiffness`). The input of an exciter without
    a shaker is its force (N). On a shaking table q is relative to the table,
    its own unknowns stand behind the structure's, and the input is the acceleration asked for (m/s²). Attachments put
    their unknowns with inertia behind the structure's, those without at the very end.

    Attributes:
        mass, damping, stiffness: (n, n).
        exciters: what drives it, one or more.
        elements: local elements with directions of shape (n,).
        points: point number -> index of its lateral displacement.
        structure_size: number of degrees of freedom of the structure; they come first.
        first_order: number of unknowns without inertia (of attachments, of a shaking table), at the end.
        couplings: forces f_k of two arguments with columns c_k of shape (n,).
        on_exciter: for each element, whether it is on the side of the exciter; empty = none is.
        shapes: point number -> row (n,) of points that are no unknown of their own.
        base: motion of the shaking table, None without one.
    """

    mass: Array
    damping: Array
    stiffness: Array
    exciters: tuple[Exciter, ...]
    elements: tuple[LocalElement, ...]
    points: dict[int, int]
    structure_size: int
    first_order: int = 0
    couplings: tuple[Coupling, ...] = ()
    on_exciter: tuple[bool, ...] = ()
    shapes: dict[int, Array] = field(default_factory=dict)
    base: BaseMotion | None = None

    @property
    def input_vector(self) -> Array:
        """b of exciter 1, (n,): of the only one, for those who take no more."""
        return self.exciters[0].input_vector

    @property
    def drive_point(self) -> int:
        """Point number that exciter 1 acts on."""
        return self.exciters[0].point

    @property
    def force(self) -> OutputRow:
        """Force of exciter 1 on the structure, N."""
        return self.exciters[0].force

    @property
    def coil(self) -> int | None:
        """Index of the displacement of exciter 1's coil, None without a shaker."""
        return self.exciters[0].coil

    @property
    def current(self) -> int | None:
        """Index of the current of exciter 1, None without a shaker."""
        return self.exciters[0].current

    @property
    def size(self) -> int:
        """Number of unknowns n."""
        return int(self.mass.shape[0])

    @property
    def mechanical_size(self) -> int:
        """Number of unknowns with inertia; currents and unknowns of first order come behind."""
        return self.size - sum(exciter.current is not None for exciter in self.exciters) - self.first_order

    def is_on_exciter(self, element: int) -> bool:
        """Whether an element (by its position) is on the side of the exciter."""
        return bool(self.on_exciter) and self.on_exciter[element]

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
        """Complex amplitudes of q (n,) and of exciter 1's force (N) for a unit input of it at ω (rad/s)."""
        q = _solution(self.impedance(frequency, sticking), self.input_vector.astype(complex))
        return q, complex(self._force_row(self.force, frequency, sticking) @ q + self.force.feedthrough)

    def responses(self, frequency: float, sticking: bool = True) -> tuple[Array, Array]:
        """Complex amplitudes of q (n, exciters) and of every exciter's force (exciters, exciters), N, for a unit input
        of each at ω (rad/s).
        """
        columns = np.column_stack([exciter.input_vector for exciter in self.exciters])
        q = np.linalg.solve(self.impedance(frequency, sticking), columns.astype(complex))
        rows = np.array([self._force_row(exciter.force, frequency, sticking) for exciter in self.exciters])
        return q, rows @ q + np.diag([exciter.force.feedthrough for exciter in self.exciters])

    def _force_row(self, force: OutputRow, frequency: float, sticking: bool) -> Array:
        """(n,) complex amplitude of a force per one of q at ω (rad/s), next to its feedthrough."""
        s = 1j * frequency
        row = s * s * force.acceleration + s * force.velocity + force.displacement
        if sticking and force.exciter_elements:
            for index, element in enumerate(self.elements):
                if self.is_on_exciter(index):
                    tangent = element.linear_stiffness + s * element.linear_damping
                    row = row + force.exciter_elements * tangent * element.direction
        return np.asarray(row)


def _solution(matrix: Array, right: Array) -> Array:
    """x (n,) of matrix · x = right, by sparse factors where few entries are not zero, as along a fine beam.

    Raises:
        LinAlgError: the matrix is singular.
    """
    if np.count_nonzero(matrix) > _FEW_ENTRIES * matrix.size:
        return np.asarray(np.linalg.solve(matrix, right))
    from scipy.sparse import csc_matrix  # late: small systems do without
    from scipy.sparse.linalg import splu

    try:
        return np.asarray(splu(csc_matrix(matrix)).solve(right))
    except RuntimeError as error:
        raise np.linalg.LinAlgError(str(error)) from error


def displacement_output(system: ElectromechanicalSystem, point: int) -> OutputRow:
    """Lateral displacement of `point`, m; that of the table is part of it where sensors see the absolute motion.

    Raises:
        KeyError: no such point exists.
        ValueError: the absolute displacement is asked for, but the table's position is not modelled.
    """
    zero = np.zeros(system.size)
    return OutputRow(zero, zero, system.selector(point) + _table_position(system, point, "displacement"), 0.0)


def velocity_output(system: ElectromechanicalSystem, point: int) -> OutputRow:
    """Lateral velocity of `point`, m/s; Raises: as :func:`displacement_output`."""
    zero = np.zeros(system.size)
    return OutputRow(zero, system.selector(point) + _table_position(system, point, "velocity"), zero, 0.0)


def acceleration_output(system: ElectromechanicalSystem, point: int) -> OutputRow:
    """Lateral acceleration of `point`, m/s² (KeyError where such a point is missing)."""
    zero = np.zeros(system.size)
    row = OutputRow(system.selector(point), zero, zero, 0.0)
    weight = 0.0 if system.base is None else system.base.weights.get(point, 0.0)
    return row if system.base is None or weight == 0.0 else row.plus(system.base.acceleration, weight)


def _table_position(system: ElectromechanicalSystem, point: int, quantity: str) -> Array:
    """(n,) share of the table's position in what a sensor at `point` sees."""
    row = np.zeros(system.size)
    weight = 0.0 if system.base is None else system.base.weights.get(point, 0.0)
    if system.base is None or weight == 0.0:
        return row
    if system.base.index is None:
        raise ValueError(
            f"the absolute {quantity} of point {point} needs the table's position: give the table its suspension"
        )
    row[system.base.index] = weight
    return row


def force_output(system: ElectromechanicalSystem, point: int) -> OutputRow:
    """Force of the exciter at `point`, of the first where none is there, N."""
    return next((exciter.force for exciter in system.exciters if exciter.point == point), system.force)


def input_output(system: ElectromechanicalSystem, exciter: int = 0) -> OutputRow:
    """The input of an exciter, counted from 0: voltage (V) with a shaker, force (N) without."""
    zero = np.zeros(system.size)
    return OutputRow(zero, zero, zero, 1.0, input=exciter)


def current_output(system: ElectromechanicalSystem, exciter: int = 0) -> OutputRow:
    """Coil current of an exciter, counted from 0, A.

    Raises:
        ValueError: it is not a shaker.
    """
    current = system.exciters[exciter].current
    if current is None:
        raise ValueError("the system has no shaker, hence no coil current")
    zero = np.zeros(system.size)
    row = np.zeros(system.size)
    row[current] = 1.0
    return OutputRow(zero, zero, row, 0.0)


def _extended(direction: Array, size: int) -> Array:
    result = np.zeros(size)
    result[: direction.shape[0]] = direction
    return result


def assemble(
    structure: Structure,
    elements: Sequence[LocalElement],
    points: int | Sequence[int],
    shakers: ElectrodynamicShaker | Sequence[ElectrodynamicShaker | None] | None = None,
    attachments: Sequence[Attachment] = (),
    exciter_elements: Sequence[LocalElement] = (),
    table: ShakingTable | None = None,
) -> ElectromechanicalSystem:
    """Join structure, local elements, exciters and attachments.

    Exciters act on the structure's `points`, one or several; each has its shaker, None = an ideal force.

    Elements on the side of the exciter (`exciter_elements`) act on the point of exciter 1 from behind its force sensor:
    their force on the structure, -Σ g, is part of its stinger force.

    The stinger (1.32e14 N/m in the paper) is a rigid link: table and drive point share a degree of
    freedom, and the stinger force stays available as
    f = -(m_T ẍ + d_T ẋ + k_T x + k_C (x - x_C) + d_C (ẋ - ẋ_C)).

    On a shaking table the ground of local elements moves with the table, and the force is the one that stands for the
    base acceleration at the drive point.

    Raises:
        KeyError: the structure has no such point.
        ValueError: an element's direction does not fit the structure; no exciter, or another number of shakers; a table
            with a shaker, with several points, with elements on its side, with attachments that have inertia, or under
            a structure without base load.
    """
    places = [points] if isinstance(points, int) else list(points)
    if shakers is None or isinstance(shakers, ElectrodynamicShaker):
        shakers = [shakers] * len(places)
    if not places or len(shakers) != len(places):
        raise ValueError(f"there must be one exciter or more and a shaker or None for each, got {len(places)} points")
    linear = [element for element in exciter_elements if element.linear]
    others = [element for element in exciter_elements if not element.linear]
    system = _with_exciters(structure, (*elements, *others), list(zip(places, shakers, strict=True)))
    if table is not None:
        if (
            len(places) > 1
            or shakers[0] is not None
            or exciter_elements
            or any(attachment.inertial for attachment in attachments)
        ):
            raise ValueError(
                "a shaking table takes no shaker, no second exciter, no elements on its side and no attachments with "
                "mass of their own"
            )
        system = on_table(structure, system, table)
    # A moment (an element on the rotation) does not belong to the lateral stinger force.
    drive = structure.selector(places[0])
    lateral = [bool(np.any(element.direction * drive)) for element in others]
    if any(lateral):
        first = system.exciters[0]
        system = replace(
            system,
            exciters=(replace(first, force=replace(first.force, exciter_elements=-1.0)), *system.exciters[1:]),
            on_exciter=(False,) * len(elements) + tuple(lateral),
        )
    for element in linear:
        system = _with_linear_on_exciter(system, element)
    return _attached(system, structure.size, attachments) if attachments else system


def _with_linear_on_exciter(system: ElectromechanicalSystem, element: LocalElement) -> ElectromechanicalSystem:
    """A linear spring or damper on the side of the exciter, as part of matrices and stinger force."""
    direction = _extended(element.direction, system.size)
    outer = np.outer(direction, direction)
    first = system.exciters[0]
    if np.any(direction * system.selector(first.point)):
        force = replace(
            first.force,
            velocity=first.force.velocity - element.linear_damping * direction,
            displacement=first.force.displacement - element.linear_stiffness * direction,
        )
        first = replace(first, force=force)
    return replace(
        system,
        damping=system.damping + element.linear_damping * outer,
        stiffness=system.stiffness + element.linear_stiffness * outer,
        exciters=(first, *system.exciters[1:]),
    )


def _attached(system: ElectromechanicalSystem, n: int, attachments: Sequence[Attachment]) -> ElectromechanicalSystem:
    """The system with the unknowns of attachments inserted: with inertia behind the structure, others at the end."""
    inertial = sum(attachment.inertial for attachment in attachments)
    first_order = sum(attachment.first_order for attachment in attachments)
    old = system.size
    size = old + inertial + first_order
    place = np.array([*range(n), *range(n + inertial, old + inertial)])  # where the old unknowns go

    def moved(vector: Array) -> Array:
        return moved_to(vector, place, size)

    matrices = []
    for matrix in (system.mass, system.damping, system.stiffness):
        larger = np.zeros((size, size))
        larger[np.ix_(place, place)] = matrix
        matrices.append(larger)
    elements = [element.along(moved(element.direction)) for element in system.elements]
    couplings = [
        replace(
            coupling,
            column=moved(coupling.column),
            displacement_rows=np.array([moved(row) for row in coupling.displacement_rows]),
            velocity_rows=np.array([moved(row) for row in coupling.velocity_rows]),
        )
        for coupling in system.couplings
    ]
    next_inertial, next_first = n, old + inertial
    for attachment in attachments:
        if attachment.direction.shape != (n,):
            raise ValueError(f"direction of {type(attachment).__name__} must have shape ({n},)")
        # Rows of [w, internal…] over all unknowns.
        local = np.zeros((attachment.size, size))
        local[0, :n] = attachment.direction
        for k in range(attachment.inertial):
            local[1 + k, next_inertial + k] = 1.0
        for k in range(attachment.first_order):
            local[1 + attachment.inertial + k, next_first + k] = 1.0
        next_inertial += attachment.inertial
        next_first += attachment.first_order
        for larger, own in zip(matrices, attachment.matrices(), strict=True):
            larger += local.T @ own @ local
        elements += [element.along(element.direction @ local) for element in attachment.elements()]
        couplings += [
            replace(
                coupling,
                column=coupling.column @ local,
                displacement_rows=coupling.displacement_rows @ local,
                velocity_rows=coupling.velocity_rows @ local,
            )
            for coupling in attachment.couplings()
        ]
    flags = system.on_exciter + (False,) * (len(elements) - len(system.elements)) if system.on_exciter else ()
    return replace(
        system,
        mass=matrices[0],
        damping=matrices[1],
        stiffness=matrices[2],
        exciters=tuple(exciter.moved(place, size) for exciter in system.exciters),
        elements=tuple(elements),
        first_order=system.first_order + first_order,
        couplings=tuple(couplings),
        on_exciter=flags,
        shapes={point: moved(row) for point, row in system.shapes.items()},
        base=None if system.base is None else system.base.moved(place, size),
    )


def _with_exciters(
    structure: Structure,
    elements: Sequence[LocalElement],
    exciters: Sequence[tuple[int, ElectrodynamicShaker | None]],
) -> ElectromechanicalSystem:
    """The structure with its elements and exciters (point and shaker): coils behind it, then the currents."""
    n = structure.size
    for element in elements:
        if element.direction.shape != (n,):
            raise ValueError(f"direction of {type(element).__name__} must have shape ({n},)")
    shakers = sum(shaker is not None for _, shaker in exciters)
    size = n + 2 * shakers
    mass, damping, stiffness = (np.zeros((size, size)) for _ in range(3))
    mass[:n, :n] = structure.mass
    damping[:n, :n] = structure.damping
    stiffness[:n, :n] = structure.stiffness
    couplings: list[Coupling] = []
    found = []
    coil = n
    for number, (point, shaker) in enumerate(exciters):
        drive = structure.selector(point)
        zero = np.zeros(size)
        if shaker is None:
            found.append(Exciter(point, _extended(drive, size), OutputRow(zero, zero, zero, 1.0, input=number)))
            continue
        current = coil + shakers
        table = np.outer(drive, drive)
        mass[:n, :n] += shaker.table_mass * table
        mass[coil, coil] = shaker.coil_mass
        damping[:n, :n] += shaker.table_damping * table
        stiffness[:n, :n] += shaker.table_stiffness * table
        for matrix, value in ((damping, shaker.coil_damping), (stiffness, shaker.coil_stiffness)):
            matrix[:n, :n] += value * table
            matrix[coil, coil] += value
            matrix[:n, coil] -= value * drive
            matrix[coil, :n] -= value * drive
        stiffness[coil, current] = -shaker.force_factor
        damping[current, coil] = shaker.force_factor
        damping[current, current] = shaker.inductance
        stiffness[current, current] = shaker.resistance
        voltage = np.zeros(size)
        voltage[current] = 1.0
        rows = np.zeros((3, size))
        rows[0, :n] = -shaker.table_mass * drive
        rows[1, :n] = -(shaker.table_damping + shaker.coil_damping) * drive
        rows[1, coil] = shaker.coil_damping
        rows[2, :n] = -(shaker.table_stiffness + shaker.coil_stiffness) * drive
        rows[2, coil] = shaker.coil_stiffness
        found.append(Exciter(point, voltage, OutputRow(rows[0], rows[1], rows[2], 0.0, input=number), coil, current))
        if shaker.force_factor_linear != 0.0 or shaker.force_factor_quadratic != 0.0:
            couplings += _varying_force_factor(shaker, size, coil, current)
        coil += 1
    return ElectromechanicalSystem(
        mass=mass,
        damping=damping,
        stiffness=stiffness,
        exciters=tuple(found),
        elements=tuple(element.along(_extended(element.direction, size)) for element in elements),
        points=dict(structure.points),
        structure_size=n,
        couplings=tuple(couplings),
        shapes={point: _extended(row, size) for point, row in structure.shapes.items()},
    )


def _varying_force_factor(
    shaker: ElectrodynamicShaker, size: int, coil: int, current: int
) -> tuple[Coupling, Coupling]:
    """What G (1 + b₁ x_C + b₂ x_C²) adds to the force on the coil and to the voltage it induces."""
    parameters = coupling_parameters(shaker.force_factor, shaker.force_factor_linear, shaker.force_factor_quadratic)
    force, voltage = np.zeros(size), np.zeros(size)
    force[coil], voltage[current] = -1.0, 1.0
    rows = np.zeros((4, 2, size))
    rows[0, 0, coil] = rows[0, 1, current] = 1.0  # x_C and i
    rows[2, 0, coil] = rows[3, 1, coil] = 1.0  # x_C and ẋ_C
    return (
        Coupling(FORCE_FACTOR, force, rows[0], rows[1], parameters),
        Coupling(FORCE_FACTOR, voltage, rows[2], rows[3], parameters),
    )


def on_table(structure: Structure, system: ElectromechanicalSystem, table: ShakingTable) -> ElectromechanicalSystem:
    """A system of structure and elements with the table as its exciter; the input is u, m/s².

    Args:
        structure: with a base load.
        system: the structure with its elements and an ideal force, as many unknowns as the structure.
        table: the table.

    Raises:
        ValueError: the structure has no base load.
    """
    load = structure.base_load
    if load is None:
        raise ValueError("the structure does not say how its base excites it")
    n = structure.size
    position = n if table.suspension is not None else None
    filtered = None if table.bandwidth is None else n + (position is not None)
    size = n + (position is not None) + (filtered is not None)
    mass, damping, stiffness = (np.zeros((size, size)) for _ in range(3))
    for larger, own in ((mass, structure.mass), (damping, structure.damping), (stiffness, structure.stiffness)):
        larger[:n, :n] = own
    # Rows that the acceleration y (or u) drives, and the acceleration a of the table as an output.
    driven = np.zeros(size)
    driven[:n] = -load
    rows = np.zeros((3, size))
    if position is not None:
        assert table.suspension is not None
        rate, square = 2.0 * table.suspension_damping * table.suspension, table.suspension**2
        driven[position] = 1.0
        mass[position, position] = 1.0
        damping[position, position], stiffness[position, position] = rate, square
        damping[:n, position], stiffness[:n, position] = -load * rate, -load * square
        rows[0, position] = 1.0
    inputs = driven
    if filtered is not None:
        assert table.bandwidth is not None
        damping[filtered, filtered] = 1.0 / table.bandwidth
        stiffness[filtered, filtered] = 1.0
        stiffness[:filtered, filtered] -= driven[:filtered]
        inputs = np.zeros(size)
        inputs[filtered] = 1.0
        if position is None:
            rows[2, filtered] = 1.0
    ideal = position is None and filtered is None
    acceleration = OutputRow(rows[0], rows[1], rows[2], 1.0 if ideal else 0.0)
    weights = {point: structure.base_motion.get(point, 1.0) for point in structure.point_numbers}

    def extended(vector: Array) -> Array:
        return np.concatenate([vector, np.zeros(size - n)])

    none = OutputRow(np.zeros(size), np.zeros(size), np.zeros(size), 0.0)
    return replace(
        system,
        mass=mass,
        damping=damping,
        stiffness=stiffness,
        exciters=(
            replace(system.exciters[0], input_vector=inputs, force=none.plus(acceleration, -table.effective_mass)),
        ),
        elements=tuple(element.along(extended(element.direction)) for element in system.elements),
        shapes={point: extended(row) for point, row in system.shapes.items()},
        first_order=int(filtered is not None),
        base=BaseMotion(acceleration, position, weights if table.absolute else {}),
    )


def driven_by_force(system: ElectromechanicalSystem) -> ElectromechanicalSystem:
    """A system on an ideal table with the force that stands for the base acceleration as its input, N.

    A table whose position is modelled is taken as free: far above its suspension it moves with the acceleration asked
    for.

    Raises:
        ValueError: the system is on no table, or the table has a bandwidth.
    """
    if system.base is None or system.first_order:
        raise ValueError("only a system on an ideal shaking table can be driven by its equivalent force")
    force, acceleration, index = system.force, system.base.acceleration, system.base.index
    per_force = 1.0 / (force.feedthrough if index is None else force.acceleration[index])
    none = np.zeros(system.size)
    exciter = replace(
        system.exciters[0],
        input_vector=system.input_vector * per_force,
        force=replace(force, acceleration=none, feedthrough=1.0)
        if index is not None
        else replace(force, feedthrough=1.0),
    )
    return replace(
        system,
        exciters=(exciter,),
        base=replace(system.base, acceleration=replace(acceleration, feedthrough=acceleration.feedthrough * per_force)),
    )
