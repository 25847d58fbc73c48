"""Matrices in the texts of finite-element programs: Nastran's DMIG, Abaqus' and CalculiX' matrices and nodes.

The formats are cards and lists of numbers; a rig must load where no package of these programs is installed.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from nmt_core.errors import BenchError
from nmt_core.files.hardened import LARGEST_ARRAYS, open_regular
from nmt_rig.file_errors import BadFileError
from nmt_rig.named_rows import Entries, ModelPart, label, mirrored, once

_LARGEST_ROWS = 10**6
_ABAQUS_MATRICES = {
    "STIFFNESS": "stiffness", "MASS": "mass", "VISCOUSDAMPING": "damping", "DAMPINGVISCOUS": "damping",
    "DAMPING": "damping",
}  # fmt: skip
_PAIRS = {"stiffness": ("STIF", ".sti"), "mass": ("MASS", ".mas"), "damping": ("DMPV", ".dam")}
_LETTERS_OF = {"stiffness": "K", "mass": "M", "damping": "BC"}
_LETTERS = {"K": "stiffness", "M": "mass", "C": "damping"}
_INCLUDE = re.compile(r"\*?\s*INCLUDE\b[\s,]*(?:INPUT\s*=)?\s*(\S.{0,60})", re.IGNORECASE)
_BARE_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d+)$")


def text_of(path: Path) -> str:
    """Text of a file that a program wrote.

    Raises:
        BadFileError: it is too large, or no regular file.
        OSError: it cannot be read.
    """
    try:
        with open_regular(path, "matrix file", LARGEST_ARRAYS) as file:
            return file.read(LARGEST_ARRAYS + 1).decode("latin-1")
    except BenchError as error:
        raise BadFileError(str(error).rstrip(".")) from error


def is_matrix_market(path: Path) -> bool:
    """Whether a file begins as Matrix Market ones do; .mtx is the ending of Abaqus' matrices, too."""
    try:
        with open_regular(path, "matrix file", LARGEST_ARRAYS) as file:
            return file.read(14).lower().startswith(b"%%matrixmarket") or path.stat().st_size == 0
    except BenchError as error:
        raise BadFileError(str(error).rstrip(".")) from error


def is_harwell_boeing(path: Path) -> bool:
    """Whether the third line of a file begins with the three letters of a Harwell-Boeing matrix, as rsa."""
    try:
        with open_regular(path, "matrix file", LARGEST_ARRAYS) as file:
            lines = [file.readline(256) for _ in range(3)]
    except BenchError as error:
        raise BadFileError(str(error).rstrip(".")) from error
    return bool(re.match(rb"[rcpi][suhzr][ae]\s+\d+\s+\d+", lines[2].lower()))


