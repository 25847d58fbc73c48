"""Changes a rig file in place: keys that differ are rewritten, everything else keeps its words and comments."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from typing import Any

import yaml

from nmt_core.errors import BenchError
from nmt_core.yaml_document import KeyPath, parse_document
from nmt_rig.rig import Rig, validate_rig

_DIGITS = 10
_LONG = 100


def edited_rig_text(text: str, name: str, target: Rig) -> str:
    """Text of a rig file that loads to ``target``, with as much of an older text as possible.

    Numbers are written with ten significant digits.

    Args:
        text: the rig file to start from.
        name: of that file, for messages.
        target: what the new text must load to.

    Raises:
        BenchError: ``text`` is no rig file, or ``target`` is beyond what a rig file may hold.
    """
    # The files that a structure was read from may not be there: then the rig is written out.
    base = target if getattr(target.structure, "source", "") else validate_rig(parse_document(text, name))
    before, after = base.model_dump(mode="json"), target.model_dump(mode="json")
    try:
        short = target.model_dump(mode="json", exclude_defaults=True)
        new = {path: _at(short, path, value) for path, (_, value) in _differences(before, after).items()}
        result = _Edit(text).apply(new)
        if _alike(validate_rig(parse_document(result, name)).model_dump(mode="json"), after):
            return result
    except (BenchError, yaml.YAMLError, _CannotEditError):
        pass
    # Anchors, merge keys and the like: written out plainly, without the comments.
    values = _listed(target.model_dump(mode="json", exclude_defaults=True))
    result = yaml.dump(values, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
    validate_rig(parse_document(result, name))
    return result


def _at(values: Any, path: KeyPath, otherwise: Any) -> Any:
    """The value at a path of a shorter form of the same values; ``otherwise`` where it was left out."""
    for part in path:
        try:
            values = values[part]
        except (KeyError, IndexError, TypeError):
            return otherwise
    return values


def changed_keys(before: Rig, after: Rig) -> list[tuple[str, Any, Any]]:
    """Keys of ``after`` that differ: dotted path, old value (None where there was none), new value."""
    found = _differences(before.model_dump(mode="json"), after.model_dump(mode="json"))
    return [(".".join(map(str, path)), old, new) for path, (old, new) in found.items()]


class _CannotEditError(Exception):
    """The text has a form that cannot be changed in place."""


Differences = dict[KeyPath, tuple[Any, Any]]


def _differences(before: Any, after: Any, path: KeyPath = ()) -> Differences:
    """Old and new value by path; entries added to lists under the index they get."""
    if isinstance(before, Mapping) and isinstance(after, Mapping) and before.get("kind") == after.get("kind"):
        result: Differences = {}
        for key, value in after.items():
            result |= _differences(before.get(key), value, (*path, key))
        return result
    if isinstance(before, list) and isinstance(after, list) and len(before) <= len(after):
        result = {}
        for index, value in enumerate(after):
            old = before[index] if index < len(before) else None
            result |= _differences(old, value, (*path, index))
        return result
    return {} if _alike(before, after) else {path: (before, after)}


def _alike(one: Any, other: Any) -> bool:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_alike, one, other))
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (one, other))
    return bool(math.isclose(one, other, rel_tol=10.0 ** (1 - _DIGITS))) if numbers else bool(one == other)


class _Edit:
    """Replacements and insertions at places of a text, made all at once."""

    def __init__(self, text: str) -> None:
        self._text = text if text.endswith("\n") else text + "\n"
        root = yaml.compose(self._text, Loader=yaml.SafeLoader)
        if not isinstance(root, yaml.MappingNode):
            raise _CannotEditError
        self._root = root
        self._changes: list[tuple[int, int, int, str]] = []

    def apply(self, new: Mapping[KeyPath, Any]) -> str:
        """The text with new values by path."""
        missing: dict[KeyPath, Any] = {}
        for path, value in new.items():
            node, depth = self._deepest(path)
            if depth == len(path):
                self._replace(node, value)
            else:
                _put(missing.setdefault(path[: depth + 1], {}), path[depth + 1 :], value)
        for path, value in missing.items():
            node, _ = self._deepest(path[:-1])
            value = value.get("", value) if isinstance(value, dict) else value
            if isinstance(path[-1], int):
                self._append(node, value)
            else:
                self._insert(node, path[-1], value)
        result = self._text
        # From the end on, so that places before a change stay where they are; insertions at one place keep their order.
        for start, end, _, words in sorted(self._changes, key=lambda c: (c[0], c[2]), reverse=True):
            result = result[:start] + words + result[end:]
        return result

    def _deepest(self, path: KeyPath) -> tuple[yaml.Node, int]:
        """The node of the longest part of a path that the text has, and that part's length."""
        node: yaml.Node = self._root
        for depth, part in enumerate(path):
            found = _child(node, part)
            if found is None:
                return node, depth
            node = found
        return node, len(path)

    def _change(self, start: int, end: int, new: str) -> None:
        self._changes.append((start, end, len(self._changes), new))

    def _replace(self, node: yaml.Node, value: Any) -> None:
        self._change(node.start_mark.index, self._end(node), _flow(value))

    def _append(self, node: yaml.Node, value: Any) -> None:
        if not isinstance(node, yaml.SequenceNode):
            raise _CannotEditError
        if node.flow_style or not node.value:
            self._change(node.end_mark.index - 1, node.end_mark.index - 1, (", " if node.value else "") + _flow(value))
        elif isinstance(value, str) and len(value) > _LONG:
            indent = " " * (node.start_mark.column + 2)
            lines = textwrap.wrap(value, 120 - len(indent), break_long_words=False, break_on_hyphens=False)
            self._new_line(node, "- >-\n" + "\n".join(indent + line for line in lines))
        else:
            self._new_line(node, f"- {_flow(value)}")

    def _insert(self, node: yaml.Node, key: str | int, value: Any) -> None:
        if not isinstance(node, yaml.MappingNode):
            raise _CannotEditError
        entry = f"{key}: {_flow(value)}"
        if node.flow_style or not node.value:
            self._change(node.end_mark.index - 1, node.end_mark.index - 1, (", " if node.value else "") + entry)
        else:
            self._new_line(node, entry)

    def _new_line(self, node: yaml.Node, entry: str) -> None:
        """A line of its own below the last one of a block, at the block's indentation."""
        end = self._text.find("\n", self._end(node))
        indent = " " * node.start_mark.column
        self._change(end, end, f"\n{indent}{entry}")

    def _end(self, node: yaml.Node) -> int:
        """Where the content of a node ends; the marks of blocks reach to the next key, past comments."""
        if isinstance(node, yaml.MappingNode) and not node.flow_style and node.value:
            return self._end(node.value[-1][1])
        if isinstance(node, yaml.SequenceNode) and not node.flow_style and node.value:
            return self._end(node.value[-1])
        start, end = node.start_mark.index, node.end_mark.index
        return start + len(self._text[start:end].rstrip())


