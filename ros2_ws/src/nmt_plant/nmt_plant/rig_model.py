"""From a rig to its model: structure, local elements, assembled system."""

from __future__ import annotations

from .model.assembly import ElectromechanicalSystem, assemble
from .model.beam import euler_bernoulli_cantilever
from .model.chain import lumped_chain
from .model.iwan import IwanJoint
from .model.local_elements import (
    CubicSpring,
    Jenkins,
    LinearDamper,
    LinearSpring,
    LocalElement,
    QuadraticDrag,
    QuadraticSpring,
    QuinticSpring,
    TanhFriction,
    TwoSidedGap,
    UnilateralStop,
)
from .model.shaker import ElectrodynamicShaker
from .model.structure import Structure
from .rig import (
    BeamSection,
    CubicSpringSection,
    ElementSection,
    IwanSection,
    JenkinsSection,
    LinearDamperSection,
    LinearSpringSection,
    QuadraticDragSection,
    QuadraticSpringSection,
    QuinticSpringSection,
    Rig,
    ShakerSection,
    TanhFrictionSection,
    TwoSidedGapSection,
    UnilateralStopSection,
)


def build_structure(rig: Rig) -> Structure:
    """Linear structure of a rig."""
    s = rig.structure
    if isinstance(s, BeamSection):
        return euler_bernoulli_cantilever(
            s.length_m,
            s.width_m,
            s.height_m,
            s.youngs_modulus_pa,
            s.density_kg_m3,
            s.elements,
            s.stiffness_damping_s,
        )
    return lumped_chain(
        s.masses_kg, s.springs_n_m, s.dampers_ns_m, s.ground_springs_n_m, s.ground_dampers_ns_m
    )


def build_element(section: ElementSection, structure: Structure) -> LocalElement:
    """Local element of one section of a rig file that stands for one element.

    Raises:
        KeyError: the structure has no such point.
        TypeError: a section of an unknown kind.
    """
    direction = structure.direction(section.point, section.other_point)
    if isinstance(section, JenkinsSection):
        return Jenkins(direction, section.tangential_stiffness_n_m, section.slip_force_n)
    if isinstance(section, CubicSpringSection):
        return CubicSpring(direction, section.stiffness_n_m3)
    if isinstance(section, QuinticSpringSection):
        return QuinticSpring(direction, section.stiffness_n_m5)
    if isinstance(section, QuadraticSpringSection):
        return QuadraticSpring(direction, section.stiffness_n_m2)
    if isinstance(section, UnilateralStopSection):
        return UnilateralStop(direction, section.stiffness_n_m, section.gap_m)
    if isinstance(section, TwoSidedGapSection):
        return TwoSidedGap(direction, section.stiffness_n_m, section.gap_m)
    if isinstance(section, QuadraticDragSection):
        return QuadraticDrag(direction, section.drag_ns2_m2)
    if isinstance(section, LinearSpringSection):
        return LinearSpring(direction, section.stiffness_n_m)
    if isinstance(section, LinearDamperSection):
        return LinearDamper(direction, section.damping_ns_m)
    if isinstance(section, TanhFrictionSection):
        return TanhFriction(direction, section.slip_force_n, section.reference_velocity_m_s)
    raise TypeError(f"no local element for {type(section).__name__}")


def build_elements(rig: Rig, structure: Structure) -> tuple[LocalElement, ...]:
    """Local elements of a rig, on the degrees of freedom of its structure; an Iwan joint becomes its sliders."""
    elements: list[LocalElement] = []
    for section in rig.local_elements:
        if isinstance(section, IwanSection):
            elements.extend(build_iwan(section).elements(structure.direction(section.point, section.other_point)))
        else:
            elements.append(build_element(section, structure))
    return tuple(elements)


def build_iwan(section: IwanSection) -> IwanJoint:
    """Iwan joint of one section of a rig file."""
    return IwanJoint(
        section.tangential_stiffness_n_m,
        section.slip_force_n,
        section.exponent,
        section.stiffness_ratio,
        section.onset_ratio,
        section.sliders,
        section.remaining_stiffness_n_m,
    )


def build_shaker(rig: Rig) -> ElectrodynamicShaker | None:
    """Shaker of a rig; None where an ideal force drives it."""
    e = rig.exciter
    if not isinstance(e, ShakerSection):
        return None
    return ElectrodynamicShaker(
        table_mass=e.table_mass_kg,
        table_stiffness=e.table_stiffness_n_m,
        table_damping=e.table_damping_ns_m,
        coil_mass=e.coil_mass_kg,
        coil_stiffness=e.coil_stiffness_n_m,
        coil_damping=e.coil_damping_ns_m,
        force_factor=e.force_factor_n_a,
        inductance=e.inductance_h,
        resistance=e.resistance_ohm,
    )


def build_system(rig: Rig) -> ElectromechanicalSystem:
    """Structure, local elements and exciter of a rig as one system."""
    structure = build_structure(rig)
    return assemble(structure, build_elements(rig, structure), rig.drive_point, build_shaker(rig))


def input_per_volt(rig: Rig) -> float:
    """Input of the system for 1 V of drive: 1 with a shaker, N/V with an ideal force."""
    return 1.0 if isinstance(rig.exciter, ShakerSection) else float(rig.exciter.newton_per_volt)
