"""Planted faults that './nmt check' has to name: each alone, in random pairs, and none on healthy benches.

./nmt shell <<< "python tests/node/check_trials.py single"
./nmt shell <<< "python tests/node/check_trials.py pairs --count 40 --seed 1"
./nmt shell <<< "python tests/node/check_trials.py healthy --count 50"
./nmt shell <<< "python tests/node/check_trials.py single --kind portaudio"    # over JACK, in real time

Without --kind the specimen is asked block by block, as fast as the computer goes.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from node.converter_bench import KINDS, converter_bench

from nmt_plant.check.hardware_check import check
from nmt_plant.devices.hardware_rig import HardwareRig, device_of
from nmt_plant.specimen import Specimen
from nmt_plant.specimen_faults import FAULTS, Fault
from nmt_rig.rig import load_rig

Named = set[tuple[str, tuple[str, ...]]]

CHANNELS = ("f2", "x2", "x4", "x5", "x6", "a2")
RESPONSES = ("x4", "x5")
"""Those whose cable is exchanged with that of x6 by the fault permuted."""
OF_THE_BENCH = ("force_response", "no_drive", "rate", "delay", "resonance")
DEAD = ("overload", "open", "short", "icp")
"""After which a port shows nothing of its sensor."""
NEEDS_RESPONSE = ("open", "sign", "force_response", "permuted", "sensitivity", "delay", "resonance")
"""Not to be seen where nothing moves."""
LEVELS = (0.05, 1.5)


def draw(random: np.random.Generator) -> tuple[Fault, Fault]:
    """Two faults of different kinds."""
    names = random.choice(list(FAULTS), 2, replace=False)
    first, second = (_place(str(name), random) for name in names)
    return first, second


def _place(name: str, random: np.random.Generator) -> Fault:
    if name in OF_THE_BENCH:
        return Fault(name)
    return Fault(name, str(random.choice(RESPONSES if name == "permuted" else CHANNELS)))


def named(fault: Fault) -> tuple[str, tuple[str, ...]]:
    """What the check has to say of a fault alone."""
    if fault.name == "force_response":
        return fault.name, ("f2", "x2")
    if fault.name == "permuted":
        return fault.name, (fault.channel, "x6")
    return fault.name, (fault.channel,) if fault.channel else ()


def is_hidden(fault: Fault, other: Fault) -> bool:
    """Whether no measurement could show a fault beside another."""
    if other.name == "no_drive" and fault.name in NEEDS_RESPONSE:
        return True
    if other.name not in DEAD:
        return False
    if fault.name in ("sign", "sensitivity", *DEAD) and fault.channel == other.channel:
        return DEAD.index(other.name) < DEAD.index(fault.name) if fault.name in DEAD else True
    # A port that shows nothing of its sensor shows no noise or offset of it either.
    return fault.channel == other.channel and fault.name in ("noise", "mains", "offset") and other.name != "open"


def expected(faults: Sequence[Fault]) -> Named:
    """What the check has to say of faults together."""
    return {
        named(fault) for fault in faults if not any(is_hidden(fault, other) for other in faults if other is not fault)
    }


def outcome(faults: Iterable[Fault], seed: int) -> tuple[Named, float]:
    """What the check says, and its largest drive over what is allowed."""
    rig = load_rig("beam")
    section = device_of(rig, "portaudio")
    specimen = Specimen(rig, section, faults=list(faults), seed=seed)
    device = HardwareRig(rig.model_copy(update={"seed": seed}), section, specimen=specimen)
    device.configure()
    device.start()
    try:
        result = check(device, LEVELS)
    finally:
        device.close()
    return {(each.name, each.channels) for each in result.findings}, result.drive_peak_v / result.drive_limit_v


def outcome_on(kind: str, faults: Iterable[Fault]) -> tuple[Named, float]:
    """The same by the command, in real time."""
    words = [word for fault in faults for word in ("--fault", ":".join(part for part in fault if part))]
    with tempfile.TemporaryDirectory() as temporary, converter_bench(kind, Path(temporary), *words) as bench:
        document: dict[str, Any] = bench.check(codes=(0, 1))
    found = {(each["name"], tuple(each["channels"])) for each in document["findings"]}
    return found, document["drive_peak_v"] / document["drive_limit_v"]


SINGLE = tuple(
    Fault(name, {"force_response": "", "permuted": "x4"}.get(name, "" if name in OF_THE_BENCH else channel))
    for name, channel in zip(FAULTS, itertools.cycle(CHANNELS), strict=False)
)


def main() -> int:
    """Print a line for every bench; 0 where all was named and nothing else."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("single", "pairs", "healthy"))
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=KINDS)
    given = parser.parse_args()
    random = np.random.default_rng(given.seed)
    benches: list[tuple[Fault, ...]] = {
        "single": [(fault,) for fault in SINGLE],
        "pairs": [draw(random) for _ in range(given.count)],
        "healthy": [()] * given.count,
    }[given.what]
    right = hidden = 0
    worst = 0.0
    for number, faults in enumerate(benches):
        found, drive = outcome(faults, given.seed + number) if given.kind is None else outcome_on(given.kind, faults)
        wanted = expected(faults)
        hidden += len(faults) - len(wanted)
        good = found == wanted
        right += good
        worst = max(worst, drive)
        words = " + ".join(":".join(part for part in fault if part) for fault in faults) or "healthy"
        if not good or given.what == "single":
            missing, more = wanted - found, found - wanted
            print(
                f"{'right' if good else 'WRONG':6s} {words:32s}"
                + (f" missing {sorted(missing)}" if missing else "")
                + (f" too much {sorted(more)}" if more else ""),
                flush=True,
            )
    print(
        f"{right} of {len(benches)} right; {hidden} faults that another hides were not asked for; largest drive "
        f"{100 * worst:.0f} % of the hundredth that is allowed"
    )
    return 0 if right == len(benches) and worst <= 1.0 else 1


if __name__ == "__main__":
    sys.exit(main())
