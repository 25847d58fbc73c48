"""What is said of a modal quantity, with its field in :class:`nmt_core.messages.modal_point.ModalPoint`.

``modal.csv``, the tables and figures, the live page, ``nmt.open`` and the floors of the uncertainties read it there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any, NamedTuple

_KEY = "quantity"


@dataclass(frozen=True)
class TableColumn:
    """A quantity in the tables that people read: report, terminal, live page.

    Attributes:
        symbol: heading in plain text.
        html: heading as HTML where the symbol has an index; empty = ``symbol``.
        unit: unit as printed, empty if none.
        factor: what values are multiplied with before printing (100 for percent).
        decimals: decimal places where the uncertainty is not known.
        scaled: whether the column takes a common power of ten.
        optional: not shown where no point has a value.
        after: quantity to whose right the column stands; empty = in the order of the record.
        rank: importance, 1 to 5; a narrow terminal leaves out 5 first and never 1.
        live: whether the table of the live page has it.
    """

    symbol: str
    html: str = ""
    unit: str = ""
    factor: float = 1.0
    decimals: int = 4
    scaled: bool = False
    optional: bool = False
    after: str = ""
    rank: int = 5
    live: bool = False


class Powers(NamedTuple):
    """Exponents of a quantity that is a product of powers of three measured amplitudes.

    Attributes:
        force: of the fundamental of the force.
        drive: of the fundamental of the response at the drive point.
        shape: of the fundamental of all responses together.
    """

    force: int = 0
    drive: int = 0
    shape: int = 0


@dataclass(frozen=True)
class ModalQuantity:
    """A measured quantity of a modal point; its standard uncertainty is ``<name>_std``.

    Attributes:
        name: field of the record, of the message and of ``modal.json``.
        unit: SI unit as in message files; ``1`` if it has none.
        meaning: what it is, in a few words.
        csv: whether ``modal.csv`` has it.
        from_harmonics: whether :class:`nmt_extract.modal.ModalQuantities` has it, which evaluates the whole window
            and each part of it.
        powers: what it is made of, from which follows how far the resolution of the channels moves it; None = it
            does not follow from that.
        second_order: whether the resolution moves it in second order only, as mode indicators near 1.
        axis: label of an axis with it; empty = its name.
        panel: title of its panel in the figure of mode indicators, in matplotlib's notation; empty = it has none.
        curve: label of the ordinate of a figure of its own over modal amplitude, in matplotlib's notation; empty =
            it has none.
        column: how tables show it; None = they do not.
    """

    name: str
    unit: str
    meaning: str
    csv: bool = False
    from_harmonics: bool = True
    powers: Powers | None = None
    second_order: bool = False
    axis: str = ""
    panel: str = ""
    curve: str = ""
    column: TableColumn | None = None

    @property
    def symbol(self) -> str:
        """Plain symbol of the tables, else the name."""
        return self.column.symbol if self.column is not None else self.name


def measured(unit: str, meaning: str, **said: Any) -> Any:
    """Default of the field of a measured quantity, NaN, with what :class:`ModalQuantity` says of it.

    Args:
        unit, meaning, said: attributes of :class:`ModalQuantity`.
    """
    return field(default=math.nan, metadata={_KEY: ModalQuantity("", unit, meaning, **said)})


def quantities_of(record: Any) -> Iterator[ModalQuantity]:
    """The measured quantities of a record in the order of its fields.

    Raises:
        TypeError: the field behind a quantity is not its standard uncertainty.
    """
    for item, following in pairwise(fields(record)):
        if _KEY in item.metadata:
            if following.name != f"{item.name}_std":
                raise TypeError(f"{item.name} is followed by {following.name}; it must be {item.name}_std.")
            yield replace(item.metadata[_KEY], name=item.name)
