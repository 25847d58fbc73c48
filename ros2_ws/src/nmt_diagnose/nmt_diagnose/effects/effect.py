"""What an effect is: a change of the rig file, with parameters, places where it may sit, and its equation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_rig.rig import Rig

Place = Literal["structure", "boundary", "joint", "exciter", "force_sensor", "response_sensor", "controller", "time"]


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect.

    Attributes:
        name: as in the equation.
        unit: of its value.
        kind: ``strength``: the effect is absent at 0, value = scale · θ; ``shape``: positive, value = scale · exp(θ).
        signed: a strength may be negative.
        grid: multiples of the scale to start a fit from. A strength has one where its first-order signature vanishes
            at 0 (clipping, for example); a shape where its likelihood has several maxima.
    """

    name: str
    unit: str
    kind: Literal["strength", "shape"] = "strength"
    signed: bool = False
    grid: tuple[float, ...] = ()


@dataclass(frozen=True)
class Placement:
    """Where an effect sits, and how large it typically is there.

    Attributes:
        label: for example ``4``, ``a2``, ``rotation``; empty where there is only one place.
        scales: scale of each parameter, by name, in its unit.
        point, other_point: points of the structure (0 = none, the ground).
        index: index of the sensor or local element it concerns (−1 = none).
        option: which of several forms.
        channel: channel name of the sensor.
    """

    label: str
    scales: Mapping[str, float]
    point: int = 0
    other_point: int = 0
    index: int = -1
    option: str = ""
    channel: str = ""


Reported = Mapping[str, tuple[float, str]]


@dataclass(frozen=True)
class Effect:
    """One effect of the library.

    Attributes:
        name: fixed name.
        place: where it lies for the verdict.
        equation: term it adds.
        reference: where it is described.
        keys: keys of the rig file that it changes.
        parameters: of the effect.
        placements: (rig, operating range) -> where it may sit; empty where it does not apply.
        change: (rig, placement, values by name) -> rig with the effect; called only with some strength not 0.
        report: values -> physical parameters as they are reported; the values themselves when None.
        equivalents: effects that look alike, and the test that tells them apart.
    """

    name: str
    place: Place
    equation: str
    reference: str
    keys: str
    parameters: tuple[EffectParameter, ...]
    placements: Callable[[Rig, OperatingRange], tuple[Placement, ...]] = field(repr=False)
    change: Callable[[Rig, Placement, Mapping[str, float]], Rig] = field(repr=False)
    report: Callable[[Mapping[str, float]], Reported] | None = field(default=None, repr=False)
    equivalents: Mapping[str, str] = field(default_factory=dict)

    def apply(self, rig: Rig, placement: Placement, values: Mapping[str, float]) -> Rig:
        """Rig with the effect; the same rig where all strengths are 0."""
        strengths = [values[p.name] for p in self.parameters if p.kind == "strength"]
        if all(value == 0.0 for value in strengths):
            return rig
        return self.change(rig, placement, values)

    def reported(self, values: Mapping[str, float]) -> Reported:
        """Physical parameters as they are reported, with units."""
        if self.report is not None:
            return self.report(values)
        return {p.name: (values[p.name], p.unit) for p in self.parameters}


@dataclass(frozen=True)
class Candidate:
    """An effect at one place."""

    effect: Effect
    placement: Placement

    @property
    def label(self) -> str:
        """For example ``cubic_stiffness@4``."""
        return f"{self.effect.name}@{self.placement.label}" if self.placement.label else self.effect.name
