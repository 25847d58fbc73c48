"""Effects of a size that every measuring chain has are not stated."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from nmt_diagnose.effects.library import library
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.ledger.size import needed


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
