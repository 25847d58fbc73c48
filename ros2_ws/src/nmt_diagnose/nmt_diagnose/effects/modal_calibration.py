"""Parameters of structures given by modes or matrices that may be re-fitted, and how stiffness changes in them."""

from __future__ import annotations

import math
from typing import Any

from nmt_diagnose.effects.rig_edit import Path
from nmt_rig.rig import MatricesSection, ModalSection


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
