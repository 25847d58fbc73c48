"""The columns in which modal properties are shown to people, and the words for what became of a level."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from nmt_core.kinds.response_curve import RESONANT_LAG
from nmt_core.messages.modal_point import QUANTITIES, ModalPoint
from nmt_core.messages.modal_quantity import TableColumn
from nmt_core.vocabulary import PointStatus
from nmt_extract.curves.response_curve import is_of_curve, response_curves
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


class _LagColumn(ModalColumn):
    """Lag of the drive-point displacement behind the force, of points of a response curve."""

    def cell(self, point: ModalPoint, exponent: int, write: Callable[[float, float, int], str] = uncertain) -> str:
        lag, std = math.degrees(RESONANT_LAG + point.phase_error), math.degrees(point.phase_error_std)
        return write(lag, std, self.shown.decimals)


@dataclass(frozen=True)
class _StabilityColumn(ModalColumn):
    """Stability in open loop of points of response curves.

    Attributes:
        words: by level index.
    """

    words: Mapping[int, str]

    @classmethod
    def of(cls, points: Sequence[ModalPoint]) -> _StabilityColumn:
        """Of the curves of all points."""
        names = {1.0: "stable", 0.0: "unstable"}
        words = {
            point.level_index: names.get(float(stable), "left open")
            for curve in response_curves(points)
            for point, stable in zip(curve.points, curve.stable, strict=True)
        }
        return cls("stable", TableColumn("open loop", rank=1), words)

    def exponent(self, points: Iterable[ModalPoint]) -> int:
        """None."""
        return 0

    def cell(self, point: ModalPoint, exponent: int, write: Callable[[float, float, int], str] = uncertain) -> str:
        """The word; a point that was measured anew has none."""
        return self.words.get(point.level_index, "left open")


_LAG = _LagColumn("phase_error", TableColumn("lag", unit="°", decimals=2, rank=1, live=True))
_OF_A_MODE = ("damping_ratio", "hysteresis_damping", "pbmif")  # of phase resonance; elsewhere they say nothing


def shown_columns(points: Iterable[ModalPoint]) -> tuple[ModalColumn, ...]:
    """The columns that have something to show for these points; of a response curve lag and stability, no damping."""
    known = list(points)
    columns = [
        column
        for column in MODAL_COLUMNS
        if not column.shown.optional or any(math.isfinite(getattr(point, column.name)) for point in known)
    ]
    if any(point.force_order for point in known):
        columns.insert(1, _EXCITATION)
    if is_of_curve(known):
        columns = [column for column in columns if column.name not in _OF_A_MODE]
        stability = [_StabilityColumn.of(known)] if any(point.level_unit == "N" for point in known) else []
        columns[1:1] = [_LAG, *stability]
    return tuple(columns)


def status_text(status: int) -> str:
    """What became of a level, in words."""
    return {PointStatus.OK: "locked", PointStatus.REJECTED: "rejected", PointStatus.NOT_LOCKED: "not locked"}.get(
        PointStatus(status), "no result"
    )


def unit_text(unit: str) -> str:
    """A unit with its superscripts: ``m/s²`` for ``m/s^2``."""
    return unit.replace("^2", "²")
