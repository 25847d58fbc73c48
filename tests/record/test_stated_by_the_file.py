"""Units, signs and scales that files of responses, universal files and netCDF state are used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml
from scipy.io import savemat

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_record.exchange.arrays import uff
from nmt_record.exchange.imports.imported_run import ImportedRun, read_import
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

LINES = np.arange(20.0, 50.0, 0.05)
OMEGA = 2.0 * np.pi * LINES
OWN = 2.0 * np.pi * 33.0
ACCELERANCE = -(OMEGA**2) / (OWN**2 - OMEGA**2 + 0.02j * OWN * OMEGA) / 2.0
RECEPTANCE = ACCELERANCE / -(OMEGA**2)


def imported(path: Path, **segment: Any) -> ImportedRun:
    """A file imported by the sidecar that it proposes, with answers."""
    (text,) = sidecar_templates(path)
    values = yaml.safe_load(text)
    for entry in values["segments"]:
        entry |= segment
    sidecar = path.with_suffix(".yaml")
    sidecar.write_text(yaml.safe_dump(values, allow_unicode=True), encoding="utf-8")
    return read_import(sidecar)


def table(path: Path, head: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=head, comments="", fmt="%.9g", encoding="utf-8")
    return path


HEADINGS = {
    "kHz": ("Frequency [kHz],Real [(m/s^2)/N],Imag [(m/s^2)/N]", LINES / 1e3, 1.0),
    "DIN": ("f / Hz,Re(H) / (mm/s²/N),Im(H) / (mm/s²/N)", LINES, 1e3),
    "turns": ("Speed [rpm],Re [g/N],Im [g/N]", 60.0 * LINES, 1.0 / 9.80665),
}


@pytest.mark.parametrize("name", list(HEADINGS))
def test_units_of_a_heading_are_those_of_the_responses(name: str, tmp_path: Path) -> None:
    head, frequency, factor = HEADINGS[name]
    path = table(tmp_path / "h.csv", head, frequency, factor * ACCELERANCE.real, factor * ACCELERANCE.imag)
    (found,) = imported(path).tables
    np.testing.assert_allclose(found.columns["frequency_hz"], LINES, rtol=1e-8)
    np.testing.assert_allclose(found.responses, ACCELERANCE, rtol=1e-7, atol=1e-9)
    with pytest.raises(BenchError, match="by its heading, in m/N by the sidecar"):
        imported(path, unit="m/N")


def test_magnitude_over_angular_frequency_with_a_lag(tmp_path: Path) -> None:
    lag = -np.degrees(np.angle(RECEPTANCE))
    path = table(tmp_path / "h.csv", "omega [rad/s],|H| [mm/N],phase lag [deg]", OMEGA, 1e3 * abs(RECEPTANCE), lag)
    (found,) = imported(path).tables
    np.testing.assert_allclose(found.responses, RECEPTANCE, rtol=1e-6)


@pytest.mark.parametrize(
    ("head", "answer"),
    [("Magnitude (dB)", {"unit": "mm/s^2/N"}), ("Mag_dB", {"unit": "mm/s^2/N"}), ("Magnitude [dB re 1 mm/s²/N]", {})],
)
def test_magnitudes_in_db_are_amplitudes(head: str, answer: dict[str, str], tmp_path: Path) -> None:
    decibel, phase = 20.0 * np.log10(1e3 * abs(ACCELERANCE)), np.degrees(np.angle(ACCELERANCE))
    assert decibel.min() > 0.0
    run = imported(table(tmp_path / "h.csv", f"Frequency (Hz),{head},Phase (deg)", LINES, decibel, phase), **answer)
    np.testing.assert_allclose(run.tables[0].responses, ACCELERANCE, rtol=1e-6)
    assert any("in dB (20 log" in note for note in run.notes)


def test_responses_of_a_matlab_array_of_three_dimensions(tmp_path: Path) -> None:
    matrix = np.stack([np.stack([(1 + i + 2 * j) * ACCELERANCE for j in range(2)], 1) for i in range(2)], 1)
    savemat(tmp_path / "h.mat", {"FRF": matrix, "freq": LINES[:, None], "Fs": 2000.0})
    tables = imported(tmp_path / "h.mat", unit="m/s^2/N").tables
    assert [(one.point, one.drive_point) for one in tables] == [(1, 1), (1, 2), (2, 1), (2, 2)]
    np.testing.assert_allclose(tables[2].responses, 2.0 * ACCELERANCE)


def test_loss_and_quality_factors_and_peak_to_peak(tmp_path: Path) -> None:
    size = np.linspace(0.1, 2.0, 15)
    frequency, damping = np.sqrt(900.0 + 40.0 * size**2), np.full(15, 0.004)
    for head, values in (
        ("loss_factor", 2.0 * damping),
        ("Q", 0.5 / damping),
        ("zeta (%)", 100.0 * damping),
        ("zeta_percent", 100.0 * damping),
    ):
        (found,) = imported(
            table(tmp_path / "b.csv", f"freq_Hz,disp_pp_mm,{head}", frequency, 2.0 * size, values)
        ).tables
        np.testing.assert_allclose(found.columns["amplitude"], 1e-3 * size, rtol=1e-8)
        np.testing.assert_allclose(found.columns["damping_ratio"], damping, rtol=1e-6)
    sidecar = tmp_path / "b.yaml"
    values = yaml.safe_load(sidecar.read_text())
    del values["segments"][0]["amplitudes"]
    sidecar.write_text(yaml.safe_dump(values))
    with pytest.raises(BenchError, match=r"disp_pp_mm .* 'amplitudes: peak_to_peak'"):
        read_import(sidecar)


@pytest.mark.parametrize("head", ["Inertance (g/N)", "Amplitude (g/N)", "Betrag / g/N"])
def test_a_column_per_force_is_a_response_whatever_its_name(head: str, tmp_path: Path) -> None:
    size, phase = abs(ACCELERANCE) / 9.80665, np.degrees(np.angle(ACCELERANCE))
    (found,) = imported(table(tmp_path / "h.csv", f"Frequency (Hz),{head},Phase (deg)", LINES, size, phase)).tables
    np.testing.assert_allclose(found.responses, ACCELERANCE, rtol=1e-6)


def test_an_amplitude_that_no_name_tells_is_asked_about(tmp_path: Path) -> None:
    path = table(tmp_path / "b.csv", "freq_Hz,foo,bar", LINES, LINES, LINES)
    (text,) = sidecar_templates(path)
    assert yaml.safe_load(text)["segments"][0]["columns"]["amplitude"] == "?"


def response(point: int, direction: int, values: np.ndarray, unit: str = "m/s^2", below: str = "N") -> uff.UffFunction:
    return uff.UffFunction(
        uff.FREQUENCY_RESPONSE, values, LINES[0], LINES[1] - LINES[0], response_node=point,
        response_direction=direction, reference_node=1, reference_direction=3,
        abscissa_axis=uff.Axis(uff.FREQUENCY, "Frequency", "Hz"),
        ordinate_axis=uff.Axis(uff.ACCELERATION, "Acc", unit), denominator_axis=uff.Axis(uff.FORCE, "Force", below),
    )  # fmt: skip


def test_a_negative_direction_turns_the_dataset_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "h.uff"
    uff.write_uff(path, [response(1, 3, ACCELERANCE), response(2, -3, -ACCELERANCE)])
    run = imported(path)
    for found in run.tables:
        np.testing.assert_allclose(found.responses, ACCELERANCE)
    assert any("dataset 2" in note and "−Z over +Z" in note for note in run.notes)
    np.testing.assert_allclose(imported(path, turned=[]).tables[1].responses, -ACCELERANCE)
    with pytest.raises(BenchError, match=r"dataset 2 .*turned: \[2\]"):
        imported(path, scale=-1.0)


def test_a_drive_point_of_the_wrong_sign_is_turned_for_its_point_alone(tmp_path: Path) -> None:
    path = tmp_path / "h.uff"
    uff.write_uff(path, [response(1, 3, -ACCELERANCE), response(2, 3, ACCELERANCE)])
    (text,) = sidecar_templates(path)
    assert yaml.safe_load(text)["segments"][0]["turned"] == "?"
    assert "dataset 1 of h.uff: at the resonance" in text
    with pytest.raises(BenchError, match=r"dataset 1 of h.uff.*'turned: \[1\]'"):
        imported(path, turned=None)
    for found in imported(path, turned=[1]).tables:
        np.testing.assert_allclose(found.responses, ACCELERANCE)


def test_the_axes_of_a_dataset_tell_its_unit(tmp_path: Path) -> None:
    path = tmp_path / "h.uff"
    uff.write_uff(path, [response(1, 3, ACCELERANCE / 9.80665 * 4.4482216152605, "g", "lbf")])
    np.testing.assert_allclose(imported(path).tables[0].responses, ACCELERANCE)
    with pytest.raises(BenchError, match="in g/lbf by the file, but in m/s\\^2/N by the sidecar"):
        imported(path, unit="m/s^2/N")
    assert abs(imported(path, unit="m/s^2/N", scale=1.0).tables[0].responses).max() < 12.0


def test_zeros_that_fill_the_last_line_are_no_values(tmp_path: Path) -> None:
    path = tmp_path / "h.uff"
    uff.write_uff(path, [response(1, 3, ACCELERANCE[:-1])], binary=False)
    text = path.read_text().splitlines()
    last = max(k for k, line in enumerate(text) if "E" in line)
    text[last] = text[last].rstrip() + f"{0.0:20.12E}" * (4 - len(text[last].split()))
    path.write_text("\n".join(text) + "\n")
    np.testing.assert_allclose(imported(path).tables[0].responses, ACCELERANCE[:-1], rtol=1e-11)


def test_time_data_have_the_sign_of_their_direction_and_the_unit_of_their_abscissa(tmp_path: Path) -> None:
    path, count = tmp_path / "t.uff", 4000
    rng = np.random.default_rng(0)
    functions = [
        uff.UffFunction(
            uff.TIME_RESPONSE, sign * rng.normal(size=count), 0.0, 0.5, lines=(name, *["NONE"] * 4), response_node=7,
            response_direction=3 * sign, abscissa_axis=uff.Axis(uff.TIME, "Time", "ms"),
            ordinate_axis=uff.Axis(kind, name, unit),
        )
        for name, kind, unit, sign in (("force", uff.FORCE, "N", 1), ("acc", uff.ACCELERATION, "m/s^2", -1))
    ]  # fmt: skip
    uff.write_uff(path, functions)
    (text,) = sidecar_templates(path)
    values = yaml.safe_load(text)
    assert [channel["point"] for channel in values["channels"]] == [7, 7]
    sidecar = tmp_path / "t.yaml"
    sidecar.write_text(text)
    run = read_import(sidecar)
    assert run.sample_rate == 2000.0
    np.testing.assert_array_equal(run.channels[1].data, -functions[1].values)
    values["channels"][1] = {**{k: v for k, v in values["channels"][1].items() if k != "sign"}, "scale": -1.0}
    sidecar.write_text(yaml.safe_dump(values))
    with pytest.raises(BenchError, match=r"direction −Z of dataset 2 .*'sign: -1'"):
        read_import(sidecar)
    values["channels"][1] |= {"sign": 1}
    sidecar.write_text(yaml.safe_dump(values))
    np.testing.assert_array_equal(read_import(sidecar).channels[1].data, -functions[1].values)


def test_packed_numbers_of_netcdf_are_unpacked_and_fill_values_missing(tmp_path: Path) -> None:
    time = np.arange(3000) / 1000.0
    wave = 4.0 * np.exp(-0.6 * time) * np.cos(2.0 * np.pi * 21.0 * time)
    packed = np.round((wave - 0.5) / 2e-4).astype(np.int16)
    packed[500:503] = -32768
    with h5py.File(tmp_path / "p.nc", "w") as file:
        file["time"], file["acc"] = time, packed
        file["time"].attrs["units"] = "seconds since 2025-01-01"
        file["acc"].attrs.update(scale_factor=2e-4, add_offset=0.5, units="m s-2", _FillValue=np.int16(-32768))
    run = imported(tmp_path / "p.nc")
    (channel,) = run.channels
    assert channel.quantity is Quantity.ACCELERATION
    assert np.isnan(channel.data[500:503]).all()
    good = np.isfinite(channel.data)
    np.testing.assert_allclose(channel.data[good], wave[good], atol=1.01e-4)
    assert good.sum() == 2997
    assert any("3 values of acc" in note for note in run.notes)


def test_a_delay_of_a_channel_is_taken_out(tmp_path: Path) -> None:
    rate, count, late = 2000.0, 4000, 0.00137
    time = np.arange(count) / rate
    late_wave = np.sin(2.0 * np.pi * 83.0 * (time - late))
    np.savez(tmp_path / "d.npz", sample_rate=rate, a=late_wave)
    side = {
        "file": "d.npz",
        "channels": [{"column": "a", "quantity": "acceleration", "unit": "m/s^2", "point": 1, "delay_s": late}],
        "segments": [{"kind": "record", "start": 0.0, "stop": 1.9}],
    }
    (tmp_path / "d.yaml").write_text(yaml.safe_dump(side))
    found = read_import(tmp_path / "d.yaml").channels[0].data
    inner = slice(40, -40)
    np.testing.assert_allclose(found[inner], np.sin(2.0 * np.pi * 83.0 * time)[inner], atol=1e-4)
    assert np.isnan(found[-3:]).all()
