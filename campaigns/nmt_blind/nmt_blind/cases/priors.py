"""How far parameters of a model are off without a mistake: priors of the truth, and draws from them."""

from __future__ import annotations

import math

import numpy as np

from nmt_blind.cases.rig_edits import Edit, rig_values
from nmt_core.tolerances import MODEL_PRIORS
from nmt_rig.rig import Rig

# Keys by section whose values are shifted, by the standard deviations of the table of priors.
STRUCTURE_KEYS = (
    "youngs_modulus_pa",
    "density_kg_m3",
    "stiffness_damping_s",
    "masses_kg",
    "springs_n_m",
    "dampers_ns_m",
    "ground_springs_n_m",
    "ground_dampers_ns_m",
    "mass_factor",
    "stiffness_factor",
    "damping_factor",
    "damping_ratios",
)
MODE_KEYS = (
    "frequency_hz",
    "damping_ratio",
    "modal_mass_kg",
)
ELEMENT_KEYS = (
    "tangential_stiffness_n_m",
    "slip_force_n",
    "exponent",
    "onset_ratio",
    "remaining_stiffness_n_m",
)
EXCITER_KEYS = (
    "table_mass_kg",
    "table_stiffness_n_m",
    "table_damping_ns_m",
    "coil_mass_kg",
    "force_factor_n_a",
    "resistance_ohm",
    "inductance_h",
)
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

    for key in STRUCTURE_KEYS:
        add(("structure", key), values["structure"].get(key), MODEL_PRIORS[key].std)
    if values["structure"]["kind"] == "modal":
        for number, mode in enumerate(values["structure"]["modes"]):
            for key in MODE_KEYS:
                add(("structure", "modes", number, key), mode.get(key), MODEL_PRIORS[key].std)
    for number, element in enumerate(values["local_elements"]):
        for key in ELEMENT_KEYS:
            add(("local_elements", number, key), element.get(key), MODEL_PRIORS[key].std)
    for key in EXCITER_KEYS:
        add(("exciter", key), values["exciter"].get(key), MODEL_PRIORS[key].std)
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
