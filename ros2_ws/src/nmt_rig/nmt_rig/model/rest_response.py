"""Response of a system linearised at rest at many frequencies, at the cost of one.

In the modes of the undamped system the impedance of a structure with stiffness- and mass-proportional damping is
diagonal but for what acts at a few ports, see `nmt_rig.model.harmonic_balance.Ports`: each frequency needs the sums
over the modes that lead from port to port, and a system of the ports.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.harmonic_balance import ModalImpedance


@dataclass(frozen=True)
class RestResponse:
    """Lateral displacement of the drive point and force on it, for a unit input.

    Attributes:
        impedance: of the linear part; its ports give the matrices, those of the local elements at rest among them.
        rows: (4, N) drive-point displacement, and displacement, velocity and acceleration rows of the force.
        given: (N,) input.
        feedthrough: force per input, next to the motion.
    """

    impedance: ModalImpedance
    rows: FloatArray
    given: FloatArray
    feedthrough: float

    @classmethod
    def of(cls, system: ElectromechanicalSystem, impedance: ModalImpedance) -> RestResponse | None:
        """Of a system and its impedance with every port; None where damping is not diagonal but for a few ports."""
        if system.force.exciter_elements:
            return None
        stiffness, ports = system.stiffness, impedance.ports
        block = np.ix_(*[np.flatnonzero(system.mass.any(axis=1))] * 2)
        if not np.allclose(stiffness[block], stiffness[block].T, rtol=1e-9, atol=1e-12 * np.abs(stiffness).max()):
            return None
        if not ports.directions.shape[1]:
            return None
        between = [ports.between_stiffness.copy(), ports.between_damping.copy()]
        for element in system.elements:
            along = ports.directions.T @ (impedance.shapes.T @ element.direction)
            between[0] += element.linear_stiffness * np.outer(along, along)
            between[1] += element.linear_damping * np.outer(along, along)
        ports = ports._replace(between_stiffness=between[0], between_damping=between[1])
        force = system.force
        rows = np.array([system.selector(system.drive_point), force.displacement, force.velocity, force.acceleration])
        given = impedance.shapes.T @ system.input_vector
        return cls(replace(impedance, ports=ports), rows @ impedance.shapes, given, float(force.feedthrough))

    def __call__(self, frequencies: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """(k,) m and (k,) N at frequencies (k,) ω, rad/s, as the system's own solution gives them but for rounding."""
        ports, m = self.impedance.ports, self.impedance.ports.directions.shape[1]
        s = 1j * frequencies[:, None]
        inverse = 1.0 / (ports.stiffness + s * ports.damping + s * s * np.diag(self.impedance.mass))  # (k, N)
        # Sums over the modes from the ports and the input to the ports and the outputs.
        ends = np.vstack((ports.directions.T, self.rows))  # (m + 4, N)
        starts = np.column_stack((ports.directions, self.given))  # (N, m + 1)
        paths = (ends[:, :, None] * starts).transpose(1, 0, 2).reshape(len(starts), -1)
        sums = (inverse @ paths).reshape(len(frequencies), len(ends), m + 1)
        # The force on the drive point is a sum of its displacement, velocity and acceleration rows.
        powers = np.concatenate((np.ones_like(s), s, s * s), axis=1)
        out = np.stack((sums[:, m], np.einsum("kp,kpj->kj", powers, sums[:, m + 1 :])), axis=1)  # (k, 2, m + 1)
        between = ports.between_stiffness + s[:, :, None] * ports.between_damping
        small = np.eye(m) + between @ sums[:, :m, :m]
        inner = np.linalg.solve(small, between @ sums[:, :m, m:])
        found = out[:, :, m] - (out[:, :, :m] @ inner)[:, :, 0]
        return found[:, 0], found[:, 1] + self.feedthrough
