"""Which rows of a window are force, response and drive point; one exciter or several."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_extract.modal.window import Window


@dataclass(frozen=True)
class WindowRows:
    """Rows of a window's data.

    Attributes:
        forces: of the exciters, the first's first.
        motions: of the responses at the exciters, same order; the first is the drive point's.
        motion_quantities: what these measure.
        gamma, gamma_quantity: response at the drive point that its fundamental content is taken from.
        shape, shape_quantity: responses at the points of the linear modes.
    """

    forces: tuple[int, ...]
    motions: tuple[int, ...]
    motion_quantities: tuple[Quantity, ...]
    gamma: int
    gamma_quantity: Quantity
    shape: tuple[int, ...]
    shape_quantity: Quantity

    @classmethod
    def of(
        cls, window: Window, linear: LinearDescription, faulty: Collection[int] = (), words: str = "."
    ) -> WindowRows:
        """The rows that a window is evaluated by.

        Args:
            window: it.
            linear: linear modes.
            faulty: rows that must not stand for the drive point.
            words: that end the sentence where none is left.

        Raises:
            BenchError: force or responses are not measured where they are needed.
        """
        places = {(channel.quantity, channel.point): row for row, channel in reversed(list(enumerate(window.channels)))}
        for quantity in MOTIONS:
            shape = [places.get((quantity, point)) for point in linear.points]
            if None not in shape:
                break
        else:
            raise BenchError(
                "No kind of response sensor covers all points "
                f"({', '.join(map(str, linear.points))}) of the linear modes."
            )
        candidates = (quantity, *MOTIONS)

        def at_drive(quantities: Collection[Quantity]) -> tuple[int, Quantity]:
            for each in quantities:
                row = places.get((each, linear.drive_point))
                if row is not None and row not in faulty:
                    return row, each
            raise BenchError(f"No response is measured at drive point {linear.drive_point}{words}")

        force = _force_row(window, linear)
        drive, drive_quantity = at_drive(candidates)
        gamma, gamma_quantity = at_drive((Quantity.ACCELERATION, *candidates))
        forces, motions, motion_quantities = [force], [drive], [drive_quantity]
        for point in linear.exciter_points[1:]:
            pair = places.get((Quantity.FORCE, point)), places.get((quantity, point))
            if None in pair:
                raise BenchError(f"Force and {quantity.topic} are not both measured at exciter point {point}.")
            forces.append(int(pair[0] or 0))
            motions.append(int(pair[1] or 0))
            motion_quantities.append(quantity)
        return cls(
            tuple(forces), tuple(motions), tuple(motion_quantities), gamma, gamma_quantity,
            tuple(row for row in shape if row is not None), quantity,
        )  # fmt: skip

    @property
    def force(self) -> int:
        """Force of the first exciter."""
        return self.forces[0]

    @property
    def drive(self) -> int:
        """Response at the drive point."""
        return self.motions[0]

    @property
    def used(self) -> list[int]:
        """All rows, ascending."""
        return sorted({*self.forces, *self.motions, self.gamma, *self.shape})


def row_of(window: Window, quantity: Quantity, point: int) -> int | None:
    """Row of a quantity at a point."""
    for row, channel in enumerate(window.channels):
        if channel.quantity is quantity and channel.point == point:
            return row
    return None


def _force_row(window: Window, linear: LinearDescription) -> int:
    row = row_of(window, Quantity.FORCE, linear.drive_point)
    if row is not None:
        return row
    forces = [row for row, channel in enumerate(window.channels) if channel.quantity is Quantity.FORCE]
    if len(forces) != 1:
        points = [str(window.channels[row].point) for row in forces]
        raise BenchError(
            f"A force channel is missing at drive point {linear.drive_point}; "
            f"force channels measure at {'point ' + ', '.join(points) if points else 'no point'}."
        )
    if window.channels[forces[0]].point != 0:
        raise BenchError(
            f"The force is measured at point {window.channels[forces[0]].point}, but the linear "
            f"description names point {linear.drive_point} as drive point."
        )
    return forces[0]


def derived(amplitudes: ComplexArray, quantity: Quantity, omega: FloatArray, derivative: int) -> ComplexArray:
    """The ``derivative``-th time derivative of the displacement; n = 0 is NaN where unknown.

    Args:
        amplitudes: harmonics 0..H of a quantity, shape ``(sets, ..., H + 1)``.
        quantity: displacement, velocity or acceleration.
        omega: rad/s, shape ``(sets,)``.
        derivative: 0 = displacement.
    """
    power = derivative - MOTIONS[quantity]
    if power == 0:
        return amplitudes
    orders = np.arange(amplitudes.shape[-1])
    factor = 1j * np.multiply.outer(omega, orders)
    if amplitudes.ndim == 3:
        factor = factor[:, np.newaxis, :]
    result = np.empty_like(amplitudes)
    result[..., 1:] = amplitudes[..., 1:] * factor[..., 1:] ** power
    result[..., 0] = 0.0 if power > 0 else complex(np.nan, np.nan)
    return result
