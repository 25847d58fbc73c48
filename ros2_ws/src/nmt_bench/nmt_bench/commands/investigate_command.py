"""``./nmt investigate``: the bench chooses, runs and stops its tests until the gap to a model has a name."""

from __future__ import annotations

import csv
import json
import math
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_bench.command_parser import EXIT_DONE, EXIT_INTERRUPTED, EXIT_PARTLY
from nmt_bench.commands.requested_test import command_text, command_words
from nmt_bench.commands.shared_options import dated_folder_option, device_option, jobs_option, latency_option
from nmt_bench.commands.worker_count import worker_count
from nmt_bench.orchestration.interrupts import terminate_as_interrupt
from nmt_core.errors import BenchError, FailedError
from nmt_core.kinds import RandomTest
from nmt_core.options import argument, option

if TYPE_CHECKING:
    from nmt_core.kinds.request import TestRequest
    from nmt_core.messages.linear_description import LinearDescription
    from nmt_diagnose.investigation.investigation import InvestigationSettings
    from nmt_diagnose.investigation.investigation_record import AskedTest, InvestigationRecord
    from nmt_diagnose.ledger.diagnosis import Diagnosis
    from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet
    from nmt_rig.rig import Rig

_DEFAULT_UNTIL, _DEFAULT_PERIODS = 0.95, 50
_RANDOM_S = 20.0, 120.0
"""Shortest and longest record of the linear test that is chosen."""
_RESOLVED = 5.0
"""Lines of a record on the half-power bandwidth of the narrowest resonance."""


@dataclass(frozen=True, kw_only=True)
class InvestigateOptions:
    """Finds out what a model lacks: runs a linear test and the lowest levels of the rig, diagnoses, chooses the test
    that is expected to tell most for its bench time, and so on until an answer is sure enough, nothing more can be
    told apart, or the bench time is used up. Every test is an ordinary recording, the level goes no higher than the
    rig's plan, and a second call with the same --out goes on where the first ended. With --real instead of --rig it
    diagnoses recordings and proposes the next test as a command."""

    model: str = argument("name of a rig (for example beam) or path of a rig file: the model", metavar="MODEL")
    rig: str | None = option(
        None, "rig file of the real side, which is driven: simulated, or with its device", metavar="REAL"
    )
    real: tuple[Path, ...] = option(
        (), "results folder or bag of a test that was made; the next one is proposed; may be repeated", metavar="BAG"
    )
    until: float = option(_DEFAULT_UNTIL, "probability from which an answer is taken (default: 0.95)", metavar="P")
    budget: float | None = option(None, "most bench time, s (default: the whole plan may be used)", metavar="S")
    levels: str | None = option(
        None, "plan of levels, V, which no test goes beyond (default: the real rig's)", metavar="PLAN"
    )
    periods: int = option(_DEFAULT_PERIODS, "whole periods a window (default: 50)", metavar="N")
    random: float | None = option(
        None,
        "length of each of the two records of the linear test, s (default: by the narrowest resonance, 20 to 120)",
        metavar="S",
    )
    ask: bool = option(False, "ask before each test: yes, no (another one) or stop")
    page: bool = option(
        False,
        "page in the browser with questions and results, to answer (with --ask) and to stop; prints its address",
    )
    out: Path = dated_folder_option("investigate.json, report.html, diagnosis/, a folder for each test", "investigate")
    set: tuple[str, ...] = option((), "change a value of the real rig; may be repeated", metavar="KEY=VALUE")
    calibration: Path | None = option(
        None,
        "calibration file of the real sensors (default: that of the bags, else ordinary tolerances)",
        metavar="FILE",
    )
    device: str = device_option()
    latency_blocks: int = latency_option()
    allow_own_model: bool = option(False, "accept a rig or recordings that equal the model, which have no gap")
    seed: int = option(0, "seed of the real rig's noise (default: 0); each test adds its number", metavar="N")
    jobs: int | None = jobs_option()
    quiet: bool = option(False, "no progress display")


