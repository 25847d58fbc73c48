"""Two hundred made-up files: each is read right to its digits or asked about; none is read wrong in silence.

The generator knows the truth and answers the questions of the proposal as somebody who made the recording would.
"""

from __future__ import annotations

import datetime
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import yaml
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_record.exchange.imports.imported_run import read_import
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

FILES = 200
RATES = (50.0, 500.0, 1000.0, 1024.0, 1600.0, 2000.0, 4096.0, 10_000.0, 25_600.0, 44_100.0, 51_200.0)
UNITS = {
    "acceleration": (("m/s^2", 1.0), ("g", 9.80665), ("mm/s^2", 1e-3)),
    "velocity": (("m/s", 1.0), ("mm/s", 1e-3)),
    "displacement": (("mm", 1e-3), ("µm", 1e-6), ("m", 1.0)),
    "force": (("N", 1.0), ("kN", 1e3)),
}  # fmt: skip
KINDS = ("csv", "lvm", "npz", "mat", "h5", "tdms", "uff")
CLOCKS = (
    "s", "ms", "us", "rounded", "iso", "space", "zone", "day", "epoch", "header", "rate", "none", "index", "both",
    "contradiction", "rounded header",
)  # fmt: skip


@dataclass
class Made:
    """One file, and what is true of it."""

    path: Path
    rate: float
    clock: str
    quantity: str
    unit: str
    values: np.ndarray
    digits: float
    missing: np.ndarray
    answers: dict[str, Any] = field(default_factory=dict)


def column_of_time(clock: str, t: np.ndarray) -> tuple[str, list[str]]:
    """Heading and cells."""
    begin = datetime.datetime(2026, 3, 1, 23, 59, 59, 500000)
    if clock in ("iso", "space", "zone", "day"):
        stamps = [begin + datetime.timedelta(microseconds=round(1e6 * own)) for own in t]
        form = {"iso": "%Y-%m-%dT%H:%M:%S.%f", "space": "%Y-%m-%d %H:%M:%S.%f", "zone": "%Y-%m-%dT%H:%M:%S.%fZ",
                "day": "%d.%m.%Y %H:%M:%S.%f"}[clock]  # fmt: skip
        return "timestamp", [own.strftime(form) for own in stamps]
    if clock == "ms":
        return "Time (ms)", [f"{1e3 * own:.7f}" for own in t]
    if clock == "us":
        return "t_us", [f"{1e6 * own:.4f}" for own in t]
    if clock == "rounded":
        return "time", [f"{own:.3f}" for own in t]
    if clock == "epoch":
        return "time", [f"{1_764_064_800.25 + own:.6f}" for own in t]
    if clock == "index":
        return "t", [str(k) for k in range(t.size)]
    return "Time [s]", [f"{own:.9f}" for own in t]


def made(seed: int, folder: Path) -> Made:
    rng = np.random.default_rng(seed)
    kind, clock = KINDS[seed % len(KINDS)], CLOCKS[int(rng.integers(len(CLOCKS)))]
    if kind == "csv" or rng.random() < 0.3:
        kind = "csv"
    rate = float(RATES[int(rng.integers(len(RATES)))])
    quantity = str(rng.choice(list(UNITS)))
    unit, factor = UNITS[quantity][int(rng.integers(len(UNITS[quantity])))]
    count = int(rng.integers(300, 3000))
    t = np.arange(count) / rate
    wave = np.exp(-float(rng.choice([0.0, 2.0])) * t * rate / count) * np.sin(
        2 * math.pi * 0.04137 * np.arange(count) + 0.3
    )
    size = {"acceleration": 20.0, "velocity": 0.05, "displacement": 1e-4, "force": 30.0}[quantity]
    values = size * wave / factor
    digits = 10.0 ** -int(rng.integers(3, 7)) * size / factor
    decimals = max(0, round(-math.log10(digits)))
    values, digits = np.round(values, decimals), 10.0**-decimals
    missing = np.zeros(count, dtype=bool)
    path = folder / f"file{seed}.{kind if kind != 'h5' else rng.choice(['h5', 'nc4'])}"
    name = str(rng.choice(["sensor", f"{quantity}", "ch 1", "m_1"]))
    file = Made(path, rate, clock, quantity, unit, values, digits, missing)
    globals()[f"make_{kind}"](file, name, t, decimals, rng)
    return file


