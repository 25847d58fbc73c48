"""From a command's module to its parser, and from what the parser finds back to the command's options.

The options of a command are the class that its ``run`` takes, see `nmt_core.options`. The first paragraph of the
class's docstring is the command's description, what follows stands below the options (or ``EPILOG``, where that is
computed). A command with parts has ``PART_COMMANDS``, a function for each, and ``DESCRIPTION``.
"""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable
from types import ModuleType
from typing import Any, get_type_hints

from nmt_core.options import add_options, options_of

_JSON = "print one JSON document (exit code, files, results) on standard output, all else on standard error"


def add_command(parser: argparse.ArgumentParser, command: ModuleType) -> None:
    """Give a command's parser what its module states."""
    parts: dict[str, Callable[[Any], int]] | None = getattr(command, "PART_COMMANDS", None)
    if parts is None:
        kind = _options_class(command.run)
        _describe(parser, kind)
        _add(parser, kind)
        return
    parser.description = command.DESCRIPTION
    places = parser.add_subparsers(dest="part", metavar="PART", title="parts", required=True)
    for name, run in parts.items():
        kind = _options_class(run)
        _add(places.add_parser(name, help=inspect.cleandoc(kind.__doc__ or "")), kind)


def run_command(command: ModuleType, arguments: argparse.Namespace) -> int:
    """Run a command, or its part, with its options.

    Raises:
        BenchError: a mistake that the user can fix.
    """
    return int(_runner(command, arguments)(command_options(command, arguments)))


def command_options(command: ModuleType, arguments: argparse.Namespace) -> Any:
    """Options of a command, or of its part."""
    return options_of(_options_class(_runner(command, arguments)), arguments)


def _runner(command: ModuleType, arguments: argparse.Namespace) -> Callable[[Any], int]:
    parts: dict[str, Callable[[Any], int]] | None = getattr(command, "PART_COMMANDS", None)
    run: Callable[[Any], int] = command.run if parts is None else parts[arguments.part]
    return run


def _options_class(run: Callable[[Any], int]) -> type:
    kind: type = get_type_hints(run)["options"]
    return kind


def _describe(parser: argparse.ArgumentParser, kind: type) -> None:
    above, _, below = inspect.cleandoc(kind.__doc__ or "").partition("\n\n")
    below = getattr(kind, "EPILOG", below).rstrip()
    parser.description = " ".join(above.split())
    if below:
        parser.epilog = below
    if "\n" in below:
        parser.formatter_class = argparse.RawDescriptionHelpFormatter


def _add(parser: argparse.ArgumentParser, kind: type) -> None:
    add_options(parser, kind)
    if "--json" not in parser._option_string_actions:
        parser.add_argument("--json", action="store_true", help=_JSON)
