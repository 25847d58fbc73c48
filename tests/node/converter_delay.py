"""Starts of the bench on a converter whose specimen has a delay or a clock of its own.

./nmt shell <<< "python tests/node/converter_delay.py portaudio --starts 20"
./nmt shell <<< "python tests/node/converter_delay.py nidaqmx --starts 20"
./nmt shell <<< "python tests/node/converter_delay.py portaudio --clock-ppm 50"
./nmt shell <<< "python tests/node/converter_delay.py nidaqmx --clock-ppm 50"
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from node.converter_bench import KINDS, RATES, converter_bench, environment

from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.hardware_rig import HardwareRig, device_of
from nmt_rig.rig import load_rig

LEAD = 40
SINE = DriveCommand(Waveform.SINE, 22.0, 0.5)


def open_device(kind: str, address: str, *changes: str) -> HardwareRig:
    """The rig behind the specimen's ports, without nodes; started."""
    rate, block = RATES[kind]
    rig = load_rig("beam", [f"sample_rate_hz={rate}", f"block_samples={block}", *changes])
    device = HardwareRig(rig, device_of(rig, kind, address), lead_blocks=LEAD)
    device.configure()
    device.start()
    return device


def true_delay(kind: str, planted: int) -> int:
    """Samples from a sample put out to the one that measures it: a sample of the specimen, and the output's buffer."""
    rate, block = RATES[kind]
    rig = load_rig("beam", [f"sample_rate_hz={rate}", f"block_samples={block}"])
    buffer = getattr(device_of(rig, kind, ""), "buffer_blocks", 0)
    return planted + 1 + buffer * block


def measured_delay(kind: str, folder: Path, planted: int) -> int:
    """The delay that a start finds; the specimen has this one."""
    with converter_bench(kind, folder, "--delay", str(planted)) as bench:
        device = open_device(kind, bench.device.partition("@")[2])
        try:
            return device.figures.delay
        finally:
            device.close()


def sentences(kind: str, folder: Path, ppm: float, seconds: float) -> tuple[float, float, tuple[str, ...]]:
    """Clock error that is found, millionths, drift of the delay, samples, and what is said of them in a test."""
    with converter_bench(kind, folder, "--clock-ppm", str(ppm)) as bench:
        device = open_device(kind, bench.device.partition("@")[2])
        try:
            for _ in range(round(seconds * device.sample_rate / device.block_samples)):
                device.write(SINE)
                device.read()
            return device.figures.clock_ppm, device.figures.drift, device.warnings
        finally:
            device.close()


def main() -> int:
    """Print every start; 0 where each was within a sample, or where the clock was said."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--clock-ppm", type=float, default=0.0)
    parser.add_argument("--seconds", type=float, default=40.0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        os.environ.update(environment(folder))
        if given.clock_ppm:
            clock, drift, said = sentences(given.kind, folder, given.clock_ppm, given.seconds)
            print(f"clock {clock:+.1f} ppm, delay moved by {drift:+.2f} samples in {given.seconds:g} s")
            print("\n".join(said) or "nothing said")
            return 0 if said else 1
        random = np.random.default_rng(given.seed)
        worst = 0
        for planted in random.integers(0, RATES[given.kind][0] // 10, given.starts):
            found = measured_delay(given.kind, folder, int(planted))
            error = found - true_delay(given.kind, int(planted))
            worst = max(worst, abs(error))
            print(f"planted {planted:5d}  found {found:5d}  error {error:+d}", flush=True)
        print(f"{given.starts} starts, largest error {worst} samples")
        return 0 if worst <= 1 else 1


if __name__ == "__main__":
    sys.exit(main())
