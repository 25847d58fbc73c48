"""What is reported of an effect stands in the rig file that it makes."""

from __future__ import annotations

import pytest
from diagnose.test_predicted_effects import candidate, surroundings

from nmt_diagnose.effects.library import library
from nmt_diagnose.effects.structure_effects import BELOW
from nmt_rig.rig import Rig

# From label: rig of the test, and where each reported parameter is found in the changed rig.
REPORTED = {
    "clamp_compliance@rotation": ("beam", {"k": lambda rig: rig.structure.clamp_rotational_stiffness_nm_rad}),
    "clamp_compliance@lateral": ("beam", {"k": lambda rig: rig.structure.clamp_lateral_stiffness_n_m}),
    "clamp_friction@rotation": (
        "beam",
        {"kt": lambda rig: last(rig).tangential_stiffness_n_m, "slip_force": lambda rig: last(rig).slip_force_n},
    ),
    "second_friction_contact@1": (
        "chain",
        {"kt": lambda rig: last(rig).tangential_stiffness_n_m, "slip_force": lambda rig: last(rig).slip_force_n},
    ),
    "microslip@1-2": (
        "plain chain",
        {
            "kt": lambda rig: -last(rig).stiffness_n_m,
            "slip_force": lambda rig: rig.local_elements[-2].slip_force_n,
            "chi": lambda rig: rig.local_elements[-2].exponent,
        },
    ),
    "power_law_damping@2": (
        "chain",
        {
            "force": lambda rig: last(rig).coefficient_n_sp_mp * fastest(2) ** last(rig).exponent,
            "p": lambda rig: last(rig).exponent,
        },
    ),
    "microslip@2": (
        "chain",
        {
            "spread": lambda rig: 1.0 / last(rig).stiffness_ratio,
            "beta": lambda rig: last(rig).stiffness_ratio,
            "chi": lambda rig: last(rig).exponent,
        },
    ),
    f"one_sided_stop@1, {BELOW}": (
        "chain",
        {"k": lambda rig: last(rig).stiffness_n_m, "gap_below": lambda rig: last(rig).gap_m},
    ),
    "local_stiffness@link": ("matrices", {"factor": lambda rig: region(rig, "link").stiffness_factor}),
    "local_mass@tip": (
        "matrices",
        {
            "factor": lambda rig: region(rig, "tip").mass_factor,
            "m": lambda rig: region(rig, "tip").moved_kg * (region(rig, "tip").mass_factor - 1.0),
        },
    ),
    "amplifier_saturation": ("chain", {"V": lambda rig: rig.exciter.amplifier_saturation_v}),
    "clipping@x1": ("chain", {"level": lambda rig: sensor(rig, "x1").clip}),
    "low_pass@x1": ("chain", {"low_pass_hz": lambda rig: sensor(rig, "x1").low_pass_hz}),
    "response_gain@x1": ("chain", {"g": lambda rig: sensor(rig, "x1").gain - 1.0}),
    "force_gain@f1": ("chain", {"g": lambda rig: sensor(rig, "f1").gain - 1.0}),
}


def fastest(point: int) -> float:
    operating = surroundings("chain")[1]
    return operating.omega * operating.displacement[point]


def sensor(rig: Rig, channel: str):
    return next(s for s in rig.sensors if rig.sensor_channel(s) == channel)


def region(rig: Rig, name: str):
    return rig.structure.regions[name]


def last(rig: Rig):
    return rig.local_elements[-1]


@pytest.mark.parametrize("label", REPORTED)
def test_a_reported_parameter_is_the_key_of_the_rig(label: str) -> None:
    name, keys = REPORTED[label]
    rig, own = candidate(name, label)
    values = {p.name: (0.7 + 0.2 * k) * own.site.scales[p.name] for k, p in enumerate(own.effect.parameters)}
    changed = own.effect.apply(rig, own.site, values)
    reported = own.effect.reported(own.site, values)
    assert set(reported) == set(keys)
    for parameter, (value, _) in reported.items():
        assert value == pytest.approx(keys[parameter](changed), rel=1e-12), parameter


def test_every_effect_that_reports_other_parameters_is_compared() -> None:
    assert {effect.name for effect in library() if effect.report is not None} == {
        label.split("@")[0] for label in REPORTED
    }
