"""Units of recorded data and their factors to SI."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Sequence

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import MOTIONS

STANDARD_GRAVITY = 9.80665
"""m/s², by definition (CGPM 1901)."""

_POUND = 0.45359237
_INCH = 0.0254

_FACTORS: dict[Quantity, dict[str, float]] = {
    Quantity.FORCE: {
        "N": 1.0, "kN": 1e3, "MN": 1e6, "mN": 1e-3, "uN": 1e-6, "daN": 10.0, "dyn": 1e-5,
        "kgf": STANDARD_GRAVITY, "kp": STANDARD_GRAVITY, "gf": 1e-3 * STANDARD_GRAVITY,
        "N*m": 1.0, "mN*m": 1e-3,
        "lbf": _POUND * STANDARD_GRAVITY, "ozf": _POUND * STANDARD_GRAVITY / 16.0,
    },
    Quantity.ACCELERATION: {
        "m/s^2": 1.0, "mm/s^2": 1e-3, "cm/s^2": 1e-2, "um/s^2": 1e-6, "km/s^2": 1e3, "Gal": 1e-2,
        "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY, "ug": 1e-6 * STANDARD_GRAVITY,
        "in/s^2": _INCH, "ft/s^2": 12.0 * _INCH,
    },
    Quantity.VELOCITY: {
        "m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "um/s": 1e-6, "nm/s": 1e-9, "km/h": 1.0 / 3.6,
        "in/s": _INCH, "ft/s": 12.0 * _INCH,
    },
    Quantity.DISPLACEMENT: {
        "m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "pm": 1e-12,
        "in": _INCH, "mil": 1e-3 * _INCH, "ft": 12.0 * _INCH,
    },
    Quantity.VOLTAGE: {"V": 1.0, "mV": 1e-3, "uV": 1e-6, "kV": 1e3},
    Quantity.CURRENT: {"A": 1.0, "mA": 1e-3, "uA": 1e-6, "kA": 1e3},
}  # fmt: skip

_DEGREE = math.pi / 180.0
_TORQUES = {
    "N*m": 1.0, "kN*m": 1e3, "mN*m": 1e-3, "uN*m": 1e-6, "N*cm": 1e-2, "N*mm": 1e-3,
    "kgf*m": STANDARD_GRAVITY, "kgf*cm": 1e-2 * STANDARD_GRAVITY,
    "lbf*ft": _POUND * STANDARD_GRAVITY * 12.0 * _INCH, "lbf*in": _POUND * STANDARD_GRAVITY * _INCH,
}  # fmt: skip
_COORDINATES = {
    "angle": (Quantity.DISPLACEMENT, "rad", {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": _DEGREE}),
    "angular_velocity": (Quantity.VELOCITY, "rad/s", {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEGREE}),
    "angular_acceleration": (Quantity.ACCELERATION, "rad/s^2", {"rad/s^2": 1.0, "deg/s^2": _DEGREE}),
    "torque": (Quantity.FORCE, "N*m", _TORQUES | {unit.replace("*", ""): value for unit, value in _TORQUES.items()}),
    "strain": (Quantity.DISPLACEMENT, "1", {"m/m": 1.0, "mm/m": 1e-3, "um/m": 1e-6, "strain": 1.0, "ustrain": 1e-6}),
}
"""Coordinates of a model that are no lengths: in its equations they stand where a motion does, a torque where a force.
"""

# A table of amplitudes says no quantity: its unit tells the coordinate, too. In tables rad/s is a frequency.
for _motion, _, _units in (_COORDINATES[name] for name in _COORDINATES if name != "torque"):
    _FACTORS[_motion] |= {unit: factor for unit, factor in _units.items() if not unit.endswith("rad/s")}

_OTHER = {
    "frequency": {"Hz": 1.0, "kHz": 1e3, "mHz": 1e-3, "rad/s": 1.0 / (2.0 * math.pi), "rpm": 1.0 / 60.0},
    "ratio": {"1": 1.0, "%": 1e-2},
    "phase": {"rad": 1.0, "deg": math.pi / 180.0, "cycles": 2.0 * math.pi},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "modal amplitude": {"m*sqrt(kg)": 1.0, "mm*sqrt(kg)": 1e-3, "um*sqrt(kg)": 1e-6},
}

_COUNTS = frozenset({"counts", "count", "lsb", "raw", "adc", "digits", "bits", "int", "int16", "int24", "int32"})
_SPELLINGS = (
    ("µ", "u"), ("μ", "u"), ("²", "^2"), ("**", "^"), ("·", "*"), ("−", "-"), ("°", "deg"), ("√kg", "*sqrt(kg)"),
    ("(m/s)/s", "m/s^2"), ("m/s/s", "m/s^2"), ("s^-2", "/s^2"), ("s^-1", "/s"), ("m/s2", "m/s^2"),
)  # fmt: skip
_NAMES = {
    "newton": "N", "newtons": "N", "volt": "V", "volts": "V", "metre": "m", "meter": "m", "ampere": "A", "amp": "A",
    "gn": "g", "g0": "g", "micron": "um", "inch": "in", "ips": "in/s", "deg": "deg", "degree": "deg", "degrees": "deg",
    "ue": "ustrain",
    "sec": "s", "second": "s", "seconds": "s", "sekunden": "s", "msec": "ms", "milliseconds": "ms", "usec": "us",
    "microseconds": "us", "nsec": "ns", "nanoseconds": "ns", "minutes": "min",
    "hertz": "Hz", "hz": "Hz", "percent": "%", "-": "1", "none": "1", "m*kg^(1/2)": "m*sqrt(kg)",
}  # fmt: skip


def plain_unit(text: str) -> str:
    """A unit as the table spells it: no spaces or brackets, ``um`` for micrometre, ``^2`` for squares."""
    unit = re.sub(r"\s+", "", text).strip("[]")
    for spelling, plain in _SPELLINGS:
        unit = unit.replace(spelling, plain)
    unit = unit.replace("**", "*").replace("*/", "/")
    return _NAMES.get(unit.lower(), unit)


def _as_in_names(units: Sequence[str]) -> dict[str, str]:
    """Units by how a column's name spells them, such as ``mms``, ``mm_s`` and ``mmps`` for mm/s."""
    return {unit.replace("^", "").replace("/", slash).lower(): unit for unit in units for slash in ("", "_", "p")}


