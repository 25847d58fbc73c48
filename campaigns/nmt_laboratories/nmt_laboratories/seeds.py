"""Campaigns over random structures: one line for each seed, and how many ended how."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from joblib import Parallel, delayed


def seed_parser(description: str | None, first: int, count: int) -> argparse.ArgumentParser:
    """Options of a campaign: which seeds, and how many processes.

    Args:
        description: of the command.
        first, count: defaults.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=first, metavar="SEED", help=f"first seed (default {first})")
    parser.add_argument("--count", type=int, default=count, metavar="N", help=f"structures (default {count})")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default 2)")
    return parser


def print_ends(work: Sequence[tuple[Any, ...]], judge: Callable[..., tuple[str, str]], jobs: int) -> None:
    """Print the line of each piece of work as it is known, in their order, and how many ended how.

    Args:
        work: arguments of ``judge``.
        judge: gives a line, and how it ended.
        jobs: processes.
    """
    ends: Counter[str] = Counter()
    for line, end in Parallel(n_jobs=jobs, return_as="generator")(delayed(judge)(*item) for item in work):
        print(line, flush=True)
        ends[end] += 1
    print(", ".join(f"{name} {count}" for name, count in sorted(ends.items())))
