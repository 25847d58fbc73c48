"""The score sheet: on the screen, as a page with curves, as a page of the documentation, and as JSON."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from nmt_blind.campaign.score import MethodScore, Scores
from nmt_blind.campaign.statistics import Proportion
from nmt_core.files.whole_file import write_whole
from nmt_report.html_page import render

TARGETS: dict[str, tuple[str, str]] = {
    "detected": ("≥ 95 %", "87 % (LiU-ICE 2025)"),
    "first": ("≥ 88 %", "74 % (known cycle), 66 % (unseen)"),
    "first_three": ("≥ 97 %", "—"),
    "place": ("≥ 88 %", "—"),
    "unknown_area": ("≥ 0.93", "0.92"),
    "unknown_recall": ("≥ 75 %", "—"),
    "ece": ("≤ 0.06", "—"),
    "closed": ("≥ 85 %", "42–63 %"),
    "harm": ("≤ 2 %", "—"),
    "compound": ("≥ 85 %", "—"),
    "false_alarms": ("≤ 1 %", "—"),
    "covered": ("≥ 95 %", "—"),
}
"""Target and best published figure by name."""


def percent(share: Proportion) -> str:
    """A share with its interval and counts."""
    if not share.of:
        return "no case"
    low, high = share.interval
    return f"{100 * share.value:.1f} % ({100 * low:.0f}–{100 * high:.0f} %, {share.hits} of {share.of})"


def number(value: float, digits: int = 3) -> str:
    """A number, or a dash where there is none."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "—"


def figures(scores: Scores) -> list[tuple[str, str, str, str, bool | None]]:
    """Figure, value, target, best published, and whether the target is met (None = no case)."""
    method = scores.method

    def row(
        text: str, name: str, value: str, found: float, good: Callable[[float], bool]
    ) -> tuple[str, str, str, str, bool | None]:
        target, published = TARGETS[name]
        return text, value, target, published, good(found) if math.isfinite(found) else None

    def share(text: str, name: str, found: Proportion, least: float) -> tuple[str, str, str, str, bool | None]:
        return row(text, name, percent(found), found.value, lambda value: value >= least)

    ece = max(scores.width.error, scores.count.error)
    return [
        row("false alarms on null cases", "false_alarms", percent(method.false_alarms), method.false_alarms.value,
            lambda value: value <= 0.01),
        share("detection, effects from 8 σ, frozen verdict", "detected", method.detected, 0.95),
        share("detection, the same, at ≤ 1 % false alarms here", "detected", method.detected_at_rate, 0.95),
        share("right effect first, single effects from 8 σ, class credit", "first", method.first, 0.88),
        share("right effect among the first three", "first_three", method.first_three, 0.97),
        share("right place", "place", scores.place, 0.88),
        row("unknown recognised, area under the ROC", "unknown_area", number(method.unknown_area), method.unknown_area,
            lambda value: value >= 0.93),
        share("unknown recognised at ≤ 5 % wrongly unknown", "unknown_recall", scores.unknown_recall, 0.75),
        row("expected calibration error (equal width / equal count)", "ece",
            f"{number(scores.width.error)} / {number(scores.count.error)}", ece, lambda value: value <= 0.06),
        row(f"held-out gap closed, median of {scores.closed_cases} accepted effects", "closed",
            f"{number(100 * scores.closed, 1)} %", scores.closed, lambda value: value >= 0.85),
        row("held-out gap larger than before, accepted effects (harm)", "harm", percent(scores.harm), scores.harm.value,
            lambda value: value <= 0.02),
        share("two effects, both among the first three", "compound", scores.compound, 0.85),
        share("truth within 3 standard uncertainties, effects named rightly", "covered", scores.covered, 0.95),
    ]  # fmt: skip


