"""By how much a test that has not been made sets fitted explanations apart.

For two explanations a and b, fitted to what has been measured, the predictions of a new test differ by Δ. What b can
still adapt within its posterior covariance C (sensitivities J_b of the new test) does not count:

    d² = Δᵀ Σ^(-½) (1 + J_b C J_bᵀ)⁻¹ Σ^(-½) Δ,

with uncertainties Σ as they were in the tests at hand. Errors of the measuring chain count among what b adapts by. d is
the expected number of standard deviations by which the test separates a from b, a being true.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.special import entr

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_diagnose.ahead.ahead import Ahead
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.ledger.comparison import Comparison
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.thresholds import THRESHOLDS


def competing(comparison: Comparison, null: FittedExplanation) -> list[FittedExplanation]:
    """The explanations that most need distinguishing: of one class, or the heads of the first two.

    Args:
        comparison: explanations.
        null: the model with its parameters re-fitted; what competes where there is only one explanation.

    Returns:
        At least two, or none where nothing is left to settle.
    """
    classes = comparison.classes
    if not classes:
        return []
    if len(classes[0].members) > 1:
        return list(classes[0].members[:3])
    if len(classes) > 1 and classes[1].probability > THRESHOLDS.next_test.second_class_share * classes[0].probability:
        return [classes[0].head, classes[1].head]
    # One explanation stands alone: nothing is left to settle, unless it hardly beats having none.
    return [classes[0].head, null] if comparison.none > THRESHOLDS.next_test.doubtful_probability else []


class Apart:
    """How far a test that has not been made sets competing hypotheses apart.

    Args:
        left: its observables with expected uncertainties; values are not set.
        competitors: the hypotheses, fitted to the recordings at hand.
        chain_names: of the errors of the measuring chain in the fits.
    """

    def __init__(
        self, left: Observations, competitors: Sequence[FittedExplanation], chain_names: Sequence[str]
    ) -> None:
        self._sigma, self._ahead = left.sigma, list[Ahead]()
        try:
            for competitor in competitors:
                chain = self._ahead[0].chain if self._ahead else None
                self._ahead.append(Ahead(competitor.fit, chain_names, left, chain))
        except (BenchError, ArithmeticError, np.linalg.LinAlgError):
            self._ahead = []

    def sigmas(self, rows: BoolArray | None = None) -> tuple[float, float]:
        """Least expected distance over all ordered pairs of hypotheses and over those of the first two, in σ.

        0 where one has no solution.

        Args:
            rows: those that count, (m,); None = all.
        """
        if not self._ahead:
            return 0.0, 0.0
        distances: dict[tuple[int, int], float] = {}
        for one, other in itertools.permutations(range(len(self._ahead)), 2):
            a, b = self._ahead[one], self._ahead[other]
            difference = a.forward.difference(a.base.values, b.base.values)
            good = np.isfinite(difference) & np.isfinite(b.base.values)
            good &= True if rows is None else rows
            distances[one, other] = b.apart(difference / self._sigma, good) if good.any() else 0.0
        return min(distances.values()), min(distances[0, 1], distances[1, 0])


def expected_information(p: float, q: float, sigmas: float) -> float:
    """Expected fall of the entropy of two hypotheses by a test that sets them apart, nats.

    The ln of their odds moves by a normal variable of mean ±d²/2, as either is true, and variance d²; the mean over it
    is taken by Gauss and Hermite's rule.

    Args:
        p, q: probabilities of the two, whatever else there is.
        sigmas: by how many standard deviations d the test separates them.
    """
    if not p + q > 0.0:
        return 0.0
    p, q = p / (p + q), q / (p + q)
    if not min(p, q) > 0.0:
        return 0.0
    nodes, weights = np.polynomial.hermite_e.hermegauss(61)
    weights = weights / weights.sum()
    log_odds, left = math.log(p / q), 0.0
    for share, sign in ((p, 1.0), (q, -1.0)):
        after = 1.0 / (1.0 + np.exp(-np.clip(log_odds + sign * 0.5 * sigmas**2 + sigmas * nodes, -700.0, 700.0)))
        left += share * float(weights @ _entropy(after))
    return max(0.0, float(_entropy(np.array(p))) - left)


def _entropy(p: FloatArray) -> FloatArray:
    """Entropy of two alternatives, nats."""
    return np.asarray(entr(p) + entr(1.0 - p), dtype=np.float64)
