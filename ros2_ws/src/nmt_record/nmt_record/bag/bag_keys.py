"""What a bag says of itself next to its messages: keys in rosbag2's custom data, and names of measurements."""

from __future__ import annotations

RUN_JSON_KEY = "run.json"
RIG_YAML_KEY = "rig.yaml"
FAILURE_KEY = "failure"
REPAIR_KEY = "repair.json"

SIMULATED_RIG = "simulated rig"
"""Device of a run: the bench simulated the rig file that the bag keeps."""


def converter_name(kind: str, name: str = "") -> str:
    """Device of a run at a converter: its kind, and the name of its specimen if known."""
    return f"{kind} ({name})" if name else kind
