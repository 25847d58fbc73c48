"""YAML files written by hand, with the line of every key.

Numbers follow YAML 1.2 (1e-4 is a number). Duplicate keys are refused. Whatever is wrong is said in one
sentence that names the file and the line.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from nmt_core.errors import BenchError

KeyPath = tuple[str | int, ...]
_MOST_NODES = 20_000
_DEEPEST = 40


class _Loader(yaml.SafeLoader):
    """SafeLoader with YAML 1.2 floats and without dates."""


_Loader.yaml_implicit_resolvers = {
    letter: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(("float", "timestamp"))]
    for letter, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^[-+]?(?:(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[0-9]+[eE][-+]?[0-9]+|\.(?:inf|Inf|INF))$"
        r"|^\.(?:nan|NaN|NAN)$"
    ),
    list("-+0123456789."),
)


@dataclass(frozen=True)
class YamlDocument:
    """Parsed file.

    Attributes:
        name: file name, as it appears in error messages.
        values: plain mapping.
        places: key path -> "line N" or the override that set it.
    """

    name: str
    values: dict[str, Any]
    places: dict[KeyPath, str]

    def place(self, path: KeyPath) -> str:
        """File and line of a key, or of the nearest enclosing one, for an error message."""
        for length in range(len(path), -1, -1):
            found = self.places.get(path[:length])
            if found is not None:
                return f"{self.name} {found}"
        return self.name


def parse_document(
    text: str, name: str, what: str = "rig file", needs: str = "name, structure and exciter"
) -> YamlDocument:
    """Parse the text of a file.

    Args:
        text: YAML.
        name: of the file, for messages.
        what: kind of file, for messages.
        needs: what such a file must have at least, for messages.

    Raises:
        BenchError: not YAML, not a mapping, duplicate keys, or far too large.
    """
    try:
        loader = _Loader(text)
    except yaml.YAMLError as error:
        raise BenchError(f"{name} is not a YAML text file: {str(error).splitlines()[0]}.") from error
    try:
        node = loader.get_single_node()
        if node is None:
            raise BenchError(f"{name} is empty; a {what} needs at least {needs}.")
        places: dict[KeyPath, str] = {}
        budget = [_MOST_NODES]
        values = _construct(loader, node, (), places, name, budget)
    except yaml.YAMLError as error:
        raise BenchError(_syntax_message(error, name)) from error
    finally:
        loader.dispose()
    if not isinstance(values, dict):
        raise BenchError(f"{name} line 1: a {what} must be a mapping of keys to values.")
    return YamlDocument(name, values, places)


def read_document(path: Path, what: str = "rig file", needs: str = "name, structure and exciter") -> YamlDocument:
    """Read and parse a file; arguments as for :func:`parse_document`.

    Raises:
        BenchError: the file cannot be read, or as :func:`parse_document`.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise BenchError(f"{path} is not a text file in UTF-8; give a YAML {what}.") from error
    except OSError as error:
        raise BenchError(f"cannot read the {what} {path}: {error.strerror}.") from error
    return parse_document(text, path.name, what, needs)


def _syntax_message(error: yaml.YAMLError, name: str) -> str:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "it is not valid YAML"
    place = f"{name} line {mark.line + 1}" if mark is not None else name
    return f"{place}: {problem}; mend the YAML syntax there."


def _construct(
    loader: _Loader, node: yaml.Node, path: KeyPath, places: dict[KeyPath, str], name: str, budget: list[int]
) -> Any:
    line = f"line {node.start_mark.line + 1}"
    budget[0] -= 1
    if budget[0] < 0 or len(path) > _DEEPEST:
        raise BenchError(f"{name} {line}: the file is nested too deeply or repeats itself; write it out plainly.")
    places.setdefault(path, line)
    if isinstance(node, yaml.MappingNode):
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key_line = f"line {key_node.start_mark.line + 1}"
            key = loader.construct_object(key_node) if isinstance(key_node, yaml.ScalarNode) else None
            if not isinstance(key, str):
                raise BenchError(f"{name} {key_line}: every key must be a plain word.")
            if key in result:
                where = ".".join(map(str, (*path, key)))
                first = places[(*path, key)]
                raise BenchError(f"{name} {key_line}: {where} is given twice (first on {first}); remove one.")
            places[(*path, key)] = key_line
            result[key] = _construct(loader, value_node, (*path, key), places, name, budget)
        return result
    if isinstance(node, yaml.SequenceNode):
        return [_construct(loader, item, (*path, index), places, name, budget) for index, item in enumerate(node.value)]
    try:
        return loader.construct_object(node)
    except ValueError as error:
        raise BenchError(f"{name} {line}: cannot read this value: {error}.") from error
