"""Channels that contradict themselves or each other are named before any model, by factor, code or range."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.signal import butter, sosfilt
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_record.exchange.import_table import read_table
from nmt_record.exchange.imports.imported_run import ImportedRun, read_import
from nmt_record.exchange.judgement.column_faults import (
    flat_top,
    held_samples,
    unwrapped,
    value_codes,
    wrap_of,
    wrap_of_counts,
    zero_step,
)
from nmt_record.exchange.judgement.motions import motion_ratio
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

VARIANTS = with_quick(range(100), *range(3))
Recording = tuple[float, dict[str, FloatArray]]


def motion(rng: np.random.Generator) -> Recording:
    """Rate and columns of a point that decays, shakes at random or goes through a sweep: position, rates, a force."""
    rate, samples, over = float(rng.choice([200.0, 500.0, 1000.0, 2048.0])), int(rng.integers(2000, 6000)), 8
    time = np.arange(samples * over) / (rate * over)
    frequency, kind = rate * rng.uniform(0.008, 0.04), rng.integers(3)
    if kind == 0:
        v = sosfilt(butter(4, frequency / (0.5 * rate * over), output="sos"), rng.standard_normal(time.size))
        v -= v.mean()
    elif kind == 1:
        v = np.exp(-rng.uniform(0.003, 0.03) * 2 * np.pi * frequency * time) * np.sin(2 * np.pi * frequency * time)
    else:
        v = np.sin(2 * np.pi * frequency * (0.5 * time + 0.5 * time**2 / time[-1]))
    v *= 10.0 ** rng.uniform(-2, 1) / np.abs(v).max()
    x, a = np.cumsum(v) / (rate * over), np.gradient(v) * rate * over
    columns = {"x": x[::over], "v": v[::over], "a": a[::over]}
    noisy = {name: values + 1e-4 * values.std() * rng.standard_normal(samples) for name, values in columns.items()}
    return rate, {**noisy, "f": rng.standard_normal(samples)}


QUANTITIES = {
    "x": ("angle", "rad"), "v": ("angular_velocity", "rad/s"), "a": ("angular_acceleration", "rad/s^2"),
    "f": ("torque", "N*m"),
}  # fmt: skip


def imported(folder: Path, found: Recording, names: str = "xvaf", **keys: Any) -> ImportedRun:
    rate, columns = found
    np.savez(folder / "data.npz", **{name: columns[name] for name in names})  # type: ignore[arg-type]
    samples = columns[names[0]].size
    channels = [
        {"column": name, "quantity": QUANTITIES[name][0], "unit": QUANTITIES[name][1], "point": 1, **keys.get(name, {})}
        for name in names
    ]
    values = {
        "file": "data.npz",
        "sample_rate": rate,
        "channels": channels,
        "segments": [{"kind": "record", "start": 0.0, "stop": samples / rate}],
    }
    (folder / "s.yaml").write_text(yaml.safe_dump(values))
    return read_import(folder / "s.yaml")


@pytest.mark.parametrize("seed", VARIANTS)
def test_motions_that_agree_are_taken_without_a_word(tmp_path: Path, seed: int) -> None:
    assert imported(tmp_path, motion(np.random.default_rng(seed)), "xvf").notes == []


@pytest.mark.parametrize("seed", VARIANTS)
def test_a_factor_or_a_sign_of_one_motion_is_asked(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    rate, columns = motion(rng)
    pair = ("xv", "va", "xa")[rng.integers(3)]
    wrong = pair[rng.integers(2)]
    factor = float(rng.choice([57.3, 20.0, 5.0, 2.0, -1.0, 9.81, 1e3, 50.0, 2 * math.pi, -3.0, 25.4]))
    factor = factor if rng.integers(2) else 1.0 / factor
    columns[wrong] = columns[wrong] * factor
    with pytest.raises(BenchError, match=r"is [−\d.·⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+ times column .*'scale: …'"):
        imported(tmp_path, (rate, columns), pair)
    assert any(
        "times column" in note for note in imported(tmp_path, (rate, columns), pair, **{wrong: {"scale": 1.0}}).notes
    )


def test_degrees_are_called_so(tmp_path: Path) -> None:
    rate, columns = motion(np.random.default_rng(3))
    columns["x"] = np.degrees(columns["x"])
    with pytest.raises(BenchError, match=r"x \(x1\) is 57\.3 times column v .*degrees that were read as radians"):
        imported(tmp_path, (rate, columns), "xv")


@pytest.mark.parametrize("seed", VARIANTS)
def test_a_late_motion_is_named_with_its_delay(seed: int) -> None:
    rng = np.random.default_rng([seed, 2])
    rate, columns = motion(rng)
    late = int(rng.integers(1, 6))
    found = motion_ratio(columns["x"][late:], columns["v"][:-late], 1, rate)
    assert found is not None
    if math.isfinite(found.delay):
        assert found.delay * rate == pytest.approx(late, abs=0.3)
    assert abs(found.factor) == pytest.approx(1.0, abs=0.1)


def test_a_filtered_velocity_is_named(tmp_path: Path) -> None:
    rate, columns = 500.0, {"x": np.cumsum(np.random.default_rng(1).standard_normal(8000)) / 500.0}
    columns["v"] = sosfilt(butter(2, 20.0 / 250.0, output="sos"), np.gradient(columns["x"]) * rate)
    notes = imported(tmp_path, (rate, columns), "xv").notes
    assert any("v1 is late" in note for note in notes), notes


def test_unrelated_motions_are_not_compared() -> None:
    rng = np.random.default_rng(4)
    assert motion_ratio(rng.standard_normal(4000), rng.standard_normal(4000), 1, 500.0) is None
    assert motion_ratio(np.zeros(4000), rng.standard_normal(4000), 1, 500.0) is None
    assert motion_ratio(np.ones(9), np.ones(9), 1, 500.0) is None


CODES = (-999.25, -999.0, -9999.0, 9.91e37, 9.9e37, 1e31, -1e31, 1e30, 3.4028234663852886e38, -99999.0, 999999.0)


@pytest.mark.parametrize("seed", VARIANTS)
def test_codes_of_no_value_are_marked_as_missing(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng([seed, 3])
    rate, columns = motion(rng)
    size = float(np.abs(columns["x"]).max()) / rng.uniform(0.01, 300.0)  # up to a few hundred, as strains in µm/m
    columns["x"] = columns["x"] / size
    code = float(rng.choice(CODES))
    rows = rng.choice(columns["x"].size, int(rng.integers(1, 40)), replace=False)
    columns["x"][rows] = code
    run = imported(tmp_path, (rate, columns), "xf")
    assert np.flatnonzero(np.isnan(run.channels[0].data)).tolist() == sorted(rows.tolist())
    assert any(f"holds {code:g} {rows.size} times" in note for note in run.notes)


def test_numbers_that_are_values_stay(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    for values in (np.round(3000 * rng.standard_normal(5000)), np.linspace(-2000, 2000, 4001), np.full(100, -999.25)):
        assert not value_codes(values).any()
    assert imported(tmp_path, motion(rng), "xf", x={"no_value": 0.0}).notes == []


@pytest.mark.parametrize("seed", VARIANTS)
def test_whole_turns_of_an_angle_go_on(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng([seed, 4])
    rate, columns = motion(rng)
    turn, unit = ((2 * math.pi, "rad"), (360.0, "deg"))[rng.integers(2)]
    swing = columns["x"] - columns["x"].mean()
    angle = swing / np.abs(swing).max() * turn * rng.uniform(0.05, 0.4) + turn * rng.uniform(0.47, 0.53)
    low = -0.5 * turn * rng.integers(2)
    columns["x"] = (angle - low + 0.5 * turn * rng.integers(2)) % turn + low
    if np.abs(np.diff(columns["x"])).max() < 0.5 * turn:
        return
    run = imported(tmp_path, (rate, columns), "xf", x={"unit": unit})
    assert any("a whole turn" in note for note in run.notes)
    factor = math.radians(1.0) if unit == "deg" else 1.0
    apart = run.channels[0].data - angle * factor
    assert np.ptp(apart) < 1e-9 * turn
    as_it_is = imported(tmp_path, (rate, columns), "xf", x={"unit": unit, "wrap": 0.0})
    assert np.array_equal(as_it_is.channels[0].data, columns["x"] * factor)


@pytest.mark.parametrize("seed", VARIANTS)
def test_counts_without_their_sign_are_asked(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    rate, columns = motion(rng)
    bits = int(rng.choice([12, 16, 24, 32]))
    source = ("x", "f")[rng.integers(2)]
    signed = np.round(columns[source] / np.abs(columns[source]).max() * 2.0**bits * rng.uniform(0.005, 0.08))
    signed[:2] = 9.0, -9.0
    columns["f"] = signed % 2.0**bits
    scale = {"scale": 1e-3}
    with pytest.raises(BenchError, match=rf"jumps by {2**bits} at .*'wrap: {2**bits}'"):
        imported(tmp_path, (rate, columns), "xf", f=scale)
    run = imported(tmp_path, (rate, columns), "xf", f={**scale, "wrap": 2.0**bits})
    assert np.allclose(run.channels[1].data, 1e-3 * signed)


def test_a_sign_bit_is_named(tmp_path: Path) -> None:
    rate, columns = motion(np.random.default_rng(6))
    signed = np.round(900 * columns["v"] / np.abs(columns["v"]).max())
    columns["f"] = np.where(signed < 0, 2.0**15 - signed, signed)
    with pytest.raises(BenchError, match="jumps by 32768 where it changes its sign"):
        imported(tmp_path, (rate, columns), "xf", f={"scale": 1e-3})


def test_what_jumps_without_a_range_does_not_begin_again() -> None:
    rng = np.random.default_rng(7)
    square = np.where(np.arange(4000) % 200 < 100, 0.0, 360.0)
    assert wrap_of(square, (360.0,)) is None
    assert wrap_of_counts(np.round(rng.uniform(0, 65535, 4000))) is None
    assert wrap_of_counts(rng.standard_normal(4000)) is None
    assert np.array_equal(unwrapped(np.full(4, np.nan), 360.0), np.full(4, np.nan), equal_nan=True)


@pytest.mark.parametrize("seed", VARIANTS)
def test_held_values_are_named(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng([seed, 6])
    rate, columns = motion(rng)
    every = float(rng.choice([2.0, 3.0, 5.0, 10.0, 20.0, 2.5, 4.2]))
    rows = np.floor(np.floor(np.arange(columns["x"].size) / every) * every).astype(int)
    columns["x"] = columns["x"][rows]
    notes = imported(tmp_path, (rate, columns), "xf").notes
    assert any(f"keeps each value for {every:.3g} samples"[:28] in note for note in notes), notes
    assert held_samples(columns["x"]) == pytest.approx(every, rel=0.02)


def test_coarse_or_slow_signals_are_not_held() -> None:
    time = np.arange(4000) / 500.0
    assert held_samples(np.round(20 * np.exp(-time) * np.cos(50 * time))) == 1.0
    assert held_samples(np.zeros(4000)) == 1.0


def test_flat_tops_and_their_absence(tmp_path: Path) -> None:
    rate, columns = motion(np.random.default_rng(8))
    assert flat_top(columns["x"]) == (0, 0)
    assert flat_top(np.round(10 * columns["x"])) == (0, 0)
    limit = 0.5 * np.abs(columns["x"]).max()
    columns["x"] = np.clip(columns["x"], -limit, limit)
    assert any("the sensor or its range ends there" in note for note in imported(tmp_path, (rate, columns), "xf").notes)


@pytest.mark.parametrize("seed", VARIANTS)
def test_a_tared_force_is_named(tmp_path: Path, seed: int) -> None:
    """A step of four times the rms of a random force and more; smaller ones pass for its slow part."""
    rng = np.random.default_rng([seed, 7])
    rate, columns = motion(rng)
    size = float(rng.choice([-1.0, 1.0]) * rng.uniform(4.0, 20.0))
    row = int(columns["f"].size * rng.uniform(0.2, 0.8))
    assert zero_step(columns["f"]) is None
    columns["f"][row:] += size
    with pytest.raises(BenchError, match=r"was it tared or reset there\? Give a segment on either side of it"):
        imported(tmp_path, (rate, columns), "xf")
    notes = imported(tmp_path, (rate, columns), "xf", f={"zero_step": "keep"}).notes
    found = [note for note in notes if "was it tared or reset there?" in note]
    assert found, notes


def test_a_drift_and_a_load_are_no_tare(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    rate, columns = motion(rng)
    samples = columns["f"].size
    assert zero_step(np.linspace(0.0, 9.0, samples) + columns["f"]) is None
    for name in "xf":
        columns[name][samples // 2 :] += 30.0 * columns[name].std()
    assert not any("tared" in note for note in imported(tmp_path, (rate, columns), "xf").notes)


@pytest.mark.parametrize("seed", VARIANTS)
def test_gravity_tells_the_unit(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng([seed, 8])
    rate, columns = motion(rng)
    tilt = rng.standard_normal(3)
    tilt /= np.linalg.norm(tilt)
    unit, reads, scale = [
        ("m/s^2", 1.0, 9.80665), ("m/s^2", 1000.0, 0.00980665), ("g", 9.80665, 1 / 9.80665), ("g", 1000.0, 1e-3),
        ("m/s^2", 9.80665, 0.0), ("g", 1.0, 0.0),
    ][rng.integers(6)]  # fmt: skip
    shaking = 0.1 * reads * (columns["a"] - columns["a"].mean()) / np.abs(columns["a"]).max()
    axes = {f"acc.{axis}": tilt[k] * reads + shaking * (k == 2) for k, axis in enumerate("xyz")}
    (tmp_path / "log.csv").write_text(
        ",".join(axes) + "\n" + "\n".join(",".join(f"{v:.7g}" for v in row) for row in np.array(list(axes.values())).T)
    )
    channels = [{"column": "acc.z", "quantity": "acceleration", "unit": unit, "point": 1}]
    values = {"file": "log.csv", "sample_rate": rate, "channels": channels, "segments": []}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(values))
    if scale == 0.0:
        assert not any("gravity" in note for note in read_import(tmp_path / "s.yaml").notes)
        return
    with pytest.raises(BenchError, match=rf"gravity is .*'scale: {scale:.9g}'"):
        read_import(tmp_path / "s.yaml")
    channels[0]["scale"] = scale
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(values))
    assert read_import(tmp_path / "s.yaml").samples == columns["a"].size


def lost(rng: np.random.Generator, samples: int) -> np.ndarray:
    """Which rows came: bursts are missing."""
    kept = np.ones(samples, dtype=bool)
    for first in rng.choice(np.arange(5, samples - 20), int(rng.integers(1, 12)), replace=False):
        kept[first : first + rng.integers(1, 10)] = False
    return kept


@pytest.mark.parametrize("seed", VARIANTS)
def test_a_packet_counter_tells_what_is_missing(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng([seed, 9])
    rate, columns = motion(rng)
    kept = lost(rng, columns["x"].size)
    bits, name = int(rng.choice([8, 16, 32])), str(rng.choice(["PacketCounter", "seq", "frame_no", "sample index"]))
    counts = (np.arange(kept.size) + int(rng.integers(0, 2**bits))) % 2**bits
    text = [f"{name},pos", *(f"{counts[row]},{columns['x'][row]:.9g}" for row in np.flatnonzero(kept))]
    (tmp_path / "log.csv").write_text("\n".join(text) + "\n")
    channels = [{"column": "pos", "quantity": "angle", "unit": "rad", "point": 1}]
    (tmp_path / "s.yaml").write_text(yaml.safe_dump({"file": "log.csv", "sample_rate": rate, "channels": channels}))
    run = read_import(tmp_path / "s.yaml")
    assert np.array_equal(np.isfinite(run.channels[0].data), kept)
    assert any(f"{int((~kept).sum())} samples are missing at" in note for note in run.notes)
    assert "PacketCounter" not in "".join(sidecar_templates(tmp_path / "log.csv")).split("channels:")[1]


@pytest.mark.parametrize(
    ("heading", "names"),
    [
        ("# time (s),force (N),acc (m/s^2)", ["time (s)", "force (N)", "acc (m/s^2)"]),
        ("#time,accel_x,accel_y", ["time", "accel_x", "accel_y"]),
        ("% t [s],F [N],a [g]", ["t [s]", "F [N]", "a [g]"]),
        ("// t,f,a", ["t", "f", "a"]),
        ("# made by hand, on a Friday", ["", "", ""]),
        ("# 1, 2, 3", ["", "", ""]),
    ],
)
def test_a_heading_behind_a_comment_names_columns(tmp_path: Path, heading: str, names: list[str]) -> None:
    rows = [f"{k / 100:.2f},{math.sin(k):.6f},{math.cos(k):.6f}" for k in range(100)]
    (tmp_path / "a.csv").write_text("\n".join(["# a log", heading, *rows]) + "\n")
    assert list(read_table(tmp_path / "a.csv").names) == names


def responses(rng: np.random.Generator) -> tuple[FloatArray, np.ndarray]:
    frequency = np.arange(20.0, 60.0, 0.1)
    omega, natural = 2 * np.pi * frequency, 2 * np.pi * rng.uniform(30.0, 50.0)
    return frequency, 1.0 / (natural**2 - omega**2 + 0.02j * natural * omega) / rng.uniform(0.3, 5.0)


def table(folder: Path, heading: str, numbers: list[Any], **keys: Any) -> ObservableTable:
    np.savetxt(folder / "t.csv", np.column_stack(numbers), delimiter=",", header=heading, comments="", fmt="%.12g")
    values = {"file": "t.csv", "segments": [{"kind": "frf", "point": 1, "drive_point": 1, **keys}]}
    (folder / "s.yaml").write_text(yaml.safe_dump(values))
    return read_import(folder / "s.yaml").tables[0]


@pytest.mark.parametrize("seed", VARIANTS)
def test_a_force_per_motion_is_turned_over_or_asked(tmp_path: Path, seed: int) -> None:
    frequency, h = responses(np.random.default_rng(seed))
    unit, order = (("N/m", 0), ("N/mm", 0), ("N/(m/s)", 1), ("N*s/m", 1), ("N/(m/s^2)", 2), ("N/g", 2))[seed % 6]
    factor = {"N/mm": 1e-3, "N/g": 9.80665}.get(unit, 1.0)
    meant = h * (2j * np.pi * frequency) ** order
    given = factor / meant
    columns = {"real": "Real", "imag": "Imag", "frequency_hz": "Frequency"}
    head = f"Frequency [Hz],Real [{unit}],Imag [{unit}]"
    with pytest.raises(BenchError, match="a force per motion, not m/N; say 'unit: "):
        table(tmp_path, head, [frequency, given.real, given.imag], columns=columns, unit="m/N")
    found = table(tmp_path, head, [frequency, given.real, given.imag], columns=columns, unit=unit)
    assert np.allclose(found.responses, meant, rtol=1e-9)


def test_magnitudes_in_the_place_of_real_parts_are_asked(tmp_path: Path) -> None:
    frequency, h = responses(np.random.default_rng(1))
    with pytest.raises(BenchError, match="magnitudes without a phase"):
        table(tmp_path, "frequency_hz,real,imag", [frequency, abs(h), 0 * frequency], unit="m/N")


@pytest.mark.parametrize("seed", VARIANTS)
def test_each_column_has_its_kind_of_amplitude(tmp_path: Path, seed: int) -> None:
    frequency, h = responses(np.random.default_rng(seed))
    kinds = {"pk": 1.0, "rms": math.sqrt(0.5), "peak": 1.0, "p-p": 2.0}
    one, other = (list(kinds)[k] for k in (seed % 4, seed // 4 % 4))
    held = 0.5 + 0.01 * np.sin(frequency)
    found = table(
        tmp_path, f"f [Hz],Control [N {one}],Tip [mm {other}],Phase [deg]",
        [frequency, held * kinds[one], 1e3 * held * abs(h) * kinds[other], np.degrees(np.angle(h))],
        columns={"frequency_hz": "f", "magnitude": "Tip", "phase": "Phase"}, per="Control", unit="mm/N",
    )  # fmt: skip
    assert np.allclose(found.responses, h, rtol=1e-9)


@pytest.mark.parametrize("seed", VARIANTS)
def test_the_mirror_half_of_a_transform_is_left_out(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = int(rng.choice([256, 257, 1000]))
    h = np.fft.fft(rng.standard_normal(size))
    frequency = np.arange(size) * 0.5
    found = table(tmp_path, "frequency_hz,real,imag", [frequency, h.real, h.imag], unit="m/N", conjugate=False, scale=1)
    assert found.columns["frequency_hz"][-1] <= 0.25 * size
    assert found.rows == size // 2
