"""Exact propagation of the linear part over a time step, with polynomial holds for input and local forces.

State s = [q with inertia (m), their velocities (m), coil current if any, unknowns of first order];
ṡ = A s + B_u u + B_g g, where u are the inputs of the exciters, and g the forces of the ports, i.e. the distinct
directions of the local elements, and behind them of the couplings. Over a step an input is a
straight line between samples; a port force is the cubic through its values and slopes at both ends (Hermite),
so a smooth local force is integrated to fourth order and the linear part without error. Where the
eigenvectors of A allow it, the state is kept in real modal form: pairs of states that a 2 x 2 block
propagates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.couplings import Coupling
from nmt_rig.model.exciter import OutputRow
from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.structure import Array

# Beyond this condition number of the scaled eigenvectors the modal form loses more digits than it saves time.
_WORST_CONDITION = 1e9


@dataclass(frozen=True)
class StateSpace:
    """First-order form of a system; see the module's text.

    Attributes:
        a: (N, N).
        b_inputs: (N, exciters).
        b_ports: (N, ports), those of the couplings last.
        directions: (ports without couplings, n) distinct directions of the local elements.
        elements: elements that are not part of A (springs and dampers that are linear are).
        element_port: (elements,) port of each element.
        mechanical_size: m.
        exciter_ports: (ports,) 1 where the elements are on the side of the exciter, else 0.
        couplings: forces of two arguments.
        observed: (2 couplings, N) what the couplings observe, in turn y₁ and y₂ of each.
    """

    a: Array
    b_inputs: Array
    b_ports: Array
    directions: Array
    elements: tuple[LocalElement, ...]
    element_port: NDArray[np.int64]
    mechanical_size: int
    exciter_ports: Array
    couplings: tuple[Coupling, ...] = ()
    observed: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def size(self) -> int:
        """Number of states N."""
        return int(self.a.shape[0])

    def output(self, rows: Sequence[OutputRow]) -> tuple[Array, Array, Array]:
        """Output matrices of y = C s + D_g g + D_u u.

        Returns:
            C (outputs, N), D_g (outputs, ports), D_u (outputs, exciters).

        Raises:
            ValueError: an output asks for the time derivative of the current.
        """
        m = self.mechanical_size
        c = np.zeros((len(rows), self.size))
        d_ports = np.zeros((len(rows), self.b_ports.shape[1]))
        d_inputs = np.zeros((len(rows), self.b_inputs.shape[1]))
        for i, row in enumerate(rows):
            if np.any(row.acceleration[m:]) or np.any(row.velocity[m:]):
                raise ValueError("an output cannot contain the time derivative of the current")
            c[i, :m] = row.displacement[:m]
            c[i, m : 2 * m] = row.velocity[:m]
            c[i, 2 * m :] = row.displacement[m:]
            c[i] += row.acceleration[:m] @ self.a[m : 2 * m]
            d_ports[i] = row.acceleration[:m] @ self.b_ports[m : 2 * m]
            if row.exciter_elements:
                d_ports[i] += row.exciter_elements * self.exciter_ports
            for j, b_input in enumerate(self.b_inputs.T):
                direct = row.feedthrough if row.input == j else 0.0
                d_inputs[i, j] = row.acceleration[:m] @ b_input[m : 2 * m] + direct
        return c, d_ports, d_inputs


def state_space(system: ElectromechanicalSystem) -> StateSpace:
    """First-order form of `system`; linear springs and dampers among its elements become part of A."""
    stiffness, damping = system.stiffness.copy(), system.damping.copy()
    rest: list[LocalElement] = []
    behind: list[bool] = []
    for position, element in enumerate(system.elements):
        if element.linear:
            outer = np.outer(element.direction, element.direction)
            stiffness += element.linear_stiffness * outer
            damping += element.linear_damping * outer
        else:
            rest.append(element)
            behind.append(system.is_on_exciter(position))
    directions: list[Array] = []
    ports: list[int] = []
    exciter_ports: list[float] = []
    for element, on_exciter in zip(rest, behind, strict=True):
        for index, known in enumerate(directions):
            if np.array_equal(known, element.direction) and bool(exciter_ports[index]) == on_exciter:
                ports.append(index)
                break
        else:
            ports.append(len(directions))
            directions.append(element.direction)
            exciter_ports.append(float(on_exciter))
    port_matrix = np.array(directions).reshape(len(directions), system.size)

    m = system.mechanical_size
    size = 2 * m + (system.size - m)
    a = np.zeros((size, size))
    b_inputs = np.zeros((size, len(system.exciters)))
    b_ports = np.zeros((size, len(directions)))
    inverse_mass = np.linalg.inv(system.mass[:m, :m])
    a[:m, m : 2 * m] = np.eye(m)
    a[m : 2 * m, :m] = -inverse_mass @ stiffness[:m, :m]
    a[m : 2 * m, m : 2 * m] = -inverse_mass @ damping[:m, :m]
    for j, exciter in enumerate(system.exciters):
        b_inputs[m : 2 * m, j] = inverse_mass @ exciter.input_vector[:m]
    b_ports[m : 2 * m] = -inverse_mass @ port_matrix[:, :m].T
    if size > 2 * m:
        a[m : 2 * m, 2 * m :] = -inverse_mass @ stiffness[:m, m:]
        inverse_inductance = np.linalg.inv(damping[m:, m:])
        a[2 * m :, :m] = -inverse_inductance @ stiffness[m:, :m]
        a[2 * m :, m : 2 * m] = -inverse_inductance @ damping[m:, :m]
        a[2 * m :, 2 * m :] = -inverse_inductance @ stiffness[m:, m:]
        for j, exciter in enumerate(system.exciters):
            b_inputs[2 * m :, j] = inverse_inductance @ exciter.input_vector[m:]
    space = StateSpace(
        a, b_inputs, b_ports, port_matrix, tuple(rest), np.array(ports, dtype=np.int64), m, np.array(exciter_ports)
    )
    return _with_couplings(space, system, inverse_mass) if system.couplings else space


def _with_couplings(space: StateSpace, system: ElectromechanicalSystem, inverse_mass: NDArray[Any]) -> StateSpace:
    """The state space with a port for each coupling behind those of the local elements."""
    m, count = space.mechanical_size, len(system.couplings)
    columns = np.array([coupling.column for coupling in system.couplings]).T
    b = np.zeros((space.size, count))
    b[m : 2 * m] = -inverse_mass @ columns[:m]
    observed = np.zeros((2 * count, space.size))
    for k, coupling in enumerate(system.couplings):
        if np.any(coupling.velocity_rows[:, m:]):
            raise ValueError("a coupling cannot observe the time derivative of an unknown without inertia")
        rows = slice(2 * k, 2 * k + 2)
        observed[rows, :m] = coupling.displacement_rows[:, :m]
        observed[rows, m : 2 * m] = coupling.velocity_rows[:, :m]
        observed[rows, 2 * m :] = coupling.displacement_rows[:, m:]
    if space.size > 2 * m:
        b[2 * m :] = -np.linalg.inv(system.damping[m:, m:]) @ columns[m:]
    return replace(
        space,
        b_ports=np.hstack([space.b_ports, b]),
        exciter_ports=np.concatenate([space.exciter_ports, np.zeros(count)]),
        couplings=system.couplings,
        observed=observed,
    )


@dataclass(frozen=True)
class Propagator:
    """Step matrices for h, h/2, …, h/2^K in working coordinates z (s = from_working z).

    Attributes:
        modal: z is in pairs (x_i, y_i), stored as all x then all y.
        pair: (K+1, 4, pairs) blocks [[xx, xy], [yx, yy]] of each pair; empty unless modal.
        dense: (K+1, Z, Z) transition matrices; empty if modal.
        start_weights: (K+1, 2 exciters + 2 ports, Z) weights of the values known before the step: each input at its
            start and at its end, port forces (N) at its start, their slopes (N/s) at its start.
        end_weights: (K+1, 2 ports, Z) weights of port forces, then their slopes, at the step's end.
        port_rows: (3 ports, Z) displacement, velocity, acceleration of the ports of local elements, grouped by kind;
            behind them, where there are couplings, what these observe and its rate (4 rows a coupling).
        port_inputs: (exciters, 3 ports) direct share of each input in them.
        port_feedthrough: (3 ports, ports) direct share of the port forces in them.
        compliance: (K+1, 3 ports, 2 ports) share of port forces and slopes at the step's end in them.
        from_working: (N, Z).
        to_working: (Z, N).
    """

    modal: bool
    pair: Array
    dense: Array
    start_weights: Array
    end_weights: Array
    port_rows: Array
    port_inputs: Array
    port_feedthrough: Array
    compliance: Array
    from_working: Array
    to_working: Array


def phi_functions(z: NDArray[np.complex128], count: int) -> NDArray[np.complex128]:
    """φ_0 … φ_count, shape (count + 1, …): φ_0 = exp(z), φ_{k+1} = (φ_k - 1/k!) / z, accurate for all |z|."""
    result = np.empty((count + 1, *z.shape), dtype=complex)
    result[0] = np.exp(z)
    small = np.abs(z) < 1.0
    safe = np.where(small, 1.0, z)
    tiny = np.where(small, z, 0.0)
    factorial = 1.0
    for k in range(count):
        result[k + 1] = (result[k] - 1.0 / factorial) / safe
        factorial *= k + 1
    factorial = 1.0
    for k in range(1, count + 1):
        factorial *= k
        term = np.full(z.shape, 1.0 / factorial, dtype=complex)
        total = term.copy()
        for j in range(1, 26):
            term = term * tiny / (k + j)
            total += term
        result[k] = np.where(small, total, result[k])
    return result


def _holds(phi: Any, h: float) -> tuple[Any, ...]:
    """Weights of input start and end, force and slope at the start, force and slope at the end."""
    i0, i1, i2, i3 = phi[0], phi[1], 2.0 * phi[2], 6.0 * phi[3]
    return (
        h * (i0 - i1),
        h * i1,
        h * (i0 - 3.0 * i2 + 2.0 * i3),
        h * h * (i1 - 2.0 * i2 + i3),
        h * (3.0 * i2 - 2.0 * i3),
        h * h * (i3 - i2),
    )


def propagator(space: StateSpace, step: float, levels: int, force_dense: bool = False) -> Propagator:
    """Step matrices of `space` for step (s) and its halves down to step / 2^levels.

    Raises:
        ValueError: the step is not positive.
    """
    if not step > 0:
        raise ValueError(f"the time step must be positive, got {step}")
    ports = space.b_ports.shape[1]
    exciters = space.b_inputs.shape[1]
    of_ports = slice(exciters, exciters + ports)
    inputs = np.column_stack([space.b_inputs, space.b_ports])
    form = None if force_dense else _modal_form(space)
    matrices = _dense_steps(space, inputs, step, levels) if form is None else _modal_steps(form, inputs, step, levels)
    weights, size = matrices.weights, matrices.from_working.shape[1]
    rows, port_inputs, feedthrough = _port_rows(space)
    port_rows = rows @ matrices.from_working
    compliance = np.zeros((levels + 1, rows.shape[0], 2 * ports))
    for level in range(levels + 1):
        compliance[level, :, :ports] = port_rows @ weights[4][level][:, of_ports] + feedthrough
        compliance[level, :, ports:] = port_rows @ weights[5][level][:, of_ports]

    # In turn those of the start and of the end for each input.
    of_inputs = np.stack([weights[0][:, :, :exciters], weights[1][:, :, :exciters]], axis=3)
    start_weights = np.concatenate(
        [
            of_inputs.reshape(levels + 1, size, 2 * exciters),
            weights[2][:, :, of_ports],
            weights[3][:, :, of_ports],
        ],
        axis=2,
    )
    end_weights = np.concatenate([weights[4][:, :, of_ports], weights[5][:, :, of_ports]], axis=2)
    return Propagator(
        modal=form is not None,
        pair=matrices.pair,
        dense=matrices.dense,
        start_weights=np.ascontiguousarray(start_weights.transpose(0, 2, 1)),
        end_weights=np.ascontiguousarray(end_weights.transpose(0, 2, 1)),
        port_rows=np.ascontiguousarray(port_rows),
        port_inputs=port_inputs,
        port_feedthrough=feedthrough,
        compliance=compliance,
        from_working=matrices.from_working,
        to_working=matrices.to_working,
    )


@dataclass(frozen=True)
class _ModalForm:
    """Modes of A in real pairs (x, y): real and imaginary part of a complex pair, or two real modes.

    Attributes:
        values: (N,) eigenvalues.
        vectors: (N, N) eigenvectors in columns.
        upper: complex modes of positive frequency.
        first, second: real modes that are x and y of their pairs; there is one more of the first where their number is
            odd.
    """

    values: NDArray[np.complex128]
    vectors: NDArray[np.complex128]
    upper: NDArray[np.int64]
    first: NDArray[np.int64]
    second: NDArray[np.int64]

    @property
    def pairs(self) -> int:
        """Number of pairs."""
        return self.upper.size + self.first.size

    @property
    def from_working(self) -> Array:
        """(N, 2 pairs)."""
        u, f, g = self.upper.size, self.first.size, self.second.size
        result = np.zeros((self.values.size, 2 * self.pairs))
        result[:, :u] = 2.0 * self.vectors[:, self.upper].real
        result[:, self.pairs : self.pairs + u] = -2.0 * self.vectors[:, self.upper].imag
        result[:, u : u + f] = self.vectors[:, self.first].real
        result[:, self.pairs + u : self.pairs + u + g] = self.vectors[:, self.second].real
        return result

    def rows(self, modal: NDArray[np.complexfloating[Any, Any]]) -> Array:
        """(2 pairs, …) of an array with a row for each mode: all x, then all y."""
        u, f, g = self.upper.size, self.first.size, self.second.size
        result = np.zeros((2 * self.pairs, modal.shape[1]))
        result[:u], result[self.pairs : self.pairs + u] = modal[self.upper].real, modal[self.upper].imag
        result[u : u + f] = modal[self.first].real
        result[self.pairs + u : self.pairs + u + g] = modal[self.second].real
        return result

    def blocks(self, factors: NDArray[np.complex128]) -> Array:
        """Blocks [xx, xy, yx, yy], shape (4, pairs), that multiply each mode by its factor."""
        u, f, g = self.upper.size, self.first.size, self.second.size
        result = np.zeros((4, self.pairs))
        result[0, :u], result[1, :u] = factors[self.upper].real, -factors[self.upper].imag
        result[2, :u], result[3, :u] = factors[self.upper].imag, factors[self.upper].real
        result[0, u : u + f] = factors[self.first].real
        result[3, u : u + g] = factors[self.second].real
        return result


@dataclass(frozen=True)
class _Steps:
    """Step matrices before the ports are distinguished from the inputs; as of :class:`Propagator`.

    Attributes:
        weights: six arrays (K+1, Z, exciters + ports) in the order of :func:`_holds`.
    """

    pair: Array
    dense: Array
    weights: list[Array]
    from_working: Array
    to_working: Array


def _modal_form(space: StateSpace) -> _ModalForm | None:
    """The modes of a system; None where its eigenvectors lose too many digits."""
    values, vectors = np.linalg.eig(space.a)
    scale = np.linalg.norm(vectors, axis=1)
    scale[scale == 0.0] = 1.0
    if not np.linalg.cond(vectors / scale[:, None]) < _WORST_CONDITION:
        return None
    real = np.flatnonzero(values.imag == 0)
    return _ModalForm(values, vectors, np.flatnonzero(values.imag > 0), real[0::2], real[1::2])


def _modal_steps(form: _ModalForm, inputs: Array, step: float, levels: int) -> _Steps:
    left = np.linalg.inv(form.vectors)
    left_inputs = left @ inputs
    size = 2 * form.pairs
    pair = np.zeros((levels + 1, 4, form.pairs))
    weights = [np.zeros((levels + 1, size, inputs.shape[1])) for _ in range(6)]
    steps = step / 2.0 ** np.arange(levels + 1)
    with np.errstate(over="ignore", invalid="ignore"):  # what grows without bound is refused when it moves
        phi_of_levels = phi_functions(np.asarray(form.values * steps[:, None], dtype=complex), 4)
    for level in range(levels + 1):
        phi = phi_of_levels[:, level]
        pair[level] = form.blocks(phi[0])
        for weight, hold in zip(weights, _holds(phi[1:], step / 2.0**level), strict=True):
            weight[level] = form.rows(hold[:, None] * left_inputs)
    return _Steps(pair, np.zeros((0, size, size)), weights, form.from_working, form.rows(left))


def _dense_steps(space: StateSpace, inputs: Array, step: float, levels: int) -> _Steps:
    size = space.size
    dense = np.zeros((levels + 1, size, size))
    weights = [np.zeros((levels + 1, size, inputs.shape[1])) for _ in range(6)]
    for level in range(levels + 1):
        h = step / 2.0**level
        augmented = np.zeros((5 * size, 5 * size))
        augmented[:size, :size] = space.a * h
        for k in range(4):
            augmented[k * size : (k + 1) * size, (k + 1) * size : (k + 2) * size] = np.eye(size)
        exponential = expm(augmented)[:size]
        dense[level] = exponential[:, :size]
        phi_matrices = [exponential[:, (k + 1) * size : (k + 2) * size] for k in range(4)]
        for weight, hold in zip(weights, _holds(phi_matrices, h), strict=True):
            weight[level] = hold @ inputs
    unit = np.eye(size)
    return _Steps(np.zeros((0, 4, 0)), dense, weights, unit, unit)


def _port_rows(space: StateSpace) -> tuple[Array, Array, Array]:
    """What the ports see of the state, of each input and of the port forces: rows (R, N), (exciters, R), (R, ports)."""
    m = space.mechanical_size
    count = space.directions.shape[0]  # ports of local elements
    local = 3 * count
    total = local + 2 * space.observed.shape[0]
    port_map = space.directions[:, :m]
    rows = np.zeros((total, space.size))
    rows[:count, :m] = port_map
    rows[count : 2 * count, m : 2 * m] = port_map
    rows[2 * count : local] = port_map @ space.a[m : 2 * m]
    feedthrough = np.zeros((total, space.b_ports.shape[1]))
    feedthrough[2 * count : local] = port_map @ space.b_ports[m : 2 * m]
    port_inputs = np.zeros((space.b_inputs.shape[1], total))
    for j, b_input in enumerate(space.b_inputs.T):
        port_inputs[j, 2 * count : local] = port_map @ b_input[m : 2 * m]
    if space.couplings:
        rates = local + space.observed.shape[0]
        rows[local:rates] = space.observed
        rows[rates:] = space.observed @ space.a
        feedthrough[rates:] = space.observed @ space.b_ports
        for j, b_input in enumerate(space.b_inputs.T):
            port_inputs[j, rates:] = space.observed @ b_input
    return rows, port_inputs, feedthrough
