"""Fixtures: the paper's specimen."""

from __future__ import annotations

import pytest

from nmt_rig.model.assembly import ElectromechanicalSystem, assemble
from nmt_rig.model.beam import euler_bernoulli_beam
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.shaker import ElectrodynamicShaker
from nmt_rig.model.structure import Structure
from nmt_rig.rig import Rig, load_rig

SHAKER = ElectrodynamicShaker(0.024, 20707.0, 28.33, 0.019, 8.42e7, 57.17, 15.48, 140e-6, 3.0)


@pytest.fixture
def beam() -> Structure:
    return euler_bernoulli_beam(0.7, 0.00527668, 0.01156978, 185e9, 7830.0, 7, 1e-4)


@pytest.fixture
def joint(beam: Structure) -> Jenkins:
    return Jenkins(beam.selector(3), 8000.0, 1.0)


@pytest.fixture
def beam_system(beam: Structure, joint: Jenkins) -> ElectromechanicalSystem:
    return assemble(beam, [joint], 2, SHAKER)


@pytest.fixture
def linear_system(beam: Structure) -> ElectromechanicalSystem:
    return assemble(beam, [], 2, SHAKER)


@pytest.fixture(scope="session")
def rig() -> Rig:
    return load_rig("beam")
