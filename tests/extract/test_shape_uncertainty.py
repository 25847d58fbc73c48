"""Uncertainty of mass-normalised shapes against drawn eigenvalues and residues that are wrong together."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tiers import with_quick

from nmt_core.messages.blocks import Quantity
from nmt_extract.linear.identification import scaled_mode
from nmt_signals.rational_fit import StructureMode

SHAPE = np.array([1.3, -0.7, 0.4])  # 1/√kg, the first is the drive point
KINDS = {Quantity.DISPLACEMENT: 0, Quantity.VELOCITY: 1, Quantity.ACCELERATION: 2}


def shape_of(record, mode):
    return scaled_mode(record, mode, None, (1.0, 1.0), None)


@pytest.mark.parametrize("drive", with_quick(KINDS, Quantity.VELOCITY))
@pytest.mark.parametrize("response", KINDS)
@pytest.mark.parametrize("sign", with_quick([1.0, -1.0], -1.0))
def test_the_stated_scatter_is_that_of_draws(drive: Quantity, response: Quantity, sign: float) -> None:
    """Whether a wrong eigenvalue adds to or takes from a wrong residue depends on the powers of both quantities."""
    draw, names = np.random.default_rng(5), ["d", "a", "b"]
    quantities = dict(zip(names, (drive, response, response), strict=True))
    record = SimpleNamespace(
        quantities=quantities, channels=SimpleNamespace(outputs=names, drives=("d",), responses=names)
    )
    omega, ratio = 2.0 * np.pi * 40.0, 0.004
    eigenvalue = omega * complex(-ratio, np.sqrt(1.0 - ratio**2))
    powers = np.array([KINDS[quantities[name]] for name in names])
    residues = SHAPE * SHAPE[0] * eigenvalue**powers / (2j * eigenvalue.imag)
    # Relative errors: one of the eigenvalue, half of which each residue has too, with one sign or the other.
    size = 1e-3
    common = size * np.array([1.0, *(0.5 * sign * np.array([1.0, -1.0, 1.0]))])
    factor = (
        np.column_stack([common, np.diag([0.0, *(0.1 * size * np.ones(3))])])
        * np.array([eigenvalue, *residues])[:, None]
    )
    mode = StructureMode(eigenvalue, residues[:, None], factor @ factor.conj().T)
    stated = shape_of(record, mode)
    assert stated.shape == pytest.approx(SHAPE, rel=1e-6)
    count = 1500
    normal = (draw.standard_normal((count, 5)) + 1j * draw.standard_normal((count, 5))) / np.sqrt(2.0)
    shapes = [
        shape_of(
            record, replace(mode, eigenvalue=eigenvalue + error[0], residues=(residues + error[1:])[:, None])
        ).shape
        for error in normal @ factor.T
    ]
    assert np.std(shapes, axis=0) == pytest.approx(stated.shape_std, rel=0.08)
