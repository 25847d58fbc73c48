"""Parameters that a model already has, with the priors under which they may be re-fitted."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from math import exp, pi
from typing import Any

import numpy as np
from scipy.linalg import eigh

from nmt_core.key_units import of_rotation, unit_of_key
from nmt_core.tolerances import MODEL_PRIORS
from nmt_diagnose.effects.location import LocationKind
from nmt_diagnose.effects.rig_edit import Path, value_at, with_value
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import BeamSection, ChainSection, ForceSection, MatricesSection, ModalSection, Rig, ShakerSection
from nmt_rig.rig_model import build_structure


@dataclass(frozen=True)
class CalibrationParameter:
    """A key of the rig that is fitted: (value + offset) exp(std θ) − offset, θ of prior N(0, 1).

    Attributes:
        name: dotted path of the key.
        unit: of its value.
        path: key.
        std: relative prior standard deviation.
        place: place it belongs to.
        value: value in the model.
        offset: distance of zero from the end of the key's range, 0 for keys that are positive or negative.
    """

    name: str
    unit: str
    path: Path
    std: float
    place: LocationKind
    value: float
    offset: float = 0.0

    def apply(self, rig: Rig, theta: float) -> Rig:
        """Rig with the parameter at θ."""
        return self.moved(rig, 0.0, theta)

    def moved(self, rig: Rig, before: float, theta: float) -> Rig:
        """Rig with the parameter moved from one θ to another."""
        return rig if theta == before else with_value(rig, self.path, self.at(theta) if theta != 0.0 else self.value)

    def at(self, theta: float) -> float:
        """Value at θ."""
        return (self.value + self.offset) * exp(self.std * theta) - self.offset


@dataclass(frozen=True)
class ModeFactor(CalibrationParameter):
    """Factor on the damping or frequency of one mode of the structure.

    Attributes:
        mode: number of the undamped mode, 0 = lowest.
        count: modes that have factors.
    """

    mode: int = 0
    count: int = 1

    def moved(self, rig: Rig, before: float, theta: float) -> Rig:
        """Rig with the factor of the mode moved from one θ to another."""
        if theta == before:
            return rig
        factors = list(value_at(rig, self.path))
        factors += [factors[-1] if factors else 1.0] * (self.count - len(factors))
        factors[self.mode] = self.at(theta)
        return with_value(rig, self.path, factors)


# Coil suspension: so stiff that no test of the bench sees it.
# An exponent of a power-law distribution is greater than −1.
_OFFSETS = {"exponent": 1.0}
_SUPPORT_KEYS = (
    "clamp_rotational_stiffness_nm_rad", "clamp_lateral_stiffness_n_m", "suspension_stiffness_n_m",
    "suspension_damping_ns_m",
)  # fmt: skip
_SHAKER_KEYS = (
    "table_mass_kg", "table_stiffness_n_m", "table_damping_ns_m", "coil_mass_kg", "force_factor_n_a",
    "resistance_ohm", "inductance_h",
)  # fmt: skip


def calibration_parameters(rig: Rig) -> tuple[CalibrationParameter, ...]:
    """Parameters that the model of a rig has; keys that are zero or left out are no part of the model."""
    found: list[CalibrationParameter] = []

    def add(path: Path, place: LocationKind) -> None:
        value = value_at(rig, path)
        key = next(str(part) for part in reversed(path) if isinstance(part, str))
        if isinstance(value, int | float) and value != 0.0:
            name = ".".join(str(part) for part in path)
            offset = _OFFSETS.get(key, 0.0)
            # A clamp's rotational stiffness names its rotation itself.
            turns = rig.coordinate == "angle" and not key.endswith("_nm_rad")
            unit = of_rotation(unit_of_key(key)) if turns else unit_of_key(key)
            std = MODEL_PRIORS[key].std * abs(float(value) / (float(value) + offset))
            found.append(CalibrationParameter(name, unit, path, std, place, float(value), offset))

    structure = rig.structure
    if isinstance(structure, BeamSection):
        for key in ("youngs_modulus_pa", "density_kg_m3", "stiffness_damping_s"):
            add(("structure", key), "structure")
        for key in _SUPPORT_KEYS:
            add(("structure", key), "boundary")
    elif isinstance(structure, ChainSection):
        for key in ("masses_kg", "springs_n_m", "dampers_ns_m", "ground_springs_n_m", "ground_dampers_ns_m"):
            for index in range(len(getattr(structure, key) or ())):
                add(("structure", key, index), "boundary" if key.startswith("ground") else "structure")
    else:
        for path in model_paths(structure):
            add(path, "structure")
        if isinstance(structure, MatricesSection):
            found.extend(_of_regions(structure))
    for index, element in enumerate(rig.local_elements):
        place: LocationKind = "exciter" if element.side == "exciter" else "joint" if element.friction else "structure"
        for key in () if element.without_harmonic_balance else element.own_keys():
            if key not in element.not_calibrated:
                add(("local_elements", index, key), place)
    if isinstance(rig.exciter, ShakerSection):
        for key in _SHAKER_KEYS:
            add(("exciter", key), "exciter")
    elif isinstance(rig.exciter, ForceSection):
        add(("exciter", "newton_per_volt"), "exciter")
    else:
        add(("exciter", "acceleration_per_volt_m_s2"), "exciter")
    return tuple(found)


def _of_regions(structure: MatricesSection) -> Iterator[CalibrationParameter]:
    """Factors of regions where the rig file says how well they are known, and compliances that supports have."""
    for name, region in structure.regions.items():
        for key, std in (("stiffness_factor", region.stiffness_std), ("mass_factor", region.mass_std)):
            if std > 0.0:
                path: Path = ("structure", "regions", name, key)
                yield CalibrationParameter(".".join(map(str, path)), "1", path, std, "structure", getattr(region, key))
        for key in ("compliance_m_n", "rotational_compliance_rad_nm"):
            if (value := getattr(region, key)) > 0.0:
                path, std = ("structure", "regions", name, key), MODEL_PRIORS[key].std
                name_of = ".".join(map(str, path))
                yield CalibrationParameter(name_of, unit_of_key(key), path, std, "boundary", value)


def mode_factors(rig: Rig, lowest_hz: float, highest_hz: float) -> tuple[ModeFactor, ...]:
    """Damping of each mode of a band, where the model has one law of damping for all modes, and of finite-element
    models its frequency, which mesh and reduction leave open.

    Args:
        rig: the model; modal structures and chains have parameters of their own in ``calibration_parameters``.
        lowest_hz, highest_hz: band of the tests.
    """
    section = rig.structure
    if not isinstance(section, BeamSection | MatricesSection):
        return ()
    structure = build_structure(rig)
    squares = eigh(structure.stiffness, structure.mass, eigvals_only=True)
    frequencies = np.sqrt(np.maximum(squares, 0.0)) / (2.0 * pi)
    near = np.flatnonzero(
        (frequencies > lowest_hz / THRESHOLDS.candidates.mode_band_ratio)
        & (frequencies < highest_hz * THRESHOLDS.candidates.mode_band_ratio)
    )
    if not near.size:
        return ()
    found: list[ModeFactor] = []
    if isinstance(section, MatricesSection):
        each_now = [*section.frequency_factors, *[1.0] * frequencies.size]
        found += [_of_mode("frequency_factors", int(mode), each_now[mode], int(near[-1]) + 1) for mode in near]
    if np.any(structure.damping) and not getattr(section, "damping_ratios", None):
        # One more for all above: together they are the flexibility that they add to the band, and its phase.
        wanted = [*map(int, near), *range(int(near[-1]) + 1, frequencies.size)[:1]]
        factors_given = list(section.damping_factors) or [1.0]
        factors = [*factors_given, *[factors_given[-1]] * frequencies.size]
        found += [_of_mode("damping_factors", mode, factors[mode], wanted[-1] + 1) for mode in wanted]
    return tuple(found)


def _of_mode(key: str, mode: int, value: float, count: int) -> ModeFactor:
    return ModeFactor(
        f"structure.{key}.{mode}", "1", ("structure", key), MODEL_PRIORS[key].std, "structure", value, mode=mode,
        count=count,
    )  # fmt: skip


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