def number_table(text: str, columns: int, what: str) -> NDArray[np.float64]:
    """(n, columns) numbers of a text with commas or blanks between them.

    Raises:
        BadFileError: something that is not a number, or lines that are not whole.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            numbers = np.fromstring(text.replace(",", " ").replace("D", "E").replace("d", "e"), sep=" ")
    except (ValueError, DeprecationWarning, OverflowError) as error:
        raise BadFileError(f"{what} has something that is not a number") from error
    if not numbers.size or numbers.size % columns or not np.all(np.isfinite(numbers)):
        raise BadFileError(f"{what} must have {columns} finite numbers a line")
    return numbers.reshape(-1, columns)


def _whole(values: NDArray[np.float64], what: str) -> NDArray[np.int64]:
    if np.any(values != np.round(values)) or np.any(np.abs(values) > 1e12):
        raise BadFileError(f"{what} has numbers of rows or nodes that are not whole")
    return values.astype(np.int64)


def sister(path: Path, quantity: str, wanted: str) -> Path | None:
    """The file of another quantity that a program wrote with this one: job_MASS1.mtx next to job_STIF1.mtx."""
    for mark, replacement in zip(_PAIRS[quantity], _PAIRS[wanted], strict=True):
        name = re.sub(re.escape(mark), replacement, path.name, flags=re.IGNORECASE)
        if name != path.name and (path.parent / name).is_file():
            return path.parent / name
    return None


def quantity_of(path: Path) -> str | None:
    """Which matrix a file holds, by the name that Abaqus or CalculiX gave it, or by its last word, as plate_K.mtx."""
    upper = path.name.upper()
    for quantity, (mark, ending) in _PAIRS.items():
        if mark in upper or upper.endswith(ending.upper()):
            return quantity
    return _LETTERS.get(re.split(r"[^A-Z]", path.stem.upper())[-1])


def read_abaqus(path: Path, quantity: str | None) -> ModelPart:
    """A substructure (``*MATRIX, TYPE=…``) or the list of entries of ``*MATRIX GENERATE``.

    Args:
        path: the file.
        quantity: which matrix a list is.

    Raises:
        BadFileError: neither, or not whole.
        OSError: the file cannot be read.
    """
    text = text_of(path)
    _refuse_includes(text)
    if re.search(r"^\*\s*MATRIX\s*,", text, re.MULTILINE | re.IGNORECASE):
        return _substructure(text)
    lines = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("*"))
    first = next((line for line in lines.splitlines() if line.strip()), "")
    columns = len(first.replace(",", " ").split())
    if columns not in (3, 5):
        raise BadFileError(
            "it is neither Matrix Market nor a matrix of Abaqus: *MATRIX TYPE=STIFFNESS, node,dof,node,dof,value or "
            "row,column,value"
        )
    if quantity is None:
        raise BadFileError(
            "its name does not say which matrix it is; give it as stiffness_file, mass_file, damping_file"
        )
    numbers = number_table(lines, columns, "a list of entries")
    places = _whole(numbers[:, :-1], "a list of entries")
    if columns == 3:
        return ModelPart({quantity: _listed(places[:, 0], places[:, 1], numbers[:, 2])})
    if np.any((places[:, 1::2] < 0) | (places[:, 1::2] > 99)):
        raise BadFileError("it has a degree of freedom that is not one of 0 to 99")
    rows, columns_of = label(places[:, 0], places[:, 1]), label(places[:, 2], places[:, 3])
    return ModelPart(entries={quantity: Entries(rows, columns_of, numbers[:, 4])})


def _listed(rows: NDArray[np.int64], columns: NDArray[np.int64], values: NDArray[np.float64]) -> Any:
    """A sparse matrix from entries whose rows are counted from 1."""
    size = int(max(rows.max(), columns.max()))
    once(rows, columns)
    if min(rows.min(), columns.min()) < 1 or size > min(_LARGEST_ROWS, 40 * rows.size):
        raise BadFileError(f"it has rows up to {size} and {rows.size} entries; rows are counted from 1")
    return mirrored(sparse.coo_matrix((values, (rows - 1, columns - 1)), shape=(size, size)).tocsr())


def _substructure(text: str) -> ModelPart:
    """Lower triangles by rows under ``*MATRIX``; rows by ``*USER ELEMENT`` and the nodes in the comment below it."""
    nodes: list[int] = []
    directions: list[list[str]] = []
    triangles: dict[str, list[str]] = {}
    now, in_nodes = "", False
    for line in text.splitlines():
        bare = re.sub(r"\s", "", line).upper()
        if bare.startswith("**"):
            if in_nodes and re.fullmatch(r"[\d,]+", bare[2:]):
                nodes += [int(word) for word in bare[2:].split(",") if word]
            else:
                in_nodes = bare[2:] == "ELEMENTNODES"
        elif bare.startswith("*"):
            kind = re.match(r"\*MATRIX,TYPE=(\w+)", bare)
            now = _ABAQUS_MATRICES.get(kind[1], "") if kind else "nodes" if bare.startswith("*USERELEMENT") else ""
            if now and now != "nodes" and triangles.setdefault(now, []):
                raise BadFileError(f"it has the {now} twice; write one substructure a file")
        elif now == "nodes" and bare:
            directions.append([word for word in bare.split(",") if word])
        elif now and bare:
            triangles[now].append(line)
    labels = _user_element(nodes, directions)
    matrices = {}
    for name, lines in triangles.items():
        values = number_table("\n".join(lines), 1, f"its {name}")[:, 0]
        n = int((np.sqrt(8.0 * values.size + 1.0) - 1.0) / 2.0)
        if n * (n + 1) // 2 != values.size:
            raise BadFileError(f"its {name} has {values.size} numbers, which is not a triangle; it is cut off")
        if 8 * n * n > LARGEST_ARRAYS:
            raise BadFileError(f"its {name} has {n} rows, more than are read")
        matrix = np.zeros((n, n))
        matrix[np.tril_indices(n)] = values
        matrices[name] = matrix + np.tril(matrix, -1).T
        if labels is not None and n < labels.size:
            raise BadFileError(f"its {name} has {n} rows, and its nodes have {labels.size} degrees of freedom")
    if not matrices:
        raise BadFileError("it has no *MATRIX, TYPE=STIFFNESS or MASS")
    n = max(matrix.shape[0] for matrix in matrices.values())
    if labels is not None and n > labels.size:
        # Behind those of the nodes stand the coordinates of the modes that the substructure keeps.
        labels = np.concatenate([labels, label(-np.arange(1, n - labels.size + 1), 0)])
    return ModelPart(matrices, labels)


def _user_element(nodes: list[int], directions: list[list[str]]) -> Any:
    """Labels of the rows: the first list holds from the first node on, each later one from the node it begins with."""
    if not nodes or not directions:
        return None
    try:
        lists = [[1, *map(int, directions[0])], *([int(word) for word in line] for line in directions[1:])]
    except ValueError as error:
        raise BadFileError("the degrees of freedom under *USER ELEMENT are not whole numbers") from error
    rows = []
    for position, node in enumerate(nodes, start=1):
        active = [each for each in lists if each[0] <= position]
        if any(not 0 <= d < 100 for d in active[-1][1:]):
            raise BadFileError("a degree of freedom under *USER ELEMENT is not one of 0 to 99")
        rows += [(node, d) for d in active[-1][1:]]
    return label([row[0] for row in rows], [row[1] for row in rows])


def read_calculix(path: Path, quantity: str) -> ModelPart:
    """Entries ``row column value`` that CalculiX stores with SOLVER=MATRIXSTORAGE, their rows by the .dof next to it.

    Raises:
        BadFileError: not such a list, or rows beyond those of the .dof file.
        OSError: the file cannot be read.
    """
    numbers = number_table(text_of(path), 3, "a list of entries")
    places = _whole(numbers[:, :2], "a list of entries")
    matrix = _listed(places[:, 0], places[:, 1], numbers[:, 2])
    names = path.with_suffix(".dof")
    if not names.is_file():
        return ModelPart({quantity: matrix})
    labels = read_row_names(names)
    if matrix.shape[0] > labels.size:
        raise BadFileError(f"it has {matrix.shape[0]} rows, and {names.name} names {labels.size}")
    matrix.resize((labels.size, labels.size))
    return ModelPart({quantity: matrix}, labels)


def read_row_names(path: Path) -> Any:
    """Labels of rows from a text: ``node.direction`` on each line, as CalculiX writes .dof, or EXTRN of Nastran.

    Raises:
        BadFileError: another content.
        OSError: the file cannot be read.
    """
    text = text_of(path)
    if is_external(text):
        return external_rows(text)
    words = text.split()
    if not words or any(not re.fullmatch(r"\d{1,12}\.\d{1,2}", word) for word in words):
        raise BadFileError("it needs EXTRN cards or node.direction on each line, as 17.3 for node 17 in z")
    pairs = np.array([[int(part) for part in word.split(".")] for word in words])
    return label(pairs[:, 0], pairs[:, 1])


def is_external(text: str) -> bool:
    """Whether a text has the EXTRN card of an external superelement of Nastran."""
    return re.search(r"^EXTRN[\s*,]", text, re.MULTILINE) is not None


def external_rows(text: str) -> Any:
    """Labels of the rows of an external superelement, in the order of its matrices, from EXTRN.

    Raises:
        BadFileError: cards that are not whole.
    """
    pairs = []
    try:
        for card in _cards(text):
            if card[0] == "EXTRN":
                for node, digits in zip(card[1::2], card[2::2], strict=False):
                    pairs += [(int(node), int(digit)) for digit in digits] if node else []
    except ValueError as error:
        raise BadFileError(f"an EXTRN card is not whole ({error})") from error
    if not pairs:
        raise BadFileError("its EXTRN card names no degrees of freedom")
    return label([pair[0] for pair in pairs], [pair[1] for pair in pairs])


def names_of_neighbour(path: Path) -> ModelPart:
    """Names of rows and nodes that Nastran punched next to an OP4 or OP2 of the same name; empty without them.

    Raises:
        BadFileError: the punched file is not whole.
        OSError: it cannot be read.
    """
    for ending in (".pch", ".asm"):
        punched = path.with_suffix(ending)
        if punched.is_file() and is_external(text := text_of(punched)):
            return ModelPart(labels=external_rows(text), nodes=_grids(_cards(text)))
    return ModelPart()


def read_nodes(path: Path) -> ModelPart:
    """Numbers and coordinates of nodes: ``*NODE`` of Abaqus or CalculiX, GRID cards of Nastran, or node,x,y,z a line.

    Raises:
        BadFileError: none of them.
        OSError: the file cannot be read.
    """
    text = text_of(path)
    if re.search(r"^GRID[\s*,]", text, re.MULTILINE):
        return ModelPart(nodes=_grids(_cards(text)))
    _refuse_includes(text)
    lines = text.splitlines()
    inside = not any(line.lstrip().startswith("*") for line in lines)
    rows = []
    for line in lines:
        bare = line.strip()
        if bare.startswith("*") and not bare.startswith("**"):
            inside = bool(re.fullmatch(r"\*NODE(,.*)?", bare.replace(" ", ""), re.IGNORECASE))
        elif inside and bare[:1].isdigit():
            rows.append(",".join(re.split(r"[\s,]+", bare)[:4]))
    if not rows:
        raise BadFileError("it has no nodes: *NODE, GRID cards, or node,x,y,z on each line")
    table = number_table("\n".join(rows), 4, "its list of nodes")
    _whole(table[:, 0], "its list of nodes")
    return ModelPart(nodes=table)


def _refuse_includes(text: str) -> None:
    """Refuse a text of Abaqus or CalculiX part of which stands in another file."""
    if elsewhere := re.search(rf"^{_INCLUDE.pattern}", text, re.MULTILINE | re.IGNORECASE):
        raise BadFileError(f"it includes {elsewhere[1].strip()}, which is not read; put its lines into one file")


def _cards(text: str) -> Iterator[list[str]]:
    """Cards of a bulk data deck as fields: name, then 4 a line in the large form and 8 in the small or free one.

    Raises:
        BadFileError: cards that stand in another file.
    """
    card: list[str] = []
    for raw in text.splitlines():
        if elsewhere := _INCLUDE.match(raw):
            raise BadFileError(f"it includes {elsewhere[1].strip()}, which is not read; put its cards into one file")
        line = raw.split("$", 1)[0].rstrip().expandtabs(8)
        if not line:
            continue
        if "," in line:
            head, *fields = (word.strip() for word in line.split(","))
            count = 4 if head.startswith("*") or head.endswith("*") else 8
        else:
            head = line[:8].strip()
            # A star before the name of a continuation, or behind that of a card, is the large form.
            width, count = (16, 4) if head.startswith("*") or head.endswith("*") else (8, 8)
            fields = [line[start : start + width].strip() for start in range(8, 8 + width * count, width)]
        fields = (fields + [""] * count)[:count]
        if head[:1] in ("", "*", "+"):
            card += fields
            continue
        if card:
            yield card
        card = [head.rstrip("*").strip().upper(), *fields]
    if card:
        yield card


def _real(word: str) -> float:
    """A real number of Nastran: 1.5, 1.5D+3 or 1.5+3.

    Raises:
        ValueError: another word, or a number that is not finite.
    """
    try:
        value = float(word)
    except ValueError:
        value = float(_BARE_EXPONENT.sub(r"E\1", word.upper().replace("D", "E")))
    if not math.isfinite(value):
        raise ValueError(f"{word} is not a finite number")
    return value


def _grids(cards: Iterator[list[str]]) -> NDArray[np.float64]:
    """Nodes of GRID cards whose coordinates are in the basic system."""
    try:
        rows = [
            [int(card[1]), *(_real(word) if word else 0.0 for word in card[3:6])]
            for card in cards
            if card[0] == "GRID" and card[2] in ("", "0")
        ]
    except ValueError as error:
        raise BadFileError(f"a GRID card has something that is not a number ({error})") from error
    if any(abs(row[0]) > 10**12 for row in rows):
        raise BadFileError("a GRID card has a number of a node beyond 10¹²")
    return np.array(rows, dtype=float).reshape(-1, 4)


def read_dmig(path: Path) -> ModelPart:
    """Matrices of DMIG cards, as Nastran punches a superelement, with the coordinates of GRID cards next to them.

    Raises:
        BadFileError: no real square matrix named K…, M…, B… or C…, several of one kind, or cards that are not whole.
        OSError: the file cannot be read.
    """
    cards = list(_cards(text_of(path)))
    found: dict[str, tuple[list[int], list[int], list[float]]] = {}
    forms: dict[str, int] = {}
    try:
        for card in cards:
            if card[0] != "DMIG":
                continue
            if card[2] == "0":
                if card[1] in forms:
                    raise BadFileError(
                        f"the heading of {card[1]} comes twice, as in a file that two runs were punched into; keep one"
                    )
                forms[card[1]] = int(card[3]) if card[4] in ("1", "2") else 0
                continue
            rows, columns, values = found.setdefault(card[1], ([], [], []))
            column = int(card[2]) * 100 + int(card[3] or 0)
            for start in range(5, len(card), 4):
                node, direction, value = card[start : start + 3]
                if node:
                    rows.append(int(node) * 100 + int(direction or 0))
                    columns.append(column)
                    values.append(_real(value))
    except (ValueError, IndexError) as error:
        raise (
            error if isinstance(error, BadFileError) else BadFileError(f"a DMIG card is not whole ({error})")
        ) from error
    binaries = [path.with_suffix(ending) for ending in (".op4", ".op2")]
    if not found and (names := [binary.name for binary in binaries if binary.is_file()]):
        raise BadFileError(f"it has no square matrix; {names[0]} next to it may have them")
    # 1 and 6 are square and symmetric forms; rectangular and complex ones are loads and gains.
    chosen = matrix_names([name for name in found if forms.get(name, 0) in (1, 6)])
    if any(not -(10**14) < row < 10**14 for name in chosen.values() for rows in found[name][:2] for row in rows):
        raise BadFileError("a DMIG card names a node that is not a node")
    entries = {}
    for quantity, name in chosen.items():
        entry_rows, entry_columns, entry_values = found[name]
        entries[quantity] = Entries(
            np.array(entry_rows, np.int64), np.array(entry_columns, np.int64), np.array(entry_values)
        )
    return ModelPart(entries=entries, nodes=_grids(iter(cards)))


def matrix_names(names: Sequence[str]) -> dict[str, str]:
    """Which of Nastran's matrices is stiffness, mass and viscous damping, by its name.

    The sets of degrees of freedom follow the letter: KXX and MXX of an external superelement, KAAX and MAAX, KAA, KGG.

    Raises:
        BadFileError: none, or several that could be one quantity.
    """
    for sets in ("", "XX", "AAX", "AA", "2GG", "2PP", "GG", "FF", "LL"):
        chosen = {q: n for q, n in ((q, _named(names, q, sets)) for q in _LETTERS_OF) if n}
        if {"stiffness", "mass"} <= chosen.keys():
            break
    else:
        chosen = {}
        for quantity, letters in _LETTERS_OF.items():
            fitting = [name for name in names if name[:1].upper() in letters and not _is_structural(name, names)]
            if len(set(fitting)) > 1:
                raise BadFileError(
                    f"{' and '.join(sorted(fitting)[:4])} could each be the {quantity}; keep one of them"
                )
            if fitting:
                chosen[quantity] = fitting[0]
    if not chosen:
        raise BadFileError(f"it has none of K…, M…, B…; it has {', '.join(sorted(names)[:9]) or 'no square matrix'}")
    for quantity, name in chosen.items():
        if list(names).count(name) > 1:
            raise BadFileError(
                f"it has {name} {list(names).count(name)} times, of several superelements; keep one {quantity}"
            )
    return chosen


def _is_structural(name: str, names: Sequence[str]) -> bool:
    """Whether a name is that of structural damping, as K4XX; K40, and K4 next to M4, are a stiffness with a number."""
    upper = name.upper()
    return bool(re.match(r"K4(?!\d)", upper)) and f"M{upper[1:]}" not in {each.upper() for each in names}


def _named(names: Sequence[str], quantity: str, sets: str) -> str:
    return next((name for name in names for first in _LETTERS_OF[quantity] if name.upper() == first + sets), "")
