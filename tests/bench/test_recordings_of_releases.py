"""Results folders that releases wrote stay readable, whole: extract, report, diagnose, export, open.

``recordings`` holds one for each release: bag, ``modal.json``, ``modal.csv``, ``run.json`` and ``rig.yaml`` of a small
test of the beam (levels 0.1 and 0.6 V, 1000 Hz), as that release's ``./nmt run`` left them. The one of 0.1.0 comes
from its last commit. They are never made again.
"""

from __future__ import annotations

import json
import math
import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiers import with_quick

import nmt
from nmt_bench.cli import main
from nmt_core.bench_version import bench_version
from nmt_core.messages.modal_point import MEASURED
from nmt_core.messages.wire import MODAL_POINT
from nmt_diagnose.effects.library import library
from nmt_extract.modal.table import read_csv, read_json
from nmt_record import Bag
from nmt_report.run_data_from_bag import report_data_from_bag

RECORDINGS = Path(__file__).with_name("recordings")
RELEASES = sorted(path.name.removesuffix(".tar.xz") for path in RECORDINGS.glob("*.tar.xz"))
OF_OTHER_TESTS = ("hysteresis_damping", "floquet_")
"""Quantities that a test of these levels does not have."""
KEPT = ("response_gain", "phase_offset")
FEW = [word for effect in library() if effect.name not in KEPT for word in ("--without", effect.name)]


@pytest.fixture(scope="module", params=RELEASES)
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results folder of one release."""
    folder = tmp_path_factory.mktemp("release") / "run"
    with tarfile.open(RECORDINGS / f"{request.param}.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder


def stored_quantities(run: Path) -> set[str]:
    """Measured quantities that the release knew."""
    return set(json.loads((run / "modal.json").read_text())["points"][0]) & set(MEASURED)


def test_there_is_one_of_the_first_release_and_of_this_one() -> None:
    assert {"0.1.0", bench_version()} <= set(RELEASES)


def test_the_bag_says_what_its_table_says(run: Path) -> None:
    """Points of bag and ``modal.json`` were one thing when they were written, and are when they are read."""
    points, inputs = read_json(run / "modal.json")
    assert [point.level for point in points] == [0.1, 0.6]
    assert inputs["run_id"] == json.loads((run / "run.json").read_text())["run_id"]
    known = {name for name in stored_quantities(run) if not name.startswith(OF_OTHER_TESTS)}
    for stored, point in zip(Bag.open(run / "bag").records("modal_point", MODAL_POINT), points, strict=True):
        assert point.identical(stored)
        assert all(math.isfinite(getattr(point, name)) for name in known)
        assert all(math.isnan(getattr(point, name)) for name in set(MEASURED) - known)
    assert read_csv(run / "modal.csv")["damping_ratio"] == [point.damping_ratio for point in points]


@pytest.mark.usefixtures("undrawn")
def test_extraction_finds_what_was_found(run: Path, tmp_path: Path) -> None:
    """To the rounding of another processor: bit for bit holds on the machine that recorded."""
    assert main(["extract", str(run), "--out", str(tmp_path / "out")]) == 0
    before, _ = read_json(run / "modal.json")
    after, _ = read_json(tmp_path / "out" / "modal.json")
    for old, new in zip(before, after, strict=True):
        for name in stored_quantities(run):
            assert np.isclose(getattr(new, name), getattr(old, name), rtol=1e-9, atol=1e-9, equal_nan=True), name
    assert "damping" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8").lower()


def test_a_report_has_levels_locks_and_states(run: Path) -> None:
    data = report_data_from_bag(run / "bag")
    assert [level.amplitude for level in data.levels if level.amplitude] == [0.1, 0.6]
    assert [lock.level_index for lock in data.locks] == [0, 1]
    assert data.loss is None
    assert data.rig


@pytest.mark.parametrize("form", ["uff", "csv"])
def test_export(form: str, run: Path, tmp_path: Path) -> None:
    assert main(["export", str(run), "--format", form, "--out", str(tmp_path / "out")]) == 0
    assert main(["import", str(tmp_path / "out" / "sidecar.yaml"), "--out", str(tmp_path / "again")]) == 0
    assert len(Bag.open(tmp_path / "again").lock_events()) == 2


@pytest.mark.parametrize("run", with_quick(RELEASES, RELEASES[0]), indirect=True)
def test_diagnosis(run: Path, tmp_path: Path) -> None:
    words = ["diagnose", "--quiet", "--jobs", "1", "--model", str(run / "rig.yaml"), "--real", str(run), *FEW]

    assert main([*words, "--allow-own-model", "--out", str(tmp_path / "out")]) == 0
    verdict = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert verdict["verdict"]


def test_opened_by_an_analyst(run: Path) -> None:
    results = nmt.open(run)
    assert len(results.to_dataframe()) == 2


def test_a_table_of_points_with_other_fields_is_read(run: Path, tmp_path: Path) -> None:
    """What a file lacks has the default of the record: NaN, not 0; what is unknown is ignored."""
    document = json.loads((run / "modal.json").read_text())
    for values in document["points"]:
        for name in ("mac", "mac_std", "window_periods", "participation"):
            del values[name]
        values["q_factor"] = 3.0
        values["words"] = ["one"]
    (tmp_path / "modal.json").write_text(json.dumps(document))
    before, _ = read_json(run / "modal.json")
    after, _ = read_json(tmp_path / "modal.json")
    for old, new in zip(before, after, strict=True):
        assert math.isnan(new.mac)
        assert math.isnan(new.mac_std)
        assert new.window_periods == 0
        assert new.participation.size == 0
        rest = {"mac": old.mac, "mac_std": old.mac_std, "window_periods": old.window_periods}
        assert replace(new, **rest, participation=old.participation).identical(old)
