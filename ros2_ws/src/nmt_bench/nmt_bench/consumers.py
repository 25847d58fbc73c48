"""Who takes tests and their recordings, and what each says of a test before anything starts or is read."""

from __future__ import annotations

import importlib

from nmt_core.messages.driven_test import Covers, DrivenTest

CONSUMERS: dict[str, str] = {
    "run": "nmt_session.coverage",
    "judgement": "nmt_record.windows.window_policy",
    "extract": "nmt_extract.modal.coverage",
    "linear": "nmt_extract.linear.evaluation",
    "reference": "nmt_rig.reference",
    "diagnosis": "nmt_diagnose.coverage",
    "synthesis": "nmt_extract.synthesis.single_mode",
    "export and import": "nmt_record.exchange.export.exported_run",
    "nmt.open": "nmt.opening",
    "report": "nmt_report.coverage",
    "figures": "nmt_report.coverage",
    "page": "nmt_bench.consumers",
}
"""Module with the function ``covers`` of each consumer; the first says what can be done at all.

Judgement, export and import, and page refuse no possible test: `tests/matrix` holds each kind, exciter and
drive against them. The page shows recordings as it shows a run; a pause and going on are the sequencer's, of any test.
"""


def covers_of(consumer: str) -> Covers:
    """What a consumer says of a test: empty = it takes it, else one sentence why not."""
    found: Covers = importlib.import_module(CONSUMERS[consumer]).covers
    return found


def covers(test: DrivenTest) -> str:
    """Of the live page, empty: signals, levels and the loop's state are shown of any test."""
    del test
    return ""
