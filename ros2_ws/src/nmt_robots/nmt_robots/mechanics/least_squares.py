"""Least squares on columns, with uncertainties that know neighbouring rows to be alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from nmt_robots.log.joint_log import Array


@dataclass(frozen=True, eq=False)
class Fit:
    """Coefficients of columns.

    Attributes:
        values, std: K; a coefficient that had to be left at zero has both zero.
        covariance: K × K.
        held: K; coefficients that would have been negative and may not be.
        negative: K; what those would have been; zero elsewhere.
        residual: N.
    """

    values: Array
    std: Array
    covariance: Array
    held: Array
    negative: Array
    residual: Array


def solve(matrix: Array, torque: Array, never_negative: Array) -> tuple[Array, Array, Array]:
    """Coefficients, which were held at zero, and what those would have been.

    Args:
        matrix: N × K.
        torque: N.
        never_negative: K.
    """
    return solve_normal(matrix.T @ matrix, matrix.T @ torque, never_negative)


def solve_normal(gram: Array, moment: Array, never_negative: Array) -> tuple[Array, Array, Array]:
    """The same from normal equations."""
    count = len(moment)
    free = np.ones(count, dtype=bool)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    negative = np.zeros(count)
    while True:
        values = np.zeros(count)
        number = np.flatnonzero(free)
        if number.size:
            reduced = gram[np.ix_(number, number)] / np.outer(scale[number], scale[number])
            values[number] = solve_scaled(reduced, moment[number] / scale[number], 1e-10) / scale[number]
        wrong = free & never_negative & (values < 0.0)
        if not np.any(wrong):
            return values, ~free, negative
        worst = int(np.argmin(np.where(wrong, values * scale, np.inf)))
        negative[worst] = values[worst]
        free[worst] = False


def solve_many(gram: Array, moments: Array, never_negative: Array) -> Array:
    """Coefficients of M right-hand sides of the same normal equations, K × M."""
    count = len(gram)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram, moments = gram / np.outer(scale, scale), moments / scale[:, None]
    values = np.zeros(moments.shape)
    # Right-hand sides with the same coefficients held at zero are solved together.
    waiting: dict[tuple[int, ...], Array] = {(): np.arange(moments.shape[1])}
    while waiting:
        held, columns = waiting.popitem()
        free = np.setdiff1d(np.arange(count), held)
        if free.size:
            values[np.ix_(free, columns)] = solve_scaled(
                gram[np.ix_(free, free)], moments[np.ix_(free, columns)], 1e-10
            )
        wrong = (values[:, columns] < 0.0) & never_negative[:, None]
        worst = np.argmin(np.where(wrong, values[:, columns], np.inf), axis=0)
        for number in np.unique(worst[np.any(wrong, axis=0)]):
            some = columns[(worst == number) & np.any(wrong, axis=0)]
            values[:, some] = 0.0
            more = tuple(sorted((*held, int(number))))
            waiting[more] = np.append(waiting.get(more, np.empty(0, dtype=int)), some)
    return np.asarray(values / scale[:, None])


def solve_scaled(gram: Array, moment: Array, least: float) -> Array:
    """Solution of normal equations with a diagonal of ones, as the moment; the shortest where columns are alike.

    Args:
        gram: K × K.
        moment: K, or K × M.
        least: singular values below this share of the largest count as none.
    """
    factor, failed = dpotrf(gram, lower=1)
    # The squared pivots bound the smallest eigenvalue from above: well above the limit the two solutions agree.
    if failed == 0 and float(np.min(np.diag(factor))) ** 2 > 1e3 * least:
        solution: Array = dpotrs(factor, moment, lower=1)[0]
        return solution
    return np.asarray(np.linalg.lstsq(gram, moment, rcond=least)[0])


def fitted(matrix: Array, torque: Array, never_negative: Array, blocks: Array) -> Fit:
    """Coefficients with standard uncertainties from the scatter between blocks of rows.

    Args:
        matrix: N × K.
        torque: N.
        never_negative: K.
        blocks: N; rows of one number may depend on each other, those of different numbers do not.
    """
    values, held, negative = solve(matrix, torque, never_negative)
    residual = torque - matrix @ values
    free = ~held
    count = matrix.shape[1]
    covariance = np.zeros((count, count))
    reduced = matrix[:, free]
    scale = np.maximum(np.linalg.norm(reduced, axis=0), 1e-300)
    reduced = reduced / scale
    numbers, index = np.unique(blocks, return_inverse=True)
    scores = np.zeros((len(numbers), reduced.shape[1]))
    np.add.at(scores, index, reduced * residual[:, None])
    inverse = np.linalg.pinv(reduced.T @ reduced, rcond=1e-10)
    correction = len(numbers) / max(len(numbers) - 1.0, 1.0)
    inner = correction * inverse @ (scores.T @ scores) @ inverse / np.outer(scale, scale)
    covariance[np.ix_(free, free)] = inner
    return Fit(values, np.sqrt(np.maximum(np.diag(covariance), 0.0)), covariance, held, negative, residual)
