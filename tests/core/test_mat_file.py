"""MATLAB files against scipy's and h5py's writers, and files that want to harm."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.io import savemat
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.files import mat_child
from nmt_core.files.mat_file import read_mat

DRAW = np.random.default_rng(3)
CONTENT = {
    "force": DRAW.standard_normal((50, 1)),
    "counts": np.arange(-3, 9, dtype=np.int16).reshape(3, 4),
    "frf": DRAW.standard_normal(6) + 1j * DRAW.standard_normal(6),
    "title": "a text",
    "test": {"fs": 2048.0, "channel": {"a1": DRAW.standard_normal(40).astype(np.float32)}},
}


@pytest.mark.parametrize("compressed", [False, True])
def test_numbers_of_structs_are_named_by_their_path(tmp_path: Path, compressed: bool) -> None:
    path = tmp_path / "run.mat"
    savemat(path, CONTENT, do_compression=compressed)
    found = read_mat(path, "data file")
    assert set(found) == {"force", "counts", "frf", "test.fs", "test.channel.a1"}
    np.testing.assert_array_equal(found["force"], CONTENT["force"])
    np.testing.assert_array_equal(found["counts"], CONTENT["counts"])
    np.testing.assert_array_equal(found["frf"].ravel(), CONTENT["frf"])
    np.testing.assert_array_equal(found["test.channel.a1"].ravel(), CONTENT["test"]["channel"]["a1"])
    assert found["test.fs"].item() == 2048.0


def test_elements_of_a_struct_array_are_numbered(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    runs = np.zeros((1, 2), dtype=[("x", object)])
    runs["x"][0, 0], runs["x"][0, 1] = np.arange(3.0), np.arange(4.0)
    savemat(path, {"runs": runs})
    found = read_mat(path, "data file")
    assert {key: value.size for key, value in found.items()} == {"runs.1.x": 3, "runs.2.x": 4}


def hdf5(path: Path) -> Path:
    """As MATLAB writes version 7.3: columns are rows, complex numbers a pair, structs groups."""
    with h5py.File(path, "w", userblock_size=512) as file:
        matrix = file.create_dataset("force", data=np.arange(12.0).reshape(2, 6), compression="gzip")
        matrix.attrs["MATLAB_class"] = np.bytes_("double")
        pair = np.zeros(5, dtype=[("real", "f8"), ("imag", "f8")])
        pair["real"], pair["imag"] = np.arange(5.0), -1.0
        file.create_dataset("test/frf", data=pair).attrs["MATLAB_class"] = np.bytes_("double")
        text = file.create_dataset("title", data=np.array([97, 98], dtype=np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset("#refs#/a", data=np.arange(3.0))
        file["elsewhere"] = h5py.ExternalLink("/etc/passwd", "/x")
        file["alias"] = h5py.SoftLink("/force")
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return path


def test_version_7_3_is_read_as_matlab_shows_it(tmp_path: Path) -> None:
    found = read_mat(hdf5(tmp_path / "run.mat"), "data file")
    assert set(found) == {"force", "test.frf"}
    np.testing.assert_array_equal(found["force"], np.arange(12.0).reshape(2, 6).T)
    np.testing.assert_array_equal(found["test.frf"], np.arange(5.0) - 1j)


def test_what_lies_in_other_files_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "secret.bin").write_bytes(b"\1" * 64)
    with h5py.File(tmp_path / "out.h5", "w") as file:
        file.create_dataset("x", (8,), "f8", external=[(str(tmp_path / "secret.bin"), 0, 64)])
    layout = h5py.VirtualLayout((4,), "f8")
    layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", (4,))
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        file.create_virtual_dataset("x", layout)
    for name in ("out.h5", "virtual.h5"):
        with pytest.raises(BenchError, match="another file"):
            read_mat(tmp_path / name, "data file")


def test_claims_are_weighed_before_memory_is_taken(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "large.h5", "w") as file:
        file.create_dataset("x", (2**40,), "f8", chunks=(2**16,))
    with pytest.raises(BenchError, match="more than the"):
        read_mat(tmp_path / "large.h5", "data file")
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    bomb = zlib.compress(bytes(2**22), 9)
    (tmp_path / "bomb.mat").write_bytes(header + struct.pack("<II", 15, len(bomb)) + bomb)
    with pytest.raises(BenchError, match="cut off or damaged"):
        read_mat(tmp_path / "bomb.mat", "data file", largest=2**20)
    for content in ({"x": np.zeros(2**19)}, {"s": {"x": np.zeros(2**19)}}, {"x": {"y": np.zeros(2**23, dtype="u1")}}):
        savemat(tmp_path / "bomb.mat", content, do_compression=True)
        with pytest.raises(BenchError, match="more than the"):
            read_mat(tmp_path / "bomb.mat", "data file", largest=2**20)
    # A matrix of 2³¹ − 1 squared numbers in forty bytes.
    body = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, 2**31 - 1, 2**31 - 1)
    body += struct.pack("<IHH", 1 << 16 | 1, 0x78, 0)[:8] + struct.pack("<II", 9, 0)
    (tmp_path / "claim.mat").write_bytes(header + struct.pack("<II", 14, len(body)) + body)
    with pytest.raises(BenchError):
        read_mat(tmp_path / "claim.mat", "data file")


def test_chunks_and_references_are_weighed_as_they_are_unpacked(tmp_path: Path) -> None:
    """Kilobytes of which one number takes a gigabyte to read, or each reference an object."""
    with h5py.File(tmp_path / "chunk.mat", "w") as file:
        few = file.create_dataset("K", (8,), "f8", chunks=(2**18,), maxshape=(None,), compression="gzip")
        few[:] = 1.0
    with pytest.raises(BenchError, match="more than the 1 MiB"):
        read_mat(tmp_path / "chunk.mat", "data file", largest=2**20)
    assert read_mat(tmp_path / "chunk.mat", "data file", largest=2**21)["K"].tolist() == [1.0] * 8
    with h5py.File(tmp_path / "long.mat", "w") as file:
        file.create_dataset("K", (2**17,), "longdouble", chunks=(2**10,), compression="gzip")
    with pytest.raises(BenchError, match="more than the 1 MiB"):
        read_mat(tmp_path / "long.mat", "data file", largest=2**20)
    with h5py.File(tmp_path / "cells.mat", "w") as file:
        file["a"] = np.zeros(2)
        file.create_dataset("K", (2**16,), h5py.ref_dtype, chunks=(2**10,), compression="gzip")[0] = file["a"].ref
    with pytest.raises(BenchError, match="too many entries"):
        read_mat(tmp_path / "cells.mat", "data file")


@pytest.mark.parametrize("seed", with_quick(range(8), 0))
def test_sparse_matrices_of_version_7_3_are_those_of_version_5(tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    density = 0.0 if seed == 0 else 0.3
    matrix = sparse.random(*random.integers(1, 30, 2), density, "csc", random_state=seed)
    savemat(tmp_path / "five.mat", {"K": matrix})
    with h5py.File(tmp_path / "seven.mat", "w", userblock_size=512) as file:
        group = file.create_group("K")
        group.attrs["MATLAB_class"], group.attrs["MATLAB_sparse"] = np.bytes_("double"), np.uint64(matrix.shape[0])
        if matrix.nnz:  # MATLAB leaves the others out
            group["data"], group["ir"] = matrix.data, matrix.indices.astype("u8")
        group["jc"] = matrix.indptr.astype("u8")
    with open(tmp_path / "seven.mat", "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    five, seven = (read_mat(tmp_path / f"{name}.mat", "matrix file") for name in ("five", "seven"))
    assert five.keys() == seven.keys()
    for name, values in five.items():
        np.testing.assert_array_equal(values, seven[name])


@pytest.mark.parametrize(("key", "values"), [("jc", [0, 5]), ("ir", [7, 0]), ("ir", [0]), ("jc", [0, 2, 1, 2])])
def test_a_sparse_matrix_that_points_outside_itself_is_refused(tmp_path: Path, key: str, values: list[int]) -> None:
    parts = {"data": [1.0, 2.0], "ir": [0, 1], "jc": [0, 1, 2]} | {key: values}
    with h5py.File(tmp_path / "seven.mat", "w") as file:
        group = file.create_group("K")
        group.attrs["MATLAB_sparse"] = np.uint64(2)
        for name, part in parts.items():
            group[name] = np.array(part, dtype="f8" if name == "data" else "u8")
    with pytest.raises(BenchError, match="sparse matrix /K points outside itself"):
        read_mat(tmp_path / "seven.mat", "matrix file")


def test_a_process_with_limits_of_its_own_reads(tmp_path: Path) -> None:
    savemat(tmp_path / "run.mat", CONTENT)
    words = ["bash", "-c", 'ulimit -v 4000000 -t 60; exec "$0" -m "$1" 1048576 120', sys.executable, mat_child.__name__]
    with (tmp_path / "run.mat").open("rb") as file:
        read = subprocess.run(words, stdin=file, capture_output=True, env={"PYTHONPATH": os.pathsep.join(sys.path)})
    assert read.returncode == 0, read.stderr
    assert read.stdout.startswith(b"PK")


def test_nesting_has_an_end(tmp_path: Path) -> None:
    nested: dict[str, object] = {"x": 1.0}
    for _ in range(30):
        nested = {"s": nested}
    savemat(tmp_path / "deep.mat", nested)
    with pytest.raises(BenchError, match="nested too deeply"):
        read_mat(tmp_path / "deep.mat", "data file")
    with h5py.File(tmp_path / "deep.h5", "w") as file:
        group = file
        for _ in range(30):
            group = group.create_group("g")
        group["again"] = file["/"]
    with pytest.raises(BenchError, match="nested too deeply"):
        read_mat(tmp_path / "deep.h5", "data file")


def test_only_regular_files_of_the_kind_are_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mat")
    (tmp_path / "text.mat").write_text("1, 2, 3\n")
    (tmp_path / "cut.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(40))
    for name, words in (("pipe.mat", "pipe or a device"), ("text.mat", "save -v7"), ("cut.h5", "cut off or damaged")):
        with pytest.raises(BenchError, match=words):
            read_mat(tmp_path / name, "data file")


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.integers(0, 255), st.booleans())
def test_a_file_with_any_byte_changed_or_cut_is_read_or_refused(place: int, value: int, cut: bool) -> None:
    path = _FOLDER / "changed.mat"
    path.write_bytes(_changed(place, value, cut))
    try:
        found = read_mat(path, "data file")
    except BenchError:
        return
    assert all(array.nbytes <= 2**20 for array in found.values())


@pytest.mark.parametrize("place", [648, 728, 784, 897])
def test_a_file_that_kills_its_reader_is_damaged(place: int) -> None:
    """scipy's reader ends at these changes with a segmentation fault."""
    path = _FOLDER / "changed.mat"
    path.write_bytes(_changed(place, 255, False))
    with pytest.raises(BenchError, match="cut off or damaged"):
        read_mat(path, "data file")


def _changed(place: int, value: int, cut: bool) -> bytes:
    data = bytearray(_EXAMPLE)
    data[place % len(data)] = value
    return bytes(data[: place % len(data)] if cut else data)


@pytest.fixture(scope="module", autouse=True)
def _example(tmp_path_factory: pytest.TempPathFactory) -> None:
    global _EXAMPLE, _FOLDER
    _FOLDER = tmp_path_factory.mktemp("mat")
    savemat(_FOLDER / "own.mat", CONTENT)
    _EXAMPLE = (_FOLDER / "own.mat").read_bytes()


_EXAMPLE, _FOLDER = b"", Path()
