"""One small results folder of every kind that can be opened."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from report import diagnosis_fixture
from report.synthetic_run import LINEAR, synthetic_run

from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_extract.curves.response_table import write_response_csv
from nmt_extract.curves.swept_response import FrequencyResponseTable
from nmt_extract.modal.table import write_results

SWEPT = (np.array([20.0, 21.0, 22.0]), np.array([20.5, 21.5]))
"""Frequencies of the two levels, Hz: the second level has fewer."""


def a_run(folder: Path) -> None:
    write_results(synthetic_run().points, folder, {"rig": "beam", "linear": json.loads(LINEAR.to_json())})


def a_linear_test(folder: Path) -> None:
    (folder / "linear.json").write_text(LINEAR.to_json())
    point = LINEAR.points[1]
    head = f"frequency_hz,a{point}_f{LINEAR.drive_point}_hv_real,a{point}_f{LINEAR.drive_point}_hv_imag"
    (folder / "frf.csv").write_text(f"{head}\n20,1,2\n21,3,-4\n")


def swept_table(level: float, frequency: np.ndarray) -> FrequencyResponseTable:
    frf = level * np.exp(1j * frequency)[None, :] * np.array([[1.0], [0.5j]])
    force = np.full(frequency.size, level)
    return FrequencyResponseTable(level, "N", 0.2, frequency, force, ("a2", "a4"), frf, 0.01 * abs(frf), 2.0 * force)


def a_sweep(folder: Path) -> None:
    write_response_csv([swept_table(1.0, SWEPT[0]), swept_table(2.0, SWEPT[1])], folder / "frf.csv")


def a_reference(folder: Path) -> None:
    (folder / "reference.csv").write_text("modal_amplitude,omega_rad_s,damping_ratio\n1e-4,140,0.01\n1e-3,130,0.05\n")
    rows = ["modal_amplitude,order,point,real,imaginary"]
    rows += [
        f"{q},{order},{point},{q * point},{order}" for q in (1e-4, 1e-3) for order in (1, 3) for point in (2, 5, 6)
    ]
    (folder / "shapes.csv").write_text("\n".join(rows) + "\n")


def a_diagnosis(folder: Path) -> None:
    diagnosis_fixture.report(Verdict.EFFECT).diagnosis.write(folder / "diagnosis.json")


def a_table_of_decays(folder: Path) -> None:
    head = "segment,channel,time_s,amplitude,unit,frequency_hz,frequency_hz_std,damping_ratio,damping_ratio_std"
    lines = ["1,a2,0.1,2.0,m/s^2,22.1,0.01,0.005,0.0001", "1,a2,0.2,1.0,m/s^2,22.2,0.01,0.004,"]
    (folder / "decay.csv").write_text("\n".join([head, *lines]) + "\n")


def a_robot(folder: Path) -> None:
    (folder / "diagnosis.json").write_text('{"kind": "robot"}')
    (folder / "joints.csv").write_text("joint,cause,value\nhip,Coulomb friction,0.3\nknee,,\n")


KINDS: dict[str, Callable[[Path], None]] = {
    "run": a_run,
    "linear": a_linear_test,
    "sweep": a_sweep,
    "reference": a_reference,
    "diagnosis": a_diagnosis,
    "decays": a_table_of_decays,
    "robot": a_robot,
}
"""Writes a folder of the kind."""
