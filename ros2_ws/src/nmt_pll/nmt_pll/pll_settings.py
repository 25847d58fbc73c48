"""Settings of the PLL node."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.kinds import METHODS
from nmt_core.messages.bundle import LOOP_INPUT, PLL_BUNDLE
from nmt_core.nodes.node_settings import NodeSettings
from nmt_core.settings import group, setting
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.paper_settings import PaperSettings

PAPER_PREFIX = "paper_"
"""Before the names of the settings of the paper's loop where they are parameters of the node."""


@dataclass(frozen=True)
class PllSettings(NodeSettings):
    """What the PLL node needs to know: the rig's points and blocks, and the settings of its loops."""

    linear_json: str = setting("", "Linear description (linear.json); empty = no phase control.")
    force_per_volt_json: str = setting(
        "",
        "Force per volt as JSON, rows of Hz, real and imaginary part (N/V); else it is probed.",
    )
    drive_point: int = setting(0, "Point of the exciter without a linear description.", low=0)
    exciters: int = setting(1, "Exciters of a random test, each with its own noise.", low=1, high=64)
    sample_rate: float = setting(10000.0, "Sample rate of the blocks.", unit="Hz", low=1.0)
    block_samples: int = setting(200, "Samples a block.", unit="samples", low=2, high=100000)
    response_topic: str = setting(
        "displacement",
        "Topic of the drive-point response whose phase is controlled.",
        choices=("displacement", "velocity", "acceleration"),
    )
    loop: str = setting(
        "adaptive",
        "adaptive: adaptive filter, closed-form gains, guard band; paper: product detector, low-pass, PI.",
        choices=("adaptive", "paper"),
    )
    bundle_blocks: int = setting(
        0,
        f"Blocks whose drive commands and states are also published together on {PLL_BUNDLE}; 0 = none.",
        unit="blocks",
        low=0,
        high=100,
    )
    joined_input: bool = setting(
        False, f"Take force and response at the drive point, joined, from {LOOP_INPUT} in place of their own topics."
    )
    settling_time: float = setting(2.0, "Random test: between the end of the ramp and the window.", unit="s", low=0.0)
    self_excited_method: str = setting("auto", "Self-excited test: method; auto = what is stable.", choices=METHODS)
    response_limit: float = setting(
        0.0,
        "Self-excited test: response limit; at 85 % the motion is damped; 0 = none.",
        low=0.0,
    )
    loop_settings: LoopSettings = group(LoopSettings)
    paper_settings: PaperSettings = group(PaperSettings, prefix=PAPER_PREFIX)
