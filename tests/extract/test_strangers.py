"""Small inputs after what strangers report, each with one kind of fault: from the file to what is said of it."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nmt_bench.data_import import import_data
from nmt_core.errors import BenchError
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_extract.decays.free_decay import free_decays
from nmt_extract.offline import extract_bag
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.imports.imported_run import read_import
from nmt_record.exchange.reduced.observables import observable_tables
from nmt_record.exchange.sidecar.import_sidecar import Sidecar
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

INPUTS = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "strangers"

pytestmark = pytest.mark.skipif(not INPUTS.is_dir(), reason=f"the inputs of strangers are not there ({INPUTS})")


@pytest.fixture
def given(tmp_path: Path) -> Callable[[str], Path]:
    """A copy of one input."""

    def copy(number: str) -> Path:
        (source,) = INPUTS.glob(f"{number}-*")
        folder = tmp_path / number
        folder.mkdir()
        for item in source.iterdir():
            (shutil.copytree if item.is_dir() else shutil.copyfile)(item, folder / item.name)
        return folder

    return copy


def changed(sidecar: Path, **keys: Any) -> Path:
    values = {**yaml.safe_load(sidecar.read_text()), **keys}
    values = {key: value for key, value in values.items() if value is not None}
    sidecar.write_text(yaml.safe_dump(values))
    return sidecar


def points(sidecar: Path) -> list[ModalPoint]:
    bag = sidecar.with_name(f"bag_{sidecar.stem}")
    import_data(sidecar, bag)
    return extract_bag(bag).points


def test_header_and_time_column_contradict(given: Callable[[str], Path]) -> None:
    folder = given("01")
    with pytest.raises(BenchError, match=r"step 1\.953125e-05 s .*51200 Hz.*column X_Value .*1600 Hz.*clock: header"):
        read_import(folder / "s.yaml")
    assert "clock: '?'" in sidecar_templates(folder / "resaved.lvm")[0]
    # The answer, one way or the other.
    run = read_import(changed(folder / "s.yaml", clock="column", segments=[]))
    assert run.sample_rate == 1600.0
    assert any("51200 Hz contradicts" in note for note in run.notes)
    assert read_import(changed(folder / "s.yaml", clock="header")).sample_rate == 51200.0
    assert read_import(changed(folder / "s.yaml", clock=None, sample_rate=1600)).sample_rate == 1600.0
    with pytest.raises(BenchError, match="which of the two"):
        read_import(changed(folder / "s.yaml", sample_rate=3000))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("delay_4ms", r"72\.0° apart.*response is late by 4 ms"),
        ("velocity_as_displacement", r"-90\.0° apart.*velocity called a displacement"),
    ],
)
def test_far_from_phase_resonance(given: Callable[[str], Path], name: str, words: str) -> None:
    for point in points(given("03") / f"{name}.yaml"):
        assert point.status is PointStatus.REJECTED
        assert re.search(words, point.reason), point.reason


def test_at_phase_resonance_nothing_is_said(given: Callable[[str], Path]) -> None:
    for point in points(given("03") / "right.yaml"):
        assert (point.status, point.reason) == (PointStatus.OK, "")
        assert point.damping_ratio == pytest.approx(0.005, rel=1e-7)
        assert 1e-12 < point.damping_ratio_std < 1e-9


def test_the_line_at_0_hz_is_no_resonance(given: Callable[[str], Path]) -> None:
    folder = given("04")
    for name, lines in (("frf", 1), ("without_dc", 0)):
        run = import_data(folder / f"{name}.yaml", folder / name)
        assert sum("line at 0 Hz" in note for note in run.notes) == lines
    (with_line,), (without,) = (observable_tables(Bag.open(folder / name)) for name in ("frf", "without_dc"))
    assert with_line.columns["real"].tolist() == without.columns["real"].tolist()


def test_channels_by_shape_and_rate_by_attribute(given: Callable[[str], Path]) -> None:
    folder = given("05")
    values = yaml.safe_load(sidecar_templates(folder / "run.nc4")[0])
    assert [channel["column"] for channel in values["channels"]] == ["time_data.1", "time_data.2"]
    assert "time" not in values
    values["channels"] = [
        {"column": f"time_data.{k}", "quantity": "acceleration", "unit": "m/s^2", "point": k} for k in (1, 2)
    ]
    (folder / "own.yaml").write_text(yaml.safe_dump(values))
    run = read_import(folder / "own.yaml")
    assert (run.sample_rate, run.samples) == (1000.0, 4000)


def test_equal_clocks_are_one(given: Callable[[str], Path]) -> None:
    folder = given("06")
    (folder / "multi.yaml").write_text(sidecar_templates(folder / "multi.lvm")[0])
    run = read_import(folder / "multi.yaml")
    assert (run.sample_rate, run.samples, len(run.channels)) == (51200.0, 200, 2)


def test_a_rounded_step_is_no_contradiction(given: Callable[[str], Path]) -> None:
    folder = given("07")
    assert read_import(folder / "s.yaml").sample_rate == 1024.0
    run = read_import(changed(folder / "s.yaml", sample_rate=None))
    assert run.sample_rate == pytest.approx(1024.0, rel=2.0 * run.clock_std)
    assert any("has few digits" in note for note in run.notes)
    with pytest.raises(BenchError, match="which of the two"):
        read_import(changed(folder / "s.yaml", sample_rate=1000))


@pytest.mark.parametrize(("number", "file", "samples"), [("08", "ms", 2000), ("10", "stamps", 500)])
def test_times_in_ms_and_as_dates(given: Callable[[str], Path], number: str, file: str, samples: int) -> None:
    folder = given(number)
    (text,) = sidecar_templates(folder / f"{file}.csv")
    assert "'?'" not in text
    (folder / "own.yaml").write_text(text)
    run = read_import(folder / "own.yaml")
    assert (run.sample_rate, run.samples) == (1000.0, samples)
    assert isinstance(run.sidecar, Sidecar)


def test_coarse_stamps_are_checked_and_not_used(given: Callable[[str], Path]) -> None:
    folder = given("09")
    run = read_import(folder / "s.yaml")
    assert (run.sample_rate, run.samples) == (1600.0, 3200)
    assert any("too coarse for 1600 Hz" in note for note in run.notes)
    with pytest.raises(BenchError, match="give sample_rate: the column is then only checked"):
        read_import(changed(folder / "s.yaml", sample_rate=None))
    # A rate that the stamps deny is not a rate.
    with pytest.raises(BenchError):
        read_import(changed(folder / "s.yaml", sample_rate=1500))


def test_a_bag_of_another_ros_node(given: Callable[[str], Path]) -> None:
    folder = given("12")
    for name in ("imu_mcap", "imu_db3"):
        with pytest.raises(BenchError, match="import --init"):
            extract_bag(folder / name)
        values = yaml.safe_load(sidecar_templates(folder / name)[0])
        (channel,) = values["channels"]
        assert channel["column"] == "/imu/data.linear_acceleration.z"
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(values))
        import_data(folder / f"{name}.yaml", folder / f"bag_{name}")
        (decay,) = free_decays(Bag.open(folder / f"bag_{name}"))
        assert decay.mean("frequency_hz")[0] == pytest.approx(20.0, rel=1e-4)
        assert decay.mean("damping_ratio")[0] == pytest.approx(0.5 / (40.0 * math.pi), rel=1e-3)


def test_the_force_is_off_within_the_window(given: Callable[[str], Path]) -> None:
    (point,) = points(given("13") / "s.yaml")
    assert point.status is PointStatus.REJECTED
    assert "The force (f1) was off from 8 to 8.12 s" in point.reason


def test_drift_is_taken_out(given: Callable[[str], Path]) -> None:
    (point,) = points(given("14") / "s.yaml")
    assert point.status is PointStatus.OK
    assert "x1 drifts" in point.reason
    assert point.damping_ratio == pytest.approx(0.005, rel=1e-6)
    assert point.modal_amplitude == pytest.approx(1e-6, rel=1e-6)
    assert np.isfinite(point.damping_ratio_std)
    assert point.damping_ratio_std > 1e-12
