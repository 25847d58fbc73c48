"""Runs the cases of another laboratory through import and diagnosis as a user would, and tabulates the answers."""

from __future__ import annotations

import hashlib
import json
import math
import os
import resource
import shutil
import signal
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nmt_blind.campaign.foreign_case import (
    CLASSES,
    TRUTH_FILE,
    ForeignAnswer,
    ForeignCase,
    contradictions,
    judge,
    read_cases,
)
from nmt_blind.campaign.frozen import diagnosis_digest
from nmt_blind.campaign.scored_case import ALARMS
from nmt_blind.campaign.statistics import ReliabilityDiagram, reliability
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json
from nmt_core.files.whole_file import csv_text, write_result
from nmt_core.processes.workers import worked

RESULT_FORMAT = "nmt foreign result 1"
_RESULT, _DIAGNOSIS = "result.json", "diagnosis"
_ONE_CORE = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_TROUBLE = 400  # characters of an error that are kept


@dataclass(frozen=True)
class ForeignLine:
    """A case in the table.

    Attributes:
        case: its name.
        kind: of its truth.
        truth: the true set of effects, or the verdicts that are right.
        answer: what was said, and what it is worth.
        seconds: processor time of the diagnosis, s; NaN if there was none.
        import_seconds: processor time of the imports, s.
        trouble: why there is no diagnosis.
        kept: from an earlier run.
        contradictions: where the parts of the diagnosis say different things.
    """

    case: str
    kind: str
    truth: str
    answer: ForeignAnswer
    seconds: float
    import_seconds: float
    trouble: str = ""
    kept: bool = False
    contradictions: tuple[str, ...] = ()


def run_laboratory(
    folder: Path,
    out: Path,
    command: Sequence[str],
    jobs: int = 1,
    only: Sequence[str] = (),
    force: bool = False,
    limit: float = 1800.0,
    keep_bags: bool = False,
    progress: Callable[[int, int, str], None] = lambda done, total, case: None,
) -> list[ForeignLine]:
    """Import and diagnose every case that this program has not diagnosed yet, and class all answers.

    A result counts as long as the program (rig, record, extract, diagnose) and the case's files other than its truth
    are the same. Truths are read anew each time, so that a corrected one needs no new diagnosis.

    Args:
        folder: of the laboratory, see :func:`read_cases`.
        out: gets a folder for each case, ``laboratory.csv`` and ``laboratory.json``.
        command: words that start the program, to which ``import`` or ``diagnose`` and their options are added.
        jobs: cases at a time.
        only: names of cases; empty = all.
        force: diagnose cases that have a result, too.
        limit: processor time of an import or a diagnosis, s; beyond it there is no diagnosis.
        keep_bags: keep what was imported.
        progress: called with cases done, cases in all and a line on the newest case.

    Returns:
        A line for each case, by name.

    Raises:
        BenchError: there is no such case, a truth has a mistake, or the folder for the results cannot be written.
    """
    cases = _chosen(read_cases(folder), only, folder)
    program = diagnosis_digest()
    work, stored = [], {}
    for case in cases:
        case_folder = out.absolute() / case.name
        files = case_digest(case.folder)
        before = None if force else _stored(case_folder, program, files)
        if before is None:
            arguments = program, files, case_folder, tuple(command), limit, keep_bags
            work.append((case.folder.absolute(), case.sidecars, case.model.absolute(), *arguments))
        else:
            stored[case.name] = before
    kept = set(stored)
    progress(len(kept), len(cases), "")
    truths = {case.name: case for case in cases}
    for result in worked(diagnose_foreign, work, jobs, ""):
        name = str(result["case"])
        stored[name] = result
        progress(len(stored), len(cases), _said(_line(truths[name], result, out, False)))
    return [_line(case, stored[case.name], out, case.name in kept) for case in cases]


