"""The table of units against an independent list: CODATA and the definitions as scipy has them."""

from __future__ import annotations

import math

import pytest
from scipy import constants

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_record.exchange.unit_table import factor_to_si, other_factor, plain_unit, quantity_of_unit, unit_in_name

_PREFIXES = {
    "M": constants.mega, "k": constants.kilo, "": 1.0, "c": constants.centi, "m": constants.milli,
    "u": constants.micro, "n": constants.nano, "p": constants.pico,
}  # fmt: skip


def _multiples(unit: str, prefixes: str) -> dict[str, float]:
    return {unit: 1.0, **{prefix + unit: _PREFIXES[prefix] for prefix in prefixes}}


CHANNELS = {
    Quantity.FORCE: {
        **_multiples("N", "Mkmu"), "daN": constants.deka, "dyn": constants.dyn, "kgf": constants.kgf,
        "kp": constants.kgf, "gf": constants.gram * constants.g, "lbf": constants.lbf,
        "ozf": constants.oz * constants.g, "N*m": 1.0, "mN*m": constants.milli,
    },
    Quantity.ACCELERATION: {
        **_multiples("m/s^2", "kcmu"), "Gal": constants.centi, "g": constants.g, "mg": constants.milli * constants.g,
        "ug": constants.micro * constants.g, "in/s^2": constants.inch, "ft/s^2": constants.foot,
        "rad/s^2": 1.0, "deg/s^2": constants.degree,
    },
    Quantity.VELOCITY: {
        **_multiples("m/s", "cmun"), "km/h": constants.kmh, "in/s": constants.inch, "ft/s": constants.foot,
        "deg/s": constants.degree,
    },
    Quantity.DISPLACEMENT: {
        **_multiples("m", "cmunp"), "in": constants.inch, "mil": constants.mil, "ft": constants.foot,
        "rad": 1.0, "mrad": constants.milli, "deg": constants.degree, "m/m": 1.0, "um/m": constants.micro,
        "strain": 1.0, "ustrain": constants.micro, "mm/m": constants.milli, "urad": constants.micro,
    },
    Quantity.VOLTAGE: _multiples("V", "kmu"),
    Quantity.CURRENT: _multiples("A", "kmu"),
}  # fmt: skip
OTHERS = {
    "frequency": {**_multiples("Hz", "km"), "rad/s": 1.0 / (2.0 * math.pi), "rpm": 1.0 / constants.minute},
    "ratio": {"1": 1.0, "%": constants.centi},
    "phase": {"rad": 1.0, "deg": constants.degree, "cycles": 2.0 * math.pi},
    "time": {**_multiples("s", "mun"), "min": constants.minute, "h": constants.hour, "d": constants.day},
    "modal amplitude": _multiples("m*sqrt(kg)", "mu"),
}


def _listed(text: str, after: str, before: str) -> set[str]:
    return set(text.split(after)[1].split(before)[0].split(", "))


@pytest.mark.parametrize("quantity", CHANNELS, ids=lambda quantity: quantity.name.lower())
def test_every_unit_of_a_channel_has_its_factor(quantity: Quantity) -> None:
    found = {unit: factor_to_si(quantity, unit, "it") for unit in CHANNELS[quantity]}
    assert found == pytest.approx(CHANNELS[quantity], rel=1e-12)
    with pytest.raises(BenchError) as refused:
        factor_to_si(quantity, "", "it")
    # The list that a refusal shows is the whole table: none of it is left unchecked.
    assert _listed(str(refused.value), "has (", ").") == set(CHANNELS[quantity])


@pytest.mark.parametrize("kind", OTHERS)
def test_every_other_unit_has_its_factor(kind: str) -> None:
    found = {unit: other_factor(kind, unit, "it") for unit in OTHERS[kind]}
    assert found == pytest.approx(OTHERS[kind], rel=1e-12)
    with pytest.raises(BenchError) as refused:
        other_factor(kind, "furlong", "it")
    assert str(refused.value).split("; use ")[1].rstrip(".").split(", ") == list(OTHERS[kind])


@pytest.mark.parametrize(
    ("column", "bare", "unit", "clock_unit"),
    [
        ("acc_m_s2", "acc", "m/s^2", ""),
        ("acc1 mps2", "acc1", "m/s^2", ""),
        ("v_mms", "v", "mm/s", ""),
        ("v_mm_s", "v", "mm/s", "s"),
        ("v_m_s", "v", "m/s", "s"),
        ("force_kN", "force", "kN", ""),
        ("u_mV", "u", "mV", ""),
        ("x_um", "x", "um", ""),
        ("angle_deg", "angle", "deg", ""),
        ("time_ms", "time_ms", "", "ms"),  # not m/s
        ("time_usec", "time_usec", "", "us"),
        ("time µs", "time µs", "", "us"),
        ("elapsed min", "elapsed min", "", "min"),
        ("swing", "swing", "", ""),
    ],
)
def test_a_name_ends_with_a_unit_of_the_table(column: str, bare: str, unit: str, clock_unit: str) -> None:
    assert unit_in_name(column) == (bare, unit)
    assert unit_in_name(column, time=True)[1] == clock_unit
    if unit:
        assert plain_unit(unit) == unit
        quantity = quantity_of_unit(unit)
        assert factor_to_si(quantity, unit, column) == CHANNELS[quantity][unit]


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns", "min"])
def test_a_clocks_units_written_out_are_in_the_table(unit: str) -> None:
    words = {"s": "Seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds", "min": "minutes"}
    assert plain_unit(words[unit]) == unit
    assert other_factor("time", words[unit], "it") == OTHERS["time"][unit]
