"""The simulator and the laboratory of four rigs against closed forms, energy balances and another integrator."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.integrate import quad, solve_ivp
from scipy.linalg import eigh

from nmt_blind.campaign.foreign_case import read_cases
from nmt_laboratories import laboratory_two as lab
from nmt_laboratories.campaign_frame import seeds_of
from nmt_laboratories.modal_simulator import KINDS, Element, Simulator, fundamental, iwan

HZ, ZETA = 20.0, 0.005
OMEGA = 2.0 * math.pi * HZ
ONE = np.array([1.0])


def single(*elements: Element, zeta: float = ZETA, fine: int = 400) -> Simulator:
    """A mass of 1 kg."""
    return Simulator(np.array([HZ]), np.array([zeta]), ONE, elements, fine=fine)


def test_a_free_decay_has_the_closed_form() -> None:
    simulator = single()
    simulator.state[:2] = 1e-3, -ZETA * OMEGA * 1e-3
    rows, _ = simulator.sine(0.0, HZ, 50, per_period=40)
    time = np.arange(rows.shape[0]) / (40 * HZ)
    damped = OMEGA * math.sqrt(1.0 - ZETA**2)
    expected = 1e-3 * np.exp(-ZETA * OMEGA * time) * np.cos(damped * time)
    assert abs(rows[:, 0] - expected).max() < 1e-9 * 1e-3


@pytest.mark.parametrize("rig", ["beam", "mast"])
def test_linear_responses_agree_with_the_integration(rig: str) -> None:
    """Table and force; the integration goes on until two windows agree within 5e-4."""
    specimen = lab.draw_specimen(rig, np.random.default_rng(4))
    specimen = lab.replace(specimen, ratios=np.full(specimen.ratios.size, 0.02))
    lines = specimen.frequencies_hz[0] * np.array([0.97, 1.0, 1.03])
    nothing = (Element("cubic", np.zeros(specimen.ratios.size), (0.0,)),)
    draw = np.random.default_rng(1)
    integrated, _, unsteady = lab.stepped_sine(specimen, nothing, 0.1, lines, draw)
    exact, _, _ = lab.stepped_sine(specimen, (), 0.1, lines, draw)
    assert unsteady[0] == 0
    assert np.all(abs(integrated - exact) < 1e-3 * abs(exact))


def test_a_duffing_oscillator_has_its_backbone() -> None:
    """ω² = ω₀² + ¾ k a² at phase resonance, to first order (Nayfeh and Mook), and the damping of a linear damper."""
    specimen = lab.draw_specimen("strip", np.random.default_rng(3))
    shape = specimen.shapes[1]
    omega = 2.0 * math.pi * specimen.frequencies_hz[0]
    k = 2.0 * 0.01 * omega**2 / (0.75 * (specimen.largest * shape[0]) ** 2)
    own = (Element("cubic", shape, (k,)),)
    rows = lab.backbone(specimen, own, lab.drive_for(specimen) * np.array([0.3, 0.7, 1.0]))
    expected = np.sqrt(omega**2 + 0.75 * k * (rows[:, 1] * shape[0]) ** 2) / (2.0 * math.pi)
    assert np.all(abs(rows[:, 0] / expected - 1.0) < 0.05 * (rows[:, 0] / specimen.frequencies_hz[0] - 1.0) + 1e-5)
    # What the spring stores it gives back: the power over ω³ q² is ζ ω₀ / ω.
    ratio = specimen.ratios[0] * specimen.frequencies_hz[0] / rows[:, 0]
    assert np.all(abs(rows[:, 2] / ratio - 1.0) < 2e-3)


def test_a_slider_takes_the_energy_of_its_loop() -> None:
    """4 Fₛ (A − Fₛ/k) a period at a prescribed amplitude, and Iwan's sliders the integral of it."""
    stiffness, force = 0.1 * OMEGA**2, 0.02
    for sliders in (((stiffness, force),), iwan(stiffness, 2.0 * force / stiffness)):
        simulator = single(Element("sliders", ONE, sliders=sliders), zeta=0.002)
        for _ in range(30):
            simulator.sine(0.05, HZ, 20)
        rows, forces = simulator.sine(0.05, HZ, 1, per_period=2000)
        work = np.trapezoid(np.append(forces[:, 0], forces[0, 0]), np.append(rows[:, 0], rows[0, 0]))
        # The motion is a sine within percents, but its extremes are what the loop depends on.
        amplitude = np.ptp(rows[:, 0]) / 2.0
        loops = [4.0 * f * max(amplitude - f / k, 0.0) for k, f in sliders]
        assert amplitude > 1.5 * force / stiffness
        assert work == pytest.approx(sum(loops), rel=5e-3)


