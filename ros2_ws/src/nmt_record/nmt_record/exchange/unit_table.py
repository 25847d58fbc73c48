"""Units of recorded data and their factors to SI.

The list is closed: in a heading, g is an acceleration, and (point) or (count) are no units.
"""

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

_INCH = 0.0254
_POUND_FORCE = 0.45359237 * STANDARD_GRAVITY
_DEGREE = math.pi / 180.0
_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12, "da": 10.0}


def _multiples(unit: str, prefixes: str, size: float = 1.0) -> dict[str, float]:
    return {prefix + unit: _PREFIXES[prefix] * size for prefix in ("", *prefixes.split())}


_FACTORS: dict[Quantity, dict[str, float]] = {
    Quantity.FORCE: {
        **_multiples("N", "k M m u da"), "dyn": 1e-5, "kgf": STANDARD_GRAVITY, "kp": STANDARD_GRAVITY,
        "gf": 1e-3 * STANDARD_GRAVITY, **_multiples("N*m", "m"),
        "lbf": _POUND_FORCE, "ozf": _POUND_FORCE / 16.0,
    },
    Quantity.ACCELERATION: {
        **_multiples("m/s^2", "m c u k"), "Gal": 1e-2, **_multiples("g", "m u", STANDARD_GRAVITY),
        "in/s^2": _INCH, "ft/s^2": 12.0 * _INCH,
    },
    Quantity.VELOCITY: {**_multiples("m/s", "m c u n"), "km/h": 1.0 / 3.6, "in/s": _INCH, "ft/s": 12.0 * _INCH},
    Quantity.DISPLACEMENT: {
        **_multiples("m", "c m u n p"), "in": _INCH, "mil": 1e-3 * _INCH, "ft": 12.0 * _INCH,
    },
    Quantity.VOLTAGE: _multiples("V", "m u k"),
    Quantity.CURRENT: _multiples("A", "m u k"),
}  # fmt: skip
_TORQUES = {
    **_multiples("N*m", "k m u"), "N*cm": 1e-2, "N*mm": 1e-3, "kgf*m": STANDARD_GRAVITY,
    "kgf*cm": 1e-2 * STANDARD_GRAVITY, "lbf*ft": _POUND_FORCE * 12.0 * _INCH, "lbf*in": _POUND_FORCE * _INCH,
}  # fmt: skip
_TORQUES |= {unit.replace("*", ""): value for unit, value in _TORQUES.items()}
_COORDINATES = {
    "angle": (Quantity.DISPLACEMENT, "rad", {**_multiples("rad", "m u"), "deg": _DEGREE}),
    "angular_velocity": (Quantity.VELOCITY, "rad/s", {**_multiples("rad/s", "m"), "deg/s": _DEGREE}),
    "angular_acceleration": (Quantity.ACCELERATION, "rad/s^2", {"rad/s^2": 1.0, "deg/s^2": _DEGREE}),
    "torque": (Quantity.FORCE, "N*m", _TORQUES),
    "strain": (Quantity.DISPLACEMENT, "1", {**_multiples("m/m", "m u"), **_multiples("strain", "u")}),
}
"""Coordinates of a model that are no lengths: in its equations they stand where a motion does, a torque where a force.
"""

# A table of amplitudes says no quantity: its unit tells the coordinate, too. In tables rad/s is a frequency.
for _motion, _, _units in (_COORDINATES[name] for name in _COORDINATES if name != "torque"):
    _FACTORS[_motion] |= {unit: factor for unit, factor in _units.items() if not unit.endswith("rad/s")}

_OTHER = {
    "frequency": {**_multiples("Hz", "k m"), "rad/s": 1.0 / (2.0 * math.pi), "rpm": 1.0 / 60.0},
    "ratio": {"1": 1.0, "%": 1e-2},
    "phase": {"rad": 1.0, "deg": _DEGREE, "cycles": 2.0 * math.pi},
    "time": {**_multiples("s", "m u n"), "min": 60.0, "h": 3600.0, "d": 86400.0},
    "modal amplitude": _multiples("m*sqrt(kg)", "m u"),
}

TIME_UNITS = tuple(_OTHER["time"])
"""Units of clocks."""

