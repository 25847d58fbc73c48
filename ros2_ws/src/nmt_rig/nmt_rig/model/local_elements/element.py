"""What local elements and their sections of a rig file share.

An element has a direction d (n,): it sees w = d · q and v = d · q̇ and acts on the structure as -d g(w, v). Its formulas
are static methods of plain numbers, first the parameters in the order of the class; numba compiles them in
element_kernels.py, and time integration, harmonic balance and diagnosis share them:

* ``response(…, w, v)``: g (N), ∂g/∂w (N/m), ∂g/∂v (N s/m).

An element whose force has corners has branches: sticking 0, slipping ±1; open 0, closed ±1. The time integration
locates where they change, with the position of a slider (m) as the memory of the one element that has any:

* ``next_branch(…, branch, w, v, slider)``: the branch that fits; equal to ``branch`` unless a corner was passed.

Where the force is linear between its corners, harmonic balance switches it exactly (``sliders``, ``contacts``), and

* ``frozen(…, branch, w, v, slider)``: what ``response`` gives, on a branch;
* ``piece(…, branch, slider)``: stiffness (N/m) and constant (N) of the force on a branch.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from nmt_core.key_units import unit_of_key
from nmt_rig.model.element_uses import ElementEffect, LawForm
from nmt_rig.model.structure import Array, Structure
from nmt_rig.rig_section import Name, Point, Positive, Section

PARAMETER_COUNT = 4
MAGNITUDE_OF = "magnitude of "
"""Before the name of a channel whose sign does not count."""
# Columns of tables of ``sliders`` and of ``contacts``.
SLIDER_STIFFNESS, SLIDER_SLIP = 0, 1
CONTACT_STIFFNESS, CONTACT_GAP, CONTACT_SIDE = 0, 1, 2

Response = tuple[float, float, float]


@dataclass(frozen=True)
class LocalElement:
    """Base of the local elements.

    Attributes:
        direction: (n,) direction d on the degrees of freedom it acts on, w = d · q.
        kind: number of the class in compiled code.
        degree: of a polynomial force, whose samples over a period are then free of aliasing.
        samples: over a period of another smooth force, for references and for models that are fitted (errors of the
            harmonics below 1e-5); without these, degree, sliders and contacts harmonic balance refuses the element.

    Raises:
        ValueError: a parameter that is not finite or not within its range.
    """

    direction: Array = field(repr=False)
    kind: ClassVar[int] = 0
    degree: ClassVar[int] = 0
    samples: ClassVar[tuple[int, int]] = (0, 0)
    must_be_positive: ClassVar[tuple[str, ...]] = ()
    must_not_be_negative: ClassVar[tuple[str, ...]] = ()
    response: ClassVar[Callable[..., Response]]
    frozen: ClassVar[Callable[..., Response]]
    next_branch: ClassVar[Callable[..., int]]
    piece: ClassVar[Callable[..., tuple[float, float]]]

    def __init_subclass__(cls) -> None:
        # By name: the numbers in cached kernels stay right when elements are added.
        cls.kind = zlib.crc32(cls.__name__.encode()) % 2**31

    def __post_init__(self) -> None:
        for name, value in zip(self.parameter_names(), self.values, strict=True):
            if not math.isfinite(value):
                raise ValueError(f"{type(self).__name__}: {name} must be finite, got {value}")
            if name in self.must_be_positive and not value > 0:
                raise ValueError(f"{type(self).__name__}: {name} must be positive, got {value}")
            if name in self.must_not_be_negative and not value >= 0:
                raise ValueError(f"{type(self).__name__}: {name} must not be negative, got {value}")

    @classmethod
    @cache
    def parameter_names(cls) -> tuple[str, ...]:
        """Names of the parameters, in the order of the class."""
        return tuple(entry.name for entry in fields(cls) if entry.name != "direction")

    @property
    def values(self) -> list[float]:
        """Parameters in the order of the class."""
        return [float(getattr(self, name)) for name in self.parameter_names()]

    @property
    def parameters(self) -> Array:
        """(PARAMETER_COUNT,) parameters in the order of the class, zeros behind."""
        return np.array(self.values + [0.0] * PARAMETER_COUNT)[:PARAMETER_COUNT]

    @property
    def linear(self) -> bool:
        """Whether it is part of the linear motion."""
        return self.degree == 1

    @property
    def linear_stiffness(self) -> float:
        """∂g/∂w at rest (the Jenkins element sticks), N/m."""
        return float(self._at_rest()[1])

    @property
    def linear_damping(self) -> float:
        """∂g/∂v at rest, N s/m."""
        return float(self._at_rest()[2])

    def _at_rest(self) -> Response:
        if hasattr(self, "frozen"):
            branch = self.next_branch(*self.values, 0, 0.0, 0.0, 0.0)
            return self.frozen(*self.values, branch, 0.0, 0.0, 0.0)
        return self.response(*self.values, 0.0, 0.0)

    @property
    def sliders(self) -> tuple[tuple[float, float], ...]:
        """Stiffness (N/m) and slip force (N) of the sliders that it is, for harmonic balance."""
        return ()

    @property
    def contacts(self) -> tuple[tuple[float, float, float], ...]:
        """Stiffness (N/m), gap (m) and side (±1) of the stops that it is, for harmonic balance."""
        return ()

    def along(self, direction: Array) -> LocalElement:
        """The same element on another direction."""
        return replace(self, direction=direction)

    def with_slip_force(self, factor: float) -> LocalElement:
        """The same element with a slip force, if it has one, times a factor."""
        slip = getattr(self, "slip_force", None)
        return self if slip is None or factor == 1.0 else replace(self, slip_force=factor * slip)  # type: ignore[call-arg]


class ElementSection(Section):
    """Common keys of local elements: between `point` and `other_point`, the ground when that is left out.

    side: an element on the side of the exciter acts on the drive point behind the force sensor, so its force is part
    of the measured one. rotation: it acts on the rotation of the beam's cross-section (N m and rad instead of N and m).

    Attributes:
        name: name for `--set` and messages
        point: point the element acts on
        other_point: second point; left out = the ground
        side: `exciter`: at the drive point behind the force sensor, so that the measured force contains it; it is then
            no part of the structure
        rotation: acts on the rotation of a beam's cross-section: N m, rad and their products for N, m and theirs
        reversed: acts along the negative displacement: a stop below the point instead of above
        valid_to_m: largest displacement (rad with `rotation`) at which its law was identified; left out = not limited
        modulated_by: channel that its strength follows: `current`, `voltage`, `force` or `displacement`, with the name
            of the sensor behind where a record has several, and `magnitude of` before it where its sign does not count,
            as that of a load on friction; a record that has it drives the element
        modulated_at: value of the channel at which the element's keys hold
        modulated_share: change of its strength by a unit of the channel, as a share of that at `modulated_at`
        modulated_value: value of the channel in simulations and in records without it; left out = `modulated_at`
    """

    name: Name | None = None
    point: Point
    other_point: Point | None = None
    side: Literal["structure", "exciter"] = "structure"
    rotation: bool = False
    reversed: bool = False
    valid_to_m: Positive | None = None
    modulated_by: (
        Annotated[str, Field(pattern=rf"^({MAGNITUDE_OF})?(current|voltage|force|displacement)( .+)?$")] | None
    ) = None
    modulated_at: float = 0.0
    modulated_share: float = 0.0
    modulated_value: float | None = None

    element: ClassVar[Any] = None  # class that is made of the section's own keys, in their order
    friction: ClassVar[bool] = False
    effect: ClassVar[ElementEffect | None] = None
    law: ClassVar[tuple[LawForm, ...]] = ()
    # Why the element is left out; a registry test asks for it.
    without_harmonic_balance: ClassVar[str] = ""
    without_effect: ClassVar[str] = ""
    without_law: ClassVar[str] = ""
    not_calibrated: ClassVar[tuple[str, ...]] = ()  # own keys that the diagnosis takes as given

    @classmethod
    def kind_name(cls) -> str:
        """Kind of the element, as rig files write it."""
        return str(cls.model_fields["kind"].annotation.__args__[0])  # type: ignore[union-attr]

    @classmethod
    def own_keys(cls) -> list[str]:
        """Keys that not every element has."""
        return [key for key in cls.model_fields if key != "kind" and key not in ElementSection.model_fields]

    def direction(self, structure: Structure) -> Array:
        """Direction (n,) that the element acts along.

        Raises:
            KeyError: the structure has no such point, or its points do not rotate.
        """
        along = structure.direction(self.point, self.other_point, self.rotation)
        return -along if self.reversed else along

    @model_validator(mode="after")
    def _strength_is_not_negative(self) -> ElementSection:
        if self.modulated_by is None and (self.modulated_share or self.modulated_at or self.modulated_value):
            raise ValueError("modulated_at, modulated_share and modulated_value need modulated_by")
        if self.modulation < 0.0:
            raise ValueError("modulated_share makes the strength negative at modulated_value")
        return self

    @property
    def modulation_value(self) -> float:
        """Value of the channel that the strength follows where nothing drives it."""
        return self.modulated_at if self.modulated_value is None else self.modulated_value

    @property
    def modulation(self) -> float:
        """Strength at that value over the one that the keys state."""
        return 1.0 + self.modulated_share * (self.modulation_value - self.modulated_at)

    def times(self, factor: float) -> ElementSection:
        """The element with its strength times a factor, whatever channel it followed."""
        scaled = {key: factor * getattr(self, key) for key in self.own_keys() if unit_of_key(key).startswith("N")}
        return self.model_copy(update={**scaled, "modulated_by": None, "modulated_share": 0.0, "modulated_value": None})

    @property
    def unmodulated(self) -> ElementSection:
        """The element as it is where nothing drives the channel that its strength follows."""
        return self if self.modulated_by is None else self.times(self.modulation)

    def own_values(self) -> list[Any]:
        """Values of the own keys: frequencies in Hz become rad/s, all else is taken as it is."""
        values = [(key, getattr(self, key)) for key in self.own_keys()]
        return [2.0 * np.pi * value if key.endswith("_hz") else value for key, value in values]

    @property
    def soft_at_rest(self) -> bool:
        """Whether its force is smooth and of higher than the first order: the modes at rest do not know it."""
        if not hasattr(self.element, "response") or hasattr(self.element, "next_branch"):
            return False
        _, by_displacement, by_velocity = self.element.response(*self.own_values(), 0.0, 0.0)
        return bool(by_displacement == 0.0 and by_velocity == 0.0)

    def elements(self, structure: Structure) -> tuple[LocalElement, ...]:
        """Local elements that it stands for.

        Raises:
            KeyError: as :meth:`direction`.
        """
        return (self.element(self.direction(structure), *self.own_values()),)
