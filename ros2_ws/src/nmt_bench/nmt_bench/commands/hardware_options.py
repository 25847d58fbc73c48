"""What ``--device`` means for a command that starts a test."""

from __future__ import annotations

import argparse
from typing import Any

from nmt_bench.hardware.chosen_device import check_command, checked_device, look_for_device, parsed_device
from nmt_rig.device_sections import DEVICE_KINDS
from nmt_rig.rig import Rig, load_rig


def rig_changes(arguments: argparse.Namespace) -> list[str]:
    """``key=value`` texts of ``--set`` and ``--exciter``."""
    return [*arguments.set, *([] if arguments.exciter is None else [f"exciter.point={arguments.exciter}"])]


def chosen_rig(arguments: argparse.Namespace) -> Rig:
    """The rig with the command's changes.

    Raises:
        BenchError: the rig or a change is refused.
    """
    return load_rig(arguments.rig, rig_changes(arguments))


def device_settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """Pacing, latency and device of a bench; looks first whether the converter is there and its check has passed.

    Raises:
        BenchError: the device is not known, its driver or library is missing, it is not there, or its check is.
    """
    rig = chosen_rig(arguments)
    kind, address = parsed_device(arguments.device, rig)
    own = getattr(arguments, "latency_blocks", 0)
    if kind not in DEVICE_KINDS:
        return {"pacing": arguments.pacing, "latency_blocks": own}
    from nmt_plant.devices.hardware_rig import device_of

    look_for_device(device_of(rig, kind, address), rig)
    command = check_command(arguments.rig, arguments.device, rig_changes(arguments))
    settings = {"pacing": "realtime", **checked_device(rig, arguments.device, command)}
    return settings | ({"latency_blocks": own} if own else {})
