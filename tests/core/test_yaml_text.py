"""Text of values as YAML, with libyaml and without."""

from __future__ import annotations

import importlib
from collections.abc import Iterator

import pytest
import yaml

from nmt_core.files import yaml_text as module
from nmt_rig.rig import load_rig

SHARED = [1, 2]
VALUE = {
    "text": "many words " * 30 + "δ̃ = 0.1 % of ω̃²q\nand a second line\t'quoted' \"twice\": # no comment",
    "numbers": [0, -1, 1e-12, 2.5e300, float("inf"), 0.1],
    "like others": ["yes", "null", "1e3", "0x1F", "", " ", "2026-01-01"],
    "none": None,
    "true": True,
    "twice": [SHARED, SHARED],
    "rig": load_rig("beam").model_dump(mode="json"),
}


@pytest.fixture(params=["libyaml", "PyYAML alone"])
def yaml_text(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[object]:
    if request.param == "PyYAML alone":
        monkeypatch.delattr(yaml, "CSafeDumper", raising=False)
    yield importlib.reload(module).yaml_text
    monkeypatch.undo()
    importlib.reload(module)


@pytest.mark.parametrize("ascii_only", [False, True])
@pytest.mark.parametrize("sort_keys", [False, True])
def test_the_text_loads_to_the_value(yaml_text, sort_keys, ascii_only):
    text = yaml_text(VALUE, sort_keys=sort_keys, ascii_only=ascii_only)
    found = yaml.safe_load(text)
    assert found == VALUE
    assert list(found) == (sorted(VALUE) if sort_keys else list(VALUE))
    assert text.isascii() == ascii_only
    assert "&id" not in text


def test_other_types_are_refused(yaml_text):
    with pytest.raises(yaml.YAMLError):
        yaml_text({"object": object()})
