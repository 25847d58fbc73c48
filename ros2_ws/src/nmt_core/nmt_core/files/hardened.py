"""Loaders that take any input and answer with its content or with one sentence.

Files are regular and of bounded size; YAML and JSON have bounded depth, number of entries and magnitudes; arrays are
measured by their headers before memory is taken for them.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
import stat
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import yaml

from nmt_core.errors import BenchError

if TYPE_CHECKING:
    import numpy as np

LARGEST_DOCUMENT = 2**20  # bytes of a file written by hand
LARGEST_TABLE = 2**28  # bytes of a text file that a program wrote
LARGEST_ARRAYS = 2**29  # bytes of all arrays of a file together, as double precision
LARGEST_NUMBER = 1e30
SMALLEST_NUMBER = 1e-25  # but for zero
_MOST_NODES = 20_000
_INTEGER_TAG = "tag:yaml.org,2002:int"
_MOST_JSON_NODES = 5_000_000
_DEEPEST = 40
# What PyYAML's constructors raise for a value that does not fit its tag, besides YAMLError.
YAML_FAULTS = (ValueError, KeyError, IndexError, AttributeError, TypeError, OverflowError)

_DAMAGED_NPZ = (zipfile.BadZipFile, zlib.error, EOFError, KeyError, NotImplementedError, RuntimeError)
# numpy takes the header of an array apart as Python's source.
_NOT_PLAIN = (
    ValueError, SyntaxError, TypeError, OverflowError, MemoryError, AttributeError, IndexError, tokenize.TokenError,
    RecursionError,
)  # fmt: skip


def open_regular(path: Path, what: str, largest: int) -> IO[bytes]:
    """Open a regular file for reading, without waiting for whatever else a path may name.

    Args:
        path: the file.
        what: kind of file, for messages.
        largest: bytes.

    Raises:
        BenchError: it is not there, not a regular file (a folder, a pipe, a device), too large or not readable.
    """
    try:
        # Without O_NONBLOCK opening a pipe would wait for its other end.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        raise BenchError(f"The {what} {path} cannot be read: {getattr(error, 'strerror', None) or error}.") from error
    file = None
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or a device"
            raise BenchError(f"The {what} {path} cannot be read: it is {kind}; give a file.")
        if status.st_size > largest:
            raise BenchError(
                f"The {what} {path} has {status.st_size / 2**20:.1f} MiB, more than the {largest / 2**20:g} MiB that "
                "are read; is it the right file?"
            )
        file = os.fdopen(handle, "rb")
        return file
    finally:
        if file is None:
            os.close(handle)


def read_text(path: Path, what: str, largest: int = LARGEST_TABLE) -> str:
    """Text of a regular file in UTF-8; arguments and errors as :func:`open_regular`, or the file is not a text."""
    try:
        with open_regular(path, what, largest) as file:
            return file.read(largest + 1).decode("utf-8")
    except UnicodeDecodeError as error:
        raise BenchError(f"{path} is not a text file in UTF-8; give a {what}.") from error
    except OSError as error:
        raise BenchError(f"The {what} {path} cannot be read: {error.strerror or error}.") from error


def read_rows(path: Path, what: str) -> list[list[str]]:
    """Rows of a table whose cells commas separate; arguments and errors as :func:`read_text`, or it is not a table."""
    try:
        return list(csv.reader(io.StringIO(read_text(path, what))))
    except csv.Error as error:
        raise BenchError(f"{path} cannot be read as a table: {error}.") from error


class _Bounded(yaml.composer.Composer):
    """A composer that gives up early on what is too large or too deep."""

    _nodes = _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """As the base class, counted."""
        self._nodes += 1
        self._depth += 1
        if self._nodes > _MOST_NODES or self._depth > _DEEPEST:
            mark = self.peek_event().start_mark  # type: ignore[attr-defined]
            raise yaml.composer.ComposerError(None, None, "the file is nested too deeply or has too many entries", mark)
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        return node


class BoundedYaml(_Bounded, yaml.SafeLoader):
    """SafeLoader with the numbers of YAML 1.2 and without dates; gives up early on what is too large or too deep."""


BoundedYaml.yaml_implicit_resolvers = {
    letter: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(("int", "float", "timestamp"))]
    for letter, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
BoundedYaml.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^[-+]?(?:(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[0-9]+[eE][-+]?[0-9]+|\.(?:inf|Inf|INF))$"
        r"|^\.(?:nan|NaN|NAN)$"
    ),
    list("-+0123456789."),
)
# YAML 1.1 would read 1:15:10 to the base 60 and 010 to the base 8.
BoundedYaml.add_implicit_resolver(
    _INTEGER_TAG, re.compile(r"^(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$"), list("-+0123456789")
)


def _construct_integer(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int:
    text = str(loader.construct_scalar(node))
    return int(text, 0 if text[:2] in ("0o", "0x") else 10)


BoundedYaml.add_constructor(_INTEGER_TAG, _construct_integer)


@cache
def fast_loader() -> type[Any]:
    """`BoundedYaml` whose text is taken apart by libyaml, ten times as fast; itself where PyYAML has no libyaml."""
    if not yaml.__with_libyaml__:
        return BoundedYaml

    class FastYaml(_Bounded, yaml.CSafeLoader):
        yaml_implicit_resolvers = BoundedYaml.yaml_implicit_resolvers
        yaml_constructors = BoundedYaml.yaml_constructors

        def __init__(self, stream: str) -> None:
            yaml.CSafeLoader.__init__(self, stream)
            yaml.composer.Composer.__init__(self)

    return FastYaml


def yaml_value(text: str, name: str) -> Any:
    """Content of a YAML text that a program wrote; for files written by hand see ``yaml_document``.

    Raises:
        BenchError: not YAML, too large, too deep, or a value that does not fit its tag.
    """
    if len(text) > LARGEST_DOCUMENT:
        raise BenchError(f"{name} has {len(text)} characters, more than the {LARGEST_DOCUMENT} that are read.")
    try:
        loader = fast_loader()(text)
        try:
            node = loader.get_single_node()
            _count_expanded(node, [_MOST_NODES], name)
            return None if node is None else loader.construct_document(node)
        finally:
            loader.dispose()
    except (yaml.YAMLError, *YAML_FAULTS, RecursionError) as error:
        problem = getattr(error, "problem", None) or type(error).__name__
        raise BenchError(f"{name} is not well-formed YAML ({problem}).") from error


def _count_expanded(node: yaml.Node | None, budget: list[int], name: str, depth: int = 0) -> None:
    """Refuse aliases that stand for more than a file may hold."""
    budget[0] -= 1
    if budget[0] < 0 or depth > _DEEPEST:
        raise BenchError(f"{name} is nested too deeply or repeats itself; write it out plainly.")
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            _count_expanded(key, budget, name, depth + 1)
            _count_expanded(value, budget, name, depth + 1)
    elif isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _count_expanded(item, budget, name, depth + 1)


def check_number(value: float, place: str) -> None:
    """Refuse a number beyond every quantity of the bench; NaN and infinity are left to the reader of the key.

    Raises:
        BenchError: with the place.
    """
    try:
        size = abs(float(value))
    except OverflowError:
        raise BenchError(f"{place}: a number of more than 300 digits; give one below {LARGEST_NUMBER:g}.") from None
    if size > LARGEST_NUMBER and not math.isinf(size):
        raise BenchError(f"{place}: {float(value):g} is beyond every quantity here; give one below {LARGEST_NUMBER:g}.")
    if 0.0 < size < SMALLEST_NUMBER:
        raise BenchError(
            f"{place}: {float(value):g} is too small to be told from zero; give 0 or more than {SMALLEST_NUMBER:g}."
        )


def json_value(text: str, name: str, bounded: bool = True) -> Any:
    """Content of a JSON text, of bounded depth, size and magnitudes.

    Args:
        text: JSON; NaN and Infinity are taken as Python writes them.
        name: of the file or the place, for messages.
        bounded: refuse magnitudes beyond every quantity; off for results, which may be as wild as the data were.

    Raises:
        BenchError: not JSON, too deep, too many entries, or a number out of bounds.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        why = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise BenchError(f"{name} is not valid JSON: {why}.") from error
    budget = _MOST_JSON_NODES
    waiting: list[tuple[Any, int, str]] = [(value, 0, "")]
    while waiting:
        item, depth, key = waiting.pop()
        budget -= 1
        if budget < 0 or depth > _DEEPEST:
            raise BenchError(f"{name} is nested too deeply or has too many entries.")
        if isinstance(item, dict):
            waiting.extend((part, depth + 1, inner) for inner, part in item.items())
        elif isinstance(item, list):
            waiting.extend((part, depth + 1, key) for part in item)
        elif bounded and isinstance(item, int | float) and not isinstance(item, bool):
            _check_json_number(item, f"{name}, '{key}'" if key else name)
    return value


