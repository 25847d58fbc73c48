"""Predictions that have to have some solutions, and can do without others."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.test_stepped_sine import CUBIC, first_order, observations_of, oscillator, swept
from diagnose.twin_tests import chain, level, locked, rows_of

from nmt_diagnose.twin.demand import UnsolvedError
from nmt_diagnose.twin.forward import Forward
from nmt_diagnose.twin.twin_settings import TwinSettings
from nmt_rig.rig import Rig

SETTINGS = TwinSettings(harmonics=5)


def stiff() -> Rig:
    """The chain with its resonance far above where it was measured."""
    rig = chain()
    springs = [200.0 * k for k in rig.structure.ground_springs_n_m]
    return rig.model_copy(update={"structure": rig.structure.model_copy(update={"ground_springs_n_m": springs})})


def levels_of_the_chain() -> tuple[Forward, np.ndarray]:
    """Three levels, and which level each row belongs to."""
    test, table = locked(chain(), [level(volts, 22.0) for volts in (0.1, 1.0, 4.0)], "x1")
    rows = rows_of(table)
    return Forward([test], rows, SETTINGS), rows.level


def lines_of_the_oscillator() -> tuple[Forward, np.ndarray]:
    """Five lines at one force."""
    hz = np.linspace(46.0, 49.0, 5)
    own = observations_of([swept(hz, 1.0, np.array([first_order(f, 1.0)[0] for f in hz]))])
    return Forward(own.tests, own.rows), own.rows.level


@pytest.mark.parametrize(("problem", "rig"), [
    (levels_of_the_chain, chain()), (lines_of_the_oscillator, oscillator(CUBIC)),
])  # fmt: skip
def test_what_nobody_asks_for_is_left_and_the_rest_stays(problem, rig) -> None:
    forward, level_of = problem()
    whole = forward.predict(rig)
    left = level_of == 1
    part = forward.predict(rig, whole, left=left)
    assert np.all(np.isnan(part.values[left]))
    assert np.allclose(part.values[~left], whole.values[~left], rtol=1e-7, atol=1e-9)
    # Its solution is kept to start from: asked for again it is what it was.
    again = forward.predict(rig, part)
    assert np.allclose(again.values, whole.values, rtol=1e-7, atol=1e-9)


def test_a_level_is_solved_where_one_of_its_rows_is_asked_for() -> None:
    forward, level_of = levels_of_the_chain()
    whole = forward.predict(chain())
    left = level_of == 1
    left[np.flatnonzero(left)[0]] = False
    part = forward.predict(chain(), whole, left=left)
    assert np.isfinite(part.values[~left]).all()
    assert np.isnan(part.values[left]).all()


def test_a_needed_level_without_solution_ends_the_prediction() -> None:
    forward, level_of = levels_of_the_chain()
    whole = forward.predict(chain())
    without = forward.predict(stiff(), whole)
    assert not np.any(np.isfinite(without.values[level_of == 2]))
    with pytest.raises(UnsolvedError):
        forward.predict(stiff(), whole, needed=level_of == 2)
    # What had no solution before either is not needed.
    forward.predict(stiff(), without, needed=level_of == 2)


def test_a_needed_line_without_solution_ends_the_prediction() -> None:
    # Newton's method has no step left to get there.
    forward, level_of = lines_of_the_oscillator()
    whole = forward.predict(oscillator(CUBIC))
    far = Forward(forward.tests, forward.rows, TwinSettings(iterations=1))
    with pytest.raises(UnsolvedError):
        far.predict(oscillator(50.0 * CUBIC), whole, needed=level_of == 2)
    assert np.all(np.isnan(far.predict(oscillator(50.0 * CUBIC), whole).values))
