"""The multisine on top of a drive."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_pll.phase_loop.multisine import Multisine


def test_over_its_window_it_has_its_rms_no_mean_and_eight_lines():
    sine = Multisine(0.02, 100, 4096)
    size, pace = np.array([sine.factors(100 + k) for k in range(4096)]).T - 1.0
    for course, rms in ((size, 0.02), (pace, 0.001)):
        assert np.sqrt(np.mean(course**2)) == pytest.approx(rms, rel=1e-9)
        lines = np.abs(np.fft.rfft(course)) / 4096
        assert np.count_nonzero(lines > 1e-3 * rms) == 8
        assert np.abs(course).max() < 2.5 * rms  # a sum of eight cosines in phase would have 4


def test_outside_its_window_and_without_a_share_it_changes_nothing():
    assert Multisine().factors(5) == (1.0, 1.0)
    sine = Multisine(0.02, 100, 50)
    assert sine.factors(99) == sine.factors(150) == (1.0, 1.0)
    assert sine.factors(100) != (1.0, 1.0)
