"""What control learns of the force per volt: a Kalman filter on one complex factor for each exciter and harmonic.

For each harmonic Ĝ = G₀ diag(c) with the matrix G₀ that was known and factors c, one for each exciter: what amplifier,
wiring and exciter do to its voltage is a factor of its column. Over the time constant of the filter

    ΔF_j = h_jᵀ c + Δd_j,   h_ji = G₀_ji ΔV_i,

which is a linear regression on the moves h that were foreseen, with a force at every exciter for every factor. With
the covariance P of c and the variance R_j of the contribution Δd_j of noise and a changing motion, force by force,

    c ← c + k (ΔF_j − h_jᵀ c),   k = P h̄_j / (h_jᵀ P h̄_j + R_j),   P ← (1 − k h_jᵀ) P.

P grows with time up to a bound, which is its forgetting. Other errors of G₀, such as exchanged terms next to the
diagonal, are left to the margins of the law. For one exciter it is the scalar filter.
"""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_pll.thresholds import HARMONICS


class GainEstimate:
    """Factors of the force per volt at some harmonics.

    Args:
        harmonics: number K of them.
        exciters: number N of exciters.

    Attributes:
        correction: c, shape (K, N).
        covariance: P, shape (K, N, N).
    """

    def __init__(self, harmonics: int, exciters: int) -> None:
        self.correction: ComplexArray = np.ones((harmonics, exciters), complex)
        self.covariance: ComplexArray = np.zeros((harmonics, exciters, exciters), complex)  # changed in place only
        self.covariance[:] = HARMONICS.initial_gain_std**2 * np.eye(exciters)
        self._variances = _diagonals(self.covariance).real  # views of it
        self._unit: ComplexArray = np.eye(exciters, dtype=complex)

    def gain(self, known: ComplexArray) -> ComplexArray:
        """Ĝ = G₀ diag(c), N/V, shape (K, N, N), for G₀ of that shape."""
        return np.asarray(known * self.correction[:, None, :])

    @property
    def trust(self) -> FloatArray:
        """|c|² / (|c|² + P_ii), shape (K, N): an uncertain Ĝ is not trusted to be small."""
        size_squared = np.abs(self.correction) ** 2
        return np.asarray(size_squared / (size_squared + self._variances))

    def grow(self, factor: float) -> None:
        """Forget some: variances grow by ``factor`` up to their bound, correlations stay."""
        largest = HARMONICS.largest_gain_std**2 * np.maximum(1.0, np.abs(self.correction) ** 2)
        after = np.minimum(self._variances * factor, largest)
        if after.shape[1] > 1:
            ratio = np.sqrt(after / self._variances)
            self.covariance *= ratio[:, :, None] * ratio[:, None, :]
        self._variances[:] = after

    def learn(self, moves: ComplexArray, change: ComplexArray, least: FloatArray, scatter: FloatArray) -> None:
        """Put c right by what the newest changes of voltage have done to the forces.

        Args:
            moves: h, N, shape (K, N, N), row j the force.
            change: ΔF, N, shape (K, N).
            least: moves that are not larger tell nothing of a force, N, shape (K, N).
            scatter: R_j, N², shape (K, N).
        """
        # What moves less than the motion may have done would tell the same wrong thing every time.
        tells = np.maximum.reduce(np.abs(moves), axis=2) > least
        if not tells.any():
            return
        moves = np.where(tells[:, :, None], moves, 0j)
        for row in range(change.shape[1]):
            self._learn_of(moves[:, row], change[:, row], scatter[:, row])

    def _learn_of(self, move: ComplexArray, change: ComplexArray, scatter: FloatArray) -> None:
        """The same of one force: ``move`` (K, N), ``change`` and ``scatter`` (K,)."""
        conjugate = move.conj()
        square = conjugate[:, :, None] * move[:, None, :]  # h̄ hᵀ
        _diagonals(square)[:] = np.abs(move) ** 2
        expected = _row_sums(_row_sums(self.covariance * square.swapaxes(1, 2))).real
        variance = np.maximum(expected + scatter, 1e-300)[:, None, None]
        weight = (self.covariance.view(np.float64) / variance).view(np.complex128)  # both parts of P over it
        innovation = change - _row_sums(self.correction * move)
        corrected = self.correction + _row_sums(weight * conjugate[:, None, :]) * innovation[:, None]
        large = np.abs(corrected) > HARMONICS.lowest_gain_correction
        self.correction = np.where(large, corrected, self.correction)
        kept = _products(self._unit - _products(weight, square), self.covariance)
        np.multiply(0.5, kept + kept.conj().swapaxes(1, 2), out=self.covariance)
        np.maximum(self._variances, 1e-6, out=self._variances)

    def doubt(self, exciters: np.ndarray) -> None:
        """Open what was learnt of some, bool (K, N), to doubt: variances are at least those of the beginning."""
        least = np.where(exciters, HARMONICS.initial_gain_std**2, 0.0)
        np.maximum(self._variances, least, out=self._variances)

    def forget(self, exciters: np.ndarray) -> None:
        """Take what was known at first for some, bool (K, N)."""
        self.correction = np.where(exciters, 1.0, self.correction)


def _diagonals(matrices: ComplexArray) -> ComplexArray:
    """Views of the diagonals of matrices (K, N, N) that lie in a row, (K, N)."""
    count, size, _ = matrices.shape
    return matrices.reshape(count, size * size)[:, :: size + 1]


def _row_sums(values: ComplexArray) -> ComplexArray:
    """Sums over the last axis; of one value it is that one."""
    return values[..., 0] if values.shape[-1] == 1 else np.asarray(np.add.reduce(values, axis=-1))


def _products(left: ComplexArray, right: ComplexArray) -> ComplexArray:
    """Products of matrices (K, N, N); those of one number are of these numbers."""
    return np.asarray(left * right if left.shape[-1] == 1 else left @ right)


def applied(matrices: ComplexArray, vectors: ComplexArray) -> ComplexArray:
    """Products of matrices (K, N, N) with vectors (K, N)."""
    return _row_sums(matrices * vectors[:, None, :])


def solved(matrices: ComplexArray, right: ComplexArray) -> ComplexArray:
    """x of A x = b for matrices A (K, N, N) and b (K, N), by elimination with pivots; one exciter: a division.

    LAPACK multiplies by the reciprocal where this divides, which differs in the last bit.
    """
    size = right.shape[1]
    if size == 1:
        return np.asarray(right / matrices[:, 0])
    a, x = matrices.copy(), right.copy()
    every = np.arange(x.shape[0])
    for column in range(size - 1):
        pivot = column + np.argmax(np.abs(a[:, column:, column]), axis=1)
        a[every, pivot], a[:, column] = a[:, column].copy(), a[every, pivot]
        x[every, pivot], x[:, column] = x[:, column].copy(), x[every, pivot]
        for row in range(column + 1, size):
            factor = a[:, row, column] / a[:, column, column]
            a[:, row] -= factor[:, None] * a[:, column]
            x[:, row] -= factor * x[:, column]
    for row in reversed(range(size)):
        x[:, row] = (x[:, row] - np.sum(a[:, row, row + 1 :] * x[:, row + 1 :], axis=1)) / a[:, row, row]
    return x
