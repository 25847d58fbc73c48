"""The how-to of laser and current: its files find the stiffness within two standard deviations."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from diagnose.test_how_to_pages import written
from scipy.signal import butter, sosfilt
from tiers import with_quick

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Verdict

PAGE = "laser-and-current.md"
RATE, OVER, SECONDS, FACTOR, MASS, RATIO, CUBIC = 2000, 2, 8, 16.0, 0.9, 0.004, 4e8
OMEGA = 2.0 * math.pi * 58.0


@cache
def scan() -> str:
    """Laser in mm/s and current in A of a mode with a cubic spring, by Runge and Kutta."""
    rng = np.random.default_rng(0)
    count, step = RATE * SECONDS, 1.0 / (RATE * OVER)
    band = butter(4, [30.0 / (0.5 * RATE * OVER), 100.0 / (0.5 * RATE * OVER)], "band", output="sos")
    current = sosfilt(band, rng.normal(size=count * OVER))
    current *= 0.5 / current.std()
    force = (FACTOR / MASS * np.append(current, 0.0)).tolist()
    x = v = 0.0
    velocity = []
    for k in range(count * OVER):
        if k % OVER == 0:
            velocity.append(v)
        middle = 0.5 * (force[k] + force[k + 1])
        slopes = []
        for share, load in ((0.0, force[k]), (0.5, middle), (0.5, middle), (1.0, force[k + 1])):
            dx, dv = slopes[-1] if slopes else (0.0, 0.0)
            at, speed = x + share * step * dx, v + share * step * dv
            slopes.append((speed, load - OMEGA**2 * at - 2.0 * RATIO * OMEGA * speed - CUBIC / MASS * at**3))
        x += step / 6.0 * sum(w * s[0] for w, s in zip((1, 2, 2, 1), slopes, strict=True))
        v += step / 6.0 * sum(w * s[1] for w, s in zip((1, 2, 2, 1), slopes, strict=True))
    measured = 1e3 * (np.array(velocity) + rng.normal(0.0, 2e-5, count))
    rows = zip(np.arange(count) / RATE, measured, current[::OVER], strict=True)
    lines = "".join(f"{t:.6f};{a:.5f};{i:.6f}\n" for t, a, i in rows)
    return "Time [s];Laser velocity [mm/s];Shaker current [A]\n" + lines


@pytest.mark.parametrize("factor", with_quick([16.0, 16.4], 16.4))
def test_the_page_finds_the_stiffness(factor: float, tmp_path: Path) -> None:
    (tmp_path / "scan.csv").write_text(scan())
    (tmp_path / "plate.yaml").write_text(written("plate.yaml", PAGE))
    sidecar = yaml.safe_load(written("scan.yaml", PAGE))
    sidecar["channels"][1]["force_factor"] = factor  # one and a quarter of its standard deviation off
    sidecar["segments"][0]["stop"] = SECONDS
    (tmp_path / "scan.yaml").write_text(yaml.safe_dump(sidecar))
    import_data(tmp_path / "scan.yaml", tmp_path / "scan")
    settings = DiagnosisSettings(look_ahead=False)
    found = diagnose_bags(tmp_path / "plate.yaml", [tmp_path / "scan"], settings=settings).diagnosis
    assert (found.verdict, found.ranking[0].effect) == (Verdict.EFFECT, "cubic_stiffness")
    stiffness = found.ranking[0].parameters["k"]
    assert abs(stiffness.value - CUBIC) < 2.0 * stiffness.std
    assert 0.01 < stiffness.std / CUBIC < 0.06
