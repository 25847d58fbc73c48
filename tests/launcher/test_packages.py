"""What packages say of themselves agrees with what they import, with each other and with the lock files."""

from __future__ import annotations

import ast
import fnmatch
import importlib.util
import re
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import ModuleType

import pytest
from packaging.requirements import Requirement

from .conftest import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SOURCES = ("ros2_ws/src", "campaigns")
FOLDERS = {path.parent.name: path.parent for source in SOURCES for path in (ROOT / source).glob("*/setup.py")}
PACKAGES = sorted(FOLDERS)
LOCKS = sorted((ROOT / "requirements" / "lock").glob("*.txt"))


@pytest.fixture(scope="module")
def tables() -> ModuleType:
    """requirements/packages.py as a module."""
    specification = importlib.util.spec_from_file_location("nmt_packages", ROOT / "requirements" / "packages.py")
    assert specification
    assert specification.loader
    module = sys.modules["nmt_packages"] = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def manifest(package: str) -> ElementTree.Element:
    folder = FOLDERS.get(package, ROOT / "ros2_ws" / "src" / package)
    return ElementTree.parse(folder / "package.xml").getroot()


def setup_arguments(package: str) -> dict[str, object]:
    """Arguments of ``setup`` in a setup.py that are written out."""
    tree = ast.parse((FOLDERS[package] / "setup.py").read_text())
    call = next(node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "setup")
    literal = {}
    for keyword in call.keywords:
        if keyword.arg != "packages":
            literal[str(keyword.arg)] = ast.literal_eval(keyword.value)
    return literal


def test_every_list_of_dependencies_follows_from_the_imports(tables: ModuleType) -> None:
    outdated = [str(path.relative_to(ROOT)) for path in tables.outdated()]
    assert not outdated, "type: python requirements/packages.py"


def test_imports_count_wherever_they_run_and_not_for_type_checkers(tables: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "module.py").write_text(
        "from __future__ import annotations\n"
        "import os.path, numpy.linalg as la\n"
        "from typing import TYPE_CHECKING\n"
        "from . import sibling\n"
        "from .other import thing\n"
        "if TYPE_CHECKING:\n"
        "    import polars\n"
        "else:\n"
        "    pass\n"
        "def late():\n"
        "    from scipy.linalg import eigh\n"
        "    try:\n"
        "        import yaml\n"
        "    except ImportError:\n"
        "        pass\n"
    )
    assert tables.imports_of(tmp_path) == {"numpy", "scipy", "yaml"}


def test_an_import_that_no_table_names_is_refused(
    tables: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "nmt_new" / "nmt_new").mkdir(parents=True)
    (tmp_path / "nmt_new" / "nmt_new" / "module.py").write_text("import polars\n")
    monkeypatch.setattr(tables, "folders", lambda: {"nmt_new": tmp_path / "nmt_new"})
    with pytest.raises(SystemExit, match="nmt_new imports polars"):
        tables.needs("nmt_new")


@pytest.mark.parametrize("package", PACKAGES)
def test_keys_of_the_manifest_exist(tables: ModuleType, package: str) -> None:
    """Python's keys were looked up in rosdep's database; ROS 2's are names of its packages, which are locked."""
    locked = set(re.findall(r"^ros-(?:jazzy-)?([\w-]+)==", LOCKS[-1].read_text(), re.M))
    for tag in ("exec_depend", "test_depend"):
        for element in manifest(package).iter(tag):
            key = str(element.text)
            if key in tables.NOT_IN_THE_WHEELS:
                continue
            assert key in tables.KNOWN_KEYS or key in (*PACKAGES, "nmt_msgs") or key.replace("_", "-") in locked, key


def test_no_circle_of_packages() -> None:
    """colcon cannot put packages into an order that need each other."""
    left = {p: {str(e.text) for e in manifest(p).iter("exec_depend")} & set(PACKAGES) for p in PACKAGES}
    while left:
        free = [package for package, needed in left.items() if not needed & set(left)]
        assert free, f"a circle among {sorted(left)}"
        for package in free:
            del left[package]


@pytest.mark.parametrize("package", PACKAGES)
def test_manifest_and_setup_say_the_same(package: str) -> None:
    root, arguments = manifest(package), setup_arguments(package)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert root.findtext("name") == arguments["name"] == package
    assert root.findtext("version") == arguments["version"] == project["version"]
    assert root.findtext("description") == arguments["description"]
    assert root.findtext("license") == arguments["license"] == "Apache-2.0"
    configuration = (FOLDERS[package] / "setup.cfg").read_text()
    assert configuration.count(f"$base/lib/{package}\n") == 2


