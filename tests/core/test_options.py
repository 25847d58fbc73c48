"""Options from a dataclass against argparse called by hand."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import pytest

from nmt_core.options import add_options, argument, needed_option, option, option_made, optional_argument, options_of


@dataclass(frozen=True, kw_only=True)
class Shared:
    more: int = option(7, "shared", metavar="N")


@dataclass(frozen=True, kw_only=True)
class Options(Shared):
    rig: str = argument("name of a rig", metavar="RIG")
    source: Path | None = optional_argument(None, "recording", metavar="BAG")
    points: int = option(400, "frequencies, many or few", metavar="N")
    control: str = option("force", "what is held", choices=("force", "voltage"))
    set: tuple[str, ...] = option((), "change a value; may be repeated", metavar="KEY=VALUE")
    port: int = needed_option("of another type than its metavar", metavar="NAME")
    start: float | None = option(None, "first frequency", name="--from", metavar="f1")
    name: str = option("", "empty where there is none", metavar="NAME")
    folder: Path = option_made(lambda: Path("made"), "a folder", metavar="DIR")
    parsed: int | str = option(0, "a number or a word", metavar="X", parse=lambda text: text or 0)
    quiet: bool = option(False, "a switch")
    task: bool = option(False, "", hidden=True)


def parsed(kind: type, words: list[str]) -> object:
    parser = argparse.ArgumentParser(prog="x", add_help=False)
    add_options(parser, kind)
    return options_of(kind, parser.parse_args(words))


def test_options_have_the_types_and_defaults_of_the_fields() -> None:
    words = ["beam", "--port", "3", "--set", "a=1", "--set", "b=2", "--from", "2", "--parsed", "w"]
    assert parsed(Options, words) == Options(rig="beam", port=3, set=("a=1", "b=2"), start=2.0, parsed="w")
    assert parsed(Options, ["beam", "bag", "--port", "3"]) == Options(rig="beam", port=3, source=Path("bag"))


def test_help_is_that_of_options_added_by_hand() -> None:
    parser = argparse.ArgumentParser(prog="x", add_help=False)
    parser.add_argument("rig", metavar="RIG", help="name of a rig")
    parser.add_argument("source", metavar="BAG", nargs="?", type=Path, help="recording")
    parser.add_argument("--points", metavar="N", type=int, default=400, help="frequencies, many or few")
    parser.add_argument("--control", choices=("force", "voltage"), default="force", help="what is held")
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", help="change a value; may be repeated")
    parser.add_argument("--port", metavar="NAME", type=int, required=True, help="of another type than its metavar")
    parser.add_argument("--from", metavar="f1", type=float, help="first frequency")
    parser.add_argument("--name", metavar="NAME", help="empty where there is none")
    parser.add_argument("--folder", metavar="DIR", help="a folder")
    parser.add_argument("--parsed", metavar="X", help="a number or a word")
    parser.add_argument("--quiet", action="store_true", help="a switch")
    parser.add_argument("--more", metavar="N", type=int, help="shared")
    made = argparse.ArgumentParser(prog="x", add_help=False)
    add_options(made, Options)
    assert made.format_help() == parser.format_help()


@dataclass(frozen=True, kw_only=True)
class OneOfTwo:
    sidecar: Path | None = optional_argument(None, "description", metavar="SIDECAR", exclusive=True)
    init: Path | None = option(None, "data", metavar="FILE", exclusive=True)


def test_exactly_one_of_exclusive_options_is_taken(capsys: pytest.CaptureFixture[str]) -> None:
    assert parsed(OneOfTwo, ["--init", "a"]) == OneOfTwo(init=Path("a"))
    for words in ([], ["a", "--init", "b"]):
        with pytest.raises(SystemExit):
            parsed(OneOfTwo, words)
    assert "not allowed with" in capsys.readouterr().err


def test_an_option_without_a_default_cannot_be_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parsed(Options, ["beam"])
    assert "required: --port" in capsys.readouterr().err


@dataclass(frozen=True, kw_only=True)
class Several:
    words: tuple[str, ...] = optional_argument((), "words", counted="*")
    bags: tuple[Path, ...] = needed_option("bags", metavar="BAG")


def test_arguments_and_options_may_be_several() -> None:
    assert parsed(Several, ["a", "b", "--bags", "c", "--bags", "d"]) == Several(
        words=("a", "b"), bags=(Path("c"), Path("d"))
    )
