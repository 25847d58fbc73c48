"""Explanations that a search begins with where the model alone is so far off that a scan about it says little.

Each begins where one kind of observation tells it: the lowest levels, the frequencies of resonances, phases, forces.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nmt_core.arrays import FloatArray
from nmt_core.errors import BenchError
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.inference.candidate_starts import (
    at_strength,
    at_zero,
    starts_of,
    strength_parameter,
    strength_position,
)
from nmt_diagnose.inference.fit import Fit, FitError, fit
from nmt_diagnose.inference.fitted_model import FittedModel, is_incredible, rms_left
from nmt_diagnose.inference.force_starts import ForceColumn, even_column, force_starts, lines_of_known_amplitude
from nmt_diagnose.inference.late_starts import DELAYS, late_starts
from nmt_diagnose.inference.level_climb import level_ranks
from nmt_diagnose.inference.model_comparison import ModelComparison
from nmt_diagnose.inference.resonance_starts import resonance_starts
from nmt_rig.rig import Rig

_LOWEST = 0.25  # of the levels, which are nearly linear
# Explanations that begin where natural frequencies suit the responses' peaks, and where forces of sweeps tell it.
_FROM_RESONANCES, _FROM_FORCES = 6, 6
# Late channels that begin where phases tell it.
_FROM_DELAYS = 3
# Rms of what the model alone leaves, in standard deviations, from which forces are asked, and where effects with a
# force lie.
_FAR = 10.0
_WITH_FORCE = ("structure", "boundary", "joint")
# Change of the observables per unit of strength, below which a force is even for them; the strength at which its square
# is looked at, of the one where a search would begin otherwise: small, so that nothing else is in it.
_EVEN, _EVEN_STRENGTH = 1e-6, 0.25


def first_explanations(comparison: ModelComparison, null: FittedModel) -> list[FittedModel]:
    """Explanations by one effect that a search may begin with, best first; none where a scan suffices.

    Args:
        comparison: fits them.
        null: the model without effect, its own parameters re-fitted.
    """
    if rms_left(null) < _FAR and not is_incredible(null.fit):
        return []
    own = null.fit.parametrisation
    try:
        given = fit(comparison.fits.problem, own, own.zero, null.fit.used, steps=0)
    except FitError:
        return []
    found: list[FittedModel] = []
    if is_incredible(null.fit):
        found += _from_delays(comparison, given) + _from_below(comparison, null, given)
    if rms_left(null) >= _FAR:
        found += _from_forces(comparison, null, given)
    return sorted(found, key=lambda explanation: -explanation.fit.log_evidence)


def _from_below(comparison: ModelComparison, null: FittedModel, given: Fit) -> list[FittedModel]:
    """Effects added to the model as the lowest levels show it.

    Where the real structure is far from any linear one, the model without effect that is fitted to all levels has
    parameters that mean nothing, and so have directions about it. The lowest levels are nearly linear.
    """
    problem, own, used = comparison.fits.problem, null.fit.parametrisation, null.fit.used
    levelled, rank = level_ranks(problem.observations)
    lowest = used & (~levelled | (rank < _LOWEST))
    if not np.any(lowest & levelled):
        return _from_resonances(comparison, given)
    try:
        below = fit(problem, own, own.zero, lowest)
        if is_incredible(below):
            return []
        base = FittedModel((), fit(problem, own, below.theta, used, below.prediction, steps=0))
    except FitError:
        return []
    return comparison.singles(base, comparison.scan(base))


def _from_resonances(comparison: ModelComparison, given: Fit) -> list[FittedModel]:
    """Effects from where they bring natural frequencies to where responses peak."""
    own, candidates = given.parametrisation, comparison.fits.candidates
    alone = [_with(comparison, (number,)) for number in range(len(candidates))]
    first = [starts_of(candidate)[0] for candidate in candidates]

    def changed(number: int, strength: float) -> Rig:
        start = at_strength(candidates[number], first[number], strength)
        return alone[number].rig(np.concatenate([own.zero, start]))

    spreads = [
        (float(each.prior_std[own.zero.size + strength_position(candidate)]), strength_parameter(candidate).signed)
        for each, candidate in zip(alone, candidates, strict=True)
    ]
    fits = comparison.fits
    starts = resonance_starts(fits.problem.observations, fits.rig, spreads, changed, _FROM_RESONANCES)
    return comparison.added_at(FittedModel((), given), starts)


def _from_delays(comparison: ModelComparison, given: Fit) -> list[FittedModel]:
    """Late channels, added to the model as given where their phases tell it."""
    late = [k for k, candidate in enumerate(comparison.fits.candidates) if candidate.effect.name in DELAYS]
    problem, with_all = comparison.fits.problem, _with(comparison, late)
    columns = range(given.theta.size, given.theta.size + len(late))
    slopes = problem.forward.jacobian(with_all, with_all.zero, given.prediction, columns)
    difference = problem.difference(given.prediction.values)
    starts = late_starts(problem.observations, difference, list(slopes.T), _FROM_DELAYS)
    return comparison.added_at(FittedModel((), given), [(late[number], strength) for number, strength in starts])


def _from_forces(comparison: ModelComparison, null: FittedModel, given: Fit) -> list[FittedModel]:
    """Effects of the structure from the forces that sweeps at held amplitudes need."""
    problem, own = comparison.fits.problem, given.parametrisation
    lines = lines_of_known_amplitude(problem.observations)
    if not lines.size:
        return []
    tried: list[tuple[int, FloatArray]] = []
    columns: list[ForceColumn] = []
    for number, candidate in enumerate(comparison.fits.candidates):
        if candidate.effect.place not in _WITH_FORCE or strength_parameter(candidate).grid:
            continue
        for start in starts_of(candidate):
            theta = np.concatenate([own.zero, at_zero(candidate, start)])
            try:
                column = _force_column(comparison, number, theta, given, lines)
            except (BenchError, ValueError, ArithmeticError):
                continue
            tried.append((number, start))
            columns.append(column)
    slopes = problem.forward.jacobian(own, own.zero, given.prediction) * own.prior_std
    difference = problem.difference(given.prediction.values)
    wanted = []
    for begun in force_starts(lines, difference, slopes, columns, _FROM_FORCES):
        number, start = tried[begun.number]
        strength = at_strength(comparison.fits.candidates[number], start, begun.strength)
        wanted.append((number, np.concatenate([begun.own * own.prior_std, strength])))
    return [found for found in comparison.started(wanted) if not np.any(null.fit.used & ~found.fit.used)]


def _force_column(
    comparison: ModelComparison, number: int, theta: FloatArray, given: Fit, lines: NDArray[np.int64]
) -> ForceColumn:
    """What a candidate's strength does to the force, from θ with none of it."""
    candidate, forward = comparison.fits.candidates[number], comparison.fits.problem.forward
    added = _with(comparison, (number,))
    position = given.theta.size + strength_position(candidate)
    strength, spread = strength_parameter(candidate), float(added.prior_std[position])
    slope = forward.jacobian(added, theta, given.prediction, (position,))[:, 0]
    if not strength.even or np.nanmax(np.abs(slope[lines])) > _EVEN:
        return ForceColumn(slope, spread, strength.signed)
    theta = theta.copy()
    theta[position] = _EVEN_STRENGTH * strength.even
    values = forward.predict(added.rig(theta), given.prediction).values
    return even_column(lines, values - given.prediction.values, float(theta[position]), spread)


def _with(comparison: ModelComparison, numbers: Sequence[int]) -> Parametrisation:
    added = tuple(comparison.fits.candidates[number] for number in numbers)
    return Parametrisation(comparison.fits.rig, comparison.fits.calibration, added)
