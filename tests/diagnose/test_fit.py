from dataclasses import replace

import numpy as np
import pytest
from diagnose.linear_problem import FunctionModel, Plain, observations_of
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal

from nmt_diagnose.inference.fit import FitError, fit
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.observations.observables import Part


def test_linear_fit_is_the_gaussian_posterior():
    generator = np.random.default_rng(1)
    matrix = generator.standard_normal((40, 3))
    sigma = generator.uniform(0.5, 2.0, 40)
    prior = np.array([1.0, 0.3, 2.0])
    measured = matrix @ np.array([0.4, -0.2, 1.5]) + sigma * generator.standard_normal(40)
    plain = Plain(prior, np.full(3, -np.inf), ("a", "b", "c"))
    result = fit(Problem(observations_of(measured, sigma), FunctionModel(lambda t: matrix @ t)), plain, np.zeros(3))
    # Conditional mean of jointly Gaussian θ and y, by the other formula (gain matrix).
    joint = matrix @ np.diag(prior**2) @ matrix.T + np.diag(sigma**2)
    gain = np.diag(prior**2) @ matrix.T @ np.linalg.inv(joint)
    assert np.allclose(result.theta, gain @ measured, atol=2e-3)
    assert np.allclose(result.covariance, np.diag(prior**2) - gain @ matrix @ np.diag(prior**2), atol=1e-6)
    assert result.converged


def test_log_evidence_is_the_marginal_likelihood_of_a_linear_model():
    generator = np.random.default_rng(2)
    matrix = generator.standard_normal((15, 2))
    measured = generator.standard_normal(15) * 2.0
    result = fit(
        Problem(observations_of(measured, 1.0), FunctionModel(lambda t: matrix @ t)), Plain.of(2, 0.7), np.zeros(2)
    )
    exact = multivariate_normal(np.zeros(15), np.eye(15) + 0.49 * matrix @ matrix.T).logpdf(measured)
    assert result.log_evidence - 7.5 * np.log(2.0 * np.pi) == pytest.approx(exact, abs=1e-4)


def test_log_evidence_of_a_curved_model_is_close_to_its_integral():
    x = np.linspace(0.0, 1.0, 30)

    def model(t):
        return np.exp(0.3 * t[0] * x)

    measured = model(np.array([1.2])) + 0.05 * np.random.default_rng(3).standard_normal(30)
    result = fit(Problem(observations_of(measured, 0.05), FunctionModel(model)), Plain.of(1, 2.0), np.zeros(1))

    def integrand(t):
        residual = (measured - model(np.array([t]))) / 0.05
        return np.exp(-0.5 * (residual @ residual - result.chi_square) - 0.5 * (t / 2.0) ** 2) / (
            2.0 * np.sqrt(2.0 * np.pi)
        )

    integral, _ = quad(integrand, -3.0, 5.0, points=[result.theta[0]], limit=200)
    assert result.log_evidence == pytest.approx(np.log(integral) - 0.5 * result.chi_square, abs=0.02)


def test_phases_are_compared_on_the_shortest_way():
    observations = observations_of([np.pi - 0.01], 0.1, part=Part.PHASE)
    result = fit(
        Problem(observations, FunctionModel(lambda t: np.array([-np.pi + 0.01]) + t)), Plain.of(1, 10.0), np.zeros(1)
    )
    assert abs(result.theta[0] + 0.02) < 1e-3


def test_bounds_hold_and_rows_without_solution_are_left_out():
    observations = observations_of([-1.0, -1.0, 5.0], 1.0)
    model = FunctionModel(lambda t: np.array([t[0], t[0], np.nan]))
    result = fit(Problem(observations, model), Plain.of(1, 3.0, lower=0.0), np.ones(1))
    assert result.theta[0] == 0.0
    assert not result.used[2]
    with pytest.raises(FitError, match="no solution"):
        fit(Problem(observations, FunctionModel(lambda t: np.full(3, np.nan))), Plain.of(1), np.zeros(1))


