"""Level plans and the state machine of a test run; the node is in :mod:`nmt_sequencer.sequencer_node`."""

from nmt_sequencer.level_plan import directed, parse_levels, spaced_levels
from nmt_sequencer.run_machine import Pacing, ResultCode, RunMachine, RunPhase, RunPlan

__all__ = [
    "Pacing",
    "ResultCode",
    "RunMachine",
    "RunPhase",
    "RunPlan",
    "directed",
    "parse_levels",
    "spaced_levels",
]
