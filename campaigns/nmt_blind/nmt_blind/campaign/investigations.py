"""Investigations of sealed rigs compared with a fixed plan: bench time to the answer, its worth, and what was learnt.

The fixed plan is what the bench's defaults make of "measure everything, then diagnose": the linear test, ten levels,
a random record at a low and one at a high level, and the ordinary diagnosis of all of it.
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_blind.campaign.foreign_case import CLASSES, ForeignAnswer, ForeignTruth, judge, read_truth
from nmt_blind.campaign.foreign_run import child
from nmt_blind.campaign.frozen import diagnosis_digest
from nmt_blind.cases.draw import SIZES
from nmt_blind.cases.driven_rigs import LEAST_SIZE, DrivenRig, read_rigs
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json
from nmt_core.files.whole_file import csv_text, write_result, write_whole
from nmt_diagnose.investigation.answers import entropy_of
from nmt_diagnose.ledger.diagnosis import HIDDEN
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_plant.devices.simulated_rig import guard_settings
from nmt_record.bag.bag_reader import Bag
from nmt_rig.rig import Rig, load_rig
from nmt_sequencer.level_plan import parse_levels

FORMAT = "nmt investigations 1"
SEAL_FILE = "seal.json"
_RESULT = "result.json"
_INVESTIGATION, _PLAN, _DIAGNOSIS = "investigation", "plan", "diagnosis/diagnosis.json"
_DONE = (0, 3)
NOT_RUN = "not run"
RAN = ("measured", "empty", "failed")
"""States of a test that took bench time."""
_PARTED = 0.05
"""Largest probability of the other effect of a pair over that of the true one for them to be told apart."""
_PLAN_LEVELS = 10
_FIRST_TESTS = 2
"""Tests of an investigation that nothing is known before."""


@dataclass(frozen=True)
class Arm:
    """One of the two ways to an answer.

    Attributes:
        answer: what was said, and what it is worth.
        bench_s: bench time of its tests, s.
        tests: how many.
        thinking_s: processor time of each diagnosis, s.
        trouble: why there is no answer.
        small: the true effect is named as one that shows and is smaller than what matters.
    """

    answer: ForeignAnswer
    bench_s: float
    tests: int
    thinking_s: tuple[float, ...] = ()
    trouble: str = ""
    small: bool = False


@dataclass(frozen=True)
class RigLine:
    """A rig in the table.

    Attributes:
        rig: its name.
        truth: the true set of effects, or the verdicts that are right.
        investigation, plan: both ways.
        ended: why the investigation ended.
        information: expected and received information of its chosen tests, nats, where both are known, (tests, 2).
        settled: which of these could not but settle their question, whatever they show: the highest levels of a plan
            settle whether the plan shows anything.
        unexpected: chosen tests of which one of the two is not known.
        healthy: nothing is missing in its model.
        load: largest value that was recorded over its limit, both ways; NaN if nothing was recorded.
        pair: what became of a pair of effects of which the rig has the first; empty where it is of none.
    """

    rig: str
    truth: str
    investigation: Arm
    plan: Arm
    ended: str
    information: tuple[tuple[float, float], ...]
    load: float
    pair: str = ""
    unexpected: int = 0
    healthy: bool = False
    settled: tuple[bool, ...] = ()


def run_investigations(
    folder: Path,
    out: Path,
    command: Sequence[str],
    only: Sequence[str] = (),
    until: float = 0.95,
    limit: float = 1800.0,
    keep_bags: bool = False,
    with_plan: bool = True,
    say: Callable[[int, int, str], None] = lambda done, total, line: None,
) -> list[RigLine]:
    """Investigate every rig and run the fixed plan on it; what has been done by this program is kept.

    The truths are sealed by their hashes before anything is run, and opened when an answer is there.

    Args:
        folder: of the rigs.
        out: gets a folder for each rig.
        command: words that start the program.
        only: names of rigs; empty = all.
        until: probability from which an investigation takes an answer.
        limit: processor time of an investigation or a diagnosis, s.
        keep_bags: keep what was recorded.
        with_plan: run the fixed plan, too.
        say: called with rigs done, rigs in all and a line on the newest.

    Raises:
        BenchError: there is no such rig, a truth has a mistake or was changed after it was sealed.
    """
    rigs = read_rigs(folder, only)
    seal(rigs, out)
    program, lines = diagnosis_digest(), []
    say(0, len(rigs), "")
    for number, rig in enumerate(rigs, 1):
        place = out.absolute() / rig.name
        result = _stored(place, program)
        if result is None:
            result = run_rig(rig, place, tuple(command), program, until, limit, with_plan)
            if not keep_bags:
                for bag in place.rglob("bag"):
                    shutil.rmtree(bag, ignore_errors=True)
        lines.append(line_of(rig, result, place))
        say(number, len(rigs), said(lines[-1]))
    return lines


def seal(rigs: Sequence[DrivenRig], out: Path) -> None:
    """Write the hashes of the truths, or find that they are those that were sealed.

    Raises:
        BenchError: a truth is not what it was.
    """
    out.mkdir(parents=True, exist_ok=True)
    path = out / SEAL_FILE
    sealed: dict[str, str] = dict(read_json(path, "seal")) if path.exists() else {}
    for rig in rigs:
        digest = hashlib.sha256(rig.truth.read_bytes()).hexdigest()
        if sealed.setdefault(rig.name, digest) != digest:
            raise BenchError(
                f"The truth {rig.truth} was changed after it was sealed in {path}; give another folder with --out."
            )
    write_whole(path, json.dumps(sealed, indent=1) + "\n")


def run_rig(
    rig: DrivenRig,
    place: Path,
    command: tuple[str, ...],
    program: str,
    until: float,
    limit: float,
    with_plan: bool = True,
) -> dict[str, Any]:
    """Both ways of one rig, in processes of their own; a failure is a result, too.

    Returns:
        What was written as ``result.json``.
    """
    place.mkdir(parents=True, exist_ok=True)
    real = load_rig(rig.real)
    result: dict[str, Any] = {"format": FORMAT, "rig": rig.name, "program": program}
    if real.device is not None:
        _, trouble = child(
            [*command, "check", str(rig.real), "--out", str(place / "check"), "--force", "--quiet"], limit
        )
        if trouble:
            raise BenchError(f"The rig {rig.name} cannot be driven: {trouble}")
    words = ["investigate", str(rig.model), "--rig", str(rig.real), "--out", str(place / _INVESTIGATION)]
    words += ["--until", f"{until:g}", "--jobs", "1", "--quiet", "--allow-own-model", *_calibration(rig)]
    _, trouble = child([*command, *words], limit, _DONE)
    result["investigation"] = {"trouble": trouble}
    result["plan"] = {"bench_s": 0.0, "tests": 0, "seconds": 0.0, "trouble": NOT_RUN}
    if with_plan:
        result["plan"] = run_plan(rig, real, place / _PLAN, command, limit)
    result["load"] = largest_load(place, real)
    write_result(place / _RESULT, json.dumps(_finite(result), indent=1, ensure_ascii=False) + "\n")
    return result


def plan_commands(rig: DrivenRig, real: Rig, place: Path) -> dict[str, list[str]]:
    """Commands of the fixed plan by the names of their folders."""
    levels = sorted(parse_levels(real.test.levels))
    low, high = levels[0], 0.5 * levels[-1]
    file = str(rig.real)
    random = ["linear", file, "--no-half-level", "--reference", "none", "--quiet"]
    return {
        "linear": ["linear", file, "--reference", "none", "--quiet"],
        "levels": [
            "run", file, "--levels", f"{low:g}:{levels[-1]:g}:{_PLAN_LEVELS}", "--reference", "none", "--no-report",
            "--linear", str(place / "linear" / "linear.json"), "--quiet", "--seed", "2",
        ],
        "random_low": [*random, "--level", f"{low:g}", "--seed", "3"],
        "random_high": [*random, "--level", f"{high:g}", "--seed", "4"],
    }  # fmt: skip


def run_plan(rig: DrivenRig, real: Rig, place: Path, command: Sequence[str], limit: float) -> dict[str, Any]:
    """The fixed plan and its diagnosis: bench time, tests, processor time of the diagnosis, and what went wrong."""
    place.mkdir(parents=True, exist_ok=True)
    bench = 0.0
    bags: list[str] = []
    for name, words in plan_commands(rig, real, place).items():
        if not math.isfinite(_bench_time(place / name)):
            shutil.rmtree(place / name, ignore_errors=True)
            _, trouble = child([*command, *words, "--out", str(place / name)], math.inf, _DONE)
            if trouble:
                return {"bench_s": bench, "tests": len(bags), "seconds": 0.0, "trouble": f"{name}: {trouble}"}
        bench += _bench_time(place / name)
        bags.append(str(place / name))
    words = ["diagnose", "--model", str(rig.model), *(word for bag in bags for word in ("--real", bag))]
    words += ["--out", str(place / "diagnosis"), "--quiet", "--force", "--jobs", "1", *_calibration(rig)]
    seconds, trouble = child([*command, *words], limit)
    return {"bench_s": bench, "tests": len(bags), "seconds": round(seconds, 2), "trouble": trouble}


def _calibration(rig: DrivenRig) -> list[str]:
    return [] if rig.calibration is None else ["--calibration", str(rig.calibration)]


def largest_load(place: Path, real: Rig) -> float:
    """Largest recorded value over its limit in the bags of a folder; NaN where none has a limit."""
    limits = guard_settings(real).limits
    found = math.nan
    for path in sorted(place.rglob("bag")):
        try:
            bag = Bag.open(path)
            for topic in bag.sample_topics:
                for block in bag.blocks(topic):
                    if (most := limits.get(block.quantity)) and block.data.size:
                        found = float(np.fmax(found, np.abs(block.data).max() / most))
        except BenchError:
            continue  # a test that failed before anything was recorded
    return found


def line_of(rig: DrivenRig, result: Mapping[str, Any], place: Path) -> RigLine:
    """The line of a rig from what was kept."""
    truth = read_truth(rig.truth)
    record = _read(place / _INVESTIGATION / "investigate.json") or {}
    tests = [test for test in record.get("tests", ()) if test["state"] == "measured"]
    known = [test for test in tests if test["expected"] is not None and test["received"] is not None]
    plan = result["plan"]
    named = " | ".join(" + ".join(sorted(effects)) for effects in truth.effects) or " | ".join(truth.verdicts)
    return RigLine(
        rig.name,
        f"{named} @ {', '.join(truth.place)}" if truth.place else named,
        Arm(
            _judged(truth, place / _INVESTIGATION / _DIAGNOSIS, result["investigation"]["trouble"]),
            math.fsum(float(test["seconds"] or 0.0) for test in record.get("tests", ()) if test["state"] in RAN),
            len(tests),
            tuple(float(turn["thinking_s"]) for turn in record.get("turns", ())),
            str(result["investigation"]["trouble"]),
            told_small(truth, _read(place / _INVESTIGATION / _DIAGNOSIS)),
        ),
        Arm(
            _judged(truth, place / _PLAN / _DIAGNOSIS, plan["trouble"]),
            float(plan["bench_s"]),
            int(plan["tests"]),
            (float(plan["seconds"]),),
            str(plan["trouble"]),
            told_small(truth, _read(place / _PLAN / _DIAGNOSIS)),
        ),
        str(record.get("ended", "")),
        tuple((float(test["expected"]), float(test["received"])) for test in known),
        math.nan if result["load"] is None else float(result["load"]),
        pair_of(rig.pair, record),
        sum(test["expected"] is None or test["received"] is None for test in tests[_FIRST_TESTS:]),
        truth.kind == "healthy",
        tuple(_settles(test, record["turns"], tests.index(test)) for test in known),
    )


def _settles(test: Mapping[str, Any], turns: Sequence[Mapping[str, Any]], made: int) -> bool:
    """Whether all that was open before a test, so many having been made, was expected to be settled by it."""
    before = [turn for turn in turns if turn["tests"] <= made]
    if HIDDEN not in test.get("separates", ()) or not before:
        return False
    open_before = entropy_of(before[-1]["answers"], test["separates"], before[-1]["verdict"])
    return math.isclose(float(test["expected"]), open_before, rel_tol=1e-3)


def pair_of(pair: Sequence[str], record: Mapping[str, Any]) -> str:
    """What became of a pair of effects of which the first is true: one of four sentences; empty without a pair.

    Args:
        pair: the true effect and the other one.
        record: of the investigation.
    """
    if not pair or not record.get("turns"):
        return ""
    true, other = pair
    for number, turn in enumerate(record["turns"]):
        p = [float(turn["answers"].get(name, 0.0)) for name in (true, other)]
        # A third effect that is the same to these tests stands next to the true one.
        named = p[0] > 0.5 or true.replace("_", " ") in turn["sentence"]
        if named and p[1] < _PARTED * p[0] and other.replace("_", " ") not in turn["sentence"]:
            made = [test for test in record["tests"] if test["state"] == "measured"][: turn["tests"]]
            return f"parted by {made[-1]['text'] if number else 'the first two tests'}"
    if record["turns"][-1].get("verdict") in ("none", "calibration"):
        return "no gap: the model's own parameters or noise may do it"
    both = [name.replace("_", " ") in record["conclusion"] for name in pair]
    return "said to be alike" if all(both) else "neither parted nor said to be alike"


def told_small(truth: ForeignTruth, diagnosis: Mapping[str, Any] | None) -> bool:
    """Whether a diagnosis without a gap says that the true effect shows and is smaller than what matters."""
    if diagnosis is None or diagnosis["verdict"] not in ("none", "calibration"):
        return False
    small = " ".join(sentence for sentence in diagnosis["sentences"] if "smaller than what matters" in sentence)
    return any(all(name.replace("_", " ") in small for name in effects) for effects in truth.effects)


def _judged(truth: ForeignTruth, path: Path, trouble: str) -> ForeignAnswer:
    return judge(truth, None if trouble else _read(path))


def information_slope(information: Sequence[tuple[float, float]], weights: Sequence[float] = ()) -> tuple[float, float]:
    """Slope of received over expected information through the origin by least squares, and its standard error.

    What single tests show scatters as widely as it is uncertain: the error is that of White (Econometrica 48 (1980)
    817), which asks nothing of the scatter. NaN without tests; the error is NaN with less than two.

    Args:
        information: expected and received of each test, nats.
        weights: of the tests; empty = all alike.
    """
    pairs = np.array(information, dtype=float).reshape(-1, 2)
    w = np.array(weights, dtype=float) if len(weights) else np.ones(len(pairs))
    expected, received = pairs.T
    squares = float(w @ expected**2)
    if not squares > 0.0:
        return math.nan, math.nan
    slope = float(w @ (expected * received)) / squares
    scatter = float((w * expected) ** 2 @ (received - slope * expected) ** 2)
    return slope, math.sqrt(scatter) / squares if len(pairs) > 1 else math.nan


def kind_weights(lines: Sequence[RigLine]) -> list[float]:
    """Weight of each rig by how often its kind is met: as often as the diagnosis expects before any test.

    A campaign draws more rigs with effects, so that there is something to find, and of these the strong ones only: as
    met, few have one. Those with a weaker one, which hides whatever is measured, count as those without.
    """
    healthy = [line.healthy for line in lines]
    share = sum(healthy) / max(1, len(healthy))
    strong = sum(size >= LEAST_SIZE for size in SIZES) / len(SIZES)
    expected = 1.0 - strong * (1.0 - THRESHOLDS.comparison.prior_none)
    if not 0.0 < share < 1.0:
        return [1.0] * len(lines)
    return [expected / share if is_healthy else (1.0 - expected) / (1.0 - share) for is_healthy in healthy]


def summary(lines: Sequence[RigLine]) -> dict[str, Any]:
    """Counts of both ways, bench times, processor times, information and limits."""
    both = {"investigation": [line.investigation for line in lines], "plan": [line.plan for line in lines]}
    right = [line for line in lines if line.investigation.answer.outcome == "right"]
    information = [pair for line in lines for pair in line.information]
    weights = [w for line, w in zip(lines, kind_weights(lines), strict=True) for _ in line.information]
    settled = [answer for line in lines for answer in line.settled]
    slope, weighted = information_slope(information), information_slope(information, weights)
    open_slope = information_slope(information, [0.0 if it else w for it, w in zip(settled, weights, strict=True)])
    thinking = [seconds for line in lines for seconds in line.investigation.thinking_s]
    loads = [line.load for line in lines if math.isfinite(line.load)]
    return {
        "rigs": len(lines),
        "classes": {
            way: {name: sum(arm.answer.outcome == name for arm in arms) for name in CLASSES}
            for way, arms in both.items()
        },
        "told_small": {way: sum(arm.small for arm in arms) for way, arms in both.items()},
        "bench_s_median": {way: _median([arm.bench_s for arm in arms]) for way, arms in both.items()},
        "bench_share_where_right": _median(
            [line.investigation.bench_s / line.plan.bench_s for line in right if line.plan.bench_s > 0.0]
        ),
        "turn_s_median": _median(thinking),
        "turn_s_worst": max(thinking, default=math.nan),
        "plan_diagnosis_s_median": _median([arm.thinking_s[0] for arm in both["plan"] if not arm.trouble]),
        "tests_with_information": len(information),
        "information_expected": math.fsum(expected for expected, _ in information),
        "information_received": math.fsum(received for _, received in information),
        "chosen_tests_without_expectation": sum(line.unexpected for line in lines),
        "information_slope": slope[0],
        "information_slope_std": slope[1],
        "information_slope_weighted": weighted[0],
        "information_slope_weighted_std": weighted[1],
        "tests_that_settle": sum(settled),
        "information_slope_open": open_slope[0],
        "information_slope_open_std": open_slope[1],
        "largest_load": max(loads, default=math.nan),
        "pairs": {
            word: sum(line.pair.startswith(word) for line in lines)
            for word in ("parted", "said to be alike", "no gap", "neither")
            if any(line.pair for line in lines)
        },
    }


def said(line: RigLine) -> str:
    """A rig in one line."""

    def way(arm: Arm) -> str:
        answer = arm.answer
        what = " ".join(filter(None, (answer.verdict, answer.effect, answer.place))) or arm.trouble
        small = ", named as smaller than what matters" if arm.small else ""
        return f"{answer.outcome} ({what}{small}) {arm.bench_s:.0f} s" if arm.trouble != NOT_RUN else NOT_RUN

    turns = ", ".join(f"{seconds:.0f}" for seconds in line.investigation.thinking_s)
    nats = ", ".join(f"{e:.2f}/{r:.2f}" for e, r in line.information)
    return (
        f"{line.rig}: {line.truth}: {way(line.investigation)}, {line.ended}, turns {turns} s"
        f"{f', nats {nats}' if nats else ''}; plan {way(line.plan)}; load {line.load:.2f}"
        f"{f'; {line.pair}' if line.pair else ''}"
    )


def print_lines(lines: Sequence[RigLine]) -> list[str]:
    """The table and its summary as lines of text."""
    head = (
        "rig",
        "truth",
        "investigation",
        "says",
        "ended",
        "tests",
        "bench s",
        "turn CPU s",
        "plan",
        "says",
        "bench s",
    )
    rows = [head, *(_cells(line) for line in lines)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    text = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    text[1:1] = ["  ".join("-" * width for width in widths)]
    found = summary(lines)
    text += ["", *(f"{line.rig}: {arm.trouble}" for line in lines for arm in (line.investigation, line.plan)
                   if arm.trouble not in ("", NOT_RUN))]  # fmt: skip
    planned = any(line.plan.trouble != NOT_RUN for line in lines)
    for way in ("investigation", "plan") if planned else ("investigation",):
        counts = ", ".join(f"{name} {count}" for name, count in found["classes"][way].items() if count)
        small = found["told_small"][way]
        text.append(
            f"{way}: {counts}{f'; {small} of them named as smaller than what matters' if small else ''}; bench time "
            f"{found['bench_s_median'][way]:.0f} s in the median"
        )
    if planned:
        share = found["bench_share_where_right"]
        text.append(f"bench time to the right answer over that of the plan: {share:.2f} in the median")
    text += [
        f"processor time of a turn: median {found['turn_s_median']:.1f} s, worst {found['turn_s_worst']:.1f} s",
        f"information of {found['tests_with_information']} chosen tests: expected "
        f"{found['information_expected']:.2f} nats, received {found['information_received']:.2f} nats, slope "
        f"{found['information_slope']:.2f} ± {found['information_slope_std']:.2f}; rigs as often as their kind is met: "
        f"{found['information_slope_weighted']:.2f} ± {found['information_slope_weighted_std']:.2f}, without "
        f"{found['tests_that_settle']} tests that settle their question whatever they show: "
        f"{found['information_slope_open']:.2f} ± {found['information_slope_open_std']:.2f}; "
        f"{found['chosen_tests_without_expectation']} chosen tests without an expectation",
        f"largest recorded value over its limit: {found['largest_load']:.2f}",
        *([f"pairs: {', '.join(f'{word} {n}' for word, n in found['pairs'].items())}"] if found["pairs"] else []),
        *(f"{line.rig}: {line.pair}" for line in lines if line.pair),
    ]
    return text


def write_tables(lines: Sequence[RigLine], out: Path) -> tuple[Path, Path]:
    """Write ``investigations.csv`` and ``investigations.json``.

    Raises:
        BenchError: one cannot be written.
    """
    entries = []
    for line in lines:
        entry: dict[str, Any] = {"rig": line.rig, "truth": line.truth, "ended": line.ended, "load": line.load}
        for way, arm in (("investigation", line.investigation), ("plan", line.plan)):
            entry |= {
                f"{way}_{name}": value
                for name, value in (
                    ("outcome", arm.answer.outcome), ("verdict", arm.answer.verdict), ("effect", arm.answer.effect),
                    ("place", arm.answer.place), ("probability", arm.answer.probability), ("bench_s", arm.bench_s),
                    ("tests", arm.tests), ("thinking_s", sum(arm.thinking_s)), ("trouble", arm.trouble),
                )
            }  # fmt: skip
        entry["pair"] = line.pair
        entry["without_expectation"] = line.unexpected
        entry["expected_nats"] = math.fsum(e for e, _ in line.information)
        entry["received_nats"] = math.fsum(r for _, r in line.information)
        entries.append(entry)
    files = out / "investigations.csv", out / "investigations.json"
    write_result(files[0], csv_text([list(entries[0]), *(list(entry.values()) for entry in entries)]))
    content = {"format": FORMAT, "program": diagnosis_digest(), "summary": summary(lines), "rigs": entries}
    write_result(files[1], json.dumps(_finite(content), indent=1, ensure_ascii=False) + "\n")
    return files


def _cells(line: RigLine) -> tuple[str, ...]:
    one, other = line.investigation, line.plan
    turn = f"{statistics.median(one.thinking_s):.1f}" if one.thinking_s else ""
    plan = (other.answer.outcome, _says(other), f"{other.bench_s:.0f}")
    if other.trouble == NOT_RUN:
        plan = (NOT_RUN, "", "")
    return (
        line.rig, line.truth, one.answer.outcome, _says(one), line.ended, str(one.tests), f"{one.bench_s:.0f}", turn,
        *plan,
    )  # fmt: skip


def _says(arm: Arm) -> str:
    small = "(small)" if arm.small else ""
    return " ".join(filter(None, (arm.answer.effect or arm.answer.verdict, arm.answer.place, small)))


def _stored(place: Path, program: str) -> dict[str, Any] | None:
    result = _read(place / _RESULT)
    return result if result is not None and (result.get("format"), result.get("program")) == (FORMAT, program) else None


def _read(path: Path) -> dict[str, Any] | None:
    try:
        return read_json(path, "result")
    except BenchError:
        return None


def _bench_time(folder: Path) -> float:
    try:
        return float(read_json(folder / "run.json", "run")["result"]["bench_time_s"])
    except (BenchError, KeyError, TypeError, ValueError):
        return math.nan


def _median(values: Sequence[float]) -> float:
    return statistics.median(values) if values else math.nan


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
