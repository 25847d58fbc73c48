"""The launcher as a module, and a small project for it to work on."""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import shutil
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
_NUMBERS = itertools.count()

# Stands in for Python, pip and colcon: notes each call, leaves what the real one would, fails where told to.
PRETENDER = """#!{python} -S
import os, shutil, sys, time
root = {root!r}
words = sys.argv[1:]
def say(what):
    with open(os.path.join(root, "calls.txt"), "a") as file:
        file.write(what + "\\n")
    if os.path.exists(os.path.join(root, "fail-at-" + what.split()[0])):
        print("Could not install packages due to an OSError: [Errno 28] No space left on device")
        sys.exit(1)
if words[:1] == ["-c"]:
    print("3.11")
elif words[:2] == ["-m", "venv"]:
    say("venv")
    os.makedirs(os.path.join(words[-1], "bin"), exist_ok=True)
    python = os.path.join(words[-1], "bin", "python")
    if not os.path.exists(python):
        shutil.copy(os.path.join(root, "pretender"), python)
    with open(os.path.join(words[-1], "pyvenv.cfg"), "w") as file:
        file.write("include-system-site-packages = false\\n")
elif words[:4] == ["-m", "pip", "config", "list"]:
    if os.path.exists(os.path.join(root, "pip-settings")):
        print(open(os.path.join(root, "pip-settings")).read())
elif words[:2] == ["-m", "uv"]:
    with open(os.path.join(root, "uv-call"), "w") as file:
        file.write("\\n".join([*words, *(f"{{k}}={{v}}" for k, v in os.environ.items() if k.startswith("UV_"))]))
    say("uv install " + os.path.basename(words[-1]))
elif words[:2] == ["-m", "pip"]:
    say("pip " + ("uninstall " + " ".join(words[words.index("uninstall") + 2:]) if "uninstall" in words
                  else "install " + os.path.basename(words[-1])))
elif words[0].endswith("colcon"):
    held = os.path.join(root, "held")
    while os.path.exists(os.path.join(root, "hold-test")) and not os.path.exists(held):
        time.sleep(0.01)
    names = words[words.index("--packages-select") + 1 : words.index("--cmake-args")]
    say("colcon " + " ".join(names))
    install = words[words.index("--install-base") + 1]
    for name in names:
        os.makedirs(os.path.join(install, name, "share", name), exist_ok=True)
        open(os.path.join(install, name, "share", name, "package.xml"), "w").close()
elif words[:1] == ["-m"]:
    say(" ".join(words[1:]))
    if os.path.exists(os.path.join(root, "hold-" + words[-1])):
        with open(os.path.join(root, "held.new"), "w") as file:
            file.write(str(os.getpid()))
        os.replace(os.path.join(root, "held.new"), os.path.join(root, "held"))
        time.sleep(300)
    for variable in ("PYTHONPATH", "ROS_AUTOMATIC_DISCOVERY_RANGE", "OPENBLAS_NUM_THREADS"):
        say(variable + "=" + os.environ.get(variable, ""))
"""


def load_launcher(root: Path) -> ModuleType:
    """The launcher of the project in a folder, as a package of its own name: each project has its own paths."""
    name = f"launcher_{next(_NUMBERS)}"
    folder = root / "requirements" / "launcher"
    specification = importlib.util.spec_from_file_location(
        name, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    assert specification
    assert specification.loader
    package = sys.modules[name] = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(package)
    for module in sorted(folder.glob("[!_]*.py")):
        importlib.import_module(f"{name}.{module.stem}")
    return package


def copy_launcher(root: Path) -> None:
    """Put the launcher's files into an empty project."""
    shutil.copy(ROOT / "nmt", root / "nmt")
    shutil.copytree(
        ROOT / "requirements" / "launcher",
        root / "requirements" / "launcher",
        ignore=shutil.ignore_patterns("__pycache__"),
    )


class Project:
    """A copy of the launcher with two packages, a lock file and a pretended Python."""

    def __init__(self, root: Path) -> None:
        self.root = root
        copy_launcher(root)
        self.write("requirements/lock/wheels-3.11.txt", "numpy==2.0\nsetuptools==79.0.1\nyaml==1.0\n")
        self.write("ros2_ws/src/nmt_msgs/package.xml", "<package/>")
        self.write("ros2_ws/src/nmt_msgs/msg/Level.msg", "float64 amplitude\n")
        self.write("ros2_ws/src/nmt_pll/package.xml", "<package/>")
        self.write("ros2_ws/src/nmt_pll/setup.py", "setup()\n")
        self.write("ros2_ws/src/nmt_pll/nmt_pll/phase_loop/gains.py", "")
        self.python = self.write("pretender", PRETENDER.format(python=sys.executable, root=str(root)))
        self.python.chmod(0o755)
        self.launcher = load_launcher(root)

    def write(self, name: str, text: str) -> Path:
        """Write a file of the project."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    def calls(self) -> list[str]:
        """What the pretended programs were asked since the last look."""
        noted = self.root / "calls.txt"
        lines = noted.read_text().splitlines() if noted.exists() else []
        noted.unlink(missing_ok=True)
        return lines


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Project:
    """A project that was never set up, outside any ROS 2."""
    for name in ("ROS_DISTRO", "NMT_ROS", "PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    made = Project(tmp_path)
    monkeypatch.setenv("NMT_PYTHON", str(made.python))
    monkeypatch.setattr(made.launcher.set_up, "machine_troubles", lambda source: [])
    return made


@pytest.fixture(scope="session")
def launcher() -> ModuleType:
    """The launcher of this project."""
    return load_launcher(ROOT)
