"""A specimen behind a converter's ports and the commands that drive it, for tests and trials.

Each has a JACK server, an address and a state folder of its own, so that several can run on one computer.
"""

from __future__ import annotations

import ctypes.util
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_bench.hardware.hardware_checks import keep_check
from nmt_plant.devices.hardware_rig import HARDWARE_LEAD, device_of
from nmt_rig.rig import load_rig

KINDS = ("portaudio", "nidaqmx")
RATES = {"portaudio": (48_000, 960), "nidaqmx": (10_000, 200)}
"""Sample rate (Hz) and samples of a block of 20 ms."""
MISSING = {
    "portaudio": shutil.which("jackd") is None or ctypes.util.find_library("portaudio") is None,
    "nidaqmx": False,
}
WHAT_IS_MISSING = "JACK or PortAudio is not installed: sudo apt install jackd2 libportaudio2"
LAUNCH = (sys.executable, "-m", "nmt_bench")


def environment(folder: Path) -> dict[str, str]:
    """Environment of specimen and commands."""
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(part for part in sys.path if part),
        "XDG_STATE_HOME": str(folder / "state"),
        "JACK_DEFAULT_SERVER": f"nmt-trial-{os.getpid()}",
        "JACK_NO_START_SERVER": "1",
        "COLUMNS": "200",
    }


@dataclass(frozen=True)
class Port:
    """Recorded at an output port.

    Attributes:
        values: V, (samples,).
        times: (n, 2): s on the steady clock, and how many samples had passed then.
        rate: Hz.
    """

    values: Any
    times: Any
    rate: float

    def index(self, time: float) -> int:
        """Samples that had passed at a time, s on the steady clock."""
        row = int(np.searchsorted(self.times[:, 0], time, side="right"))
        return int(self.times[row - 1, 1]) if row else 0

    def time_to_zero(self, since: float) -> float:
        """s from a time on the steady clock to the first of the zeros that follow for good; inf = there are none."""
        moving = np.flatnonzero(self.values)
        if not moving.size or moving[-1] == self.values.size - 1:
            return float("inf") if moving.size else 0.0
        row = int(np.searchsorted(self.times[:, 1], moving[-1] + 1))
        return float(self.times[row, 0] - since)


@dataclass
class ConverterBench:
    """Specimen of a kind that runs, and the options that reach it.

    Attributes:
        kind: of the converter.
        folder: for results, state and the record of the port.
        device: value of ``--device``.
        changes: of the rig, key=value.
        process: of the specimen.
    """

    kind: str
    folder: Path
    device: str
    changes: tuple[str, ...]
    process: subprocess.Popen[str]

    @property
    def options(self) -> list[str]:
        """Options of every command that drives it."""
        return ["--device", self.device, *(word for change in self.changes for word in ("--set", change))]

    def start(
        self, *words: str, extra: Mapping[str, str] | None = None, path: Path | None = None
    ) -> subprocess.Popen[str]:
        """Start a command of the bench; what it says is read from its standard output.

        Args:
            words: of the command.
            extra: further environment.
            path: folder in front of the others from which Python imports.
        """
        around = {**environment(self.folder), **(extra or {})}
        if path is not None:
            around["PYTHONPATH"] = os.pathsep.join([str(path), around["PYTHONPATH"]])
        return subprocess.Popen(
            [*LAUNCH, words[0], "beam", *self.options, *words[1:]],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=around,
            start_new_session=True,
        )

    def command(self, *words: str, codes: Sequence[int] = (0,)) -> str:
        """What a command says.

        Raises:
            RuntimeError: it ended with another exit code than those given.
        """
        with self.start(*words) as process:
            said, _ = process.communicate()
        if process.returncode not in codes:
            raise RuntimeError(f"nmt {' '.join(words)} ended with {process.returncode}:\n{said}")
        return said

    def check(self, *words: str, codes: Sequence[int] = (0,)) -> dict[str, Any]:
        """The document of ``./nmt check``."""
        self.command("check", "--quiet", "--force", "--out", str(self.folder / "check"), *words, codes=codes)
        document: dict[str, Any] = json.loads((self.folder / "check" / "check.json").read_text())
        return document

    def pass_check(self) -> int:
        """Let tests begin without a check; gives the blocks that will wait at their output."""
        rig = load_rig("beam", list(self.changes))
        section = device_of(rig, self.kind, self.device.partition("@")[2])
        delay = 1 + getattr(section, "buffer_blocks", 0) * int(rig.block_samples)
        document = {"time": time.time(), "passed": True, "findings": [], "delay_samples": delay}
        before = os.environ.get("XDG_STATE_HOME")
        os.environ["XDG_STATE_HOME"] = environment(self.folder)["XDG_STATE_HOME"]
        try:
            keep_check(rig, section, document)
        finally:
            if before is None:
                del os.environ["XDG_STATE_HOME"]
            else:
                os.environ["XDG_STATE_HOME"] = before
        return HARDWARE_LEAD + math.ceil(delay / int(rig.block_samples))

    def port(self) -> Port:
        """What was at the output port as recorded on its other side; after the end of the specimen."""
        with np.load(self.folder / "port.npz") as kept:
            return Port(kept["values"], kept["times"], float(RATES[self.kind][0]))