def _check_json_number(item: float, place: str) -> None:
    # Files that programs wrote hold residuals and variances, which may be as small as they like.
    if isinstance(item, int) or abs(item) > LARGEST_NUMBER:
        check_number(item, place)


def read_json(path: Path, what: str, largest: int = LARGEST_TABLE) -> dict[str, Any]:
    """A JSON object from a regular file; errors as :func:`read_text` and :func:`json_value`, or it is not an object."""
    value = json_value(read_text(path, what, largest), f"The {what} {path}")
    if not isinstance(value, dict):
        raise BenchError(f"The {what} {path} must be a JSON object.")
    return value


def read_arrays(path: Path, what: str, largest: int = LARGEST_ARRAYS) -> Mapping[str, np.ndarray[Any, Any]]:
    """Arrays of an NPZ file, without pickles.

    Every header is read, and its claim compared with the file, before memory is taken for any array.

    Args:
        path: the file.
        what: kind of file, for messages.
        largest: bytes of all arrays together.

    Raises:
        BenchError: as :func:`open_regular`, no NPZ file, an array of objects, or claims that do not fit the file or
            are more than ``largest``.
    """
    import numpy as np  # late: most files are text, and commands that read only those start faster

    try:
        with open_regular(path, what, largest) as file:
            with zipfile.ZipFile(file) as archive:
                sizes = {item.filename: _claimed_in_archive(archive, item) for item in archive.infolist()}
            total = sum(sizes.values())
            if total > largest:
                raise BenchError(
                    f"The arrays of the {what} {path} need {total / 2**20:.4g} MiB, more than the "
                    f"{largest / 2**20:g} MiB that are read; split the file."
                )
            file.seek(0)
            with np.load(file, allow_pickle=False) as arrays:
                return {name: arrays[name] for name in arrays.files}
    except BenchError:
        raise
    except (OSError, *_DAMAGED_NPZ) as error:
        raise BenchError(
            f"The {what} {path.name} is cut off or damaged ({_first_line(error)}); save it again."
        ) from error
    except _NOT_PLAIN as error:
        raise BenchError(
            f"The {what} {path.name} holds arrays that are not plain numbers ({_first_line(error)}); save float arrays "
            "with numpy.savez."
        ) from error


