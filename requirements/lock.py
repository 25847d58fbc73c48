"""Resolve the requirements into the lock files: ``python requirements/lock.py [--upgrade]``.

Needs ``uv`` on the PATH (it is in .venv/bin) and the network. What is locked keeps its version unless --upgrade is
given. One file per source of ROS 2 and Python version; where they can, all
Pythons get the versions of the first one. Each entry pins one version and lists the SHA-256 of its wheels
for Linux x86_64 with glibc. Source archives are left out, so pip compiles nothing; the one
exception is a package of a single Python file that was never published as a wheel.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import urllib.request
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
INDEX = "https://pypi.org/simple"
TARGETS = (("wheels", "3.11"), ("wheels", "3.12"), ("wheels", "3.13"), ("wheels", "3.10"), ("system", "3.12"))
SAME_AS_FIRST = (("wheels", "3.12"), ("wheels", "3.13"))
WITHOUT_WHEEL = {"empy"}
HEADER = "# {source}.in resolved for Python {version}, Linux x86_64, by requirements/lock.py; do not edit.\n"


@cache
def files_of(name: str) -> dict[str, str]:
    """All files of a project on the index: file name -> SHA-256."""
    with urllib.request.urlopen(f"{INDEX}/{name}/", timeout=60) as answer:
        page = answer.read().decode()
    links = re.findall(r'href="([^"]+)#sha256=([0-9a-f]{64})"', page)
    return {link.rsplit("/", 1)[-1]: digest for link, digest in links}


def fits(filename: str, name: str, version: str, python: str) -> bool:
    """Whether a file is ``name==version`` for CPython ``python`` on Linux x86_64 with glibc."""
    if name in WITHOUT_WHEEL:
        return filename == f"{name}-{version}.tar.gz"
    if not filename.endswith(".whl") or filename.split("-")[1].replace("_", "-") != version:
        return False
    interpreters, abis, platforms = filename[: -len(".whl")].split("-")[-3:]
    minor = int(python.split(".")[1])
    if platforms != "any" and not ("manylinux" in platforms and "x86_64" in platforms):
        return False
    for interpreter in interpreters.split("."):
        if interpreter in (f"cp3{minor}", "py3", f"py3{minor}") and not abis.endswith("t"):
            return True
        stable = re.fullmatch(r"cp3(\d+)", interpreter)
        if stable and "abi3" in abis.split(".") and int(stable[1]) <= minor:
            return True
    return False


def pins_of(path: Path) -> list[str]:
    """The entries ``name==version`` of a lock file; empty if there is none."""
    return re.findall(r"^\S+==\S+", path.read_text(), re.M) if path.exists() else []


def lock(source: str, python: str, upgrade: bool) -> None:
    """Write ``lock/<source>-<python>.txt``.

    Args:
        source: where ROS 2 comes from.
        python: version of Python.
        upgrade: take the newest versions instead of those in the present file.
    """
    target = FOLDER / "lock" / f"{source}-{python}.txt"
    command = ["uv", "pip", "compile", "--quiet", "--no-header", "--no-annotate", "--no-config"]
    command += ["--default-index", INDEX, "--no-python-downloads", "--python-version", python]
    command += ["--python-platform", "x86_64-manylinux_2_28", str(FOLDER / f"{source}.in")]
    if (source, python) in SAME_AS_FIRST:
        pins = pins_of(FOLDER / "lock" / "{}-{}.txt".format(*TARGETS[0]))
        command += ["--constraint", "-"]
    else:
        pins = []
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "resolved.txt"
        if not upgrade:  # uv keeps the versions that it finds in its output file
            output.write_text("\n".join(pins_of(target)) + "\n")
        command += ["--output-file", str(output)]
        subprocess.run(command, check=True, input="\n".join(pins), stdout=subprocess.DEVNULL, text=True)
        resolved = output.read_text()
    lines = [HEADER.format(source=source, version=python)]
    for pin in resolved.split():
        name, version = pin.split("==")
        name = name.split("[")[0]
        digests = sorted(digest for filename, digest in files_of(name).items() if fits(filename, name, version, python))
        if not digests:
            raise SystemExit(f"{pin}: the index has no wheel for Python {python} on Linux x86_64")
        lines.append(f"{name}=={version}" + "".join(f" \\\n    --hash=sha256:{digest}" for digest in digests) + "\n")
    target.parent.mkdir(exist_ok=True)
    target.write_text("".join(lines))
    sys.stdout.write(f"{source}-{python}: {len(lines) - 1} packages\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Resolve the requirements into the lock files.")
    parser.add_argument("--upgrade", action="store_true", help="take the newest versions")
    options = parser.parse_args()
    for target in TARGETS:
        lock(*target, options.upgrade)
