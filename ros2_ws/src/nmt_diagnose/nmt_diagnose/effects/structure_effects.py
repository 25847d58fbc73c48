"""Effects of the structure: springs, drag, damping, mass and stops at its points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from nmt_diagnose.effects.changes import added, kind_of, local_element, with_local
from nmt_diagnose.effects.effect import Effect, EffectParameter, Site
from nmt_diagnose.effects.location import Location
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.effects.rig_edit import with_value
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.local_elements.contacts import TwoSidedGapSection, UnilateralStopSection
from nmt_rig.model.local_elements.dampers import (
    AmplitudeDamperSection,
    LinearDamperSection,
    PowerLawDamperSection,
    QuadraticDragSection,
)
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.model.local_elements.springs import CubicSpringSection, QuadraticSpringSection, QuinticSpringSection
from nmt_rig.rig import AddedMassSection, BeamSection, Rig

# Gaps as multiples of the largest amplitude at their point: a stop that is not reached does nothing.
GAP_GRID = (0.1, 0.3, 0.5, 0.7, 0.9)
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


def _local(
    name: str, equation: str, section: type[ElementSection], keys: Mapping[str, str],
    parameters: tuple[EffectParameter, ...], sizes: Sizes, reference: str, **more: Any,
) -> Effect:  # fmt: skip
    """An effect that is one local element; ``keys`` maps parameters to keys of its section."""
    defaults: dict[str, Any] = {"sites": partial(local_sites, sizes=sizes), "change": local_element(section, keys)}
    kind = f"local_elements: {kind_of(section)}"
    return Effect(name, "structure", equation, reference, kind, parameters, **(defaults | more))


def _spring(
    name: str, equation: str, section: type[ElementSection], power: int, unit: str, share: float, **how: Any
) -> Effect:
    """A power of the displacement, of a share of the linear force at the largest amplitude."""
    return _local(
        name, equation, section, {"k": f"stiffness_n_m{power}"},
        (EffectParameter("k", unit, signed=True, **how),),
        lambda a, k, w: {"k": share * k / a ** (power - 1)}, "Nayfeh and Mook, Nonlinear Oscillations (1979)",
    )  # fmt: skip


def _stop(name: str, equation: str, section: type[ElementSection]) -> Effect:
    return _local(
        name, equation, section, {"k": "stiffness_n_m", "gap": "gap_m"},
        (EffectParameter("k", "N/m"), EffectParameter("gap", "m", "shape", grid=GAP_GRID)),
        lambda a, k, w: {"k": 0.1 * k, "gap": a}, "Kerschen et al., Mech. Syst. Signal Process. 20 (2006) 505",
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


def _drag_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    sites = local_sites(rig, operating, lambda a, k, w: {"c2": 0.005 * k / (w**2 * a)})
    return tuple(replace(site, limits={"c2": largest_air_drag(rig, operating, site.point)}) for site in sites)


def _excess(values: Mapping[str, float]) -> float:
    """Exponent of a power-law damper beyond 1 that a rig file takes."""
    return min(values["excess"], THRESHOLDS.candidates.largest_power_excess)


def _with_power_law(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    """A damper that takes a force at the reference speed."""
    exponent = 1.0 + _excess(values)
    coefficient = values["force"] / site.reference**exponent
    return with_local(rig, PowerLawDamperSection, site, coefficient_n_sp_mp=coefficient, exponent=exponent)


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


STRUCTURE_EFFECTS: tuple[Effect, ...] = (
    _spring("cubic_stiffness", "k x³", CubicSpringSection, 3, "N/m³", 0.02),
    _spring("quintic_stiffness", "k x⁵", QuinticSpringSection, 5, "N/m⁵", 0.02),
    _spring("quadratic_stiffness", "k x²", QuadraticSpringSection, 2, "N/m²", 0.05, even=4.0),
    _local(
        "air_drag", "c₂ v |v|, |c₂| ≤ ½ ρ C_d A", QuadraticDragSection, {"c2": "drag_ns2_m2"},
        (EffectParameter("c2", "N s²/m²"),), lambda a, k, w: {},
        "Baker, Woolam and Young, Int. J. Mech. Sci. 9 (1967) 743; Keulegan and Carpenter, "
        "J. Res. Natl. Bur. Stand. 60 (1958) 423",
        sites=_drag_sites,
    ),
    _local(
        "amplitude_damping", "c x² v", AmplitudeDamperSection, {"c": "damping_ns_m3"},
        (EffectParameter("c", "N s/m³"),), lambda a, k, w: {"c": 0.02 * k / (w * a**2)},
        "Zaitsev et al., Nonlinear Dyn. 67 (2012) 859",
    ),
    _local(
        "power_law_damping", "F (|v|/v₀)ᵖ sgn v, p = 1 + excess, v₀ the largest speed", PowerLawDamperSection, {},
        (EffectParameter("force", "N"), EffectParameter("excess", "1", "shape", grid=(0.5, 2.0))), lambda a, k, w: {},
        "Ruzicka and Derby, Influence of Damping in Vibration Isolation (1971)",
        sites=partial(local_sites, sizes=lambda a, k, w: {"force": 0.005 * k * a, "excess": 1.0},
                      reference=lambda a, w: w * a),
        change=_with_power_law,
        report=lambda site, values: {"force": (values["force"], "N"), "p": (1.0 + _excess(values), "1")},
    ),
    Effect(
        name="structural_damping", place="structure", equation="K (1 + iη)",
        reference="Crandall, J. Sound Vib. 11 (1970) 3; as modal viscous damping ζ_r = η/2, exact at each resonance",
        keys="structure.loss_factor", parameters=(EffectParameter("eta", "1"),),
        sites=lambda rig, operating: (Site(Location("structure"), {"eta": 0.005}),),
        change=added("eta", "structure", "loss_factor"),
        equivalents={"viscous_damping": "several modes in a random test"},
    ),
    _local(
        "viscous_damping", "c v", LinearDamperSection, {"c": "damping_ns_m"},
        (EffectParameter("c", "N s/m"),), lambda a, k, w: {"c": 0.005 * k / w}, "linear damper",
        equivalents={"structural_damping": "several modes in a random test"},
    ),
    Effect(
        name="added_mass", place="structure", equation="m a", reference="Ewins, Modal Testing (2000)",
        keys="structure.added_masses", parameters=(EffectParameter("m", "kg"),),
        sites=_mass_sites, change=_with_mass,
        equivalents={"sensor_mass": "a test with the sensor taken off", "stinger_stiffness": "a second drive point"},
    ),
    _stop("one_sided_stop", "k max(x − g, 0)", UnilateralStopSection),
    _stop("two_sided_gap", "k (x ∓ g) beyond ±g", TwoSidedGapSection),
)  # fmt: skip
