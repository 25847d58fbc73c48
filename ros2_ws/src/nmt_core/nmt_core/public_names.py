"""Public names of a package that are loaded when asked for, so that importing the package costs nothing."""

from __future__ import annotations

import importlib
import sys
from functools import cache
from pathlib import Path
from typing import Any


def loaded(package: str, name: str) -> Any:
    """The object of a public name, from where the package imports it for type checkers; for its ``__getattr__``.

    Args:
        package: the package that was asked.
        name: what for.

    Raises:
        AttributeError: the package has no such public name.
    """
    home = _homes(package).get(name) if name in sys.modules[package].__all__ else None
    if home is None:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    module, own = home
    return getattr(importlib.import_module(module), own)


@cache
def _homes(package: str) -> dict[str, tuple[str, str]]:
    """Module and name of each import for type checkers alone."""
    import ast

    tree = ast.parse(Path(str(sys.modules[package].__file__)).read_text(encoding="utf-8"))
    checked = [item for node in tree.body if isinstance(node, ast.If) for item in node.body]
    return {
        alias.asname or alias.name: (str(item.module), alias.name)
        for item in checked
        if isinstance(item, ast.ImportFrom)
        for alias in item.names
    }
