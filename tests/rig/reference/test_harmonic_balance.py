"""Transfer matrices by the ports of an impedance against those by its whole matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.harmonic_balance import ModalImpedance, OutputTables, Ports, harmonic_responses, transfer_matrices
from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_system

ORDERS = np.array([0, 1, 2, 3, 7])


def without_ports(size: int) -> Ports:
    return Ports(np.zeros(size), np.zeros(size), np.zeros((size, 0)), np.zeros((0, 0)), np.zeros((0, 0)))


@pytest.mark.parametrize(
    ("rig", "changes"),
    [
        ("beam", []),
        ("beam", ["structure.elements=28"]),
        ("beam", ["exciter.point=2", "structure.elements=28"]),
        ("beam", ["structure.elements=28", "local_elements=[{kind: linear_damper, point: 9, damping_ns_m: 0.3}]"]),
    ],
)
@pytest.mark.parametrize(("excitation", "shift", "mode"), [(0.0, 0j, -1), (2.5, 3e4 + 2e3j, 2)])
def test_ports_give_what_the_whole_matrices_give(
    rig: str, changes: list[str], excitation: float, shift: complex, mode: int
) -> None:
    system = build_system(load_rig(rig, changes))
    impedance = ModalImpedance.of(system)
    size = impedance.mass.shape[0]
    assert not impedance.diagonal
    assert 0 < 4 * impedance.ports.directions.shape[1] <= size
    rng = np.random.default_rng(7)
    inputs = np.ascontiguousarray(impedance.shapes.T @ rng.normal(size=(size, 3)))
    rows = [np.ascontiguousarray(rng.normal(size=(4, size)) @ impedance.shapes) for _ in range(3)]
    for omega in 10.0 ** rng.uniform(1.0, 4.0, 6):
        both = [
            transfer_matrices(
                float(omega), excitation, ORDERS, own.tables, inputs, OutputTables(*rows, np.ones((4, 3))), shift, mode
            )
            for own in (impedance, replace(impedance, ports=without_ports(size)))
        ]
        for ours, whole in zip(*both, strict=True):
            for position in range(ORDERS.size):
                assert np.abs(ours[position] - whole[position]).max() <= 1e-8 * np.abs(whole[position]).max() + 1e-300


def test_responses_by_ports() -> None:
    system = build_system(load_rig("beam", ["structure.elements=28"]))
    impedance = ModalImpedance.of(system)
    size = impedance.mass.shape[0]
    basis = FourierBasis.up_to(3)
    rng = np.random.default_rng(8)
    amplitudes = rng.normal(size=(basis.orders.size, 2)) + 1j * rng.normal(size=(basis.orders.size, 2))
    inputs = rng.normal(size=(size, 2))
    ours, whole = (
        harmonic_responses(one, basis, 137.0, 0.4, inputs, amplitudes)
        for one in (impedance, replace(impedance, ports=without_ports(size)))
    )
    assert ours == pytest.approx(whole, rel=1e-7, abs=1e-9 * np.abs(whole).max())


def test_small_and_other_systems_keep_their_matrices() -> None:
    assert ModalImpedance.of(build_system(load_rig("joint_resonator"))).ports.directions.shape[1] == 0
    system = build_system(load_rig("beam", ["structure.elements=28"]))
    rng = np.random.default_rng(5)
    extra = np.zeros_like(system.damping)
    root = rng.normal(size=(system.structure_size, system.structure_size))
    extra[: system.structure_size, : system.structure_size] = root @ root.T
    assert ModalImpedance.of(replace(system, damping=system.damping + extra)).ports.directions.shape[1] == 0
