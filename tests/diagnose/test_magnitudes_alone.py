"""Frequency responses of which only magnitudes were kept: closed forms with noise, 1 kg at 50 Hz, 1 % damping."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_record import Bag
from nmt_record.exchange.reduced.observables import observable_tables
from nmt_rig.rig import load_rig

OMEGA, DAMPING, CUBIC = 2 * np.pi * 50, 2 * 0.01 * 2 * np.pi * 50, 2.4e9
LINES = np.linspace(46.0, 60.0, 80)
NOISE = 0.005


def displacement(force: float, branch: int, cubic: float) -> np.ndarray:
    """Amplitude in m at each line (Nayfeh and Mook, Nonlinear Oscillations, section 4.1)."""
    found = []
    for omega in 2 * np.pi * LINES:
        a, b = OMEGA**2 - omega**2, 0.75 * cubic
        squares = np.roots([b * b, 2 * a * b, a * a + (DAMPING * omega) ** 2, -(force**2)])
        states = sorted(z.real for z in squares if abs(z.imag) < 1e-9 * abs(z))
        found.append(np.sqrt(states[branch]))
    return np.array(found)


def imported(folder: Path, segments: list[dict[str, object]]) -> tuple[Path, Path]:
    """The bag of the tables in a folder, and the model."""
    own = [{"kind": "frf", "point": 1, "drive_point": 1, **each} for each in segments]
    sidecar = {"rig": "one_mode", "file": own[0]["file"], "segments": own}
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(sidecar), encoding="utf-8")
    (folder / "model.yaml").write_text(
        "name: one_mode\nstructure: {kind: modal, modes: [{frequency_hz: 50.0, damping_ratio: 0.01, "
        "modal_mass_kg: 1.0}]}\n",
        encoding="utf-8",
    )
    import_data(folder / "sidecar.yaml", folder / "bag")
    return folder / "bag", folder / "model.yaml"


def sweeps(folder: Path, cubic: float) -> tuple[Path, Path]:
    """Up and down sweeps at four forces, amplitudes in mm with the force beside them."""
    draw, segments = np.random.default_rng(1), []
    for force in (0.5, 2.0, 5.0, 8.0):
        for direction, branch in (("up", -1), ("down", 0)):
            amplitude = 1e3 * displacement(force, branch, cubic) * np.exp(NOISE * draw.standard_normal(LINES.size))
            name = f"{direction}_{force:g}.csv"
            rows = [f"{hz:.9g},{value:.9g},{force}" for hz, value in zip(LINES, amplitude, strict=True)]
            (folder / name).write_text("\n".join(["frequency_hz,magnitude,force", *rows]) + "\n", encoding="utf-8")
            segments.append({
                "file": name, "unit": "mm/N", "per": "force", "level": force, "level_unit": "N",
                "direction": direction, "name": f"{force:g} N {direction}",
            })  # fmt: skip
    return imported(folder, segments)


def diagnosed(bag: Path, model: Path) -> Diagnosis:
    return diagnose_bags(str(model), [bag], settings=DiagnosisSettings(look_ahead=False)).diagnosis


def test_no_observable_is_a_phase_and_the_noise_is_that_of_the_magnitudes(tmp_path: Path) -> None:
    bag, model = sweeps(tmp_path, CUBIC)
    table = observable_tables(Bag.open(bag))[0]
    assert not table.phase_known
    assert table.columns["magnitude"] == pytest.approx(displacement(0.5, -1, CUBIC) / 0.5, rel=5 * NOISE)
    assert table.units["magnitude"] == "m/N"
    observations = read_observations([bag], load_rig(str(model)))
    assert set(observations.rows.part) == {Part.LOG_MAGNITUDE}
    assert observations.std == pytest.approx(NOISE, rel=0.3)


@pytest.mark.campaign
def test_magnitudes_alone_tell_a_cubic_spring(tmp_path: Path) -> None:
    found = diagnosed(*sweeps(tmp_path, CUBIC))
    assert found.verdict is Verdict.EFFECT
    first = found.ranking[0]
    assert first.effect == "cubic_stiffness"
    assert first.probability >= 0.9
    assert abs(first.parameters["k"].value - CUBIC) < 3.0 * first.parameters["k"].std
    assert found.gap.closed >= 0.9


@pytest.mark.campaign
def test_magnitudes_of_the_model_raise_no_alarm(tmp_path: Path) -> None:
    assert diagnosed(*sweeps(tmp_path, 1e-6 * CUBIC)).verdict in (Verdict.NONE, Verdict.CALIBRATION)


@pytest.mark.parametrize(("frequency", "verdict"), [(1.0, "none"), (1.004, "calibration")])
def test_magnitudes_of_a_random_test_tell_the_resonance(frequency: float, verdict: str, tmp_path: Path) -> None:
    draw, omega = np.random.default_rng(2), 2 * np.pi * LINES
    size = np.abs(omega**2 / ((frequency * OMEGA) ** 2 - omega**2 + 1j * DAMPING * omega))
    size *= np.exp(0.01 * draw.standard_normal(LINES.size))
    rows = [f"{hz:.9g},{value:.9g},{0.01 * value:.9g}" for hz, value in zip(LINES, size, strict=True)]
    text = "\n".join(["frequency_hz,magnitude,magnitude_std", *rows]) + "\n"
    (tmp_path / "responses.csv").write_text(text, encoding="utf-8")
    found = diagnosed(*imported(tmp_path, [{"file": "responses.csv", "unit": "m/s^2/N", "name": "responses"}]))
    assert found.verdict.value == verdict
