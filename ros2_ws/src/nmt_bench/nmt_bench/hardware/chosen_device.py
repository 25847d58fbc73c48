"""Which converter a test drives: the words of ``--device``, whether it is there, and what its check has found."""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from nmt_bench.hardware.hardware_checks import require_check
from nmt_core.errors import BenchError
from nmt_rig.device_sections import DEVICE_KINDS, DEVICES, SIMULATED_OR_CONVERTERS, AnyDevice
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_session.plan_of_test import PlanSettings


def parsed_device(text: str, rig: Rig) -> tuple[str, str]:
    """Kind and address of ``--device``; the rig file's own where it says nothing.

    Raises:
        BenchError: a kind that is not known.
    """
    kind, _, address = text.partition("@")
    if kind and kind not in SIMULATED_OR_CONVERTERS:
        raise BenchError(f"--device '{kind}' is not known; use {', '.join(SIMULATED_OR_CONVERTERS)}.")
    if address and not (kind in DEVICES and DEVICES[kind].addressed):
        addressed = " and ".join(name for name, section in DEVICES.items() if section.addressed)
        raise BenchError(f"--device takes an address for {addressed} only, as in {addressed}@localhost:31763.")
    if not kind and rig.device is not None:
        kind = rig.device.kind
    return kind, address


def checked_device(rig: Rig, device: str, command: str) -> PlanSettings:
    """Settings of a test for what is driven: of a converter only where its check has passed.

    Args:
        rig: with all changes.
        device: as ``--device``.
        command: that makes the check, for the sentence.

    Raises:
        BenchError: the device is not known, or its check is missing.
    """
    kind, address = parsed_device(device, rig)
    if kind not in DEVICE_KINDS:
        return {"device": kind}
    from nmt_plant.devices.hardware_rig import HARDWARE_LEAD, device_of

    checked = require_check(rig, device_of(rig, kind, address), command)
    # As much delay as the check has found, and the usual blocks that may be late.
    blocks = HARDWARE_LEAD + math.ceil(int(checked["delay_samples"]) / rig.block_samples)
    return {"device": kind, "device_address": address, "latency_blocks": blocks}


def check_command(rig: str, device: str, changes: Sequence[str]) -> str:
    """The command that makes the check of a test, from its rig, ``--device`` and ``key=value`` texts."""
    words = ["./nmt check", str(rig)]
    words += [f"--device {device}"] if device else []
    for change in changes:
        key, _, value = change.partition("=")
        words.append(f"--exciter {value}" if key == "exciter.point" else f"--set {change}")
    return " ".join(words)


def look_for_device(section: AnyDevice, rig: Rig) -> None:
    """Refuse a converter that is not there, before anything is started.

    Raises:
        BenchError: driver, library or device is missing, with what fixes it.
    """
    if section.finder:
        module, _, function = section.finder.partition(":")
        getattr(importlib.import_module(module), function)(section, rig)
