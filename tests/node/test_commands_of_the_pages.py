"""Commands of README and tutorial that start nodes run, with short plans and all nodes in one process."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
import yaml
from docs.test_command_blocks import BLOCK, ROOT, block_lines, words_of

from nmt_bench.cli import main
from nmt_bench.page.page_process import page_process
from nmt_rig.rig import find_rig

pytest.importorskip("rclpy")
pytestmark = pytest.mark.campaign

TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")
ROW = re.compile(r"^ *(\d[\d.]*) +(\S+) +(\S+) +(\S+) +(\S+) ", re.M)
"""Level, frequency, damping ratio, modal amplitude and force of a row of the table."""


def command(text: str, beginning: str) -> list[str]:
    """Words of the one command of a page that begins so."""
    found = [words_of(line) for line in block_lines(text) if line.removeprefix("./nmt ").startswith(beginning)]
    assert len(found) == 1, f"{beginning}: {found}"
    return found[0]


def changed(words: list[str], **values: str) -> list[str]:
    """The command with other values of some options."""
    words = list(words)
    for name, value in values.items():
        option = f"--{name}"
        if option in words:
            words[words.index(option) + 1] = value
        else:
            words += [option, value]
    return [*words, "--one-process", "--quiet"]


def rows(text: str) -> dict[str, tuple[str, ...]]:
    """Rows of a table of modal properties: level -> what is printed for it."""
    return {match[1]: match.groups()[1:] for match in ROW.finditer(text)}


def test_the_first_row_of_the_demo_is_that_of_the_tutorial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The demo's first level, then its own commands for a second extraction and figures."""
    monkeypatch.chdir(tmp_path)
    shown = rows(TUTORIAL)
    assert next(iter(shown)) == "0.05"
    demo = ["run", "beam", "--out", "out/demo", "--no-report", "--reference", "none"]
    assert main(changed(demo, levels="0.05,0.0507")) == 0
    printed = rows(capfd.readouterr().out)
    assert printed["0.05"] == shown["0.05"]
    assert main([*command(TUTORIAL, "extract out/demo --out"), "--no-report"]) == 0
    assert "Equal to the live results bit for bit (2 of 2 levels compared)." in capfd.readouterr().out


def test_the_run_of_the_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = command(README, "run beam")
    assert main([*changed(words, levels="0.5", periods="20"), "--no-report"]) == 0
    point = json.loads((tmp_path / "out" / "point4" / "modal.json").read_text(encoding="utf-8"))
    assert len(point["points"]) == 1


def test_the_sweep_of_the_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = changed(command(README, "sweep joint_resonator"), force="14.65", to="352", rate="2")
    assert main([*words, "--reference", "none"]) == 0
    assert (tmp_path / "out" / "sweep" / "frf.csv").exists()


SHORTER: dict[str, dict[str, str]] = {
    "run beam": {"levels": "0.05,0.4", "periods": "20"},
    "run beam --exciter 6": {"levels": "2,10"},
    "run beam --set structure.added_masses": {},  # the diagnosis needs its levels
    "run duffing.yaml": {"levels": "0.1,0.2", "periods": "20"},
    "run duffing.yaml --set": {},  # as the reader's data
    "run out/why/model.yaml": {"levels": "0.1,0.2", "periods": "20"},
    "run joint_resonator": {"levels": "0.5,1", "periods": "20"},
    "linear joint_resonator": {"duration": "20"},
    "sweep joint_resonator": {"force": "14.65", "from": "360", "to": "372", "rate": "2"},
    "run strong_cubic": {"levels": "4.8"},
    "run beam --pacing realtime": {"levels": "0.2", "periods": "20"},
}
"""Beginning of a command -> what is changed that it takes less time; of several beginnings the longest."""


def follow(line: str) -> int:
    """Do what a line of the tutorial says, shorter where it may be; returns the exit code."""
    words = ["run", "beam", "--out", "out/demo"] if line == "./nmt demo" else words_of(line)
    if words[0] in ("run", "linear", "sweep"):
        fitting = [key for key in SHORTER if " ".join(words).startswith(key)]
        values = SHORTER[max(fitting, key=len)] if fitting else {}
        words = [word for word in changed(words, **values) if word != "--one-process" or "--page" not in words]
    return main(words)


