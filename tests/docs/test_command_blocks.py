"""Every command line of README and docs is one that the argument parser accepts; the cheap ones run."""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from bench import synthetic_bag

from nmt_bench.cli import all_commands, build_parser, main
from nmt_bench.command_parser import CommandRefusal, leaf_parsers
from nmt_rig.rig import find_rig

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
LAUNCHER = {"test", "doctor", "setup", "shell", "ros", "--version", "--help"}
BLOCK = re.compile(r"^( *)```(?:\w*)\n(.*?)^ *```", re.S | re.M)
START = re.compile(r"^(?:\./)?nmt +(?!\w+:)")
INLINE = re.compile(r"`\./nmt ([a-z][^`\n]*)`")
PLACEHOLDER = re.compile(r"^[A-Z][A-Z_./]*$|^…$|^\.\.\.$")
REFUSAL = re.compile(r"^(\./nmt \w+ [^\n]*)\n(\./nmt \w+: [^\n]*\n)", re.M)


def block_lines(text: str) -> Iterator[str]:
    """Command lines of the code blocks, continued lines joined, without comments and redirections."""
    for match in BLOCK.finditer(text):
        joined = re.sub(r"\\\n\s*", " ", match[2])
        for line in joined.splitlines():
            line = line.strip().removeprefix("$ ")
            if START.match(line):
                yield line


def words_of(line: str) -> list[str]:
    words = shlex.split(line, comments=True)[1:]
    for stop in ("|", ">", "2>", "&", "&&", "<", "<<<"):
        if stop in words:
            words = words[: words.index(stop)]
    return words


def command_lines() -> list[tuple[str, str]]:
    return [
        (str(page.relative_to(ROOT)), line) for page in PAGES for line in block_lines(page.read_text(encoding="utf-8"))
    ]


def inline_commands() -> list[tuple[str, str]]:
    return sorted(
        {
            (str(page.relative_to(ROOT)), found)
            for page in PAGES
            for found in INLINE.findall(BLOCK.sub("", page.read_text(encoding="utf-8")))
        }
    )


LINES, INLINES = command_lines(), inline_commands()


def test_the_parser_accepts_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert len(LINES) > 50
    for page, line in LINES:
        the_parser_accepts(page, line, capsys)


def the_parser_accepts(page: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = words_of(line)
    while words and words[0] in ("--wheels", "--system"):
        words = words[1:]
    assert words, line
    if words[0] in LAUNCHER:
        return
    assert words[0] in all_commands(), f"{page}: there is no command {words[0]}"
    if any(PLACEHOLDER.match(word) for word in words[1:]):
        assert_options_exist(words)
        return
    try:
        build_parser(words[0]).parse_args(words)
    except CommandRefusal as refusal:
        pytest.fail(f"{page}: {line}: {refusal.sentence}")
    finally:
        capsys.readouterr()


def options_of(command: str) -> set[str]:
    parser = build_parser(command)
    group = next(action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    return {
        word
        for leaf in leaf_parsers(group.choices[command])
        for action in leaf._actions
        for word in action.option_strings
    }


def assert_options_exist(words: list[str]) -> None:
    options = {word.partition("=")[0] for word in words if word.startswith("--")}
    unknown = options - options_of(words[0])
    assert not unknown, f"{words[0]} has no {', '.join(sorted(unknown))}"


def test_options_in_the_text_exist() -> None:
    for page, text in INLINES:
        words = re.sub(r"[\[\](){}|,]", " ", text).split()
        if words[0] not in LAUNCHER:
            assert words[0] in all_commands(), f"{page}: there is no command {words[0]}"
            assert_options_exist(words)


@pytest.mark.campaign
@pytest.mark.filterwarnings("ignore:Attempting to set identical")  # the made-up recording has one frequency
def test_commands_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that need no nodes, on a small recording in the place of the first one's."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(synthetic_bag, "RIG_YAML", find_rig("beam").read_text(encoding="utf-8"))
    synthetic_bag.write_bag(tmp_path / "out" / "point4" / "bag", level_seconds=2.5)
    assert main(["extract", "out/point4", "--out", "out/point4", "--force"]) == 0
    lines = [words_of(line) for line in block_lines((ROOT / "README.md").read_text(encoding="utf-8"))]
    ran = set()
    for words in lines:
        if "out/point4" in words and words[0] != "run":
            assert main([*words, "--no-report"] if words[0] == "extract" else words) == 0, words
            ran.add(words[0])
    assert ran == {"extract", "figures"}
    assert (tmp_path / "out" / "again" / "modal.csv").read_text() == (tmp_path / "out/point4/modal.csv").read_text()


@pytest.mark.campaign
def test_a_test_without_ros_prints_what_the_page_says() -> None:
    text = (ROOT / "docs" / "how-to" / "use-from-python.md").read_text(encoding="utf-8")
    section = re.search(r"^## A test without ROS\n(.*?)^## ", text, re.S | re.M)
    shown = re.search(r"^prints\n\n```\n(.*?)^```", text, re.S | re.M)
    assert section is not None
    assert shown is not None
    code = re.search(r"^```python\n(.*?)^```", section[1], re.S | re.M)
    assert code is not None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code[1], "A test without ROS", "exec"), {"__name__": "snippet"})
    assert "prints the two lines above" in section[1]
    assert printed.getvalue().splitlines() == shown[1].splitlines()[1:]


@pytest.mark.campaign
def test_a_refusal_reads_as_on_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = [found for page in PAGES for found in REFUSAL.findall(page.read_text(encoding="utf-8"))]
    assert shown
    monkeypatch.chdir(tmp_path)
    for line, refusal in shown:
        assert main(words_of(line)) == 2
        assert capsys.readouterr().err == refusal
