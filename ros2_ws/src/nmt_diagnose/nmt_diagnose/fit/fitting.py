"""Most probable parameters of an explanation, with its chain and scales, and its evidence by Laplace's method.

The model predicts y = f(θ) + U n + e: θ are parameters of the rig, n errors of the measuring chain in units of their
standard deviations, e noise whose scales are learnt (noise.py). For each θ the best n and scales follow by a few
reweighted linear solutions; θ itself by Levenberg's damping.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from nmt_diagnose.chain.chain_columns import is_tolerance, linear_chain
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.misfit import Whitening, misfit_of
from nmt_diagnose.fit.noise import Groups, beyond_noise, groups_of, sigma_of
from nmt_diagnose.measurements.measurement import Observations, is_broad_band
from nmt_diagnose.observations.observables import ANGLES, FUNDAMENTAL, Natural, Part, with_natural
from nmt_diagnose.prediction.forward import Forward, Prediction
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

# Change of ln frequency that is large: a bandwidth of 1 %.
_LARGE_LOG_FREQUENCY = 0.01

# Steps of a fit; one that needs more is continued as a finalist.
_MOST_STEPS = 25
# The first order holds for a few prior deviations at most.
_LARGEST_STEP = 3.0
# Shares of the size of each row that are added to its noise one after the other, so that no group is given up early.
_APPROACH_SHARES = (0.1, 0.01, 0.001)
# Actual over promised fall below which sensitivities are computed anew after a step.
_BROYDEN_LEAST_GAIN_RATIO = 0.75
# Actual over promised fall below which the next step is damped, as usual for Levenberg's method.
_DAMPING_GAIN_RATIO = 0.25
# Reweightings of chain and scales for one prediction; near the optimum three suffice.
_MOST_REWEIGHTINGS = 20
# Damped trials of one step before the fit ends.
_MOST_TRIALS = 6


class FitError(ArithmeticError):
    """The model has no solution where the fit would have to start."""


@dataclass(frozen=True)
class Data:
    """What fits work on.

    Lines of random tests are compared as complex numbers over the measured ones: noise and images of a zero-order hold
    add to them, however small a response is near its zeros. Gains and delays multiply what the model predicts, as they
    do everywhere.

    Attributes:
        observations: the real side.
        forward: predicts its rows.
        sigma: standard deviation of each row before scales, its noise and misfit, (m,).
        share: variance of the misfit that neighbouring rows share over the whole, (m,); 0 of records.
        groups: rows that share a scale.
        chain: change of the model's values by a standard deviation of each error of the measuring chain, (m, r).
        added: what such errors add to what was measured, in proportion to that, (m, r).
        chain_names: of these errors.
        used: rows that are compared, (m,).
        lines: rows of the magnitude and of the phase of each line of random tests, (2, k).
        records: rows of channels of records with what they share, over their standard deviations before scales.
        key: of these data and no others.
        known: of fits to these data, what takes long to compute.
    """

    observations: Observations
    forward: Forward
    sigma: FloatArray
    share: FloatArray
    groups: Groups
    chain: FloatArray
    added: FloatArray
    chain_names: tuple[str, ...]
    used: BoolArray
    lines: IntArray
    records: tuple[tuple[IntArray, FloatArray], ...] = ()
    key: object = field(init=False, repr=False, compare=False, default_factory=object)
    known: dict[object, float] = field(init=False, repr=False, compare=False, default_factory=dict)

    def tails(self, errors: ChainErrors) -> FloatArray:
        """Probability that the residual of each group is noise, by its size and by its trend, (2K,)."""
        groups = self.groups
        return np.concatenate([groups.tails(errors.squares, self.counts), groups.trends(errors.residual, self.used)])

    def excess(self, errors: ChainErrors) -> BoolArray:
        """Groups in which a fit leaves more than noise, by its size or by its trend over levels, (K,)."""
        return np.asarray(beyond_noise(self.tails(errors)).reshape(2, -1).any(axis=0))

    def difference(self, values: FloatArray, errors: FloatArray | None = None) -> FloatArray:
        """Measured minus predicted over σ, whitened, 0 where a row is not used, (m,).

        Args:
            values: of the model, (m,).
            errors: of the measuring chain, (r,); None = none.
        """
        return self.whitened(self.residual(values, errors))

    def residual(self, values: FloatArray, errors: FloatArray | None = None) -> FloatArray:
        """Measured minus predicted over σ row by row, 0 where a row is not used, (m,); arguments as above."""
        return self.residual_of(values if errors is None else values + self.chain @ errors, errors)

    def residual_of(self, moved: FloatArray, errors: FloatArray | None) -> FloatArray:
        """The same of values that errors of the chain have multiplied, (m,)."""
        result: FloatArray = self.observations.values - moved
        phases = self._phases
        result[phases] = (result[phases] + np.pi) % (2.0 * np.pi) - np.pi
        z = self._over_measured(moved)
        result[self.lines[0]], result[self.lines[1]] = 1.0 - z.real, -z.imag
        if errors is not None:
            result -= self.added @ errors
        return np.where(self.used, np.nan_to_num(result) / self.sigma, 0.0)

    def change(self, before: FloatArray, after: FloatArray, errors: ChainErrors) -> FloatArray:
        """Change of the compared values from one prediction of the model, (m,), to another, over σ."""
        return self.difference(before, errors.chain) - self.difference(after, errors.chain)

    def slopes(self, columns: FloatArray, values: FloatArray) -> FloatArray:
        """Derivatives of the model's values, (m, n), about values, as derivatives of the compared values, over σ."""
        result = np.nan_to_num(columns, posinf=0.0, neginf=0.0)
        z = np.nan_to_num(self._over_measured(values))[:, None]
        turned = z * (result[self.lines[0]] + 1j * result[self.lines[1]])
        result[self.lines[0]], result[self.lines[1]] = turned.real, turned.imag
        return self.whitened(self._scaled(result))

    def chain_slopes(self, moved: FloatArray) -> FloatArray:
        """Derivatives of the compared values by the errors of the measuring chain, over σ, (m, r).

        Args:
            moved: values of the model with the errors that multiply it, (m,).
        """
        plain, turned, added = self._chain_over_sigma
        z = np.nan_to_num(self._over_measured(moved))[:, None]
        result = plain.copy()
        result[self.lines[0]] = z.real * turned[0].real - z.imag * turned[0].imag + added[0]
        result[self.lines[1]] = z.real * turned[1].imag + z.imag * turned[1].real + added[1]
        return self._whitenings[1](result, result)

    @cached_property
    def tolerances(self) -> BoolArray:
        """Which errors of the measuring chain have a prior before the tests, (r,)."""
        return np.array([is_tolerance(name) for name in self.chain_names], dtype=bool)

    @cached_property
    def _phases(self) -> BoolArray:
        return np.isin(self.observations.rows.part, ANGLES)

    @cached_property
    def _chain_over_sigma(self) -> tuple[FloatArray, ComplexArray, FloatArray]:
        """Columns of the chain over σ: all, whitened where they do not turn with lines, (m, r).

        Also of the magnitudes and phases of lines, (2, k, r): those that turn and those that are added.
        """
        added = self._scaled(self.added)
        plain = np.nan_to_num(self.chain, posinf=0.0, neginf=0.0)
        all_columns = self._whitenings[0](self._scaled(plain) + added)
        lines = plain[self.lines[0]] + 1j * plain[self.lines[1]]
        over = np.where(self.used[self.lines], 1.0 / self.sigma[self.lines], 0.0)
        return all_columns, over[:, :, None] * lines, added[self.lines]

    @cached_property
    def _whitenings(self) -> tuple[Whitening, Whitening]:
        """Of rows that do not turn with lines, and of lines."""
        turning = np.zeros(self.used.size, dtype=bool)
        turning[self.lines.ravel()] = True
        return (
            Whitening(self.observations, self.share, self.used & ~turning, self.records),
            Whitening(self.observations, self.share, self.used & turning),
        )

    def whitened(self, columns: FloatArray) -> FloatArray:
        """Columns over σ, (m,) or (m, n), as independent ones."""
        plain, lines = self._whitenings
        return lines(plain(columns))

    def in_units(self, whitened: FloatArray) -> FloatArray:
        """A whitened change or residual, (m,), in the units of the rows."""
        plain, lines = self._whitenings
        return plain.back(lines.back(whitened)) * self.sigma

    def _scaled(self, columns: FloatArray) -> FloatArray:
        return np.where(self.used[:, None], columns / self.sigma[:, None], 0.0)

    def _over_measured(self, values: FloatArray) -> ComplexArray:
        """Predicted over measured response of each line, (k,)."""
        over = values[self.lines] - self.observations.values[self.lines]
        with np.errstate(invalid="ignore"):  # lines that the model does not predict are not used
            return np.asarray(np.exp(np.minimum(over[0], THRESHOLDS.fits.largest_log_ratio) + 1j * over[1]))

    @property
    def counts(self) -> FloatArray:
        """Used rows of each group, (K,)."""
        return self.groups.counts(self.used)


