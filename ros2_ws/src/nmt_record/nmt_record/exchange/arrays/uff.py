"""Universal file format, dataset 58 (function at nodal DOF): ASCII and binary (58b), strictly read and written.

Layout after the UC-SDRL text of datasets 58 and 58b: eleven header records of 80 columns, then the values (20 columns
and 13 digits in ASCII double precision). The header holds the abscissa's increment with six digits only, so a sampling
rate like 51200 Hz does not survive in it; whoever needs it exactly writes it elsewhere.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.files.hardened import LARGEST_TABLE, open_regular
from nmt_core.files.universal_file import HEADER_RECORDS, Dataset, datasets
from nmt_core.files.whole_file import writing
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import Quantity

TIME_RESPONSE = 1
FREQUENCY_RESPONSE = 4
FUNCTION_NAMES = {
    0: "general function", 1: "time response", 2: "auto spectrum", 3: "cross spectrum", 4: "frequency response",
    5: "transmissibility", 6: "coherence", 7: "auto correlation", 8: "cross correlation", 9: "power spectral density",
    10: "energy spectral density", 11: "probability density", 12: "spectrum", 13: "cumulative distribution",
    18: "mode indicator function", 19: "force pattern", 22: "eigenvalue", 23: "eigenvector", 24: "shock response",
    25: "impulse response filter", 26: "multiple coherence", 27: "order function",
}  # fmt: skip
"""Function types by number, as far as vibration tests have them."""

_NUMBERS_OF_A_LINE = 6  # at most
_RUN_TOGETHER = re.compile(rb"(E[-+]\d+)(?=[-+])")
"""A number whose exponent the sign of the next one follows: both fill their columns."""

GENERAL, DISPLACEMENT, VELOCITY, ACCELERATION, FORCE, TIME, FREQUENCY = 1, 8, 11, 12, 13, 17, 18
"""Specific data types."""
DATA_TYPES = {
    Quantity.FORCE: FORCE, Quantity.DISPLACEMENT: DISPLACEMENT, Quantity.VELOCITY: VELOCITY,
    Quantity.ACCELERATION: ACCELERATION,
}  # fmt: skip
"""Specific data type of a quantity; of others it is GENERAL."""
QUANTITIES = {9: Quantity.FORCE, **{kind: quantity for quantity, kind in DATA_TYPES.items()}}
"""Quantities by specific data type; 9 is a reaction force."""


@dataclass(frozen=True)
class Axis:
    """Characteristics of abscissa or ordinate (records 8 to 11).

    Attributes:
        data_type: specific data type, see the constants of this module; 0 = unknown.
        label: name, at most 20 characters.
        unit: at most 20 characters.
    """

    data_type: int = 0
    label: str = "NONE"
    unit: str = "NONE"


@dataclass(frozen=True, eq=False)
class UffFunction:
    """One dataset 58.

    Attributes:
        function_type: see ``FUNCTION_NAMES``.
        values: ordinate, real or complex, shape ``(samples,)``.
        abscissa_minimum: first abscissa; ignored if ``abscissa`` is given.
        abscissa_increment: step; ignored if ``abscissa`` is given.
        abscissa: uneven abscissa, shape ``(samples,)``; None = even.
        lines: the five ID lines.
        response_node: node of the response; 0 = none.
        response_direction: ±1, ±2, ±3 = x, y, z; 0 = scalar.
        reference_node: node of the excitation.
        reference_direction: as ``response_direction``.
        abscissa_axis: what the abscissa is.
        ordinate_axis: what the ordinate (or its numerator) is.
        denominator_axis: what the ordinate's denominator is.
        number: position in the file, from 1; 0 = not read from a file.
    """

    function_type: int
    values: NDArray[Any]
    abscissa_minimum: float = 0.0
    abscissa_increment: float = 0.0
    abscissa: FloatArray | None = None
    lines: tuple[str, ...] = ("NONE",) * 5
    response_node: int = 0
    response_direction: int = 0
    reference_node: int = 0
    reference_direction: int = 0
    abscissa_axis: Axis = field(default_factory=Axis)
    ordinate_axis: Axis = field(default_factory=Axis)
    denominator_axis: Axis = field(default_factory=Axis)
    number: int = 0

    @property
    def x(self) -> FloatArray:
        """Abscissa of every value, shape ``(samples,)``."""
        if self.abscissa is not None:
            return self.abscissa
        return self.abscissa_minimum + self.abscissa_increment * np.arange(self.values.shape[0], dtype=np.float64)

    @property
    def direction_sign(self) -> int:
        """−1 where the direction of the response, or of response or reference of a frequency response, is negative."""
        response = -1 if self.response_direction < 0 else 1
        reference = -1 if self.function_type == FREQUENCY_RESPONSE and self.reference_direction < 0 else 1
        return response * reference

    @property
    def direction_words(self) -> str:
        """The direction as a reader of the file has it, such as −Z; with that of the reference where it is one."""
        named = [_direction(self.response_direction)]
        if self.function_type == FREQUENCY_RESPONSE:
            named.append(_direction(self.reference_direction))
        return " over ".join(named)

    @property
    def name(self) -> str:
        """First ID line, stripped; empty if it says NONE."""
        return "" if self.lines[0].strip().upper() == "NONE" else self.lines[0].strip()


def _direction(number: int) -> str:
    axes = ("", "X", "Y", "Z", "RX", "RY", "RZ")
    if not 0 < abs(number) < len(axes):
        return "no direction"
    return ("−" if number < 0 else "+") + axes[abs(number)]


def write_uff(path: Path, functions: Sequence[UffFunction], binary: bool = True) -> None:
    """Write a file of datasets 58, double precision.

    Args:
        path: the file; replaced if it is there.
        functions: in the order of the file.
        binary: 58b with little-endian IEEE numbers, else ASCII.

    Raises:
        BenchError: the file cannot be written.
    """
    with writing(path), path.open("wb") as file:
        for function in functions:
            _write_function(file, function, binary)


def read_uff(path: Path) -> list[UffFunction]:
    """Read all datasets 58 of a file; other datasets (units, geometry) are passed over.

    Raises:
        BenchError: not a universal file, cut off, or a dataset 58 that is not whole or not of this form.
    """
    try:
        with open_regular(path, "universal file", LARGEST_TABLE) as file:
            data = file.read()
    except OSError as error:
        raise BenchError(f"{path} cannot be read: {error.strerror or error}.") from error
    functions = [_read_function(dataset, path.name) for dataset in datasets(data, path.name) if dataset.kind == 58]
    if not functions:
        raise BenchError(f"{path.name} has no dataset 58 (time data or frequency responses); export those as UFF58.")
    return functions


def _text(value: str, width: int) -> str:
    """Printable ASCII of at most ``width`` characters; ``NONE`` for nothing."""
    plain = value.replace("²", "^2").replace("µ", "u").encode("ascii", "replace").decode()
    plain = "".join(letter if letter.isprintable() else " " for letter in plain).strip()[:width]
    return plain or "NONE"


def _write_function(file: Any, function: UffFunction, binary: bool) -> None:
    values = np.asarray(function.values)
    is_complex = np.iscomplexobj(values)
    even = function.abscissa is None
    columns: list[FloatArray] = [] if function.abscissa is None else [function.abscissa]
    columns += [values.real, values.imag] if is_complex else [values]
    table = np.ascontiguousarray(np.column_stack(columns), dtype="<f8")
    payload = _payload(table, even) if binary else b""
    identifier = f"{58:6d}"
    if binary:
        identifier += f"b{1:6d}{2:6d}{HEADER_RECORDS:12d}{len(payload):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    minimum, increment = (function.abscissa_minimum, function.abscissa_increment) if even else (0.0, 0.0)
    lines = (*function.lines, *("NONE",) * 5)[:5]
    records = [
        "    -1",
        identifier,
        *(_text(line, 80) for line in lines),
        f"{function.function_type:5d}{0:10d}{0:5d}{0:10d}"
        f" {'NONE':<10}{function.response_node:10d}{function.response_direction:4d}"
        f" {'NONE':<10}{function.reference_node:10d}{function.reference_direction:4d}",
        f"{6 if is_complex else 4:10d}{values.shape[0]:10d}{int(even):10d}{minimum:13.5E}{increment:13.5E}{0.0:13.5E}",
        *(
            f"{axis.data_type:10d}{0:5d}{0:5d}{0:5d} {_text(axis.label, 20):<20} {_text(axis.unit, 20):<20}"
            for axis in (function.abscissa_axis, function.ordinate_axis, function.denominator_axis, Axis())
        ),
    ]
    file.write("".join(f"{record:<80}\n" for record in records).encode("ascii"))
    if binary:
        file.write(payload)
    else:
        _write_ascii(file, table, even)
    file.write(b"    -1" + b" " * 74 + b"\n")


def _payload(table: NDArray[Any], even: bool) -> bytes:
    """Values as they lie in a 58b; the abscissa is single precision by definition of the format."""
    if even:
        return table.tobytes()
    kind = np.dtype([("x", "<f4")] + [(f"y{i}", "<f8") for i in range(table.shape[1] - 1)])
    packed = np.empty(table.shape[0], dtype=kind)
    for name, column in zip(kind.names or (), table.T, strict=True):
        packed[name] = column
    return packed.tobytes()


def _write_ascii(file: Any, table: NDArray[Any], even: bool) -> None:
    items = table.reshape(-1, 1) if even else table
    form = "%20.12E" if even else "%13.5E" + "%20.12E" * (table.shape[1] - 1)
    per_line = 4 if even else 2 if table.shape[1] == 2 else 1
    whole = items.shape[0] // per_line * per_line
    np.savetxt(file, items[:whole].reshape(-1, per_line * items.shape[1]), fmt=form * per_line)
    if whole < items.shape[0]:
        np.savetxt(file, items[whole:].reshape(1, -1), fmt=form * (items.shape[0] - whole))


def _read_function(dataset: Dataset, name: str) -> UffFunction:
    where = f"Dataset {dataset.number} of {name}"
    records = dataset.records
    if len(records) < HEADER_RECORDS:
        raise BenchError(f"{where} has {len(records)} header records instead of {HEADER_RECORDS}; export it again.")
    try:
        head = records[5].ljust(80)
        function_type = int(head[0:5])
        response = int(head[41:51]), int(head[51:55])
        reference = int(head[66:76]), int(head[76:80])
        form = records[6].ljust(80)
        value_type, count, even = int(form[0:10]), int(form[10:20]), int(form[20:30])
        minimum, increment = _number(form[30:43]), _number(form[43:56])
        axes = _read_axis(records[7]), _read_axis(records[8]), _read_axis(records[9])
    except ValueError:
        raise BenchError(f"{where} has a header that is not of the form of UFF58; export it again.") from None
    if value_type not in (2, 4, 5, 6) or even not in (0, 1) or count < 1:
        raise BenchError(
            f"{where} has {count} values of ordinate type {value_type} and spacing {even}; UFF58 knows types 2, 4, "
            "5, 6."
        )
    columns = (1 if value_type < 5 else 2) + (0 if even else 1)
    table = (
        _binary_values(dataset, value_type, count, even, columns, where)
        if dataset.binary
        else _ascii_values(dataset.payload, count, columns, where)
    )
    ordinate = table[:, columns - 2] + 1j * table[:, columns - 1] if value_type >= 5 else table[:, columns - 1]
    return UffFunction(
        function_type,
        np.ascontiguousarray(ordinate),
        minimum,
        increment,
        None if even else np.ascontiguousarray(table[:, 0]),
        tuple(record.rstrip() for record in records[:5]),
        *response,
        *reference,
        *axes,
        dataset.number,
    )


def _read_axis(record: str) -> Axis:
    record = record.ljust(80)
    return Axis(int(record[0:10]), record[26:46].strip() or "NONE", record[47:67].strip() or "NONE")


def _number(text: str) -> float:
    return float(text.strip().replace("D", "E").replace("d", "e") or "nan")


def _binary_values(dataset: Dataset, value_type: int, count: int, even: int, columns: int, where: str) -> FloatArray:
    try:
        order, form = int(dataset.identifier[7:13]), int(dataset.identifier[13:19])
    except ValueError:
        order, form = 0, 0
    if order not in (1, 2) or form != 2:
        raise BenchError(
            f"{where} has byte order {order} and number format {form}; IEEE numbers (format 2) are needed."
        )
    sign = "<" if order == 1 else ">"
    size = 8 if value_type in (4, 6) else 4
    ordinates = columns - (0 if even else 1)
    kinds = [] if even else [("x", f"{sign}f{len(dataset.payload) // count - size * ordinates}")]
    kinds += [(f"y{i}", f"{sign}f{size}") for i in range(ordinates)]
    packed = np.frombuffer(dataset.payload, dtype=np.dtype(kinds), count=count)
    return np.column_stack([packed[name].astype(np.float64) for name in packed.dtype.names or ()])


def _ascii_values(payload: bytes, count: int, columns: int, where: str) -> FloatArray:
    words = _RUN_TOGETHER.sub(rb"\1 ", payload.replace(b"D", b"E").replace(b"d", b"E").replace(b"e", b"E")).split()
    total = count * columns
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError:
        raise BenchError(f"{where} has words in the place of numbers; the file is damaged.") from None
    if total < values.shape[0] < total + _NUMBERS_OF_A_LINE and not values[total:].any():
        values = values[:total]  # zeros that fill the last line
    if values.shape[0] != total:
        raise BenchError(
            f"{where} holds {values.shape[0]} numbers instead of {total}; it is cut off or damaged, export it again."
        )
    return values.reshape(count, columns)
