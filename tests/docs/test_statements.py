"""Every statement stands before recordings that bear it out and before recordings that tempt to it."""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from nmt_diagnose.ledger.statements import STATEMENTS

TESTS = Path(__file__).resolve().parents[1]


def recordings(function: ast.FunctionDef) -> int:
    """Recordings of a test in both tiers: the sets of parameters that it is called with."""
    count = 1
    for call in (it for it in function.decorator_list if isinstance(it, ast.Call)):
        if ast.unparse(call.func) != "pytest.mark.parametrize":
            continue
        values = call.args[1]
        if isinstance(values, ast.Call) and ast.unparse(values.func) == "with_quick":
            values = values.args[0]
        if isinstance(values, ast.List | ast.Tuple):
            count *= len(values.elts)
        elif isinstance(values, ast.Call) and ast.unparse(values.func) == "range":
            count *= len(range(*(ast.literal_eval(number) for number in values.args)))
    return count


@cache
def court() -> dict[str, Counter[str]]:
    """Recordings that bear statements out (said) or tempt to them (not_said), by statement."""
    found: dict[str, Counter[str]] = {"said": Counter(), "not_said": Counter()}
    for path in TESTS.rglob("test_*.py"):
        text = path.read_text(encoding="utf-8")
        if "mark.court" not in text:
            continue
        for function in (node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)):
            for call in (it for it in function.decorator_list if isinstance(it, ast.Call)):
                if ast.unparse(call.func) != "pytest.mark.court":
                    continue
                for keyword in call.keywords:
                    names = ast.literal_eval(keyword.value)
                    for name in (names,) if isinstance(names, str) else names:
                        found[str(keyword.arg)][name] += recordings(function)
    return found


@pytest.mark.parametrize("kind", ["said", "not_said"])
@pytest.mark.parametrize("statement", [statement.name for statement in STATEMENTS])
def test_two_recordings_bear_a_statement_out_and_two_tempt_to_it(statement: str, kind: str) -> None:
    assert court()[kind][statement] >= 2, f"{statement}: {dict(court()[kind])}"


def test_the_court_knows_no_other_statement() -> None:
    assert set(court()["said"]) | set(court()["not_said"]) == {statement.name for statement in STATEMENTS}
