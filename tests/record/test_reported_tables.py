"""Kinds of tables that users brought: each is read right, or asked about by the question that settles it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.signal import cont2discrete, lfilter

from nmt_core.errors import BenchError
from nmt_record.exchange.arrays.uff import ACCELERATION, FORCE, TIME, Axis, UffFunction, write_uff
from nmt_record.exchange.import_table import read_table
from nmt_record.exchange.imports.imported_run import read_import
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

Array = NDArray[np.float64]
Draw = np.random.Generator


def decay(time: Array, hertz: float, ratio: float = 0.01) -> Array:
    omega = 2.0 * np.pi * hertz
    return np.exp(-ratio * omega * time) * np.cos(omega * time)


def simcenter(draw: Draw, folder: Path) -> None:
    """Structs of Simcenter Testlab: rate, unit and point stand in the file."""
    rate, samples = float(draw.choice([512, 2048, 6400, 51200])), int(draw.integers(2000, 4000))
    time, unit = np.arange(samples) / rate, str(draw.choice(["g", "m/s^2", "N"]))
    content, truth = {}, {}
    for number in range(int(draw.integers(1, 4))):
        values = decay(time, 0.02 * rate / (number + 1))
        label = {"label": unit, "unit_transformation": {"factor": 1.0, "offset": 0.0}}
        content[f"Signal_{number}"] = {
            "x_values": {"start_value": 0.0, "increment": 1.0 / rate, "number_of_values": float(samples),
                         "quantity": {"label": "s"}},
            "y_values": {"values": values[:, None], "quantity": label},
            "function_record": {"name": "run", "first_id": {"name": f"rod:{number + 4}:+Z"}},
        }  # fmt: skip
        truth[f"Signal_{number}.y_values.values"] = values
    savemat(folder / "run.mat", content)
    table = read_table(folder / "run.mat")
    assert dict(zip(table.names, table.points, strict=True)) == {name: i + 4 for i, name in enumerate(truth)}
    assert set(table.units) == {unit}
    assert table.step == 1.0 / rate
    for name, column in zip(table.names, table.columns, strict=True):
        np.testing.assert_array_equal(column, truth[name])


def durations(draw: Draw, folder: Path) -> None:
    """Row times of MATLAB's timetables with their unit."""
    unit, seconds = [("sec", 1.0), ("min", 60.0), ("hr", 3600.0), ("s", 1.0), ("ms", 1e-3)][draw.integers(5)]
    rate = float(draw.choice([100, 250, 500, 1000]))
    time = np.arange(1500) / rate
    rows = [f"{t / seconds:.10g} {unit},{x:.7f}\n" for t, x in zip(time, decay(time, 0.03 * rate), strict=True)]
    (folder / "run.csv").write_text("Time,Acc_ms2\n" + "".join(rows))
    (text,) = sidecar_templates(folder / "run.csv")
    stated = float(text.partition("# sample_rate: ")[2].split()[0])
    assert "time: Time" in text
    assert stated == pytest.approx(rate, rel=1e-6)


def long_form(draw: Draw, folder: Path) -> None:
    """A row for each value: one series behind the other, or in turn; with one clock, or several."""
    count, together = int(draw.integers(2, 6)), bool(draw.integers(2))
    head = str(draw.choice(["elapsed time,topic,value", "time,signal,value", "t,series,y"]))
    time = np.arange(400) / 200.0
    series = {f"/p{k}/imu.z": decay(time, 5.0 + 3.0 * k) for k in range(count)}
    shift = 0.0 if together else 3e-4
    rows = [
        (t + shift * k, name, x) for k, (name, xs) in enumerate(series.items()) for t, x in zip(time, xs, strict=True)
    ]
    if draw.integers(2):
        rows.sort(key=lambda row: row[0])
    (folder / "run.csv").write_text(head + "\n" + "".join(f"{t:.6f},{name},{x:.9f}\n" for t, name, x in rows))
    if not together:
        with pytest.raises(BenchError, match=r"is in the long form, a row for each value .* as a table of its own"):
            read_table(folder / "run.csv")
        return
    table = read_table(folder / "run.csv")
    assert set(table.names[1:]) == set(series)
    np.testing.assert_allclose(table.columns[0], time, atol=1e-6)
    for name, column in zip(table.names[1:], table.columns[1:], strict=True):
        np.testing.assert_allclose(column, series[name], atol=1e-9)


