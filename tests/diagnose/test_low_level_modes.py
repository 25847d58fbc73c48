"""Modes of frequency responses against a cantilever in closed form (Euler-Bernoulli), none of the bench's models."""

from pathlib import Path

import numpy as np
import pytest
from diagnose.predicted_tests import chain, noise_test
from ruamel.yaml import YAML
from scipy.optimize import brentq

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.fit.low_level_modes import LowLevelModes, Modes, disorder, measured_modes, modes_that_lack
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.measurements.measurement import RowTable, joined

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


def by_modes(kept: tuple[int, ...]) -> dict:
    modes = [
        {
            "frequency_hz": frequency(k) / (2.0 * np.pi), "damping_ratio": DAMPING, "modal_mass_kg": MASS,
            "shape": [float(v) for v in shape(k, np.array(POINTS) / PARTS)],
        }
        for k in kept
    ]  # fmt: skip
    return {"kind": "modal", "points": list(POINTS), "modes": modes}


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


def test_a_mode_that_the_model_lacks_is_no_effect(tmp_path: Path):
    found = diagnosed(*recorded(tmp_path, by_modes((0, 2))))
    assert found.verdict is Verdict.UNKNOWN
    assert not found.adequate
    assert f"a mode at {frequency(1) / (2.0 * np.pi):.4g} Hz" in found.sentences[0]


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