def diagnose_foreign(
    folder: Path,
    sidecars: Sequence[Path],
    model: Path,
    program: str,
    files: str,
    case_folder: Path,
    command: Sequence[str],
    limit: float,
    keep_bags: bool,
) -> dict[str, Any]:
    """Import and diagnose one case in processes of their own, and keep the result; a failure is a result, too.

    Returns:
        What was written as ``result.json``.
    """
    case_folder.mkdir(parents=True, exist_ok=True)
    (case_folder / _RESULT).unlink(missing_ok=True)
    shutil.rmtree(case_folder / _DIAGNOSIS, ignore_errors=True)
    wall = time.monotonic()
    result: dict[str, Any] = {"format": RESULT_FORMAT, "case": folder.name, "program": program, "files": files}
    bags, trouble = [], ""
    result["import_seconds"] = result["seconds"] = 0.0
    for sidecar in sidecars:
        bags.append(case_folder / f"imported-{sidecar.stem}")
        words = ["import", str(sidecar.absolute()), "--out", str(bags[-1]), "--force"]
        seconds, trouble = child([*command, *words], limit)
        result["import_seconds"] += seconds
        if trouble:
            break
    else:
        words = [
            "diagnose",
            "--model",
            str(model),
            "--out",
            str(case_folder / _DIAGNOSIS),
            "--quiet",
            "--force",
            "--jobs",
            "1",
        ]
        real = [word for bag in bags for word in ("--real", str(bag))]
        result["seconds"], trouble = child([*command, *words, *real], limit)
    if not keep_bags:
        for bag in bags:
            shutil.rmtree(bag, ignore_errors=True)
    result |= {"trouble": trouble, "wall_seconds": round(time.monotonic() - wall, 2)}
    result |= {key: round(result[key], 2) for key in ("seconds", "import_seconds")}
    write_result(case_folder / _RESULT, json.dumps(result, indent=1, ensure_ascii=False) + "\n")
    return result


def case_digest(folder: Path) -> str:
    """SHA-256 over the files of a case by name and content, without its truth."""
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file() and path.name != TRUTH_FILE):
        digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
        sha256 = hashlib.sha256()
        with path.open("rb") as file:
            while block := file.read(2**20):
                sha256.update(block)
        digest.update(sha256.digest())
    return digest.hexdigest()


def summary(lines: Sequence[ForeignLine]) -> dict[str, Any]:
    """Counts of the classes, shares, alarms among healthy rigs, and processor times in s."""
    counts = {name: sum(line.answer.outcome == name for line in lines) for name in CLASSES}
    healthy = [line for line in lines if line.kind == "healthy"]
    times = [line.seconds for line in lines if line.answer.outcome != "refused"]
    deviations = [abs(line.answer.deviation) for line in lines if not math.isnan(line.answer.deviation)]
    return {
        "cases": len(lines),
        "classes": counts,
        "share_right": counts["right"] / len(lines) if lines else math.nan,
        "share_right_or_hedged": (counts["right"] + counts["hedged right"]) / len(lines) if lines else math.nan,
        "healthy": len(healthy),
        "alarms": sum(line.answer.verdict in ALARMS for line in healthy),
        "contradictory": sum(bool(line.contradictions) for line in lines),
        "parameters": len(deviations),
        "parameters_within_3": sum(deviation <= 3.0 for deviation in deviations),
        "calibration_error": _reliability(lines).error,
        "brier": _brier(lines),
        "sets_that_hold_the_truth": sum(line.answer.held for line in lines),
        "mean_size_of_sets": _mean([line.answer.credible for line in lines if line.answer.credible]),
        "seconds_median": statistics.median(times) if times else math.nan,
        "seconds_worst": max(times, default=math.nan),
    }


_RIGHT = ("right", "hedged right")


def _stated(lines: Sequence[ForeignLine]) -> tuple[list[float], list[bool]]:
    """Probability of the first answer and whether it is right, of all cases with an answer."""
    told = [line.answer for line in lines if not math.isnan(line.answer.probability)]
    return [answer.probability for answer in told], [answer.outcome in _RIGHT for answer in told]


