"""Changes of rigs: a rig is frozen, so every change is a new rig that shares what stays."""

from __future__ import annotations

from typing import Any, TypeAlias

from nmt_rig.model.local_elements import AnyElement
from nmt_rig.rig import Rig

Path: TypeAlias = tuple[str | int, ...]


def value_at(rig: Rig, path: Path) -> Any:
    """Value of a key, for example ``("structure", "springs_n_m", 0)``; a missing entry of a dict is None."""
    node: Any = rig
    for part in path:
        if isinstance(node, dict):
            node = node.get(part)
        else:
            node = node[part] if isinstance(part, int) else getattr(node, part)
    return node


def with_value(rig: Rig, path: Path, value: Any) -> Rig:
    """The rig with one key changed."""
    changed: Rig = _changed(rig, path, value)
    return changed


def _changed(node: Any, path: Path, value: Any) -> Any:
    if not path:
        return value
    part, remaining = path[0], path[1:]
    if isinstance(node, dict):
        return {**node, part: _changed(node.get(part), remaining, value)}
    if isinstance(node, list):
        return [_changed(entry, remaining, value) if index == part else entry for index, entry in enumerate(node)]
    return node.model_copy(update={part: _changed(getattr(node, str(part)), remaining, value)})


def with_element(rig: Rig, element: AnyElement) -> Rig:
    """The rig with one more local element."""
    return rig.model_copy(update={"local_elements": [*rig.local_elements, element]})
