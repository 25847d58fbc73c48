"""``./nmt blind``: the blind check of the diagnosis — make sealed cases, diagnose them, score."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_bench.command_parser import EXIT_DONE, EXIT_FAILED
from nmt_bench.commands.shared_options import jobs_option, scheduler_option
from nmt_bench.commands.worker_count import worker_count
from nmt_core.errors import BenchError
from nmt_core.options import argument, needed_option, option

if TYPE_CHECKING:
    from collections.abc import Callable


_MOST_RIGS = 10_000  # that one command makes
RIGS = ("beam", "joint_resonator", "modal_beam")
TOLERANCES = ("laboratory", "none")


SUMMARY = "blind check of the diagnosis: make sealed cases, diagnose, score"

DESCRIPTION = (
    "Checks the diagnosis on simulated tests whose truth it cannot know. 'make' seals the truth and writes "
    "bags, 'run' diagnoses them, 'score' opens the seal and compares; 'laboratory' does all of it with cases "
    "that others have made. 'rigs' draws rigs that are driven, 'investigate' investigates them and a fixed plan. "
    "All parts go on where they stopped."
)


@dataclass(frozen=True, kw_only=True)
class MakeOptions:
    """draw cases, seal their truth, record their bags"""

    rig: str = option("beam", "rig of the cases (default: beam)", choices=RIGS)
    cases: int = option(400, "number of cases (default: 400)", metavar="N")
    seed: int = needed_option("seed: even for development, odd for a sealed campaign", metavar="S")
    sealed: bool = option(False, "a sealed campaign; needs an odd seed")
    kinds: str = option(
        "", "only these kinds of case: null, effect, open, compound, twin, withheld (default: all)", metavar="KIND,…"
    )
    batch: int = option(0, "make only N more cases now; all truths are sealed at once", metavar="N")
    tolerances: str = option(
        TOLERANCES[0],
        "measuring chain of an ordinary laboratory, drawn for every case, or none (default: laboratory)",
        choices=TOLERANCES,
    )
    out: Path = needed_option("folder of the campaign", metavar="DIR")
    jobs: int | None = jobs_option()
    scheduler: str = scheduler_option()


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """diagnose all cases that have no result yet; the truth stays sealed"""

    out: Path = needed_option("folder of the campaign", metavar="DIR")
    results: Path | None = option(
        None, "folder of the results (default: results in the campaign's folder)", metavar="DIR"
    )
    jobs: int | None = jobs_option()
    scheduler: str = scheduler_option()
    discard_bags: bool = option(False, "remove the bags of a case once it is diagnosed; hashes stay")
    again: bool = option(False, "diagnose cases that have a result, too")
    sizes: str = option(
        "none",
        "what matters: usual, the sizes of './nmt diagnose', or none, every effect that is seen (default: none)",
        choices=("none", "usual"),
    )


@dataclass(frozen=True, kw_only=True)
class ScoreOptions:
    """open the seal and compare the results with the truth"""

    out: Path = needed_option("folder of the campaign", metavar="DIR")
    results: Path | None = option(
        None, "folder of the results (default: results in the campaign's folder)", metavar="DIR"
    )
    again: bool = option(False, "score although the seal has been opened before; is noted")
    train: Path | None = option(
        None, "diagnosed development campaign that the generic classifier learns from", metavar="DIR"
    )
    jobs: int | None = jobs_option()
    docs: Path | None = option(None, "write the score sheet as a page of the documentation, too", metavar="FILE")


@dataclass(frozen=True, kw_only=True)
class ExplainOptions:
    """of an opened case: cost of model, winner and truth under the same noise, and what follows"""

    case: str = argument("number of the case, as in its folder; of a laboratory its name", metavar="CASE")
    out: Path | None = option(None, "folder of the campaign", metavar="DIR", exclusive=True)
    laboratory: Path | None = option(
        None, "folder of the cases of a laboratory that shares no code", metavar="DIR", exclusive=True
    )


@dataclass(frozen=True, kw_only=True)
class LaboratoryOptions:
    """import and diagnose the cases that another laboratory has made, and class the answers"""

    folder: Path = argument(
        "a folder for each case: model.yaml, sidecar.yaml (or several) with its data, truth.yaml; of robots robot.xml, "
        "log.yaml with its data, truth.yaml; of real recordings with a plan, the commands to run",
        metavar="DIR",
    )
    out: Path = needed_option(
        "folder for the results (laboratory.csv, laboratory.json, a folder for each case)", metavar="DIR"
    )
    only: str = option("", "only these cases (default: all)", metavar="NAME,…")
    force: bool = option(False, "diagnose cases that have a result of the same program and files, too")
    limit: float = option(
        1800.0,
        "processor time of an import or a diagnosis, s; beyond it the case is refused (default: 1800)",
        metavar="S",
    )
    keep_bags: bool = option(False, "keep what was imported")
    jobs: int | None = jobs_option()


@dataclass(frozen=True, kw_only=True)
class RigsOptions:
    """draw rigs that are driven: model.yaml, real.yaml, truth.yaml in a folder for each; every third is healthy"""

    rig: str = option("beam", "rig that they are drawn from (default: beam)", choices=RIGS)
    seeds: str = option("", "seeds, one a rig: the first and the one after the last, such as 0:20", metavar="A:B")
    pairs: bool = option(False, "two rigs for each pair of effects that are hard to distinguish, instead of seeds")
    tolerances: str = option(
        "none",
        "measuring chain of the rigs of --seeds: as their rig files say, or with gains, phases, hum and a clock "
        "of an ordinary laboratory and a calibration file (default: none)",
        choices=TOLERANCES,
    )
    out: Path = needed_option("folder that gets a folder for each rig", metavar="DIR")


@dataclass(frozen=True, kw_only=True)
class InvestigateRigsOptions:
    """investigate sealed rigs and run a fixed plan (linear test, ten levels, low and high random) on each"""

    folder: Path = argument("a folder for each rig: model.yaml, real.yaml, truth.yaml", metavar="DIR")
    out: Path = needed_option(
        "folder for the results (investigations.csv, investigations.json, a folder for each rig)", metavar="DIR"
    )
    only: str = option("", "only these rigs (default: all)", metavar="NAME,…")
    until: float = option(0.95, "probability from which an answer is taken (default: 0.95)", metavar="P")
    limit: float = option(1800.0, "processor time of an investigation or a diagnosis, s (default: 1800)", metavar="S")
    keep_bags: bool = option(False, "keep what was recorded")
    no_plan: bool = option(False, "investigate only")


def _make(options: MakeOptions) -> int:
    from nmt_blind.cases.make import CampaignPlan, make_campaign

    kinds = tuple(word.strip() for word in options.kinds.split(",") if word.strip())
    with _Bar("making cases") as bar:
        made = make_campaign(
            options.out,
            CampaignPlan(
                rig_name=options.rig,
                count=options.cases,
                seed=options.seed,
                kinds=kinds,
                sealed=options.sealed,
                tolerances=options.tolerances,
            ),
            worker_count(options),
            options.scheduler,
            on_seal=lambda digest: bar.say(f"seal of the truth: sha256 {digest}"),
            progress=lambda done, total: bar.update(done, total),
            batch=options.batch,
        )
    each = f"; {made.seconds / made.new:.2f} s of computing a new case" if made.new else ""
    bar.say(f"{made.cases} cases, {made.new} of them new{each}; {made.megabytes:.0f} MB of bags in {made.folder}")
    if made.left:
        bar.say(f"{made.left} are to be made: the same line goes on")
    else:
        bar.say(f"end of the hash trail: sha256 {made.trail}")
    return EXIT_DONE


def _run(options: RunOptions) -> int:
    from nmt_blind.campaign.run import diagnose_case, run_campaign

    with _Bar("diagnosing") as bar:
        done = run_campaign(
            options.out,
            options.results,
            worker_count(options),
            options.scheduler,
            options.discard_bags,
            options.again,
            partial(diagnose_case, sizes=options.sizes),
            progress=lambda number, total, _: bar.update(number, total),
        )
    each = f", {done.seconds:.1f} s each (median)" if done.new else ""
    bar.say(f"{done.done} of {done.cases} cases have a result, {done.new} of them new{each}; results in {done.results}")
    if done.waiting:
        bar.say(f"{done.waiting} cases have no bags yet: go on with './nmt blind make'")
    if done.failed:
        bar.say(f"{done.failed} diagnoses ended without a verdict; their results say why")
    return EXIT_FAILED if done.failed else EXIT_DONE


def _score(options: ScoreOptions) -> int:
    from nmt_blind.campaign.score import score_campaign
    from nmt_blind.campaign.score_sheet import print_scores, write_sheets

    def measured(truth: dict[str, Any]) -> dict[str, float]:
        from nmt_blind.campaign.explain import measured_strengths

        with _Bar("measuring strengths") as bar:
            return measured_strengths(
                options.out,
                truth,
                worker_count(options),
                progress=lambda done, total, _: bar.update(done, total),
            )

    scores = score_campaign(options.out, options.results, options.again, options.train, measured)
    files = write_sheets(scores, options.out, options.docs)
    for line in print_scores(scores):
        _console().print(line)
    _console().print(f"written: {', '.join(str(file) for file in files)}")
    return EXIT_DONE


def _explain(options: ExplainOptions) -> int:
    from nmt_blind.campaign.explain import explain_case, explain_foreign

    if options.laboratory:
        found = explain_foreign(options.laboratory, options.case, (sys.executable, "-m", "nmt_bench"))
    else:
        assert options.out is not None  # the parser takes exactly one of the two
        found = explain_case(options.out, options.case)
    null, winner, truth = found.costs
    console = _console()
    lines = [
        f"case {found.case}: truth {found.truth or 'none'}",
        f"cost of the model alone {null:.1f}",
        f"cost of the winner, {found.winner}: {winner:.1f} ({winner - null:+.1f}), "
        f"ln evidence {found.evidence[0]:+.1f}",
        f"cost of the truth: {truth:.1f} ({truth - null:+.1f}), ln evidence {found.evidence[1]:+.1f}; "
        f"{found.sigma:.1f} standard deviations under this noise",
        "learnt scales, of the model alone, the winner and the truth:",
        *(f"  {name}: {a:.2f}, {b:.2f}, {c:.2f}" for name, (a, b, c) in found.scales.items()),
        f"what follows: {found.follows}",
    ]
    for line in lines:
        console.print(line, soft_wrap=True)
    return EXIT_DONE


def _cases(names: str) -> tuple[str, ...]:
    """Names of cases in a list with commas."""
    return tuple(word.strip() for word in names.split(",") if word.strip())


def _progress(bar: _Bar) -> Callable[[int, int, str], None]:
    """Progress of cases done of all, with a line on the newest, on a bar."""

    def say(done: int, total: int, newest: str) -> None:
        if newest:
            bar.say(newest)
        bar.update(done, total)

    return say


def _laboratory(options: LaboratoryOptions) -> int:
    from nmt_blind.campaign.foreign_run import print_lines, run_laboratory, write_tables
    from nmt_blind.campaign.recordings import has_plans
    from nmt_blind.campaign.robot_case import has_robots

    if has_plans(options.folder):
        return _recordings(options)
    if has_robots(options.folder):
        return _robots(options)
    only = _cases(options.only)
    with _Bar("diagnosing") as bar:
        lines = run_laboratory(
            options.folder,
            options.out,
            (sys.executable, "-m", "nmt_bench"),
            worker_count(options),
            only,
            options.force,
            options.limit,
            options.keep_bags,
            _progress(bar),
        )
        files = write_tables(lines, options.out)
    console = _console()
    for line in print_lines(lines):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    console.print(f"written: {', '.join(str(file) for file in files)}", soft_wrap=True)
    return EXIT_FAILED if any(line.answer.outcome == "refused" for line in lines) else EXIT_DONE


def _recordings(options: LaboratoryOptions) -> int:
    from nmt_blind.campaign.recordings import run_recordings, summary_words, write_recordings

    only = _cases(options.only)
    with _Bar("diagnosing") as bar:
        program = (sys.executable, "-m", "nmt_bench")
        found = run_recordings(options.folder, options.out, program, only, options.limit, _progress(bar))
    files = write_recordings(found, options.folder, options.out)
    console = _console()
    console.print(summary_words(found), soft_wrap=True, markup=False, highlight=False)
    console.print(f"written: {', '.join(str(file) for file in files)}", soft_wrap=True)
    return EXIT_FAILED if any(answer.outcome == "no answer" for answer in found) else EXIT_DONE


def _robots(options: LaboratoryOptions) -> int:
    from nmt_blind.campaign.robot_run import run_robots, summary_lines, write_robot_tables

    with _Bar("diagnosing") as bar:
        lines = run_robots(
            options.folder,
            options.out,
            (sys.executable, "-m", "nmt_bench"),
            worker_count(options),
            _cases(options.only),
            options.force,
            options.limit,
            _progress(bar),
        )
        files = write_robot_tables(lines, options.out)
    console = _console()
    for line in summary_lines(lines):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    console.print(f"written: {', '.join(str(file) for file in files)}", soft_wrap=True)
    return EXIT_FAILED if any(line.answer.outcome == "refused" for line in lines) else EXIT_DONE


def _rigs(options: RigsOptions) -> int:
    from nmt_blind.cases.driven_rigs import make_pairs, make_rigs

    if options.pairs == bool(options.seeds):
        raise BenchError("Give either --seeds or --pairs.")
    if options.pairs and options.tolerances != "none":
        raise BenchError("--tolerances is of rigs that are drawn by --seeds; leave it out with --pairs.")
    if options.pairs:
        _console().print(f"{len(make_pairs(options.out, options.rig))} rigs in {options.out}", soft_wrap=True)
        return EXIT_DONE
    first, _, end = options.seeds.partition(":")
    if not (first.isdigit() and end.isdigit() and int(first) < int(end)):
        raise BenchError(f"--seeds are the first and the one after the last, such as 0:20; got {options.seeds}.")
    if len(end) > 9 or int(end) - int(first) > _MOST_RIGS:
        raise BenchError(f"--seeds {options.seeds}: {_MOST_RIGS} rigs at most, and seeds of nine digits at most.")
    names = make_rigs(options.out, options.rig, range(int(first), int(end)), options.tolerances)
    _console().print(f"{len(names)} rigs in {options.out}", soft_wrap=True)
    return EXIT_DONE


def _investigate(options: InvestigateRigsOptions) -> int:
    from nmt_blind.campaign.investigations import NOT_RUN, print_lines, run_investigations, write_tables

    if not 0.5 < options.until < 1.0:
        raise BenchError(f"--until is a probability between 0.5 and 1, got {options.until:g}.")
    only = _cases(options.only)
    with _Bar("investigating") as bar:
        lines = run_investigations(
            options.folder,
            options.out,
            (sys.executable, "-m", "nmt_bench"),
            only,
            options.until,
            options.limit,
            options.keep_bags,
            not options.no_plan,
            _progress(bar),
        )
        files = write_tables(lines, options.out)
    console = _console()
    for line in print_lines(lines):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    console.print(f"written: {', '.join(str(file) for file in files)}", soft_wrap=True)
    troubles = {arm.trouble for line in lines for arm in (line.investigation, line.plan)}
    return EXIT_FAILED if troubles - {"", NOT_RUN} else EXIT_DONE


def _console() -> Any:
    from nmt_bench.commands.console import make_console

    return make_console()


class _Bar:
    """Progress with time spent and left; a line now and then where the output is not a terminal."""

    _QUIET = 30.0  # s between lines

    def __init__(self, title: str) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
        from rich.progress import TimeRemainingColumn as Left

        self._title = title
        self._console = _console()
        self._live = bool(self._console.is_terminal)
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), Left()
        self._bar = Progress(*columns, console=self._console, disable=not self._live)
        self._task = self._bar.add_task(title, total=None)
        self._said = time.monotonic()

    def __enter__(self) -> _Bar:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def update(self, done: int, total: int) -> None:
        """So many of so many are done."""
        self._bar.update(self._task, completed=done, total=total)
        if not self._live and (time.monotonic() - self._said > self._QUIET or done == total):
            self._said = time.monotonic()
            self._console.print(f"{self._title}: {done} of {total}")

    def say(self, sentence: str) -> None:
        """A line above the bar."""
        self._console.print(sentence, soft_wrap=True)


PART_COMMANDS = {
    "make": _make,
    "run": _run,
    "score": _score,
    "explain": _explain,
    "laboratory": _laboratory,
    "rigs": _rigs,
    "investigate": _investigate,
}
"""What does each part; its options are those that it takes."""
