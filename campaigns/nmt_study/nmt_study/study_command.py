"""``./nmt study``: the paper's studies of the virtual experiment against references computed here."""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from nmt_bench.command_parser import EXIT_DONE, EXIT_FAILED
from nmt_bench.commands.shared_options import jobs_option, scheduler_option
from nmt_bench.commands.worker_count import worker_count
from nmt_core.errors import BenchError
from nmt_core.files.whole_file import write_whole
from nmt_core.options import argument, option
from nmt_study import STUDIES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nmt_study.study import Finding
    from nmt_study.study_runner import CaseReport
    from nmt_study.study_table import SummaryRow


_LISTED = "\n".join(f"  {name:<18}{summary}" for name, (_, summary) in STUDIES.items())

SUMMARY = "the paper's studies, all cases, compared with references"


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Runs the cases of a study through the bench's nodes in lockstep, in parallel over the cores, and compares every
    level with two references: EPMC (error of the method) and the single-point phase-resonant test (error of the
    test). A finished case is kept; the same command again goes on where it stopped."""

    EPILOG: ClassVar[str] = f"studies:\n{_LISTED}\n  {'all':<18}all of them, each in a folder of its own"

    name: str = argument("name of the study, or all", metavar="NAME", choices=(*STUDIES, "all"))
    out: Path | None = option(
        None,
        "folder for the results (study.csv, report.html, cases/); one of the same study is gone on with "
        "(default:"
        " out/study-NAME)",
        metavar="DIR",
    )
    force: bool = option(False, "start over in a folder that has results")
    quick: bool = option(False, "few, short cases: shows that it works, no more")
    jobs: int | None = jobs_option()
    scheduler: str = scheduler_option()
    keep_bags: bool = option(False, "keep the recording of every case in bags/")

    @property
    def results_folder(self) -> Path:
        """Where the results go."""
        return Path("out") / f"study-{self.name}" if self.out is None else self.out


def run(options: StudyOptions) -> int:
    """Run the study, write table and report, print the summary.

    Returns:
        0 if every case has a result, else 1.

    Raises:
        BenchError: the folder holds something else, or an option is refused.
    """
    jobs = worker_count(options)
    from nmt_bench.commands.console import make_console

    console = make_console()
    began = time.monotonic()
    if options.name == "all":
        complete = _run_all(options, jobs, console)
    else:
        complete, *_ = _run_study(options.name, options.results_folder, options, jobs, console)
    from nmt_report.quantity_format import duration

    console.print(f"{duration(time.monotonic() - began)}; results in {options.results_folder}")
    return EXIT_DONE if complete else EXIT_FAILED


def _run_all(options: StudyOptions, jobs: int, console: Any) -> bool:
    from nmt_study.case_store import CaseStore
    from nmt_study.study_report import index_page
    from nmt_study.study_table import study_csv

    CaseStore(options.results_folder, "all", options.force)
    shutil.rmtree(options.results_folder / "cases", ignore_errors=True)
    complete, entries, rows = True, [], []
    for name in STUDIES:
        whole, title, summary, findings, study_rows = _run_study(
            name, options.results_folder / name, options, jobs, console
        )
        complete = complete and whole
        entries.append((name, title, summary, findings))
        rows += study_rows
    write_whole(options.results_folder / "study.csv", study_csv(rows))
    write_whole(options.results_folder / "report.html", index_page(entries, options.quick))
    return complete


def _run_study(
    name: str, folder: Path, options: StudyOptions, jobs: int, console: Any
) -> tuple[bool, str, list[SummaryRow], Sequence[Finding], list[Any]]:
    from nmt_report.svg import figure_style
    from nmt_study.case_store import CaseStore
    from nmt_study.study_report import study_page
    from nmt_study.study_runner import load_study, run_cases
    from nmt_study.study_table import level_rows, study_csv, summary_row

    module = load_study(name)
    store = CaseStore(folder, name, options.force)
    cases = module.cases(options.quick)
    todo = store.missing(cases)
    done = len(cases) - len(todo)
    text = f"{module.TITLE}: {len(cases)} cases"
    console.print(text + (f", {done} of them done before" if done else ""), style="bold")
    progress = _Progress(console, len(todo))
    bags = folder / "bags" if options.keep_bags else None
    reports = run_cases(name, cases, store, jobs, bags, progress.case_done, options.scheduler)
    failures = [report for report in reports if report.result is None]
    results = [result for case in cases if (result := store.load(case)) is not None]
    if not results:
        raise BenchError(
            f"No case of the study {name} has a result: {failures[0].failure if failures else 'none ran'}."
        )
    rows = [level_rows(name, result) for result in results]
    summary = [summary_row(result, own) for result, own in zip(results, rows, strict=True)]
    with figure_style():
        output = module.show(results)
    if options.quick:
        # Few and short cases show that a study works; they carry no conclusion.
        output = replace(output, findings=[replace(finding, holds=None) for finding in output.findings])
    table = [row for own in rows for row in own] + list(output.extra_rows)
    write_whole(folder / "study.csv", study_csv(table))
    page_text = study_page(name, module.TITLE, results, summary, table, output, options.quick)
    write_whole(folder / "report.html", page_text)
    print_summary(console, summary, output.findings)
    for report in failures:
        console.print(f"Case {report.case.name} failed: {report.failure}", style="red")
    return not failures, module.TITLE, summary, output.findings, table


def print_summary(console: Any, summary: Sequence[SummaryRow], findings: Sequence[Finding]) -> None:
    """Largest errors of each case, and the statements checked."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from nmt_report.quantity_format import plain, significant

    table = Table(box=SIMPLE_HEAD, header_style="bold")
    table.add_column("case")
    for head in ("levels", "test ω̃\n%", "test δ̃\n%", "method ω̃\n%", "method δ̃\n%", "periods\nper level"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("note")
    for row in summary:
        table.add_row(
            row.case,
            f"{row.locked}/{row.levels}",
            *(significant(100.0 * value, 2) for value in (*row.single_point, *row.epmc)),
            plain(row.periods, 1),
            row.note,
        )
    console.print(table)
    words = {True: ("holds", "green"), False: ("does not hold", "red"), None: ("not judged", "dim")}
    for finding in findings:
        word, style = words[finding.holds]
        console.print(f"{word}: {finding.claim} {finding.found}.", style=style)


class _Progress:
    """One line for each case as it ends."""

    def __init__(self, console: Any, total: int) -> None:
        self._console = console
        self._total = total
        self._count = 0
        self._began = time.monotonic()

    def case_done(self, report: CaseReport) -> None:
        """Say what became of a case and how long the rest may take."""
        from nmt_report.quantity_format import duration

        self._count += 1
        elapsed = time.monotonic() - self._began
        rest = elapsed / self._count * (self._total - self._count)
        if report.result is None:
            what = f"failed: {report.failure}"
        else:
            run = report.result["run"]
            what = f"{run['message']} {duration(run['bench_time_s'])} of bench time"
        left = f"; about {duration(rest)} left" if self._count < self._total else ""
        self._console.print(f"  {self._count}/{self._total} {report.case.title}: {what}{left}")