def further(scores: Scores) -> list[tuple[str, str]]:
    """Figures without a target."""
    within = scores.within
    return [
        ("detection, effects of 8 to 16 σ only", percent(within.detected)),
        ("the same at ≤ 1 % false alarms here", percent(within.detected_at_rate)),
        ("right effect first / among the first three, 8 to 16 σ only",
         f"{percent(within.first)} / {percent(within.first_three)}"),
        ("unknown recognised, area under the ROC, 8 to 16 σ only", number(within.unknown_area)),
        ("verdict unknown, unnamed effects from 8 σ", percent(scores.verdict_unknown)),
        ("verdict unknown, named effects from 8 σ", percent(scores.wrongly_unknown)),
        ("verdict calibration, null cases with shifted parameters", percent(scores.calibrated)),
        ("verdict none, null cases without", percent(scores.plain_none)),
        ("area under the ROC, gap or none, all strengths", number(scores.method.roc_area)),
        ("computing time of a diagnosis, median", f"{number(scores.seconds, 1)} s"),
        ("cases of which fewer than half of the levels locked", f"{len(scores.stalled)}"),
        ("cases scored / without result / without verdict",
         f"{len(scores.cases)} / {len(scores.missing)} / {len(scores.failed)}"),
    ]  # fmt: skip


def print_scores(scores: Scores) -> list[str]:
    """Lines for the screen."""
    lines = [_heading(scores)]
    for text, value, target, _, met in figures(scores):
        mark = {True: "met", False: "missed", None: "no case"}[met]
        lines.append(f"  {text}: {value}; target {target}: {mark}")
    lines += [f"  {text}: {value}" for text, value in further(scores)]
    lines += [f"  {m.name}: right first {percent(m.first)}, ROC {number(m.roc_area)}" for m in scores.baselines]
    return lines


def write_sheets(scores: Scores, folder: Path, docs: Path | None = None) -> list[Path]:
    """Write score.json, score.md and score.html into a folder, and the page of the documentation if asked for.

    Returns:
        The files.
    """
    values = json.dumps(scores.to_mapping(), indent=1, ensure_ascii=False) + "\n"
    text = markdown(scores)
    files = [folder / "score.json", folder / "score.md", folder / "score.html"]
    for path, content in zip(files, (values, text, page(scores)), strict=True):
        write_whole(path, content)
    if docs is not None:
        docs.parent.mkdir(parents=True, exist_ok=True)
        write_whole(docs, text)
        files.append(docs)
    return files


