"""Frequency responses as a laboratory has them, their truth known: see the README of the data."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict

ONE_MODE = "structure: {kind: modal, modes: [{frequency_hz: 50.0, damping_ratio: 0.01, modal_mass_kg: 1.0}]}\n"
ON_TABLE = (
    "structure: {kind: modal, modes: [{frequency_hz: 31.4, damping_ratio: 0.004, modal_mass_kg: 1.0, "
    "participation: 1.57}]}\nexciter: {kind: shaking_table, point: 1}\n"
)


def imported(
    source: Path, folder: Path, name: str, levels: tuple[float, ...], model: str, keys: dict[str, object]
) -> tuple[Path, Path]:
    """The bag of a table's levels, and the rig file."""
    if not (source / f"{name}_{levels[0]:g}_up.csv").is_file():
        pytest.skip(f"the laboratory's data ({source}) is not on this machine")
    segments = []
    for level in levels:
        for direction in ("up", "down"):
            file = f"{name}_{level:g}_{direction}.csv"
            shutil.copy(source / file, folder / file)
            own = {"kind": "frf", "file": file, "point": 1, "drive_point": 1, "level": level, "direction": direction}
            segments.append({**own, "name": f"{level:g} {direction}", **keys})
    sidecar = {"rig": "one_mode", "file": segments[0]["file"], "segments": segments}
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(sidecar), encoding="utf-8")
    (folder / "model.yaml").write_text(f"name: one_mode\n{model}", encoding="utf-8")
    import_data(folder / "sidecar.yaml", folder / "bag")
    return folder / "bag", folder / "model.yaml"


def diagnosed(*words: Any) -> Diagnosis:
    bag, model = imported(*words)
    return diagnose_bags(str(model), [bag], settings=DiagnosisSettings(look_ahead=False)).diagnosis


@pytest.mark.campaign
def test_a_duffing_oscillator_at_four_forces(data_folder: Path, tmp_path: Path) -> None:
    keys: dict[str, object] = {"unit": "m/s^2/N", "level_unit": "N"}
    found = diagnosed(data_folder / "laboratory", tmp_path, "duffing", (0.5, 2.0, 5.0, 8.0), ONE_MODE, keys)
    assert found.verdict is Verdict.EFFECT
    first = found.ranking[0]
    assert first.effect == "cubic_stiffness"
    assert first.probability >= 0.9
    k = first.parameters["k"]
    assert abs(k.value - 2.4e9) < 3.0 * k.std
    # The scale of the motion, 1 %, is 2 % of k as far as nothing else tells it.
    assert 0.015 * k.value < k.std < 0.05 * k.value
    assert found.gap.closed >= 0.9


@pytest.mark.campaign
def test_a_cantilever_that_softens_gets_its_damping_beside(data_folder: Path, tmp_path: Path) -> None:
    keys: dict[str, object] = {"unit": "(m/s^2)/(m/s^2)", "level_unit": "g"}
    found = diagnosed(data_folder / "laboratory", tmp_path, "table", (0.02, 0.1, 0.3), ON_TABLE, keys)
    assert found.verdict is Verdict.EFFECT
    # Two laws at one point may be one outside the library: what closes most alone comes first, then both.
    assert [item.effect for item in found.ranking[:2]] == ["cubic_stiffness", "cubic_stiffness + amplitude_damping"]
    assert not found.adequate
    assert any("with amplitude damping added it closes 99" in sentence for sentence in found.sentences)
    assert found.ranking[1].closed.low > found.ranking[0].closed.high >= 0.85
