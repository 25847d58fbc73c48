"""The table of what ends a test: each row's sentence is in the product, and its test holds cause, sentence and code."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "reference" / "first-causes.md"
ROWS = [
    [cell.strip() for cell in line.strip("|").split(" | ")]
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if line.startswith("| ") and not line.startswith("| cause")
]


@cache
def product() -> str:
    sources = sorted((ROOT / "ros2_ws" / "src").glob("nmt*/nmt*/**/*.py"))
    return "\n".join(path.read_text(encoding="utf-8") for path in sources)


@pytest.mark.parametrize(("cause", "found_by", "sentence", "code", "test"), ROWS, ids=[row[0] for row in ROWS])
def test_a_cause_has_its_sentence_and_its_test(cause: str, found_by: str, sentence: str, code: str, test: str) -> None:
    name, file = re.findall(r"`([^`]+)`", test)
    text = (ROOT / file).read_text(encoding="utf-8")
    functions = {node.name: node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)}
    assert name in functions
    body = ast.get_source_segment(text, functions[name]) or ""
    assert "assert" in body or "pytest.raises" in body
    assert code == "–" or f"ResultCode.{code}" in text
    words = sentence.strip("`")
    # What an operating system says stands in the test alone; limits are named by their channel.
    assert words in product() or words in body