_IN_NAMES = _as_in_names(("m/s^2", "m/s", "mm/s", "mm", "um", "g", "mg", "N", "kN", "V", "mV", "deg", "rad"))
del _IN_NAMES["ms"]  # milliseconds
_CHANNEL_ENDING = re.compile(rf"[_ ]({'|'.join(_IN_NAMES)})$", re.I)
_TIME_ENDING = re.compile(r"(?:^|[_ ])(s|sec|ms|msec|us|usec|µs|ns|nsec|min)$", re.I)


def unit_in_name(name: str, *, time: bool = False) -> tuple[str, str]:
    """A column's name without the unit that ends it, and that unit; empty if none does.

    Args:
        name: such as ``acc_m_s2``.
        time: whether it is a clock's, whose ``_ms`` are milliseconds.
    """
    found = (_TIME_ENDING if time else _CHANNEL_ENDING).search(name)
    if not found:
        return name, ""
    word = found[1].lower()
    return name[: found.start()], plain_unit(_IN_NAMES.get(word, word))


def coordinate_of_unit(unit: str) -> str:
    """The coordinate that is no length whose unit it is; empty if none."""
    plain = plain_unit(unit)
    return next((name for name, (_, _, units) in _COORDINATES.items() if plain in units), "")


def measured_quantity(name: str) -> Quantity:
    """What a quantity of a channel, or a coordinate, is in the bag and in the equations."""
    return _COORDINATES[name][0] if name in _COORDINATES else Quantity[name.upper()]


def si_unit(name: str) -> str:
    """SI unit of a quantity or coordinate."""
    return _COORDINATES[name][1] if name in _COORDINATES else Quantity[name.upper()].unit


def channel_factor(name: str, unit: str, where: str) -> float:
    """Factor from a unit to the SI unit of a quantity of a channel, or of a coordinate.

    Raises:
        BenchError: as :func:`factor_to_si`; a coordinate is given as a motion, or the other way round.
    """
    own = coordinate_of_unit(unit)
    if own == name:
        return _COORDINATES[name][2][plain_unit(unit)]
    if name in _COORDINATES:
        raise BenchError(
            f"{where} measures {name.replace('_', ' ')}, but its unit '{unit.strip()}' is none; use "
            f"{', '.join(_COORDINATES[name][2])}."
        )
    if own and not (own == "torque" and name == "force"):
        raise BenchError(
            f"{where} measures {name}, but its unit {unit.strip()} is one of {own}; write quantity: {own}."
        )
    return factor_to_si(Quantity[name.upper()], unit, where)