def test_a_cold_fit_goes_around_a_fold_that_a_warm_one_ends_in():
    """A response that comes back far from what is believed: the prior tells the two optima apart, not the data."""

    def model(t):
        return np.array([np.cos(2.0 * (t[0] - 0.5)) * 5.0, t[0] * 0.01])

    function = FunctionModel(model)
    problem = Problem(observations_of(model(np.array([0.4])), 0.01), function)
    plain, begin = Plain.of(1, 1.0), np.array([2.3])
    warm = fit(problem, plain, begin, start=function.predict(begin))
    assert abs(warm.theta[0] - 0.4) > 2.0
    cold = fit(problem, plain, begin)
    assert abs(cold.theta[0] - 0.5) == pytest.approx(0.1, abs=1e-3)  # the cosine does not know the side
    assert cold.log_evidence > warm.log_evidence


def test_parameters_that_hardly_differ_still_have_uncertainties():
    column = np.linspace(1.0, 2.0, 30) * 1e6
    matrix = np.column_stack([column, column * (1.0 + 1e-9), column])
    model = FunctionModel(lambda t: matrix @ t)
    result = fit(Problem(observations_of(matrix @ np.ones(3), 1.0), model), Plain.of(3, 1.0), np.zeros(3))
    assert np.all(np.isfinite(result.std))
    assert np.all(result.predictive_std >= 1.0)


def test_a_fit_that_stops_before_its_optimum_says_so():
    """A narrow bent valley (Rosenbrock): one step is not enough, and where steps are too short they promise little."""

    def valley(t):
        return np.array([20.0 * (t[1] - t[0] ** 2), 2.0 - t[0]])

    def derivative(t):
        return np.array([[-40.0 * t[0], 20.0], [-1.0, 0.0]])

    problem = Problem(observations_of(np.zeros(2), 0.01), FunctionModel(valley, derivative))
    plain = Plain.of(2, 10.0)
    start = FunctionModel(valley).predict(np.array([-1.5, 2.0]))
    early = fit(problem, plain, np.array([-1.5, 2.0]), start=start, steps=2)
    assert not early.converged
    assert early.chi_square > 1.0
    whole = fit(problem, plain, np.array([-1.5, 2.0]), start=start, steps=200, refreshes=200)
    assert whole.converged
    assert np.allclose(whole.theta, [2.0, 4.0], atol=0.05)


def test_what_is_left_beyond_the_noise_makes_parameters_uncertain():
    """A line through points that scatter five times as much as stated: how far its slope scatters is known."""
    x = np.linspace(-1.0, 1.0, 40)
    generator = np.random.default_rng(12)

    def slope(size):
        measured = 2.0 * x + size * generator.standard_normal(x.size)
        model = FunctionModel(lambda t: x * t[0])
        return fit(Problem(observations_of(measured, 1.0), model), Plain.of(1, 100.0), np.zeros(1))

    found = [slope(5.0) for _ in range(200)]
    spread = np.std([item.theta[0] for item in found])
    stated = np.mean([item.std[0] * item.scatter for item in found])
    assert stated == pytest.approx(spread, rel=0.15)
    # Within chance the stated uncertainties stay as they are.
    assert slope(1.0).scatter == 1.0


def test_a_less_probable_part_of_the_prior_costs_its_weight():
    x = np.linspace(0.0, 1.0, 20)
    problem = Problem(observations_of(3.0 * x, 1.0), FunctionModel(lambda t: x * t[0]))
    plain = Plain.of(1, 2.0)
    usual, rare = (fit(problem, replace(plain, log_prior=value), np.zeros(1)) for value in (0.0, -2.5))
    assert usual.log_evidence - rare.log_evidence == pytest.approx(2.5)