def make_csv(file: Made, name: str, t: np.ndarray, decimals: int, rng: np.random.Generator) -> None:
    delimiter, comma = [(",", False), (";", False), (";", True), ("\t", False), ("\t", True)][int(rng.integers(5))]
    head = str(rng.choice(["none", "one", "two", "long"]))
    cells = [f"{value:.{decimals}f}" for value in file.values]
    if rng.random() < 0.3:
        lost = rng.choice(file.values.size, 5, replace=False)
        file.missing[lost] = True
        for k in lost:
            cells[k] = str(rng.choice(["", "NaN"]))
    if comma:
        cells = [cell.replace(".", ",") for cell in cells]
    columns = [cells]
    label = {"one": f"{name} [{file.unit}]", "two": name, "long": f"{name} ({file.unit})"}.get(head, "")
    labels, units = [label], [file.unit]
    if file.clock not in ("none", "header", "rate", "rounded header"):
        title, times = column_of_time("s" if file.clock in ("both", "contradiction") else file.clock, t)
        columns.insert(
            0, [own.replace(".", ",") if comma and "-" not in own and ":" not in own else own for own in times]
        )
        found = re.match(r"(.*?) *[\[(](.*)[\])]", title)
        labels.insert(0, (found[1] if found else title) if head == "two" else title)
        units.insert(0, found[2] if found else "")
    lines = []
    stated = {"header": file.rate, "both": file.rate, "contradiction": 3.0 * file.rate}.get(file.clock)
    if stated is not None:
        lines.append(f"Sample rate: {stated:g} Hz")
        if file.clock == "contradiction":
            file.answers["clock"] = "column"
    elif file.clock == "rounded header":
        lines.append(f"Sampling interval: {1.0 / file.rate:.3g} s")
    if head == "long":
        lines += ["Recorded by: somebody", "Remarks: none"]
    if head != "none":
        lines.append(delimiter.join(labels))
    if head == "two":
        lines.append(delimiter.join(units))
    lines += [delimiter.join(row) for row in zip(*columns, strict=True)]
    encoding = str(rng.choice(["utf-8", "utf-8-sig", "cp1252"]))
    file.path.write_bytes(str(rng.choice(["\n", "\r\n"])).join([*lines, ""]).encode(encoding))


def make_lvm(file: Made, name: str, t: np.ndarray, decimals: int, rng: np.random.Generator) -> None:
    with_time = file.clock in ("s", "both", "contradiction", "ms", "iso", "epoch")
    step = f"{1.0 / file.rate:.9E}"
    if file.clock == "rounded header":
        step = f"{1.0 / file.rate:.6f}"
        with_time = False
        if not float(step) > 0.0 or abs(float(step) * file.rate - 1.0) > 5e-3:
            step = f"{1.0 / file.rate:.4E}"
    if file.clock == "contradiction":
        step = f"{1.0 / file.rate / 32.0:.9E}"
        file.answers["clock"] = "column"
    head = (
        f"LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
        f"Multi_Headings\tNo\nX_Columns\t{'One' if with_time else 'No'}\nTime_Pref\tRelative\nDate\t2026/01/01\n"
        f"Time\t10:00:00.0\n***End_of_Header***\t\n\t\nChannels\t1\t\nSamples\t{t.size}\t\nDate\t2026/01/01\t\n"
        f"Time\t10:00:00.0\t\nY_Unit_Label\t{file.unit}\t\nX_Dimension\tTime\t\nX0\t0.0\t\nDelta_X\t{step}\t\n"
        f"***End_of_Header***\t\t\nX_Value\t{name}\tComment\n"
    )
    rows = [
        f"{f'{own:.9f}' if with_time else ''}\t{value:.{decimals}f}" for own, value in zip(t, file.values, strict=True)
    ]
    file.path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")


