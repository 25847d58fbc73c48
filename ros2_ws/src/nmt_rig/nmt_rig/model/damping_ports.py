"""Damping that is diagonal in the modes but for what acts at a few places: the drive point, the coil, dampers.

With these m ports P, (N, m) in modal coordinates,

    C = diag(d) + P X Pᵀ,

and a solution at a frequency needs a system of m unknowns only (Woodbury). Whether the damping is of this form is found
by a least-squares fit of X and checked entry by entry.
"""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_rig.model.assembly import ElectromechanicalSystem

MOST_PORTS = 12
_RELATIVE = 1e-9
# Modes that the ports move most, from whose entries the damping between the ports is found.
_FITTED = 64


def port_directions(system: ElectromechanicalSystem, inertial: np.ndarray) -> FloatArray | None:
    """Orthonormal directions (m, inertial) that damping next to the modes' own may act along; None = too many."""
    directions = [system.selector(system.drive_point), *np.eye(system.size)[system.structure_size :]]
    directions += [element.direction for element in system.elements]
    chosen = np.array(directions)[:, inertial]
    chosen = chosen[chosen.any(axis=1)]
    _, _, basis = np.linalg.svd(chosen, full_matrices=False)
    found: FloatArray = basis[: np.linalg.matrix_rank(chosen)]
    return found if len(found) <= MOST_PORTS else None


def split_damping(modal: FloatArray, ports: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """X (m, m) and the diagonal d (N,) of a damping matrix (N, N) in the modes; None where it has another form.

    Args:
        modal: the damping matrix, symmetric.
        ports: (N, m).
    """
    m = ports.shape[1]
    pairs = [(a, b) for a in range(m) for b in range(a, m)]
    moved = np.sort(np.argsort(-np.sum(ports**2, axis=1), kind="stable")[:_FITTED])
    some = ports[moved]
    above = np.triu_indices(len(moved), 1)
    terms = [some[:, [a]] * some[:, b] for a, b in pairs]
    terms = [term if a == b else term + term.T for term, (a, b) in zip(terms, pairs, strict=True)]
    matrix = np.column_stack([term[above] for term in terms])
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    values = np.linalg.lstsq(matrix / scale, modal[np.ix_(moved, moved)][above], rcond=None)[0] / scale
    between = np.zeros((m, m))
    for (a, b), value in zip(pairs, values, strict=True):
        between[a, b] = between[b, a] = value
    rest = modal - ports @ between @ ports.T
    own = np.diag(rest).copy()
    return (between, own) if is_small(rest - np.diag(own), modal) else None


def is_small(rest: FloatArray, matrix: FloatArray) -> bool:
    """Whether a difference of matrices is rounding compared with the diagonal, entry by entry."""
    size = np.abs(np.diag(matrix))
    return not np.any(np.abs(rest) > _RELATIVE * np.sqrt(np.outer(size, size)) + 1e-12 * size.max(initial=0.0))
