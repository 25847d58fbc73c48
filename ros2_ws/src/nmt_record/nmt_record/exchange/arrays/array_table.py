"""Columns of files of arrays: NPZ, MATLAB and HDF5."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_arrays
from nmt_core.files.mat_file import read_attributes, read_mat
from nmt_core.numerics.arrays import FloatArray
from nmt_record.exchange.source_table import AS_IT_IS, Scaling, SourceTable
from nmt_record.exchange.text.text_heading import LARGEST_STEP
from nmt_record.exchange.unit_table import TIME_UNITS, is_known_unit, plain_unit

_MOST_COLUMNS = 64  # of one matrix


def read_npz(path: Path) -> SourceTable:
    """Arrays of an NPZ file, one a channel.

    Raises:
        BenchError: arrays of several lengths or types, or the file is damaged.
    """
    name = path.name
    arrays = dict(read_arrays(path, "data file"))
    rate, step, clock_keys = _clock_keys(arrays)
    for key in clock_keys:
        del arrays[key]
    columns: dict[str, FloatArray] = {}
    for key, array in arrays.items():
        if array.ndim == 0:
            continue
        if array.dtype.kind not in "iufb" or array.dtype.kind == "b":
            raise BenchError(f"Array {key} of {name} is of type {array.dtype}; real numbers are needed.")
        if array.ndim > 2 or (array.ndim == 2 and 1 not in array.shape):
            shape = " × ".join(map(str, array.shape))
            raise BenchError(f"Array {key} of {name} has the shape {shape}; save each channel as an array of its own.")
        columns[key] = array.reshape(-1).astype(np.float64, copy=False)
    if not columns or not next(iter(columns.values())).size:
        raise BenchError(f"{name} is empty of arrays; save the columns with numpy.savez.")
    lengths = {key: column.shape[0] for key, column in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{key} {length}" for key, length in list(lengths.items())[:6])
        raise BenchError(f"The arrays of {name} have unequal lengths ({listed}); save columns of one recording.")
    for key, column in columns.items():
        if np.isinf(column).any():
            raise BenchError(
                f"Array {key} of {name} is infinite at sample {int(np.argmax(np.isinf(column)))}; use NaN where "
                f"values are missing."
            )
    return SourceTable(name, tuple(columns), tuple(columns.values()), sample_rate=rate, step=step)


_RATES = frozenset(("samplerate", "fs", "samplingrate", "samplingfrequency", "samplefrequency"))
_STEPS = frozenset(
    ("dt", "deltat", "sampleinterval", "samplinginterval", "timestep", "wfincrement", "x_values.increment")
)
_X_VALUES = re.compile(r"(.*\bx_values)\.(increment|start_value)$")
"""Abscissa in the files of Simcenter Testlab."""


def _plain_key(key: str) -> str:
    """Last part of a name, in small letters, without what joins words; of an abscissa with its own."""
    if _X_VALUES.match(key):
        return ".".join(key.rsplit(".", 2)[-2:])
    return re.sub(r"[_ -]", "", key.rpartition(".")[2]).lower()


def _clock_keys(values: Mapping[str, NDArray[Any]]) -> tuple[float | None, float | None, list[str]]:
    """Sampling rate (Hz) and step (s) among single numbers, and their keys; None where there is none, or several."""
    single = {key: float(np.real(array.reshape(-1)[0])) for key, array in values.items()
              if array.size == 1 and array.dtype.kind in "iufc"}  # fmt: skip
    rates = {key: value for key, value in single.items() if _plain_key(key) in _RATES and value > 0.0}
    steps = {key: value for key, value in single.items() if _plain_key(key) in _STEPS and 0.0 < value <= LARGEST_STEP}
    rate = next(iter(rates.values())) if len(set(rates.values())) == 1 else None
    step = next(iter(steps.values())) if len(set(steps.values())) == 1 else None
    return rate, step, [key for key in single if _plain_key(key) in _RATES | _STEPS]


def _counts_seconds(key: str, texts: Mapping[str, str]) -> bool:
    """Whether a number may be one of a clock: an abscissa may be another one by its unit."""
    found = _X_VALUES.match(key)
    return found is None or plain_unit(texts.get(f"{found[1]}.quantity.label", "s")) == "s"


def read_mat_table(path: Path, wanted: Sequence[str | int]) -> SourceTable:
    """Arrays of a MATLAB or HDF5 file.

    Raises:
        BenchError: no arrays of numbers of one length, or the file is damaged.
    """
    name = path.name
    texts: dict[str, str] = {}
    arrays = read_mat(path, "data file", texts=texts)
    rate, step, _ = _clock_keys({key: array for key, array in arrays.items() if _counts_seconds(key, texts)})
    columns: dict[str, FloatArray] = {}
    for key, array in arrays.items():
        if array.size > 1:
            columns |= _columns_of(key, array)
    if not columns:
        raise BenchError(f"{name} has no arrays of numbers; save the columns as numeric arrays.")
    lengths = {key: column.shape[0] for key, column in columns.items()}
    needed = {column: lengths[column] for column in wanted if isinstance(column, str) and column in lengths}
    if len(set(needed.values())) > 1:
        listed = ", ".join(f"{key} {length}" for key, length in needed.items())
        raise BenchError(f"The columns of {name} have unequal lengths ({listed}); save those of one recording.")
    if needed:
        length = next(iter(needed.values()))
    else:
        every = list(lengths.values())
        length = max(set(every), key=lambda own: (own * every.count(own), own))
    kept = {key: column for key, column in columns.items() if column.shape[0] == length}
    stated = _Stated(read_attributes(path) | _units_beside(columns, texts), name)
    kept = {key: stated.filled(key, column) for key, column in kept.items()}
    for key, column in kept.items():
        if np.isinf(column).any():
            raise BenchError(
                f"Array {key} of {name} is infinite at sample {int(np.argmax(np.isinf(column)))}; use NaN."
            )
    others = len(columns) - len(kept)
    notes = [f"{others} arrays of {name} have other lengths than {length} and are left out."] if others else []
    single = {key: float(np.real(array.reshape(-1)[0])) for key, array in arrays.items() if array.size == 1}
    return SourceTable(
        name, tuple(kept), tuple(kept.values()), tuple(map(stated.unit, kept)), notes=[*notes, *stated.notes],
        sample_rate=rate, step=step, constants=single, scalings=tuple(map(stated.scaling, kept)),
        points=tuple(map(stated.point, kept)),
    )  # fmt: skip


def _units_beside(columns: Mapping[str, FloatArray], texts: Mapping[str, str]) -> dict[str, dict[str, str | float]]:
    """Unit of each column that stands as a text next to it in its struct, and point by an identifier as rod:1:+Z."""
    found: dict[str, dict[str, str | float]] = {}
    for key in columns:
        parts = re.sub(r"(\.\d+)+$", "", key).split(".")
        struct = ".".join(parts[:-1])
        label_names = (f"{struct}.{name}" for name in ("quantity.label", "unit", "units", "Unit", "Units"))
        unit = next((texts[name] for name in label_names if struct and name in texts), "")
        place = re.match(
            r".*:(\d{1,8}):[+-]?[XYZ]", texts.get(".".join([*parts[:-2], "function_record.first_id.name"]), "")
        )
        alone = ".".join(parts) == key
        found[key] = {"unit": unit} if unit else {}
        found[key] |= {"point": float(place[1])} if place and alone else {}
    return {key: stated for key, stated in found.items() if stated}


class _Stated:
    """What the attributes of a file's data sets say of its columns."""

    def __init__(self, attributes: Mapping[str, Mapping[str, str | float]], name: str) -> None:
        self._attributes, self._name = attributes, name
        self.notes: list[str] = []

    def _of(self, key: str) -> Mapping[str, str | float]:
        while key and key not in self._attributes:
            key = key.rpartition(".")[0]  # a column of an array
        return self._attributes.get(key, {})

    def _number(self, key: str, attribute: str, default: float) -> float:
        value = self._of(key).get(attribute)
        return float(value) if isinstance(value, float) and math.isfinite(value) else default

    def unit(self, key: str) -> str:
        """Unit of a column; of a time *since* some day that of its steps."""
        text = str(self._of(key).get("units", self._of(key).get("unit", "")))
        text = re.sub(r"\s+since\s.*", "", text)
        return text if is_known_unit(text) else ""

    def point(self, key: str) -> int:
        """Point of a column; 0 = not told."""
        value = self._number(key, "point", 0.0)
        return int(value) if value.is_integer() and 0.0 <= value < 2**31 else 0

    def scaling(self, key: str) -> Scaling:
        """Scale of a packed column; one of a clock is applied already."""
        scale, offset = self._number(key, "scale_factor", 1.0), self._number(key, "add_offset", 0.0)
        if (scale, offset) == (1.0, 0.0) or scale == 0.0 or plain_unit(self.unit(key)) in TIME_UNITS:
            return AS_IT_IS
        return Scaling(scale, offset=offset, words=f"the attribute scale_factor of {key} in {self._name}")

    def filled(self, key: str, column: FloatArray) -> FloatArray:
        """A column with NaN in the place of its fill values; of a packed clock its values."""
        fills = {v for name in ("_FillValue", "missing_value") if math.isfinite(v := self._number(key, name, math.nan))}
        lost = np.isin(column, list(fills)) if fills else np.zeros(column.size, dtype=bool)
        if lost.any():
            column = np.where(lost, np.nan, column)
            self.notes.append(f"{int(lost.sum())} values of {key} in {self._name} are fill values; they are missing.")
        if plain_unit(self.unit(key)) in TIME_UNITS:
            column = column * self._number(key, "scale_factor", 1.0) + self._number(key, "add_offset", 0.0)
        return column


