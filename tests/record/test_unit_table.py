"""The table of units against an independent list: CODATA and the definitions as scipy has them."""

from __future__ import annotations

import math

import pytest
from scipy import constants

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_record.exchange.unit_table import factor_to_si, other_factor

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
    "time": {**_multiples("s", "mun"), "min": constants.minute},
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
