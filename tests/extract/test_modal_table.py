from __future__ import annotations

import csv
import json
import math
import os

import numpy as np
import pytest
from extract.synthetic import FREQUENCY, RATE, Stream, extract, in_phase_case, lock_event
from hypothesis import given, settings
from hypothesis import strategies as st

from nmt_core.errors import BenchError
from nmt_core.messages.modal_point import MEASURED, ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_extract.modal.point import rejected_point
from nmt_extract.modal.table import COLUMNS, read_csv, read_json, write_csv, write_json, write_results


@pytest.fixture(scope="module")
def points():
    force, shape = in_phase_case()
    samples = round(12 * RATE / FREQUENCY)
    stream = Stream([0, force], [[0, x] for x in shape], samples=samples, noise=0.01)
    good = extract(stream, lock_event(0, samples, 12))
    return [good, rejected_point(lock_event(0, samples, 12, level=0.2), RATE, "Samples 1 to 2 are missing.")]


def test_columns_are_those_of_the_contract():
    expected = (
        "level,frequency_hz,frequency_hz_std,omega_rad_s,omega_rad_s_std,damping_ratio,damping_ratio_std,"
        "modal_amplitude,modal_amplitude_std,force_n,force_n_std,pbmif,pbmif_std,gamma_force,gamma_force_std,"
        "gamma_acceleration,gamma_acceleration_std,mac,mac_std"
    )
    assert ",".join(COLUMNS[:19]) == expected, "columns of earlier releases come first, in their order"


def test_csv_keeps_every_bit_and_every_row(points, tmp_path):
    write_csv(points, tmp_path / "modal.csv")
    with (tmp_path / "modal.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["damping_ratio"]) == points[0].damping_ratio
    assert rows[1]["level"] == "0.2"
    assert rows[1]["damping_ratio"] == "nan"
    columns = read_csv(tmp_path / "modal.csv")
    for name in COLUMNS:
        np.testing.assert_array_equal(columns[name], [getattr(point, name) for point in points])


finite_or_nan = st.floats(allow_nan=True, allow_infinity=False)


@given(
    st.fixed_dictionaries(dict.fromkeys(MEASURED, finite_or_nan)),
    st.lists(st.complex_numbers(allow_nan=False, allow_infinity=False), min_size=1, max_size=6),
    st.sampled_from(PointStatus),
    st.text(max_size=20),
)
@settings(max_examples=40, deadline=None)
def test_json_reads_back_to_the_same_bits(tmp_path_factory, measured, harmonics, status, reason):
    path = tmp_path_factory.mktemp("json") / "modal.json"
    point = ModalPoint(
        1, status, reason, 0.3, "V", 17, 3, 4, 5, harmonics=len(harmonics) - 1, points=(2, 4),
        force_harmonics=np.array(harmonics, dtype=complex),
        shape_harmonics=np.outer(harmonics, [1.0, -1.0]), **measured,
    )  # fmt: skip
    write_json([point], path)
    (again,), _ = read_json(path)
    assert again.identical(point)


def test_json_says_why_and_from_what(points, tmp_path):
    write_json(points, tmp_path / "modal.json", {"run_id": "r1", "nothing": math.nan, "list": (1, np.float64(2.0))})
    document = json.loads((tmp_path / "modal.json").read_text(), parse_constant=pytest.fail)
    assert document["inputs"] == {"run_id": "r1", "nothing": None, "list": [1, 2.0]}
    assert document["points"][1]["reason"] == "Samples 1 to 2 are missing."
    assert document["points"][1]["status"] == "REJECTED"
    again, inputs = read_json(tmp_path / "modal.json")
    assert inputs["run_id"] == "r1"
    assert all(a.identical(b) for a, b in zip(again, points, strict=True))


def test_same_points_give_the_same_files(points, tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_results(points, tmp_path / name, {"run_id": "r"})
    for name in ("modal.csv", "modal.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_failed_write_leaves_the_old_file_and_no_other(points, tmp_path, monkeypatch):
    path = tmp_path / "modal.csv"
    path.write_text("old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(BenchError, match="No space left"):
        write_csv(points, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_table_of_another_release_is_read(points, tmp_path):
    """Columns that it lacks are NaN, unknown ones are kept, and the order of columns means nothing."""
    write_csv(points, tmp_path / "modal.csv")
    with (tmp_path / "modal.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        del row["mac"], row["mac_std"]
        row |= {"loudness": "41.5", "remark": "door open"}
    with (tmp_path / "other.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, sorted(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    known, other = read_csv(tmp_path / "modal.csv"), read_csv(tmp_path / "other.csv")
    assert set(other) == {*COLUMNS, "loudness", "remark"}
    assert other["loudness"] == [41.5, 41.5]
    assert other["remark"] == ["door open"] * 2
    assert all(math.isnan(value) for name in ("mac", "mac_std") for value in other[name])
    for name in set(COLUMNS) - {"mac", "mac_std"}:
        np.testing.assert_array_equal(other[name], known[name])


def test_a_wrong_value_is_named_with_its_line(points, tmp_path):
    write_csv(points, tmp_path / "modal.csv")
    text = (tmp_path / "modal.csv").read_text()
    (tmp_path / "modal.csv").write_text(text.replace("\n0.2,nan", "\n0.2,much"))
    with pytest.raises(BenchError, match=r"modal.csv line 3: frequency_hz is 'much'; give a number"):
        read_csv(tmp_path / "modal.csv")


def test_files_that_are_something_else_are_refused(tmp_path):
    path = tmp_path / "other"
    with pytest.raises(BenchError, match="cannot be read"):
        read_csv(path)
    with pytest.raises(BenchError, match="cannot be written"):
        write_csv([], tmp_path / "missing" / "modal.csv")
    for text in (
        "",
        "a,b\n1,2\n",
        ",".join(COLUMNS) + "\n1,2\n",
        ",".join(COLUMNS) + "\n" + ",".join("x" * len(COLUMNS)) + "\n",
        ",".join((*COLUMNS, "level")) + "\n",
    ):
        path.write_text(text)
        with pytest.raises(BenchError):
            read_csv(path)
    for text in ("", "[]", "{}", '{"format": "other"}', '{"format": "nmt modal points 1", "points": [{}]}'):
        path.write_text(text)
        with pytest.raises(BenchError):
            read_json(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BenchError, match="not a text file"):
        read_csv(path)
