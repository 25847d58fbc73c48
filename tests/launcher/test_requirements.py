"""The lock files pin everything and agree with each other; what pip left half-installed is noticed."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from .conftest import ROOT

LOCKS = sorted((ROOT / "requirements" / "lock").glob("*.txt"))


def direct(name: str) -> dict[str, str]:
    """The requirements a file asks for, with those it includes: name -> condition."""
    asked = {}
    for line in (ROOT / "requirements" / name).read_text().splitlines():
        if line.startswith("-r "):
            asked.update(direct(line[3:]))
        elif line and not line.startswith("#"):
            found = re.fullmatch(r"([\w.-]+)(?:\[\w+\])?(.*)", line)
            assert found
            asked[found[1]] = found[2]
    return asked


def test_every_supported_python_is_locked():
    assert [p.stem for p in LOCKS] == ["system-3.12", "wheels-3.10", "wheels-3.11", "wheels-3.12", "wheels-3.13"]


@pytest.mark.parametrize("lock", LOCKS, ids=lambda p: p.stem)
def test_lock_pins_each_entry_with_hashes_and_nothing_else(lock):
    entry = re.compile(r"[a-z0-9][a-z0-9._-]*==[\w.+!]+(?: \\\n    --hash=sha256:[0-9a-f]{64})+\n")
    body = lock.read_text().split("\n", 1)[1]
    assert entry.sub("", body) == ""


@pytest.mark.parametrize("lock", LOCKS, ids=lambda p: p.stem)
def test_lock_holds_what_is_asked_for(lock, launcher):
    pins = launcher.distributions.pins_of(str(lock))
    for name, condition in direct(lock.stem.split("-")[0] + ".in").items():
        assert launcher.distributions.normalised(name) in pins
        if condition.startswith("=="):
            assert pins[launcher.distributions.normalised(name)] == condition[2:]
    assert int(pins["setuptools"].split(".")[0]) < 80
    assert pins["empy"].startswith("3.")


def recent_pins(launcher) -> list[dict[str, str]]:
    """Pins for Python 3.11, 3.12 and 3.13 with the wheels."""
    return [launcher.distributions.pins_of(str(ROOT / f"requirements/lock/wheels-3.{m}.txt")) for m in (11, 12, 13)]


def test_same_versions_on_recent_pythons(launcher):
    first, *others = recent_pins(launcher)
    for other in others:
        assert other == {name: version for name, version in first.items() if name in other}
    assert len({frozenset(other) for other in others}) == 1


def test_what_only_the_oldest_of_them_has_is_asked_for_by_a_condition_on_the_python(launcher):
    """A package that only 3.11 has stands for one that is part of later Pythons, or is needed by such a one."""
    oldest, newer, _ = recent_pins(launcher)
    conditional, needs = set(), {}
    for distribution in metadata.distributions():
        asked = {v: set() for v in ("3.11", "3.12")}
        for requirement in map(Requirement, distribution.requires or []):
            for version, names in asked.items():
                if not requirement.marker or requirement.marker.evaluate({"python_version": version, "extra": ""}):
                    names.add(launcher.distributions.normalised(requirement.name))
        conditional |= asked["3.11"] - asked["3.12"]
        needs[launcher.distributions.normalised(distribution.name)] = asked["3.11"]
    explained = set()
    while conditional - explained:
        explained |= conditional
        conditional |= set().union(*(needs.get(name, set()) for name in conditional))
    extra = set(oldest) - set(newer)
    missing = extra - explained
    # Away from 3.11 the extra packages are not installed, and what they need in turn cannot be asked.
    assert not missing or not extra <= set(needs)
    assert extra & explained


def test_numpy_beside_a_system_ros_is_the_one_its_messages_were_built_with(launcher):
    assert launcher.distributions.pins_of(str(ROOT / "requirements/lock/system-3.12.txt"))["numpy"].startswith("1.26.")


def make_distribution(site, name="pkg", record=None):
    """A distribution as pip leaves it; returns the folder of its metadata."""
    metadata = site / f"{name}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (site / f"{name}.py").write_text("x = 1\n")
    (metadata / "INSTALLER").write_text("pip\n")
    lines = [f"{name}.py,sha256=abc,6", f"__pycache__/{name}.cpython-311.pyc,,", f"{name}-1.0.dist-info/INSTALLER,,4"]
    (metadata / "RECORD").write_text("\n".join([*(lines if record is None else record), ""]))
    return metadata


def test_complete_distribution_is_recognised(launcher, tmp_path):
    assert launcher.distributions.is_complete(str(make_distribution(tmp_path)))


def test_distribution_with_a_missing_file_is_not_complete(launcher, tmp_path):
    metadata = make_distribution(tmp_path)
    (tmp_path / "pkg.py").unlink()
    assert not launcher.distributions.is_complete(str(metadata))


def test_distribution_with_a_cut_file_is_not_complete(launcher, tmp_path):
    metadata = make_distribution(tmp_path)
    (tmp_path / "pkg.py").write_text("x")
    assert not launcher.distributions.is_complete(str(metadata))


def test_distribution_whose_installation_did_not_end_is_not_complete(launcher, tmp_path):
    assert not launcher.distributions.is_complete(str(make_distribution(tmp_path, record=["pkg.py,sha256=abc,6"])))
    (tmp_path / "pkg-1.0.dist-info" / "RECORD").unlink()
    assert not launcher.distributions.is_complete(str(tmp_path / "pkg-1.0.dist-info"))


def test_half_installed_distribution_is_forgotten_before_pip_runs(project):
    site = project.root / ".venv/lib/python3.11/site-packages"
    whole, cut = make_distribution(site, "numpy"), make_distribution(site, "yaml")
    (site / "yaml.py").unlink()
    state = {"source": "wheels", "python": "3.11"}
    with project.launcher.set_up.only_set_up() as guard:
        runner = project.launcher.programs.StepRunner(
            "requirements", project.launcher.progress.Progress(1, 1, "x"), guard
        )
        project.launcher.virtual_environment.make_environment(state, str(project.python), runner)
        project.launcher.requirements.install_requirements(state, runner)
    assert whole.exists()
    assert not cut.exists()
    selected = (project.root / ".nmt" / "first.txt").read_text()
    assert [line.split("==")[0] for line in selected.splitlines()] == ["setuptools", "yaml"]


WITH_UV = "numpy==2.0\nsetuptools==79.0.1\nuv==0.13.8\nyaml==1.0\n"
SETTINGS = """global.index-url='https://me:secret@mirror.example/simple'
global.extra-index-url='https://one.example/simple https://two.example/simple'
global.timeout='20'
install.timeout='60.5'
:env:.no-index='false'
freeze.timeout='1'
global.find-links='/nowhere https://files.example'
"""


def test_uv_installs_what_pip_does_not_have_to(project):
    project.write("requirements/lock/wheels-3.11.txt", WITH_UV)
    project.write("pip-settings", SETTINGS)
    project.launcher.set_up.set_up(None)
    assert project.calls()[1:3] == ["pip install first.txt", "uv install wheels-3.11.txt"]
    call = (project.root / "uv-call").read_text().splitlines()
    assert "--require-hashes" in call
    assert "UV_INDEX=https://one.example/simple https://two.example/simple" in call
    assert "UV_DEFAULT_INDEX=https://me:secret@mirror.example/simple" in call
    assert "UV_HTTP_TIMEOUT=60" in call
    assert "UV_FIND_LINKS=https://files.example" in call
    assert not any(line.startswith("UV_NO_INDEX") for line in call)
    assert "secret" not in (project.root / ".nmt" / "log" / "requirements.log").read_text()


def test_pip_installs_where_uv_fails(project):
    project.write("requirements/lock/wheels-3.11.txt", WITH_UV)
    project.write("fail-at-uv", "")
    project.launcher.set_up.set_up(None)
    assert project.calls()[1:4] == [
        "pip install first.txt",
        "uv install wheels-3.11.txt",
        "pip install wheels-3.11.txt",
    ]


def test_variables_that_the_user_has_set_for_uv_are_left_alone(launcher):
    variables = launcher.index_settings.uv_variables
    settings = {"index-url": "https://a", "proxy": "http://p:1", "no-index": "1", "cert": "/c.pem"}
    assert variables(settings, {}) == {
        "UV_DEFAULT_INDEX": "https://a",
        "UV_NO_INDEX": "1",
        "SSL_CERT_FILE": "/c.pem",
        "HTTPS_PROXY": "http://p:1",
        "HTTP_PROXY": "http://p:1",
    }
    taken = {"UV_DEFAULT_INDEX": "https://b", "https_proxy": "http://q", "SSL_CERT_FILE": "/d.pem"}
    assert variables(settings, taken) == {"UV_NO_INDEX": "1", "HTTP_PROXY": "http://p:1"}


def imported_by(path: Path, **options: object) -> set[str]:
    """Top-level modules that a file imports; its own package's (relative) left out."""
    nodes = list(ast.walk(ast.parse(path.read_text(), **options)))
    names = {a.name for n in nodes if isinstance(n, ast.Import) for a in n.names}
    names |= {str(n.module) for n in nodes if isinstance(n, ast.ImportFrom) and n.level == 0}
    return {name.split(".")[0] for name in names}


def test_launcher_uses_the_standard_library_only():
    files = sorted((ROOT / "requirements" / "launcher").glob("*.py"))
    assert len(files) > 10
    for path in files:
        own = {"nmt_bench", "nmt_core"} if path.name == "commands.py" else set()  # for help, see test_start_up.py
        assert imported_by(path) <= own | set(sys.stdlib_module_names), path
    assert imported_by(ROOT / "nmt", feature_version=(3, 7)) <= {*sys.stdlib_module_names, "launcher"}


def test_old_python_is_answered_with_one_sentence(tmp_path):
    script = (
        "import runpy, sys; sys.version_info = (3, 8, 18, 'final', 0); "
        f"runpy.run_path({str(ROOT / 'nmt')!r}, run_name='__main__')"
    )
    environment = {**os.environ, "PATH": str(tmp_path)}
    answer = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment)
    assert answer.returncode == 1
    assert answer.stderr == (
        "nmt: nmt needs Python 3.10 to 3.13; this is Python 3.8 and no newer one is on the PATH.\n"
    )
