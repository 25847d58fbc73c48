"""Rational model of all channels around a resonance, fitted to the spectrum of one long record.

A record of a linear system under any excitation u obeys, line by line and without any window,

    Y_c(ω) = H_c(ω) U(ω) + T_c(ω),    H_c, T_c = Σ_p R_cp / (ω − ω_p) + polynomial in ω,

where T_c stands for the free vibration at the record's two ends: it has the same poles. With T_c in the model there is
no leakage, so that a resonance of a few lines is met without bias where Hann-windowed averages widen it (Pintelon and
Schoukens, System Identification, sections 6.3 and 7.2). Residues and polynomials are linear; the common poles are found
by Gauss-Newton steps on the projected residual.

With the drive voltage as u and force and responses as channels, only outputs carry noise. The structure alone follows
by division: its poles are zeros of voltage → force, its residues N_x / N_f′ there, free of the bias that noise of the
force gives H1 where the force drops out at resonance. Without a voltage, u is the force and the structure's poles are
the poles.

Noise that enters with an input goes through the structure: the residual of the channels is larger where they resonate.
Its variance, a_c + Σ_j b_j |H_cj|², is read off a first fit; the second weights the lines by it, as the maximum of the
likelihood with noise of inputs and outputs does (section 9.11 there), and so do all uncertainties.

Several inputs u_j add their terms H_cj U_j. Voltage → force is then a matrix N_f / D, and the structure is
N_x adj(N_f) / det N_f. As residues of a pole have rank one, both contain D^(inputs − 1), which cancels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import ztrsm
from scipy.optimize import nnls

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray

RATIONAL_MOST_LINES = 3000
"""Most lines of a rational fit: more show the same and take longer."""
# Steps of a rational fit at each precision.
_STEPS = 40

_PRECISIONS = (1e-4, 1e-6, 1e-9)
_NOISE_ROUNDS = 8  # of weights, until the powers of the noise stand still
_NOISE_FLOOR = 1e-3  # power of a line's noise over the mean, at least, so that no line counts alone
_STARTS = (0.1j, 0.35 + 0.2j, -0.35 + 0.2j, 0.6j)


@dataclass(frozen=True, eq=False)
class RationalFit:
    """Fitted model in the variable z = (f − centre) / half width.

    Attributes:
        centre_hz: centre of the band.
        half_width_hz: half of its width.
        poles: poles in z with positive imaginary part, shape ``(P,)``.
        residues: R of the responses, output unit over input unit, shape ``(channels, inputs, P)``.
        polynomial: coefficients from the constant up, shape ``(channels, inputs, order + 1)``.
        covariance: of (poles, then residues and polynomial by channel and input), complex circular.
        misfit: rms of the residual over that of the channel, shape ``(channels,)``.
        input_noise: power of the noise that enters with each input over the input's around the centre, ``(inputs,)``.
        lines: number of spectral lines fitted.
    """

    centre_hz: float
    half_width_hz: float
    poles: ComplexArray
    residues: ComplexArray
    polynomial: ComplexArray
    covariance: ComplexArray
    misfit: FloatArray
    input_noise: FloatArray
    lines: int

    @property
    def eigenvalues(self) -> ComplexArray:
        """Poles in the Laplace variable s = iω, rad/s, shape ``(P,)``."""
        return np.asarray(2j * np.pi * (self.centre_hz + self.half_width_hz * self.poles))

    def response(self, frequency_hz: FloatArray) -> ComplexArray:
        """Channels over inputs at frequencies within the band, shape ``(channels, inputs, frequencies)``."""
        z = (np.asarray(frequency_hz) - self.centre_hz) / self.half_width_hz
        rows, powers = self.residues.reshape(-1, self.poles.size), self.polynomial.shape[2]
        rational = rows @ (1.0 / (z[np.newaxis] - self.poles[:, np.newaxis]))
        total = rational + self.polynomial.reshape(-1, powers) @ np.power.outer(z, np.arange(powers)).T
        return np.asarray(total.reshape(*self.residues.shape[:2], -1))

    def parameters(self) -> ComplexArray:
        """All parameters in the order of ``covariance``."""
        return np.concatenate([self.poles, np.concatenate([self.residues, self.polynomial], axis=2).ravel()])

    def with_parameters(self, values: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Denominators and numerators of many sets of parameters at once.

        Args:
            values: sets in the order of ``covariance``, shape ``(sets, parameters)``.

        Returns:
            Polynomials in z, highest power first, shapes ``(sets, P + 1)`` and ``(sets, channels, inputs, powers)``.
        """
        count = self.poles.size
        poles = values[:, :count]
        denominator = _with_roots(poles)
        table = values[:, count:].reshape(len(values), *self.residues.shape[:2], -1)
        numerators = _product(table[..., : count - 1 : -1], denominator[:, np.newaxis, np.newaxis])
        for index in range(count):
            strengths = _rank_one(table[..., index], self.residues[..., index])
            other = _with_roots(np.delete(poles, index, axis=1))
            numerators[..., -count:] += strengths[..., np.newaxis] * other[:, np.newaxis, np.newaxis]
        return denominator, numerators


