"""Arc-length continuation on curves with known folds."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_rig.model.continuation import Branch, NotConvergedError, StepControl, follow_branch, solve_at_parameter


def cubic(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """λ = y³ − y: folds at y = ∓1/√3, λ = ±2/(3√3)."""
    y, parameter = z
    return np.array([y**3 - y - parameter]), np.array([[3.0 * y**2 - 1.0, -1.0]])


def test_branch_passes_both_folds() -> None:
    start = solve_at_parameter(cubic, np.array([-1.5, -1.0]))
    branch = follow_branch(cubic, start, 1.0)
    assert branch.complete
    assert branch.folds == 2
    assert not branch.single_valued
    np.testing.assert_allclose(branch.points[:, 0] ** 3 - branch.points[:, 0], branch.points[:, 1], atol=1e-10)
    roots = sorted(float(point[0]) for point in branch.passages(0.0))
    np.testing.assert_allclose(roots, [-1.0, 0.0, 1.0], atol=1e-4)


def test_extreme_parameter_of_the_branch_is_the_fold() -> None:
    start = solve_at_parameter(cubic, np.array([-1.5, -1.0]))
    branch = follow_branch(cubic, start, 1.0, StepControl(largest_step=0.01))
    first_leg = branch.points[branch.points[:, 0] < 0.0]
    assert first_leg[:, 1].max() == pytest.approx(2.0 / (3.0 * np.sqrt(3.0)), abs=1e-4)


def test_incomplete_branch_is_not_single_valued() -> None:
    start = solve_at_parameter(cubic, np.array([-1.5, -1.0]))
    branch = follow_branch(cubic, start, 1.0, StepControl(most_points=5))
    assert not branch.complete
    assert branch.folds == 0
    assert not branch.single_valued


def test_fold_between_points_is_seen_even_if_the_tangents_miss_it() -> None:
    points = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 0.5]])
    tangents = np.tile([0.0, 1.0], (3, 1))
    assert Branch(points, tangents, True).folds == 1


def test_corrector_does_not_jump_to_a_neighbouring_branch() -> None:
    # Branches y = h(x) + k π with a steep rise of h: a long step lands in the reach of another k.
    def stairs(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        y, x = z
        rise = np.tanh(20.0 * (x - 0.5))
        phase = y - 4.0 * rise
        return np.array([np.sin(phase)]), np.cos(phase) * np.array([[1.0, -80.0 * (1.0 - rise**2)]])

    control = StepControl(first_step=0.3, largest_step=1.0, largest_turn=4.0)
    branch = follow_branch(stairs, solve_at_parameter(stairs, np.array([-4.0, 0.0])), 1.0, control)
    np.testing.assert_allclose(branch.points[:, 0], 4.0 * np.tanh(20.0 * (branch.points[:, 1] - 0.5)), atol=1e-6)


def test_no_solution_is_said() -> None:
    def empty(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([z[0] ** 2 + 1.0]), np.array([[2.0 * z[0], 0.0]])

    with pytest.raises(NotConvergedError, match="no solution at parameter"):
        solve_at_parameter(empty, np.array([0.7, 0.0]))


def test_parameter_outside_the_branch_is_said() -> None:
    start = solve_at_parameter(cubic, np.array([-1.5, -1.0]))
    with pytest.raises(BenchError, match="widen the range"):
        follow_branch(cubic, start, 1.0).at_parameter(40.0)