def lines_of(observations: Observations) -> IntArray:
    """Rows of the magnitude and of the phase of each line of random tests that has both, (2, k)."""
    rows = observations.rows
    random = [number for number, test in enumerate(observations.tests) if is_broad_band(test)]
    pairs: dict[tuple[int, int, int], dict[int, int]] = {}
    for row in np.flatnonzero(np.isin(rows.test, random) & np.isin(rows.part, FUNDAMENTAL)):
        key = int(rows.test[row]), int(rows.level[row]), int(rows.channel[row])
        pairs.setdefault(key, {})[int(rows.part[row])] = int(row)
    both = [(parts[int(Part.LOG_MAGNITUDE)], parts[int(Part.PHASE)]) for parts in pairs.values() if len(parts) == 2]
    return np.array(both, dtype=np.int64).reshape(-1, 2).T


def data_about(
    observations: Observations, rig: Rig, near: Prediction, used: BoolArray, logarithms: bool = False
) -> Data:
    """What fits work on, its measuring chain about a solution.

    Args:
        observations: the real side.
        rig: an explanation of it.
        near: its prediction.
        used: rows that are compared, (m,).
        logarithms: compare logarithms of lines: far from the optimum they lead further.
    """
    lines = np.zeros((2, 0), dtype=np.int64) if logarithms else lines_of(observations)
    chain = linear_chain(observations, rig, near)
    both = chain.added & np.ones((len(observations.rows), 1), dtype=bool)
    on_lines = np.zeros((len(observations.rows), 1), dtype=bool)
    on_lines[lines.ravel()] = True
    added = np.where(both & on_lines, chain.columns, 0.0)
    misfit = misfit_of(observations)
    sigma = np.sqrt(sigma_of(observations) ** 2 + misfit.common**2 + misfit.independent**2)
    groups = groups_of(observations, (misfit.common**2 + misfit.independent**2) / sigma**2)
    share = np.where(observations.rows.part == Part.SAMPLE, 0.0, misfit.common / sigma) ** 2
    data = Data(
        observations, Forward(observations.tests, observations.rows), sigma, share, groups, chain.columns - added,
        added, chain.names, used, lines,
    )  # fmt: skip
    if not misfit.records:
        return data
    # Scales multiply what rows share, too; that of a gap would make half of a response an ordinary misfit.
    scales = best_chain_errors(data, near.values).weights ** -0.5
    scaled = sigma * np.maximum(scales / THRESHOLDS.verdict.credible_noise_scale, 1.0)
    return replace(data, records=tuple((index, shared / scaled[index, None]) for index, shared in misfit.records))