def run(options: InvestigateOptions) -> int:
    """Investigate, write the results, print what was asked and what it told.

    Returns:
        0 if the gap has a name or there is none, 3 if something is left open, 130 after Ctrl-C.

    Raises:
        BenchError: an option, a rig or a test is refused; what was measured is kept.
    """
    if (options.rig is None) == (not options.real):
        raise BenchError("Give either --rig with the rig that is to be driven, or --real with recordings of it.")
    if not 0.5 < options.until < 1.0:
        raise BenchError(f"--until is a probability between 0.5 and 1, got {options.until:g}.")
    if options.budget is not None and not options.budget > 0.0:
        raise BenchError(f"--budget must be positive, got {options.budget:g} s.")
    if options.periods < 2 or (options.random is not None and not 0.0 < options.random < math.inf) or options.seed < 0:
        raise BenchError("--periods must be 2 or more, --random positive and finite and --seed not negative.")
    jobs = worker_count(options)
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    from nmt_bench.commands.console import make_console
    from nmt_diagnose.investigation.investigation_record import RECORD_FILE, InvestigationRecord, read_record
    from nmt_record.exchange.sidecar.calibration_file import read_calibration
    from nmt_rig.rig import load_rig

    console = make_console()
    model = load_rig(options.model, vibrating=False)
    bags = tuple(str(path.resolve()) for path in options.real)
    known = "" if options.calibration is None else str(options.calibration.resolve())
    asked = InvestigationRecord(options.model, options.rig or "", options.set, bags, known)
    try:
        made = not options.out.exists()
    except OSError as error:
        raise _no_folder(options.out, error) from error
    record = read_record(options.out) or asked
    if options.page and options.real:
        raise BenchError("--page is of an investigation with --rig; with --real nothing is run.")
    calibration = None if options.calibration is None else read_calibration(options.calibration)
    same = all(getattr(record, key) == getattr(asked, key) for key in ("model", "real", "changes", "calibration"))
    if not same or not set(record.bags) <= set(bags):
        raise BenchError(
            f"{options.out / RECORD_FILE} is of another model, rig, calibration file or other recordings; give another "
            "folder with --out."
        )
    settings = None if options.rig is None else _settings(options, model)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _no_folder(options.out, error) from error
    if not made and not (options.out / RECORD_FILE).exists() and any(options.out.iterdir()):
        raise BenchError(f"The folder {options.out} holds something else; choose another one with --out.")
    bench = _Bench(options, model, jobs, console, calibration)
    if settings is None:
        try:
            record = bench.propose(replace(record, bags=bags, ended="", conclusion=""))
        finally:
            if made and not any(options.out.iterdir()):
                options.out.rmdir()
        bench.show(record)
        return EXIT_DONE
    # What ended for want of time or by a person may go on.
    reopened = replace(record, ended="", conclusion="") if record.ended in ("budget", "stopped") else record
    try:
        with terminate_as_interrupt():
            record = bench.investigate(reopened, settings)
    except KeyboardInterrupt:
        console.print(
            f"Stopped; the drive is at zero. The same command goes on from {options.out / RECORD_FILE}.",
            soft_wrap=True,
        )
        return EXIT_INTERRUPTED
    bench.show(record)
    return EXIT_DONE if record.ended in ("named", "no_gap", "recalibrated") else EXIT_PARTLY


def _no_folder(folder: Path, error: OSError) -> BenchError:
    return BenchError(f"The folder {folder} cannot be made ({error.strerror}); choose another one.")


