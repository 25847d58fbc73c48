"""The contracts that keep truth and diagnosis apart hold, and would be noticed if they did not."""

from __future__ import annotations

import shutil
import subprocess
import sys
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


def check(folder: Path, contract: str) -> subprocess.CompletedProcess[str]:
    program = "import sys; from importlinter.cli import lint_imports_command as run; run(sys.argv[1:])"
    return subprocess.run(
        [sys.executable, "-c", program, "--config", str(ROOT / ".importlinter"), "--contract", contract, "--no-cache"],
        cwd=folder,
        env={"PYTHONPATH": ":".join(str(folder / name) for name in PACKAGES), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize(
    ("contract", "module", "line"),
    [
        ("truth", "nmt_blind/cases/leak.py", "from nmt_diagnose.prediction import forward"),
        ("truth", "nmt_blind/cases/leak.py", "from nmt_diagnose.effects.library import library"),
        ("truth", "nmt_blind/cases/leak.py", "from nmt_rig.reference import single_point_reference"),
        ("layers", "nmt_diagnose/fit/leak.py", "from nmt_blind.cases.draw import draw_cases"),
        ("blind", "nmt_diagnose/observations/leak.py", "from nmt_plant.devices.simulated_rig import SimulatedRig"),
        ("unmodelled", "nmt_extract/leak.py", "from nmt_rig.rig import load_rig"),
    ],
)
def test_a_forbidden_import_is_caught(tmp_path: Path, contract: str, module: str, line: str) -> None:
    changed = module.split("/")[0]
    for name in PACKAGES:
        package = tmp_path / name / name
        package.parent.mkdir()
        if name == changed:
            shutil.copytree(FOLDERS[name], package)
        else:
            package.symlink_to(FOLDERS[name])
    kept = check(tmp_path, contract)
    assert kept.returncode == 0, kept.stdout + kept.stderr
    (tmp_path / changed / module).write_text(f"{line}\n")
    broken = check(tmp_path, contract)
    assert broken.returncode == 1
    assert "BROKEN" in broken.stdout
    assert "leak" in broken.stdout