@pytest.mark.timeout(1200)
def test_every_command_of_the_tutorial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """In a folder that holds the guide's rig and nothing else, in the order of the page."""
    monkeypatch.chdir(tmp_path)
    guide = (ROOT / "docs" / "how-to" / "write-a-rig-file.md").read_text(encoding="utf-8")
    complete = re.search(r"```yaml\n(name:.*?)```", guide, re.S)
    assert complete is not None
    Path("duffing.yaml").write_text(complete[1], encoding="utf-8")
    printed = {}
    for line in re.findall(r"^(?:cp|\./nmt) .*", "\n".join(match[2] for match in BLOCK.finditer(TUTORIAL)), re.M):
        if line.startswith("cp "):
            shutil.copy(*line.split()[1:])
        elif line.startswith("./nmt page "):
            with page_process(Path("page.log"), tuple(words_of(line)[1:]), lines=1) as served:
                assert served.lines[0].startswith("Page (works once): http://127.0.0.1:")
        elif line not in ("./nmt shell",) and not re.match(r"\./nmt \w+: ", line):
            refused = f"{line}\n{line.partition(' --')[0].rpartition(' ')[0]}: " in TUTORIAL
            assert follow(line) == (2 if refused else 0), line
            printed[line] = capfd.readouterr().out
        if "--init" in line:
            sidecar = Path("measured.yaml").read_text(encoding="utf-8")
            (asked,) = re.findall(r"in the place of the line `(# rig: my_rig\.yaml) …` write", TUTORIAL, re.I)
            (answer,) = re.findall(r"^rig: .*", TUTORIAL, re.M)
            Path("measured.yaml").write_text(re.sub(rf"{asked}.*", answer, sidecar), encoding="utf-8")
    (why,) = (text for line, text in printed.items() if line.startswith("./nmt diagnose --model duffing.yaml"))
    for sentence in re.findall(r"^(?:Verdict|Where).*", TUTORIAL, re.M):
        assert sentence in why
    (stiffness,) = re.findall(r"comes out as (\(\S+ ± \S+\)·10⁹ N/m³)", TUTORIAL)
    assert stiffness in why
    (linear,) = (text for line, text in printed.items() if line.startswith("./nmt linear"))
    assert "Linear modes: value ± standard uncertainty" in linear
    (mass,) = (text for line, text in printed.items() if line.startswith("./nmt diagnose --model beam"))
    (verdict,) = re.findall(r"^Verdict: (.*)", mass, re.M)
    assert verdict == "the model lacks sensor mass or added mass (a response sensor, channel x5)"


def test_the_diagnosis_of_the_guide_prints_what_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The rig file as the page changes it, the three commands in full, and the sample beside what is printed."""
    monkeypatch.chdir(tmp_path)
    guide = (ROOT / "docs" / "how-to" / "diagnose.md").read_text(encoding="utf-8")
    asked = re.search(r"```yaml\n(local_elements:.*?)```", guide, re.S)
    sample = re.search(r"```\n(Verdict: .*?)```", guide, re.S)
    assert asked is not None
    assert sample is not None
    changes = yaml.safe_load(asked[1])
    content = yaml.safe_load(find_rig("beam").read_text(encoding="utf-8"))
    content["local_elements"] += changes["local_elements"]
    noise = {own["quantity"]: own for own in changes["sensors"]}
    for sensor in content["sensors"]:
        own = noise.get(sensor["quantity"], {})
        sensor.update({name: value for name, value in own.items() if name.startswith("noise_")})
    (tmp_path / "real.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    for words in (command(guide, "run real.yaml"), command(guide, "linear real.yaml")):
        assert main([*words, "--one-process", "--quiet", *(["--no-report"] if words[0] == "run" else [])]) == 0
    monkeypatch.setenv("COLUMNS", "160")
    capfd.readouterr()
    words = [words_of(line) for line in block_lines(guide) if "--real random --out diagnosis" in line]
    assert main(words[-1]) == 0
    printed = capfd.readouterr().out
    (verdict,) = re.findall(r"^Verdict: (.*)", sample[1], re.M)
    assert re.findall(r"^Verdict: (.*)", printed, re.M) == [verdict]
    shown, found = (re.findall(r"[█▏▎▍▌▋▊▉]+ +(\d+) % +(\S+(?: \S+)*)", text) for text in (sample[1], printed))
    assert [name for _, name in found[: len(shown)]] == [name for _, name in shown]
    for (ours, _), (theirs, _) in zip(found, shown, strict=False):
        assert abs(int(ours) - int(theirs)) <= 2
    stiffness = [re.findall(r"k = \((\S+) ± (\S+)\)", text)[0] for text in (sample[1], printed)]
    assert abs(float(stiffness[0][0]) - float(stiffness[1][0])) < 2.0 * float(stiffness[0][1])