def markdown(scores: Scores) -> str:
    """The sheet as Markdown."""
    met = {True: "yes", False: "**no**", None: "—"}
    parts = [f"# Blind check of the diagnosis: {scores.rig}", "", _heading(scores), ""]
    parts += _table(("figure", "reached", "target", "best published", "met"),
                    [(a, b, c, d, met[e]) for a, b, c, d, e in figures(scores)])  # fmt: skip
    parts += ["", "In brackets: interval of 95 % after Wilson, and counts.", ""]
    parts += _table(("further figures", ""), further(scores))
    parts += ["", "## Other methods on the same cases", ""]
    parts += _table(
        ("method", "detected from 8 σ", "false alarms", "detected at ≤ 1 %", "right first", "first three", "ROC",
         "unknown"),
        [_method_row(m) for m in (scores.method, *scores.baselines)],
    )  # fmt: skip
    if not scores.training:
        parts += ["", "No classifier was trained (`--train`)."]
    parts += ["", "## By strength", ""]
    parts += _table(
        ("σ", "detected", "right effect first"),
        [(f"{sigma:g}", percent(found), percent(first)) for sigma, (found, first) in scores.by_strength.items()],
    )
    parts += ["", "## By band of strengths", ""]
    parts += _table(
        ("σ", "detected", "right first", "right place", "within 3 σ", "called unknown", "pairs, first three"),
        [
            (f"{b.low:g} to {b.high:g}" if b.high < 1e9 else f"from {b.low:g}",
             *(percent(share) for share in (b.detected, b.first, b.place, b.covered, b.unknown, b.pairs)))
            for b in scores.bands
        ],
    )  # fmt: skip
    parts += ["", "## Unnamed effects by strength", ""]
    parts += _table(("σ", "verdict unknown"), [(f"{s:g}", percent(share)) for s, share in scores.unnamed.items()])
    parts += ["", "## Verdicts by kind of case", ""]
    verdicts = sorted({name for row in scores.by_kind.values() for name in row})
    parts += _table(("kind", *verdicts), [
        (kind, *(str(row.get(name, 0)) for name in verdicts)) for kind, row in sorted(scores.by_kind.items())
    ])  # fmt: skip
    parts += ["", "## Reliability", ""]
    parts += _table(("stated", "right", "cases"), [
        (f"{s:.3f}", f"{r:.3f}", str(n))
        for s, r, n in zip(scores.width.stated, scores.width.right, scores.width.counts, strict=True)
    ])  # fmt: skip
    parts += ["", "## Confusion", "", "Truth, and what was answered how often; null cases and strengths from 8 σ.", ""]
    parts += _table(("truth", "answers"), [
        (row, ", ".join(f"{answer} {count}" for answer, count in sorted(found.items(), key=lambda item: -item[1])))
        for row, found in scores.confusion.items()
    ])  # fmt: skip
    parts += ["", "## Hash trail", "", f"* truth: `{scores.seal}`", f"* bags: `{scores.trail}`"]
    parts += [f"* program that diagnosed them: `{scores.frozen or 'not noted'}`", ""]
    return "\n".join(parts)


def _heading(scores: Scores) -> str:
    opened = f" The seal was opened {scores.openings} times: this is not a first look." if scores.openings > 1 else ""
    kind = "sealed" if scores.purpose == "sealed" else "development (not sealed)"
    return f"{len(scores.cases)} cases of the rig {scores.rig}, {kind}.{opened}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    return lines + [f"| {' | '.join(str(cell).replace('|', chr(92) + '|') for cell in row)} |" for row in rows]


def _method_row(m: MethodScore) -> tuple[str, ...]:
    return (
        m.name, percent(m.detected), percent(m.false_alarms), percent(m.detected_at_rate), percent(m.first),
        percent(m.first_three), number(m.roc_area), number(m.unknown_area),
    )  # fmt: skip


# The page --------------------------------------------------------------------------------------------------------


def page(scores: Scores) -> str:
    """The sheet as one HTML file with its curves."""
    blocks = [_block(block.strip().split("\n"), scores) for block in markdown(scores).split("\n\n") if block.strip()]
    return render("score_sheet.html", title=f"Blind check: {scores.rig}", blocks=blocks)


def _block(lines: list[str], scores: Scores) -> dict[str, Any]:
    """One paragraph of the Markdown page for the template."""
    first = lines[0]
    if first.startswith("# "):
        return {"kind": "heading", "level": 1, "text": _inline(first[2:]), "figure": ""}
    if first.startswith("## "):
        return {"kind": "heading", "level": 2, "text": _inline(first[3:]), "figure": _figure(first[3:], scores)}
    if first.startswith("|"):
        head, _, *rows = ([_inline(cell.strip()) for cell in line.strip("|").split("|")] for line in lines)
        return {"kind": "table", "head": head, "rows": rows}
    if first.startswith("* "):
        return {"kind": "list", "lines": [_inline(line[2:]) for line in lines]}
    return {"kind": "text", "text": _inline(" ".join(lines))}


def _inline(text: str) -> Markup:
    marked = escape(text)
    for mark, tag in (("**", "b"), ("`", "code")):
        pieces = marked.split(mark)
        tagged = (p if i % 2 == 0 else Markup(f"<{tag}>{{}}</{tag}>").format(p) for i, p in enumerate(pieces))
        marked = Markup("").join(tagged)
    return marked


