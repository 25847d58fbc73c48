"""Rigs that are driven blindly: what is sealed when, what is run again, and what the table says."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from blind.blind_campaign import operating, short_rig

from nmt_blind.campaign.foreign_case import judge, read_truth
from nmt_blind.campaign.investigations import (
    information_slope,
    kind_weights,
    pair_of,
    print_lines,
    run_investigations,
    summary,
    told_small,
    write_tables,
)
from nmt_blind.cases.draw import SIZES, TrueEffect, draw_cases
from nmt_blind.cases.driven_rigs import (
    CALIBRATION_FILE,
    LEAST_SIZE,
    calibration_of,
    make_pairs,
    read_rigs,
    truth_of,
    truth_of_effect,
)
from nmt_blind.cases.rig_edits import rig_yaml, with_edits
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain, measuring_chain
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_record.exchange.sidecar.calibration_file import read_calibration

pytestmark = pytest.mark.usefixtures("module_undrawn")

RIG = short_rig()

PROGRAM = """
import json, pathlib, sys
words = sys.argv[1:]
out = pathlib.Path(words[words.index("--out") + 1])
out.mkdir(parents=True, exist_ok=True)
sealed = (out.parents[1] / "seal.json").exists() or (out.parents[2] / "seal.json").exists()
sheet = words[words.index("--calibration") + 1] if "--calibration" in words else "-"
pathlib.Path(sys.argv[0]).with_name("calls").open("a").write(f"{words[0]} {sheet} {sealed}\\n")
cubic = {"effect": "cubic_stiffness", "place": "structure", "detail": "4", "probability": 0.99, "equivalents": []}
said = {"verdict": "effect", "ranking": [cubic], "where": [], "probabilities": {"cubic_stiffness@4": 0.99},
        "sentences": []}
if words[0] == "investigate":
    tests = [{"state": "measured", "seconds": 30.0, "expected": e, "received": r, "separates": s}
             for e, r, s in ((None, None, ()), (0.5, 0.6, ("a", "b")), (0.325083, 0.1, ("none", "too_weak_so_far")))]
    tests += [{"state": "empty", "seconds": 6.0}, {"state": "asked", "seconds": 50.0}]
    answers = {"none": 0.9, "too_weak_so_far": 0.1}
    turns = [{"tests": n, "thinking_s": t, "answers": answers, "verdict": "none"} for n, t in ((1, 4.0), (2, 8.0))]
    (out / "investigate.json").write_text(json.dumps({"tests": tests, "turns": turns, "ended": "named"}))
    (out / "diagnosis").mkdir()
    (out / "diagnosis" / "diagnosis.json").write_text(json.dumps(said))
elif words[0] == "diagnose":
    (out / "diagnosis.json").write_text(json.dumps(said | {"verdict": "unknown", "ranking": []}))
else:
    (out / "run.json").write_text(json.dumps({"result": {"bench_time_s": 45.0}}))
sys.exit(3 if words[0] == "investigate" else 0)
"""


def rig_folder(folder: Path, name: str) -> Path:
    """A rig with a cubic spring at point 4."""
    made = folder / name
    made.mkdir(parents=True)
    for file in ("model.yaml", "real.yaml"):
        (made / file).write_text(rig_yaml(RIG.model()), encoding="utf-8")
    truth = {"kind": "effect", "verdicts": ["effect"], "effects": ["cubic_stiffness"], "place": ["4"]}
    (made / "truth.yaml").write_text(yaml.safe_dump(truth), encoding="utf-8")
    return made


def run(tmp_path: Path, **more: Any) -> list[Any]:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM, encoding="utf-8")
    return run_investigations(tmp_path / "rigs", tmp_path / "out", (sys.executable, str(program)), **more)


def test_truths_are_sealed_before_anything_is_run_and_results_are_kept(tmp_path: Path) -> None:
    for name in ("a", "b"):
        rig_folder(tmp_path / "rigs", name)
    reported: list[str] = []
    lines = run(tmp_path, say=lambda done, total, line: reported.append(f"{done}/{total} {line}"))
    calls = (tmp_path / "calls").read_text().splitlines()
    assert [call.split()[0] for call in calls[:6]] == ["investigate", "linear", "run", "linear", "linear", "diagnose"]
    assert all(call.endswith("True") for call in calls)
    assert len(calls) == 12
    assert [text.split()[0] for text in reported] == ["0/2", "1/2", "2/2"]
    assert "a: cubic_stiffness @ 4: right (effect cubic_stiffness structure 4) 96 s" in reported[1]
    assert print_lines(run(tmp_path)) == print_lines(lines)
    assert len((tmp_path / "calls").read_text().splitlines()) == 12


def test_what_is_known_of_a_chain_goes_to_both_ways(tmp_path: Path) -> None:
    """The sheet states what an ordinary chain has, of every channel, also where the bench's simulator is driven."""
    sheet = rig_folder(tmp_path / "rigs", "a") / CALIBRATION_FILE
    sheet.write_text(yaml.safe_dump(calibration_of(RIG.model())), encoding="utf-8")
    run(tmp_path)
    calls = [line.split() for line in (tmp_path / "calls").read_text().splitlines()]
    assert {call[0] for call in calls if call[1] == str(sheet)} == {"investigate", "diagnose"}
    model = RIG.model()
    channels = {
        name: MeasuredChannel(name, Quantity[sensor.quantity.upper()], 1)
        for sensor in model.sensors
        if (name := model.sensor_channel(sensor))
    }
    chain = measuring_chain({"device": "simulated"}, channels, 1e4, None, read_calibration(sheet))
    assert chain is not None
    assert not chain.channels  # all as usual
    usual = MeasuringChain()
    assert (chain.voltage_gain, chain.shared_delay_s, chain.clock) == (
        usual.voltage_gain, usual.shared_delay_s, usual.clock,
    )  # fmt: skip


