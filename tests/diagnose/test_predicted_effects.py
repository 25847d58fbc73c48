"""Every effect of the library: the plant's time integration with the key set against the prediction's steady state.

The plant is driven at a fixed frequency until it is stationary. Its measured phase between force and velocity is given
to the prediction, which has to find the frequency and all harmonics of all channels.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnose.predicted_tests import chain, channels_of, level, locked, rows_of
from rig.effect_rigs import harmonic, run
from scipy.linalg import eigvalsh

from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.library import ALIKE_AT_EVERY_LEVEL, candidates, library
from nmt_diagnose.effects.operating_range import LackingMode, OperatingRange
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.effects.structure_effects import BELOW
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.operating_range import operating_range, receptances
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_rig.model.packed_matrix import packed
from nmt_rig.rig import Rig, load_rig
from nmt_rig.rig_model import build_elements, build_structure

# label -> θ; strengths in scales, shapes as ln of scales.
ON_THE_CHAIN = {
    "cubic_stiffness@2": (4.0,),
    "cubic_stiffness@1-2": (3.0,),
    "quintic_stiffness@2": (4.0,),
    "quadratic_stiffness@1": (2.0,),
    "air_drag@2": (6.0,),
    "amplitude_damping@2": (4.0,),
    "power_law_damping@2": (6.0, math.log(0.5)),
    "power_law_damping@1-2": (4.0, math.log(1.7)),
    "structural_damping": (4.0,),
    "added_stiffness@1-2": (900.0,),
    "viscous_damping@1-2": (5.0,),
    "added_mass@2": (5.0,),
    "one_sided_stop@2": (2.0, math.log(0.5)),
    "one_sided_stop@2, below": (2.0, math.log(0.5)),
    "two_sided_gap@1": (2.0, math.log(0.4)),
    "microslip@2": (4.0, -0.3),
    "second_friction_contact@1": (0.9, math.log(3.0)),
    "preload_loss@time": (-40.0,),
    "preload_loss@cycles": (-0.05,),
    "temperature_drift": (0.5,),
    "stinger_stiffness@lateral": (4.0,),
    "amplifier_saturation": (9.0,),
    "source_impedance": (4.0,),
    "drive_hold@drive": (6.0,),
    "suspension_cubic": (8.0,),
    "force_factor_symmetric": (-3.0,),
    "force_factor_asymmetric": (3.0,),
    "force_gain@f1": (3.0,),
    "force_cell_mass": (3.0,),
    "response_gain@a2": (-3.0,),
    "transverse_sensitivity@a2<1": (5.0,),
    "sensor_mass@a2": (5.0,),
    "channel_skew@a2": (5.0,),
    "channel_skew@f1": (3.0,),
    "low_pass@x1": (8.0,),
    "charge_high_pass@a2": (6.0,),
    "clipping@a2": (3.0,),
    "quantisation@x1": (0.3,),
    "clock_error": (5.0,),
}
ON_THE_BEAM = {
    "clamp_compliance@rotation": (3.0,),
    "clamp_compliance@lateral": (1.0,),
    "clamp_friction@lateral": (0.6, math.log(3.0)),
    "clamp_friction@rotation": (0.6, math.log(3.0)),
    "stinger_stiffness@rotation": (3.0,),
    "shared_delay@displacement channels": (5.0,),
}
WITHOUT_FRICTION = {"microslip@1-2": (6.0, math.log(0.5), 0.0), "microslip@2": (3.0, math.log(0.4), math.log(0.6))}
# The chain by its matrices, with regions: the spring between its masses, the second mass.
ON_THE_MATRICES = {"local_stiffness@link": (3.0,), "local_mass@tip": (-3.0,)}
# What no steady state of a channel shows: means over windows of a line of unknown phase, and the loop's own settings.
ELSEWHERE = {"mains_hum", "phase_offset", "loop_latency"}
# A resonance that the chain lacks: m, f and ζ of a mass beside the model's, and of a part of it.
LACKING_HZ, OSCILLATORS = 37.0, {"": (4.0, 0.05, 1.5), "of the model's mass": (6.0, -0.05, 1.5)}
CHAIN_DRIVE, CHAIN_HZ = 2.0, 25.0
BEAM_DRIVE, BEAM_HZ = 1.0, 20.0
SETTINGS = PredictionSettings(mesh_refinement=1, harmonics=11)
DURATION = {"preload_loss@time": 4.0}


@cache
def the_beam() -> Rig:
    return load_rig("beam", ["watchdog.blocks=0", "structure.stiffness_damping_s=1e-3"])


def by_matrices() -> Rig:
    structure = build_structure(chain(local_elements=[]))
    link = -structure.stiffness[0, 1] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    tip = np.diag([0.0, structure.mass[1, 1]])
    section = {
        "kind": "matrices", "points_at": [{"point": 1, "row": 0}, {"point": 2, "row": 1}],
        "mass_kg": structure.mass.tolist(), "stiffness_n_m": structure.stiffness.tolist(),
        "damping_ns_m": structure.damping.tolist(),
        "regions": {
            "link": {"nodes": [1, 2], "stiffness_n_m": packed(link)},
            "tip": {"nodes": [2], "mass_kg": packed(tip), "moved_kg": float(tip[1, 1])},
        },
    }  # fmt: skip
    return chain(structure=section)


@cache
def surroundings(name: str) -> tuple[Rig, OperatingRange]:
    models = {
        "chain": chain, "beam": the_beam, "plain chain": lambda: chain(local_elements=[]), "matrices": by_matrices,
    }  # fmt: skip
    rig = models[name]()
    drive, hz = (BEAM_DRIVE, BEAM_HZ) if name == "beam" else (CHAIN_DRIVE, 24.9)
    test, _ = locked(rig, [level(drive, hz)], "x2" if name == "beam" else "x1")
    return rig, operating_range(rig, [test])


def candidate(name: str, label: str) -> tuple[Rig, Candidate]:
    rig, operating = surroundings(name)
    label, _, form = label.partition(", ")
    found = [c for c in candidates(rig, operating) if c.label == label and (c.effect.form == BELOW) == (form == BELOW)]
    assert len(found) == 1, label
    return rig, found[0]


def compare(rig: Rig, response: str, volts: float, hz: float, seconds: float, tolerance: float) -> None:
    periods = 10
    recorded = run(rig, hz, volts, seconds)
    names = [channel.name for channel in channels_of(rig)]
    length = periods / hz
    reference = {n: {name: harmonic(recorded[name], hz, n, periods=periods) for name in names} for n in range(6)}
    zero = {name: float(np.mean(recorded[name][-round(length * 1e4) :])) for name in names}
    force = harmonic(recorded[names[0]], hz, periods=periods)
    phase = float(np.angle(force / (2j * np.pi * hz * reference[1][response])))
    middle = seconds - 0.5 * length
    test, table = locked(rig, [level(volts, hz, phase, middle, middle * hz)], response)
    prediction = Forward([test], rows_of(table), SETTINGS).predict(rig)
    assert not prediction.reasons
    values = dict(zip(table, prediction.values, strict=True))
    assert values[(0, 0, -1, -1, Part.LOG_FREQUENCY)] == pytest.approx(math.log(2 * np.pi * hz), abs=tolerance)
    for index, name in enumerate(names):
        own = reference[1][name]
        size = math.exp(values[(0, 0, index, 1, Part.LOG_MAGNITUDE)])
        predicted = size * np.exp(1j * values[(0, 0, index, 1, Part.PHASE)])
        assert abs(predicted / own - 1.0) < 5 * tolerance, name
        for order in (0, 2, 3, 4, 5):
            there = complex(*(values[(0, 0, index, order, part)] for part in (Part.REAL, Part.IMAG)))
            measured = zero[name] / abs(own) if order == 0 else reference[order][name] / abs(own)
            assert abs(there - measured) < 5 * tolerance, (name, order)


def test_the_model_itself():
    compare(chain(), "x1", CHAIN_DRIVE, CHAIN_HZ, 3.0, 1e-4)


@pytest.mark.parametrize("label", ON_THE_CHAIN)
def test_an_effect_on_the_chain(label):
    rig, own = candidate("chain", label)
    parametrisation = Parametrisation(rig, (), (own,))
    changed = parametrisation.rig(np.array(ON_THE_CHAIN[label]))
    assert changed != rig
    tolerance = 2e-3 if label.startswith("quantisation") else 2e-4
    compare(changed, "x1", CHAIN_DRIVE, CHAIN_HZ, DURATION.get(label, 3.0), tolerance)


@pytest.mark.parametrize("label", ON_THE_BEAM)
def test_an_effect_on_the_beam(label):
    rig, own = candidate("beam", label)
    parametrisation = Parametrisation(rig, (), (own,))
    changed = parametrisation.rig(np.array(ON_THE_BEAM[label]))
    assert changed != rig
    compare(changed, "x2", BEAM_DRIVE, BEAM_HZ, 3.0, 2e-4)


@pytest.mark.parametrize("label", ON_THE_MATRICES)
def test_an_effect_of_a_region(label):
    rig, found = candidate("matrices", label)
    changed = Parametrisation(rig, (), (found,)).rig(np.array(ON_THE_MATRICES[label]))
    assert changed != rig
    compare(changed, "x1", CHAIN_DRIVE, CHAIN_HZ, 3.0, 2e-4)


@pytest.mark.parametrize("label", WITHOUT_FRICTION)
def test_a_joint_in_a_model_without_friction(label):
    """It takes its stiffness from the model: stuck, it changes nothing; slipping, the plant moves as predicted."""
    rig, own = candidate("plain chain", label)
    changed = Parametrisation(rig, (), (own,)).rig(np.array(WITHOUT_FRICTION[label]))
    stuck, given = (eigvalsh(structure_stiffness(item), build_structure(item).mass) for item in (changed, rig))
    np.testing.assert_allclose(stuck, given, rtol=1e-12)
    compare(changed, "x1", CHAIN_DRIVE, CHAIN_HZ, 3.0, 2e-4)


@pytest.mark.parametrize("form", OSCILLATORS)
def test_a_mode_that_the_chain_lacks(form):
    rig, operating = surroundings("chain")
    pole = 2.0 * np.pi * LACKING_HZ * (1j - 0.01)
    lacking = LackingMode(pole, (15.0, 60.0), receptances(rig, pole, ideal_force=False))
    found = candidates(rig, replace(operating, lacking=(lacking,)))
    (candidate,) = (c for c in found if c.label == "missing_mode@2" and c.effect.form == form)
    changed = Parametrisation(rig, (), (candidate,)).rig(np.array(OSCILLATORS[form]))
    assert changed.structure.oscillators[0].mass_kg > 0.0
    compare(changed, "x1", CHAIN_DRIVE, CHAIN_HZ, 3.0, 2e-4)


def structure_stiffness(rig: Rig) -> np.ndarray:
    """Stiffness at rest, elements included."""
    structure = build_structure(rig)
    outer = [e.linear_stiffness * np.outer(e.direction, e.direction) for e in build_elements(rig, structure)]
    return structure.stiffness + sum(outer)


def test_a_model_with_friction_gets_no_joint_beside_it():
    rig, operating = surroundings("chain")
    assert [c.label for c in candidates(rig, operating) if c.effect.name == "microslip"] == ["microslip@2"]


def test_air_gives_no_more_drag_than_its_density_and_the_area_allow():
    """A plate of 0.7 m by 5.3 mm in air of 1.2 kg/m³, C_d at most 10; without a size the sheet that weighs as much."""
    rig, own = candidate("beam", "air_drag@5")
    assert own.site.limits["c2"] == pytest.approx(0.5 * 1.2 * 10.0 * 0.7 * rig.structure.width_m)
    _, light = candidate("chain", "air_drag@2")
    assert 0.0 < light.site.limits["c2"] <= 0.5 * 1.2 * 10.0 * 0.8 / 2.7


def test_every_effect_is_compared():
    compared = {label.partition("@")[0] for label in (*ON_THE_CHAIN, *ON_THE_BEAM, *ON_THE_MATRICES)} | {"missing_mode"}
    assert compared | ELSEWHERE == {effect.name for effect in library()}


@pytest.mark.parametrize(("label", "theta", "expected"), [
    ("phase_offset", 2.0, lambda omega: 0.04),
    ("loop_latency", 2.0, lambda omega: 0.04 * omega / surroundings("chain")[1].omega),
])  # fmt: skip
def test_what_the_loop_holds(label, theta, expected):
    """The controller decides where the loop stands; the motion there is an input, so nothing else changes."""
    rig, own = candidate("chain", label)
    test, table = locked(rig, [level(CHAIN_DRIVE, CHAIN_HZ)], "x1")
    forward = Forward([test], rows_of(table), SETTINGS)
    plain = forward.predict(rig)
    changed = forward.predict(Parametrisation(rig, (), (own,)).rig(np.array([theta])))
    held = np.array([row[4] == Part.PHASE_ERROR for row in table])
    assert np.all(plain.values[held] == 0.0)
    omega = math.exp(plain.values[0])
    np.testing.assert_allclose(changed.values[held], expected(omega), rtol=1e-9)
    np.testing.assert_array_equal(changed.values[~held], plain.values[~held])


def test_hum_has_no_mean_in_a_harmonic():
    rig, own = candidate("chain", "mains_hum@x1")
    test, table = locked(rig, [level(CHAIN_DRIVE, CHAIN_HZ)], "x1")
    forward = Forward([test], rows_of(table), SETTINGS)
    changed = Parametrisation(rig, (), (own,)).rig(np.array([3.0]))
    assert changed.sensors[1].hum_amplitude > 0.0
    np.testing.assert_array_equal(forward.predict(changed).values, forward.predict(rig).values)


def test_hum_is_a_line_of_its_channel():
    rig, own = candidate("chain", "mains_hum@x1")
    test, _ = locked(rig, [level(CHAIN_DRIVE, CHAIN_HZ)], "x1")
    table = [(0, 0, channel, -1, Part.LINE) for channel in range(3)]
    parametrisation = Parametrisation(rig, (), (own,))
    forward = Forward([test], rows_of(table, 50.1), SETTINGS)
    size = own.site.scales["amplitude"]
    prediction = forward.predict(parametrisation.rig(np.array([3.0])))
    np.testing.assert_allclose(prediction.values, [0.0, 3.0 * size, 0.0])
    jacobian = forward.jacobian(parametrisation, np.zeros(1), forward.predict(rig))
    np.testing.assert_allclose(jacobian[:, 0], [0.0, size, 0.0])
    elsewhere = Forward([test], rows_of(table, 60.0), SETTINGS)
    np.testing.assert_array_equal(elsewhere.predict(parametrisation.rig(np.array([3.0]))).values, 0.0)


@pytest.mark.parametrize("label", ON_THE_CHAIN)
def test_what_acts_alike_at_every_level_is_known(label: str) -> None:
    """Frequency, responses for each volt and their phases at twice the drive, on a linear chain."""
    rig, operating = surroundings("plain chain")
    found = next((it for it in candidates(rig, operating) if it.label == label and not it.cause.form), None)
    if found is None or (found.effect.place == "time" and found.effect.name != "clock_error"):
        pytest.skip("needs friction in the model, or time")
    if len(found.effect.parameters) != len(ON_THE_CHAIN[label]):
        pytest.skip("needs friction in the model, which another form of the effect changes")
    changed = Parametrisation(rig, (), (found,)).rig(np.array(ON_THE_CHAIN[label]))
    test, table = locked(changed, [level(drive, CHAIN_HZ) for drive in (CHAIN_DRIVE, 2.0 * CHAIN_DRIVE)], "x1")
    first = {Part.LOG_FREQUENCY, Part.LOG_MAGNITUDE, Part.PHASE}
    values = {
        row[1:]: value
        for row, value in zip(table, Forward([test], rows_of(table)).predict(changed).values, strict=True)
        if row[4] in first
    }
    moved = [
        abs(value - values[(1, *key[1:])] + math.log(2.0) * (key[3] == Part.LOG_MAGNITUDE))
        for key, value in values.items()
        if key[0] == 0
    ]
    assert (max(moved) < 1e-6) == (found.effect.name in ALIKE_AT_EVERY_LEVEL), max(moved)
