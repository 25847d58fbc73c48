"""Structures that a rig file takes from other files: read once, when the rig is loaded.

The rig then holds the numbers, so that it travels in bags and result folders without the files.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import json_value, read_text
from nmt_core.files.whole_file import write_whole
from nmt_core.files.yaml_document import YamlDocument
from nmt_rig.file_errors import BadFileError
from nmt_rig.modal_files import read_modal_csv, read_uff55

# Larger structures are integrated too slowly, and their rig files become too long.
LARGEST = 60
_LARGEST_CONDENSED = 2000
# The reduction of smaller files takes less time than a node's start.
_SMALL_FILE = 2**18
# Changes where the reduction gives other numbers for the same files.
_REDUCTION = "1"
_FILE_KEYS = ("file", "mass_file", "stiffness_file", "damping_file")
_MATRIX_KEYS = ("mass_kg", "stiffness_n_m", "damping_ns_m")


def names_files(key: str) -> bool:
    """Whether an override's key says which files or reduction a structure is read with, or replaces the structure."""
    first, _, rest = key.partition(".")
    return first == "structure" and rest in ("", *_FILE_KEYS, "modes", "direction", "points_at", "base_vector")


def with_file_contents(document: YamlDocument, folder: Path) -> YamlDocument:
    """The document with the contents of the files that its structure names; matrices checked, and reduced as it says.

    Args:
        document: a rig file.
        folder: where relative paths start.

    Raises:
        BenchError: a file that cannot be read or does not fit, with the line of its key.
    """
    structure = document.values.get("structure")
    if not isinstance(structure, Mapping):
        return document
    if structure.get("kind") == "modal" and structure.get("file") is not None:
        return _replaced(document, _modal(document, structure, folder))
    if structure.get("kind") == "matrices":
        return _replaced(document, _matrices(document, structure, folder))
    return document


def _replaced(document: YamlDocument, structure: dict[str, Any]) -> YamlDocument:
    return YamlDocument(document.name, {**document.values, "structure": structure}, document.places)


def completed(document: YamlDocument) -> YamlDocument:
    """A modal rig with what its file leaves out: exciter and sensors, and as many linear modes as they allow.

    So a structure given by one mode is a rig of a few lines.
    """
    document = with_channels(document)
    values = document.values
    extraction = values.get("extraction", {})
    if not _is_modal(document) or not isinstance(extraction, Mapping) or "linear_modes" in extraction:
        return document
    modes, sensors = values["structure"].get("modes"), values["sensors"]
    if not isinstance(modes, list) or not isinstance(sensors, list):
        return document
    quantity = extraction.get("quantity", "displacement")
    responses = sum(isinstance(sensor, Mapping) and sensor.get("quantity") == quantity for sensor in sensors)
    extraction = {**extraction, "linear_modes": max(1, min(2, len(modes), responses))}
    return YamlDocument(document.name, {**values, "extraction": extraction}, document.places)


def with_channels(document: YamlDocument) -> YamlDocument:
    """A modal rig with an ideal force at its first point and sensors at all points, where its file leaves them out."""
    if not _is_modal(document):
        return document
    points = document.values["structure"].get("points", [1])
    if not isinstance(points, list) or not points:
        points = [1]
    sensors = [
        {"quantity": "force", "point": "drive"},
        *({"quantity": "displacement", "point": point} for point in points),
        *({"quantity": "acceleration", "point": point} for point in points),
        {"quantity": "voltage"},
    ]
    defaults: dict[str, Any] = {"exciter": {"kind": "force", "point": points[0]}, "sensors": sensors}
    if "exciters" in document.values:
        del defaults["exciter"]
    return YamlDocument(document.name, {**defaults, **document.values}, document.places)


def _is_modal(document: YamlDocument) -> bool:
    structure = document.values.get("structure")
    return isinstance(structure, Mapping) and structure.get("kind") == "modal"


def _path(document: YamlDocument, structure: Mapping[str, Any], key: str, folder: Path) -> Path | None:
    text = structure.get(key)
    if text is None:
        return None
    place = document.place(("structure", key))
    if not isinstance(text, str) or not text:
        raise BenchError(f"{place}: structure.{key} must be the path of a file.")
    path = folder / Path(text).expanduser()
    if not path.is_file():
        raise BenchError(f"{place}: structure.{key} is {text}, and there is no file {path}; fix the path.")
    return path


def _reading(place: str, path: Path, read: Callable[[Path], Any]) -> Any:
    """What `read` returns; what is wrong with the file as one sentence."""
    try:
        return read(path)
    except OSError as error:
        raise BenchError(f"{place}: {path.name} cannot be read: {error.strerror or error}.") from error
    except BadFileError as error:
        raise BenchError(f"{place}: {path.name}: {error}.") from error


