"""Matrix files whose headings or indices claim what is not there, and files with changed bytes."""

from __future__ import annotations

import io as bytes_io
import zipfile

import numpy as np
import pytest
from scipy import io, sparse

from nmt_core.errors import BenchError
from nmt_rig.file_errors import BadFileError
from nmt_rig.matrix_files import read_matrices, read_matrix

PLATE = sparse.diags([-1.0, 4.0, -1.0], [-1, 0, 1], shape=(9, 9)).tocsr()


def parts(**changed):
    return {
        "data": PLATE.data, "indices": PLATE.indices, "indptr": PLATE.indptr, "shape": np.array(PLATE.shape),
        "format": np.array(b"csr"),
    } | changed  # fmt: skip


def replaced(array, place, value):
    array = array.astype(np.int64)
    array[place] = value
    return array


LIARS = {
    "a column of 10⁹": parts(indices=replaced(PLATE.indices, 3, 10**9)),
    "a column of −1": parts(indices=replaced(PLATE.indices, 3, -1)),
    "a row that begins at 10¹²": parts(indptr=replaced(PLATE.indptr, 4, 10**12)),
    "an end at 10¹²": parts(indptr=replaced(PLATE.indptr, -1, 10**12)),
    "rows that go back": parts(indptr=replaced(PLATE.indptr, 4, 1)),
    "a shape of 10⁹ by 10⁹": parts(shape=np.array([10**9, 10**9])),
    "a shape of 9 by 10¹²": parts(shape=np.array([9, 10**12])),
    "a shape of three": parts(shape=np.array([9, 9, 9])),
    "a negative shape": parts(shape=np.array([-9, 9])),
    "fractions as indices": parts(indices=PLATE.indices.astype(float)),
    "complex entries": parts(data=PLATE.data.astype(complex)),
    "fewer entries": parts(data=PLATE.data[:-1]),
    "a table of entries": parts(data=PLATE.data.reshape(1, -1)),
    "blocks": parts(format=np.array(b"bsr")),
    "two formats": parts(format=np.array([b"csr", b"csc"])),
}


@pytest.mark.parametrize("content", LIARS.values(), ids=LIARS)
def test_a_sparse_matrix_whose_parts_do_not_fit_is_refused(tmp_path, content):
    np.savez(tmp_path / "k.npz", **content)
    with pytest.raises(BadFileError):
        read_matrix(tmp_path / "k.npz")
    if "format" in content and content["format"].size == 1 and content["format"].item() == b"csr":
        np.savez(tmp_path / "all.npz", **{f"K_{name}": part for name, part in content.items()})
        with pytest.raises(BadFileError):
            read_matrices(tmp_path / "all.npz")


@pytest.mark.parametrize("columns", [False, True])
def test_what_fits_is_read(tmp_path, columns):
    matrix = (PLATE + sparse.coo_matrix(([3.0], ([0], [8])), shape=(9, 9))).tocsr()
    sparse.save_npz(tmp_path / "k.npz", matrix.tocsc() if columns else matrix)
    np.testing.assert_array_equal(read_matrix(tmp_path / "k.npz").toarray(), matrix.toarray())


@pytest.mark.parametrize(
    "text",
    [
        "%%MatrixMarket matrix coordinate real general\n1000000000 1000000000 1\n1 1 1\n",
        "%%MatrixMarket matrix coordinate real symmetric\n3 3 1000000000\n1 1 1\n",
        "%%MatrixMarket matrix array real general\n100000 100000\n1\n",
        "%%MatrixMarket matrix array real symmetric\n100000 100000\n1\n",
        "%%MatrixMarket matrix coordinate complex general\n1 1 1\n1 1 1 1\n",
        "%%MatrixMarket matrix coordinate real general\n-1 2 1\n1 1 1\n",
        "%%MatrixMarket matrix coordinate real general\n2 2 1\n7 1 1\n",
        "%%MatrixMarket matrix coordinate real general\n",
        "%%MatrixMarket vector coordinate real general\n3 1\n1 1\n",
        "%" * 4000, "", "\n" * 50,
    ],
)  # fmt: skip
def test_a_matrix_market_file_is_weighed_before_it_is_read(tmp_path, text):
    (tmp_path / "k.mtx").write_text(text)
    with pytest.raises(BadFileError):
        read_matrix(tmp_path / "k.mtx")