def test_the_table_has_both_ways(tmp_path: Path) -> None:
    rig_folder(tmp_path / "rigs", "a")
    lines = run(tmp_path)
    found = summary(lines)
    assert found["classes"]["investigation"]["right"] == 1
    assert found["classes"]["plan"]["honest unknown"] == 1
    assert found["bench_s_median"] == {"investigation": 96.0, "plan": 180.0}  # what locked nothing took time, too
    assert found["bench_share_where_right"] == pytest.approx(96.0 / 180.0)
    assert found["turn_s_median"] == 6.0
    assert found["information_slope"] == pytest.approx((0.5 * 0.6 + 0.325083 * 0.1) / (0.5**2 + 0.325083**2))
    assert (found["tests_that_settle"], found["information_slope_open"]) == (1, pytest.approx(0.6 / 0.5))
    assert found["chosen_tests_without_expectation"] == 0
    text = "\n".join(print_lines(lines))
    assert "investigation: right 1; bench time 96 s in the median" in text
    files = write_tables(lines, tmp_path / "out")
    assert json.loads(files[1].read_text())["rigs"][0]["plan_outcome"] == "honest unknown"


def test_what_is_named_and_too_small_to_matter_is_told_from_what_is_missed(tmp_path: Path) -> None:
    truth = read_truth(rig_folder(tmp_path, "a") / "truth.yaml")
    small = "The recordings show a difference that is smaller than what matters: 0.7 %. It looks like {} at point 4."
    quiet = {"verdict": "none", "sentences": ["There is no gap.", small.format("cubic stiffness")]}
    assert told_small(truth, quiet)
    assert not told_small(truth, quiet | {"verdict": "unknown"})
    assert not told_small(truth, quiet | {"sentences": [small.format("air drag"), "No cubic stiffness."]})
    assert not told_small(truth, None)


def test_a_truth_that_was_changed_later_is_refused(tmp_path: Path) -> None:
    folder = rig_folder(tmp_path / "rigs", "a")
    run(tmp_path)
    with (folder / "truth.yaml").open("a", encoding="utf-8") as file:
        file.write("remark: something else\n")
    with pytest.raises(BenchError, match="changed after it was sealed"):
        run(tmp_path)


def test_folders_without_rigs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="blind rigs"):
        read_rigs(tmp_path)
    (rig_folder(tmp_path, "a") / "real.yaml").unlink()
    with pytest.raises(BenchError, match="make it again"):
        read_rigs(tmp_path)
    with pytest.raises(BenchError, match="There is no rig c"):
        read_rigs(tmp_path, ("c",))


def test_what_is_true_of_a_drawn_rig_is_judged_right(tmp_path: Path) -> None:
    """The words of the truth are those of a diagnosis that is right, for every effect that is drawn."""
    model = RIG.model()
    cases = draw_cases(model, operating(), 60, 2, ("null", "effect"))
    for number, case in enumerate(case for case in cases if all(e.size >= LEAST_SIZE for e in case.effects)):
        path = tmp_path / f"{number}.yaml"
        path.write_text(yaml.safe_dump(truth_of(case)), encoding="utf-8")
        truth = read_truth(path)
        if not case.effects:
            assert truth.kind == "healthy"
            continue
        with_edits(model, case.edits)
        (effect,) = case.effects
        head = {"effect": effect.name, "place": effect.place, "detail": effect.detail, "probability": 0.99}
        diagnosis = {"verdict": "effect", "ranking": [head], "where": [], "probabilities": {}}
        assert judge(truth, diagnosis).outcome == "right"
        head["effect"] = "clock_error" if effect.name != "clock_error" else "cubic_stiffness"
        assert judge(truth, diagnosis).outcome == "confidently wrong"