def _reliability(lines: Sequence[ForeignLine]) -> ReliabilityDiagram:
    return reliability(*_stated(lines), bins=5)


def _brier(lines: Sequence[ForeignLine]) -> float:
    """Mean square of what the stated probability is off: 0 = certain and right, 0.25 = a coin's."""
    return _mean([(p - float(right)) ** 2 for p, right in zip(*_stated(lines), strict=True)])


def _mean(values: Sequence[float]) -> float:
    return statistics.fmean(values) if values else math.nan


def print_lines(lines: Sequence[ForeignLine]) -> list[str]:
    """The table and its summary as lines of text."""
    head = ("case", "class", "truth", "verdict", "effect", "place", "p", "parameter", "closed", "CPU s")
    rows = [head, *(_cells(line) for line in lines)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    text = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    text[1:1] = ["  ".join("-" * width for width in widths)]
    text += ["", *(f"{line.case}: {line.trouble}" for line in lines if line.trouble)]
    text += [f"{line.case}: {sentence}" for line in lines for sentence in line.contradictions]
    found = summary(lines)
    counts = ", ".join(f"{name} {count}" for name, count in found["classes"].items())
    text += [
        f"{found['cases']} cases: {counts}",
        f"right or hedged right {_percent(found['share_right_or_hedged'])}, right {_percent(found['share_right'])}; "
        f"alarms in {found['alarms']} of {found['healthy']} healthy",
        f"parameters within 3 stated standard deviations: {found['parameters_within_3']} of {found['parameters']}",
        f"diagnoses whose parts say different things: {found['contradictory']} of {len(lines)}",
        "stated probability of the first answer, how often it is right: " + _reliability_words(lines),
        f"expected calibration error {_text(found['calibration_error'], 3)}, Brier score {_text(found['brier'], 3)}; "
        f"answers stated at 95 %: {found['sets_that_hold_the_truth']} of {found['cases']} hold the truth, "
        f"mean size {_text(found['mean_size_of_sets'], 2)}",
        f"processor time of a diagnosis: median {_text(found['seconds_median'], 1)} s, "
        f"worst {_text(found['seconds_worst'], 1)} s",
    ]
    return text


def _reliability_words(lines: Sequence[ForeignLine]) -> str:
    table = _reliability(lines)
    return ", ".join(
        f"{stated:.2f}: {right:.2f} ({count})"
        for stated, right, count in zip(table.stated, table.right, table.counts, strict=True)
    )


def write_tables(lines: Sequence[ForeignLine], out: Path) -> tuple[Path, Path]:
    """Write ``laboratory.csv`` and ``laboratory.json``.

    Raises:
        BenchError: one cannot be written.
    """
    fields = (
        "outcome", "verdict", "effect", "place", "probability", "adequate", "parameter", "deviation", "closed",
        "credible", "held",
    )  # fmt: skip
    entries = [
        {"case": line.case, "kind": line.kind, "truth": line.truth}
        | {name: getattr(line.answer, name) for name in fields}
        | {"seconds": line.seconds, "import_seconds": line.import_seconds, "trouble": line.trouble}
        for line in lines
    ]
    files = out / "laboratory.csv", out / "laboratory.json"
    write_result(files[0], csv_text([list(entries[0]), *(list(entry.values()) for entry in entries)]))
    content = {"format": "nmt laboratory 1", "program": diagnosis_digest(), "summary": summary(lines), "cases": entries}
    write_result(files[1], json.dumps(_finite(content), indent=1, ensure_ascii=False) + "\n")
    return files


def child(
    words: Sequence[str], limit: float, accepted: Sequence[int] = (0,), folder: Path | None = None
) -> tuple[float, str]:
    """Run a command; its processor time in s, and in a sentence why it failed, empty where it did not.

    Args:
        words: of the command.
        limit: of its processor time, s; infinite = none.
        accepted: exit codes that are no failure.
        folder: to run it in; None = this process's own.
    """
    ceiling = max(1, math.ceil(limit)) if math.isfinite(limit) else 0

    def bounded() -> None:
        if ceiling:
            resource.setrlimit(resource.RLIMIT_CPU, (ceiling, ceiling + 30))

    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            list(words),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, **_ONE_CORE},
            cwd=folder,
            preexec_fn=bounded,
        )
        try:
            # Of this child and of what it has waited for, whatever other children this process has.
            _, status, usage = os.wait4(process.pid, 0)
        except BaseException:
            process.kill()
            process.wait()
            raise
        code = process.returncode = os.waitstatus_to_exitcode(status)
        seconds = usage.ru_utime + usage.ru_stime
        if code in accepted:
            return seconds, ""
        if ceiling and code in (-signal.SIGXCPU, -signal.SIGKILL) and seconds > ceiling - 1:
            return seconds, f"ended after {ceiling} s of processor time, the limit"
        output.seek(0)
        lines = output.read().decode(errors="replace").strip().splitlines()
    return seconds, (lines[-1].strip()[:_TROUBLE] if lines else f"ended with {code}")


