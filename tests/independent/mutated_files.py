"""Files with changed bytes, a thousand of each kind: what reads them must take them or say what is wrong.

Run from the root of the repository, in an environment with the bench::

    PYTHONPATH=tests:$PYTHONPATH python -m independent.mutated_files --count 1000 --out answers [KIND …]

Each file is read in a child whose memory may grow by 1 GiB and which has 10 s. A kind whose answer is in the folder is
not read again; files that end otherwise than taken or refused are kept there.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import re
import resource
import shutil
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from rig.superelement_files import FORMS, REPORTED, reported, write
from rig.test_matrix_files import mutated, written

from nmt_bench.data_import import import_data
from nmt_core.errors import BenchError
from nmt_diagnose.units.unit_table import read_unit_table
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.sidecar.calibration_file import read_calibration
from nmt_rig.file_errors import BadFileError
from nmt_rig.matrix_files import read_model
from nmt_rig.model_figures import model_figures
from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_structure
from nmt_rig.rig_places import find_rig, rig_names

TAKEN, REFUSED = "taken", "refused"
SECONDS = 10.0
GROWTH = 2**30
_KEPT = 5


@dataclass(frozen=True)
class Kind:
    """Files of one kind.

    Attributes:
        name: of the kind.
        changed: the file whose bytes are changed.
        read: what reads it; raises BenchError or BadFileError where it refuses.
        change: makes another file of its content.
    """

    name: str
    changed: Path
    read: Callable[[], Any]
    change: Callable[[bytes, np.random.Generator], bytes] = mutated


def _matrix_kinds(folder: Path) -> list[Kind]:
    """Matrices of each form, and models of each finite-element program."""
    kinds = [
        Kind(f"matrix {name}", folder / name, lambda name=name, read=read: read(folder / name))  # type: ignore[misc]
        for name, read in written(folder).items()
    ]
    for form in FORMS:
        place = folder / form.replace(" ", "-")
        place.mkdir()
        paths = write(form, place)
        for key, path in paths.items():
            if path.exists():
                kinds.append(Kind(f"model {form}, {key}", path, lambda paths=paths: read_model(paths)))  # type: ignore[misc]
    for form in REPORTED:
        place = folder / form.replace(" ", "-")
        place.mkdir()
        paths, _ = reported(form, 1, place)
        path = next(iter(paths.values()))
        kinds.append(Kind(f"model {form}", path, lambda paths=paths: model_figures(paths, "m-kg-N")))  # type: ignore[misc]
    return kinds


def _rig_kinds(folder: Path) -> list[Kind]:
    """Rig files, those with the elements of laws among them."""
    kinds = []
    for name in rig_names():
        target = folder / f"{name}.yaml"
        shutil.copy(find_rig(name), target)
        kinds.append(Kind(f"rig {name}", target, lambda target=target: build_structure(load_rig(target))))  # type: ignore[misc]
    return kinds


def _import_kinds(folder: Path) -> list[Kind]:
    """Sidecars, time data, tables, and the bag that they become."""
    time_s = np.arange(2000) / 1000.0
    motion = np.exp(-3.0 * time_s) * np.sin(2.0 * np.pi * 30.0 * time_s)
    displacement = -motion / (2.0 * np.pi * 30.0) ** 2
    columns = np.column_stack([time_s, motion, displacement])
    np.savetxt(folder / "data.csv", columns, delimiter=",", header="time_s,a1,x1", comments="", fmt="%.9g")
    np.savez(folder / "data.npz", time_s=time_s, a1=motion, x1=displacement)
    channels = (
        "channels:\n- {column: a1, quantity: acceleration, unit: m/s^2, point: 1}\n"
        "- {column: x1, quantity: displacement, unit: m, point: 1}\n"
        "segments:\n- {kind: ring_down, start: 0.0, stop: 1.9}\n"
    )
    mode = "{frequency_hz: 30.0, damping_ratio: 0.016, modal_mass_kg: 1.0}"
    (folder / "model.yaml").write_text(f"name: one\nstructure: {{kind: modal, modes: [{mode}]}}\n")
    for ending in ("csv", "npz"):
        text = f"rig: model.yaml\nfile: data.{ending}\ntime: time_s\n{channels}"
        (folder / f"{ending}.yaml").write_text(text)
    hertz = np.linspace(25.0, 35.0, 60)
    response = -(hertz**2) / (30.0**2 - hertz**2 + 2j * 0.016 * 30.0 * hertz)
    rows = np.column_stack([hertz, response.real, response.imag])
    np.savetxt(folder / "frf.csv", rows, delimiter=",", header="frequency_hz,real,imag", comments="")
    segment = "- {kind: frf, file: frf.csv, unit: m/s^2/N, point: 1, drive_point: 1}\n"
    (folder / "frf.yaml").write_text(f"rig: model.yaml\nfile: frf.csv\nsegments:\n{segment}")

    def importing(sidecar: str) -> Callable[[], Any]:
        def read() -> None:
            out = folder / "out"
            shutil.rmtree(out, ignore_errors=True)
            import_data(folder / sidecar, out)

        return read

    import_data(folder / "npz.yaml", folder / "kept")
    bag = next((folder / "kept").rglob("*.mcap"))

    def read_bag() -> None:
        opened = Bag.open(bag.parent)
        for _ in opened.messages():
            pass

    return [
        *(Kind(f"sidecar of {name}", folder / f"{name}.yaml", importing(f"{name}.yaml")) for name in ("csv", "frf")),
        *(Kind(f"data {name}", folder / f"data.{name}", importing(f"{name}.yaml")) for name in ("csv", "npz")),
        Kind("table of responses", folder / "frf.csv", importing("frf.yaml")),
        Kind("bag", bag, read_bag),
    ]


def _table_kinds(folder: Path) -> list[Kind]:
    """Tables of units, calibration files."""
    for name in ("a", "b", "c"):
        (folder / name).mkdir()
    units, calibration = folder / "units.csv", folder / "calibration.yaml"
    units.write_text("recording,unit,mounting\na,leg 1,1\nb,leg 1,2\nc,leg 2,1\n")
    calibration.write_text("channels:\n- {channel: a1, gain_std: 0.01}\n- {channel: f2, gain_std: 0.02}\n")
    return [
        Kind("table of units", units, lambda: read_unit_table(units)),
        Kind("calibration", calibration, lambda: read_calibration(calibration)),
    ]


def _robot_kinds(folder: Path) -> list[Kind]:
    """A robot's file, its log, its sidecar; none where MuJoCo is not installed."""
    try:
        import mujoco  # noqa: F401
    except ImportError:
        return []
    import h5py
    from robots.changed_robot_files import MJCF, URDF, changed_tree
    from robots.simulated_joint import log_columns, robot_file

    from nmt_robots.log.proposal import propose_sidecar
    from nmt_robots.model.robot_model import RobotModel
    from nmt_robots.verdict.robot_diagnosis import read_log

    robot = robot_file(folder)
    log, sidecar = folder / "log.npz", folder / "log.yaml"
    columns = log_columns(rate_hz=100.0)
    columns = {name: values[:400] if values.shape[0] > 400 else values for name, values in columns.items()}
    np.savez(log, **columns)
    sidecar.write_text(propose_sidecar(log, robot, folder).text)
    rows = {name: np.ravel(values) for name, values in columns.items() if len(values) > 1}
    effort = 60.0 * (rows["des_pos"] - rows["pos"]) + np.random.default_rng(5).normal(0.0, 0.1, len(rows["pos"]))
    table, episode = folder / "table.csv", folder / "episode.h5"
    header = "time [s],elbow_pos [rad],elbow_vel [rad/s],elbow_torque [Nm]"
    numbers = np.column_stack([rows["time"], rows["pos"], rows["vel"], effort])
    np.savetxt(table, numbers, delimiter=",", header=header, comments="", fmt="%.9g")
    with h5py.File(episode, "w") as file:
        for name, values in (("time", rows["time"]), ("qpos", columns["pos"]), ("effort", effort[:, None])):
            file[f"observations/{name}"] = values
    rich = []
    for form, text in (("xml", MJCF), ("urdf", URDF)):
        path = folder / f"rich.{form}"
        path.write_text(text)
        rich += [
            Kind(f"robot {form}{words}", path, lambda path=path: _torque_of(path), change)  # type: ignore[misc]
            for words, change in (("", mutated), (", tree", changed_tree))
        ]
    return [
        *rich,
        Kind("robot", robot, lambda: RobotModel(robot)),
        Kind("log of joints", log, lambda: read_log(sidecar, robot)),
        Kind("sidecar of joints", sidecar, lambda: read_log(sidecar, robot)),
        Kind("table of joints", table, lambda: read_log(table, robot)),
        Kind("episode of joints", episode, lambda: read_log(episode, robot)),
    ]


