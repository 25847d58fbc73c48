"""How far parameters of a model are off when nobody made a mistake: priors of the truth, and draws from them."""

from __future__ import annotations

import math

import numpy as np

from nmt_blind.cases.rig_edits import Edit, rig_values
from nmt_rig.rig import Rig

# Relative standard deviations (of the logarithm) by section and key.
STRUCTURE_PRIORS = {
    "youngs_modulus_pa": 0.01,  # tables of alloys differ by as much
    "density_kg_m3": 0.01,  # weighing and rulers
    "stiffness_damping_s": 0.2,  # material damping is never known better
    "masses_kg": 0.01,
    "springs_n_m": 0.03,
    "dampers_ns_m": 0.2,
    "ground_springs_n_m": 0.2,
    "ground_dampers_ns_m": 0.3,
    "mass_factor": 0.02,  # of a finite-element model, against weighing
    "stiffness_factor": 0.05,
    "damping_factor": 0.3,
    "damping_ratios": 0.3,
}
MODE_PRIORS = {
    "frequency_hz": 0.005,  # another day, mounted again
    "damping_ratio": 0.2,
    "modal_mass_kg": 0.05,  # calibration of the test that the shapes come from
}
ELEMENT_PRIORS = {
    "tangential_stiffness_n_m": 0.1,  # from assembly to assembly
    "slip_force_n": 0.1,
    "exponent": 0.1,
    "onset_ratio": 0.2,
    "remaining_stiffness_n_m": 0.03,
}
EXCITER_PRIORS = {
    "table_mass_kg": 0.05,  # data sheets, and what is screwed on
    "table_stiffness_n_m": 0.05,
    "table_damping_ns_m": 0.1,
    "coil_mass_kg": 0.03,
    "force_factor_n_a": 0.03,
    "resistance_ohm": 0.03,
    "inductance_h": 0.1,
}
# Beyond so many standard deviations somebody would have noticed.
LARGEST_SHIFT = 2.0
# An exponent of a distribution must stay above -1.
_STEEPEST = -0.98


def parameters(rig: Rig) -> dict[tuple[str | int, ...], tuple[float, float]]:
    """Value and relative prior standard deviation of all parameters that a model has, by path."""
    values = rig_values(rig)
    found: dict[tuple[str | int, ...], tuple[float, float]] = {}

    def add(path: tuple[str | int, ...], value: object, std: float) -> None:
        if isinstance(value, list):
            for index, entry in enumerate(value):
                add((*path, index), entry, std)
        elif isinstance(value, int | float) and value != 0.0:
            found[path] = float(value), std

    for key, std in STRUCTURE_PRIORS.items():
        add(("structure", key), values["structure"].get(key), std)
    if values["structure"]["kind"] == "modal":
        for number, mode in enumerate(values["structure"]["modes"]):
            for key, std in MODE_PRIORS.items():
                add(("structure", "modes", number, key), mode.get(key), std)
    for number, element in enumerate(values["local_elements"]):
        for key, std in ELEMENT_PRIORS.items():
            add(("local_elements", number, key), element.get(key), std)
    for key, std in EXCITER_PRIORS.items():
        add(("exciter", key), values["exciter"].get(key), std)
    return found


def shifted(path: tuple[str | int, ...], value: float, std: float, deviation: float) -> Edit:
    """The edit that moves a parameter by so many standard deviations."""
    result = value * math.exp(std * deviation)
    return Edit(path, max(result, _STEEPEST) if path[-1] == "exponent" else result)


def draw_shifts(rig: Rig, generator: np.random.Generator) -> tuple[Edit, ...]:
    """Edits that shift every parameter of a model at random."""
    found = parameters(rig)
    deviations = np.clip(generator.standard_normal(len(found)), -LARGEST_SHIFT, LARGEST_SHIFT)
    return tuple(
        shifted(path, value, std, float(deviation))
        for (path, (value, std)), deviation in zip(found.items(), deviations, strict=True)
    )
