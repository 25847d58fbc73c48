"""Effects of the clamp and of the joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from nmt_diagnose.effects.changes import Sites, has_friction, inverse, is_clamped, with_local
from nmt_diagnose.effects.effect import Effect, EffectParameter, Reported, Site
from nmt_diagnose.effects.location import Location, LocationKind
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.effects.rig_edit import with_value
from nmt_diagnose.effects.structure_effects import spots
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.model.local_elements.friction import JenkinsSection
from nmt_rig.model.local_elements.iwan import IwanSection
from nmt_rig.model.local_elements.springs import LinearSpringSection
from nmt_rig.rig import BeamSection, Rig

# Neighbours differ by 8 % in slip displacement; fewer show as corners of the cost at small amplitudes.
_JOINT_SLIDERS = 120

# Slip displacement as multiples of the largest amplitude: above 1 the contact sticks and is a spring.
SLIP_GRID = (0.03, 0.1, 0.3, 0.7)
# The same for a contact added to the model, of a tenth of the amplitude: the stiffness of a contact ranges from less
# than that of the structure to rigid, whatever force it holds.
FREE_SLIP_SHARE, FREE_SLIP_STD = 0.1, 3.0
FREE_SLIP_GRID = (3e-4, 0.03, 0.3, 1.0, 3.0, 7.0)
CLAMP_KEYS = {"rotation": "clamp_rotational_stiffness_nm_rad", "lateral": "clamp_lateral_stiffness_n_m"}
_FRICTION_REFERENCE = "Jenkins, Br. J. Appl. Phys. 13 (1962) 30; Iwan, J. Appl. Mech. 33 (1966) 893"
_POWER = EffectParameter("power", "1", "shape", grid=(0.5, 1.0))


def _compliance_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    beam = rig.structure
    if not isinstance(beam, BeamSection) or not is_clamped(rig):
        return ()
    bending = beam.youngs_modulus_pa * beam.width_m * beam.height_m**3 / 12.0
    # 1 % of the static compliance of the tip.
    scales = {"rotation": 0.01 * beam.length_m / bending, "lateral": 0.01 * beam.length_m**3 / (3.0 * bending)}
    return tuple(
        Site(Location("boundary", detail=option), {"compliance": scale}, option=option)
        for option, scale in scales.items()
        if getattr(beam, CLAMP_KEYS[option]) is None
    )


def _with_compliance(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    return with_value(rig, ("structure", CLAMP_KEYS[site.option]), 1.0 / values["compliance"])


def _clamp_friction_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    if not is_clamped(rig):
        return ()
    sizes = {
        "lateral": (0.05 * operating.effective_stiffness(1), operating.displacement[1]),
        "rotation": (0.05 * operating.omega**2 * operating.effective_inertia[1], operating.rotation[1]),
    }
    return tuple(
        Site(Location("boundary", detail=option), {"kt": kt, "slip_displacement": slip}, 1, option=option)
        for option, (kt, slip) in sizes.items()
    )


def _contact_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    return tuple(
        Site(Location.at("joint", point, other), {"kt": 0.05 * stiffness, "slip_displacement": amplitude}, point, other)
        for point, other, amplitude, stiffness in spots(rig, operating)
        if not (is_clamped(rig) and point == 1)
    )


def _with_free_slip(sites: Sites) -> Sites:
    """The same places, with a slip force for the strength and a slip displacement that is free over decades."""

    def free(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
        return tuple(
            replace(
                site,
                scales={
                    "slip_force": site.scales["kt"] * site.scales["slip_displacement"],
                    "slip_displacement": FREE_SLIP_SHARE * site.scales["slip_displacement"],
                },
            )
            for site in sites(rig, operating)
        )

    return free


def _stiffness_of(values: Mapping[str, float]) -> Mapping[str, float]:
    """Stiffness and slip displacement of a contact by its slip force."""
    slip = values["slip_displacement"]
    return {"kt": values["slip_force"] / slip, "slip_displacement": slip}


def _without_friction(sites: Sites) -> Sites:
    """The same places, of a model that has no friction."""
    return lambda rig, operating: () if has_friction(rig) else sites(rig, operating)


def _with_friction(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    slip = values["kt"] * values["slip_displacement"]
    return with_local(rig, JenkinsSection, site, tangential_stiffness_n_m=values["kt"], slip_force_n=slip)


def _taken(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    """The rig with so much less stiffness at a site as a contact there has: while it sticks, nothing changes."""
    return with_local(rig, LinearSpringSection, site, stiffness_n_m=-values["kt"])


def _friction(
    name: str, place: LocationKind, sites: Sites, equation: str, keys: str, stuck_equation: str, stuck_keys: str
) -> tuple[Effect, Effect]:
    """A slider with a spring added to the model, and one whose spring carries a part of the model's stiffness.

    The latter is for a contact that may slip and that a model without friction takes for a spring.
    """
    added = Effect(
        name=name,
        place=place,
        equation=equation,
        reference=_FRICTION_REFERENCE,
        keys=f"local_elements: {keys}",
        parameters=(
            EffectParameter("slip_force", "N"),
            EffectParameter("slip_displacement", "m", "shape", grid=FREE_SLIP_GRID, std=FREE_SLIP_STD),
        ),
        sites=_with_free_slip(sites),
        change=lambda rig, site, values: _with_friction(rig, site, _stiffness_of(values)),
        report=lambda site, values: {
            "kt": (_stiffness_of(values)["kt"], "N/m"), "slip_force": (values["slip_force"], "N"),
        },
    )  # fmt: skip
    stuck = replace(
        added,
        parameters=(
            EffectParameter("kt", "N/m"),
            EffectParameter("slip_displacement", "m", "shape", grid=SLIP_GRID),
        ),
        report=lambda site, values: {
            "kt": (values["kt"], "N/m"), "slip_force": (values["kt"] * values["slip_displacement"], "N"),
        },
        equation=stuck_equation,
        keys=f"local_elements: {stuck_keys}",
        sites=_without_friction(sites),
        change=lambda rig, site, values: _taken(_with_friction(rig, site, values), site, values),
        form="stuck in the model",
    )  # fmt: skip
    return added, stuck


def joint_location(element: ElementSection, nameless: str) -> Location:
    """Where a local element with friction sits; ``nameless`` replaces a missing name."""
    points = tuple(point for point in (element.point, element.other_point) if point)
    return Location("joint", points, detail=element.name or nameless)


def _new_joint_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    """Where micro-slip may be in a model that has no friction: any contact, and the clamp of a beam."""
    contacts = (*_contact_sites(rig, operating), *_clamp_friction_sites(rig, operating))
    return tuple(replace(site, scales={**site.scales, "power": 1.0}) for site in contacts)


def _with_new_joint(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    joint = with_local(
        rig, IwanSection, site,
        tangential_stiffness_n_m=values["kt"], slip_force_n=_joint_slip_force(values), exponent=values["power"] - 1.0,
        sliders=_JOINT_SLIDERS, partition="ratio",
    )  # fmt: skip
    return _taken(joint, site, values)


def _joint_slip_force(values: Mapping[str, float]) -> float:
    """F_S of a power law from 0 to the slip displacement: K_T times its mean."""
    power = values["power"]
    return values["kt"] * values["slip_displacement"] * power / (power + 1.0)


def _microslip_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    return tuple(
        Site(joint_location(element, str(element.point)), {"spread": 0.3, "power": 1.0}, element.point, index=index)
        for index, element in enumerate(rig.local_elements)
        if isinstance(element, JenkinsSection)
    )


def _with_microslip(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    jenkins = rig.local_elements[site.index]
    if not isinstance(jenkins, JenkinsSection):  # another explanation made a distribution of it already
        return rig
    kept = {key: getattr(jenkins, key) for key in type(jenkins).model_fields if key != "kind"}
    # The share of the power law grows from 0 (one slider).
    joint = IwanSection.model_construct(
        kind="iwan", exponent=values["power"] - 1.0, stiffness_ratio=1.0 / values["spread"], sliders=12, **kept
    )
    return with_value(rig, ("local_elements", site.index), joint)


def _new_joint_report(site: Site, values: Mapping[str, float]) -> Reported:
    slip = _joint_slip_force(values)
    return {"kt": (values["kt"], "N/m"), "slip_force": (slip, "N"), "chi": (values["power"] - 1.0, "1")}


def _microslip_report(site: Site, values: Mapping[str, float]) -> Reported:
    spread, chi = values["spread"], values["power"] - 1.0
    return {"spread": (spread, "1"), "chi": (chi, "1"), "beta": (inverse(spread), "1")}


BOUNDARY_EFFECTS: tuple[Effect, ...] = (
    Effect(
        name="clamp_compliance",
        place="boundary",
        equation="rotational (or lateral) spring k = 1/compliance at the clamp",
        reference="Ewins, Modal Testing (2000); Gorman, Free Vibration Analysis of Beams and Shafts (1975)",
        keys="structure.clamp_rotational_stiffness_nm_rad, structure.clamp_lateral_stiffness_n_m",
        parameters=(EffectParameter("compliance", "rad/(N m) or m/N"),),
        sites=_compliance_sites,
        change=_with_compliance,
        report=lambda site, values: {"k": (inverse(values["compliance"]), "N m/rad or N/m")},
        equivalents={"stinger_stiffness": "a second drive point"},
    ),
    *_friction(
        "clamp_friction", "boundary", _clamp_friction_sites,
        "Jenkins element between the ground and the point next to the clamp (displacement or rotation)",
        "jenkins at point 1, with or without rotation",
        "the same element, of stiffness kt that it takes from the model's; for a model without friction",
        "jenkins at point 1, linear_spring of −kt",
    ),
)  # fmt: skip

JOINT_EFFECTS: tuple[Effect, ...] = (
    Effect(
        name="microslip",
        place="joint",
        equation="Iwan distribution of sliders, β = 1/spread, χ = power − 1, instead of one slider",
        reference="Segalman, J. Appl. Mech. 72 (2005) 752",
        keys="local_elements: iwan instead of jenkins",
        parameters=(
            EffectParameter("spread", "1", grid=(0.3, 1.0, 3.0)),
            _POWER,
        ),
        sites=_microslip_sites,
        change=_with_microslip,
        report=_microslip_report,
    ),
    Effect(
        name="microslip",
        place="joint",
        equation="Iwan distribution of sliders up to the slip displacement, χ = power − 1, of stiffness kt that it "
        "takes from the model's; for a model without friction",
        reference="Iwan, J. Appl. Mech. 33 (1966) 893; Segalman, J. Appl. Mech. 72 (2005) 752",
        keys="local_elements: iwan, linear_spring of −kt",
        parameters=(
            EffectParameter("kt", "N/m"),
            EffectParameter("slip_displacement", "m", "shape", grid=(0.3, 1.0, 3.0)),
            _POWER,
        ),
        sites=_without_friction(_new_joint_sites),
        change=_with_new_joint,
        report=_new_joint_report,
    ),
    *_friction(
        "second_friction_contact", "joint", _contact_sites,
        "another Jenkins element, kt and slip_force = kt slip_displacement",
        "jenkins",
        "a Jenkins element of stiffness kt that it takes from the model's, slip_force = kt slip_displacement; "
        "for a model without friction",
        "jenkins, linear_spring of −kt",
    ),
)  # fmt: skip
