"""Structures that a rig file takes from other files: read once, when the rig is loaded.

The rig then holds the numbers, so that it travels in bags and result folders without the files.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import SMALLEST_NUMBER, check_number, json_value, read_text
from nmt_core.files.whole_file import write_whole
from nmt_core.files.yaml_document import YamlDocument
from nmt_rig.file_errors import BadFileError, KeyOfRigError
from nmt_rig.modal_files import read_modal_csv, read_uff55

if TYPE_CHECKING:
    from nmt_rig.named_rows import NamedModel

# Larger structures are integrated too slowly, and their rig files become too long.
LARGEST = 60
_LARGEST_CONDENSED = 2000
# The reduction of smaller files takes less time than a node's start.
_SMALL_FILE = 2**18
# Changes where the reduction gives other numbers for the same files.
_REDUCTION = "7"
_FILE_KEYS = ("file", "mass_file", "stiffness_file", "damping_file", "rows_file", "nodes_file")
_DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")
_MATRIX_KEYS = ("mass_kg", "stiffness_n_m", "damping_ns_m")


def names_files(key: str) -> bool:
    """Whether an override's key says which files or reduction a structure is read with, or replaces the structure."""
    first, _, rest = key.partition(".")
    return first == "structure" and rest in (
        "", *_FILE_KEYS, "units", "modes", "direction", "points_at", "base_vector", "regions"
    )  # fmt: skip


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
    place = document.place(("structure", "file"))
    held = {key: _as_in_a_rig_file(value, f"{place}: structure.{key}") for key, value in structure.items()}
    return YamlDocument(document.name, {**document.values, "structure": held}, document.places)


def _as_in_a_rig_file(value: Any, place: str) -> Any:
    """Computed numbers as a rig file may hold them: what is too small for one is rounding where zero is meant.

    Raises:
        BenchError: a number beyond every quantity, with the place.
    """
    if isinstance(value, dict):
        return {key: _as_in_a_rig_file(item, f"{place}.{key}") for key, item in value.items()}
    if isinstance(value, list):
        return [_as_in_a_rig_file(item, place) for item in value]
    if not isinstance(value, float):
        return value
    value = value if abs(value) >= SMALLEST_NUMBER or math.isnan(value) else 0.0
    check_number(value, place)
    return value


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
    named = {name: _path(document, structure, name, folder) for name in _FILE_KEYS}
    paths = {name: path for name, path in named.items() if path is not None}
    entries = _point_entries(document, structure.get("points_at"), bool(paths))
    source = _source(*paths.values(), *(path for path in region_paths(structure, folder) if path.is_file()))
    stored = _stored_reduction(structure, paths, entries, folder)
    found = _read_reduction(stored, len(entries))
    if not found:
        try:
            model = _model(document, structure, key, paths)
            found = _reduced(model, entries, structure, folder)
        except OSError as error:
            raise BenchError(f"{place}: {error.filename} cannot be read: {error.strerror or error}.") from error
        except KeyOfRigError as error:
            raise BenchError(f"{document.place(error.path)}: {error}.") from error
        except ValueError as error:
            raise BenchError(f"{place}: {error}.") from error
        if stored is not None:
            # A folder that cannot be written only costs the time of the next reduction.
            with contextlib.suppress(OSError):
                stored.parent.mkdir(exist_ok=True)
                write_whole(stored, json.dumps(found))
    note = found.pop("note")
    away = (*_FILE_KEYS, *_MATRIX_KEYS, "units", "modes", "base_vector")
    rest = {k: v for k, v in structure.items() if k not in away}
    source = f"{source}; {note}" if source and note else source or structure.get("source", "")
    return rest | {**found, "source": source}


def _model(document: YamlDocument, structure: Mapping[str, Any], key: str, paths: Mapping[str, Path]) -> NamedModel:
    """Matrices and vectors by quantity, from the files and from what stands in the rig file itself."""
    # Late: file formats of scipy take a third of a second, in every node that loads a rig.
    from nmt_rig.matrix_files import read_model

    place = document.place(("structure", key))
    try:
        model = read_model(paths)
    except OSError as error:
        raise BenchError(f"{place}: {error.filename} cannot be read: {error.strerror or error}.") from error
    except BadFileError as error:
        raise BenchError(f"{place}: {error}.") from error
    found = model.matrices
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
        if quantity in found:
            raise BenchError(f"{place}: structure.{key} and structure.{name} both give the {quantity}; remove one.")
        found[quantity] = value
    for quantity in ("mass", "stiffness"):
        if quantity not in found:
            raise BenchError(f"{place}: the {quantity} matrix is missing; give structure.file, or {quantity}_file.")
    if "damping" in found and structure.get("damping_ratios") is not None:
        raise BenchError(f"{place}: the files give a damping matrix, and structure.damping_ratios too; remove one.")
    return model


