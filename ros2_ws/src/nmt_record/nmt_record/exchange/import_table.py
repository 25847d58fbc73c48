"""Columns of numbers from CSV, NPZ, MATLAB, HDF5, UFF, LVM and TDMS files: what is not certain is refused by line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.files.hardened import open_regular
from nmt_core.files.mat_file import MAT5, is_hdf5
from nmt_core.files.universal_file import is_universal_file
from nmt_record.exchange.arrays.array_table import read_mat_table, read_npz
from nmt_record.exchange.arrays.uff_table import read_uff_table
from nmt_record.exchange.arrays.vendor_table import read_lvm, read_tdms
from nmt_record.exchange.clocks.time_columns import clocks_joined
from nmt_record.exchange.source_table import SourceTable
from nmt_record.exchange.text.text_table import read_text_table

LARGEST_DATA = 2**29  # bytes of a file of columns

_SUFFIXES = {
    ".csv": "csv", ".txt": "csv", ".tsv": "csv", ".dat": "csv", ".asc": "csv",
    ".npz": "npz",
    ".mat": "mat", ".h5": "mat", ".hdf5": "mat",
    ".lvm": "lvm", ".tdms": "tdms",
    ".uff": "uff", ".unv": "uff", ".uf": "uff", ".ufb": "uff", ".58": "uff",
}  # fmt: skip
_FOREIGN = (
    (b"PK\x03\x04", "a zip archive or spreadsheet", "save the table as CSV"),
    (b"\xd0\xcf\x11\xe0", "an old spreadsheet", "save the table as CSV"),
    (b"\x93NUMPY", "a single NumPy array", "save the columns with numpy.savez"),
    (b"\x1f\x8b", "a gzip archive", "unpack it"),
    (b"%PDF", "a PDF", "save the table as CSV"),
    (b"MDF     ", "an MDF file", "export it with asammdf as .mat or .csv, one channel group with a raster a file"),
    (b"|CF,2", "a FAMOS file of imc", "export it as text, MATLAB or UFF58"),
)


def read_table(path: Path, wanted: Sequence[str | int] = (), time: str | int | None = None) -> SourceTable:
    """Read a file of columns by the kind that its name and first bytes say.

    Args:
        path: the file.
        wanted: names of columns that are needed: of a MATLAB or HDF5 file, which may hold arrays of many lengths, those
            as long as they are read; without any, those of the largest set.
        time: the column that the sidecar calls the time.

    Raises:
        BenchError: not there, of another kind, or malformed.
    """
    from nmt_record.exchange.messages.ros_bag_table import is_bag, read_bag  # a bag reader, where the file is one

    if is_bag(path):
        return read_bag(path, wanted)
    kind = kind_of(path)
    readers = {"csv": read_text_table, "npz": read_npz, "uff": read_uff_table, "lvm": read_lvm, "tdms": read_tdms}
    table = read_mat_table(path, wanted) if kind == "mat" else readers[kind](path)
    return clocks_joined(table, time)


def kind_of(path: Path) -> str:
    """``csv``, ``npz``, ``mat`` (HDF5 too), ``uff``, ``lvm`` or ``tdms``.

    Raises:
        BenchError: not there, empty, or a file of another kind.
    """
    try:
        if path.is_dir():
            raise BenchError(f"{path} is a folder; name the file with the data.")
        with open_regular(path, "data file", LARGEST_DATA) as file:
            head = file.read(520)
    except OSError as error:
        raise BenchError(f"The data file {path} cannot be read: {(error.strerror or str(error)).lower()}.") from error
    if not head.strip():
        raise BenchError(f"{path.name} is empty; name the file with the data.")
    kind = _SUFFIXES.get(path.suffix.lower(), "")
    for magic, what, fix in _FOREIGN:
        if head.startswith(magic) and not (magic == b"PK\x03\x04" and kind == "npz"):
            raise BenchError(f"{path.name} is {what}; {fix}.")
    if is_universal_file(head):
        kind = "uff"
    elif is_hdf5(head) or head.startswith(MAT5):
        kind = "mat"
    elif head.startswith(b"TDSm"):
        kind = "tdms"
    elif head.startswith(b"LabVIEW Measurement"):
        kind = "lvm"
    elif kind == "lvm":
        kind = "csv"  # without a header it is a table
    elif not kind or (kind == "npz" and not head.startswith(b"PK")) or kind in ("uff", "mat", "tdms"):
        wanted = {
            "npz": "an NPZ file (numpy.savez)",
            "uff": "a universal file (it does not begin with '    -1')",
            "tdms": "a TDMS file",
            "mat": "a MATLAB file of version 5 or later, nor HDF5 (save it with 'save -v7')",
        }
        what = f"is not {wanted[kind]}" if kind else f"has the unknown ending '{path.suffix}'"
        raise BenchError(f"{path.name} {what}; import csv, txt, npz, mat, h5, uff, lvm or tdms.")
    return kind
