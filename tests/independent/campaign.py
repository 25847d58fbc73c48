"""Diagnoses of what the second laboratory records: healthy measuring chains, and five effects that it really has.

Run from the root of the repository, in an environment with the bench::

    PYTHONPATH=tests:$PYTHONPATH python -m independent.campaign --healthy 30 --effects

A healthy recording that is given any other verdict than ``none`` or ``calibration`` is an alarm.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from independent.laboratory import Chain, MeasuringChain, record

from nmt_bench.data_import import import_data
from nmt_diagnose.inference.diagnose import diagnose_bags
from nmt_diagnose.inference.diagnosis import Diagnosis
from nmt_diagnose.inference.diagnosis_settings import DiagnosisSettings

START_HZ = 96.9676
SEED = 101


@dataclass(frozen=True)
class InjectedEffect:
    """An effect that the laboratory has and its model has not.

    Attributes:
        chain: the rig as it is.
        change: of the measuring chain.
        effect: its name.
        parameters: true values, as the diagnosis reports them.
    """

    chain: Chain
    effect: str
    parameters: dict[str, float]
    change: Callable[[MeasuringChain], MeasuringChain] = lambda measuring: measuring


def _weak(measuring: MeasuringChain) -> MeasuringChain:
    gains = list(measuring.gains)
    gains[3] *= 0.95
    return replace(measuring, gains=tuple(gains))


INJECTED_EFFECTS = {
    "gain": InjectedEffect(Chain(), "response_gain", {"g": -0.05}, _weak),
    "cubic": InjectedEffect(Chain(cubic=2e11), "cubic_stiffness", {"k": 2e11}),
    "stop": InjectedEffect(Chain(stop=1e4, stop_gap=4e-5), "one_sided_stop", {"k": 1e4, "gap": 4e-5}),
    "gap": InjectedEffect(Chain(gap_stiffness=1e4, gap=4e-5), "two_sided_gap", {"k": 1e4, "gap": 4e-5}),
    "source": InjectedEffect(Chain(source_resistance=1.5), "source_impedance", {"R": 1.5}),
}


def diagnosed(folder: Path, chain: Chain, measuring: MeasuringChain, levels: Sequence[float]) -> Diagnosis:
    """Record, import and diagnose.

    Args:
        folder: an existing, empty folder.
        chain: the rig as it is; its model is without nonlinear forces and source resistance.
        measuring: the measuring chain.
        levels: drive amplitudes, V.
    """
    recorded = record(folder, chain, measuring, tuple(levels), start_hz=START_HZ, random_seconds=12.0)
    bag = folder / "imported"
    import_data(recorded.sidecar, bag)
    return diagnose_bags(recorded.model, [bag], settings=DiagnosisSettings(look_ahead=False)).diagnosis


def main() -> None:
    """Print a line for each recording, and how many alarms there were."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--healthy", type=int, default=30, metavar="N", help="healthy recordings (default 30)")
    parser.add_argument("--effects", action="store_true", help="the five effects, too")
    given = parser.parse_args()
    alarms = 0
    for seed in range(1, given.healthy + 1):
        with tempfile.TemporaryDirectory() as folder:
            found = diagnosed(Path(folder), Chain(), MeasuringChain.drawn(seed), (0.2, 0.5, 1.0))
        alarms += found.verdict.value not in ("none", "calibration")
        print(f"healthy {seed}: {found.verdict.value}", flush=True)
    print(f"{alarms} alarms in {given.healthy} healthy recordings")
    for name, truth in INJECTED_EFFECTS.items() if given.effects else ():
        measuring = truth.change(MeasuringChain.drawn(SEED))
        with tempfile.TemporaryDirectory() as folder:
            found = diagnosed(Path(folder), truth.chain, measuring, (0.2, 0.4, 0.6, 0.8, 1.0))
        head = found.ranking[0] if found.ranking else None
        values = {} if head is None else head.parameters
        off = {key: (values[key].value - v) / values[key].std for key, v in truth.parameters.items() if key in values}
        deviations = ", ".join(f"{key} {value:+.1f} σ" for key, value in off.items())
        print(f"{name}: {found.verdict.value}, {head.effect if head else 'nothing'} first; {deviations}", flush=True)


if __name__ == "__main__":
    main()
