"""Backbones of a simulator that shares no code with the bench: its witnesses, and what the diagnosis says of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from independent.structure_at_a_point import Bench, Structure, backbone_table, iwan_joint

from nmt_bench.cli import main


def test_a_linear_structure_has_its_own_frequency_and_damping() -> None:
    frequency, amplitude, ratio = Bench(Structure((130.0,), (0.004,))).point(2.0)
    omega = 2.0 * np.pi * 130.0
    assert frequency == pytest.approx(130.0, rel=2e-5)
    assert ratio == pytest.approx(0.004, rel=2e-3)
    # In a harmonic motion at this frequency the drive is a sine of the force's amplitude.
    assert amplitude == pytest.approx(2.0 / (2.0 * 0.004 * omega**2), rel=5e-3)


def test_a_cubic_spring_hardens_as_harmonic_balance_says() -> None:
    """ω² = ω₀² + ¾ k₃ a² to first order; the next order is 3/128 (k₃ a²/ω₀²)² of ω₀²."""
    omega = 2.0 * np.pi * 130.0
    cubic = 0.2 * omega**2 / 0.5e-3**2
    frequency, amplitude, _ = Bench(Structure((130.0,), (0.004,), cubic=cubic)).point(1.0)
    expected = np.sqrt(omega**2 + 0.75 * cubic * amplitude**2) / (2.0 * np.pi)
    assert frequency / 130.0 > 1.01
    assert frequency == pytest.approx(expected, rel=2e-4)


def test_a_joint_dissipates_as_its_distribution_says() -> None:
    """Work of a cycle ∫₀ᵃ 4 φ (a − φ) ρ dφ of the power law, over 2π ω² a²."""
    stiffness, largest, exponent = 1.1e5, 2e-4, -0.5
    structure = Structure((160.0,), (0.001,), joint=iwan_joint(stiffness, largest, exponent, 200, 1e-4))
    frequency, amplitude, ratio = Bench(structure).point(1.0)
    assert 0.05 < amplitude / largest < 0.9
    factor = stiffness * (exponent + 1.0) / largest ** (exponent + 1.0)
    work = 4.0 * factor * amplitude ** (exponent + 3.0) / ((exponent + 2.0) * (exponent + 3.0))
    omega = 2.0 * np.pi * frequency
    own = 0.001 * 160.0 / frequency
    assert ratio == pytest.approx(own + work / (2.0 * np.pi * omega**2 * amplitude**2), rel=0.02)


def diagnosed(folder: Path, structure: Structure, model: tuple[float, float], scatter: tuple[float, float, float],
              forces: np.ndarray, seed: int) -> dict[str, Any]:  # fmt: skip
    """``diagnosis.json`` of a backbone, from a model of one linear mode that is a little off."""
    backbone_table(structure, forces, folder / "table.csv", scatter, seed)
    (folder / "rig.yaml").write_text(
        f"name: one_mode\nstructure: {{kind: modal, modes: [{{frequency_hz: {model[0]}, damping_ratio: {model[1]}, "
        "modal_mass_kg: 1.0}]}\n",
        encoding="utf-8",
    )
    (folder / "table.yaml").write_text(
        "rig: rig.yaml\nfile: table.csv\nsegments: [{kind: backbone, unit: mm, point: 1}]\n", encoding="utf-8"
    )
    assert main(["import", str(folder / "table.yaml"), "--out", str(folder / "bag")]) == 0
    words = ["--quiet", "--jobs", "1", "--model", str(folder / "rig.yaml"), "--real", str(folder / "bag")]
    assert main(["diagnose", *words, "--out", str(folder / "out")]) == 0
    result: dict[str, Any] = json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    return result


def off(parameter: dict[str, float], truth: float) -> float:
    """Distance from the truth in stated standard uncertainties."""
    return abs(parameter["value"] - truth) / parameter["std"]


def test_a_bolted_joint_is_micro_slip_with_its_own_stiffness_and_exponent(tmp_path: Path) -> None:
    stiffness = 0.1 * (2.0 * np.pi * 168.0) ** 2
    structure = Structure((161.0,), (0.0012,), joint=iwan_joint(stiffness, 2e-4, -0.5))
    found = diagnosed(tmp_path, structure, (168.5, 0.0014), (5e-4, 0.01, 0.06), np.geomspace(0.02, 6.0, 14), 3)
    first = found["ranking"][0]
    assert found["verdict"] == "effect"
    assert first["effect"] == "microslip"
    assert off(first["parameters"]["kt"], stiffness) < 3.0
    assert off(first["parameters"]["chi"], -0.5) < 3.0
    assert found["gap"]["closed"] > 0.9


def test_a_clamped_beam_is_cubic_beside_its_second_mode_and_a_weak_even_force(tmp_path: Path) -> None:
    omega = 2.0 * np.pi * 132.4
    cubic = omega**2 / 0.5e-3**2
    structure = Structure(
        (132.4, 364.0), (0.004, 0.003), (1.0, -0.6), cubic=cubic, quadratic=0.1 * omega**2 / 0.5e-3
    )  # fmt: skip
    found = diagnosed(tmp_path, structure, (131.0, 0.0035), (3e-3, 0.01, 0.08), np.geomspace(0.05, 4.0, 14), 1)
    first = found["ranking"][0]
    assert found["verdict"] == "effect"
    assert first["effect"] == "cubic_stiffness"
    assert off(first["parameters"]["k"], cubic) < 3.0
    assert found["gap"]["closed"] > 0.9


def test_a_linear_beam_with_scatter_has_no_effect(tmp_path: Path) -> None:
    structure = Structure((132.0,), (0.0041,))
    found = diagnosed(tmp_path, structure, (131.0, 0.0035), (1.5e-3, 0.01, 0.06), np.geomspace(0.05, 2.0, 12), 5)
    assert found["verdict"] in ("none", "calibration")
