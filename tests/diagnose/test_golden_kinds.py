"""One measurement of every kind: what a diagnosis makes of it stays what it was."""

from __future__ import annotations

import json

import numpy as np
import pytest
from diagnose.golden_kinds import FILE, golden
from diagnose.one_of_each_kind import KINDS


@pytest.mark.parametrize("kind", KINDS)
def test_predictions_columns_floors_and_ranges_stay(kind: str) -> None:
    """Other processors round otherwise, so numbers are compared and not their last bits."""
    found = golden(kind)
    with np.load(FILE) as kept:
        names = {name.removeprefix(f"{kind}: ") for name in kept.files if name.startswith(f"{kind}: ")}
        assert names == set(found)
        for name in sorted(names - {"texts"}):
            expected = kept[f"{kind}: {name}"]
            size = float(np.abs(np.nan_to_num(expected)).max(initial=0.0))
            # Derivatives are differences over 1e-6: the last bits of predictions are 1e-5 of them.
            derived = 1e-5 if name in ("jacobian", "chain columns") else 1e-6
            np.testing.assert_allclose(found[name], expected, rtol=1e-5, atol=derived * size, err_msg=name)
        texts, expected = json.loads(str(found["texts"])), json.loads(str(kept[f"{kind}: texts"]))
    exact = [name for name in texts if not name.startswith(("range", "map", "shared"))]
    assert {name: texts[name] for name in exact} == {name: expected[name] for name in exact}
