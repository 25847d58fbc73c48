"""What ``--device`` means for a command that starts a test."""

from __future__ import annotations

import argparse
import math
from typing import Any

from nmt_core.errors import BenchError
from nmt_rig.device_sections import DEVICE_KINDS, SIMULATED_OR_CONVERTERS, AnyDevice
from nmt_rig.rig import Rig, load_rig


def chosen_rig(arguments: argparse.Namespace) -> Rig:
    """The rig with the command's changes.

    Raises:
        BenchError: the rig or a change is refused.
    """
    changes = list(arguments.set)
    if arguments.exciter is not None:
        changes.append(f"exciter.point={arguments.exciter}")
    return load_rig(arguments.rig, changes)


def parsed_device(text: str, rig: Rig) -> tuple[str, str]:
    """Kind and address of ``--device``; the rig file's own where it says nothing.

    Raises:
        BenchError: a kind that is not known.
    """
    kind, _, address = text.partition("@")
    if kind and kind not in SIMULATED_OR_CONVERTERS:
        raise BenchError(f"--device '{kind}' is not known; use {', '.join(SIMULATED_OR_CONVERTERS)}.")
    if address and kind != "nidaqmx":
        raise BenchError("--device takes an address for nidaqmx only, as in nidaqmx@localhost:31763.")
    if not kind and rig.device is not None:
        kind = rig.device.kind
    return kind, address


def device_settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """Pacing and device of a bench; looks first whether the converter is there, and whether its check has passed.

    Raises:
        BenchError: the device is not known, its driver or library is missing, it is not there, or its check is.
    """
    rig = chosen_rig(arguments)
    kind, address = parsed_device(arguments.device, rig)
    if kind not in DEVICE_KINDS:
        return {"pacing": arguments.pacing}
    from nmt_bench.commands.hardware_checks import require_check
    from nmt_plant.hardware_rig import HARDWARE_LEAD, device_of

    section = device_of(rig, kind, address)
    look_for_device(section, rig)
    checked = require_check(rig, section, _check_command(arguments))
    settings: dict[str, Any] = {"pacing": "realtime", "device": kind, "device_address": address}
    if not getattr(arguments, "latency_blocks", 0):
        # As much delay as the check has found, and the usual blocks that may be late.
        settings["latency_blocks"] = HARDWARE_LEAD + math.ceil(int(checked["delay_samples"]) / rig.block_samples)
    return settings


def _check_command(arguments: argparse.Namespace) -> str:
    """The command that makes the check of a test."""
    words = ["./nmt check", str(arguments.rig)]
    words += [f"--device {arguments.device}"] if arguments.device else []
    words += [f"--exciter {arguments.exciter}"] if arguments.exciter is not None else []
    words += [f"--set {change}" for change in arguments.set]
    return " ".join(words)


def look_for_device(section: AnyDevice, rig: Rig) -> None:
    """Refuse a converter that is not there, before anything is started.

    Raises:
        BenchError: driver, library or device is missing, with what mends it.
    """
    if section.kind == "portaudio":
        from nmt_plant.portaudio_converter import find_device, list_devices

        ports = [
            max(int(entry.port) for entry in section.inputs),
            max(int(entry.port) for entry in section.outputs),
        ]
        devices = list_devices()
        found = devices[find_device(devices, section.name, section.host_api, *ports)]
        if "jack" in found["host_api"].lower() and round(found["rate"]) != round(rig.sample_rate_hz):
            raise BenchError(
                f"The JACK server runs at {found['rate']:g} Hz and rig {rig.name} at {rig.sample_rate_hz:g} Hz; write "
                f"--set sample_rate_hz={found['rate']:g}, or start the server at the rig's rate."
            )
        return
    from nmt_plant.nidaqmx_converter import find_channels

    find_channels(section.address, [str(entry.port) for entry in section.ports])
