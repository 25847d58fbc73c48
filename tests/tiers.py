"""The two tiers of the suite, and what of a whole run is kept.

What is marked ``campaign`` takes long and guards breadth: sealed campaigns, data sets of laboratories, large
independent witnesses, signals to every process, soak, notebooks, the documentation's commands. It is left out unless
``--all`` is given, a file or a test of it is named, or ``-m`` chooses otherwise.

With ``--all`` every test that has passed is noted in ``.nmt/whole-suite.jsonl`` and not run again while the sources
stay the same, so that the command goes on where it stopped. The file's first line says which sources those are.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / ".nmt" / "whole-suite.jsonl"


def with_quick(cases: Iterable[Any], *quick: Any) -> list[Any]:
    """Cases to parametrise with, of which only some are in the first tier; a tuple has a value for each name."""
    return [
        case
        if case in quick
        else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.campaign)
        for case in cases
    ]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--all", action="store_true", help="both tiers; goes on where it stopped")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--all") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(WholeSuite(), "whole suite")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is not asked for; the long first, so that nobody waits for it at the end."""
    for item in items:
        if item.path.is_relative_to(ROOT / "tests" / "node"):
            item.add_marker(pytest.mark.node)
    if config.getoption("--all"):
        passed = _passed(config)
        _choose(config, items, lambda item: item.nodeid not in passed)
    elif not config.option.markexpr:
        named = [Path(argument.partition("::")[0]).name for argument in config.args]
        _choose(config, items, lambda item: not item.get_closest_marker("campaign") or item.path.name in named)
    items.sort(key=lambda item: (not item.get_closest_marker("campaign"), not item.get_closest_marker("node")))


def _choose(config: pytest.Config, items: list[pytest.Item], wanted: Any) -> None:
    left_out = [item for item in items if not wanted(item)]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if wanted(item)]


def _passed(config: pytest.Config) -> set[str]:
    """Tests that need not run; all workers are told the same."""
    worker_input = getattr(config, "workerinput", None)
    if worker_input is not None:
        return set(worker_input["passed"])
    return config.pluginmanager.get_plugin("whole suite").passed


def sources(root: Path = ROOT) -> str:
    """Digest of the commit, of what differs from it and of the Python; empty without git."""
    digest = hashlib.sha256(sys.version.encode())
    try:
        for words in (["rev-parse", "HEAD"], ["diff", "--binary", "HEAD"]):
            digest.update(subprocess.run(["git", *words], cwd=root, check=True, capture_output=True).stdout)
        words = ["git", "ls-files", "-z", "--others", "--exclude-standard"]
        names = subprocess.run(words, cwd=root, check=True, capture_output=True).stdout.split(b"\0")
    except (OSError, subprocess.CalledProcessError):
        return ""
    for name in filter(None, names):
        digest.update(name + (root / name.decode()).read_bytes())
    return digest.hexdigest()


class WholeSuite:
    """Notes what has passed, and ends with one table.

    Attributes:
        passed: names of the tests that passed or were skipped at these sources.
    """

    def __init__(self, path: Path = KEPT) -> None:
        self._now: dict[str, list[Any]] = {}
        self._kept = self._read(path, sources())
        self.passed = set(self._kept)
        path.parent.mkdir(exist_ok=True)
        self._file = path.open("a", encoding="utf-8")

    @staticmethod
    def _read(path: Path, key: str) -> dict[str, list[Any]]:
        """Results at these sources: test -> seconds and True; a file of other sources is begun anew."""
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        if lines[:1] == [key] and key:
            complete = [line for line in lines[1:] if line.endswith("]")]
            return {name: [seconds, True] for name, seconds in map(json.loads, complete)}
        path.parent.mkdir(exist_ok=True)
        path.write_text(key + "\n", encoding="utf-8")
        return {}

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: Any) -> None:
        node.workerinput["passed"] = sorted(self.passed)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        seconds, good = self._now.get(report.nodeid, (0.0, True))
        self._now[report.nodeid] = [seconds + report.duration, good and not report.failed]
        if report.when == "teardown" and self._now[report.nodeid][1]:
            self._file.write(json.dumps([report.nodeid, round(seconds + report.duration, 3)]) + "\n")
            self._file.flush()

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Where nothing is left to run, all has passed."""
        if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED and self._kept:
            session.exitstatus = pytest.ExitCode.OK

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        rows: dict[str, list[float]] = {}
        for results, column in ((self._kept, 1), (self._now, 2)):
            for name, (seconds, good) in results.items():
                row = rows.setdefault(name.split("/")[1], [0, 0, 0, 0.0])
                row[0] += not good
                row[column] += 1
                row[3] += seconds
        terminalreporter.section("both tiers")
        line = "{:<14}{:>8}{:>10}{:>8}{:>10}"
        terminalreporter.write_line(line.format("part", "kept", "run now", "failed", "seconds"))
        rows = dict(sorted(rows.items()))
        rows["all"] = [sum(column) for column in zip(*rows.values(), strict=True)] if rows else [0, 0, 0, 0.0]
        for name, (failed, kept, now, seconds) in rows.items():
            terminalreporter.write_line(line.format(name, kept, now, failed, f"{seconds:.0f}"))