@dataclass(frozen=True)
class ChainErrors:
    """Best errors of the chain and scales for one prediction.

    Attributes:
        chain: in standard deviations, (r,).
        slopes: derivatives by them, over σ, (m, r).
        residual: of the rows with these errors, over σ, (m,).
        weights: 1/s² of each row, (m,).
        squares: Σ (e/σ)² of each group, (K,).
        cost: −2 ln of likelihood and prior of the errors.
        values: of the model with the errors that multiply it, (m,).
        key: of the data that were fitted.
        products: of the derivatives that the last steps used, in each group, (K, r, r).
    """

    chain: FloatArray
    slopes: FloatArray
    residual: FloatArray
    weights: FloatArray
    squares: FloatArray
    cost: float
    values: FloatArray
    key: object = None
    products: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0)))


def chain_errors_at(data: Data, values: FloatArray, chain: FloatArray) -> ChainErrors:
    """Residual and cost of a model's values, (m,), with given errors of the chain, (r,); without derivatives."""
    groups, counts = data.groups, data.counts
    moved = values + data.chain @ chain
    left = data.whitened(data.residual_of(moved, chain))
    squares = groups.sums(left * left)
    weights = groups.weights(squares, counts)[groups.of]
    cost = groups.cost(squares, counts) + float(chain @ chain)
    return ChainErrors(chain, np.zeros((0, 0)), left, weights, squares, cost, moved, data.key)