_COUNTS = frozenset({"counts", "count", "lsb", "raw", "adc", "digits", "bits", "int", "int16", "int24", "int32"})
_SPELLINGS = (
    ("µ", "u"), ("μ", "u"), ("²", "^2"), ("**", "^"), ("·", "*"), ("−", "-"), ("°", "deg"), ("√kg", "*sqrt(kg)"),
    ("(m/s)/s", "m/s^2"), ("m/s/s", "m/s^2"), ("s^-2", "/s^2"), ("s^-1", "/s"),
)  # fmt: skip
_NEGATIVE_POWER = re.compile(r"(?<=[A-Za-z])[\s.·⋅*]+(s|kg|N)\s*(?:\^|\*\*)?\{?[-−⁻]([12¹²])\}?")
_POWERS = {"1": "", "¹": "", "2": "^2", "²": "^2"}
_NAMES = {
    "newton": "N", "newtons": "N", "volt": "V", "volts": "V", "metre": "m", "meter": "m", "ampere": "A", "amp": "A",
    "amps": "A", "amperes": "A", "metres": "m", "meters": "m", "lb": "lbf", "lbs": "lbf", "mils": "mil", "inches": "in",
    "lb*in": "lbf*in", "in*lbf": "lbf*in", "in*lb": "lbf*in", "lb*ft": "lbf*ft", "ft*lbf": "lbf*ft", "ft*lb": "lbf*ft",
    "gn": "g", "g0": "g", "micron": "um", "inch": "in", "ips": "in/s", "deg": "deg", "degree": "deg", "degrees": "deg",
    "ue": "ustrain", "microstrain": "ustrain", "radian": "rad", "radians": "rad", "db": "dB", "khz": "kHz",
    "sec": "s", "second": "s", "seconds": "s", "sekunden": "s", "msec": "ms", "milliseconds": "ms", "usec": "us",
    "microseconds": "us", "nsec": "ns", "nanoseconds": "ns", "minutes": "min", "hours": "h", "hour": "h", "hrs": "h",
    "hr": "h", "days": "d", "day": "d",
    "1/min": "rpm", "u/min": "rpm", "r/min": "rpm", "rev/min": "rpm", "revs/min": "rpm", "min^-1": "rpm",
    "hertz": "Hz", "hz": "Hz", "percent": "%", "pct": "%", "-": "1", "none": "1", "m*kg^(1/2)": "m*sqrt(kg)",
}  # fmt: skip


# What kind of amplitude it is the name tells, too.
_AMPLITUDE_WORD = re.compile(r"(?<=\S)\s+\(?(rms|pk-pk|0-pk|pk|peak|p-p|pp|eff)\.?\)?(?=\s*\]?$)", re.I)


def plain_unit(text: str) -> str:
    """A unit as the table spells it: no spaces or brackets, ``um`` for micrometre, ``^2`` for squares."""
    text = _AMPLITUDE_WORD.sub("", text)
    unit = _NEGATIVE_POWER.sub(lambda found: f"/{found[1]}{_POWERS[found[2]]}", text)
    unit = re.sub(r"\s+", "", unit).strip("[]")
    for spelling, plain in _SPELLINGS:
        unit = unit.replace(spelling, plain)
    unit = unit.replace("**", "*").replace("*/", "/")
    unit = re.sub(r"/s(?:ec)?\^?2(?![\w^])", "/s^2", re.sub(r"/sec(?![\w])", "/s", unit))
    unit = re.sub(r"(?<=[A-Za-z])[-.](?=[A-Za-z])", "*", unit)  # N-m, N.m
    return "g" if unit == "G" else _NAMES.get(unit.lower(), unit)


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
    """The coordinate that is not a length whose unit it is; empty if none."""
    plain = plain_unit(unit)
    return next((name for name, (_, _, units) in _COORDINATES.items() if plain in units), "")


def is_quantity(name: str) -> bool:
    """Whether a channel may be said to measure it."""
    return name in _COORDINATES or name.upper() in Quantity.__members__


def measured_quantity(name: str) -> Quantity:
    """What a quantity of a channel, or a coordinate, is in the bag and in the equations."""
    return _COORDINATES[name][0] if name in _COORDINATES else Quantity[name.upper()]


