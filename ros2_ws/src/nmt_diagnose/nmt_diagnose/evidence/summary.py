"""What a real side consists of: one row per test, for the screen and for ``diagnosis.json``."""

from __future__ import annotations

from typing import Any

import numpy as np

from nmt_diagnose.evidence.conditions import (
    BackboneTable,
    PhaseResonanceTest,
    RandomTest,
    RecordTest,
    RingDownTest,
    Test,
)
from nmt_diagnose.evidence.observables import Evidence

_KINDS: dict[type, str] = {
    PhaseResonanceTest: "phase resonance",
    RandomTest: "frequency response",
    RingDownTest: "ring-down",
    RecordTest: "record",
    BackboneTable: "backbone table",
}


def found_tests(evidence: Evidence) -> list[dict[str, Any]]:
    """One entry per test: name, kind, drive_point, channels, levels, observables, low, high and their unit."""
    result = []
    for number, test in enumerate(evidence.tests):
        mine = evidence.rows.test == number
        amplitudes = evidence.rows.amplitude[mine]
        result.append(
            {
                "name": test.name,
                "kind": _KINDS[type(test)],
                "drive_point": test.drive_point,
                "channels": _channels(test),
                "levels": int(np.unique(evidence.rows.level[mine]).size),
                "observables": int(mine.sum()),
                "low": float(amplitudes.min()) if amplitudes.size else None,
                "high": float(amplitudes.max()) if amplitudes.size else None,
                "unit": _unit(test),
            }
        )
    return result


def table_lines(evidence: Evidence) -> list[str]:
    """The same as lines of text with a head."""
    rows = found_tests(evidence)
    if not rows:
        return ["no tests"]
    width = max(4, *(len(row["name"]) for row in rows))
    kind = max(4, *(len(row["kind"]) for row in rows))
    lines = [f"{'test':{width}}  {'kind':{kind}}  drive  levels  observables  amplitudes"]
    for row in rows:
        span = "" if row["low"] is None else f"{row['low']:.3g} to {row['high']:.3g} {row['unit']}".rstrip()
        lines.append(
            f"{row['name']:{width}}  {row['kind']:{kind}}  {row['drive_point']:5d}  {row['levels']:6d}  "
            f"{row['observables']:11d}  {span}"
        )
    return lines


def as_inputs(evidence: Evidence) -> dict[str, Any]:
    """Entry ``inputs`` of ``diagnosis.json``, as far as the evidence knows it."""
    return {
        "bags": [{"path": path, "sha256": digest} for path, digest in evidence.inputs],
        "tests": found_tests(evidence),
        "notes": list(evidence.notes),
    }


def _channels(test: Test) -> list[str]:
    if isinstance(test, RingDownTest | BackboneTable):
        return [test.channel.name]
    return [channel.name for channel in test.channels]


def _unit(test: Test) -> str:
    if isinstance(test, RingDownTest | BackboneTable):
        return test.channel.quantity.unit
    if isinstance(test, PhaseResonanceTest):
        return "V" if test.held == "voltage" else "N"
    if isinstance(test, RecordTest):
        return test.input_channel.quantity.unit
    return "V" if test.reference == "voltage" else "N"
