"""The command line: help for everything, one sentence and the right exit code for every mistake."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from bench.synthetic_bag import write_bag

from nmt_bench import cli
from nmt_bench.commands import json_output, output_folder, run_command
from nmt_core.errors import BenchError
from nmt_rig.rig import rig_names


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    status = cli.main(words)
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def one_sentence(text: str) -> bool:
    return text.count("\n") == 1 and text.rstrip().endswith(".") and "Traceback" not in text


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "--help")
    assert status == 0
    for name in cli.all_commands():
        assert re.search(rf"^ +{name}\b", out, flags=re.M)


@pytest.mark.parametrize("name", ["demo", "extract", "reference", "benchmark"])
def test_every_option_has_a_help_text(name: str) -> None:
    parser = cli.build_parser(name)
    subparsers = next(action for action in parser._actions if action.dest == "command")
    command = subparsers.choices[name]  # type: ignore[index]
    assert len(command.description) > 60
    for action in command._actions:
        assert action.help, f"{name} {action.dest} has no help"


def test_help_starts_without_numerical_libraries() -> None:
    code = (
        "import sys; from nmt_bench.cli import main; main(['--help']); main(['extract', '--help'])\n"
        "heavy = {'scipy', 'matplotlib', 'numba', 'rich', 'rclpy', 'rosbags'} & set(sys.modules)\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment())
    assert result.returncode == 0, result.stderr


def test_runs_as_a_module() -> None:
    result = subprocess.run(
        [sys.executable, "-m", "nmt_bench", "--version"], capture_output=True, text=True, env=environment()
    )
    assert result.returncode == 0
    assert result.stdout.startswith("nmt ")


@pytest.mark.parametrize(
    "words",
    [
        ("--nonsense",),
        ("no-such-command",),
        ("extract",),
        ("extract", "--out", "x", "--harmonics", "many", "bag"),
        ("benchmark", "--part", "weather"),
        ("reference", "beam", "--out"),
    ],
)
def test_wrong_usage_is_one_sentence(capsys: pytest.CaptureFixture[str], words: tuple[str, ...]) -> None:
    status, _, err = run(capsys, *words)
    assert status == 2
    assert one_sentence(err)
    assert "--help" in err


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("exrtact", "bag"), "extract"),
        (("extract", "bag", "--harmonic", "3", "--referense", "x"), "--reference"),
        (("blind", "scroe"), "score"),
        (("run", "baem"), "beam"),
        (("help", "sewep"), "sweep"),
        (("help", "blind", "mkae"), "make"),
    ],
)
def test_a_mistyped_word_gets_a_proposal(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], meant: str
) -> None:
    status, _, err = run(capsys, *words)
    assert status == 2
    assert one_sentence(err)
    assert f"did you mean '{meant}'" in err


def test_help_of_a_command_is_that_of_its_option(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "help", "extract") == run(capsys, "extract", "--help")
    assert run(capsys, "help") == run(capsys, "--help")
    assert run(capsys, "help", "blind", "make") == run(capsys, "blind", "make", "--help")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("run", "x" * 5000, "--out", "out"), "there is no rig xxx"),
        (("export", "x" * 5000), "xxx…: this name is too long for a file"),
        (("export", "nowhere", "--format", "hdf5"), "There is no bag at nowhere"),
        (("check", "beam", "--device", "simulated"), "give --device portaudio or nidaqmx or loopback"),
        (("run", "beam", "--levels", "0,5"), "decimals have a point"),
    ],
)
def test_what_is_refused_says_how_to_go_on(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)  # a folder out of the clone's user is not the subject
    status, _, err = run(capsys, *words)
    assert status == 2
    assert one_sentence(err)
    assert sentence in err
    assert len(err) < 500


def test_check_offers_no_simulated_device(capsys: pytest.CaptureFixture[str]) -> None:
    assert "simulated," not in run(capsys, "check", "--help")[1]
    assert "simulated," in run(capsys, "run", "--help")[1]


def test_a_rig_file_is_checked_by_loading_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "one.yaml"
    file.write_text("name: one\nstructure: {kind: modal, modes: [{frequency_hz: 30, damping_ratio: 0.01}]}\n")
    status, out, _ = run(capsys, "rigs", "--check", str(file))
    assert status == 0
    assert "structure: modal, point 1 only" in out
    assert "frequencies: 30 Hz, damping ratios 1 %" in out
    file.write_text("name: one\nstructure: {kind: modal, modes: [{frequency_hz: 30, damping: 0.01}]}\n")
    status, _, err = run(capsys, "rigs", "--check", str(file))
    assert status == 2
    assert "one.yaml line 2: unknown key structure.modes.0.damping" in err


def test_rigs_are_listed_with_their_descriptions(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.yaml").write_text("description: a rig of one's own\n")
    monkeypatch.setenv("NMT_RIG_PATH", str(tmp_path))
    status, out, _ = run(capsys, "rigs")
    assert status == 0
    rows = {line.split()[0]: line for line in out.splitlines()}
    assert set(rows) == {*rig_names()} >= {"beam", "mine"}
    assert "a rig of one's own" in rows["mine"]


def test_json_is_one_document_on_standard_output(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    write_bag(tmp_path / "bag")
    out = tmp_path / "out"
    status, text, err = run(capsys, "extract", str(tmp_path / "bag"), "--out", str(out), "--no-report", "--json")
    document = json.loads(text)
    assert (status, document["command"], document["exit_code"], document["out"]) == (0, "extract", 0, str(out))
    assert document["files"] == sorted(path.name for path in out.iterdir())
    assert document["results"] == json.loads((out / "modal.json").read_text())
    assert "Modal properties" in err
    assert "± does not include the error of single-point excitation" in err
    status, text, err = run(capsys, "extract", str(tmp_path / "none"), "--json")
    refusal = json.loads(text)
    assert status == refusal["exit_code"] == 2
    assert refusal["error"] in err
    assert one_sentence(err)


def test_tables_become_rows_of_numbers(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("# a comment\nlevel,state,frequency_hz\n1,ok,10.5\n2,,nan\n")
    assert json_output.contents_of(path) == [
        {"level": 1, "state": "ok", "frequency_hz": 10.5},
        {"level": 2, "state": None, "frequency_hz": None},
    ]


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_knows_every_command_and_its_options(capsys: pytest.CaptureFixture[str], shell: str) -> None:
    status, out, _ = run(capsys, "completion", shell)
    assert status == 0
    for word in (*cli.all_commands(), "--stop-on-lost-lock", "--harmonics"):
        assert word in out
    if shell == "bash":
        subprocess.run(["bash", "-n"], input=out, text=True, check=True)


def test_results_go_to_a_dated_folder_by_default(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    out = cli.build_parser("extract").parse_args(["extract", "bag"]).out
    assert re.fullmatch(r"out/extract-\d{8}-\d{6}", str(out))
    out.mkdir(parents=True)
    (out / "file").touch()
    assert output_folder.free_folder(out) == out.with_name(f"{out.name}-2")


def test_nothing_typed_shows_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys)
    assert status == 2
    assert "commands:" in out


def test_missing_bag(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    status, _, err = run(capsys, "extract", str(tmp_path / "none"), "--out", str(tmp_path / "out"))
    assert status == 2
    assert one_sentence(err)
    assert str(tmp_path / "none") in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "expected"),
    [(b"", "empty"), (b"#ROSBAG V2.0\n" + bytes(50), "ROS 1"), (b"hello world, no bag", "not a bag")],
)
def test_what_is_no_bag(capsys: pytest.CaptureFixture[str], tmp_path: Path, content: bytes, expected: str) -> None:
    file = tmp_path / "file.mcap"
    file.write_bytes(content)
    status, _, err = run(capsys, "extract", str(file), "--out", str(tmp_path / "out"))
    assert status == 2
    assert one_sentence(err)
    assert expected in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file.mcap"]


@pytest.mark.parametrize(
    ("option", "content"), [("--linear", "{"), ("--linear", "{}"), ("--reference", "a,b\n1,2\n"), ("--reference", "")]
)
def test_wrong_side_files(capsys: pytest.CaptureFixture[str], tmp_path: Path, option: str, content: str) -> None:
    file = tmp_path / "side"
    file.write_text(content)
    words = ("extract", str(tmp_path), "--out", str(tmp_path / "out"), option, str(file))
    status, _, err = run(capsys, *words)
    assert status == 2
    assert one_sentence(err)
    assert "side" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("reference", "no_such_rig"),
        ("reference", "beam", "--harmonics", "0"),
        ("reference", "beam", "--amplitudes", "1:2"),
        ("reference", "beam", "--amplitudes", "2:1:5"),
        ("reference", "beam", "--set", "no.such.key=1"),
    ],
)
def test_wrong_reference_options(capsys: pytest.CaptureFixture[str], tmp_path: Path, words: tuple[str, ...]) -> None:
    status, _, err = run(capsys, *words, "--out", str(tmp_path / "out"))
    assert status == 2
    assert one_sentence(err)
    assert list(tmp_path.iterdir()) == []


def test_results_are_not_overwritten(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "modal.csv").write_text("precious")
    status, _, err = run(capsys, "extract", str(tmp_path), "--out", str(tmp_path / "out"))
    assert status == 2
    assert "--force" in err
    assert (tmp_path / "out" / "modal.csv").read_text() == "precious"


def test_interrupt(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("nmt_bench.commands.extract_command.check_output", interrupt)
    status, _, err = run(capsys, "extract", "bag", "--out", str(tmp_path / "out"))
    assert status == 130
    assert one_sentence(err)


def test_unexpected_error_names_a_log(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("nobody foresaw this")

    monkeypatch.setattr("nmt_bench.commands.extract_command.check_output", fail)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    status, _, err = run(capsys, "extract", "bag", "--out", str(tmp_path / "out"))
    assert status == 1
    assert one_sentence(err)
    log = re.search(r"in (/\S+\.log)\.", err)
    assert log is not None
    assert "nobody foresaw this" in Path(log[1]).read_text()
    assert "Traceback" in Path(log[1]).read_text()


def test_command_without_its_libraries(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nmt_bench.commands.run_command", None)
    status, _, err = run(capsys, "run", "beam")
    assert status == 2
    assert one_sentence(err)
    assert "setup" in err


WITHOUT_ROS = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("rclpy", "nmt_msgs", "std_msgs", "std_srvs", "diagnostic_msgs", "nmt_blind"):
            raise ModuleNotFoundError("No module named " + repr(name), name=name)
sys.meta_path.insert(0, Absent())
from nmt_bench.cli import main
print([main(words.split()) for words in sys.argv[1:]])
"""