def _chosen(cases: list[ForeignCase], only: Sequence[str], folder: Path) -> list[ForeignCase]:
    unknown = sorted(set(only) - {case.name for case in cases})
    if unknown:
        raise BenchError(f"There is no case {unknown[0]} in {folder}; it has {', '.join(case.name for case in cases)}.")
    return [case for case in cases if not only or case.name in only]


def _stored(case_folder: Path, program: str, files: str) -> dict[str, Any] | None:
    """The result of an earlier run by the same program from the same files, if there is one."""
    try:
        result = read_json(case_folder / _RESULT, "result")
    except BenchError:
        return None
    same = result.get("format") == RESULT_FORMAT and (result.get("program"), result.get("files")) == (program, files)
    return result if same else None


def _line(case: ForeignCase, result: dict[str, Any], out: Path, kept: bool) -> ForeignLine:
    trouble, diagnosis = str(result["trouble"]), None
    if not trouble:
        try:
            diagnosis = read_json(out / case.name / _DIAGNOSIS / "diagnosis.json", "diagnosis")
        except BenchError as error:
            trouble = str(error)
    truth = case.truth
    named = " | ".join(" + ".join(sorted(effects)) for effects in truth.effects) or " | ".join(truth.verdicts)
    place = f" @ {', '.join(truth.place)}" if truth.place else ""
    seconds = (float(result["seconds"]), float(result["import_seconds"]))
    differ = () if diagnosis is None else contradictions(diagnosis)
    answer = judge(truth, diagnosis)
    return ForeignLine(case.name, truth.kind, f"{named}{place}", answer, *seconds, trouble, kept, differ)


def _cells(line: ForeignLine) -> tuple[str, ...]:
    answer = line.answer
    off = f"{answer.parameter} {answer.deviation:+.1f} σ" if answer.parameter else ""
    effect = answer.effect + ("" if answer.adequate else " (partial)" if answer.effect else "")
    closed = "" if math.isnan(answer.closed) else _percent(answer.closed)
    return (
        line.case, answer.outcome, line.truth, answer.verdict, effect, answer.place, _text(answer.probability, 3), off,
        closed, _text(line.seconds, 1),
    )  # fmt: skip


def _said(line: ForeignLine) -> str:
    answer = line.answer
    what = " ".join(filter(None, (answer.verdict, answer.effect))) or line.trouble
    return f"{line.case}: {answer.outcome} ({what}), {line.seconds:.1f} s"


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else f"{100.0 * share:.1f} %"


def _text(value: float, digits: int) -> str:
    return "" if math.isnan(value) else f"{value:.{digits}f}"


def _finite(value: Any) -> Any:
    """The value with None for what JSON has no number for."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