PARAMETERS = {
    "cubic": (0.1 * OMEGA**2 / 1e-6,),
    "quintic": (0.1 * OMEGA**2 / 1e-12,),
    "drag": (3.0,),
    "amplitude_damper": (2e6,),
    "stop": (0.2 * OMEGA**2, 4e-4),
    "gap": (0.1 * OMEGA**2, 4e-4),
    "sliders": (),
    "stribeck": (0.02, 1e-3, 1.5, 0.05),
    "lugre": (0.1 * OMEGA**2, 0.3, 0.05, 0.1, 0.05),
    "bouc_wen": (0.1 * OMEGA**2, 2e-4, 1.5, 0.2),
    "backlash": (0.1 * OMEGA**2, 4e-4, 0.1 * OMEGA**2 / 0.2),
    "eddy_brake": (2.0, 0.05),
    "damper": (0.7,),
    "polynomial": (0.05 * OMEGA**2, 20.0 * OMEGA**2, 0.1 * OMEGA**2 / 1e-6, 0.1 * OMEGA**2 / 1e-12),
    "magnet": (0.02 * OMEGA**2 * 2e-3**3, 2e-3),
    "pinched": (0.1 * OMEGA**2, 2e-4, 1.5, 2.0, 5e-5),
}


def element_of(kind: str) -> Element:
    return Element(kind, ONE, PARAMETERS[kind], ((0.1 * OMEGA**2, 0.02),) if kind == "sliders" else ())


@pytest.mark.parametrize("kind", list(KINDS))
def test_energy_is_balanced(kind: str) -> None:
    """What the drive brings in is stored or taken by damper and element, which never gives more than it got."""
    simulator = single(element_of(kind))
    rows, forces = simulator.sine(0.5, HZ, 30, per_period=1000)
    step = 1.0 / (1000 * HZ)
    velocity = rows[:, 1]
    brought = np.trapezoid(rows[:, -1] * velocity, dx=step)
    damped = np.trapezoid(2.0 * ZETA * OMEGA * velocity**2, dx=step)
    taken = np.trapezoid(forces[:, 0] * velocity, dx=step)
    stored = 0.5 * (velocity[-1] ** 2 + OMEGA**2 * rows[-1, 0] ** 2)
    assert abs(rows[:, 0]).max() > 3e-4
    assert brought == pytest.approx(damped + taken + stored, rel=2e-4)
    assert taken > -1e-6 * brought


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("sliders", "damper")])
def test_another_integrator_finds_the_same_motion(kind: str) -> None:
    """The forces as they stand in the table of elements, by DOP853 with its step controlled."""
    simulator = single(element_of(kind))
    rows, _ = simulator.sine(0.5, HZ, 8, per_period=50)
    p = PARAMETERS[kind]

    def law(w: float, v: float, z: float) -> tuple[float, float]:
        if kind == "lugre":
            rate = v - p[0] * abs(v) * z / (p[2] + (p[3] - p[2]) * math.exp(-((v / p[4]) ** 2)))
            return p[0] * z + p[1] * rate, rate
        if kind == "bouc_wen":
            rate = v * (1.0 - abs(z / p[1]) ** p[2] * 0.5 * (1.0 + np.sign(v * z)))
            return p[0] * (p[3] * w + (1.0 - p[3]) * z), rate
        if kind == "pinched":
            rate = v * (1.0 - abs(z / p[1]) ** p[2] * 0.5 * (1.0 + np.sign(v * z)))
            return p[0] * z, rate / (1.0 + p[3] * math.exp(-((z / p[4]) ** 2)))
        beyond = abs(w) - p[-1 if kind in ("stop", "gap") else 1] if kind in ("stop", "gap", "backlash") else 0.0
        outward = math.copysign(1.0, w)
        return {
            "cubic": lambda: p[0] * w**3,
            "quintic": lambda: p[0] * w**5,
            "drag": lambda: p[0] * v * abs(v),
            "amplitude_damper": lambda: p[0] * w**2 * v,
            "stop": lambda: p[0] * max(w - p[1], 0.0),
            "gap": lambda: outward * p[0] * max(beyond, 0.0),
            "stribeck": lambda: p[0] * math.tanh(v / p[1]) * (1.0 + p[2] * math.exp(-((v / p[3]) ** 2))),
            "backlash": lambda: outward * max(beyond * (p[0] + p[2] * v * outward), 0.0) if beyond > 0.0 else 0.0,
            "eddy_brake": lambda: p[0] * v / (1.0 + (v / p[1]) ** 2),
            "polynomial": lambda: w * (p[0] + w * (p[1] + w * (p[2] + w**2 * p[3]))),
            "magnet": lambda: 4.0 * p[0] * w * (p[1] / (p[1] ** 2 - w**2) ** 2 - p[1] ** -3),
        }[kind](), 0.0

    def rates(t: float, y: np.ndarray) -> list[float]:
        force, rate = law(y[0], y[1], y[2])
        drive = 0.5 * t * HZ / 8.0 * math.cos(OMEGA * t)
        return [y[1], drive - OMEGA**2 * y[0] - 2.0 * ZETA * OMEGA * y[1] - force, rate]

    time = np.arange(rows.shape[0]) / (50 * HZ)
    options = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-12, "max_step": 2.5e-4}
    found = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0, 0.0], t_eval=time, **options).y[0]
    assert abs(rows[:, 0] - found).max() < 2e-4 * abs(found).max()


