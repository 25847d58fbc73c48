"""Text of values as YAML, with libyaml and without."""

from __future__ import annotations

import importlib
import random
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

import nmt_rig
from nmt_core.files import yaml_text as module
from nmt_core.files.hardened import BoundedYaml, fast_loader, yaml_value
from nmt_core.files.yaml_document import parse_document, yaml_mapping
from nmt_rig.rig import load_rig

RIGS = Path(nmt_rig.__file__).parent / "rigs"

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


def test_texts_that_one_version_of_yaml_takes_for_numbers_stay_texts(yaml_text):
    words = ["190:20:30", "010", "08", "0o17", "1_000", "0b11", "1e-4", "12", "1:15:10"]
    text = yaml_text({"words": words})
    assert yaml.safe_load(text)["words"] == words
    assert parse_document(text, "x").values["words"] == words


@pytest.mark.parametrize("separator", [":", ",", "_"])
def test_a_number_is_decimal_and_a_plan_is_a_text(separator: str) -> None:
    generator = random.Random(separator)
    for _ in range(40):
        parts = [str(generator.randrange(1, 60)) for _ in range(3)]
        plan, zeros = separator.join(parts), f"00{parts[0]}"
        document = parse_document(f"plan: {plan}\nnumber: {zeros}", "x")
        assert document.values == {"plan": plan, "number": int(parts[0])}
        assert yaml_value(f"plan: {plan}\nnumber: {zeros}", "x") == document.values


def test_other_types_are_refused(yaml_text):
    with pytest.raises(yaml.YAMLError):
        yaml_text({"object": object()})


BY_HAND = """\
# A file by hand: ä, µ
name: "a \\u00b5 b"   # quoted
numbers: {one: 1e-4, two: 1.0E+3, three: 0x1f, four: 1_000, time: 12:30:00, date: 2026-03-01, none: ~}
words: [yes, 'it''s', plain words, on, -, .inf]
text: |
  first

  second
folded: >-
  goes on
  here
nested:
- {a: [1, 2, {b: c}]}
-
  key : value
"""


@pytest.mark.parametrize("file", ["", "frame.yaml", "clamped_beam.yaml"])
def test_both_parsers_read_a_file_by_hand_alike(file: str) -> None:
    text = (RIGS / file).read_text(encoding="utf-8") if file else BY_HAND
    one, other = (yaml_mapping(loader(text), "x", "file", "") for loader in (BoundedYaml, fast_loader()))
    assert one == other
    assert len(one.places) > 20
