"""The one table of ordinary uncertainties of a measuring chain and a model.

Checks of recordings, the diagnosis, the sidecar's defaults and the generator of blind cases read it: cases are drawn
from what the diagnosis assumes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from nmt_core.threshold import threshold


@dataclass(frozen=True)
class ChainTolerances:
    """What an ordinary laboratory's measuring chain is off by; a sidecar, rig file or calibration sheet may say other.

    Standard deviations, but for those that are called largest.
    """

    gain: float = threshold(
        0.01, "1",
        "Calibration sheets state 0.5 to 1 %; cables and mounting add.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[tolerances.gain]",
    )  # fmt: skip
    transverse: float = threshold(
        0.005, "1",
        "Recorded share of motion elsewhere: transverse sensitivity up to 5 %, or shape errors near nodes.",
        "tests/diagnose/test_ordinary_effects.py::test_a_pick_up_within_its_tolerance_is_no_effect",
    )  # fmt: skip
    force_factor: float = threshold(
        0.03, "1",
        "Force per ampere falls off centre and with the magnet's warmth.",
        "tests/record/test_current_as_force.py::test_the_factor_of_a_current_is_in_the_budget",
    )  # fmt: skip
    zero: float = threshold(
        0.1, "1",
        "Zero over the largest value: an untared bridge.",
        "tests/diagnose/test_records_as_they_are.py::test_the_zero_of_a_sensor_is_an_error_of_the_record",
    )  # fmt: skip
    phase_deg: float = threshold(
        0.2, "°",
        "A high-pass of 0.1 Hz leads by this at 30 Hz.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[tolerances.phase_deg]",
    )  # fmt: skip
    delay_s: float = threshold(
        1e-5, "s",
        "Between channels: a multiplexer at 100 000 samples per second, filter spread.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[tolerances.delay_s]",
    )  # fmt: skip
    shared_delay_s: float = threshold(
        1e-4, "s",
        "All sensors of a kind against the drive: shared filters.",
        "tests/diagnose/test_threshold_edges_of_fits.py::test_a_threshold_decides[tolerances.shared_delay_s]",
    )  # fmt: skip
    clock: float = threshold(
        3e-5, "1",
        "Converter crystals: 25 to 50 parts in a million.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[tolerances.clock]",
    )  # fmt: skip
    mains: float = threshold(
        1e-3, "1",
        "Ordinary hum over the largest fundamental: 60 dB.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[tolerances.mains]",
    )  # fmt: skip
    drive_harmonic: float = threshold(
        1e-3, "1",
        "Unrecorded harmonics 2 and 3 of an amplifier over its fundamental.",
        "tests/diagnose/test_threshold_numbers.py::test_a_drive_is_distorted_by_a_thousandth",
    )  # fmt: skip
    loop_phase_deg: float = threshold(
        1.0, "°",
        "Phase offset of a loop's measuring chain, all levels alike.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[tolerances.loop_phase_deg]",
    )  # fmt: skip
    lock_phase_deg: float = threshold(
        0.5, "°",
        "Phase offset of each level: lock tolerates about a degree.",
        "tests/diagnose/test_threshold_edges_of_measurements.py::test_a_threshold_decides[tolerances.lock_phase_deg]",
    )  # fmt: skip
    resonance_shift: float = threshold(
        3e-4, "1",
        "Steel loses 3e-4 of its modulus per kelvin.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[tolerances.resonance_shift]",
    )  # fmt: skip
    amplitude_scale: float = threshold(
        0.01, "1",
        "Scale of amplitudes from a file without sensor data.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[tolerances.amplitude_scale]",
    )  # fmt: skip
    image_share: float = threshold(
        0.6, "1",
        "Images of a hold sum to a sawtooth, rms 0.58.",
        "tests/diagnose/test_threshold_edges.py::test_a_threshold_decides[tolerances.image_share]",
    )  # fmt: skip


TOLERANCES = ChainTolerances()
"""The values that are in force."""


class Prior(NamedTuple):
    """How well a parameter of a model is known.

    Attributes:
        std: relative standard deviation, of the logarithm.
        reason: what leaves it open.
    """

    std: float
    reason: str


MODEL_PRIORS: dict[str, Prior] = {
    "youngs_modulus_pa": Prior(0.01, "alloy tables agree within 1 to 2 %"),
    "density_kg_m3": Prior(0.01, "weighing a beam of ruler accuracy; stands for the cross-section too"),
    "stiffness_damping_s": Prior(0.2, "material damping is known within tens of percent only"),
    "clamp_rotational_stiffness_nm_rad": Prior(0.2, "estimated from a static test at best"),
    "clamp_lateral_stiffness_n_m": Prior(0.2, "estimated from a static test at best"),
    "suspension_stiffness_n_m": Prior(0.1, "soft springs or cords, by their sag"),
    "suspension_damping_ns_m": Prior(0.3, "damping of a model is a guess"),
    "compliance_m_n": Prior(0.2, "estimated from a static test at best"),
    "rotational_compliance_rad_nm": Prior(0.2, "estimated from a static test at best"),
    "masses_kg": Prior(0.01, "weighed, but screws, cables and adhesive come on top"),
    "springs_n_m": Prior(0.03, "leaf springs: thickness enters cubed"),
    "dampers_ns_m": Prior(0.2, "material and joint damping"),
    "ground_springs_n_m": Prior(0.2, "suspension cords"),
    "ground_dampers_ns_m": Prior(0.3, "suspension cords"),
    "tangential_stiffness_n_m": Prior(0.1, "contact stiffness, repeatability of assembly"),
    "slip_force_n": Prior(0.1, "friction coefficient and preload"),
    "exponent": Prior(0.1, "fitted to a few loops of the joint"),
    "onset_ratio": Prior(0.2, "fitted to a few loops of the joint"),
    "stiffness_ratio": Prior(0.2, "fitted to a few loops of the joint"),
    "remaining_stiffness_n_m": Prior(0.03, "elastic path parallel to the joint"),
    "stiffness_n_m": Prior(0.05, "static test of a spring or stop"),
    "stiffness_n_m2": Prior(0.1, "fit of a static curve"),
    "stiffness_n_m3": Prior(0.1, "fit of a static curve"),
    "stiffness_n_m5": Prior(0.2, "fit of a static curve"),
    "gap_m": Prior(0.1, "feeler gauge"),
    "damping_ns_m": Prior(0.2, "damping"),
    "drag_ns2_m2": Prior(0.2, "drag coefficient"),
    "damping_ns_m3": Prior(0.2, "fit of decays"),
    "damping_ns_m5": Prior(0.2, "fit of decays"),
    "kinetic_force_n": Prior(0.1, "friction coefficient and preload"),
    "static_force_n": Prior(0.1, "friction coefficient and preload"),
    "decay_velocity_m_s": Prior(0.3, "fit of a friction curve"),
    "belt_velocity_m_s": Prior(0.02, "tachometer of the belt"),
    "coefficient_n_sp_mp": Prior(0.2, "fit of decays"),
    "reference_velocity_m_s": Prior(0.3, "fit of a friction curve"),
    "table_mass_kg": Prior(0.05, "data sheet, plus fixture and stinger"),
    "table_stiffness_n_m": Prior(0.05, "data sheet; changes with temperature"),
    "table_damping_ns_m": Prior(0.1, "data sheet, if at all"),
    "coil_mass_kg": Prior(0.03, "data sheet"),
    "force_factor_n_a": Prior(0.03, "data sheet"),
    "resistance_ohm": Prior(0.03, "copper changes by 0.4 % per kelvin"),
    "inductance_h": Prior(0.1, "changes with frequency"),
    "newton_per_volt": Prior(0.03, "gain of amplifier and exciter as a data sheet gives it"),
    "acceleration_per_volt_m_s2": Prior(0.03, "gain of amplifier and table as a data sheet gives it"),
    "damping_factors": Prior(3.0, "a law of damping fitted to one mode says little of the others"),
    "frequency_factors": Prior(1e-3, "mesh and reduction of a finite-element model"),
    "frequency_hz": Prior(0.005, "another day, another temperature, mounted again"),
    "damping_ratio": Prior(0.2, "fits of lightly damped modes, cables and mounting"),
    "modal_mass_kg": Prior(0.05, "scale of the measured shape: calibration of force cell and accelerometers"),
    "participation": Prior(0.03, "mode shape over the whole structure, from few points or a model"),
    "mass_factor": Prior(0.02, "density and what is not modelled, against weighing"),
    "stiffness_factor": Prior(0.05, "finite-element model before updating: material, thickness, joints"),
    "damping_factor": Prior(0.3, "damping of a model is a guess"),
    "damping_ratios": Prior(0.3, "damping of a model is a guess"),
}
"""Parameters of a model by key of its rig file: what a data sheet, a ruler or a modal test leaves open."""
