"""Tables of a diagnosis for the terminal."""

from __future__ import annotations

import math

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from nmt_core.text.number_words import percent, value_text
from nmt_diagnose.ledger.diagnosis import NULL, UNKNOWN, Diagnosis, Verdict
from nmt_diagnose.say.words import (
    class_text,
    effect_text,
    is_partial,
    is_within_first,
    parameters_text,
    place_text,
    probability_text,
    rest_text,
    sigma_text,
    smallest_text,
)
from nmt_report.quantity_format import plain

_BAR = 16
_RANKED = 5
_MOVED = 2.0
_LEAST = 0.005


def bar(share: float, width: int = _BAR) -> str:
    """A bar of blocks for a share of one."""
    eighths = round(8 * width * min(1.0, max(0.0, share))) if math.isfinite(share) else 0
    full, rest = divmod(eighths, 8)
    return "█" * full + ("▏▎▍▌▋▊▉"[rest - 1] if rest else "")


def ranking_table(diagnosis: Diagnosis) -> Table | None:
    """Explanations with their probability, most probable first; None without a gap."""
    if not diagnosis.ranking:
        return None
    table = _new("Explanations")
    partial = is_partial(diagnosis)
    table.add_column("among the library" if partial else "probability", no_wrap=True, min_width=_BAR)
    table.add_column("", justify="right", no_wrap=True)
    table.add_column("explanation", overflow="fold")
    table.add_column("place", overflow="fold")
    table.add_column("parameters (± standard uncertainty)", overflow="fold")
    table.add_column("gap closed", justify="right", no_wrap=True)
    rows, within = [], []
    for item in diagnosis.ranking:
        name = class_text(item)
        place, parameters = place_text(item.place, item.detail), parameters_text(item.parameters)
        cells = (name, place, parameters, percent(item.closed.value))
        if is_within_first(diagnosis, item):
            within.append(cells)
        else:
            rows.append((item.probability, cells))
    if not partial:
        rows.append((diagnosis.probabilities.get(NULL, 0.0), (effect_text(NULL), "", "", "")))
        text, p = rest_text(diagnosis)
        rows.append((p, (text, "", "", "")))
    rows.sort(key=lambda row: -row[0])
    shown = [row for number, row in enumerate(rows) if number < 2 or row[0] >= _LEAST]
    shown = shown[:_RANKED]
    left = 1.0 - sum(p for p, _ in shown)
    if left > _LEAST:
        shown.append((left, ("all other explanations", "", "", "")))
    for p, cells in shown:
        table.add_row(Text(bar(p), style="blue"), probability_text(p), *map(Text, cells))
    for cells in within:
        table.add_row("within the first", "", *map(Text, cells))
    if partial:
        table.add_row("", "", Text(f"{effect_text(UNKNOWN)} acts, too"), "", "", "")
    return table


def place_table(diagnosis: Diagnosis) -> Table | None:
    """Places with their probability; None without a gap."""
    if not diagnosis.where:
        return None
    table = _new("Places")
    table.add_column("probability", no_wrap=True, min_width=_BAR)
    table.add_column("", justify="right", no_wrap=True)
    table.add_column("place")
    for item in diagnosis.where[:_RANKED]:
        table.add_row(
            Text(bar(item.p), style="blue"), probability_text(item.p), Text(place_text(item.place, item.detail))
        )
    return table


def calibration_table(diagnosis: Diagnosis, every: bool = False) -> Table | None:
    """Parameters of the model that moved by more than twice their uncertainty, the surest few or ``every`` one."""
    moved = [item for item in diagnosis.calibration if abs(item.sigmas) > _MOVED]
    if not moved or diagnosis.verdict is Verdict.NONE:
        return None
    moved = sorted(moved, key=lambda item: -abs(item.sigmas))[: None if every else _RANKED]
    table = _new("Parameters of the model that moved (the others are in the report)")
    table.add_column("key")
    table.add_column("from", justify="right", no_wrap=True)
    table.add_column("to", justify="right", no_wrap=True)
    table.add_column("change\n%", justify="right", no_wrap=True)
    for item in moved:
        change = 100.0 * (item.to / item.start - 1.0) if item.start else math.nan
        table.add_row(
            Text(item.name), value_text(item.start, math.nan, item.unit), value_text(item.to, item.std, item.unit),
            plain(change, 2),
        )  # fmt: skip
    return table


def next_table(diagnosis: Diagnosis) -> Table | None:
    """Tests that would tell more, with their commands."""
    if not diagnosis.next_test:
        return None
    table = _new("Tests that would tell more")
    table.add_column("test", overflow="fold")
    table.add_column("distinguishes", overflow="fold")
    table.add_column("expected\nstd. dev.", justify="right", no_wrap=True)
    if any(item.command for item in diagnosis.next_test):
        table.add_column("command", overflow="fold")
    for item in diagnosis.next_test:
        names = ", ".join(effect_text(name) for name in item.separates)
        cells = Text(item.test), Text(names), sigma_text(item.expected_sigma), Text(item.command)
        table.add_row(*cells[: len(table.columns)])
    return table


def recordings_table(diagnosis: Diagnosis) -> Table | None:
    """The recordings, and what made each."""
    bags = [bag for bag in diagnosis.inputs.get("bags", ()) if "origin" in bag]
    if not bags:
        return None
    table = _new("Recordings")
    table.add_column("recording", overflow="fold")
    table.add_column("what made it", overflow="fold")
    for bag in bags:
        table.add_row(Text(str(bag["path"])), Text(str(bag["origin"]["text"])))
    return table


def visible_table(diagnosis: Diagnosis) -> Table | None:
    """The weakest that each effect could be and still be seen."""
    if not diagnosis.visible:
        return None
    table = _new("Smallest effects that these recordings would show")
    for head in ("effect", "where it would show first", "smallest size"):
        table.add_column(head, overflow="fold")
    for item in diagnosis.visible:
        table.add_row(
            Text(effect_text(item.effect)), Text(place_text(item.place, item.detail)),
            Text(smallest_text(item.parameters)),
        )  # fmt: skip
    return table


def visible_sentence(diagnosis: Diagnosis) -> str:
    """How many effects these recordings would show, with the first as an example."""
    item, count = diagnosis.visible[0], len(diagnosis.visible)
    example = f"{effect_text(item.effect)} from {smallest_text(item.parameters)}"
    return (
        f"These recordings would show {count} effect{'s' * (count > 1)}, such as {example} at "
        f"{place_text(item.place, item.detail)}; the report and --verbose list the smallest of each."
    )


def _new(title: str) -> Table:
    return Table(
        title=title, title_justify="left", title_style="bold", header_style="bold", box=SIMPLE_HEAD, pad_edge=False
    )
