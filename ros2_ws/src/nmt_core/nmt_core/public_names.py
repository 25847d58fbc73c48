"""Public names of a package that are loaded when asked for, so that importing the package costs nothing."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any


def loaded(package: str, name: str, homes: Mapping[str, str]) -> Any:
    """The object of a public name; for the ``__getattr__`` of a package.

    Args:
        package: the package that was asked.
        name: what for.
        homes: the module that each public name comes from; ``module:name`` where it has another name there.

    Raises:
        AttributeError: the package has no such public name.
    """
    home = homes.get(name)
    if home is None:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    module, _, own = home.partition(":")
    return getattr(importlib.import_module(module), own or name)
