"""Effects of the structure: springs, drag, damping, mass and stops at its points."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, cast

import numpy as np

from nmt_core.key_units import unit_of_key
from nmt_diagnose.effects.changes import added, local_element, with_local
from nmt_diagnose.effects.effect import Effect, EffectParameter, Site
from nmt_diagnose.effects.location import Location
from nmt_diagnose.effects.operating_range import LackingMode, OperatingRange
from nmt_diagnose.effects.rig_edit import with_value
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.element_uses import ElementEffect
from nmt_rig.model.local_elements import SECTIONS
from nmt_rig.model.local_elements.contacts import UnilateralStopSection
from nmt_rig.model.local_elements.dampers import PowerLawDamperSection
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.rig import AddedMassSection, BeamSection, OscillatorSection, Rig
from nmt_rig.rig_model import build_plain_structure

MISSING_MODE = "missing_mode"
BELOW = "below"
"""Form of a stop on the side of negative displacement."""
Sizes = Callable[[float, float, float], Mapping[str, float]]


def spots(rig: Rig, operating: OperatingRange) -> Iterator[tuple[int, int, float, float]]:
    """Point, other point (0 = ground), amplitude (m) and effective stiffness (N/m) where an element may sit.

    Every point to the ground, and the pairs of the operating range. Points that hardly move are left out.
    """
    largest = max(operating.displacement.values())
    for point in rig.structure.points:
        amplitude = operating.displacement[point]
        if amplitude > THRESHOLDS.candidates.least_motion_share * largest:
            yield point, 0, amplitude, operating.effective_stiffness(point)
    for (point, other), (amplitude, mass) in operating.pairs.items():
        if amplitude > THRESHOLDS.candidates.least_motion_share * largest:
            yield point, other, amplitude, operating.omega**2 * mass


def local_sites(
    rig: Rig, operating: OperatingRange, sizes: Sizes, reference: Callable[[float, float], float] = lambda a, w: 0.0
) -> tuple[Site, ...]:
    """A site for each spot; ``sizes`` gives the scales from amplitude, effective stiffness and ω."""
    return tuple(
        Site(
            Location.at("structure", point, other), sizes(amplitude, stiffness, operating.omega), point, other,
            reference=reference(amplitude, operating.omega),
        )
        for point, other, amplitude, stiffness in spots(rig, operating)
    )  # fmt: skip


def _local(section: type[ElementSection], effect: ElementEffect) -> Effect:
    """The effect that a local element says it is."""
    strength, *shapes = effect.parameters
    units = {name: unit_of_key(key) for name, key in effect.parameters.items()}

    def sizes(a: float, k: float, w: float) -> Mapping[str, float]:
        return {
            strength: effect.strength(effect.share * k, a, w),
            **{name: a if units[name] == "m" else 1.0 for name in shapes},
        }

    parameters = (
        EffectParameter(strength, units[strength], signed=effect.signed, even=effect.even),
        *(EffectParameter(name, units[name], "shape", grid=effect.starts) for name in shapes),
    )
    return Effect(
        effect.name, "structure", effect.equation, effect.reference, f"local_elements: {section.kind_name()}",
        parameters,
        sites=partial(local_sites, sizes=sizes), change=local_element(section, effect.parameters),
        equivalents=effect.equivalents,
    )  # fmt: skip


def largest_air_drag(rig: Rig, operating: OperatingRange, point: int) -> float:
    """Largest c₂ that air can give a structure, ½ ρ C_d A, N s²/m².

    The area is that of a beam's face; for anything else that of a sheet with the mass that moves, of 1 mm of aluminium.
    """
    structure = rig.structure
    if isinstance(structure, BeamSection):
        area = structure.length_m * structure.width_m
    else:
        area = min(operating.effective_mass[point], operating.total_mass) / THRESHOLDS.candidates.least_sheet_kg_m2
    return 0.5 * THRESHOLDS.candidates.air_density_kg_m3 * THRESHOLDS.candidates.largest_drag_coefficient * area


def _air_drag(effect: Effect) -> Effect:
    """At most what air can give."""

    def sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
        found = effect.sites(rig, operating)
        return tuple(replace(site, limits={"c2": largest_air_drag(rig, operating, site.point)}) for site in found)

    return replace(effect, sites=sites)


def excess_exponent(values: Mapping[str, float]) -> float:
    """Exponent of a power-law damper beyond 1 that a rig file takes."""
    return min(values["excess"], THRESHOLDS.candidates.largest_power_excess)


def _with_power_law(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    """A damper that takes a force at the reference speed."""
    exponent = 1.0 + excess_exponent(values)
    coefficient = values["force"] / site.reference**exponent
    return with_local(rig, PowerLawDamperSection, site, coefficient_n_sp_mp=coefficient, exponent=exponent)


def _below(effect: Effect) -> Effect:
    """A stop on the other side of a point, or against the other of two."""
    section = UnilateralStopSection
    return replace(
        effect, equation="k min(x + g, 0)", keys=f"local_elements: {section.kind_name()}, reversed", form=BELOW,
        change=local_element(section, section.effect.parameters, reversed=True),
        report=lambda site, values: {"k": (values["k"], "N/m"), "gap_below": (values["gap"], "m")},
    )  # fmt: skip


def _power_law(effect: Effect) -> Effect:
    """By its force at the largest speed, as its coefficient depends on the exponent."""
    force, excess = effect.parameters
    return replace(
        effect,
        parameters=(replace(force, unit="N"), excess),
        sites=partial(cast(Any, effect.sites), reference=lambda a, w: w * a),
        change=_with_power_law,
        report=lambda site, values: {"force": (values["force"], "N"), "p": (1.0 + excess_exponent(values), "1")},
    )


def _mass_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    return tuple(
        Site(
            Location.at("structure", point),
            {"m": operating.typical_mass(point)},
            point,
            existing=_added_there(rig, point),
        )
        for point in rig.structure.points
        if operating.displacement[point]
        > THRESHOLDS.candidates.least_motion_share * max(operating.displacement.values())
    )


def _added_there(rig: Rig, point: int) -> dict[str, float]:
    """Masses that the model itself has added at a point, kg."""
    mass = sum(item.mass_kg for item in rig.structure.added_masses if item.point == point)
    return {"m": mass} if mass > 0.0 else {}


def _with_mass(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    added = AddedMassSection.model_construct(point=site.point, mass_kg=values["m"])
    return with_value(rig, ("structure", "added_masses"), [*rig.structure.added_masses, added])


def _oscillator_starts(mode: LackingMode, point: int, mass: float, hanging: bool) -> Mapping[str, float] | None:
    """Parameters of an oscillator of some mass that gives the model the pole of the responses; None where none does.

    With the receptance H of the point and the dynamic stiffness Z of the addition, 1 + H Z = 0 at the pole s. That of
    the oscillator has 1/Z = 1/(s² m) + 1/(k + s c); where its mass is taken from the structure, Z − s² m counts.
    """
    s, inertia = mode.pole, mode.pole**2 * mass
    added = -1.0 / mode.receptance[point] + (inertia if hanging else 0.0)
    spring = 1.0 / (1.0 / added - 1.0 / inertia)
    damper = spring.imag / s.imag
    stiffness = spring.real - s.real * damper
    if not stiffness > 0.0:
        return None
    omega = math.sqrt(stiffness / mass)
    ratio = damper / (2.0 * omega * mass)
    hertz = omega / (2.0 * math.pi)
    if not mode.band_hz[0] < hertz < mode.band_hz[1]:
        return None
    return {"m": mass, "f": hertz, "zeta": max(ratio, THRESHOLDS.candidates.least_oscillator_damping)}


def _oscillator_sites(hanging: bool) -> Callable[[Rig, OperatingRange], tuple[Site, ...]]:
    def sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
        found = []
        for number, mode in enumerate(operating.lacking):
            hertz = abs(mode.pole) / (2.0 * math.pi)
            for point, _, _, _ in (spot for spot in spots(rig, operating) if not spot[1]):
                detail = f"{point} at {hertz:.4g} Hz" if number else str(point)
                scale = operating.typical_mass(point)
                masses = [100.0 * share * scale for share in THRESHOLDS.candidates.oscillator_mass_shares]
                masses = [mass for mass in masses if not hanging or mass < _mass_at(rig, point)]
                begun = [_oscillator_starts(mode, point, mass, hanging) for mass in masses]
                known = tuple(start for start in begun if start is not None)
                if known:
                    location = Location("structure", (point,), detail=detail)
                    scales = {"m": scale, "f": hertz, "zeta": -mode.pole.real / abs(mode.pole)}
                    found.append(Site(location, scales, point, begun=known, band_hz=mode.band_hz))
        return tuple(found)

    return sites


def _mass_at(rig: Rig, point: int) -> float:
    """What may be taken off at a point until the structure is without inertia in some motion, kg."""
    structure = build_plain_structure(rig)
    selector = structure.selector(point)
    return float(1.0 / (selector @ np.linalg.solve(structure.mass, selector)))


def _with_oscillator(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    """The rig with a mass on a spring, whose frequency stays within the band that shows it."""
    low, high = site.band_hz
    oscillator = OscillatorSection.model_construct(
        point=site.point, mass_kg=values["m"], frequency_hz=min(max(values["f"], low), high),
        damping_ratio=values["zeta"],
    )  # fmt: skip
    return with_value(rig, ("structure", "oscillators"), [*rig.structure.oscillators, oscillator])


def _with_hanging_mass(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    """The same, its mass taken from the structure: what moves slowly is the model's."""
    return _with_mass(_with_oscillator(rig, site, values), site, {"m": -values["m"]})


