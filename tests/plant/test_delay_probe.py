"""The delay that a probe finds is that of the line, whatever its length, noise and filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal
from tiers import with_quick

from nmt_plant.converters.delay_probe import DelayProbe

RATE = 10_000.0


def probed(respond, chunk=100, lose=()):
    probe = DelayProbe(0.25, RATE, settling=0.05)
    turn = 0
    while not (probe.done or probe.failed):
        put_out = probe.next(chunk)
        probe.take(respond(put_out), turn in lose)
        turn += 1
    return probe


class Line:
    """A delay with noise, gain and an anti-alias filter; block by block."""

    def __init__(self, delay, noise=0.0, gain=1.0, sections=None):
        self._line = np.zeros(delay)
        self._noise, self._gain = noise, gain
        self._random = np.random.default_rng(3)
        self._sections = sections
        self._state = None if sections is None else np.zeros((sections.shape[0], 2))

    def __call__(self, values):
        line = np.concatenate([self._line, values])
        out, self._line = line[: values.size], line[values.size :]
        if self._sections is not None:
            out, self._state = signal.sosfilt(self._sections, out, zi=self._state)
        return self._gain * out + self._noise * self._random.standard_normal(values.size)


def test_twenty_random_delays_are_found_to_the_sample():
    for delay in np.random.default_rng(13).integers(0, 3900, 20):
        found = probed(Line(int(delay), noise=0.1, gain=-0.7)).delay()
        assert abs(found.samples - delay) <= 1
        assert found.is_clear
        assert found.gain == pytest.approx(-0.7, abs=0.05)


def test_a_filter_on_the_way_adds_its_own_delay_only():
    sections = signal.butter(4, 0.8, output="sos")
    found = probed(Line(500, sections=sections)).delay()
    assert 500 <= found.samples <= 503
    assert found.is_clear


def test_a_line_that_is_cut_is_not_clear():
    assert not probed(Line(0, noise=0.1, gain=0.0)).delay().is_clear
    assert not probed(Line(0, gain=0.0)).delay().is_clear


@pytest.mark.parametrize("ppm", with_quick([50.0, -50.0, 150.0], 150.0))
def test_a_delay_that_drifts_with_the_clocks_is_clear(ppm):
    """At 48 kHz both runs lie 20,223 samples apart: 50 ppm move the delay by 1.01 samples, which rounds to 1 or 2."""
    spreads = set()
    for phase in np.arange(0.0, 1.0, 0.02):
        probe, position, line = DelayProbe(0.25, 48_000.0, settling=0.01), 0, np.zeros(20)
        while not probe.done:
            put_out = probe.next(4800)
            line = np.concatenate([line[-20:], put_out])
            index = np.arange(4800)
            late = 8.0 + phase + 1e-6 * ppm * (position + index)
            probe.take(np.interp(20.0 + index - late, np.arange(line.size), line), False)
            position += 4800
        found = probe.delay()
        spreads.add(abs(found.spread))
        assert found.is_clear
        assert found.spread == pytest.approx(1e-6 * ppm * found.apart, abs=1.0)
    assert max(spreads) >= 2


def test_a_turn_that_was_lost_unseen_is_not_clear():
    """Between both runs a turn of what was measured is missing and nobody said so: the second run comes earlier."""
    probe, line = DelayProbe(0.25, RATE, settling=0.05), Line(500)
    for turn in range(200):
        answer = line(probe.next(100))
        if turn != 30:
            probe.take(answer, False)
    found = probe.delay()
    assert found.spread == -100
    assert found.is_seen
    assert not found.is_clear


def test_lost_samples_start_it_again_and_too_many_end_it():
    assert probed(Line(77), lose={30, 60}).delay().samples == 77
    assert probed(Line(77), lose=set(range(0, 5000, 20))).failed