def si_unit(name: str) -> str:
    """SI unit of a quantity or coordinate."""
    return _COORDINATES[name][1] if name in _COORDINATES else Quantity[name.upper()].unit


def si_unit_of(unit: str) -> str:
    """SI unit of a unit's quantity or coordinate, or of a quotient of such; empty if it is not known."""
    plain = plain_unit(unit)
    coordinate = coordinate_of_unit(plain)
    if coordinate:
        return si_unit(coordinate)
    if quantity_of_unit(plain) is not Quantity.UNKNOWN:
        return quantity_of_unit(plain).unit
    found = _quotient(plain)
    if found is None:
        return ""
    above, below = _halves(plain)
    over = si_unit_of(below) if below else REFERENCE_UNITS[found[2]]
    return f"{si_unit_of(above) or found[0].unit}/" + (f"({over})" if "/" in over or "*" in over else over)


def channel_factor(name: str, unit: str, where: str) -> float:
    """Factor from a unit to the SI unit of a quantity of a channel, or of a coordinate.

    Raises:
        BenchError: as :func:`factor_to_si`; a coordinate is given as a motion, or the other way round.
    """
    coordinate = coordinate_of_unit(unit)
    if coordinate == name:
        return _COORDINATES[name][2][plain_unit(unit)]
    if name in _COORDINATES:
        raise BenchError(
            f"{where} measures {name.replace('_', ' ')}, but its unit '{unit.strip()}' is none; use "
            f"{', '.join(_COORDINATES[name][2])}."
        )
    if coordinate and not (name == "force" and plain_unit(unit) in _FACTORS[Quantity.FORCE]):
        raise BenchError(
            f"{where} measures {name}, but its unit {unit.strip()} is one of {coordinate}; write quantity: "
            f"{coordinate}."
        )
    return factor_to_si(Quantity[name.upper()], unit, where)


def factor_to_si(quantity: Quantity, unit: str, where: str) -> float:
    """Factor from a unit to the SI unit of its quantity.

    Args:
        quantity: what is measured.
        unit: as the user wrote it.
        where: place, for the message.

    Raises:
        BenchError: the unit is empty, raw counts, one of another quantity, or not known.
    """
    plain = plain_unit(unit)
    units = _FACTORS[quantity]
    if plain in units:
        return units[plain]
    if quantity is Quantity.FORCE and plain in _TORQUES:
        return _TORQUES[plain]
    name = quantity.name.lower()
    known = ", ".join(units)
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
    raise BenchError(f"{where} has the unknown unit '{unit.strip()}'{_close(plain, units)}; {name} may be in {known}.")


def other_factor(kind: str, unit: str, where: str) -> float:
    """Factor to SI (Hz for frequencies) of a unit that no channel has: frequency, ratio, phase, time, modal amplitude.

    Raises:
        BenchError: the unit is not known.
    """
    units = _OTHER[kind]
    plain = plain_unit(unit)
    if plain not in units:
        raise BenchError(
            f"{where} has the unknown unit '{unit.strip()}'{_close(plain, units)}; use {', '.join(units)}."
        )
    return units[plain]


def is_known_unit(text: str) -> bool:
    """Whether a text is a unit of a channel, a clock, a frequency, a phase or a frequency response."""
    plain = plain_unit(text)
    if not plain or plain == "1":
        return False
    return (
        is_channel_unit(plain)
        or plain == "%"
        or decibels(text) is not None
        or any(plain in units for units in _OTHER.values())
        or is_quotient(plain)
    )


def is_channel_unit(unit: str) -> bool:
    """Whether it is the unit of a quantity or coordinate of a channel."""
    return quantity_of_unit(unit) is not Quantity.UNKNOWN or bool(coordinate_of_unit(unit))


def is_quotient(unit: str) -> bool:
    """Whether it is the unit of a frequency response."""
    return _quotient(unit) is not None


def quantity_of_unit(unit: str) -> Quantity:
    """The quantity that a unit belongs to; ``UNKNOWN`` if none."""
    plain = plain_unit(unit)
    if plain in _TORQUES:
        return Quantity.FORCE
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