def _child(node: yaml.Node, part: str | int) -> yaml.Node | None:
    if isinstance(node, yaml.MappingNode):
        return next((value for key, value in node.value if key.value == part), None)
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int):
        return node.value[part] if part < len(node.value) else None
    return None


def _put(target: dict[Any, Any], path: KeyPath, value: Any) -> None:
    """Set a value below keys that may be missing; the empty path is kept under the empty key."""
    if not path:
        target[""] = value
        return
    for part in path[:-1]:
        target = target.setdefault(part, {})
    target[path[-1]] = value


def _flow(value: Any) -> str:
    """A value in one line."""
    values = [_listed(value)]
    text = yaml.dump(values, Dumper=_Dumper, default_flow_style=True, allow_unicode=True, width=10**9, sort_keys=False)
    return text.strip()[1:-1]


def _listed(value: Any) -> Any:
    """Mappings of list indices as lists; keys without a value left out."""
    if isinstance(value, Mapping):
        kept = {key: _listed(item) for key, item in value.items() if item is not None}
        return [kept[key] for key in sorted(kept)] if kept and all(isinstance(key, int) for key in kept) else kept
    return [_listed(item) for item in value] if isinstance(value, list) else value


class _Dumper(yaml.SafeDumper):
    """Writes numbers with ten digits, in a form that YAML 1.1 and 1.2 both read as a number."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _number(dumper: yaml.SafeDumper, value: float) -> yaml.ScalarNode:
    mantissa, _, exponent = f"{value:.{_DIGITS}g}".partition("e")
    mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
    return dumper.represent_scalar("tag:yaml.org,2002:float", f"{mantissa}e{exponent}" if exponent else mantissa)


_Dumper.add_representer(float, _number)
