"""Friction of any stiffness, up to rigid, beside a model without it: found with its size in decays, responses, records.

The real side is simulated by small steps of its own, the slider's force clipped; nothing is shared with the product.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from tiers import with_quick

from nmt_core.numerics.arrays import FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.measurements.recorded_decay import RecordedDecay
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_record.exchange.imports.imported_run import read_import, write_import
from nmt_rig.rig import load_rig

RATE, FINER = 500, 40
INERTIA, SPRING, DAMPER = 0.05, 60.0, 0.0139
OMEGA = math.sqrt(SPRING / INERTIA)
PENDULUM = f"""
name: pendulum
sample_rate_hz: {RATE}
structure:
  {{kind: chain, masses_kg: [{INERTIA}], ground_springs_n_m: [{SPRING}], ground_dampers_ns_m: [{DAMPER}]}}
exciter: {{kind: force, point: 1}}
sensors:
  - {{quantity: force, point: drive}}
  - {{quantity: displacement, point: 1}}
extraction: {{quantity: displacement, linear_modes: 1}}
"""
ROW = f"""
name: row
sample_rate_hz: {RATE}
structure:
  kind: chain
  masses_kg: [1.0, 0.8]
  springs_n_m: [3000.0]
  dampers_ns_m: [0.6]
  ground_springs_n_m: [2000.0, 0.0]
  ground_dampers_ns_m: [0.5, 0.0]
exciter: {{kind: force, point: 1}}
sensors:
  - {{quantity: force, point: drive}}
  - {{quantity: displacement, point: 1}}
  - {{quantity: displacement, point: 2}}
