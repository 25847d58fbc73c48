"""Rigs of the laboratories behind a converter answer as the laboratories' own simulators do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nmt_laboratories.driven_laboratories import (
    MASS_RIGS,
    LaboratoryOne,
    LaboratoryTwo,
    Masses,
    _beam,
    rigs_of_masses,
    rigs_of_two,
)
from nmt_laboratories.laboratory_two import drive_for, linear_response
from nmt_laboratories.modal_simulator import Simulator, fundamental
from nmt_rig.rig import load_rig

LABORATORY_ONE = Path(__file__).resolve().parents[2].parent / "shared" / "laboratories" / "one"


def seed_with(kind: str) -> int:
    """First seed of a healthy beam, or of one whose only change is an element of some kind."""
    for seed in range(300):
        _, injected, _, _ = _beam(seed)
        found = [element.kind for element in injected.elements]
        if (kind == "" and injected.truth["kind"] == "healthy") or found == [kind]:
            return seed
    raise AssertionError(f"no seed with {kind}")


def driver(seed: int, rate: float = 5000.0) -> LaboratoryTwo:
    return LaboratoryTwo(rate, [(1, 10.0)], [(p, 10.0) for p in range(1, 6)], seed, 1.0, [1.0] * 5, [0.0] * 5, 1)


def answered(made: Any, size: float, frequency: float, periods: int, rate: float) -> tuple[np.ndarray, complex, int]:
    """Channels in the last eight periods of a sine of whole samples a period, and the drive's fundamental."""
    each = round(rate / frequency)
    drive = size * np.cos(2.0 * np.pi * np.arange(periods * each + 1) / each)
    values = made._answer(drive)[:, -8 * each :]
    return values, fundamental(drive[-8 * each - 1 : -1], 8), each


def test_a_linear_beam_is_that_of_closed_form() -> None:
    seed = seed_with("")
    specimen, _, chain, _ = _beam(seed)
    first, rate = float(specimen.frequencies_hz[0]), 5000.0
    frequency = rate / round(rate / (0.9 * first))
    values, drive, _ = answered(driver(seed), 0.1, frequency, 600, rate)
    expected = (
        linear_response(specimen, np.array([frequency])) @ np.array([specimen.shapes[p] for p in specimen.sensors]).T
    )[0]
    gains = np.array([chain.gains[p] for p in specimen.sensors])
    found = np.array([fundamental(row, 8) for row in values[1:]]) / drive
    assert found == pytest.approx(gains * expected, rel=2e-3)
    assert fundamental(values[0], 8) / drive == pytest.approx(chain.reference_gain, rel=1e-9)


@pytest.mark.parametrize("kind", ["cubic", "sliders"])
def test_an_element_acts_as_in_the_simulator_of_the_laboratory(kind: str) -> None:
    """Its own integrator: another method at other steps, with the sine inside its steps."""
    seed = seed_with(kind)
    specimen, injected, chain, _ = _beam(seed)
    rate, size = 5000.0, 0.5 * drive_for(specimen)
    frequency = rate / round(rate / (0.97 * float(specimen.frequencies_hz[0])))
    values, drive, _ = answered(driver(seed), size, frequency, 600, rate)
    simulator = Simulator(specimen.frequencies_hz, specimen.ratios, specimen.load, injected.elements)
    simulator.size = size
    simulator.sine(size, frequency, 592)
    rows, _ = simulator.sine(size, frequency, 8, per_period=64)
    n = specimen.frequencies_hz.size
    for row, point in zip(values[1:], specimen.sensors, strict=True):
        expected = fundamental(rows[:, 2 * n : 3 * n] @ specimen.shapes[point], 8) / fundamental(rows[:, -1], 8)
        assert fundamental(row, 8) / drive == pytest.approx(chain.gains[point] * expected, rel=3e-3)


def test_what_is_exchanged_goes_on_from_turn_to_turn() -> None:
    one, other = driver(seed_with("cubic")), driver(seed_with("cubic"))
    drive = np.sin(np.arange(200) / 7.0)
    parts = [one.exchange(drive[None, k : k + 50]) for k in range(0, 200, 50)]
    together = np.hstack(parts)
    assert together == pytest.approx(other.exchange(drive[None]), rel=1e-9, abs=1e-12)
    assert together[-1] == pytest.approx(np.concatenate([[0.0], drive[:-1]]))


