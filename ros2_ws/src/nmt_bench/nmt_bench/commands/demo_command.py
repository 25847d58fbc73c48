"""``./nmt demo``: the paper's virtual experiment with the defaults of the beam's rig file."""

from __future__ import annotations

import argparse
from pathlib import Path

from nmt_bench.command_parser import Subparsers
from nmt_bench.commands.bench_options import add_page_option
from nmt_bench.commands.output_folder import free_folder

DEFAULT_FOLDER = Path("out") / "demo"


def add_parser(subparsers: Subparsers) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "demo",
        help="the paper's virtual experiment, from the first node to the report",
        description=(
            "Runs the virtual experiment of the reference paper (Scheel et al. 2018): a cantilever beam "
            "with a friction joint on a Brüel & Kjær 4808 shaker, held at phase resonance while the level "
            "is stepped up. Every node is its own process; everything is recorded to a bag. Ends with a "
            "table of modal properties and a report."
        ),
        epilog="The same test with your own settings: ./nmt run beam --out DIR",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help=f"folder for the results (default: {DEFAULT_FOLDER}, or the next free number after it)",
    )
    parser.add_argument("--domain", metavar="N", help="ROS domain, 1 to 100 (default: a free one)")
    parser.add_argument("--force", action="store_true", help="replace earlier results in the folder")
    add_page_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the demo.

    Returns:
        The exit code of ``./nmt run beam``.

    Raises:
        BenchError: as ``./nmt run``.
    """
    from nmt_bench.cli import build_parser, run_parsed

    folder = arguments.out if arguments.out is not None else free_folder(DEFAULT_FOLDER)
    arguments.out = folder
    words = ["run", "beam", "--out", str(folder)] + (["--force"] if arguments.force else [])
    words += ["--domain", arguments.domain] if arguments.domain is not None else []
    words += ["--page"] if arguments.page else []
    return run_parsed(build_parser("run").parse_args(words))