extraction: {{quantity: displacement, linear_modes: 1}}
"""
RIGID = 1e5


@njit(cache=True)
def swung(force: FloatArray, step: float, contact: float, slip: float, start: float) -> FloatArray:
    """Angle of the pendulum under a torque, with a slider of a stiffness to the ground."""
    result = np.empty(force.size)
    x, v, g = start, 0.0, 0.0
    for i in range(force.size):
        result[i] = x
        v += step * (force[i] - DAMPER * v - SPRING * x - g) / INERTIA
        g = min(max(g + contact * step * v, -slip), slip)
        x += step * v
    return result


@njit(cache=True)
def shaken_row(force: FloatArray, step: float, contact: float, slip: float) -> FloatArray:
    """Displacements (2, n) of the two masses in a row, the first driven, a slider between the second and the ground."""
    result = np.empty((2, force.size))
    x, y, v, w, g = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(force.size):
        result[0, i], result[1, i] = x, y
        between = 3000.0 * (x - y) + 0.6 * (v - w)
        v += step * (force[i] - 2000.0 * x - 0.5 * v - between)
        w += step * (between - g) / 0.8
        g = min(max(g + contact * step * w, -slip), slip)
        x += step * v
        y += step * w
    return result


def band(samples: int, low: float, high: float, size: float, seed: int) -> FloatArray:
    """Noise of a band in Hz with an rms value."""
    frequency = np.fft.rfftfreq(samples, 1.0 / RATE)
    phases = np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=frequency.size))
    found = np.fft.irfft(np.where((frequency > low) & (frequency < high), phases, 0.0), samples)
    return size * found / found.std()


def finer(samples: FloatArray) -> FloatArray:
    return np.fft.irfft(np.fft.rfft(samples), FINER * samples.size) * FINER


def recorded(folder: Path, rig: str, columns: dict[str, FloatArray], kind: str) -> Path:
    """Bag of one segment; columns are named by quantity and point, such as ``force 1``."""
    units = {"force": "N", "torque": "N m", "displacement": "m", "angle": "rad"}
    (folder / "rig.yaml").write_text(rig, encoding="utf-8")
    np.savez(folder / "data.npz", **{name.replace(" ", "_"): values for name, values in columns.items()})
    channels = "".join(
        f"  - {{column: {name.replace(' ', '_')}, quantity: {name.split()[0]}, unit: {units[name.split()[0]]}, "
        f"point: {name.split()[1]}}}\n"
        for name in columns
    )
    stop = next(iter(columns.values())).size / RATE
    (folder / "sidecar.yaml").write_text(
        f"rig: rig.yaml\nsample_rate: {RATE}\nfile: data.npz\nchannels:\n{channels}"
        f"segments:\n  - {{kind: {kind}, start: 0.0, stop: {stop}}}\n",
        encoding="utf-8",
    )
    name = rig.split("name: ")[1].split()[0]
    return write_import(read_import(folder / "sidecar.yaml"), folder / "bag", name, rig, {})


def diagnosed(folder: Path, rig: str, columns: dict[str, FloatArray], kind: str) -> Diagnosis:
    """The diagnosis of a bag of one segment."""
    bag = recorded(folder, rig, columns, kind)
    return diagnose_bags(folder / "rig.yaml", [bag], settings=DiagnosisSettings(look_ahead=False)).diagnosis


def assert_friction(found: Diagnosis, slip: float, contact: float) -> None:
    """Friction alone, of this size, and as stiff as it is or at least far stiffer than the structure."""
    assert found.verdict is Verdict.EFFECT, found.sentences
    first = found.ranking[0]
    assert first.effect == "second_friction_contact", found.sentences
    assert first.parameters["slip_force"].value == pytest.approx(slip, rel=0.05)
    assert first.parameters["kt"].value > 30.0 * SPRING if contact == RIGID else contact / 1.5
    assert contact == RIGID or first.parameters["kt"].value < 1.5 * contact


def decay(contact: float, slip: float, seed: int = 1) -> FloatArray:
    angle = swung(np.zeros(8 * RATE * FINER), 1.0 / (RATE * FINER), contact, slip, 0.1)[::FINER]
    return np.asarray(angle + 1e-5 * np.random.default_rng(seed).standard_normal(angle.size))


@pytest.mark.parametrize("contact", with_quick([800.0, RIGID], RIGID))
def test_friction_ends_a_decay(tmp_path: Path, contact: float) -> None:
    found = diagnosed(tmp_path, PENDULUM, {"angle 1": decay(contact, 0.15)}, "ring_down")
    assert_friction(found, 0.15, contact)


def test_a_decay_is_read_from_its_beginning(tmp_path: Path) -> None:
    """What rings on at 800 N m/rad once the contact sticks is a thousandth of the motion."""
    bag = recorded(tmp_path, PENDULUM, {"angle 1": decay(800.0, 0.15)}, "ring_down")
    observations = read_observations([bag], load_rig(tmp_path / "rig.yaml"))
    (test,) = observations.tests
    assert isinstance(test, RecordedDecay)
    assert test.amplitudes.max() > 0.08
    assert test.amplitudes.size >= 6


def test_coulomb_friction_has_the_damping_of_its_work(tmp_path: Path) -> None:
    """ζ + 2 F/(π k A): four times force and amplitude are the work of a period, whatever the size (Den Hartog 1931)."""
    bag = recorded(tmp_path, PENDULUM, {"angle 1": decay(RIGID, 0.04)}, "ring_down")
    more = f"{{name: dry, kind: jenkins, point: 1, tangential_stiffness_n_m: {RIGID}, slip_force_n: 0.04}}"
    (tmp_path / "dry.yaml").write_text(f"{PENDULUM}local_elements:\n  - {more}\n", encoding="utf-8")
    observations = read_observations([bag], load_rig(tmp_path / "rig.yaml"))
    rows = observations.rows
    damping = rows.part == Part.DAMPING
    amplitude = np.asarray(observations.tests[0].amplitudes)[rows.level[damping]]  # type: ignore[union-attr]
    expected = 0.5 * DAMPER / math.sqrt(SPRING * INERTIA) + 2.0 * 0.04 / (math.pi * SPRING * amplitude)
    dry = load_rig(tmp_path / "dry.yaml")
    predicted = Forward(observations.tests, rows).predict(dry).values[damping]
    large = amplitude > 0.015
    assert large.sum() > 10
    np.testing.assert_allclose(predicted[large], expected[large], rtol=5e-3)
    np.testing.assert_allclose(observations.values[damping][large], expected[large], rtol=0.03)


@pytest.mark.parametrize("contact", with_quick([20.0, 800.0, RIGID], 800.0))
def test_friction_in_a_record(tmp_path: Path, contact: float) -> None:
    torque = band(8000, 2.0, 9.0, 0.5, 3)
    angle = swung(finer(torque), 1.0 / (RATE * FINER), contact, 0.15, 0.0)[::FINER]
    angle = angle + 1e-5 * np.random.default_rng(4).standard_normal(angle.size)
    found = diagnosed(tmp_path, PENDULUM, {"torque 1": torque, "angle 1": angle}, "record")
    assert_friction(found, 0.15, contact)


@pytest.mark.campaign
def test_rigid_friction_at_an_inner_mass(tmp_path: Path) -> None:
    """Between the second mass of a row and the ground, found at its place without a gap or a stop."""
    force = band(8000, 2.0, 16.0, 12.0, 5)
    both = shaken_row(finer(force), 1.0 / (RATE * FINER), 1e6, 2.0)[:, ::FINER]
    both = both + 1e-6 * np.random.default_rng(6).standard_normal(both.shape)
    columns = {"force 1": force, "displacement 1": both[0], "displacement 2": both[1]}
    found = diagnosed(tmp_path, ROW, columns, "record")
    assert found.verdict is Verdict.EFFECT, found.sentences
    first = found.ranking[0]
    assert first.effect == "second_friction_contact", found.sentences
    assert first.detail == "2"
    assert first.parameters["slip_force"].value == pytest.approx(2.0, rel=0.05)
