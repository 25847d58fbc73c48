"""``./nmt help``: the commands, or one of them."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from nmt_core.errors import BenchError
from nmt_core.options import optional_argument


@dataclass(frozen=True, kw_only=True)
class HelpOptions:
    """Shows the list of commands, or the description and options of one: the same as COMMAND --help."""

    topic: tuple[str, ...] = optional_argument(
        (), "the command, and its part as in 'blind make' (default: the list)", metavar="COMMAND", counted="*"
    )


def run(options: HelpOptions) -> int:
    """Print the help.

    Raises:
        BenchError: no such command exists.
    """
    from nmt_bench.cli import build_parser
    from nmt_core.text.proposal import did_you_mean

    parser: argparse.ArgumentParser = build_parser(next(iter(options.topic), None))
    for name in options.topic:
        parts = next((action for action in parser._actions if isinstance(action, argparse._SubParsersAction)), None)
        known = {} if parts is None else parts.choices
        if name not in known:
            raise BenchError(
                f"There is no command '{' '.join(options.topic)}'{did_you_mean(name, known)}; './nmt help' lists all."
            )
        parser = known[name]
    parser.print_help()
    return 0
