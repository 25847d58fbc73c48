"""A measured record: the cubic spring of the Silverbox, which its linear model lacks, on the arrow that no fit sees."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from nmt_bench.cli import main
from nmt_rig.rig import load_rig

RATE = 1e7 / 2**14
HOW_TO = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "diagnose-a-record.md"


def written(name: str) -> str:
    """A file's text as the how-to shows it, below the line that names it."""
    text = HOW_TO.read_text(encoding="utf-8")
    start = text.index("```yaml\n", text.index(f"`{name}`")) + len("```yaml\n")
    return text[start : text.index("```", start)]


@pytest.mark.campaign
def test_the_silverbox_lacks_a_cubic_spring(
    data_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    data = data_folder / "silverbox" / "SNLS80mV.csv"
    if not data.is_file():
        pytest.skip(f"the measured record ({data}) is not on this machine")
    (tmp_path / "SNLS80mV.csv").symlink_to(data)
    monkeypatch.chdir(tmp_path)
    for name in ("silverbox.yaml", "multisine.yaml"):
        Path(name).write_text(written(name), encoding="utf-8")
    multisine, arrow = "{kind: record, start: 66.6, stop: 108.0}", "{kind: record, start: 0.0, stop: 65.53}"
    assert arrow in HOW_TO.read_text(encoding="utf-8")
    Path("arrow.yaml").write_text(written("multisine.yaml").replace(multisine, arrow), encoding="utf-8")
    for name in ("multisine", "arrow"):
        assert main(["import", f"{name}.yaml", "--out", name]) == 0
    words = ["--model", "silverbox.yaml", "--real", "multisine", "--real", "arrow", "--hold-out", "arrow"]
    assert main(["diagnose", "--quiet", "--jobs", "1", *words, "--out", "diagnosis"]) == 0
    assert "Verdict: cubic stiffness + power law damping (the structure, point 1) explains " in capsys.readouterr().out

    found = json.loads(Path("diagnosis/diagnosis.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "effect"
    first = found["ranking"][0]
    assert (first["effect"], first["detail"]) == ("cubic_stiffness + power_law_damping", "1 + 1")
    assert first["probability"] >= 0.9
    assert found["gap"]["held_out"] == ["the test arrow"]
    assert found["gap"]["closed"] >= 0.97
    (arrow,) = (item for name, item in found["gap"]["per_observable"].items() if name.startswith("arrow"))
    # Literature (Noël and Schoukens 2017): the best linear model of the arrow leaves 14.1 mV, one with a cubic spring
    # 0.42 mV. The model as given, integrated by scipy, leaves 20.4 mV, before gains and delays are taken out.
    volts_of_one = arrow["before_unit"] / arrow["before"]
    assert 1e3 * volts_of_one * found["gap"]["as_given"] == pytest.approx(17.9, abs=1.5)
    assert 1e3 * arrow["after_unit"] < 0.6
    others = [item["closed"]["value"] for item in found["ranking"][1:] if "cubic" not in item["effect"]]
    assert all(value is None or not math.isfinite(value) or value < 0.9 for value in others)

    model = load_rig("diagnosis/model.yaml")
    (spring,) = (element for element in model.local_elements if element.kind == "cubic_spring")
    value = first["parameters"]["cubic_stiffness@1.k"]
    assert spring.stiffness_n_m3 == pytest.approx(value["value"], rel=1e-6)
    assert abs(value["value"] - 7.39e5) < 2.0 * value["std"] < 5e4
    assert np.isclose(model.sample_rate_hz, RATE)
