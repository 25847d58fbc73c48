"""Every kind of test that the bench does has its settings, its loop, its rules for windows and its row in the page."""

from __future__ import annotations

from pathlib import Path

import pytest

from nmt_core.errors import BenchError
from nmt_core.kinds import GOAL_FIELDS, RandomTest
from nmt_core.kinds import KINDS as CLASSES
from nmt_core.vocabulary import ControlKind, TestKind
from nmt_pll.loop_core import LoopCore
from nmt_record.windows.window_policy import POLICIES, Consequence, WindowFault
from nmt_session import plan_nodes, plan_test

PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "architecture.md"
KINDS = [kind for kind in TestKind if kind not in (TestKind.UNKNOWN, TestKind.RECORD)]
EACH = pytest.mark.parametrize("kind", KINDS, ids=[kind.label for kind in KINDS])


@EACH
def test_its_settings_are_known(kind: TestKind) -> None:
    assert kind in CLASSES, f"write the class of a {kind.label} test in nmt_core/kinds"
    assert set(CLASSES[kind]().level_fields) <= {*GOAL_FIELDS, "test"}


@EACH
def test_it_has_a_loop(kind: TestKind) -> None:
    plan = plan_nodes(plan_test("beam", [0.1]), Path("bag"), Path("rig.yaml"))
    assert kind in LoopCore(plan.pll, lambda *_: None).loops


@EACH
def test_the_page_has_it(kind: TestKind) -> None:
    assert f"| `{kind.label}` |" in PAGE.read_text(encoding="utf-8")


@EACH
def test_what_has_no_phase_is_not_judged_by_it(kind: TestKind) -> None:
    judged = POLICIES[kind].effects[WindowFault.PHASE_JUMP]
    found = CLASSES[kind]
    assert found.has_phase or judged is Consequence.NONE
    assert found.has_phase or not (found.closes_phase_loop or found.gives_modal_points)


def test_noise_has_levels_of_voltage_and_no_frequencies() -> None:
    noise = RandomTest(band_low_hz=5.0, band_high_hz=50.0, duration=4.0)
    noise.check([], 1, ControlKind.VOLTAGE, 1000.0)
    with pytest.raises(BenchError, match="levels of voltage"):
        noise.check([], 1, ControlKind.FORCE, 1000.0)
    with pytest.raises(BenchError, match="has a band and no frequencies"):
        noise.check([10.0], 1, ControlKind.VOLTAGE, 1000.0)
