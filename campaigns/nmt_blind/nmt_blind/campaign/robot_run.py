"""Runs cases of robots through ``./nmt diagnose`` and through a plain fit, and tabulates the answers."""

from __future__ import annotations

import json
import math
import shutil
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nmt_blind.campaign.foreign_run import case_digest, child
from nmt_blind.campaign.frozen import diagnosis_digest
from nmt_blind.campaign.plain_robot_fit import plain_claims
from nmt_blind.campaign.robot_case import (
    ROBOT_FILE,
    SIDECAR,
    Claims,
    RobotAnswer,
    RobotCase,
    claims_of,
    counts_of,
    judge_robot,
    read_robot_cases,
)
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json
from nmt_core.files.whole_file import csv_text, write_result
from nmt_core.processes.workers import worked

RESULT_FORMAT = "nmt robot result 1"
_RESULT, _DIAGNOSIS = "result.json", "diagnosis"


@dataclass(frozen=True)
class RobotLine:
    """A case in the table: its kind and truth, the answer and that of the plain fit, processor time in s, trouble."""

    case: str
    kind: str
    truth: str
    claims: str
    answer: RobotAnswer
    plain: RobotAnswer
    seconds: float
    trouble: str = ""


def run_robots(
    folder: Path,
    out: Path,
    command: Sequence[str],
    jobs: int = 1,
    only: Sequence[str] = (),
    force: bool = False,
    limit: float = 1800.0,
    progress: Callable[[int, int, str], None] = lambda done, total, case: None,
) -> list[RobotLine]:
    """Diagnose every case that this program has not diagnosed yet, and class all answers; arguments as of
    :func:`nmt_blind.campaign.foreign_run.run_laboratory`.

    Raises:
        BenchError: there is no such case, a truth has a mistake, or the folder for the results cannot be written.
    """
    cases = [case for case in read_robot_cases(folder) if not only or case.name in only]
    if not cases:
        raise BenchError(f"There is no such case in {folder}.")
    program = diagnosis_digest()
    work, stored = [], {}
    for case in cases:
        case_folder = out.absolute() / case.name
        files = case_digest(case.folder)
        before = None if force else _stored(case_folder, program, files)
        if before is None:
            work.append((case.folder.absolute(), case_folder, program, files, tuple(command), limit))
        else:
            stored[case.name] = before
    progress(len(stored), len(cases), "")
    by_name = {case.name: case for case in cases}
    for result in worked(_diagnosed, work, jobs, ""):
        name = str(result["case"])
        stored[name] = result
        line = _line(by_name[name], result, out)
        progress(len(stored), len(cases), f"{name}: {line.answer.outcome} ({line.truth}), {line.seconds:.1f} s")
    return [_line(case, stored[case.name], out) for case in cases]


def _diagnosed(
    folder: Path, case_folder: Path, program: str, files: str, command: Sequence[str], limit: float
) -> dict[str, Any]:
    """Diagnose one case in a process of its own, and keep the result; a failure is a result, too."""
    case_folder.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(case_folder / _DIAGNOSIS, ignore_errors=True)
    words = ["diagnose", "--model", str(folder / ROBOT_FILE), "--real", str(folder / SIDECAR), "--quiet", "--force"]
    seconds, trouble = child([*command, *words, "--out", str(case_folder / _DIAGNOSIS)], limit)
    plain = plain_claims(folder / ROBOT_FILE, folder / SIDECAR)
    result = {
        "format": RESULT_FORMAT, "case": folder.name, "program": program, "files": files, "trouble": trouble,
        "seconds": round(seconds, 2), "plain": [list(term) for term in plain.terms],
    }  # fmt: skip
    write_result(case_folder / _RESULT, json.dumps(result, indent=1, ensure_ascii=False) + "\n")
    return result


def _stored(case_folder: Path, program: str, files: str) -> dict[str, Any] | None:
    """The result of an earlier run by the same program from the same files, if there is one."""
    try:
        result = read_json(case_folder / _RESULT, "result")
    except BenchError:
        return None
    same = result.get("format") == RESULT_FORMAT and (result.get("program"), result.get("files")) == (program, files)
    return result if same else None


def _line(case: RobotCase, result: dict[str, Any], out: Path) -> RobotLine:
    trouble, words, answer = str(result["trouble"]), "", RobotAnswer("refused")
    if not trouble:
        claims = claims_of(read_json(out / case.name / _DIAGNOSIS / "diagnosis.json", "diagnosis"))
        words, answer = claims.text, judge_robot(case, claims)
    plain = judge_robot(case, Claims(tuple((str(j), str(k)) for j, k in result["plain"]), (), {}))
    return RobotLine(case.name, case.kind, case.truth, words, answer, plain, float(result["seconds"]), trouble)


def summary_lines(lines: Sequence[RobotLine]) -> list[str]:
    """The table and its counts as lines of text."""
    head = ("case", "class", "truth", "claims", "why", "σ", "plain fit", "CPU s")
    rows = [head]
    for line in lines:
        off = "" if math.isnan(line.answer.deviation) else f"{line.answer.deviation:+.1f}"
        rows.append(
            (line.case, line.answer.outcome, line.truth, line.claims, line.answer.reason, off, line.plain.outcome,
             f"{line.seconds:.1f}")
        )  # fmt: skip
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    text = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    text += ["", *(f"{line.case}: {line.trouble}" for line in lines if line.trouble)]
    kinds = list(dict.fromkeys(line.kind for line in lines))
    for kind in [*kinds, "all"]:
        chosen = [line for line in lines if kind in (line.kind, "all")]
        for name, outcomes in (
            ("diagnosis", [line.answer.outcome for line in chosen]),
            ("plain fit", [line.plain.outcome for line in chosen]),
        ):
            counts = ", ".join(f"{outcome} {count}" for outcome, count in counts_of(outcomes).items())
            text.append(f"{kind}, {len(chosen)} cases, {name}: {counts}")
    times = [line.seconds for line in lines]
    text.append(f"processor time: median {statistics.median(times):.1f} s, worst {max(times):.1f} s")
    return text


def write_robot_tables(lines: Sequence[RobotLine], out: Path) -> tuple[Path, Path]:
    """Write ``laboratory.csv`` and ``laboratory.json``.

    Raises:
        BenchError: one cannot be written.
    """
    entries = [
        {
            "case": line.case, "kind": line.kind, "truth": line.truth, "outcome": line.answer.outcome,
            "claims": line.claims, "reason": line.answer.reason,
            "deviation": None if math.isnan(line.answer.deviation) else round(line.answer.deviation, 2),
            "plain_fit": line.plain.outcome, "seconds": line.seconds, "trouble": line.trouble,
        }
        for line in lines
    ]  # fmt: skip
    files = out / "laboratory.csv", out / "laboratory.json"
    write_result(files[0], csv_text([list(entries[0]), *(list(entry.values()) for entry in entries)]))
    counts = {
        "diagnosis": counts_of(line.answer.outcome for line in lines),
        "plain_fit": counts_of(line.plain.outcome for line in lines),
    }
    content = {
        "format": "nmt laboratory of robots 1",
        "program": diagnosis_digest(),
        "summary": counts,
        "cases": entries,
    }
    write_result(files[1], json.dumps(content, indent=1, ensure_ascii=False) + "\n")
    return files
