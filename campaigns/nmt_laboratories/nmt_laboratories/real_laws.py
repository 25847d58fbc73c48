"""Laws of three real drives and dampers: read from some recordings, and the force that they predict of others.

Run in ``./nmt shell``::

    python -m nmt_laboratories.real_laws earthquakes FOLDER   # sines and earthquakes as JSON, see below
    python -m nmt_laboratories.real_laws drive FOLDER         # steady speeds, see below
    python -m nmt_laboratories.real_laws damper FOLDER        # test_*.csv at three currents
    python -m nmt_laboratories.real_laws currents FOLDER      # the same, one law for all

Each record is imported as its owner would, with a model of a mass of no weight; the law is read by the diagnosis, goes
to the rig file, and the file predicts the force of records that the reading did not have. Figures are rms of what is
left over rms of the force, both without their means: the zero of the cell and a preload are no law. Beside them stand
what plain elements leave that are fitted by this file to the same records.

FOLDER of the earthquakes is ``data/dataset-3`` of github.com/ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash
(CC BY-SA 4.0): sines read the law, earthquakes are predicted. The MR damper is labcontrol-data/mr-damper (MIT), the
drive ``experiments/driveNo1/steady_state/0.096kg`` of RViMLab/TRO2021-Dynamic-Modelling (MIT): every other speed is
read.
"""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.optimize import minimize

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import observed
from nmt_diagnose.law.law_elements import with_law
from nmt_diagnose.law.moved_record import MovedRecord
from nmt_diagnose.law.reading import LawReading
from nmt_diagnose.search.law_starts import law_of
from nmt_laboratories.campaign_frame import command_parser
from nmt_rig.rig import Rig, load_rig

Array = np.ndarray
_INCH, _KIP = 0.0254, 4448.22
_DECIMATED = 8  # samples that are averaged
_ROWS = 2500
_AT_REST = 0.02  # of the range of a motion that has not begun
_TESTS = {"weak": "1_1 4_1 7_1", "middle": "B_1 B_6 B_9", "strong": "A_1 A_4 A_7 A_9"}
_HELD, _NOMINAL = 120, 9.84e-3  # samples of each speed; torque that the drive's percents count from, N m


@dataclass(frozen=True)
class Record:
    """Motion at a rate (Hz) in its quantity (displacement or angular_velocity) and the force beside it, N or N m.

    A current (A) is that of the coil all along; NaN = not recorded.
    """

    name: str
    rate: float
    motion: Array
    force: Array
    quantity: str = "displacement"
    current: float = math.nan


def model(folder: Path, rate: float, mass: float, quantity: str) -> Rig:
    """Rig file of a mass that is moved."""
    kind = {"displacement": "displacement", "angular_velocity": "velocity"}[quantity]
    text = {
        "name": "moved", "sample_rate_hz": rate,
        "structure": {"kind": "chain", "masses_kg": [mass], "ground_springs_n_m": [0.0]},
        "exciter": {"kind": "force", "point": 1},
        "sensors": [{"quantity": "force", "point": "drive"}, {"quantity": kind, "point": 1}],
        "extraction": {"quantity": kind, "linear_modes": 1},
    }  # fmt: skip
    (folder / "model.yaml").write_text(yaml.safe_dump(text), encoding="utf-8")
    return load_rig(str(folder / "model.yaml"), vibrating=False)


