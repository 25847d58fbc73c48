"""Channels that are late by what their conditioners take, behind a held drive: healthy, with filters and without."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from nmt_blind.cases.blind_rigs import blind_rig
from nmt_blind.cases.laboratory import record_backbone, record_random
from nmt_blind.cases.laboratory_rig import Converters
from nmt_blind.cases.rig_edits import Edit, rig_yaml, with_edits
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Verdict

# Delays against the drive (s) and gains by kind of sensor.
LATE = {"acceleration": 85e-6, "force": -23e-6, "displacement": 31e-6}
GAINS = {"acceleration": 0.99, "force": 1.01, "displacement": 1.006}


@pytest.mark.parametrize("filtered", [pytest.param(True, marks=pytest.mark.campaign), False])
def test_late_channels_are_no_gap(tmp_path: Path, filtered: bool) -> None:
    """On top of its resonance a random test tells damping to 1e-3: windows at a wrong phase contradict it."""
    rig = blind_rig("modal_beam")
    model, bench = rig.model(), replace(rig.bench, levels=rig.bench.levels[::4])
    edits = [
        Edit(("sensors", number, key), values[sensor.quantity])
        for number, sensor in enumerate(model.sensors)
        for key, values in (("delay_s", LATE), ("gain", GAINS))
        if sensor.quantity in values
    ]
    truth = with_edits(model, edits)
    converters = Converters(held=True, filtered=filtered)
    record_backbone(tmp_path / "backbone", truth, model, bench, 3, converters)
    record_random(tmp_path / "random", truth, model, bench, 3, converters)
    (tmp_path / "model.yaml").write_text(rig_yaml(model), encoding="utf-8")
    bags = [tmp_path / "backbone", tmp_path / "random"]
    found = diagnose_bags(tmp_path / "model.yaml", bags, settings=DiagnosisSettings(look_ahead=False)).diagnosis
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION)
    assert all(value < 1.5 for name, value in found.features.items() if name.startswith("rms:"))


@pytest.mark.campaign
def test_filters_behind_a_shaker_keep_images_out(tmp_path: Path) -> None:
    """What images of a held drive may be off by is more noise than what is not there: less is left over it."""
    rig = blind_rig("beam")
    model, bench = rig.model(), replace(rig.bench, levels=rig.bench.levels[::3])
    late = {"acceleration": -75e-6, "force": 55e-6, "displacement": -83e-6}
    edits = [
        Edit(("sensors", number, "delay_s"), late[sensor.quantity])
        for number, sensor in enumerate(model.sensors)
        if sensor.quantity in late
    ]
    truth, converters = with_edits(model, edits), Converters(held=True, filtered=True)
    record_backbone(tmp_path / "backbone", truth, model, bench, 3, converters)
    record_random(tmp_path / "random", truth, model, bench, 3, converters)
    (tmp_path / "model.yaml").write_text(rig_yaml(model), encoding="utf-8")
    bags = [tmp_path / "backbone", tmp_path / "random"]
    found = diagnose_bags(tmp_path / "model.yaml", bags, settings=DiagnosisSettings(look_ahead=False)).diagnosis
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION)
