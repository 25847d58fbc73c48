"""``./nmt params``: parameter files for starting the nodes one by one with ``ros2 run``."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.commands.output_folder import OutputFolder, add_output_options, check_output

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


def add_parser(subparsers: Subparsers) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "params",
        help="parameter file of a rig for starting the nodes with 'ros2 run'",
        description=(
            "Writes what the nodes need to test a rig: nodes.yaml for '--ros-args --params-file', rig.yaml and "
            "run.json, and prints the commands that start the nodes and the run."
        ),
    )
    parser.add_argument("rig", metavar="RIG", help="name of a rig (for example beam) or path of a rig file")
    add_output_options(parser, "nodes.yaml, rig.yaml, run.json")
    parser.add_argument("--exciter", metavar="N", type=int, help="drive point (default: the rig's)")
    parser.add_argument(
        "--levels", metavar="PLAN", help="drive amplitudes in V, as in './nmt run' (default: the rig's)"
    )
    parser.add_argument(
        "--pacing",
        choices=("lockstep", "realtime"),
        default="realtime",
        help="realtime: by the clock, as with hardware; lockstep: as fast as the machine goes (default: realtime)",
    )
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="change a value of the rig file; may be repeated",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the files and print the commands.

    Raises:
        BenchError: the rig or an option is refused, or the folder cannot be written.
    """
    check_output(arguments.out, arguments.force)

    from nmt_bench.commands.terminal import make_console
    from nmt_rig.rig import load_rig
    from nmt_rig.rig_snapshot import rig_text
    from nmt_sequencer.level_plan import parse_levels
    from nmt_session.node_plan import NODES, TestPlan, plan_nodes

    changes = list(arguments.set)
    if arguments.exciter is not None:
        changes.append(f"exciter.point={arguments.exciter}")
    rig = load_rig(arguments.rig, changes)
    text = rig_text(rig, arguments.rig, changes)
    test = TestPlan(
        rig=rig,
        rig_yaml=text,
        levels=tuple(parse_levels(arguments.levels or rig.test.levels)),
        run_id=time.strftime(f"{rig.name}-%Y%m%d-%H%M%S"),
        pacing=arguments.pacing,
    )
    out: Path = arguments.out.resolve()
    plan = plan_nodes(test, out / "bag", out / "rig.yaml")
    with OutputFolder(arguments.out, arguments.force) as folder:
        (folder / "rig.yaml").write_text(text, encoding="utf-8")
        (folder / "run.json").write_text(json.dumps(plan.run, indent=2) + "\n", encoding="utf-8")
        plan.write_parameters(folder / "nodes.yaml")
    console = make_console()
    console.print("Start each node in a terminal of its own, the sequencer last:")
    for name in ("recorder", "extract", "pll", "plant", "sequencer"):
        package, executable, _ = NODES[name]
        console.print(
            f"  ros2 run {package} {executable} --ros-args --params-file {out / 'nodes.yaml'}",
            markup=False,
            soft_wrap=True,
        )
    console.print("Then start the run:")
    console.print(
        f"  ros2 action send_goal --feedback /run_levels nmt_msgs/action/RunLevels '{json.dumps(plan.goal)}'",
        markup=False,
        soft_wrap=True,
    )
    sys.stdout.flush()
    return 0
