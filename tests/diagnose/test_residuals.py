import json

import numpy as np
import pytest
from scipy.stats import kstest

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.ledger.gap import closed
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import LockedLevel, Observations
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.say.residual_map import per_observable, residual_map
from nmt_diagnose.say.residual_tests import ResidualTest, holm, residual_tests

CHANNELS = (MeasuredChannel("f1", Quantity.FORCE, 1), MeasuredChannel("a1", Quantity.ACCELERATION, 1))


def run_observations(levels=10, harmonics=4, down=False):
    """A run with rows of every harmonic of two channels at every level."""
    table = []
    indices = range(2 * levels) if down else range(levels)
    for index in indices:
        drive = 1.0 + (index if index < levels else 2 * levels - 1 - index)
        table.append((index, -1, -1, Part.LOG_FREQUENCY, drive))
        for channel in range(2):
            for harmonic in range(1, harmonics + 1):
                parts = (Part.LOG_MAGNITUDE, Part.PHASE) if harmonic == 1 else (Part.REAL, Part.IMAG)
                table.extend((index, channel, harmonic, part, drive) for part in parts)
    level, channel, harmonic, part, drive = (np.array(column) for column in zip(*table, strict=True))
    m = level.size
    rows = Rows(
        np.zeros(m, int), level, channel, harmonic, part.astype(int), level * 1.0, np.full(m, 22.0), drive * 1.0
    )
    plan = tuple(
        LockedLevel(int(i), float(drive[level == i][0]), 0.0, 1e-3, 22.0, 0.0, 1.0, 0.0, 1 if i < levels else -1)
        for i in np.unique(level)
    )
    test = LockedWindows("run", (1,), "a1", CHANNELS, harmonics, "voltage", plan)
    return Observations((test,), rows, np.zeros(m), np.full(m, 0.01), np.zeros(m))


def _tests(observations, residual):
    return residual_tests(observations, residual, np.ones(len(observations.rows), dtype=bool))


def _named(tests, name, where=None):
    for test in tests:
        if test.name == name and where in (None, test.where):
            return test
    raise AssertionError(name)


def _p(observations, residual, name, where=None):
    return _named(_tests(observations, residual), name, where)


@pytest.mark.campaign
def test_white_residuals_give_uniform_p_values():
    observations = run_observations(down=True)
    generator = np.random.default_rng(6)
    drawn = [_tests(observations, generator.standard_normal(len(observations.rows))) for _ in range(300)]
    for name, where in (
        ("size of the residual", "run"),
        ("smooth course over the level", "a1"),
        ("even harmonics", "run"),
        ("differences between rising and falling level", "run"),
    ):
        values = [_named(tests, name, where).p for tests in drawn]
        assert kstest(values, "uniform").pvalue > 1e-3, name


def test_each_test_sees_its_own_structure_that_the_size_alone_does_not_show():
    observations = run_observations(down=True)
    rows = observations.rows
    generator = np.random.default_rng(7)
    noise = generator.standard_normal(len(rows))
    trend = noise + 1.3 * np.where((rows.channel == 1) & (rows.harmonic == 3), (rows.amplitude - 5.5) / 3.0, 0.0)
    assert _p(observations, trend, "smooth course over the level", "a1").p < 1e-4
    assert _p(observations, trend, "size of the residual").p > 1e-3
    hysteresis = noise + np.where((rows.level >= 10) & (rows.harmonic == 1), 2.5, 0.0)
    assert _p(observations, hysteresis, "differences between rising and falling level").p < 0.02
    even = noise * np.where(rows.harmonic == 2, 2.0, 1.0)
    assert _p(observations, even, "even harmonics").p < 1e-4
    assert _p(observations, even, "odd harmonics above the first").p > 1e-3


def test_holm_is_the_step_down_rule():
    tests = holm([ResidualTest(str(k), "", 0.0, 1, p) for k, p in enumerate((0.04, 0.01, 0.03))])
    assert [round(test.p_holm, 12) for test in tests] == [0.03, 0.06, 0.06]


def test_map_and_observables_carry_units():
    observations = run_observations()
    ones, twos = np.ones(len(observations.rows)), np.full(len(observations.rows), 2.0)
    groups = residual_map(observations, 3.0 * ones, twos, ones)
    assert sum(group.rows for group in groups) == len(observations.rows)
    assert {group.channel for group in groups} == {"f1", "a1", "frequency and phase"}
    assert all((group.as_given, group.before, group.after) == (3.0, 2.0, 1.0) for group in groups)
    table = per_observable(observations, [(twos, ones, np.ones(len(observations.rows), dtype=bool))])
    assert table["run: frequency"]["before_unit"] == pytest.approx(2.0)  # 2 σ of 1 %
    assert table["run: frequency"]["unit"] == "%"
    assert table["run: phase of f1"]["after_unit"] == pytest.approx(np.degrees(0.01))
    json.dumps(table)


def test_observables_of_held_out_rows_pool_to_the_residual_of_the_headline():
    observations = run_observations()
    generator = np.random.default_rng(8)
    rows = observations.rows
    pairs = [
        (4.0 * generator.standard_normal(len(rows)), generator.standard_normal(len(rows)), np.isin(rows.level, levels))
        for levels in ((1, 3, 5, 7), (6, 7))
    ]
    table = per_observable(observations, pairs).values()
    share = closed(observations, pairs)
    for key, headline in (("before", share.before), ("after", share.after)):
        squares = sum(item["rows"] * item[key] ** 2 for item in table)
        assert squares / sum(item["rows"] for item in table) == pytest.approx(headline**2)
    assert sum(item["values"] for item in table) == int(np.any([judged for *_, judged in pairs], axis=0).sum())
    # A row that two splits hold out counts in both, one that none does in neither.
    assert sum(item["rows"] for item in table) == sum(int(judged.sum()) for *_, judged in pairs)
