"""YAML files written by hand, with the line of every key.

Numbers follow YAML 1.2 (1e-4 is a number). Duplicate keys are refused. Whatever is wrong is said in one
sentence that names the file and the line.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from nmt_core.errors import BenchError
from nmt_core.files.hardened import LARGEST_DOCUMENT, YAML_FAULTS, BoundedYaml, check_number, fast_loader, read_text

KeyPath = tuple[str | int, ...]
_MOST_NODES = 20_000
_DEEPEST = 40


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
    if len(text) > LARGEST_DOCUMENT:
        raise BenchError(f"{name} has {len(text)} characters, far too many for a {what}; is it the right file?")
    try:
        return yaml_mapping(fast_loader()(text), name, what, needs)
    except yaml.YAMLError:
        pass  # PyYAML's parser, which is slower, says better what is wrong
    try:
        loader = BoundedYaml(text)
    except yaml.YAMLError as error:
        raise BenchError(f"{name} is not a YAML text file: {str(error).splitlines()[0]}.") from error
    try:
        return yaml_mapping(loader, name, what, needs)
    except yaml.YAMLError as error:
        raise BenchError(_syntax_message(error, name)) from error


def yaml_mapping(loader: BoundedYaml, name: str, what: str, needs: str) -> YamlDocument:
    """Errors as :func:`parse_document`, and those of YAML as they are."""
    try:
        node = loader.get_single_node()
        if node is None:
            raise BenchError(f"{name} is empty; a {what} needs at least {needs}.")
        places: dict[KeyPath, str] = {}
        budget = [_MOST_NODES]
        values = _construct(loader, node, (), places, name, budget)
    except RecursionError as error:
        raise BenchError(f"{name}: the file is nested too deeply; write it out plainly.") from error
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
    return parse_document(read_text(path, f"YAML {what}", LARGEST_DOCUMENT), path.name, what, needs)


def _syntax_message(error: yaml.YAMLError, name: str) -> str:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "it is not valid YAML"
    place = f"{name} line {mark.line + 1}" if mark is not None else name
    return f"{place}: {problem}; fix the YAML syntax there."


def _construct(
    loader: BoundedYaml, node: yaml.Node, path: KeyPath, places: dict[KeyPath, str], name: str, budget: list[int]
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
            key = _scalar(loader, key_node, name) if isinstance(key_node, yaml.ScalarNode) else None
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
    value = _scalar(loader, node, name)
    if isinstance(value, int | float) and not isinstance(value, bool):
        check_number(value, f"{name} {line}")
    return value


def _scalar(loader: BoundedYaml, node: yaml.Node, name: str) -> Any:
    try:
        return loader.construct_object(node)
    except yaml.YAMLError:
        raise
    except YAML_FAULTS as error:
        said = str(getattr(node, "value", ""))[:40]
        raise BenchError(
            f"{name} line {node.start_mark.line + 1}: cannot read this value: '{said}' is no "
            f"{node.tag.rsplit(':', 1)[-1]}; fix it, or leave the tag out."
        ) from error
