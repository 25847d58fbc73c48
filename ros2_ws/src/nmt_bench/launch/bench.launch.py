"""The bench's five nodes under ``ros2 launch nmt_bench bench.launch.py rig:=… pacing:=… namespace:=… out:=…``.

The folder ``out`` gets what ``./nmt params`` writes (nodes.yaml, rig.yaml, run.json), and the bags of the runs. The
nodes close their transport to the network by themselves. When one of them ends, all end.
"""

import os
from pathlib import Path
from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from nmt_bench.orchestration.bench_files import write_bench_files
from nmt_session.node_plan import NODES

ARGUMENTS = {
    "rig": ("beam", "name of a rig that comes with the bench, or path of a rig file"),
    "pacing": ("realtime", "realtime: by the clock, as with hardware; lockstep: as fast as the machine goes"),
    "device": ("", "what is driven, as --device of ./nmt run; empty: the converter of the rig file, else simulated"),
    "namespace": ("", "namespace of all nodes and topics; /diagnostics stays where it is"),
    "out": ("bench", "folder for parameters and bags; it must not hold a bag"),
}
# The recorder may wait 4 s for the ramp to zero before it closes its bag.
PATIENCE = "8"


def generate_launch_description() -> Any:
    """What ``ros2 launch`` starts."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start_nodes)])


def start_nodes(context: Any) -> list[Any]:
    """Write the parameters of the nodes, then start them."""
    values = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    out = Path(values["out"]).resolve()
    write_bench_files(values["rig"], out, out, pacing=values["pacing"], device=values["device"])
    nodes = [
        Node(
            package=package,
            executable=executable,
            name=name,
            namespace=values["namespace"],
            parameters=[str(out / "nodes.yaml")],
            output="both",
            sigterm_timeout=PATIENCE,
            sigkill_timeout=PATIENCE,
            on_exit=Shutdown(reason=f"node {name} has ended"),
        )
        for name, (package, executable, _) in NODES.items()
    ]
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    return [LogInfo(msg=f"Bench of rig {values['rig']} in ROS domain {domain}; bags go to {out}"), *nodes]