def _columns_of(key: str, array: NDArray[Any]) -> dict[str, FloatArray]:
    """Columns of one array: ``x``, or ``x.1``, ``x.2`` … along its shorter side, ``x.1.1`` … of three
    dimensions; of complex ones real and imag."""
    flat = np.squeeze(array) if array.ndim > 2 else array
    flat = flat.reshape(-1) if flat.ndim < 2 or 1 in flat.shape else flat
    if flat.ndim > 3 or flat.size > _MOST_COLUMNS * max(flat.shape):
        return {}
    if flat.ndim == 2:
        long = flat if flat.shape[0] >= flat.shape[1] else flat.T
        parts = {f"{key}.{number + 1}": long[:, number] for number in range(long.shape[1])}
    elif flat.ndim == 3:
        long = np.moveaxis(flat, int(np.argmax(flat.shape)), 0)
        parts = {f"{key}.{i + 1}.{j + 1}": long[:, i, j] for i, j in np.ndindex(*long.shape[1:])}
    else:
        parts = {key: flat}
    result: dict[str, FloatArray] = {}
    for own, values in parts.items():
        if np.iscomplexobj(values):
            result |= {f"{own}.real": values.real.astype(np.float64), f"{own}.imag": values.imag.astype(np.float64)}
        else:
            result[own] = values.astype(np.float64)
    return result