def imported(folder: Path, record: Record, number: int) -> Path:
    """Bag of a record."""
    columns: dict[str, Any] = {"x": record.motion, "f": record.force}
    followed = []
    if not math.isnan(record.current):
        # A channel without any noise would be a dead one.
        noise = np.random.default_rng(number).standard_normal(record.motion.size)
        columns["i"] = record.current * (1.0 + 1e-3 * noise)
        followed = [{"column": "i", "quantity": "current", "unit": "A", "point": 1}]
    np.savez(folder / f"{number}.npz", **columns)
    units = {"displacement": "m", "angular_velocity": "rad/s"}
    sidecar = {
        "rig": "model.yaml", "sample_rate": record.rate, "file": f"{number}.npz",
        "channels": [
            {"column": "x", "quantity": record.quantity, "unit": units[record.quantity], "point": 1},
            {"column": "f", "quantity": "force", "unit": "N", "point": 1},
            *followed,
        ],
        "segments": [
            {"kind": "record", "start": 0.0, "stop": (record.motion.size - 1.5) / record.rate, "held": "response"}
        ],
    }  # fmt: skip
    (folder / f"{number}.yaml").write_text(yaml.safe_dump(sidecar), encoding="utf-8")
    import_data(folder / f"{number}.yaml", folder / f"bag{number}")
    return folder / f"bag{number}"


