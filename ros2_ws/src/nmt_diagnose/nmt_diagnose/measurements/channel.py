"""A recorded channel."""

from __future__ import annotations

from dataclasses import dataclass, field

from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import ROTATION_UNITS


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
