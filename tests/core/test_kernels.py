"""The cache of compiled functions is keyed by the formulas inside them, for whoever runs them."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest

from nmt_core.numerics.kernels import formulas_digest
from nmt_rig.model.element_kernels import _dispatch
from nmt_rig.model.local_elements import ELEMENTS

SOURCE = Path(__file__).resolve().parents[2] / "ros2_ws" / "src"
OWN = SOURCE / "nmt_core" / "nmt_core" / "numerics" / "kernels.py"
KERNEL = """\
import sys
from nmt_core.numerics.kernels import njit
from nmt_sample.middle import middle

@njit(cache=True)
def kernel(x):
    return middle(x) + 1.0

if __name__ == "__main__":
    from nmt_sample import kernel as own
    print(own.kernel(2.0), sum(own.kernel.stats.cache_hits.values()), own.kernel._cache.lock)
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
        """Python reads byte code where the source has the same size and second: each version is to have its size."""
        path = self.folder / "nmt_sample" / f"{module}.py"
        assert not path.exists() or path.read_text() == text or path.stat().st_size != len(text.encode())
        path.write_text(text)

    def run(self, new_environment: bool = False) -> tuple[float, int, Path]:
        """Value of the kernel at 2, how often it came from the cache, and the lock of its file there."""
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
            value, hits, lock = text.split()
        except ValueError:
            pytest.fail(text)
        return float(value), int(hits), Path(lock)


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
    value, hits, lock = sample.run()
    assert (value, hits) == (21.0, 1)
    assert lock.parent == sample.folder / "nmt_sample" / "__pycache__" / "kernels"
    sample.write("formulas", "def spring(x):\n    return x**3\n")
    assert sample.run()[:2] == (81.0, 0)
    sample.write("constants", "FACTOR = 1.0\n")
    assert sample.run()[:2] == (9.0, 0)
    sample.write("formulas", "def spring(x):\n    return x\n")
    sample.write("constants", "FACTOR = 10.0\n")
    assert sample.run() == (21.0, 1, lock)


def test_nothing_else_in_the_files_counts(sample: Sample) -> None:
    """A comment, a docstring, another function, another class; nor that the files are newer, as in a new checkout."""
    assert sample.run()[:2] == (21.0, 0)
    sample.write("kernel", "# of the sample\n" + KERNEL.replace("def kernel(x):", "def kernel(x):  # compiled"))
    sample.write("formulas", 'class Other:\n    pass\n\n\ndef spring(x):\n    """Force."""\n    return x\n')
    sample.write("constants", "FACTOR = 10.0\nOTHER = 3.0\n")
    for path in sample.folder.glob("nmt_sample/*.py"):
        os.utime(path, (1e9, 1e9))
    assert sample.run()[:2] == (21.0, 1)


def test_the_order_of_the_fields_that_are_handed_over_counts(sample: Sample) -> None:
    """To the compiler the class is its name and the types of its fields."""
    call = "own.kernel(pair.Pair(a=2.0, b=3.0))"
    text = KERNEL.replace("own.kernel(2.0)", call).replace("middle(x) + 1.0", "x.a - x.b")
    sample.write("kernel", text.replace("import sys\n", "import sys\nfrom nmt_sample import pair\n"))
    for order, end in (("ab", ""), ("ba", "\n")):
        fields = "".join(f"    {name}: float\n" for name in order)
        sample.write("pair", f"from typing import NamedTuple\n\nclass Pair(NamedTuple):\n{fields}{end}")
        assert sample.run()[:2] == (-1.0, 0)


def test_a_named_tuple_may_get_another_name(sample: Sample) -> None:
    """The index of the cache holds the classes that were handed over: one that is gone must not stop the program."""
    text = KERNEL.replace("import sys\n", "import sys\nfrom nmt_sample import pair\n")
    for name, hits in (("Pair", 0), ("Couple", 0), ("Couple", 1)):
        call = f"own.kernel(pair.{name}(a=2.0, b=3.0))"
        sample.write("kernel", text.replace("own.kernel(2.0)", call).replace("middle(x) + 1.0", "x.a - x.b"))
        sample.write(
            "pair", f"from typing import NamedTuple\n\nclass {name}(NamedTuple):\n    a: float\n    b: float\n"
        )
        assert sample.run()[:2] == (-1.0, hits)


def test_of_many_versions_the_last_are_kept(sample: Sample) -> None:
    for factor in range(6):
        sample.write("constants", f"FACTOR = {factor}.0{'0' * factor}\n")
        lock = sample.run()[2]
    assert len([*lock.parent.glob("*.nbi")]) == len([*lock.parent.glob("*.nbc")]) == 4
    assert sample.run()[:2] == (11.0, 1)


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


@pytest.mark.campaign
def test_the_folder_of_the_environment_is_taken(sample: Sample, tmp_path: Path) -> None:
    sample.environment["NUMBA_CACHE_DIR"] = str(tmp_path / "kept")
    assert sample.run(new_environment=True)[2].parent == tmp_path / "kept" / "kernels"
    assert sample.run(new_environment=True)[1] == 1
    sample.write("formulas", "def spring(x):\n    return -x\n")
    assert sample.run(new_environment=True)[:2] == (-19.0, 0)


@pytest.mark.parametrize("element", ELEMENTS, ids=lambda element: element.__name__)
def test_the_formulas_of_every_local_element_count(element: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    for formula, arguments in (("response", "w, v"), ("margin", "branch, w, slider")):
        if not hasattr(element, formula):
            continue
        before = formulas_digest(_dispatch(formula, arguments))
        assert formulas_digest(_dispatch(formula, arguments)) == before
        code = getattr(element, formula).__code__
        other = FunctionType(code.replace(co_consts=(*code.co_consts, 0.123)), getattr(element, formula).__globals__)
        monkeypatch.setattr(element, formula, staticmethod(other))
        assert formulas_digest(_dispatch(formula, arguments)) != before


def test_a_value_that_no_digest_can_be_made_of_is_named() -> None:
    things = {"__name__": "nmt_odd", "odd": type("Odd", (), {"__module__": "nmt_odd"})()}
    function = FunctionType(compile("def f():\n    return odd", "f", "exec").co_consts[0], things)
    with pytest.raises(TypeError, match=r"f: odd: no digest can be made of .*Odd"):
        formulas_digest(function)


def test_every_kernel_of_the_bench_is_cached_so() -> None:
    """Only one module asks numba itself; laboratories share no code with the bench."""
    compiled = 0
    for path in sorted([*SOURCE.glob("*/nmt*/**/*.py"), *SOURCE.parents[1].glob("campaigns/*/nmt*/**/*.py")]):
        text = path.read_text(encoding="utf-8")
        if path == OWN or "nmt_laboratories" in path.parts or "njit" not in text:
            continue
        compiled += 1
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom):
                assert node.module != "numba" or all(name.name != "njit" for name in node.names), path
    assert compiled > 20