def read_array(path: Path, what: str, largest: int = LARGEST_ARRAYS) -> np.ndarray[Any, Any]:
    """The array of an NPY file, its claim compared with the file first; arguments and errors as :func:`read_arrays`."""
    import numpy as np

    try:
        with open_regular(path, what, largest) as file:
            needed = _claimed_bytes(file, "it", path.stat().st_size)
            if needed > largest:
                raise BenchError(
                    f"The array of the {what} {path} needs {needed / 2**20:.4g} MiB, more than the "
                    f"{largest / 2**20:g} MiB that are read."
                )
            file.seek(0)
            array: np.ndarray[Any, Any] = np.load(file, allow_pickle=False)
            return array
    except BenchError:
        raise
    except (OSError, EOFError, *_NOT_PLAIN) as error:
        raise BenchError(
            f"The {what} {path.name} is not a NumPy array of numbers ({_first_line(error)}); save it with numpy.save."
        ) from error


def _claimed_bytes(entry: IO[bytes], name: str, size: int) -> int:
    """Bytes that an array of `size` bytes with its header needs in memory as double precision, by its header."""
    from numpy.lib import format as npy

    version = npy.read_magic(entry)
    reader = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(version)
    if reader is None:
        raise ValueError(f"{name} has version {version} of the format")
    shape, _, kind = reader(entry)
    head = entry.tell()
    if kind.hasobject:
        raise ValueError(f"{name} holds objects")
    values = math.prod(int(n) for n in shape)
    claimed = values * int(kind.itemsize)
    if claimed != size - head or any(n < 0 for n in shape):
        raise ValueError(f"{name} claims {claimed} bytes and has {size - head}")
    return max(claimed, 8 * values)


def _claimed_in_archive(archive: zipfile.ZipFile, item: zipfile.ZipInfo) -> int:
    if not item.filename.endswith(".npy"):
        raise ValueError(f"'{item.filename}' in it is not an array")
    with archive.open(item) as entry:
        return _claimed_bytes(entry, f"'{item.filename}'", item.file_size)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