def factor_to_si(quantity: Quantity, unit: str, where: str) -> float:
    """Factor from a unit to the SI unit of its quantity.

    Args:
        quantity: what is measured.
        unit: as the user wrote it.
        where: of what, for the message.

    Raises:
        BenchError: the unit is empty, raw counts, one of another quantity, or not known.
    """
    plain = plain_unit(unit)
    own = _FACTORS[quantity]
    if plain in own:
        return own[plain]
    name = quantity.name.lower()
    known = ", ".join(own)
    if not plain:
        raise BenchError(f"{where} has no unit; say which one its {name} has ({known}).")
    if plain.lower() in _COUNTS:
        raise BenchError(
            f"{where} is in raw {unit.strip()}; give 'scale: …' ({quantity.unit} per count) and 'unit: "
            f"{quantity.unit}'."
        )
    others = [other for other, units in _FACTORS.items() if plain in units]
    if others:
        hint = "check the quantity"
        if others[0] in (Quantity.VOLTAGE, Quantity.CURRENT):
            scale = f"'scale: …' ({quantity.unit} per {plain}) and 'unit: {quantity.unit}'"
            hint = f"or, if it is a sensor's output, give {scale}"
        raise BenchError(
            f"{where} measures {name}, but its unit {unit.strip()} is one of {others[0].name.lower()}; {hint}."
        )
    raise BenchError(f"{where} has the unknown unit '{unit.strip()}'{_close(plain, own)}; {name} may be in {known}.")


def other_factor(kind: str, unit: str, where: str) -> float:
    """Factor to SI (Hz for frequencies) of a unit that no channel has: frequency, ratio, phase, time, modal amplitude.

    Raises:
        BenchError: the unit is not known.
    """
    own = _OTHER[kind]
    plain = plain_unit(unit)
    if plain not in own:
        raise BenchError(f"{where} has the unknown unit '{unit.strip()}'{_close(plain, own)}; use {', '.join(own)}.")
    return own[plain]


def quantity_of_unit(unit: str) -> Quantity:
    """The quantity that a unit belongs to; ``UNKNOWN`` if none."""
    plain = plain_unit(unit)
    return next((quantity for quantity, units in _FACTORS.items() if plain in units), Quantity.UNKNOWN)


def response_unit(unit: str, where: str) -> tuple[Quantity, float]:
    """Quantity and factor to SI of the unit of a response amplitude (m, m/s, m/s^2 or a multiple).

    Raises:
        BenchError: not the unit of a displacement, velocity or acceleration.
    """
    quantity = quantity_of_unit(unit)
    if quantity not in MOTIONS:
        given = f"'{unit.strip()}' is not" if unit.strip() else "it is missing, which must be"
        raise BenchError(f"{where}: the unit of the response must be given, such as mm, m/s or g; {given} one.")
    return quantity, _FACTORS[quantity][plain_unit(unit)]


def response_per_force(unit: str, where: str) -> tuple[Quantity, float]:
    """Response quantity and factor to SI of the unit of a frequency response such as ``m/s^2/N`` or ``g/N``.

    Raises:
        BenchError: not a response divided by a force.
    """
    found = _quotient(unit)
    if found is None or found[2] != "force":
        given = f"'{unit.strip()}' is not" if unit.strip() else "it is missing"
        raise BenchError(f"{where}: the unit must be a response per force, such as m/N or m/s^2/N or g/N; {given}.")
    return found[:2]


REFERENCE_UNITS = {"force": "N", "base": "m/s^2", "voltage": "V"}
"""What frequency responses may be divided by, and its SI unit."""


def response_over_reference(unit: str, where: str) -> tuple[Quantity, float, str]:
    """Response quantity, factor to SI and reference of the unit of a frequency response.

    ``m/s^2/N`` and ``g/N`` are over a force, ``g/g``, ``m/(m/s^2)`` and ``m/s^2/g`` over the acceleration of a base,
    ``m/s^2/V`` over a voltage; ``1`` is a motion over that of the base, whichever.

    Raises:
        BenchError: not a response over one of these.
    """
    found = _quotient(unit)
    if found is not None:
        return found
    given = f"'{unit.strip()}' is not" if unit.strip() else "it is missing"
    raise BenchError(
        f"{where}: the unit must be a response per force, such as m/N or m/s^2/N or g/N, per acceleration of the base, "
        f"such as g/g or m/(m/s^2), or per voltage, such as m/s^2/V; {given}."
    )


def _quotient(unit: str) -> tuple[Quantity, float, str] | None:
    """Response quantity, factor to SI and reference of a unit; None if it is no quotient of these."""
    plain = plain_unit(unit)
    if plain in ("1", "m/m"):
        return Quantity.ACCELERATION, 1.0, "base"
    for slash in re.finditer("/", plain):
        halves = plain[: slash.start()], plain[slash.end() :]
        above, below = (half[1:-1] if half[:1] == "(" and half[-1:] == ")" else half for half in halves)
        quantity, reference = quantity_of_unit(above), quantity_of_unit(below)
        known = {Quantity.FORCE: "force", Quantity.ACCELERATION: "base", Quantity.VOLTAGE: "voltage"}.get(reference)
        if known and quantity in MOTIONS:
            return quantity, _FACTORS[quantity][above] / _FACTORS[reference][below], known
    return None


def _close(unit: str, known: dict[str, float]) -> str:
    close = difflib.get_close_matches(unit, known, n=1, cutoff=0.6)
    return f" (did you mean {close[0]}?)" if close else ""
