"""Terms of local laws: forces of a unit coefficient along a given periodic motion, and their harmonics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from typing import Any

import numpy as np

from nmt_core.key_units import unit_of_key
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_core.vocabulary import Quantity
from nmt_diagnose.law.modal_frame import ORDERS
from nmt_rig.model.element_uses import LawForm
from nmt_rig.model.local_elements import SECTIONS
from nmt_rig.model.local_elements.attachments import LuGre, SlackSlider
from nmt_rig.model.local_elements.dampers import LinearDamperSection
from nmt_rig.model.local_elements.element import MAGNITUDE_OF, ElementSection
from nmt_rig.model.local_elements.springs import LinearSpringSection

SAMPLES = 512
"""A period's samples: forces with corners have aliases below 1e-4 of their size in the orders that are kept."""
_TURNS = np.exp(2j * np.pi * np.outer(np.arange(ORDERS + 1), np.arange(SAMPLES)) / SAMPLES)
_ALONG = np.ones(1)
_POWERS = {ord(raised): f"^{plain}" for plain, raised in enumerate("⁰¹²³⁴⁵⁶⁷⁸⁹")}

# Terms that are combined with those of elements and that no element has.
_SECOND_FORMS = (
    LawForm(
        "gap damping", "gap", "damper where |x| > {mm} mm", words="clearance", unit="N s/m",
        force=lambda x, v, gap, _: np.where(np.abs(x) > gap, v, 0.0), unwritten="damping in contact",
    ),
    LawForm(
        "stop damping", "stop", "damper where {beyond}", words="stop on one side", unit="N s/m",
        force=lambda x, v, gap, side: np.where(np.sign(side) * x > gap, v, 0.0), unwritten="damping in contact",
    ),
)  # fmt: skip
# A linear force is an error of the modes at held levels; a record separates the two.
OF_RECORDS: tuple[tuple[LawForm, type[ElementSection]], ...] = (
    (
        LawForm(
            "power", "linear spring", "x", lambda c, *_: (c,), "linear spring", unit="N/m", exponent=1.0, signed=True
        ),
        LinearSpringSection,
    ),
    (
        LawForm("speed", "viscous damping", "v", lambda c, *_: (c,), "viscous damping", unit="N s/m", exponent=1.0),
        LinearDamperSection,
    ),
)
_OF_ELEMENTS = [(form, section) for section in SECTIONS for form in section.law]
_FORMS: tuple[tuple[LawForm, type[ElementSection] | None], ...] = (
    *((form, None) for form in _SECOND_FORMS),
    *OF_RECORDS,
    *_OF_ELEMENTS,
)


@dataclass(frozen=True)
class Term:
    """One term of a law; its force is a coefficient times :func:`force`.

    Attributes:
        kind: of its form, see :class:`nmt_rig.model.element_uses.LawForm`.
        first, second: its numbers.
        by, about: measured channel by which its coefficient changes, and the value of the channel that counts as none;
            empty = it does not change.
    """

    kind: str
    first: float = 0.0
    second: float = 0.0
    by: str = ""
    about: float = 0.0

    @property
    def form(self) -> LawForm:
        """What the term is, as the element says that has its force.

        Raises:
            ValueError: the term does not exist.
        """
        return _form(self.kind, self.first)[0]

    @property
    def section(self) -> type[ElementSection] | None:
        """Section of the element that has its force; None where no element has it."""
        return _form(self.kind, self.first)[1]

    @property
    def signed(self) -> bool:
        """Polynomials of the displacement may soften; all else is passive by coefficients that are not negative."""
        return self.form.signed

    @property
    def below(self) -> bool:
        """Whether it is a stop on the side of negative displacement."""
        return self.kind == "stop" and self.second < 0.0

    @property
    def remembers(self) -> bool:
        """Whether its force depends on the way to a motion, not on the motion alone."""
        if self.form.force is not None:
            return False
        return isinstance(self._element, LuGre | SlackSlider) or bool(self._element.sliders)

    @property
    def unit(self) -> str:
        """Unit of the coefficient."""
        if self.by:
            return f"{replace(self, by='').unit}/{Quantity[self.by.removeprefix(MAGNITUDE_OF).split()[0].upper()].unit}"
        if self.section is None or self.form.unit:
            return self.form.unit.format(exponent=f"{self.first:.3g}")
        return unit_of_key(self.section.own_keys()[0]).translate(_POWERS)

    def values(self, strength: float) -> dict[str, float]:
        """Own keys of the element's section at a strength; a stop of the other side has the same."""
        form, section = _form(self.kind, self.first)
        if section is None or form.values is None:
            return {}
        return dict(zip(_own_keys(section), form.values(strength, self.first, self.second), strict=True))

    def force(self, x: FloatArray, v: FloatArray, closed: bool = True) -> FloatArray:
        """Force (…, n) of a unit coefficient along displacement (m) and velocity (m/s); see :func:`force_of`."""
        if self.form.force is not None:
            return np.asarray(self.form.force(x, v, self.first, self.second))
        # A stop of the other side is the same one along the other direction.
        side = -1.0 if self.below else 1.0
        return side * force_of(self._element, side * x, side * v, closed)

    @cached_property
    def _element(self) -> Any:
        """The element of unit strength that has its force."""
        assert self.section is not None
        return self.section.element(_ALONG, *self.values(1.0).values())


