from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nmt_rig.model.beam import euler_bernoulli_beam
from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.shaker import ElectrodynamicShaker
from nmt_rig.model.structure import Structure


@pytest.fixture(scope="session")
def beam() -> Structure:
    return euler_bernoulli_beam(0.7, 0.00527668, 0.01156978, 185e9, 7830.0, 7, 1e-4)


@pytest.fixture(scope="session")
def joint(beam: Structure) -> tuple[LocalElement, ...]:
    return (Jenkins(beam.direction(3), 8000.0, 1.0),)


@pytest.fixture(scope="session")
def shaker() -> ElectrodynamicShaker:
    return ElectrodynamicShaker(0.024, 20707.0, 28.33, 0.019, 8.42e7, 57.17, 15.48, 140e-6, 3.0)


@pytest.fixture(scope="session")
def published_backbone() -> np.ndarray:
    path = Path(__file__).resolve().parents[4] / "shared" / "data" / "epmc_beam_kt8000.csv"
    if not path.is_file():
        pytest.skip("the given EPMC table (shared/data/epmc_beam_kt8000.csv) is not on this machine")
    return np.loadtxt(path, delimiter=",", comments="#")


@pytest.fixture(scope="session")
def finite_differences():
    def check(system, z: np.ndarray, step: float = 1e-6) -> float:
        """Largest difference of the Jacobian to central differences, relative to its largest entry."""
        _, jacobian = system(z)
        numeric = np.empty_like(jacobian)
        for k in range(z.size):
            ahead, behind = z.copy(), z.copy()
            ahead[k] += step
            behind[k] -= step
            numeric[:, k] = (system(ahead)[0] - system(behind)[0]) / (2.0 * step)
        return float(np.abs(jacobian - numeric).max() / np.abs(jacobian).max())

    return check
