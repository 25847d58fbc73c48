from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmt_record.bag.gap_counter import GapCounter


@given(st.lists(st.booleans(), min_size=1, max_size=40), st.integers(0, 1000))
def test_missing_samples_are_those_of_the_dropped_blocks(kept, start):
    """Witness: the set of samples between first and last that no block carried."""
    counter, carried = GapCounter(), set()
    for index, keep in enumerate(kept):
        first = start + 20 * index
        if keep:
            counter.add("force", first, 20, 1000.0)
            carried |= set(range(first, first + 20))
    expected = max(carried) - min(carried) + 1 - len(carried) if carried else 0
    assert counter.missing_samples == expected
    runs = "".join("x" if keep else "." for keep in kept).strip(".").split("x")
    assert counter.gaps == sum(1 for run in runs if run)


def test_repeats_and_ends():
    counter = GapCounter()
    assert counter.reached(10)  # no topic, nothing to wait for
    counter.add("force", 0, 20, 1000.0)
    counter.add("voltage", 0, 10, 1000.0)
    assert counter.reached(9)
    assert not counter.reached(10)
    assert counter.add("voltage", 5, 20, 1000.0) == 0
    assert counter.topics["voltage"].repeats == 1
    assert counter.gaps == 0
    assert counter.reached(19)
    assert counter.bench_time() == 0.025
    assert counter.add("force", 30, 20, 1000.0) == 10
    assert counter.as_dict()["force"] == {
        "first_sample": 0,
        "end_sample": 50,
        "blocks": 2,
        "gaps": 1,
        "missing_samples": 10,
        "repeats": 0,
    }


def test_what_a_recording_lacks_is_counted_in_seconds_of_bench_time() -> None:
    counter = GapCounter()
    assert (counter.recorded, counter.lacking(99)) == (0, 0.0)
    for first in (0, 100, 300):
        counter.add("force", first, 100, 1000.0)
    for first in (0, 100, 200):
        counter.add("voltage", first, 100, 1000.0)
    assert counter.recorded == 300
    assert counter.lacking() == pytest.approx(0.1)  # the gap of the force
    assert counter.lacking(399) == pytest.approx(0.1)
    assert counter.lacking(999) == pytest.approx(0.7)  # the gap and 600 samples at the end, or 700 there
