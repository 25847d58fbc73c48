"""Command line, orchestration, harness, and what they put together.

Import what you need from its module, so that ``./nmt --help`` loads none of it:

* :mod:`nmt_bench.harness`: ``Bench``, the nodes from Python; needs ROS 2.
* :mod:`nmt_bench.cli`: the commands; one module each, ``*_command``.

Without ROS, loaded when asked for: :func:`import_data`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nmt_core.public_names import loaded

if TYPE_CHECKING:
    from nmt_bench.data_import import import_data

__all__ = ["import_data"]


def __getattr__(name: str) -> Any:
    return loaded(__name__, name)
