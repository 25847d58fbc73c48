"""The notebooks of examples/ run from top to bottom, with smaller parameters, and give what they promise."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

import nmt
from nmt_rig.reference import single_point_reference

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))

SMALLER = {
    "virtual_experiment": ['LEVELS = "0.1:0.5:2"', "PERIODS = 20", "POINTS = 20"],
    "joint_resonator": ['LEVELS = "0.5:12:3"', "FORCES = [5.0]"],
    "diagnosis": [
        'LEVELS = "0.1:1.0:3"',
        "PERIODS = 20",
        "from nmt_diagnose.effects.library import library",
        'KEPT = {"cubic_stiffness", "quadratic_stiffness"}',
        "SETTINGS = DiagnosisSettings(",
        "    withheld=tuple(sorted({effect.name for effect in library()} - KEPT)), look_ahead=False",
        ")",
    ],
    "own_data": ["SECONDS = 2.0"],
}
"""What follows the parameters of each notebook in the tests."""


def executed(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The notebook after a run in ``folder``, in a kernel of its own."""
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(folder / "runtime"))
    monkeypatch.setenv("JUPYTER_PLATFORM_DIRS", "1")
    monkeypatch.setenv("IPYTHONDIR", str(folder / "ipython"))
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    notebook = nbformat.read(ROOT / "examples" / f"{name}.ipynb", as_version=4)
    (cell,) = [cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", ())]
    cell.source = "\n".join([cell.source, *SMALLER[name]])
    NotebookClient(
        notebook, timeout=280, kernel_name="python3", resources={"metadata": {"path": str(folder)}}, allow_errors=False
    ).execute()
    return notebook


def pictures(notebook: Any) -> int:
    return sum("image/png" in output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", ()))


def test_every_notebook_is_run() -> None:
    assert [path.stem for path in NOTEBOOKS] == sorted(SMALLER)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_valid_and_hold_the_outputs_of_one_run(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert notebook.cells[0].cell_type == "markdown"
    assert notebook.cells[0].source.startswith("# ")
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == [*range(1, len(code) + 1)]
    assert pictures(notebook) >= 1
    assert "/tmp/" not in path.read_text("utf-8")
    assert not any(output.output_type == "error" for cell in code for output in cell.outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_smaller_parameters_name_what_the_notebook_has(path: Path) -> None:
    cells = [cell for cell in json.loads(path.read_text("utf-8"))["cells"] if cell["metadata"].get("tags")]
    (cell,) = cells
    given = set(re.findall(r"^([A-Z]+) = ", "".join(cell["source"]), re.M))
    changed = {word for line in SMALLER[path.stem] for word in re.findall(r"^([A-Z]+) = ", line)}
    assert changed - {"KEPT"} <= given - {"OUT"}


def test_a_notebook_runs_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for path in NOTEBOOKS:
        cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
        beginning = "\n".join(cell.source for cell in cells[:2])
        old = tmp_path / "out" / path.stem / "bag"
        old.mkdir(parents=True)
        exec(compile(beginning, path.name, "exec"), {})
        assert not old.exists()


@pytest.mark.campaign
def test_virtual_experiment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notebook = executed("virtual_experiment", tmp_path, monkeypatch)
    assert pictures(notebook) == 1
    run = nmt.open(tmp_path / "out" / "virtual_experiment")
    assert isinstance(run, nmt.RunResults)
    rig = nmt.load_rig("beam")
    ideal = single_point_reference(rig, exciter_point=rig.exciter.point, levels=[p.level for p in run.good_points])
    np.testing.assert_allclose(run.values("omega_rad_s"), ideal.mode.omega_rad_s, rtol=1e-4)
    np.testing.assert_allclose(run.values("damping_ratio"), ideal.mode.damping_ratio, rtol=1e-2)
    assert (run.folder / "everything.nc").exists()


@pytest.mark.campaign
def test_joint_resonator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notebook = executed("joint_resonator", tmp_path, monkeypatch)
    assert pictures(notebook) == 3
    run = nmt.open(tmp_path / "out" / "joint_resonator")
    assert isinstance(run, nmt.RunResults)
    frequency, damping = run.values("frequency_hz"), run.values("damping_ratio")
    assert frequency[0] == pytest.approx(370.0, rel=2e-3)
    assert frequency[-1] < frequency[0]
    assert damping[-1] > 2 * damping[0]


@pytest.mark.campaign
def test_own_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notebook = executed("own_data", tmp_path, monkeypatch)
    assert pictures(notebook) == 1
    run = nmt.open(tmp_path / "out" / "own_data")
    assert isinstance(run, nmt.RunResults)
    np.testing.assert_allclose(run.values("damping_ratio"), [0.01, 0.02], rtol=1e-3)
    np.testing.assert_allclose(run.values("frequency_hz"), 21.7, rtol=1e-6)


@pytest.mark.campaign
def test_diagnosis(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notebook = executed("diagnosis", tmp_path, monkeypatch)
    assert pictures(notebook) == 1
    found = nmt.open(tmp_path / "out" / "diagnosis")
    assert isinstance(found, nmt.DiagnosisResult)
    assert found.rows()[0]["effect"] == "cubic_stiffness"
