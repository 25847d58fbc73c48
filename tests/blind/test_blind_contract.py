"""The contracts that keep truth and diagnosis apart hold, and would be noticed if they did not."""

from __future__ import annotations

import shutil
import subprocess
import sys
from configparser import ConfigParser
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = {
    path.name: path / path.name
    for path in (*(ROOT / "ros2_ws" / "src").glob("nmt*"), *(ROOT / "campaigns").glob("nmt*"))
    if (path / path.name / "__init__.py").is_file()
}
PACKAGES = tuple(sorted(FOLDERS))

pytest.importorskip("importlinter", reason="import-linter is not installed")


LEAKS = (
    ("truth", "nmt_blind/cases", "from nmt_diagnose.prediction import forward"),
    ("truth", "nmt_blind/cases", "from nmt_diagnose.effects.library import library"),
    ("truth", "nmt_blind/cases", "from nmt_rig.reference import single_point_reference"),
    ("layers", "nmt_diagnose/fit", "from nmt_blind.cases.draw import draw_cases"),
    ("blind", "nmt_diagnose/observations", "from nmt_plant.devices.simulated_rig import SimulatedRig"),
    ("unmodelled", "nmt_extract", "from nmt_rig.rig import load_rig"),
)
"""Contract, folder of a module and what it must not import."""


def check(folder: Path) -> subprocess.CompletedProcess[str]:
    """What the contracts of the leaks say of the packages in a folder."""
    program = "import sys; from importlinter.cli import lint_imports_command as run; run(sys.argv[1:])"
    chosen = [word for contract in dict.fromkeys(name for name, _, _ in LEAKS) for word in ("--contract", contract)]
    return subprocess.run(
        [sys.executable, "-c", program, "--config", str(ROOT / ".importlinter"), *chosen, "--no-cache"],
        cwd=folder,
        env={"PYTHONPATH": ":".join(str(folder / name) for name in PACKAGES), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_forbidden_imports_are_caught(tmp_path: Path) -> None:
    changed = {module.split("/")[0] for _, module, _ in LEAKS}
    for name in PACKAGES:
        package = tmp_path / name / name
        package.parent.mkdir()
        if name in changed:
            shutil.copytree(FOLDERS[name], package)
        else:
            package.symlink_to(FOLDERS[name])
    kept = check(tmp_path)
    assert kept.returncode == 0, kept.stdout + kept.stderr
    for number, (_, folder, line) in enumerate(LEAKS):
        (tmp_path / folder.split("/")[0] / folder / f"leak_{number}.py").write_text(f"{line}\n")
    broken = check(tmp_path)
    assert broken.returncode == 1
    titles = ConfigParser()
    titles.read(ROOT / ".importlinter")
    text = " ".join(broken.stdout.split())  # lines are wrapped
    for number, (contract, folder, _) in enumerate(LEAKS):
        assert f"{titles[f'importlinter:contract:{contract}']['name']} BROKEN" in text, broken.stdout
        assert f"{folder.replace('/', '.')}.leak_{number} -> " in text, broken.stdout
