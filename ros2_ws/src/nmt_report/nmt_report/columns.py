"""The columns in which modal properties are shown to people, and the words for what became of a level."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from markupsafe import Markup

from nmt_extract.modal_point import ModalPoint, Status


@dataclass(frozen=True)
class ModalColumn:
    """A column of the table of modal properties.

    Attributes:
        name: field of the modal point; its standard uncertainty is ``<name>_std``.
        symbol: heading; markup where it has an index.
        plain_symbol: heading for terminals.
        unit: SI unit, empty if none.
        factor: what to multiply values with before printing (100 for percent).
        decimals: decimal places where the uncertainty is not known.
        scaled: whether the column takes a common power of ten.
        optional: not shown where no point has a value.
    """

    name: str
    symbol: str
    plain_symbol: str
    unit: str
    factor: float = 1.0
    decimals: int = 4
    scaled: bool = False
    optional: bool = False


MODAL_COLUMNS = (
    ModalColumn("frequency_hz", "f̃", "f̃", "Hz", decimals=4),
    ModalColumn("damping_ratio", "δ̃", "δ̃", "%", factor=100.0, decimals=3),
    ModalColumn(
        "hysteresis_damping", Markup("δ<sub>hyst</sub>"), "δ_hyst", "%", factor=100.0, decimals=3, optional=True
    ),
    ModalColumn("modal_amplitude", Markup("<i>q</i>"), "q", "m√kg", scaled=True),
    ModalColumn("force_n", Markup("|<i>F</i><sub>1</sub>|"), "|F₁|", "N", decimals=4),
    ModalColumn("pbmif", "PBMIF", "PBMIF", ""),
    ModalColumn("gamma_force", Markup("γ<sub><i>F</i></sub>"), "γ_F", ""),
    ModalColumn("gamma_acceleration", Markup("γ<sub><i>A</i></sub>"), "γ_A", ""),
    ModalColumn("mac", "MAC", "MAC", "", decimals=5),
)


def shown_columns(points: Iterable[ModalPoint]) -> tuple[ModalColumn, ...]:
    """The columns that have something to show for these points."""
    known = list(points)
    return tuple(
        column
        for column in MODAL_COLUMNS
        if not column.optional or any(math.isfinite(getattr(point, column.name)) for point in known)
    )


def status_text(status: int) -> str:
    """What became of a level, in words."""
    return {Status.OK: "locked", Status.REJECTED: "rejected", Status.NOT_LOCKED: "not locked"}.get(
        Status(status), "no result"
    )


def unit_text(unit: str) -> str:
    """A unit with its superscripts: ``m/s²`` for ``m/s^2``."""
    return unit.replace("^2", "²")
