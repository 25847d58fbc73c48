"""Sixty texts drawn at random: none is read wrong in silence, and no proposal is refused by the import."""

from __future__ import annotations

from pathlib import Path

import pytest
from record.generated_texts import judged, made
from tiers import with_quick

TEXTS, PARTS = 60, 4


@pytest.mark.parametrize("part", with_quick(range(PARTS), 0))
def test_a_text_is_read_right_or_asked_about(part: int, tmp_path: Path) -> None:
    results = [judged(made(seed, tmp_path)) for seed in range(part, TEXTS, PARTS)]
    assert not [answers for result, answers in results if result == "refused"]
