"""Recordings of small structures in closed form or by an integration of their own: what tempts, and what is there.

Nothing here is shared with the diagnosis: matrices, responses and courses are written out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.diagnose import diagnose_observations
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Diagnosis
from nmt_diagnose.measurements.measurement import Observations, joined
from nmt_diagnose.measurements.stepped_reading import measured_together
from nmt_diagnose.observations.channels.measuring_chain import table_chain
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_tables import table_observations
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

MASSES = np.array([1.0, 0.8, 0.6])
BETWEEN, TO_GROUND = (4000.0, 3000.0), (6000.0, 0.0, 2000.0)
DAMPERS, DAMPERS_TO_GROUND = (1.0, 0.8), (1.5, 0.5, 0.5)
HERTZ, RATIO, MASS = 50.0, 0.004, 0.7


def chain_rig() -> Rig:
    """Three masses in a row as a user's model."""
    structure = {
        "kind": "chain",
        "masses_kg": MASSES.tolist(),
        "springs_n_m": list(BETWEEN),
        "ground_springs_n_m": list(TO_GROUND),
        "dampers_ns_m": list(DAMPERS),
        "ground_dampers_ns_m": list(DAMPERS_TO_GROUND),
    }
    sensors = [{"quantity": "force", "point": "drive"}, *({"quantity": "acceleration", "point": p} for p in (1, 2, 3))]
    values = {
        "name": "three",
        "structure": structure,
        "exciter": {"kind": "force", "point": 1},
        "extraction": {"quantity": "acceleration"},
        "sensors": sensors,
    }
    return validate_rig(RigDocument("test", values, {}))


def chain_receptance(hertz: FloatArray, stiffer: float = 1.0, more: Sequence[float] = (0.0, 0.0, 0.0)) -> ComplexArray:
    """Displacements of all points over forces at all points, shape (n, 3, 3); ``more`` springs to the ground, N/m."""
    mass = np.diag(MASSES)
    stiffness, damping = np.diag(np.array(TO_GROUND)), np.diag(np.array(DAMPERS_TO_GROUND))
    for i, (spring, damper) in enumerate(zip(BETWEEN, DAMPERS, strict=True)):
        pair = np.zeros(3)
        pair[i], pair[i + 1] = 1.0, -1.0
        stiffness, damping = stiffness + spring * np.outer(pair, pair), damping + damper * np.outer(pair, pair)
    omega = 2.0 * np.pi * hertz
    dynamic = (
        stiffer * stiffness
        + np.diag(np.array(more))
        - omega[:, None, None] ** 2 * mass
        + 1j * omega[:, None, None] * damping
    )
    return np.asarray(np.linalg.inv(dynamic))


def chain_accelerance(
    hertz: FloatArray, stiffer: float = 1.0, force: float = 1.0, cubic: float = 0.0, place: int = 1,
    more: Sequence[float] = (0.0, 0.0, 0.0),
) -> ComplexArray:  # fmt: skip
    """Accelerations over the force at point 1, shape (n, 3).

    A cubic spring from a place to the ground acts by its first harmonic, 3/4 k |X|² X: |X|² is the least real root of
    |1 + 3/4 k |X|² H|² |X|² = |H₁ F|², the branch that a rising sweep takes.
    """
    h = chain_receptance(hertz, stiffer, more)
    receptance, driven = h[:, place - 1, place - 1], h[:, place - 1, 0] * force
    response = h[:, :, 0].copy()
    for i in range(hertz.size):
        a = 0.75 * cubic * receptance[i]
        roots = np.roots([abs(a) ** 2, 2.0 * a.real, 1.0, -(abs(driven[i]) ** 2)]) if cubic else np.zeros(1)
        square = float(np.min(roots.real[np.abs(roots.imag) < 1e-9 * np.abs(roots) + 1e-30]))
        x = driven[i] / (1.0 + a * square)
        response[i] -= h[i, :, place - 1] * 0.75 * cubic * square * x / force
    return np.asarray(-((2.0 * np.pi * hertz[:, None]) ** 2) * response)


