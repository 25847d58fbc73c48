"""``report.html`` of a check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.quantity_format import uncertain
from nmt_report.response_page import ResponsePage, html_figures, html_table
from nmt_report.svg import BLUE, MUTED, ReportFigure, figure_style


def check_page(document: Mapping[str, Any]) -> str:
    """The page of a check.

    Args:
        document: content of ``check.json``.
    """
    findings = document["findings"]
    names = sorted({finding["name"].replace("_", " ") for finding in findings})
    verdict = ("Passed: nothing was found.", "good") if not findings else (f"Found: {', '.join(names)}.", "bad")
    head = [("channel", ""), ("port", ""), ("noise", "V rms"), ("noise", "rms"), ("mains", "V"), ("mean", "V")]
    head += [("range used", "%"), ("verdict", "")]
    answers_head = [("channel", ""), ("coherence", ""), ("gain", "1"), ("delay", "µs"), ("δ̃ error", "%")]
    answers_head.append(("ω̃ error", "ppm"))
    rows, answers = [], []
    for channel in document["channels"]:
        own = [each["name"].replace("_", " ") for each in findings if channel["channel"] in each["channels"]]
        rows.append(
            [
                channel["channel"],
                channel["port"],
                _figure(channel["noise_v"]),
                f"{_figure(channel['noise'])} {channel['unit']}",
                _figure(channel["mains_v"]),
                _figure(channel["offset_v"]),
                _figure(channel["headroom"], 100.0),
                ", ".join(own) or "good",
            ]
        )
        answers.append(
            [
                channel["channel"],
                _figure(channel["coherence"]),
                _pair(channel["gain"], channel["gain_std"], 1.0),
                _pair(channel["delay"], channel["delay_std"], 1e6),
                _figure(channel["damping_error"], 100.0),
                _figure(channel["frequency_error"], 1e6),
            ]
        )
    note = (
        "Gain: measured over what the rig's model expects; delay: later than the median of the channels; both with "
        "standard uncertainties. Errors: what this gain and this delay make of a test at phase resonance."
    )
    sections = [
        ("channels", "Channels", html_table(head, rows)),
        ("responses", "Responses to the drive", html_table(answers_head, answers, note)),
    ]
    modes = [
        [
            str(mode["number"]),
            _pair(mode["frequency_hz"], mode["frequency_std"], 1.0),
            _figure(mode["model_hz"]),
            _figure(mode["frequency_hz"] / mode["model_hz"] - 1.0, 100.0),
            _pair(mode["damping_ratio"], mode["damping_std"], 100.0),
            _figure(mode["model_damping"], 100.0),
        ]
        for mode in document["modes"]
    ]
    if modes:
        heads = [("mode", ""), ("found", "Hz"), ("model", "Hz"), ("apart", "%"), ("damping", "%"), ("model", "%")]
        sections.append(("modes", "Modes", html_table(heads, modes, "Of the structure without exciter.")))
    needed = ("gain", "gain_std", "delay", "delay_std")  # of a channel whose response is weak only some are known
    fitted = [channel for channel in document["channels"] if all(channel[name] is not None for name in needed)]
    if fitted:
        with figure_style():
            sections.insert(0, ("fit", "Gains and delays", html_figures([_fit_figure(fitted)])))
    if findings:
        listed = [[", ".join(each["channels"]) or "bench", each["sentence"], each["remedy"]] for each in findings]
        sections.insert(0, ("findings", "Findings", html_table([("where", ""), ("what", ""), ("remedy", "")], listed)))
    stated = document["stated_samples"]
    facts = [
        ("Date", str(document["date"])),
        ("Device", str(document["device"])),
        ("Round trip", f"{document['round_trip_samples']} samples" + (f", driver: {stated}" if stated >= 0 else "")),
        ("Clock against the computer", "" if document["clock_ppm"] is None else f"{document['clock_ppm']:+.1f} ppm"),
        ("Largest drive", f"{document['drive_peak_v']:.3g} V of {document['drive_limit_v']:.3g} V allowed"),
        ("Resonance", f"{document['frequency_hz']:.5g} Hz, expected {document['expected_hz']:.5g} Hz"),
        ("Blocks with lost samples", str(document["lost_blocks"])),
        ("Process at the converter", str(document.get("priority", ""))),
    ]
    return ResponsePage(
        "Check before a test",
        str(document["rig"]),
        f"{len(rows)} channels at {document['device']}, {document['date']}",
        verdict,
        sections,
        facts=facts,
    ).html()


def _fit_figure(channels: Sequence[Mapping[str, Any]]) -> ReportFigure:
    """Gain and delay of the fitted channels, with bars of two standard uncertainties."""
    figure, (left, right) = plot_panels((6.3, 3.4), 1, 2, left=0.11, right=0.97, bottom=0.17, top=0.96, wspace=0.35)
    places, names = range(len(channels)), [str(channel["channel"]) for channel in channels]
    for axes, name, factor, centre in ((left, "gain", 1.0, 1.0), (right, "delay", 1e6, 0.0)):
        values = [factor * channel[name] for channel in channels]
        bars = [2.0 * factor * channel[f"{name}_std"] for channel in channels]
        axes.axhline(centre, color=MUTED, linewidth=0.8)
        axes.errorbar(places, values, bars, fmt="o", color=BLUE, capsize=3)
        axes.set_xticks(list(places), names, rotation=90 if len(names) > 8 else 0)
    left.set_ylabel("gain, measured over expected")
    right.set_ylabel("delay against the others (µs)")
    caption = (
        "Fitted to the responses together with frequency and damping of the model's modes; bars: two standard "
        "uncertainties. A negative gain is a wrong sign."
    )
    title = "Gain and delay of each channel"
    return report_figure(figure, "fit", title, caption, wide=True, label=title)


def _pair(value: float | None, std: float | None, factor: float) -> str:
    return _figure(value, factor) if value is None or std is None else uncertain(factor * value, factor * std)


def _figure(value: float | None, factor: float = 1.0) -> str:
    return "" if value is None else f"{factor * value:.3g}"
