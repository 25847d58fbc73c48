"""Changes a rig file in place: keys that differ are rewritten, everything else keeps its words and comments."""

from __future__ import annotations

import io
import math
import textwrap
from collections import Counter
from collections.abc import Iterator, Mapping
from difflib import SequenceMatcher
from itertools import accumulate
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import CommentMark, YAMLError
from ruamel.yaml.representer import RoundTripRepresenter
from ruamel.yaml.scalarstring import FoldedScalarString, LiteralScalarString
from ruamel.yaml.tokens import CommentToken

from nmt_core.errors import BenchError
from nmt_core.files.yaml_document import KeyPath, parse_document
from nmt_core.files.yaml_text import yaml_text
from nmt_rig.rig import Rig, validate_rig

_DIGITS = 10
_LONG = 100
_LINE = 116
_ENDLESS = 10**6
_OWN_LINES = (FoldedScalarString, LiteralScalarString)
_EOL = {CommentedMap: 2, CommentedSeq: 0}
"""Where an entry's comment stands among those that ruamel.yaml keeps of it."""


def edited_rig_text(text: str, name: str, target: Rig) -> str:
    """Text of a rig file that loads to ``target``, with as much of an older text as possible.

    Numbers are written with ten significant digits, those of a structure from files with all.

    Args:
        text: the rig file to start from.
        name: of that file, for messages.
        target: what the new text must load to.

    Raises:
        BenchError: ``text`` is not a rig file, or ``target`` is beyond what a rig file may hold.
    """
    # The files that a structure was read from may not be there: then the rig is written out.
    base = target if getattr(target.structure, "source", "") else validate_rig(parse_document(text, name))
    before, after = base.model_dump(mode="json"), target.model_dump(mode="json")
    try:
        short = target.model_dump(mode="json", exclude_defaults=True)
        new = {path: _at(short, path, value) for path, (_, value) in _differences(before, after).items()}
        for result in _edited(text, new):
            if _alike(validate_rig(parse_document(result, name)).model_dump(mode="json"), after):
                return result
    except (BenchError, YAMLError, _CannotEditError):
        pass
    # Anchors, merge keys and the like: written out plainly, without the comments.
    values = _listed(target.model_dump(mode="json", exclude_defaults=True))
    # Matrices keep all digits: the lowest of many rows hangs on the last ones.
    result = yaml_text(values) if base is target else _dumped(_yaml(2, 2, 120), values)
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


def _edited(text: str, new: Mapping[KeyPath, Any]) -> Iterator[str]:
    """A text with new values by path: first with all other lines as they are, then as ruamel.yaml lays it out."""
    yaml = _layout(text)
    root = yaml.load(text)
    before = _dumped(yaml, root)
    missing: dict[KeyPath, Any] = {}
    for path, value in new.items():
        depth = _depth(root, path)
        if depth == len(path):
            _replace(_at(root, path[:-1], None), path[-1], value)
        else:
            _put(missing.setdefault(path[: depth + 1], {}), path[depth + 1 :], value)
    for path, value in missing.items():
        _add(_at(root, path[:-1], None), path[-1], value.get("", value) if isinstance(value, dict) else value)
    after = _dumped(yaml, root)
    yield _merged(text, before, after)
    yield after


def _merged(text: str, before: str, after: str) -> str:
    """What changes from ``before`` to ``after``, line by line, done to a text that ``before`` is another layout of.

    Lines that only the layout changes, such as a comment within braces, stay as they are in the text.
    """
    old, base, new = text.splitlines(), before.splitlines(), after.splitlines()
    own, its = _pairs(base, old), _pairs(base, new)
    result: list[str] = []
    k = i = j = 0
    for line in range(len(base) + 1):
        if line in own and line in its:
            result += old[i : own[line]] if new[j : its[line]] == base[k:line] else new[j : its[line]]
            result += old[own[line] : own[line] + 1]
            k, i, j = line + 1, own[line] + 1, its[line] + 1
    return "\n".join(result) + "\n"


def _pairs(base: list[str], other: list[str]) -> dict[int, int]:
    """Numbers of equal lines; the ends belong together too."""
    blocks = SequenceMatcher(None, base, other, autojunk=False).get_matching_blocks()
    return {block.a + k: block.b + k for block in blocks for k in range(block.size)} | {len(base): len(other)}


def _layout(text: str) -> YAML:
    """Reader and writer with the indentation of a text: the one that gives it back with the fewest changed lines."""

    def changes(yaml: YAML) -> int:
        return (Counter(text.splitlines()) - Counter(_dumped(yaml, yaml.load(text)).splitlines())).total()

    layouts = (_yaml(mapping, dash, width) for width in (_ENDLESS, 120) for mapping in (2, 4) for dash in (2, 0))
    best, fewest = None, math.inf
    for yaml in layouts:
        count = changes(yaml)
        if count < fewest:
            best, fewest = yaml, count
        if count == 0:
            break
    return best if best is not None else _yaml(2, 2, _ENDLESS)


