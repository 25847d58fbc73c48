"""Noise of sweeps that is estimated from their scatter, on normal noise whose size is known."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.stats import f as fisher

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.measurements.stepped_reading import scatter_of_lines
from nmt_diagnose.measurements.stepped_responses import SteppedResponses
from nmt_diagnose.observations.noise.scatter import shrunk, with_shared_scatter
from nmt_diagnose.say.residual_tests import residual_tests
from nmt_diagnose.thresholds import THRESHOLDS

LINES = 60


def estimates(sizes: list[float], seed: int) -> np.ndarray:
    """Scatter found of sweeps whose lines are normal noise of given sizes about a smooth course."""
    generator = np.random.default_rng(seed)
    frequency = np.linspace(100.0, 110.0, LINES)
    found = []
    for size in sizes:
        noise = size * (generator.standard_normal(LINES) + 1j * generator.standard_normal(LINES))
        found.append(scatter_of_lines(frequency, np.exp(noise) * (2.0 + frequency / 50.0))[0])
    return np.array(found)


DEGREES = 2 * LINES / (2.0 * THRESHOLDS.noise.median_relative_std**2)


def test_a_scatter_is_as_uncertain_as_it_is_said_to_be() -> None:
    log = np.log(np.concatenate([estimates([0.003], seed) for seed in range(150)]))
    assert math.exp(log.mean()) == pytest.approx(0.003, rel=0.03)
    assert log.std() == pytest.approx(math.sqrt(0.5 / DEGREES), rel=0.15)


def test_sweeps_that_scatter_alike_are_known_by_all_of_them() -> None:
    alone, together, stated = [], [], []
    for seed in range(50):
        own = estimates([0.003] * 6, seed)
        shared, degrees = shrunk(own, np.full(6, DEGREES))
        alone += list(np.log(own / 0.003))
        together += list(np.log(shared / 0.003))
        stated.append(np.mean(0.5 / degrees))
    assert np.std(together) < 0.7 * np.std(alone)
    assert np.std(together) == pytest.approx(math.sqrt(np.mean(stated)), rel=0.25)


def test_sweeps_that_scatter_otherwise_keep_their_own() -> None:
    sizes = [0.03, 0.01, 0.003, 0.001]
    shared, degrees = shrunk(np.array(sizes), np.full(4, DEGREES))
    np.testing.assert_allclose(shared, sizes, rtol=0.05)
    np.testing.assert_allclose(degrees, DEGREES, rtol=0.1)


def sweeps(noise: list[float], degrees: list[float]) -> Observations:
    """Sweeps of one channel with two rows a line; the floor is 0.1 %."""
    rows = np.repeat(np.arange(len(noise)), 2 * LINES)
    tests = [
        SteppedResponses(
            name=f"sweep {number}",
            drive_point=1,
            channels=(MeasuredChannel("a1", Quantity.ACCELERATION, 1),),
            reference="force",
            held="force",
            lines_hz=np.linspace(100.0, 110.0, LINES),
            levels=np.ones(LINES),
            measured=np.ones((LINES, 1), dtype=complex),
            noise=np.full(LINES, math.hypot(size, 1e-3)),
            noise_degrees=free,
        )
        for number, (size, free) in enumerate(zip(noise, degrees, strict=True))
    ]
    empty = np.zeros(rows.size)
    table: Any = SimpleNamespace(
        test=rows,
        channel=empty.astype(int),
        part=np.tile([0, 1], rows.size // 2),
        level=np.tile(np.arange(LINES), 2 * len(noise)),
    )
    return Observations(tuple(tests), cast(Any, table), empty, np.repeat(noise, 2 * LINES), np.full(rows.size, 1e-3))


def test_stated_noise_stays_and_estimated_noise_is_shared() -> None:
    before = sweeps([0.002, 0.004, 0.0001], [DEGREES, DEGREES, math.inf])
    after = with_shared_scatter(before)
    first, second, stated = (after.std[after.rows.test == number] for number in range(3))
    assert 0.002 < first[0] < second[0] < 0.004
    assert np.ptp(first) == np.ptp(second) == 0.0
    np.testing.assert_array_equal(stated, 0.0001)
    for number, std in enumerate((first[0], second[0], 0.0001)):
        test = after.tests[number]
        assert isinstance(test, SteppedResponses)
        np.testing.assert_allclose(test.noise, math.hypot(std, 1e-3))
    (note,) = after.notes
    assert note.startswith("The scatter of the 2 sweeps of a1 is taken together: ")


def test_one_sweep_alone_stays_as_it_is() -> None:
    before = sweeps([0.002], [DEGREES])
    after = with_shared_scatter(before)
    np.testing.assert_array_equal(after.std, before.std)
    assert after.notes == ()


def test_a_residual_over_an_estimated_noise_is_less_surprising() -> None:
    for degrees in (math.inf, DEGREES):
        own = sweeps([0.002], [degrees])
        residual = np.full(2 * LINES, 1.4)
        residual[::2] *= -1.0
        size = next(t for t in residual_tests(own, residual, np.ones(2 * LINES, bool)) if t.name.startswith("size"))
        assert size.statistic == pytest.approx(1.96 * 2 * LINES)
        if math.isinf(degrees):
            assert size.p < 1e-8
        else:
            assert size.p == pytest.approx(float(fisher.sf(1.96, 2 * LINES, degrees)))
            assert size.p > 0.01
