"""What a user can get wrong on the command line: one sentence, exit code 2, nothing left behind."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from nmt_bench.cli import main
from nmt_rig.rig import find_rig

BEAM = find_rig("beam").read_text(encoding="utf-8")


def altered(old: str, new: str) -> str:
    assert BEAM.count(old) >= 1, old
    return BEAM.replace(old, new, 1)


RIGS = {
    "empty": ("", "empty|mapping|missing"),
    "not yaml": ("structure: [1, 2", "line 1"),
    "a list": ("- a\n- b\n", "mapping"),
    "binary": ("\x00\x01\x02", "YAML|text|character"),
    "tab indent": (altered("  kind: beam", "\tkind: beam"), r"line \d+"),
    "unknown key": (altered("  width_m:", "  widht_m:"), r"line \d+.*widht_m.*width_m"),
    "duplicate key": (altered("  elements: 7", "  elements: 7\n  elements: 8"), r"line \d+.*elements"),
    "nan": (altered("  length_m: 0.7", "  length_m: .nan"), r"line \d+.*length_m.*finite"),
    "infinite": (altered("  length_m: 0.7", "  length_m: .inf"), r"line \d+.*length_m.*finite"),
    "negative": (altered("  resistance_ohm: 3.0", "  resistance_ohm: -3"), r"line \d+.*resistance_ohm.*positive.*-3"),
    "zero": (altered("density_kg_m3: 7830", "density_kg_m3: 0"), r"line \d+.*density_kg_m3.*positive"),
    "text for a number": (altered("  length_m: 0.7", "  length_m: 70 cm"), r"line \d+.*length_m.*number"),
    "comma decimal": (altered("  length_m: 0.7", "  length_m: 0,7"), r"line \d+.*length_m"),
    "wrong unit name": (altered("  length_m: 0.7", "  length_mm: 700"), r"line \d+.*length_mm.*length_m"),
    "unknown kind": (altered("kind: jenkins", "kind: jenkin"), r"line \d+.*jenkin"),
    "point off the beam": (altered("    point: 3 ", "    point: 9 "), r"line \d+.*point.*9.*1 to 7"),
    "no force sensor": (altered("  - {quantity: force, point: drive}\n", ""), "force sensor"),
    "channel twice": (altered("{quantity: displacement, point: 4}", "{quantity: displacement, point: 2}"), "x2"),
    "too many modes": (altered("linear_modes: 2", "linear_modes: 9"), "linear_modes"),
    "missing section": (altered("exciter:", "exiter:"), "exiter|exciter"),
    "unknown loop setting": (altered("pll: {}", "pll: {gian: 3}"), "gian"),
    "loop setting out of range": (altered("pll: {}", "pll: {phase_tolerance: -1}"), "phase_tolerance"),
    "fractional block": (altered("seed: 1\n", "seed: 1\nblock_samples: 200.5\n"), r"line \d+.*block_samples.*whole"),
    "levels of letters": (altered('"0.05:1.5:10"', '"a:b:c"'), "levels"),
}


@pytest.mark.parametrize("name", sorted(RIGS))
def test_a_malformed_rig_file(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, sentence = RIGS[name]
    rig = tmp_path / "my_rig.yaml"
    rig.write_text(text, encoding="utf-8")
    refused(["run", str(rig), "--out", str(tmp_path / "out")], sentence, capsys, tmp_path / "out")


RUNS = {
    "no such rig": (["run", "baem"], "baem.*beam"),
    "no such file": (["run", "nowhere/rig.yaml"], "nowhere"),
    "levels backwards syntax": (["run", "beam", "--levels", "1:2"], "not a plan"),
    "levels zero": (["run", "beam", "--levels", "0:1:5"], "positive"),
    "levels nan": (["run", "beam", "--levels", "nan,1"], "positive and finite"),
    "levels words": (["run", "beam", "--levels", "low,high"], "not a number"),
    "levels none": (["run", "beam", "--levels", "0.1:1:0"], "number of levels"),
    "levels too many": (["run", "beam", "--levels", "0.1:1:100000"], "number of levels"),
    "exciter off the beam": (["run", "beam", "--exciter", "12"], "12.*1 to 7"),
    "exciter not a number": (["run", "beam", "--exciter", "tip"], "invalid int"),
    "override of nothing": (["run", "beam", "--set", "exciter.colour=red"], "colour"),
    "override without value": (["run", "beam", "--set", "seed"], "seed"),
    "window of one period": (["run", "beam", "--periods", "1"], "at least 3 periods"),
    "negative ramp": (["run", "beam", "--ramp", "-1"], "ramp"),
    "unknown pacing": (["run", "beam", "--pacing", "warp"], "warp"),
    "unknown option": (["run", "beam", "--speed", "9"], "--speed"),
    "domain out of range": (["run", "beam", "--domain", "500"], "domain"),
}


@pytest.mark.parametrize("name", sorted(RUNS))
def test_a_malformed_run(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words, sentence = RUNS[name]
    refused([*words, "--out", str(tmp_path / "out")], sentence, capsys, tmp_path / "out")


@pytest.mark.parametrize("command", ["run", "linear", "reference"])
@pytest.mark.parametrize("ending", [".xml", ".urdf", ".MJCF"])
def test_a_robot_is_sent_where_robots_go(
    command: str, ending: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = tmp_path / f"good{ending}"
    robot.write_text("<mujoco><worldbody/></mujoco>", encoding="utf-8")
    sentence = r"robot's file.*diagnose --model .*good.* --real LOG"
    refused([command, str(robot), "--out", str(tmp_path / "out")], sentence, capsys, tmp_path / "out")


def bag_of(kind: str, folder: Path) -> Path:
    """A thing that is not a usable bag."""
    path = folder / "bag"
    if kind == "missing":
        return path
    if kind in ("empty folder", "wrong metadata"):
        path.mkdir()
        if kind == "wrong metadata":
            (path / "metadata.yaml").write_text("rosbag2_bagfile_information: 3\n")
            (path / "bag_0.mcap").write_bytes(b"")
        return path
    contents = {
        "empty file": b"",
        "ros 1 bag": b"#ROSBAG V2.0\n" + bytes(4096),
        "text": b"hello world\n" * 50,
        "only the magic": b"\x89MCAP0\r\n",
        "noise": bytes(range(256)) * 64,
    }
    path = folder / "thing.mcap"
    path.write_bytes(contents[kind])
    return path


@pytest.mark.parametrize(
    "kind", ["missing", "empty folder", "wrong metadata", "empty file", "ros 1 bag", "text", "only the magic", "noise"]
)
def test_a_bag_that_is_none(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = bag_of(kind, tmp_path)
    refused(["extract", str(bag), "--out", str(tmp_path / "out")], bag.name, capsys, tmp_path / "out")


def test_a_folder_with_results_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "precious.txt").write_text("keep")
    assert main(["run", "beam", "--out", str(out)]) == 2
    assert "not empty" in capsys.readouterr().err
    assert [path.name for path in out.iterdir()] == ["precious.txt"]
    shutil.rmtree(out)


def refused(words: list[str], sentence: str, capsys: pytest.CaptureFixture[str], out: Path) -> None:
    import re

    assert main(words) == 2
    captured = capsys.readouterr()
    message = captured.err.strip()
    assert "Traceback" not in message
    assert len(message.splitlines()) == 1
    assert re.search(sentence, message), message
    assert not out.exists()
