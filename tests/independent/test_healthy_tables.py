"""Healthy tables: what they state over what they scatter, and what they hold."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.optimize import brentq

from nmt_laboratories import laboratory_three as three
from nmt_laboratories.healthy_tables import STRUCTURES, make_case
from nmt_laboratories.laboratory_two import bending_roots, bending_shape
from nmt_record.exchange.imports.imported_run import read_import
from nmt_rig.rig import load_rig


def columns(path: Path) -> dict[str, np.ndarray]:
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def stated_over_scatter(folder: Path) -> float:
    """By tables of one point at several levels, between which a linear structure changes nothing."""
    segments = yaml.safe_load((folder / "sidecar.yaml").read_text())["segments"]
    points = {segment["point"]: [] for segment in segments}
    for segment in segments:
        table = columns(folder / segment["file"])
        order = np.argsort(table["frequency_hz"])
        points[segment["point"]].append({name: values[order] for name, values in table.items()})
    found = []
    for tables in points.values():
        for part in ("real", "imag"):
            values, stated = (np.array([table[f"{part}{end}"] for table in tables]) for end in ("", "_std"))
            found.append((values - values.mean(axis=0)) / stated * np.sqrt(len(tables) / (len(tables) - 1.0)))
    return float(1.0 / np.sqrt(np.mean(np.square(found))))


def first_frequency(model: dict[str, Any], joint: bool) -> float:
    """Of a cantilever with the joint's spring, Hz: 1/k + Σ φ²/(ω_r² − ω²) = 0 with modes in closed form."""
    beam, spring = model["structure"], model["local_elements"][0]
    area = beam["width_m"] * beam["height_m"]
    wave = math.sqrt(beam["youngs_modulus_pa"] / beam["density_kg_m3"] * beam["height_m"] ** 2 / 12.0)
    roots = bending_roots(False, 8)
    squares = np.array([((root / beam["length_m"]) ** 2 * wave) ** 2 for root in roots])
    at = spring["point"] / beam["elements"]
    shapes = np.array([float(bending_shape(root, False, at)) for root in roots])
    flexible = shapes**2 / (beam["density_kg_m3"] * area * beam["length_m"])
    if not joint:
        return math.sqrt(squares[0]) / (2.0 * math.pi)
    stiffness = spring["tangential_stiffness_n_m"]
    square = brentq(lambda x: 1.0 / stiffness + np.sum(flexible / (squares - x)), 1.0001 * squares[0], 0.9 * squares[1])
    return math.sqrt(square) / (2.0 * math.pi)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_table_states_what_its_truth_says(seed: int, tmp_path: Path) -> None:
    folder = tmp_path / make_case(tmp_path, seed)
    remark = yaml.safe_load((folder / "truth.yaml").read_text())["remark"]
    factor = float(remark.split(" of the scatter")[0].rsplit(" ", 1)[1])
    assert 0.3 <= factor <= 3.0
    assert stated_over_scatter(folder) == pytest.approx(factor, rel=0.05)


def test_seeds_cover_all_structures_and_factors_on_both_sides(tmp_path: Path) -> None:
    names = [make_case(tmp_path, seed) for seed in range(len(STRUCTURES))]
    assert {name.rsplit("_", 1)[0] for name in names} == set(STRUCTURES)
    truths = [yaml.safe_load((tmp_path / name / "truth.yaml").read_text()) for name in names]
    assert all(truth["kind"] == "healthy" for truth in truths)
    factors = [float(truth["remark"].split()[3]) for truth in truths]
    assert min(factors) < 1.0 < max(factors)
    for name in names:
        load_rig(tmp_path / name / "model.yaml")
        assert read_import(tmp_path / name / "sidecar.yaml").tables


def test_the_same_seed_gives_the_same_tables(tmp_path: Path) -> None:
    first, second = (tmp_path / name / make_case(tmp_path / name, 4) for name in ("a", "b"))
    for path in first.iterdir():
        assert path.read_bytes() == (second / path.name).read_bytes()


def test_the_joint_sticks_at_the_lowest_amplitude_and_slides_at_the_highest(tmp_path: Path) -> None:
    folder = tmp_path / make_case(tmp_path, 0)
    model, table = yaml.safe_load((folder / "model.yaml").read_text()), columns(folder / "backbone.csv")
    sticking, free = (first_frequency(model, joint) for joint in (True, False))
    assert table["frequency_hz"][0] == pytest.approx(sticking, abs=5.0 * table["frequency_hz_std"][0])
    assert free < table["frequency_hz"][-1] < 0.99 * sticking
    assert table["damping_ratio"][-1] > 2.0 * table["damping_ratio"][0]


def test_the_free_beam_of_closed_form_resonates_at_its_mode() -> None:
    beam = three.free_beam(1.0, 0.008, 5e-5, 0.0, 500.0)
    omega, zeta = float(np.sqrt(beam.omega2[2])), beam.ratio(2)
    phi, at = beam.shapes[:, 2], np.array(three.SENSORS) - 1
    peak = three.accelerance(beam, omega)
    assert peak.imag == pytest.approx(phi[at] * phi[three.DRIVEN - 1] / (2.0 * zeta), rel=1e-3)
