"""Each package shows its public names, and loads them only when they are asked for."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys

import pytest

PACKAGES = ("nmt_rig", "nmt_record", "nmt_extract", "nmt_diagnose", "nmt_report", "nmt_blind", "nmt_bench", "nmt")


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_is_there_and_documented(name: str) -> None:
    package = importlib.import_module(name)
    modules = {module.name for module in pkgutil.iter_modules(package.__path__)}
    assert package.__all__ == sorted(package.__all__)
    for public in package.__all__:
        assert getattr(package, public).__doc__
        # A module of that name would take its place once it is imported.
        assert public not in modules
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        package.nothing  # noqa: B018


def test_importing_the_packages_loads_nothing_heavy() -> None:
    heavy = ("scipy", "numba", "matplotlib", "jinja2", "pydantic")
    code = f"import sys, {', '.join(PACKAGES)}; print(*[name for name in {heavy!r} if name in sys.modules])"
    path = [path for path in sys.path if path]
    answer = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {path!r}; {code}"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout.strip() == ""
