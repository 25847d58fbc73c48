from __future__ import annotations

import math

import pytest

from nmt_core.text.number_words import share_with_interval, significant, value_text


@pytest.mark.parametrize(
    ("share", "low", "high", "texts"),
    [
        (0.92, 0.89, 0.94, ("92 %", "89 to 94 %")),
        (0.9992, 0.9990, 0.9995, ("99.9 %", "99.9 to 100.0 %")),
        (0.99992, 0.99990, 0.99994, ("99.992 %", "99.990 to 99.994 %")),
        (1.0, 1.0, 1.0, ("100 %", "")),
        (-0.2, -0.4, 0.1, ("−20 %", "−40 to 10 %")),
        (0.5, math.nan, math.nan, ("50 %", "")),
    ],
)
def test_the_ends_of_an_interval_never_read_alike(share, low, high, texts):
    assert share_with_interval(share, low, high) == texts


def test_a_value_has_one_notation():
    assert value_text(2.1116e5, 1.0e4, "N/m") == "(211 ± 10)·10³ N/m"


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (10.2, 1, "10"),
        (-96.0, 1, "−100"),
        (2345.0, 2, "2300"),
        (23456.0, 2, "2.3·10⁴"),
        (9.1e-5, 2, "9.1·10⁻⁵"),
        (0.04, 1, "0.04"),
    ],
)
def test_small_whole_numbers_stand_in_full(value, digits, text):
    assert significant(value, digits) == text
