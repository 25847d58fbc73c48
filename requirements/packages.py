"""What each package imports, and the lists of dependencies that follow: ``python requirements/packages.py [--check]``.

One table names every library; the imports are read from the sources (those for type checkers alone do not count).
From both follow the ``exec_depend`` of each package.xml, ``install_requires`` of each setup.py, ``dependencies`` of the
wheel in pyproject.toml, and the lists for apt and pip in docs/how-to/install.md. A test holds them.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = (ROOT / "ros2_ws" / "src", ROOT / "campaigns")
INSTALL_PAGE = ROOT / "docs" / "how-to" / "install.md"


@dataclass(frozen=True)
class Library:
    """A library that the packages import.

    Attributes:
        name: of the distribution on the Python package index.
        versions: that will do.
        rosdep: key of rosdep; None where Ubuntu 24.04 has no such key or too old a version behind it.
        apt: package of Ubuntu 24.04; None where it is missing or too old, then it comes from pip.
        extra: of the wheel that brings it; None = always installed.
    """

    name: str
    versions: str
    rosdep: str | None = None
    apt: str | None = None
    extra: str | None = None

    @property
    def requirement(self) -> str:
        """As pip takes it."""
        return self.name + self.versions


LIBRARIES = {
    # rosdep has the key, Ubuntu 24.04 the version 3.9.
    "aiohttp": Library("aiohttp", ">=3.9", "python3-aiohttp", "python3-aiohttp"),
    "contourpy": Library("contourpy", ">=1.0", apt="python3-contourpy"),
    "distributed": Library("distributed", ">=2024.1", apt="python3-distributed", extra="dask"),
    "grpc": Library("grpcio", ">=1.49", apt="python3-grpcio", extra="hardware"),
    "h5py": Library("h5py", ">=3.10", apt="python3-h5py"),
    "lvm_read": Library("lvm-read", ">=1.22"),
    "nptdms": Library("npTDMS", ">=1.7"),
    "jack": Library("JACK-Client", ">=0.5.4", extra="hardware"),
    "jinja2": Library("jinja2", ">=3.1", "python3-jinja2", "python3-jinja2"),
    "joblib": Library("joblib", ">=1.3", "python3-joblib", "python3-joblib"),
    "lz4": Library("lz4", ">=4.0", apt="python3-lz4"),
    "matplotlib": Library("matplotlib", ">=3.6", "python3-matplotlib", "python3-matplotlib"),
    "mcap": Library("mcap", ">=1.1"),
    "nfoursid": Library("nfoursid", ">=1.0.2", extra="identification"),
    "mujoco": Library("mujoco", ">=3.3.7", extra="robots"),
    # rosdep knows python3-numba for older Ubuntus only.
    "nidaqmx": Library("nidaqmx", ">=1.0", extra="hardware"),
    "numba": Library("numba", ">=0.59"),
    "numpy": Library("numpy", ">=1.26", "python3-numpy", "python3-numpy"),
    # Ubuntu 24.04 has version 1.10, to which the key python3-pydantic leads; the rig file needs version 2.
    "pydantic": Library("pydantic", ">=2.5"),
    "pyuff": Library("pyuff", ">=2.4"),
    "rich": Library("rich", ">=13.7", "python3-rich", "python3-rich"),
    "pandas": Library("pandas", ">=2.0", apt="python3-pandas", extra="analysis"),
    # What is asked of its tables of types changes from version to version.
    "rosbags": Library("rosbags", "==0.11.9"),
    "ruamel": Library("ruamel.yaml", ">=0.17.21", "python3-ruamel.yaml", "python3-ruamel.yaml"),
    "scipy": Library("scipy", ">=1.11", "python3-scipy", "python3-scipy"),
    "sdypy": Library("sdypy-EMA", ">=0.31"),
    "skfem": Library("scikit-fem", ">=10.0"),
    "shtab": Library("shtab", ">=1.6", apt="python3-shtab", extra="completion"),
    "sounddevice": Library("sounddevice", ">=0.4.6", extra="hardware"),
    "xarray": Library("xarray", ">=2023.6", apt="python3-xarray", extra="analysis"),
    "yaml": Library("PyYAML", ">=6.0", "python3-yaml", "python3-yaml"),
    "zstandard": Library("zstandard", ">=0.22", apt="python3-zstandard"),
}
"""By the name that is imported."""

WITH_ANOTHER = {"markupsafe": "jinja2", "pydantic_core": "pydantic"}
"""Modules that come with a library of another name."""

ROS = frozenset(
    {
        "action_msgs",
        "diagnostic_msgs",
        "launch",
        "launch_ros",
        "nmt_msgs",
        "rcl_interfaces",
        "rclpy",
        "std_msgs",
        "std_srvs",
        "unique_identifier_msgs",
    }
)
"""Packages of ROS 2, each its own rosdep key; in the wheel they are absent."""

NOT_IN_THE_WHEELS = frozenset({"launch", "launch_ros"})
"""Packages of ROS 2 that come from apt only; the launch file alone needs them."""

KNOWN_KEYS = frozenset(
    f"python3-{name}"
    for name in ("aiohttp", "jinja2", "joblib", "matplotlib", "numpy", "pytest", "rich", "ruamel.yaml", "scipy", "yaml")
)
"""Keys of rosdep/python.yaml for Ubuntu, read in ros/rosdistro at 000730dc5f916eb05b15d3f183bd1c17bf1b4722; that of
rich came later, with pull request 43386."""


NOT_IN_THE_WHEEL = frozenset({"nmt_blind", "nmt_laboratories"})
"""Packages of this clone alone."""


@cache
def folders() -> dict[str, Path]:
    """Folder of each Python package of the workspace and of the campaigns beside it."""
    return {path.parent.name: path.parent for source in SOURCES for path in source.glob("*/setup.py")}


@cache
def packages() -> tuple[str, ...]:
    """Their names."""
    return tuple(sorted(folders()))


@cache
def packages_of_the_wheel() -> tuple[str, ...]:
    """Names of those that the wheel holds."""
    return tuple(name for name in packages() if name not in NOT_IN_THE_WHEEL)


def imports_of(folder: Path) -> set[str]:
    """Top-level names that the Python files below a folder import when they run."""
    names: set[str] = set()
    for path in sorted(folder.rglob("*.py")):
        for node in _run_nodes(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names.update(alias.name.partition(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names.add(str(node.module).partition(".")[0])
    return names - set(sys.stdlib_module_names)


def _run_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those below ``if TYPE_CHECKING``."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        yield from _run_nodes(node)


@cache
def needs(package: str) -> tuple[str, ...]:
    """What a package imports from outside itself, by the names in the tables.

    Raises:
        SystemExit: an import is in no table.
    """
    found = imports_of(folders()[package] / package) | imports_of(folders()[package] / "launch")
    names = {WITH_ANOTHER.get(name, name) for name in found} - {package}
    unknown = names - set(LIBRARIES) - ROS - set(packages())
    if unknown:
        raise SystemExit(f"{package} imports {', '.join(sorted(unknown))}: say in requirements/packages.py where from")
    return tuple(sorted(names - {upper for lower, upper in against_the_layers() if lower == package}))


@cache
def against_the_layers() -> frozenset[tuple[str, str]]:
    """Pairs of packages whose import .importlinter tolerates although it goes upwards; colcon cannot order a circle."""
    text = (ROOT / ".importlinter").read_text()
    layers = text[text.index("[importlinter:contract:layers]") :].split("[importlinter:contract:", 2)[1]
    return frozenset(re.findall(r"^ +(\w+)[\w.]* -> (\w+)", layers, re.M))


def exec_depends(package: str) -> list[str]:
    """The keys of a package's package.xml: ROS 2, packages of this workspace, libraries."""
    names = needs(package)
    own = sorted(name for name in names if name in packages())
    ros = sorted(name for name in names if name in ROS)
    return ros + own + sorted(key for name in names if name in LIBRARIES and (key := LIBRARIES[name].rosdep))