def united_clocks(draw: Draw, folder: Path) -> None:
    """Channel groups of two rates on the union of their clocks, values between samples interpolated."""
    rate, slow = float(draw.choice([500, 1000, 2000])), float(draw.choice([10, 50, 100]))
    time = np.arange(int(draw.integers(3000, 6000))) / rate
    other = np.arange(0.2 / rate + float(draw.uniform(0.2, 0.6)) / rate, time[-1], 1.0 / slow)
    fast, temperature = decay(time, 0.03 * rate), np.sin(other)
    union = np.union1d(time, other)
    columns = [union, np.interp(union, time, fast), np.interp(union, other, temperature)]
    np.savetxt(folder / "run.csv", np.column_stack(columns), "%.9f", ",", header="timestamps,acc,temp", comments="")
    table = read_table(folder / "run.csv")
    assert any("instants of another clock" in note for note in table.notes)
    np.testing.assert_allclose(table.columns[0], time, atol=1e-9)
    np.testing.assert_allclose(table.columns[1], fast, atol=1e-9)


def formats(draw: Draw, folder: Path) -> None:
    """Files of programs that nothing here reads are named, with a way in."""
    head, ending, says = [
        (b"MDF     4.10    asammdf\0", "mf4", "is an MDF file; export it with asammdf"),
        (b"MDF     3.30    tool", "dat", "is an MDF file; export it with asammdf"),
        (b"|CF,2,1,1;|CK,1,3,1,1;", "raw", "is a FAMOS file of imc; export it as"),
        (b"|CF,2,1,1;|CK,1,3,1,1;", "dat", "is a FAMOS file of imc; export it as"),
    ][draw.integers(4)]
    (folder / f"run.{ending}").write_bytes(head + draw.bytes(int(draw.integers(100, 5000))))
    with pytest.raises(BenchError, match=says):
        read_table(folder / f"run.{ending}")


def excited(draw: Draw, rate: float) -> tuple[Array, Array]:
    """Force and acceleration of an oscillator under noise, a sweep, or noise within a band."""
    samples = int(rate * draw.uniform(10, 20))
    force = draw.standard_normal(samples)
    if draw.integers(2):
        lines, frequency = np.fft.rfft(force), np.fft.rfftfreq(samples, 1.0 / rate)
        lines[(frequency < 5.0) | (frequency > 0.2 * rate)] = 0.0
        force = np.fft.irfft(lines, samples) + 1e-3 * draw.standard_normal(samples)
    elif draw.integers(2):
        force = np.sin(2.0 * np.pi * np.cumsum(np.linspace(8.0, 40.0, samples)) / rate)
    force *= draw.uniform(0.5, 20.0)
    omega = 2.0 * np.pi * 20.0
    above, below, _ = cont2discrete(([1.0, 0, 0], [1.0, 0.04 * omega, omega**2]), 1.0 / rate, "bilinear")
    return force, np.asarray(lfilter(above.ravel(), below.ravel(), force)) / 1.7


