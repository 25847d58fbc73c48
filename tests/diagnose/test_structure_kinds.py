"""The prediction on structures given by modes or matrices, and on a shaking table; their parameters."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.predicted_tests import chain, level, locked, noise_test, rows_of

from nmt_core.errors import BenchError
from nmt_core.tolerances import MODEL_PRIORS
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.library import candidates
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_rig.model.assembly import displacement_output, driven_by_force
from nmt_rig.model.forced_response import ForcedProblem
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.model.phase_resonance import phase_resonant_backbone
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument
from nmt_rig.rig_model import build_structure, build_system

PAIR = chain()


def modal(**changes) -> Rig:
    """The pair of masses in its two modes, damping made modal."""
    modes = sticking_modes(build_structure(PAIR))
    entries = [
        {
            "frequency_hz": float(omega) / (2.0 * np.pi),
            "damping_ratio": float(ratio),
            "modal_mass_kg": 0.25,
            "shape": (0.5 * modes.shapes[:, k]).tolist(),
            "participation": float(modes.shapes[:, k] @ [0.5, 0.3]) / 0.5,
        }
        for k, (omega, ratio) in enumerate(zip(modes.frequencies, modes.damping_ratios, strict=True))
    ]
    return chain(structure={"kind": "modal", "points": [1, 2], "modes": entries}, **changes)


def matrices(**changes) -> Rig:
    """The same pair by its matrices, with the damping of its modes."""
    structure = build_structure(modal())
    shapes = np.array([structure.selector(1), structure.selector(2)])
    to_points = np.linalg.inv(shapes)
    mass, damping, stiffness = (
        (to_points.T @ matrix @ to_points).tolist()
        for matrix in (structure.mass, structure.damping, structure.stiffness)
    )
    section = {
        "kind": "matrices", "points_at": [{"point": 1, "row": 0}, {"point": 2, "row": 1}], "base_vector": [1.0, 1.0],
        "mass_kg": mass, "stiffness_n_m": stiffness, "damping_ns_m": damping,
    }  # fmt: skip
    return chain(structure=section, **changes)


def test_both_kinds_are_the_same_structure_to_the_twin():
    values = []
    for rig in (modal(), matrices()):
        near = level(1.0, 26.0)
        test, table = locked(rig, [level(0.1, 26.0), near], "x1")
        noise, more = noise_test(rig, 10.0, 80.0, 12, test=1)
        values.append(Forward([test, noise], rows_of([*table, *more]), PredictionSettings()).predict(rig))
    assert all(np.all(prediction.converged) for prediction in values)
    np.testing.assert_allclose(values[0].values, values[1].values, atol=1e-7)


@pytest.mark.parametrize("make", [modal, matrices])
def test_the_twin_meets_harmonic_balance(make):
    """As for the other structures: frequency and harmonics of all channels, also on a table."""
    for rig in (make(), make(exciter={"kind": "shaking_table", "point": 1, "acceleration_per_volt_m_s2": 2.0})):
        volts = (0.1, 1.0, 4.0)
        guess = float(sticking_modes(build_structure(rig), [], 1).frequencies[0]) / (2.0 * np.pi)
        problem = ForcedProblem(build_system(rig), FourierBasis.up_to(7), 2.0 * np.pi * guess)
        per_volt = 2.0 if rig.exciter.kind == "shaking_table" else 1.0
        drives = per_volt * np.array([1e-4, *volts])
        expected = phase_resonant_backbone(problem, drives).responses[1:]
        test, table = locked(rig, [level(v, guess) for v in volts], "x1")
        states = Forward([test], rows_of(table), PredictionSettings(harmonics=7)).predict(rig).states[0]
        for state, solution in zip(states, expected, strict=True):
            assert state.omega == pytest.approx(solution.angular_frequency, rel=1e-8)
            force = state.channels[0]
            np.testing.assert_allclose(force, solution.force, atol=1e-7 * abs(solution.force[1]))
            x = problem.system.motion(1, solution.unknowns.T)
            np.testing.assert_allclose(state.channels[1], x, atol=1e-7 * abs(x[1]))


def test_a_table_under_a_test_held_by_its_force_is_the_equivalent_force():
    """Responses over force do not know what stands between volts and acceleration."""
    table = {"kind": "shaking_table", "point": 1, "effective_mass_kg": 0.7}
    elements = {"local_elements": []}
    rig = modal(exciter=table | {"suspension_hz": 3.0, "bandwidth_hz": 300.0}, **elements)
    noise, rows = noise_test(rig, 10.0, 80.0, 9, reference="force")
    found = np.exp(Forward([noise], rows_of(rows), PredictionSettings()).predict(rig).values[::2])
    structure = build_structure(rig)
    omega = 2.0 * np.pi * np.repeat(noise.lines_hz, len(noise.channels))
    exact = []
    for line, w in enumerate(omega):
        q = np.linalg.solve(
            structure.stiffness + 1j * w * structure.damping - w * w * structure.mass, structure.base_load / 0.7
        )
        point = noise.channels[line % len(noise.channels)].point
        order = 2 if noise.channels[line % len(noise.channels)].name.startswith("a") else 0
        exact.append(abs(structure.motion(point, q)) * w**order)
    # The estimator's window mixes neighbouring lines.
    np.testing.assert_allclose(found, exact, rtol=0.03)
    plain = modal(exciter=table, **elements)
    ideal = np.exp(Forward([noise], rows_of(rows), PredictionSettings()).predict(plain).values[::2])
    np.testing.assert_allclose(found, ideal, rtol=1e-12)
    by_voltage, more = noise_test(rig, 10.0, 80.0, 5)
    with pytest.raises(BenchError, match="takes the shaking table as ideal"):
        Forward([by_voltage], rows_of(more), PredictionSettings()).predict(rig)


def test_absolute_accelerations_contain_the_table():
    sensors = [
        {"quantity": "force", "point": "drive"},
        {"quantity": "acceleration", "point": 2},
        {"quantity": "voltage"},
    ]
    extraction = {"quantity": "acceleration", "linear_modes": 1}
    found = []
    for responses in ("relative", "absolute"):
        table = {"kind": "shaking_table", "point": 1, "effective_mass_kg": 0.7, "responses": responses}
        rig = modal(exciter=table, sensors=sensors, extraction=extraction, local_elements=[])
        noise, rows = noise_test(rig, 10.0, 40.0, 5)
        values = Forward([noise], rows_of(rows), PredictionSettings()).predict(rig).values
        own = [values[k : k + 2] for k in range(0, values.size, 2 * len(noise.channels))]
        names = [channel.name for channel in noise.channels]
        offset = 2 * names.index("a2")
        rest = values.reshape(-1, 2 * len(names))[:, offset : offset + 2]
        assert len(own) == rest.shape[0]
        found.append(np.exp(rest[:, 0] + 1j * rest[:, 1]))
    # Per volt the table moves with 1 m/s².
    np.testing.assert_allclose(found[1], found[0] + 1.0, rtol=1e-9)


def test_sensors_that_a_recording_lacks_turn_no_absolute_acceleration():
    """A displacement among the rig's sensors gives the table a position, whose suspension must not lead."""
    found = []
    for further in ([], [{"quantity": "displacement", "point": 1}]):
        sensors = [
            {"quantity": "force", "point": "drive"},
            {"quantity": "acceleration", "point": 2},
            {"quantity": "voltage"},
        ]
        table = {"kind": "shaking_table", "point": 1, "effective_mass_kg": 0.7, "responses": "absolute"}
        extraction = {"quantity": "acceleration", "linear_modes": 1}
        rig = modal(exciter=table, sensors=[*sensors, *further], extraction=extraction, local_elements=[])
        if not found:
            noise, rows = noise_test(rig, 5.0, 40.0, 5)
        values = Forward([noise], rows_of(rows), PredictionSettings()).predict(rig).values
        found.append(np.exp(values[::2] + 1j * values[1::2]))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-3)


