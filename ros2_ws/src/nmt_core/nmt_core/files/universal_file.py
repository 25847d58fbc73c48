"""Universal files: the data sets between two lines of ``    -1``, whatever they hold; ASCII, and the binary 58b.

Layout after the UC-SDRL text of datasets 58 and 58b. What a data set says is read by whoever knows its kind.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from nmt_core.errors import BenchError

HEADER_RECORDS = 11
"""Records of a data set 58 before its values."""
DELIMITER = b"    -1"
_LINE_END = re.compile(rb"\r\n|\n|\r")
_CLOSING = re.compile(rb"(?:(?<=\n)|(?<=\r))    -1[ \t]*(?:\r\n|\n|\r|\Z)")


@dataclass(frozen=True)
class Dataset:
    """One data set.

    Attributes:
        number: position in the file, from 1.
        kind: its number by the format: 15, 55, 58, …
        binary: whether its values are (58b).
        identifier: the record with its kind.
        records: header records of a data set 58; none of others.
        payload: what follows up to the closing line.
    """

    number: int
    kind: int
    binary: bool
    identifier: str
    records: list[str]
    payload: bytes

    @property
    def lines(self) -> list[str]:
        """Lines of an ASCII payload."""
        return self.payload.decode("latin-1").splitlines()


class _Cursor:
    """Lines of a file that may hold binary stretches; knows LF, CR LF and CR."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.position = 0

    def at_end(self) -> bool:
        return self.position >= len(self.data)

    def line(self) -> bytes:
        end = _LINE_END.search(self.data, self.position)
        line = self.data[self.position : end.start() if end else len(self.data)]
        self.position = end.end() if end else len(self.data) + 1
        return line


def _is_delimiter(line: bytes) -> bool:
    return line.startswith(DELIMITER) and not line[6:].strip()


def datasets(data: bytes, name: str) -> Iterator[Dataset]:
    """The data sets of a file, in its order; line ends may be LF, CR LF or CR.

    Args:
        data: content of the file.
        name: of the file, for sentences.

    Raises:
        BenchError: not a universal file, or a data set that is cut off.
    """
    cursor = _Cursor(data)
    number = 0
    while not cursor.at_end():
        line = cursor.line()
        if not line.strip():
            continue
        if not _is_delimiter(line):
            what = "text stands between its datasets" if number else "it does not begin with '    -1'"
            raise BenchError(f"{name} is not a universal file: {what}.")
        if cursor.at_end():
            return
        identifier = cursor.line().decode("ascii", "replace")
        number += 1
        where = f"Dataset {number} of {name}"
        try:
            kind = int(identifier[:6])
        except ValueError:
            raise BenchError(f"{where} has no number in columns 1 to 6; the file is not a universal file.") from None
        binary = identifier[6:7].lower() == "b"
        records: list[str] = []
        if binary:
            try:
                ascii_lines, size = int(identifier[19:31]), int(identifier[31:43])
            except ValueError:
                raise BenchError(f"{where} has no line and byte counts in its first record (58b).") from None
            records = [cursor.line().decode("ascii", "replace") for _ in range(min(max(ascii_lines, 0), 100))]
            size = _true_size(records, size, memoryview(data)[cursor.position :])
            payload = data[cursor.position : cursor.position + size]
            cursor.position += size
            if len(payload) < size or cursor.at_end():
                raise BenchError(
                    f"{where} is cut off: {len(payload)} of {size} bytes are there; copy or export the file again."
                )
            end = cursor.line()
            if not _is_delimiter(end if end else cursor.line()):
                raise BenchError(f"{where} does not end after its {size} bytes; the file is damaged, export it again.")
        else:
            payload, ended = _ascii_part(cursor, records, kind)
            if not ended:
                raise BenchError(f"{where} is cut off: its closing '-1' is missing; copy or export the file again.")
        yield Dataset(number, kind, binary, identifier, records, payload)
    if not number:
        raise BenchError(f"{name} is empty; a universal file is needed.")


def _true_size(records: list[str], stated: int, rest: memoryview) -> int:
    """Bytes of the values by their type and count; some writers state others, or write the abscissa in double "
    "precision."""
    try:
        kind, count, even = (int(records[6][at : at + 10]) for at in (0, 10, 20))
    except (IndexError, ValueError):
        return max(stated, 0)
    ordinate = {2: 4, 4: 8, 5: 8, 6: 16}.get(kind, 0) * max(count, 0)
    sizes = [ordinate] if even else [ordinate + 4 * count, ordinate + 8 * count]
    return next(
        (size for size in sizes if bytes(rest[size : size + 8]).lstrip(b"\r\n").startswith(DELIMITER)), sizes[0]
    )


def _ascii_part(cursor: _Cursor, records: list[str], kind: int) -> tuple[bytes, bool]:
    wanted = HEADER_RECORDS if kind == 58 else 0
    while len(records) < wanted and not cursor.at_end():
        line = cursor.line()
        if _is_delimiter(line):
            return b"", True
        records.append(line.decode("ascii", "replace"))
    start = cursor.position
    end = _CLOSING.search(cursor.data, max(0, start - 1))
    if end is None:
        cursor.position = len(cursor.data)
        return cursor.data[start:], False
    cursor.position = end.end()
    return cursor.data[start : max(start, end.start())], True


def is_universal_file(head: bytes) -> bool:
    """Whether a file that begins with these bytes may be a universal file."""
    return any(_is_delimiter(line) for line in head.replace(b"\r", b"\n").split(b"\n")[:3])