def chain_tables(
    seed: int,
    stated: float = 1.0,
    gains: Sequence[complex] = (1.0, 1.0, 1.0),
    scatter: float = 0.005,
    drift: float = 0.0,
    *,
    stiffer: float = 1.0,
    cubic: float = 0.0,
    place: int = 1,
    more: Sequence[float] = (0.0, 0.0, 0.0),
    late: Sequence[float] = (0.0, 0.0, 0.0),
    band: tuple[float, float] = (6.0, 20.0),
) -> list[ObservableTable]:
    """Stepped sines at two forces.

    Args:
        seed: of the scatter.
        stated: stated uncertainty over the scatter that is there.
        gains: of the three accelerometers, complex of a turned phase.
        scatter: relative, of the real and of the imaginary part.
        drift: relative rise of all springs from the first table to the last.
        stiffer: all springs over those of the model.
        cubic: N/m³, of a spring from ``place`` to the ground.
        place: point of it, from 1.
        more: springs to the ground that the model lacks, N/m.
        late: delay of each accelerometer, s.
        band: lowest and highest frequency, Hz.
    """
    generator, hertz, result = np.random.default_rng(seed), np.linspace(*band, 30), []
    for number, level in enumerate((0.5, 2.0)):
        accelerance = chain_accelerance(hertz, stiffer + drift * number, level, cubic, place, more)
        for point, (gain, delay) in enumerate(zip(gains, late, strict=True), 1):
            response = gain * np.exp(-2j * np.pi * hertz * delay) * accelerance[:, point - 1]
            noise = generator.standard_normal((2, hertz.size))
            response = response * (1.0 + scatter * (noise[0] + 1j * noise[1]))
            std = stated * scatter * np.abs(response)
            columns = {
                "frequency_hz": hertz, "real": response.real, "imag": response.imag, "real_std": std, "imag_std": std
            }  # fmt: skip
            result.append(
                ObservableTable(
                    "frf", columns, {}, Quantity.ACCELERATION, level=level, level_unit="N", point=point, drive_point=1,
                    name=f"point {point} at {level} N",
                )
            )  # fmt: skip
    return result


def one_mode_rig() -> Rig:
    """One mode as a user's model."""
    mode = {"frequency_hz": HERTZ, "damping_ratio": RATIO, "modal_mass_kg": MASS}
    return validate_rig(RigDocument("test", {"name": "one", "structure": {"kind": "modal", "modes": [mode]}}, {}))


def backbone(
    seed: int,
    cubic: float = 0.0,
    drag: float = 0.0,
    scatter: float = 1e-4,
    stated: float = 1.0,
    stiffer: float = 1.0,
    *,
    damped: float = 1.0,
    wave: float = 0.0,
    losses: float = 0.0,
) -> list[ObservableTable]:
    """Frequency and damping over amplitude of one mode by the first harmonic.

    Args:
        seed: of the scatter.
        cubic: spring, N/m³: k rises by 3/4 of it times the square of the amplitude.
        drag: N s²/m²: c rises by 8/(3π) of it times ω and the amplitude.
        scatter: relative, of the frequency; of the damping a hundred times as much.
        stated: stated uncertainty over the scatter that is there.
        stiffer: stiffness over that of the model.
        damped: linear damping over that of the model.
        wave: relative size of a wave that the frequency has over the logarithm of the amplitude, which no law makes.
        losses: the same of the damping.
    """
    generator, amplitude = np.random.default_rng(seed), np.geomspace(2e-5, 1e-3, 12)
    spring = MASS * (2.0 * np.pi * HERTZ) ** 2
    course = np.sin(3.0 * np.pi * np.linspace(0.0, 1.0, amplitude.size))
    omega = np.sqrt((stiffer * spring + 0.75 * cubic * amplitude**2) / MASS) * (1.0 + wave * course)
    ratio = damped * RATIO * 2.0 * np.pi * HERTZ / omega + 8.0 / (3.0 * np.pi) * drag * amplitude / (2.0 * MASS)
    ratio = ratio * (1.0 + losses * course)
    hertz = omega / (2.0 * np.pi) * (1.0 + scatter * generator.standard_normal(amplitude.size))
    ratio = ratio * (1.0 + 100.0 * scatter * generator.standard_normal(amplitude.size))
    columns = {
        "frequency_hz": hertz, "amplitude": amplitude, "damping_ratio": ratio,
        "frequency_hz_std": stated * scatter * hertz, "damping_ratio_std": stated * 100.0 * scatter * ratio,
    }  # fmt: skip
    return [ObservableTable("backbone", columns, {}, Quantity.DISPLACEMENT, point=1, drive_point=1, name="backbone")]


def observed(rig: Rig, tables: Sequence[ObservableTable]) -> Observations:
    """Rows of tables with the tolerances of an ordinary measuring chain."""
    groups = measured_together(list(tables), 1)
    found = joined(
        [
            table_observations(f"test {k}", [tables[i] for i in group], rig, ObservationSettings())
            for k, group in enumerate(groups)
        ]
    )
    return replace(found, chains=tuple(table_chain(test.channels) for test in found.tests))


def diagnosed(rig: Rig, tables: Sequence[ObservableTable]) -> Diagnosis:
    """The diagnosis of tables."""
    return diagnose_observations(rig, observed(rig, tables), DiagnosisSettings(look_ahead=False)).diagnosis
