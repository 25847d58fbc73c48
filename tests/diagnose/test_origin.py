"""What made a recording, as its bag says, and what follows from it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from diagnose.observation_bags import record, rig_with_noise

from nmt_bench.commands.requested_test import command_text
from nmt_core.errors import BenchError
from nmt_diagnose.ahead.proposals import proposals
from nmt_diagnose.observations.origin import Origin, origin_of, refuse_own_recordings, same_rig, strangers
from nmt_diagnose.observations.read_observations import read_observations
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.bag_writer import BagWriter
from nmt_rig.rig import load_rig

REAL = rig_with_noise(overrides=["structure.youngs_modulus_pa=2.2e11"])


def bag(folder: Path, **run: Any) -> Bag:
    """A bag with nothing but a description of itself."""
    writer = BagWriter(
        folder, run_json=json.dumps({"run_id": "a", **run}), rig_yaml=REAL.model_dump_json(), clock=lambda: 0
    )
    writer.close("done", "")
    return Bag.open(folder)


def test_a_simulated_run_names_its_rig_file(tmp_path: Path) -> None:
    plant = {"rig_file": str(tmp_path / "elsewhere.yaml")}
    folder = tmp_path / "levels"
    found = bag(folder / "bag", rig="beam", device="simulated rig", parameters={"plant": plant},
                plan={"window_periods": 40})  # fmt: skip
    lost = origin_of(found, folder, ["levels"])
    assert (lost.kind, lost.rig_file, lost.periods, lost.tests) == ("simulated", "", 40, ("levels",))
    assert "kept in the bag" in lost.text
    # Another rig's file is not that of the recording.
    (folder / "rig.yaml").write_text("name: another\n", encoding="utf-8")
    (tmp_path / "elsewhere.yaml").write_text(REAL.model_dump_json(), encoding="utf-8")
    assert origin_of(found, folder).rig_file == plant["rig_file"]
    (folder / "rig.yaml").write_text(REAL.model_dump_json(), encoding="utf-8")
    assert origin_of(found, folder).rig_file == str(folder / "rig.yaml")
    assert origin_of(found, folder / "bag").rig_file == str(folder / "rig.yaml")
    assert str(folder / "rig.yaml") in origin_of(found, folder).text


def test_other_recordings_say_where_they_come_from(tmp_path: Path) -> None:
    files = [{"name": "data.csv", "sha256": "0"}, {"name": "more.csv", "sha256": "1"}]
    imported = origin_of(bag(tmp_path / "i", imported={"files": files}), tmp_path / "i")
    assert (imported.kind, imported.files) == ("imported", ("data.csv", "more.csv"))
    assert "data.csv, more.csv" in imported.text
    measured = origin_of(
        bag(tmp_path / "m", device="SoundCard", parameters={"plant": {"rig_file": "r"}}), tmp_path / "m"
    )
    assert (measured.kind, measured.device) == ("measured", "SoundCard")
    assert "SoundCard" in measured.text
    assert origin_of(bag(tmp_path / "u", rig="beam"), tmp_path / "u").kind == "unknown"
    # A run that does not know its device, although its plant has a rig file, may be one on hardware.
    by_hand = bag(tmp_path / "h", device="", parameters={"plant": {"rig_file": "r"}})
    assert origin_of(by_hand, tmp_path / "h").kind == "unknown"
    # Before runs named their device only simulated ones had a plant with a rig file.
    assert origin_of(bag(tmp_path / "o", parameters={"plant": {"rig_file": "r"}}), tmp_path / "o").kind == "simulated"


def test_one_rig_is_one_however_it_is_tested() -> None:
    beam = load_rig("beam")
    assert same_rig(beam, load_rig("beam", ["exciter.point=5", "test.mode=2", "seed=9"]))
    for change in ("structure.density_kg_m3=7801", "local_elements.0.slip_force_n=2.1", "sensors.1.gain=1.01",
                   "pll.phase_offset_rad=0.02", "clock_error=1e-6"):  # fmt: skip
        assert not same_rig(beam, load_rig("beam", [change])), change


def test_recordings_of_the_model_itself_are_refused_and_strangers_told() -> None:
    beam = load_rig("beam")
    own, real = Origin("simulated", "beam", beam), Origin("simulated", "real", REAL)
    imported = Origin("imported", "beam", beam)
    refuse_own_recordings(beam, [("a", real), ("b", imported), ("c", Origin("simulated"))])
    with pytest.raises(BenchError, match=r"^b was simulated from the model itself \(rig 'beam'\)"):
        refuse_own_recordings(beam, [("a", real), ("b", own)])
    assert strangers([("a", real), ("b", imported), ("c", real)]) == []
    (sentence,) = strangers([("a", real), ("b", own)])
    assert sentence.startswith("b and a were simulated from different rig files")


@pytest.fixture(scope="module")
def levels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("real run")
    run = {"device": "simulated rig", "plan": {"window_periods": 40}}
    record(folder / "bag", REAL, levels=(0.3, 0.6), periods=20, run=run)
    (folder / "rig.yaml").write_text(REAL.model_dump_json(), encoding="utf-8")
    return folder


def test_commands_run_the_recorded_rig_as_it_was_recorded(levels: Path) -> None:
    beam = load_rig("beam")
    observations = read_observations([levels], beam, allow_own_model=False)
    found = proposals(beam, observations)
    assert len(found) > 4
    for proposal in found:
        command = command_text(proposal.request)
        assert f"'{levels / 'rig.yaml'}'" in command
        assert command.startswith(("./nmt run ", "./nmt linear "))
        assert ("--periods 40" in command) == command.startswith("./nmt run ")
    with pytest.raises(BenchError, match="simulated from the model itself"):
        refuse_own_recordings(REAL, [(str(levels), observations.origins[0])])


def test_of_data_measured_elsewhere_there_is_no_command(tmp_path: Path) -> None:
    run = {"imported": {"files": [{"name": "data.npz", "sha256": "0"}], "sidecar": {}, "notes": []}}
    found = read_observations(
        [record(tmp_path / "bag", REAL, levels=(0.3, 0.6), periods=20, run=run)], load_rig("beam")
    )
    assert {command_text(proposal.request) for proposal in proposals(load_rig("beam"), found)} == {""}
    assert all(proposal.text for proposal in proposals(load_rig("beam"), found))
