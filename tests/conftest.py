"""What all tests share: the environment of ROS 2, private domains, reference data, and no leftovers.

Nodes that tests start talk on this host only, write their logs to a temporary folder and check the fields
of every message they fill.
"""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from nmt_bench.orchestration.bench_domain import BenchDomain
from nmt_core.shared_memory import remove_dead_segments

TESTS = Path(__file__).resolve().parent

# Message classes read this when they are imported, which is before any fixture runs.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

# A shell starts jobs in the background with Ctrl-C ignored, and every program that tests start would ignore it, too.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

_LOG_FOLDER = pytest.StashKey[str]()


# The same examples every time where a failure would stop everybody; new ones on one's own machine.
settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("ci")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--write-seconds", action="store_true", help="put what each file takes into tests/seconds.txt, for the order"
    )


class Stopwatch:
    """Adds up what the tests of each file take, and puts it into the table at the end."""

    def __init__(self) -> None:
        self._seconds: Counter[str] = Counter()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._seconds[report.nodeid.partition("::")[0]] += report.duration

    def pytest_sessionfinish(self) -> None:
        from worker_schedule import write_costs

        write_costs(self._seconds)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """The longest first, unless the command line wants another distribution."""
    if config.getvalue("dist") != "load":
        return None
    from worker_schedule import LongestFirst

    return LongestFirst(config, log)


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_LOG_FOLDER] = os.environ["ROS_LOG_DIR"] = tempfile.mkdtemp(prefix="nmt-test-logs-")
    worker = getattr(config, "workerinput", {}).get("workerid", "")
    if worker:
        from worker_schedule import stand_back

        stand_back(worker)
    if config.getoption("--write-seconds") and not worker:
        config.pluginmanager.register(Stopwatch())


def pytest_unconfigure(config: pytest.Config) -> None:
    folder = config.stash.get(_LOG_FOLDER, None)
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.is_relative_to(TESTS / "node"):
            item.add_marker(pytest.mark.node)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Nodes that tests kill leave shared memory behind; under xdist the controller clears it for all."""
    if not hasattr(session.config, "workerinput"):
        remove_dead_segments()


@pytest.fixture
def domain_id() -> Iterator[int]:
    """A ROS domain that nobody else on this host uses during the test."""
    domain = BenchDomain()
    yield domain.id
    domain.close()


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Reference data beside the repository."""
    folder = TESTS.parent.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the reference data ({folder}) is not on this machine")
    return folder
