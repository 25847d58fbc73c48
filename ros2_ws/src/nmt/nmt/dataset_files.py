"""Writes an ``xarray.Dataset`` as NetCDF, NPZ, HDF5 or a MATLAB file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.files.whole_file import writing


def write_dataset(data: Any, path: Path, ending: str = "") -> Path:
    """Write variables and coordinates of a dataset; the ending chooses the format.

    ========  ===============================================================================================
    ``.nc``   NetCDF 3; a complex variable becomes two, ``NAME_real`` and ``NAME_imag``; texts become characters
    ``.npz``  an array a name
    ``.h5``   HDF5: a data set a name, with its dimensions and units as attributes; complex numbers are pairs r, i
    ``.mat``  MATLAB 5: a variable a name
    ========  ===============================================================================================

    Args:
        data: an ``xarray.Dataset``.
        path: of the file.
        ending: of the format; empty = that of the path.

    Returns:
        The path.

    Raises:
        BenchError: no such format, or the file cannot be written.
    """
    write = _WRITERS.get(ending or path.suffix)
    if write is None:
        raise BenchError(
            f"{path.name}: arrays are written as {', '.join(DATASET_ENDINGS)}; choose one of these endings."
        )
    with writing(path):
        write(data, path)
    return path


def _arrays(data: Any) -> dict[str, NDArray[Any]]:
    return {str(name): np.asarray(values) for name, values in data.variables.items()}


def _write_netcdf(data: Any, path: Path) -> None:
    for name in [name for name, values in data.data_vars.items() if values.dtype.kind == "c"]:
        data = data.assign({f"{name}_real": data[name].real, f"{name}_imag": data[name].imag}).drop_vars(name)
    data.to_netcdf(path, engine="scipy")


def _write_npz(data: Any, path: Path) -> None:
    arrays: dict[str, Any] = dict(_arrays(data))
    np.savez(path, **arrays)


def _write_hdf5(data: Any, path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs.update(data.attrs)
        for name, values in _arrays(data).items():
            texts = values.dtype.kind == "U"
            kind = h5py.string_dtype() if texts else values.dtype
            written = file.create_dataset(name, data=values.astype(object) if texts else values, dtype=kind)
            written.attrs["dimensions"] = list(map(str, data[name].dims))
            written.attrs.update(data[name].attrs)


def _write_mat(data: Any, path: Path) -> None:
    from scipy.io import savemat

    savemat(path, _arrays(data), oned_as="column")


_WRITERS: dict[str, Callable[[Any, Path], None]] = {
    ".nc": _write_netcdf,
    ".npz": _write_npz,
    ".h5": _write_hdf5,
    ".mat": _write_mat,
}

DATASET_ENDINGS = tuple(_WRITERS)
"""Endings of the files that :func:`write_dataset` writes."""