def _source(*paths: Path | None) -> str:
    """Names and digests of files, for the rig to say where its numbers come from."""
    return ", ".join(
        f"{path.name} (SHA-256 {hashlib.sha256(path.read_bytes()).hexdigest()[:12]})"
        for path in paths
        if path is not None
    )


def _modal(document: YamlDocument, structure: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    path = _path(document, structure, "file", folder)
    assert path is not None
    place = document.place(("structure", "file"))
    if structure.get("modes"):
        raise BenchError(f"{place}: structure.file and structure.modes both give the modes; remove one.")
    wanted = structure.get("points")
    if path.suffix.lower() == ".csv":
        points, modes = _reading(place, path, read_modal_csv)
    elif path.suffix.lower() in (".uff", ".unv", ".uf"):
        direction = str(structure.get("direction", "z"))
        points, modes = _reading(place, path, partial(read_uff55, direction=direction))
    else:
        raise BenchError(
            f"{place}: structure.file must be a .csv table or a universal file (.uff, .unv), got {path.name}."
        )
    if wanted is not None:
        if not isinstance(wanted, list) or not set(wanted) <= set(points):
            raise BenchError(
                f"{document.place(('structure', 'points'))}: structure.points must be among the points of {path.name}: "
                f"{', '.join(map(str, points))}."
            )
        rows = [points.index(point) for point in wanted]
        modes = [{**mode, "shape": [mode["shape"][row] for row in rows]} for mode in modes]
        points = wanted
    rest = {key: value for key, value in structure.items() if key not in ("file", "direction", "points")}
    return {**rest, "points": points, "modes": modes, "source": _source(path)}


def _matrices(document: YamlDocument, structure: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    key = next((key for key in _FILE_KEYS if structure.get(key) is not None), "modes")
    place = document.place(("structure", key))
    paths = {name: _path(document, structure, name, folder) for name in _FILE_KEYS}
    points_at, kept = _kept_rows(document, structure.get("points_at"))
    source = _source(*paths.values())
    stored = _stored_reduction(structure, paths, kept)
    found = _read_reduction(stored, len(kept))
    if not found:
        try:
            found = _reduced(_quantities(document, structure, key, paths), kept, structure.get("modes"))
        except ValueError as error:
            raise BenchError(f"{place}: {error}.") from error
        if stored is not None:
            # A folder that cannot be written only costs the time of the next reduction.
            with contextlib.suppress(OSError):
                stored.parent.mkdir(exist_ok=True)
                write_whole(stored, json.dumps(found))
    number, note = dict(zip(kept, found.pop("rows"), strict=True)), found.pop("note")
    points_at = [
        {name: value if name == "point" or value is None else number[value] for name, value in entry.items()}
        for entry in points_at
    ]
    rest = {k: v for k, v in structure.items() if k not in (*_FILE_KEYS, *_MATRIX_KEYS, "modes", "base_vector")}
    source = f"{source}; {note}" if source and note else source or structure.get("source", "")
    return rest | {"points_at": points_at, **found, "source": source}


def _quantities(
    document: YamlDocument, structure: Mapping[str, Any], key: str, paths: Mapping[str, Path | None]
) -> dict[str, Any]:
    """Matrices and vectors by quantity, from the files and from what stands in the rig file itself."""
    # Late: file formats of scipy take a third of a second, in every node that loads a rig.
    from nmt_rig.matrix_files import read_matrices, read_matrix

    place = document.place(("structure", key))
    found: dict[str, Any] = {}
    for name, path in paths.items():
        if path is None:
            continue
        read = read_matrices if name == "file" else read_matrix
        content = _reading(document.place(("structure", name)), path, read)
        given = content if name == "file" else {name.removesuffix("_file"): content}
        _once(found, given, place, key, name)
    for name in (*_MATRIX_KEYS, "base_vector", "base_load_kg"):
        if structure.get(name) is None or structure[name] == []:
            continue
        quantity = name.removesuffix("_kg").removesuffix("_ns_m").removesuffix("_n_m")
        try:
            value = np.array(structure[name], dtype=float)
        except (TypeError, ValueError) as error:
            raise BenchError(
                f"{document.place(('structure', name))}: structure.{name} must be rows of numbers of equal length."
            ) from error
        _once(found, {quantity: value}, place, key, name)
    for quantity in ("mass", "stiffness"):
        if quantity not in found:
            raise BenchError(f"{place}: the {quantity} matrix is missing; give structure.file, or {quantity}_file.")
    if "damping" in found and structure.get("damping_ratios") is not None:
        raise BenchError(f"{place}: the files give a damping matrix, and structure.damping_ratios too; remove one.")
    return found


def _once(found: dict[str, Any], given: Mapping[str, Any], place: str, key: str, name: str) -> None:
    """Take quantities that nothing else gives."""
    for quantity in given:
        if quantity in found:
            raise BenchError(f"{place}: structure.{key} and structure.{name} both give the {quantity}; remove one.")
    found.update(given)


def _reduced(quantities: Mapping[str, Any], kept: list[int], modes: Any) -> dict[str, Any]:
    """Matrices of at most ``LARGEST`` rows as lists, the new rows of the kept ones, what was condensed in words.

    Raises:
        ValueError: matrices that are no passive structure, or too large without `modes`.
    """
    # Late: scipy's sparse matrices take a third of a second, in every node that loads a rig.
    from nmt_rig.model.matrix_structure import Matrices, condensed, craig_bampton

    matrices = Matrices(**quantities).checked()
    if beyond := [row for row in kept if row >= matrices.size]:
        raise ValueError(f"structure.points_at names row {beyond[0]}, but the rows are 0 to {matrices.size - 1}")
    massless = int(matrices.massless().size)
    if modes is not None:
        if not isinstance(modes, int) or isinstance(modes, bool):
            raise ValueError(f"structure.modes must be a whole number, got {modes!r}")
        matrices, rows = craig_bampton(matrices, kept, modes), list(range(len(kept)))
    elif matrices.size - massless > LARGEST or matrices.size > _LARGEST_CONDENSED:
        raise ValueError(
            f"the structure has {matrices.size} degrees of freedom, and {LARGEST} is the limit; reduce it with "
            "structure.modes, the number of modes to keep beside the points"
        )
    else:
        matrices, left = condensed(matrices, kept)
        rows = np.searchsorted(left, kept).tolist()
    plain = matrices.dense()
    if without := np.flatnonzero(~np.asarray(plain.mass).any(axis=1)).tolist():
        raise ValueError(
            f"row {kept[rows.index(without[0])] if without[0] in rows else without[0]} moves a point or a damper and "
            "has no mass; reduce the structure with structure.modes"
        )
    found = {"mass_kg": plain.mass, "stiffness_n_m": plain.stiffness, "damping_ns_m": plain.damping,
             "base_vector": matrices.base_vector, "base_load_kg": matrices.load()}  # fmt: skip
    lists = {name: np.asarray(value, dtype=float).tolist() for name, value in found.items() if value is not None}
    note = f"{massless} rows without mass follow the others statically" if massless else ""
    return {**lists, "rows": rows, "note": note}


def _stored_reduction(structure: Mapping[str, Any], paths: Mapping[str, Path | None], kept: list[int]) -> Path | None:
    """Where the reduction of large files is kept, named by the digest of all that it follows from; None without one."""
    files = [path for path in paths.values() if path is not None]
    if structure.get("modes") is None or not files or sum(path.stat().st_size for path in files) < _SMALL_FILE:
        return None
    digest = hashlib.sha256(f"{_REDUCTION} {kept} {structure['modes']}".encode())
    for name, path in paths.items():
        if path is not None:
            digest.update(f"{name} {hashlib.sha256(path.read_bytes()).hexdigest()}".encode())
    for name in (*_MATRIX_KEYS, "base_vector", "base_load_kg", "damping_ratios"):
        digest.update(repr(structure.get(name)).encode())
    return files[0].parent / ".nmt-reduced" / f"{files[0].name}-{digest.hexdigest()[:16]}.json"


def _read_reduction(path: Path | None, kept: int) -> dict[str, Any]:
    """What was kept of a reduction; empty where there is none, or it is damaged."""
    if path is None or not path.is_file():
        return {}
    try:
        found = json_value(read_text(path, "reduced structure"), path.name, bounded=False)
    except BenchError:
        return {}
    good = isinstance(found, dict) and {"mass_kg", "stiffness_n_m", "rows", "note"} <= set(found)
    return found if good and isinstance(found["rows"], list) and len(found["rows"]) == kept else {}


def _kept_rows(document: YamlDocument, points_at: Any) -> tuple[list[dict[str, Any]], list[int]]:
    """Entries of points_at as they are, and the rows that they name, in order."""
    place = document.place(("structure", "points_at"))
    good = isinstance(points_at, list) and points_at and all(isinstance(entry, dict) for entry in points_at)
    rows = [entry.get(key) for entry in points_at for key in ("row", "rotation_row")] if good else [None]
    named = [row for row in rows if row is not None]
    if not good or not all(isinstance(row, int) and row >= 0 for row in named) or any(row is None for row in rows[::2]):
        raise BenchError(
            f"{place}: structure.points_at must be a list of points with their rows of the matrices, counted from 0: "
            "{point: 1, row: 12}."
        )
    return points_at, named
