from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmt_report.quantity_format import (
    concise,
    duration,
    engineering_exponent,
    file_size,
    plain,
    power_of_ten,
    significant,
    uncertain,
)


@pytest.mark.parametrize(
    ("value", "std", "long", "short"),
    [
        (139.42, 0.0123, "139.420 ± 0.012", "139.420(12)"),
        (1.23456, 0.5, "1.23 ± 0.50", "1.23(50)"),
        (1234.5, 12.0, "1234 ± 12", "1234(12)"),
        (-1.5, 0.01, "−1.500 ± 0.010", "−1.500(10)"),
        (12.34, 1.5, "12.3 ± 1.5", "12.3(1.5)"),
        (1.5, math.nan, "1.5000", "1.5000"),
        (1.5, 0.0, "1.5000", "1.5000"),
        (1.5, 3e-9, "1.500000 ± 3·10⁻⁹", "1.500000(<1)"),
        (1.0, 9.7e-10, "1.000000 ± 1·10⁻⁹", "1.000000(<1)"),
        (math.nan, 0.1, "—", "—"),
    ],
)
def test_value_with_uncertainty(value: float, std: float, long: str, short: str) -> None:
    assert uncertain(value, std) == long
    assert concise(value, std) == short


@given(st.floats(-1e4, 1e4), st.floats(1e-5, 1e3))
def test_rounding_loses_less_than_the_uncertainty(value: float, std: float) -> None:
    shown, _, uncertainty = uncertain(value, std).partition(" ± ")
    assert abs(float(shown.replace("−", "-")) - value) <= 0.051 * std + 5e-7
    assert float(uncertainty) == pytest.approx(std, rel=0.06, abs=6e-7)


def test_engineering_exponent() -> None:
    assert engineering_exponent([3.6e-4, 1e-5]) == -6
    assert engineering_exponent([2.4e-3]) == -3
    assert engineering_exponent([1500.0]) == 3
    assert engineering_exponent([math.nan, 0.0]) == 0
    assert power_of_ten(-12) == "10⁻¹²"
    assert power_of_ten(0) == ""


def test_words() -> None:
    assert duration(12.34).replace("\u202f", " ") == "12.3 s"
    assert duration(245).replace("\u202f", " ") == "4 min 05 s"
    assert duration(3720).replace("\u202f", " ") == "1 h 02 min"
    assert duration(math.nan) == "—"
    assert file_size(999).replace("\u202f", " ") == "999 B"
    assert file_size(123_456_789).replace("\u202f", " ") == "123.5 MB"
    assert file_size(5_000_000_000).replace("\u202f", " ") == "5.00 GB"
    assert plain(-0.5, 2) == "−0.50"
    assert significant(1.23456e-4, 3) == "0.000123"