def libraries(*names: str) -> list[Library]:
    """Libraries that packages need, in alphabetical order."""
    found = {name for package in names for name in needs(package) if name in LIBRARIES}
    return sorted((LIBRARIES[name] for name in found), key=lambda library: library.name.lower())


def with_exec_depends(text: str, package: str) -> str:
    """A package.xml with its ``exec_depend`` put right."""
    lines = "".join(f"  <exec_depend>{key}</exec_depend>\n" for key in exec_depends(package))
    return re.sub(r"(?:  <exec_depend>.*</exec_depend>\n)+", lines, text, count=1)


def with_install_requires(text: str, package: str) -> str:
    """A setup.py with its ``install_requires`` put right."""
    items = "".join(f'        "{library.requirement}",\n' for library in libraries(package))
    listed = f"[\n{items}    ]" if items else "[]"
    return re.sub(r"install_requires=\[[^\]]*\]", f"install_requires={listed}", text, count=1)


def with_dependencies(text: str) -> str:
    """pyproject.toml with dependencies and extras of the wheel put right."""
    every = libraries(*packages_of_the_wheel())
    listed = "".join(f'    "{library.requirement}",\n' for library in every if not library.extra)
    text = re.sub(r"^dependencies = \[[^\]]*\]", f"dependencies = [\n{listed}]", text, count=1, flags=re.M)
    extras: dict[str, list[str]] = {}
    for library in every:
        if library.extra:
            extras.setdefault(library.extra, []).append(library.requirement)
    lines = "".join(f"{name} = {items!r}\n".replace("'", '"') for name, items in sorted(extras.items()))
    return re.sub(r"(?<=^\[project\.optional-dependencies\]\n)(?:\w+ = .*\n)*", lines, text, count=1, flags=re.M)