def tared(draw: Draw, folder: Path) -> None:
    """The zero of a force sensor steps within a record: asked, and taken as it is where the sidecar says so."""
    rate = float(draw.choice([500, 1000, 2000]))
    force, acceleration = excited(draw, rate)
    row = int(force.size * draw.uniform(0.08, 0.92))
    healthy = np.column_stack([np.arange(force.size) / rate, force, acceleration])
    force[row:] += force.std() * draw.uniform(0.8, 8.0) * draw.choice([-1.0, 1.0])
    stepped = np.column_stack([healthy[:, 0], force, acceleration])
    channel = "{{column: {}, quantity: {}, unit: {}, point: 1{}}}"
    for name, rows, more in (("healthy", healthy, ""), ("run", stepped, ""), ("kept", stepped, ", zero_step: keep")):
        np.savetxt(folder / f"{name}.csv", rows, "%.9g", ",", header="time_s,f,a", comments="")
        (folder / f"{name}.yaml").write_text(
            f"file: {name}.csv\ntime: time_s\nchannels:\n- {channel.format('f', 'force', 'N', more)}\n"
            f"- {channel.format('a', 'acceleration', 'm/s^2', '')}\n"
            f"segments:\n- {{kind: record, start: 0, stop: {rows[-1, 0]:.9g}}}\n"
        )
    read_import(folder / "healthy.yaml")
    with pytest.raises(BenchError, match=r"the zero of column f steps by .* N near sample (\d+), .*'zero_step: keep'"):
        read_import(folder / "run.yaml")
    assert any("was it tared" in note for note in read_import(folder / "kept.yaml").notes)


def orders(draw: Draw, folder: Path) -> None:
    """Responses of an order over the speed: its frequency is order × speed."""
    order = float(draw.choice([1, 2, 3, 0.5, 4, 6]))
    speed = np.linspace(300.0, 6000.0, 500)
    hertz, natural = order * speed / 60.0, order * float(draw.uniform(20.0, 60.0))
    response = -(hertz**2) / (natural**2 - hertz**2 + 0.04j * natural * hertz)
    named = [f"Order {order:.2f}", f"order_{order:g}", f"Ordnung {order:g}", f"{order:g}. Ordnung", f"{order:g}x",
             f"Ord {order:g}"][draw.integers(6)]  # fmt: skip
    over = ["Speed [rpm]", "rpm", "Drehzahl [1/min]", "RPM", "Speed (rpm)"][draw.integers(5)]
    head = f"{over},{named} real [m/s^2/N],{named} imag [m/s^2/N]"
    rows = np.column_stack([speed, response.real, response.imag])
    np.savetxt(folder / "run.csv", rows, "%.9g", ",", header=head, comments="")
    (text,) = sidecar_templates(folder / "run.csv")
    assert f"order: {order:g} " in text
    (folder / "run.yaml").write_text(text)
    (table,) = read_import(folder / "run.yaml").tables
    np.testing.assert_allclose(table.columns["frequency_hz"], hertz, rtol=1e-8)
    if order != 1.0:
        without = "\n".join(line for line in text.splitlines() if "order: " not in line)
        (folder / "run.yaml").write_text(without.replace("'?'", "1"))
        with pytest.raises(BenchError, match=f"is order {order:g} of a rotation.*say 'order: {order:g}'"):
            read_import(folder / "run.yaml")


def signs_and_magnitudes(draw: Draw, folder: Path) -> None:
    """Whole numbers whose highest bit is the sign: proposed by --init, asked for where the sidecar says nothing."""
    bit, rate = int(draw.choice([11, 15, 15, 23])), 1000.0
    force, motion = excited(draw, rate)
    values = motion if draw.integers(2) else force
    reach = 2**bit - 1
    counts = np.round(values / np.abs(values).max() * reach * draw.uniform(0.02, 0.99)).astype(np.int64)
    written = np.where(counts < 0, 2**bit - counts, counts)
    rows = np.column_stack([np.arange(counts.size) / rate, written])
    np.savetxt(folder / "run.csv", rows, "%.9g", ",", header="time_s,acc", comments="")
    (text,) = sidecar_templates(folder / "run.csv")
    assert f"sign_bit: {bit}" in text
    channel = "{column: acc, quantity: acceleration, unit: m/s^2, point: 1, scale: 0.001, sign_bit: 9}"
    side = f"file: run.csv\ntime: time_s\nchannels:\n- {channel}\nsegments:\n- {{kind: record, start: 0, stop: 9}}\n"
    (folder / "run.yaml").write_text(side.replace("sign_bit: 9", f"sign_bit: {bit}"))
    np.testing.assert_allclose(read_import(folder / "run.yaml").channels[0].data, counts * 1e-3, atol=1e-9)
    (folder / "run.yaml").write_text(side.replace(", sign_bit: 9", ""))
    with pytest.raises(BenchError, match=rf"say 'sign_bit: {bit}', or 'sign_bit: 0'"):
        read_import(folder / "run.yaml")


