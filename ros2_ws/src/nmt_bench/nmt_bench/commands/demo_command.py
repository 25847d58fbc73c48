"""``./nmt demo``: the paper's virtual experiment with the defaults of the beam's rig file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nmt_bench.commands.output_folder import free_folder
from nmt_bench.commands.shared_options import page_option
from nmt_core.options import option, option_made

DEFAULT_FOLDER = Path("out") / "demo"


@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """Runs the virtual experiment of the reference paper (Scheel et al. 2018): a cantilever beam with a friction joint
    on a Brüel & Kjær 4808 shaker, held at phase resonance while the level is stepped up. Every node is its own
    process; everything is recorded to a bag. Ends with a table of modal properties and a report.

    The same test with your own settings: ./nmt run beam --out DIR
    """

    out: Path = option_made(
        lambda: free_folder(DEFAULT_FOLDER),
        f"folder for the results (default: {DEFAULT_FOLDER}, or the next free number after it)",
        metavar="DIR",
    )
    domain: int | None = option(None, "ROS domain, 1 to 100 (default: a free one)", metavar="N")
    force: bool = option(False, "replace earlier results in the folder")
    page: bool = page_option()


def run(options: DemoOptions) -> int:
    """Run the demo.

    Returns:
        The exit code of ``./nmt run beam``.

    Raises:
        BenchError: as ``./nmt run``.
    """
    from nmt_bench.commands.run_command import RunOptions
    from nmt_bench.commands.run_command import run as run_test

    return run_test(
        RunOptions(rig="beam", out=options.out, force=options.force, domain=options.domain, page=options.page)
    )
