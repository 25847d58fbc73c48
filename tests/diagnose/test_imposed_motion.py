"""Imposed motion: the force is predicted from the motion, against equations of motion that are solved otherwise."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import library
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.measurements.imposed_motion import ImposedMotion
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_record.exchange.imports.imported_run import read_import, write_import
from nmt_record.exchange.unit_table import channel_factor
from nmt_rig.rig import Rig, load_rig

RATE = 200.0
DRIVE = """
name: drive
sample_rate_hz: 200
structure: {{kind: chain, masses_kg: [2.0e-3], ground_springs_n_m: [{spring}], ground_dampers_ns_m: [{damper}]}}
exciter: {{kind: force, point: 1}}
sensors:
  - {{quantity: force, point: drive}}
  - {{quantity: velocity, point: 1}}
  - {{quantity: displacement, point: 1}}
extraction: {{quantity: velocity, linear_modes: 1}}
"""
FREE = DRIVE.format(spring=0.0, damper=5e-3)
CHAIN = """
name: row
sample_rate_hz: 200
structure:
  kind: chain
  masses_kg: [0.5, 0.4, 0.3]
  springs_n_m: [900.0, 700.0]
  dampers_ns_m: [0.8, 0.5]
  ground_springs_n_m: [0.0, 0.0, 0.0]
exciter: {kind: force, point: 1}
sensors:
  - {quantity: force, point: drive}
  - {quantity: displacement, point: 1}
  - {quantity: displacement, point: 3}
extraction: {quantity: displacement, linear_modes: 1}
local_elements:
  - {name: hard, kind: cubic_spring, point: 3, stiffness_n_m3: 4.0e6}