def with_install_lines(text: str) -> str:
    """The page on installation with the lists for apt and pip put right."""
    every = libraries(*packages_of_the_wheel())
    from_apt = " ".join(library.apt for library in every if library.apt)
    from_pip = " ".join(
        f"'{library.requirement}'" if re.search("[<>]", library.versions) else library.requirement
        for library in every
        if not library.apt
    )
    block = f"```\nsudo apt install {from_apt}\npip install --user --break-system-packages {from_pip}\n```\n"
    begin, end = "<!-- lists by requirements/packages.py -->\n", "<!-- end of lists -->\n"
    head, _, rest = text.partition(begin)
    return head + begin + block + end + rest.partition(end)[2]


def outdated() -> dict[Path, str]:
    """Files whose lists differ from what follows from imports and tables, and what they should hold."""
    files: list[tuple[Path, Callable[[str], str]]] = [
        (ROOT / "pyproject.toml", with_dependencies),
        (INSTALL_PAGE, with_install_lines),
    ]
    for package in packages():
        files.append((folders()[package] / "package.xml", partial(with_exec_depends, package=package)))
        files.append((folders()[package] / "setup.py", partial(with_install_requires, package=package)))
    found = {}
    for path, put_right in files:
        text = path.read_text()
        if (right := put_right(text)) != text:
            found[path] = right
    return found


def main() -> int:
    """Put the lists right, or only say which are not."""
    parser = argparse.ArgumentParser(description="Lists of dependencies that follow from the imports.")
    parser.add_argument("--check", action="store_true", help="change nothing; exit code 1 where a list is not right")
    check = parser.parse_args().check
    found = outdated()
    for path, text in found.items():
        sys.stdout.write(f"{path.relative_to(ROOT)}\n")
        if not check:
            path.write_text(text)
    return 1 if check and found else 0


if __name__ == "__main__":
    sys.exit(main())
