"""``./nmt linear`` and ``--linear``: what is refused before anything starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from nmt_bench.cli import main
from nmt_bench.commands.linear_input import check_fits, read_linear
from nmt_core.errors import BenchError
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "either a rig"),
        (["beam", "--bag", "somewhere"], "either a rig"),
        (["beam", "--band", "10-2000"], "LOW:HIGH"),
        (["beam", "--band", "2000:10"], "LOW < HIGH"),
        (["beam", "--band", "10:5000"], "5000"),
        (["beam", "--level", "0"], "--level must be positive"),
        (["beam", "--level", "nan"], "--level must be positive"),
        (["beam", "--level", "20"], "beyond"),
        (["beam", "--duration", "0"], "duration"),
        (["--bag", "nowhere"], "no bag at nowhere"),
        (["wing"], "there is no rig wing"),
    ],
)
def test_a_wrong_option_is_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rclpy")
    out = tmp_path / "out"
    assert main(["linear", *words, "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not out.exists()


def test_a_linear_description_from_a_file(tmp_path: Path) -> None:
    rig = load_rig("beam")
    linear = linear_description(rig)
    (tmp_path / "linear.json").write_text(linear.to_json(), encoding="utf-8")
    assert read_linear(tmp_path) == read_linear(tmp_path / "linear.json") == linear
    check_fits(linear, rig, "linear.json")
    with pytest.raises(BenchError, match="exciter at point 2"):
        check_fits(linear, load_rig("beam", ["exciter.point=5"]), "linear.json")
    with pytest.raises(BenchError, match="no acceleration sensor"):
        check_fits(linear, load_rig("beam", ["extraction.quantity=acceleration", "extraction.linear_modes=1"]), "file")


@pytest.mark.parametrize("text", ["", "[1]", "{}", '{"points": 3}', "not json"])
def test_a_file_that_is_no_linear_description(text: str, tmp_path: Path) -> None:
    path = tmp_path / "linear.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BenchError, match=r"linear\.json"):
        read_linear(path)
    with pytest.raises(BenchError, match="cannot be read"):
        read_linear(tmp_path / "nothing.json")
