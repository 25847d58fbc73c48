"""The peak of a response carries the unit of its channel, in sentences and in the table."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_bench.commands.sweep_command import COMPARISON_HEAD, comparison_lines, comparison_rows
from nmt_extract.curves.swept_response import FrequencyResponseTable
from nmt_extract.synthesis.single_mode import ResonanceError


@pytest.mark.parametrize(("channel", "unit"), [("a2", "m/s²"), ("x2", "m")])
def test_a_peak_has_the_unit_of_its_channel(channel: str, unit: str) -> None:
    frequency = np.array([20.0, 21.0])
    ones = np.ones(2)
    table = FrequencyResponseTable(0.5, "N", 0.0, frequency, ones, (channel,), ones[None] + 0j, ones[None], ones)
    error = ResonanceError(channel, 1.25, 20.5, 0.01, 0.001, 0.02, 0.015, (20.2, 20.8), 2)
    (line,) = comparison_lines([(table, error)], "synthesis")
    assert f"peak 1.25 {unit} at 20.500 Hz" in line
    (row,) = comparison_rows([(table, error)])
    assert row[[name for name, _ in COMPARISON_HEAD].index("Peak")].endswith(f" {unit}")
