"""Level plans and the state machine of a test run; the node is in :mod:`nmt_sequencer.sequencer_node`."""

from nmt_sequencer.level_plan import RunPlan, directed, parse_levels, spaced_levels
from nmt_sequencer.run_machine import Pacing, RunMachine
from nmt_sequencer.steering import PRESENT_LEVEL, SteeringRequest

__all__ = [
    "PRESENT_LEVEL",
    "Pacing",
    "RunMachine",
    "RunPlan",
    "SteeringRequest",
    "directed",
    "parse_levels",
    "spaced_levels",
]
