"""A rig as a file and as equations, without ROS and without a device.

Public names, each loaded when it is asked for: a rig from its file, and its computed backbone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nmt_core.public_names import loaded

if TYPE_CHECKING:
    from nmt_rig.reference import Reference, compute_reference, write_reference_csv
    from nmt_rig.rig import Rig, load_rig
    from nmt_rig.rig_places import find_rig, rig_names

__all__ = [
    "Reference",
    "Rig",
    "compute_reference",
    "find_rig",
    "load_rig",
    "rig_names",
    "write_reference_csv",
]


def __getattr__(name: str) -> Any:
    return loaded(__name__, name)
