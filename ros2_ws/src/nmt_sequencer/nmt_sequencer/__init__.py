"""Level plans and the state machine of a test run; the node is in :mod:`nmt_sequencer.sequencer_node`."""

from nmt_sequencer.level_plan import directed, parse_levels, spaced_levels
from nmt_sequencer.run_machine import Pacing, RunMachine, RunPlan

__all__ = [
    "Pacing",
    "RunMachine",
    "RunPlan",
    "directed",
    "parse_levels",
    "spaced_levels",
]
