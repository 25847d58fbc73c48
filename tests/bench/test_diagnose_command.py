"""``./nmt diagnose``: refusals, and one diagnosis from bag to rig file."""

from __future__ import annotations

import csv
import json
import re
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnose.observation_bags import altered, record, rig_with_noise, with_data

from nmt_bench.cli import build_parser, main
from nmt_bench.commands.requested_test import command_text
from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.records import LockEvent
from nmt_diagnose.ahead.proposals import proposals
from nmt_diagnose.effects.library import library
from nmt_diagnose.observations.read_observations import read_observations
from nmt_record.bag.bag_reader import Bag
from nmt_rig.rig import find_rig, load_rig
from nmt_session import Session, plan_test

pytestmark = pytest.mark.usefixtures("module_undrawn")

GAIN = 0.05
KEPT = ("response_gain", "cubic_stiffness", "phase_offset")
FEW = [word for effect in library() if effect.name not in KEPT for word in ("--without", effect.name)]
FILES = ["diagnosis.json", "model.yaml", "observables.csv", "report.html"]


@pytest.fixture(scope="module")
def gain_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A beam whose sensor x5 shows five percent too much."""
    rig = rig_with_noise()
    sensors = [s.model_copy(update={"gain": 1.0 + GAIN}) if s.point == 5 else s for s in rig.sensors]
    return record(tmp_path_factory.mktemp("real") / "run", rig.model_copy(update={"sensors": sensors}))


def diagnose(*words: str | Path) -> int:
    return main(["diagnose", "--quiet", *map(str, words)])


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "--model"),
        (["--model", "beam"], "--real"),
        (["--model", "wing", "--real", "bag"], "there is no rig wing"),
        (["--model", "beam", "--real", "nowhere"], "nowhere"),
        (["--model", "beam", "--real", "nowhere", "--without", "sunspots"], "--without: there is no effect sunspots"),
        (["--model", "beam", "--real", "nowhere", "--set", "structure.mass=1"], "unknown key structure.mass"),
        (["--model", "beam", "--real", "nowhere", "--seed", "-1"], "--seed must not be negative"),
        (["--model", "beam", "--real", "nowhere", "--matters", "force=1"], "--matters is one of frequency"),
    ],
)
def test_a_wrong_option_is_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert diagnose(*words, "--out", out) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not out.exists()


def test_results_are_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    assert diagnose("--model", "beam", "--real", "nowhere", "--out", tmp_path) == 2
    assert "is not empty" in capsys.readouterr().err


def test_a_wrong_gain_is_found_placed_and_mended(
    gain_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert diagnose("--model", "beam", "--real", gain_bag, *FEW, "--out", out) == 0
    shown = capsys.readouterr().out
    assert "Verdict: the model lacks response gain (a response sensor, channel x5)" in shown
    assert sorted(path.name for path in out.iterdir()) == FILES

    found = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "effect"
    head = found["ranking"][0]
    assert (head["effect"], head["place"], head["detail"]) == ("response_gain", "response_sensor", "x5")
    (value,) = head["parameters"].values()
    assert value["value"] == pytest.approx(GAIN, abs=4.0 * value["std"])
    assert found["where"][0]["place"] == "response_sensor"
    inputs = found["inputs"]
    assert inputs["bags"][0]["path"] == str(gain_bag)
    assert len(inputs["bags"][0]["sha256"]) == 64
    assert inputs["model_file"]["path"] == str(find_rig("beam"))
    assert "microslip" in inputs["withheld"]

    # The new rig file is the old one with this sensor's gain; the residual of the table shrinks with it.
    model = load_rig(out / "model.yaml")
    x5 = next(sensor for sensor in model.sensors if sensor.point == 5)
    assert x5.gain == pytest.approx(1.0 + GAIN, rel=0.01)
    assert "# identified, see assumptions" in (out / "model.yaml").read_text(encoding="utf-8")
    assert any("response gain" in line for line in model.assumptions)
    with open(out / "observables.csv", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["channel"] == "x5" and row["part"] == "ln_magnitude"]
    gap = np.array(
        [[float(row[key]) - float(row["measured"]) for row in rows] for key in ("model_as_given", "model_final")]
    )
    assert np.all(np.abs(gap[0]) > 0.03)
    assert np.all(np.abs(gap[1]) < 0.005)
    assert "response gain" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.campaign
def test_the_new_rig_file_leaves_no_gap(gain_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same bag against a model that has the wrong gain already."""
    out = tmp_path / "out"
    words = ["--model", "beam", "--set", f"sensors.3.gain={1.0 + GAIN}", "--real", gain_bag, *FEW]
    assert diagnose(*words, "--out", out) == 0
    found = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert found["verdict"] in ("none", "calibration")
    assert found["inputs"]["overrides"] == [f"sensors.3.gain={1.0 + GAIN}"]
    assert "lacks" not in capsys.readouterr().out


