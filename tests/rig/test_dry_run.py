"""Values that pass the schema and break the physics are refused before anything starts; sound rigs are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from nmt_core.errors import BenchError
from nmt_rig.rig import find_rig, load_rig, rig_names
from nmt_rig.rig_model import build_system

ABSURD = {
    "exciter.coil_mass_kg=1e308": "beyond every quantity",
    "exciter.coil_mass_kg=1e20": "check the units of the masses",
    "exciter.coil_mass_kg=1e-20": "check the units of the masses",
    "exciter.inductance_h=1e-30": "too small",
    "exciter.inductance_h=1e-20": "inductance against resistance",
    "exciter.resistance_ohm=9e39": "beyond every quantity",
    "exciter.resistance_ohm=9e29": "inductance against resistance",
    "sensors.0.delay_s=1e9": "by 10 s at most",
    "sensors.0.low_pass_hz=1e300": "beyond every quantity",
    "sensors.0.low_pass_hz=1e20": "far beyond what 10000 samples a second show",
    "structure.youngs_modulus_pa=1e-20": "are rigid-body modes of rig beam",
    "structure.youngs_modulus_pa=1e29": "time constant",
    "structure.length_m=1e-20": "check the units of the masses",
    "sample_rate_hz=40": "mode 1 of rig beam is at 22",
    "sample_rate_hz=1e20": "no bench samples faster",
}


@pytest.mark.parametrize("override", ABSURD)
def test_absurd_values_are_refused_in_a_sentence(override: str) -> None:
    with pytest.raises(BenchError, match=ABSURD[override]) as caught:
        load_rig("beam", [override])
    assert "\n" not in str(caught.value)


def test_too_large_models_are_refused_before_they_are_built() -> None:
    with pytest.raises(BenchError, match="elements times mesh_refinement is 4000"):
        load_rig("beam", ["structure.elements=200", "structure.mesh_refinement=20"])


def test_too_many_sensors(tmp_path: Path) -> None:
    values = yaml.safe_load(find_rig("beam").read_text())
    values["sensors"] += [{"quantity": "displacement", "point": 1, "channel": f"c{i}"} for i in range(2_000)]
    path = tmp_path / "many.yaml"
    path.write_text(yaml.safe_dump(values))
    with pytest.raises(BenchError, match="sensors are more than the 200"):
        load_rig(path)


@pytest.mark.parametrize("name", rig_names())
def test_shipped_rigs_pass(name: str) -> None:
    load_rig(name)


@pytest.mark.parametrize(
    "overrides",
    [
        ["structure.elements=25", "structure.mesh_refinement=4"],
        ["sample_rate_hz=102400", "exciter.inductance_h=1e-6"],
        ["exciter.coil_mass_kg=1e-4", "structure.youngs_modulus_pa=1e12"],
        ["sensors.0.low_pass_hz=200000", "sensors.0.delay_s=0.5"],
    ],
)
def test_unusual_rigs_pass_and_can_be_computed(overrides: list[str]) -> None:
    system = build_system(load_rig("beam", overrides))
    assert np.isfinite(system.mass).all()