def arrays_of(file: Made, t: np.ndarray) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Arrays and single numbers of a file of arrays."""
    scalars = {}
    arrays = {}
    if file.clock in ("header", "both", "iso", "space"):
        scalars["sample_rate"] = file.rate
    elif file.clock in ("rate", "zone"):
        scalars["dt"] = 1.0 / file.rate
    elif file.clock == "contradiction":
        scalars["fs"] = 2.5 * file.rate
        file.answers["clock"] = "column"
    if file.clock in ("s", "both", "contradiction", "day"):
        arrays["time"] = t
    elif file.clock == "ms":
        arrays["time_ms"] = 1e3 * t
    elif file.clock == "us":
        arrays["t_us"] = 1e6 * t
    elif file.clock == "rounded":
        arrays["time"] = np.round(t, 3)
    elif file.clock == "epoch":
        arrays["timestamp"] = 1_764_064_800.25 + t
    elif file.clock == "index":
        arrays["t"] = np.arange(t.size, dtype=float)
    return arrays, scalars


def make_npz(file: Made, name: str, t: np.ndarray, decimals: int, rng: np.random.Generator) -> None:
    arrays, scalars = arrays_of(file, t)
    np.savez(file.path, **arrays, **{key: np.array(value) for key, value in scalars.items()}, data=file.values)


def make_mat(file: Made, name: str, t: np.ndarray, decimals: int, rng: np.random.Generator) -> None:
    arrays, scalars = arrays_of(file, t)
    scipy.io.savemat(file.path, {**arrays, **scalars, "data": file.values})


def make_h5(file: Made, name: str, t: np.ndarray, decimals: int, rng: np.random.Generator) -> None:
    arrays, scalars = arrays_of(file, t)
    with h5py.File(file.path, "w") as handle:
        for key, array in arrays.items():
            handle[key] = array
        if file.clock in ("header", "none") and rng.random() < 0.5:
            handle["time_data"] = np.stack([file.values, 2.0 * file.values])
        else:
            handle["data"] = file.values
        handle.attrs.update(scalars)


def make_tdms(file: Made, name: str, t: np.ndarray, decimals: int, rng: np.random.Generator) -> None:
    from nptdms import ChannelObject, TdmsWriter

    properties: dict[str, Any] = {"unit_string": file.unit}
    channels = []
    if file.clock not in ("none", "s", "index"):
        properties["wf_increment"] = 1.0 / file.rate
    if file.clock in ("s", "both", "contradiction"):
        channels.append(ChannelObject("g", "Time", t, {"unit_string": "s"} | {
            key: value for key, value in properties.items() if key != "unit_string"}))  # fmt: skip
    if file.clock == "contradiction":
        properties["wf_increment"] = 2.0 / file.rate
        channels[0].properties["wf_increment"] = 2.0 / file.rate
        file.answers["clock"] = "column"
    channels.append(ChannelObject("g", name, file.values, properties))
    with TdmsWriter(str(file.path)) as writer:
        writer.write_segment(channels)


def make_uff(file: Made, name: str, t: np.ndarray, decimals: int, rng: np.random.Generator) -> None:
    import pyuff

    kinds = {"acceleration": 12, "velocity": 11, "displacement": 8, "force": 13}
    file.path = file.path.with_suffix(".uff")
    pyuff.UFF(str(file.path)).write_sets(
        {
            "type": 58, "binary": 0, "orddenom_spec_data_type": 0, "z_axis_spec_data_type": 0, "version_num": 0,
            "load_case_id": 0, "func_type": 1, "rsp_node": 1, "rsp_dir": 3, "ref_node": 1, "ref_dir": 3,
            "data": file.values,
            "x": t, "id1": name, "abscissa_spec_data_type": 17, "ordinate_spec_data_type": kinds[file.quantity],
            "ordinate_axis_units_lab": file.unit if rng.random() < 0.7 else "NONE", "abscissa_inc": t[1],
            "abscissa_min": 0.0, "abscissa_spacing": 1, "num_pts": t.size,
        },
        "overwrite",
    )  # fmt: skip


def completed(text: str, file: Made) -> tuple[dict[str, Any], list[str]]:
    """The proposal with its questions answered, and what they were."""
    values = yaml.safe_load(text)
    asked = []
    for key, answer in (
        ("sample_rate", file.rate),
        ("clock", file.answers.get("clock", "column")),
        ("time_unit", {"ms": "ms", "us": "us"}.get(file.clock, "s")),
    ):
        if values.get(key) == "?":
            asked.append(key)
            values[key] = answer
            if key == "time_unit" and file.clock == "index":
                # Numbers of samples: the rate is known to whoever recorded it.
                del values[key]
                values["sample_rate"], values["clock"] = file.rate, "sample_rate"
    for number, channel in enumerate(values["channels"]):
        for key, answer in (("quantity", file.quantity), ("unit", file.unit), ("scale", 1)):
            if channel.get(key) == "?":
                asked.append(key)
                channel[key] = answer
        channel["point"] = number + 1
    for segment in values["segments"]:
        for key in ("start", "stop"):
            if segment.get(key) == "?":
                asked.append(key)
                segment[key] = 0.0 if key == "start" else (file.values.size - 1) / file.rate
    return values, asked


def judged(file: Made) -> tuple[str, list[str]]:
    """Right, asked or refused, and questions or the sentence; what is wrong is an error."""
    try:
        (text,) = sidecar_templates(file.path)
    except BenchError as error:
        return "refused", [str(error)]
    values, asked = completed(text, file)
    sidecar = file.path.with_name(f"{file.path.stem}.yaml")
    sidecar.write_text(yaml.safe_dump(values, allow_unicode=True), encoding="utf-8")
    run = read_import(sidecar)  # neither a proposal nor its answers are refused
    twice_the_clock_std = run.clock_std * 2.0
    assert run.sample_rate == pytest.approx(file.rate, rel=max(3e-5, twice_the_clock_std)), (
        f"{file.path.name}, {file.clock}"
    )
    assert run.samples == file.values.size
    channel = run.channels[0]
    factor = dict(UNITS[file.quantity])[file.unit]
    assert channel.quantity is Quantity[file.quantity.upper()]
    good = ~file.missing
    assert channel.data[good] == pytest.approx(file.values[good] * factor, abs=0.51 * file.digits * factor, rel=1e-6)
    assert np.isnan(channel.data[file.missing]).all()
    return ("asked" if asked else "right"), asked


@pytest.mark.parametrize("part", with_quick(range(10), 0))
def test_a_file_is_read_right_or_asked_about(part: int, tmp_path: Path) -> None:
    results = [judged(made(seed, tmp_path)) for seed in range(part, FILES, 10)]
    assert {result for result, _ in results} <= {"right", "asked"}, [said for result, said in results]
