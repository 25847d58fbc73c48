"""Pages from templates: what tables and sections hold, and the environment that escapes all text put into a page.

Text given to a page is plain and is escaped. HTML of our own (a figure, a symbol with an index) is a
:class:`markupsafe.Markup`; whoever makes one from text with :meth:`~markupsafe.Markup.format` has that text escaped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from nmt_record.bag.bag_keys import SIMULATED_RIG


@dataclass(frozen=True)
class PageColumn:
    """A column of a table.

    Attributes:
        heading: above it.
        unit: below the heading.
        kind: classes of its cells: empty for numbers, ``text``, ``text wrap`` or ``text mono``.
    """

    heading: str
    unit: str = ""
    kind: str = ""


@dataclass(frozen=True)
class Row:
    """A row of a table.

    Attributes:
        cells: from the left; fewer than columns where ``reason`` takes the rest.
        failed: whether to mark it.
        reason: why there are no values, across the columns that ``cells`` leave.
    """

    cells: Sequence[object]
    failed: bool = False
    reason: str = ""


@dataclass(frozen=True)
class Table:
    """A table with a sentence below it.

    Attributes:
        columns: from the left.
        rows: from the top.
        note: below the table; empty for none.
        heading: above it; empty for none.
    """

    columns: Sequence[PageColumn]
    rows: Sequence[Row]
    note: str = ""
    heading: str = ""


def subtitle(run: Mapping[str, Any], description: str) -> str:
    """What stands below a rig's name: its description, and that it is simulated where the run says so.

    Args:
        run: start record of a recording.
        description: of the rig; may be empty.
    """
    if run.get("device") != SIMULATED_RIG:
        return description
    return f"Simulated rig: {description}" if description else "Simulated rig"


def render(template: str, **values: Any) -> str:
    """A page from a template of this package.

    Args:
        template: file in ``templates``.
        values: its variables; a missing one raises.
    """
    return _environment().get_template(template).render(**values)


def part(name: str, *values: Any) -> Markup:
    """A macro of ``templates/parts.html`` on its own, for example ``part("table", table)``."""
    macro = getattr(_environment().get_template("parts.html").module, name)
    return Markup(macro(*values))


@cache
def _environment() -> Environment:
    loader = PackageLoader("nmt_report", "templates")
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    # Style and script are no templates: their braces are their own.
    environment.globals["source"] = lambda name: Markup(loader.get_source(environment, name)[0])
    return environment