@dataclass(frozen=True, eq=False)
class StructureMode:
    """A pole of response over force with the residues of the responses.

    Attributes:
        eigenvalue: λ = −ζω + iω√(1 − ζ²), rad/s.
        residues: A of H ≈ A / (s − λ), response unit over N times rad/s, shape ``(responses, forces)``.
        covariance: of (eigenvalue, residues by response and force), complex circular, square.
    """

    eigenvalue: complex
    residues: ComplexArray
    covariance: ComplexArray


def fit_rational(
    input_spectrum: ComplexArray,
    output_spectra: ComplexArray,
    frequency_hz: FloatArray,
    centre_hz: float,
    half_width_hz: float,
    poles: int = 1,
    order: int = 3,
    start: RationalFit | None = None,
) -> RationalFit:
    """Fit the model to spectra of a whole record without window.

    Args:
        input_spectrum: U, shape ``(lines,)``, or ``(inputs, lines)``.
        output_spectra: Y, shape ``(channels, lines)``.
        frequency_hz: lines, Hz.
        centre_hz, half_width_hz: band to use.
        poles: number of poles.
        order: degree of the polynomials.
        start: an earlier fit of the same band to start from; None = several starts, the best counts.

    Raises:
        BenchError: too few lines, a channel without signal, or no damped pole found.
    """
    inputs = np.atleast_2d(input_spectrum)
    use = np.flatnonzero(np.abs(frequency_hz - centre_hz) <= half_width_hz)
    use = use[:: 1 + use.size // RATIONAL_MOST_LINES]
    unknown = (1 + len(inputs)) * (poles + order + 1)
    lines = use.size
    if lines < 2 * unknown:
        raise BenchError(
            f"The record has {lines} spectral lines within {centre_hz - half_width_hz:.4g} to "
            f"{centre_hz + half_width_hz:.4g} Hz; the fit needs at least {2 * unknown}: record longer."
        )
    outputs = output_spectra[:, use]
    scale = np.sqrt(np.mean(np.abs(outputs) ** 2, axis=1))
    input_scale = np.array([np.sqrt(np.mean(np.abs(values[use]) ** 2)) for values in inputs])
    if not (np.all(input_scale > 0.0) and np.all(scale > 0.0)):
        raise BenchError(f"A channel has no signal around {centre_hz:.4g} Hz; check sensors and drive.")
    problem = _Problem(
        (frequency_hz[use] - centre_hz) / half_width_hz,
        [values[use] / size for values, size in zip(inputs, input_scale, strict=True)],
        (outputs / scale[:, np.newaxis]).T,
        poles,
        order,
    )
    spread = np.linspace(-0.5, 0.5, poles) if poles > 1 else np.zeros(1)
    starts = [np.asarray(first + spread, dtype=np.complex128) for first in _STARTS]
    best = problem.best(starts if start is None else [start.poles])
    if best is None:
        raise BenchError(f"No damped resonance fits the spectra around {centre_hz:.4g} Hz.")
    noise = problem.noise(best)
    weighted = problem.weighted(noise.line_weights)
    again = weighted.best([best.poles])
    if again is not None:
        problem, best, noise = weighted, again, problem.noise(again)
    found_poles = best.poles
    table, covariance, misfit = problem.statistics(best, noise)
    factor = scale[:, np.newaxis] / input_scale
    count = poles + order + 1
    response_rows = table[: factor.shape[1] * count].T.reshape(*factor.shape, count) * factor[:, :, np.newaxis]
    scaling = np.concatenate([np.ones(poles), np.repeat(factor.ravel(), count)])
    return RationalFit(
        centre_hz,
        half_width_hz,
        found_poles,
        response_rows[:, :, :poles],
        response_rows[:, :, poles:],
        covariance * np.outer(scaling, scaling),
        misfit,
        noise.input_shares(problem, float(np.abs(found_poles[np.argmin(np.abs(found_poles))].imag))),
        lines,
    )


@dataclass(frozen=True, eq=False)
class _Solution:
    """Poles of a fit, the weights of the channels, and what it leaves: logarithm of the likelihood, negative."""

    cost: float
    poles: ComplexArray
    weights: FloatArray


@dataclass(frozen=True, eq=False)
class _Noise:
    """Noise of the channels line by line.

    Attributes:
        outputs: covariance of the part that is the same at all lines, shape ``(channels, channels)``.
        inputs: power of the part that enters with each input, shape ``(inputs,)``.
        responses: channels over inputs, shape ``(lines, inputs, channels)``.
    """

    outputs: ComplexArray
    inputs: FloatArray
    responses: ComplexArray

    @property
    def line_weights(self) -> FloatArray:
        """Of the lines, the same for all channels: 1 where the outputs' noise is all there is, shape ``(lines,)``."""
        through = np.einsum("j,ljc->lc", self.inputs, np.abs(self.responses) ** 2)
        level = np.maximum(np.diagonal(self.outputs).real, 1e-24)
        return np.asarray(1.0 / np.sqrt(np.mean(1.0 + through / level, axis=1)))

    def terms(self) -> list[tuple[FloatArray | float, ComplexArray]]:
        """(power, factors) of each part of the covariance at the lines beyond ``outputs``."""
        return [(power, self.responses[:, j]) for j, power in enumerate(self.inputs) if power > 0.0]

    def input_shares(self, problem: _Problem, half_power: float) -> FloatArray:
        """Noise over power of each input within two half-power bandwidths of the centre, shape ``(inputs,)``."""
        use = np.abs(problem.z) <= max(2.0 * half_power, float(np.sort(np.abs(problem.z))[min(4, problem.z.size - 1)]))
        return np.array([b / np.mean(np.abs(u[use]) ** 2) for b, u in zip(self.inputs, problem.drives, strict=True)])


class _Problem:
    """Scaled data of one band; lines lead, channels follow."""

    def __init__(
        self,
        z: FloatArray,
        drives: Sequence[ComplexArray],
        data: ComplexArray,
        poles: int,
        order: int,
        lines: FloatArray | None = None,
    ) -> None:
        self.z, self.drives, self.plain = z, drives, data
        self.poles, self.order = poles, order
        self.lines = np.ones(z.size) if lines is None else lines
        self.data = data * self.lines[:, np.newaxis]
        self.powers = np.power.outer(z, np.arange(order + 1)).astype(np.complex128)
        self.driven_powers = [self.powers * drive[:, np.newaxis] for drive in drives]
        self.each = poles + order + 1
        self.driven = len(drives) * self.each

    def weighted(self, lines: FloatArray) -> _Problem:
        """The same with weights of the lines, shape ``(lines,)``."""
        return _Problem(self.z, self.drives, self.plain, self.poles, self.order, lines)

    def best(self, starts: Sequence[ComplexArray]) -> _Solution | None:
        """The best of several starts."""
        best: _Solution | None = None
        for first in starts:
            found = self.solve(first)
            if found is None:
                continue
            if best is not None and abs(found.cost - best.cost) < 1e-3:
                break  # the same optimum from two starts
            if best is None or found.cost < best.cost:
                best = found
        return best

    def noise(self, solution: _Solution) -> _Noise:
        """Noise of outputs and inputs, from what a fit without weights of the lines leaves with these poles."""
        q, r, residual = self.split(solution.poles)
        table = self.table(q, r)
        partial = np.hstack([1.0 / (self.z[:, np.newaxis] - solution.poles), self.powers])
        rows = [slice(j * self.each, (j + 1) * self.each) for j in range(len(self.drives))]
        responses = np.stack([partial @ table[row] for row in rows], axis=1)
        free = np.maximum(1.0 - np.sum(np.abs(q) ** 2, axis=1), 0.05)
        inputs = _input_powers(np.abs(residual) ** 2 / free[:, np.newaxis], free, np.abs(responses) ** 2)
        through = np.einsum("j,ljc->lc", inputs, np.abs(responses) ** 2)
        level = np.mean(np.abs(residual) ** 2 / free[:, np.newaxis], axis=0)
        share = 1.0 / np.sqrt(1.0 + through / np.maximum(level - through.mean(axis=0), 1e-3 * level))
        left = residual * share
        outputs = left.T @ left.conj() / max(1.0, float(np.sum(free)) - self.poles)
        return _Noise(outputs, inputs, responses)

    def basis(self, poles: ComplexArray) -> ComplexArray:
        partial = 1.0 / (self.z[:, np.newaxis] - poles)
        driven = [
            part
            for drive, powers in zip(self.drives, self.driven_powers, strict=True)
            for part in (partial * drive[:, np.newaxis], powers)
        ]
        return np.asarray(np.hstack([*driven, partial, self.powers]) * self.lines[:, np.newaxis], dtype=np.complex128)

    def split(self, poles: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        q, r = _orthonormal(self.basis(poles))
        return q, r, self.data - q @ (q.conj().T @ self.data)

    def table(self, q: ComplexArray, r: ComplexArray) -> ComplexArray:
        """Linear parameters, shape ``(unknown, channels)``."""
        return np.asarray(np.linalg.solve(r, q.conj().T @ self.data), dtype=np.complex128)

    def derivative(self, poles: ComplexArray, table: ComplexArray) -> ComplexArray:
        """∂(basis · table)/∂pole, shape ``(P, lines, channels)``."""
        partial = 1.0 / (self.z[:, np.newaxis] - poles) ** 2
        slopes = np.zeros((self.poles, *self.data.shape), dtype=np.complex128)
        for p in range(self.poles):
            for number, drive in enumerate(self.drives):
                slopes[p] += np.outer(partial[:, p] * drive, table[number * self.each + p])
            slopes[p] += np.outer(partial[:, p], table[self.driven + p])
        return np.asarray(slopes * self.lines[:, np.newaxis], dtype=np.complex128)

    def solve(self, poles: ComplexArray) -> _Solution | None:
        """Poles from a start, in rounds with channels weighted by what the round before left over."""
        weights = np.ones(self.data.shape[1])
        cost = np.inf
        # The cost of a weighted round is the number of data: a gain far below 1 is not a gain.
        for precision in _PRECISIONS:
            q, r, residual = self.split(poles)
            cost = float(np.sum(np.abs(residual * weights) ** 2))
            for _ in range(_STEPS):
                table = self.table(q, r)
                slopes = self.derivative(poles, table) * weights
                slopes = slopes - q @ (q.conj().T @ slopes)
                step = np.linalg.lstsq(slopes.reshape(self.poles, -1).T, (residual * weights).ravel(), rcond=None)[0]
                length = 1.0
                while length > 1e-4:
                    trial = poles + length * step
                    if np.all(trial.imag > 0.0) and np.all(np.abs(trial) < 50.0):
                        q, r, residual = self.split(trial)
                        new_cost = float(np.sum(np.abs(residual * weights) ** 2))
                        if new_cost <= cost * (1.0 + 1e-12):
                            break
                    length *= 0.5
                else:
                    q, r, residual = self.split(poles)
                    break
                poles, gain, cost = trial, cost - new_cost, new_cost
                if np.max(np.abs(length * step)) < 1e-10 or gain <= precision * cost:
                    break
            level = np.sqrt(np.mean(np.abs(residual) ** 2, axis=0))
            weights = 1.0 / np.maximum(level, 1e-12)
        if not np.all(np.isfinite(poles)):
            return None
        # Comparable between starts: the residual of every channel, logarithms summed (likelihood of unknown noise).
        return _Solution(float(np.sum(np.log(np.maximum(level, 1e-12)))), poles, weights)

    def statistics(self, solution: _Solution, noise: _Noise) -> tuple[ComplexArray, ComplexArray, FloatArray]:
        """Linear parameters ``(unknown, channels)``, covariance of poles and response parameters, misfit."""
        poles, weights = solution.poles, solution.weights
        q, r, _ = self.split(poles)
        table = self.table(q, r)
        slopes = self.derivative(poles, table)
        inside = np.linalg.solve(r, q.conj().T @ slopes)
        outside = slopes - q @ (q.conj().T @ slopes)
        weighted = outside * weights**2
        gain = np.linalg.inv(np.einsum("plc,qlc->pq", weighted.conj(), outside))
        keep = slice(0, self.driven)
        solved = np.linalg.solve(r, q.conj().T)[keep]  # of the linear parameters by the weighted data
        along = -np.moveaxis(inside[:, keep], 0, -1)  # (kept, channels, P)
        along = np.moveaxis(along, 1, 0).reshape(-1, self.poles)
        count, channels = self.poles, self.data.shape[1]
        covariance = np.zeros((count + channels * self.driven,) * 2, dtype=np.complex128)
        # Noise of the outputs, and of each input as it comes out of them; δpoles = gain Σ_c weighted_cᴴ n_c.
        root = _root(noise.outputs)
        parts = [(1.0, np.broadcast_to(row, (self.z.size, channels))) for row in root.T]
        for power, response in parts + noise.terms():
            at_lines = response * self.lines[:, np.newaxis]
            of_poles = gain @ np.einsum("plc,lc->pl", weighted.conj(), at_lines)
            of_linear = np.concatenate([solved * at_lines[:, c] for c in range(channels)]) + along @ of_poles
            both = np.concatenate([of_poles, of_linear])
            covariance += power * (both @ both.conj().T)
        left = self.plain - (q @ (r @ table)) / self.lines[:, np.newaxis]
        misfit = np.sqrt(np.mean(np.abs(left) ** 2, axis=0))
        return table, covariance, np.asarray(misfit, dtype=np.float64)


def _root(covariance: ComplexArray) -> ComplexArray:
    """A root C = R Rᴴ of a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _input_powers(left: FloatArray, free: FloatArray, gains: FloatArray) -> FloatArray:
    """Powers of the noise of the inputs that make the residual of the channels most likely.

    Args:
        left: power of the residual, shape ``(lines, channels)``.
        free: share of each line that the fit did not take, shape ``(lines,)``.
        gains: squared magnitudes of channels over inputs, shape ``(lines, inputs, channels)``.

    Returns:
        Powers, shape ``(inputs,)``, 0 where an input's noise explains nothing.
    """
    lines, inputs, channels = gains.shape
    matrix = np.zeros((lines, channels, channels + inputs))
    for c in range(channels):
        matrix[:, c, c] = 1.0
        matrix[:, c, channels:] = gains[:, :, c]
    scale = np.maximum(left.mean(axis=0), 1e-24)
    matrix, left = (matrix / scale[:, np.newaxis]).reshape(lines * channels, -1), (left / scale).ravel()
    sizes = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    matrix = matrix / sizes
    share, variance = np.repeat(np.sqrt(free), channels), np.ones(lines * channels)
    powers = np.zeros(channels + inputs)
    for _ in range(_NOISE_ROUNDS):
        weights = share / variance
        powers, _ = nnls(matrix * weights[:, np.newaxis], left * weights)
        variance = np.maximum(matrix @ powers, _NOISE_FLOOR)
    return np.asarray((powers / sizes)[channels:])


def _orthonormal(matrix: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """QR of a tall matrix by Cholesky, twice (CholeskyQR2): products of matrices only, ten times as fast."""
    try:
        q: ComplexArray = matrix
        r: ComplexArray = np.eye(matrix.shape[1], dtype=np.complex128)
        for _ in range(2):
            factor = np.linalg.cholesky(q.conj().T @ q).conj().T
            q = np.asarray(ztrsm(1.0, factor, q, side=1), dtype=np.complex128)  # q / factor, which is upper triangular
            r = factor @ r
    except np.linalg.LinAlgError:  # too close to singular for the square of the matrix
        q, r = np.linalg.qr(matrix)
    return q, r


def structure_mode(fit: RationalFit, near_hz: complex, force_rows: Sequence[int] = ()) -> StructureMode:
    """The mode of responses over forces nearest to a start, with its covariance by propagation of errors.

    Args:
        fit: of voltages to forces and responses, or of forces to responses.
        near_hz: start, Hz, complex (f + i ζ f).
        force_rows: rows of the forces among the channels, one an input; none where the forces are the inputs.
    """
    values = fit.parameters()
    near = (near_hz - fit.centre_hz) / fit.half_width_hz
    result = _modes_of(fit, values[np.newaxis], near, force_rows)[0]
    root = (result[0] / 2j / np.pi - fit.centre_hz) / fit.half_width_hz
    deviation = np.sqrt(np.maximum(np.diagonal(fit.covariance).real, 0.0))
    # The mode is an analytic function of the parameters: one complex difference gives its derivative.
    steps = np.maximum(np.maximum(1e-3 * deviation, 1e-7 * np.abs(values)), 1e-30)
    up, down = (_modes_of(fit, values + sign * np.diag(steps), root, force_rows) for sign in (1.0, -1.0))
    slopes = ((up - down) / (2.0 * steps[:, np.newaxis])).T
    residues = result[1:].reshape(-1, fit.residues.shape[1])
    return StructureMode(complex(result[0]), residues, slopes @ fit.covariance @ slopes.conj().T)


def _rank_one(values: ComplexArray, near: ComplexArray) -> ComplexArray:
    """Matrices of rank one that are matrices near a known one where they have rank one; an analytic function of them.

    Args:
        values: matrices, shape ``(sets, channels, inputs)``.
        near: the known one, shape ``(channels, inputs)``.
    """
    column = int(np.argmax(np.linalg.norm(near, axis=0)))
    across = near[:, column].conj() @ values
    across = across / across[:, column : column + 1]
    across[:, column] = 1.0
    return np.asarray(values[:, :, column, np.newaxis] * across[:, np.newaxis])


def _modes_of(fit: RationalFit, values: ComplexArray, near: complex, force_rows: Sequence[int]) -> ComplexArray:
    """Eigenvalue, then residues by response and force, of sets of parameters ``(sets, parameters)``, a row each."""
    below, numerators = fit.with_parameters(values)
    roots: ComplexArray = values[:, : fit.poles.size]
    responses = np.delete(numerators, list(force_rows), axis=1)
    if force_rows:
        forces = numerators[:, list(force_rows)]
        shared = np.ones((len(values), 1), dtype=np.complex128)
        for _ in force_rows[1:]:
            shared = _product(shared, below)
        below = _quotient(_determinant(forces), shared)
        roots = _roots(below)
        # Cramer's rule: each response in the place of each force.
        solved = []
        for at in range(len(force_rows)):
            rows = np.repeat(forces[:, np.newaxis], responses.shape[1], axis=1)
            rows[:, :, at] = responses
            solved.append(_quotient(_determinant(rows), shared[:, np.newaxis]))
        responses = np.stack(solved, axis=2)
    nearest = np.argmin(np.abs(roots - near), axis=1)
    root = np.take_along_axis(roots, nearest[:, np.newaxis], axis=1)[:, 0]
    derivative = below[:, :-1] * np.arange(below.shape[1] - 1, 0, -1)
    slope = _value(derivative, root) / (2j * np.pi * fit.half_width_hz)
    eigenvalue = 2j * np.pi * (fit.centre_hz + fit.half_width_hz * root)
    residues = _value(responses, root[:, np.newaxis, np.newaxis]) / slope[:, np.newaxis, np.newaxis]
    return np.column_stack([eigenvalue, residues.reshape(len(values), -1)])


# Polynomials along the last axis, highest power first; the axes before it are many of them.


def _with_roots(roots: ComplexArray) -> ComplexArray:
    result = np.ones((len(roots), 1), dtype=np.complex128)
    for root in roots.T:
        result = _product(result, np.column_stack([np.ones_like(root), -root]))
    return result


def _product(one: ComplexArray, other: ComplexArray) -> ComplexArray:
    size = one.shape[-1]
    shape = np.broadcast_shapes(one.shape[:-1], other.shape[:-1])
    result = np.zeros((*shape, size + other.shape[-1] - 1), dtype=np.complex128)
    for power in range(other.shape[-1]):
        result[..., power : power + size] += one * other[..., power : power + 1]
    return result


def _value(polynomial: ComplexArray, at: ComplexArray) -> ComplexArray:
    result = np.zeros(np.broadcast_shapes(polynomial.shape[:-1], at.shape), dtype=np.complex128)
    for power in range(polynomial.shape[-1]):
        result = result * at + polynomial[..., power]
    return result


def _roots(polynomial: ComplexArray) -> ComplexArray:
    """Eigenvalues of the companion matrices."""
    degree = polynomial.shape[-1] - 1
    companion = np.zeros((*polynomial.shape[:-1], degree, degree), dtype=np.complex128)
    companion[..., 1:, :-1] = np.eye(degree - 1)
    companion[..., 0, :] = -polynomial[..., 1:] / polynomial[..., :1]
    return np.asarray(np.linalg.eigvals(companion), dtype=np.complex128)


def _quotient(numerator: ComplexArray, denominator: ComplexArray) -> ComplexArray:
    """Without the remainder."""
    size = denominator.shape[-1]
    left = numerator.copy()
    quotient = np.zeros((*left.shape[:-1], left.shape[-1] - size + 1), dtype=np.complex128)
    for index in range(quotient.shape[-1]):
        quotient[..., index] = left[..., index] / denominator[..., 0]
        left[..., index : index + size] -= quotient[..., index, np.newaxis] * denominator
    return quotient


def _determinant(rows: ComplexArray) -> ComplexArray:
    """Of square matrices of polynomials, shape ``(…, n, n, powers)``, by their first rows."""
    if rows.shape[-2] == 1:
        return rows[..., 0, 0, :]
    terms = [
        (-1) ** column
        * _product(rows[..., 0, column, :], _determinant(np.delete(rows[..., 1:, :, :], column, axis=-2)))
        for column in range(rows.shape[-2])
    ]
    return np.asarray(sum(terms), dtype=np.complex128)
