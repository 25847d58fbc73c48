"""What a study is made of: cases, figures, findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from nmt_report.svg import ReportFigure

Result = Mapping[str, Any]
"""What :func:`nmt_study.case_runner.run_case` returned, with ``case``."""


@dataclass(frozen=True)
class Finding:
    """A statement of the paper (or of ours) and what was found.

    Attributes:
        claim: the statement.
        found: one sentence with numbers.
        holds: None if it cannot be said.
    """

    claim: str
    found: str
    holds: bool | None


@dataclass(frozen=True)
class StudyTable:
    """A table of a study's own.

    Attributes:
        title: heading.
        columns: heading and unit of each column; the first is text.
        rows: cells as text.
        note: sentence below.
    """

    title: str
    columns: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[str]]
    note: str = ""


@dataclass(frozen=True)
class StudyOutput:
    """What a study shows in addition to its table.

    Attributes:
        figures: in the paper's order.
        findings: claims checked.
        remarks: sentences on choices and limits.
        extra_rows: further rows of ``study.csv``.
        tables: of the study's own, shown before its figures.
    """

    figures: Sequence[ReportFigure] = ()
    findings: Sequence[Finding] = ()
    remarks: Sequence[str] = ()
    extra_rows: Sequence[Mapping[str, Any]] = field(default_factory=tuple)
    tables: Sequence[StudyTable] = ()