@contextmanager
def converter_bench(
    kind: str, folder: Path, *options: str, changes: Sequence[str] = (), record_s: float = 0.0
) -> Iterator[ConverterBench]:
    """A specimen that answers, in a process of its own; its port is recorded for as long as is said, s."""
    rate, block = RATES[kind]
    changes = (f"sample_rate_hz={rate}", f"block_samples={block}", *changes)
    words = ["beam", *(word for change in changes for word in ("--set", change)), "--address", "127.0.0.1:0", *options]
    if record_s:
        words += ["--record", str(folder / "port.npz"), "--record-s", str(record_s)]
    with subprocess.Popen(
        [*LAUNCH, "specimen", "--device", kind, *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment(folder),
        start_new_session=True,
    ) as process:
        try:
            assert process.stdin is not None
            assert process.stdout is not None
            line = process.stdout.readline()
            if not line.startswith("ready"):
                raise RuntimeError(f"the specimen does not answer: {line}")
            address = line.partition(" at ")[2].partition(",")[0]
            device = f"nidaqmx@{address}" if kind == "nidaqmx" else kind
            yield ConverterBench(kind, folder, device, changes, process)
            process.stdin.close()
            process.wait(30)
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
                try:
                    process.wait(20)
                except subprocess.TimeoutExpired:
                    process.kill()


def simulated(kind: str, folder: Path, *words: str, changes: Sequence[str] = ()) -> None:
    """The same test of the simulated rig, at the converter's rate.

    Raises:
        RuntimeError: it did not end with 0.
    """
    rate, block = RATES[kind]
    given = [
        word for change in (f"sample_rate_hz={rate}", f"block_samples={block}", *changes) for word in ("--set", change)
    ]
    command = [*LAUNCH, words[0], "beam", "--device", "simulated", "--one-process", "--quiet", *given, *words[1:]]
    done = subprocess.run(command, capture_output=True, text=True, env=environment(folder))
    if done.returncode:
        raise RuntimeError(f"the simulated test ended with {done.returncode}:\n{done.stdout}{done.stderr}")


@dataclass(frozen=True)
class Difference:
    """A level on a converter and simulated.

    Attributes:
        level: V.
        frequency_hz, damping: on the converter, simulated.
    """

    level: float
    frequency_hz: tuple[float, float]
    damping: tuple[float, float]

    @property
    def frequency_difference(self) -> float:
        """Relative difference."""
        return self.frequency_hz[0] / self.frequency_hz[1] - 1.0

    @property
    def damping_difference(self) -> float:
        """Relative difference."""
        return self.damping[0] / self.damping[1] - 1.0


def differences(measured: Path, reference: Path) -> list[Difference]:
    """Level by level, from two results folders.

    Raises:
        RuntimeError: they have not the same levels.
    """
    tables = [np.genfromtxt(folder / "modal.csv", delimiter=",", names=True) for folder in (measured, reference)]
    one, other = (np.atleast_1d(table) for table in tables)
    if one.shape != other.shape or not np.allclose(one["level"], other["level"], rtol=1e-9):
        raise RuntimeError(f"{one.size} and {other.size} levels cannot be compared.")
    return [
        Difference(
            float(a["level"]),
            (float(a["frequency_hz"]), float(b["frequency_hz"])),
            (float(a["damping_ratio"]), float(b["damping_ratio"])),
        )
        for a, b in zip(one, other, strict=True)
    ]