def test_commands_that_start_nodes_say_that_ros_is_missing(tmp_path: Path) -> None:
    """As the script ``nmt`` that pip installs where there is no ROS 2."""
    script = tmp_path / "nmt"
    script.write_text(WITHOUT_ROS)
    commands = ["run beam", "demo", "sweep joint_resonator --force 10 --from 350 --to 390", "linear joint_resonator"]
    command = [sys.executable, str(script), *(f"{words} --out {tmp_path / 'out'}" for words in commands)]
    result = subprocess.run(command, capture_output=True, text=True, env=environment(), cwd=tmp_path)
    assert result.stdout == "[2, 2, 2, 2]\n"
    for words, said in zip(commands, result.stderr.splitlines(keepends=True), strict=True):
        assert one_sentence(said)
        assert said.startswith(f"nmt {words.split()[0]}: This starts ROS 2 nodes and 'rclpy' is not installed")
    assert list(tmp_path.iterdir()) == [script]


def test_campaigns_that_pip_does_not_install_ask_for_a_clone(tmp_path: Path) -> None:
    script = tmp_path / "nmt"
    script.write_text(WITHOUT_ROS)
    command = [sys.executable, str(script), f"blind make --seed 1 --cases 1 --out {tmp_path / 'out'}"]
    result = subprocess.run(command, capture_output=True, text=True, env=environment(), cwd=tmp_path)
    assert result.stdout == "[2]\n"
    assert result.stderr == "nmt blind: Campaigns are not in what pip installs; use './nmt blind' of a clone.\n"
    assert list(tmp_path.iterdir()) == [script]