_MISSING_MODE = Effect(
    name=MISSING_MODE, place="structure", equation="one more degree of freedom: m on k = (2πf)² m and c = 4πζfm",
    reference="Ewins, Modal Testing (2000); Den Hartog, Mechanical Vibrations (1956), section 3.2",
    keys="structure.oscillators",
    parameters=(
        EffectParameter("m", "kg"), EffectParameter("f", "Hz", "shape", std=0.3),
        EffectParameter("zeta", "1", "shape", std=1.0),
    ),
    sites=_oscillator_sites(hanging=False), change=_with_oscillator,
)  # fmt: skip
_ELASTIC_TRANSMISSION = replace(
    _MISSING_MODE, equation="the same, m taken from what the model has at the point: an elastic transmission",
    keys="structure.oscillators, structure.added_masses of −m",
    sites=_oscillator_sites(hanging=True), change=_with_hanging_mass, form="of the model's mass",
)  # fmt: skip
_STRUCTURAL_DAMPING = Effect(
    name="structural_damping", place="structure", equation="K (1 + iη)",
    reference="Crandall, J. Sound Vib. 11 (1970) 3; as modal viscous damping ζ_r = η/2, exact at each resonance",
    keys="structure.loss_factor", parameters=(EffectParameter("eta", "1"),),
    sites=lambda rig, operating: (Site(Location("structure"), {"eta": 0.005}),),
    change=added("eta", "structure", "loss_factor"),
    equivalents={"viscous_damping": "several modes in a random test"},
)  # fmt: skip
_ADDED_MASS = Effect(
    name="added_mass", place="structure", equation="m a", reference="Ewins, Modal Testing (2000)",
    keys="structure.added_masses", parameters=(EffectParameter("m", "kg"),),
    sites=_mass_sites, change=_with_mass,
    equivalents={"sensor_mass": "a test with the sensor taken off", "stinger_stiffness": "a second drive point"},
)  # fmt: skip
_MORE: dict[str, Callable[[Effect], tuple[Effect, ...]]] = {
    "air_drag": lambda effect: (_air_drag(effect),),
    "one_sided_stop": lambda effect: (effect, _below(effect)),
    "power_law_damping": lambda effect: (_power_law(effect), _STRUCTURAL_DAMPING),
    "viscous_damping": lambda effect: (effect, _ADDED_MASS, _MISSING_MODE, _ELASTIC_TRANSMISSION),
}
"""Properties of an effect beyond its element; effects without an element follow those that they resemble."""


def _structure_effects() -> Iterator[Effect]:
    """Effects that are one local element, in the order of the registry, with what they are more."""
    for section in SECTIONS:
        if section.effect is not None:
            effect = _local(section, section.effect)
            yield from _MORE[effect.name](effect) if effect.name in _MORE else (effect,)


STRUCTURE_EFFECTS = tuple(_structure_effects())