def _reduced(
    model: NamedModel, entries: list[dict[str, Any]], structure: Mapping[str, Any], folder: Path
) -> dict[str, Any]:
    """Matrices of at most ``LARGEST`` rows as lists, points with their rows of them, regions, what was done in words.

    Raises:
        ValueError: points that the files do not have, matrices that are no passive structure, or too large without
            `modes`, or figures that cannot be in SI units where no others are stated.
    """
    # Late: scipy's sparse matrices take a third of a second, in every node that loads a rig.
    from nmt_rig.model.matrix_structure import TRUNCATION, Matrices, condensed, craig_bampton, regular
    from nmt_rig.named_rows import Units
    from nmt_rig.region_files import read_regions, reduced_with_regions

    units, modes = structure.get("units"), structure.get("modes")
    points_at, notes = _found_points(model, entries)
    kept = [entry[key] for entry in points_at for key in ("row", "rotation_row") if entry.get(key) is not None]
    rotations = [entry["rotation_row"] for entry in points_at if entry.get("rotation_row") is not None]
    with _about("units"):
        system = Units.named(str(units or "m-kg-N"))
    if units is None and (doubt := model.doubt_of_units()):
        raise ValueError(
            f"read in metres, kilograms and newtons {doubt}; state the units of the file, as units: mm-t-N"
        )
    turned = [entry["row"] for entry in points_at if str(entry.get("direction")).startswith("r")]
    matrices = Matrices(**system.in_si(model.matrices, rotations + turned)).checked()
    if beyond := [row for row in kept if row >= matrices.size]:
        why = f"structure.points_at names row {beyond[0]}, but the rows are 0 to {matrices.size - 1}"
        raise KeyOfRigError(("structure", "points_at"), why)
    massless = int(matrices.massless().size)
    written: dict[str, Any] = {}
    if structure.get("regions") and modes is None and structure.get("mass_kg") is None:
        why = "structure.regions need structure.modes, the number of modes to keep besides the points"
        raise KeyOfRigError(("structure", "regions"), why)
    if modes is not None:
        if not isinstance(modes, int) or isinstance(modes, bool):
            raise KeyOfRigError(("structure", "modes"), f"structure.modes must be a whole number, got {modes!r}")
        if sections := structure.get("regions"):
            regions = read_regions(model, sections, folder, system, rotations + turned)
            with _about("regions"):
                matrices, written = reduced_with_regions(matrices, kept, modes, regions, LARGEST)
            notes += _region_notes(written)
        else:
            with _about("modes"):
                matrices = craig_bampton(matrices, kept, modes, most=LARGEST)
        rows = list(range(len(kept)))
        if written and (moving := matrices.size - _held_rows(written)) > LARGEST:
            raise KeyOfRigError(
                ("structure", "regions"),
                f"points, modes and what regions need are {moving} coordinates, and {LARGEST} is the limit; "
                "keep fewer modes or regions",
            )
    elif (
        matrices.size - massless - _held_rows(structure.get("regions") or {}) > LARGEST
        or matrices.size > _LARGEST_CONDENSED
    ):
        raise ValueError(
            f"the structure has {matrices.size} degrees of freedom, and {LARGEST} is the limit; reduce it with "
            "structure.modes, the number of modes to keep besides the points"
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
    if not regular(plain.mass):
        raise ValueError("a combination of the rows moves no mass; reduce the structure with structure.modes")
    found = {"mass_kg": plain.mass, "stiffness_n_m": plain.stiffness, "damping_ns_m": plain.damping,
             "base_vector": matrices.base_vector, "base_load_kg": matrices.load()}  # fmt: skip
    lists = {name: np.asarray(value, dtype=float).tolist() for name, value in found.items() if value is not None}
    if massless:
        notes.append(f"{massless} rows without mass follow the others statically")
    if matrices.band_hz is not None:
        notes.append(f"modes left out move frequencies by less than {TRUNCATION:.1%} up to {matrices.band_hz:.4g} Hz")
    if model.held:
        notes.append(f"{model.held} rows are held and were left out")
    number = dict(zip(kept, rows, strict=True))
    placed = [
        {k: number[v] if k in ("row", "rotation_row") and v is not None else v for k, v in entry.items()}
        for entry in points_at
    ]
    return {**lists, "points_at": placed, "note": "; ".join(notes), **({"regions": written} if written else {})}


@contextlib.contextmanager
def _about(key: str) -> Iterator[None]:
    """Whatever is refused is so for the value of a key of the structure."""
    try:
        yield
    except ValueError as error:
        raise KeyOfRigError(("structure", key), error) from error


def _held_rows(regions: Mapping[str, Any]) -> int:
    """Coordinates of a reduced structure that ideal supports take out of its motion."""
    return sum(
        len(region.get(key) or ()) for region in regions.values() for key in ("translation_rows", "rotation_rows")
    )


def _region_notes(regions: Mapping[str, Any]) -> list[str]:
    """What each region is, in words."""
    notes = []
    for name, region in regions.items():
        parts = [f"{len(region['nodes'])} nodes"] if region["nodes"] else []
        if region.get("held"):
            kinds = [
                word
                for key, word in (("translation_rows", "translations"), ("rotation_rows", "rotations"))
                if region.get(key)
            ]
            parts.append(f"held in {' and '.join(kinds)}")
        else:
            if "mass_kg" in region:
                parts.append(f"{region['moved_kg']:.4g} kg")
            parts.append("with a stiffness of its own" if "stiffness_n_m" in region else "without a stiffness")
        notes.append(f"region {name}: {', '.join(parts)}")
    return notes


def _found_points(model: NamedModel, entries: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[str]]:
    """Points with the rows that their nodes and directions are, and which node is next to a place, in words.

    Raises:
        ValueError: a node, a direction or coordinates that the files do not have.
    """
    found, notes = [], []
    for index, entry in enumerate(entries):
        if entry.get("row") is not None:
            found.append(entry)
            continue
        number, node = entry["point"], entry.get("node")
        try:
            if node is None:
                node, distance = model.nearest(entry["at"])
                notes.append(f"point {number} is node {node}, {distance:.3g} from its place")
            rows = {"row": model.row(node, entry["direction"])}
            if entry.get("rotation") is not None:
                rows["rotation_row"] = model.row(node, entry["rotation"])
        except ValueError as error:
            raise KeyOfRigError(("structure", "points_at", index), f"point {number}: {error}") from error
        found.append({**entry, "node": node, **rows})
    return found, notes


def _stored_reduction(
    structure: Mapping[str, Any], paths: Mapping[str, Path], entries: list[dict[str, Any]], folder: Path
) -> Path | None:
    """Where the reduction of large files is kept, named by the digest of all that it follows from; None without one."""
    files = list(paths.values())
    if structure.get("modes") is None or not files or sum(path.stat().st_size for path in files) < _SMALL_FILE:
        return None
    digest = hashlib.sha256(f"{_REDUCTION} {entries} {structure['modes']} {structure.get('units')}".encode())
    digest.update(repr(structure.get("regions")).encode())
    for file in region_paths(structure, folder):
        digest.update(hashlib.sha256(file.read_bytes()).digest() if file.is_file() else b"")
    for name, path in paths.items():
        digest.update(f"{name} {hashlib.sha256(path.read_bytes()).hexdigest()}".encode())
    for name in (*_MATRIX_KEYS, "base_vector", "base_load_kg", "damping_ratios"):
        digest.update(repr(structure.get(name)).encode())
    return files[0].parent / ".nmt-reduced" / f"{files[0].name}-{digest.hexdigest()[:16]}.json"


def region_paths(structure: Mapping[str, Any], folder: Path) -> list[Path]:
    """Files of the regions of a structure."""
    regions = structure.get("regions")
    sections = regions.values() if isinstance(regions, Mapping) else ()
    names = [section.get("file") for section in sections if isinstance(section, Mapping)]
    return [folder / Path(name).expanduser() for name in names if isinstance(name, str)]


def _read_reduction(path: Path | None, points: int) -> dict[str, Any]:
    """What was kept of a reduction; empty where there is none, or it is damaged."""
    if path is None or not path.is_file():
        return {}
    try:
        found = json_value(read_text(path, "reduced structure"), path.name, bounded=False)
    except BenchError:
        return {}
    good = isinstance(found, dict) and {"mass_kg", "stiffness_n_m", "points_at", "note"} <= set(found)
    return found if good and isinstance(found["points_at"], list) and len(found["points_at"]) == points else {}


def _point_entries(document: YamlDocument, points_at: Any, files: bool) -> list[dict[str, Any]]:
    """Entries of points_at, each by a row, by a node and its direction, or by a place and a direction.

    A rig that carries its matrices names rows; node and place then only say where they come from.
    """
    place = document.place(("structure", "points_at"))
    example = "{point: 1, node: 17, direction: z}, {point: 1, at: [0.2, 0, 0], direction: z} or {point: 1, row: 12}"
    if not isinstance(points_at, list) or not points_at or not all(isinstance(entry, dict) for entry in points_at):
        raise BenchError(f"{place}: structure.points_at must be a list of points: {example}.")
    for entry in points_at:
        rows = [entry.get(key) for key in ("row", "rotation_row") if entry.get(key) is not None]
        by_row = entry.get("row") is not None and all(_is_whole(row) and row >= 0 for row in rows)
        names = [key for key in ("node", "at") if entry.get(key) is not None]
        by_name = not rows and len(names) == 1 and entry.get("direction") in _DIRECTIONS
        by_name = by_name and entry.get("rotation") in (None, *_DIRECTIONS[3:])
        by_name = by_name and (_is_whole(entry.get("node")) if names == ["node"] else _is_place(entry.get("at")))
        if not ((by_name and files) or (by_row and not (files and names))):
            raise BenchError(f"{place}: structure.points_at must be a list of points, each by one of {example}.")
    return points_at


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_place(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(x, int | float) and not isinstance(x, bool) and np.isfinite(x) for x in value)
    )