def test_a_missing_module_of_our_own_is_a_fault(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(*_: object) -> None:
        raise ModuleNotFoundError("No module named 'nmt_rig.gone'", name="nmt_rig.gone")

    monkeypatch.setattr("nmt_bench.commands.extract_command.check_output", fail)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    status, _, err = run(capsys, "extract", "bag", "--out", str(tmp_path / "out"))
    assert status == 1
    assert "should not have happened" in err


def test_demo_is_the_run_of_the_beam(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    seen = []
    monkeypatch.setattr(run_command, "run", lambda options: seen.append(options) or 7)  # type: ignore[func-returns-value]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out" / "demo").mkdir(parents=True)
    (tmp_path / "out" / "demo" / "modal.csv").write_text("an earlier demo")
    assert cli.main(["demo"]) == 7
    assert seen[0].rig == "beam"
    assert seen[0] == run_command.RunOptions(rig="beam", out=Path("out") / "demo-2")


class TestOutputFolder:
    def test_of_two_runs_into_one_folder_the_second_is_told_of_the_first(self, tmp_path):
        out = tmp_path / "out"
        with output_folder.OutputFolder(out, live=True) as folder:
            for force in (False, True):
                with pytest.raises(BenchError, match="Another command is writing"):
                    output_folder.OutputFolder(out, force=force, live=True).__enter__()
            (folder / "run.json").write_text('{"run_id": "beam-1"}')
            for live in (False, True):
                with pytest.raises(BenchError, match=r"Another command is writing to .*out \(run beam-1\)"):
                    output_folder.OutputFolder(out, force=True, live=live).__enter__()
        assert [path.name for path in out.iterdir()] == ["run.json"]  # and is whole
        with pytest.raises(BenchError, match="not empty"):
            output_folder.check_output(out, force=False)
        with output_folder.OutputFolder(out, force=True, live=True):
            assert not list(out.iterdir())

    def test_results_that_another_command_has_left_meanwhile_are_kept(self, tmp_path):
        out = tmp_path / "out"

        def end_late():
            with output_folder.OutputFolder(out) as folder:
                (folder / "modal.csv").write_text("late")
                out.mkdir()
                (out / "modal.csv").write_text("early")

        with pytest.raises(BenchError, match="not empty"):
            end_late()
        assert (out / "modal.csv").read_text() == "early"
        assert [path.name for path in tmp_path.iterdir()] == ["out"]

    def test_new_folder_appears_whole(self, tmp_path: Path) -> None:
        out = tmp_path / "deep" / "out"
        with output_folder.OutputFolder(out) as folder:
            (folder / "modal.csv").write_text("1")
            assert not out.exists()
        assert [path.name for path in out.iterdir()] == ["modal.csv"]
        assert [path.name for path in out.parent.iterdir()] == ["out"]

    def test_nothing_is_left_after_an_error(self, tmp_path: Path) -> None:
        with pytest.raises(BenchError, match="broke off"):
            break_off(output_folder.OutputFolder(tmp_path / "out"), "modal.csv")
        assert list(tmp_path.iterdir()) == []

    def test_force_replaces_results_and_keeps_the_rest(self, tmp_path: Path) -> None:
        (tmp_path / "bag").mkdir()
        (tmp_path / "bag" / "old.mcap").write_text("old")
        (tmp_path / "notes.txt").write_text("mine")
        with output_folder.OutputFolder(tmp_path, force=True) as folder:
            (folder / "bag").mkdir()
            (folder / "bag" / "new.mcap").write_text("new")
        assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == [
            "bag",
            os.path.join("bag", "new.mcap"),
            "notes.txt",
        ]

    def test_live_folder_keeps_what_was_recorded(self, tmp_path: Path) -> None:
        out = tmp_path / "out"
        with pytest.raises(BenchError, match="broke off"):
            break_off(output_folder.OutputFolder(out, live=True))
        assert not out.exists()
        with pytest.raises(BenchError, match="broke off"):
            break_off(output_folder.OutputFolder(out, live=True), "run.json")
        assert (out / "run.json").is_file()

    def test_live_force_removes_old_results_only(self, tmp_path: Path) -> None:
        (tmp_path / "bag").mkdir()
        (tmp_path / "modal.csv").write_text("old")
        (tmp_path / "notes.txt").write_text("mine")
        with output_folder.OutputFolder(tmp_path, force=True, live=True) as folder:
            assert [path.name for path in folder.iterdir()] == ["notes.txt"]

    def test_a_file_in_the_way(self, tmp_path: Path) -> None:
        (tmp_path / "out").write_text("")
        with pytest.raises(BenchError, match="is a file"), output_folder.OutputFolder(tmp_path / "out", True):
            pass
        with (
            pytest.raises(BenchError, match="cannot be written"),
            output_folder.OutputFolder(tmp_path / "out" / "below"),
        ):
            pass

    def test_free_folder_counts_on(self, tmp_path: Path) -> None:
        assert output_folder.free_folder(tmp_path / "demo") == tmp_path / "demo"
        for name in ("demo", "demo-2"):
            (tmp_path / name).mkdir()
            (tmp_path / name / "file").write_text("")
        assert output_folder.free_folder(tmp_path / "demo") == tmp_path / "demo-3"


def break_off(context: output_folder.OutputFolder, name: str = "") -> None:
    """Write a file in the folder, if a name is given, and fail."""
    with context as folder:
        if name:
            (folder / name).write_text("1")
        raise BenchError("broke off")


def environment() -> dict[str, str]:
    """The environment of a child that finds the same modules."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


@pytest.mark.parametrize("option", ["--ramp", "--levels", "--set"])
def test_a_dash_in_the_place_of_a_value(capsys: pytest.CaptureFixture[str], tmp_path: Path, option: str) -> None:
    assert cli.main(["run", "beam", f"{option}=--", "--out", str(tmp_path / "out")]) == 2
    assert f"Argument {option}: expected a value" in capsys.readouterr().err


def test_a_folder_whose_name_is_too_long(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.main(["reference", "beam", "--out", str(tmp_path / ("x" * 300))]) == 2
    assert "cannot be used (file name too long)" in capsys.readouterr().err