def triaxial(draw: Draw, folder: Path) -> None:
    """Several directions at a node of a universal file: the one that a point of the model is, is asked."""
    axes = sorted(draw.choice([1, 2, 3], size=2, replace=False).tolist())
    nodes = draw.choice(np.arange(1, 200), size=int(draw.integers(1, 4)), replace=False).tolist()
    hertz = np.arange(200) * 0.5
    sizes = {(node, axis): float(draw.uniform(0.5, 5.0)) for node in nodes for axis in axes}
    unit = Axis(ACCELERATION, "acc", "m/s^2"), Axis(FORCE, "force", "N")
    driven = axes[int(draw.integers(2))]
    responses = [
        UffFunction(
            4, size / (1.0 - (hertz / 40.0) ** 2 + 0.02j), 0.0, 0.5, None, (f"{node}{'XYZ'[axis - 1]}",), node,
            axis * int(draw.choice([-1, 1])), nodes[0], driven, Axis(18, "f", "Hz"), *unit,
        )
        for (node, axis), size in sizes.items()
    ]  # fmt: skip
    write_uff(folder / "frf.uff", responses)
    (folder / "frf.yaml").write_text("file: frf.uff\nsegments:\n- {kind: frf, turned: []}\n")
    letters = "xyz"
    with pytest.raises(BenchError, match=rf"point \d+ has directions .*say 'axis: [{letters}]'"):
        read_import(folder / "frf.yaml")
    side = f"file: frf.uff\nsegments:\n- {{kind: frf, axis: {letters[driven - 1]}, turned: [], conjugate: false}}\n"
    (folder / "frf.yaml").write_text(side)
    tables = read_import(folder / "frf.yaml").tables
    assert {table.point for table in tables} == set(nodes)
    for table in tables:
        lines = table.columns["frequency_hz"]
        right = sizes[table.point, driven] / (1.0 - (lines / 40.0) ** 2 + 0.02j)
        np.testing.assert_allclose(table.responses, right, rtol=1e-5)
    time = np.arange(1000) / 500.0
    signals = [
        UffFunction(1, size * decay(time, 20.0), 0.0, 0.002, None, (f"{node}{'XYZ'[axis - 1]}",), node, axis, 0, 0,
                    Axis(TIME, "t", "s"), unit[0])
        for (node, axis), size in sizes.items()
    ]  # fmt: skip
    write_uff(folder / "time.uff", signals)
    (text,) = sidecar_templates(folder / "time.uff")
    assert text.count("point: '?'") == len(signals)


KINDS: tuple[Callable[[Draw, Path], None], ...] = (
    simcenter, durations, long_form, united_clocks, formats, tared, orders, signs_and_magnitudes, triaxial,
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize(
    "seeds", [range(2), pytest.param(range(2, 100), marks=pytest.mark.campaign)], ids=["few", "all"]
)
def test_tables_that_users_brought_are_right_or_asked_about(
    tmp_path: Path, kind: Callable[[Draw, Path], None], seeds: range
) -> None:
    wrong = []
    for seed in seeds:
        folder = tmp_path / str(seed)
        folder.mkdir()
        try:
            kind(np.random.default_rng([seed, KINDS.index(kind)]), folder)
        except (AssertionError, BenchError, pytest.fail.Exception) as error:
            wrong.append((seed, str(error)[:300]))
    assert len(wrong) <= 0.05 * len(seeds), wrong