def best_chain_errors(data: Data, values: FloatArray, start: ChainErrors | None = None) -> ChainErrors:
    """Errors of the chain and scales that explain the observations best.

    Gauss–Newton with reweighting. What lines turn changes little from step to step, so that derivatives are computed
    anew only where a step gains less than they promise.

    Args:
        data: what fits work on.
        values: of the model, (m,).
        start: of a prediction nearby.
    """
    groups, counts = data.groups, data.counts
    count, at = data.chain.shape[1], partial(chain_errors_at, data, values)
    best = at(np.zeros(count))
    slopes, damping = np.zeros((0, 0)), 0.0
    products = np.zeros((0, 0, 0))
    if start is not None:
        near = at(start.chain)
        best = near if near.cost < best.cost else best
        if start.key is data.key:
            slopes, products = start.slopes, start.products
    known, exact = bool(products.size), False
    for _ in range(_MOST_REWEIGHTINGS):
        if not known:
            slopes, exact = data.chain_slopes(best.values), True
            products = groups.products(slopes)
        fresh, known = not known, True
        normal = np.tensordot(groups.weights(best.squares, counts), products, 1) + np.eye(count)
        gradient = slopes.T @ (best.weights * best.residual) - best.chain
        for _ in range(_MOST_TRIALS):
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
            trial = at(best.chain + step)
            if trial.cost < best.cost or not fresh:
                break
            damping = max(10.0 * damping, 1e-3)
        fall, promised = best.cost - trial.cost, float(gradient @ step)
        best = trial if fall > 0.0 else best
        if max(fall, promised) < _CHAIN_FALL:
            if exact:
                break
            # Old derivatives promise nothing more; those at the best may.
            slopes, exact = data.chain_slopes(best.values), True
            continue
        if fall <= 0.0 and fresh:
            break
        damping = 0.1 * damping if damping > 1e-4 else 0.0
        exact, known = False, fall > _CHAIN_GAIN * promised
    return replace(best, slopes=slopes if exact else data.chain_slopes(best.values), products=products)


_CHAIN_FALL = 1e-2
"""Fall of −2 ln likelihood below which errors of the chain are at their best."""
_CHAIN_GAIN = 0.5
"""Share of a promised fall that a step gains as long as its derivatives serve."""


