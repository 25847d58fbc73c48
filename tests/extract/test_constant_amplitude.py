"""Modal properties from frequency responses: exact linear system, harmonic balance of the joint resonator, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_extract.curves.constant_amplitude import (
    SolvedPoints,
    fit_at_amplitudes,
    half_power,
    modal_amplitudes,
    solve_points,
)
from nmt_extract.curves.swept_response import FrequencyResponseTable
from nmt_report.response_analysis import model_responses
from nmt_rig.linear_description import linear_description
from nmt_rig.reference import compute_reference
from nmt_rig.rig import load_rig

OMEGA, DAMPING, MASS = 2.0 * math.pi * 100.0, 0.004, 2.0
LINEAR = LinearDescription("test", 1, 0, (1,), (OMEGA,), (DAMPING,), ((MASS**-0.5,),), MASS**-0.5, OMEGA, DAMPING, 0.0)


def linear_table(force: float, noise: float = 0.0, points: int = 41, seed: int = 1) -> FrequencyResponseTable:
    """Accelerance of a single mass."""
    omega = OMEGA * (1.0 + DAMPING * np.linspace(-2.5, 2.5, points))
    frf = -(omega**2) / MASS / (OMEGA**2 - omega**2 + 2j * DAMPING * OMEGA * omega)
    std = noise * float(np.abs(frf).max())
    rng = np.random.default_rng(seed)
    frf = frf + std * (rng.standard_normal(points) + 1j * rng.standard_normal(points))
    nothing = np.full(points, math.nan)
    return FrequencyResponseTable(
        force, "N", 0.0, omega / (2.0 * math.pi), np.full(points, force), ("a1",), frf[None], np.full((1, points), std),
        nothing,
    )  # fmt: skip


def test_linear_responses_give_the_linear_mode() -> None:
    tables = [linear_table(force) for force in (1.0, 1.3, 1.7, 2.2)]
    solved = SolvedPoints.of([solve_points(table, LINEAR) for table in tables])
    np.testing.assert_allclose(np.sqrt(solved.square), OMEGA, rtol=1e-12)
    peak = float(modal_amplitudes(tables[1], LINEAR).max())
    assert peak == pytest.approx(1.3 * MASS**-0.5 / (2.0 * DAMPING * OMEGA**2), rel=1e-4)
    found = fit_at_amplitudes(solved, [peak])
    assert found.omega_rad_s[0] == pytest.approx(OMEGA, rel=1e-12)
    assert found.damping_ratio[0] == pytest.approx(DAMPING, rel=1e-9)
    q, omega, damping = half_power(tables[1], LINEAR)
    assert (q, omega, damping) == pytest.approx((peak, OMEGA, DAMPING), rel=3e-3)


def test_uncertainties_are_those_of_repeated_noise() -> None:
    deviations = []
    for seed in range(25):
        tables = [linear_table(force, 0.01, seed=10 * seed + k) for k, force in enumerate((1.0, 1.3, 1.7))]
        solved = SolvedPoints.of([solve_points(table, LINEAR) for table in tables])
        found = fit_at_amplitudes(solved, [1.1 * MASS**-0.5 / (2.0 * DAMPING * OMEGA**2)])
        deviations.append(
            (
                (found.omega_rad_s[0] - OMEGA) / found.omega_rad_s_std[0],
                (found.damping_ratio[0] - DAMPING) / found.damping_ratio_std[0],
            )
        )
    spread = np.sqrt(np.mean(np.square(deviations), axis=0))
    assert np.all((spread > 0.5) & (spread < 1.5))


def test_harmonic_balance_of_the_joint_resonator_gives_its_backbone() -> None:
    """Where damping depends on amplitude, equal amplitudes give the mode; the half-power band of one force does not."""
    rig = load_rig("joint_resonator")
    linear = linear_description(rig)
    forces = (9.0, 12.5, 17.5)
    tables = []
    for model in model_responses(rig, forces, 363.0, 373.0, ("a1", "a2", "a3"), harmonics=3):
        size = model.frequency_hz.size
        tables.append(
            FrequencyResponseTable(
                model.level, "N", 0.0, model.frequency_hz, np.full(size, model.level), model.channels,
                model.responses / model.level, np.full((3, size), 1e-6), np.full(size, math.nan),
            )
        )  # fmt: skip
    amplitudes = np.array([600.0, 700.0, 800.0]) / linear.frequencies_rad_s[1] ** 2
    found = fit_at_amplitudes(SolvedPoints.of([solve_points(table, linear) for table in tables]), amplitudes)
    backbone = compute_reference(rig, 3, amplitudes)
    np.testing.assert_array_equal(found.modal_amplitude, amplitudes)
    np.testing.assert_allclose(found.omega_rad_s, backbone.omega_rad_s, rtol=1.5e-4)
    np.testing.assert_allclose(found.damping_ratio, backbone.damping_ratio, rtol=2e-2)
    q, _, damping = half_power(tables[1], linear)
    at_peak = compute_reference(rig, 3, [q / 1.01, q]).damping_ratio[1]
    assert damping > 1.08 * at_peak


def test_what_cannot_be_said_is_not_said() -> None:
    table = linear_table(1.0)
    solved = solve_points(table, LINEAR)
    top = float(solved.modal_amplitude.max())
    assert fit_at_amplitudes(solved, [3.0 * top, 0.7 * top]).modal_amplitude.tolist() == [0.7 * top]
    with pytest.raises(BenchError, match="measure more frequencies or forces"):
        fit_at_amplitudes(solved, [3.0 * top])
    short = linear_table(1.0)
    part = FrequencyResponseTable(
        1.0, "N", 0.0, short.frequency_hz[18:23], short.force_n[18:23], ("a1",), short.frf[:, 18:23],
        short.frf_std[:, 18:23], short.voltage_v[18:23],
    )  # fmt: skip
    with pytest.raises(BenchError, match="half-power band"):
        half_power(part, LINEAR)
    other = LinearDescription("test", 2, 0, (2,), (OMEGA,), (DAMPING,), ((1.0,),), 1.0, OMEGA, DAMPING, 0.0)
    with pytest.raises(BenchError, match="no channel at point 2"):
        solve_points(table, other)