def _figure(heading: str, scores: Scores) -> Markup:
    drawn = {"By strength": _strength_figure, "Reliability": _reliability_figure, "Confusion": _confusion_figure,
             "Other methods on the same cases": _roc_figure}.get(heading)  # fmt: skip
    return drawn(scores) if drawn is not None else Markup("")


def _axes(width: float = 6.4, height: float = 3.8) -> tuple[Any, Any]:
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasSVG(figure)
    axes = figure.add_subplot()
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure, axes


def _svg(figure: Any) -> Markup:
    target = io.StringIO()
    figure.savefig(target, format="svg", metadata={"Date": None})
    text = target.getvalue()
    return Markup(text[text.index("<svg") :])


def _strength_figure(scores: Scores) -> Markup:
    figure, axes = _axes()
    for which, (name, colour) in enumerate((("detected", "#1b6ca8"), ("right effect first", "#c2571a"))):
        shares = {sigma: pair[which] for sigma, pair in scores.by_strength.items() if pair[which].of}
        values = [share.value for share in shares.values()]
        errors = [[max(0.0, s.value - s.interval[0]) for s in shares.values()],
                  [max(0.0, s.interval[1] - s.value) for s in shares.values()]]  # fmt: skip
        axes.errorbar(list(shares), values, yerr=errors, marker="o", capsize=3, label=name, color=colour)
    axes.set(xscale="log", xlabel="strength, σ after calibration", ylabel="share of single effects", ylim=(-0.03, 1.05))
    axes.set_xticks(list(scores.by_strength), [f"{sigma:g}" for sigma in scores.by_strength])
    axes.minorticks_off()
    axes.legend(frameon=False)
    return _svg(figure)


def _reliability_figure(scores: Scores) -> Markup:
    figure, axes = _axes(4.4, 4.0)
    axes.plot((0, 1), (0, 1), color="#9aa4b0", linewidth=1)
    for name, found, marker in (("equal width", scores.width, "o"), ("equal count", scores.count, "s")):
        axes.plot(found.stated, found.right, marker=marker, linestyle="-", label=f"{name}, ECE {found.error:.3f}")
    axes.set(xlabel="stated probability", ylabel="share right", xlim=(0, 1.02), ylim=(0, 1.02), aspect="equal")
    axes.legend(frameon=False, loc="upper left")
    return _svg(figure)


def _roc_figure(scores: Scores) -> Markup:
    figure, axes = _axes(4.8, 3.6)
    axes.step(*scores.roc, where="post", color="#1b6ca8", label="diagnosis, effects from 8 σ")
    alarms, found = scores.method.false_alarms, scores.method.detected
    if alarms.of and found.of:
        axes.plot([alarms.value], [found.value], "o", color="#c2571a", label="frozen verdict")
    axes.set(xlabel="false alarms", ylabel="detected", xlim=(-0.02, 1.02), ylim=(-0.02, 1.04))
    axes.legend(frameon=False, loc="lower right")
    return _svg(figure)


def _confusion_figure(scores: Scores) -> Markup:
    rows = list(scores.confusion)
    columns = sorted({answer for found in scores.confusion.values() for answer in found},
                     key=lambda name: (name not in ("none", "unknown"), name))  # fmt: skip
    if not rows:
        return Markup("")
    figure, axes = _axes(3.2 + 0.26 * len(columns), 1.6 + 0.24 * len(rows))
    grid = [[scores.confusion[row].get(column, 0) for column in columns] for row in rows]
    axes.imshow(grid, cmap="Blues", aspect="auto")
    for i, row in enumerate(grid):
        for j, count in enumerate(row):
            if count:
                dark = count > 0.6 * max(map(max, grid))
                axes.text(j, i, str(count), ha="center", va="center", fontsize=7, color="white" if dark else "black")
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right", fontsize=7)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.set(xlabel="answer", ylabel="truth")
    return _svg(figure)
