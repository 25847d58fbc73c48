"""What ``--device`` means for a command that starts a test."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmt_bench.commands.shared_options import DeviceOptions, RigOptions
from nmt_bench.hardware.chosen_device import check_command, checked_device, look_for_device, parsed_device
from nmt_rig.device_sections import DEVICE_KINDS
from nmt_rig.one_of_several import named_as_exciter
from nmt_rig.rig import Rig, load_rig

if TYPE_CHECKING:
    from nmt_session.plan_of_test import PlanSettings


def rig_changes(options: RigOptions) -> list[str]:
    """``key=value`` texts of ``--set`` and ``--exciter``."""
    return [*options.set, *([] if options.exciter is None else [f"exciter.point={options.exciter}"])]


def chosen_rig(options: RigOptions) -> Rig:
    """The rig with the command's changes.

    Raises:
        BenchError: the rig or a change is refused.
    """
    with named_as_exciter(options.exciter):
        return load_rig(options.rig, rig_changes(options))


def device_settings(options: DeviceOptions, latency_blocks: int = 0) -> PlanSettings:
    """Pacing, latency and device of a bench; looks first whether the converter is there and its check has passed.

    Raises:
        BenchError: the device is not known, its driver or library is missing, it is not there, or its check is.
    """
    rig = chosen_rig(options)
    kind, address = parsed_device(options.device, rig)
    if kind not in DEVICE_KINDS:
        return {"pacing": options.pacing, "latency_blocks": latency_blocks}
    from nmt_plant.devices.hardware_rig import device_of

    look_for_device(device_of(rig, kind, address), rig)
    command = check_command(options.rig, options.device, rig_changes(options))
    settings = checked_device(rig, options.device, command)
    settings["pacing"] = "realtime"
    if latency_blocks:
        settings["latency_blocks"] = latency_blocks
    return settings