def _settings(options: InvestigateOptions, model: Rig) -> InvestigationSettings:
    """How it goes about, once the rig takes its tests.

    Raises:
        BenchError: the rig is the model itself, or refuses a level, a window or its device.
    """
    from nmt_bench.commands.hardware_options import device_settings
    from nmt_diagnose.investigation.investigation import InvestigationSettings
    from nmt_diagnose.observations.origin import same_rig
    from nmt_rig.device_sections import DEVICE_KINDS
    from nmt_rig.rig import load_rig
    from nmt_sequencer.level_plan import parse_levels
    from nmt_session.planning import plan_test

    name = str(options.rig)
    rig = load_rig(name, options.set)
    levels = tuple(sorted(set(parse_levels(options.levels or rig.test.levels))))
    bench = device_settings(_Driven(name, options.set, options.device), options.latency_blocks)
    plan = plan_test(name, levels, overrides=options.set, window_periods=options.periods, **bench)
    for number, ratio in enumerate(plan.used_linear.damping_ratios if plan.used_linear is not None else (), 1):
        if ratio <= 0.0:
            raise BenchError(
                f"Mode {number} of {name} feeds its motion (damping {100.0 * ratio:.2g} %), and an investigation "
                "drives structures that rest without a drive; measure it by './nmt run --kind self_excited'."
            )
    band = 0.1 * rig.sample_rate_hz, 0.2 * rig.sample_rate_hz
    random_s = random_length(plan.used_linear) if options.random is None else options.random
    plan_test(name, [levels[0]], overrides=options.set, test="random", band_hz=band, duration=random_s, **bench)
    hardware = bench.get("device", "") in DEVICE_KINDS
    if not hardware and not options.allow_own_model and same_rig(model, rig):
        raise BenchError(
            f"The rig {name} is the model itself, so there is no gap to look for: change something of it with --set, "
            "or give --allow-own-model to see what a rig without a gap looks like."
        )
    return InvestigationSettings(
        until=options.until,
        budget_s=math.inf if options.budget is None else options.budget,
        levels=levels,
        periods=options.periods,
        random_s=random_s,
        fixed_exciter=not options.ask and hardware,
    )


def random_length(linear: LinearDescription | None) -> float:
    """Length of a record, s, whose lines lie dense enough on the narrowest mode from the one under test on."""
    shortest, longest = _RANDOM_S
    if linear is None:
        return shortest
    omega, ratios = (values[linear.target_mode :] for values in (linear.frequencies_rad_s, linear.damping_ratios))
    widths = [2.0 * ratio * w / (2.0 * math.pi) for w, ratio in zip(omega, ratios, strict=True) if ratio * w > 0.0]
    return min(max(_RESOLVED / min(widths, default=math.inf), shortest), longest)


@dataclass(frozen=True)
class _Driven:
    """What every test drives, as a command of the bench gets it."""

    rig: str
    set: tuple[str, ...]
    device: str
    exciter: int | None = None
    pacing: str = "lockstep"


