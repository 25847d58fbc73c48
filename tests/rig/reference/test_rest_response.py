"""Responses at rest by ports against the solution of the whole system at each frequency."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nmt_rig.model.assembly import assemble
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.harmonic_balance import ModalImpedance
from nmt_rig.model.rest_response import RestResponse
from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_system


@pytest.mark.parametrize(
    ("rig", "changes"),
    [
        ("beam", []),
        ("beam", ["structure.elements=28"]),
        ("beam", ["structure.elements=100", "structure.mesh_refinement=1"]),
        ("beam", ["exciter.point=2"]),
        ("clamped_beam", []),
        ("joint_resonator", []),
    ],
)
def test_ports_give_what_the_whole_system_gives(rig: str, changes: list[str]) -> None:
    system = build_system(load_rig(rig, changes))
    rng = np.random.default_rng(3)
    frequencies = np.sort(10.0 ** rng.uniform(1.0, 4.5, 40))
    response = RestResponse.of(system, ModalImpedance.with_every_port(system))
    assert response is not None
    found = response(frequencies)
    for k, omega in enumerate(frequencies):
        unknowns, force = system.response(float(omega))
        assert found[0][k] == pytest.approx(system.motion(system.drive_point, unknowns), rel=1e-7)
        assert abs(found[1][k] - force) <= 1e-6 * abs(force) + 1e-9


@pytest.mark.parametrize("count", [2, 150])
def test_a_free_chain_at_rest_is_singular_however_long(count: int) -> None:
    system = assemble(lumped_chain([1.0] * count, [1.0] * (count - 1)), [], 1)
    with pytest.raises(np.linalg.LinAlgError):
        system.response(0.0)


@pytest.mark.parametrize("elements", [7, 150])
def test_a_fine_beam_is_solved_as_a_coarse_one(elements: int) -> None:
    system = build_system(load_rig("beam", [f"structure.elements={elements}", "structure.mesh_refinement=1"]))
    for omega in (100.0, 2e3, 3e4):
        unknowns, _ = system.response(omega)
        impedance = system.impedance(omega)
        assert unknowns == pytest.approx(np.linalg.solve(impedance, system.input_vector), rel=1e-9)


def test_damping_of_another_form_is_refused() -> None:
    system = build_system(load_rig("beam"))
    rng = np.random.default_rng(5)
    extra = np.zeros_like(system.damping)
    root = rng.normal(size=(system.structure_size, system.structure_size))
    extra[: system.structure_size, : system.structure_size] = root @ root.T
    other = replace(system, damping=system.damping + extra)
    assert RestResponse.of(other, ModalImpedance.with_every_port(other)) is None
