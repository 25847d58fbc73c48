"""Modes of frequency responses against a cantilever in closed form (Euler-Bernoulli), none of the bench's models."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnose.predicted_tests import chain, noise_test
from ruamel.yaml import YAML
from scipy.linalg import eigh
from scipy.optimize import brentq

from nmt_bench.data_import import import_data
from nmt_core.messages.blocks import Quantity
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import candidates as library_candidates
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.low_level_modes import (
    LowLevelModes,
    Modes,
    disorder,
    measured_modes,
    modes_that_lack,
    side_by_side,
)
from nmt_diagnose.fit.model_alone import free_parameters
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.measurements.measurement import RowTable, joined
from nmt_diagnose.prediction.operating_range import operating_range

LENGTH, WIDTH, HEIGHT, MODULUS, DENSITY = 0.7, 0.0053, 0.0116, 185e9, 7830.0
MASS = DENSITY * WIDTH * HEIGHT * LENGTH
POINTS, DRIVEN, PARTS = (2, 4, 6, 7), 2, 7
DAMPING = 0.004


def frequency(mode: int) -> float:
    """rad/s."""
    return float(wave_number(mode) ** 2 * np.sqrt(MODULUS * HEIGHT**2 / (12.0 * DENSITY * LENGTH**4)))


def wave_number(mode: int) -> float:
    """βL of cos βL cosh βL = −1."""
    near = (mode + 0.5) * np.pi
    return float(brentq(lambda x: np.cos(x) + 2.0 * np.exp(-x) / (1.0 + np.exp(-2.0 * x)), near - 0.6, near + 0.6))


def shape(mode: int, place: np.ndarray) -> np.ndarray:
    """Mode shape of modal mass ρAL over x/L, in a form that does not cancel in high modes."""
    beta = wave_number(mode)
    rest = (np.exp(-beta) + np.cos(beta) - np.sin(beta)) / (np.sinh(beta) + np.sin(beta))
    x = beta * place
    return np.asarray(-0.5 * rest * np.exp(x) + 0.5 * (2.0 + rest) * np.exp(-x) - np.cos(x) + (1.0 + rest) * np.sin(x))


def accelerances(lines_hz: np.ndarray, mass: tuple[int, float] | None = None) -> np.ndarray:
    """(points, lines), with a mass (point, kg) by coupling of receptances."""
    omega = 2.0 * np.pi * lines_hz
    places = np.array([*POINTS, DRIVEN, mass[0] if mass else DRIVEN]) / PARTS
    shapes = np.array([shape(k, places) for k in range(40)])
    own = np.array([1.0 / (MASS * (w**2 - omega**2 + 2j * DAMPING * w * omega)) for w in map(frequency, range(40))])
    receptance = np.einsum("kp,kq,kw->pqw", shapes, shapes, own)
    found = receptance[: len(POINTS), len(POINTS)]
    if mass:
        load = -mass[1] * omega**2
        found = found - receptance[: len(POINTS), -1] * load * receptance[-1, len(POINTS)] / (
            1.0 + load * receptance[-1, -1]
        )
    return np.asarray(-(omega**2) * found)


def lines() -> np.ndarray:
    near = [frequency(k) / (2.0 * np.pi) * np.linspace(0.85, 1.03, 60) for k in range(3)]
    return np.unique(np.concatenate([np.linspace(10.0, 450.0, 120), *near]))


def recorded(folder: Path, structure: dict, mass: tuple[int, float] | None = None) -> tuple[Path, Path]:
    """Rig file and bag of tables with noise of 0.4 %."""
    noise = np.random.default_rng(0).standard_normal((2, len(POINTS), lines().size))
    values = accelerances(lines(), mass) * (1.0 + 0.004 * (noise[0] + 1j * noise[1]))
    segments = []
    for point, own in zip(POINTS, values, strict=True):
        rows = [f"{f:.8g},{h.real:.8g},{h.imag:.8g}" for f, h in zip(lines(), own, strict=True)]
        (folder / f"p{point}.csv").write_text("\n".join(["frequency_hz,real,imag", *rows]) + "\n")
        segments.append(
            {"kind": "frf", "file": f"p{point}.csv", "point": point, "drive_point": DRIVEN, "unit": "m/s^2/N"}
        )
    yaml = YAML(typ="safe")
    sensors = [{"quantity": "acceleration", "point": point} for point in POINTS]
    rig = {
        "name": "cantilever", "structure": structure, "exciter": {"kind": "force", "point": DRIVEN},
        "sample_rate_hz": 10000, "limits": {"force_n": 100}, "extraction": {"quantity": "acceleration"},
        "sensors": [{"quantity": "force", "point": "drive"}, *sensors],
        "test": {"levels": "0.1:1:3"},
    }  # fmt: skip
    yaml.dump(rig, folder / "model.yaml")
    yaml.dump({"rig": "model.yaml", "file": "p2.csv", "segments": segments}, folder / "data.yaml")
    import_data(folder / "data.yaml", folder / "bag")
    return folder / "model.yaml", folder / "bag"


def by_law_of_damping() -> dict:
    """A model whose damping rises with frequency, as it does on no real beam; 0.4 % stiffer."""
    return {
        "kind": "beam", "length_m": LENGTH, "width_m": WIDTH, "height_m": HEIGHT, "youngs_modulus_pa": 1.004 * MODULUS,
        "density_kg_m3": DENSITY, "elements": PARTS, "mesh_refinement": 2, "stiffness_damping_s": 1e-4,
    }  # fmt: skip


def diagnosed(rig: Path, bag: Path) -> Diagnosis:
    return diagnose_bags(rig, [bag], settings=DiagnosisSettings(look_ahead=False)).diagnosis


def test_modes_of_responses_are_those_of_the_closed_form():
    found = measured_modes(lines(), accelerances(lines()), 2)
    np.testing.assert_allclose(found.frequencies_hz, [frequency(k) / (2.0 * np.pi) for k in range(3)], rtol=1e-4)
    np.testing.assert_allclose(found.dampings, DAMPING, rtol=0.01)
    expected = np.array([shape(k, np.array(POINTS) / PARTS) for k in range(3)])
    for own, theirs in zip(found.shapes, expected, strict=True):
        assert abs(np.vdot(own, theirs)) ** 2 > 0.9999 * np.vdot(own, own).real * (theirs @ theirs)


def modes_at(*frequencies_hz: float) -> Modes:
    poles = 2.0 * np.pi * np.array(frequencies_hz) * (1j - 0.01)
    return Modes(poles, np.eye(poles.size, dtype=np.complex128))


def test_what_the_model_lacks_is_told_but_at_the_edges_of_the_band():
    found = modes_at(21.0, 50.0, 190.0)
    told = modes_that_lack("random", (20.0, 200.0), found, np.array([-1, -1, -1]))
    assert [frequency for frequency, _ in told] == pytest.approx([50.0], rel=1e-3)
    assert modes_that_lack("random", (20.0, 200.0), found, np.array([0, 1, 2])) == []


def test_modes_in_another_order_are_told():
    found, alike = modes_at(50.0, 60.0), np.array([[0.0, 1.0], [1.0, 0.0]])
    ((_, sentence),) = disorder("random", found, np.array([1, 0]), alike)
    assert "50 and 60 Hz in the other order" in sentence
    assert disorder("random", found, np.array([1, 0]), np.ones((2, 2))) == []


def test_friction_of_no_width_has_no_modes_and_ends_nothing():
    model = chain(local_elements=[])
    test, _ = noise_test(model, 5.0, 60.0, 60, test=0, window="none")
    modes = LowLevelModes(joined([RowTable().observations(test)]), model)
    dry = {"kind": "tanh_friction", "point": 2, "slip_force_n": 1.0}
    for width, there in ((1e-2, True), (1e-310, False)):
        rig = chain(local_elements=[{**dry, "reference_velocity_m_s": width}])
        assert (modes.modes(rig, test) is not None) is there


@pytest.mark.parametrize("alone", [False, True], ids=["all channels", "one channel a test"])
def test_shapes_of_the_model_are_residues_whatever_channels_a_test_has(alone: bool):
    """Against the modes of mass and stiffness alone: tests of one channel each make up one shape."""
    model = chain(local_elements=[])
    test, _ = noise_test(model, 5.0, 60.0, 60, reference="force", window="none")
    looked = LowLevelModes(joined([RowTable().observations(test)]), model)
    tests = [replace(test, channels=(channel,)) for channel in test.channels] if alone else [test]
    found = side_by_side([looked.modes(model, each) for each in tests])
    stiffness = np.array([[35000.0, -15000.0], [-15000.0, 18000.0]])
    squares, shapes = eigh(stiffness, np.diag([0.5, 0.3]))
    receptance = shapes.T * shapes[0][:, None] / (2j * np.sqrt(squares)[:, None])  # driven at the first mass
    assert [channel.quantity for channel in test.channels] == [Quantity.DISPLACEMENT, Quantity.ACCELERATION]
    expected = receptance * np.column_stack([np.ones(2), -squares])
    np.testing.assert_allclose(found.frequencies_hz, np.sqrt(squares) / (2.0 * np.pi), rtol=1e-3)
    np.testing.assert_allclose(np.abs(found.shapes / expected), 1.0, rtol=0.02)
    np.testing.assert_allclose(np.angle(found.shapes / expected), 0.0, atol=0.15)


def test_what_moves_no_mode_promises_nothing():
    model = chain(local_elements=[])
    test, _ = noise_test(model, 5.0, 60.0, 60, reference="force", window="none")
    looked = LowLevelModes(joined([RowTable().observations(test)]), model)
    poles = np.array([1.05 * pole for pole in looked.modes(model, test).poles])
    looked.tests = [(test, replace(looked.modes(model, test), poles=poles), np.arange(poles.size))]
    observations = joined([RowTable().observations(test)])
    none = Parametrisation(model, free_parameters(model, observations), (), ())
    theta = np.zeros(none.size)
    offered = library_candidates(model, operating_range(model, [test]), ())
    heavy, cubic = (
        next(it for it in offered if it.effect.name == name and it.site.location.detail == "2")
        for name in ("added_mass", "cubic_stiffness")
    )
    left = looked.promises(
        none,
        theta,
        [(Parametrisation(model, none.calibration, (it,), ()), np.append(theta, 0.01)) for it in (heavy, cubic)],
    )
    assert 0.0 < left[0] < np.sum(looked.residual(none, theta) ** 2)
    assert left[1] == np.inf


@pytest.mark.campaign
def test_damping_of_every_mode_is_the_models_own(tmp_path: Path):
    found = diagnosed(*recorded(tmp_path, by_law_of_damping()))
    assert found.verdict is Verdict.CALIBRATION
    assert found.gap.closed > 0.99


@pytest.mark.campaign
def test_a_mass_that_moves_modes_by_many_bandwidths_is_found(tmp_path: Path):
    found = diagnosed(*recorded(tmp_path, by_law_of_damping(), mass=(6, 0.025)))
    assert found.verdict is Verdict.EFFECT
    names = {found.ranking[0].effect, *found.ranking[0].equivalents}
    assert {"added_mass", "sensor_mass"} & names
    mass = found.ranking[0].parameters["m"]
    assert mass.value == pytest.approx(0.025, abs=3.0 * mass.std)
    assert mass.std < 0.001