def test_an_array_larger_than_its_file_is_refused(tmp_path):
    head = bytes_io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (50_000, 50_000)})
    (tmp_path / "k.npy").write_bytes(head.getvalue() + bytes(80))
    with pytest.raises(BadFileError, match="claims 20000000000 bytes and has 80"):
        read_matrix(tmp_path / "k.npy")
    with zipfile.ZipFile(tmp_path / "k.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("K.npy", (tmp_path / "k.npy").read_bytes())
    with pytest.raises(BadFileError):
        read_matrices(tmp_path / "k.npz")


def test_zeros_that_unpack_to_more_than_is_read_are_refused(tmp_path):
    head = bytes_io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (9000, 9000)})
    with (
        zipfile.ZipFile(tmp_path / "k.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("K.npy", "w", force_zip64=True) as entry,
    ):
        entry.write(head.getvalue())
        for _ in range(9000):
            entry.write(bytes(9000 * 8))
    assert (tmp_path / "k.npz").stat().st_size < 2**20
    with pytest.raises(BadFileError, match="more than the 512 MiB"):
        read_matrices(tmp_path / "k.npz")


def written(folder):
    """Files of each form with one small matrix."""
    sparse.save_npz(folder / "sparse.npz", PLATE)
    np.savez(folder / "dense.npz", M=PLATE.toarray(), K=PLATE.toarray())
    np.save(folder / "one.npy", PLATE.toarray())
    io.mmwrite(folder / "one.mtx", PLATE.tocoo(), symmetry="symmetric")
    io.mmwrite(folder / "array.mtx", PLATE.toarray())
    return {"sparse.npz": read_matrix, "dense.npz": read_matrices, "one.npy": read_matrix, "one.mtx": read_matrix,
            "array.mtx": read_matrix}  # fmt: skip


def mutated(content, random):
    """The bytes of a file with some changed, removed, doubled or cut off."""
    content = bytearray(content)
    for _ in range(random.integers(1, 6)):
        place = int(random.integers(len(content)))
        kind = random.integers(5)
        if kind == 0:
            content[place] = int(random.integers(256))
        elif kind == 1:
            del content[place : place + int(random.integers(1, 30))]
        elif kind == 2:
            content[place:place] = content[place : place + int(random.integers(1, 30))]
        elif kind == 3:
            content[place : place + 1] = str(random.integers(10**12)).encode()
        else:
            del content[max(place, 20) :]
        if not content:
            break
    return bytes(content)


@pytest.mark.parametrize("seed", range(5))
def test_changed_bytes_are_a_matrix_or_a_sentence(tmp_path, seed):
    random = np.random.default_rng(seed)
    for name, read in written(tmp_path).items():
        content = (tmp_path / name).read_bytes()
        for _ in range(40):
            (tmp_path / name).write_bytes(mutated(content, random))
            try:
                found = read(tmp_path / name)
            except (BadFileError, BenchError):
                continue
            for matrix in found.values() if isinstance(found, dict) else [found]:
                if sparse.issparse(matrix):
                    (matrix + matrix.T) @ np.ones(matrix.shape[0]) if matrix.shape[0] == matrix.shape[1] else None


@pytest.mark.parametrize("end", ["t", "e", "e+", "-", "E-", "nan", "0x", "\n3 3"])
def test_a_last_line_that_is_no_number_is_refused(tmp_path, end):
    """SciPy's reader reads past the end of the file there, or leaves the rest of the line out."""
    (tmp_path / "k.mtx").write_text(f"%%MatrixMarket matrix coordinate real symmetric\n%\n2 2 2\n1 1 4\n2 2 4{end}")
    with pytest.raises(BadFileError):
        read_matrix(tmp_path / "k.mtx")


def test_a_last_line_without_its_end_is_read(tmp_path):
    (tmp_path / "k.mtx").write_text("%%MatrixMarket matrix coordinate real symmetric\n2 2 2\n1 1 4\n2 2 4.5e1")
    np.testing.assert_array_equal(read_matrix(tmp_path / "k.mtx").toarray(), np.diag([4.0, 45.0]))
