"""Units that are mistaken for each other, by the factor that comes of it."""

from __future__ import annotations

import math

_KNOWN = (
    (180.0 / math.pi, "degrees that were read as radians"),
    (math.pi / 180.0, "radians that were read as degrees"),
    (9.80665, "m/s² that were read as g, or newtons as kilograms-force"),
    (1.0 / 9.80665, "g that were read as m/s², or kilograms-force as newtons"),
    (30.0 / math.pi, "revolutions per minute that were read as rad/s"),
    (math.pi / 30.0, "rad/s that were read as revolutions per minute"),
    (2.0 * math.pi, "rad/s that were read as Hz"),
    (0.5 / math.pi, "Hz that were read as rad/s"),
    (1e3, "thousandths of a unit that were read as the unit, such as mm as m"),
    (1e-3, "a unit that was read as thousandths of it, such as m as mm"),
    (1e6, "millionths of a unit that were read as the unit, such as µm as m"),
    (1e-6, "a unit that was read as millionths of it, such as m as µm"),
    (1.0 / 0.0254, "inches that were read as metres"),
    (1.0 / 4.4482216, "pounds-force that were read as newtons"),
)
_TOLERANCE = 0.05
"""Of ln of a factor."""


def mistaken_units(factor: float) -> tuple[str, ...]:
    """What was mistaken where numbers are larger than they should be by a factor; empty where it is none of two units.

    Args:
        factor: recorded over what was meant; its sign does not count.
    """
    size = abs(factor)
    return tuple(words for value, words in _KNOWN if size > 0.0 and abs(math.log(size / value)) < _TOLERANCE)
