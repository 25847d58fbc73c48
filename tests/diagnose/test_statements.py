"""Every statement has a check in code and a test, but for those whose check is still to come."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from nmt_diagnose.ledger.statements import STATEMENTS, Statement, statements_table

ROOT = Path(__file__).resolve().parents[2]
WITHOUT_CHECK: set[str] = set()
"""May only shrink."""


def test_statements_without_a_check_are_known() -> None:
    assert {it.name for it in STATEMENTS if not (it.function and it.test)} == WITHOUT_CHECK
    assert len({it.name for it in STATEMENTS}) == len(STATEMENTS) >= 22


@pytest.mark.parametrize("statement", [it for it in STATEMENTS if it.function], ids=lambda it: it.name)
def test_a_statement_has_its_check_and_its_test(statement: Statement) -> None:
    module, _, name = statement.function.partition(":")
    found = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    assert callable(found)
    assert found.__doc__
    path, _, test = statement.test.partition("::")
    assert f"def {test}(" in (ROOT / path).read_text(encoding="utf-8")


def test_the_table_has_a_row_for_each() -> None:
    assert len(statements_table().splitlines()) == len(STATEMENTS) + 2
