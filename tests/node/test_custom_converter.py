"""The template of a laboratory's driver, from a folder outside the clone: a whole check and a whole test through it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from node.converter_bench import environment

from nmt_extract.modal.table import read_csv, read_json
from nmt_rig.rig import load_rig

TEMPLATE = Path(__file__).resolve().parents[2] / "examples" / "converter"


def command(folder: Path, *words: object, code: int = 0) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "nmt_bench", *map(str, words)],
        cwd=folder, env=environment(folder), capture_output=True, text=True, timeout=400, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture
def laboratory(tmp_path: Path) -> Path:
    """A folder with the template and nothing of nmt."""
    for name in ("laboratory.yaml", "laboratory_driver.py"):
        (tmp_path / name).write_text((TEMPLATE / name).read_text())
    return tmp_path


@pytest.mark.campaign
def test_a_driver_that_breaks_the_contract_is_not_driven(laboratory: Path) -> None:
    driver = laboratory / "laboratory_driver.py"
    driver.write_text(driver.read_text().replace("volts.shape[1] / self._rate", "volts.shape[1] / 4000.0"))
    said = command(laboratory, "check", "laboratory.yaml", "--out", "check", code=1)
    assert "samples a second, the rig has 5000" in said
    document = json.loads((laboratory / "check" / "check.json").read_text())
    assert [each["name"] for each in document["findings"]] == ["rate"]
    assert "found rate; fix it and type: ./nmt check" in command(laboratory, "run", "laboratory.yaml", code=2)


@pytest.mark.campaign
def test_a_converter_that_cannot_follow_the_model_is_checked_by_the_contract(laboratory: Path) -> None:
    words = ("laboratory.yaml", "--set", "device.check=converter")
    assert "type: ./nmt check" in command(laboratory, "run", *words, "--out", "before", code=2)
    assert "The converter keeps the contract" in command(laboratory, "check", *words, "--out", "check")
    assert not (laboratory / "before").exists()


@pytest.mark.campaign
def test_a_whole_test_through_the_template(laboratory: Path) -> None:
    """Against the rig's model, which knows nothing of the driver: the nonlinear mode by harmonic balance."""
    command(laboratory, "check", "laboratory.yaml", "--quiet", "--out", "check")
    command(laboratory, "run", "laboratory.yaml", "--quiet", "--out", "test")
    points, _ = read_json(laboratory / "test" / "modal.json")
    assert [point.level for point in points] == [0.5, 1.5]
    assert json.loads((laboratory / "test" / "run.json").read_text())["device"] == "custom"
    assert load_rig(laboratory / "test" / "rig.yaml").device == load_rig(laboratory / "laboratory.yaml").device
    columns = read_csv(laboratory / "test" / "modal.csv")
    command(laboratory, "reference", "laboratory.yaml", "--out", "reference")
    reference = np.genfromtxt(laboratory / "reference" / "reference.csv", delimiter=",", names=True)
    for quantity, tolerance in (("omega_rad_s", 3e-4), ("damping_ratio", 3e-3)):
        expected = np.interp(columns["modal_amplitude"], reference["modal_amplitude"], reference[quantity])
        assert columns[quantity] == pytest.approx(expected, rel=tolerance), quantity
