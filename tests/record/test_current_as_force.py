"""A current with a force factor is a force: in the bag, in the linear test and in the uncertainty."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.signal import cont2discrete, lfilter

from nmt_bench.cli import main
from nmt_bench.data_import import import_data
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_record import Bag
from nmt_record.exchange.imports.imported_run import read_import
from nmt_record.exchange.sidecar.channel_tolerances import tolerances

RATE, COUNT, FACTOR, MASS, HZ, RATIO = 1000.0, 60_000, 16.0, 0.9, 58.0, 0.01

RIG = """name: plate
sample_rate_hz: 1000
structure: {kind: modal, modes: [{frequency_hz: 58.0, damping_ratio: 0.01, modal_mass_kg: 0.9}]}
exciter: {kind: force, point: 1, newton_per_volt: 1}
sensors: [{quantity: force, point: drive}, {quantity: velocity, point: 1}]
extraction: {quantity: velocity, linear_modes: 1}
"""


def made(folder: Path, kind: str = "random", **current: Any) -> Path:
    """Sidecar of a laser in mm/s and a shaker's current in A."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(1)
    amperes = rng.normal(size=COUNT) * 0.3
    omega = 2.0 * np.pi * HZ
    b, a, _ = cont2discrete(([1.0 / MASS, 0.0], [1.0, 2.0 * RATIO * omega, omega**2]), 1.0 / RATE, "foh")
    velocity = lfilter(b.ravel(), a, FACTOR * amperes)
    np.savez(folder / "t.npz", sample_rate=RATE, laser=1e3 * velocity, current=amperes)
    channels = [
        {"column": "laser", "quantity": "velocity", "unit": "mm/s", "point": 1},
        {"column": "current", "quantity": "current", "unit": "A", "point": 1, "force_factor": FACTOR, **current},
    ]
    segments = [{"kind": kind, "start": 0.0, "stop": 60.0}]
    (folder / "rig.yaml").write_text(RIG)
    values = {"file": "t.npz", "rig": "rig.yaml", "channels": channels, "segments": segments}
    (folder / "t.yaml").write_text(yaml.safe_dump(values))
    return folder / "t.yaml"


def test_it_is_a_force_in_the_bag(tmp_path: Path) -> None:
    run = read_import(made(tmp_path))
    assert [(channel.name, channel.quantity) for channel in run.channels] == [
        ("v1", Quantity.VELOCITY),
        ("f1", Quantity.FORCE),
    ]
    np.testing.assert_allclose(run.channels[1].data, FACTOR * np.load(tmp_path / "t.npz")["current"])
    assert any("counts as a force by 16 N/A" in note for note in run.notes)


def test_the_linear_test_finds_the_mode(tmp_path: Path) -> None:
    import_data(made(tmp_path), tmp_path / "bag")
    assert main(["linear", "--bag", str(tmp_path / "bag"), "--band", "30:90", "--out", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "linear.json").read_text())
    assert found["frequencies_rad_s"][0] == pytest.approx(2.0 * np.pi * HZ, rel=1e-3)
    assert abs(found["shapes"][0][0]) == pytest.approx(MASS**-0.5, rel=0.03)


def test_the_factor_of_a_current_is_in_the_budget(tmp_path: Path) -> None:
    import_data(made(tmp_path), tmp_path / "bag")
    run = Bag.open(tmp_path / "bag").run_start or {}
    found = tolerances(run).of(Quantity.FORCE, 1)
    assert found.gain == pytest.approx(np.hypot(0.01, 0.03))
    import_data(made(tmp_path, force_factor_std=0.004, gain_std=0.003), tmp_path / "bag2")
    run = Bag.open(tmp_path / "bag2").run_start or {}
    assert tolerances(run).of(Quantity.FORCE, 1).gain == pytest.approx(0.005)


def test_a_torque_of_a_motor_is_in_newton_metres(tmp_path: Path) -> None:
    run = read_import(made(tmp_path, force_unit="N*m"))
    assert run.channels[1].section.si_unit == "N*m"


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"quantity": "voltage", "unit": "V"}, "force_factor makes a force of a current, but column current measures"),
        ({"force_factor": None, "force_factor_std": 0.1}, "has no force_factor"),
    ],
)
def test_a_factor_belongs_to_a_current(keys: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=sentence):
        read_import(made(tmp_path, **keys))
