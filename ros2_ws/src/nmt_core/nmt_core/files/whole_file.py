"""Files that are whole or not there."""

from __future__ import annotations

import csv
import io
import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from nmt_core.errors import BenchError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Say which file cannot be written, and why.

    Raises:
        BenchError: in place of an OSError.
    """
    try:
        yield
    except OSError as error:
        raise BenchError(f"{path} cannot be written: {error.strerror or error}.") from error


def umask() -> int:
    """The rights that new files of this process do not get."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Rows as CSV with a line feed behind each."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def write_result(path: Path, text: str) -> None:
    """Write a file of results by `write_whole`.

    Raises:
        BenchError: it cannot be written; an older file is then left as it was.
    """
    try:
        write_whole(path, text)
    except OSError as error:
        raise BenchError(f"{path} cannot be written: {error.strerror}; check the folder and the free space.") from error


def write_whole(path: Path, text: str) -> None:
    """Write a text file completely or not at all; a file of that name stays as it was until the new one is whole.

    Args:
        path: the file; its folder must exist.
        text: written as UTF-8 without translating line ends.

    Raises:
        OSError: the folder cannot be written or is full; nothing is left behind.
    """
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o666 & ~umask())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
