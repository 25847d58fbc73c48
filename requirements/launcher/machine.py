"""Source of ROS 2, interpreter, and whether this machine can be set up."""

from __future__ import annotations

import contextlib
import glob
import os
import re
import shutil
import subprocess
import sys
from typing import Any

from .places import LOCKS, MISUSED, ROOT, VENV, SetupError

DISK_NEEDED = {"wheels": 2.0e9, "system": 1.0e9}  # bytes free in this folder before the first set-up
TEMPORARY_NEEDED = 0.6e9  # bytes free where pip unpacks its downloads


def sourced_python() -> str | None:
    """Python version ("3.12") that the sourced ROS 2 Jazzy was built for; None where none is sourced."""
    if os.environ.get("ROS_DISTRO") != "jazzy":
        return None
    for folder in os.environ.get("PYTHONPATH", "").split(os.pathsep):
        for module in glob.glob(os.path.join(folder, "rclpy", "_rclpy_pybind11.cpython-3*")) if folder else []:
            found = re.search(r"\.cpython-3(\d+)", module)
            if found:
                return f"3.{found[1]}"
    return None


def choose_source(wanted: str | None, state: dict[str, Any]) -> str:
    """Where ROS 2 comes from: as the user says, else as the set-up has it, else the system's if sourced.

    Raises:
        SetupError: an unknown choice, or the system's ROS 2 is wanted and not sourced.
    """
    wanted = wanted or os.environ.get("NMT_ROS") or state.get("source")
    if wanted not in (None, "wheels", "system"):
        raise SetupError(f"NMT_ROS is '{wanted}'; it can be 'wheels' or 'system'.", MISUSED)
    sourced = sourced_python()
    if wanted == "system" and not sourced:
        raise SetupError(
            "This set-up uses the system's ROS 2 Jazzy, which is not sourced: type 'source "
            "/opt/ros/jazzy/setup.bash' first, or './nmt setup --wheels' to take ROS 2 from the Python "
            "package index."
        )
    return wanted or ("system" if sourced else "wheels")


def version_of(python: str) -> str | None:
    """Version ("3.11") of an interpreter that runs and has venv and pip's installer; None otherwise."""
    question = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2])"
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    try:
        answer = subprocess.run([python, "-c", question], capture_output=True, text=True, env=environment, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.strip() if answer.returncode == 0 else None


def choose_python(source: str) -> tuple[str, str]:
    """Interpreter for the environment and its version.

    Raises:
        SetupError: none fits.
    """
    pattern = re.compile(re.escape(source) + r"-(3\.\d+)\.txt$")
    locked = sorted((m[1] for m in map(pattern.search, os.listdir(LOCKS)) if m), key=lambda v: -int(v[2:]))
    span = locked[0] if len(locked) == 1 else f"{locked[-1]} to {locked[0]}"
    if source == "system":
        needed = sourced_python()
        if needed not in locked:
            raise SetupError(
                f"The sourced ROS 2 Jazzy is built for Python {needed}, its requirements are locked for "
                f"{span}; use './nmt setup --wheels'."
            )
        locked = [str(needed)]
    own = getattr(sys, "_base_executable", None) or sys.executable
    asked = os.environ.get("NMT_PYTHON")
    candidates = [asked] if asked else [own, *(f"python{version}" for version in locked), "/usr/bin/python3"]
    without_venv = None
    for candidate in candidates:
        path = shutil.which(candidate)
        version = version_of(path) if path else None
        if path and version in locked:
            return path, str(version)
        if path and version is None:
            without_venv = without_venv or path
    if asked:
        raise SetupError(f"NMT_PYTHON={asked} is not a Python {span} with venv.", MISUSED)
    here = "{}.{}".format(*sys.version_info[:2])
    if here in locked and without_venv:
        raise SetupError(
            f"Python {here} is here but its venv module is not complete: install it, on Debian or Ubuntu "
            f"with 'sudo apt install python{here}-venv'."
        )
    raise SetupError(
        f"nmt needs Python {' or '.join(locked) if source == 'system' else span} with venv; this is Python "
        f"{here} and no other is on the PATH: install one (Debian, Ubuntu: 'sudo apt install python3 "
        "python3-venv') or name it in NMT_PYTHON."
    )


def machine_troubles(source: str) -> list[str]:
    """What on this machine stands in the way of a set-up, one sentence each."""
    found = []
    system, machine = os.uname().sysname, os.uname().machine
    if source == "wheels":
        libc = ""
        with contextlib.suppress(ValueError, OSError):
            libc = os.confstr("CS_GNU_LIBC_VERSION") or ""
        release = re.match(r"glibc (\d+)\.(\d+)", libc)
        instead = "install ROS 2 Jazzy from apt (Ubuntu 24.04) and source it, nmt then uses that"
        if system != "Linux" or machine != "x86_64":
            found.append(f"ROS 2 wheels exist for Linux x86_64 only and this is {system} {machine}: {instead}.")
        elif not release or (int(release[1]), int(release[2])) < (2, 28):
            found.append(f"ROS 2 wheels need glibc 2.28 or newer and this system has {libc or 'none'}: {instead}.")
    if re.search(r"[\s:;\"'$\\]", ROOT):
        found.append(
            f"The path of this folder ({ROOT}) has a blank or a special character, which the build tools "
            "of ROS 2 do not bear: move the folder."
        )
    compilers = (("C++", "CXX", ("g++", "c++", "clang++")), ("C", "CC", ("gcc", "cc", "clang")))
    for language, variable, names in compilers:
        if not any(map(shutil.which, os.environ.get(variable, "").split()[:1] or names)):
            found.append(
                f"There is no {language} compiler on the PATH, the messages cannot be built: install one "
                "(Debian, Ubuntu: 'sudo apt install g++')."
            )
            break
    if not os.access(ROOT, os.W_OK):
        found.append(f"The folder {ROOT} cannot be written: change its owner or clone it to a folder of yours.")
    if not os.path.exists(os.path.join(VENV, "pyvenv.cfg")):
        temporary = os.environ.get("TMPDIR", "/tmp")
        for folder, needed in ((ROOT, DISK_NEEDED[source]), (temporary, TEMPORARY_NEEDED)):
            free = shutil.disk_usage(folder).free if os.path.isdir(folder) else needed
            if free < needed:
                found.append(
                    f"The disk of {folder} has {free / 1e9:.1f} GB free and the set-up needs "
                    f"{needed / 1e9:.1f} GB: make room" + (" or set TMPDIR." if folder == temporary else ".")
                )
    return found
