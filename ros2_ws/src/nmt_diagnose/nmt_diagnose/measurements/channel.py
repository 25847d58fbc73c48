"""A recorded channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import ROTATION_UNITS
from nmt_rig.model.local_elements.element import MAGNITUDE_OF


@dataclass(frozen=True)
class MeasuredChannel:
    """A recorded channel.

    Attributes:
        name: channel name, for example ``f2``, ``x4``, ``a2``, ``u``.
        quantity: what it measures.
        point: measurement point, 0 for voltage and current.
        ideal: it is the motion or force itself, whatever sensors the rig has.
        turns: an angle stands for its displacement, a torque for its force.
    """

    name: str
    quantity: Quantity
    point: int
    ideal: bool = False
    turns: bool = field(default=False, compare=False)

    @property
    def unit(self) -> str:
        """SI unit."""
        return ROTATION_UNITS.get(self.quantity, self.quantity.unit) if self.turns else self.quantity.unit


def with_magnitudes(signals: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Channels that a strength may follow, by name, and their magnitudes: friction grows with a load of either sign."""
    plain = {name: values for name, values in signals.items() if not name.startswith(MAGNITUDE_OF)}
    return plain | {MAGNITUDE_OF + name: np.abs(values) for name, values in plain.items()}
