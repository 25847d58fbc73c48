"""What all tests share: the environment of ROS 2, private domains, reference data, and no leftovers.

Nodes that tests start talk on this host only, write their logs to a temporary folder and check the fields
of every message they fill.
"""

from __future__ import annotations

import gc
import importlib.util
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

# Read when numpy is imported: several workers with several threads each would wait for one another most of the time.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

from nmt_bench.orchestration.bench_domain import BenchDomain  # noqa: E402

pytest_plugins = ("tiers",)
TESTS = Path(__file__).resolve().parent

# Message classes read this when they are imported, which is before any fixture runs.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

# A shell starts jobs in the background with Ctrl-C ignored, and every program that tests start would ignore it, too.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

_LOG_FOLDER = pytest.StashKey[str]()


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_LOG_FOLDER] = os.environ["ROS_LOG_DIR"] = tempfile.mkdtemp(prefix="nmt-test-logs-")
    if not config.option.help:
        _configure_hypothesis()


def _configure_hypothesis() -> None:
    """The same examples every time where a failure would stop everybody; new ones on one's computer.

    How long an example takes says how busy the computer is, and nothing of the program. The import takes longer than
    ``--help`` may.
    """
    from hypothesis import HealthCheck, settings

    settings.register_profile(
        "nmt", derandomize=bool(os.environ.get("CI")), deadline=None, suppress_health_check=[HealthCheck.too_slow]
    )
    settings.load_profile("nmt")


@pytest.hookimpl(hookwrapper=True)
def pytest_collection() -> Iterator[None]:
    """What modules and tests are made of lives to the end: it is not looked through for garbage again and again."""
    gc.disable()
    yield
    gc.freeze()
    gc.enable()


def pytest_unconfigure(config: pytest.Config) -> None:
    folder = config.stash.get(_LOG_FOLDER, None)
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def domain_id() -> Iterator[int]:
    """A ROS domain that nobody else on this host uses during the test."""
    domain = BenchDomain()
    yield domain.id
    domain.close()


def _leave_undrawn(patch: pytest.MonkeyPatch) -> None:
    from markupsafe import Markup

    from nmt_report import diagnosis_files, run_report, svg  # noqa: F401 - what they import is to be there

    if importlib.util.find_spec("mujoco"):
        importlib.import_module("nmt_robots.report.robot_files")
    for name, module in list(sys.modules.items()):
        if name.startswith(("nmt_report.", "nmt_robots.")) and module is not svg and hasattr(module, "svg_text"):
            patch.setattr(module, "svg_text", lambda *_: Markup("<svg></svg>"))


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are built, and an empty drawing stands in their place: drawing takes most of a page's time."""
    _leave_undrawn(monkeypatch)


@pytest.fixture(scope="module")
def module_undrawn() -> Iterator[None]:
    """As `undrawn`, for fixtures of a module, too."""
    with pytest.MonkeyPatch.context() as patch:
        _leave_undrawn(patch)
        yield


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Reference data beside the repository."""
    folder = TESTS.parent.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the reference data ({folder}) is not on this machine")
    return folder
