"""Parameters of structures given by modes or matrices that may be re-fitted, and how stiffness changes in them."""

from __future__ import annotations

import math
from typing import Any

from nmt_diagnose.effects.rig_edit import Path
from nmt_rig.rig import MatricesSection, ModalSection

# Relative standard deviations and why: what a modal test or a finite-element model leaves open.
MODEL_PRIORS: dict[str, tuple[float, str]] = {
    "frequency_hz": (0.005, "another day, another temperature, mounted again"),
    "damping_ratio": (0.2, "fits of lightly damped modes, cables and mounting"),
    "modal_mass_kg": (0.05, "scale of the measured shape: calibration of force cell and accelerometers"),
    "participation": (0.03, "mode shape over the whole structure, from few points or a model"),
    "mass_factor": (0.02, "density and what is not modelled, against weighing"),
    "stiffness_factor": (0.05, "finite-element model before updating: material, thickness, joints"),
    "damping_factor": (0.3, "damping of a model is a guess"),
    "damping_ratios": (0.3, "damping of a model is a guess"),
}


def model_paths(structure: ModalSection | MatricesSection) -> tuple[Path, ...]:
    """Keys of the structure that are its parameters: every mode's, or the factors of the matrices.

    A participation is one only where it is given.
    """
    if isinstance(structure, ModalSection):
        keys = ("frequency_hz", "damping_ratio", "modal_mass_kg", "participation")
        return tuple(("structure", "modes", mode, key) for mode in range(len(structure.modes)) for key in keys)
    paths: list[Path] = [("structure", "mass_factor"), ("structure", "stiffness_factor")]
    if structure.damping_ns_m is not None:
        paths.append(("structure", "damping_factor"))
    paths += [("structure", "damping_ratios", index) for index in range(len(structure.damping_ratios or ()))]
    return tuple(paths)


def with_stiffness(structure: ModalSection | MatricesSection, factor: float) -> dict[str, Any]:
    """Keys of the structure with all its stiffness times ``factor`` and its damping matrix as it was."""
    root = math.sqrt(factor)
    if isinstance(structure, ModalSection):
        # c = 2 ζ ω m stays as it is.
        modes = [
            mode.model_copy(
                update={"frequency_hz": root * mode.frequency_hz, "damping_ratio": mode.damping_ratio / root}
            )
            for mode in structure.modes
        ]
        return {"modes": modes}
    change: dict[str, Any] = {"stiffness_factor": structure.stiffness_factor * factor}
    return change
