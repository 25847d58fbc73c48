"""The frame of campaigns: seeds, sealed cases, answers that are kept and not computed again, how many ended how."""

from __future__ import annotations

import argparse
import hashlib
import json
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from nmt_core.errors import BenchError

SEAL = "seal.txt"


def command_parser(description: str | None) -> argparse.ArgumentParser:
    """Parser of a command whose help is the text of its module."""
    return argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)


def seeds_of(text: str) -> range:
    """Seeds of "first:end" or "first:end:step", the end left out.

    Raises:
        argparse.ArgumentTypeError: it is no such range.
    """
    numbers = text.split(":")
    if len(numbers) not in (2, 3) or not all(number.isdigit() for number in numbers):
        raise argparse.ArgumentTypeError(f"seeds are FIRST:END or FIRST:END:STEP, such as 0:40; got {text}")
    first, end, step = (*map(int, numbers), 1)[:3]
    if step == 0 or first >= end:
        raise argparse.ArgumentTypeError(f"seeds {text} are none: END is to be above FIRST, STEP at least 1")
    return range(first, end, step)


def seed_parser(description: str | None, first: int, count: int, kept: bool = False) -> argparse.ArgumentParser:
    """Options of a campaign over seeds.

    Args:
        description: of the command.
        first, count: defaults.
        kept: whether a folder keeps the answers.
    """
    parser = command_parser(description)
    parser.add_argument("--first", type=int, default=first, metavar="SEED", help=f"first seed (default {first})")
    parser.add_argument("--count", type=int, default=count, metavar="N", help=f"structures (default {count})")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default 2)")
    if kept:
        parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="gets the answer of each seed")
    return parser


def answers_of_seeds(
    options: argparse.Namespace, answered: Callable[[int], dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """The answer of each seed, in their order, as it is known."""
    options.out.mkdir(parents=True, exist_ok=True)
    seeds = range(options.first, options.first + options.count)
    work = (delayed(kept_answer)(options.out / f"{seed}.json", answered, seed) for seed in seeds)
    yield from Parallel(n_jobs=options.jobs, return_as="generator")(work)


def kept_answer(path: Path, answered: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
    """What the file holds; where it is absent, what is computed is written first."""
    if not path.exists():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            answer = answered(*arguments)
        path.write_text(json.dumps(answer, indent=1, ensure_ascii=False, default=float), encoding="utf-8")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def judged_in_parallel(
    work: Iterable[tuple[Any, ...]], judge: Callable[..., tuple[str, str]], jobs: int
) -> Iterator[tuple[str, str]]:
    """A line and an end of each piece of work, in their order, as they are known."""
    yield from Parallel(n_jobs=jobs, return_as="generator")(delayed(judge)(*item) for item in work)


def print_ends(lines: Iterable[tuple[str, str]]) -> None:
    """Print each line as it is known, and how many ended how."""
    ends: Counter[str] = Counter()
    for line, end in lines:
        print(line, flush=True)
        ends[end] += 1
    print(", ".join(f"{name} {count}" for name, count in sorted(ends.items())))


def sealed_parser(
    description: str | None,
) -> tuple[argparse.ArgumentParser, argparse.ArgumentParser, argparse.ArgumentParser]:
    """Parser of a sealed campaign, that of ``make`` and that of ``read``."""
    parser = command_parser(description)
    parts = parser.add_subparsers(dest="part", required=True)
    maker, reader = parts.add_parser("make"), parts.add_parser("read")
    reader.add_argument("cases", type=Path)
    reader.add_argument("--only", default="", help="parts of names, with commas between them (default: all)")
    for part in (maker, reader):
        part.add_argument("--out", type=Path, required=True)
    return parser, maker, reader


def digest_of(cases: Path) -> str:
    """SHA-256 of all truths, in the order of their names."""
    digest = hashlib.sha256()
    for truth in sorted(cases.glob("*/truth.yaml")):
        digest.update(truth.parent.name.encode() + truth.read_bytes())
    return digest.hexdigest()


def seal(cases: Path) -> None:
    """Write the digest of all truths into their folder."""
    (cases / SEAL).write_text(digest_of(cases) + "\n", encoding="utf-8")


def sealed_answers(
    options: argparse.Namespace, read_case: Callable[[Path], dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """The answer to each case that is asked for, in the order of their names; a refused case is printed.

    Raises:
        SystemExit: the truths are not those that were sealed.
    """
    if (options.cases / SEAL).read_text(encoding="utf-8").strip() != digest_of(options.cases):
        raise SystemExit(f"the truths in {options.cases} are not those that were sealed; make the cases anew")
    options.out.mkdir(parents=True, exist_ok=True)
    for truth in sorted(options.cases.glob("*/truth.yaml")):
        folder = truth.parent
        if not any(part in folder.name for part in options.only.split(",")):
            continue
        try:
            yield kept_answer(options.out / f"{folder.name}.json", read_case, folder)
        except BenchError as error:
            print(f"{folder.name}: {error}", flush=True)
