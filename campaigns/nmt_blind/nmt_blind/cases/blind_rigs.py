"""The rigs that blind cases are drawn from, and how they are tested."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nmt_blind.cases.laboratory import BenchSettings
from nmt_core.errors import BenchError
from nmt_rig.rig import Rig, load_rig


@dataclass(frozen=True)
class BlindRig:
    """A rig of the blind check.

    Attributes:
        name: name of the rig.
        bench: its tests.
        tests: of every case, see `nmt_blind.cases.make.RECORDERS`.
    """

    name: str
    bench: BenchSettings
    tests: tuple[str, ...] = ("backbone", "random")

    @property
    def file(self) -> Path:
        """The rig file: the model of every case."""
        return Path(__file__).parent / "rigs" / f"{self.name}.yaml"

    def model(self) -> Rig:
        """The rig as it is believed to be."""
        return load_rig(self.file)


def _geometric(first: float, last: float, count: int) -> tuple[float, ...]:
    return tuple(float(f"{value:.4g}") for value in np.geomspace(first, last, count))


BLIND_RIGS: dict[str, BlindRig] = {
    "beam": BlindRig(
        "beam",
        BenchSettings(
            levels=_geometric(0.08, 1.5, 12),
            window_periods=48,
            ramp=0.25,
            random_level=0.15,
            band_hz=(5.0, 500.0),
            duration=24.0,
            settling_time=1.5,
        ),
    ),
    "joint_resonator": BlindRig(
        "joint_resonator",
        BenchSettings(
            levels=_geometric(0.25, 18.0, 12),
            window_periods=80,
            ramp=0.2,
            random_level=0.3,
            band_hz=(20.0, 1500.0),
            duration=16.0,
            settling_time=1.5,
            substeps=2,
        ),
    ),
    "modal_beam": BlindRig(
        "modal_beam",
        BenchSettings(
            levels=_geometric(0.01, 0.2, 10),
            window_periods=80,
            ramp=0.2,
            random_level=0.05,
            band_hz=(20.0, 1200.0),
            duration=16.0,
            settling_time=1.5,
        ),
        tests=("backbone", "random", "tables", "ring_down"),
    ),
}


def blind_rig(name: str) -> BlindRig:
    """Rig of the blind check by name.

    Raises:
        BenchError: there is none.
    """
    if name not in BLIND_RIGS:
        raise BenchError(f"There is no blind rig '{name}'; choose one of {', '.join(BLIND_RIGS)}.")
    return BLIND_RIGS[name]