def test_sensitivities_that_are_known_are_not_computed_again():
    """A fit that goes on from its own estimate: the same outcome, one set of sensitivities less."""
    generator = np.random.default_rng(5)
    grid = np.linspace(0.0, 1.0, 30)
    computed = []

    def derivative(theta):
        computed.append(theta.copy())
        return np.column_stack([np.exp(theta[1] * grid), theta[0] * grid * np.exp(theta[1] * grid)])

    model = FunctionModel(lambda t: t[0] * np.exp(t[1] * grid), derivative)
    problem = Problem(observations_of(1.5 * np.exp(0.8 * grid) + 0.1 * generator.standard_normal(30), 0.1), model)
    plain = Plain.of(2, 2.0)
    first = fit(problem, plain, np.zeros(2))
    assert first.fresh
    outcomes, counts = [], []
    for known in (None, first.jacobian):
        computed.clear()
        outcomes.append(fit(problem, plain, first.theta, None, first.prediction, known=known))
        counts.append(len(computed))
    assert counts[0] == counts[1] + 1
    plainly, quickly = outcomes
    np.testing.assert_array_equal(plainly.theta, quickly.theta)
    np.testing.assert_array_equal(plainly.jacobian, quickly.jacobian)
    assert plainly.log_evidence == quickly.log_evidence
    # Sensitivities from elsewhere are no witness of an optimum.
    stale = fit(problem, plain, first.theta, None, first.prediction, first.jacobian, steps=0, exact=False)
    assert not stale.fresh


class _Counting(FunctionModel):
    """Counts how often sensitivities are asked for."""

    def __init__(self, function):
        super().__init__(function)
        self.sensitivities = 0

    def jacobian(self, parametrisation, theta, prediction, which=None):
        self.sensitivities += 1
        return super().jacobian(parametrisation, theta, prediction, which)


def _shaker(theta):
    """Force per volt and added damping of a shaker whose current is not measured, over frequency.

    Force factor, resistance and damping of the table make up for one another: along the valley G/R and d + G²/R stay.
    """
    g, r, d = np.exp(np.array([0.03, 0.03, 0.1]) * theta) * np.array([15.0, 3.0, 25.0])
    per_volt = g / r
    added = d + g**2 / r
    return np.concatenate([np.full(40, per_volt), np.full(40, added)])


def test_a_narrow_curved_valley_is_followed_to_its_optimum():
    """The optimum along the valley is that of the prior; found by a search in one dimension for comparison."""
    away = np.array([1.5, 1.5, 0.0])
    measured = _shaker(np.zeros(3))
    # The start lies in the valley, where the prior alone says in which direction to go.
    g, r = 15.0 * np.exp(0.045), 3.0 * np.exp(0.045)
    away[2] = np.log((100.0 - g**2 / r) / 25.0) / 0.1
    assert np.allclose(_shaker(away), measured)
    model = _Counting(_shaker)
    sigma = np.concatenate([np.full(40, 5.0e-6 * 5.0), np.full(40, 5.0e-6 * 100.0)])
    problem = Problem(observations_of(measured, sigma), model)
    result = fit(problem, Plain.of(3), away, start=model.predict(away))

    def prior(share):
        d = 100.0 - 75.0 * np.exp(0.03 * share)
        return 2.0 * share**2 + (np.log(d / 25.0) / 0.1) ** 2

    best = minimize_scalar(prior, bounds=(-2.0, 2.0), method="bounded", options={"xatol": 1e-9})
    assert result.converged
    assert result.theta == pytest.approx([best.x, best.x, 0.0], abs=0.02)
    assert model.sensitivities <= 12


def test_what_a_fit_leaves_is_the_noise_by_which_its_steps_count():
    """A model that is wrong by a hundred σ does not creep for falls of χ² that nobody could see."""
    x = np.linspace(0.0, 1.0, 200)
    measured = 100.0 * np.sign(np.sin(40.0 * x))
    model = _Counting(lambda t: 30.0 * np.tanh(0.3 * t[0] * x) + 30.0 * np.exp(0.2 * t[1] * x))
    result = fit(Problem(observations_of(measured, 1.0), model), Plain.of(2), np.zeros(2))
    noise = result.chi_square / 200.0
    assert noise > 1000.0
    assert result.converged
    best = min(
        fit(Problem(observations_of(measured, 1.0), model), Plain.of(2), start).chi_square
        for start in ([0.5, 0.5], [-0.5, -0.5])
    )
    assert result.chi_square - best < noise
