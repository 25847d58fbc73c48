"""Whole self-excited tests in one process, beside the nonlinear modes of an independent harmonic balance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from independent import self_excited_modes as witness
from pll.self_excited_rig import PAPER_CORRELATION, PAPER_NOISE

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus, ResultCode
from nmt_extract.curves.limit_cycles import limit_cycles
from nmt_extract.offline import extract_bag
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test
from nmt_session.run_result import RunResult


def run(name: str, out: Path, levels: list[float] | None = None, noise: bool = False, **settings: object) -> RunResult:
    overrides = []
    for row, sensor in enumerate(load_rig(name).sensors):
        if noise and sensor.quantity in PAPER_NOISE_OF:
            overrides.append(f"sensors.{row}.noise_psd={PAPER_NOISE_OF[sensor.quantity]}")
            overrides.append(f"sensors.{row}.noise_correlation_time_s={PAPER_CORRELATION}")
    plan = plan_test(name, levels, test="self_excited", overrides=overrides, window_periods=20, **settings)
    with Session(plan, out) as session:
        return session.run()


AROUND_THE_CYCLES = {"subcritical": [0.0008, 0.002, 0.0036, 0.0052, 0.006], "belt": [0.001, 0.0024, 0.0034, 0.0038]}
"""Levels (m) on both sides of each limit cycle."""
PAPER_NOISE_OF = dict(zip(("force", "displacement"), PAPER_NOISE, strict=True))


def errors(name: str, points: list[ModalPoint]) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of ω̃ and errors of δ̃ against the nonlinear mode at the measured amplitudes."""
    assert [point.status for point in points] == [PointStatus.OK] * len(points)
    q = np.array([point.modal_amplitude for point in points])
    grid = np.unique(np.concatenate([np.linspace(0.2, 1.0, 8) * q.min(), np.linspace(q.min(), q.max(), 40), q]))
    omega, damping = witness.nonlinear_mode(getattr(witness, name)(), grid, 11, 1024)
    place = np.searchsorted(grid, q)
    measured = np.array([(point.omega_rad_s, point.damping_ratio) for point in points])
    return measured[:, 0] / omega[place] - 1.0, measured[:, 1] - damping[place]


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("name", "latency", "noise"),
    [
        pytest.param("subcritical", 0, False, marks=pytest.mark.campaign),
        pytest.param("belt", 0, False, marks=pytest.mark.campaign),
        ("belt", 3, True),
        pytest.param("subcritical", 3, True, marks=pytest.mark.campaign),
        pytest.param("subcritical", 1, True, marks=pytest.mark.campaign),
        pytest.param("belt", 1, True, marks=pytest.mark.campaign),
    ],
)
def test_stable_and_unstable_parts_of_the_damping_curve(name: str, latency: int, noise: bool, tmp_path: Path) -> None:
    result = run(name, tmp_path, AROUND_THE_CYCLES[name], noise=noise, latency_blocks=latency)
    assert result.code == ResultCode.SUCCEEDED, result.message
    assert "the response is down" in result.message
    omega, damping = errors(name, list(result.points))
    assert np.abs(omega).max() < 1e-3
    assert np.abs(damping).max() < 3e-3
    assert min(point.damping_ratio for point in result.points) < -0.005
    again = extract_bag(tmp_path / "bag").points
    assert [(point.omega_rad_s, point.damping_ratio) for point in again] == [
        (point.omega_rad_s, point.damping_ratio) for point in result.points
    ]
    found = limit_cycles(result.points)
    assert [cycle.stable for cycle in found] == [False, True]


@pytest.mark.campaign
@pytest.mark.parametrize("latency", [0, 1, 3])
def test_a_rig_that_is_unstable_at_rest_is_released_and_beyond_its_limit_cycle_held(
    latency: int, tmp_path: Path
) -> None:
    result = run("van_der_pol", tmp_path, noise=latency > 0, latency_blocks=latency)
    assert result.code == ResultCode.SUCCEEDED, result.message
    omega, damping = errors("van_der_pol", list(result.points))
    assert np.abs(omega).max() < 1e-3
    assert np.abs(damping).max() < 3e-3
    released = [point.window_periods == 0 for point in result.points]
    assert released == [True, True, True, True, False, False]
    again = extract_bag(tmp_path / "bag").points
    assert [repr(point.damping_ratio) for point in again] == [repr(point.damping_ratio) for point in result.points]
    (cycle,) = limit_cycles(result.points)
    assert cycle.stable
    settled, _ = witness.limit_cycle(witness.van_der_pol(), 4e-3, 6.0)
    assert cycle.modal_amplitude == pytest.approx(settled, rel=0.01)


def test_released_motions_of_a_bistable_rig(tmp_path: Path) -> None:
    """Ring-up above the unstable limit cycle, ring-down above the stable one."""
    result = run("subcritical", tmp_path, [0.0036, 0.0044, 0.0057], method="envelope")
    omega, damping = errors("subcritical", list(result.points))
    assert np.abs(omega).max() < 1e-3
    assert np.abs(damping).max() < 3e-3
    assert all(point.window_periods == 0 for point in result.points)
