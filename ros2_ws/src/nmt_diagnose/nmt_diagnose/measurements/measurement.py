"""What every kind of measurement is: conditions under which rows were recorded, and all that depends on the kind."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from nmt_diagnose.measurements.channel import MeasuredChannel


class Measurement:
    """One measurement of a real side; its rows stand in observations.

    Attributes:
        WORDS: what the kind is called in tables.
    """

    WORDS: ClassVar[str]

    if TYPE_CHECKING:

        @property
        def name(self) -> str:
            """Unique name."""

        @property
        def drive_point(self) -> int:
            """Measurement point of the exciter, of several the first."""

        @property
        def drive_points(self) -> tuple[int, ...]:
            """Measurement point of each exciter."""

        @property
        def channels(self) -> tuple[MeasuredChannel, ...]:
            """Channels, in the order of the rows."""


class Driven(Measurement):
    """A measurement that names the point of its exciter, and those of further ones that it sees at rest."""

    resting_points: tuple[int, ...] = ()

    @property
    def drive_points(self) -> tuple[int, ...]:
        """Measurement point of each exciter."""
        return (self.drive_point, *self.resting_points)
