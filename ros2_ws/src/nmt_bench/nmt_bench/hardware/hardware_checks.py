"""Where the last check of a bench is kept, and whether a test may begin on it.

The file lies in the user's state folder (XDG_STATE_HOME, else ~/.local/state), named by the rig and by what was
checked: channel map, sensors, limits, sample rate. A change of any of them asks for a new check.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from pathlib import Path
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.files.whole_file import write_whole
from nmt_rig.device_sections import AnyDevice
from nmt_rig.rig import Rig


def fingerprint(rig: Rig, section: AnyDevice) -> str:
    """SHA-256 of the subject of a check."""
    values = rig.model_dump(mode="json", include={"name", "sensors", "exciter", "limits", "sample_rate_hz"})
    text = json.dumps([values, section.model_dump(mode="json")], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def check_file(rig: Rig, section: AnyDevice) -> Path:
    """Where the check of a rig at a converter is kept."""
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return state / "nmt" / "checks" / f"{rig.name}-{section.kind}-{fingerprint(rig, section)[:16]}.json"


def keep_check(rig: Rig, section: AnyDevice, document: dict[str, Any]) -> Path:
    """Keep a check for the tests that follow.

    Raises:
        BenchError: the state folder cannot be written.
    """
    path = check_file(rig, section)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(document, indent=1) + "\n")
    except OSError as error:
        raise BenchError(
            f"The check cannot be kept in {path.parent} ({error.strerror}); set XDG_STATE_HOME."
        ) from error
    return path


def require_check(rig: Rig, section: AnyDevice, command: str, now: float | None = None) -> dict[str, Any]:
    """The check that lets a test begin.

    Args:
        rig: to be tested.
        section: its converter.
        command: that makes the check, for the sentence.
        now: s since 1970; None = the present.

    Raises:
        BenchError: there is none, it found something, or it is too old.
    """
    path = check_file(rig, section)
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        made, passed = float(document["time"]), bool(document["passed"])
    except (OSError, ValueError, KeyError, TypeError):
        raise BenchError(
            f"Rig {rig.name} at its converter ({section.kind}) has not been checked since it was last changed; type: "
            f"{command}"
        ) from None
    if section.check == "rig" and document.get("scope", "rig") != "rig":
        raise BenchError(f"The last check of rig {rig.name} looked at the converter alone; type: {command}")
    age = ((time.time() if now is None else now) - made) / 3600.0
    if not passed:
        names = ", ".join(dict.fromkeys(str(each.get("name")) for each in document.get("findings", ())))
        raise BenchError(f"The last check of rig {rig.name} found {names}; fix it and type: {command}")
    if not 0.0 <= age <= section.check_valid_hours:
        raise BenchError(
            f"The last check of rig {rig.name} is {age:.1f} h old and holds for {section.check_valid_hours:g} h "
            f"(device.check_valid_hours); type: {command}"
        )
    checked: dict[str, Any] = document
    return checked
