"""A self-contained page for frequency responses, in the look of the run's report."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from nmt_report.html_page import PageColumn, Row, Table, part, render
from nmt_report.svg import ReportFigure

_WORD = re.compile(r"(?!nan|inf)[A-Za-z]{3}")
_LONG = 40  # characters; longer texts are wrapped


@dataclass(frozen=True)
class ResponsePage:
    """What a page shows. Text is plain and is escaped; markup is kept.

    Attributes:
        kicker: kind of report.
        heading: main heading.
        subtitle: one line.
        verdict: one sentence and its class: ``good``, ``partly`` or ``bad``.
        sections: (anchor, heading, content as markup); those without content are left out.
        cards: (label, value, note).
        facts: (name, value); those without a value are left out.
        notices: sentences on what is missing or wrong.
        footer: last line.
        answers: (question, sentence) below the verdict.
        notes: sentences on the recordings that do not bear on the answer.
    """

    kicker: str
    heading: str
    subtitle: str
    verdict: tuple[str, str]
    sections: Sequence[tuple[str, str, Markup]] = ()
    cards: Sequence[tuple[str, str, str]] = ()
    facts: Sequence[tuple[str, str]] = ()
    notices: Sequence[str] = ()
    footer: str = "SI units."
    answers: Sequence[tuple[str, str]] = ()
    notes: Sequence[str] = ()

    def html(self, template: str = "response_report.html", **values: Any) -> str:
        """The whole page; the same text for the same content.

        Args:
            template: a template that extends ``response_report.html``.
            values: what that template needs besides.
        """
        title = f"{self.heading}: {self.kicker.lower()}"
        return render(template, title=title, page=self, sections=self.sections, **values)


def text_table(head: Sequence[tuple[str, str]], rows: Sequence[Sequence[str]], note: str = "") -> Table:
    """A table whose first column is text, as is every other one with words in it.

    Args:
        head: (heading, unit) of each column.
        rows: cells.
        note: sentence below it.
    """
    cells = [[str(row[k]) for row in rows if k < len(row)] for k in range(len(head))]
    long = [any(len(cell) > _LONG for cell in column) for column in cells]
    text = [not k or any(_WORD.search(cell) for cell in column) for k, column in enumerate(cells)]
    kinds = [("text wrap" if wide else "text") if words else "" for wide, words in zip(long, text, strict=True)]
    columns = [PageColumn(name, unit, kind) for (name, unit), kind in zip(head, kinds, strict=True)]
    return Table(columns, [Row(row) for row in rows], note)


def html_table(head: Sequence[tuple[str, str]], rows: Sequence[Sequence[str]], note: str = "") -> Markup:
    """:func:`text_table` as markup."""
    return part("table", text_table(head, rows, note))


def html_figures(figures: Sequence[ReportFigure]) -> Markup:
    """Figures of a section as markup; empty where there are none."""
    return part("figures", figures)
