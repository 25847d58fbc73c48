"""Kind of test and frequencies on their way from the plan to the levels."""

from __future__ import annotations

from dataclasses import fields

import pytest
from sequencer.bench import Bench, Fate

from nmt_core.errors import BenchError
from nmt_core.kinds import SweepTest
from nmt_core.vocabulary import ResultCode
from nmt_sequencer.level_plan import RunPlan

SWEEP = SweepTest(rate_hz_s=0.2, frequency_end_hz=390.0)


def test_every_order_says_what_kind_of_test_it_belongs_to():
    bench = Bench([Fate(), Fate()])
    bench.start(RunPlan("run", (14.65, 38.15), control=3, kind=SWEEP, frequencies_hz=(350.0, 360.0)))
    bench.run()
    assert bench.machine.code == ResultCode.SUCCEEDED
    # Two levels, and the one that ends the excitation.
    assert [(order.amplitude, order.frequency_hz) for order in bench.orders] == [
        (14.65, 350.0),
        (38.15, 360.0),
        (0.0, 0.0),
    ]
    names = [item.name for item in fields(SWEEP)]
    assert all(getattr(order, name) == getattr(SWEEP, name) for order in bench.orders for name in names)


def test_plans_beyond_the_sample_rate_are_refused():
    plan = RunPlan("run", (1.0,), kind=SWEEP, frequencies_hz=(350.0,))
    plan.check(1000.0)
    with pytest.raises(BenchError, match="half the sample rate, 350 Hz"):
        plan.check(700.0)
