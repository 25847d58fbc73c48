"""Many stretches of a recording at once are what each of them is alone, overlaps and stretches beyond it included."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import read_stretches
from nmt_session import Session, plan_test


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Bag:
    folder = tmp_path_factory.mktemp("stretches")
    with Session(plan_test("joint_resonator", [0.3], window_periods=20), folder, extract=False) as session:
        session.run()
    return Bag.open(folder)


def test_stretches_together_are_those_alone(bag: Bag) -> None:
    rng = np.random.default_rng(8)
    last = max(block.end_sample for block in bag.blocks("force"))
    spans = [(int(first), int(size)) for first, size in rng.integers((0, 1), (last, 3000), (25, 2))]
    spans += [(0, last), (last - 7, 100), (last, 5), (last + 1000, 10), (199, 1), (200, 1), (100, 0)]
    found = 0
    for span, together in zip(spans, read_stretches(bag, spans), strict=True):
        (alone,) = read_stretches(bag, [span])
        assert (alone is None) == (together is None) == (span[0] >= last or span[1] == 0)
        if alone is None or together is None:
            continue
        found += 1
        assert list(alone.channels) == list(together.channels)
        for name, samples in alone.channels.items():
            assert np.array_equal(samples, together.channels[name], equal_nan=True)
        assert alone.gaps == together.gaps
        assert alone.cycles_before == together.cycles_before
    assert found == 29