def masses(case: str, newton_per_volt: float = 1.0) -> Masses:
    return Masses(5000.0, [(1, 10.0)], [(p, 10.0) for p in range(1, 5)], case, newton_per_volt, [1.0] * 4, [0.0] * 4, 1)


def test_a_row_of_masses_answers_as_its_equations() -> None:
    """M ẍ + C ẋ + K x = f with the damping of modes, solved as one set of complex equations."""
    frequency, size = 5000.0 / 180.0, 0.3
    values, drive, _ = answered(masses("nothing"), size, frequency, 500, 5000.0)
    stiffness = 2e5 * np.array([[2, -1, 0, 0], [-1, 2, -1, 0], [0, -1, 2, -1], [0, 0, -1, 1]])
    vectors = np.linalg.eigh(stiffness)[1]
    roots = 2.0 * np.sqrt(2e5) * np.sin((2 * np.arange(1, 5) - 1) * np.pi / 18.0)
    damping = vectors @ np.diag(2.0 * np.array([0.006, 0.005, 0.006, 0.008]) * roots) @ vectors.T
    omega = 2.0 * np.pi * frequency
    moved = np.linalg.solve(stiffness - omega**2 * np.eye(4) + 1j * omega * damping, np.array([1, 0, 0, 0]))
    found = np.array([fundamental(row, 8) for row in values]) / drive
    assert found[1:] / found[0] == pytest.approx(-(omega**2) * moved[[0, 3]], rel=0.02)
    assert np.angle(found[1:] / found[0] / (-(omega**2) * moved[[0, 3]])) == pytest.approx(0.0, abs=5e-3)


def test_a_late_channel_and_a_wrong_gain_are_that_alone() -> None:
    drive = np.sin(np.arange(401) / 5.0)
    healthy, late, gain = (masses(case)._answer(drive) for case in ("nothing", "late", "gain"))
    assert late[2, 2:] == pytest.approx(healthy[2, :-2])
    assert gain[2] == pytest.approx(1.07 * healthy[2])
    pieces = masses("late")
    joined = np.hstack([pieces._answer(drive[k : k + 101]) for k in range(0, 400, 100)])
    assert joined == pytest.approx(late, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("name", [name for name, rig in MASS_RIGS.items() if rig.element[0] and not rig.gains])
def test_a_local_force_moves_frequency_or_damping(name: str) -> None:
    """By 1 to 4 % of the frequency, or a fifth of the damping and more: near resonance no one overlooks it."""
    frequency = 5000.0 / 202.0
    plain, _, _ = answered(masses("nothing", 2.32), 1.0, frequency, 120, 5000.0)
    changed, _, _ = answered(masses(name, 2.32), 1.0, frequency, 120, 5000.0)
    ratio = fundamental(changed[2], 8) / fundamental(plain[2], 8)
    assert abs(ratio - 1.0) > 0.1


def test_the_rig_files_are_rigs(tmp_path: Path) -> None:
    for name in [*rigs_of_two(tmp_path, 2), *rigs_of_masses(tmp_path, 2)]:
        model, real = (load_rig(tmp_path / name / file) for file in ("model.yaml", "real.yaml"))
        assert model.device is None
        assert real.device is not None
        assert yaml.safe_load((tmp_path / name / "truth.yaml").read_text())["verdicts"]


@pytest.mark.skipif(not LABORATORY_ONE.is_dir(), reason="laboratory one is not at hand")
def test_laboratory_one_answers_in_pieces_as_in_one() -> None:
    made = [
        LaboratoryOne(
            10000.0,
            [(1, 10.0)],
            [(p, 10.0) for p in range(1, 7)],
            str(LABORATORY_ONE),
            "gap_6",
            [1.0] * 6,
            [0.0] * 6,
            1,
        )
        for _ in range(2)
    ]
    drive = np.cos(2.0 * np.pi * 22.0 * np.arange(2001) / 10000.0)
    whole_run = made[0]._answer(drive)
    pieces = np.hstack([made[1]._answer(drive[k : k + 501]) for k in range(0, 2000, 500)])
    assert whole_run == pytest.approx(pieces, rel=1e-6, abs=1e-9)
    assert np.all(np.abs(whole_run).max(axis=1) > 0.0)
