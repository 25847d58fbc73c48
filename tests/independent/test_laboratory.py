"""Two simulators that share no code: the laboratory's own witnesses, and the bench on what it recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from independent.laboratory import CHANNELS, Chain, Laboratory, MeasuringChain, derivative, record
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from nmt_bench.cli import main
from nmt_diagnose.diagnose import diagnose_bags
from nmt_extract.offline import extract_bag

PLAIN = MeasuringChain(hold=False)
STRONG = Chain(cubic=4e11, stop=3e5, stop_gap=2e-5, gap_stiffness=2e5, gap=3e-5)


def resonance_hz(chain: Chain) -> float:
    """Frequency at which the force at mass 1 is in phase with its velocity, from the matrices alone."""
    mass, damping, stiffness = chain.linear_matrices()

    def reactance(frequency: float) -> float:
        omega = 2.0 * np.pi * frequency
        receptance = np.linalg.inv(stiffness - omega**2 * mass + 1j * omega * damping)[0, 0]
        return float((1j * omega * receptance).imag)

    undamped = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)[1]) / (2.0 * np.pi)
    return float(brentq(reactance, 0.999 * undamped, 1.001 * undamped))


def damping_ratio(chain: Chain) -> float:
    """Of the second mode (the first is the suspension's), from the complex eigenvalues."""
    mass, damping, stiffness = chain.linear_matrices()
    zero, one = np.zeros((3, 3)), np.eye(3)
    state = np.block([[zero, one], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]])
    values = np.linalg.eigvals(state)
    values = values[values.imag > 0]
    mode = values[np.argsort(np.abs(values))][1]
    return float(-mode.real / abs(mode))


@pytest.mark.campaign
def test_the_integrator_agrees_with_an_adaptive_one() -> None:
    """Fixed steps of Runge–Kutta against DOP853 with tight tolerances, all nonlinear forces at work."""
    lab = Laboratory(STRONG, PLAIN, sample_rate=5000.0, substeps=48)
    samples, frequency, amplitude = 400, 97.0, 6.0
    ours = lab.play(amplitude, frequency, samples)
    parameters = STRONG.parameters()

    def right_hand_side(time: float, state: np.ndarray) -> np.ndarray:
        out = np.empty(9)
        derivative(state, amplitude * np.cos(2.0 * np.pi * frequency * time), parameters, out)
        return out

    instants = np.arange(samples) / 5000.0
    peer = solve_ivp(
        right_hand_side, (0.0, instants[-1]), np.zeros(9), "DOP853", instants, rtol=1e-11, atol=1e-16, max_step=2e-5
    )
    accelerations = np.empty((samples, 3))
    forces = np.empty(samples)
    for index in range(samples):
        out = np.empty(9)
        drive = amplitude * np.cos(2.0 * np.pi * frequency * instants[index])
        forces[index] = derivative(peer.y[:, index], drive, parameters, out)
        accelerations[index] = out[3:6]
    assert np.max(np.abs(peer.y[2])) > 3e-5, "the gap must have closed"
    assert ours[:, 2:] == pytest.approx(accelerations, abs=2e-5 * np.max(np.abs(accelerations)))
    assert ours[:, 1] == pytest.approx(forces, abs=2e-5 * np.max(np.abs(forces)))


