"""Every command of the documentation answers what its page says.

A page is followed as a reader follows it: from top to bottom, in an empty folder, each command as it stands. What each
has to answer is in :mod:`node.page_answers`; a new command without an answer fails in the first tier.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from docs.test_command_blocks import BLOCK, LINES, ROOT, START, words_of
from node.page_answers import ANSWERS, TESTS, Answer, page_text

from nmt_bench.cli import main

FOLLOWED = [page for page, answers in ANSWERS.items() if any(answer.is_run for answer in answers.values())]
NUMBER = re.compile(r"^(−?\d+(?:\.\d+)?)(?:\((<?\d+)\))?$")


def test_every_documented_command_has_an_answer() -> None:
    """Checked beyond its exit code, or run by a test that exists, or not run for a reason."""
    missing = [(page, line) for page, line in LINES if line_of(line) not in ANSWERS.get(page, {})]
    assert not missing, f"{len(missing)} commands without an answer in page_answers.py: {missing[:20]}"
    known = {(page, line_of(line)) for page, line in LINES}
    for page, answers in ANSWERS.items():
        for line, answer in answers.items():
            assert (page, line) in known or line.startswith("cp "), f"{page} has no command {line}"
            assert answer.is_checked or not answer.is_run, f"{page}: {line} has no check"
            assert not answer.is_run or not answer.not_run
            if answer.tested_by:
                file, _, test = answer.tested_by.partition("::")
                text = (TESTS / file).read_text(encoding="utf-8")
                assert not test or f"def {test}(" in text, f"{answer.tested_by} is not a test"


def line_of(line: str) -> str:
    """A command without the remark behind it."""
    return re.split(r"\s+#\s", line)[0].strip()


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("page", FOLLOWED)
def test_a_page_answers_what_it_says(page: str, tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    tables = tables_of(page)
    lines = lines_of(page)
    for number, line in enumerate(lines):
        answer = ANSWERS[page][line]
        if not answer.is_run or line in lines[number + 1 :]:  # a page may show first what it does last
            continue
        if answer.before is not None:
            answer.before(tmp_path)
        printed = run(answer.instead or line, tmp_path, answer.code)
        for expression in answer.prints:
            assert re.search(expression, printed), f"{line} does not print {expression}:\n{printed}"
        if answer.table:
            compare_tables(next(tables), printed)
        if answer.holds is not None:
            answer.holds(tmp_path)


def lines_of(page: str) -> list[str]:
    """Commands of a page in order, copies of files among them; what a command prints is none."""
    lines = []
    for match in BLOCK.finditer(page_text(page)):
        for line in re.sub(r"\\\n\s*", " ", match[2]).splitlines():
            line = line.strip().removeprefix("$ ")
            if line.startswith("cp ") or START.match(line):
                lines.append(line_of(line))
    return [line for line in lines if line in ANSWERS[page]]


def run(line: str, folder: Path, code: int) -> str:
    """Run a command as a reader does; returns what it prints."""
    if line.startswith("cp "):
        _, source, target = shlex.split(line)
        shutil.copy(folder / source, folder / target)
        return ""
    words = [str(ROOT / "nmt"), *words_of(line)]
    environment = {**os.environ, "COLUMNS": "200"}
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    printed = done.stdout + done.stderr
    assert done.returncode == code, f"{line} ended with {done.returncode}:\n{printed}"
    return printed


def tables_of(page: str) -> Iterator[list[list[str]]]:
    """Tables of modal properties that a page shows, their rows as cells."""
    for match in BLOCK.finditer(page_text(page)):
        rows = [line.split() for line in match[2].splitlines() if NUMBER.match((line.split() or [""])[0])]
        if rows and all(len(row) >= 5 for row in rows):
            yield rows


def compare_tables(shown: list[list[str]], printed: str) -> None:
    """Each row of a page is among those that are printed, its numbers within two of their uncertainties.

    A page may leave out columns in the middle; the first five and the last two are compared.
    """
    found = {cells[0]: cells for line in printed.splitlines() if (cells := line.split()) and NUMBER.match(cells[0])}
    for row in shown:
        assert row[0] in found, f"no row of level {row[0]} is printed:\n{printed}"
        cells = found[row[0]]
        for ours, theirs in [*zip(row[:5], cells[:5], strict=True), *zip(row[-2:], cells[-2:], strict=True)]:
            (value, std), (other, other_std) = number_of(ours), number_of(theirs)
            assert abs(value - other) <= 2.0 * max(std, other_std), f"level {row[0]}: {ours} is printed as {theirs}"
            assert std <= 3.0 * other_std, f"level {row[0]}: {ours} is printed as {theirs}"
            assert other_std <= 3.0 * std, f"level {row[0]}: {ours} is printed as {theirs}"


def number_of(cell: str) -> tuple[float, float]:
    """Value and uncertainty of ``22.1916(16)``; without one half of the last digit but two counts."""
    match = NUMBER.match(cell)
    assert match is not None, cell
    unit = 10.0 ** -len(match[1].partition(".")[2])
    digits = match[2] or "1"
    return float(match[1].replace("−", "-")), unit * float(digits.removeprefix("<"))


def test_a_table_that_is_not_printed_is_seen() -> None:
    printed = "0.05 22.1916(16) 0.505937(71) 26.680976(79) 0.014050(1) 1.0 0.0071 0.01"
    shown = ["0.05", "22.1916(16)", "0.505937(71)", "26.680976(79)", "0.014050(1)", "0.0071", "0.01"]
    compare_tables([shown], printed)
    for wrong in (["0.05", "22.1966(16)", *shown[2:]], ["0.05", "22.1916(1)", *shown[2:]], ["0.06", *shown[1:]]):
        with pytest.raises(AssertionError):
            compare_tables([wrong], printed)


@pytest.mark.usefixtures("undrawn")
def test_the_mass_of_the_tutorial_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Section 11 whole, all nodes in one process: place, size, verdict and the written model."""
    monkeypatch.chdir(tmp_path)
    page = "docs/tutorial.md"
    lines = [line for line in lines_of(page) if "out/heavy" in line]
    assert len(lines) == 2
    for line in lines:
        extra = ["--one-process", "--no-report", "--reference", "none"] if line.startswith("./nmt run") else []
        assert main([*words_of(line), *extra, "--quiet"]) == 0
    answer: Answer = ANSWERS[page][lines[-1]]
    assert answer.holds is not None
    answer.holds(tmp_path)