REFERENCE_UNITS = {"force": "N", "base": "m/s^2", "voltage": "V"}
"""What frequency responses may be divided by, and its SI unit."""


def response_over_reference(unit: str, where: str, force_only: bool = False) -> tuple[Quantity, float, str]:
    """Response quantity, factor to SI and reference of the unit of a frequency response.

    ``m/s^2/N`` and ``g/N`` are over a force, ``g/g``, ``m/(m/s^2)`` and ``m/s^2/g`` over the acceleration of a base,
    ``m/s^2/V`` over a voltage; ``1`` is a motion over that of the base, whichever.

    Raises:
        BenchError: not a response over one of these, or over another than a force where only that will do.
    """
    found = _quotient(unit)
    if found is not None and (found[2] == "force" or not force_only):
        return found
    given = f"'{unit.strip()}' is not" if unit.strip() else "it is missing"
    others = ", per acceleration of the base, such as g/g or m/(m/s^2), or per voltage, such as m/s^2/V"
    raise BenchError(
        f"{where}: the unit must be a response per force, such as m/N or m/s^2/N or g/N{'' if force_only else others}; "
        f"{given}."
    )


def inverse_unit(unit: str) -> str:
    """Unit of the response whose reciprocal has a unit of force per motion, such as N/m; empty for others."""
    plain = {"N*s/m": "N/(m/s)", "Ns/m": "N/(m/s)"}.get(plain_unit(unit), plain_unit(unit))
    for slash in re.finditer("/", plain):
        above, below = plain[: slash.start()], plain[slash.end() :]
        below = below[1:-1] if below[:1] == "(" and below[-1:] == ")" else below
        if quantity_of_unit(above) is Quantity.FORCE and quantity_of_unit(below) in MOTIONS:
            return f"({below})/{above}"
    return ""


def decibels(unit: str) -> str | None:
    """Unit that dB refer to, empty where it is not told; None where a unit is not a dB."""
    found = re.fullmatch(
        r"\[?\s*dB\s*(?:\(?\s*(?:re\.?|ref\.?|rel\.?|/)\s*(?:1(?![\d/]))?\s*(.*?)\)?)?\s*\]?", unit.strip(), re.I
    )
    return None if found is None else (found[1] or "").strip()


def unit_size(unit: str) -> tuple[Quantity, float, str] | None:
    """Response quantity, factor to SI and reference (empty for a response alone) of a unit; None if it is not known."""
    quotient = _quotient(unit)
    if quotient is not None:
        return quotient
    quantity = quantity_of_unit(unit)
    return None if quantity is Quantity.UNKNOWN else (quantity, _FACTORS[quantity].get(plain_unit(unit), 1.0), "")


def _quotient(unit: str) -> tuple[Quantity, float, str] | None:
    """Response quantity, factor to SI and reference of a unit; None if it is not a quotient of these."""
    plain = plain_unit(unit)
    if plain in ("1", "m/m"):
        return Quantity.ACCELERATION, 1.0, "base"
    above, below = _halves(plain)
    if not above:
        return None
    quantity, reference = quantity_of_unit(above), quantity_of_unit(below)
    return quantity, _FACTORS[quantity][above] / (_FACTORS[reference] | _TORQUES)[below], _REFERENCES[reference]


_REFERENCES = {Quantity.FORCE: "force", Quantity.ACCELERATION: "base", Quantity.VOLTAGE: "voltage"}


def _halves(plain: str) -> tuple[str, str]:
    """Units of response and reference of a quotient; empty if it is none of these."""
    for slash in re.finditer("/", plain):
        halves = plain[: slash.start()], plain[slash.end() :]
        above, below = (half[1:-1] if half[:1] == "(" and half[-1:] == ")" else half for half in halves)
        if quantity_of_unit(above) in MOTIONS and quantity_of_unit(below) in _REFERENCES:
            return above, below
    return "", ""


def _close(unit: str, known: dict[str, float]) -> str:
    close = difflib.get_close_matches(unit, known, n=1, cutoff=0.6)
    return f" (did you mean {close[0]}?)" if close else ""
