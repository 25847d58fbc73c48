"""Parameters that a model already has, with the priors under which they may be re-fitted."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, pi

import numpy as np
from scipy.linalg import eigh

from nmt_core.key_units import of_rotation, unit_of_key
from nmt_core.tolerances import MODEL_PRIORS
from nmt_diagnose.effects.location import LocationKind
from nmt_diagnose.effects.modal_calibration import model_paths
from nmt_diagnose.effects.rig_edit import Path, value_at, with_value
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import BeamSection, ChainSection, ForceSection, MatricesSection, Rig, ShakerSection
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
class ModeDamping(CalibrationParameter):
    """Factor on the damping of one mode of the structure, whose law of damping is a guess.

    Attributes:
        mode: number of the undamped mode, 0 = lowest.
        count: modes that have factors; the last one's holds for all above it, too.
    """

    mode: int = 0
    count: int = 1

    def moved(self, rig: Rig, before: float, theta: float) -> Rig:
        """Rig with the factor of the mode moved from one θ to another."""
        if theta == before:
            return rig
        factors = list(rig.structure.damping_factors)
        factors += [factors[-1] if factors else 1.0] * (self.count - len(factors))
        factors[self.mode] = self.at(theta)
        return with_value(rig, self.path, factors)


# Coil suspension: so stiff that no test of the bench sees it.
# An exponent of a power-law distribution is greater than −1.
_OFFSETS = {"exponent": 1.0}
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
        for key in ("clamp_rotational_stiffness_nm_rad", "clamp_lateral_stiffness_n_m"):
            add(("structure", key), "boundary")
    elif isinstance(structure, ChainSection):
        for key in ("masses_kg", "springs_n_m", "dampers_ns_m", "ground_springs_n_m", "ground_dampers_ns_m"):
            for index in range(len(getattr(structure, key) or ())):
                add(("structure", key, index), "boundary" if key.startswith("ground") else "structure")
    else:
        for path in model_paths(structure):
            add(path, "structure")
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


def mode_dampings(rig: Rig, lowest_hz: float, highest_hz: float) -> tuple[ModeDamping, ...]:
    """Damping of each mode of a band, where the model has one law of damping for all modes.

    Args:
        rig: the model; modal structures and chains have dampings of their own in ``calibration_parameters``.
        lowest_hz, highest_hz: band of the tests.
    """
    section = rig.structure
    if not isinstance(section, BeamSection | MatricesSection) or getattr(section, "damping_ratios", None):
        return ()
    structure = build_structure(rig)
    if not np.any(structure.damping):
        return ()
    squares = eigh(structure.stiffness, structure.mass, eigvals_only=True)
    frequencies = np.sqrt(np.maximum(squares, 0.0)) / (2.0 * pi)
    near = np.flatnonzero(
        (frequencies > lowest_hz / THRESHOLDS.candidates.mode_band_ratio)
        & (frequencies < highest_hz * THRESHOLDS.candidates.mode_band_ratio)
    )
    # One more for all above: together they are the flexibility that they add to the band, and its phase.
    wanted = [*map(int, near), *range(int(near[-1]) + 1, frequencies.size)[:1]] if near.size else []
    factors_given = list(section.damping_factors) or [1.0]
    factors = [*factors_given, *[factors_given[-1]] * frequencies.size]
    return tuple(
        ModeDamping(
            f"structure.damping_factors.{mode}", "1", ("structure", "damping_factors"),
            MODEL_PRIORS["damping_factors"].std, "structure", factors[mode], mode=mode, count=wanted[-1] + 1,
        )
        for mode in wanted
    )  # fmt: skip
