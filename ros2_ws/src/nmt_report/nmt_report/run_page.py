"""The report's page: facts, tables and figures put together to one self-contained HTML file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from nmt_core.text.number_words import level_list
from nmt_core.vocabulary import ControlKind, PointStatus
from nmt_extract.curves.backbone_jumps import direction_difference, find_jumps
from nmt_extract.curves.limit_cycles import feeds_its_motion, limit_cycles
from nmt_extract.curves.response_curve import is_of_curve
from nmt_extract.judgement.uncertainty_budget import UncertaintySource, channel_tolerances_used, left_out
from nmt_extract.modal.harmonics_indicators import any_control, indicators
from nmt_extract.modal.mode_identity import mode_verdict
from nmt_plant.real_time import read_histogram
from nmt_report.columns import shown_columns, status_text, unit_text
from nmt_report.exciter_table import exciter_fact, exciter_table
from nmt_report.html_page import PageColumn, Row, Table, render, subtitle
from nmt_report.quantity_format import (
    duration,
    engineering_exponent,
    file_size,
    plain,
    power_of_ten,
    significant,
)
from nmt_report.run_data import RunReportData
from nmt_report.run_verdict import level_sentences, run_verdict
from nmt_report.stated_uncertainty import std_note
from nmt_report.svg import ReportFigure


def page(data: RunReportData, figures: Mapping[str, Sequence[ReportFigure]]) -> str:
    """The whole HTML page.

    Args:
        data: the run.
        figures: figures by section: ``first``, ``modal``, ``shape`` and ``run``.
    """
    description = data.rig.get("description", "")
    return render(
        "run_report.html",
        title=f"{run_name(data)}: nonlinear modal test",
        name=run_name(data),
        description=subtitle(data.run, str(description or "")),
        result=run_verdict(data.points, len(data.run.get("plan", {}).get("levels", ())), data.linear),
        faults=_faults(data),
        remarks=_remarks(data),
        shown_cards=_cards(data),
        facts=_facts(data),
        modal_table=_modal_table(data),
        first_figures=figures.get("first", ()),
        modal_figures=figures.get("modal", ()),
        shape_figures=figures.get("shape", ()),
        run_figures=figures.get("run", ()),
        harmonics_table=harmonics_table(data),
        exciter_table=exciter_table(data),
        harmonics_notes=harmonics_notes(data),
        level_table=_level_table(data),
        block_reason=_block_reason(data),
        std_note=std_note(data.budgets),
        budget_tables=_budget_tables(data),
        budget_notes=_budget_notes(data),
        assumptions=_assumptions(data),
        real_time_facts=_real_time_facts(data),
        lateness_table=_lateness_table(data),
        file_table=_file_table(data),
        settings=_settings(data),
    )


def run_name(data: RunReportData) -> str:
    """Name of the rig, else of the run."""
    return str(data.rig.get("name") or data.run.get("rig") or data.run.get("run_id") or "Run")


def worst_deviation(data: RunReportData) -> tuple[float, float]:
    """Largest relative deviation of ω̃ and of δ̃ from the reference; NaN without a reference.

    Of a structure that feeds its motion the deviation of δ̃ itself.
    """
    if data.reference is None:
        return math.nan, math.nan
    worst = [math.nan, math.nan]
    controlled = any_control(data.points)
    feeds = feeds_its_motion(data.points)
    for point in data.good_points:
        if controlled and not point.harmonics_control:
            continue  # a level for comparison
        expected = data.reference.at(point.modal_amplitude)
        for index, value in enumerate((point.omega_rad_s, point.damping_ratio)):
            deviation = value - expected[1] if feeds and index == 1 else value / expected[index] - 1.0
            if not abs(deviation) <= abs(worst[index]) and not math.isnan(deviation):
                worst[index] = deviation
    return worst[0], worst[1]


_CONTROLS: dict[Any, str] = {kind.value: kind.label for kind in ControlKind if kind is not ControlKind.UNKNOWN}


def _faults(data: RunReportData) -> list[str]:
    """Sentences on what is missing, the most important first."""
    faults = []
    state, reason = _end_of_run(data)
    if state not in ("", "done") and reason:
        faults.append(f"End of the run: {reason}")
    if data.loss:
        faults.append(data.loss)
    if data.not_live:
        faults.append(
            f"Extraction sent no point of {level_list(data.not_live)} while the test ran ({len(data.not_live)} of "
            f"{len(data.locks)} locked): they were extracted from the recording."
        )
    return faults + level_sentences(data.failed_points)


def _remarks(data: RunReportData) -> list[str]:
    """Sentences on what is there and needs a second look."""
    modes = "" if data.linear is None else mode_verdict(data.points, data.linear)
    remarks = [*filter(None, [modes]), *(jump.sentence for jump in find_jumps(data.points))]
    directions = direction_difference(data.points)
    if directions is not None and directions.different:
        remarks.append(directions.sentence)
    return remarks + level_sentences([point for point in data.good_points if point.reason])


def _cards(data: RunReportData) -> list[tuple[str, str, str]]:
    """Label, value and note of each."""
    points = data.good_points
    if not points:
        return []

    def span(values: Sequence[float], digits: int = 4) -> str:
        low, high = significant(min(values), digits), significant(max(values), digits)
        return low if low == high else f"{low} … {high}"

    frequencies = [point.frequency_hz for point in points]
    lowest, highest = (pick(points, key=lambda point: point.modal_amplitude) for pick in (min, max))
    exponent = engineering_exponent(point.modal_amplitude for point in points)
    cards: list[tuple[str, str, str]] = [
        (
            "Modal frequency f̃",
            f"{span(frequencies)} Hz",
            f"{_percent(highest.frequency_hz / lowest.frequency_hz - 1.0)} from the smallest to the largest amplitude",
        ),
        *(
            []
            if is_of_curve(points)
            else [("Modal damping δ̃", f"{span([100 * p.damping_ratio for p in points], 3)} %", "")]
        ),
        (
            Markup("Modal amplitude <i>q</i>"),
            f"({span([p.modal_amplitude / 10**exponent for p in points], 3)}) {power_of_ten(exponent)} m√kg",
            f"force {span([p.force_n for p in points], 3)} N",
        ),
    ]
    if data.reference is not None:
        omega, damping = worst_deviation(data)
        unit = " points" if feeds_its_motion(points) else ""
        sizes = f"f̃ {_percent(omega)}, δ̃ {_percent(damping)}{unit}"
        cards.append(("Largest deviation from the computed mode", sizes, data.reference.label))
        cards += [
            (
                "Stable limit cycle" if cycle.stable else "Unstable limit cycle",
                f"{significant(cycle.omega_rad_s / (2.0 * math.pi), 6)} Hz",
                f"q = {significant(cycle.modal_amplitude)} m√kg",
            )
            for cycle in limit_cycles(points)
        ]
    else:
        # In a secondary resonance the power enters in another order than the one in resonance.
        name = "mac" if is_of_curve(points) or any(point.force_order for point in points) else "pbmif"
        cards.append((f"{name.upper()}, worst level", significant(min(getattr(p, name) for p in points), 4), ""))
    directions = direction_difference(data.points)
    if directions is not None:
        alike = directions.levels - len(directions.different)
        agreement = f"{alike} of {directions.levels} levels agree"
        cards.append(("Up and down", agreement, f"f̃ within {significant(100.0 * directions.largest, 2)} %"))
    return cards


def _resonance(plan: Mapping[str, Any]) -> str | None:
    """Which secondary resonance was held; None for phase resonance."""
    k, nu = plan.get("response_order"), plan.get("force_order")
    if not k or not nu:
        return None
    words = f"{k}:{nu}, {'superharmonic' if k > nu else 'subharmonic'}: values of order {k} of the response"
    release = plan.get("release")
    return f"{words}, released at {significant(release)} in the unit of the response" if release else words


def _facts(data: RunReportData) -> list[tuple[str, str]]:
    run, plan, linear = data.run, data.run.get("plan", {}), data.linear
    facts: list[tuple[str, Any]] = [
        ("Run", run.get("run_id")),
        ("Started", str(run.get("started", "")).replace("T", " ")),
        ("Rig", run.get("rig")),
        *([] if linear is None else [exciter_fact(linear)]),
        (
            "Target mode",
            f"{linear.target_mode + 1} (linear: {linear.frequency_hz:.3f} Hz, "
            f"{100 * linear.damping_ratios[linear.target_mode]:.2f} %, "
            f"from {'the model' if linear.source == 'model' else 'a linear test'})"
            if linear is not None
            else None,
        ),
        ("Resonance", _resonance(plan)),
        ("Level control", _CONTROLS.get(plan.get("control"), plan.get("control"))),
        ("Window", f"{plan['window_periods']} periods" if plan.get("window_periods") else None),
        ("Sampling", f"{significant(data.sample_rate, 6)} Hz"),
        ("Block length", _block_length(data)),
        ("Bench time", duration(data.end_sample / data.sample_rate) if data.end_sample else None),
        ("Seed", run.get("seed")),
        ("End of run", ": ".join(filter(None, _end_of_run(data)))),
        ("Versions", ", ".join(f"{name} {value}" for name, value in run.get("versions", {}).items())),
    ]
    return [(name, str(value)) for name, value in facts if value not in (None, "")]


def _block_length(data: RunReportData) -> str:
    """Samples and duration of a block; empty if the bag does not say."""
    block = data.run.get("block")
    if not isinstance(block, Mapping) or not block.get("samples"):
        return ""
    samples = int(block["samples"])
    text = f"{samples} samples ({significant(1e3 * samples / data.sample_rate, 3)} ms)"
    return f"{text}, chosen by the program" if _block_reason(data) else text


def _block_reason(data: RunReportData) -> str:
    """Why blocks are as long as they are, where that was chosen; empty elsewhere."""
    block = data.run.get("block")
    return str(block.get("reason") or "") if isinstance(block, Mapping) else ""


def _modal_table(data: RunReportData) -> Table | None:
    if not data.points:
        return None
    points, columns = data.good_points, shown_columns(data.good_points)
    exponents = {column.name: column.exponent(points) for column in columns}
    head = [PageColumn("Level", unit_text(data.points[0].level_unit))]
    head += [PageColumn(column.heading, column.unit(exponents[column.name]) or "1") for column in columns]
    if data.reference is not None:
        head += [PageColumn("Δf̃", "%"), PageColumn("Δδ̃", "points" if feeds_its_motion(points) else "%")]
    rows = []
    for point in data.points:
        cells: list[str] = [significant(point.level)]
        if point.status != PointStatus.OK:
            reason = status_text(point.status) + (f": {point.reason}" if point.reason else "")
            rows.append(Row(cells, failed=True, reason=reason))
            continue
        for column in columns:
            value, _, std = column.cell(point, exponents[column.name]).partition(" ± ")
            # The template's macro, written out: a page of a thousand levels has ten thousand of these cells.
            cells.append(Markup("{} <i>± {}</i>").format(value, std) if std else value)
        if data.reference is not None:
            expected = data.reference.at(point.modal_amplitude)
            cells.append(plain(100 * (point.omega_rad_s / expected[0] - 1), 4))
            feeds = feeds_its_motion(points)
            deviation = point.damping_ratio - expected[1] if feeds else point.damping_ratio / expected[1] - 1
            cells.append(plain(100 * deviation, 3 if feeds else 2))
        rows.append(Row(cells))
    note = std_note(data.budgets)
    if data.reference is not None:
        note += f" Δf̃, Δδ̃: deviation from {data.reference.label} at the same modal amplitude."
        if _is_own_deviation(data):
            note += (
                " ± contains the error of single-point excitation, which was taken from these deviations: it does not "
                "judge them."
            )
    note += f" Level: amplitude (peak value) of the {_LEVEL_WORDS.get(data.points[0].level_unit, 'response')}."
    return Table(head, rows, note)


def _is_own_deviation(data: RunReportData) -> bool:
    """Whether the budget took the error of the method from the deviations of this run, not from another run."""
    by_level = {point.level_index: point.budgets.get("omega_rad_s") for point in data.budgets}
    compared = False
    for point in data.good_points:
        budget = by_level.get(point.level_index)
        expected = math.nan if data.reference is None else data.reference.at(point.modal_amplitude)[0]
        part = 0.0 if budget is None else budget.parts.get(UncertaintySource.METHOD, 0.0)
        if part > 0.0 and math.isfinite(expected):
            if not math.isclose(part / point.omega_rad_s, abs(point.omega_rad_s / expected - 1.0), rel_tol=0.01):
                return False
            compared = True
    return compared


_LEVEL_WORDS = {"V": "drive voltage", "N": "force"}


_BUDGET_SYMBOLS = {"omega_rad_s": "f̃", "damping_ratio": "δ̃", "modal_amplitude": "q", "force_n": "F₁"}


def _budget_tables(data: RunReportData) -> list[Table]:
    """Standard uncertainties by source, relative to the value, for each quantity."""
    tables = []
    unit = unit_text(data.points[0].level_unit) if data.points else ""
    for name, symbol in _BUDGET_SYMBOLS.items():
        budgets = [(point.level, point.budgets[name]) for point in data.budgets if name in point.budgets]
        sources = [s for s in UncertaintySource if any(budget.parts.get(s, 0.0) > 0.0 for _, budget in budgets)]
        if not sources:
            continue
        columns = [PageColumn("Level", unit), *(PageColumn(source.value, "%") for source in sources)]
        columns += [
            PageColumn("repeatability", "%"),
            PageColumn("total", "%"),
            PageColumn("k"),
            PageColumn("95 % interval", "± %"),
        ]
        rows = []
        for level, budget in budgets:
            shares = [budget.parts.get(source, math.nan) for source in sources]
            cells = [_relative(value, budget.value) for value in (*shares, budget.repeatability, budget.total)]
            cells += [plain(budget.coverage_factor, 2), _relative(budget.expanded, budget.value)]
            rows.append(Row([significant(level), *cells]))
        tables.append(Table(columns, rows, heading=f"Uncertainty of {symbol}"))
    return tables


def _relative(std: float, value: float) -> str:
    return significant(100.0 * std / abs(value), 2) if math.isfinite(std) and value else "—"


def _budget_notes(data: RunReportData) -> list[str]:
    """What the budget took for the channels, and what it does not know."""
    if data.budget_inputs is None or not data.budgets:
        return []
    notes = []
    for channel, gain, phase, source in channel_tolerances_used(data.budget_inputs):
        if gain or phase:
            turned = significant(math.degrees(phase), 2)
            notes.append(f"{channel}: gain ± {significant(100 * gain, 2)} %, phase ± {turned}° ({source}).")
    if data.budget_inputs.method is not None:
        notes.append(
            "Single-point excitation: deviation of a simulated run from the computed mode at the same modal amplitude, "
            "not corrected. The run is this one, or that of --model-run."
        )
    return [*notes, *left_out(data.budget_inputs)]


_LEVEL_COLUMNS = (
    PageColumn("Level", kind="text"),
    PageColumn("Target"),
    PageColumn("Start", "s"),
    PageColumn("Time to lock", "s"),
    PageColumn("Window", "periods"),
    PageColumn("Window", "s"),
    PageColumn("Whole level", "s"),
    PageColumn("Result", kind="text wrap"),
)


def _level_table(data: RunReportData) -> Table | None:
    """When each level started, locked and was captured, in bench time."""
    if not data.levels:
        return None
    locks = {lock.level_index: lock for lock in data.locks}
    steps = [step for step in data.levels if step.amplitude > 0.0]
    ends = [step.sample for step in data.levels[1:]] + [data.end_sample]
    after = {id(step): end for step, end in zip(data.levels, ends, strict=True)}
    points = {point.level_index: point for point in data.points}
    rate = data.sample_rate
    rows = []
    for step in steps:
        lock, point = locks.get(step.index), points.get(step.index)
        unit = unit_text(lock.level_unit) if lock else unit_text(point.level_unit) if point else ""
        cells = [
            step.index + 1,
            f"{significant(step.amplitude)} {unit}",
            plain(step.sample / rate, 2),
            plain((lock.sample - step.sample) / rate, 2) if lock else "—",
            lock.window_periods if lock else "—",
            plain(lock.window_samples / rate, 2) if lock else "—",
            plain((after[id(step)] - step.sample) / rate, 2),
            status_text(point.status) if point else "no result",
        ]
        rows.append(Row(cells, failed=point is None or point.status != PointStatus.OK))
    return Table(_LEVEL_COLUMNS, rows, heading="Bench time of each level")


_HARMONICS_COLUMNS = (
    PageColumn("Level", kind="text"),
    PageColumn("Target"),
    PageColumn("Controlled", kind="text"),
    PageColumn(Markup("√Σ|F<sub>n</sub>|² / |F<sub>1</sub>|"), "%"),
    PageColumn("without control", "%"),
    PageColumn(Markup("γ<sub>F</sub>")),
    PageColumn("PBMIF"),
    PageColumn("f̃ moved by", "%"),
    PageColumn("δ̃ moved by", "%"),
)
_ONE_EXCITER = 0.01  # deviation of damping from the reference from which on the exciter's place is named


def harmonics_table(data: RunReportData) -> Table | None:
    """What control of the force's harmonics has done at each level; none in a run without it."""
    if not any_control(data.points):
        return None
    rows = []
    for point, told in zip(data.points, indicators(data.points), strict=True):
        if point.status != PointStatus.OK:
            continue
        controlled = {0: "none", 1: "auto"}.get(told.harmonics_control, f"2 to {told.harmonics_control}")
        rows.append(
            Row(
                [
                    point.level_index + 1,
                    f"{significant(point.level)} {unit_text(point.level_unit)}",
                    controlled,
                    _share_text(told.force_harmonics),
                    _share_text(told.force_harmonics_without),
                    plain(point.gamma_force, 5),
                    plain(point.pbmif, 5),
                    _share_text(told.frequency_moved, True),
                    _share_text(told.damping_moved, True),
                ]
            )
        )
    return Table(_HARMONICS_COLUMNS, rows, heading="Control of the force harmonics") if rows else None