@cache
def _own_keys(section: type[ElementSection]) -> tuple[str, ...]:
    return tuple(section.own_keys())


@lru_cache(maxsize=4096)
def _form(kind: str, first: float) -> tuple[LawForm, type[ElementSection] | None]:
    """Form of a term and the section of the element that has its force."""
    for form, section in _FORMS:
        if form.kind == kind and form.exponent in (0.0, first):
            return form, section
    raise ValueError(f"there is no term of kind {kind} with {first:g}")


def force_of(element: Any, x: FloatArray, v: FloatArray, closed: bool = True) -> FloatArray:
    """Force of an element along displacement (m) and velocity (m/s), (…, n).

    Args:
        element: sliders, with slack too, contacts, bristles, or a ``response`` that takes arrays.
        x, v: one period, or a record.
        closed: whether memory is that of a loop that closes; else it begins as in a model at rest at zero.
    """
    if isinstance(element, LuGre):
        reach = element.sliding_force(v) / element.bristle_stiffness
        return element.bristle_stiffness * bristle_force(x, reach, closed)
    if isinstance(element, SlackSlider):
        return element.force(slider_force(x, element.reach, closed))
    if element.sliders:
        return np.asarray(sum(k * slider_force(x, slip / k, closed) for k, slip in element.sliders))
    if element.contacts:
        return np.asarray(sum(side * k * np.maximum(side * x - gap, 0.0) for k, gap, side in element.contacts))
    return np.asarray(element.response(*element.values, x, v)[0])


def slider_force(x: FloatArray, slip: float, closed: bool = True) -> FloatArray:
    """Force of a spring of 1 N/m in series with a slider that yields at a displacement.

    Args:
        x: displacement, m, (…, n).
        slip: slip displacement, m.
        closed: as of :func:`force_of`.
    """
    flat = np.ascontiguousarray(x.reshape(-1, x.shape[-1]))
    # The second period is the closed loop: a slider forgets its start at the first full slip.
    loops: FloatArray = _slider_loops(flat, slip, 2 if closed else 1)
    return loops.reshape(x.shape)


@njit(cache=True)
def _slider_loops(x: FloatArray, slip: float, turns: int) -> FloatArray:
    """Spring force behind the slider along the last of some turns, row by row."""
    result = np.empty_like(x)
    for row in range(x.shape[0]):
        at = 0.0
        for _ in range(turns):
            for k in range(x.shape[1]):
                at = min(max(at, x[row, k] - slip), x[row, k] + slip)
                result[row, k] = x[row, k] - at
    return result


def bristle_force(x: FloatArray, reach: FloatArray, closed: bool = True) -> FloatArray:
    """Force z of bristles of 1 N/m: dz/dx = 1 − z sgn(v) / reach.

    Constant reach is Dahl's law, one that falls with speed the bristles of Canudas de Wit et al. (IEEE Trans. Automat.
    Contr. 40, 1995) without their damping. Between samples the reach is constant; the loop is affine in its start.

    Args:
        x: displacement, m, (…, n).
        reach: deflection of the bristles while they slide, m, (…, n).
        closed: as of :func:`force_of`.
    """
    flat = (np.ascontiguousarray(part.reshape(-1, x.shape[-1])) for part in (x, reach))
    loops: FloatArray = _bristle_loops(*flat, 2 if closed else 1)
    return loops.reshape(x.shape)


@njit(cache=True)
def _bristle_loops(x: FloatArray, reach: FloatArray, turns: int) -> FloatArray:
    """Deflection of the bristles, row by row."""
    result = np.empty_like(x)
    count = x.shape[1]
    for row in range(x.shape[0]):
        at, kept = 0.0, 1.0
        # A period from zero and what it keeps of a start give the start that a period comes back to.
        for turn in range(turns):
            if turn == 1:
                at = at / (1.0 - kept) if kept < 1.0 else 0.0
            for k in range(count):
                result[row, k] = at
                after = (k + 1) % count
                way = x[row, after] - x[row, k]
                full = 0.5 * (reach[row, after] + reach[row, k])
                full = full if way > 0.0 else -full
                share = np.exp(-abs(way / full))
                at = full + (at - full) * share
                if turn == 0:
                    kept *= share
    return result


def sampled(motion: ComplexArray, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Displacement and velocity (L, SAMPLES) of harmonics (L, ORDERS + 1)."""
    x = (motion @ _TURNS).real
    v = ((1j * omega[:, np.newaxis] * np.arange(ORDERS + 1) * motion) @ _TURNS).real
    return x, v


def harmonics(force: FloatArray) -> ComplexArray:
    """Orders 0 … ORDERS (…, ORDERS + 1) of forces over one period (…, SAMPLES)."""
    found = np.fft.rfft(force, axis=-1)[..., : ORDERS + 1] * (2.0 / SAMPLES)
    found[..., 0] *= 0.5
    return np.asarray(found)
