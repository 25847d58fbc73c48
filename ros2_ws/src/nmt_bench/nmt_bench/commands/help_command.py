"""``./nmt help``: the commands, or one of them."""

from __future__ import annotations

import argparse

from nmt_core.errors import BenchError

Subparsers = argparse._SubParsersAction


def add_parser(subparsers: Subparsers[argparse.ArgumentParser]) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "help",
        help="the commands, or the options of one",
        description="Shows the list of commands, or the description and options of one: the same as COMMAND --help.",
    )
    parser.add_argument("topic", metavar="COMMAND", nargs="?", help="the command (default: the list of all)")


def run(arguments: argparse.Namespace) -> int:
    """Print the help.

    Raises:
        BenchError: there is no such command.
    """
    from nmt_bench.cli import COMMANDS, build_parser
    from nmt_core.proposal import did_you_mean

    name = arguments.topic
    parser = build_parser(name)
    if name is None:
        parser.print_help()
        return 0
    if name not in COMMANDS:
        raise BenchError(f"There is no command '{name}'{did_you_mean(name, COMMANDS)}; './nmt help' lists all.")
    group = next(action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    group.choices[name].print_help()
    return 0
