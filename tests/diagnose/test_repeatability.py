"""What a sidecar says of repeats is part of the floors."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from diagnose.linear_problem import observations_of

from nmt_bench.data_import import import_data
from nmt_core.errors import BenchError
from nmt_diagnose.observations.noise.floors import repeatability, with_stated_repeatability
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.observation_settings import Floors
from nmt_diagnose.observations.read_observations import read_observations
from nmt_rig.rig import load_rig

RIG = """name: one_mode
structure: {kind: modal, modes: [{frequency_hz: 100.0, damping_ratio: 0.01, modal_mass_kg: 1.0}]}
test: {levels: "0.01:1:8"}
"""
TABLE = """frequency_hz,frequency_hz_std,amplitude,damping_ratio,damping_ratio_std
100.0,0.3,0.1,0.01,0.0003
101.0,0.3,0.2,0.02,0.0003
103.0,0.3,0.3,0.03,0.0003
"""
SIDECAR = "rig: rig.yaml\nfile: table.csv\nsegments: [{kind: backbone, unit: mm, point: 1}]\n"


def observations(folder: Path, stated: str):
    for name, text in (("rig.yaml", RIG), ("table.csv", TABLE), ("side.yaml", SIDECAR + stated)):
        (folder / name).write_text(text, encoding="utf-8")
    import_data(folder / "side.yaml", folder / "bag")
    return read_observations([folder / "bag"], load_rig(str(folder / "rig.yaml")))


def test_it_adds_to_the_floors_of_its_kind(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    plain = observations(tmp_path / "a", "")
    stated = observations(tmp_path / "b", "repeatability: {frequency: 0.006, damping: 0.1}\n")
    frequency, damping = (plain.rows.part == part for part in (Part.LOG_FREQUENCY, Part.DAMPING))
    np.testing.assert_allclose(stated.floor[frequency], np.hypot(plain.floor[frequency], 0.006))
    np.testing.assert_allclose(stated.floor[damping], np.hypot(plain.floor[damping], [0.001, 0.002, 0.003]))
    np.testing.assert_array_equal(stated.std, plain.std)


def test_without_any_the_evidence_stays(tmp_path: Path) -> None:
    plain = observations(tmp_path, "")
    for run in ({}, {"imported": {}}, {"imported": {"sidecar": {"repeatability": None}}}):
        assert with_stated_repeatability(plain, run) is plain
    turned = with_stated_repeatability(plain, {"imported": {"sidecar": {"repeatability": {"phase_deg": 2.0}}}})
    np.testing.assert_array_equal(turned.floor, plain.floor)
    assert math.radians(2.0) not in turned.floor


@pytest.mark.parametrize("wrong", ["{frequency: -0.1}", "{frequency: 1.5}", "{sway: 0.1}"])
def test_what_cannot_be_is_refused(tmp_path: Path, wrong: str) -> None:
    with pytest.raises(BenchError, match="repeatability"):
        observations(tmp_path, f"repeatability: {wrong}\n")


def test_the_floor_from_repeats_is_the_scatter_of_one_test() -> None:
    """Two tests that scatter by s differ by √2 s; what their noise explains of it is not a floor."""
    draw, count, scatter, noise = np.random.default_rng(1), 900, 3e-3, 2e-3
    first, second = (
        observations_of(draw.normal(0.0, np.hypot(scatter, noise), count), noise, levels=np.arange(count))
        for _ in range(2)
    )
    floor, _ = repeatability(first, second)
    # 900 squares of differences scatter by 5 %, the root by 2.4 %, and more by what the noise takes off.
    np.testing.assert_allclose(floor, scatter, rtol=0.12)


@pytest.mark.parametrize("levels", [1, 9, 100])
def test_levels_of_a_run_do_not_average_away_what_the_loop_holds_wrong(levels: int) -> None:
    """The mean over n levels has 1/√n of the floor of each."""
    floors = Floors(phase_error=1e-3)
    each = floors.window(Part.PHASE_ERROR, levels=levels)
    assert each / math.sqrt(levels) == pytest.approx(1e-3)
