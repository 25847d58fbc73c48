"""A blind check small enough for tests: two levels, short windows, round motions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from nmt_blind.cases.blind_rigs import BLIND_RIGS, BlindRig
from nmt_blind.cases.laboratory import BenchSettings
from nmt_blind.cases.make import CampaignPlan, Made, make_campaign
from nmt_blind.cases.operating import Operating

SHORT = BenchSettings(
    levels=(0.5, 1.0), window_periods=10, ramp=0.1, random_level=0.15, band_hz=(5.0, 500.0), duration=1.0,
    settling_time=0.2, mesh_refinement=1, substeps=1,
)  # fmt: skip


def short_rig() -> BlindRig:
    return replace(BLIND_RIGS["beam"], bench=SHORT)


def operating() -> Operating:
    """Round numbers of the beam's size."""
    points = range(1, 8)
    return Operating(
        omega=139.0,
        displacement={p: 4e-5 * p**2 for p in points},
        relative={p: 4e-5 * (2 * p + 1) for p in points if p < 7},
        rotation={p: 5e-4 * p for p in points},
        stiffness={p: 1e5 / p**2 for p in points},
        relative_stiffness={p: 1e5 for p in points if p < 7},
        channels={"f2": 1.5, "x2": 2e-4, "x4": 7e-4, "x5": 1e-3, "x6": 1.4e-3, "a2": 3.0},
        peaks={"f2": 1.6, "x2": 2.1e-4, "x4": 7.2e-4, "x5": 1.1e-3, "x6": 1.5e-3, "a2": 5.0},
        noise={"f2": 0.014, "x2": 7e-6, "x4": 7e-6, "x5": 7e-6, "x6": 7e-6, "a2": 0.02, "u": 0.0},
        voltage=1.0,
        duration=4.0,
        cycles=80.0,
    )


def make(folder: Path, seed: int = 2, count: int = 2, **more: Any) -> Made:
    rig = short_rig()
    of_plan = {name: more.pop(name) for name in ("kinds", "sealed", "tolerances") if name in more}
    plan = CampaignPlan(rig_name=rig.name, count=count, seed=seed, rig=rig, operating=operating(), **of_plan)
    return make_campaign(folder, plan, **more)