def read_and_predict(
    known: Sequence[Record], unknown: Sequence[Record], mass: float, parts: Sequence[int] = ()
) -> tuple[LawReading | None, list[float], float]:
    """The law of some records, what its file leaves of the force of others (share), and CPU seconds of the reading.

    Where lengths of parts are stated, of the means of these parts.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rig = model(folder, known[0].rate, mass, known[0].quantity)
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
            kept, force = np.concatenate(found.left_by(written)), found.measured
            if parts:
                at = np.cumsum(parts)[:-1] * force.size // sum(parts)
                kept, force = (np.array([part.mean() for part in np.split(some, at)]) for some in (kept, force))
            left.append(float(np.std(kept) / np.std(force)))
    return reading, left, seconds


def families_in_words(reading: LawReading | None) -> str:
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
    return np.asarray(np.gradient(record.motion) * record.rate)


def table_of(path: Path) -> Array:
    """Rows of a file with a heading: time (s), displacement (mm), force (N)."""
    return np.loadtxt(path, delimiter=",", skiprows=1)


def earthquakes(folder: Path) -> None:
    """Print what the law of the sines leaves of the force under each earthquake, beside two sliders."""

    def record(path: Path) -> Record:
        data = np.array(json.loads(path.read_text(encoding="utf-8"))["data"], float)
        data = data[: len(data) // _DECIMATED * _DECIMATED].reshape(-1, _DECIMATED, data.shape[1]).mean(axis=1)
        return Record(path.stem, 1.0 / float(np.diff(data[:, 0]).mean()), data[:, 1] * _INCH, data[:, 2] * _KIP)

    known = [record(path) for path in sorted((folder / "characterization tests").glob("*.json"))]
    unknown = [record(path) for path in sorted((folder / "earthquake profiles").glob("*.json"))]
    reading, left, seconds = read_and_predict(known, unknown, 1.0)
    starts = (2e-3, 8e-3)
    sliders = fitted(known, unknown, lambda one, slips: [play(one.motion, slip) for slip in slips], starts)
    print(f"{len(known)} sines: {families_in_words(reading)}; {seconds:.1f} s")
    for record_, law, two in zip(unknown, left, sliders, strict=True):
        print(f"{record_.name}: law {100 * law:.1f} %, two sliders {100 * two:.1f} %")
    print(f"mean: law {100 * np.mean(left):.1f} %, two sliders {100 * np.mean(sliders):.1f} %")


def drive(folder: Path) -> None:
    """One record of speeds one after the other, from the slowest on; the curve over speed is the mean at each."""

    def speeds(path: Path) -> tuple[float, Array]:
        lines = path.read_text(encoding="utf-8").splitlines()
        first = next(k for k, line in enumerate(lines) if line.startswith("ms;")) + 1
        rows = [list(map(float, line.split(";"))) for line in lines[first : first + _HELD] if line.count(";") == 2]
        table = np.array(rows) * (1.0, -np.pi / 30.0, -_NOMINAL / 100.0)
        return float(table[:, 1].mean()), table

    tables = sorted((speeds(path) for path in folder.glob("*.csv")), key=lambda one: one[0])
    for parity in (0, 1):
        known, unknown = ([table for _, table in tables[start::2]] for start in (parity, 1 - parity))
        rate = 1000.0 / float(np.median(np.diff(tables[0][1][:, 0])))

        def joined(some: Sequence[Array], name: str, rate: float = rate) -> Record:
            all_rows = np.vstack(some)
            return Record(name, rate, all_rows[:, 1], all_rows[:, 2], "angular_velocity")

        reading, left, seconds = read_and_predict(
            [joined(known, "known")], [joined(unknown, "unknown")], 2.2e-6, [len(table) for table in unknown]
        )
        what = f"{len(known)} speeds: {families_in_words(reading)}; {seconds:.1f} s"
        print(f"{what}; {100 * left[0]:.1f} % of the curve left at the other {len(unknown)}")


def of_damper(folder: Path, names: str) -> list[Record]:
    """Records of the damper while it moves."""
    records = []
    for name in names.split():
        data = table_of(folder / f"test_{name}.csv")
        moves = np.flatnonzero(np.abs(data[:, 1] - data[0, 1]) > _AT_REST * np.ptp(data[:, 1]))
        data = data[moves[0] : moves[-1] + 1]
        records.append(Record(name, 100.0, 1e-3 * data[:, 1], data[:, 2]))
    return records


def currents(folder: Path) -> None:
    """Print what one law for all currents leaves of each record that it was not read from, beside Dahl's element.

    The files do not say the current. The size of the force of the other records at the same one stands for it.
    """
    groups = {current: of_damper(folder, names) for current, names in _TESTS.items()}
    left_of: dict[str, list[float]] = {current: [] for current in groups}
    for current, records in groups.items():
        for out in records:
            kept = {name: [record for record in some if record is not out] for name, some in groups.items()}
            size = {name: float(np.mean([np.std(record.force) for record in some])) for name, some in kept.items()}
            known = [replace(record, current=size[name] / 1e3) for name, some in kept.items() for record in some]
            reading, left, seconds = read_and_predict(known, [replace(out, current=size[current] / 1e3)], 0.1)
            left_of[current] += left
            print(f"{current} {out.name}: law {100 * left[0]:.1f} %; {families_in_words(reading)}; {seconds:.1f} s")
    for current, left in left_of.items():
        print(f"{current}: one law for all currents {100 * np.mean(left):.1f} %")


def damper(folder: Path) -> None:
    """Print for each current what the law of the other records leaves of each, beside Dahl's element."""
    ratios = []
    for current, names in _TESTS.items():
        records = of_damper(folder, names)
        laws, plain = [], []
        for number, out in enumerate(records):
            known = [*records[:number], *records[number + 1 :]]
            reading, left, seconds = read_and_predict(known, [out], 0.1)
            dahls = fitted(known, [out], lambda one, at: [dahl(one, at[0], 1.0), speed(one), one.motion], (3.0 / 5e-4,))
            laws += left
            plain += dahls
            print(f"{current} {out.name}: law {100 * left[0]:.1f} %, Dahl {100 * dahls[0]:.1f} %; "
                  f"{families_in_words(reading)}; {seconds:.1f} s")  # fmt: skip
        ratios.append(float(np.mean(laws) / np.mean(plain)))
        print(f"{current}: law {100 * np.mean(laws):.1f} %, Dahl {100 * np.mean(plain):.1f} %, ratio {ratios[-1]:.2f}")


def main() -> None:
    """Read the laws of one set of recordings, and print how well they predict."""
    parser = command_parser(__doc__)
    parser.add_argument("what", choices=("earthquakes", "drive", "damper", "currents"))
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    {"earthquakes": earthquakes, "drive": drive, "damper": damper, "currents": currents}[arguments.what](
        arguments.folder
    )


if __name__ == "__main__":
    main()
