"""Continuation by the response amplitude as whole tests: levels put in, jumps named, up and down."""

from __future__ import annotations

import numpy as np
import pytest
from pll.internal_resonance import at_amplitude, folds
from tiers import with_quick

from nmt_core.vocabulary import PointStatus, SteeringAct
from nmt_extract.curves.backbone_jumps import direction_difference, find_jumps
from nmt_extract.offline import extract_bag
from nmt_session import Session, plan_test

PLAN = [0.7e-3, 1.0e-3, 1.4e-3, 2.1e-3, 2.4e-3, 2.8e-3]


def measured(factor: float, levels, tmp_path, refinement: float):
    """Modal points, steering acts and the bag of a run of the shipped rig at a damping of ``factor`` per cent."""
    acts = []
    plan = plan_test(
        "internal_resonance",
        levels,
        overrides=[f"structure.damping_factors=[{factor},{factor},{factor}]"],
        control="response",
        window_periods=12,
        refinement=refinement,
    )

    def listen(topic, record):
        if topic == "steering":
            acts.append(record)

    with Session(plan, tmp_path / "run", listener=listen) as session:
        points = session.run().points
    return points, acts, tmp_path / "run" / "bag"


@pytest.mark.campaign
def test_levels_are_put_in_where_the_backbone_bends_and_the_bag_knows_them(tmp_path):
    points, acts, bag = measured(0.5, PLAN, tmp_path, 5e-4)
    levels = [point.level for point in points]
    assert set(PLAN) < set(levels)
    assert levels == sorted(levels)
    assert len(acts) == len(levels) - len(PLAN)
    assert all(act.act is SteeringAct.CHANGE_LEVELS and act.source == "the step control" for act in acts)
    for point in points:
        (balance,) = at_amplitude(0.5, point.level)
        assert point.omega_rad_s == pytest.approx(balance.omega_b, rel=1e-3)
    assert find_jumps(points) == []
    again = extract_bag(bag).points
    assert all(one.identical(other) for one, other in zip(again, points, strict=True))


@pytest.mark.parametrize("factor", with_quick([1.0, 0.5], 0.5))
def test_without_a_fold_over_the_amplitude_up_and_down_are_the_same(factor, tmp_path):
    levels = [0.7e-3, 1.7e-3, 2.1e-3, 2.6e-3]
    points, _, _ = measured(factor, [*levels, *levels[-2::-1]], tmp_path, 0.0)
    difference = direction_difference(points)
    assert difference is not None
    assert difference.levels == len(levels) - 1
    assert difference.different == ()
    assert difference.largest < 3e-4


@pytest.mark.campaign
def test_the_jump_at_a_fold_over_the_amplitude_is_named(tmp_path):
    levels = [1.6e-3, 1.8e-3, 1.86e-3, 1.9e-3, 2.02e-3, 2.1e-3, 2.4e-3]
    points, _, _ = measured(0.2, levels, tmp_path, 0.0)
    assert all(point.status is PointStatus.OK for point in points)
    (jump,) = find_jumps(points)
    assert jump.before.level < max(folds(0.2)[1]) < jump.after.level
    assert jump.size == pytest.approx(0.0055, abs=0.002)
    frequencies = [point.frequency_hz for point in points]
    assert np.all(np.diff(frequencies) > 0.0)
