"""UFF58 against another's tool (pyuff) in both directions, and against the text of the format byte by byte."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyuff

from nmt_core.errors import BenchError
from nmt_record.exchange.arrays import uff
from nmt_record.exchange.arrays.uff import Axis, UffFunction

RANDOM = np.random.default_rng(5)
TIME = UffFunction(
    uff.TIME_RESPONSE,
    RANDOM.standard_normal(1003),
    0.5,
    1e-4,
    lines=("a2", "second line"),
    response_node=2,
    response_direction=3,
    abscissa_axis=Axis(uff.TIME, "Time", "s"),
    ordinate_axis=Axis(uff.ACCELERATION, "Acceleration", "m/s^2"),
)
RESPONSE = UffFunction(
    uff.FREQUENCY_RESPONSE,
    RANDOM.standard_normal(101) + 1j * RANDOM.standard_normal(101),
    10.0,
    0.25,
    lines=("H",),
    response_node=4,
    response_direction=3,
    reference_node=2,
    reference_direction=3,
    abscissa_axis=Axis(uff.FREQUENCY, "Frequency", "Hz"),
    ordinate_axis=Axis(uff.ACCELERATION, "Acceleration", "m/s^2"),
    denominator_axis=Axis(uff.FORCE, "Force", "N"),
)


@pytest.mark.parametrize(("binary", "tolerance"), [(True, 0.0), (False, 1e-12)])
def test_another_tool_reads_what_is_written(binary: bool, tolerance: float, tmp_path: Path) -> None:
    uff.write_uff(tmp_path / "x.uff", [TIME, RESPONSE], binary)
    time, response = pyuff.UFF(str(tmp_path / "x.uff")).read_sets()
    assert np.allclose(time["data"], TIME.values, rtol=tolerance, atol=0.0)
    assert np.allclose(time["x"], TIME.x)
    assert np.allclose(response["data"], RESPONSE.values, rtol=tolerance, atol=tolerance)
    assert [time[key] for key in ("func_type", "rsp_node", "rsp_dir", "ref_node", "id1")] == [1, 2, 3, 0, "a2"]
    assert [time[key] for key in ("abscissa_spec_data_type", "ordinate_spec_data_type")] == [17, 12]
    assert [response[key] for key in ("func_type", "rsp_node", "rsp_dir", "ref_node", "ref_dir")] == [4, 4, 3, 2, 3]
    assert [response[f"{axis}_axis_units_lab"] for axis in ("abscissa", "ordinate", "orddenom")] == ["Hz", "m/s^2", "N"]
    assert response["orddenom_spec_data_type"] == 13
    if binary:
        assert (time["n_bytes"], response["n_bytes"]) == (8 * 1003, 16 * 101)


# pyuff leaves a file open.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("even", [0, 1])
@pytest.mark.parametrize("values", [TIME.values, RESPONSE.values])
def test_what_another_tool_writes_is_read(binary: int, even: int, values: Any, tmp_path: Path) -> None:
    path = tmp_path / "y.uff"
    x = np.arange(values.size) * 0.25
    kind = 4 if np.iscomplexobj(values) else 1
    dataset = {
        "type": 58, "binary": binary, "func_type": kind, "rsp_node": 7, "rsp_dir": -2, "ref_node": 3, "ref_dir": 1,
        "data": values, "x": x, "abscissa_spacing": even, "orddenom_spec_data_type": 0, "id1": "from elsewhere",
    }  # fmt: skip
    pyuff.UFF(str(path)).write_sets(dataset, "add")
    (function,) = uff.read_uff(path)
    assert np.allclose(function.values, values, rtol=0.0 if binary else 1e-10, atol=0.0 if binary else 1e-11)
    assert np.allclose(function.x, x, rtol=1e-5)
    assert (function.response_node, function.response_direction, function.name) == (7, -2, "from elsewhere")
    assert (function.reference_node, function.reference_direction) == (3, 1)


@pytest.mark.parametrize("binary", [True, False])
def test_the_header_is_that_of_the_format(binary: bool, tmp_path: Path) -> None:
    path = tmp_path / "x.uff"
    uff.write_uff(path, [RESPONSE], binary)
    content = path.read_bytes()
    records = [content[81 * i : 81 * i + 81] for i in range(13)]
    assert all(len(record) == 81 and record.endswith(b"\n") for record in records)
    assert records[0][:6] == b"    -1"
    head = b"    58b     1     2          11        1616     0     0           0           0" if binary else b"    58"
    assert records[1].rstrip() == head
    assert records[2][:80] == b"H".ljust(80)
    assert all(record.rstrip() == b"NONE" for record in records[3:7])
    # Format(2(I5,I10),2(1X,10A1,I10,I4))
    assert records[7].rstrip() == b"    4         0    0         0 NONE               4   3 NONE               2   3"
    # Format(3I10,3E13.5)
    assert records[8].rstrip() == b"         6       101         1  1.00000E+01  2.50000E-01  0.00000E+00"
    # Format(I10,3I5,2(1X,20A1))
    assert records[9].rstrip() == b"        18    0    0    0 Frequency            Hz"
    assert records[10].rstrip() == b"        12    0    0    0 Acceleration         m/s^2"
    assert records[11].rstrip() == b"        13    0    0    0 Force                N"
    values = content[81 * 13 :]
    if binary:
        assert values[:1616] == np.column_stack((RESPONSE.values.real, RESPONSE.values.imag)).astype("<f8").tobytes()
        assert values[1616:] == b"    -1".ljust(80) + b"\n"
    else:
        first = values.split(b"\n")[0]
        assert len(first) == 80
        assert float(first[:20]) == pytest.approx(RESPONSE.values[0].real, rel=1e-12)


def test_big_endian_single_precision_and_numbers_without_space_between(tmp_path: Path) -> None:
    path = tmp_path / "x.uff"
    uff.write_uff(path, [TIME], True)
    content = path.read_bytes()
    content = content.replace(b"    58b     1     2", b"    58b     2     2", 1)
    content = content.replace(b"        8024", b"        4012", 1).replace(
        b"         4      1003", b"         2      1003", 1
    )
    content = content[: 81 * 13] + TIME.values.astype(">f4").tobytes() + content[81 * 13 + 8024 :]
    path.write_bytes(content)
    assert np.array_equal(uff.read_uff(path)[0].values, TIME.values.astype(np.float32).astype(np.float64))
    uff.write_uff(path, [UffFunction(1, np.array([-1.5, -2.5, -3.5]), 0.0, 1.0)], False)
    text = path.read_text().replace(
        " -1.500000000000E+00 -2.500000000000E+00", "-1.5000000000000E+00-2.5000000000000E+00"
    )
    path.write_text(text.replace("\n", "\r\n"))
    assert uff.read_uff(path)[0].values.tolist() == [-1.5, -2.5, -3.5]


def test_other_datasets_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "x.uff"
    uff.write_uff(path, [TIME], False)
    units = "    -1\n   164\n         1SI: Meter (newton)         2\n  1.0  1.0  1.0\n    -1\n"
    path.write_text(units + path.read_text())
    (function,) = uff.read_uff(path)
    assert function.number == 2


def test_a_file_of_other_datasets_only(tmp_path: Path) -> None:
    (tmp_path / "x.uff").write_text("    -1\n   164\n  1\n    -1\n")
    with pytest.raises(BenchError, match="no dataset 58"):
        uff.read_uff(tmp_path / "x.uff")
