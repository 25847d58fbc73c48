"""What pydantic finds wrong becomes one sentence with file, line, key and remedy."""

from __future__ import annotations

from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nmt_core.files.validation_sentence import validation_sentence
from nmt_core.files.yaml_document import parse_document


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class Spring(_Section):
    kind: Literal["spring"]
    stiffness: Annotated[float, Field(gt=0)]


class Gap(_Section):
    kind: Literal["gap"]
    width: Annotated[float, Field(ge=0, le=1)]
    limits: Annotated[list[float], Field(min_length=2, max_length=2)] = [0.0, 1.0]


class Thing(_Section):
    name: str
    parts: list[Annotated[Spring | Gap, Field(discriminator="kind")]] = []
    either: list[Spring | Gap] = []
    locked: bool = False


def sentence_of(text: str, **options: object) -> str:
    document = parse_document(text, "thing.yaml", "thing", "name")
    with pytest.raises(ValidationError) as failure:
        Thing.model_validate(document.values)
    errors = failure.value.errors(include_url=False)
    return validation_sentence(errors, document, Thing, "the thing", **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("nam: a", "thing.yaml line 1: unknown key nam; did you mean name? (1 more like this)"),
        ("locked: true", "thing.yaml line 1: name is missing; add it."),
        ("name: 3", "thing.yaml line 1: name must be a text, got 3."),
        ("name: a\nlocked: 3", "thing.yaml line 2: locked must be true or false, got 3."),
        ("name: a\nparts:\n- {kind: rope}", "line 3: parts.0.kind must be one of 'spring', 'gap'; got 'rope'."),
        ("name: a\nparts:\n- {width: 1.0}", "line 3: parts.0.kind must be one of 'spring', 'gap'; it is missing."),
        ("name: a\nparts:\n- kind: spring\n  stiffness: 0.0", "line 4: parts.0.stiffness must be positive, got 0.0."),
        ("name: a\nparts:\n- kind: gap\n  width: -1.0", "line 4: parts.0.width must not be negative, got -1.0."),
        ("name: a\nparts:\n- kind: gap\n  width: 2.0", "line 4: parts.0.width must be at most 1, got 2.0."),
        ("name: a\nparts:\n- kind: gap\n  width: .inf", "line 4: parts.0.width must be a finite number, got inf."),
        (
            "name: a\nparts:\n- kind: gap\n  width: 0,5",
            "line 4: parts.0.width must be a number, got '0,5'; write the decimal sign as a point.",
        ),
        ("name: a\nparts:\n- {kind: gap, width: 0.5, limits: [1.0]}", "parts.0.limits has too few entries, got 1."),
        ("name: a\nparts:\n- {kind: gap, width: 0.5, hue: 1}", "parts.0.hue; known keys are kind, width, limits."),
        ("name: a\nparts:\n- {kind: gap, width: 0.5, witdh: 1}", "unknown key parts.0.witdh; did you mean width?"),
    ],
)  # fmt: skip
def test_a_sentence_for_every_kind_of_mistake(text: str, sentence: str) -> None:
    assert sentence in sentence_of(text)


def test_a_union_that_names_no_kind_offers_the_keys_of_all() -> None:
    assert "known keys are kind, stiffness, width, limits." in sentence_of("name: a\neither:\n- {zzz: 1}")


def test_own_words_and_remedies() -> None:
    assert "add it (such as: a)." in sentence_of("locked: true", remedies={"name": "such as: a"})
    assert "name is not a name, got 3." in sentence_of("name: 3", words={"string_type": "is not a name"})


def test_long_values_are_cut() -> None:
    shown = sentence_of(f"name: a\nlocked: {'x' * 200}").rpartition("got ")[2]
    assert len(shown) == len("'...") + 57
