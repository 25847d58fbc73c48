"""Effects of a size that every measuring chain has are not stated."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nmt_diagnose.effects.library import library
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.ledger import size
from nmt_diagnose.ledger.comparison import Hypotheses
from nmt_diagnose.ledger.row import Facts
from nmt_diagnose.ledger.size import needed
from nmt_diagnose.search.search import Search


def test_a_pick_up_within_its_tolerance_is_no_effect() -> None:
    effects = {effect.name: effect for effect in library()}
    transverse, cubic = effects["transverse_sensitivity"], effects["cubic_stiffness"]

    def small(share: float, tolerances: list[bool], *members: Any) -> list[int]:
        values = {"transverse_sensitivity": {"s": share}, "cubic_stiffness": {"k": 1.0}}
        fit: Any = SimpleNamespace(
            theta=None, parametrisation=SimpleNamespace(values=lambda _, k: values[members[k].name])
        )
        added: Any = tuple(SimpleNamespace(effect=effect, cause=effect.name) for effect in members)
        data: Any = SimpleNamespace(tolerances=np.array(tolerances, dtype=bool))
        return sorted(needed(data, FittedExplanation(added, fit), [], {}).small)

    ordinary, large = 0.0145, 0.0155
    assert small(ordinary, [True], cubic, transverse) == [1]
    assert small(-ordinary, [True], cubic, transverse) == [1]
    assert small(ordinary, [True], transverse) == [0]
    assert small(large, [True], cubic, transverse) == []
    assert small(ordinary, [False], cubic, transverse) == []  # the bench's own sensors have no tolerances


def test_an_effect_that_is_small_in_the_leading_explanation_is_in_every_other() -> None:
    """Two pick-ups lead that say no more than the model alone; a gain that needs them, too, gets both."""
    library_of = [
        SimpleNamespace(cause=name, effect=SimpleNamespace(name=name)) for name in ("pick 1", "pick 2", "gain")
    ]
    parametrisation = SimpleNamespace(calibration=(), index_of=lambda k: slice(k, k + 1))

    def explanation(evidence: float, small: set[int], *members: int) -> FittedExplanation:
        fit: Any = SimpleNamespace(
            theta=np.arange(3.0), parametrisation=parametrisation, log_evidence=evidence, promised=0.0
        )
        added: Any = tuple(library_of[k] for k in members)
        return FittedExplanation(added, fit, frozenset(small))

    leading, other, weak = explanation(100.0, {0, 1}, 0, 1), explanation(90.0, {0}, 0, 2), explanation(70.0, {0}, 0)
    hypotheses = Hypotheses(None, weak, [other, weak, leading], [], [], [])  # type: ignore[arg-type]
    hypotheses.prior = lambda found: 0.0  # type: ignore[method-assign]
    hypotheses._evidence = lambda found: found.fit.log_evidence  # type: ignore[method-assign]
    assert hypotheses.best is other
    assert hypotheses.leading is leading

    search: Any = Search.__new__(Search)
    search.candidates, search.refit = tuple(library_of), lambda found: found

    def with_added(base: FittedExplanation, score: Any, **_: Any) -> FittedExplanation:
        return FittedExplanation((*base.candidates, search.candidates[score.candidate]), base.fit)

    search.with_added = with_added
    (more,) = search.with_small_effects(leading, [leading, other, weak])
    assert [candidate.effect.name for candidate in more.candidates] == ["pick 1", "gain", "pick 2"]


@pytest.mark.parametrize(("change", "small"), [(0.7, [0, 1]), (1.4, [1])])
def test_an_effect_that_is_not_needed_lends_the_other_nothing(change: float, small: list[int]) -> None:
    """Two masses against each other move more than one of them, whose change alone decides."""
    masses = [SimpleNamespace(cause=name, effect=SimpleNamespace(ordinary=0.0)) for name in ("mass 10", "mass 11")]

    def explanation(*members: int) -> FittedExplanation:
        fit: Any = SimpleNamespace(log_evidence=float(len(members)))
        return FittedExplanation(tuple(masses[k] for k in members), fit)  # type: ignore[misc]

    null, one, two = explanation(), explanation(0), explanation(0, 1)
    facts = {
        (2, 0): Facts(left_without=4.6, change=3.4), (2, 1): Facts(left_without=0.0),
        (1, 0): Facts(left_without=3.8, change=change),
    }  # fmt: skip
    data: Any = SimpleNamespace(tolerances=np.zeros(1, dtype=bool))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            size, "compared_with_simpler",
            lambda data, more, less, *_: facts[len(more.candidates), len(less.candidates)],
        )  # fmt: skip
        found = needed(data, two, [null, one, two], {})
    assert sorted(found.small) == small
    assert found.comparisons[0].change == change