@dataclass(frozen=True)
class FitResult:
    """A fit.

    Attributes:
        parametrisation: what θ means.
        theta: most probable, (n,).
        covariance: of θ, chain and scales free, (n, n).
        errors: chain and scales.
        jacobian: ∂f/∂θ over σ, (m, n).
        prediction: of the model at θ, without the errors of the chain.
        cost: −2 ln of likelihood and priors.
        log_evidence: ln ∫ likelihood · prior, without constants of the rows.
        promised: fall of the cost that one more step promises; 0 where no step along it lowers the cost, however short.
        exact: whether ``jacobian`` is of θ and not of the way there.
        start: name of the start that led there.
    """

    parametrisation: Parametrisation
    theta: FloatArray
    covariance: FloatArray
    errors: ChainErrors
    jacobian: FloatArray
    prediction: Prediction
    cost: float
    log_evidence: float
    promised: float
    exact: bool
    start: str = ""

    @property
    def std(self) -> FloatArray:
        """Standard uncertainties of θ, (n,)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 1e-300)))

    def is_of(self, data: Data, parametrisation: Parametrisation, theta: FloatArray) -> bool:
        """Whether it is a fit to these data that ended there."""
        same = self.parametrisation is parametrisation and self.errors.key is data.key
        return same and np.array_equal(self.theta, theta)

    @property
    def converged(self) -> bool:
        """No step promises a fall that matters."""
        return self.promised < THRESHOLDS.fits.converged_cost_fall


class Metric:
    """Inner products of whitened vectors after the part that chain and parameters can explain is projected out.

    Args:
        columns: derivatives by these parameters, over σ, (m, k).
        precision: inverse prior variance of each, (k,).
        weights: of the rows, (m,).
    """

    def __init__(self, columns: FloatArray, precision: FloatArray, weights: FloatArray) -> None:
        self._weighted = columns * weights[:, None]
        self._weights = weights
        self.normal = columns.T @ self._weighted + np.diag(precision)
        self._factor = _factor(self.normal)
        self._columns = columns

    def project(self, vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual of vectors (m, p) after a fit of the columns, and the coefficient of each column, (k, p)."""
        along = self._weighted.T @ vectors
        taken = np.linalg.solve(self._factor.T, np.linalg.solve(self._factor, along))
        return np.asarray(vectors - self._columns @ taken), np.asarray(taken)

    @property
    def log_determinant(self) -> float:
        """ln det of the normal matrix."""
        return 2.0 * float(np.sum(np.log(np.diag(self._factor))))


def _factor(normal: FloatArray) -> FloatArray:
    """Cholesky factor of a normal matrix; where rounding leaves it none, of one with a little more on its diagonal."""
    diagonal = np.diag(np.maximum(np.diag(normal), 1e-300))
    for share in (1e-13, 1e-10):
        try:
            return np.asarray(np.linalg.cholesky(normal + share * diagonal))
        except np.linalg.LinAlgError:
            continue
    return np.asarray(np.linalg.cholesky(normal + 1e-7 * diagonal))


def predicted(
    data: Data, parametrisation: Parametrisation, theta: FloatArray, start: Prediction | None
) -> Prediction | None:
    """The model's prediction; None where the parameters make no rig, or a used row has no solution."""
    try:
        found = data.forward.predict(parametrisation.rig(theta), start)
    except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError):
        return None
    return found if np.all(np.isfinite(found.values[data.used])) else None


def sensitivities(
    data: Data,
    parametrisation: Parametrisation,
    theta: FloatArray,
    near: Prediction,
    errors: ChainErrors,
    which: range | None = None,
) -> FloatArray:
    """∂f/∂θ over σ, (m, n), or by those parameters that are asked for.

    Raises:
        FitError: the model has none there.
    """
    if not theta.size:
        return np.zeros((data.sigma.size, 0))
    try:
        return data.slopes(data.forward.jacobian(parametrisation, theta, near, which), errors.values)
    except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise FitError(f"the model has no sensitivities there ({error})") from error


@dataclass(frozen=True)
class Effort:
    """How much a fit may cost.

    Attributes:
        steps: most steps.
        refreshes: how often sensitivities may be computed anew on the way.
        exact: compute them anew at the end.
    """

    steps: int = _MOST_STEPS
    refreshes: int = _MOST_STEPS
    exact: bool = True


TO_THE_END = Effort()
ON_THE_WAY = Effort(exact=False)
# Finalists are fitted to the end.
FIRST_LOOK = Effort(refreshes=3, exact=False)
# A refit to a part of the rows starts at the optimum of all.
REFIT = Effort(8, 2, exact=False)
# Each stage of an approach from afar only has to come near.
_FROM_AFAR = Effort(10, exact=False)


@dataclass(frozen=True)
class Start:
    """Where a fit begins.

    Attributes:
        name: of the place, as the ledger has it.
        theta: parameters, (n,).
        near: a solution nearby, or a fit, which goes on where it is of the same data, parametrisation and θ.
        known: parameters, the first of θ, whose sensitivities the fit nearby lends; 0 = all are computed.
        coarse: approach from afar, first to a tenth of everything measured, then ever closer. Far from the optimum the
            learnt scale of a group of rows grows so large that the group hardly counts, and the fit stays there; with a
            coarse demand on all rows at first no group is lost.
        effort: of the fit.
    """

    name: str
    theta: FloatArray
    near: Prediction | FitResult | None = None
    known: int = 0
    coarse: bool = False
    effort: Effort = TO_THE_END


