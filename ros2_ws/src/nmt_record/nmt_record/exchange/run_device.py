"""What a run says of the device that it measured."""

from __future__ import annotations

SIMULATED_RIG = "simulated rig"
"""The bench simulated the rig file that the bag keeps."""


def converter_name(kind: str, name: str = "") -> str:
    """What a bag says of a converter: its kind, and the name of what is known to be behind it."""
    return f"{kind} ({name})" if name else kind
