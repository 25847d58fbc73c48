"""Arguments and options of a command from a table that reads as its help does.

An entry is a line: the words, two spaces, the help; lines that are indented go on with the help. ::

    RIG  name of a rig
    BAG? >source  positional that may be missing, as ``arguments.source``
    --linear FILE  a path; a metavar says the type, see below
    --points N =400  an integer with its default
    --control force|voltage =force  one of these
    --set KEY=VALUE...  may be repeated; a list
    --seed N required  cannot be left out
    --port NAME :int  of another type than that of its metavar
    --quiet  a switch
    --task hidden
    @device  entries that several commands share

Entries that begin with a bar exclude each other, and one of them is needed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from nmt_core.text.text_table import entries

_PATHS = ("FILE", "DIR", "BAG", "SIDECAR", "RUN_OUT", "SWEEP_OUT")
_NUMBERS = ("S", "V", "HZ", "PT", "PPM", "f1", "f2", "r")
_KINDS: dict[str, Callable[[str], Any]] = {
    "int": int, "float": float, "text": str, "N": int, "H": int,
    **dict.fromkeys(_PATHS, Path), **dict.fromkeys(_NUMBERS, float),
}  # fmt: skip


def declare(
    parser: argparse.ArgumentParser,
    table: str,
    kinds: Mapping[str, Callable[[str], Any]] | None = None,
    shared: Mapping[str, str | Callable[[str], str]] | None = None,
) -> None:
    """Add the entries of a table to a parser.

    Args:
        parser: gets them.
        table: as described above.
        kinds: types beyond the known ones, by the name behind the colon.
        shared: entries that one with ``@`` stands for, or a function that makes them of the words behind it.
    """
    known = {**_KINDS, **(kinds or {})}
    exclusive: Any = None
    for head, words in entries(table):
        if head.startswith("@"):
            name, _, rest = head[1:].partition(" ")
            meaning = (shared or {})[name]
            declare(parser, meaning if isinstance(meaning, str) else meaning(rest), kinds, shared)
            continue
        if head.startswith("| ") and exclusive is None:
            exclusive = parser.add_mutually_exclusive_group(required=True)
        name, settings = _settings(head.removeprefix("| "), known)
        (exclusive if head.startswith("| ") else parser).add_argument(name, **{"help": words, **settings})


def _settings(head: str, kinds: Mapping[str, Callable[[str], Any]]) -> tuple[str, dict[str, Any]]:
    """First argument of ``add_argument`` and the others."""
    word, *marks = head.split(" ")
    name, settings = word, dict[str, Any]()
    if not word.startswith("-"):
        word, settings = _counted(word)
        if word.isupper():
            settings["metavar"] = word
        name = word.lower()
    kind, default = "", None
    for mark in marks:
        if mark == "required":
            settings["required"] = True
        elif mark == "hidden":
            settings["help"] = argparse.SUPPRESS
        elif mark.startswith("="):
            default = mark[1:].strip('"')
        elif mark.startswith(":"):
            kind = mark[1:]
        elif mark.startswith(">") and name.startswith("-"):
            settings["dest"] = mark[1:]
        elif mark.startswith(">"):
            name = mark[1:]
        else:
            mark, more = _counted(mark)
            settings |= more
            if "|" in mark:
                settings["choices"] = tuple(mark.split("|"))
            else:
                settings["metavar"] = mark
    known = kinds.get(kind or str(settings.get("metavar", "")))
    if known is not None:
        settings["type"] = known
    if default is not None:
        settings["default"] = default if known is None else known(default)
    if name.startswith("-") and not settings.keys() & {"metavar", "choices"}:
        settings["action"] = "store_true"
    return name, settings


def _counted(word: str) -> tuple[str, dict[str, Any]]:
    """A word without the mark of its count, and what that mark says."""
    if word.endswith("..."):
        return word[:-3], {"action": "append", "default": []}
    return (word[:-1], {"nargs": word[-1]}) if word[-1] in "?*" else (word, {})
