"""Structures from matrices of a user's own script go through every command: run, linear, diagnose, investigate."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from matrix.element_structures import FIRST_HZ, STRUCTURES, ElementStructure
from tiers import with_quick

from nmt_bench.cli import main
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig

pytest.importorskip("rclpy")

QUICK = next(each for each in STRUCTURES if each.name == "chain_30_lumped")
QUIET = ["--one-process", "--quiet"]


def names(structure: ElementStructure) -> str:
    return structure.name


def run(file: Path, out: Path) -> list[dict[str, float]]:
    words = ["run", str(file), "--levels", "0.5,1", "--periods", "20", "--no-report", "--reference", "none"]
    assert main([*words, *QUIET, "--out", str(out)]) == 0
    points: list[dict[str, float]] = json.loads((out / "modal.json").read_text(encoding="utf-8"))["points"]
    return points


@pytest.mark.parametrize("structure", with_quick(STRUCTURES, QUICK), ids=names)
def test_nodes_run_a_structure_from_matrices(structure: ElementStructure, tmp_path: Path) -> None:
    points = run(structure.write(tmp_path), tmp_path / "run")
    assert [point["frequency_hz"] for point in points] == pytest.approx([FIRST_HZ] * 2, rel=2e-3)
    assert [point["damping_ratio"] for point in points] == pytest.approx([0.01] * 2, rel=2e-2)


def linear_is_exact(file: Path, out: Path) -> None:
    assert main(["linear", str(file), "--duration", "20", *QUIET, "--out", str(out)]) == 0
    found = json.loads((out / "linear.json").read_text(encoding="utf-8"))
    exact = linear_description(load_rig(file))
    assert found["frequencies_rad_s"] == pytest.approx(list(exact.frequencies_rad_s), rel=1e-4)


@pytest.mark.campaign
@pytest.mark.parametrize("structure", STRUCTURES, ids=names)
def test_a_structure_from_matrices_has_no_gap_to_itself(structure: ElementStructure, tmp_path: Path) -> None:
    file = structure.write(tmp_path)
    run(file, tmp_path / "run")
    linear = tmp_path / "linear"
    linear_is_exact(file, linear)
    exact = linear_description(load_rig(file))
    words = ["--real", str(tmp_path / "run"), "--real", str(linear), "--allow-own-model"]
    assert main(["diagnose", "--model", str(file), *words, "--out", str(tmp_path / "d")]) == 0
    assert json.loads((tmp_path / "d" / "diagnosis.json").read_text(encoding="utf-8"))["verdict"] in (
        "none", "calibration"
    )  # fmt: skip
    again = linear_description(load_rig(tmp_path / "d" / "model.yaml"))
    assert list(again.frequencies_rad_s) == pytest.approx(list(exact.frequencies_rad_s), rel=1e-4)
    words = ["--rig", str(file), "--allow-own-model", "--random", "8", "--periods", "20"]
    assert main(["investigate", str(file), *words, "--out", str(tmp_path / "i")]) == 0
    assert json.loads((tmp_path / "i" / "investigate.json").read_text(encoding="utf-8"))["ended"] == "no_gap"