def _share_text(value: float, signed: bool = False) -> str:
    if math.isnan(value):
        return "—"
    text = plain(100.0 * abs(value), 3)
    return text if not signed else f"{'+' if value >= 0.0 else '−'}{text}"


def harmonics_notes(data: RunReportData) -> list[str]:
    """Sentences on control of harmonics: what was given up, and what control cannot take away."""
    if not any_control(data.points):
        return []
    notes = [
        f"Level {index + 1}: {part.strip()}."
        for index, words in sorted(data.lock_words.items())
        for part in words.split(";")
        if "given up" in part
    ]
    if any(not math.isnan(told.damping_moved) for told in indicators(data.points)):
        notes.append(
            "Moved by: modal properties with control over those without it at the same modal amplitude, i.e. the error "
            "of the method that control has taken away."
        )
    if abs(worst_deviation(data)[1]) > _ONE_EXCITER:
        notes.append(
            "The remaining deviation from the reference with the harmonics at their targets comes from the place "
            "of the one exciter: its fundamental also drives the other modes."
        )
    return notes


def _assumptions(data: RunReportData) -> list[str]:
    items = data.rig.get("assumptions") or []
    return [str(item) for item in ([items] if isinstance(items, str) else items)]


def _real_time_facts(data: RunReportData) -> list[tuple[str, str]]:
    """Converter, priorities and lateness of a test in real time; empty in lockstep."""
    said = data.plant
    if "lateness_histogram" not in said:
        return []
    facts: list[tuple[str, str]] = []
    if "converter_delay" in said:
        stated = said.get("converter_stated", "-1")
        facts += [
            ("Converter", str(data.run.get("device", ""))),
            ("Delay from command to monitor", f"{said['converter_delay']} samples, moved by {said['converter_drift']}"),
            (
                "Round trip",
                f"{said['converter_round_trip']} samples"
                + ("" if stated.startswith("-") else f"; the driver says {stated}"),
            ),
            ("Clock against the computer's", f"{said['converter_clock_ppm']} ppm".replace("nan ppm", "not known")),
            ("Turns of the converter with lost samples (xruns)", said["converter_lost_turns"]),
            ("Priority of the process at the converter", said["converter_priority"]),
            ("Priority of the plant node", said["plant_priority"]),
            ("Computer", said.get("computer", "")),
        ]
    facts += [
        (
            "Blocks late by",
            f"{said['jitter_p50_ms']} ms (median), {said['jitter_p99_ms']} ms (99 %), {said['jitter_max_ms']} ms "
            "(worst)",
        ),
        ("By more than a block and a turn", said["overruns"]),
        ("Warnings", said.get("warnings", "")),
    ]
    return [(name, value) for name, value in facts if value]


