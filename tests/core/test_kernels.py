"""The cache of compiled functions is keyed by the formulas inside them, for whoever runs them."""

from __future__ import annotations

import ast
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from nmt_core.numerics.kernels import formula_modules

SOURCE = Path(__file__).resolve().parents[2] / "ros2_ws" / "src"
ELEMENTS = SOURCE / "nmt_rig" / "nmt_rig" / "model" / "local_elements"
OWN = SOURCE / "nmt_core" / "nmt_core" / "numerics" / "kernels.py"
KERNEL = """\
import sys
from nmt_core.numerics.kernels import cache_folder, njit
from nmt_sample.middle import middle

@njit(cache=True)
def kernel(x):
    return middle(x) + 1.0

if __name__ == "__main__":
    from nmt_sample import kernel as own
    print(own.kernel(2.0), sum(own.kernel.stats.cache_hits.values()), cache_folder(own.kernel.py_func))
"""
MIDDLE = """\
from nmt_core.numerics.kernels import njit
from nmt_sample.constants import (
    FACTOR,
)
from nmt_sample import formulas

formula = njit(formulas.spring)

@njit
def middle(x):
    return FACTOR * formula(x)
"""
PROCESSES = """\
import json, os, runpy, signal, sys, traceback
from nmt_core.numerics.kernels import njit
njit(lambda x: x + 1.0)(2.0)
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
for line in sys.stdin:
    if os.fork() == 0:
        answer, path, folder = json.loads(line)
        with open(answer, "w") as sys.stdout:
            try:
                os.chdir(folder)
                sys.path[:0] = path
                runpy.run_module("nmt_sample.kernel", run_name="__main__")
            except BaseException:
                traceback.print_exc(file=sys.stdout)
        os._exit(0)
"""
"""Makes a process for each line; what they all import, and the compiler itself, is in them already."""


class Sample:
    """A package with a kernel, whose formula and constant stand in other files, and what a new process makes of it."""

    def __init__(self, folder: Path, processes: subprocess.Popen[str]) -> None:
        self.folder = folder
        self.path = [str(folder)]
        self._processes = processes
        self._runs = 0
        self.environment = {**os.environ, "PYTHONPATH": f"{folder}:{SOURCE / 'nmt_core'}"}
        self.environment.pop("NUMBA_CACHE_DIR", None)
        (folder / "nmt_sample").mkdir()
        self.write("__init__", "")
        self.write("kernel", KERNEL)
        self.write("middle", MIDDLE)
        self.write("constants", "FACTOR = 10.0\n")
        self.write("formulas", "def spring(x):\n    return x\n")

    def write(self, module: str, text: str) -> None:
        (self.folder / "nmt_sample" / f"{module}.py").write_text(text)

    def run(self, new_environment: bool = False) -> tuple[float, int, Path]:
        """Value of the kernel at 2, how often it came from the cache, and where that is."""
        if new_environment:
            text = subprocess.run(
                [sys.executable, "-m", "nmt_sample.kernel"], env=self.environment, cwd=self.folder, check=True,
                capture_output=True, text=True,
            ).stdout  # fmt: skip
        else:
            self._runs += 1
            answer = self.folder / f"answer-{self._runs}"
            os.mkfifo(answer)
            assert self._processes.stdin is not None
            self._processes.stdin.write(json.dumps([str(answer), self.path, str(self.folder)]) + "\n")
            self._processes.stdin.flush()
            text = answer.read_text()
        try:
            value, hits, folder = text.split()
        except ValueError:
            pytest.fail(text)
        return float(value), int(hits), Path(folder)


@pytest.fixture(scope="module")
def processes() -> Iterator[subprocess.Popen[str]]:
    environment = {**os.environ, "PYTHONPATH": str(SOURCE / "nmt_core")}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-c", PROCESSES]
    with subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, text=True) as started:
        yield started


@pytest.fixture
def sample(tmp_path: Path, processes: subprocess.Popen[str]) -> Sample:
    return Sample(tmp_path, processes)


def test_a_formula_or_a_constant_in_another_file_counts(sample: Sample) -> None:
    assert sample.run()[:2] == (21.0, 0)
    value, hits, folder = sample.run()
    assert (value, hits) == (21.0, 1)
    assert folder.parent == sample.folder / "nmt_sample" / "__pycache__"
    sample.write("formulas", "def spring(x):\n    return x**3\n")
    assert sample.run()[:2] == (81.0, 0)
    sample.write("constants", "FACTOR = 1.0\n")
    assert sample.run()[:2] == (9.0, 0)
    sample.write("formulas", "def spring(x):\n    return x\n")
    sample.write("constants", "FACTOR = 10.0\n")
    assert sample.run() == (21.0, 1, folder)


def test_of_two_processes_one_compiles_and_the_other_waits(sample: Sample) -> None:
    with ThreadPoolExecutor(2) as pool:
        both = [future.result() for future in [pool.submit(sample.run) for _ in range(2)]]
    assert [value for value, _, _ in both] == [21.0, 21.0]
    assert sorted(hits for _, hits, _ in both) == [0, 1]


def test_a_function_that_calls_itself_is_compiled(sample: Sample) -> None:
    """With an argument of another type, while the first is being compiled."""
    recursive = "def middle(x):\n    return FACTOR * formula(x) if x > 1 else middle(x + 1.0)\n"
    text = MIDDLE.replace("@njit\ndef middle(x):\n    return FACTOR * formula(x)\n", f"@njit(cache=True)\n{recursive}")
    assert recursive in text
    sample.write("middle", text)
    assert sample.run()[0] == 21.0


def test_a_package_behind_a_link_shares_the_cache(sample: Sample, tmp_path: Path) -> None:
    """As the packages of a workspace that colcon built with links, and those of the sources."""
    assert sample.run()[:2] == (21.0, 0)
    (tmp_path / "built").mkdir()
    (tmp_path / "built" / "nmt_sample").symlink_to(sample.folder / "nmt_sample")
    sample.path = [str(tmp_path / "built")]
    sample.folder = tmp_path / "built"
    assert sample.run()[:2] == (21.0, 1)


def test_the_folder_of_the_environment_is_taken(sample: Sample, tmp_path: Path) -> None:
    sample.environment["NUMBA_CACHE_DIR"] = str(tmp_path / "kept")
    assert sample.run(new_environment=True)[2].parent == tmp_path / "kept"
    assert sample.run(new_environment=True)[1] == 1
    sample.write("formulas", "def spring(x):\n    return -x\n")
    assert sample.run(new_environment=True)[:2] == (-19.0, 0)


def test_the_time_integration_is_keyed_by_every_local_element() -> None:
    importlib.import_module("nmt_rig.model.integration_kernel")
    elements = {f"nmt_rig.model.local_elements.{path.stem}" for path in ELEMENTS.glob("[a-z]*.py")}
    assert len(elements) > 5
    assert elements <= set(formula_modules("nmt_rig.model.integration_kernel"))


def test_every_kernel_of_the_bench_is_cached_so() -> None:
    """Only one module asks numba itself; imports that the key would not follow do not stand beside kernels."""
    compiled = 0
    for path in sorted([*SOURCE.glob("*/nmt*/**/*.py"), *SOURCE.parents[1].glob("campaigns/*/nmt*/**/*.py")]):
        text = path.read_text(encoding="utf-8")
        if path == OWN or "njit" not in text:
            continue
        compiled += 1
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom):
                assert not node.level, f"{path}: a relative import"
                assert node.module != "numba" or all(name.name != "njit" for name in node.names), path
    assert compiled > 20
