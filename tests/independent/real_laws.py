"""Laws of three real drives and dampers: read from some recordings, and the force that they predict of others.

Run from the root of the repository in ``./nmt shell``::

    PYTHONPATH=tests python -m independent.real_laws earthquakes FOLDER   # sines and earthquakes as JSON, see below
    PYTHONPATH=tests python -m independent.real_laws drive FOLDER         # s50.csv and s200.csv
    PYTHONPATH=tests python -m independent.real_laws damper FOLDER        # test_*.csv at three currents

Each record is imported as its owner would, with a model of a mass of no weight; the law is read by the diagnosis, goes
to the rig file, and the file predicts the force of records that the reading did not have. Figures are rms of what is
left over rms of the force, both without their means: the zero of the cell and a preload are no law. Beside them stand
what plain elements leave that are fitted by this file to the same records.

FOLDER of the earthquakes is ``data/dataset-3`` of github.com/ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash
(CC BY-SA 4.0): sines read the law, earthquakes are predicted. The MR damper is labcontrol-data/mr-damper (MIT), the
drive RViMLab/TRO2021-Dynamic-Modelling (MIT).
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from scipy.optimize import minimize

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import observed
from nmt_diagnose.law.law_elements import with_law
from nmt_diagnose.law.moved_record import MovedRecord
from nmt_diagnose.law.reading import LawReading
from nmt_diagnose.search.law_starts import law_of
from nmt_rig.rig import Rig, load_rig

Array = np.ndarray
_INCH, _KIP = 0.0254, 4448.22
_DECIMATED = 8  # samples that are averaged
_ROWS = 2500


@dataclass(frozen=True)
class Record:
    """Motion at a rate (Hz) in its quantity (displacement or angular_velocity) and the force beside it, N or N m."""

    name: str
    rate: float
    motion: Array
    force: Array
    quantity: str = "displacement"


def model(folder: Path, rate: float, mass: float, damper: float, quantity: str) -> Rig:
    """Rig file of a mass that is moved."""
    kind = {"displacement": "displacement", "angular_velocity": "velocity"}[quantity]
    text = {
        "name": "moved", "sample_rate_hz": rate,
        "structure": {
            "kind": "chain", "masses_kg": [mass], "ground_springs_n_m": [0.0], "ground_dampers_ns_m": [damper],
        },
        "exciter": {"kind": "force", "point": 1},
        "sensors": [{"quantity": "force", "point": "drive"}, {"quantity": kind, "point": 1}],
        "extraction": {"quantity": kind, "linear_modes": 1},
    }  # fmt: skip
    (folder / "model.yaml").write_text(yaml.safe_dump(text), encoding="utf-8")
    return load_rig(str(folder / "model.yaml"), vibrating=False)


def imported(folder: Path, record: Record, number: int) -> Path:
    """Bag of a record."""
    np.savez(folder / f"{number}.npz", x=record.motion, f=record.force)
    units = {"displacement": "m", "angular_velocity": "rad/s"}
    sidecar = {
        "rig": "model.yaml", "sample_rate": record.rate, "file": f"{number}.npz",
        "channels": [
            {"column": "x", "quantity": record.quantity, "unit": units[record.quantity], "point": 1},
            {"column": "f", "quantity": "force", "unit": "N", "point": 1},
        ],
        "segments": [
            {"kind": "record", "start": 0.0, "stop": (record.motion.size - 1.5) / record.rate, "held": "response"}
        ],
    }  # fmt: skip
    (folder / f"{number}.yaml").write_text(yaml.safe_dump(sidecar), encoding="utf-8")
    import_data(folder / f"{number}.yaml", folder / f"bag{number}")
    return folder / f"bag{number}"


def read_and_predict(
    known: Sequence[Record], unknown: Sequence[Record], mass: float, damper: float = 0.0
) -> tuple[LawReading | None, list[float], float]:
    """The law of some records, what its file leaves of the force of others (share), and CPU seconds of the reading."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rig = model(folder, known[0].rate, mass, damper, known[0].quantity)
        bags = [imported(folder, record, number) for number, record in enumerate(known)]
        observations = observed(rig, bags)
        begin = time.process_time()
        reading = law_of(rig, observations)
        seconds = time.process_time() - begin
        written = rig if reading is None or not reading.laws else with_law(rig, reading)
        left = []
        for number, record in enumerate(unknown, len(known)):
            found = MovedRecord.of(rig, observed(rig, [imported(folder, record, number)]), 0, 10, _ROWS)
            assert found is not None
            rest = np.concatenate(found.left_by(written))
            left.append(float(np.std(rest) / np.std(found.measured)))
    return reading, left, seconds


def said(reading: LawReading | None) -> str:
    """Families of a reading, or why there is none."""
    if reading is None:
        return "no reading"
    words = ", ".join(law.family for law in reading.laws)
    return words + (f" (not stated: {'; '.join(reading.refusals)})" if reading.refusals else "")


def play(x: Array, slip: float) -> Array:
    """Deflection of a spring in series with a slider, m."""
    result, at = np.empty_like(x), x[0]
    for k, now in enumerate(x):
        at = min(max(at, now - slip), now + slip)
        result[k] = now - at
    return result


