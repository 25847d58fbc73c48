"""``./nmt params``: parameter files for starting the nodes one by one with ``ros2 run``."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from nmt_bench.commands.output_folder import OutputFolder, check_output

USAGE = """\
Writes what the nodes need to test a rig: nodes.yaml for '--ros-args --params-file', rig.yaml and run.json, and prints
the commands that start the nodes and the run.

RIG  name of a rig (for example beam) or path of a rig file
@output nodes.yaml, rig.yaml, run.json
--exciter N  drive point (default: the rig's)
--levels PLAN  drive amplitudes in V, as in './nmt run' (default: the rig's)
--pacing lockstep|realtime =realtime  realtime: by the clock, as with hardware; lockstep: as fast as the machine goes
    (default: realtime)
@device
@set
"""


def run(arguments: argparse.Namespace) -> int:
    """Write the files and print the commands.

    Raises:
        BenchError: the rig or an option is refused, or the folder cannot be written.
    """
    check_output(arguments.out, arguments.force)

    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.hardware_options import rig_changes
    from nmt_bench.orchestration.bench_files import write_bench_files
    from nmt_session.node_plan import NODES

    out: Path = arguments.out.resolve()
    with OutputFolder(arguments.out, arguments.force) as folder:
        plan = write_bench_files(
            arguments.rig,
            folder,
            out,
            levels=arguments.levels,
            pacing=arguments.pacing,
            changes=rig_changes(arguments),
            device=arguments.device,
        )
    console = make_console()
    console.print("Start each node in a terminal of its own, the sequencer last:")
    for name in ("recorder", "extract", "pll", "plant", "sequencer"):
        package, executable, _ = NODES[name]
        console.print(
            f"  ros2 run {package} {executable} --ros-args --params-file {out / 'nodes.yaml'}", soft_wrap=True
        )
    console.print("Then start the run:")
    console.print(
        f"  ros2 action send_goal --feedback /run_levels nmt_msgs/action/RunLevels '{json.dumps(plan.goal)}'",
        soft_wrap=True,
    )
    return 0