@pytest.mark.campaign
def test_a_next_test_runs_the_recorded_rig_and_keeps_the_answer(
    gain_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The proposed command, carried out as it stands, gives a recording of the real rig; the model's own is refused."""
    real = Bag.open(gain_bag).rig_yaml
    assert real
    (tmp_path / "rig.yaml").write_text(real, encoding="utf-8")
    levels = record(tmp_path / "bag", load_rig(tmp_path / "rig.yaml"), run={"device": "simulated rig"})
    found = proposals(load_rig("beam"), read_observations([levels], load_rig("beam")))
    request = next(item.request for item in found if item.request.exciters == (5,))
    words = shlex.split(command_text(request))
    assert words[0] == "./nmt"
    asked = build_parser("run").parse_args(words[1:])
    next_bag = tmp_path / "point5"
    with Session(
        plan_test(asked.rig, asked.levels, exciter=asked.exciter, window_periods=10), next_bag, extract=False
    ) as session:
        session.run()
        assert session.levels_locked >= 3
    out = tmp_path / "out"
    assert diagnose("--model", "beam", "--real", levels, "--real", next_bag, *FEW, "--out", out) == 0
    answer = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert answer["verdict"] == "effect"
    head = answer["ranking"][0]
    assert (head["effect"], head["detail"]) == ("response_gain", "x5")
    assert head["probability"] > 0.7
    assert [bag["origin"]["kind"] for bag in answer["inputs"]["bags"]] == ["simulated", "simulated"]
    shown = capsys.readouterr().out
    assert re.search(r"These recordings would show \d+ effects, such as .* list the smallest of", shown)
    assert "Smallest effects that these recordings would show" not in shown

    with Session(plan_test("beam", [0.3], exciter=5, window_periods=5), tmp_path / "own", extract=False) as session:
        session.run()
    refusal = "own was simulated from the model itself (rig 'beam')"
    assert refusal in refused(capsys, tmp_path / "no", "--model", "beam", "--real", levels, "--real", tmp_path / "own")


# -- hostile real sides -----------------------------------------------------------------------------------------------


def refused(capsys: pytest.CaptureFixture[str], out: Path, *words: str | Path) -> str:
    """The one sentence of a refusal that leaves nothing behind."""
    assert diagnose(*words, "--out", out) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert not out.exists()
    assert not list(out.parent.glob(".*part*"))
    return error


def test_a_bag_of_another_rig(gain_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    error = refused(capsys, tmp_path / "out", "--model", "joint_resonator", "--real", gain_bag)
    assert "name the rig file of the rig that was tested" in error


def test_three_periods(gain_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def short(event: LockEvent) -> LockEvent:
        return replace(event, window_periods=3, window_samples=3 * 450)

    bag = altered(gain_bag, tmp_path / "short", events=short)
    assert "period" in refused(capsys, tmp_path / "out", "--model", "beam", "--real", bag)


def test_a_force_of_nan(gain_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def spoilt(block: SampleBlock) -> Iterator[SampleBlock]:
        yield with_data(block, np.full_like(block.data, np.nan)) if block.quantity is Quantity.FORCE else block

    bag = altered(gain_bag, tmp_path / "nan", spoilt)
    refused(capsys, tmp_path / "out", "--model", "beam", "--real", bag)


def test_a_file_that_is_no_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "data.mcap"
    path.write_bytes(b"\x00" * 100)
    assert str(path) in refused(capsys, tmp_path / "out", "--model", "beam", "--real", path)
