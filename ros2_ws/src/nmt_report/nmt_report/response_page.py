"""A self-contained page for frequency responses, in the look of the run's report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files

from nmt_report.svg import ReportFigure


@dataclass(frozen=True)
class ResponsePage:
    """What a page shows.

    Attributes:
        kicker: kind of report.
        heading: main heading.
        subtitle: one line.
        verdict: one sentence and its class: ``good``, ``partly`` or ``bad``.
        cards: (label, value, note).
        facts: (name, value).
        sections: (anchor, heading, HTML).
        notices: sentences on what is missing or wrong.
        footer: HTML.
        answers: (question, sentence) below the verdict.
    """

    kicker: str
    heading: str
    subtitle: str
    verdict: tuple[str, str]
    sections: Sequence[tuple[str, str, str]]
    cards: Sequence[tuple[str, str, str]] = ()
    facts: Sequence[tuple[str, str]] = ()
    notices: Sequence[str] = ()
    footer: str = field(default="SI units.")
    answers: Sequence[tuple[str, str]] = ()

    def html(self) -> str:
        """The whole page; the same text for the same content."""
        policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
        present = [section for section in self.sections if section[2]]
        body = "".join(f'<section id="{key}"><h2>{escape(name)}</h2>{html}</section>\n' for key, name, html in present)
        links = "\n".join(f'<a href="#{key}">{escape(name)}</a>' for key, name, _ in present)
        text, kind = self.verdict
        cards = "".join(
            f'<div class="card"><div class="label">{escape(label)}</div><div class="value">{escape(value)}</div>'
            f'<div class="note">{escape(note)}</div></div>'
            for label, value, note in self.cards
        )
        facts = "".join(
            f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in self.facts if value
        )
        answers = "".join(
            f"<div><dt>{escape(question)}</dt><dd>{escape(sentence)}</dd></div>" for question, sentence in self.answers
        )
        notices = "".join(f'<p class="notice">{escape(text)}</p>' for text in self.notices)
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{escape(self.heading)}: {escape(self.kicker.lower())}</title>\n"
            f"<style>\n{_template('report.css')}</style>\n</head>\n<body>\n<main>\n"
            f'<header>\n<p class="kicker">{escape(self.kicker)}</p>\n<h1>{escape(self.heading)}</h1>\n'
            f'<p class="subtitle">{escape(self.subtitle)}</p>'
            f'<p class="verdict {kind}">{escape(text)}</p>\n'
            + (f'<dl class="answers">{answers}</dl>\n' if answers else "")
            + notices
            + (f'<div class="cards">{cards}</div>\n' if cards else "")
            + (f'<dl class="facts">{facts}</dl>\n' if facts else "")
            + f"<nav>{links}</nav>\n</header>\n{body}<footer>{self.footer}</footer>\n</main>\n"
            "<dialog><p><button>Close</button>Wheel: zoom. Drag: move. Double click: whole figure.</p><div></div>"
            f"</dialog>\n<script>\n{_template('report.js')}</script>\n</body>\n</html>\n"
        )


def html_table(head: Sequence[tuple[str, str]], rows: Sequence[Sequence[str]], note: str = "") -> str:
    """A table.

    Args:
        head: (heading, unit) of each column; HTML.
        rows: cells as HTML; the first of each row is set as text.
        note: sentence of HTML below it.
    """
    cells = "".join(
        f'<th{" class=text" if k == 0 else ""}>{name}<span class="unit">{unit}</span></th>'
        for k, (name, unit) in enumerate(head)
    )
    body = "".join(
        "<tr>" + "".join(f"<td{' class=text' if k == 0 else ''}>{cell}</td>" for k, cell in enumerate(row)) + "</tr>"
        for row in rows
    )
    return f'<div class="scroll"><table><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table></div>' + (
        f'<p class="note">{note}</p>' if note else ""
    )


def html_figures(figures: Sequence[ReportFigure]) -> str:
    """Figures of a section."""
    items = "".join(
        f'<figure id="{figure.name}"{" class=wide" if figure.wide else ""}><h3>{escape(figure.title)}</h3>{figure.svg}'
        f"<figcaption>{figure.caption}</figcaption></figure>\n"
        for figure in figures
    )
    return f'<div class="figures">{items}</div>' if items else ""


def _template(name: str) -> str:
    return files("nmt_report").joinpath("templates", name).read_text(encoding="utf-8")
