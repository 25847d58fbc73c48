"""Secondary resonances: which order of the response is in resonance, and the phase lag that it has there.

In a k:ν resonance the force has the frequency Ω and the response vibrates at kΩ/ν near a natural frequency. Orders are
counted in the base frequency Ω/ν, so that the force has the order ν and the resonant part of the response the order k::

    θ = k arg F_ν − ν arg x_k

does not depend on where the phase is counted from. With a spring that hardens as w³ and a force F cos Ωt:

* 3:1, superharmonic. Below its resonance the mode follows the force, x₁ = X₁ cos Ωt with X₁ > 0, and −α X₁³/4 cos 3Ωt
  excites the third order. At resonance that lags by 90°: arg x₃ = 180° − 90°, θ = −90° = 270°.
* 1:3, subharmonic. Above its resonance the mode is in antiphase to the force, x₃ < 0. The power balance of the order 1,
  sin 3φ = 4 c ω / (3 α |x₁| |x₃|) with its lag φ, has its extreme amplitudes where 3φ = θ = 90°; φ = 30° modulo 120°.

A spring that softens turns both by 180°. Volvert and Kerschen, Mechanical Systems and Signal Processing 167 (2022)
108510.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from nmt_core.errors import BenchError


class SecondaryResonance(NamedTuple):
    """A k:ν resonance.

    Attributes:
        response_order: k.
        force_order: ν.
        lag: θ at resonance with a hardening spring, rad.
    """

    response_order: int
    force_order: int
    lag: float

    @property
    def label(self) -> str:
        """As k:ν."""
        return f"{self.response_order}:{self.force_order}"

    @property
    def needs_release(self) -> bool:
        """Whether the resonant response lies on a branch apart from rest."""
        return self.force_order > 1


RESONANCES = (
    SecondaryResonance(3, 1, math.radians(270.0)),
    SecondaryResonance(1, 3, math.radians(90.0)),
)
"""Those that the bench can hold."""


def resonance_of(response_order: int, force_order: int) -> SecondaryResonance:
    """The resonance with these orders.

    Raises:
        BenchError: the bench does not hold it.
    """
    for resonance in RESONANCES:
        if (response_order, force_order) == resonance[:2]:
            return resonance
    known = " or ".join(item.label for item in RESONANCES)
    raise BenchError(f"A resonance of {response_order}:{force_order} cannot be held; use {known}.")


def resonance_named(name: str) -> SecondaryResonance:
    """The resonance of a text as ``3:1``; errors as :func:`resonance_of`."""
    for resonance in RESONANCES:
        if name == resonance.label:
            return resonance
    raise BenchError(f"Resonance '{name}' is not known; use {' or '.join(item.label for item in RESONANCES)}.")
