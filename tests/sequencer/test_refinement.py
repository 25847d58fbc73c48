"""Levels put between those of a plan where the backbone bends."""

from __future__ import annotations

import itertools
import math

import pytest

from nmt_sequencer.refinement import MOST_PARTS, LevelRefinement


def walked(levels, frequency, tolerance: float, lost=lambda level: False) -> list[float]:
    """Levels that are done, in order, of a backbone given by its frequency at a level."""
    refinement, rest, done = LevelRefinement(tolerance, levels), list(levels), []
    while rest:
        level = rest.pop(0)
        assert len(done) < 500
        if lost(level):
            half = refinement.after_loss(level)
            if half is not None:
                rest[:0] = [half, level]
            continue
        done.append(level)
        refinement.add(level, frequency(level))
        between = refinement.before(rest[0]) if rest else None
        if between is not None:
            rest.insert(0, between)
    return done


LEVELS = [2.0**k for k in range(-4, 5)]


@pytest.mark.parametrize("levels", [LEVELS, LEVELS[::-1]], ids=["up", "down"])
def test_a_straight_backbone_gets_no_level_more(levels):
    assert walked(levels, lambda level: level**0.1, 1e-4) == levels


@pytest.mark.parametrize("levels", [LEVELS, LEVELS[::-1]], ids=["up", "down"])
def test_the_levels_crowd_where_the_backbone_bends_and_those_of_the_plan_are_kept(levels):
    def frequency(level: float) -> float:
        return 1.0 + 0.05 * math.tanh(4.0 * math.log(level))

    done = walked(levels, frequency, 1e-3)
    assert set(levels) < set(done)
    assert done == sorted(done, reverse=levels[0] > levels[-1])
    middle = [level for level in done if 0.5 < level < 2.0]
    ends = [level for level in done if level > 4.0]
    assert len(middle) > len(ends) + 2
    steps = [abs(math.log(b / a)) for a, b in itertools.pairwise(done)]
    assert min(steps) >= math.log(2.0) / MOST_PARTS * 0.5
    finer = walked(levels, frequency, 1e-4)
    assert len(finer) > len(done)


def test_a_lost_level_is_enclosed_and_given_up():
    done = walked(LEVELS, lambda level: 1.0, 1e-3, lost=lambda level: 1.3 < level < 1.9 or level == 2.0)
    below, above = max(level for level in done if level < 1.31), min(level for level in done if level > 1.89)
    assert below > 1.2
    assert above in LEVELS
    assert 2.0 not in done


def test_a_turn_of_the_direction_begins_anew():
    levels = [1.0, 2.0, 4.0, 8.0, 4.0, 2.0, 1.0]
    assert walked(levels, lambda level: level**0.1, 1e-4) == levels
