"""The map of packages shows what there is, in the order that import-linter holds."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "explanation" / "architecture.md").read_text()


def test_map_is_that_of_the_import_contract() -> None:
    contract = (ROOT / ".importlinter").read_text()
    layers = re.search(r"^layers =\n((?: +.+\n)+)", contract, re.M)
    assert layers
    shown = re.search(r"## The map\n\n```\n(.*?)```", PAGE, re.S)
    assert shown
    assert shown[1].split() == layers[1].split()


def test_every_package_is_described() -> None:
    packages = sorted(path.parent.name for path in ROOT.glob("ros2_ws/src/*/package.xml"))
    packages = sorted([*packages, *(path.parent.name for path in ROOT.glob("campaigns/*/package.xml"))])
    assert packages
    described = re.findall(r"^\| (nmt(?:_\w+)?) \| \S", PAGE, re.M)
    assert sorted(described) == packages
