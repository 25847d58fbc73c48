"""The columns in which modal properties are shown to people, and the words for what became of a level."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from markupsafe import Markup

from nmt_core.messages.modal_point import QUANTITIES, ModalPoint
from nmt_core.messages.modal_quantity import TableColumn
from nmt_core.vocabulary import PointStatus
from nmt_report.quantity_format import engineering_exponent, power_of_ten, uncertain


@dataclass(frozen=True)
class ModalColumn:
    """A column of the table of modal properties.

    Attributes:
        name: field of the modal point; its standard uncertainty is ``<name>_std``.
        shown: how it is shown.
    """

    name: str
    shown: TableColumn

    @property
    def heading(self) -> str:
        """Heading as markup."""
        return Markup(self.shown.html) if self.shown.html else self.shown.symbol  # the markup stands in the record

    def exponent(self, points: Iterable[ModalPoint]) -> int:
        """Power of ten that the column takes for these points."""
        return engineering_exponent(getattr(point, self.name) for point in points) if self.shown.scaled else 0

    def unit(self, exponent: int) -> str:
        """Unit with the power of ten before it; empty where there is none of both."""
        return " ".join(filter(None, (power_of_ten(exponent), self.shown.unit)))

    def cell(self, point: ModalPoint, exponent: int, write: Callable[[float, float, int], str] = uncertain) -> str:
        """Value and standard uncertainty of a point as text."""
        factor = self.shown.factor / 10.0**exponent
        value, std = getattr(point, self.name), getattr(point, f"{self.name}_std")
        return write(factor * value, factor * std, self.shown.decimals)


def _in_order() -> tuple[ModalColumn, ...]:
    """Columns of all quantities that tables show: as in the record, but where one names its place."""
    columns: list[ModalColumn] = []
    for quantity in QUANTITIES:
        if quantity.column is None:
            continue
        names = [column.name for column in columns]
        place = names.index(quantity.column.after) + 1 if quantity.column.after else len(columns)
        columns.insert(place, ModalColumn(quantity.name, quantity.column))
    return tuple(columns)


MODAL_COLUMNS = _in_order()
"""Columns of the tables of modal properties, in order."""

_EXCITATION = ModalColumn(
    "excitation_frequency_hz", TableColumn("Ω/2π", unit="Hz", rank=2, live=True)
)  # of a secondary resonance, where it is not the modal frequency


def shown_columns(points: Iterable[ModalPoint]) -> tuple[ModalColumn, ...]:
    """The columns that have something to show for these points."""
    known = list(points)
    columns = [
        column
        for column in MODAL_COLUMNS
        if not column.shown.optional or any(math.isfinite(getattr(point, column.name)) for point in known)
    ]
    if any(point.force_order for point in known):
        columns.insert(1, _EXCITATION)
    return tuple(columns)


def status_text(status: int) -> str:
    """What became of a level, in words."""
    return {PointStatus.OK: "locked", PointStatus.REJECTED: "rejected", PointStatus.NOT_LOCKED: "not locked"}.get(
        PointStatus(status), "no result"
    )


def unit_text(unit: str) -> str:
    """A unit with its superscripts: ``m/s²`` for ``m/s^2``."""
    return unit.replace("^2", "²")
