"""Cantilevers with soft clamps: their modes against closed forms, and what a diagnosis of them names."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_laboratories.laboratory_two import bending_roots
from nmt_laboratories.soft_clamps import make_case, modes_of


def test_modes_of_a_rigid_clamp_are_those_of_a_cantilever() -> None:
    omega, _ = modes_of(2.0, 3.0, 0.5, 1e5 * 3.0 / 2.0)
    exact = np.array([(root / 2.0) ** 2 * math.sqrt(3.0 / 0.5) for root in bending_roots(False, 4)])
    np.testing.assert_allclose(omega[:4], exact, rtol=1e-4)


@pytest.mark.parametrize("clamp", [0.3, 3.0, 30.0])
def test_modes_of_a_soft_clamp_solve_their_equation(clamp: float) -> None:
    """cos λ cosh λ + 1 = (sin λ cosh λ − cos λ sinh λ) λ EI/(k L) with EI = L = m = 1 (Gorman 1975)."""
    omega, _ = modes_of(1.0, 1.0, 1.0, clamp)
    for root in np.sqrt(omega[:3]):
        c, s, ch, sh = math.cos(root), math.sin(root), math.cosh(root), math.sinh(root)
        assert c * ch + 1.0 == pytest.approx(root / clamp * (s * ch - c * sh), rel=1e-6, abs=1e-6 * ch)


@pytest.mark.campaign
@pytest.mark.court(said="effect")
def test_a_clamp_that_lowers_the_first_mode_by_a_seventh_is_named_with_its_stiffness(tmp_path: Path) -> None:
    """The owner's damping by the stiffness is ten times that of the second and third mode."""
    folder = tmp_path / make_case(tmp_path, 9604)
    import_data(folder / "sidecar.yaml", tmp_path / "bag")
    settings = DiagnosisSettings(jobs=1, look_ahead=False)
    found = diagnose_bags(folder / "model.yaml", [tmp_path / "bag"], settings=settings).diagnosis
    head, truth = found.ranking[0], yaml.safe_load((folder / "truth.yaml").read_text())["parameters"]["k"]
    assert (found.verdict, head.effect, head.detail) == (Verdict.EFFECT, "clamp_compliance", "rotation")
    k = head.parameters["k"]
    assert k.value == pytest.approx(truth, abs=3.0 * k.std)
    assert k.std < 0.03 * truth
