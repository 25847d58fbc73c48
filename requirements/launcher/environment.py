"""The environments in which programs run: of the set-up, of the build, of every command."""

from __future__ import annotations

import glob
import os
from typing import Any

from .places import BUILD, INSTALL, SOURCE, STATE_FOLDER, VENV
from .stamps import packages

WHEELS_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"  # tells the wheels' start-up hook that the paths are set


def clean_environment(source: str) -> dict[str, str]:
    """The caller's environment with the venv first, without what another venv, Python or ROS 2 left in it."""
    environment = dict(os.environ)
    for name in (
        "PYTHONHOME",
        "PYTHONSTARTUP",
        "PIP_TARGET",
        "PIP_PREFIX",
        "PIP_REQUIRE_VIRTUALENV",
        WHEELS_GUARD,
    ):
        environment.pop(name, None)
    environment.update(VIRTUAL_ENV=VENV, PYTHONNOUSERSITE="1", PIP_USER="0")
    old_path = [folder for folder in environment.get("PATH", os.defpath).split(os.pathsep) if folder]
    environment["PATH"] = os.pathsep.join(
        [os.path.join(VENV, "bin"), *(f for f in old_path if f != os.path.join(VENV, "bin"))]
    )
    if source == "wheels":
        for name in (
            "PYTHONPATH",
            "AMENT_PREFIX_PATH",
            "CMAKE_PREFIX_PATH",
            "COLCON_PREFIX_PATH",
            "AMENT_CURRENT_PREFIX",
            "ROS_DISTRO",
            "ROS_VERSION",
            "ROS_PYTHON_VERSION",
            "RMW_IMPLEMENTATION",
        ):
            environment.pop(name, None)
        # Libraries of another ROS 2 would win over those of the wheels; those of a measuring card may stay.
        libraries = [f for f in environment.pop("LD_LIBRARY_PATH", "").split(os.pathsep) if f and not holds_ros(f)]
        if libraries:
            environment["LD_LIBRARY_PATH"] = os.pathsep.join(libraries)
    return environment


def holds_ros(folder: str) -> bool:
    """Whether a folder of libraries belongs to a ROS 2, to its wheels or to a workspace's messages."""
    patterns = (
        "librcutils*",
        "lib*__rosidl_typesupport_c*",
        os.path.join("python3*", "site-packages", "ros_*.libs"),
    )
    return os.path.basename(folder).startswith("ros_") or any(glob.glob(os.path.join(folder, p)) for p in patterns)


def prepend(environment: dict[str, str], name: str, folders: list[str]) -> None:
    """Put folders at the front of a search path, without duplicates."""
    old = [f for f in environment.get(name, "").split(os.pathsep) if f]
    environment[name] = os.pathsep.join(folders + [f for f in old if f not in folders])


def ros_environment(source: str) -> dict[str, str]:
    """The clean environment with ROS 2 where it is found: in the venv, or as it was sourced."""
    environment = clean_environment(source)
    if source == "wheels":
        environment.update(AMENT_PREFIX_PATH=VENV, CMAKE_PREFIX_PATH=VENV, CMAKE_GENERATOR="Ninja")
    return environment


def build_environment(source: str) -> dict[str, str]:
    """Environment of ``colcon build``."""
    environment = ros_environment(source)
    cores = str(len(os.sched_getaffinity(0)))
    environment.setdefault("MAKEFLAGS", "-j" + cores)  # without it colcon waits for the machine to be idle
    environment.setdefault("CMAKE_BUILD_PARALLEL_LEVEL", cores)
    environment["COLCON_DEFAULTS_FILE"] = os.path.join(STATE_FOLDER, "colcon-defaults.yaml")  # not the user's
    # Each package is a process or more: without byte code each would compile the tools that build it.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    return environment


def command_environment(state: dict[str, Any]) -> dict[str, str]:
    """Environment of every command: the venv, ROS 2, and the workspace as its ``setup.bash`` would set it.

    Discovery stays on this host and each process keeps to one BLAS thread unless the caller says otherwise:
    the nodes of a bench share the cores.
    """
    source, version = str(state["source"]), str(state["python"])
    environment = ros_environment(source)
    prefixes = [os.path.join(INSTALL, name) for name in packages()]
    site = [os.path.join(prefix, "lib", f"python{version}", "site-packages") for prefix in prefixes]
    linked = [os.path.join(BUILD, name) for name in packages() if glob.glob(os.path.join(BUILD, name, "*.egg-info"))]
    libraries = [os.path.join(prefix, "lib") for prefix in prefixes if glob.glob(os.path.join(prefix, "lib", "*.so"))]
    if source == "wheels":
        # The wheels would restart each Python once to set this path; set beforehand it saves the restart.
        libraries.append(os.path.join(VENV, "lib"))
        libraries += sorted(glob.glob(os.path.join(VENV, "lib", f"python{version}", "site-packages", "ros_*.libs")))
        environment[WHEELS_GUARD] = "1"
        environment["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
    prepend(environment, "AMENT_PREFIX_PATH", prefixes)
    prepend(environment, "CMAKE_PREFIX_PATH", prefixes)
    prepend(environment, "PYTHONPATH", linked + [folder for folder in site if os.path.isdir(folder)])
    prepend(environment, "LD_LIBRARY_PATH", libraries)
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # A lost datagram is sent again within 50 ms; see docs/decisions/007-lost-datagrams.md.
    environment.setdefault(
        "FASTRTPS_DEFAULT_PROFILES_FILE", os.path.join(SOURCE, "nmt_core", "nmt_core", "fastdds.xml")
    )
    environment.setdefault("RMW_FASTRTPS_USE_QOS_FROM_XML", "1")
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        environment.setdefault(name, "1")
    if not (environment.get("HOME") or environment.get("ROS_LOG_DIR")):  # rclpy does not start without either
        environment["ROS_LOG_DIR"] = os.path.join(STATE_FOLDER, "ros_log")
    return environment