"""


def rig_of(folder: Path, text: str, more: str = "") -> Rig:
    (folder / "rig.yaml").write_text(text + more, encoding="utf-8")
    return load_rig(folder / "rig.yaml", vibrating=False)


def bag_of(
    folder: Path, rate: float, columns: dict[str, FloatArray], segments: str, rig_text: str, **units: str
) -> Path:
    """Bag of an import; columns are named by quantity and point, such as ``force 1``."""
    names = {"force": "N", "torque": "N m", "displacement": "m", "velocity": "m/s", "angular_velocity": "rad/s"}
    names |= {"current": "A", "voltage": "V", "acceleration": "m/s^2"}
    np.savez(folder / "data.npz", **{name.replace(" ", "_"): values for name, values in columns.items()})
    channels = "".join(
        f"  - {{column: {name.replace(' ', '_')}, quantity: {name.split()[0]}, unit: {names[name.split()[0]]}, "
        f"point: {name.split()[1]}}}\n"
        for name in columns
    )
    (folder / "sidecar.yaml").write_text(
        f"rig: rig.yaml\nsample_rate: {rate!r}\nfile: data.npz\nchannels:\n{channels}segments:\n{segments}",
        encoding="utf-8",
    )
    name = rig_text.split("name: ")[1].split()[0]
    return write_import(read_import(folder / "sidecar.yaml"), folder / "bag", name, rig_text, {})


def record(samples: int, rate: float = RATE, **more: Any) -> str:
    extra = "".join(f", {key}: {value}" for key, value in more.items())
    return f"  - {{kind: record, start: 0.0, stop: {samples / rate!r}{extra}}}\n"


def sines(time: FloatArray, *terms: tuple[float, float, float]) -> FloatArray:
    """Displacement, velocity and acceleration (3, n) of sines of amplitude, frequency in Hz and phase."""
    rows = []
    for order in range(3):
        parts = [
            a * (2.0 * np.pi * f) ** order * np.sin(2.0 * np.pi * f * time + phase + 0.5 * np.pi * order)
            for a, f, phase in terms
        ]
        rows.append(np.sum(parts, axis=0))
    return np.array(rows)


def jenkins(w: FloatArray, stiffness: float, slip: float) -> FloatArray:
    """Force of a spring in series with a dry slider along a motion, the slider at zero first."""
    force, result = 0.0, np.empty(w.size)
    for k, (before, now) in enumerate(zip(np.concatenate(([0.0], w[:-1])), w, strict=True)):
        force = min(max(force + stiffness * (now - before), -slip), slip)
        result[k] = force
    return result


def predicted(rig: Rig, observations: Observations) -> FloatArray:
    return Forward(observations.tests, observations.rows).predict(rig).values


def diagnosed(rig: Rig, bag: Path, *known: str) -> Diagnosis:
    """What is diagnosed with a few effects, or all."""
    withheld = tuple(effect.name for effect in library() if known and effect.name not in known)
    return diagnose_bags(rig, [bag], settings=DiagnosisSettings(look_ahead=False, withheld=withheld)).diagnosis


LAWS = {
    "jenkins": ("tangential_stiffness_n_m: 40.0, slip_force_n: 0.3", lambda w, v: jenkins(w, 40.0, 0.3)),
    "cubic_spring": ("stiffness_n_m3: 2000.0", lambda w, v: 2000.0 * w**3),
    "power_law_damper": ("coefficient_n_sp_mp: 0.8, exponent: 1.5", lambda w, v: 0.8 * np.abs(v) ** 1.5 * np.sign(v)),
    "two_sided_gap": (
        "stiffness_n_m: 60.0, gap_m: 0.01",
        lambda w, v: 60.0 * np.sign(w) * np.maximum(np.abs(w) - 0.01, 0.0),
    ),
}


@pytest.mark.parametrize("kind", LAWS)
def test_one_mass_takes_its_forces_along_the_motion(tmp_path: Path, kind: str) -> None:
    """m a + c v + g(w, v), every term in closed form; a free mass has no mode and no spring."""
    keys, law = LAWS[kind]
    more = f"local_elements:\n  - {{name: law, kind: {kind}, point: 1, {keys}}}\n"
    rig = rig_of(tmp_path, FREE, more)
    time = np.arange(4000) / RATE
    w, v, a = sines(time, (0.03, 0.9, 0.0), (0.008, 2.3, 0.4))
    force = 2e-3 * a + 5e-3 * v + law(w, v)
    bag = bag_of(tmp_path, RATE, {"force 1": force, "displacement 1": w}, record(time.size), FREE + more)
    observations = read_observations([bag], rig)
    (test,) = observations.tests
    assert isinstance(test, ImposedMotion)
    left = observations.values - predicted(rig, observations)
    assert np.sqrt(np.mean(left**2)) < 3e-3 * np.sqrt(np.mean(force**2))


@pytest.mark.parametrize("measured", with_quick(["displacement", "velocity"], "displacement"))
def test_inner_masses_follow_by_their_own_equations(tmp_path: Path, measured: str) -> None:
    """Three free masses in a row, the first one moved: the others and the force by scipy's integration."""
    rig = rig_of(tmp_path, CHAIN.replace("displacement, point: 1", f"{measured}, point: 1"))
    time = np.arange(3000) / RATE
    motion = (0.004, 1.3, 0.0), (0.002, 3.1, 0.0)

    def accelerations(t: float, x: FloatArray) -> FloatArray:
        w, v, _ = sines(np.array([t]), *motion)[:, 0]
        first = 900.0 * (x[0] - w) + 0.8 * (x[2] - v)
        second = 700.0 * (x[1] - x[0]) + 0.5 * (x[3] - x[2])
        return np.array([x[2], x[3], (second - first) / 0.4, (-second - 4.0e6 * x[1] ** 3) / 0.3])

    found = solve_ivp(accelerations, (0.0, time[-1]), np.zeros(4), t_eval=time, method="LSODA", rtol=1e-8, atol=1e-11).y
    w, v, a = sines(time, *motion)
    force = 0.5 * a - 900.0 * (found[0] - w) - 0.8 * (found[2] - v)
    drive = {"displacement": w, "velocity": v}[measured]
    columns = {"force 1": force, f"{measured} 1": drive, "displacement 3": found[1]}
    bag = bag_of(tmp_path, RATE, columns, record(time.size, held="response"), CHAIN)
    observations = read_observations([bag], rig)
    left = observations.values - predicted(rig, observations)
    # What swings freely starts at rest with the motion, as in the model, and both have the time to settle.
    for channel, size in ((0, force), (1, found[1])):
        selected = (observations.rows.channel == channel) & (observations.rows.time_s > 10.0)
        assert np.sqrt(np.mean(left[selected] ** 2)) < 0.01 * np.sqrt(np.mean(size**2)), channel