def test_absolute_displacements_contain_the_tables_position():
    """Over the equivalent force −m a the table itself moves by 1/(m ω²)."""
    sensors = [{"quantity": "force", "point": "drive"}, {"quantity": "displacement", "point": 2}]
    found = []
    for responses in ("relative", "absolute"):
        table = {"kind": "shaking_table", "point": 1, "effective_mass_kg": 0.7, "responses": responses}
        rig = modal(
            exciter=table | {"suspension_hz": 3.0, "bandwidth_hz": 300.0},
            sensors=[*sensors, {"quantity": "voltage"}],
            extraction={"quantity": "displacement", "linear_modes": 1},
            local_elements=[],
        )
        noise, rows = noise_test(rig, 10.0, 40.0, 5, reference="force")
        values = Forward([noise], rows_of(rows), PredictionSettings()).predict(rig).values
        names = [channel.name for channel in noise.channels]
        own = values.reshape(-1, 2 * len(names))[:, 2 * names.index("x2") : 2 * names.index("x2") + 2]
        found.append(np.exp(own[:, 0] + 1j * own[:, 1]))
    omega = 2.0 * np.pi * noise.lines_hz
    # The estimator's window mixes neighbouring lines.
    np.testing.assert_allclose(found[1], found[0] + 1.0 / (0.7 * omega**2), rtol=0.02)


