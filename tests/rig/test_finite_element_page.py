"""The model of *Use a finite-element model* is built by its page and is the strip that beam theory knows."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from nmt_rig.linear_description import linear_description
from nmt_rig.model_figures import model_figures
from nmt_rig.rig import load_rig

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "finite-element-model.md"


def block(language: str) -> str:
    """The first block of a language on the page."""
    found = re.search(rf"^```{language}\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.S | re.M)
    assert found is not None
    return found[1]


def test_the_page_makes_a_rig_of_a_strip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """ω = 1.8751² √(EI/ρA)/L², free from the clamp's Poisson effect within one percent; the mass is ρ V."""
    pytest.importorskip("skfem", reason="scikit-fem, which builds the model of the page, is not installed")
    monkeypatch.chdir(tmp_path)
    exec(compile(block("python"), PAGE.name, "exec"), {"__name__": "page"})
    (tmp_path / "strip.yaml").write_text(block("yaml"))
    figures = model_figures({"file": tmp_path / "strip.npz"}, "mm-t-N")
    first = 1.87510406871196**2 * np.sqrt(70e9 * 0.006**2 / 12.0 / 2700.0) / 0.3**2 / (2.0 * np.pi)
    np.testing.assert_allclose(figures.frequencies_hz[0], first, rtol=0.015)
    # Of the rows at the clamp a part of the first element's mass is missing.
    np.testing.assert_allclose(figures.mass_kg["z"], 2700.0 * 0.3 * 0.04 * 0.006, rtol=0.03)
    rig = load_rig(tmp_path / "strip.yaml")
    hertz = np.asarray(linear_description(rig).frequencies_rad_s) / (2.0 * np.pi)
    np.testing.assert_allclose(hertz[0], figures.frequencies_hz[0], rtol=1e-3)
    assert "0 from its place" in rig.structure.source
    assert "move frequencies by less than 0.1%" in rig.structure.source
