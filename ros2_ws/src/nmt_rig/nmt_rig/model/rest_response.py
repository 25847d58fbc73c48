"""Response of a system linearised at rest at many frequencies, at the cost of one.

In the modes of the undamped system the damping of a structure with stiffness- and mass-proportional damping is diagonal
but for what acts at a few places: the drive point, the coil, dampers. With these m ports P

    C = diag(d) + P X Pᵀ,

and the solution at a frequency needs a system of m unknowns only (Woodbury). Whether the damping is of this form is
found by a least-squares fit of X and checked entry by entry.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.fourier_basis import ComplexArray, FloatArray

_MOST_PORTS = 12
_RELATIVE = 1e-9


def responses_at_rest(
    system: ElectromechanicalSystem, frequencies: FloatArray
) -> tuple[ComplexArray, ComplexArray] | None:
    """Lateral displacement of the drive point and force on it, for a unit input, at many frequencies.

    Args:
        system: structure with its local elements and exciter; those behind the force sensor are linear.
        frequencies: (k,) ω, rad/s.

    Returns:
        (k,) m and (k,) N, as :meth:`ElectromechanicalSystem.response` gives them but for rounding; None where the
        damping is not diagonal but for a few ports.
    """
    if system.force.exciter_elements:
        return None
    inertial = np.flatnonzero(system.mass.any(axis=1))
    massless = np.flatnonzero(~system.mass.any(axis=1))
    stiffness, damping = system.sticking_stiffness(), system.resting_damping()
    block = np.ix_(inertial, inertial)
    squares, modes = eigh(0.5 * (stiffness[block] + stiffness[block].T), system.mass[block])
    if not np.allclose(stiffness[block], stiffness[block].T, rtol=1e-9, atol=1e-12 * np.abs(stiffness).max()):
        return None
    found = _ports(system, inertial, modes, damping[block])
    if found is None:
        return None
    ports, between, own = found

    s = 1j * frequencies[:, None]
    inverse = 1.0 / (squares + s * own + s * s)  # (k, N)
    # Unknowns of the small system: the motion of the ports, then what has no inertia.
    to_modes = modes.T @ stiffness[np.ix_(inertial, massless)], modes.T @ damping[np.ix_(inertial, massless)]
    from_modes = stiffness[np.ix_(massless, inertial)] @ modes, damping[np.ix_(massless, inertial)] @ modes
    whole = np.ix_(massless, massless)
    m, size = ports.shape[1], ports.shape[1] + massless.size
    columns = np.empty((frequencies.size, inertial.size, size), dtype=np.complex128)
    columns[:, :, :m] = s[:, :, None] * (ports @ between)
    columns[:, :, m:] = to_modes[0] + s[:, :, None] * to_modes[1]
    rows = np.empty((frequencies.size, size, inertial.size), dtype=np.complex128)
    rows[:, :m] = ports.T
    rows[:, m:] = from_modes[0] + s[:, :, None] * from_modes[1]
    small = -(rows * inverse[:, None, :]) @ columns
    small[:, :m] *= -1.0
    small[:, :m, :m] += np.eye(m)
    small[:, m:, m:] += stiffness[whole] + s[:, :, None] * damping[whole]
    given = modes.T @ system.input_vector[inertial]
    right = np.einsum("kij,kj->ki", rows, inverse * given)
    right[:, m:] = system.input_vector[massless] - right[:, m:]
    inner = np.linalg.solve(small, right[:, :, None])
    modal = inverse * (given - (columns @ inner)[:, :, 0])
    unknowns = np.zeros((frequencies.size, system.size), dtype=np.complex128)
    unknowns[:, inertial] = modal @ modes.T
    unknowns[:, massless] = inner[:, m:, 0]
    force = system.force
    row = s * s * force.acceleration + s * force.velocity + force.displacement
    displacement = np.asarray(system.motion(system.drive_point, unknowns.T), dtype=np.complex128)
    return displacement, np.einsum("ki,ki->k", row, unknowns) + force.feedthrough


def _ports(
    system: ElectromechanicalSystem, inertial: np.ndarray, modes: FloatArray, damping: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Ports (N, m) in modal coordinates, X (m, m) and the diagonal d (N,); None where the damping has another form."""
    directions = [system.selector(system.drive_point), *np.eye(system.size)[system.structure_size :]]
    directions += [element.direction for element in system.elements]
    chosen = np.array(directions)[:, inertial]
    chosen = chosen[chosen.any(axis=1)]
    _, _, basis = np.linalg.svd(chosen, full_matrices=False)
    basis = basis[: np.linalg.matrix_rank(chosen)]
    if len(basis) > _MOST_PORTS:
        return None
    ports = modes.T @ basis.T
    modal = modes.T @ damping @ modes
    m = ports.shape[1]
    pairs = [(a, b) for a in range(m) for b in range(a, m)]
    above = np.triu_indices(len(modal), 1)
    terms = [ports[:, [a]] * ports[:, b] for a, b in pairs]
    terms = [term if a == b else term + term.T for term, (a, b) in zip(terms, pairs, strict=True)]
    matrix = np.column_stack([term[above] for term in terms])
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    values = np.linalg.lstsq(matrix / scale, modal[above], rcond=None)[0] / scale
    between = np.zeros((m, m))
    for (a, b), value in zip(pairs, values, strict=True):
        between[a, b] = between[b, a] = value
    rest = modal - ports @ between @ ports.T
    own = np.diag(rest).copy()
    rest[np.diag_indices_from(rest)] = 0.0
    size = np.abs(np.diag(modal))
    if np.any(np.abs(rest) > _RELATIVE * np.sqrt(np.outer(size, size)) + 1e-12 * size.max(initial=0.0)):
        return None
    return ports, between, own
