"""``./nmt diagnose --group``: three benches with a sensor that shows too much, from bags to the page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest
from diagnose.observation_bags import record, rig_with_noise
from diagnose.test_units import diagnosis

from nmt_bench.cli import main
from nmt_diagnose.effects.library import library

pytestmark = pytest.mark.usefixtures("module_undrawn")

GAINS = {"bench 1": 0.05, "bench 2": 0.05, "bench 3": 0.05}
FEW = [word for effect in library() if effect.name != "response_gain" for word in ("--without", effect.name)]


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("real")
    lines = ["recording,unit"]
    for number, (unit, gain) in enumerate(GAINS.items()):
        rig = rig_with_noise()
        sensors = [s.model_copy(update={"gain": 1.0 + gain}) if s.point == 5 else s for s in rig.sensors]
        changed = rig.model_copy(update={"sensors": sensors, "seed": 10 + number})
        lines.append(f"{record(folder / f'run-{number}', changed).relative_to(folder)},{unit}")
    (folder / "units.csv").write_text("\n".join(lines) + "\n")
    return folder / "units.csv"


@pytest.mark.campaign
def test_one_effect_is_found_for_all(table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["diagnose", "--quiet", "--model", "beam", "--group", str(table), *FEW, "--out", str(out)]) == 0
    assert "All 3 units: one effect for all, response gain at channel x5." in capsys.readouterr().out
    group = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))["group"]
    head = group["quantities"][0]
    assert head["name"].startswith("response gain at channel x5: ")
    found = head["components"]
    assert found["mean"] == pytest.approx(0.05, abs=4.0 * found["mean_std"])
    assert found["next_low"] < 0.05 < found["next_high"]
    assert not found["odd"]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "1-bench-1/report.html" in page
    assert (out / "1-bench-1" / "report.html").is_file()


def test_each_unit_is_diagnosed_and_all_together(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the command does with the diagnoses, which are made up here."""
    stiffness = {"a": 1.00e9, "b": 1.01e9, "c": 2.00e9, "d": 0.99e9, "e": 1.02e9}
    for name in stiffness:
        (tmp_path / name).mkdir()
    lines = ["recording,unit", *(f"{name},leg {name}" for name in stiffness)]
    (tmp_path / "units.csv").write_text("\n".join(lines) + "\n")

    def made_up(model: object, bags: Sequence[Path], *_: object) -> SimpleNamespace:
        (bag,) = bags
        return SimpleNamespace(diagnosis=diagnosis(stiffness=stiffness[bag.name], std=1e7))

    monkeypatch.setattr("nmt_diagnose.diagnose.diagnose_bags", made_up)
    monkeypatch.setattr("nmt_report.diagnosis_files.write_diagnosis", lambda *_: "")
    out = tmp_path / "out"
    words = ["--model", "beam", "--group", str(tmp_path / "units.csv"), "--out", str(out)]
    assert main(["diagnose", "--quiet", *words]) == 0
    printed = capsys.readouterr().out
    assert "All 5 units: one effect for all, cubic stiffness at point 3." in printed
    assert "leg c differs from its sisters in cubic stiffness at point 3: stiffness_n_m3 by" in printed
    group = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))["group"]
    assert [odd["unit"] for odd in group["quantities"][0]["components"]["odd"]] == ["leg c"]
    assert "3-leg-c/report.html" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "--real BAG for one unit, or --group TABLE"),
        (["--real", "bag", "--group", "units.csv"], "not both"),
        (["--group", "nowhere.csv"], "nowhere.csv"),
    ],
)
def test_a_group_and_one_unit_are_told_apart(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", "--quiet", "--model", "beam", *words, "--out", str(tmp_path / "out")]) == 2
    assert sentence in capsys.readouterr().err
