"""A shaker as an attachment: what exciters besides the first are to the equations of motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nmt_rig.model.couplings import FORCE_FACTOR, Coupling, coupling_parameters
from nmt_rig.model.local_elements.attachments import Attachment
from nmt_rig.model.shaker import ElectrodynamicShaker
from nmt_rig.model.structure import Array


@dataclass(frozen=True)
class AttachedShaker(Attachment):
    """Table on the structure, coil with inertia, current without: coordinates [w, x_C (m), i (A)].

    The equations are those of :class:`~nmt_rig.model.shaker.ElectrodynamicShaker`; the input, a voltage, acts on the
    row of the current.
    """

    shaker: ElectrodynamicShaker
    inertial: ClassVar[int] = 1

    @property
    def first_order(self) -> int:
        """The current."""
        return 1

    def matrices(self) -> tuple[Array, Array, Array]:
        """Mass, damping and stiffness (3, 3)."""
        own = self.shaker
        mass, damping, stiffness = self._zeros()
        mass[0, 0], mass[1, 1] = own.table_mass, own.coil_mass
        damping[0, 0], stiffness[0, 0] = own.table_damping, own.table_stiffness
        for matrix, value in ((damping, own.coil_damping), (stiffness, own.coil_stiffness)):
            matrix[0, 0] += value
            matrix[1, 1] += value
            matrix[0, 1] -= value
            matrix[1, 0] -= value
        stiffness[1, 2] = -own.force_factor
        damping[2, 1], damping[2, 2] = own.force_factor, own.inductance
        stiffness[2, 2] = own.resistance
        return mass, damping, stiffness

    def couplings(self) -> tuple[Coupling, ...]:
        """What a force factor that varies with the coil's displacement adds to force and induced voltage."""
        own = self.shaker
        if own.force_factor_linear == own.force_factor_quadratic == 0.0:
            return ()
        parameters = coupling_parameters(own.force_factor, own.force_factor_linear, own.force_factor_quadratic)
        force, voltage = np.zeros(3), np.zeros(3)
        force[1], voltage[2] = -1.0, 1.0
        rows = np.zeros((4, 2, 3))
        rows[0, 0, 1] = rows[0, 1, 2] = 1.0  # x_C and i
        rows[2, 0, 1] = rows[3, 1, 1] = 1.0  # x_C and its velocity
        return (
            Coupling(FORCE_FACTOR, force, rows[0], rows[1], parameters),
            Coupling(FORCE_FACTOR, voltage, rows[2], rows[3], parameters),
        )
