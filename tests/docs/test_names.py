"""Names that say nothing of what they hold, and words that say little, are refused.

Rooms that still have such names may not get more.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# How many each room still has. A number is put down when names are replaced, and never up.
STILL = {
    "nmt": 4, "nmt_bench": 50, "nmt_core": 40, "nmt_diagnose": 16, "nmt_extract": 36, "nmt_plant": 50, "nmt_pll": 10,
    "nmt_record": 76, "nmt_report": 54, "nmt_rig": 66, "nmt_sequencer": 14, "nmt_session": 12, "nmt_signals": 1,
    "tests": 480, "campaigns": 81, "docs": 3,
}  # fmt: skip


NOT_USED = re.compile(
    r"\b(?:beside|nobody|(?:is|are) told|is no(?= \w)|of what|what is left|looked for|what is believed)\b",
    re.IGNORECASE,
)
"""Phrases that documents do not use; a sentence says which thing it means."""


@cache
def refused() -> tuple[frozenset[str], frozenset[str]]:
    """Names of variables and of constants that CONTRIBUTING refuses."""
    (line,) = [line for line in (ROOT / "CONTRIBUTING.md").read_text().splitlines() if line.startswith("* Refused")]
    names, constants = line.partition("as constants")[::2]
    constants = constants.partition(". ")[0]
    words = re.findall(r"`([a-z]+)`", names)
    return frozenset(words), frozenset(re.findall(r"`([A-Z]+)`", constants))


def named(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Variables, arguments, attributes, functions and classes that a module defines, with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name, node.lineno


@cache
def refused_word() -> re.Pattern[str]:
    """A refused name as a word of code."""
    words, constants = refused()
    return re.compile(rf"\b_*(?:{'|'.join(sorted(words | constants))})\b")


TEXTS_AND_COMMENTS = re.compile(r'"""[\s\S]*?"""|"(?:[^"\\\n]|\\.)*"|#[^\n]*')


def found(text: str) -> list[tuple[str, int]]:
    """Refused names of a module; one without such a word in its code is not parsed."""
    if not refused_word().search(TEXTS_AND_COMMENTS.sub("", text)):
        return []
    words, constants = refused()
    tree = ast.parse(text)
    return [(name, line) for name, line in named(tree) if name.lstrip("_") in words or name.lstrip("_") in constants]


def rooms() -> dict[str, list[Path]]:
    """Modules of each room: a package, a folder of tests, campaigns."""
    result: dict[str, list[Path]] = {}
    for path in sorted(ROOT.glob("ros2_ws/src/nmt*/nmt*/**/*.py")):
        result.setdefault(path.relative_to(ROOT).parts[2], []).append(path)
    for folder in ("tests", "campaigns", "docs"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            result.setdefault(folder, []).append(path)
    return result


def test_a_refused_name_is_found() -> None:
    code = (
        "def f(own, x):\n    told = [seen for seen in x]\n    self.rest = 1\n\n_LEAST = 3\n_LEAST_GAIN = 3\nowner = 1\n"
    )
    assert sorted(name for name, _ in found(code)) == ["_LEAST", "own", "rest", "seen", "told"]


def test_no_room_gets_more_names_that_say_nothing() -> None:
    more = {}
    for room, paths in rooms().items():
        locations = [
            f"{path.relative_to(ROOT)}:{line} {name}"
            for path in paths
            for name, line in found(path.read_text(encoding="utf-8"))
        ]
        if len(locations) > STILL.get(room, 0):
            more[room] = (
                len(locations),
                STILL.get(room, 0),
                Counter(place.split()[-1] for place in locations),
                locations[:5],
            )
    assert not more, f"rename them to what they hold (docs/reference/vocabulary.md): {more}"


def test_documents_say_which_thing_they_mean() -> None:
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    used = [
        f"{page.relative_to(ROOT)}:{number} {phrase[0]}"
        for page in pages
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        for phrase in NOT_USED.finditer(line)
    ]
    assert not used, f"say it in the words of docs/reference/vocabulary.md: {used}"