def test_a_table_with_absolute_displacements_is_driven_by_its_equivalent_force():
    """Records of a force −m a on such a table: the structure's own motion and that of the table, F/(m ω²)."""
    system = build_system(
        modal(
            exciter={"kind": "shaking_table", "point": 1, "effective_mass_kg": 0.7, "suspension_hz": 0.01,
                     "responses": "absolute"},
            sensors=[{"quantity": "force", "point": "drive"}, {"quantity": "displacement", "point": 2}],
            extraction={"quantity": "displacement", "linear_modes": 1},
            local_elements=[],
        )
    )  # fmt: skip
    forced, structure = driven_by_force(system), build_structure(modal(local_elements=[]))
    for hertz in (10.0, 40.0):
        omega = 2.0 * np.pi * hertz
        q, force = forced.response(omega)
        assert force == pytest.approx(1.0)
        own = np.linalg.solve(
            structure.stiffness + 1j * omega * structure.damping - omega**2 * structure.mass, structure.base_load / 0.7
        )
        row = displacement_output(forced, 2)
        exact = structure.motion(2, own) + 1.0 / (0.7 * omega**2)
        assert row.displacement @ q == pytest.approx(exact, rel=5e-3)


def test_a_free_body_has_no_static_response():
    """Two bodies on a spring, free in space: their receptance at 5 Hz by Cramer's rule, none at 0 Hz."""
    document = {
            "name": "free", "sample_rate_hz": 1000, "test": {"mode": 2},
            "structure": {"kind": "chain", "masses_kg": [2.0, 3.0], "springs_n_m": [4e4]},
            "exciter": {"kind": "force", "point": 1},
            "sensors": [{"quantity": "force", "point": "drive"}, {"quantity": "displacement", "point": 1},
                        {"quantity": "displacement", "point": 2}],
            "extraction": {"quantity": "displacement", "linear_modes": 2},
        }  # fmt: skip
    rig = validate_rig(RigDocument("free", document, {}))
    view = ModelView.of(rig, (1,))
    found = view.responses([view.channels[2]], np.array([0.0, 5.0]))[0]
    omega = 2.0 * np.pi * 5.0
    assert np.isnan(found[0])
    assert found[1] == pytest.approx(4e4 / ((4e4 - 2.0 * omega**2) * (4e4 - 3.0 * omega**2) - 4e4**2))


def test_every_parameter_of_these_structures_may_be_refitted():
    names = {parameter.name: parameter for parameter in calibration_parameters(modal())}
    own = [name for name in names if name.startswith("structure")]
    assert own == [
        f"structure.modes.{mode}.{key}"
        for mode in (0, 1)
        for key in ("frequency_hz", "damping_ratio", "modal_mass_kg", "participation")
    ]
    assert names["structure.modes.0.frequency_hz"].unit == "Hz"
    moved = names["structure.modes.1.modal_mass_kg"].apply(modal(), 1.0)
    assert moved.structure.modes[1].modal_mass_kg == pytest.approx(0.25 * np.exp(MODEL_PRIORS["modal_mass_kg"].std))
    factors = [p.name for p in calibration_parameters(matrices()) if p.name.startswith("structure")]
    assert factors == ["structure.mass_factor", "structure.stiffness_factor", "structure.damping_factor"]
    on_table = modal(exciter={"kind": "shaking_table", "point": 1})
    assert "exciter.acceleration_per_volt_m_s2" in [p.name for p in calibration_parameters(on_table)]