def dahl(record: Record, stiffness: float, friction: float) -> Array:
    """Force of Dahl's element: dF = σ (1 − F sgn(ẋ) / F_C) dx, N."""
    result, force = np.empty_like(record.motion), 0.0
    steps = np.diff(record.motion, prepend=record.motion[0])
    for k, step in enumerate(steps):
        full = friction if step > 0.0 else -friction
        force = full + (force - full) * np.exp(-abs(step) * stiffness / friction)
        result[k] = force
    return result


Columns = Callable[[Record, Sequence[float]], list[Array]]


def fitted(known: Sequence[Record], unknown: Sequence[Record], columns: Columns, start: Sequence[float]) -> list[float]:
    """What columns of free strength and free parameters leave of other records when they are fitted to some."""

    def parts(records: Sequence[Record], at: Array) -> tuple[Array, Array]:
        made = [np.stack(columns(record, np.exp(at))).T for record in records]
        left = np.vstack([one - one.mean(axis=0) for one in made])
        return left, np.concatenate([record.force - record.force.mean() for record in records])

    def cost(at: Array) -> float:
        left, force = parts(known, at)
        return float(np.sum((force - left @ np.linalg.lstsq(left, force, rcond=None)[0]) ** 2) / np.sum(force**2))

    best = minimize(cost, np.log(start), method="Nelder-Mead", options={"maxiter": 120}).x
    strengths = np.linalg.lstsq(*parts(known, best), rcond=None)[0]
    result = []
    for record in unknown:
        left, force = parts([record], best)
        result.append(float(np.std(force - left @ strengths) / np.std(force)))
    return result


def speed(record: Record) -> Array:
    """Velocity of a displacement, m/s."""
    return np.gradient(record.motion) * record.rate


def table_of(path: Path) -> Array:
    return np.loadtxt(path, delimiter=",", skiprows=1)


def earthquakes(folder: Path) -> None:
    def record(path: Path) -> Record:
        data = np.array(json.loads(path.read_text(encoding="utf-8"))["data"], float)
        data = data[: len(data) // _DECIMATED * _DECIMATED].reshape(-1, _DECIMATED, data.shape[1]).mean(axis=1)
        return Record(path.stem, 1.0 / float(np.diff(data[:, 0]).mean()), data[:, 1] * _INCH, data[:, 2] * _KIP)

    known = [record(path) for path in sorted((folder / "characterization tests").glob("*.json"))]
    unknown = [record(path) for path in sorted((folder / "earthquake profiles").glob("*.json"))]
    reading, left, seconds = read_and_predict(known, unknown, 1.0)
    starts = (2e-3, 8e-3)
    sliders = fitted(known, unknown, lambda one, slips: [play(one.motion, slip) for slip in slips], starts)
    print(f"{len(known)} sines: {said(reading)}; {seconds:.1f} s")
    for record_, law, two in zip(unknown, left, sliders, strict=True):
        print(f"{record_.name}: law {100 * law:.1f} %, two sliders {100 * two:.1f} %")
    print(f"mean: law {100 * np.mean(left):.1f} %, two sliders {100 * np.mean(sliders):.1f} %")


def drive(folder: Path) -> None:
    def records(parity: int) -> list[Record]:
        found = []
        for name in ("s50", "s200"):
            data = table_of(folder / f"{name}.csv")
            rate = 1.0 / float(np.diff(data[:, 0]).mean())
            half = slice(0, len(data) // 2) if parity == 0 else slice(len(data) // 2, None)
            found.append(Record(f"{name} half {parity + 1}", rate, data[half, 1], data[half, 2], "angular_velocity"))
        return found

    for parity in (0, 1):
        known, unknown = records(parity), records(1 - parity)
        reading, left, seconds = read_and_predict(known, unknown, 2.2e-6)
        print(f"half {parity + 1}: {said(reading)}; {seconds:.1f} s")
        for record, law in zip(unknown, left, strict=True):
            print(f"  {record.name}: law {100 * law:.1f} % of the torque left")


def damper(folder: Path) -> None:
    ratios = []
    for current, names in (("weak", "1_1 4_1 7_1"), ("middle", "B_1 B_6 B_9"), ("strong", "A_1 A_4 A_7 A_9")):
        records = []
        for name in names.split():
            data = table_of(folder / f"test_{name}.csv")
            records.append(Record(name, 100.0, 1e-3 * data[:, 1], data[:, 2]))
        laws, plain = [], []
        for number, out in enumerate(records):
            known = [*records[:number], *records[number + 1 :]]
            reading, left, seconds = read_and_predict(known, [out], 0.1)
            dahls = fitted(known, [out], lambda one, at: [dahl(one, at[0], 1.0), speed(one), one.motion], (3.0 / 5e-4,))
            laws += left
            plain += dahls
            print(f"{current} {out.name}: law {100 * left[0]:.1f} %, Dahl {100 * dahls[0]:.1f} %; "
                  f"{said(reading)}; {seconds:.1f} s")  # fmt: skip
        ratios.append(float(np.mean(laws) / np.mean(plain)))
        print(f"{current}: law {100 * np.mean(laws):.1f} %, Dahl {100 * np.mean(plain):.1f} %, ratio {ratios[-1]:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("earthquakes", "drive", "damper"))
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    {"earthquakes": earthquakes, "drive": drive, "damper": damper}[arguments.what](arguments.folder)


if __name__ == "__main__":
    main()
