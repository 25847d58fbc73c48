"""Local forces under Gaussian motion, each replaced by the spring and damper that are nearest to it in the mean square.

Statistical linearisation (Roberts and Spanos, Random Vibration and Statistical Linearization, 2003, chapter 3): a force
g(w, ẇ) becomes k w + d ẇ with k = E[g w] / E[w²] and d = E[g ẇ] / E[ẇ²]. It is what cross-spectra with the drive see of
a weakly nonlinear system. A force with memory takes its values from cycles whose amplitudes are distributed as those of
narrow-band noise (Rayleigh).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_core.numerics.kernels import njit
from nmt_rig.model.aft import ElementTables, LocalTables
from nmt_rig.model.element_kernels import response
from nmt_rig.model.local_elements.element import CONTACT_GAP, CONTACT_STIFFNESS, SLIDER_SLIP, SLIDER_STIFFNESS

_DISPLACEMENTS, _VELOCITIES, _CYCLES = 16, 48, 32
_W, _W_SHARE = np.polynomial.hermite_e.hermegauss(_DISPLACEMENTS)
_V, _V_SHARE = np.polynomial.hermite_e.hermegauss(_VELOCITIES)
_W_SHARE, _V_SHARE = _W_SHARE / _W_SHARE.sum(), _V_SHARE / _V_SHARE.sum()
_A, _A_SHARE = np.polynomial.laguerre.laggauss(_CYCLES)


class Quadrature(NamedTuple):
    """Nodes and weights of displacement and velocity over their rms, and of half the squared amplitude of cycles over
    the mean square.
    """

    displacements: FloatArray
    displacement_shares: FloatArray
    velocities: FloatArray
    velocity_shares: FloatArray
    cycles: FloatArray
    cycle_shares: FloatArray


NODES = Quadrature(_W, _W_SHARE, _V, _V_SHARE, _A, _A_SHARE)


def equivalents(tables: LocalTables, displacement: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stiffness (N/m) and damping (N s/m) of the local forces of each coordinate, (r,) each.

    Args:
        tables: of the local forces.
        displacement, velocity: rms of w (m) and ẇ (m/s) of each coordinate, (r,), above zero.
    """
    stiffness, damping = equivalents_kernel(tables.elements, displacement, velocity, NODES)
    return stiffness, damping


@njit(cache=True)
def equivalents_kernel(
    elements: ElementTables, displacement: FloatArray, velocity: FloatArray, nodes: Quadrature
) -> tuple[FloatArray, FloatArray]:
    """``equivalents`` for other kernels."""
    jenkins, jenkins_start, contacts, contacts_start, kinds, parameters, sampled_start = elements
    w_nodes, w_shares, v_nodes, v_shares, cycles, cycle_shares = nodes
    count = displacement.size
    stiffness, damping = np.zeros(count), np.zeros(count)
    for i in range(count):
        x, y = displacement[i], velocity[i]
        for number in range(jenkins_start[i], jenkins_start[i + 1]):
            k, d = _slider(jenkins[number, SLIDER_STIFFNESS], jenkins[number, SLIDER_SLIP], x, y, cycles, cycle_shares)
            stiffness[i] += k
            damping[i] += d
        for number in range(contacts_start[i], contacts_start[i + 1]):
            # E[g w] / E[w²] is the mean slope of g (Stein): the share of time in contact.
            closed = 0.5 * math.erfc(contacts[number, CONTACT_GAP] / x / math.sqrt(2.0))
            stiffness[i] += contacts[number, CONTACT_STIFFNESS] * closed
        for number in range(sampled_start[i], sampled_start[i + 1]):
            along_w, along_v = 0.0, 0.0
            for a in range(w_nodes.size):
                for b in range(v_nodes.size):
                    g = response(kinds[number], parameters, number, x * w_nodes[a], y * v_nodes[b])[0]
                    share = w_shares[a] * v_shares[b] * g
                    along_w += share * w_nodes[a]
                    along_v += share * v_nodes[b]
            stiffness[i] += along_w / x
            damping[i] += along_v / y
    return stiffness, damping


@njit(cache=True)
def _slider(k: float, slip: float, x: float, y: float, cycles: FloatArray, shares: FloatArray) -> tuple[float, float]:
    """Equivalents of a Jenkins element: secant and dissipation of cycles of amplitude A, weighed with A²."""
    limit = slip / k
    # With x = A² / 2σ² the distribution is exp(−x); below x₀ the slider sticks.
    start = 0.5 * (limit / x) ** 2
    share = math.exp(-start)
    along, lost = k * (1.0 - share * (1.0 + start)), 0.0
    for n in range(cycles.size if share > 0.0 else 0):
        amplitude = x * math.sqrt(2.0 * (start + cycles[n]))
        weight = share * shares[n] * (start + cycles[n])
        angle = math.acos(max(1.0 - 2.0 * limit / amplitude, -1.0))
        along += weight * k / math.pi * (angle - 0.5 * math.sin(2.0 * angle))
        # 4 μN (A − A₀) a cycle, over π ω A².
        lost += weight * 4.0 * slip * (amplitude - limit) / (math.pi * amplitude * amplitude)
    return along, lost * x / y
