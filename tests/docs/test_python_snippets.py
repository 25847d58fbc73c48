"""The snippets of *Use from Python* that need no ROS run as they stand, on small recordings."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bench import synthetic_bag
from diagnose.observation_bags import record, rig_with_noise
from record import foreign_data
from scipy.signal import bilinear, lfilter

from nmt_bench import import_data
from nmt_bench.cli import main
from nmt_extract import synthesise
from nmt_extract.modal.table import read_csv
from nmt_rig.rig import find_rig

pytestmark = pytest.mark.campaign
PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "use-from-python.md"
RATE = 2000.0
MODES = ((60.0, 0.01, (1.0, 0.6)), (210.0, 0.008, (0.5, -0.9)))


def snippet(heading: str) -> str:
    """The Python block under a heading of the page."""
    text = PAGE.read_text(encoding="utf-8")
    section = re.search(rf"^### {re.escape(heading)}\n(.*?)(?=^##)", text, re.S | re.M)
    assert section is not None
    found = re.search(r"^```python\n(.*?)^```", section[1], re.S | re.M)
    assert found is not None
    return found[1]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Runs a snippet in a folder with ``out/``; returns what it prints."""
    monkeypatch.chdir(tmp_path)
    Path("out").mkdir()

    def run_snippet(heading: str) -> str:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(snippet(heading), f"{PAGE.name}: {heading}", "exec"), {"__name__": "snippet"})
        return printed.getvalue()

    return run_snippet


def recorded_run(folder: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic_bag, "RIG_YAML", find_rig("beam").read_text(encoding="utf-8"))
        synthetic_bag.write_bag(folder / "bag", level_seconds=2.5)


def recorded_noise(folder: Path) -> None:
    """Random force on two known modes, accelerations at two points: digital filters with exactly these poles."""
    force = np.random.default_rng(1).standard_normal(round(40 * RATE))
    data = {"f": force, "a1": np.zeros(force.size), "a2": np.zeros(force.size)}
    for hertz, damping, shape in MODES:
        # The bilinear transform bends the axis of frequency, and with its slope shortens the decay.
        angle = math.pi * hertz / RATE
        omega, ratio = 2.0 * RATE * math.tan(angle), damping * 2.0 * angle / math.sin(2.0 * angle)
        b, a = bilinear([1.0, 0.0, 0.0], [1.0, 2.0 * ratio * omega, omega**2], RATE)
        for row, name in enumerate(("a1", "a2")):
            data[name] += shape[row] * shape[0] * lfilter(b, a, force)
    values = {
        "sample_rate": RATE,
        "file": "data.npz",
        "channels": [
            {"column": "f", "quantity": "force", "unit": "N", "point": 1},
            {"column": "a1", "quantity": "acceleration", "unit": "m/s^2", "point": 1},
            {"column": "a2", "quantity": "acceleration", "unit": "m/s^2", "point": 2},
        ],
        "segments": [{"kind": "random", "start": 0.0, "stop": 40.0, "level": 1.0, "band_hz": [20.0, 400.0]}],
    }
    foreign_data.write(folder / "data", values, data)
    import_data(folder / "data" / "sidecar.yaml", folder / "bag")


def test_extract_and_synthesise(run: Callable[[str], str]) -> None:
    recorded_run(Path("out/demo"))
    printed = run("Extract a bag")
    assert printed.startswith("made-up None\n")
    assert len(printed.splitlines()) == 2 + 3
    table = read_csv(Path("out/extracted/modal.csv"))
    assert table["frequency_hz"] == pytest.approx([synthetic_bag.FREQUENCY_HZ] * 3)
    assert Path("out/extracted/report.html").read_text(encoding="utf-8").endswith("</html>\n")
    printed = run("Synthesis")
    assert "force_n,frequency_hz,solution,modal_amplitude" in printed
    # The command writes what the function gives.
    words = ["--backbone", "out/extracted", "--levels", "0.3", "--from", "20", "--to", "24", "--points", "201"]
    assert main(["synthesis", *words, "--out", "out/synthesis"]) == 0
    expected = synthesise("out/extracted", forces=[0.3], low_hz=20.0, high_hz=24.0).csv(201)
    assert Path("out/synthesis/synthesis.csv").read_text(encoding="utf-8") == expected
    assert "Synthesis from the backbone" in Path("out/synthesis/report.html").read_text(encoding="utf-8")


def test_evaluate_a_linear_test(run: Callable[[str], str]) -> None:
    recorded_noise(Path("out/linear"))
    assert len(run("Evaluate a linear test").splitlines()) == 2
    values = json.loads(Path("out/linear/linear.json").read_text(encoding="utf-8"))
    assert values["drive_point"] == 1
    assert values["frequencies_rad_s"] == pytest.approx([2 * math.pi * hertz for hertz, _, _ in MODES], rel=1e-3)
    assert values["damping_ratios"] == pytest.approx([damping for _, damping, _ in MODES], rel=0.02)
    rows = list(csv.DictReader(Path("out/linear/frf.csv").read_text(encoding="utf-8").splitlines()))
    assert float(rows[-1]["frequency_hz"]) > 300.0
    assert "2 modes identified and mass-normalised" in Path("out/linear/report.html").read_text(encoding="utf-8")
    # The command writes what the function gives.
    assert main(["linear", "--bag", "out/linear/bag", "--out", "out/again"]) == 0
    assert json.loads(Path("out/again/linear.json").read_text(encoding="utf-8")) == values
    for name in ("frf.csv", "report.html"):
        assert Path("out/again", name).read_bytes() == Path("out/linear", name).read_bytes()


def test_import_and_export(run: Callable[[str], str]) -> None:
    foreign_data.write(Path("measured"))
    printed = run("Import and export")
    assert "data.npz" in printed
    exported = np.load("out/exported/data.npz")
    np.testing.assert_array_equal(exported["f2"], foreign_data.recording()["f"])


def test_the_backbone_of_a_model(run: Callable[[str], str]) -> None:
    assert run("The backbone of a model").startswith("(20,) ")
    lines = Path("out/reference.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "modal_amplitude,omega_rad_s,damping_ratio"
    assert len(lines) == 1 + 20


@pytest.mark.timeout(600)
def test_diagnose(run: Callable[[str], str]) -> None:
    rig = rig_with_noise()
    sensors = [s.model_copy(update={"gain": 1.05}) if s.point == 5 else s for s in rig.sensors]
    record(Path("out/real/bag"), rig.model_copy(update={"sensors": sensors}), levels=(0.1, 0.3, 1.0))
    assert run("Diagnose").splitlines()[-1].startswith("Verdict.")
    names = sorted(path.name for path in Path("out/diagnosis").iterdir())
    assert names == ["diagnosis.json", "model.yaml", "observables.csv", "report.html"]


@pytest.mark.timeout(600)
def test_a_blind_check(run: Callable[[str], str]) -> None:
    assert run("A blind check").startswith("Proportion(")
    assert {"score.json", "score.md", "score.html"} <= {path.name for path in Path("out/campaign").iterdir()}
