"""References of the shipped beam as the command line uses them."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_rig.reference import (
    REFERENCE_COLUMNS,
    compute_reference,
    convergence_table,
    default_amplitudes,
    single_point_reference,
    write_reference_csv,
)
from nmt_rig.rig import Rig, load_rig


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("beam")


def test_reference_of_the_beam_meets_the_given_table(rig, published_backbone) -> None:
    q, omega, damping = published_backbone.T
    reference = compute_reference(rig, 7, q)
    np.testing.assert_allclose(reference.omega_rad_s, omega, rtol=1e-4)
    np.testing.assert_allclose(reference.damping_ratio, damping, rtol=1e-4)


def test_a_mode_alone_under_an_ideal_force_is_computed_without_warnings(tmp_path) -> None:
    mode = "{frequency_hz: 133.1, damping_ratio: 0.0035, modal_mass_kg: 1.0}"
    (tmp_path / "one.yaml").write_text(
        f"name: one\nstructure: {{kind: modal, modes: [{mode}]}}\ntest: {{levels: '1'}}\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reference = compute_reference(load_rig(tmp_path / "one.yaml"), 3, [1e-5, 1e-4])
    np.testing.assert_allclose(reference.damping_ratio, 0.0035, rtol=1e-9)


def test_written_file_has_the_fixed_columns_and_the_same_numbers(rig, tmp_path) -> None:
    reference = compute_reference(rig, 3, [1e-5, 1e-4, 1e-3])
    path = write_reference_csv(reference, tmp_path / "out" / "reference.csv")
    assert path.read_text().splitlines()[0] == "modal_amplitude,omega_rad_s,damping_ratio"
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    np.testing.assert_allclose(table.T, [getattr(reference, name) for name in REFERENCE_COLUMNS], rtol=1e-11)
    assert [item.name for item in path.parent.iterdir()] == ["reference.csv"]


def test_file_that_cannot_be_written_is_said(rig, tmp_path) -> None:
    (tmp_path / "taken").write_text("")
    reference = compute_reference(rig, 1, [1e-5])
    with pytest.raises(BenchError, match="cannot write"):
        write_reference_csv(reference, tmp_path / "taken" / "reference.csv")


def test_default_amplitudes_cover_the_levels_of_the_rig(rig) -> None:
    q = default_amplitudes(rig, 10)
    reached = single_point_reference(rig, None, np.geomspace(0.05, 1.5, 5)).mode.modal_amplitude
    assert q.size == 10
    assert q[0] < reached.min()
    assert q[-1] > reached.max()
    with pytest.raises(BenchError, match="at least 2"):
        default_amplitudes(rig, 1)


def test_convergence_table_falls_to_zero_at_the_finest(rig) -> None:
    rows = convergence_table(rig, (1, 3, 5, 7, 20), np.geomspace(1e-5, 1e-2, 20))
    errors = [row.damping_error for row in rows]
    assert [row.harmonics for row in rows] == [1, 3, 5, 7, 20]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == 0.0
    assert rows[3].omega_error < 1e-4


def test_single_point_reference_at_another_point(rig) -> None:
    levels = np.geomspace(0.05, 1.5, 6)
    own, other = single_point_reference(rig, None, levels), single_point_reference(rig, 4, levels)
    assert (own.exciter_point, other.exciter_point) == (2, 4)
    np.testing.assert_array_equal(own.level, levels)
    assert own.mode.force_n[-1] > other.mode.force_n[-1]
    with pytest.raises(BenchError, match="choose one of them"):
        single_point_reference(rig, 12, levels)
    with pytest.raises(BenchError, match="levels must be"):
        single_point_reference(rig, 2, [])


def test_single_point_reference_does_not_depend_on_which_levels_are_asked(rig) -> None:
    all_levels = np.geomspace(0.05, 12.0, 12)
    every = single_point_reference(rig, 2, all_levels)
    last = single_point_reference(rig, 2, all_levels[-2:])
    np.testing.assert_allclose(every.mode.damping_ratio[-2:], last.mode.damping_ratio, rtol=1e-8)
