from __future__ import annotations

import math

import pytest
from scipy.special import stdtrit

from nmt_extract.judgement.student import two_sided_quantile


@pytest.mark.parametrize("coverage", [0.5, 0.6827, 0.95, 0.99])
@pytest.mark.parametrize("degrees", [1.0, 1.3, 2.0, 4.7, 9.0, 19.0, 63.2, 999.0, 1001.0, 1e4, 1e9])
def test_equals_scipy(degrees, coverage):
    witness = stdtrit(degrees, 0.5 * (1.0 + coverage))
    assert two_sided_quantile(degrees, coverage) == pytest.approx(witness, rel=1e-10)


def test_infinite_degrees_give_the_normal_distribution():
    assert two_sided_quantile(math.inf, 0.95) == pytest.approx(1.959963984540054, rel=1e-14)


@pytest.mark.parametrize(("degrees", "coverage"), [(0.5, 0.95), (math.nan, 0.95), (9.0, 1.0), (9.0, 0.0)])
def test_out_of_range_is_refused(degrees, coverage):
    with pytest.raises(ValueError, match="no quantile"):
        two_sided_quantile(degrees, coverage)
