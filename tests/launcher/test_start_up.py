"""What the ends that only print load: the launcher answers --version and --help itself, from the standard library."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from report.synthetic_run import synthetic_run

from nmt_bench import cli
from nmt_core import bench_version
from nmt_extract.modal.table import write_results
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test

ROOT = Path(__file__).resolve().parents[2]
OWN = {"__main__", "launcher", "nmt_bench", "nmt_core"}
SLOW = {"dataclasses", "difflib", "importlib.metadata", "inspect", "json", "subprocess", "tempfile", "traceback"}
"""Modules of the standard library that take longer than all else that help needs."""


def started(*words: str) -> tuple[str, set[str]]:
    """What the launcher prints, and the modules that it loads; without site-packages, so without any library."""
    answer = subprocess.run(
        [sys.executable, "-I", "-S", "-X", "importtime", str(ROOT / "nmt"), *words], capture_output=True, text=True
    )
    assert answer.returncode == 0, answer.stderr
    return answer.stdout, set(re.findall(r"^import time: .*\| +([\w.]+)$", answer.stderr, re.M))


@pytest.mark.parametrize("words", [("--version",), ("--help",), ("-h",), ()])
def test_version_and_help_load_little(words: tuple[str, ...]) -> None:
    _, modules = started(*words)
    assert "launcher.commands" in modules
    assert {name.partition(".")[0] for name in modules} <= OWN | set(sys.stdlib_module_names)
    assert not modules & SLOW
    assert not {name for name in modules if name.startswith("launcher.")} - {"launcher.commands", "launcher.places"}


def test_the_launcher_knows_the_version() -> None:
    printed, _ = started("--version")
    assert printed == f"nmt {bench_version.bench_version()}\n" == f"nmt {version('nmt_bench')}\n"


def test_version_without_the_sources(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(bench_version, "_PACKAGE_FILE", str(tmp_path / "package.xml"))
    assert bench_version.bench_version() == version("nmt_bench")


def test_help_lists_the_commands_of_the_bench(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "PROGRAM", "./nmt")
    printed, _ = started("--help")
    listed = re.findall(r"^    ([a-z]+)\b", printed, re.M)
    assert [name for name in listed if name in cli.all_commands()] == list(cli.all_commands())


@pytest.mark.parametrize("command", list(cli.all_commands()))
def test_help_of_every_command_needs_no_large_library(command: str) -> None:
    code = (
        "import sys; from nmt_bench import cli; cli.main([sys.argv[1], '--help']);"
        "large = {'h5py', 'jinja2', 'matplotlib', 'numba', 'numpy', 'pandas', 'pydantic', 'rclpy', 'rich', 'scipy'};"
        "sys.exit(', '.join(sorted(large & set(sys.modules))) or 0)"
    )
    answer = subprocess.run([sys.executable, "-c", code, command], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr


LARGE = "{'h5py', 'matplotlib', 'numba', 'pandas', 'pydantic', 'rclpy', 'scipy'}"


def loaded_large(code: str, *words: str) -> str:
    """Large libraries that a script loads, on its last line."""
    whole = f"import sys\n{code}\nprint(sorted({LARGE} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", whole, *words], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    return answer.stdout.splitlines()[-1]


def test_extract_refuses_before_it_loads_a_kernel(tmp_path: Path) -> None:
    code = "from nmt_bench import cli; assert cli.main(['extract', sys.argv[1], '--out', sys.argv[2]]) == 2"
    assert loaded_large(code, str(tmp_path / "nowhere"), str(tmp_path / "out")) == "[]"


def test_opening_results_loads_no_kernel(tmp_path: Path) -> None:
    write_results(synthetic_run().points, tmp_path, {"rig": "beam"})
    code = "import nmt; assert len(nmt.open(sys.argv[1]).rows()) > 3"
    assert loaded_large(code, str(tmp_path)) == "[]"


def test_a_list_of_rigs_loads_no_model() -> None:
    code = "from nmt_bench import cli; assert cli.main(['rigs']) == 0; assert 'numpy' not in sys.modules"
    assert loaded_large(code) == "[]"


def test_extraction_loads_no_schemas() -> None:
    code = (
        "import nmt_extract.modal.bag_budget, nmt_extract.offline, nmt_bench.commands.terminal; "
        "import nmt_record.bag.bag_reader"
    )
    assert loaded_large(code) == "[]"


def test_extraction_without_report_loads_nothing_large(tmp_path: Path) -> None:
    """Half of the computing time of a short extraction was the loading of numba, scipy and rosbags."""
    with Session(plan_test(load_rig("beam"), [0.2], window_periods=6)) as session:
        session.run()
        code = (
            "from nmt_bench import cli\n"
            "assert cli.main(['extract', sys.argv[1], '--no-report', '--out', sys.argv[2]]) == 0\n"
            "assert 'rosbags' not in sys.modules"
        )
        assert loaded_large(code, str(session.out / "bag"), str(tmp_path / "out")) == "[]"


def test_a_reference_and_a_plant_load_the_part_of_scipy_they_use() -> None:
    code = (
        "import sys, nmt_rig.reference, nmt_plant.devices.simulated_rig\n"
        "parts = {'scipy.io', 'scipy.optimize', 'scipy.signal', 'scipy.sparse'}\n"
        "sys.exit(', '.join(sorted(parts & set(sys.modules))) or 0)"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