def test_a_mass_of_the_force_sensor_is_at_its_place_without_a_channel(tmp_path: Path) -> None:
    (tmp_path / "truth.yaml").write_text(
        yaml.safe_dump(truth_of_effect(TrueEffect("force_cell_mass", "force_sensor", "f2", 10.0, 0.2, "kg", True, {}))),
        encoding="utf-8",
    )
    head = {"effect": "force_cell_mass", "place": "force_sensor", "detail": "", "probability": 0.99}
    diagnosis = {"verdict": "effect", "ranking": [head], "where": [], "probabilities": {}}
    assert judge(read_truth(tmp_path / "truth.yaml"), diagnosis).outcome == "right"


def test_the_slope_of_information_goes_through_the_origin() -> None:
    assert information_slope([(0.5, 0.5), (0.2, 0.2)]) == pytest.approx((1.0, 0.0))
    assert information_slope([(0.5, 0.25), (0.2, 0.1)]) == pytest.approx((0.5, 0.0))
    assert information_slope([(0.5, 0.5), (0.5, 0.0)], (3.0, 1.0))[0] == pytest.approx(0.75)
    assert np.isnan(information_slope([])).all()
    assert math.isnan(information_slope([(0.5, 0.4)])[1])


def test_the_error_of_the_slope_is_the_scatter_of_slopes() -> None:
    """Of many campaigns whose tests scatter more the more is expected of them."""
    rng = np.random.default_rng(2)
    expected = rng.uniform(0.05, 0.6, 60)
    draws = [
        information_slope(list(zip(expected, expected * (1.0 + rng.standard_normal(60)), strict=True)))
        for _ in range(2000)
    ]
    slopes, errors = np.array(draws).T
    assert np.mean(slopes) == pytest.approx(1.0, abs=0.02)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(np.std(slopes), rel=0.1)


def test_rigs_count_as_often_as_their_kind_is_met() -> None:
    def lines(healthy: int, others: int) -> Any:
        return [SimpleNamespace(healthy=k < healthy) for k in range(healthy + others)]

    weights = kind_weights(lines(2, 6))
    drawn = sum(size >= LEAST_SIZE for size in SIZES) / len(SIZES)
    assert sum(weights[2:]) / sum(weights) == pytest.approx(drawn * (1.0 - THRESHOLDS.comparison.prior_none))
    assert kind_weights(lines(0, 3)) == [1.0, 1.0, 1.0]


def test_what_becomes_of_a_pair() -> None:
    def record(*turns: tuple[int, float, float, str], conclusion: str = "") -> dict[str, Any]:
        return {
            "tests": [{"state": "measured", "text": text} for text in ("random", "low levels", "mode 2")],
            "turns": [
                {"tests": n, "answers": {"force_gain": p, "response_gain": q}, "sentence": text}
                for n, p, q, text in turns
            ],
            "conclusion": conclusion,
        }

    pair = ("force_gain", "response_gain")
    alike = "The cause is force gain; these tests cannot tell it from response gain."
    assert pair_of(pair, record((2, 0.99, 0.01, "The cause is force gain."))) == "parted by the first two tests"
    later = record((2, 0.6, 0.4, ""), (3, 0.99, 0.01, "The cause is force gain."))
    assert pair_of(pair, later) == "parted by mode 2"
    assert pair_of(pair, record((2, 0.99, 0.0, alike), conclusion="Whether it is force gain or response gain")) == (
        "said to be alike"
    )
    third = "The cause is clipping; these tests cannot tell it from force gain."
    assert pair_of(pair, record((2, 0.4, 0.0, third))) == "parted by the first two tests"
    assert pair_of(pair, record((2, 0.4, 0.0, ""))).startswith("neither")
    assert pair_of(pair, record((2, 0.1, 0.9, ""))).startswith("neither")
    quiet = record((2, 0.0, 0.0, ""))
    quiet["turns"][-1]["verdict"] = "calibration"
    assert pair_of(pair, quiet).startswith("no gap")
    assert pair_of((), record()) == ""


@pytest.mark.campaign
def test_both_sides_of_a_pair_have_a_rig(tmp_path: Path) -> None:
    names = make_pairs(tmp_path, "beam")
    rigs = read_rigs(tmp_path)
    assert [rig.name for rig in rigs] == sorted(names)
    for rig in rigs:
        assert read_truth(rig.truth).effects == (frozenset({rig.pair[0]}),)
