"""``./nmt goal``: starts the run of nodes that were started one by one."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from nmt_bench.command_parser import EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED
from nmt_core.errors import BenchError
from nmt_core.options import argument, option

_PATIENCE = 20.0  # s for the sequencer to be found and to answer


@dataclass(frozen=True, kw_only=True)
class GoalOptions:
    """Sends the plan of './nmt params' to the sequencer that runs, and shows the run until it is over. Ctrl-C takes the
    drive to zero and closes the bag; the nodes go on."""

    folder: Path = argument("folder of './nmt params', which has goal.json", metavar="DIR")
    domain: int | None = option(None, "ROS domain of the nodes (default: that of ROS_DOMAIN_ID)", metavar="N")
    namespace: str = option("", "namespace of the nodes (default: none)", metavar="NAME")


def run(options: GoalOptions) -> int:
    """Send the goal and wait for its end.

    Returns:
        0 where the plan was worked through, 1 where the run ended before, 130 after Ctrl-C.

    Raises:
        BenchError: no goal in the folder, no sequencer that answers, or one that refuses.
    """
    from nmt_bench.orchestration.bench_files import GOAL_FILE
    from nmt_core.files.hardened import read_json
    from nmt_rig.rig import load_rig

    goal = read_json(options.folder / GOAL_FILE, "plan of a run")
    if not isinstance(levels := goal.get("levels"), list) or not levels:
        raise BenchError(f"{options.folder / GOAL_FILE} holds no plan of a run; write it anew with './nmt params'.")
    rig = load_rig(options.folder / "rig.yaml")
    domain = options.domain
    if domain is None:
        stated = os.environ.get("ROS_DOMAIN_ID", "0")
        domain = int(stated) if stated.isdigit() else 0
    if not 0 <= domain <= 232:
        raise BenchError(f"A ROS domain must be from 0 to 232, got {domain}.")

    from nmt_bench.commands.run_progress import RunProgress
    from nmt_bench.orchestration.run_client_node import run_with_bench
    from nmt_core.vocabulary import ResultCode

    with RunProgress(rig.sample_rate_hz, len(levels)) as progress:
        result, interrupted = run_with_bench(domain, options.namespace, goal, progress.update, _PATIENCE)
    progress.note(result.message)
    if interrupted:
        return EXIT_INTERRUPTED
    return EXIT_DONE if result.result_code == ResultCode.SUCCEEDED else EXIT_FAILED
