"""The words of the field (ISO 2041, Ewins' Modal Testing, the paper) instead of private ones, and short sentences."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")])
SOURCES = sorted([*(ROOT / "ros2_ws" / "src").rglob("*.py"), *(ROOT / "requirements").rglob("*.py")])
TEMPLATES = sorted((ROOT / "ros2_ws" / "src").rglob("templates/*"))

GLOSSARY = {
    r"mend(s|ed|ing)?": "fix",
    r"(told|tell|tells|telling)( them| it)? apart": "distinguish",
    r"beg[iu]ns? anew": "start over",
    r"foreign lines?": "other spectral lines",
    r"sealed truth": "sealed file",
    r"moduli": "magnitudes",
    r"rival methods": "other methods",
    r"first passage": "first crossing",
    r"contests?": "comparison",
}
"""A private word, and the one to write."""

NAMES = {
    "contest": "model comparison",
    "contender": "fitted model",
    "rival": "equivalent or competing",
    "freedom": "degrees of freedom",
    "moduli": "magnitudes",
    "mend": "repair",
}
"""The same in names of code, where a word is a part between capitals or underscores."""

FIRST = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "docs" / "tutorial.md"]
"""What a newcomer reads: here colons and semicolons do not end a sentence."""
OTHERS = sorted({*(ROOT / "docs").rglob("*.md")} - {*FIRST})
"""All other pages of the documentation."""
MOST_WORDS = 30
LONGEST_LIST = 45
"""Words of a sentence of these, in which enumerations stand."""


def private_words(text: str) -> list[str]:
    return [f"'{found[0]}': write '{word}'" for pattern, word in GLOSSARY.items()
            for found in re.finditer(rf"\b{pattern}\b", text, re.I)]  # fmt: skip


@pytest.mark.parametrize("path", [*PAGES, *TEMPLATES], ids=lambda path: str(path.relative_to(ROOT)))
def test_pages_use_the_words_of_the_field(path: Path) -> None:
    assert private_words(path.read_text(encoding="utf-8")) == []


def test_messages_and_docstrings_use_the_words_of_the_field() -> None:
    found = []
    for path in SOURCES:
        if "build" in path.parts or "install" in path.parts:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found += [f"{path.relative_to(ROOT)}:{node.lineno}: {what}" for what in private_words(node.value)]
    assert found == []


def names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """What a module defines, with its line: classes, functions, parameters, variables and attributes."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name):
            yield node.lineno, node.id


def private_names(tree: ast.AST) -> list[str]:
    found = []
    for line, name in names(tree):
        spelled = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower().replace("degrees_of_freedom", "")
        found += [f"{line}: {name}: write '{NAMES[own]}'" for part in spelled.split("_") for own in NAMES
                  if part in (own, f"{own}s")]  # fmt: skip
    return found


def test_names_of_code_use_the_words_of_the_field() -> None:
    found = []
    for path in SOURCES:
        if "build" not in path.parts and "install" not in path.parts:
            own = private_names(ast.parse(path.read_text(encoding="utf-8")))
            found += [f"{path.relative_to(ROOT)}:{what}" for what in own]
    assert found == []


def test_a_private_name_is_seen() -> None:
    tree = ast.parse("class HeldOutContest:\n    def of(self, rivals):\n        freedom = degrees_of_freedom = 1")
    assert [what.partition(":")[0] for what in private_names(tree)] == ["1", "2", "3"]


def test_classes_of_a_kind_are_distinguished_by_their_names() -> None:
    """No two packages define one name for an outcome, settings or a result."""
    defined: dict[str, list[str]] = {}
    for path in SOURCES:
        if "build" not in path.parts and "install" not in path.parts:
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef) and re.search(r"(Outcome|Settings|Result)$", node.name):
                    defined.setdefault(node.name, []).append(str(path.relative_to(ROOT)))
    assert {name: where for name, where in defined.items() if len(where) > 1 or name in ("Outcome", "Settings")} == {}


def blocks(text: str) -> Iterator[str]:
    """Paragraphs, items of lists and cells of tables of a page, without code."""
    text = re.sub(r"^ *```.*?^ *```", "", text, flags=re.S | re.M)
    lines: list[str] = []
    for line in [*text.splitlines(), ""]:
        line = line.strip()
        item = re.match(r"(\*|-|\d+\.)\s+", line)
        if lines and (not line or item or line.startswith(("|", "#"))):
            yield " ".join(lines)
            lines = []
        if line.startswith("|"):
            yield from (cell.strip() for cell in line.strip("|").split("|"))
        elif line and not line.startswith("#"):
            lines.append(line[item.end() :] if item else line)


def sentences(text: str) -> Iterator[str]:
    for block in blocks(text):
        plain = re.sub(r"`[^`]*`", "X", re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", block))
        yield from re.split(r"(?<=[.!?])\s+(?=[\"'(A-ZΔδωφ0-9*])", plain)


def words(sentence: str) -> int:
    return len(re.findall(r"[A-Za-z][\w'’-]*", sentence))


@pytest.mark.parametrize("page", FIRST, ids=lambda path: path.name)
def test_sentences_of_the_first_pages_are_short(page: Path) -> None:
    assert [s for s in sentences(page.read_text(encoding="utf-8")) if words(s) > MOST_WORDS] == []


@pytest.mark.parametrize("page", OTHERS, ids=lambda path: str(path.relative_to(ROOT)))
def test_sentences_of_the_other_pages_are_short(page: Path) -> None:
    """At most thirty words to a colon or semicolon, which open and part enumerations; at most 45 in all."""
    long = []
    for sentence in sentences(page.read_text(encoding="utf-8")):
        parts = [words(part) for part in re.split(r"[:;]\s", sentence)]
        if max(parts) > MOST_WORDS or sum(parts) > LONGEST_LIST:
            long.append(sentence)
    assert long == []


def test_a_private_word_and_a_long_sentence_are_seen() -> None:
    assert private_words("It says how to mend it.") == ["'mend': write 'fix'"]
    assert [words(s) for s in sentences("One two. " + "Word " * 31 + ".\n\n* And `code` here.")] == [2, 31, 3]
