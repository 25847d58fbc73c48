"""Half-cosine ramp."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmt_core.numerics.ramp import half_cosine


def test_ends_middle_and_quarter():
    np.testing.assert_allclose(
        half_cosine(np.array([0.0, 0.25, 0.5, 0.75, 1.0])),
        [0.0, 0.5 - np.sqrt(2) / 4, 0.5, 0.5 + np.sqrt(2) / 4, 1.0],
        atol=1e-15,
    )


def test_slope_is_zero_at_both_ends_and_steepest_in_the_middle():
    step = 1e-4
    fraction = np.arange(0.0, 1.0 + step / 2, step)
    slope = np.diff(half_cosine(fraction)) / step
    assert abs(slope[0]) < 1e-3
    assert abs(slope[-1]) < 1e-3
    assert slope.max() == pytest.approx(np.pi / 2, rel=1e-6)


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_rises_and_stays_within_its_ends(a, b):
    low, high = half_cosine(np.array(sorted((a, b))))
    assert 0.0 <= low <= high <= 1.0


@given(st.floats(0.0, 1.0))
def test_is_point_symmetric_about_its_middle(fraction):
    there, back = half_cosine(np.array([fraction, 1.0 - fraction]))
    assert there + back == pytest.approx(1.0, abs=1e-12)


def test_keeps_the_shape():
    assert half_cosine(np.zeros((2, 3))).shape == (2, 3)
