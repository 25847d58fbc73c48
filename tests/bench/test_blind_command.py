"""``./nmt blind`` refuses in one sentence, and its parts fit together."""

from __future__ import annotations

from pathlib import Path

import pytest

from nmt_bench.cli import main


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("make", "--cases", "2", "--seed", "3"), "odd"),
        (("make", "--cases", "2", "--seed", "2", "--sealed"), "even"),
        (("make", "--cases", "2", "--seed", "2", "--kinds", "nul"), "no kind of case"),
        (("make", "--cases", "0", "--seed", "2"), "at least one"),
        (("run", "--jobs", "0"), "--jobs must be at least 1"),
        (("run",), "no blind cases"),
        (("score",), "no blind cases"),
        (("rigs", "--seeds", "0:99999999999"), "10000 rigs at most"),
        (("rigs", "--seeds", "0:10001"), "10000 rigs at most"),
    ],
)
def test_refusals_are_sentences(
    words: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["blind", *words, "--out", str(tmp_path / "check")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "check").exists()


def test_a_part_is_needed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["blind"]) == 2
    assert "PART" in capsys.readouterr().err
