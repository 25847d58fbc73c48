"""An angle, its rate and a torque keep their units from the import through extraction, export and back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nmt_bench.data_import import import_data
from nmt_core.key_units import of_rotation, unit_of_key
from nmt_core.vocabulary import ROTATION_UNITS, Quantity
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.observations.read_observations import read_observations
from nmt_extract.decays.free_decay import free_decays
from nmt_record import Bag
from nmt_record.exchange import FORMATS
from nmt_record.exchange.export.exported_run import export_run
from nmt_record.windows.segments import read_signals
from nmt_rig.rig import load_rig

RATE, COUNT = 500.0, 5000
TIME = np.arange(COUNT) / RATE
ANGLE = 0.2 * np.exp(-0.3 * TIME) * np.cos(2.0 * np.pi * 9.0 * TIME)


def imported(folder: Path, **changes: Any) -> Path:
    folder.mkdir()
    rng = np.random.default_rng(0)
    np.savez(
        folder / "t.npz", sample_rate=RATE, q=np.degrees(ANGLE), w=np.gradient(ANGLE, TIME), m=rng.normal(size=COUNT)
    )
    channels = [
        {"column": "q", "quantity": "angle", "unit": "deg", "point": 1},
        {"column": "w", "quantity": "angular_velocity", "unit": "rad/s", "point": 1},
        {"column": "m", "quantity": "torque", "unit": "N mm", "point": 1},
    ]
    segments = [{"kind": "ring_down", "start": 0.0, "stop": 9.99, "level": 0.2, "level_unit": "rad"}]
    values = {"file": "t.npz", "channels": channels, "segments": segments, **changes}
    (folder / "t.yaml").write_text(yaml.safe_dump(values))
    import_data(folder / "t.yaml", folder / "bag")
    return folder / "bag"


def units(bag: Path) -> dict[str, str]:
    return read_signals(Bag.open(bag), 0, COUNT).units


def test_the_bag_and_the_decay_are_in_rad(tmp_path: Path) -> None:
    bag = imported(tmp_path / "a")
    assert units(bag) == {"f1": "N*m", "x1": "rad", "v1": "rad/s"}
    found = {decay.channel: decay for decay in free_decays(Bag.open(bag))}
    assert found["x1"].unit == "rad"
    assert found["x1"].frequency_hz[0] == pytest.approx(9.0, rel=1e-3)


@pytest.mark.parametrize("form", FORMATS)
def test_an_export_comes_back_as_it_went(form: str, tmp_path: Path) -> None:
    bag = imported(tmp_path / "a")
    out = tmp_path / "out"
    out.mkdir()
    export_run(bag, out, form)
    values = yaml.safe_load((out / "sidecar.yaml").read_text())
    assert [(entry["quantity"], entry["unit"]) for entry in values["channels"]] == [
        ("torque", "N*m"), ("angle", "rad"), ("angular_velocity", "rad/s"),
    ]  # fmt: skip
    assert values["segments"][0]["level_unit"] == "rad"
    import_data(out / "sidecar.yaml", out / "bag")
    assert units(out / "bag") == units(bag)
    first, again = (read_signals(Bag.open(recording), 0, COUNT).channels for recording in (bag, out / "bag"))
    for name in first:
        np.testing.assert_array_equal(first[name], again[name])


def test_a_length_beside_an_angle_keeps_the_unit_of_lengths(tmp_path: Path) -> None:
    channels = [
        {"column": "q", "quantity": "angle", "unit": "deg", "point": 1},
        {"column": "w", "quantity": "displacement", "unit": "m", "point": 2},
    ]
    assert units(imported(tmp_path / "a", channels=channels)) == {"x1": "m", "x2": "m"}


def test_units_of_parameters_turn() -> None:
    turned = {key: of_rotation(unit_of_key(key)) for key in ("k_n_m3", "c_ns_m", "mass_kg", "force_n", "gap_m", "f_hz")}
    assert turned == {
        "k_n_m3": "N·m/rad³", "c_ns_m": "N·m s/rad", "mass_kg": "kg·m²", "force_n": "N·m", "gap_m": "rad", "f_hz": "Hz",
    }  # fmt: skip
    assert all(quantity.accepts(unit) for quantity, unit in ROTATION_UNITS.items())
    assert not Quantity.FORCE.accepts("rad")


def test_the_diagnosis_reads_a_rotation_in_its_units(tmp_path: Path) -> None:
    folder = tmp_path / "a"
    bag = imported(folder)
    (tmp_path / "rig.yaml").write_text(
        "name: shaft\nsample_rate_hz: 500\n"
        "structure: {kind: chain, masses_kg: [0.02], ground_springs_n_m: [64.0], ground_dampers_ns_m: [0.01]}\n"
        "exciter: {kind: force, point: 1, newton_per_volt: 1}\n"
        "sensors: [{quantity: force, point: drive}, {quantity: displacement, point: 1}]\n"
        "extraction: {quantity: displacement, linear_modes: 1}\n"
    )
    observations = read_observations([bag], load_rig(tmp_path / "rig.yaml"))
    assert observations.turns
    rig = load_rig(tmp_path / "rig.yaml").model_copy(update={"coordinate": "angle"})
    found = {parameter.name: parameter.unit for parameter in calibration_parameters(rig)}
    assert found["structure.masses_kg.0"] == "kg·m²"
    assert found["structure.ground_springs_n_m.0"] == "N·m/rad"
