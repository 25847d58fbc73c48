"""``./nmt export``, ``./nmt import`` and ``./nmt extract`` in a circle, and what the commands leave behind."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
import pyuff
import yaml
from bench import synthetic_bag
from record.foreign_data import DAMPING, FREQUENCY_HZ, RATE, recording, sidecar, write
from tiers import with_quick

from nmt_bench.cli import main
from nmt_core.vocabulary import PointStatus
from nmt_extract import extract_bag
from nmt_extract.modal.mode_uff import linear_modes, write_mode_uff
from nmt_extract.modal.table import read_csv, read_json
from nmt_record import Bag
from nmt_record.exchange.reduced.observables import observable_tables
from nmt_record.windows.segments import read_signals, segments
from nmt_rig.linear_description import linear_description
from nmt_rig.modal_files import read_uff55
from nmt_rig.rig import find_rig, load_rig


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a made-up run with the beam's rig file, one level of which never locked."""
    folder = tmp_path_factory.mktemp("recorded") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic_bag, "RIG_YAML", find_rig("beam").read_text(encoding="utf-8"))
        synthetic_bag.write_bag(folder / "bag", lost_level=1, level_seconds=2.5)
    done(["extract", folder / "bag", "--out", folder / "results", "--no-report"])
    return folder


@pytest.fixture
def run(recorded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recorded, tmp_path / "run"))


def done(words: list[object]) -> None:
    assert main([str(word) for word in words]) == 0


def refused(words: list[object], capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    assert main([str(word) for word in words]) == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("form", "tolerance"),
    with_quick(
        [(["uff"], 0.0), (["uff", "--ascii"], 1e-9), (["csv"], 0.0), (["npz"], 0.0), (["h5"], 0.0), (["mat"], 0.0)],
        (["uff"], 0.0),
        (["npz"], 0.0),
    ),
    ids=["58b", "58 ascii", "csv", "npz", "h5", "mat"],
)
def test_export_import_extract_gives_the_same_table(
    form: list[str], tolerance: float, run: Path, tmp_path: Path
) -> None:
    done(["export", run / "bag", "--format", *form, "--out", tmp_path / "out"])
    done(["import", tmp_path / "out" / "sidecar.yaml", "--out", tmp_path / "again"])
    done(["extract", tmp_path / "again", "--out", tmp_path / "results", "--no-report"])
    before, after = read_csv(run / "results" / "modal.csv"), read_csv(tmp_path / "results" / "modal.csv")
    assert before["level"] == [0.1, 0.3, 1.0]
    assert math.isnan(before["omega_rad_s"][1])
    for name, column in before.items():
        assert np.allclose(after[name], column, rtol=tolerance, atol=tolerance * 1e-3, equal_nan=True), name
    reasons = [point.reason for point in extract_bag(run / "bag").points]
    assert [point.reason for point in extract_bag(tmp_path / "again").points] == reasons


