"""The how-tos of hammer, one-mode model and responses at levels: their files give what the pages say."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_extract.linear.evaluation import evaluate_linear_test
from nmt_record.bag.bag_reader import Bag
from nmt_rig.rig import load_rig

HOW_TO = Path(__file__).resolve().parents[2] / "docs" / "how-to"
EXAMPLES = HOW_TO.parents[1] / "examples"
HZ, RATIO, CUBIC, TOP = 133.1, 0.0035, 1.7e12, 6e-4
OMEGA = 2.0 * math.pi * HZ


def written(name: str, page: str = "impact-hammer.md") -> str:
    """A file's text as the how-to shows it, below the line that names it."""
    text = (HOW_TO / page).read_text(encoding="utf-8")
    start = text.index("```yaml\n", text.index(f"`{name}`")) + len("```yaml\n")
    return text[start : text.index("```", start)]


def test_the_files_of_the_page_read_a_tap(tmp_path: Path) -> None:
    t = np.arange(8000) / 4000.0
    run = solve_ivp(
        lambda _, y: [y[1], -(OMEGA**2) * y[0] - CUBIC * y[0] ** 3 - 2.0 * RATIO * OMEGA * y[1]],
        (0.0, t[-1]), [TOP, 0.0], t_eval=t, rtol=1e-8, atol=1e-12, method="DOP853",
    )  # fmt: skip
    hammer = 0.3 * np.exp(-600.0 * t) * np.sin(2.0 * math.pi * 1500.0 * t)
    lines = "\n".join(f"{a:.9g},{b:.9g}" for a, b in zip(t, run.y[1] + hammer, strict=True))
    (tmp_path / "tap.csv").write_text(f"time_s,velocity\n{lines}\n")
    for name in ("clamped.yaml", "tap.yaml"):
        (tmp_path / name).write_text(written(name))
    import_data(tmp_path / "tap.yaml", tmp_path / "tap")
    observations = read_observations([tmp_path / "tap"], load_rig(tmp_path / "clamped.yaml"))
    hertz = np.exp(observations.values[observations.rows.part == Part.LOG_FREQUENCY]) / (2.0 * math.pi)
    assert hertz.size >= 10
    assert hertz[0] > 1.08 * HZ
    assert abs(hertz[-1] / HZ - 1.0) < 3e-4
    damping = observations.values[observations.rows.part == Part.DAMPING]
    assert abs(damping[-3] / RATIO - 1.0) < 0.02
    assert not any("left out" in note for note in observations.notes)


def test_the_files_of_the_one_mode_model_read_a_frequency_response(tmp_path: Path) -> None:
    hertz = np.linspace(125.0, 142.0, 60)
    ratio = hertz / HZ
    response = -(ratio**2) / (1.0 - ratio**2 + 2j * RATIO * ratio)
    rows = "\n".join(f"{f},{h.real},{h.imag}" for f, h in zip(hertz, response, strict=True))
    (tmp_path / "frf.csv").write_text(f"frequency_hz,real,imag\n{rows}\n")
    (tmp_path / "frf.yaml").write_text(written("frf.yaml", "one-mode-model.md"))
    page = (HOW_TO / "one-mode-model.md").read_text(encoding="utf-8")
    start = page.index("```yaml\nname: one_mode\n") + len("```yaml\n")
    (tmp_path / "one_mode.yaml").write_text(page[start : page.index("```", start)])
    import_data(tmp_path / "frf.yaml", tmp_path / "frf")
    model = load_rig(tmp_path / "one_mode.yaml")
    observations = read_observations([tmp_path / "frf"], model)
    forward = Forward(observations.tests, observations.rows)
    left = forward.difference(observations.values, forward.predict(model).values)
    assert len(observations.rows) == 120
    assert np.abs(left).max() < 1e-6


def test_the_example_of_responses_at_levels_is_named(tmp_path: Path) -> None:
    import_data(EXAMPLES / "bench" / "measured.yaml", tmp_path / "sweeps")
    model = EXAMPLES / "bench" / "one_mode.yaml"
    found = diagnose_bags(model, [tmp_path / "sweeps"], settings=DiagnosisSettings(look_ahead=False)).diagnosis
    assert (found.verdict, found.ranking[0].effect) == (Verdict.EFFECT, "cubic_stiffness")
    k = found.ranking[0].parameters["k"]
    assert abs(k.value - 2.4e9) < 2.0 * k.std < 0.1 * k.value
    assert not found.warnings


def example(page: str) -> str:
    """The first example in Python of a page."""
    text = (HOW_TO / page).read_text(encoding="utf-8")
    start = text.index("```python\n") + len("```python\n")
    return text[start : text.index("```", start)]


def test_hits_of_a_hammer_give_the_modes_and_no_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(example("impact-hammer.md"), "example", "exec"), {})
    Path("hits.yaml").write_text(written("hits.yaml"))
    import_data(Path("hits.yaml"), Path("hits"))
    result = evaluate_linear_test(Bag.open("hits"), band_hz=(10.0, 200.0))
    assert len(result.test.modes) == 2
    for mode, hertz, ratio in zip(result.test.modes, (25.997243, 73.075910), (0.00138774, 0.00089474), strict=True):
        assert abs(mode.frequency_hz - hertz) < 2.0 * mode.frequency_std < 1e-4 * hertz
        assert abs(mode.damping_ratio - ratio) < 2.0 * mode.damping_std < 0.02 * ratio
    assert result.remarks == ("No voltage was recorded: the exciter's share of the plant is not known.",)


@pytest.mark.campaign
def test_the_friction_of_the_joint_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(example("robot-joint.md"), "example", "exec"), {})
    for name in ("arm.yaml", "elbow.yaml"):
        Path(name).write_text(written(name, "robot-joint.md"))
    import_data(Path("elbow.yaml"), Path("elbow"))
    found = diagnose_bags("arm.yaml", [Path("elbow")], settings=DiagnosisSettings(look_ahead=False)).diagnosis
    assert (found.verdict, found.ranking[0].effect) == (Verdict.EFFECT, "second_friction_contact")
    assert found.ranking[0].probability > 0.99
    limit = found.ranking[0].parameters["slip_force"]
    assert abs(limit.value - 0.6) < 2.0 * limit.std < 0.02
    stiffness = found.ranking[0].parameters["kt"]
    assert abs(stiffness.value - 800.0) < 2.0 * stiffness.std