@pytest.mark.campaign
def test_energy_is_balanced() -> None:
    """What the drive puts in over a period at steady state is what resistance and dampers take out."""
    chain = replace(Chain(), cubic=2e9)
    lab = Laboratory(chain, PLAIN, sample_rate=4850.0, substeps=24)  # 50 samples a period of 97 Hz
    lab.play(1.0, 97.0, 50 * 400, start=0.0)
    lab.play(1.0, 97.0, 50 * 6000)
    before, cycles = lab._state.copy(), lab._cycles
    lab.play(1.0, 97.0, 50)
    assert lab._state == pytest.approx(before, rel=1e-6, abs=1e-9)
    # The load cell's power into the structure against what the structure's dampers take, both by the trapezium rule.
    state, parameters, out = before, chain.parameters(), np.empty(9)
    step = 1.0 / (4850.0 * 24)
    powers, losses = [], []
    (c1, c2), cg = chain.dampers, chain.ground_damper
    y = state.copy()
    for index in range(50 * 24):
        first, half, last = np.cos(2.0 * np.pi * (cycles + (index + np.array([0.0, 0.5, 1.0])) / (50 * 24)))
        force = derivative(y, first, parameters, out)
        v1, v2, v3 = y[3:6]
        powers.append(force * v1)
        losses.append(c1 * (v1 - v2) ** 2 + c2 * (v2 - v3) ** 2 + cg * (v1**2 + v2**2 + v3**2))
        k1 = out.copy()
        k2, k3, k4 = np.empty(9), np.empty(9), np.empty(9)
        derivative(y + 0.5 * step * k1, half, parameters, k2)
        derivative(y + 0.5 * step * k2, half, parameters, k3)
        derivative(y + step * k3, last, parameters, k4)
        y = y + step / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
    assert np.mean(powers) == pytest.approx(np.mean(losses), rel=1e-3)


def test_the_measuring_chain_does_what_it_says() -> None:
    """Gain, phase and delay of a sine against the closed form; quantisation and clock as stated."""
    plain = Laboratory(Chain(), replace(PLAIN, noise=(0.0,) * 5, bits=0))
    plain.play(0.5, 97.0, 5000)
    chain = MeasuringChain(
        gains=(1.0, 1.02, 0.97, 1.0, 1.0), phases=(0.0, 0.02, 0.0, 0.0, 0.0), delays=(0.0, 0.0, 50e-6, 0.0, 0.0),
        noise=(0.0,) * 5, bits=0, hold=False,
    )  # fmt: skip
    altered = Laboratory(Chain(), chain)
    altered.play(0.5, 97.0, 5000)
    phase = 2.0 * np.pi * 97.0 / 5000.0 * np.arange(2500, 5000)
    basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones(phase.size)])

    def fundamentals(lab: Laboratory) -> np.ndarray:
        cosine, sine = np.linalg.lstsq(basis, lab.recording()[2500:5000], rcond=None)[0][:2]
        return np.asarray(cosine - 1j * sine)

    ratio = fundamentals(altered) / fundamentals(plain)
    assert ratio[1] == pytest.approx(1.02 * np.exp(0.02j), rel=2e-3)
    assert ratio[2] == pytest.approx(0.97 * np.exp(-2j * np.pi * 97.0 * 50e-6), rel=1e-4)
    assert ratio[[0, 3, 4]] == pytest.approx(np.ones(3), rel=1e-9)


@pytest.mark.campaign
def test_the_bench_reads_the_foreign_laboratory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Imported, a linear chain has the frequency and damping of its matrices, and the diagnosis finds no gap."""
    chain = Chain()
    expected = resonance_hz(chain)
    recorded = record(tmp_path, chain, PLAIN, (0.2, 0.5, 1.0), start_hz=expected)
    assert recorded.frequencies == pytest.approx([expected] * 3, rel=2e-6)
    assert len(CHANNELS) == 5
    bag = tmp_path / "imported"
    assert main(["import", str(recorded.sidecar), "--out", str(bag)]) == 0
    capsys.readouterr()
    points = extract_bag(bag / "bag").points
    assert len(points) == 3
    for point in points:
        assert point.frequency_hz == pytest.approx(expected, rel=3e-6)
        assert point.damping_ratio == pytest.approx(damping_ratio(chain), rel=5e-3)
    modal = tmp_path / "modal"
    assert main(["extract", str(bag), "--out", str(modal)]) == 0
    assert "time in the window / periods" in (modal / "report.html").read_text()
    outcome = diagnose_bags(recorded.model, [bag / "bag"])
    assert outcome.diagnosis.verdict.value == "none"
