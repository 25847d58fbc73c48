"""What a diagnosis warns of."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from nmt_diagnose.effects.effect import Candidate, Site
from nmt_diagnose.effects.library import effect_named
from nmt_diagnose.effects.location import Location
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.ledger.diagnosis import Gap, Recalibrated, Verdict
from nmt_diagnose.ledger.warnings import warned, without_observables
from nmt_diagnose.observations.origin import Origin

CUBIC = Candidate(effect_named("cubic_stiffness"), Site(Location.at("structure", 2), {"k": 1.0}, 2))
GAP = Gap(20.0, 1.1, 1.0, 30.0, 0.99, 0.98, 1.0, {"run: frequency": {"after": 1.1}}, ("every second level",))
MASS = Recalibrated("structure.masses_kg.0", 0.5, 0.52, 1e-3, "kg", 0.01, 4.0)


def best(theta: float = 0.0, promised: float = 0.5, candidates: tuple[Candidate, ...] = (CUBIC,)) -> FittedExplanation:
    """A fit of a model with one parameter of its own and an effect."""
    own = SimpleNamespace(
        values=lambda values, _: {p: float(values[1]) for p in ("k", "c2")}, base=SimpleNamespace(coordinate="length")
    )
    fit = SimpleNamespace(theta=np.array([theta, 1.0]), promised=promised, parametrisation=own)
    return FittedExplanation(candidates, fit)  # type: ignore[arg-type]


def test_nothing_to_mind_is_not_mentioned() -> None:
    assert warned(Verdict.EFFECT, best(2.9), (MASS,), GAP) == ()
    assert warned(Verdict.NONE, best(4.0), (MASS,), GAP) == ()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_parameter_that_nobody_would_believe(sign: float) -> None:
    (sentence,) = warned(Verdict.EFFECT, best(4.0 * sign), (MASS,), GAP)
    assert "structure.masses_kg.0 from 0.5 to 0.52 kg (4.0 standard deviations)" in sentence


def test_a_fit_that_stopped_early() -> None:
    (sentence,) = warned(Verdict.EFFECT, best(promised=4.0), (MASS,), GAP)
    assert sentence.startswith("The fit with cubic_stiffness@2 stopped before its optimum, some 2.0 standard")
    alone = best(promised=4.0, candidates=())
    assert warned(Verdict.CALIBRATION, alone, (MASS,), GAP)[0].startswith("The re-fit of the model stopped")


def test_an_explanation_that_is_not_the_whole() -> None:
    left = replace(
        GAP, closed=0.8, after=4.0, per_observable={"run: frequency": {"after": 2.0}, "run: phase": {"after": 6.0}}
    )
    (sentence,) = warned(Verdict.EFFECT, best(), (MASS,), left)
    assert sentence.startswith("4.0 standard deviations (rms) are left on held-out data, most of it in run: phase")
    assert warned(Verdict.UNKNOWN, best(), (MASS,), left) == ()
    # A remainder of some percent is told with the verdict.
    assert warned(Verdict.EFFECT, best(), (MASS,), replace(left, closed=0.94)) == ()
    assert warned(Verdict.EFFECT, best(), (MASS,), replace(left, after=math.nan)) == ()


def test_drag_that_no_air_has_is_told_beside_what_looks_alike() -> None:
    drag = Candidate(effect_named("air_drag"), Site(Location.at("structure", 1), {"c2": 1.0}, 1, limits={"c2": 0.02}))
    found = best(candidates=(drag,))
    (sentence,) = warned(Verdict.EFFECT, best(), (MASS,), GAP, (best(), found))
    assert sentence.startswith("As air_drag@1 the gap would take c2 = ")
    assert "50 times the largest that physics allows" in sentence
    assert warned(Verdict.UNKNOWN, best(), (MASS,), GAP, (best(), found)) == ()
    within = best(candidates=(replace(drag, site=replace(drag.site, limits={"c2": 10.0})),))
    assert warned(Verdict.EFFECT, best(), (MASS,), GAP, (best(), within)) == ()


def test_a_recording_of_which_nothing_can_be_compared() -> None:
    tests = tuple(SimpleNamespace(name=name) for name in ("backbone/decay", "random"))
    bags = (("runs/backbone", "1"), ("runs/random", "2"), ("runs/unlocked", "3"))
    origins = tuple(Origin("simulated", tests=names) for names in (("backbone/decay",), ("random",), ()))
    rows = SimpleNamespace(test=np.array([0, 0, 1]))
    found = SimpleNamespace(tests=tests, rows=rows, inputs=bags, origins=origins)
    (sentence,) = without_observables(found)  # type: ignore[arg-type]
    assert sentence.startswith("Nothing of runs/unlocked could be compared")
    found.rows = SimpleNamespace(test=np.array([1, 1]))
    assert "runs/backbone and runs/unlocked" in without_observables(found)[0]  # type: ignore[arg-type]
    found.origins, found.inputs = (origins[1], Origin("simulated", tests=("floor",))), bags[1:]
    assert without_observables(found) == ()  # type: ignore[arg-type]
