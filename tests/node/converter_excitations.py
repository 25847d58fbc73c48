"""Linear test, sweep and ring-down on a converter with the specimen behind its ports, compared with simulated ones.

./nmt shell <<< "python tests/node/converter_excitations.py portaudio"
./nmt shell <<< "python tests/node/converter_excitations.py nidaqmx --of sweep,ring_down"
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from node.converter_bench import KINDS, RATES, ConverterBench, converter_bench, environment, simulated

from nmt_bench.harness import Bench
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import ResultCode
from nmt_extract.decays.structure_decay import structure_decay
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import read_signals, segments
from nmt_rig.linear_description import linear_description

Values = dict[str, float]
SWEEP = ("--control", "voltage", "--force", "0.05", "--from", "21.5", "--to", "25.5", "--rate", "0.2")
LINEAR = ("--no-half-level",)
DECAY_LEVEL = 0.5


def of_linear(folder: Path) -> Values:
    """Frequency and damping of the target, from a results folder."""
    found = json.loads((folder / "linear.json").read_text())
    mode = found["target_mode"]
    return {
        "linear frequency, Hz": found["frequencies_rad_s"][mode] / (2.0 * np.pi),
        "linear damping, %": 100.0 * found["damping_ratios"][mode],
    }


def of_sweep(folder: Path) -> Values:
    """Largest displacement of the drive point and where it lies."""
    table: Any = np.genfromtxt(folder / "frf.csv", delimiter=",", names=True, comments="#")
    moved = np.hypot(table["x2_real"], table["x2_imag"])
    peak = int(np.nanargmax(moved))
    return {"sweep peak, Hz": float(table["frequency_hz"][peak]), "sweep peak, m": float(moved[peak])}


def of_ring_down(bag: Bag, rig: Any) -> Values:
    """Frequency and damping at the middle amplitude of the decay, of structure and exciter."""
    (segment,) = segments(bag)
    signals = read_signals(bag, segment.first_sample, segment.samples)
    decay = structure_decay(signals, linear_description(rig), Quantity.DISPLACEMENT)
    amplitude = 5e-5
    order = np.argsort(decay.modal_amplitude)
    at = [
        np.interp(amplitude, decay.modal_amplitude[order], values[order])
        for values in (decay.apparent_omega_rad_s, decay.apparent_damping_ratio)
    ]
    return {"decay frequency, Hz": float(at[0]) / (2.0 * np.pi), "decay damping, %": 100.0 * float(at[1])}


def decay_run(kind: str, folder: Path, bench: ConverterBench | None, lead: int = 0) -> Values:
    """A ring-down on the converter, or simulated where there is no bench."""
    rate, block = RATES[kind]
    where: dict[str, Any] = {}
    if bench is not None:
        where = {
            "device": kind,
            "device_address": bench.device.partition("@")[2],
            "pacing": "realtime",
            "latency_blocks": lead,
            "processes": True,
        }
    changes = [f"sample_rate_hz={rate}", f"block_samples={block}"]
    with Bench("beam", [DECAY_LEVEL], test="ring_down", duration=2.0, overrides=changes, out=folder, **where) as made:
        result = made.run()
        if result.code != ResultCode.SUCCEEDED:
            raise RuntimeError(result.message)
        return of_ring_down(Bag.open(folder / "bag"), made.rig)


def compare(kind: str, folder: Path, what: str) -> list[tuple[str, float, float]]:
    """Name, value on the converter, value simulated."""
    commands: dict[str, tuple[tuple[str, ...], Callable[[Path], Values]]] = {
        "linear": (("linear", *LINEAR), of_linear),
        "sweep": (("sweep", *SWEEP), of_sweep),
    }
    with converter_bench(kind, folder) as bench:
        lead = bench.pass_check()
        if what == "ring_down":
            found = decay_run(kind, folder / "decay", bench, lead)
        else:
            words, read = commands[what]
            bench.command(*words, "--quiet", "--out", str(folder / what))
            found = read(folder / what)
    if what == "ring_down":
        wanted = decay_run(kind, folder / "simulated-decay", None)
    else:
        simulated(kind, folder, *words, "--out", str(folder / f"simulated-{what}"))
        wanted = read(folder / f"simulated-{what}")
    return [(name, value, wanted[name]) for name, value in found.items()]


def main() -> int:
    """Print both values of everything; 0 where they agree within a hundredth."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--of", default="linear,sweep,ring_down")
    given = parser.parse_args()
    worst = 0.0
    for what in given.of.split(","):
        with tempfile.TemporaryDirectory() as temporary:
            os.environ.update(environment(Path(temporary)))
            for name, value, wanted in compare(given.kind, Path(temporary), what):
                difference = value / wanted - 1.0
                worst = max(worst, abs(difference))
                print(f"{name:24s} {value:12.6g} {wanted:12.6g}  {100 * difference:+.4f} %", flush=True)
    return 0 if worst <= 0.01 else 1


if __name__ == "__main__":
    sys.exit(main())