def fit(data: Data, parametrisation: Parametrisation, start: Start) -> FitResult:
    """Fit an explanation from one start; see :func:`nmt_diagnose.fit.best_fit.best_fit` for several.

    Args:
        data: what fits work on.
        parametrisation: what θ means.
        start: where to begin.

    Raises:
        FitError: the model cannot be solved at the start.
    """
    start = _from_nearby(data, parametrisation, start) if start.coarse else start
    std, lower, effort, near = parametrisation.prior_std, parametrisation.lower, start.effort, start.near
    refreshes = effort.refreshes
    theta = np.maximum(np.asarray(start.theta, dtype=np.float64), lower)
    if isinstance(near, FitResult) and near.is_of(data, parametrisation, theta):
        prediction, errors, slopes, fresh = near.prediction, near.errors, near.jacobian, near.exact
    else:
        found = predicted(data, parametrisation, theta, near.prediction if isinstance(near, FitResult) else near)
        if found is None:
            raise FitError("the model has no solution for the rows that are compared")
        prediction, errors, fresh = found, best_chain_errors(data, found.values), not start.known
        slopes = _slopes_at(data, parametrisation, theta, prediction, errors, start)
    cost = errors.cost + float(np.sum((theta / std) ** 2))
    damping, settled = 1e-3, False
    for _ in range(effort.steps if theta.size else 0):
        normal, gradient = _normal(slopes, errors, theta, std)
        trial = None
        for _ in range(_MOST_TRIALS):
            step = _bounded(normal, gradient, damping, theta, lower)
            step *= min(1.0, _LARGEST_STEP / max(float(np.max(np.abs(step) / std)), 1e-300))
            moved = np.maximum(theta + step, lower)
            step = moved - theta
            promised = float(2.0 * gradient @ step - step @ normal @ step)
            if promised < 0.1 * THRESHOLDS.fits.converged_cost_fall:
                break
            found = predicted(data, parametrisation, moved, prediction)
            if found is not None:
                chain_errors = best_chain_errors(data, found.values, errors)
                total = chain_errors.cost + float(np.sum((moved / std) ** 2))
                if total < cost:
                    trial = found
                    break
            if not fresh:
                break
            damping = max(damping, 1e-4) * 10.0
        if trial is None:
            # Sensitivities from elsewhere may promise nothing where those at the estimate would lead on.
            settled = fresh
            if fresh or refreshes <= 0 or not (effort.exact or promised >= 0.1 * THRESHOLDS.fits.converged_cost_fall):
                break
            slopes, fresh = sensitivities(data, parametrisation, theta, prediction, errors), True
            refreshes -= 1
            continue
        gained = cost - total
        changed = data.change(prediction.values, trial.values, chain_errors)
        slopes = slopes + np.outer(changed - slopes @ step, step) / float(step @ step)
        fresh = False
        theta, prediction, errors, cost = moved, trial, chain_errors, total
        # A step that gains far less than it promised went over a bend: undamped ones would swing about the optimum.
        damping = 0.1 * damping if gained > _DAMPING_GAIN_RATIO * promised else 10.0 * max(damping, 1e-3)
        # Broyden's update follows what a step showed; sensitivities are computed anew where one fell short of it.
        if gained < _BROYDEN_LEAST_GAIN_RATIO * promised and refreshes > 0:
            slopes, fresh = sensitivities(data, parametrisation, theta, prediction, errors), True
            refreshes -= 1
        if gained < 0.1 * THRESHOLDS.fits.converged_cost_fall:
            break
    if effort.exact and not fresh:
        slopes, fresh = sensitivities(data, parametrisation, theta, prediction, errors), True
    return _finished(parametrisation, theta, errors, slopes, prediction, cost, settled, fresh, start.name)


