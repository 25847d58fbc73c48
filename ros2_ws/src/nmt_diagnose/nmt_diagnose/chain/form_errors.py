"""Errors of the model's form, which act on all tests alike, records among them."""

from __future__ import annotations

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.chain.chain_tests import ChainTests
from nmt_diagnose.chain.coupled_modes import CoupledModes
from nmt_diagnose.chain.modes_left_out import ModesLeftOut
from nmt_diagnose.chain.shape_errors import ShapeErrors
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward, Prediction
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import BeamSection


def form_errors(tests: ChainTests, prediction: Prediction) -> dict[str, FloatArray]:
    """What a standard deviation of each adds to the rows of all tests, (m,) each, by name.

    Args:
        tests: those that have measuring chains.
        prediction: of all observations.
    """
    # Differences are taken from a solution of the same accuracy.
    base = tests.forward.predict(tests.rig, tests.start(prediction))
    found = mesh(tests, base)
    for module in (ModesLeftOut(tests), ShapeErrors(tests), CoupledModes(tests)):
        name = type(module).__name__
        found |= {f"{name} {k}": column for k, column in enumerate(module.columns(base))}
    return {name: tests.full(column) for name, column in found.items()}


def mesh(tests: ChainTests, base: Prediction) -> dict[str, FloatArray]:
    """What a beam's mesh of half the element length changes: so much its own may be off by."""
    structure = tests.rig.structure
    if not isinstance(structure, BeamSection):
        return {}
    finer = PredictionSettings(mesh_refinement=2 * structure.mesh_refinement)
    try:
        moved = Forward(tests.tests, tests.rows, finer).predict(tests.rig).values
    except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError):
        return {}
    change = np.nan_to_num(tests.forward.difference(moved, base.values))
    # Near a sharp resonance or zero the change of a logarithm is not proportional to the error.
    most = np.where(tests.rows.part == Part.SAMPLE, np.inf, THRESHOLDS.misfit.largest_mesh_change)
    return {"mesh": np.clip(change, -most, most)}
