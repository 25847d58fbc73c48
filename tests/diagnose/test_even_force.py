"""A backbone bent by an even force: its frequency falls with the square of the strength, which no first order shows."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nmt_bench.cli import main

HZ, RATIO, SCALE = 80.0, 0.005, 2e-3  # Hz; damping ratio; m
OMEGA = 2.0 * np.pi * HZ
QUADRATIC = 0.5 * OMEGA**2 / SCALE  # N/m² for 1 kg


def free_vibration(top: float) -> tuple[float, float]:
    """Frequency (Hz) and fundamental amplitude (m) of x″ + ω² x + k x² = 0 from a turning point, by integration."""

    def turning(_: float, state: np.ndarray) -> float:
        return float(state[1])

    turning.direction = -1.0  # type: ignore[attr-defined]
    slope = lambda _, s: (s[1], -(OMEGA**2) * s[0] - QUADRATIC * s[0] ** 2)  # noqa: E731
    found = solve_ivp(slope, (0.0, 1.6 / HZ), (top, 0.0), events=turning, dense_output=True, rtol=1e-11, atol=1e-15)
    period = next(t for t in found.t_events[0] if t > 0.2 / HZ)
    times = np.arange(256) / 256 * period
    fundamental = 2.0 * np.mean(found.sol(times)[0] * np.exp(-2j * np.pi * times / period))
    return 1.0 / period, float(abs(fundamental))


def test_free_vibration_against_the_perturbation_solution() -> None:
    hz, amplitude = free_vibration(0.02 * SCALE)
    # Nayfeh and Mook, Nonlinear Oscillations, eq. 2.3.34.
    assert hz / HZ - 1.0 == pytest.approx(-5.0 / 12.0 * (QUADRATIC * amplitude / OMEGA**2) ** 2, rel=0.01)


@pytest.mark.campaign
def test_an_even_force_is_found_in_a_backbone(tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    rows = ["frequency_hz,amplitude,damping_ratio"]
    for top in np.geomspace(0.05, 0.8, 12) * SCALE:
        hz, amplitude = free_vibration(float(top))
        noise = 1.0 + np.array([4e-4, 1e-3, 0.04]) * random.standard_normal(3)
        rows.append(f"{hz * noise[0]},{amplitude * 1e3 * noise[1]},{RATIO * HZ / hz * noise[2]}")
    (tmp_path / "table.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(
        f"name: arch\nstructure: {{kind: modal, modes: [{{frequency_hz: {HZ}, damping_ratio: {RATIO}, "
        "modal_mass_kg: 1.0}]}\n",
        encoding="utf-8",
    )
    (tmp_path / "table.yaml").write_text(
        "rig: rig.yaml\nfile: table.csv\nsegments: [{kind: backbone, unit: mm, point: 1}]\n", encoding="utf-8"
    )
    assert main(["import", str(tmp_path / "table.yaml"), "--out", str(tmp_path / "bag")]) == 0
    words = ["--quiet", "--jobs", "1", "--model", str(tmp_path / "rig.yaml"), "--real", str(tmp_path / "bag")]
    assert main(["diagnose", *words, "--out", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "effect"
    assert found["gap"]["closed"] >= 0.95
    named = {entry["effect"]: entry for entry in found["ranking"]}
    assert "quadratic_stiffness" in named
    spring = named["quadratic_stiffness"]["parameters"]["k"]
    assert abs(abs(spring["value"]) - QUADRATIC) < 3.0 * spring["std"]
