"""Effects of the exciter: stinger, amplifier, suspension, force factor."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from nmt_diagnose.effects.changes import Sites, added, with_local
from nmt_diagnose.effects.effect import Effect, EffectParameter, Site
from nmt_diagnose.effects.location import Location
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.effects.rig_edit import with_value
from nmt_rig.model.local_elements.springs import CubicSpringSection, LinearSpringSection
from nmt_rig.rig import BeamSection, Rig, ShakerSection, ShakingTableSection

LARGE_SIGNAL = "Klippel, J. Audio Eng. Soc. 54 (2006) 907 (large-signal parameters of electrodynamic transducers)"


def _stinger_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    if isinstance(rig.exciter, ShakingTableSection):
        return ()
    point = rig.drive_point
    scales = {"lateral": 0.02 * operating.effective_stiffness(point)}
    if isinstance(rig.structure, BeamSection):
        scales["rotation"] = 0.02 * operating.omega**2 * operating.effective_inertia[point]
    return tuple(Site(Location("exciter", detail=o), {"k": k}, point, option=o) for o, k in scales.items())


def _suspension_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    if not isinstance(rig.exciter, ShakerSection):
        return ()
    amplitude = operating.displacement[rig.drive_point]
    size = max(rig.exciter.table_stiffness_n_m, 0.1 * operating.effective_stiffness(rig.drive_point))
    return (Site(Location("exciter"), {"k": 0.05 * size / amplitude**2}, rig.drive_point),)


def _shaker(scale: Callable[[ShakerSection, OperatingRange], float], name: str) -> Sites:
    def sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
        if not isinstance(rig.exciter, ShakerSection):
            return ()
        return (Site(Location("exciter"), {name: scale(rig.exciter, operating)}),)

    return sites


def _with_saturation(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    return with_value(rig, ("exciter", "amplifier_saturation_v"), values["inverse_square"] ** -0.5)


EXCITER_EFFECTS: tuple[Effect, ...] = (
    Effect(
        name="stinger_stiffness",
        place="exciter",
        equation="k x or k θ at the drive point, on the exciter's side of the force sensor",
        reference="Ewins, Modal Testing (2000)",
        keys="local_elements: linear_spring, side exciter, with or without rotation",
        parameters=(EffectParameter("k", "N/m or N m/rad"),),
        sites=_stinger_sites,
        change=lambda rig, site, values: with_local(
            rig, LinearSpringSection, site, side="exciter", stiffness_n_m=values["k"]
        ),
        equivalents={"clamp_compliance": "a second drive point", "added_mass": "a second drive point"},
    ),
    Effect(
        name="amplifier_saturation",
        place="exciter",
        equation="V tanh(u/V) instead of u, strength 1/V²",
        reference="static saturation; compare the memoryless amplifier model of Rapp (1991)",
        keys="exciter.amplifier_saturation_v",
        parameters=(EffectParameter("inverse_square", "1/V²"),),
        sites=_shaker(lambda shaker, operating: 0.03 / operating.voltage**2, "inverse_square"),
        change=_with_saturation,
        report=lambda site, values: {
            "V": (values["inverse_square"] ** -0.5 if values["inverse_square"] > 0.0 else float("inf"), "V")
        },
    ),
    Effect(
        name="source_impedance",
        place="exciter",
        equation="R + R_s in the coil's circuit",
        reference="McConnell and Varoto, Vibration Testing (2008)",
        keys="exciter.source_resistance_ohm",
        parameters=(EffectParameter("R", "Ω"),),
        sites=_shaker(lambda shaker, operating: 0.1 * shaker.resistance_ohm, "R"),
        change=added("R", "exciter", "source_resistance_ohm"),
    ),
    Effect(
        name="suspension_cubic",
        place="exciter",
        equation="k_T3 x³ of the table's suspension",
        reference=LARGE_SIGNAL,
        keys="local_elements: cubic_spring, side exciter",
        parameters=(EffectParameter("k", "N/m³", signed=True),),
        sites=_suspension_sites,
        change=lambda rig, site, values: with_local(
            rig, CubicSpringSection, site, side="exciter", stiffness_n_m3=values["k"]
        ),
        equivalents={"force_factor_symmetric": "a second drive point"},
    ),
    Effect(
        name="force_factor_symmetric",
        place="exciter",
        equation="G (1 + b₂ x²) in force and back-EMF",
        reference=LARGE_SIGNAL,
        keys="exciter.force_factor_quadratic_per_m2",
        parameters=(EffectParameter("b2", "1/m²", signed=True),),
        sites=_shaker(lambda shaker, operating: 0.05 / operating.coil_displacement**2, "b2"),
        change=added("b2", "exciter", "force_factor_quadratic_per_m2"),
        equivalents={"suspension_cubic": "a second drive point"},
    ),
    Effect(
        name="force_factor_asymmetric",
        place="exciter",
        equation="G (1 + b₁ x) in force and back-EMF",
        reference=LARGE_SIGNAL,
        keys="exciter.force_factor_linear_per_m",
        parameters=(EffectParameter("b1", "1/m", signed=True),),
        sites=_shaker(lambda shaker, operating: 0.05 / operating.coil_displacement, "b1"),
        change=added("b1", "exciter", "force_factor_linear_per_m"),
    ),
)
