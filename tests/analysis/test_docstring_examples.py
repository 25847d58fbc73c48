"""Examples in docstrings run as they stand, in a folder with small results of each command in ``out``.

``nmt``, ``np`` and ``dataclasses`` are imported; ``OTHERS`` are all effects but two. A part of a result that an example
leaves out is ``...``. Where more than one function of a module has examples, they share nothing.
"""

from __future__ import annotations

import dataclasses
import doctest
import importlib
import inspect
import sys
import tarfile
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from analysis.results_folders import KINDS

import nmt
import nmt_diagnose
import nmt_extract
import nmt_rig
from nmt_bench.cli import main
from nmt_diagnose.effects.library import library
from nmt_session import Session, plan_test

RECORDING = Path(__file__).resolve().parents[1] / "bench" / "recordings" / "0.2.0.tar.xz"
ROOMS = (nmt, nmt_extract, nmt_rig, nmt_diagnose)
FUNCTIONS = {
    getattr(room, name): f"{room.__name__}.{name}"
    for room in reversed(ROOMS)
    for name in room.__all__
    if inspect.isfunction(getattr(room, name))
}
"""Every public function once, by the name that stands first in ``ROOMS``."""
METHODS = [
    *("nmt.Results.to_dataframe", "nmt.Results.export"),
    *("nmt.RunResults.values", "nmt.RunResults.to_xarray", "nmt.RunResults.plot"),
]
ELSEWHERE = {"nmt.diagnose": nmt}
"""Functions whose examples stand in the docstring of a package."""

FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``out/demo`` (with report), ``out/exported``, ``out/random``, and a small folder of each other kind."""
    root = tmp_path_factory.mktemp("examples")
    out = root / "out"
    with tarfile.open(RECORDING) as archive:
        archive.extractall(out / "demo", filter="data")
    assert main(["extract", str(out / "demo"), "--out", str(out / "again")]) == 0
    (out / "again" / "report.html").rename(out / "demo" / "report.html")
    assert main(["export", str(out / "demo"), "--format", "csv", "--out", str(out / "exported")]) == 0
    noise = plan_test("joint_resonator", [0.5], test="random", band_hz=(100.0, 1500.0), duration=8.0)
    with Session(noise, out / "random") as session:
        session.run()
    for name in ("linear", "sweep", "reference", "diagnosis"):
        (out / name).mkdir()
        KINDS[name](out / name)
    for name in ("empty", "figures", "table", "backbone"):
        (out / name).mkdir()
    return root


def examples_of(thing: Any, name: str, module: Any) -> doctest.DocTest:
    context = {**vars(module), "nmt": nmt, "np": np, "dataclasses": dataclasses}
    context["OTHERS"] = tuple(e.name for e in library() if e.name not in ("response_gain", "phase_offset"))
    found = doctest.DocTestParser().get_doctest(inspect.getdoc(thing) or "", context, name, module.__file__, 0)
    return found


@pytest.mark.parametrize("module", ["nmt_diagnose", "nmt_session.session", "nmt_bench.harness"])
def test_examples_of_a_module(module: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if module == "nmt_bench.harness":
        pytest.importorskip("rclpy", reason="the harness starts nodes, which need ROS 2")
    monkeypatch.chdir(folder)
    thing = importlib.import_module(module)
    run(examples_of(thing, module, thing))


def test_no_example_of_the_sources_is_skipped() -> None:
    root = Path(__file__).resolve().parents[2]
    paths = [path for source in ("ros2_ws/src", "campaigns") for path in (root / source).glob("*/nmt*/**/*.py")]
    skipped = [path.name for path in paths if "doctest: +SKIP" in path.read_text("utf-8")]
    assert not skipped


@pytest.mark.parametrize("name", [*FUNCTIONS.values(), *METHODS])
def test_examples(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "agg")
    matplotlib.use("agg")
    room, *parts = name.split(".")
    thing: Any = sys.modules[room]
    for part in parts:
        thing = getattr(thing, part)
    thing = ELSEWHERE.get(name, thing)
    module = thing if inspect.ismodule(thing) else importlib.import_module(thing.__module__)
    examples = examples_of(thing, name, module)
    calls = [example for example in examples.examples if name.rsplit(".", 1)[-1] in example.source]
    assert calls, f"no example calls {name}"
    run(examples)


def run(examples: doctest.DocTest) -> None:
    """Run the examples; none may be skipped, and at least two must be there."""
    assert len(examples.examples) >= 2, f"{examples.name} has {len(examples.examples)} examples"
    assert not any(example.options.get(doctest.SKIP) for example in examples.examples)
    said: list[str] = []
    failed, tried = doctest.DocTestRunner(optionflags=FLAGS).run(examples, out=said.append)
    assert not failed, "".join(said)
    assert tried == len(examples.examples)
