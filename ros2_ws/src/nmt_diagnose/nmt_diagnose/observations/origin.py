"""What made a recording: a simulated rig, an import or a device, as its bag says."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from nmt_core.errors import BenchError
from nmt_core.files.hardened import yaml_value
from nmt_record.bag.bag_keys import SIMULATED_RIG
from nmt_record.bag.bag_reader import Bag
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

# Sections of a rig file that say what the rig is; the others say how it is tested.
_PHYSICS = ("structure", "local_elements", "exciter", "sensors", "clock_error", "drift", "substeps")
_LOOP = ("phase_offset_rad", "loop_latency_s")


@dataclass(frozen=True)
class Origin:
    """What made one recording.

    Attributes:
        kind: ``simulated`` from a rig file by this bench, ``imported`` from files, ``measured`` on a device, or
            ``unknown``: the bag does not say.
        rig_name: name of the rig; may be empty.
        rig: rig file kept in the bag; None = none, or one that cannot be read.
        rig_file: where the same rig file lies now; empty = nowhere.
        device: what a run was measured on.
        files: names of imported files.
        periods: periods a window of a run; 0 = not said.
        tests: names of the tests found in it.
    """

    kind: Literal["simulated", "imported", "measured", "unknown"]
    rig_name: str = ""
    rig: Rig | None = field(default=None, repr=False)
    rig_file: str = ""
    device: str = ""
    files: tuple[str, ...] = ()
    periods: int = 0
    tests: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """For people: what made it."""
        of_rig = f" (rig '{self.rig_name}')" if self.rig_name else ""
        if self.kind == "simulated":
            return f"simulated from the rig file {self.rig_file or 'kept in the bag'}{of_rig}"
        if self.kind == "imported":
            return f"imported from {', '.join(self.files) or 'files'}{of_rig}"
        if self.kind == "measured":
            return f"measured on {self.device}{of_rig}"
        return f"not said in the bag{of_rig}"

    def to_mapping(self) -> dict[str, Any]:
        """As it stands in ``diagnosis.json``."""
        return {
            "kind": self.kind,
            "text": self.text,
            "rig": self.rig_name,
            "rig_file": self.rig_file,
            "device": self.device,
            "files": list(self.files),
            "tests": list(self.tests),
        }


def origin_of(bag: Bag, path: Path, tests: Sequence[str] = ()) -> Origin:
    """What made a bag, by what it says itself.

    Args:
        bag: the bag.
        path: results folder or bag, as the user gave it.
        tests: names of the tests found in it.
    """
    run = bag.run_start or {}
    text = bag.rig_yaml or ""
    rig, found = _rig(text), tuple(tests)
    name = run.get("rig")
    name = name if isinstance(name, str) else rig.name if rig is not None else ""
    imported = run.get("imported")
    if isinstance(imported, dict):
        files = tuple(
            str(item["name"]) for item in imported.get("files", ()) if isinstance(item, dict) and "name" in item
        )
        return Origin("imported", name, rig, files=files, tests=found)
    parameters = run.get("parameters")
    plant = parameters.get("plant") if isinstance(parameters, dict) else None
    # Runs recorded before they named their device were simulated: the plant had a rig file and nothing else.
    device = run.get("device", SIMULATED_RIG if isinstance(plant, dict) and plant.get("rig_file") else "")
    if not isinstance(device, str) or not device:
        return Origin("unknown", name, rig, tests=found)
    if device != SIMULATED_RIG:
        return Origin("measured", name, rig, device=device, tests=found)
    places = [path / "rig.yaml", path.parent / "rig.yaml"]
    if isinstance(plant, dict) and isinstance(plant.get("rig_file"), str):
        places.append(Path(plant["rig_file"]))
    plan = run.get("plan")
    periods = plan.get("window_periods") if isinstance(plan, dict) else None
    return Origin(
        "simulated",
        name,
        rig,
        next((str(place) for place in places if _holds(place, text)), ""),
        device,
        periods=periods if isinstance(periods, int) and not isinstance(periods, bool) and periods > 0 else 0,
        tests=found,
    )


def same_rig(left: Rig, right: Rig) -> bool:
    """Whether two rig files describe one rig, wherever its exciter sits and however it is tested."""
    return _physics(left, left.drive_point) == _physics(right, left.drive_point)


def refuse_own_recordings(model: Rig, origins: Sequence[tuple[str, Origin]]) -> None:
    """Refuse recordings that the model itself made.

    Args:
        model: the rig file that is compared.
        origins: path and origin of each recording of the real side.

    Raises:
        BenchError: one was simulated from the model.
    """
    for path, origin in origins:
        if origin.kind == "simulated" and origin.rig is not None and same_rig(origin.rig, model):
            raise BenchError(
                f"{path} was simulated from the model itself (rig '{model.name}') and says nothing about the real rig; "
                "leave it out, or give --allow-own-model to see what a rig without a gap looks like."
            )


def strangers(origins: Sequence[tuple[str, Origin]]) -> list[str]:
    """Sentences on simulated recordings of rigs that are not that of the first."""
    simulated = [
        (path, origin.rig) for path, origin in origins if origin.kind == "simulated" and origin.rig is not None
    ]
    return [
        f"{path} and {simulated[0][0]} were simulated from different rig files: they are not recordings of one rig."
        for path, rig in simulated[1:]
        if simulated[0][1] is not None and rig is not None and not same_rig(simulated[0][1], rig)
    ]


def _physics(rig: Rig, point: int) -> dict[str, Any]:
    """What a rig is, its exciter at a point."""
    content = rig.model_dump(include=set(_PHYSICS))
    content["exciter"]["point"] = point
    for element in content["local_elements"]:
        if element.get("side") == "exciter":
            element["point"] = point
    content["loop"] = {key: float(rig.pll.get(key, 0.0)) for key in _LOOP}
    return content


def _holds(place: Path, text: str) -> bool:
    """Whether a file holds a text."""
    try:
        return bool(text) and hashlib.sha256(place.read_bytes()).digest() == hashlib.sha256(text.encode()).digest()
    except OSError:
        return False


def _rig(text: str) -> Rig | None:
    try:
        content = yaml_value(text, "rig.yaml")
        return validate_rig(RigDocument("rig.yaml", content, {})) if isinstance(content, dict) else None
    except BenchError:
        return None
