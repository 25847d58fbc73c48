"""What a model records of itself has no gap, whatever drove it; what another rig records has one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matrix.own_model import distance
from matrix.small_rigs import EXCITERS, rig_text
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.vocabulary import TestKind
from nmt_diagnose.coverage import covers
from nmt_diagnose.measurements.locked_windows import LockedWindows, drive_terms
from nmt_diagnose.measurements.recorded_decay import close_mode
from nmt_diagnose.measurements.stepped_responses import SteppedResponses
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.read_observations import read_observations
from nmt_extract.curves.response_curve import response_curves
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test

DRIVES: dict[str, dict[str, Any]] = {
    "sine": {},
    "harmonics": {"harmonics_control": 5},
    "modal harmonics": {"harmonics_control": 5, "harmonics_target": "modal"},
    "force": {"control": "force"},
    "force, harmonics": {"control": "force", "harmonics_control": 5},
    "response": {"control": "response", "levels": [0.0005, 0.001]},
    "response, harmonics": {"control": "response", "levels": [0.0005, 0.001], "harmonics_control": 5},
}
SHAKERS = ["electrodynamic_shaker", "2 electrodynamic_shaker"]
ONE_EXCITER = ("electrodynamic_shaker", "force", "shaking_table")


def rig_file(folder: Path, exciters: str, *changes: tuple[str, str]) -> Path:
    """File of a small rig; ``changes`` replace text in it."""
    text = rig_text(exciters, TestKind.PHASE_RESONANCE)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "small.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def recorded(folder: Path, file: Path, **settings: Any) -> Path:
    """Bag of a test of a rig."""
    plan = plan_test(file, settings.pop("levels", [0.3, 0.6]), **settings)
    with Session(plan, folder / "run") as session:
        result = session.run()
    assert result.message.startswith("2 of 2"), result.message
    assert result.bag is not None
    return result.bag


def cases() -> list[Any]:
    """Exciters and drive; those that protect a change are in the first tier."""
    found = []
    for exciters in EXCITERS:
        for drive, settings in DRIVES.items():
            if drive == "modal harmonics" and exciters in ONE_EXCITER:
                continue  # that needs three modes, and the small rigs have two
            if exciters in ONE_EXCITER or "control" not in settings:  # several exciters have levels of voltage
                first = drive == "sine" and exciters in ("force", "2 electrodynamic_shaker")
                marks = [] if first else [pytest.mark.campaign]
                found.append(pytest.param(exciters, drive, id=f"{exciters}, {drive}", marks=marks))
    return found


@pytest.mark.parametrize(("exciters", "drive"), cases())
def test_a_recording_of_the_model_itself_is_what_it_predicts(exciters: str, drive: str, tmp_path: Path) -> None:
    file = rig_file(tmp_path, exciters)
    rig = load_rig(file)
    bag = recorded(tmp_path, file, **DRIVES[drive])
    assert distance(read_observations([bag], rig), rig) < 1.5


@pytest.mark.campaign
@pytest.mark.parametrize("exciters", SHAKERS)
def test_without_recorded_voltages_the_forces_are_what_drives(exciters: str, tmp_path: Path) -> None:
    """Of one exciter and of two; what was commanded is not a sine where harmonics are controlled."""
    changes = [("- quantity: voltage\n  exciter: 2\n", "")] if exciters.startswith("2") else []
    file = rig_file(tmp_path, exciters, *changes, ("- quantity: voltage\n", ""))
    rig = load_rig(file)
    observations = read_observations([recorded(tmp_path, file, harmonics_control=5)], rig)
    test = observations.tests[0]
    assert isinstance(test, LockedWindows)
    assert test.held == "force"
    assert test.drive_points == rig.exciter_points
    assert distance(observations, rig) < 1.5


@pytest.mark.parametrize("exciters", with_quick(SHAKERS, "electrodynamic_shaker"))
def test_a_rig_with_another_spring_is_told_from_the_model(exciters: str, tmp_path: Path) -> None:
    """The criterion for no gap, 1.5, sees a spring that is 30 % off."""
    file = rig_file(tmp_path, exciters, ("stiffness_n_m3: 200000000.0", "stiffness_n_m3: 260000000.0"))
    bag = recorded(tmp_path, file, levels=[0.5, 1.0])
    model = load_rig(rig_file(tmp_path, exciters))
    observations = read_observations([bag], model)
    assert distance(observations, model) > 2.0
    assert distance(observations, load_rig(file, ["local_elements.0.stiffness_n_m3=2.6e8"])) < 1.5


def test_a_spring_that_takes_the_frequency_far_is_followed(tmp_path: Path) -> None:
    """From 21 to 33 Hz over two levels: linear responses there tell no wrong unit, and the branch is climbed to it."""
    bag = recorded(tmp_path, Path("strong_cubic"), levels=[0.1, 0.8])
    rig = load_rig("strong_cubic")
    observations = read_observations([bag], rig)
    test = observations.tests[0]
    assert isinstance(test, LockedWindows)
    assert test.levels[1].frequency_hz > 1.5 * test.levels[0].frequency_hz
    assert distance(observations, rig) < 1.5


@pytest.mark.campaign
def test_a_response_curve_is_what_its_model_predicts_on_every_branch(tmp_path: Path) -> None:
    """Lines of which some are between the folds; a spring that is 5 % off is told by them."""
    curve = {"test": "response_curve", "lag_deg": (60.0, 165.0), "spacing": 0.45, "window_periods": 20, "ramp": 0.3}
    with Session(plan_test("strong_cubic", [0.32], **curve), tmp_path / "run") as session:
        result = session.run()
    assert result.bag is not None
    rig = load_rig("strong_cubic")
    observations = read_observations([result.bag], rig)
    test = observations.tests[0]
    assert isinstance(test, SteppedResponses)
    assert test.lines_hz.size == len(result.points)
    (measured,) = response_curves(result.points)
    assert np.count_nonzero(measured.stable == 0.0) > 1
    assert distance(observations, rig) < 1.5
    assert distance(observations, load_rig("strong_cubic", ["local_elements.0.stiffness_n_m3=1.68e10"])) > 2.0


def test_what_an_oscillator_did_not_make_is_no_drive() -> None:
    """A harmonic counts where it stands out of its scatter, and all do where nobody knows what was commanded."""
    rng = np.random.default_rng(1)
    shares = np.zeros((10, 1, 4), dtype=complex)
    shares[:, 0] = [0.0, 1.0, 1e-5, 1e-3]
    shares[:, 0, 2:] += 1e-4 * rng.normal(size=(10, 2))
    assert drive_terms(shares.mean(axis=0), shares, [0], 1)[0][1] == 0.0
    assert drive_terms(shares.mean(axis=0), shares, [0], 1)[0][2] == pytest.approx(1e-3, rel=0.2)
    assert drive_terms(shares.mean(axis=0), shares, [0], 3)[0][1] != 0.0


def test_a_decay_of_close_modes_is_told_from_one_that_is_alone(tmp_path: Path) -> None:
    """Modes 9 % apart, as several exciters can tell them, ring together after a release: frequencies are 0.07 % off."""
    close, apart = tmp_path / "close.yaml", tmp_path / "apart.yaml"
    close.write_text(rig_text("2 force", TestKind.PHASE_RESONANCE), encoding="utf-8")
    apart.write_text(rig_text("2 force", TestKind.RING_DOWN), encoding="utf-8")
    view = ModelView.of(load_rig(close), (1, 2))
    assert "mode at 21.94 Hz rings so close to 20.13 Hz" in close_mode(view, 20.13)
    assert close_mode(ModelView.of(load_rig(apart), (1, 2)), 20.13) == ""
    assert close_mode(ModelView.of(load_rig(close), (1,)), 20.13) == ""


KINDS = [kind for kind in TestKind if kind not in (TestKind.UNKNOWN, TestKind.RECORD)]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.label)
def test_a_kind_is_taken_or_refused_in_one_sentence(kind: TestKind) -> None:
    resonance = "3:1" if kind is TestKind.SECONDARY_RESONANCE else ""
    one = DrivenTest(kind=kind, resonance=resonance)
    for test in (one, replace(one, exciters=("force", "force"))):
        sentence = covers(test)
        assert not sentence or (sentence.endswith(".") and sentence.count(". ") == 0 and "use " in sentence)
    assert bool(covers(one)) == (
        kind in (TestKind.SWEEP, TestKind.SECONDARY_RESONANCE, TestKind.SELF_EXCITED)
    )  # fmt: skip)


@pytest.mark.campaign
def test_a_recording_without_a_covered_test_is_refused_by_its_kind(tmp_path: Path) -> None:
    file = rig_file(tmp_path, "force")
    settings: dict[str, Any] = {"frequencies_hz": (18.0,), "frequency_end_hz": 20.0, "rate_hz_s": 1.0}
    with Session(plan_test(file, [0.3], test="sweep", **settings), tmp_path / "run") as session:
        bag = session.run().bag
    assert bag is not None
    with pytest.raises(BenchError, match=r"The diagnosis takes no part of a sweep test, as .*; use windows"):
        read_observations([bag], load_rig(file))
