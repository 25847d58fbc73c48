"""``./nmt params``: parameter files for starting the nodes one by one with ``ros2 run``."""

from __future__ import annotations

import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path

from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import dated_folder_option, device_option, replace_option, set_option
from nmt_core.options import argument, option


@dataclass(frozen=True, kw_only=True)
class ParamsOptions:
    """Writes what the nodes need to test a rig: nodes.yaml for '--ros-args --params-file', rig.yaml, run.json and
    goal.json, and prints the commands that start the nodes and the run."""

    rig: str = argument("name of a rig (for example beam) or path of a rig file", metavar="RIG")
    out: Path = dated_folder_option("nodes.yaml, rig.yaml, run.json, goal.json", "params")
    force: bool = replace_option()
    exciter: int | None = option(None, "drive point (default: the rig's)", metavar="N")
    levels: str | None = option(None, "drive amplitudes in V, as in './nmt run' (default: the rig's)", metavar="PLAN")
    pacing: str = option(
        "realtime",
        "realtime: by the clock, as with hardware; lockstep: as fast as the machine goes (default: realtime)",
        choices=("lockstep", "realtime"),
    )
    device: str = device_option()
    set: tuple[str, ...] = set_option()


def run(options: ParamsOptions) -> int:
    """Write the files and print the commands.

    Raises:
        BenchError: the rig or an option is refused, or the folder cannot be written.
    """
    check_output(options.out, options.force)

    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.hardware_options import rig_changes
    from nmt_bench.orchestration.bench_files import write_bench_files
    from nmt_session.node_plan import NODES

    out: Path = options.out.resolve()
    with OutputFolder(options.out, options.force) as folder:
        write_bench_files(
            options.rig,
            folder,
            out,
            levels=options.levels,
            pacing=options.pacing,
            changes=rig_changes(options),
            device=options.device,
        )
    console = make_console()
    starter = "ros2 run" if shutil.which("ros2") else "./nmt ros"
    console.print("Start each node in a terminal of its own, the sequencer last:")
    for name in ("recorder", "extract", "pll", "plant", "sequencer"):
        package, executable, _ = NODES[name]
        console.print(
            f"  {starter} {package} {executable} --ros-args --params-file {out / 'nodes.yaml'}", soft_wrap=True
        )
    console.print("Then start the run:")
    console.print(f"  ./nmt goal {shlex.quote(str(options.out))}", soft_wrap=True)
    return 0
