"""``./nmt demo``: the paper's virtual experiment with the defaults of the beam's rig file."""

from __future__ import annotations

import argparse
from pathlib import Path

from nmt_bench.commands.output_folder import free_folder

DEFAULT_FOLDER = Path("out") / "demo"


USAGE = f"""\
Runs the virtual experiment of the reference paper (Scheel et al. 2018): a cantilever beam with a friction joint on a
Brüel & Kjær 4808 shaker, held at phase resonance while the level is stepped up. Every node is its own process;
everything is recorded to a bag. Ends with a table of modal properties and a report.

--out DIR  folder for the results (default: {DEFAULT_FOLDER}, or the next free number after it)
--domain N  ROS domain, 1 to 100 (default: a free one)
--force  replace earlier results in the folder
@page

The same test with your own settings: ./nmt run beam --out DIR
"""


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
    words += ["--domain", str(arguments.domain)] if arguments.domain is not None else []
    words += ["--page"] if arguments.page else []
    return run_parsed(build_parser("run").parse_args(words))
