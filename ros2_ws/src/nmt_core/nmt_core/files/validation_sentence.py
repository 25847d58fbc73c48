"""What pydantic found wrong in a YAML file, as one sentence with file, line, key and remedy."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from nmt_core.files.yaml_document import KeyPath, YamlDocument

if TYPE_CHECKING:
    from pydantic import BaseModel
    from pydantic_core import ErrorDetails

_SHOWN = 60
_MAPPING = "must be a mapping of keys to values"
_WORDS = {
    "greater_than": "must be positive",
    "finite_number": "must be a finite number",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be a text",
    "list_type": "must be a list",
    "dict_type": _MAPPING,
    "model_type": _MAPPING,
    "model_attributes_type": _MAPPING,
}


def validation_sentence(
    errors: Sequence[ErrorDetails],
    document: YamlDocument,
    model: type[BaseModel],
    whole: str,
    *,
    values: Mapping[str, Any] | None = None,
    words: Mapping[str, str] | None = None,
    remedies: Mapping[str, str] | None = None,
) -> str:
    """The first thing that is wrong, with file and line, and how many more there are.

    Args:
        errors: of a ``ValidationError``, at least one.
        document: the file, for the line of every key.
        model: what the file was checked against, for the keys it may have.
        whole: what the file describes, for example ``the rig``.
        values: what was checked, where that differs from the document.
        words: sentences for types of error, in place of the usual ones.
        remedies: for keys that may be missing, what to add.
    """
    checked = document.values if values is None else values
    # A misspelt key is also a missing one: name what is there and wrong first.
    first = min(errors, key=lambda error: error["type"] != "extra_forbidden")
    path = _plain_path(first["loc"], checked)
    name = ".".join(map(str, path)) or whole
    more = f" ({len(errors) - 1} more like this)" if len(errors) > 1 else ""
    kind, context = first["type"], first.get("ctx", {})
    if kind == "extra_forbidden":
        sentence = f"unknown key {name}; {_suggestion(str(path[-1]), _known_keys(model, checked, path))}"
    elif kind == "missing":
        remedy = (remedies or {}).get(str(path[-1]) if path else "", "")
        sentence = f"{name} is missing; add it{f' ({remedy})' if remedy else ''}."
    elif kind in ("union_tag_invalid", "union_tag_not_found"):
        # The location of a discriminated union is the section; the key at fault is its `kind`.
        kinds = ", ".join(repr(tag) for tag in _kinds(_section(model, checked, path)))
        tag = first["input"].get("kind") if isinstance(first["input"], Mapping) else None
        path = (*path, "kind")
        sentence = f"{name}.kind must be one of {kinds}; {f'got {tag!r}' if tag is not None else 'it is missing'}."
    elif kind == "value_error":
        sentence = f"{name} {context.get('error', first['msg'])}."
    else:
        sentence = f"{name} {_must(first, words or {})}, got {_shown(first)}"
        sentence += "; write the decimal sign as a point." if _has_decimal_comma(first["input"]) else "."
    return f"{document.place(path)}: {sentence}{more}"


def _must(error: ErrorDetails, words: Mapping[str, str]) -> str:
    kind, context = error["type"], error.get("ctx", {})
    if kind == "greater_than" and context.get("gt"):
        return f"must be greater than {context['gt']}"
    if kind == "greater_than_equal":
        return "must not be negative" if context["ge"] == 0 else f"must be at least {context['ge']:g}"
    if kind == "less_than_equal":
        return f"must be at most {context['le']:g}"
    if kind == "literal_error":
        return f"must be {context['expected']}"
    if kind == "string_pattern_mismatch":
        return f"does not have the form {context['pattern']}"
    if kind in ("too_short", "too_long"):
        return "has too few entries" if kind == "too_short" else "has too many entries"
    return words.get(kind) or _WORDS.get(kind) or error["msg"].replace("Input should", "should")


def _shown(error: ErrorDetails) -> str:
    given = error["input"]
    if error["type"] in ("too_short", "too_long"):
        return str(error.get("ctx", {}).get("actual_length"))
    text = "null" if given is None else repr(given) if isinstance(given, str) else str(given)
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


def _has_decimal_comma(given: object) -> bool:
    if not isinstance(given, str) or given.count(",") != 1:
        return False
    return given.replace(",", "", 1).replace(".", "", 1).strip("-+ ").isdigit()


def _plain_path(location: Sequence[str | int], values: Any) -> KeyPath:
    """pydantic's location without the tags of unions."""
    path: list[str | int] = []
    node = values
    rest = list(location)
    while rest:
        part = rest.pop(0)
        known = isinstance(node, Mapping) and part in node
        if known or (isinstance(node, list) and isinstance(part, int) and part < len(node)):
            node = node[part]
        elif rest or not isinstance(node, Mapping | list):
            continue
        elif isinstance(node, Mapping) and part == node.get("kind"):
            continue  # the section as a whole, by its tag
        path.append(part)
    return tuple(path)


def _suggestion(key: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    return f"did you mean {close[0]}?" if close else f"known keys are {', '.join(known)}."


def _known_keys(model: type[BaseModel], values: Any, path: KeyPath) -> list[str]:
    """Keys of the section that contains the last part of a path."""
    sections = _sections(_section(model, values, path[:-1]))
    return list(dict.fromkeys(key for each in sections for key in each.model_fields))


def _section(model: type[BaseModel], values: Any, path: KeyPath) -> Any:
    """Class of the section at a path, or the annotation where it may be one of several."""
    section: Any = model
    node = values
    for part in path:
        # A key that the document has under another name, such as the first of several exciters.
        there = part in node if isinstance(node, Mapping) else isinstance(node, Sequence) and isinstance(part, int)
        node = node[part] if there else None
        section = _variant(section if isinstance(part, int) else section.model_fields[part].annotation, node)
    return section


def _kinds(annotation: Any) -> list[str]:
    """The kinds that a union of sections knows."""
    fields = [section.model_fields.get("kind") for section in _sections(annotation)]
    return [kind for field in fields if field is not None for kind in field.annotation.__args__]


def _sections(annotation: Any) -> list[Any]:
    """The section classes that an annotation allows, in unions however they are nested."""
    if hasattr(annotation, "model_fields"):
        return [annotation]
    if getattr(annotation, "__metadata__", None) is not None:
        return _sections(annotation.__origin__)
    return [section for part in getattr(annotation, "__args__", ()) for section in _sections(part)]


def _variant(annotation: Any, node: Any) -> Any:
    """The section class that a node is an instance of, or the annotation of a list's entries."""
    arguments = getattr(annotation, "__args__", ())
    if getattr(annotation, "__metadata__", None) is not None:
        return _variant(annotation.__origin__, node)
    if isinstance(node, list):
        return arguments[0] if arguments else annotation
    for candidate in _sections(annotation):
        field = candidate.model_fields.get("kind")
        if field is not None and isinstance(node, Mapping) and node.get("kind") in field.annotation.__args__:
            return candidate
    return annotation