def _yaml(mapping: int, dash: int, width: int) -> YAML:
    yaml = YAML(typ="rt")
    yaml.Representer = _Representer
    yaml.preserve_quotes = True
    yaml.width = width
    yaml.indent(mapping=mapping, sequence=dash + 2, offset=dash)
    return yaml


def _dumped(yaml: YAML, root: Any) -> str:
    buffer = io.StringIO()
    yaml.dump(root, buffer)
    return buffer.getvalue()


def _depth(root: Any, path: KeyPath) -> int:
    """Length of the longest part of a path that there is."""
    node = root
    for depth, part in enumerate(path):
        known = isinstance(node, CommentedMap) and part in node
        known = known or (isinstance(node, CommentedSeq) and isinstance(part, int) and part < len(node))
        if not known:
            return depth
        node = node[part]
    return len(path)


def _replace(parent: Any, key: str | int, value: Any) -> None:
    tail = _cut_tail(parent, key)
    parent[key] = _node(value)
    _attach_tail(parent, key, tail)


def _add(parent: Any, key: str | int, value: Any) -> None:
    """A new entry at the end of a mapping or sequence, before the comments that lead over to what follows."""
    if not isinstance(parent, CommentedMap | CommentedSeq) or isinstance(parent, CommentedSeq) != isinstance(key, int):
        raise _CannotEditError
    last = _last(parent)
    tail = "" if last is None or parent.fa.flow_style() else _cut_tail(parent, last)
    if isinstance(parent, CommentedSeq):
        parent.append(_node(value, folded=not parent.fa.flow_style()))
        key = len(parent) - 1
    else:
        parent[key] = _node(value)
    _attach_tail(parent, key, tail)


def _last(node: Any) -> Any:
    """Key of the last entry; None where there is none."""
    if isinstance(node, CommentedMap):
        return next(reversed(node), None)
    return len(node) - 1 if isinstance(node, CommentedSeq) and node else None


def _cut_tail(parent: Any, key: Any) -> str:
    """Take the lines away that follow an entry and its own comment: they belong to what comes after it."""
    value = parent[key]
    last = _last(value)
    if last is not None and not value.fa.flow_style():
        return _cut_tail(value, last)
    tokens, place = parent.ca.items.get(key), _EOL[type(parent)]
    if not tokens or tokens[place] is None:
        return ""
    token = tokens[place]
    if isinstance(value, _OWN_LINES):
        tokens[place] = None  # a text in lines of its own has no comment next to it
        return str(token.value)
    own, newline, tail = token.value.partition("\n")
    if own.strip() or not tail:
        token.value = own + newline
    else:
        tokens[place] = None
    return str(tail)


def _attach_tail(parent: Any, key: Any, tail: str) -> None:
    if not tail:
        return
    value = parent[key]
    tokens, place = parent.ca.items.setdefault(key, [None, None, None, None]), _EOL[type(parent)]
    if tokens[place] is None:
        lead = "" if isinstance(value, _OWN_LINES) else "\n"
        tokens[place] = CommentToken(lead + tail, CommentMark(0), None)
    else:
        tokens[place].value = tokens[place].value.rstrip("\n") + "\n" + tail


def _node(value: Any, folded: bool = False) -> Any:
    """A value in one line; a long text folded over several where the place allows it."""
    value = _listed(value)
    if folded and isinstance(value, str) and len(value) > _LONG:
        lines = textwrap.wrap(value, _LINE, break_long_words=False, break_on_hyphens=False)
        text = FoldedScalarString(value)
        text.fold_pos = [end - 1 for end in accumulate(len(line) + 1 for line in lines[:-1])]
        return text
    if isinstance(value, Mapping):
        mapping = CommentedMap({key: _node(item) for key, item in value.items()})
        mapping.fa.set_flow_style()
        return mapping
    if isinstance(value, list):
        sequence = CommentedSeq([_node(item) for item in value])
        sequence.fa.set_flow_style()
        return sequence
    return value


def _put(target: dict[Any, Any], path: KeyPath, value: Any) -> None:
    """Set a value below keys that may be missing; the empty path is kept under the empty key."""
    if not path:
        target[""] = value
        return
    for part in path[:-1]:
        target = target.setdefault(part, {})
    target[path[-1]] = value


def _listed(value: Any) -> Any:
    """Mappings of list indices as lists; keys without a value left out."""
    if isinstance(value, Mapping):
        kept = {key: _listed(item) for key, item in value.items() if item is not None}
        return [kept[key] for key in sorted(kept)] if kept and all(isinstance(key, int) for key in kept) else kept
    return [_listed(item) for item in value] if isinstance(value, list) else value


class _Representer(RoundTripRepresenter):
    """Writes new numbers with ten digits, in a form that YAML 1.1 and 1.2 both read as a number."""


def _number(representer: RoundTripRepresenter, value: float) -> Any:
    mantissa, _, exponent = f"{value:.{_DIGITS}g}".partition("e")
    mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
    return representer.represent_scalar("tag:yaml.org,2002:float", f"{mantissa}e{exponent}" if exponent else mantissa)


_Representer.add_representer(float, _number)
