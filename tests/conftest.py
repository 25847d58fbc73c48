"""What all tests share: the environment of ROS 2, private domains, reference data, and no leftovers.

Nodes that tests start talk on this host only, over UDP as in a bench, write their logs to a temporary folder and
check the fields of every message they fill.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nmt_bench.bench_domain import BenchDomain

TESTS = Path(__file__).resolve().parent
SHARED_MEMORY = Path("/dev/shm")

# Message classes read this when they are imported, which is before any fixture runs.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
# A node that a test kills cannot tidy up its shared memory.
os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"

_LOG_FOLDER = pytest.StashKey[str]()
_SEGMENTS = pytest.StashKey[set[str]]()


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_LOG_FOLDER] = os.environ["ROS_LOG_DIR"] = tempfile.mkdtemp(prefix="nmt-test-logs-")
    config.stash[_SEGMENTS] = dead_segments()


def pytest_unconfigure(config: pytest.Config) -> None:
    folder = config.stash.get(_LOG_FOLDER, None)
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.is_relative_to(TESTS / "node"):
            item.add_marker(pytest.mark.node)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail a session that leaves shared memory of Fast DDS behind; under xdist the controller looks."""
    if hasattr(session.config, "workerinput"):
        return
    left = dead_segments() - session.config.stash[_SEGMENTS]
    if left:
        time.sleep(1.0)  # a process that was just ending has removed its segments by now
        left &= dead_segments()
    if left:
        names = ", ".join(sorted(left))
        session.config.pluginmanager.get_plugin("terminalreporter").write_line(
            f"\nShared memory of nodes that died during the session is left in {SHARED_MEMORY}: {names}",
            red=True,
        )
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def dead_segments() -> set[str]:
    """Shared memory of Fast DDS that no living process of this user has mapped or open."""
    segments = {path.name for path in SHARED_MEMORY.glob("fastrtps_*")} if SHARED_MEMORY.is_dir() else set()
    return segments - _held_segments() if segments else segments


def _held_segments() -> set[str]:
    held: set[str] = set()
    for process in Path("/proc").glob("[0-9]*"):
        try:
            lines = (process / "maps").read_text().splitlines()
            names = [line.rpartition("/")[2] for line in lines if f" {SHARED_MEMORY}/" in line]
            names += [os.path.basename(os.readlink(link)) for link in (process / "fd").iterdir()]
        except OSError:
            continue  # gone meanwhile, or not ours
        held.update(names)
    return held


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
