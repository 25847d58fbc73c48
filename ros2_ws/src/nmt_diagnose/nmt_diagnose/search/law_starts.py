"""Laws that were read as starts of the search: they are fitted and judged as every explanation is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.structure_effects import BELOW
from nmt_diagnose.fit.best_fit import StartName, likelihood, spread_at
from nmt_diagnose.fit.explanations import FittedExplanation, best_of
from nmt_diagnose.fit.fitting import ON_THE_WAY, Start
from nmt_diagnose.law.driven_law import read_driven_law
from nmt_diagnose.law.reading import LawReading, LawTerm, LocalLaw, read_law
from nmt_diagnose.law.record_law import read_record_law
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.search.search import WEAKER_SHARE, Search
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

_LARGEST_LOG = 8.0  # of a shape over its scale: beyond it the start says nothing


def law_of(rig: Rig, observations: Observations) -> LawReading | None:
    """The law of held levels, else of records of an imposed motion, else of driven ones; None without one.

    A test without a law does not hide the law of another.
    """
    found = []
    for read in (read_law, read_record_law, read_driven_law):
        try:
            reading = read(rig, observations)
        except (BenchError, ArithmeticError, np.linalg.LinAlgError):
            continue
        if reading is not None and reading.is_stated:
            return reading
        found += [] if reading is None else [reading]
    return next((reading for reading in found if reading.laws), found[0] if found else None)


def with_laws(search: Search, null: FittedExplanation, reading: LawReading | None) -> list[FittedExplanation]:
    """Explanations that begin at the laws of a reading, the best first.

    Args:
        search: fits explanations.
        null: the model alone.
        reading: of the laws.
    """
    laws = reading.laws if reading is not None else ()
    found = [start for law in laws if (start := _start(search.candidates, law)) is not None]
    if reading is None or not worth_a_start(reading):
        return []
    groups = [[start] for start in found] + ([found] if len(found) > 1 else [])
    late = _late_channel(search.candidates, reading)
    if late is not None:
        groups = [[late], *([*group, late] for group in groups)]
    if not groups:
        return []
    search.tell("fitting force laws estimated from the data")
    fitted = [one for group in groups if (one := _fitted(search, null, group)) is not None]
    return best_of(fitted)


def worth_a_start(reading: LawReading) -> bool:
    """Whether a law explains enough for the search to begin at it."""
    return reading.after <= THRESHOLDS.law.start_score_ratio * reading.before


def _fitted(
    search: Search, null: FittedExplanation, starts: Sequence[tuple[Candidate, FloatArray]]
) -> FittedExplanation | None:
    candidates = [candidate for candidate, _ in starts]
    spreads = [spread_at(candidate, theta) for candidate, theta in starts]
    parametrisation = search.parametrisation(candidates, spreads)
    as_given = np.zeros_like(null.fit.theta)
    near, afar = StartName.LAW, StartName.LAW_GIVEN
    for share, names in ((1.0, (near, afar)), (WEAKER_SHARE, (near.weaker, afar.weaker))):
        added = [_weaker(candidate, parameters, share) for candidate, parameters in starts]
        # The law was read with the model as it was given; without it a strong law has bent the model's own parameters.
        table = [
            Start(names[0], np.concatenate([null.fit.theta, *added]), null.fit.prediction, effort=ON_THE_WAY),
            Start(names[1], np.concatenate([as_given, *added]), coarse=True),
        ]
        found = search.best(parametrisation, table, None, True, likelihood, lambda it: not search.exceeds_noise(it))
        if found is not None:
            return found
    return None


def _weaker(candidate: Candidate, theta: FloatArray, share: float) -> FloatArray:
    """The parameters with their strengths times a share."""
    strengths = [parameter.kind == "strength" for parameter in candidate.effect.parameters]
    return np.where(strengths, share * theta, theta)


def _late_channel(candidates: Sequence[Candidate], reading: LawReading) -> tuple[Candidate, FloatArray] | None:
    """The effect of a force that comes late, with how late; None where it is in step."""
    if reading.late is None:
        return None
    name, late = reading.late
    for candidate in candidates:
        if candidate.effect.name == "channel_skew" and candidate.site.location.channel == name:
            theta = parameters_at(candidate, {"tau": late})
            return None if theta is None else (candidate, theta)
    return None


def _start(candidates: Sequence[Candidate], law: LocalLaw) -> tuple[Candidate, FloatArray] | None:
    """The effect of the library that a law is, with its parameters; None where it has none."""
    orders = {(one.point, one.other_point): effects_of_law(one) for one in (law, law.reversed)}
    for number, (name, _) in enumerate(effects_of_law(law)):
        for candidate in candidates:
            site, effect = candidate.site, candidate.effect
            found = orders.get((site.point, site.other_point))
            if found is None or effect.name != name or site.option != "":
                continue
            values = found[number][1]
            theta = parameters_at(candidate, values)
            if theta is not None and (effect.form == BELOW) == (BELOW in values):
                return candidate, theta
    return None


def effects_of_law(law: LocalLaw) -> list[tuple[str, Mapping[str, float]]]:
    """Names of effects with parameters by name, the strongest term of the law first; a stop below says so, too."""
    sliders = [
        term for term in law.at_middle if term.kind in ("slider", "slack slider", "bristle", "weakening bristle")
    ]
    if sliders:
        stiffness = sum(term.coefficient for term in sliders)
        force = sum(term.coefficient * term.parameters[0] for term in sliders)
        return [("second_friction_contact", _friction(stiffness, force))]
    if any(term.kind in ("friction", "weakening friction") for term in law.at_middle):
        force = sum(term.coefficient for term in law.at_middle if term.unit == "N")
        # A slider that sticks at the smallest level does not act as dry friction there.
        smallest = min((0.5 * float(np.ptp(loop.displacement)) for loop in law.loops), default=law.valid_to_m)
        shares = THRESHOLDS.law
        slip = min(shares.dry_slip_share * law.valid_to_m, shares.dry_stick_share * smallest)
        return [("second_friction_contact", _friction(force / slip, force))]
    largest = sorted(law.at_middle, key=lambda term: -_size(term, law.valid_to_m))
    return [(name, values) for term in largest for name, values in _of_term(term)]


def _friction(stiffness: float, force: float) -> Mapping[str, float]:
    return {"kt": stiffness, "slip_force": force, "slip_displacement": force / stiffness}


def _size(term: LawTerm, reach: float) -> float:
    return abs(term.coefficient) * (reach ** term.parameters[0] if term.kind == "power" else reach)


def _of_term(term: LawTerm) -> list[tuple[str, Mapping[str, float]]]:
    """The effect of a term's element, with its keys for parameters."""
    unit = term.of_unit_strength
    if unit.form.effect is not None:
        found = unit.form.effect(term.coefficient, unit.first)
        return [] if found is None else [found]
    if unit.section is None or unit.section.effect is None:
        return []
    effect, keys = unit.section.effect, unit.values(term.coefficient)
    below = {BELOW: 1.0} if unit.below else {}
    return [(effect.name, {name: keys[key] for name, key in effect.parameters.items()} | below)]


def parameters_at(candidate: Candidate, values: Mapping[str, float]) -> FloatArray | None:
    """Dimensionless parameters of a candidate at some values; None where they are out of its reach."""
    theta = []
    for parameter in candidate.effect.parameters:
        if parameter.name not in values:
            return None
        ratio = values[parameter.name] / candidate.site.scales[parameter.name]
        if parameter.kind == "shape":
            if not ratio > 0.0 or abs(math.log(ratio)) > _LARGEST_LOG:
                return None
            ratio = math.log(ratio)
        theta.append(ratio)
    return np.array(theta)
