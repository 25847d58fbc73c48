"""Pages, figures and tables of tests, responses and diagnoses.

Public names, each loaded when it is asked for: the report of a run, of a linear test, and the files of a diagnosis.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nmt_core.public_names import loaded

if TYPE_CHECKING:
    from nmt_report.diagnosis_files import write_diagnosis
    from nmt_report.figure_files import report_figures, write_figures
    from nmt_report.linear_report import exact_modes, linear_page
    from nmt_report.run_data import read_reference
    from nmt_report.run_report import report_data_from_bag, write_report

__all__ = [
    "exact_modes",
    "linear_page",
    "read_reference",
    "report_data_from_bag",
    "report_figures",
    "write_diagnosis",
    "write_figures",
    "write_report",
]


def __getattr__(name: str) -> Any:
    return loaded(__name__, name)