def test_a_second_round_changes_no_bit(run: Path, tmp_path: Path) -> None:
    done(["export", run / "bag", "--out", tmp_path / "1"])
    done(["import", tmp_path / "1" / "sidecar.yaml", "--out", tmp_path / "again"])
    done(["export", tmp_path / "again", "--out", tmp_path / "2"])
    for name in ("data.uff", "sidecar.yaml", "oscillator.csv", "loop.csv", "linear.json", "rig.yaml"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes(), name


def test_another_tool_reads_the_exported_channels(run: Path, tmp_path: Path) -> None:
    done(["export", run / "bag", "--out", tmp_path / "out"])
    sets = pyuff.UFF(str(tmp_path / "out" / "data.uff")).read_sets()
    bag = Bag.open(run / "bag")
    signals = read_signals(bag, 0, 75_000)
    assert [item["id1"] for item in sets] == list(signals.channels)
    for item in sets:
        assert np.array_equal(item["data"], signals.channels[item["id1"]])
        assert item["rsp_node"] == signals.points[item["id1"]]
        assert item["rsp_dir"] == (3 if item["rsp_node"] else 0)
        assert item["ordinate_axis_units_lab"] == signals.units[item["id1"]]
        assert item["abscissa_inc"] == pytest.approx(1e-4, rel=1e-12)
    assert [item["ordinate_spec_data_type"] for item in sets] == [13, 8, 8, 1]


def test_one_segment(run: Path, tmp_path: Path) -> None:
    done(["export", run / "bag", "--segment", 3, "--format", "npz", "--out", tmp_path / "out"])
    done(["import", tmp_path / "out" / "segment-3" / "sidecar.yaml", "--out", tmp_path / "again"])
    (segment,) = segments(Bag.open(tmp_path / "again"))
    assert segment == segments(Bag.open(run / "bag"))[-1]
    (point,) = extract_bag(tmp_path / "again").points
    assert point.identical(extract_bag(run / "bag").points[-1])


def test_export_refusals_leave_nothing(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert "segments 1 to 3, so there is no segment 4" in refused(
        ["export", run / "bag", "--segment", 4, "--out", out], capsys
    )
    assert "--ascii is a form of UFF" in refused(
        ["export", run / "bag", "--format", "csv", "--ascii", "--out", out], capsys
    )
    assert "There is no bag" in refused(["export", tmp_path / "nothing", "--out", out], capsys)
    assert not out.exists()
    assert not list(tmp_path.glob(".out*"))


def test_frequency_responses_of_a_sweep_and_of_a_linear_test(run: Path, tmp_path: Path) -> None:
    (run / "frf.csv").write_text(
        "segment,level,level_unit,rate_hz_s,frequency_hz,force_n,voltage_v,a2_real,a2_imag,a2_std\n"
        + "".join(
            f"{s},{level},N,0.2,{f},1,1,{f * level},-1.5,0.1\n"
            for s, level in ((0, 1.5), (1, 3.0))
            for f in (10.0, 10.5, 11.0)
        )
    )
    done(["export", run, "--out", tmp_path / "out"])
    sets = pyuff.UFF(str(tmp_path / "out" / "frf.uff")).read_sets()
    assert [item["id1"] for item in sets] == ["a2 1.5 N", "a2 3.0 N"]
    assert [(item["func_type"], item["rsp_node"], item["ref_node"], item["ref_dir"]) for item in sets] == [
        (4, 2, 2, 3)
    ] * 2
    assert np.allclose(sets[1]["data"], 3.0 * np.array([10.0, 10.5, 11.0]) - 1.5j)
    assert np.allclose(sets[1]["x"], [10.0, 10.5, 11.0])
    (run / "frf.csv").write_text(
        "frequency_hz,a2_f1_h1_real,a2_f1_h1_imag,a2_f1_hc_real,a2_f1_hc_imag,a2_f1_coherence,a2_u_h1_real,a2_u_h1_imag\n"
        "1,2,3,4,5,1,6,7\n2,2,3,4.5,5,1,6,7\n"
    )
    done(["export", run, "--out", tmp_path / "linear", "--ascii"])
    item = pyuff.UFF(str(tmp_path / "linear" / "frf.uff")).read_sets()
    assert (item["id1"], item["id3"], item["rsp_node"], item["ref_node"]) == ("a2", "hc", 2, 1)
    assert np.allclose(item["data"], [4 + 5j, 4.5 + 5j])


def test_uneven_frequencies_are_written_in_ascii(run: Path, tmp_path: Path) -> None:
    (run / "frf.csv").write_text("frequency_hz,a2_f1_hv_real,a2_f1_hv_imag\n1,4,5\n2.5,4.5,5\n3,1,2\n")
    done(["export", run, "--out", tmp_path / "out"])
    item = pyuff.UFF(str(tmp_path / "out" / "frf.uff")).read_sets()
    assert (item["binary"], item["x"].tolist()) == (0, [1.0, 2.5, 3.0])
    assert np.allclose(item["data"], [4 + 5j, 4.5 + 5j, 1 + 2j])


def test_exported_frequency_responses_come_back_as_tables(run: Path, tmp_path: Path) -> None:
    (run / "frf.csv").write_text("frequency_hz,a2_f1_hv_real,a2_f1_hv_imag\n1,4,5\n2,4.5,5\n3,1,2\n")
    done(["export", run, "--out", tmp_path / "out"])
    path = tmp_path / "out" / "frf.yaml"
    path.write_text(yaml.safe_dump({"file": "frf.uff", "kind": "frf", "unit": "m/s^2/N"}))
    done(["import", path, "--out", tmp_path / "again"])
    (table,) = observable_tables(Bag.open(tmp_path / "again"))
    assert (table.point, table.drive_point, table.units["real"]) == (2, 1, "m/s^2/N")
    assert table.columns["frequency_hz"].tolist() == [1.0, 2.0, 3.0]
    assert table.columns["real"].tolist() == [4.0, 4.5, 1.0]


def test_foreign_data_are_extracted_without_a_known_phase(tmp_path: Path) -> None:
    done(["import", write(tmp_path / "in"), "--out", tmp_path / "bag"])
    done(["extract", tmp_path / "bag", "--out", tmp_path / "results"])
    points = extract_bag(tmp_path / "bag").points
    assert [point.status for point in points] == [PointStatus.OK, PointStatus.OK]
    for point in points:
        assert point.frequency_hz == pytest.approx(FREQUENCY_HZ, rel=1e-9)
        assert point.damping_ratio == pytest.approx(DAMPING, rel=1e-6)
        assert point.mac == pytest.approx(1.0, abs=1e-9)
    assert (tmp_path / "results" / "report.html").is_file()


def test_a_window_over_a_gap_is_rejected(tmp_path: Path) -> None:
    data = recording()
    data["a4"][round(4.0 * RATE)] = math.nan
    done(["import", write(tmp_path / "in", sidecar(), data), "--out", tmp_path / "bag"])
    good, spoilt = extract_bag(tmp_path / "bag").points
    assert good.status is PointStatus.OK
    assert spoilt.status is PointStatus.REJECTED
    assert "Channel 'a4' of 'acceleration' has no valid value at sample 8000" in spoilt.reason


def test_a_level_that_did_not_lock(tmp_path: Path) -> None:
    values = sidecar()
    values["segments"][1] = {**values["segments"][1], "window": None, "locked": False, "reason": "the loop hunted"}
    del values["segments"][1]["window"]
    done(["import", write(tmp_path / "in", values), "--out", tmp_path / "bag"])
    points = extract_bag(tmp_path / "bag").points
    assert [point.status for point in points] == [PointStatus.OK, PointStatus.NOT_LOCKED]
    assert "the loop hunted" in points[1].reason


def test_the_rig_of_a_sidecar(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done(["import", write(tmp_path / "in", sidecar(rig="beam", linear=None)), "--out", tmp_path / "1"])
    assert "restricted to the measured points 2, 4" in capsys.readouterr().out
    bag = Bag.open(tmp_path / "1")
    assert bag.rig_yaml is not None
    assert "kind: beam" in bag.rig_yaml
    assert bag.run_start is not None
    assert bag.run_start["linear"]["points"] == [2, 4]
    done(["import", write(tmp_path / "in", sidecar(rig="their rig")), "--out", tmp_path / "2"])
    assert "There is no rig file 'their rig'" in capsys.readouterr().out
    path = write(tmp_path / "in", sidecar(rig="rigs/mine.yaml"))
    assert "rig file rigs/mine.yaml, which is not next to it" in refused(
        ["import", path, "--out", tmp_path / "3"], capsys
    )
    assert not (tmp_path / "3").exists()


def test_an_import_that_is_refused_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = recording()
    path = write(tmp_path / "in", sidecar(), {**data, "f": data["a2"], "a2": data["f"]})
    assert "swapped" in refused(["import", path, "--out", tmp_path / "out"], capsys)
    path = write(tmp_path / "in", sidecar(extraction={"harmonics": 0}))
    assert "harmonics" in refused(["import", path, "--out", tmp_path / "out"], capsys)
    assert [entry.name for entry in tmp_path.iterdir()] == ["in"]


def test_levels_are_exported_as_complex_modes_with_geometry(run: Path, tmp_path: Path) -> None:
    for name in ("modal.json", "modal.csv"):
        shutil.copy(run / "results" / name, run / name)
    done(["export", run, "--out", tmp_path / "out"])
    points = [point for point in read_json(run / "modal.json")[0] if point.status == PointStatus.OK]
    nodes, line, *modes = pyuff.UFF(str(tmp_path / "out" / "modes.uff")).read_sets()
    assert (nodes["type"], line["type"], {mode["type"] for mode in modes}) == (15, 82, {55})
    assert len(modes) == len(points)
    spacing = 0.7 / 7
    np.testing.assert_allclose(nodes["x"], spacing * np.array(nodes["node_nums"]), rtol=1e-6)
    for mode, point in zip(modes, points, strict=True):
        assert list(mode["node_nums"]) == list(point.points) == [int(n) for n in line["nodes"]]
        assert abs(mode["eig"]) == pytest.approx(point.omega_rad_s, rel=1e-5)
        assert -mode["eig"].real / abs(mode["eig"]) == pytest.approx(point.damping_ratio, rel=1e-5)
        np.testing.assert_allclose(mode["r3"], point.normalised_shape, rtol=2e-5, atol=1e-5)


def test_linear_modes_come_back_through_a_universal_file(tmp_path: Path) -> None:
    """The rig file's own reader of data set 55 shares no code with pyuff, which writes it."""
    linear = linear_description(load_rig("beam"))
    write_mode_uff(tmp_path / "modes.uff", linear_modes(linear))
    points, modes = read_uff55(tmp_path / "modes.uff")
    assert points == sorted(linear.points)
    for number, mode in enumerate(modes):
        assert 2 * math.pi * mode["frequency_hz"] == pytest.approx(linear.frequencies_rad_s[number], rel=1e-5)
        assert mode["damping_ratio"] == pytest.approx(linear.damping_ratios[number], rel=1e-5)
        own = [linear.shapes[linear.points.index(point)][number] for point in points]
        scale = math.sqrt(mode.get("modal_mass_kg", 1.0))
        np.testing.assert_allclose(np.array(mode["shape"]) / scale, own, rtol=1e-4, atol=1e-5)
