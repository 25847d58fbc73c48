"""Keys of what a bag says of itself beside its messages, in rosbag2's custom data."""

from __future__ import annotations

RUN_JSON_KEY = "run.json"
RIG_YAML_KEY = "rig.yaml"
FAILURE_KEY = "failure"
REPAIR_KEY = "repair.json"
