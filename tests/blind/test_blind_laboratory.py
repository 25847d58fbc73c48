"""The laboratory's bags are those of a bench, and its rig behaves as harmonic balance says it must."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nmt_blind.campaign.ensemble_sindy import sparse_terms
from nmt_blind.cases.blind_rigs import blind_rig
from nmt_blind.cases.laboratory import TrialError, record_backbone, record_random
from nmt_blind.cases.laboratory_rig import Converters
from nmt_blind.cases.quiet_tests import play_backbone, play_random
from nmt_blind.cases.rig_edits import Edit, with_edits
from nmt_core.vocabulary import TestKind
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_extract.offline import extract_bag
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import read_signals, segments
from nmt_rig.reference import single_point_reference
from nmt_rig.rig import Rig

BEAM = blind_rig("beam")
MODEL = BEAM.model()
FEW = replace(BEAM.bench, levels=(0.12, 0.4, 1.0), window_periods=40, duration=4.0)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("laboratory")
    assert record_backbone(folder / "backbone", MODEL, MODEL, FEW, 7).locked == 3
    assert record_random(folder / "random", MODEL, MODEL, FEW, 7).locked == 1
    return folder


def test_modal_points_agree_with_harmonic_balance_within_noise(bags: Path) -> None:
    points = extract_bag(bags / "backbone").points
    reference = single_point_reference(MODEL, levels=FEW.levels, harmonics=9).mode
    assert len(points) == 3
    for k, point in enumerate(points):
        assert point.omega_rad_s == pytest.approx(reference.omega_rad_s[k], rel=3e-4)
        deviation = point.damping_ratio - reference.damping_ratio[k]
        assert abs(deviation) < 4.0 * point.damping_ratio_std + 5e-3 * reference.damping_ratio[k]


def test_a_random_bag_is_that_of_a_bench(bags: Path) -> None:
    bag = Bag.open(bags / "random")
    (segment,) = segments(bag)
    assert (segment.kind, segment.fault, segment.level) == (TestKind.RANDOM, "", FEW.random_level)
    signals = read_signals(bag, segment.first_sample, segment.samples)
    assert not signals.gaps
    voltage = signals.channels["u"]
    assert np.std(voltage) == pytest.approx(FEW.random_level, rel=0.1)
    power = np.abs(np.fft.rfft(voltage)) ** 2
    frequency = np.fft.rfftfreq(voltage.size, 1.0 / signals.sample_rate)
    assert power[frequency > 2.0 * FEW.band_hz[1]].sum() < 1e-2 * power.sum()


def test_noise_is_that_of_the_rig_file(bags: Path) -> None:
    first = read_signals(Bag.open(bags / "backbone"), 0, 80)
    assert np.std(first.channels["x5"]) == pytest.approx(math.sqrt(4.5e-16 / 1e-5), rel=0.35)


def _frequency(rig: Rig) -> float:
    return play_backbone(rig, MODEL, replace(FEW, levels=(0.4,)))[0].frequency_hz


@pytest.mark.parametrize(
    "edit",
    [
        Edit(("structure", "added_masses"), {"point": 7, "mass_kg": 0.004}, "append"),
        Edit(("local_elements",), {"kind": "cubic_spring", "point": 5, "stiffness_n_m3": 2e8}, "append"),
        Edit(("structure", "youngs_modulus_pa"), 1.01, "scale"),
        Edit(("local_elements", 0, "slip_force_n"), 1.1, "scale"),
    ],
    ids=("added mass", "cubic spring", "modulus", "slip force"),
)
def test_what_an_edit_does_without_noise_is_what_harmonic_balance_says(edit: Edit) -> None:
    truth = with_edits(MODEL, (edit,))
    measured = math.log(_frequency(truth) / _frequency(MODEL))
    omega = [single_point_reference(rig, levels=[0.4], harmonics=9).mode.omega_rad_s[0] for rig in (truth, MODEL)]
    expected = math.log(omega[0] / omega[1])
    assert abs(expected) > 5e-4
    assert measured == pytest.approx(expected, rel=0.01, abs=2e-6)


@pytest.mark.campaign
def test_a_finer_step_and_mesh_change_less_than_a_test_repeats() -> None:
    bench = replace(FEW, levels=(1.0,))
    fine = play_backbone(MODEL, MODEL, bench)[0]
    finer = play_backbone(MODEL, MODEL, replace(bench, mesh_refinement=5, substeps=8))[0]
    assert fine.frequency_hz == pytest.approx(finer.frequency_hz, rel=1e-5)
    assert np.abs(fine.amplitudes[:, 1]) == pytest.approx(np.abs(finer.amplitudes[:, 1]), rel=2e-4)


def test_windows_and_random_tests_refer_to_the_same_recorded_voltage(tmp_path: Path) -> None:
    """A held drive and filters act on voltage and force alike: the force of an ideal exciter per volt is one number."""
    rig = blind_rig("modal_beam")
    model, bench = rig.model(), replace(rig.bench, levels=rig.bench.levels[-2:])
    converters = Converters(held=True, filtered=True)
    for record, name in ((record_backbone, "backbone"), (record_random, "random")):
        record(tmp_path / name, model, model, bench, 5, converters)
    found = read_observations([tmp_path / "backbone", tmp_path / "random"], model)
    rows, (locked, random) = found.rows, found.tests
    assert isinstance(locked, LockedWindows)
    assert isinstance(random, RandomResponses)
    assert not locked.commanded
    for part in (Part.LOG_MAGNITUDE, Part.PHASE):
        of_force = rows.part == part
        windows = of_force & (rows.test == 0) & (rows.channel == [c.name for c in locked.channels].index("f3"))
        lines = of_force & (rows.test == 1) & (rows.channel == [c.name for c in random.channels].index("f3"))
        lines &= rows.frequency_hz < 400.0
        # Beside the commanded voltage the force is half a sample late: 73 mrad.
        mean = float(np.average(found.values[lines], weights=found.std[lines] ** -2.0))
        windows &= rows.harmonic == 1
        drives = np.array([level.drive for level in locked.levels])[rows.level[windows]]
        over_drive = np.log(drives) if part is Part.LOG_MAGNITUDE else 0.0
        assert found.values[windows] - over_drive == pytest.approx(mean, abs=5e-4)


def test_random_responses_differ_by_what_a_gain_says() -> None:
    louder = with_edits(MODEL, (Edit(("sensors", 2, "gain"), 1.02),))
    plain, changed = (play_random(rig, MODEL, FEW) for rig in (MODEL, louder))
    assert np.array_equal(plain.voltage, changed.voltage)
    row = plain.channels.index("x4")
    assert changed.data[row] == pytest.approx(1.02 * plain.data[row])
    assert np.array_equal(np.delete(changed.data, row, 0), np.delete(plain.data, row, 0))


def test_a_rig_that_cannot_be_integrated_is_a_test_that_cannot_be_made() -> None:
    inductance = MODEL.model_dump()["exciter"]["inductance_h"]
    truth = with_edits(MODEL, (Edit(("exciter", "inductance_h"), 1e-44 / inductance, "scale"),))
    for played in (play_backbone, play_random):
        with pytest.raises(TrialError, match="not finite"):
            played(truth, MODEL, FEW)


def test_sparse_regression_names_a_strong_spring(tmp_path: Path) -> None:
    strong = Edit(("local_elements",), {"kind": "cubic_spring", "point": 5, "stiffness_n_m3": 3e8}, "append")
    bench = replace(FEW, levels=(0.2, 0.5, 0.8, 1.2))
    record_backbone(tmp_path / "bag", with_edits(MODEL, (strong,)), MODEL, bench, 3)
    found = sparse_terms(BEAM.file, [tmp_path / "bag"])
    assert found["terms"][0]["effect"] in ("cubic_stiffness", "quintic_stiffness")
    assert sparse_terms(BEAM.file, []) == {}
