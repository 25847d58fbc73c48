"""Texts of loggers, spreadsheets and oscilloscopes: what their lines, headings and stamps say is read."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml

from nmt_core.errors import BenchError
from nmt_record.exchange.import_table import read_table
from nmt_record.exchange.imports.imported_run import ImportedRun, read_import
from nmt_record.exchange.templates.sidecar_template import sidecar_templates
from nmt_record.exchange.text import text_table
from nmt_record.exchange.text.text_table import read_text_table

RATE, COUNT = 1000.0, 3000
TIME = np.arange(COUNT) / RATE
WAVE = np.round(4.0 * np.exp(-0.6 * TIME) * np.cos(2.0 * np.pi * 21.0 * TIME), 5)
BEGIN = datetime.datetime(2025, 3, 4, 12, 59, 58)
MOMENTS = [BEGIN + datetime.timedelta(milliseconds=k) for k in range(COUNT)]


def proposed(path: Path, lines: Sequence[str]) -> ImportedRun:
    """The file imported by the sidecar that it proposes."""
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    (text,) = sidecar_templates(path)
    sidecar = path.with_suffix(".yaml")
    sidecar.write_text(text, encoding="utf-8")
    return read_import(sidecar)


def rows(first: Callable[[int], str], head: str = "Time,Acc (m/s^2)") -> list[str]:
    return [head, *(f"{first(k)},{WAVE[k]:.5f}" for k in range(COUNT))]


def half_day(k: int) -> str:
    return f"{MOMENTS[k]:%m/%d/%Y %I:%M:%S}.{MOMENTS[k].microsecond // 1000:03d} {MOMENTS[k]:%p}"


def two_columns(k: int) -> str:
    return f"{MOMENTS[k]:%Y-%m-%d},{MOMENTS[k]:%H:%M:%S.%f}"


CLOCKS = {
    "am and pm": rows(half_day),
    "colon before milliseconds": rows(lambda k: f"{MOMENTS[k]:%H:%M:%S}:{MOMENTS[k].microsecond // 1000:03d}"),
    "date and time apart": rows(two_columns, "Date,Time,Acc (m/s^2)"),
    "month by its name": rows(lambda k: f"{MOMENTS[k]:%d-%b-%Y %H:%M:%S.%f}"),
    "minutes and seconds": rows(lambda k: f"{MOMENTS[k]:%M:%S.%f}"),
    "days of MATLAB": rows(lambda k: f"{739580.4371527 + TIME[k] / 86400:.11f}"),
    "days of a spreadsheet": rows(lambda k: f"{45987.5 + TIME[k] / 86400:.10f}", "Datum,Acc (m/s^2)"),
    "hours": rows(lambda k: f"{TIME[k] / 3600:.10f}", "Time (h),Acc (m/s^2)"),
    "seconds and nanoseconds": rows(
        lambda k: f"{1764064800 + k // 1000},{k % 1000 * 1_000_000},base_link",
        "stamp.sec,stamp.nanosec,frame,Acc (m/s^2)",
    ),
    "a counter that begins again": rows(lambda k: str((2**32 - 700_000 + 1000 * k) % 2**32), "micros,Acc (m/s^2)"),
    "DIN": rows(lambda k: f"{TIME[k]:.4f}", "t / s,a / m/s²"),
    "after a comma": rows(lambda k: f"{TIME[k]:.4f}", '"Time, s","Acc, m/s^2"'),
}


@pytest.mark.parametrize("clock", list(CLOCKS))
def test_a_clock_is_read_as_it_is_written(clock: str, tmp_path: Path) -> None:
    run = proposed(tmp_path / "a.csv", CLOCKS[clock])
    assert run.sample_rate == pytest.approx(RATE, rel=3.0 * max(run.clock_std, 1e-7))
    assert run.clock_std < 1e-4
    np.testing.assert_allclose(run.channels[0].data, WAVE)


def test_rows_that_stand_newest_first_are_turned_with_a_sentence(tmp_path: Path) -> None:
    lines = rows(lambda k: f"{1764064800 + TIME[k]:.3f}")
    run = proposed(tmp_path / "a.csv", [lines[0], *lines[:0:-1]])
    assert run.sample_rate == pytest.approx(RATE)
    np.testing.assert_allclose(run.channels[0].data, WAVE)
    assert any("newest first" in note for note in run.notes)


def test_a_number_that_may_be_days_is_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("\n".join(rows(lambda k: f"{45987.5 + 1e-4 * k:.6f}", "Time,Acc (m/s^2)")))
    (text,) = sidecar_templates(path)
    assert yaml.safe_load(text)["time_unit"] == "?"
    assert "may be a number of days" in text


def test_thousands_and_quotes_are_read(tmp_path: Path) -> None:
    lines = [f'"{1000.0 * TIME[k]:,.1f}","{1000.0 * WAVE[k]:,.2f}"' for k in range(COUNT)]
    run = proposed(tmp_path / "a.csv", ['"Time (ms)","Acc (mm/s^2)"', *lines])
    np.testing.assert_allclose(run.channels[0].data, WAVE, atol=6e-6)
    german = [
        f"{1000.0 * TIME[k]:,.1f};{1000.0 * WAVE[k]:,.2f}".translate(str.maketrans(",.", ".,")) for k in range(COUNT)
    ]
    run = proposed(tmp_path / "b.csv", ["Zeit (ms);Acc (mm/s^2)", *german])
    np.testing.assert_allclose(run.channels[0].data, WAVE, atol=6e-6)


def test_a_quoted_comma_that_may_be_either_is_asked_about(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        '"a","b"\n' + "".join(f'"{k},{k + 111}","{k + 1},{k + 222}"\n' for k in range(1, 300))
    )
    with pytest.raises(BenchError, match="decimals or thousands"):
        read_table(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text('"a","b"\n' + "".join(f'"{k},{k % 10}","0,{k % 7}"\n' for k in range(300)))
    np.testing.assert_allclose(
        read_table(tmp_path / "b.csv").columns[0][:12], [0, 1.1, 2.2, 3.3, 4.4, 5.5, 6.6, 7.7, 8.8, 9.9, 10, 11.1]
    )


def test_columns_of_words_are_left_out_with_a_sentence(tmp_path: Path) -> None:
    run = proposed(tmp_path / "a.csv", rows(lambda k: f"{TIME[k]:.3f},imu link", "Time (s),frame,Acc (m/s^2)"))
    np.testing.assert_allclose(run.channels[0].data, WAVE)
    assert any("Column frame" in note and "words" in note for note in run.notes)
    assert read_table(tmp_path / "a.csv").index("Acc (m/s^2)", "") == 2  # numbers of columns are those of the file


def test_words_in_a_column_of_numbers_are_refused(tmp_path: Path) -> None:
    lines = rows(lambda k: f"{TIME[k]:.3f}")
    lines[1500] = lines[1500].split(",")[0] + ",error"
    with pytest.raises(BenchError, match=r"line 1501: column Acc .* 'error'"):
        proposed(tmp_path / "a.csv", lines)


def test_statistics_behind_the_numbers_are_left_out(tmp_path: Path) -> None:
    run = proposed(tmp_path / "a.csv", [*rows(lambda k: f"{TIME[k]:.3f}"), "", "Max,4.0", "Mean,0.00012"])
    assert run.samples == COUNT
    assert any("last 2 lines" in note and "Max, Mean" in note for note in run.notes)


def test_statistics_behind_a_column_of_words_are_left_out(tmp_path: Path) -> None:
    lines = rows(lambda k: f"ok,{TIME[k]:.3f}", "status,Time (s),Acc (m/s^2)")
    run = proposed(tmp_path / "a.csv", [*lines, "", "Max,2.999,4.0"])
    assert run.samples == COUNT


def test_channels_that_are_rows_are_turned(tmp_path: Path) -> None:
    lines = [
        "time_s," + ",".join(f"{value:.3f}" for value in TIME),
        "acc_m_s2," + ",".join(f"{value:.5f}" for value in WAVE),
    ]
    run = proposed(tmp_path / "a.csv", lines)
    assert run.sample_rate == pytest.approx(RATE)
    np.testing.assert_allclose(run.channels[0].data, WAVE)


def test_the_increment_of_an_oscilloscope_is_its_clock(tmp_path: Path) -> None:
    head = ["X,CH1,Start,Increment,", "Sequence,A,-3.000000e-01,5.000000e-04"]
    run = proposed(tmp_path / "a.csv", [*head, *(f"{k},{value:.5f},," for k, value in enumerate(WAVE))])
    assert run.sample_rate == 2000.0
    assert run.sidecar.segments[0].start == -0.3  # type: ignore[union-attr]
    np.testing.assert_allclose(run.channels[0].data, WAVE)


def counts(head: Sequence[str]) -> list[str]:
    return [*head, *(f"{round(value / 1e-3) - 512}" for value in WAVE)]


COUNTS_HEAD = ["# Sample rate (Hz): 1000", "# Scale: 1e-3 g/count", "# Offset: -512 counts", "acc_counts"]


def test_counts_are_scaled_as_the_heading_says(tmp_path: Path) -> None:
    run = proposed(tmp_path / "a.csv", counts(COUNTS_HEAD))
    np.testing.assert_allclose(run.channels[0].data, 9.80665 * WAVE, atol=0.51e-3 * 9.80665)


def test_a_scale_of_the_sidecar_that_differs_is_a_sentence(tmp_path: Path) -> None:
    run = proposed(tmp_path / "a.csv", counts(COUNTS_HEAD))
    sidecar = tmp_path / "a.yaml"
    values = yaml.safe_load(sidecar.read_text())
    values["channels"][0] |= {"scale": 2e-3}
    sidecar.write_text(yaml.safe_dump(values))
    other = read_import(sidecar)
    np.testing.assert_allclose(other.channels[0].data, 2.0 * run.channels[0].data - 1.024 * 9.80665, atol=1e-9)
    assert any("states the scale 0.001, the sidecar 0.002, which is used" in note for note in other.notes)


def test_a_unit_that_nobody_knows_is_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("\n".join(rows(lambda k: f"{TIME[k]:.3f}", "Time (s),Acc (furlong)")))
    (text,) = sidecar_templates(path)
    assert yaml.safe_load(text)["channels"][0]["unit"] == "?"
    assert "the file says 'furlong'" in text


@pytest.mark.parametrize("unit", ["degC", "°C", "K"])
def test_a_temperature_is_told_as_what_a_strength_may_follow(tmp_path: Path, unit: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text("\n".join(rows(lambda k: f"{TIME[k]:.3f}", f"Time (s),T ({unit})")))
    (text,) = sidecar_templates(path)
    assert f"the file says '{unit}': a strength may follow it as quantity: voltage, unit: V" in text


def test_a_name_that_may_be_two_quantities_follows_the_unit(tmp_path: Path) -> None:
    rate = np.gradient(WAVE) * RATE / 9806.65
    run = proposed(
        tmp_path / "a.csv",
        ["Time,Laser,Acc", "s,mm/s,g", *(f"{TIME[k]},{WAVE[k]},{rate[k]:.9g}" for k in range(COUNT))],
    )
    assert [channel.name for channel in run.channels] == ["v1", "a1"]


@pytest.mark.parametrize("seed", range(12))
def test_a_long_table_of_plain_numbers_is_that_of_its_lines(seed, tmp_path, monkeypatch):
    """Whatever its heading and delimiter, a text beyond the usual limit gives the same columns, names, units, lines."""
    generator = np.random.default_rng(seed)
    delimiter, end = generator.choice([",", ";", "\t"]), generator.choice(["\n", "\r\n"])
    values = generator.normal(size=(400, int(generator.integers(2, 6)))) * 10.0 ** generator.integers(-9, 6)
    values[:, 0] = np.arange(400) / 1000.0
    heads = ["time [s]", *(f"a{k} [m/s^2]" for k in range(1, values.shape[1]))]
    above = ["# a comment", "recorded by a program"][: int(generator.integers(0, 3))]
    lines = [*above, delimiter.join(heads), *(delimiter.join(map(repr, map(float, row))) for row in values)]
    path = tmp_path / "long.csv"
    path.write_bytes((end.join(lines) + end).encode())
    usual = read_text_table(path)
    monkeypatch.setattr(text_table, "_LARGEST", 4000)
    monkeypatch.setattr(text_table, "_HEAD", 3000)
    long = read_text_table(path)
    assert np.array_equal(long.columns, usual.columns)
    assert np.array_equal(np.array(long.columns).T, values)
    assert (long.names, long.units, long.notes) == (usual.names, usual.units, usual.notes)
    assert [long.lines(row) for row in (0, 17, 399)] == [usual.lines(row) for row in (0, 17, 399)]
    for broken in ("1,2", "x", "1,000.5;3"):
        path.write_bytes((end.join([*lines[:300], broken, *lines[300:]]) + end).encode())
        with pytest.raises(BenchError, match="plain numbers only") as caught:
            read_text_table(path)
        assert "\n" not in str(caught.value)
