"""The launcher ``./nmt``: sets up what is missing, then runs the command. Standard library only.

It stands outside the workspace because it makes the environment in which the workspace is built and run. The set-up has
four steps:

    environment    .venv, with the Python that runs ``./nmt`` (or NMT_PYTHON, or one found on the PATH)
    requirements   the lock file requirements/lock/<source>-<version>.txt, every file checked by its hash
    workspace      colcon build of ros2_ws/src and campaigns into ros2_ws/install, by links: Python edits are live
    kernels        the compiled numerical kernels are cached

Each finished step leaves a stamp in .nmt/setup.json: the digest of what it was made from. A later call
compares the digests (a few milliseconds) and does again only what changed; an interrupted set-up goes on
where it stopped.

ROS 2 Jazzy comes from wheels of the Python package index, or from the system where one is sourced
(NMT_ROS=wheels or NMT_ROS=system decides; a set-up keeps the source it was made with). Everything past the
set-up runs in one environment, see :func:`environment.command_environment`.

``commands`` (what is typed) calls ``set_up`` (the four steps) or ``doctor``. A step each: ``virtual_environment``,
``requirements``, ``workspace``, ``kernels``. Below them ``programs`` and ``progress`` (a program under way),
``environment``, ``machine`` (what this machine offers), ``distributions`` (what is installed), ``stamps`` (what is
done) and ``places``.
"""
