"""What the forces are brought to; zero harmonics of one exciter are the simplest."""

from __future__ import annotations

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray


class ForceTargets:
    """Targets of the forces of all exciters: zero for harmonics; others follow what is measured.

    Attributes:
        points: whose responses they follow.
    """

    points: tuple[int, ...] = ()

    @property
    def obstacle(self) -> str:
        """What keeps the motion from being as they want it, empty if nothing does."""
        return ""

    @property
    def summary(self) -> str:
        """How the motion is, empty if there is nothing to say."""
        return ""

    def clear(self) -> None:
        """The drive is at rest: forget what was measured."""

    def restart_dwell(self) -> None:
        """Judge what comes from now on."""

    def targets(self, force: ComplexArray, response: ComplexArray, quantity: Quantity, duration: float) -> ComplexArray:
        """F_jn*, N, shape (exciters, H); that of the first fundamental is what it is.

        Args:
            force: F_jn, N, shape (exciters, H).
            response: harmonics 1 … H of the response at ``points``, in any unit, shape (points, H).
            quantity: what the response is.
            duration: s since the last block.
        """
        target: ComplexArray = np.zeros(force.shape, complex)
        target[0, 0] = force[0, 0]
        return target
