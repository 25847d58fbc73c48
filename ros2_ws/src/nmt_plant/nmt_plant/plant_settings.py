"""Settings of the plant node."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.messages.bundle import LOOP_INPUT, PLANT_BUNDLE
from nmt_core.messages.run_announcement import TAKEN_TOPICS
from nmt_core.nodes.node_settings import PACINGS, NodeSettings
from nmt_core.settings import setting
from nmt_plant.devices.guarded_device import LEAST_LEAD
from nmt_rig.device_sections import SIMULATED_OR_CONVERTERS


@dataclass(frozen=True)
class PlantSettings(NodeSettings):
    """What the plant drives, and how its samples go out."""

    rig_file: str = setting("", "Rig file: a path or the name of a shipped rig.")
    pacing: str = setting(
        "realtime",
        "realtime: paced by the converter; lockstep: every block waits for the drive of the one before.",
        choices=PACINGS,
    )
    latency_blocks: int = setting(
        0,
        f"Blocks of buffering between command and excitation; in real time at least the {LEAST_LEAD} that wait"
        " at the output.",
        unit="blocks",
        low=0,
        high=100,
    )
    output_record: str = setting("", "Real time: record file of the output's process; empty = none.")
    stop_file: str = setting("", "File whose existence is the external stop input; empty = none.")
    device: str = setting(
        "",
        "simulated (also empty), the rig file's device, or a kind of converter with the specimen's ports.",
        choices=("", *SIMULATED_OR_CONVERTERS),
    )
    bundle_blocks: int = setting(
        0,
        f"Blocks whose samples are also published together on {PLANT_BUNDLE}, for readers that may be late; 0 = none.",
        unit="blocks",
        low=0,
        high=100,
    )
    loop_topics: tuple[str, ...] = setting(
        ("",), f"Topics whose channel at the drive point is also published, together, on {LOOP_INPUT}; empty = none."
    )
    drive_point: int = setting(0, "Point of the exciter, for loop_topics; 0 = all their channels.", low=0)
    device_address: str = setting("", "host:port of NI's gRPC device server; empty = as the rig file says.")
    reader_lead: float = setting(
        0.0,
        "Bench time in lockstep by which the plant may be ahead of recorder and extraction, as told on "
        f"{' and '.join(TAKEN_TOPICS.values())}; 0 = any.",
        unit="s",
        low=0.0,
    )
