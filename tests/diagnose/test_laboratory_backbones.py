"""Backbones as laboratories have them, computed from closed forms with scatter: what is named, whatever their unit."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from nmt_bench.cli import main
from nmt_rig.rig import load_rig

# Frequency at rest, Hz, and damping ratio of the linear model to start from.
STARTS = {"clamped": (133.1, 0.0035), "very_thin": (133.1, 0.0035), "bolted": (170.0, 0.0011)}
CUBIC = {
    "clamped_backbone": 0.9,
    "clamped_backbone_std": 0.9,
    "very_thin_backbone": 0.94,
    "very_thin_backbone_std": 0.94,
}


def diagnosed(data_folder: Path, folder: Path, name: str, scale: float = 1.0) -> dict[str, Any]:
    """``diagnosis.json`` of a table whose amplitudes are multiplied."""
    table = data_folder / "laboratory" / f"{name}.csv"
    if not table.is_file():
        pytest.skip(f"the table of the laboratory ({table}) is not on this machine")
    with open(table, encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    lines = [",".join(rows[0])]
    for row in rows:
        lines.append(",".join(repr(scale * float(v)) if k == "amplitude" else v for k, v in row.items()))
    (folder / "table.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    hz, ratio = next(value for start, value in STARTS.items() if name.startswith(start))
    (folder / "rig.yaml").write_text(
        f"name: one_mode\nstructure: {{kind: modal, modes: [{{frequency_hz: {hz}, damping_ratio: {ratio}, "
        'modal_mass_kg: 1.0}]}\ntest: {levels: "0.01:1:8"}\n',
        encoding="utf-8",
    )
    (folder / "table.yaml").write_text(
        "rig: rig.yaml\nfile: table.csv\nsegments: [{kind: backbone, unit: mm, point: 1}]\n", encoding="utf-8"
    )
    shutil.rmtree(folder / "bag", ignore_errors=True)
    assert main(["import", str(folder / "table.yaml"), "--out", str(folder / "bag")]) == 0
    words = ["--quiet", "--jobs", "1", "--force", "--model", str(folder / "rig.yaml"), "--real", str(folder / "bag")]
    assert main(["diagnose", *words, "--out", str(folder / "out")]) == 0
    result: dict[str, Any] = json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    return result


@pytest.mark.campaign
@pytest.mark.parametrize("name", CUBIC)
def test_beams_that_stretch_are_cubic_in_any_unit(data_folder: Path, tmp_path: Path, name: str) -> None:
    found = diagnosed(data_folder, tmp_path, name)
    assert found["verdict"] == "effect"
    first = found["ranking"][0]
    assert first["effect"] == "cubic_stiffness"
    assert found["gap"]["closed"] >= CUBIC[name]
    spring = load_rig(str(tmp_path / "out" / "model.yaml")).local_elements[0]
    assert spring.kind == "cubic_spring"
    for scale in (0.01, 100.0):
        other = diagnosed(data_folder, tmp_path, name, scale)
        assert other["verdict"] == "effect"
        assert other["ranking"][0]["effect"] == "cubic_stiffness"
        assert other["ranking"][0]["probability"] == pytest.approx(first["probability"], abs=0.01)
        assert other["gap"]["closed"] == pytest.approx(found["gap"]["closed"], abs=0.01)


@pytest.mark.campaign
def test_a_bolted_joint_is_friction_and_no_air_drag(data_folder: Path, tmp_path: Path) -> None:
    found = diagnosed(data_folder, tmp_path, "bolted_backbone")
    assert found["verdict"] == "effect"
    first = found["ranking"][0]
    assert first["effect"] == "microslip"
    assert "air_drag" not in first["equivalents"]
    assert found["gap"]["closed"] >= 0.9
    # A uniform Iwan joint with 7 % of the stiffness of 1 kg at 170 Hz, slip force 60 N.
    truth = {"kt": 0.07 * (2.0 * 3.14159 * 170.0) ** 2, "slip_force": 60.0, "chi": 0.0}
    for key, value in truth.items():
        said = first["parameters"][key]
        assert abs(said["value"] - value) < 3.0 * said["std"], key
