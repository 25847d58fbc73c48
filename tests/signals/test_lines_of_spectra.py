"""Frequency and amplitude of the strongest line, wherever it lies between the lines of the spectrum."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_signals.spectral_lines import common_line, line_amplitude, piece_spectra, strongest_line

RATE = 1000.0
TIME = np.arange(4000) / RATE


@pytest.mark.parametrize("between", [0.0, 0.3, 0.5])
def test_frequency_and_amplitude_do_not_depend_on_the_place_between_lines(between: float) -> None:
    frequency = (200 + between) * RATE / TIME.size
    values = 3.0 + 0.7 * np.cos(2.0 * np.pi * frequency * TIME + 1.0) + 0.1 * np.cos(2.0 * np.pi * 123.0 * TIME)
    found = line_amplitude(values, RATE)
    assert found is not None
    assert found[0] == pytest.approx(frequency, abs=0.51 * RATE / TIME.size)
    assert found[1] == pytest.approx(0.7, rel=2e-3)
    assert strongest_line(values, RATE) == pytest.approx(frequency, abs=0.02 * RATE / TIME.size + 0.05 * between)
    assert common_line([values, 0.01 * values], RATE) == pytest.approx(frequency, abs=0.02 * RATE / TIME.size)


def test_channels_agree_on_the_line_that_they_share() -> None:
    shared = np.cos(2.0 * np.pi * 40.0 * TIME)
    one = shared + 1.1 * np.cos(2.0 * np.pi * 90.0 * TIME)
    other = shared + 1.1 * np.cos(2.0 * np.pi * 170.0 * TIME)
    assert common_line([one, other], RATE) == pytest.approx(40.0, abs=0.01)
    assert common_line([np.zeros(400), np.zeros(400)], RATE) == 0.0


def test_pieces_that_are_too_short_or_have_gaps_have_no_spectra() -> None:
    assert piece_spectra([TIME[:100]], RATE, 10) is None
    assert piece_spectra([np.where(TIME == 0.5, np.nan, TIME)], RATE, 2) is None
    found = piece_spectra([TIME, np.sin(TIME)], RATE, 4)
    assert found is not None
    lines, spectra = found
    assert lines[0] == pytest.approx(1.0)
    assert [spectrum.shape for spectrum in spectra] == [(4, lines.size)] * 2
