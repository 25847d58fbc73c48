"""From a rig to its model: structure, local elements, assembled system."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_rig.model.assembly import ElectromechanicalSystem, assemble
from nmt_rig.model.beam import Supports, euler_bernoulli_beam
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.linear_modes import modal_damping_matrix, sticking_modes
from nmt_rig.model.local_elements.attachments import Attachment, AttachmentSection
from nmt_rig.model.local_elements.dampers import LinearDamper, LinearDamperSection
from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.local_elements.springs import LinearSpring, LinearSpringSection
from nmt_rig.model.modal_structure import Mode, modal_structure
from nmt_rig.model.packed_matrix import unpacked
from nmt_rig.model.shaker import ElectrodynamicShaker
from nmt_rig.model.shaking_table import ShakingTable, effective_mass
from nmt_rig.model.structure import Structure
from nmt_rig.rig_sections import AnyExciter, Rig, ShakerSection, ShakingTableSection
from nmt_rig.structure_sections import BeamSection, ChainSection, MatricesSection, ModalSection


def build_structure(rig: Rig) -> Structure:
    """Linear structure of a rig: added masses and those of response sensors, loss factor, oscillators.

    Raises:
        BenchError: numbers that make no structure, or negative masses that leave it without inertia.
    """
    return completed_structure(build_plain_structure(rig), rig)


def completed_structure(structure: Structure, rig: Rig) -> Structure:
    """The structure of `build_plain_structure` with what its section says mode by mode, and oscillators.

    These have dampers of their own.
    """
    s = rig.structure
    if isinstance(s, MatricesSection) and s.frequency_factors:
        structure = structure.with_frequency_factors(s.frequency_factors)
    if s.damping_factors:
        structure = structure.with_damping_factors(s.damping_factors)
    if s.loss_factor:
        structure = structure.with_loss_factor(s.loss_factor)
    for item in s.oscillators:
        omega = 2.0 * np.pi * item.frequency_hz
        structure = structure.with_oscillator(item.point, item.mass_kg, omega, item.damping_ratio)
    return structure


def build_plain_structure(rig: Rig) -> Structure:
    """Structure of a rig as `build_structure` without what is said of modes and oscillators; errors as there."""
    s = rig.structure
    try:
        structure = _bare_structure(s)
    except ValueError as error:
        raise BenchError(f"the structure of rig {rig.name} cannot be built: {error}; check its section.") from error
    masses = [(added.point, added.mass_kg) for added in s.added_masses]
    masses += [
        (rig.sensor_point(sensor), sensor.mass_kg)
        for sensor in rig.sensors
        if sensor.mass_kg != 0.0 and sensor.quantity in ("displacement", "velocity", "acceleration")
    ]
    if masses:
        try:
            structure = structure.with_masses(masses)
        except ValueError as error:
            raise BenchError(
                f"the masses of rig {rig.name} do not fit: {error}; check structure.added_masses and the sensors' "
                "mass_kg."
            ) from error
    return structure


def _bare_structure(s: BeamSection | ChainSection | ModalSection | MatricesSection) -> Structure:
    if isinstance(s, BeamSection):
        return euler_bernoulli_beam(
            s.length_m,
            s.width_m,
            s.height_m,
            s.youngs_modulus_pa,
            s.density_kg_m3,
            s.elements,
            s.stiffness_damping_s,
            s.mesh_refinement,
            s.boundary,
            Supports(
                s.clamp_rotational_stiffness_nm_rad,
                s.clamp_lateral_stiffness_n_m,
                s.suspension_stiffness_n_m,
                s.suspension_damping_ns_m,
            ),
        )
    if isinstance(s, ChainSection):
        return lumped_chain(s.masses_kg, s.springs_n_m, s.dampers_ns_m, s.ground_springs_n_m, s.ground_dampers_ns_m)
    if isinstance(s, ModalSection):
        modes = [
            Mode(
                2.0 * np.pi * mode.frequency_hz,
                mode.damping_ratio,
                tuple(s.shape(number)),
                mode.modal_mass_kg,
                mode.participation,
            )
            for number, mode in enumerate(s.modes)
        ]
        residual = s.residual
        if residual is None:
            return modal_structure(s.points, modes, base_motion=s.base_motion)
        return modal_structure(
            s.points,
            modes,
            np.array(residual.flexibility_m_n),
            2.0 * np.pi * residual.frequency_hz,
            residual.damping_ratio,
            s.base_motion,
        )
    return _matrix_structure(s)


def _matrix_structure(s: MatricesSection) -> Structure:
    mass, stiffness = np.array(s.mass_kg), np.array(s.stiffness_n_m)
    _add_regions(s, mass, stiffness)
    kept = s.moving_rows  # points come first among the rows, so that their numbers stay
    mass, stiffness = mass[np.ix_(kept, kept)], stiffness[np.ix_(kept, kept)]
    damping = np.zeros_like(mass)
    if s.damping_ns_m is not None:
        damping = np.array(s.damping_ns_m)[np.ix_(kept, kept)]
    elif s.damping_ratios is not None:
        damping = modal_damping_matrix(mass, stiffness, s.damping_ratios)
    # A load that was given is of the mass as given; both grow together.
    load = None
    if s.base_load_kg is not None:
        load = s.mass_factor * np.array(s.base_load_kg)[kept]
    elif s.base_vector is not None:
        load = s.mass_factor * (mass @ np.array(s.base_vector)[kept])
    motion = {} if s.base_vector is None else {entry.point: s.base_vector[entry.row] for entry in s.points_at}
    return Structure(
        s.mass_factor * mass,
        s.damping_factor * damping,
        s.stiffness_factor * stiffness,
        {entry.point: entry.row for entry in s.points_at},
        {entry.point: entry.rotation_row for entry in s.points_at if entry.rotation_row is not None},
        base_load=load,
        base_motion=motion,
    )


def _add_regions(s: MatricesSection, mass: NDArray[np.float64], stiffness: NDArray[np.float64]) -> None:
    """Change mass and stiffness to what regions say; the factor on all stiffness is none on springs of a support."""
    for region in s.regions.values():
        if region.stiffness_factor != 1.0:
            stiffness += (region.stiffness_factor - 1.0) * unpacked(str(region.stiffness_n_m))
        if region.mass_factor != 1.0:
            mass += (region.mass_factor - 1.0) * unpacked(str(region.mass_kg))
        for rows, compliance in region.supports:
            if compliance:
                stiffness[rows, rows] += 1.0 / (compliance * len(region.nodes) * s.stiffness_factor)


def build_elements(rig: Rig, structure: Structure) -> tuple[LocalElement, ...]:
    """Local elements on the structure of a rig; an Iwan joint becomes its sliders.

    Those on the side of the exciter and attachments are not among them.
    """
    return tuple(
        e
        for section in rig.local_elements
        if section.side == "structure"
        for e in section.unmodulated.elements(structure)
    )


def build_exciter_elements(rig: Rig, structure: Structure) -> tuple[LocalElement, ...]:
    """Local elements on the side of the exciter, on the degrees of freedom of the structure."""
    return tuple(e for s in rig.local_elements if s.side == "exciter" for e in s.unmodulated.elements(structure))


def build_attachments(rig: Rig, structure: Structure) -> tuple[Attachment, ...]:
    """Attachments of a rig: local elements with unknowns of their own."""
    sections = (section.unmodulated for section in rig.local_elements)
    return tuple(s.attachment(structure) for s in sections if isinstance(s, AttachmentSection))


def build_resting_elements(rig: Rig, structure: Structure) -> tuple[LocalElement, ...]:
    """What sticking modes are computed with: local elements of the structure, and attachments as they are at rest."""
    elements = list(build_elements(rig, structure))
    for attachment in build_attachments(rig, structure):
        if attachment.resting_stiffness:
            elements.append(LinearSpring(attachment.direction, attachment.resting_stiffness))
        if attachment.resting_damping:
            elements.append(LinearDamper(attachment.direction, attachment.resting_damping))
    return tuple(elements)


def refuse_beyond_harmonic_balance(rig: Rig, with_exciter: bool) -> None:
    """References by harmonic balance are steady states of time-invariant systems without couplings.

    Sensors, converters, the clock and what the loop holds are not part of a reference: it is what a perfect test with
    perfect sensors would measure.

    Args:
        rig: the rig.
        with_exciter: the reference contains the exciter; without, what belongs to it does not matter.

    Raises:
        BenchError: a key that harmonic balance does not cover.
    """
    for index, section in enumerate(rig.local_elements):
        if with_exciter:
            covered = not section.without_harmonic_balance or (
                isinstance(section, AttachmentSection) and section.in_forced_response
            )
        else:
            covered = not section.without_harmonic_balance or section.side == "exciter"
        if not covered:
            _refuse(rig, f"local_elements.{index} ({section.kind})")
    for name, value in rig.drift.model_dump().items():
        if value != 0.0:
            _refuse(rig, f"drift.{name}")
    exciter = rig.exciter
    if not with_exciter:
        return
    if len(rig.all_exciters) > 1:
        _refuse(rig, "several exciters")
    if isinstance(exciter, ShakerSection):
        if exciter.amplifier_saturation_v is not None:
            _refuse(rig, "exciter.amplifier_saturation_v")
        for name in ("force_factor_linear_per_m", "force_factor_quadratic_per_m2"):
            if getattr(exciter, name) != 0.0:
                _refuse(rig, f"exciter.{name}")
    for index, section in enumerate(rig.local_elements):
        linear = isinstance(section, LinearSpringSection | LinearDamperSection)
        if section.side == "exciter" and not linear and not section.rotation:
            _refuse(rig, f"local_elements.{index}.side exciter for a nonlinear element")


def without_exciter_effects(rig: Rig) -> Rig:
    """The rig with an exciter that harmonic balance covers; the structure stays as it is."""
    exciter = rig.exciter
    if isinstance(exciter, ShakerSection):
        linear = {"force_factor_linear_per_m": 0.0, "force_factor_quadratic_per_m2": 0.0}
        exciter = exciter.model_copy(update={"amplifier_saturation_v": None, **linear})
    elements = [section for section in rig.local_elements if section.side == "structure"]
    return rig.model_copy(update={"exciter": exciter, "local_elements": elements})


def _refuse(rig: Rig, key: str) -> None:
    raise BenchError(
        f"rig {rig.name} has {key}, which the reference by harmonic balance does not cover; "
        "run the test without reference, or take the key out for the reference."
    )


def build_shaker(rig: Rig) -> ElectrodynamicShaker | None:
    """Shaker of a rig, of several the first; None where an ideal force or a shaking table drives it."""
    return shaker_of(rig.exciter)


def shaker_of(e: AnyExciter) -> ElectrodynamicShaker | None:
    """The shaker that a section describes; None where it is another exciter."""
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
        resistance=e.resistance_ohm + e.source_resistance_ohm,
        force_factor_linear=e.force_factor_linear_per_m,
        force_factor_quadratic=e.force_factor_quadratic_per_m2,
    )


SOFT_SUSPENSION_HZ = 0.5
"""Suspension, below every test, of a table whose rig file gives none although absolute displacements are measured."""
_INTEGRATED = ("displacement", "velocity")


def build_table(rig: Rig, structure: Structure) -> ShakingTable | None:
    """Shaking table under a rig; None where something else drives it.

    Raises:
        BenchError: the table does not move the target mode, or the point it refers to is a node of it.
    """
    e = rig.exciter
    if not isinstance(e, ShakingTableSection):
        return None
    mass = e.effective_mass_kg
    if mass is None:
        modes = sticking_modes(structure, build_resting_elements(rig, structure), rig.test.mode)
        try:
            mass = effective_mass(structure, modes.full_shapes[:, rig.test.mode - 1], e.point)
        except ValueError as error:
            raise BenchError(
                f"the shaking_table of rig {rig.name} has no effective mass on mode {rig.test.mode}: {error}; choose "
                "another exciter.point or test.mode."
            ) from error
    suspension = e.suspension_hz
    if suspension is None and e.responses == "absolute" and any(s.quantity in _INTEGRATED for s in rig.sensors):
        suspension = SOFT_SUSPENSION_HZ
    return ShakingTable(
        mass,
        None if e.bandwidth_hz is None else 2.0 * np.pi * e.bandwidth_hz,
        None if suspension is None else 2.0 * np.pi * suspension,
        e.suspension_damping_ratio,
        e.responses == "absolute",
    )


def build_system(rig: Rig, structure: Structure | None = None) -> ElectromechanicalSystem:
    """Structure, local elements and exciter of a rig as one system.

    Args:
        rig: the rig.
        structure: its structure, if that has been built already.

    Raises:
        BenchError: as :func:`build_structure` and :func:`build_table`.
    """
    structure = build_structure(rig) if structure is None else structure
    return assemble(
        structure,
        build_elements(rig, structure),
        rig.exciter_points,
        [shaker_of(exciter) for exciter in rig.all_exciters],
        build_attachments(rig, structure),
        build_exciter_elements(rig, structure),
        build_table(rig, structure),
    )


def input_per_volt(rig: Rig) -> float:
    """Input of the system for 1 V of drive: 1 with a shaker, N/V with an ideal force, m/s²/V with a shaking table."""
    return inputs_per_volt(rig)[0]


def inputs_per_volt(rig: Rig) -> tuple[float, ...]:
    """`input_per_volt` of every exciter."""
    return tuple(_input_per_volt(exciter) for exciter in rig.all_exciters)


def _input_per_volt(e: AnyExciter) -> float:
    if isinstance(e, ShakerSection):
        return 1.0
    if isinstance(e, ShakingTableSection):
        return float(e.acceleration_per_volt_m_s2)
    return float(e.newton_per_volt)