def _torque_of(path: Path) -> None:
    """Read a robot, its facts and a torque, which has to be a number."""
    from nmt_robots.model.robot_model import RobotModel
    from nmt_robots.verdict.file_findings import file_findings

    model = RobotModel(path)
    model.chosen(model.names)
    file_findings(model, model.names)
    pose = np.linspace(-0.5, 0.5, len(model.names))[None]
    if not np.all(np.isfinite(model.torque(model.names, pose, pose, pose))):
        raise ValueError("the torque is not a number")


def kinds_in(folder: Path) -> list[Kind]:
    """All kinds, with their files in folders of their own."""
    found: list[Kind] = []
    for number, make in enumerate((_matrix_kinds, _rig_kinds, _import_kinds, _table_kinds, _robot_kinds)):
        place = folder / str(number)
        place.mkdir()
        found += make(place)
    return found


def _child(kind: Kind, files: Sequence[bytes], first: int, answers: Connection) -> None:
    """Read the files from ``first`` on; sends the outcome of each."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    warnings.simplefilter("ignore")
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + GROWTH
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for content in files[first:]:
        kind.changed.write_bytes(content)
        try:
            kind.read()
        except (BenchError, BadFileError):
            answers.send(REFUSED)
        except Exception as error:
            answers.send(f"internal error: {type(error).__name__}: {str(error)[:120]}")
        else:
            answers.send(TAKEN)
    answers.close()


def outcomes(kind: Kind, files: Sequence[bytes]) -> list[str]:
    """How the reading of each file ended."""
    context, found = multiprocessing.get_context("fork"), []
    while len(found) < len(files):
        receiver, sender = context.Pipe(duplex=False)
        child = context.Process(target=_child, args=(kind, files, len(found), sender))
        child.start()
        sender.close()
        try:
            while len(found) < len(files):
                if not receiver.poll(SECONDS):
                    found.append(f"no answer in {SECONDS:g} s")
                    child.kill()
                    break
                found.append(receiver.recv())
        except EOFError:
            child.join()
            found.append(f"crash: exit code {child.exitcode}")
        child.join()
        receiver.close()
    return found


def answered(kind: Kind, count: int, out: Path) -> dict[str, int]:
    """How many files of a kind ended how, from the folder where it is there."""
    stem = re.sub(r"[^A-Za-z0-9]+", "-", kind.name).strip("-")
    path = out / f"{stem}.json"
    if path.exists():
        return dict(json.loads(path.read_text(encoding="utf-8")))
    random = np.random.default_rng([823, *kind.name.encode()])
    content = kind.changed.read_bytes()
    files = [kind.change(content, random) for _ in range(count)]
    ends = outcomes(kind, files)
    kind.changed.write_bytes(content)
    bad = [number for number, end in enumerate(ends) if end not in (TAKEN, REFUSED)]
    for number in bad[:_KEPT]:
        (out / f"{stem}-{number}{kind.changed.suffix}").write_bytes(files[number])
    counts = dict(Counter(ends))
    path.write_text(json.dumps(counts, indent=1), encoding="utf-8")
    return counts


def main() -> None:
    """Read what is asked for and print a line for each kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", help="beginnings of names; all without")
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        chosen = [
            kind for kind in kinds_in(Path(name)) if not options.kinds or kind.name.startswith(tuple(options.kinds))
        ]
        wrong = 0
        for number, kind in enumerate(chosen, start=1):
            started = time.monotonic()
            counts = answered(kind, options.count, options.out)
            bad = {end: times for end, times in counts.items() if end not in (TAKEN, REFUSED)}
            wrong += sum(bad.values())
            text = "; ".join(f"{times} × {end}" for end, times in bad.items()) or "none otherwise"
            print(
                f"{number} of {len(chosen)}, {time.monotonic() - started:.0f} s: {kind.name}: {counts.get(TAKEN, 0)} "
                f"taken, {counts.get(REFUSED, 0)} refused, {text}", flush=True,
            )  # fmt: skip
        print(f"{sum(1 for _ in chosen)} kinds, {options.count} files each: {wrong} neither taken nor refused")


if __name__ == "__main__":
    main()
