"""Settings of the sequencer node."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.nodes.node_settings import PACINGS, NodeSettings
from nmt_core.settings import group, setting
from nmt_sequencer.level_plan import LevelLimits


@dataclass(frozen=True)
class SequencerSettings(NodeSettings):
    """What the sequencer goes by: blocks, what a goal leaves open, and how long it waits."""

    sample_rate: float = setting(10000.0, "Sample rate of the rig.", unit="Hz", low=1.0)
    block_samples: int = setting(200, "Samples a block.", unit="samples", low=2, high=100000)
    pacing: str = setting("lockstep", "lockstep for simulated rigs, realtime for hardware.", choices=PACINGS)
    tick_blocks: int = setting(5, "Blocks between two decisions.", unit="blocks", low=1, high=1000)
    latency_blocks: int = setting(0, "Buffering between command and excitation.", unit="blocks", low=0, high=100)
    ramp: float = setting(0.5, "Half-cosine between levels if the goal gives none.", unit="s", low=0.0)
    quiet_ramp: float = setting(0.5, "Half-cosine to zero at the end of a run.", unit="s", low=0.0)
    window_periods: int = setting(
        200, "Whole periods a window if the goal gives none.", unit="periods", low=1, high=1000000
    )
    timeout: float = setting(60.0, "Bench time a level may take to lock if the goal gives none.", unit="s", low=0.0)
    open_loop_abort: bool = setting(True, "End a phase resonance test after a level without force or response.")
    ready_timeout: float = setting(
        30.0,
        "Wait for all watched nodes before a run.",
        unit="s",
        low=0.1,
    )
    stall_timeout: float = setting(
        20.0,
        "Time without an answered block that ends the run.",
        unit="s",
        low=1.0,
    )
    recording: bool = setting(True, "A run needs an open bag.")
    points_timeout: float = setting(
        30.0,
        "Time without progress of extraction before missing points are given up.",
        unit="s",
        low=0.0,
    )
    limits: LevelLimits = group(LevelLimits)