class _Bench:
    """Carries tests out by the commands of the bench, each in a process of its own, and diagnoses them.

    Args:
        options: of the command.
        model: the model.
        jobs: processes of a diagnosis.
        console: shows what is done.
        calibration: sheet of the real side's sensors; None = what its recordings say.
    """

    def __init__(
        self,
        options: InvestigateOptions,
        model: Rig,
        jobs: int,
        console: Any,
        calibration: CalibrationSheet | None = None,
    ) -> None:
        from nmt_bench.page.task_answers import TaskAnswers
        from nmt_bench.page.task_feed import TaskFeed
        from nmt_diagnose.search.memory import Memory

        self._options, self._model, self._jobs, self._console = options, model, jobs, console
        self._calibration = calibration
        self._plan: tuple[float, ...] = ()
        self._outcome: Any = None
        self._memory = Memory()
        self._feed = TaskFeed()
        self._answers = TaskAnswers()

    def investigate(self, record: InvestigationRecord, settings: InvestigationSettings) -> InvestigationRecord:
        """Go on with an investigation to its end; its report is written whatever ends it."""
        from nmt_bench.page.task_answers import TaskAnswers
        from nmt_bench.page.task_feed import task_page
        from nmt_diagnose.investigation.investigation import YES, Investigation

        self._plan = settings.levels
        agree = self._agree if self._options.ask else (lambda _: YES)
        title = f"Investigation of {Path(record.real).stem}"
        with task_page(self._options.page, title, self._console) as self._feed:
            self._answers = TaskAnswers(self._feed.answers)
            found = Investigation(
                record, settings, self._options.out, self._measure, self._think, agree, self._command, self._say,
                self._tell_page, self._look,
            )  # fmt: skip
            self._tell_page(record)
            try:
                return found.run()
            finally:
                self._write(found.record)
                self._feed.tell(outcome=found.record.conclusion[:250])

    def _tell_page(self, record: InvestigationRecord) -> None:
        """What was asked and learnt so far."""
        from nmt_diagnose.effects.location import effect_words
        from nmt_report.investigation_report import shown_answers, tests_table

        names = shown_answers(record) if record.turns else []
        self._feed.tell(
            timeline={
                effect_words(name): [
                    [round(turn.bench_s, 1), round(turn.answers.get(name, 0.0), 3)] for turn in record.turns[-20:]
                ]
                for name in names
            }
        )
        rows = [(str(row.cells[0]), " · ".join(map(str, row.cells[1:]))) for row in tests_table(record).rows]
        self._feed.table(("Test", "What, why; bench time; expected and received information; state"), rows[-12:])

    def propose(self, record: InvestigationRecord) -> InvestigationRecord:
        """Diagnose the recordings and put the proposed tests into the record."""
        from nmt_diagnose.investigation.investigation import proposed

        record = proposed(record, self._think)
        record.write(self._options.out)
        self._write(record)
        return record

    def _measure(self, test: AskedTest) -> tuple[float, float]:
        return measure(test, self._options.out, self._options.seed, self._say, self._bench_words(test.request))

    def _bench_words(self, request: TestRequest) -> tuple[str, ...]:
        """Options that say on what bench every test is made."""
        options = self._options
        words = [word for change in options.set for word in ("--set", change)]
        words += ["--device", options.device] if options.device else []
        latency = options.latency_blocks and not isinstance(request.kind, RandomTest)
        return (*words, *(("--latency-blocks", str(options.latency_blocks)) if latency else ()))

    def _command(self, request: TestRequest) -> str:
        return f"./nmt {shlex.join((*command_words(request), *self._bench_words(request)))}"

    def _think(self, names: Sequence[str]) -> tuple[Diagnosis, float]:
        from nmt_diagnose.diagnose import diagnose_bags
        from nmt_diagnose.diagnosis_settings import DiagnosisSettings

        bags = [self._options.out / name for name in names] or list(self._options.real)
        began = _processor_time()
        settings = DiagnosisSettings(
            jobs=self._jobs,
            plan=self._plan,
            calibration=self._calibration,
            put_off_detectable=True,
            command=command_text,
            allow_own_model=self._options.allow_own_model,
        )
        self._outcome = diagnose_bags(self._model, bags, settings=settings, memory=self._memory)
        return self._outcome.diagnosis, _processor_time() - began

    def _look(self) -> str:
        """What the recordings of the last diagnosis say against having no gap."""
        from nmt_diagnose.investigation.checks import none_contradicted

        found = self._outcome
        return none_contradicted(found.observations, found.final, found.observations.matters)

    def _agree(self, test: AskedTest) -> str:
        seconds = f", {test.seconds:.0f} s" if math.isfinite(test.seconds) else ""
        self._console.print(f"{test.text}{seconds}: {test.why}.\n  {test.command}", soft_wrap=True)
        self._feed.tell(question=f"{test.text}{seconds}: {test.why}.")
        answer = self._answers.wait("Run it? yes, no (another one) or stop: ")
        self._feed.tell(question="")
        return answer

    def _say(self, sentence: str) -> None:
        self._feed.step(sentence)
        if not self._options.quiet:
            self._console.print(sentence, soft_wrap=True)

    def _write(self, record: InvestigationRecord) -> None:
        from nmt_core.files.whole_file import write_result
        from nmt_report.diagnosis_files import write_diagnosis
        from nmt_report.investigation_report import investigation_page

        out = self._options.out
        if self._outcome is not None:
            (out / "diagnosis").mkdir(exist_ok=True)
            self._outcome = self._outcome.completed()
            write_diagnosis(self._outcome, out / "diagnosis", self._options.model)
        elif record.ended and (out / "report.html").exists():
            return  # nothing was done, and the page of the call that ended it has what it drew
        write_result(out / "report.html", investigation_page(record, self._outcome))

    def show(self, record: InvestigationRecord) -> None:
        """Print the tests with what they told, and how it ended."""
        from rich.box import SIMPLE_HEAD
        from rich.table import Table

        from nmt_report.investigation_report import ENDS, tests_table

        found = tests_table(record)
        table = Table(box=SIMPLE_HEAD)
        for column in found.columns:
            table.add_column(f"{column.heading}\n{column.unit}" if column.unit else column.heading)
        for row in found.rows:
            table.add_row(*map(str, row.cells))
        if record.tests:
            self._console.print(table)
        sentence, kind = ENDS[record.ended]
        style = {"good": "bold green", "partly": "bold yellow", "bad": "bold red"}[kind]
        self._console.print(f"{sentence}.", style=style)
        self._console.print(record.conclusion, soft_wrap=True)
        if record.ended == "proposed":
            for test in record.tests:
                if test.state == "asked":
                    self._console.print(test.command or f"{test.text}, on the rig", soft_wrap=True)
        self._console.print(f"Report: {(self._options.out / 'report.html').resolve()}", soft_wrap=True)