@pytest.mark.parametrize("clamped", [True, False])
def test_bending_modes_meet_their_boundaries_and_are_orthogonal(clamped: bool) -> None:
    roots = lab.bending_roots(clamped, 3)
    known = [4.7300407449, 7.8532046241, 10.9956078380] if clamped else [1.8751040687, 4.6940911330, 7.8547574382]
    assert roots == pytest.approx(known, abs=1e-9)
    for i, first in enumerate(roots):
        for j, second in enumerate(roots):
            product = quad(
                lambda x, a=first, b=second: float(
                    lab.bending_shape(a, clamped, x) * lab.bending_shape(b, clamped, x)
                ), 0.0, 1.0, limit=200,
            )[0]  # fmt: skip
            assert product == pytest.approx(float(i == j), abs=1e-8)
    end = abs(float(lab.bending_shape(roots[0], clamped, 1.0)))
    assert end == pytest.approx(0.0 if clamped else 2.0, abs=1e-8)


def test_the_owners_elements_have_the_modes_of_the_mast() -> None:
    """Frequencies, shapes and participation in closed form against matrices of another discretisation."""
    specimen = lab.draw_specimen("mast", np.random.default_rng(8))
    mass, stiffness, load = lab.mast_matrices(specimen)
    values, shapes = eigh(stiffness, mass)
    assert np.sqrt(values[:3]) / (2.0 * math.pi) == pytest.approx(specimen.frequencies_hz, rel=3e-4)
    assert abs(shapes[:, :3].T @ load) == pytest.approx(abs(specimen.participation), rel=2e-3)
    assert abs(shapes[22, :3]) == pytest.approx(abs(specimen.shapes[12]), rel=1e-3)
    # Mass that the first three modes move, over the whole (Clough and Penzien): 61.3, 18.8 and 6.5 %.
    assert specimen.participation**2 / specimen.mass == pytest.approx([0.6131, 0.1883, 0.0647], abs=1e-4)


def test_a_tap_moves_the_plate_as_far_as_was_meant() -> None:
    specimen = lab.draw_specimen("plate", np.random.default_rng(5))
    shape, omega = specimen.shapes[1], 2.0 * math.pi * specimen.frequencies_hz[0]
    simulator = Simulator(specimen.frequencies_hz, specimen.ratios, specimen.load)
    size = specimen.largest * omega**2 / shape[0] ** 2 * 0.65
    rate = 40.0 * specimen.frequencies_hz[0]
    rows, _ = simulator.tap(size, 0.5 / specimen.frequencies_hz[0], 80, rate)
    assert abs(rows[:, 0] * shape[0]).max() == pytest.approx(specimen.largest, rel=0.1)


def test_a_case_is_written_whole_and_says_nothing_of_its_truth(tmp_path: Path) -> None:
    """The same seed gives the same files, every third case is healthy, and a case that is there is left alone."""
    names = [lab.make_case(tmp_path / "first", seed) for seed in (0, 1, 3)]
    cases = {case.name: case for case in read_cases(tmp_path / "first")}
    assert [cases[name].truth.kind == "healthy" for name in names] == [True, False, True]
    for name, seed in zip(names, (0, 1, 3), strict=True):
        assert lab.make_case(tmp_path / "second", seed) == name
        for file in (tmp_path / "first" / name).iterdir():
            assert file.read_bytes() == (tmp_path / "second" / name / file.name).read_bytes()
            if file.name != "truth.yaml":
                text = file.read_text()
                assert "effect" not in text
                assert "healthy" not in text
    truth = tmp_path / "first" / names[1] / "truth.yaml"
    truth.write_text("{kind: healthy, verdicts: [none]}")
    lab.make_case(tmp_path / "first", 1)
    assert yaml.safe_load(truth.read_text())["kind"] == "healthy"


def test_every_effect_can_be_injected() -> None:
    """A strength for each, which shifts the first resonance by percents or adds to its damping as much as it has."""
    for rig in lab.RIGS:
        specimen = lab.draw_specimen(rig, np.random.default_rng(2))
        chain = lab.draw_chain(specimen, np.random.default_rng(3))
        for name in {*lab.KNOWN[rig], *lab.UNKNOWN}:
            injected = lab.inject(name, specimen, np.random.default_rng(6))
            assert injected.elements or injected.chain(chain) != chain
            assert (injected.truth["kind"] == "unknown") == (name in lab.UNKNOWN)
    assert list(seeds_of("3:5")) == [3, 4]
    assert abs(fundamental(np.cos(2.0 * np.pi * np.arange(40) / 20), 2) - 1.0) < 1e-12
