"""Imports that pass: values, what was fixed and said, tables of others, and nothing half-written."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from record.foreign_data import FREQUENCY_HZ, RATE, SHAPES, recording, sidecar, write, write_csv, write_sidecar

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import TestKind
from nmt_record import Bag
from nmt_record.exchange.imports.imported_run import ImportedRun, read_import, write_import
from nmt_record.exchange.reduced.observables import observable_tables
from nmt_record.exchange.unit_table import factor_to_si
from nmt_record.windows.segments import read_signals, segments


def imported(path: Path) -> Bag:
    return Bag.open(write_import(read_import(path), path.parent / "bag", "made-up", "", {}))


def attempt(path: Path) -> tuple[ImportedRun | None, str]:
    """The import, or the sentence of its refusal; anything else is raised."""
    try:
        return read_import(path), ""
    except BenchError as error:
        return None, str(error)


def signals(bag: Bag, samples: int = 12000) -> dict[str, np.ndarray]:
    return read_signals(bag, 0, samples).channels


def test_the_bag_holds_the_recording_bit_for_bit(tmp_path: Path) -> None:
    bag = imported(write(tmp_path))
    data = recording()
    found = signals(bag)
    for channel, column in (("u", "u"), ("f2", "f"), ("a2", "a2"), ("a4", "a4")):
        assert np.array_equal(found[channel], data[column])
    assert bag.loss is None
    assert [(s.kind, s.first_sample, s.samples, s.level, s.level_unit) for s in segments(bag)] == [
        (TestKind.PHASE_RESONANCE, 1000, 4800, 0.5, "N"),
        (TestKind.PHASE_RESONANCE, 7000, 4800, 1.0, "N"),
    ]
    assert read_signals(bag, 0, 100).oscillator is None
    assert bag.run_start is not None
    assert [entry["name"] for entry in bag.run_start["imported"]["files"]] == [
        "sidecar.yaml",
        "linear.json",
        "data.npz",
    ]


def test_a_slow_clock_costs_no_message_a_sample(tmp_path: Path) -> None:
    segment = {"kind": "record", "start": 0.0, "stop": 590.0}
    run = read_import(write(tmp_path, sidecar(sample_rate=20.0, segments=[segment])))
    write_import(run, tmp_path / "bag", "rig", "", {})
    assert Bag.open(tmp_path / "bag").topics["force"][1] == run.samples / 200


def test_two_imports_are_the_same_file(tmp_path: Path) -> None:
    path = write(tmp_path / "in")
    one = write_import(read_import(path), tmp_path / "1" / "bag", "r", "", {})
    two = write_import(read_import(path), tmp_path / "2" / "bag", "r", "", {})
    assert (one / "bag_0.mcap").read_bytes() == (two / "bag_0.mcap").read_bytes()


MENDED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "comma decimals": (
        lambda f: write_csv(f, delimiter=";", change=lambda t: t.replace(".", ",")),
        "decimals with a comma",
    ),
    "comma decimals with tabs": (
        lambda f: write_csv(f, delimiter="\t", change=lambda t: t.replace(".", ",")),
        "decimals with a comma",
    ),
    "utf-16": (lambda f: write_csv(f, encoding="utf-16"), "UTF-16"),
    "windows-1252": (
        lambda f: write_csv(f, change=lambda t: t.replace("u,f", "Überspannung,f", 1), encoding="cp1252", values={
            **sidecar(), "channels": sidecar()["channels"][1:]
        }),
        "Windows-1252",
    ),
    "row of units": (
        lambda f: write_csv(f, delimiter=";", change=lambda t: t.replace("\n", "\nV;N;m/s^2;m/s^2\n", 1)),
        r"read as units \(V, N, m/s\^2, m/s\^2\)",
    ),
    "header repeated, with a time column": (
        lambda f: write_csv(
            f,
            {"time": np.arange(12000) / RATE, **recording()},
            change=lambda t: "\n".join([*t.split("\n")[:5000], t.split("\n")[0], *t.split("\n")[5000:]]),
        ),
        "repeated after line 5000",
    ),
    "a clock a little off": (
        lambda f: write(f, sidecar(), {"time": np.arange(12000) / (RATE * 1.0004), **recording()}),
        "gives 2000.8 Hz, 2000 Hz was stated",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(MENDED))
def test_what_is_mended_is_said_and_kept(name: str, tmp_path: Path) -> None:
    make, sentence = MENDED[name]
    run = read_import(make(tmp_path))
    assert any(re.search(sentence, note) for note in run.notes), run.notes
    bag = Bag.open(write_import(run, tmp_path / "bag", "r", "", {}))
    assert bag.run_start is not None
    assert bag.run_start["imported"]["notes"] == run.notes
    assert np.allclose(signals(bag)["f2"], recording()["f"], rtol=1e-8, atol=1e-9)


def test_a_byte_order_mark_and_windows_line_ends_are_nothing_to_speak_of(tmp_path: Path) -> None:
    run = read_import(write_csv(tmp_path, change=lambda t: "\ufeff# a comment\r\n" + t.replace("\n", "\r\n")))
    assert run.notes == []


def test_columns_by_number_without_a_header(tmp_path: Path) -> None:
    values = sidecar()
    values["channels"] = [{**channel, "column": number + 1} for number, channel in enumerate(values["channels"])]
    run = read_import(write_csv(tmp_path, header=False, values=values))
    assert np.allclose(run.channels[1].data, recording()["f"], atol=1e-9)


def test_gaps_are_marked_and_never_filled(tmp_path: Path) -> None:
    def spoil(text: str) -> str:
        lines = text.split("\n")
        for number in range(1500, 1520):
            cells = lines[number].split(",")
            lines[number] = ",".join([cells[0], "", cells[2], "nan"])
        return "\n".join(lines)

    path = write_csv(tmp_path, change=spoil)
    run = read_import(path)
    assert [note for note in run.notes if "Column f lacks 20 values in 1 stretches (first at line 1501" in note]
    found = signals(Bag.open(write_import(run, tmp_path / "bag", "r", "", {})))
    assert np.flatnonzero(np.isnan(found["f2"])).tolist() == list(range(1499, 1519))
    assert np.isnan(found["a4"]).sum() == 20
    assert not np.isnan(found["a2"]).any()


def test_samples_missing_by_the_time_column_become_gaps(tmp_path: Path) -> None:
    keep = np.r_[0:4000, 4003:12000]
    data = {"time": np.arange(12000) / RATE, **recording()}
    run = read_import(write(tmp_path, sidecar(sample_rate=None), {name: column[keep] for name, column in data.items()}))
    assert run.samples == 12000
    assert run.sample_rate == RATE
    assert np.flatnonzero(np.isnan(run.channels[0].data)).tolist() == [4000, 4001, 4002]
    assert any("3 samples are missing at 1 places" in note for note in run.notes)


@pytest.mark.parametrize(("rate", "digits"), [(51200.0, 9), (44100.0, 9), (2000.0, 5), (1000 / 3, 6)])
def test_rounded_time_stamps_give_the_rate(rate: float, digits: int, tmp_path: Path) -> None:
    data = recording()
    time = np.round(np.arange(data["f"].size) / rate, digits)
    values = sidecar(sample_rate=None, segments=[])
    run = read_import(write(tmp_path, values, {"t": time, **data}))
    assert run.sample_rate == pytest.approx(rate, rel=3e-6)
    if rate == round(rate):
        assert run.sample_rate == rate


def test_times_are_those_of_the_time_column(tmp_path: Path) -> None:
    data = {"time": 100.0 + np.arange(12000) / RATE, **recording()}
    segment = {"kind": "phase_resonance", "start": 101.0, "stop": 103.0, "window": [101.5, 102.5]}
    bag = imported(write(tmp_path, sidecar(segments=[segment]), data))
    (found,) = segments(bag)
    assert (found.first_sample, found.samples) == (3000, 2000)


UNITS = [
    ("force", "kN", 1e-3), ("force", "lbf", 1 / 4.4482216152605), ("acceleration", "g", 1 / 9.80665),
    ("acceleration", "mm/s²", 1e3), ("acceleration", " m/s/s ", 1.0), ("displacement", "µm", 1e6),
    ("displacement", "mm", 1e3), ("velocity", "mm/s", 1e3), ("voltage", "mV", 1e3),
    ("displacement", "inch", 1 / 0.0254),
]  # fmt: skip


@pytest.mark.parametrize(("quantity", "unit", "per_si"), UNITS)
def test_units(quantity: str, unit: str, per_si: float) -> None:
    assert factor_to_si(Quantity[quantity.upper()], unit, "x") * per_si == pytest.approx(1.0, rel=1e-12)


def test_temperatures_called_t1_and_t2_are_no_clocks(tmp_path: Path) -> None:
    warm = 20.0 + 0.01 * np.sin(np.arange(12000))
    run = read_import(write(tmp_path, sidecar(), {"t1": warm, "t2": warm + 1.0, **recording()}))
    assert run.sample_rate == RATE


def test_units_and_scales_reach_the_bag_in_si(tmp_path: Path) -> None:
    data = recording()
    data["a2"] = np.round(data["a2"] / 9.80665 / 1e-6)
    values = sidecar()
    values["channels"][2].update(unit="g", scale=1e-6)
    found = signals(imported(write(tmp_path, values, data)))
    assert np.allclose(found["a2"], recording()["a2"], atol=6e-6)


def test_units_off_by_a_thousand_are_suspected(tmp_path: Path) -> None:
    values = sidecar()
    values["channels"][1]["unit"] = "kN"
    notes = read_import(write(tmp_path, values)).notes
    assert any("a unit is probably wrong by a power of ten (kN, m/s^2)" in note for note in notes)


def test_displacement_and_acceleration_are_compared(tmp_path: Path) -> None:
    data = recording()
    data["x2"] = -data["a2"] / (2 * np.pi * FREQUENCY_HZ) ** 2
    values = sidecar()
    values["channels"].append({"column": "x2", "quantity": "displacement", "unit": "m", "point": 2})
    assert read_import(write(tmp_path, values, data)).notes == []
    values["channels"][-1]["unit"] = "mm"
    with pytest.raises(BenchError, match=r"column x2 \(x2\) is 0\.001 times column a2 .*thousandths.*'scale: …'"):
        read_import(write(tmp_path, values, data))
    values["channels"][-1]["scale"] = 1.0
    notes = read_import(write(tmp_path, values, data)).notes
    assert any("is 0.001 times column a2" in note for note in notes)


def test_a_force_out_of_phase_is_no_reason_to_refuse(tmp_path: Path) -> None:
    """Errors of phase up to 100° are for the diagnosis to find."""
    time = np.arange(12000) / RATE
    data = recording()
    data["f"] = np.cos(2 * np.pi * FREQUENCY_HZ * time + math.radians(100.0))
    assert read_import(write(tmp_path, sidecar(), data)).notes == []


def random_test(delay: int = 0) -> dict[str, np.ndarray]:
    """White force on a mode, and its acceleration, ``delay`` samples late."""
    force = np.random.default_rng(3).standard_normal(12000)
    omega, natural = 2 * np.pi * np.fft.rfftfreq(12000, 1 / RATE), 2 * np.pi * FREQUENCY_HZ
    response = np.fft.rfft(force) / (natural**2 - omega**2 + 0.04j * natural * omega) * -(omega**2)
    acceleration = np.roll(np.fft.irfft(response, 12000), delay)
    return {"f": force, "a2": acceleration + 1e-3 * np.random.default_rng(4).standard_normal(12000)}


def of_random_test(**changes: object) -> dict[str, object]:
    channels = [channel for channel in sidecar()["channels"] if channel["column"] in ("f", "a2")]
    return sidecar(channels=channels, segments=[{"kind": "random", "start": 0.0, "stop": 6.0}], linear=None, **changes)


def test_an_exchange_in_a_random_test_is_seen_but_a_late_channel_passes(tmp_path: Path) -> None:
    assert read_import(write(tmp_path, of_random_test(), random_test())).notes == []
    assert read_import(write(tmp_path, of_random_test(), random_test(2))).notes == []
    good = random_test()
    with pytest.raises(BenchError, match="swapped"):
        read_import(write(tmp_path, of_random_test(), {"f": good["a2"], "a2": good["f"]}))
    with pytest.raises(BenchError, match="wrong sign"):
        read_import(write(tmp_path, of_random_test(), {"f": good["f"], "a2": -good["a2"]}))


def test_a_dead_channel_is_named(tmp_path: Path) -> None:
    data = {**recording(), "a4": np.zeros(12000)}
    assert any("a4) is constant" in note for note in read_import(write(tmp_path, sidecar(), data)).notes)


def test_every_kind_of_segment_becomes_a_window(tmp_path: Path) -> None:
    values = sidecar(segments=[
        {"kind": "phase_resonance", "level": 0.5, "start": 0.0, "stop": 1.0, "window": [0.5, 1.0]},
        {"kind": "ring_down", "start": 1.0, "stop": 2.0, "switch_off": 1.25},
        {"kind": "random", "level": 0.1, "start": 2.0, "stop": 3.0, "band_hz": [10, 500]},
        {"kind": "sweep", "level": 1.0, "level_unit": "N", "start": 3.0, "stop": 4.0, "frequency_hz": 10},
        {"kind": "stepped_sine", "start": 4.0, "stop": 5.0, "window": [4.5, 5.0]},
        {"kind": "record", "start": 5.0, "stop": 6.0},
    ])  # fmt: skip
    found = segments(imported(write(tmp_path, values)))
    assert [(s.kind.label, s.first_sample, s.samples) for s in found] == [
        ("phase_resonance", 1000, 1000),
        ("ring_down", 2500, 1500),
        ("random", 4000, 2000),
        ("sweep", 6000, 2000),
        ("stepped_sine", 9000, 1000),
        ("record", 10000, 2000),
    ]
    assert found[3].frequency_hz == 10.0
    assert found[2].frequency_hz == 0.0


def test_backbone_and_frequency_responses_of_others(tmp_path: Path) -> None:
    (tmp_path / "backbone.csv").write_text("f [rad/s];q;zeta [%];zeta_std\n136;0.1;0.5;0.01\n135;0.2;1.5;0.02\n")
    (tmp_path / "frf.csv").write_text("frequency_hz,magnitude,phase [deg],level\n10,2,90,0.5\n11,3,-180,0.5\n")
    path = write_sidecar(tmp_path, {
        "file": "backbone.csv",
        "rig": "their rig",
        "segments": [
            {"kind": "backbone", "unit": "mm", "point": 2, "units": {"damping_ratio": "%"},
             "columns": {"frequency_hz": "f", "amplitude": "q", "damping_ratio": "zeta",
                         "damping_ratio_std": "zeta_std"}},
            {"kind": "frf", "file": "frf.csv", "unit": "g/N", "point": 4, "drive_point": 2, "level_unit": "N"},
        ],
    })  # fmt: skip
    backbone, frf = observable_tables(imported(path))
    assert backbone.quantity is Quantity.DISPLACEMENT
    assert backbone.columns["frequency_hz"] == pytest.approx(np.array([136, 135]) / (2 * np.pi))
    assert backbone.columns["amplitude"] == pytest.approx([1e-4, 2e-4])
    assert backbone.columns["damping_ratio"] == pytest.approx([0.005, 0.015])
    assert backbone.columns["damping_ratio_std"] == pytest.approx([1e-4, 2e-4])
    assert (frf.quantity, frf.point, frf.drive_point) == (Quantity.ACCELERATION, 4, 2)
    assert frf.columns["real"] + 1j * frf.columns["imag"] == pytest.approx(9.80665 * np.array([2j, -3]))
    assert frf.units == {"frequency_hz": "Hz", "level": "N", "real": "m/s^2/N", "imag": "m/s^2/N"}


def test_a_magnitude_beside_real_and_imaginary_part_is_not_needed(tmp_path: Path) -> None:
    (tmp_path / "frf.csv").write_text("frequency_hz,real,imag,magnitude\n10,3,-4,5\n11,4,-3,5\n")
    segment = {"kind": "frf", "unit": "m/N", "point": 4, "drive_point": 2, "scale": -1.0}
    path = write_sidecar(tmp_path, {"file": "frf.csv", "rig": "their rig", "segments": [segment]})
    (table,) = observable_tables(imported(path))
    assert table.phase_known
    assert table.responses == pytest.approx([-3 + 4j, -4 + 3j])
    assert set(table.columns) == {"frequency_hz", "real", "imag"}


@pytest.mark.parametrize(
    ("text", "section", "sentence"),
    [
        ("frequency_hz,amplitude\n1,2\n", {"unit": ""}, "unit of the response must be given"),
        ("frequency_hz,amplitude\n1,2\n", {"unit": "N"}, "'N' is not one"),
        ("frequency_hz,amp\n1,2\n", {"unit": "m"}, "no column amplitude .it has frequency_hz, amp"),
        ("frequency_hz,amplitude\n1,-2\n", {"unit": "m"}, "not positive at line 2"),
        ("frequency_hz,amplitude\n1,\n", {"unit": "m"}, "amplitude is missing at line 2"),
        ("frequency_hz,amplitude,damping_ratio\n1,2,3.5\n", {"unit": "m"}, "in percent"),
        ("frequency_hz,amplitude,amplitude_std\n1,2,-1\n", {"unit": "m"}, "amplitude_std is negative"),
        ("frequency_hz,real,imag\n1,2,3\n", {"kind": "frf", "unit": "m"}, "response per force"),
        ("frequency_hz,real\n1,2\n", {"kind": "frf", "unit": "m/N"}, "neither real and imag nor magnitude"),
        ("frequency_hz,magnitude,phase\n1,2,90\n", {"kind": "frf", "unit": "m/N"}, "more than a turn in rad"),
        ("frequency_hz,magnitude,phase\n1,-2,1\n", {"kind": "frf", "unit": "m/N"}, "dB"),
        ("frequency_hz,magnitude\n1,-2\n", {"kind": "frf", "unit": "m/N"}, "dB"),
        ("frequency_hz,magnitude\n1,2\n", {"kind": "frf", "unit": "m/N", "conjugate": True}, "no conjugate"),
        (
            "frequency_hz,amplitude\n1,2\n",
            {"unit": "m", "columns": {"freq": "x"}},
            "'freq', which a backbone does not have",
        ),
    ],
)
def test_malformed_tables_of_others(text: str, section: dict[str, object], sentence: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(text)
    path = write_sidecar(tmp_path, {"file": "t.csv", "segments": [{"kind": "backbone", **section}]})
    with pytest.raises(BenchError, match=sentence):
        read_import(path)


def test_a_column_of_phases_may_say_degrees_in_its_name(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("frequency_hz,magnitude,phase_deg\n1,2,90\n")
    path = write_sidecar(tmp_path, {"file": "t.csv", "segments": [{"kind": "frf", "unit": "m/N"}]})
    (table,) = observable_tables(imported(path))
    assert table.columns["real"] + 1j * table.columns["imag"] == pytest.approx([2j])


def test_a_file_that_is_one_table(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("frequency_hz,amplitude\n21.5,2e-3\n")
    path = write_sidecar(tmp_path, {"file": "t.csv", "kind": "backbone", "unit": "m*sqrt(kg)"})
    (table,) = observable_tables(imported(path))
    assert (table.quantity, table.units["amplitude"]) == (Quantity.UNKNOWN, "m*sqrt(kg)")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_the_bytes_there_is_a_bag_or_one_sentence(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("spoilt")
    path = write_csv(folder, {name: column[:400] for name, column in recording().items()}, delimiter=";")
    table = folder / "data.csv"
    content = bytearray(table.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        what = data.draw(st.sampled_from(["cut", "drop", "byte", "insert", "double"]))
        if what == "cut" and data.draw(st.booleans()):
            del content[at:]
        elif what == "drop":
            del content[at : at + data.draw(st.integers(1, 200))]
        elif what == "byte":
            content[at] = data.draw(st.integers(0, 255))
        elif what == "insert":
            content[at:at] = data.draw(
                st.sampled_from([b";", b"\n", b",", b"nan", b"1e999", b"\0", b"x", b"-", b"1;2\n"])
            )
        else:
            content[at:at] = content[at : at + data.draw(st.integers(1, 500))]
        if not content:
            break
    table.write_bytes(bytes(content))
    values = sidecar(file="data.csv", segments=[{"kind": "record", "start": 0.0, "stop": 0.15}])
    write_sidecar(folder, values)
    run, refusal = attempt(path)
    assert "\n" not in refusal
    if run is None:
        return
    for channel in run.channels:
        assert not np.isinf(channel.data).any()
    assert Bag.open(write_import(run, folder / "bag", "r", "", {})).loss is None


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    key=st.sampled_from(
        ["sample_rate", "file", "channels", "segments", "linear", "time", "first_sample", "extraction", "rig"]
    ),
    value=st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["kind", "unit", "column", "start"]), inner)
        ),
        max_leaves=6,
    ),
)
def test_whatever_the_sidecar_there_is_an_import_or_one_sentence(
    key: str, value: object, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("sidecar")
    values = sidecar()
    values[key] = value
    path = write(folder, values, {name: column[:200] for name, column in recording(0.1).items()})
    assert "\n" not in attempt(path)[1]


def test_shapes_of_the_made_up_data_are_those_of_its_linear_description() -> None:
    data = recording()
    assert np.allclose(data["a4"] / SHAPES[1], data["a2"] / SHAPES[0], atol=1e-7)
