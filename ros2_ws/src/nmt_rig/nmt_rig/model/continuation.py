"""Arc-length continuation of a solution branch with step control.

The unknowns and the parameter form one vector z = [y, λ]; the system gives n residuals of n + 1 numbers and
their Jacobian. Unknowns should be scaled to the order of one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray

System = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


class NotConvergedError(BenchError):
    """No solution was found from the given start; the message says where and what to change."""


@dataclass(frozen=True)
class StepControl:
    """Settings of the continuation.

    Attributes:
        first_step, smallest_step, largest_step: arc lengths in the scaled unknowns.
        target_iterations: Newton iterations per step that leave the step as it is.
        largest_turn: largest angle between successive tangents, rad.
        tolerance: Newton stops at this largest correction (scaled unknowns).
        iterations: most Newton iterations per step.
        most_points: most points of a branch.
    """

    first_step: float = 0.02
    smallest_step: float = 1e-9
    largest_step: float = 0.1
    target_iterations: int = 4
    largest_turn: float = 0.35
    tolerance: float = 1e-10
    iterations: int = 10
    most_points: int = 5000


@dataclass(frozen=True)
class Branch:
    """Points of a solution branch, in order along the arc.

    Attributes:
        points: (k, n + 1) unknowns and parameter.
        tangents: (k, n + 1) unit tangents.
        complete: the parameter range was traversed (else the limit of points was met).
    """

    points: FloatArray
    tangents: FloatArray
    complete: bool

    @property
    def folds(self) -> int:
        """Number of turning points of the parameter along the branch, by its tangents or its points."""
        return max(_sign_changes(self.tangents[:, -1]), _sign_changes(np.diff(self.points[:, -1])))

    @property
    def single_valued(self) -> bool:
        """The parameter range was traversed without turning back; an incomplete branch does not count."""
        return self.complete and self.folds == 0

    def at_parameter(self, value: float) -> FloatArray:
        """First point (n + 1,) at which the parameter passes ``value``, by cubic Hermite interpolation.

        Raises:
            BenchError: the branch does not reach that value.
        """
        found = self.passages(value)
        if not found:
            parameter = self.points[:, -1]
            raise BenchError(
                f"the branch spans parameters {parameter.min():g} to {parameter.max():g}, not {value:g}; "
                "widen the range of the continuation."
            )
        return found[0]

    def passages(self, value: float) -> list[FloatArray]:
        """All points (n + 1,) at which the parameter passes ``value``, by cubic Hermite interpolation."""
        before = self.points[:-1, -1] - value
        after = self.points[1:, -1] - value
        # A point that lies on the value belongs to the piece it ends (the first point to the piece it
        # starts).
        crossing = (before * after < 0.0) | (after == 0.0)
        if crossing.size and before[0] == 0.0:
            crossing[0] = True
        return [self._passage(int(k), value) for k in np.flatnonzero(crossing)]

    def _passage(self, k: int, value: float) -> FloatArray:
        start, end = self.points[k], self.points[k + 1]
        length = float(np.linalg.norm(end - start))
        low, high = 0.0, 1.0
        rising = bool(end[-1] >= start[-1])
        point = start
        for _ in range(50):
            t = 0.5 * (low + high)
            point = _hermite(start, end, length * self.tangents[k], length * self.tangents[k + 1], t)
            if (point[-1] < value) == rising:
                low = t
            else:
                high = t
        result: FloatArray = np.append(point[:-1], value)
        return result


def _sign_changes(values: FloatArray) -> int:
    signs = np.sign(values)
    signs = signs[signs != 0]
    return int(np.count_nonzero(signs[1:] != signs[:-1]))


def _hermite(
    start: FloatArray, end: FloatArray, start_slope: FloatArray, end_slope: FloatArray, t: float
) -> FloatArray:
    result: FloatArray = (
        (1 + 2 * t) * (1 - t) ** 2 * start
        + t * (1 - t) ** 2 * start_slope
        + t**2 * (3 - 2 * t) * end
        + t**2 * (t - 1) * end_slope
    )
    return result


def solve_at_parameter(
    system: System, guess: FloatArray, tolerance: float = 1e-11, iterations: int = 30, what: str = "solution"
) -> FloatArray:
    """Newton's method at the parameter of ``guess`` (its last entry), damped when the residual grows.

    Raises:
        NotConvergedError: no convergence from this guess.
    """
    point = guess.copy()
    residual, jacobian = system(point)
    norm = float(np.linalg.norm(residual))
    for _ in range(iterations):
        try:
            correction = np.linalg.solve(jacobian[:, :-1], -residual)
        except np.linalg.LinAlgError:
            break
        factor = 1.0
        while True:
            trial = point.copy()
            trial[:-1] += factor * correction
            trial_residual, trial_jacobian = system(trial)
            trial_norm = float(np.linalg.norm(trial_residual))
            if trial_norm <= (1.0 - 0.1 * factor) * norm or trial_norm < 1e-9 or factor < 1e-3:
                break
            factor *= 0.5
        point, residual, jacobian, norm = trial, trial_residual, trial_jacobian, trial_norm
        if not np.isfinite(norm):
            break
        if factor == 1.0 and float(np.max(np.abs(correction))) < tolerance:
            return point
    raise NotConvergedError(
        f"harmonic balance found no {what} at parameter {guess[-1]:.6g} (residual {norm:.2g}); "
        "start from a lower level or keep more harmonics."
    )


def _tangent(jacobian: FloatArray, previous: FloatArray) -> FloatArray:
    size = jacobian.shape[1]
    bordered = np.empty((size, size))
    bordered[:-1] = jacobian
    bordered[-1] = previous
    right = np.zeros(size)
    right[-1] = 1.0
    tangent = np.linalg.solve(bordered, right)
    result: FloatArray = tangent / np.linalg.norm(tangent)
    return result


def follow_branch(
    system: System,
    start: FloatArray,
    stop_parameter: float,
    control: StepControl | None = None,
    what: str = "branch",
) -> Branch:
    """Follow the branch through the solution ``start`` until the parameter leaves the range towards
    ``stop_parameter``.

    Folds are passed; the branch ends at the first point beyond ``stop_parameter``, or when it turns back
    past its start.

    Raises:
        NotConvergedError: the step shrank below its smallest value.
    """
    control = control or StepControl()
    first_parameter = float(start[-1])
    direction = 1.0 if stop_parameter >= first_parameter else -1.0
    point = start.copy()
    _, jacobian = system(point)
    heading = np.zeros(point.size)
    heading[-1] = direction
    tangent = _tangent(jacobian, heading)
    points, tangents = [point], [tangent]
    step = control.first_step
    complete = False
    while len(points) < control.most_points:
        if step < control.smallest_step:
            raise NotConvergedError(
                f"continuation of the {what} stopped at parameter {point[-1]:.6g}: no solution within the "
                "smallest step; keep more harmonics or narrow the range."
            )
        predicted = point + step * tangent
        solution = _correct(system, predicted, tangent, control)
        if solution is None:
            step *= 0.4
            continue
        trial, jacobian, used = solution
        # A correction longer than the step has left the branch for another one.
        if float(np.linalg.norm(trial - predicted)) > step and step > 1e3 * control.smallest_step:
            step *= 0.4
            continue
        try:
            trial_tangent = _tangent(jacobian, tangent)
        except np.linalg.LinAlgError:
            step *= 0.4
            continue
        turn = float(np.arccos(np.clip(trial_tangent @ tangent, -1.0, 1.0)))
        if turn > control.largest_turn and step > 1e3 * control.smallest_step:
            step *= 0.5
            continue
        point, tangent = trial, trial_tangent
        points.append(point)
        tangents.append(tangent)
        growth = float(np.clip(control.target_iterations / max(used, 1), 0.5, 1.6))
        if turn > 0.5 * control.largest_turn:
            growth = min(growth, 1.0)
        step = min(step * growth, control.largest_step)
        if direction * (point[-1] - stop_parameter) >= 0.0:
            complete = True
            break
        if direction * (point[-1] - first_parameter) < 0.0:
            break
    return Branch(np.array(points), np.array(tangents), complete)


def solve_fold(system: System, branch: Branch, k: int, what: str = "branch") -> FloatArray:
    """Point (n + 1,) at which the parameter turns between points k and k + 1 of a branch, by bisection along the arc.

    Raises:
        NotConvergedError: the solution is lost between the points.
    """
    start, end = branch.points[k], branch.points[k + 1]
    length = float(np.linalg.norm(end - start))
    slopes = length * branch.tangents[k], length * branch.tangents[k + 1]
    low, high, rising = 0.0, 1.0, branch.tangents[k, -1] > 0.0
    heading: FloatArray = branch.tangents[k]
    point: FloatArray = start
    for _ in range(40):
        t = 0.5 * (low + high)
        solution = _correct(system, _hermite(start, end, *slopes, t), heading, StepControl())
        if solution is None:
            raise NotConvergedError(f"the {what} was lost at a fold near parameter {point[-1]:.6g}; take more points.")
        point, jacobian, _ = solution
        if (_tangent(jacobian, heading)[-1] > 0.0) == rising:
            low = t
        else:
            high = t
    return point


def _correct(
    system: System, predicted: FloatArray, tangent: FloatArray, control: StepControl
) -> tuple[FloatArray, FloatArray, int] | None:
    point = predicted.copy()
    bordered = np.empty((point.size, point.size))
    right = np.zeros(point.size)
    bordered[-1] = tangent
    previous_change = np.inf
    for iteration in range(1, control.iterations + 1):
        residual, jacobian = system(point)
        if not np.all(np.isfinite(residual)):
            return None
        bordered[:-1] = jacobian
        right[:-1] = -residual
        try:
            correction = np.linalg.solve(bordered, right)
        except np.linalg.LinAlgError:
            return None
        change = float(np.max(np.abs(correction)))
        if not np.isfinite(change) or (iteration > 2 and change > 2.0 * previous_change):
            return None
        point += correction
        if change < control.tolerance:
            # Quadratic convergence: the Jacobian of the last iterate serves the tangent.
            return point, jacobian, iteration
        previous_change = change
    return None
