"""Rig files as text: `a.b.c=value` overrides of the YAML."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.files.yaml_document import KeyPath, YamlDocument, parse_document, read_document

RigDocument = YamlDocument

__all__ = ["KeyPath", "RigDocument", "apply_overrides", "parse_document", "read_document"]


def apply_overrides(document: RigDocument, overrides: Sequence[str]) -> RigDocument:
    """Set values by `a.b.c=value`; list entries by index or by their `name` or `channel`.

    Raises:
        BenchError: an override that is not of that form or leads nowhere.
    """
    values = _copied(document.values)
    places = dict(document.places)
    for override in overrides:
        key, separator, text = override.partition("=")
        parts = key.strip().split(".")
        if not separator or not all(parts):
            raise BenchError(f"--set {override}: write it as key.key=value, for example exciter.point=4.")
        try:
            value = parse_document(f"value: {text}", f"--set {override}").values.get("value")
        except BenchError as error:
            why = str(error).rsplit(": ", 1)[-1].rstrip(".")
            raise BenchError(f"--set {override}: the value is not valid YAML, or no value of a rig ({why}).") from error
        target: Any = values
        path: KeyPath = ()
        for depth, part in enumerate(parts):
            step: str | int = part
            if isinstance(target, list):
                step = _list_index(target, part, override, ".".join(parts[:depth]))
            elif not isinstance(target, dict):
                raise BenchError(f"--set {override}: {'.'.join(parts[:depth])} has no keys inside.")
            path = (*path, step)
            if depth == len(parts) - 1:
                target[step] = value
                for known in [known for known in places if known[: len(path)] == path]:
                    del places[known]
                places[path] = f"(--set {override})"
            else:
                if isinstance(target, dict) and part not in target:
                    target[part] = {}
                target = target[step]
    return RigDocument(document.name, values, places)


def _list_index(entries: list[Any], part: str, override: str, where: str) -> int:
    if part.isdigit() and int(part) < len(entries):
        return int(part)
    for index, entry in enumerate(entries):
        if isinstance(entry, dict) and part in (entry.get("name"), entry.get("channel")):
            return index
    raise BenchError(f"--set {override}: {where} has {len(entries)} entries and none is called {part}.")


def _copied(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _copied(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_copied(item) for item in value]
    return value
