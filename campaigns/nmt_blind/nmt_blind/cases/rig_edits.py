"""Changes of a rig file as plain data, so that they can be written down and read by people."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from nmt_core.files.yaml_text import yaml_text
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument


@dataclass(frozen=True)
class Edit:
    """One change of a rig file.

    Attributes:
        path: keys and list indices; of a list that is extended, the list's own.
        value: what is set, added or multiplied with.
        kind: ``set``, ``append`` to a list, ``merge`` into a mapping, or ``scale`` a number.
    """

    path: tuple[str | int, ...]
    value: Any
    kind: str = "set"

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"path": list(self.path), "kind": self.kind, "value": self.value}

    @classmethod
    def from_mapping(cls, values: dict[str, Any]) -> Edit:
        """From `to_mapping`."""
        return cls(tuple(values["path"]), values["value"], str(values["kind"]))


def rig_values(rig: Rig) -> dict[str, Any]:
    """Keys and values of a rig that are not left out."""
    values: dict[str, Any] = rig.model_dump(mode="json", exclude_none=True)
    return values


def rig_yaml(rig: Rig) -> str:
    """Text of a rig file that loads to the same rig."""
    return yaml_text(rig_values(rig))


def with_edits(rig: Rig, edits: Sequence[Edit]) -> Rig:
    """The rig with changes, checked as a file would be.

    Raises:
        BenchError: a value that a rig file may not have.
        KeyError, IndexError: an edit of something that is not there.
    """
    if not edits:
        return rig
    values = rig_values(rig)
    for edit in edits:
        _apply(values, edit)
    return validate_rig(RigDocument(rig.name, values, {}))


def _apply(values: dict[str, Any], edit: Edit) -> None:
    target: Any = values
    for part in edit.path[:-1]:
        if isinstance(target, dict) and part not in target:
            target[part] = {}
        target = target[part]
    key = edit.path[-1]
    value = copy.deepcopy(edit.value)
    if edit.kind == "set":
        target[key] = value
    elif edit.kind == "scale":
        target[key] = target[key] * value
    elif edit.kind == "append":
        if isinstance(target, dict):
            target.setdefault(key, [])
        target[key].append(value)
    elif edit.kind == "merge":
        if isinstance(target, dict):
            target.setdefault(key, {})
        target[key].update(value)
    else:
        raise ValueError(f"an edit cannot be '{edit.kind}'")