def measure(
    test: AskedTest,
    out: Path,
    seed: int = 0,
    say: Callable[[str], None] = lambda _: None,
    options: Sequence[str] = (),
) -> tuple[float, float]:
    """Run the command of a test in a process of its own; its bench time, s, and the highest level that locked.

    Args:
        test: its name is that of the folder.
        out: gets the folder, and the log next to it.
        seed: of the rig's noise, to which the number of the test is added.
        say: called with a sentence.
        options: further words, of the bench that does it.

    Raises:
        EmptyTestError: it was carried out, and no level of it locked.
        FailedError: it was refused, or it failed.
    """
    from nmt_diagnose.investigation.investigation_record import EmptyTestError

    folder, log = out / test.name, out / f"{test.name}.log"
    number = int(test.name.split("_")[0])
    words = [*command_words(test.request), *options, "--out", str(folder), "--quiet", "--seed", str(seed + number)]
    words += ["--reference", "none"]
    with log.open("w", encoding="utf-8") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "nmt_bench", *words], stdin=subprocess.DEVNULL, stdout=file, stderr=file,
            preexec_fn=_begin_test,
        )  # fmt: skip
        try:
            code = process.wait()
        except KeyboardInterrupt:
            say("ending the test by its ramp")
            process.send_signal(signal.SIGINT)
            process.wait()
            raise
    if code not in (EXIT_DONE, EXIT_PARTLY):
        result = _result(folder)
        if result.get("code") == "SUCCEEDED" and str(result.get("message", "")).startswith("0 of "):
            raise EmptyTestError(
                f"No level of test {test.name} locked; it is left out. See {log}.", _bench_time(folder)
            )
        why = reason_of_failure(log.read_text(encoding="utf-8", errors="replace"), result) or f"it ended with {code}"
        raise FailedError(
            f"Test {test.name} failed: {why.rstrip('.')}; its drive is at zero, and what it recorded is left out. See "
            f"{log}; the same command tries it again."
        )
    return _bench_time(folder), math.nan if test.is_random else _highest_locked(folder)


def reason_of_failure(log: str, result: Mapping[str, Any]) -> str:
    """Why a command failed; empty where nothing says so.

    Args:
        log: what it printed. Its first refusal is the cause of whatever follows.
        result: of ``run.json``.
    """
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    refused = next((line.removeprefix("nmt: ") for line in lines if line.startswith("nmt: ")), "")
    failed = str(result.get("message", "")) if result.get("code") != "SUCCEEDED" else ""
    return refused or failed or (lines[-1] if lines else "")


def _highest_locked(folder: Path) -> float:
    """Highest level of a run that has a frequency; NaN where none has."""
    try:
        with (folder / "modal.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        levels = [float(row["level"]) for row in rows if math.isfinite(float(row["frequency_hz"]))]
    except (OSError, ValueError, KeyError):
        return math.nan
    return max(levels, default=math.nan)


def _begin_test() -> None:
    """In a group of its own, so that Ctrl-C reaches it once, and ended by its ramp when this process dies."""
    from nmt_core.processes.process_end import begin_group

    begin_group()


def _processor_time() -> float:
    """Of this process and of those that it has waited for, s."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _result(folder: Path) -> dict[str, Any]:
    """How a test ended; empty where nothing says so."""
    try:
        return dict(json.loads((folder / "run.json").read_text(encoding="utf-8"))["result"])
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _bench_time(folder: Path) -> float:
    try:
        return float(_result(folder)["bench_time_s"])
    except (ValueError, KeyError, TypeError):
        return 0.0
