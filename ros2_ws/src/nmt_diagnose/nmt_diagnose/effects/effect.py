"""What an effect is: a change of the rig file, with parameters, places where it may sit, and its equation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from nmt_diagnose.effects.location import Cause, Location, LocationKind
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_rig.rig import Rig


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
        std: prior standard deviation of ln of a shape; 0 = that of all shapes.
        even: multiple of the scale to start a strength from where the observations do not show its first order, such as
            the frequency of an even force; 0 = always at zero.
    """

    name: str
    unit: str
    kind: Literal["strength", "shape"] = "strength"
    signed: bool = False
    grid: tuple[float, ...] = ()
    even: float = 0.0
    std: float = 0.0


@dataclass(frozen=True)
class Site:
    """A place of a rig where an effect may sit: where, how large it typically is there, and what it needs to know.

    Attributes:
        location: where.
        scales: scale of each parameter, by name, in its unit.
        point, other_point: points of the structure that it acts on (0 = none, the ground).
        index: index of the sensor or local element it concerns (−1 = none).
        option: which of several forms: a direction, or a key of the rig file.
        reference: size that a strength is counted from, in the unit of the channel; the frequency of a line, Hz; or a
            speed, m/s.
        starts: strengths other than zero from which a fit begins, by name, in their unit.
        begun: all parameters from which fits begin instead, by name, in their unit, where data determine them jointly.
        limits: largest magnitude that physics allows a parameter, by name, in its unit; none for those left out.
        band_hz: band that shows a resonance here, Hz; (0, 0) where none does.
        existing: what the model itself has of a strength at this place, by name, in its unit: so much of it may be
            taken off, although what is added cannot be negative.
    """

    location: Location
    scales: Mapping[str, float]
    point: int = 0
    other_point: int = 0
    index: int = -1
    option: str = ""
    reference: float = 0.0
    starts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    begun: tuple[Mapping[str, float], ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)
    existing: Mapping[str, float] = field(default_factory=dict)
    band_hz: tuple[float, float] = (0.0, 0.0)


Reported = Mapping[str, tuple[float, str]]


@dataclass(frozen=True)
class Effect:
    """One effect of the library.

    Attributes:
        name: fixed name.
        place: where it lies for the verdict; that of a channel lies at the force sensor where the channel is the force.
        equation: term it adds.
        reference: where it is described.
        keys: keys of the rig file that it changes.
        parameters: of the effect.
        sites: (rig, operating range) -> where it may sit; empty where it does not apply.
        change: (rig, site, values by name) -> rig with the effect; called only with some strength not 0.
        report: values -> physical parameters as they are reported; the values themselves when None.
        equivalents: effects that look alike, and the test that distinguishes them.
        form: which of several forms of one name it is; empty where they never compete.
        ordinary: standard deviation of the strength in an ordinary measuring chain, where no error of the chain stands
            for it; 0 = one does, or it has no such tolerance.
        alters: what the model is where its property is larger and smaller than the real one, such as too stiff and too
            soft; empty: the model lacks the effect.
        factor: key of the rig file that multiplies the reference of its sites; empty where none does.
    """

    name: str
    place: LocationKind
    equation: str
    reference: str
    keys: str
    parameters: tuple[EffectParameter, ...]
    sites: Callable[[Rig, OperatingRange], tuple[Site, ...]] = field(repr=False)
    change: Callable[[Rig, Site, Mapping[str, float]], Rig] = field(repr=False)
    report: Callable[[Site, Mapping[str, float]], Reported] | None = field(default=None, repr=False)
    equivalents: Mapping[str, str] = field(default_factory=dict)
    form: str = ""
    ordinary: float = 0.0
    alters: tuple[str, ...] = ()
    factor: tuple[str | int, ...] = ()

    def apply(self, rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
        """Rig with the effect; the same rig where all strengths are 0."""
        strengths = [values[p.name] for p in self.parameters if p.kind == "strength"]
        if all(value == 0.0 for value in strengths):
            return rig
        return self.change(rig, site, values)

    def reported(self, site: Site, values: Mapping[str, float]) -> Reported:
        """Physical parameters at a site as they are reported, with units."""
        if self.report is not None:
            return self.report(site, values)
        return {p.name: (values[p.name], p.unit) for p in self.parameters}


@dataclass(frozen=True)
class Candidate:
    """An effect at one place."""

    effect: Effect
    site: Site

    @property
    def cause(self) -> Cause:
        """What it is in an explanation."""
        return Cause(self.effect.name, self.site.location, self.effect.form)

    @property
    def label(self) -> str:
        """For example ``cubic_stiffness@4``."""
        return self.cause.label

    def signed(self, parameter: EffectParameter) -> bool:
        """Whether a strength may be negative here."""
        return parameter.signed or parameter.name in self.site.existing

    def lower(self, parameter: EffectParameter) -> float:
        """Lower bound of a dimensionless parameter."""
        if parameter.kind != "strength" or parameter.signed:
            return -math.inf
        existing = self.site.existing.get(parameter.name, 0.0)
        return -existing / self.site.scales[parameter.name] if existing else 0.0
