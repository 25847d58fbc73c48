"""MATLAB and HDF5 files, divided columns, sign and convention of frequency responses, and sidecars to start from."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml
from record.foreign_data import RATE, recording, sidecar, write, write_sidecar
from scipy.io import savemat

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_record.exchange.imports.imported_run import ImportedRun, read_import
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

HZ, RATIO, MASS = 30.0, 0.01, 2.0
OMEGA = 2.0 * math.pi * HZ
LINES = np.linspace(20.0, 40.0, 201)


def channels(prefix: str) -> list[dict[str, Any]]:
    return [{**channel, "column": prefix + channel["column"]} for channel in sidecar()["channels"]]


def test_columns_of_a_matlab_struct_are_the_recording(tmp_path: Path) -> None:
    path = write(tmp_path)
    wanted = read_import(path)
    data = recording()
    content = {"test": {"fs": RATE, "data": {key: value[:, None] for key, value in data.items()}}, "other": np.ones(7)}
    savemat(tmp_path / "run.mat", content, do_compression=True)
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["test/fs"] = RATE
        for key, value in data.items():
            file[f"test/data/{key}"] = value
    for name in ("run.mat", "run.h5"):
        write_sidecar(tmp_path, sidecar(file=name, channels=channels("test.data."), sample_rate=None))
        found = read_import(path)
        assert found.sample_rate == RATE
        for own, theirs in zip(found.channels, wanted.channels, strict=True):
            np.testing.assert_array_equal(own.data, theirs.data)


def test_columns_of_a_matrix_are_numbered(tmp_path: Path) -> None:
    path = write(tmp_path)
    data = recording()
    savemat(tmp_path / "run.mat", {"y": np.column_stack(list(data.values())), "t": np.arange(12000) / RATE})
    own = [{**c, "column": f"y.{k + 1}"} for k, c in enumerate(sidecar()["channels"])]
    write_sidecar(tmp_path, sidecar(file="run.mat", channels=own, sample_rate=None))
    found = read_import(path)
    assert found.sample_rate == pytest.approx(RATE)
    np.testing.assert_array_equal(found.channels[2].data, data["a2"])


def test_arrays_of_unequal_length_are_named(tmp_path: Path) -> None:
    path = write(tmp_path)
    data = recording()
    savemat(tmp_path / "run.mat", {**data, "a4": data["a4"][:-5]})
    write_sidecar(tmp_path, sidecar(file="run.mat"))
    with pytest.raises(BenchError, match=r"unequal lengths .*a4 11995"):
        read_import(path)


def receptance() -> np.ndarray:
    omega = 2.0 * math.pi * LINES
    return np.asarray(1.0 / (MASS * (OMEGA**2 - omega**2 + 2j * RATIO * OMEGA * omega)))


def frf(tmp_path: Path, response: np.ndarray, unit: str, **keys: Any) -> ImportedRun:
    rows = zip(LINES, response.real, response.imag, 2.0 + 0.0 * LINES, strict=True)
    lines = [",".join(map(repr, map(float, row))) for row in rows]
    (tmp_path / "frf.csv").write_text("\n".join(["frequency_hz,real,imag,load", *lines]) + "\n")
    values = {"file": "frf.csv", "segments": [{"kind": "frf", "unit": unit, **keys}]}
    (tmp_path / "sidecar.yaml").write_text(yaml.safe_dump(values))
    return read_import(tmp_path / "sidecar.yaml", shape_sign=lambda point, drive_point, hz: -1.0 if point == 3 else 0.0)


def response_of(run: ImportedRun) -> np.ndarray:
    table: ObservableTable = run.tables[0]
    return np.asarray(table.columns["real"] + 1j * table.columns["imag"])


@pytest.mark.parametrize(("unit", "order"), [("m/N", 0), ("m/s/N", 1), ("m/s^2/N", 2)])
def test_sign_and_convention_of_a_drive_point(tmp_path: Path, unit: str, order: int) -> None:
    right = receptance() * (2j * math.pi * LINES) ** order
    assert response_of(frf(tmp_path, right, unit)) == pytest.approx(right)
    # A conditioner that is 100° off is for the diagnosis.
    frf(tmp_path, right * np.exp(-1.7j), unit)
    with pytest.raises(BenchError, match="'scale: -1'"):
        frf(tmp_path, -right, unit)
    with pytest.raises(BenchError, match=r"phase rises with frequency.*'conjugate: true'"):
        frf(tmp_path, right.conj(), unit)
    assert response_of(frf(tmp_path, -right, unit, scale=-1.0)) == pytest.approx(right)
    assert response_of(frf(tmp_path, right.conj(), unit, conjugate=True)) == pytest.approx(right)
    # As it is, if it is said to be meant so.
    assert response_of(frf(tmp_path, -right, unit, scale=1.0)) == pytest.approx(-right)
    assert response_of(frf(tmp_path, right.conj(), unit, conjugate=False, scale=1.0)) == pytest.approx(right.conj())


def test_away_from_the_drive_point_the_model_knows_the_sign(tmp_path: Path) -> None:
    right = receptance()
    frf(tmp_path, -right, "m/N", point=2, drive_point=1)
    frf(tmp_path, -right, "m/N", point=3, drive_point=1)
    with pytest.raises(BenchError, match=r"where 90° belong.*'scale: -1'"):
        frf(tmp_path, right, "m/N", point=3, drive_point=1)


def test_noise_without_a_resonance_says_nothing(tmp_path: Path) -> None:
    draw = np.random.default_rng(5)
    for _ in range(20):
        far = 1e-4 * (1.0 + 0.05 * draw.standard_normal(LINES.size))
        frf(tmp_path, far + 0j, "m/N")


def test_a_response_is_divided_by_its_force(tmp_path: Path) -> None:
    right = receptance()
    run = frf(tmp_path, 2.0 * right, "mm", per="load")
    assert response_of(run) == pytest.approx(1e-3 * right)
    assert run.tables[0].columns["force_n"] == pytest.approx(2.0)
    assert run.tables[0].quantity is Quantity.DISPLACEMENT
    run = frf(tmp_path, 2.0 * right, "m/lbf", per="load", scale=3.0)
    assert response_of(run) == pytest.approx(3.0 * right / 4.4482216152605)
    assert run.tables[0].columns["force_n"] == pytest.approx(2.0 * 4.4482216152605)
    with pytest.raises(BenchError, match="an amplitude that responses are divided by is positive"):
        frf(tmp_path, right, "m/N", per="real")


def test_a_backbone_has_nothing_to_divide_by(tmp_path: Path) -> None:
    (tmp_path / "b.csv").write_text("frequency_hz,amplitude\n10,1\n11,2\n")
    (tmp_path / "sidecar.yaml").write_text("file: b.csv\nsegments: [{kind: backbone, unit: mm, per: amplitude}]\n")
    with pytest.raises(BenchError, match="belong to a table of kind frf"):
        read_import(tmp_path / "sidecar.yaml")


def template(path: Path) -> dict[str, Any]:
    values = yaml.safe_load(sidecar_templates(path)[0])
    assert isinstance(values, dict)
    return values


def test_a_template_knows_clock_names_units_and_a_decay(tmp_path: Path) -> None:
    t = np.arange(2000) / 1000.0
    x = np.exp(-3.0 * t) * np.sin(200.0 * t)
    path = tmp_path / "run.csv"
    path.write_text(
        "time [ms],v3 [mm/s],unnamed\n" + "".join(f"{1e3 * a},{b},{c}\n" for a, b, c in zip(t, x, x + 1, strict=True))
    )
    values = template(path)
    assert values["time"] == "time [ms]"
    assert values["channels"] == [
        {"column": "v3 [mm/s]", "quantity": "velocity", "unit": "mm/s", "point": 3},
        {"column": "unnamed", "quantity": "?", "unit": "?"},
    ]
    path.write_text("time,v3 [mm/s]\n" + "".join(f"{a},{b}\n" for a, b in zip(t, x, strict=True)))
    values = template(path)
    assert values["segments"][0]["kind"] == "ring_down"
    # As it is written it imports.
    (tmp_path / "run.yaml").write_text(sidecar_templates(path)[0])
    run = read_import(tmp_path / "run.yaml")
    assert run.channels[0].data == pytest.approx(1e-3 * x)
    assert run.segments[0].stop_sample == 2000


def test_a_template_of_a_recording_with_a_force_is_a_record(tmp_path: Path) -> None:
    write(tmp_path)
    values = template(tmp_path / "data.npz")
    assert [c["quantity"] for c in values["channels"]] == ["voltage", "force", "acceleration", "acceleration"]
    assert values["segments"][0]["kind"] == "record"
    assert values["sample_rate"] == "?"


def test_templates_of_tables(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("Freq Hz;Magnitude;Phase\n20;1;-10\n21;2;-90\n22;1;-170\n")
    path.write_text("freq_hz;magnitude;phase_deg;force\n20;1;-10;2\n21;2;-90;2\n22;1;-170;2\n")
    segment = template(path)["segments"][0]
    assert segment["kind"] == "frf"
    assert segment["columns"] == {"frequency_hz": "freq_hz", "phase": "phase_deg", "magnitude": "magnitude"}
    assert segment["units"] == {"phase": "deg"}
    assert "per: force" in sidecar_templates(path)[0]
    path.write_text("frequency_hz,zeta,amplitude [mm]\n20,1.1,0.1\n21,1.2,0.2\n")
    segment = template(path)["segments"][0]
    assert segment["kind"] == "backbone"
    assert segment["unit"] == "mm"
    assert segment["units"] == {"damping_ratio": "%"}


@pytest.mark.parametrize(
    ("head", "kind", "columns"),
    [
        ("frequency_hz,magnitude", "frf", {"frequency_hz": "frequency_hz", "magnitude": "magnitude"}),
        (
            "frequency_hz,amplitude,damping_ratio",
            "backbone",
            {name: name for name in ("frequency_hz", "amplitude", "damping_ratio")},
        ),
        (
            "frequency_hz,magnitude,zeta",
            "backbone",
            {"frequency_hz": "frequency_hz", "amplitude": "magnitude", "damping_ratio": "zeta"},
        ),
    ],
)
def test_a_magnitude_alone_is_a_response_unless_a_damping_ratio_is_beside_it(
    head: str, kind: str, columns: dict[str, str], tmp_path: Path
) -> None:
    path = tmp_path / "table.csv"
    count = head.count(",")
    path.write_text(f"{head}\n20{',0.01' * count}\n21{',0.02' * count}\n")
    segment = template(path)["segments"][0]
    assert segment["kind"] == kind
    assert segment["columns"] == columns
