"""An exciter in the equations of motion, and outputs as rows over the unknowns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nmt_rig.model.structure import Array


def moved_to(vector: Array, place: Array, size: int) -> Array:
    """A vector over `size` unknowns, whose entries place[i] are those of the given one."""
    result = np.zeros(size)
    result[place] = vector
    return result


@dataclass(frozen=True)
class OutputRow:
    """Linear output of the system.

    y = acceleration · q̈ + velocity · q̇ + displacement · q + feedthrough · input + exciter_elements · Σ g, the sum
    being over the local elements on the side of the exciter; rows have shape (n,). The feedthrough is that of the input
    of one exciter, `input`, counted from 0.
    """

    acceleration: Array
    velocity: Array
    displacement: Array
    feedthrough: float
    exciter_elements: float = 0.0
    input: int = 0

    def plus(self, other: OutputRow, factor: float = 1.0) -> OutputRow:
        """This output and a multiple of another."""
        return OutputRow(
            self.acceleration + factor * other.acceleration,
            self.velocity + factor * other.velocity,
            self.displacement + factor * other.displacement,
            self.feedthrough + factor * other.feedthrough,
            self.exciter_elements + factor * other.exciter_elements,
            self.input if self.feedthrough != 0.0 else other.input,
        )

    def moved(self, place: Array, size: int) -> OutputRow:
        """The same among `size` unknowns, old unknown i being the new one place[i]."""
        return replace(
            self,
            acceleration=moved_to(self.acceleration, place, size),
            velocity=moved_to(self.velocity, place, size),
            displacement=moved_to(self.displacement, place, size),
        )


@dataclass(frozen=True)
class Exciter:
    """What drives a system at a point.

    Attributes:
        point: point number it acts on.
        input_vector: (n,) column of its input: V with a shaker, N without, m/s² of a shaking table.
        force: output row set of its (stinger) force on the structure, N.
        coil, current: index of coil displacement and current, None without a shaker.
    """

    point: int
    input_vector: Array
    force: OutputRow
    coil: int | None = None
    current: int | None = None

    def moved(self, place: Array, size: int) -> Exciter:
        """The same among `size` unknowns, old unknown i being the new one place[i]."""
        coil, current = (None if index is None else int(place[index]) for index in (self.coil, self.current))
        column = moved_to(self.input_vector, place, size)
        return Exciter(self.point, column, self.force.moved(place, size), coil, current)
