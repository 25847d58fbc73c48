"""A simulator that shares no code with the bench: its witnesses, and what the diagnosis says of its recordings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmt_bench.cli import main
from nmt_laboratories.structure_at_a_point import Bench, Structure, backbone_table, iwan_joint


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


def test_a_decay_loses_what_its_dampers_take() -> None:
    """c x² v takes c a⁴ ω / 4 of the power a cycle: ȧ = −ζ ω a − c a³ / 8, which has a closed form."""
    frequency, ratio, factor, rate = 47.0, 0.003, 4e6, 2048.0
    speed = Bench(Structure((frequency,), (ratio,), square_damping=factor)).decay(2.0, 2.0, rate)
    omega, times = 2.0 * np.pi * frequency, np.arange(len(speed)) / rate
    windows = [slice(k, k + 436) for k in range(0, len(speed) - 436, 436)]  # ten periods
    turning = np.exp(-1j * omega * times)
    found = np.array([2.0 * abs(np.mean(speed[own] * turning[own])) / omega for own in windows])
    middle = np.array([times[own].mean() for own in windows])
    share = factor / (8.0 * ratio * omega)
    start = found[0] ** -2 + share
    expected = (start * np.exp(2.0 * ratio * omega * (middle - middle[0])) - share) ** -0.5
    assert found[0] ** 2 * share > 0.5
    assert found == pytest.approx(expected, rel=0.01)


def test_a_linear_response_is_that_of_its_modes() -> None:
    frequencies, ratios, shape = (133.0, 364.0), (0.004, 0.003), (1.0, -0.6)
    lines = np.array([120.0, 132.5, 133.0, 134.0, 150.0])
    found = Bench(Structure(frequencies, ratios, shape)).response(0.5, lines)
    omega = 2.0 * np.pi * lines
    expected = sum(
        p**2 / ((2.0 * np.pi * f) ** 2 - omega**2 + 2j * z * 2.0 * np.pi * f * omega)
        for f, z, p in zip(frequencies, ratios, shape, strict=True)
    )
    assert found == pytest.approx(expected, rel=1e-3)


def test_a_gap_stiffens_as_harmonic_balance_says() -> None:
    """First harmonic of max(|x| − g, 0): the describing function of a dead zone."""
    omega, gap, stiffness = 2.0 * np.pi * 133.0, 1.5e-4, 2e4
    frequency, amplitude, _ = Bench(Structure((133.0,), (0.005,), stop=(stiffness, gap))).point(2.0)
    ratio = gap / amplitude
    assert 0.1 < ratio < 0.8
    share = 1.0 - 2.0 / np.pi * (np.arcsin(ratio) + ratio * np.sqrt(1.0 - ratio**2))
    assert frequency == pytest.approx(np.sqrt(omega**2 + stiffness * share) / (2.0 * np.pi), rel=1e-4)


def diagnosed(folder: Path, structure: Structure, model: tuple[float, float], scatter: tuple[float, float, float],
              forces: np.ndarray, seed: int) -> dict[str, Any]:  # fmt: skip
    """``diagnosis.json`` of a backbone, from a model of one linear mode that is a little off."""
    backbone_table(structure, forces, folder / "table.csv", scatter, seed)
    return told(folder, model, "file: table.csv\nsegments: [{kind: backbone, unit: mm, point: 1}]\n")


def of_decay(folder: Path, structure: Structure, model: tuple[float, float], force: float, seconds: float,
             rate: float, seed: int) -> dict[str, Any]:  # fmt: skip
    """``diagnosis.json`` of a decay as a laser vibrometer sees it, with noise, an offset and hum."""
    speed, generator = Bench(structure).decay(force, seconds, rate), np.random.default_rng(seed)
    times, full = np.arange(len(speed)) / rate, float(np.max(np.abs(speed)))
    speed += full * (0.002 * generator.standard_normal(len(speed)) + 0.002)
    speed += full * 0.002 * np.sin(2.0 * np.pi * 50.0 * times + 1.0)
    lines = ["time,v1", *(f"{time:.9g},{value:.8g}" for time, value in zip(times, speed, strict=True))]
    (folder / "decay.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return told(
        folder, model, "file: decay.csv\nchannels:\n  - {column: v1, quantity: velocity, unit: m/s, point: 1}\n"
        f"segments:\n  - {{kind: ring_down, start: 0.0, stop: {times[-1]:.9g}}}\n",
    )  # fmt: skip


def of_responses(folder: Path, structure: Structure, model: tuple[float, float], forces: tuple[float, ...],
                 lines: np.ndarray, seed: int) -> dict[str, Any]:  # fmt: skip
    """``diagnosis.json`` of mobilities stepped up and down at held forces, 1 % and 0.3° off, with scatter of 0.4 %."""
    generator, segments = np.random.default_rng(seed), []
    for force in forces:
        for direction, frequencies in (("up", lines), ("down", lines[::-1])):
            response = 2j * np.pi * frequencies * Bench(structure).response(force, frequencies)
            scatter = 0.004 * (generator.standard_normal(len(lines)) + 1j * generator.standard_normal(len(lines)))
            response *= 1.01 * np.exp(1j * np.radians(0.3) + scatter)
            rows = sorted(zip(frequencies, response.real, response.imag, strict=True))
            name = f"{direction}_{force:g}.csv"
            text = ["frequency_hz,real,imag", *(f"{f:.8g},{a:.8g},{b:.8g}" for f, a, b in rows)]
            (folder / name).write_text("\n".join(text) + "\n", encoding="utf-8")
            segments.append(
                f"  - {{kind: frf, file: {name}, unit: m/s/N, point: 1, drive_point: 1, level: {force:g}, "
                f"level_unit: N, direction: {direction}, name: {force:g} N {direction}}}\n"
            )
    return told(folder, model, f"file: up_{forces[0]:g}.csv\nsegments:\n" + "".join(segments))


def of_windows(
    folder: Path, structure: Structure, model: tuple[float, float], forces: np.ndarray, seed: int
) -> dict[str, Any]:
    """``diagnosis.json`` of steady vibration at phase resonance, force and acceleration 1 % off, 0.2 % of noise."""
    generator, bench, rate, seconds = np.random.default_rng(seed), Bench(structure), 2048.0, 1.2
    signals = np.hstack([bench.locked(float(force), seconds, rate) for force in forces])
    noise = 0.002 * signals.std(axis=1, keepdims=True) * generator.standard_normal(signals.shape)
    force, acceleration = signals + noise
    times = np.arange(force.size) / rate
    np.savez(folder / "windows.npz", time=times, f1=force, a1=1.01 * acceleration)
    length = int(seconds * rate) / rate
    segments = "".join(
        f"  - {{kind: phase_resonance, start: {k * length:.9g}, stop: {(k + 1) * length - 0.5 / rate:.9g}, window: "
        f"[{k * length + 0.1:.9g}, {(k + 1) * length - 0.05:.9g}], level: {level:.6g}, level_unit: N}}\n"
        for k, level in enumerate(forces)
    )
    return told(
        folder, model, "file: windows.npz\nchannels:\n  - {column: f1, quantity: force, unit: N, point: 1}\n"
        "  - {column: a1, quantity: acceleration, unit: m/s^2, point: 1}\nsegments:\n" + segments,
    )  # fmt: skip


def told(folder: Path, model: tuple[float, float], recording: str) -> dict[str, Any]:
    """``diagnosis.json`` of a recording, by the commands."""
    (folder / "rig.yaml").write_text(
        f"name: one_mode\nstructure: {{kind: modal, modes: [{{frequency_hz: {model[0]}, damping_ratio: {model[1]}, "
        "modal_mass_kg: 1.0}]}\n",
        encoding="utf-8",
    )
    (folder / "table.yaml").write_text(f"rig: rig.yaml\n{recording}", encoding="utf-8")
    assert main(["import", str(folder / "table.yaml"), "--out", str(folder / "bag")]) == 0
    words = ["--quiet", "--jobs", "1", "--model", str(folder / "rig.yaml"), "--real", str(folder / "bag")]
    assert main(["diagnose", *words, "--out", str(folder / "out")]) == 0
    result: dict[str, Any] = json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    return result


def off(parameter: dict[str, float], truth: float) -> float:
    """Distance from the truth in stated standard uncertainties."""
    return abs(parameter["value"] - truth) / parameter["std"]


def assert_named(found: dict[str, Any], effect: str, **parameter: float) -> None:
    """An effect with a parameter within three of its standard uncertainties, which closes nine tenths of the gap."""
    ((key, value),) = parameter.items()
    first = found["ranking"][0]
    assert found["verdict"] == "effect"
    assert first["effect"] == effect
    assert off(first["parameters"][key], value) < 3.0
    assert found["gap"]["closed"] > 0.9


def expect_gap(found: dict[str, Any], stiffness: float, gap: float) -> None:
    """A two-sided gap is named first, with the truth inside, and explains nearly all."""
    first = found["ranking"][0]
    assert found["verdict"] == "effect"
    assert first["effect"] == "two_sided_gap"
    assert off(first["parameters"]["k"], stiffness) < 3.0
    assert off(first["parameters"]["gap"], gap) < 3.0
    assert found["gap"]["closed"] > 0.9


@pytest.mark.campaign
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


@pytest.mark.campaign
def test_a_contact_that_the_model_takes_for_a_spring_is_named_when_it_slips(tmp_path: Path) -> None:
    """The model has the frequency of small amplitudes, where one slider sticks."""
    stiffness, limit = 0.08 * (2.0 * np.pi * 168.0) ** 2, 3.0
    structure = Structure((161.67,), (0.0012,), joint=((stiffness, limit),))
    found = of_decay(tmp_path, structure, (168.2, 0.0013), 6.0, 2.0, 8192.0, 6)
    first = found["ranking"][0]
    assert found["verdict"] == "effect"
    assert first["effect"] == "second_friction_contact"
    assert off(first["parameters"]["kt"], stiffness) < 3.0
    assert off(first["parameters"]["slip_force"], limit) < 3.0
    assert found["gap"]["closed"] > 0.9


@pytest.mark.campaign
def test_a_clamped_beam_is_cubic_beside_its_second_mode_and_a_weak_even_force(tmp_path: Path) -> None:
    omega = 2.0 * np.pi * 132.4
    cubic = omega**2 / 0.5e-3**2
    structure = Structure(
        (132.4, 364.0), (0.004, 0.003), (1.0, -0.6), cubic=cubic, quadratic=0.1 * omega**2 / 0.5e-3
    )  # fmt: skip
    found = diagnosed(tmp_path, structure, (131.0, 0.0035), (3e-3, 0.01, 0.08), np.geomspace(0.05, 4.0, 14), 1)
    assert_named(found, "cubic_stiffness", k=cubic)


def test_a_linear_beam_with_scatter_has_no_effect(tmp_path: Path) -> None:
    structure = Structure((132.0,), (0.0041,))
    found = diagnosed(tmp_path, structure, (131.0, 0.0035), (1.5e-3, 0.01, 0.06), np.geomspace(0.05, 2.0, 12), 5)
    assert found["verdict"] in ("none", "calibration")


@pytest.mark.campaign
def test_a_decay_of_a_clamped_beam_is_cubic(tmp_path: Path) -> None:
    omega = 2.0 * np.pi * 133.1
    cubic = 0.9 * omega**2 / 0.6e-3**2
    structure = Structure(
        (133.1, 364.0), (0.0035, 0.003), (1.0, -0.6), cubic=cubic, quadratic=0.05 * omega**2 / 0.6e-3
    )  # fmt: skip
    found = of_decay(tmp_path, structure, (131.5, 0.003), 3.0, 1.5, 5120.0, 1)
    assert_named(found, "cubic_stiffness", k=cubic)


@pytest.mark.campaign
def test_a_decay_with_damping_that_grows_with_amplitude_is_named(tmp_path: Path) -> None:
    found = of_decay(tmp_path, Structure((97.0,), (0.003,), square_damping=2e7), (96.2, 0.0035), 4.0, 3.0, 2048.0, 4)
    assert_named(found, "amplitude_damping", c=2e7)


@pytest.mark.campaign
def test_a_fast_decay_is_looked_at_over_all_its_amplitudes(tmp_path: Path) -> None:
    """A narrow band would make one segment of its ninety periods, more certain than any of many."""
    structure = Structure((192.3, 770.9), (0.0089, 0.0089), (1.0, -0.03), square_damping=3.5e8)
    found = of_decay(tmp_path, structure, (192.2, 0.0082), 62.0, 0.465, 7693.0, 5)
    assert_named(found, "amplitude_damping", c=3.5e8)


@pytest.mark.campaign
def test_contacts_of_the_first_periods_of_a_decay_are_seen(tmp_path: Path) -> None:
    """Narrow bands tell small amplitudes to a millionth; the few periods with contact must not drown in that."""
    structure = Structure((72.5, 260.3), (0.0052, 0.0052), (1.0, 0.17), stop=(4.76e5, 1.9e-4))
    found = of_decay(tmp_path, structure, (72.41, 0.0051), 1.09, 2.1, 2900.0, 7)
    first, gap = found["ranking"][0], found["gap"]
    assert found["verdict"] == "effect"
    # The table of fundamentals separates a stop on one side, twice as stiff, from one on both no more than it must.
    (name,) = {first["effect"], *first["equivalents"]} & {"two_sided_gap"}
    sides = 1.0 if first["effect"] == name else 2.0
    assert off(first["parameters"]["k"], sides * 4.76e5) < 3.0
    # Within the four periods of the window the amplitude falls by 12 %, and the frequency with it.
    (gap_m,) = (value["value"] for key, value in first["parameters"].items() if key.startswith("gap"))
    assert gap_m == pytest.approx(1.9e-4, rel=0.05)
    # No half of so few amplitudes tells the contact: what is left is that of the fit, and by observable no other.
    left = [item["after"] for item in gap["per_observable"].values()]
    assert min(left) <= gap["after"] <= max(left)


@pytest.mark.campaign
def test_hum_near_the_mode_does_not_hide_what_damps_a_decay(tmp_path: Path) -> None:
    """The mode decays at 47 Hz, the mains stay at 50 Hz: they beat where the decay has become small."""
    factor = 6e6
    found = of_decay(tmp_path, Structure((47.0,), (0.003,), square_damping=factor), (46.5, 0.0035), 2.0, 4.0, 2048.0, 4)
    first = found["ranking"][0]
    assert found["verdict"] == "effect"
    assert first["effect"] == "amplitude_damping"
    assert off(first["parameters"]["c"], factor) < 3.0
    assert any("a line of the mains is taken out" in note for note in found["notes"])


@pytest.mark.campaign
def test_a_decay_of_a_linear_beam_has_no_effect(tmp_path: Path) -> None:
    found = of_decay(tmp_path, Structure((133.1,), (0.0035,)), (131.5, 0.003), 3.0, 1.5, 5120.0, 2)
    assert found["verdict"] in ("none", "calibration")


@pytest.mark.campaign
def test_responses_at_held_forces_tell_a_gap(tmp_path: Path) -> None:
    stiffness, gap = 0.3 * (2.0 * np.pi * 133.1) ** 2, 1.5e-4
    structure = Structure((133.1,), (0.005,), stop=(stiffness, gap))
    found = of_responses(tmp_path, structure, (131.5, 0.004), (0.2, 1.0, 2.0), np.linspace(127.0, 146.0, 77), 8)
    expect_gap(found, stiffness, gap)


@pytest.mark.campaign
def test_responses_whose_scatter_moves_the_resonance_by_its_width_tell_a_cubic_spring(tmp_path: Path) -> None:
    cubic = -0.27 * (2.0 * np.pi * 52.36) ** 2 / 0.8e-3**2
    structure = Structure((52.36,), (0.0024,), cubic=cubic)
    found = of_responses(tmp_path, structure, (52.3, 0.0025), (0.02, 0.1, 0.38), np.linspace(49.5, 53.3, 77), 8)
    assert_named(found, "cubic_stiffness", k=cubic)


@pytest.mark.campaign
def test_responses_of_a_linear_beam_have_no_effect(tmp_path: Path) -> None:
    structure = Structure((133.1,), (0.0035,))
    found = of_responses(tmp_path, structure, (131.5, 0.003), (0.1, 1.0, 3.0), np.linspace(126.0, 142.0, 65), 6)
    assert found["verdict"] in ("none", "calibration")


@pytest.mark.campaign
def test_locked_windows_without_a_voltage_tell_a_gap(tmp_path: Path) -> None:
    """The resonance moves by 8 %, thousands of times its uncertainty: no linear model is near all levels."""
    stiffness, gap = 0.3 * (2.0 * np.pi * 133.1) ** 2, 1.5e-4
    structure = Structure((133.1,), (0.005,), stop=(stiffness, gap))
    found = of_windows(tmp_path, structure, (131.5, 0.004), np.geomspace(0.1, 3.0, 8), 6)
    expect_gap(found, stiffness, gap)


@pytest.mark.campaign
def test_locked_windows_of_a_linear_beam_have_no_effect(tmp_path: Path) -> None:
    structure = Structure((133.1, 364.0), (0.0035, 0.003), (1.0, -0.6))
    found = of_windows(tmp_path, structure, (131.5, 0.003), np.geomspace(0.1, 3.0, 8), 5)
    assert found["verdict"] in ("none", "calibration")


@pytest.mark.campaign
def test_a_decay_with_a_cubic_spring_and_damping_that_grows_names_both(tmp_path: Path) -> None:
    """Alone another damping fits better, and what is wrong with that is not what the cubic spring lacks."""
    cubic, factor = 7.46e11, 2.155e8
    structure = Structure((46.37,), (0.0034,), cubic=cubic, square_damping=factor)
    found = of_decay(tmp_path, structure, (46.2, 0.0036), 1.8, 4.0, 2048.0, 7)
    first, both = found["ranking"][:2]
    assert found["verdict"] == "effect"
    # The law that closes most alone leads; both together close all of it.
    assert first["effect"] == "cubic_stiffness"
    assert both["effect"] == "cubic_stiffness + amplitude_damping"
    assert off(both["parameters"]["cubic_stiffness@1.k"], cubic) < 3.0
    assert off(both["parameters"]["amplitude_damping@1.c"], factor) < 3.0
    assert found["gap"]["closed"] > 0.9
    assert both["closed"]["value"] > 0.99
