"""Formulas that are kept between figures change no figure, and matplotlib is left as it was."""

from __future__ import annotations

import io
from typing import Any

import matplotlib
import pytest
from matplotlib.figure import Figure
from matplotlib.mathtext import MathTextParser

from nmt_report import kept_formulas as module
from nmt_report.kept_formulas import kept_formulas


def drawn(label: str, **settings: Any) -> str:
    with matplotlib.rc_context({"svg.hashsalt": "a", **settings}):
        figure = Figure(figsize=(2, 2))
        figure.subplots().set_xlabel(label)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Formulas that matplotlib has parsed."""
    formulas: list[str] = []
    parse: Any = MathTextParser._parse_cached

    def noted(parser: Any, *arguments: Any) -> Any:
        formulas.append(arguments[0])
        return parse(parser, *arguments)

    monkeypatch.setattr(MathTextParser, "_parse_cached", noted)
    monkeypatch.setattr(module, "kept", {})
    return formulas


def test_a_figure_is_the_same_and_its_formulas_are_parsed_once(parsed: list[str]) -> None:
    plain = drawn("$q_7$")
    parsed.clear()
    with kept_formulas(), kept_formulas():
        assert drawn("$q_7$") == plain
        assert "$q_7$" in parsed
        parsed.clear()
        assert drawn("$q_7$") == plain
        assert parsed == []


def test_other_settings_are_other_formulas(parsed: list[str]) -> None:
    plain = drawn("$q_7$", **{"mathtext.default": "rm"})
    with kept_formulas():
        assert drawn("$q_7$") != plain
        assert drawn("$q_7$", **{"mathtext.default": "rm"}) == plain


def test_matplotlib_is_left_as_it_was() -> None:
    before = MathTextParser._parse_cached
    with kept_formulas():
        assert MathTextParser._parse_cached is not before
    assert MathTextParser._parse_cached is before
    with pytest.raises(ValueError, match="could not convert"), kept_formulas():
        float("no figure")
    assert MathTextParser._parse_cached is before


def test_no_more_than_some_are_kept(parsed: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_KEPT", 3)
    with kept_formulas():
        for number in range(9):
            drawn(f"$q_{number}$")
    assert len(module.kept) <= 3


def test_a_parser_of_another_make_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(MathTextParser, "_parse_cached")
    with kept_formulas():
        assert not hasattr(MathTextParser, "_parse_cached")
