"""``./nmt help``: the commands, or one of them."""

from __future__ import annotations

import argparse

from nmt_core.errors import BenchError

USAGE = """\
Shows the list of commands, or the description and options of one: the same as COMMAND --help.

COMMAND* >topic  the command, and its part as in 'blind make' (default: the list)
"""


def run(arguments: argparse.Namespace) -> int:
    """Print the help.

    Raises:
        BenchError: there is no such command.
    """
    from nmt_bench.cli import build_parser
    from nmt_core.text.proposal import did_you_mean

    parser: argparse.ArgumentParser = build_parser(next(iter(arguments.topic), None))
    for name in arguments.topic:
        parts = next((action for action in parser._actions if isinstance(action, argparse._SubParsersAction)), None)
        known = {} if parts is None else parts.choices
        if name not in known:
            raise BenchError(
                f"There is no command '{' '.join(arguments.topic)}'{did_you_mean(name, known)}; './nmt help' lists all."
            )
        parser = known[name]
    parser.print_help()
    return 0
