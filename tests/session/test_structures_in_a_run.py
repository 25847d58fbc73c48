"""Whole tests of structures given by modes or matrices, with velocities, and on a shaking table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nmt_core.vocabulary import ResultCode
from nmt_record.bag.bag_reader import Bag
from nmt_rig.reference import single_point_reference
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test

VELOCITIES = """
name: laser
structure: {kind: modal, file: modes.csv}
local_elements: [{kind: cubic_spring, point: 5, stiffness_n_m3: 5.0e+8}]
exciter: {kind: force, point: 2}
sensors:
  - {quantity: force, point: drive}
  - {quantity: velocity, point: 2}
  - {quantity: velocity, point: 5}
  - {quantity: voltage}
test: {ramp_s: 0.2}
extraction: {quantity: velocity}
"""
MODES = """frequency_hz,damping_ratio,modal_mass_kg,point_2,point_5
60,0.01,0.5,0.6,1.0
210,0.012,0.4,1.0,-0.7
"""


def matrices(folder: Path) -> str:
    """The same two modes as matrices of points 2 and 5."""
    shapes = np.array([[0.6, 1.0], [1.0, -0.7]]) / np.sqrt([[0.5], [0.4]])  # (modes, points), mass-normalised
    inverse = np.linalg.inv(shapes.T)
    omega = 2.0 * np.pi * np.array([60.0, 210.0])
    np.savez(
        folder / "two.npz",
        M=inverse.T @ inverse,
        K=(inverse.T * omega**2) @ inverse,
        C=(inverse.T * (2.0 * np.array([0.01, 0.012]) * omega)) @ inverse,
    )
    where = "points_at: [{point: 2, row: 0}, {point: 5, row: 1}]"
    return VELOCITIES.replace("kind: modal, file: modes.csv", f"kind: matrices, file: two.npz, {where}")


@pytest.mark.parametrize("kind", ["modal", "matrices", "table"])
def test_a_run_measures_what_harmonic_balance_says(tmp_path: Path, kind: str) -> None:
    source: str | Path = "clamped_beam"
    levels = [0.05, 0.3]
    if kind != "table":
        (tmp_path / "modes.csv").write_text(MODES)
        source = tmp_path / "laser.yaml"
        source.write_text(VELOCITIES if kind == "modal" else matrices(tmp_path))
        levels = [0.5, 3.0]
    with Session(plan_test(str(source), levels=levels, window_periods=30), tmp_path / "out") as session:
        result = session.run()
    assert result.code == ResultCode.SUCCEEDED
    reference = single_point_reference(load_rig(source), None, levels).mode
    frequencies = np.array([point.frequency_hz for point in result.points])
    np.testing.assert_allclose(2.0 * np.pi * frequencies, reference.omega_rad_s, rtol=5e-4)
    np.testing.assert_allclose([point.damping_ratio for point in result.points], reference.damping_ratio, rtol=2e-2)
    np.testing.assert_allclose([p.modal_amplitude for p in result.points], reference.modal_amplitude, rtol=1e-2)
    assert frequencies[1] > 1.001 * frequencies[0]
    # What the bag holds loads without the files that the structure was read from.
    kept = tmp_path / "out" / "rig.yaml"
    (tmp_path / "modes.csv").unlink(missing_ok=True)
    (tmp_path / "two.npz").unlink(missing_ok=True)
    assert load_rig(kept).structure == session.rig.structure
    assert Bag.open(tmp_path / "out" / "bag").rig_yaml == kept.read_text(encoding="utf-8")
