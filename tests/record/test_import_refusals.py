"""Imports that must not pass: each is refused with one sentence that says what, where and how to fix it."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record.foreign_data import RATE, recording, sidecar, write, write_csv, write_sidecar

from nmt_core.errors import BenchError
from nmt_record.exchange.arrays import uff
from nmt_record.exchange.imports.imported_run import read_import

Case = Callable[[Path], Path]


def of_sidecar(change: Callable[[dict[str, Any]], None]) -> Case:
    def make(folder: Path) -> Path:
        values = copy.deepcopy(sidecar())
        change(values)
        return write(folder, values)

    return make


def of_data(change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray] | None], **changes: Any) -> Case:
    def make(folder: Path) -> Path:
        data = recording()
        return write(folder, sidecar(**changes), change(data) or data)

    return make


def of_text(change: Callable[[str], str], **options: Any) -> Case:
    return lambda folder: write_csv(folder, change=change, **options)


def of_bytes(name: str, content: bytes) -> Case:
    def make(folder: Path) -> Path:
        path = write(folder, sidecar(file=name))
        (folder / name).write_bytes(content)
        return path

    return make


def with_time(times: Callable[[np.ndarray], np.ndarray], **changes: Any) -> Case:
    def make(folder: Path) -> Path:
        data = recording()
        grid = np.arange(data["f"].size) / RATE
        return write(folder, sidecar(**changes), {"time": times(grid), **data})

    return make


def exchanged(data: dict[str, np.ndarray], one: str, other: str) -> dict[str, np.ndarray]:
    return {**data, one: data[other], other: data[one]}


def set_item(*path: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(values: dict[str, Any]) -> None:
        target: Any = values
        for part in path[:-1]:
            target = target[part]
        if value is None:
            del target[path[-1]]
        else:
            target[path[-1]] = value

    return change


def line(number: int, old: str, new: str, count: int = 1) -> Callable[[str], str]:
    def change(text: str) -> str:
        lines = text.split("\n")
        assert old in lines[number - 1]
        lines[number - 1] = lines[number - 1].replace(old, new, count)
        return "\n".join(lines)

    return change


def insert(number: int, what: Callable[[list[str]], str]) -> Callable[[str], str]:
    def change(text: str) -> str:
        lines = text.split("\n")
        lines.insert(number - 1, what(lines))
        return "\n".join(lines)

    return change


def a_list(folder: Path) -> Path:
    path = write(folder)
    path.write_text("- 1\n")
    return path


def stepped(grid: np.ndarray) -> np.ndarray:
    half = grid.size // 2
    return np.concatenate((grid[:half], grid[half] + np.arange(grid.size - half) * 1.5 / RATE))


def uff_file(spoil: Callable[[bytes], bytes] = lambda data: data, binary: bool = True, **changes: Any) -> Case:
    def make(folder: Path) -> Path:
        path = write(folder, sidecar(file="data.uff"))
        functions = []
        for name, values in recording().items():
            settings: dict[str, Any] = {
                "function_type": 1,
                "values": values,
                "abscissa_increment": 1 / RATE,
                "lines": (name,),
                "abscissa_axis": uff.Axis(uff.TIME, "Time", "s"),
                **changes,
            }
            functions.append(uff.UffFunction(**settings))
        uff.write_uff(folder / "data.uff", functions, binary)
        (folder / "data.uff").write_bytes(spoil((folder / "data.uff").read_bytes()))
        return path

    return make


CASES: dict[str, tuple[Case, str]] = {
    # what the sidecar says
    "unit missing": (
        of_sidecar(set_item("channels", 1, "unit", value=None)),
        r"line \d+: channels\.1\.unit is "
        "missing",
    ),
    "unit empty": (of_sidecar(set_item("channels", 1, "unit", value="")), r"line \d+: column f has no unit"),
    "unit unknown": (of_sidecar(set_item("channels", 1, "unit", value="Nx")), "unknown unit 'Nx'.*kN"),
    "unit of a torque": (of_sidecar(set_item("channels", 1, "unit", value="Nm")), "one of torque; .*quantity: torque"),
    "unit of another quantity": (of_sidecar(set_item("channels", 1, "unit", value="g")), "force.*unit g.*acceleration"),
    "sensor output in mV": (of_sidecar(set_item("channels", 2, "unit", value="mV")), r"'scale: …' .*m/s\^2 per mV"),
    "counts without scale": (of_sidecar(set_item("channels", 1, "unit", value="counts")), "raw counts.*scale"),
    "unknown key": (of_sidecar(set_item("channels", 0, "sensitivty", value=3)), r"line \d+: unknown key.*sensitivty"),
    "misspelt key": (of_sidecar(set_item("segmnets", value=[])), "segmnets; did you mean segments"),
    "unknown quantity": (of_sidecar(set_item("channels", 0, "quantity", value="forse")), "must be 'force'"),
    "unknown kind": (of_sidecar(set_item("segments", 0, "kind", value="random_walk")), "kind must be.*random_walk"),
    "no channels": (of_sidecar(set_item("channels", value=[])), "neither channels nor"),
    "no rate and no time": (of_sidecar(set_item("sample_rate", value=None)), "sample_rate: … in Hz or time: …"),
    "point of 20 digits": (of_sidecar(set_item("channels", 0, "point", value=10**20)), "point must be at most"),
    "delay of ages": (of_sidecar(set_item("channels", 0, "delay_s", value=1e29)), "delay_s must be at most 10"),
    "rate zero": (of_sidecar(set_item("sample_rate", value=0)), "sample_rate must be positive"),
    "rate not finite": (
        of_sidecar(set_item("sample_rate", value=float("nan"))),
        "sample_rate.*finite|sample_rate must",
    ),
    "rate with a comma": (of_sidecar(set_item("sample_rate", value="2000,5")), "decimal sign as a point"),
    "scale zero": (of_sidecar(set_item("channels", 1, "scale", value=0)), "scale of column f is zero"),
    "no such column": (
        of_sidecar(set_item("channels", 1, "column", value="force")),
        "no column force; it has u, f, a2, a4",
    ),
    "no such number": (of_sidecar(set_item("channels", 1, "column", value=9)), "4 columns, so there is no column 9"),
    "a number before the first": (
        of_sidecar(lambda values: values.update(time=-4)),
        "4 columns, so there is no column -4",
    ),
    "column zero": (of_sidecar(set_item("channels", 1, "column", value=0)), "counted from 1"),
    "column twice": (of_sidecar(set_item("channels", 3, "column", value="a2")), "column a2 is given twice"),
    "column twice by number": (of_sidecar(set_item("channels", 3, "column", value=3)), "both take column a2"),
    "two channels for one point": (
        of_sidecar(set_item("channels", 3, "point", value=2)),
        "both measure acceleration at point 2",
    ),
    "file missing": (of_sidecar(set_item("file", value="other.npz")), r"line \d+: there is no file .*other\.npz"),
    "linear missing": (of_sidecar(set_item("linear", value="lin.json")), r"there is no file .*lin\.json"),
    "segment outside": (
        of_sidecar(set_item("segments", 1, "stop", value=60.0)),
        "reaches from 3 to 60 s, but the data from 0 to 6",
    ),
    "segment negative": (of_sidecar(set_item("segments", 0, "start", value=-1.0)), "but the data from 0 to"),
    "segment backwards": (of_sidecar(set_item("segments", 1, "stop", value=1.0)), "not after its start"),
    "segments overlap": (of_sidecar(set_item("segments", 1, "start", value=2.0)), "must not overlap"),
    "window outside": (of_sidecar(set_item("segments", 1, "window", value=[2.0, 5.0])), "not within its 3 to 6 s"),
    "window backwards": (of_sidecar(set_item("segments", 1, "window", value=[5.0, 4.0])), "not after its begin"),
    "window of one time": (
        of_sidecar(set_item("segments", 1, "window", value=[5.0])),
        "window.*(few entries|at least 2)",
    ),
    "no window": (of_sidecar(set_item("segments", 1, "window", value=None)), "needs window: .*locked: false"),
    "a list": (a_list, "mapping"),
    # swapped and doubled columns
    "force and acceleration swapped": (
        of_data(lambda d: exchanged(d, "f", "a2")),
        "power factor -.*swapped.*scale: -1",
    ),
    "sensor upside down": (of_data(lambda d: {**d, "a2": -d["a2"]}), "wrong sign"),
    "same numbers twice": (of_data(lambda d: {**d, "a4": d["a2"]}), "a2 and a4 hold the same numbers"),
    "counts": (of_data(lambda d: {**d, "a2": np.round(d["a2"] * 3000)}), "looks like raw counts.*scale"),
    "mostly missing": (
        of_data(lambda d: {**d, "a2": np.where(np.arange(d["a2"].size) % 3, np.nan, 1.0)}),
        "are missing",
    ),
    "infinite": (
        of_data(lambda d: {**d, "a2": np.where(np.arange(d["a2"].size) == 7, np.inf, d["a2"])}),
        "infinite at sample 7",
    ),
    "unequal lengths": (of_data(lambda d: {**d, "a2": d["a2"][:-5]}), "unequal lengths"),
    "complex": (of_data(lambda d: {**d, "a2": d["a2"] + 1j}), "complex128; real numbers"),
    "matrix": (of_data(lambda d: {**d, "a2": d["a2"].reshape(-1, 2)}), "shape .* array of its own"),
    "objects": (of_data(lambda d: {**d, "a2": np.array([None] * 9)}), "plain numbers"),
    "rate in the file": (of_data(lambda d: {**d, "sample_rate": np.array(4000.0)}), "itself says 4000 Hz"),
    # clocks
    "two rates": (with_time(stepped, sample_rate=None), "not uniform.*two clocks or rates"),
    "time jumps back": (with_time(lambda t: t % 3.0, sample_rate=None), "jumps back from 2.9995 to 0"),
    "time stands still": (with_time(lambda t: np.round(t, 2), sample_rate=None), "stands still.*more digits"),
    "time with a hole that is not a sample": (with_time(lambda t: t + 0.0003 * (t > 2)), "not uniform|rate changes"),
    "drifting clock": (with_time(lambda t: t + 1e-4 * t**2, sample_rate=None), "rate changes|not uniform"),
    "wrong rate": (with_time(lambda t: t, sample_rate=4000.0), "sample_rate is 4000 Hz, but column time"),
    "time in ms": (with_time(lambda t: 1e3 * t), r"steps of 0\.5 s .*unit of the time"),
    "time missing": (with_time(lambda t: np.where(t == 1.0, np.nan, t)), "time is missing at sample 2000"),
    "time is a channel": (with_time(lambda t: t, time="f"), "named as time and as a channel"),
    "every second sample missing from the middle": (
        with_time(lambda t: np.where(t < 3.0, t, 2 * t - 3.0), sample_rate=None),
        "not uniform.*two clocks",
    ),
    "two time columns": (
        lambda f: write(
            f, sidecar(), {"time_f": np.arange(12000) / RATE, "time_a": np.arange(12000) / 1999.0, **recording()}
        ),
        "two clocks, the columns time_f and time_a",
    ),
    "two time columns with numbers": (
        lambda f: write(f, sidecar(), {"t1": np.arange(12000) / RATE, "t2": np.arange(12000) / 1999.0, **recording()}),
        "two clocks, the columns t1 and t2",
    ),
    "a second time column beside the named one": (
        lambda f: write(
            f,
            sidecar(time="time"),
            {"time": np.arange(12000) / RATE, "time.1": np.arange(12000) / 1999.0, **recording()},
        ),
        "two clocks, the columns time and time.1",
    ),
    # CSV
    "csv empty": (of_bytes("data.csv", b"  \n"), "data.csv is empty"),
    "csv only a header": (of_bytes("data.csv", b"u,f,a2,a4\n"), "no line of numbers"),
    "csv comma decimals": (
        of_text(lambda t: t.replace(".", ",")),
        "decimal|text in a column|values instead|column names but",
    ),
    "csv a comma among points": (of_text(line(9, ".", ","), delimiter=";"), "line 9: column u.*decimal comma among"),
    "csv number beyond all numbers": (
        of_text(insert(30, lambda lines: "1;2;1.5e999;4"), delimiter=";"),
        r"line 30: column a2 is infinite \(1\.5e999\)",
    ),
    "csv text": (
        of_text(insert(30, lambda lines: "1;2;overload;4"), delimiter=";"),
        "line 30: column a2 has 'overload'",
    ),
    "csv row too short": (
        of_text(insert(30, lambda lines: "1;2;3"), delimiter=";"),
        "line 30 has 3 values instead of 4",
    ),
    "csv row too long": (
        of_text(insert(30, lambda lines: "1;2;3;4;5"), delimiter=";"),
        "line 30 has 5 values instead of 4",
    ),
    "csv cut off": (of_text(lambda t: t[:-30]), "(cut off|instead of 4)"),
    "csv header in the middle": (of_text(insert(5000, lambda lines: lines[0])), "header .* repeated .*line 5"),
    "csv infinite": (of_text(insert(30, lambda lines: "1;2;inf;4"), delimiter=";"), "line 30: column a2 is infinite"),
    "csv name twice": (of_text(line(1, "a4", "a2")), "2 columns named a2 .*number|no column a4"),
    "csv unit contradicts": (of_text(line(1, "f", "f [kN]")), "unit kN by the file, but N"),
    "csv names swapped": (
        lambda f: write_csv(
            f,
            dict(zip(("u", "acc", "force", "a4"), recording().values(), strict=True)),
            values={
                **sidecar(),
                "channels": [
                    {"column": "acc", "quantity": "force", "unit": "N", "point": 2},
                    {"column": "force", "quantity": "acceleration", "unit": "m/s^2", "point": 2},
                ],
            },
        ),
        "called like an acceleration",
    ),
    "spreadsheet": (of_bytes("data.csv", b"PK\x03\x04" + bytes(100)), "spreadsheet.*save the table as CSV"),
    "matlab": (of_bytes("data.mat", b"MATLAB 5.0 MAT-file" + bytes(100)), "cut off or damaged"),
    "unknown ending": (of_bytes("data.wav", b"RIFF" + bytes(100)), "unknown ending '.wav'"),
    "binary csv": (of_bytes("data.csv", bytes(range(256)) * 9), "zero bytes"),
    # NPZ and UFF
    "npz cut off": (of_bytes("data.npz", b"PK\x03\x04" + bytes(300)), "cut off or damaged"),
    "npz that is text": (of_bytes("data.npz", b"1,2,3\n"), "is not an NPZ file"),
    "uff that is text": (of_bytes("data.uff", b"1,2,3\n"), "is not a universal file"),
    "uff cut off": (uff_file(lambda data: data[:-5000]), "Dataset 4 of data.uff is cut off"),
    "uff ascii cut off": (uff_file(lambda data: data[:-5000], binary=False), "Dataset 4 .* cut off"),
    "uff cut in a header": (uff_file(lambda data: data[:500]), "Dataset 1 .*(cut off|header)"),
    "uff bytes lost in the middle": (
        uff_file(lambda data: data[:5000] + data[5008:]),
        "Dataset 1 .*does not end|damaged",
    ),
    "uff of spectra": (uff_file(function_type=2), "no time data but auto spectrum"),
    "uff with another rate": (uff_file(abscissa_increment=1e-3), "sample_rate is 2000 Hz, but data.uff says 1000"),
    "uff of another quantity": (
        uff_file(ordinate_axis=uff.Axis(uff.ACCELERATION, "Acceleration", "m/s^2")),
        "acceleration by its dataset|unit m/s.2 by the file",
    ),
    "uff uneven": (uff_file(abscissa=stepped(np.arange(12000) / RATE)), "not uniform|stands still"),
    "uff not finite": (uff_file(values=np.full(12000, np.inf)), "infinite"),
}


@pytest.mark.parametrize("name", sorted(CASES))
def test_it_is_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    make, sentence = CASES[name]
    path = make(tmp_path)
    with pytest.raises(BenchError) as refusal:
        read_import(path)
    text = str(refusal.value)
    assert re.search(sentence, text), text
    assert "\n" not in text
    assert len(text) < 420


def test_the_unspoilt_recording_passes_without_a_note(tmp_path: Path) -> None:
    assert read_import(write(tmp_path)).notes == []
    assert read_import(write_csv(tmp_path)).notes == []
    assert read_import(uff_file()(tmp_path)).notes == []


def test_no_sidecar(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"The YAML sidecar .* cannot be read"):
        read_import(tmp_path / "sidecar.yaml")


def test_a_sidecar_with_nothing_in_it(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="file"):
        read_import(write_sidecar(tmp_path, {"sample_rate": 1.0}))