def _lateness_table(data: RunReportData) -> Table | None:
    """Blocks by how late they came."""
    classes = read_histogram(data.plant.get("lateness_histogram", ""))
    total = sum(count for _, count in classes)
    if not total:
        return None
    rows = [Row((name, count, significant(100.0 * count / total, 3))) for name, count in classes]
    note = "From the moment a block was put out to the plant node's turn; a converter's turn is part of it."
    return Table((PageColumn("Late by", kind="text"), PageColumn("Blocks"), PageColumn("Share", "%")), rows, note)


def _file_table(data: RunReportData) -> Table | None:
    if not data.files:
        return None
    rows = [Row((entry.name, file_size(entry.size), entry.sha256)) for entry in data.files]
    return Table((PageColumn("File", kind="text"), PageColumn("Size"), PageColumn("SHA-256", kind="text mono")), rows)


def _settings(data: RunReportData) -> list[tuple[str, str]]:
    """Name and JSON text of each."""
    parts: list[tuple[str, Mapping[str, Any]]] = [
        ("run.json: plan, parameters, versions", data.run),
        ("rig.yaml: the rig as used", data.rig),
        ("Stop record of the bag", data.stop),
    ]
    return [(name, json.dumps(values, indent=1, ensure_ascii=False, default=str)) for name, values in parts if values]


def _end_of_run(data: RunReportData) -> tuple[str, str]:
    """Exit state and reason of the stop record; empty where there is none."""
    end = data.stop.get("exit")
    if not isinstance(end, Mapping):
        return "", ""
    return str(end.get("state", "")), str(end.get("reason", ""))


def _percent(value: float) -> str:
    return f"{100 * value:+.2g} %".replace("-", "−") if math.isfinite(value) else "—"
