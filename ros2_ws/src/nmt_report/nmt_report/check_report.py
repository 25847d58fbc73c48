"""``report.html`` of a check."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nmt_report.response_page import ResponsePage, html_table


def check_page(document: Mapping[str, Any]) -> str:
    """The page of a check.

    Args:
        document: content of ``check.json``.
    """
    findings = document["findings"]
    names = sorted({finding["name"].replace("_", " ") for finding in findings})
    verdict = ("Passed: nothing was found.", "good") if not findings else (f"Found: {', '.join(names)}.", "bad")
    head = [
        ("channel", ""),
        ("port", ""),
        ("noise", "V rms"),
        ("noise", "unit rms"),
        ("unit", ""),
        ("mains", "V"),
        ("mean", "V"),
        ("coherence", ""),
        ("gain", "1"),
        ("range used", "%"),
        ("verdict", ""),
    ]
    rows = []
    for channel in document["channels"]:
        own = [each["name"].replace("_", " ") for each in findings if channel["channel"] in each["channels"]]
        rows.append(
            [
                channel["channel"],
                channel["port"],
                _figure(channel["noise_v"]),
                _figure(channel["noise"]),
                channel["unit"],
                _figure(channel["mains_v"]),
                _figure(channel["offset_v"]),
                _figure(channel["coherence"]),
                _figure(channel["gain"]),
                _figure(channel["headroom"], 100.0),
                ", ".join(own) or "good",
            ]
        )
    sections = [("channels", "Channels", html_table(head, rows, "Gain: measured over what the rig's model expects."))]
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


def _figure(value: float | None, factor: float = 1.0) -> str:
    return "" if value is None else f"{factor * value:.3g}"
