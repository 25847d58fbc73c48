"""Energy of a simulated system, by integrals of what its elements answer at rest."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.integrate import quad

from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.time_integration import TimeIntegrator


def energy_of(element: LocalElement, w: float, slider: float) -> float:
    """Elastic energy at a displacement, J: the work of a slow motion from zero, that of a Jenkins element's spring."""
    if isinstance(element, Jenkins):
        return 0.5 * element.tangential_stiffness * (w - slider) ** 2
    values = element.values

    def force(x: float) -> float:
        if hasattr(element, "frozen"):
            return element.frozen(*values, element.next_branch(*values, 0, x, 0.0, 0.0), x, 0.0, 0.0)[0]
        return element.response(*values, x, 0.0)[0]

    corners = sorted({side * gap for _, gap, side in element.contacts if 0.0 < side * gap / w < 1.0})
    ends = [0.0, *(corners if w > 0.0 else corners[::-1]), w]
    return float(sum(quad(force, a, b)[0] for a, b in itertools.pairwise(ends)))


def stored_energy(integrator: TimeIntegrator) -> float:
    """Kinetic and elastic energy of structure, exciter and local elements, and of the inductance, J."""
    system = integrator.system
    m, state = system.mechanical_size, integrator.physical_state
    x, v, current = state[:m], state[m : 2 * m], state[2 * m :]
    energy = 0.5 * float(v @ system.mass[:m, :m] @ v + x @ system.stiffness[:m, :m] @ x)
    if system.current is not None:
        energy += 0.5 * float(system.damping[system.current, system.current]) * float(current[0]) ** 2
    sliders = iter(integrator._memory[3])
    for element in system.elements:
        slider = 0.0 if element.linear else float(next(sliders))
        w = float(np.asarray(element.direction)[:m] @ x)
        energy += energy_of(element, w, slider) if w else 0.0
    return energy