def _from_nearby(data: Data, parametrisation: Parametrisation, start: Start) -> Start:
    """The start that one from afar leads to by ever smaller shares of everything measured."""
    start = replace(start, coarse=False)
    for share in _APPROACH_SHARES:
        blurred = replace(data, sigma=np.hypot(data.sigma, share * _natural_size(data.observations)))
        found = fit(blurred, parametrisation, replace(start, effort=_FROM_AFAR))
        start = replace(start, theta=found.theta, near=found.prediction, known=0)
    return start


def _slopes_at(
    data: Data, parametrisation: Parametrisation, theta: FloatArray, at: Prediction, errors: ChainErrors, start: Start
) -> FloatArray:
    """Sensitivities at the beginning of a fit, (m, n): those that the fit nearby knows are not computed."""
    if not start.known:
        return sensitivities(data, parametrisation, theta, at, errors)
    assert isinstance(start.near, FitResult)
    known = start.near.jacobian[:, : start.known]
    more = range(start.known, theta.size)
    if not more:
        return known
    return np.column_stack([known, sensitivities(data, parametrisation, theta, at, start.near.errors, more)])


def _normal(
    slopes: FloatArray, errors: ChainErrors, theta: FloatArray, std: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix of θ with the chain marginalised, and the gradient.

    Errors of the chain are at their best to a tiny fall of the cost. Where θ and chain are nearly collinear, the
    remaining gradient of the chain is larger than that of θ, so that it is taken off.
    """
    metric = Metric(errors.slopes, np.ones(errors.chain.size), errors.weights)
    projected, taken = metric.project(slopes)
    normal = projected.T @ (slopes * errors.weights[:, None]) + np.diag(std**-2.0)
    left = errors.weights * errors.residual
    gradient = slopes.T @ left - theta / std**2 - taken.T @ (errors.slopes.T @ left - errors.chain)
    return 0.5 * (normal + normal.T), gradient


def _bounded(
    normal: FloatArray, gradient: FloatArray, damping: float, theta: FloatArray, lower: FloatArray
) -> FloatArray:
    """Damped step; parameters at their bound that would leave it stay there."""
    free = ~((theta <= lower) & (gradient < 0.0))
    step = np.zeros_like(theta)
    if np.any(free):
        matrix = normal[np.ix_(free, free)]
        step[free] = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), gradient[free])
    return step


def _finished(
    parametrisation: Parametrisation,
    theta: FloatArray,
    errors: ChainErrors,
    slopes: FloatArray,
    prediction: Prediction,
    cost: float,
    settled: bool,
    exact: bool,
    start: str,
) -> FitResult:
    std = parametrisation.prior_std
    chain = Metric(errors.slopes, np.ones(errors.chain.size), errors.weights)
    normal, gradient = _normal(slopes, errors, theta, std)
    step = _bounded(normal, gradient, 0.0, theta, parametrisation.lower)
    promised = 0.0 if settled else float(2.0 * gradient @ step - step @ normal @ step)
    _, of_theta = np.linalg.slogdet(normal)
    log_evidence = -0.5 * cost - 0.5 * (chain.log_determinant + float(of_theta)) - float(np.sum(np.log(std)))
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    return FitResult(
        parametrisation, theta, covariance, errors, slopes, prediction, cost,
        log_evidence + parametrisation.log_prior, promised, exact, start,
    )  # fmt: skip


def _natural_size(observations: Observations) -> FloatArray:
    """What is a large change of each row, (m,): a neper, a radian, a bandwidth of 1 %; 0 for what has no such size."""
    part, values = observations.rows.part, observations.values
    size = np.ones(len(observations.rows))
    size[part == Part.LOG_FREQUENCY] = _LARGE_LOG_FREQUENCY
    of_value, of_rms, none = (
        np.isin(part, with_natural(natural)) for natural in (Natural.VALUE, Natural.RMS, Natural.NONE)
    )
    size[of_value], size[none] = np.abs(values[of_value]), 0.0
    if of_rms.any():
        size[of_rms] = float(np.sqrt(np.mean(values[of_rms] ** 2)))
    return size
