"""Harmonics near a mode that the model has a little elsewhere, against the receptances of its matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.predicted_observations import chain, observations_of_model
from scipy.linalg import eigh

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.tolerances import MODEL_PRIORS
from nmt_diagnose.inference.chain import linear_chain
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.forward import Forward
from nmt_rig.rig_model import build_structure

STRUCTURE = {
    "kind": "chain",
    "masses_kg": [0.5, 0.3],
    "springs_n_m": [25000.0],
    "dampers_ns_m": [5.0],
    "ground_springs_n_m": [8000.0, 3000.0],
    "ground_dampers_ns_m": [4.0, 1.0],
}
WEAK = {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 1e3}
SENSORS = [
    {"quantity": "force", "point": "drive"},
    {"quantity": "displacement", "point": 1},
    {"quantity": "displacement", "point": 2},
    {"quantity": "voltage"},
]


def test_columns_are_those_of_the_receptances_of_a_moved_mode() -> None:
    rig = chain(
        structure=STRUCTURE, local_elements=[WEAK], sensors=SENSORS,
        exciter={"kind": "force", "point": 1, "newton_per_volt": 1.0},
    )  # fmt: skip
    observations = observations_of_model(rig, noise=0.0, drives=(0.1, 0.4), random=False)
    chains = tuple(MeasuringChain() for _ in observations.tests)
    observations = replace(observations, chains=chains, std=1e-6 * observations.std)  # so that nothing is too small
    prediction = Forward(observations.tests, observations.rows).predict(rig)
    found = linear_chain(observations, rig, prediction)
    ours = [name for name in found.names if name.endswith("at harmonics")]
    assert ours == ["frequency of mode 2 at harmonics", "damping of mode 2 at harmonics"]  # 66 Hz, three times 21 Hz

    structure = build_structure(rig)
    squares, shapes = eigh(structure.stiffness, structure.mass)
    rates = np.diag(shapes.T @ structure.damping @ shapes).copy()
    coupling = shapes.T @ structure.damping @ shapes - np.diag(rates)

    def receptance(hertz: float, frequency: float = 1.0, damping: float = 1.0) -> ComplexArray:
        """Displacements over a force at the cubic spring, (points,)."""
        s = 2j * np.pi * hertz
        moved, lossy = squares.copy(), rates.copy()
        moved[1] *= frequency**2
        lossy[1] *= damping * frequency
        dynamic = np.diag(moved + s * lossy + s * s) + s * coupling
        return np.asarray(shapes @ np.linalg.solve(dynamic, shapes[1]))

    rows, names = observations.rows, [c.name for c in observations.tests[0].channels]  # type: ignore[union-attr]
    third = 3.0 * _locked(prediction.values, rows)
    factors = {
        ours[0]: {"frequency": 1.0 + MODEL_PRIORS["frequency_hz"].std},
        ours[1]: {"damping": 1.0 + MODEL_PRIORS["damping_ratio"].std},
    }
    for name, factor in factors.items():
        column = found.columns[:, found.names.index(name)]
        assert not column[rows.harmonic < 2].any()
        for point in (1, 2):
            selected = (rows.channel == names.index(f"x{point}")) & (rows.harmonic == 3)
            real, imag = (selected & (rows.part == part) for part in (Part.REAL, Part.IMAG))
            change = column[real] + 1j * column[imag]
            harmonic = prediction.values[real] + 1j * prediction.values[imag]
            expected = [receptance(h, **factor)[point - 1] / receptance(h)[point - 1] - 1.0 for h in third]
            assert change / harmonic == pytest.approx(np.array(expected), rel=0.02)


def _locked(values: FloatArray, rows: Rows) -> FloatArray:
    """Frequency of each level in Hz."""
    return np.asarray(np.exp(values[rows.part == Part.LOG_FREQUENCY]) / (2.0 * np.pi))
