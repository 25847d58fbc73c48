"""Effects of the structure: springs, drag, damping, mass and stops at its points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Literal

from nmt_diagnose.effects.effect import Effect, EffectParameter, Site
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.effects.placement import Placement
from nmt_diagnose.effects.rig_edit import with_element, with_value
from nmt_rig.model.local_elements.contacts import TwoSidedGapSection, UnilateralStopSection
from nmt_rig.model.local_elements.dampers import (
    AmplitudeDamperSection,
    LinearDamperSection,
    PowerLawDamperSection,
    QuadraticDragSection,
)
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.model.local_elements.springs import CubicSpringSection, QuadraticSpringSection, QuinticSpringSection
from nmt_rig.rig import AddedMassSection, BeamSection, ChainSection, Rig

# Gaps as multiples of the largest amplitude at their point: a stop that is not reached does nothing.
GAP_GRID = (0.1, 0.3, 0.5, 0.7, 0.9)
# Density of air, and the drag coefficient of a plate that swings by about its width, where it is largest.
_AIR_KG_M3, _LARGEST_DRAG_COEFFICIENT = 1.2, 10.0
_SHEET_KG_M2 = 2.7
# Exponents of a power law beyond 1 that a rig file takes.
_LARGEST_EXCESS = 9.0
Sizes = Callable[[float, float, float], Mapping[str, float]]


def spots(rig: Rig, operating: OperatingRange) -> Iterator[tuple[int, int, float, float]]:
    """Point, other point (0 = ground), amplitude (m) and effective stiffness (N/m) where an element may sit.

    Every point to the ground; in a chain also neighbours to one another. Points that hardly move are left out.
    """
    largest = max(operating.displacement.values())
    for point in rig.structure.points:
        amplitude = operating.displacement[point]
        if amplitude > 1e-3 * largest:
            yield point, 0, amplitude, operating.effective_stiffness(point)
    if isinstance(rig.structure, ChainSection):
        for point in list(rig.structure.points)[:-1]:
            pair = operating.pair(point, point + 1)
            if pair is not None and pair[0] > 1e-3 * largest:
                yield point, point + 1, pair[0], operating.omega**2 * pair[1]


def local_sites(rig: Rig, operating: OperatingRange, sizes: Sizes) -> tuple[Site, ...]:
    """A site for each spot; ``sizes`` gives the scales from amplitude, effective stiffness and ω."""
    return tuple(
        Site(Placement.at("structure", point, other), sizes(amplitude, stiffness, operating.omega), point, other)
        for point, other, amplitude, stiffness in spots(rig, operating)
    )


def local_element(section: type[ElementSection], keys: Mapping[str, str]) -> Callable[..., Rig]:
    """Change that adds one local element; ``keys`` maps parameters to keys of its section."""

    def change(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
        settings: dict[str, Any] = {key: values[name] for name, key in keys.items()}
        settings["point"] = site.point
        if site.other_point:
            settings["other_point"] = site.other_point
        kind = section.model_fields["kind"].annotation.__args__[0]  # type: ignore[union-attr]
        return with_element(rig, section.model_construct(kind=kind, **settings))  # type: ignore[arg-type]

    return change


def _single(
    name: str, equation: str, parameter: EffectParameter, section: type[ElementSection], key: str, size: Sizes,
    reference: str, equivalents: Mapping[str, str] | None = None, force: Literal["", "elastic", "dissipative"] = "",
) -> Effect:  # fmt: skip
    return Effect(
        name=name,
        place="structure",
        equation=equation,
        reference=reference,
        keys=f"local_elements: {section.model_fields['kind'].annotation.__args__[0]}",  # type: ignore[union-attr]
        parameters=(parameter,),
        sites=partial(local_sites, sizes=size),
        change=local_element(section, {parameter.name: key}),
        equivalents=equivalents or {},
        force=force,
    )


def _stop(name: str, equation: str, section: type[ElementSection]) -> Effect:
    return Effect(
        name=name,
        place="structure",
        equation=equation,
        reference="Kerschen et al., Mech. Syst. Signal Process. 20 (2006) 505",
        keys=f"local_elements: {section.model_fields['kind'].annotation.__args__[0]}",  # type: ignore[union-attr]
        parameters=(EffectParameter("k", "N/m"), EffectParameter("gap", "m", "shape", grid=GAP_GRID)),
        sites=partial(local_sites, sizes=lambda a, k, w: {"k": 0.1 * k, "gap": a}),
        change=local_element(section, {"k": "stiffness_n_m", "gap": "gap_m"}),
    )


def largest_air_drag(rig: Rig, operating: OperatingRange, point: int) -> float:
    """Largest c₂ that air can give a structure, ½ ρ C_d A, N s²/m².

    The area is that of a beam's face; for anything else that of a sheet with the mass that moves, of 1 mm of aluminium.
    """
    structure = rig.structure
    if isinstance(structure, BeamSection):
        area = structure.length_m * structure.width_m
    else:
        area = min(operating.effective_mass[point], operating.total_mass) / _SHEET_KG_M2
    return 0.5 * _AIR_KG_M3 * _LARGEST_DRAG_COEFFICIENT * area


def _drag_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    sites = local_sites(rig, operating, lambda a, k, w: {"c2": 0.005 * k / (w**2 * a)})
    return tuple(replace(site, limits={"c2": largest_air_drag(rig, operating, site.point)}) for site in sites)


def _power_law_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    return tuple(
        Site(
            Placement.at("structure", point, other), {"force": 0.005 * stiffness * amplitude, "excess": 1.0},
            point, other, reference=operating.omega * amplitude,
        )
        for point, other, amplitude, stiffness in spots(rig, operating)
    )  # fmt: skip


def _power_law(site: Site, values: Mapping[str, float]) -> tuple[float, float]:
    """Coefficient and exponent of a damper that takes a force at the reference speed."""
    exponent = 1.0 + min(values["excess"], _LARGEST_EXCESS)
    return values["force"] / site.reference**exponent, exponent


def _with_power_law(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    coefficient, exponent = _power_law(site, values)
    settings: dict[str, Any] = {"other_point": site.other_point} if site.other_point else {}
    element = PowerLawDamperSection.model_construct(
        kind="power_law_damper", point=site.point, coefficient_n_sp_mp=coefficient, exponent=exponent, **settings
    )
    return with_element(rig, element)


def _mass_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    return tuple(
        Site(Placement.at("structure", point), {"m": operating.typical_mass(point)}, point)
        for point in rig.structure.points
        if operating.displacement[point] > 1e-3 * max(operating.displacement.values())
    )


def _with_mass(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    added = AddedMassSection.model_construct(point=site.point, mass_kg=values["m"])
    return with_value(rig, ("structure", "added_masses"), [*rig.structure.added_masses, added])


def _with_loss(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    return with_value(rig, ("structure", "loss_factor"), rig.structure.loss_factor + values["eta"])


STRUCTURE_EFFECTS: tuple[Effect, ...] = (
    _single(
        "cubic_stiffness", "k x³", EffectParameter("k", "N/m³", signed=True), CubicSpringSection, "stiffness_n_m3",
        lambda a, k, w: {"k": 0.02 * k / a**2}, "Nayfeh and Mook, Nonlinear Oscillations (1979)",
        force="elastic",
    ),
    _single(
        "quintic_stiffness", "k x⁵", EffectParameter("k", "N/m⁵", signed=True), QuinticSpringSection,
        "stiffness_n_m5", lambda a, k, w: {"k": 0.02 * k / a**4}, "Nayfeh and Mook, Nonlinear Oscillations (1979)",
        force="elastic",
    ),
    _single(
        "quadratic_stiffness", "k x²", EffectParameter("k", "N/m²", signed=True, even=4.0), QuadraticSpringSection,
        "stiffness_n_m2", lambda a, k, w: {"k": 0.05 * k / a}, "Nayfeh and Mook, Nonlinear Oscillations (1979)",
        force="elastic",
    ),
    Effect(
        name="air_drag", place="structure", equation="c₂ v |v|, |c₂| ≤ ½ ρ C_d A",
        reference="Baker, Woolam and Young, Int. J. Mech. Sci. 9 (1967) 743; Keulegan and Carpenter, "
        "J. Res. Natl. Bur. Stand. 60 (1958) 423",
        keys="local_elements: quadratic_drag",
        parameters=(EffectParameter("c2", "N s²/m²", signed=True),),
        sites=_drag_sites, change=local_element(QuadraticDragSection, {"c2": "drag_ns2_m2"}),
        force="dissipative",
    ),
    _single(
        "amplitude_damping", "c x² v", EffectParameter("c", "N s/m³"), AmplitudeDamperSection, "damping_ns_m3",
        lambda a, k, w: {"c": 0.02 * k / (w * a**2)}, "Zaitsev et al., Nonlinear Dyn. 67 (2012) 859",
        force="dissipative",
    ),
    Effect(
        name="power_law_damping", place="structure", equation="F (|v|/v₀)ᵖ sgn v, p = 1 + excess, v₀ the largest speed",
        reference="Ruzicka and Derby, Influence of Damping in Vibration Isolation (1971)",
        keys="local_elements: power_law_damper",
        parameters=(EffectParameter("force", "N"), EffectParameter("excess", "1", "shape", grid=(0.5, 2.0))),
        sites=_power_law_sites, change=_with_power_law,
        report=lambda site, values: {"force": (values["force"], "N"),
                               "p": (1.0 + min(values["excess"], _LARGEST_EXCESS), "1")},
        force="dissipative",
    ),
    Effect(
        name="structural_damping", place="structure", equation="K (1 + iη)",
        reference="Crandall, J. Sound Vib. 11 (1970) 3; as modal viscous damping ζ_r = η/2, exact at each resonance",
        keys="structure.loss_factor", parameters=(EffectParameter("eta", "1"),),
        sites=lambda rig, operating: (Site(Placement("structure"), {"eta": 0.005}),), change=_with_loss,
        equivalents={"viscous_damping": "several modes in a random test"},
    ),
    _single(
        "viscous_damping", "c v", EffectParameter("c", "N s/m", signed=True), LinearDamperSection, "damping_ns_m",
        lambda a, k, w: {"c": 0.005 * k / w}, "linear damper",
        {"structural_damping": "several modes in a random test"},
    ),
    Effect(
        name="added_mass", place="structure", equation="m a", reference="Ewins, Modal Testing (2000)",
        keys="structure.added_masses", parameters=(EffectParameter("m", "kg", signed=True),),
        sites=_mass_sites, change=_with_mass,
        equivalents={"sensor_mass": "a test with the sensor taken off", "stinger_stiffness": "a second drive point"},
    ),
    _stop("one_sided_stop", "k max(x − g, 0)", UnilateralStopSection),
    _stop("two_sided_gap", "k (x ∓ g) beyond ±g", TwoSidedGapSection),
)  # fmt: skip
