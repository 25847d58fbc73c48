"""The table of options against argparse called by hand."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from nmt_core.text.option_table import declare

TABLE = """\
RIG  name of a rig
BAG? >source  recording
--points N =400  frequencies,
    many or few
--control force|voltage =force  what is held
--set KEY=VALUE...  change a value; may be repeated
--port NAME :int required  of another type than its metavar
--from f1 >start  first frequency
--name NAME =""  empty where there is none
--quiet  a switch
--task hidden
@more 7
"""


def parser_of(table: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="x", add_help=False)
    declare(parser, table, shared={"more": lambda words: f"--more N ={words}  shared"})
    return parser


def test_values_have_the_types_and_defaults_of_the_table() -> None:
    words = ["beam", "--port", "3", "--set", "a=1", "--set", "b=2", "--from", "2"]
    assert vars(parser_of(TABLE).parse_args(words)) == {
        "rig": "beam", "source": None, "points": 400, "control": "force", "set": ["a=1", "b=2"], "port": 3,
        "start": 2.0, "name": "", "quiet": False, "task": False, "more": 7,
    }  # fmt: skip


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
    parser.add_argument("--quiet", action="store_true", help="a switch")
    parser.add_argument("--more", metavar="N", type=int, help="shared")
    assert parser_of(TABLE).format_help() == parser.format_help()


def test_entries_with_a_bar_exclude_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    parser = parser_of("| SIDECAR?  description\n| --init FILE  data\n")
    assert parser.parse_args(["--init", "a"]).init == Path("a")
    for words in ([], ["a", "--init", "b"]):
        with pytest.raises(SystemExit):
            parser.parse_args(words)
    assert "not allowed with" in capsys.readouterr().err
