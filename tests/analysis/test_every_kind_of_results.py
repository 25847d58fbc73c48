"""One contract for all results: every kind of folder gives tables, arrays, files of every format, a plot, a page."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import matplotlib
import numpy as np
import pytest
from analysis.results_folders import KINDS, SWEPT, swept_table
from scipy.io import loadmat, netcdf_file

import nmt
from nmt.dataset_files import DATASET_ENDINGS
from nmt.opening import KINDS_OF_RESULTS
from nmt_core.errors import BenchError

matplotlib.use("Agg")

Arrays = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("kinds")
    for name, write in KINDS.items():
        (root / name).mkdir()
        write(root / name)
    return root


@pytest.fixture(params=list(KINDS))
def results(request: pytest.FixtureRequest, folders: Path) -> nmt.Results:
    return nmt.open(folders / request.param)


def test_every_class_that_can_be_opened_is_tried(folders: Path) -> None:
    tried = {type(nmt.open(folders / name)) for name in KINDS}
    assert tried == {read.__self__ for _, read in KINDS_OF_RESULTS}  # type: ignore[attr-defined]


def test_the_table_has_the_rows(results: nmt.Results) -> None:
    table, rows = results.to_dataframe(), results.rows()
    assert len(rows) >= 1
    assert list(table.columns) == list(rows[0])
    assert len(table) == len(rows)


def test_the_notebook_table_has_a_row_each(results: nmt.Results) -> None:
    page = results._repr_html_()
    assert page.count("<tr") == 1 + len(results.rows())
    assert all(f">{name}<" in page for name in results.rows()[0])


def test_a_prompt_shows_one_short_line(results: nmt.Results) -> None:
    shown = repr(results)
    assert shown.startswith(f"{type(results).__name__}('{results.folder}': ")
    assert "\n" not in shown
    assert len(shown) < 100 + len(str(results.folder))


def test_the_plot_is_drawn_on_the_axes_given(results: nmt.Results) -> None:
    axes = matplotlib.figure.Figure().subplots()
    assert results.plot(axes=axes) is axes
    assert axes.lines or axes.patches
    assert axes.get_xlabel()


def test_one_dataset_with_more_than_attributes(results: nmt.Results) -> None:
    data = results.to_xarray()
    assert type(data).__name__ == "Dataset"
    assert data.sizes
    assert data.attrs["folder"] == str(results.folder)


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_csv_holds_the_table(results: nmt.Results, tmp_path: Path) -> None:
    written = read_csv(results.export(tmp_path / "table.csv"))
    rows = results.rows()
    assert [list(row) for row in written] == [list(row) for row in rows]
    for line, row in zip(written, rows, strict=True):
        for name, value in row.items():
            if isinstance(value, float):
                assert (line[name] == "") == math.isnan(value)
                assert math.isnan(value) or float(line[name]) == value
            else:
                assert line[name] == str(value)


def from_netcdf(path: Path) -> Arrays:
    """With scipy, which shares nothing with xarray but the format."""
    with netcdf_file(path, mmap=False) as file:
        found = {name: np.array(variable[:]) for name, variable in file.variables.items()}
    for name in [name for name in found if name.endswith("_real")]:
        found[name[:-5]] = found.pop(name) + 1j * found.pop(name[:-5] + "_imag")
    return {
        name: np.array([b"".join(row).decode().rstrip("\0") for row in values]) if values.dtype.kind == "S" else values
        for name, values in found.items()
    }


def from_npz(path: Path) -> Arrays:
    with np.load(path) as file:
        return dict(file)


def from_hdf5(path: Path) -> Arrays:
    with h5py.File(path) as file:
        return {
            name: data.asstr()[:] if h5py.check_string_dtype(data.dtype) else data[()] for name, data in file.items()
        }


def from_mat(path: Path) -> Arrays:
    """A vector is a column, texts are rows of characters that MATLAB fills with blanks."""
    found = {name: values for name, values in loadmat(path).items() if not name.startswith("__")}
    return {
        name: np.array([text.rstrip() for text in values])
        if values.dtype.kind == "U"
        else values[:, 0]
        if values.ndim == 2 and values.shape[1] == 1
        else values
        for name, values in found.items()
    }


READERS: dict[str, Callable[[Path], Arrays]] = {
    ".nc": from_netcdf,
    ".npz": from_npz,
    ".h5": from_hdf5,
    ".mat": from_mat,
}


def test_every_format_has_a_reader_here() -> None:
    assert tuple(READERS) == DATASET_ENDINGS


def equal(written: np.ndarray, own: np.ndarray) -> None:
    if own.dtype.kind == "U":
        assert written.tolist() == own.tolist()
    else:
        np.testing.assert_array_equal(np.squeeze(written), np.squeeze(own))


@pytest.mark.parametrize("ending", DATASET_ENDINGS)
def test_a_file_holds_the_arrays(results: nmt.Results, ending: str, tmp_path: Path) -> None:
    data: Any = results.to_xarray()
    written = READERS[ending](results.export(tmp_path / f"arrays{ending}"))
    own = {name: np.asarray(values) for name, values in data.variables.items()}
    assert set(written) == set(own)
    for name, values in own.items():
        equal(written[name], values)


def test_netcdf_whatever_the_ending(results: nmt.Results, tmp_path: Path) -> None:
    written = results.to_netcdf(tmp_path / "arrays.cdf")
    assert written.read_bytes() == results.export(tmp_path / "arrays.nc").read_bytes()


def test_hdf5_says_dimensions_and_units(folders: Path, tmp_path: Path) -> None:
    with h5py.File(nmt.open(folders / "sweep").export(tmp_path / "sweep.h5")) as file:
        assert list(file["response"].attrs["dimensions"]) == ["level", "channel", "line"]
        assert file["level"].attrs["units"] == "N"


def test_other_endings_are_refused(results: nmt.Results, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"arrays\.xlsx: arrays are written as \.nc, "):
        results.export(tmp_path / "arrays.xlsx")


@pytest.mark.parametrize("ending", [".csv", *DATASET_ENDINGS])
def test_a_missing_folder_is_named(results: nmt.Results, ending: str, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="cannot be written"):
        results.export(tmp_path / "nowhere" / f"file{ending}")


def test_levels_of_a_sweep_with_other_frequencies(folders: Path) -> None:
    data = nmt.open(folders / "sweep").to_xarray()
    for number, (level, frequency) in enumerate(zip((1.0, 2.0), SWEPT, strict=True)):
        made, own = swept_table(level, frequency), data.isel(level=number, line=slice(frequency.size))
        np.testing.assert_array_equal(own.frequency_hz, frequency)
        np.testing.assert_array_equal(own.response, made.frf)
        np.testing.assert_array_equal(own.response_std, made.frf_std)
        np.testing.assert_array_equal(own.force_n, made.force_n)
    assert np.isnan(data.response.isel(level=1, line=2)).all()


def test_shapes_of_a_reference(folders: Path, tmp_path: Path) -> None:
    shapes = nmt.open(folders / "reference").to_xarray().shape_harmonics
    assert complex(shapes.sel(modal_amplitude=1e-3, order=3, point=5)) == pytest.approx(5e-3 + 3j)
    lines = (folders / "reference" / "shapes.csv").read_text().splitlines()
    (tmp_path / "reference.csv").write_bytes((folders / "reference" / "reference.csv").read_bytes())
    (tmp_path / "shapes.csv").write_text("\n".join(lines[:-1]))
    with pytest.raises(BenchError, match=r"shapes\.csv does not fit reference\.csv"):
        nmt.open(tmp_path)
    (tmp_path / "shapes.csv").write_text("a,b\n")
    with pytest.raises(BenchError, match=r"not a table with the columns modal_amplitude, order"):
        nmt.open(tmp_path)


def test_a_linear_test_with_its_responses(folders: Path) -> None:
    data = nmt.open(folders / "linear").to_xarray()
    np.testing.assert_array_equal(data.response[0], [1 + 2j, 3 - 4j])
    assert data.frequency_hz.values.tolist() == [20.0, 21.0]