def test_the_version_is_told_the_same_everywhere() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    newest = re.findall(r"^## (\S+)(?: \((\d{4}-\d\d-\d\d)\))?$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    released = [release for release in newest if release[0] != "Unreleased"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert released[0][0] == version == manifest("nmt_msgs").findtext("version")
    assert f"\nversion: {version}\ndate-released: {released[0][1]}\n" in citation


def test_a_release_is_told_on_one_page() -> None:
    """Added, Changed, Fixed in this order, at most 750 words; the changes of a package stand nowhere else."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    for page in re.split(r"^## ", text, flags=re.M)[1:]:
        name, *_ = page.split()
        headings = re.findall(r"^### (.+)$", page, re.M)
        assert headings == [heading for heading in ("Added", "Changed", "Fixed") if heading in headings], name
        assert len(page.split()) <= 750, name
    assert not [path for source in SOURCES for path in (ROOT / source).rglob("CHANGELOG*")]


@pytest.mark.parametrize("package", PACKAGES)
def test_data_files_are_installed(package: str) -> None:
    patterns = setup_arguments(package)["package_data"]
    assert isinstance(patterns, dict)
    folder = FOLDERS[package] / package
    for path in folder.rglob("*"):
        if path.is_dir() or path.suffix == ".py" or "__pycache__" in path.parts:
            continue
        covered = [
            fnmatch.fnmatch(str(path.relative_to(folder)) if owner else path.name, pattern)
            or fnmatch.fnmatch(str(path.relative_to(folder)), pattern)
            for owner, owned in patterns.items()
            for pattern in owned
        ]
        assert any(covered), path


@pytest.mark.parametrize("package", PACKAGES)
def test_colcon_test_imports_every_module(package: str) -> None:
    assert setup_arguments(package)["extras_require"] == {"test": ["pytest"]}  # what makes colcon run pytest
    first = (FOLDERS[PACKAGES[0]] / "test" / "test_imports.py").read_text()
    assert (FOLDERS[package] / "test" / "test_imports.py").read_text() == first


def test_wheel_holds_every_package_but_those_of_the_clone(tables: ModuleType) -> None:
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    wanted = {str((FOLDERS[name] / name).relative_to(ROOT)) for name in tables.packages_of_the_wheel()}
    assert sorted(wheel["packages"]) == sorted(wanted)
    assert set(wheel["force-include"]) == {"ros2_ws/src/nmt_msgs/msg"}


def test_commands_of_the_wheel_are_those_of_the_packages() -> None:
    """Commands of packages beside the bench are found by entry points, in a clone and in the wheel."""
    commands = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["nmt.commands"]
    declared = {}
    for package in PACKAGES:
        points = setup_arguments(package).get("entry_points", {})
        assert isinstance(points, dict)
        declared |= dict(line.split(" = ") for line in points.get("nmt.commands", []))
    assert declared.pop("blind") == "nmt_blind.blind_command"
    assert declared == commands


@pytest.mark.parametrize("lock", LOCKS, ids=lambda p: p.stem)
def test_locked_versions_satisfy_the_wheel(lock: Path) -> None:
    pins = dict(re.findall(r"^([\w.-]+)==(\S+)", lock.read_text(), re.M))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = list(project["dependencies"])
    for extra in project["optional-dependencies"].values():
        asked += extra
    assert len(asked) > 10
    for requirement in map(Requirement, asked):
        name = re.sub(r"[-_.]+", "-", requirement.name).lower()
        assert requirement.specifier.contains(pins[name]), requirement


def test_every_library_is_asked_for_in_the_requirements(tables: ModuleType) -> None:
    text = (ROOT / "requirements" / "bench.in").read_text()
    asked = {re.split(r"[<=>\[]", line)[0].lower() for line in text.splitlines() if line and not line.startswith("#")}
    assert {library.name.lower() for library in tables.libraries(*PACKAGES)} <= asked
    run_time = text[: text.index("# build of the workspace")]
    named = {re.split(r"[<=>\[]", line)[0].lower() for line in run_time.splitlines() if line and line[0] != "#"}
    assert named - {"uv"} <= {library.name.lower() for library in tables.LIBRARIES.values()}