def test_the_springs_that_carry_a_free_beam_are_no_better_known_than_others() -> None:
    """Else the mass of the beam is as well known as its lowest frequency, and every strength with it."""
    structure = {"kind": "beam", "boundary": "free-free", "length_m": 1.0, "width_m": 0.03, "height_m": 0.008,
                 "youngs_modulus_pa": 2.05e11, "density_kg_m3": 7850.0, "elements": 6, "stiffness_damping_s": 6e-5,
                 "suspension_stiffness_n_m": 900.0, "suspension_damping_ns_m": 0.6}  # fmt: skip
    free = chain(structure=structure, exciter={"kind": "force", "point": 2})
    found = {parameter.name: parameter for parameter in calibration_parameters(free)}
    for key in ("suspension_stiffness_n_m", "suspension_damping_ns_m"):
        assert found[f"structure.{key}"].place == "boundary"


@pytest.mark.parametrize("make", [modal, matrices])
def test_a_drifting_stiffness_moves_all_frequencies(make):
    """c and m stay: the sticking structure's frequencies grow with the root of the stiffness."""
    rig = make(local_elements=[], drift={"stiffness_per_s": 0.1})
    starts = [0.0, 2.1]
    test, table = locked(rig, [level(0.5, 26.0, start=start) for start in starts], "x1")
    forces = make(local_elements=[], exciter={"kind": "force", "point": 1}, drift={"stiffness_per_s": 0.1})
    test, table = locked(forces, [level(0.5, 26.0, start=start) for start in starts], "x1")
    states = Forward([test], rows_of(table), PredictionSettings()).predict(forces).states[0]
    assert states[1].omega / states[0].omega == pytest.approx(np.sqrt(1.21), rel=1e-4)


@pytest.mark.parametrize("make", [modal, matrices])
def test_every_effect_finds_its_places(make):
    rig = make()
    test, _ = locked(rig, [level(1.0, 26.0)], "x1")
    operating = operating_range(rig, [test])
    assert operating.effective_mass[1] > 0.0
    found = candidates(rig, operating)
    assert {"cubic_stiffness", "added_mass", "force_gain", "viscous_damping"} <= {own.effect.name for own in found}
    assert not {"clamp_compliance", "clamp_friction"} & {own.effect.name for own in found}
    for own in found:
        theta = np.where([p.kind == "strength" for p in own.effect.parameters], 1.0, 0.0)
        changed = Parametrisation(rig, (), (own,)).rig(theta)
        assert validate_rig(RigDocument("changed", changed.model_dump(exclude_none=True), {})) == changed


@pytest.mark.parametrize(
    ("kind", "places"), [("chain", ["1", "2", "1-2"]), ("modal", ["1", "2", "1-2"]), ("one mode", ["1", "2"])]
)
def test_springs_are_tried_between_points_too(kind: str, places: list[str]) -> None:
    """Of one mode the points move together: a spring between them acts as one to the ground."""
    rig = PAIR if kind == "chain" else modal()
    if kind == "one mode":
        structure = rig.structure.model_copy(update={"modes": rig.structure.modes[:1]})
        rig = rig.model_copy(update={"structure": structure})
    found = candidates(rig, operating_range(rig, []))
    springs = [own for own in found if own.effect.name == "cubic_stiffness"]
    assert [own.site.location.detail for own in springs] == places
    if "1-2" in places:
        changed = springs[-1].effect.change(rig, springs[-1].site, {"k": 1e9})
        assert (changed.local_elements[-1].point, changed.local_elements[-1].other_point) == (1, 2)