def coulomb_drive(friction: float, damper: float, seed: int = 3) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time, speed and torque of a drive that starts, turns and stops, both ways; rigid friction to the ground."""
    time = np.arange(3400) / RATE
    speed = np.zeros(time.size)
    for begin, top in ((1.0, 8.0), (5.0, -8.0), (9.0, 20.0), (13.0, -20.0)):
        speed += top * np.clip(np.minimum((time - begin) / 0.4, (begin + 3.0 - time) / 0.4), 0.0, 1.0)
    acceleration = np.gradient(speed, time)
    torque = 2e-3 * acceleration + damper * speed + friction * np.sign(np.round(speed, 9))
    rng = np.random.default_rng(seed)
    return time, speed + 0.01 * rng.standard_normal(time.size), torque + 0.01 * rng.standard_normal(time.size)


@pytest.mark.parametrize(("spring", "damper"), with_quick([(0.0, 5e-3), (1e-5, 5e-3), (1e-5, 0.0)], (1e-5, 0.0)))
def test_a_drive_without_restoring_force_is_moved_as_measured(tmp_path: Path, spring: float, damper: float) -> None:
    """Free inertia, overdamped, or a spring that nothing swings on: Coulomb friction is found with its size."""
    text = DRIVE.format(spring=spring, damper=damper)
    rig = rig_of(tmp_path, text)
    time, speed, torque = coulomb_drive(0.4, damper)
    bag = bag_of(tmp_path, RATE, {"torque 1": torque, "angular_velocity 1": speed}, record(time.size), text)
    observations = read_observations([bag], rig)
    assert any("held: force" in note and "no mode of the model drive swings" in note for note in observations.notes)
    found = diagnosed(rig, bag)
    assert found.verdict is Verdict.EFFECT
    first = found.ranking[0]
    assert first.effect in ("second_friction_contact", "microslip"), first
    assert first.parameters["slip_force"].value == pytest.approx(0.4, rel=0.05)


def test_a_mode_swings_that_has_three_periods_in_the_record(tmp_path: Path) -> None:
    view = ModelView.of(rig_of(tmp_path, DRIVE.format(spring=0.5, damper=0.0)), (1,))
    (hertz,) = view.swinging_hz(1e6, 1e6)
    assert view.swinging_hz(2.9 / hertz, 1e6) == ()
    assert view.swinging_hz(3.1 / hertz, 1e6) == (hertz,)


def test_what_the_model_makes_of_a_motion_has_no_gap(tmp_path: Path) -> None:
    text = DRIVE.format(spring=0.0, damper=5e-3)
    keys = LAWS["jenkins"][0]
    more = f"local_elements:\n  - {{name: brake, kind: jenkins, point: 1, {keys}}}\n"
    rig = rig_of(tmp_path, text, more)
    time = np.arange(4000) / RATE
    rng = np.random.default_rng(5)
    w, v, a = sines(time, (0.03, 0.9, 0.0), (0.008, 2.3, 0.4))
    force = 2e-3 * a + 5e-3 * v + jenkins(w, 40.0, 0.3) + 0.003 * rng.standard_normal(time.size)
    columns = {"force 1": force, "displacement 1": w + 1e-5 * rng.standard_normal(time.size)}
    found = diagnosed(rig, bag_of(tmp_path, RATE, columns, record(time.size), text + more))
    assert found.verdict is Verdict.NONE, found.sentences


def test_a_force_at_rest_is_no_observable(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, FREE)
    time, speed, torque = coulomb_drive(0.4, 5e-3)
    bag = bag_of(tmp_path, RATE, {"torque 1": torque, "angular_velocity 1": speed}, record(time.size), FREE)
    rows = read_observations([bag], rig).rows
    at = np.interp(rows.time_s, time, np.abs(speed))
    assert at.min() > 0.5
    assert rows.time_s.max() > 15.0


def test_noise_of_the_motion_is_part_of_the_noise_of_the_force(tmp_path: Path) -> None:
    """Force of white noise of the displacement through a spring and a mass, against many draws of it."""
    text = DRIVE.format(spring=500.0, damper=0.5).replace("2.0e-3", "2.0")
    rig = rig_of(tmp_path, text)
    time = np.arange(4000) / RATE
    w, v, a = sines(time, (0.03, 0.9, 0.0), (0.02, 1.3, 0.4))
    force = 2.0 * a + 0.5 * v + 500.0 * w
    rng = np.random.default_rng(2)
    left, told = [], []
    for draw in range(4):
        folder = tmp_path / str(draw)
        folder.mkdir()
        (folder / "rig.yaml").write_text(text, encoding="utf-8")
        columns = {"force 1": force, "displacement 1": w + 1e-3 * rng.standard_normal(time.size)}
        bag = bag_of(folder, RATE, columns, record(time.size, held="response"), text)
        observations = read_observations([bag], rig)
        left.append(observations.values - predicted(rig, observations))
        told.append(observations.std)
    assert float(np.median(np.concatenate(told))) == pytest.approx(float(np.std(np.concatenate(left))), rel=0.5)


@pytest.mark.parametrize(("share", "imposed"), [(0.0085, True), (0.0125, False)])
def test_a_hundredth_of_the_power_at_a_mode_is_vibration(tmp_path: Path, share: float, imposed: bool) -> None:
    text = DRIVE.format(spring=180.0, damper=5e-3)  # 48 Hz
    rig = rig_of(tmp_path, text)
    w = sines(np.arange(8000) / RATE, (0.03, 2.0, 0.0), (0.03 * math.sqrt(share / (1.0 - share)), 48.0, 0.0))[0]
    bag = bag_of(tmp_path, RATE, {"force 1": 180.0 * w, "displacement 1": w}, record(w.size), text)
    assert all(isinstance(test, ImposedMotion) is imposed for test in read_observations([bag], rig).tests)


@pytest.mark.parametrize(("held", "imposed"), [(None, True), ("response", True), ("force", False)])
def test_a_motion_far_from_the_modes_is_imposed(tmp_path: Path, held: str | None, imposed: bool) -> None:
    """At a hundredth of the natural frequency force and motion say the same; the sidecar has the last word."""
    text = DRIVE.format(spring=180.0, damper=5e-3)  # 48 Hz
    rig = rig_of(tmp_path, text)
    time = np.arange(4000) / RATE
    w, v, a = sines(time, (0.03, 0.4, 0.0))
    force = 2e-3 * a + 5e-3 * v + 180.0 * w
    more = {} if held is None else {"held": held}
    bag = bag_of(tmp_path, RATE, {"force 1": force, "displacement 1": w}, record(time.size, **more), text)
    observations = read_observations([bag], rig)
    assert all(isinstance(test, ImposedMotion) is imposed for test in observations.tests)
    assert any("held: force" in note for note in observations.notes) == (held is None)


def test_a_motion_on_a_resonance_is_an_answer(tmp_path: Path) -> None:
    text = DRIVE.format(spring=0.32, damper=1e-3)  # 2 Hz
    rig = rig_of(tmp_path, text)
    time = np.arange(4000) / RATE
    w, v, a = sines(time, (0.03, 2.1, 0.0))
    force = 2e-3 * a + 1e-3 * v + 0.32 * w
    bag = bag_of(tmp_path, RATE, {"force 1": force, "displacement 1": w}, record(time.size), text)
    assert not any(isinstance(test, ImposedMotion) for test in read_observations([bag], rig).tests)


def test_a_short_window_is_left_out(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, FREE)
    time = np.arange(400) / RATE
    w, v, a = sines(time, (0.03, 4.0, 0.0))
    columns = {"force 1": 2e-3 * a + 5e-3 * v, "displacement 1": w}
    segments = "  - {kind: record, start: 0.0, stop: 1.6}\n  - {kind: record, start: 1.6, stop: 1.85}\n"
    observations = read_observations([bag_of(tmp_path, RATE, columns, segments, FREE)], rig)
    assert len(observations.tests) == 1
    assert any("50 samples are too few" in note for note in observations.notes)


def test_held_is_refused_where_it_means_nothing(tmp_path: Path) -> None:
    rig_of(tmp_path, FREE)
    time = np.arange(400) / RATE
    w = math.e * np.sin(time)
    segment = "  - {kind: ring_down, start: 0.0, stop: 2.0, held: response}\n"
    with pytest.raises(BenchError, match="held says what was given in a record or a stepped_sine"):
        bag_of(tmp_path, RATE, {"force 1": w, "displacement 1": w}, segment, FREE)


def test_a_table_of_held_motions_shows_friction(tmp_path: Path) -> None:
    """Force over motion far below the mode is k + c iω − m ω², and i 4F/(π A) of rigid friction beside it."""
    text = DRIVE.format(spring=2.0, damper=5e-3)  # 5 Hz
    rig_of(tmp_path, text)
    frequency = np.geomspace(0.1, 1.0, 3)
    omega, rng, segments = 2.0 * np.pi * frequency, np.random.default_rng(8), ""
    for level in (0.05, 0.1, 0.4):
        response = 1.0 / (2.0 + 5e-3j * omega - 2e-3 * omega**2 + 4j * 0.4 / (np.pi * level))
        response = response * np.exp(0.005 * (rng.standard_normal(3) + 1j * rng.standard_normal(3)))
        table = np.column_stack((frequency, response.real, response.imag))
        np.savetxt(tmp_path / f"{level}.csv", table, delimiter=",", header="frequency_hz,real,imag", comments="")
        segments += (
            f"  - {{kind: frf, file: {level}.csv, unit: m/N, point: 1, drive_point: 1, level: {level}, "
            f"level_unit: m, held: response, noise: 0.5, name: at {level}}}\n"
        )
    (tmp_path / "sidecar.yaml").write_text(f"rig: rig.yaml\nfile: 0.05.csv\nsegments:\n{segments}", encoding="utf-8")
    bag = write_import(read_import(tmp_path / "sidecar.yaml"), tmp_path / "bag", "drive", text, {})
    laws = "second_friction_contact", "power_law_damping", "two_sided_gap", "cubic_stiffness"
    found = diagnosed(load_rig(tmp_path / "rig.yaml", vibrating=False), bag, *laws)
    assert found.verdict is Verdict.EFFECT, found.sentences
    first = found.ranking[0]
    assert first.effect == "second_friction_contact", found.sentences
    assert first.parameters["slip_force"].value == pytest.approx(0.4, rel=0.05)


def test_torque_has_units_of_its_own() -> None:
    assert channel_factor("torque", "mN m", "here") == 1e-3
    assert channel_factor("torque", "Nm", "here") == 1.0
    assert channel_factor("torque", "lbf ft", "here") == pytest.approx(1.3558179483, rel=1e-9)
    with pytest.raises(BenchError, match="measures torque, but its unit 'N' is none; use"):
        channel_factor("torque", "N", "here")
