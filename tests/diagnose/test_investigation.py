"""What an investigation asks, in which order, when it ends, and that it goes on where it was left."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nmt_bench.commands.requested_test import command_text, command_words
from nmt_core.errors import BenchError
from nmt_core.kinds.request import TestRequest
from nmt_diagnose.ahead.apart import expected_information
from nmt_diagnose.ahead.hidden_effects import Hidden
from nmt_diagnose.investigation.answers import answers_of
from nmt_diagnose.investigation.investigation import NO, STOP, YES, Investigation, InvestigationSettings, proposed
from nmt_diagnose.investigation.investigation_record import AskedTest, EmptyTestError, InvestigationRecord, read_record
from nmt_diagnose.ledger.diagnosis import HIDDEN, NextTest, Ranked, Share, Verdict
from nmt_report.investigation_report import investigation_page, shown_answers

PLAN = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
SETTINGS = InvestigationSettings(levels=PLAN, periods=20, random_s=10.0)
POINT_4 = TestRequest(rig="real.yaml", levels=(0.1, 0.2), exciters=(4,), name="x")
POINT_5 = replace(POINT_4, exciters=(5,))
MODE_2 = replace(POINT_4, exciters=(), changes=(("test.mode", 2),))


def named(effect: str, p: float, equivalents: tuple[str, ...] = ()) -> Ranked:
    return Ranked(effect, "structure", "2", p, equivalents, {}, Share(0.9, 0.8, 1.0), 9.0)


def diagnosis(
    verdict: Verdict,
    probabilities: dict[str, float],
    ahead: Sequence[NextTest] = (),
    equivalents: tuple[str, ...] = (),
    levels: NextTest | None = None,
    sensors: Sequence[NextTest] = (),
) -> Any:
    effects = [(name, p) for name, p in probabilities.items() if name not in ("none", "unknown")]
    ranking = tuple(named(name.split("@")[0], p, equivalents) for name, p in effects)
    return SimpleNamespace(
        verdict=verdict, sentences=("where", f"which: {verdict.value}", "how far"), ranking=ranking,
        probabilities=probabilities, next_test=tuple(ahead), adequate=True, next_levels=levels,
        other_sensors=tuple(sensors),
    )  # fmt: skip


OPEN = diagnosis(Verdict.EFFECT, {"cubic_stiffness@2": 0.6, "quintic_stiffness@2": 0.4})
SURE = diagnosis(Verdict.EFFECT, {"cubic_stiffness@2": 0.99, "quintic_stiffness@2": 0.01})
NOTHING = diagnosis(Verdict.NONE, {"none": 0.97, "unknown": 0.03})


def ahead(text: str, request: TestRequest, sigma: float, seconds: float, nats: float) -> NextTest:
    pair = ("cubic_stiffness", "quintic_stiffness")
    return NextTest(text, command_text(request), pair, sigma, seconds, nats, request=request)


def asked_levels(test: AskedTest) -> str:
    return ",".join(f"{level:g}" for level in test.request.levels)


@dataclass
class Bench:
    """Measures nothing and believes what it is given, one diagnosis after the other."""

    beliefs: list[Any]
    seconds: float = 30.0
    made: list[AskedTest] = field(default_factory=list)
    thought: list[tuple[str, ...]] = field(default_factory=list)
    fails_at: int = 0
    empty: tuple[str, ...] = ()

    def measure(self, test: AskedTest) -> tuple[float, float]:
        if asked_levels(test) in self.empty:
            raise EmptyTestError("no level locked", self.seconds)
        if len(self.made) + 1 == self.fails_at:
            self.fails_at = 0
            raise BenchError("a node died")
        self.made.append(test)
        return self.seconds, math.nan if test.is_random else test.request.top

    def think(self, names: Sequence[str]) -> tuple[Any, float]:
        self.thought.append(tuple(names))
        return self.beliefs[min(len(self.thought), len(self.beliefs)) - 1], 1.0


def investigated(
    folder: Path,
    bench: Bench,
    settings: InvestigationSettings = SETTINGS,
    agree: Callable[[AskedTest], str] = lambda _: YES,
    record: InvestigationRecord | None = None,
) -> InvestigationRecord:
    begun = record or InvestigationRecord("beam", "real.yaml")
    return Investigation(begun, settings, folder, bench.measure, bench.think, agree).run()


def test_a_linear_test_and_the_lowest_levels_come_first(tmp_path: Path) -> None:
    bench = Bench([SURE])
    record = investigated(tmp_path, bench)
    linear, levels = bench.made
    assert command_words(linear.request) == ("linear", "real.yaml", "--duration", "10")
    words = command_words(levels.request)
    assert words[:4] == ("run", "real.yaml", "--levels", "0.1,0.2")
    assert words[4:6] == ("--periods", "20")
    assert words[6:] == ("--linear", str(tmp_path / "01_linear" / "linear.json"))
    assert record.ended == "named"
    assert record.conclusion.startswith("which: effect Of effects that act above 0.2 V only nothing is known")
    assert record.bench_s == 60.0
    assert bench.thought == [("01_linear", "02_levels")]


def test_the_test_that_tells_most_for_its_time_is_made(tmp_path: Path) -> None:
    slow = ahead("slow", POINT_4, 40.0, 200.0, 0.6)
    quick = ahead("quick", POINT_5, 5.0, 20.0, 0.5)
    bench = Bench([diagnosis(Verdict.EFFECT, OPEN.probabilities, [slow, quick]), SURE])
    record = investigated(tmp_path, bench)
    third = record.measured[2]
    assert (third.text, third.expected) == ("quick", 0.5)
    assert third.request == replace(POINT_5, periods=20)  # no linear test of another drive point
    before, after = (sum(-p * math.log(p) for p in pair) for pair in ((0.6, 0.4), (0.99, 0.01)))
    assert third.received == pytest.approx(before - after)
    assert record.ended == "named"


def test_levels_of_the_plan_are_expected_to_show_what_was_too_weak(tmp_path: Path) -> None:
    """Expected by the last diagnosis; received: whether something acts is known better, or for certain."""
    hidden = Hidden(0.2, 0.1)
    levels = NextTest("more", "", ("none", HIDDEN), math.nan, 20.0, hidden.information, hidden.probability)
    weak = diagnosis(Verdict.NONE, {"none": 0.8, "unknown": 0.2}, levels=levels)
    bench = Bench([weak, SURE])
    record = investigated(tmp_path, bench)
    third = record.measured[2]
    assert record.turns[0].answers == pytest.approx({"none": 0.8, HIDDEN: 0.2})
    assert third.expected == pytest.approx(hidden.information)
    assert "20 %" in third.why
    assert third.received == pytest.approx(-0.8 * math.log(0.8) - 0.2 * math.log(0.2))  # no gap has no share any more
    assert record.ended == "named"


def test_what_shows_and_does_not_matter_is_no_gap(tmp_path: Path) -> None:
    """It has a share in the answers; what is open is what further levels show."""
    small = {"none": 0.84, "cubic_stiffness@2": 0.16}
    levels = [NextTest("more", "", ("none", HIDDEN), math.nan, 20.0, 0.05, p) for p in (0.2, 0.1)]
    bench = Bench([diagnosis(Verdict.NONE, small, levels=it) for it in (*levels, None)])
    record = investigated(tmp_path, bench)
    assert record.turns[0].answers == pytest.approx({"none": 0.672, HIDDEN: 0.2, "cubic_stiffness": 0.128})

    def entropy(p: float) -> float:
        return -p * math.log(p) - (1.0 - p) * math.log(1.0 - p)

    received = [test.received for test in record.measured[2:]]
    assert received == pytest.approx([entropy(0.2) - entropy(0.1), entropy(0.1)])


def test_no_gap_is_said_at_the_end_of_the_plan_only(tmp_path: Path) -> None:
    bench = Bench([NOTHING])
    record = investigated(tmp_path, bench)
    levels = [asked_levels(test) for test in bench.made if not test.is_random]
    assert levels == ["0.1,0.2", "0.3,0.4", "0.5,0.6"]
    assert record.ended == "no_gap"


GAIN = diagnosis(Verdict.EFFECT, {"response_gain@a3": 0.99, "sensor_mass@a3": 0.01}, equivalents=("sensor_mass",))
BOTH = diagnosis(Verdict.EFFECT, {"cubic_stiffness@2 + response_gain@a3": 0.99})


def test_a_gain_that_is_found_at_low_level_hides_nothing_of_the_plan(tmp_path: Path) -> None:
    """It acts alike at every level: the plan is climbed to its top, or until what grows is found beside it."""
    bench = Bench([GAIN])
    alone = investigated(tmp_path, bench)
    assert [asked_levels(test) for test in bench.made[1:]] == ["0.1,0.2", "0.3,0.4", "0.5,0.6"]
    assert (alone.ended, alone.conclusion, alone.bound) == ("named", "which: effect", "")
    bench = Bench([GAIN, BOTH])
    (tmp_path / "both").mkdir()
    both = investigated(tmp_path / "both", bench)
    assert [asked_levels(test) for test in bench.made[1:]] == ["0.1,0.2", "0.3,0.4"]
    assert "above 0.4 V only nothing is known" in both.conclusion


def test_a_gain_is_named_with_its_bound_where_the_time_is_used_up(tmp_path: Path) -> None:
    record = investigated(tmp_path, Bench([GAIN]), replace(SETTINGS, budget_s=70.0))
    assert (record.ended, len(record.measured)) == ("named", 2)
    assert record.conclusion == f"which: effect {record.bound}"
    values = json.loads((tmp_path / "investigate.json").read_text(encoding="utf-8"))
    assert (values["reached"], values["bound"]) == (0.2, record.bound)


def test_a_level_that_did_not_lock_is_not_known(tmp_path: Path) -> None:
    """Of the last test half its levels: what is said holds as far as they locked."""
    bench = Bench([NOTHING])
    record = investigated(tmp_path, bench)
    assert (record.ended, record.bound) == ("no_gap", "")
    last = replace(record.tests[-1], reached=0.5)
    assert "above 0.5 V only" in replace(record, tests=(*record.tests[:-1], last)).bound


def test_what_only_moved_parameters_explain_is_no_lack_of_a_gap(tmp_path: Path) -> None:
    moved = diagnosis(Verdict.CALIBRATION, {"none": 0.99, "unknown": 0.01})
    record = investigated(tmp_path, Bench([moved]))
    assert record.ended == "recalibrated"
    page = investigation_page(record)
    assert "The model&#39;s own parameters were off" in page
    assert "There is no gap" not in page


def test_no_gap_is_not_said_against_a_plain_look(tmp_path: Path) -> None:
    bench = Bench([NOTHING])
    begun = InvestigationRecord("beam", "real.yaml")
    look = "The frequency moves by 3 % more than the model says."
    record = Investigation(begun, SETTINGS, tmp_path, bench.measure, bench.think, look=lambda: look).run()
    assert (record.ended, record.conclusion) == ("unknown", look)


def test_what_no_test_sets_apart_is_said(tmp_path: Path) -> None:
    alike = diagnosis(Verdict.EFFECT, {"cubic_stiffness@2": 0.6, "clearance@2": 0.4}, equivalents=("clearance",))
    bench = Bench([alike])
    record = investigated(tmp_path, bench)
    assert record.ended == "not_told_apart"
    assert "cubic stiffness or clearance cannot be told" in record.conclusion
    assert max(test.request.top for test in bench.made[1:]) == PLAN[-1]


def test_what_predicts_the_same_and_is_improbable_needs_no_test(tmp_path: Path) -> None:
    """Its model and chain would have to be what nobody believes: the probability of the other alone is enough."""
    both = {"cubic_stiffness@2": 0.96, "clearance@2": 0.04}
    record = investigated(tmp_path, Bench([diagnosis(Verdict.EFFECT, both, equivalents=("clearance",))]))
    assert (record.ended, len(record.measured)) == ("named", 2)


def test_levels_that_tell_rivals_little_apart_are_not_made(tmp_path: Path) -> None:
    """What all of the plan would not tell is said after the first two tests, with the sensors that would tell it."""
    pair = ("cubic_stiffness", "clearance")
    sensors = [NextTest(f"a sensor at point {point}", "", pair, 10.0 - point) for point in (3, 5)]
    for sigma, made in ((0.9, 2), (1.1, 4)):
        levels = NextTest("more", "", pair, sigma, 20.0, 0.01, levels=PLAN[2:4], plan_sigma=sigma)
        p = {"cubic_stiffness@2": 0.6, "clearance@2": 0.4}
        beliefs = [diagnosis(Verdict.EFFECT, p, (), pair[1:], it, sensors) for it in (levels, levels, None)]
        bench = Bench(beliefs)
        folder = tmp_path / str(made)
        folder.mkdir()
        record = investigated(folder, bench)
        assert record.ended == "not_told_apart"
        assert len(record.measured) == made
        assert "a sensor at point 3 would, by 7; also a sensor at point 5" in record.conclusion


@pytest.mark.parametrize(("information", "made"), [(7e-4, False), (1.4e-3, True)])
def test_a_test_that_tells_next_to_nothing_is_not_made(tmp_path: Path, information: float, made: bool) -> None:
    mode = ahead("mode 2", MODE_2, 5.0, 20.0, information)
    bench = Bench([diagnosis(Verdict.EFFECT, OPEN.probabilities, [mode])])
    investigated(tmp_path, bench)
    assert ("mode 2" in [test.text for test in bench.made]) == made


def test_what_explains_a_part_is_not_set_against_itself_with_more(tmp_path: Path) -> None:
    """Where something unnamed acts beside it, that is the end; levels that are left may still show a law."""
    pair = ("microslip", "microslip + two_sided_gap")
    levels = NextTest("more", "", pair, 0.0, 20.0, 0.0, levels=PLAN[2:4], plan_sigma=0.0)
    moved = ahead("moved", POINT_4, 99.0, 20.0, 1e-9)
    partly = diagnosis(Verdict.EFFECT, {"unknown": 1.0, "microslip@joint": 0.0}, [moved], levels=levels)
    partly.adequate = False
    record = investigated(tmp_path, Bench([partly]))
    assert len(record.measured) == 4
    assert (record.ended, record.conclusion) == ("unknown", "where which: effect")


def test_as_many_levels_are_made_as_the_diagnosis_asks_for(tmp_path: Path) -> None:
    """Where what is small so far is expected to matter at the top, in one test; said why."""
    levels = NextTest(
        "more", "", ("none", HIDDEN), math.nan, 40.0, 0.05, 0.9, grows="cubic_stiffness", levels=PLAN[2:]
    )  # fmt: skip
    small = diagnosis(Verdict.NONE, {"none": 0.84, "cubic_stiffness@2": 0.16}, levels=levels)
    record = investigated(tmp_path, Bench([small, SURE]))
    assert asked_levels(record.measured[2]) == "0.3,0.4,0.5,0.6"
    assert "cubic stiffness, too small to matter so far, grows to what matters, 90 %" in record.measured[2].why


def test_an_exciter_that_nobody_moves_stays(tmp_path: Path) -> None:
    """On hardware without a person: the other test is made, and what moving would tell is said."""
    moved = ahead("the same levels with the exciter at point 4", POINT_4, 40.0, 20.0, 0.6)
    mode = ahead("mode 2", MODE_2, 5.0, 20.0, 0.1)
    bench = Bench([diagnosis(Verdict.EFFECT, OPEN.probabilities, [moved, mode])])
    record = investigated(tmp_path, bench, replace(SETTINGS, fixed_exciter=True))
    assert "mode 2" in [test.text for test in bench.made]
    assert all(not test.request.exciters for test in bench.made)
    assert record.ended == "not_told_apart"
    assert "the exciter at point 4 would, by 40: with --ask the exciter is moved" in record.conclusion


@pytest.mark.parametrize("budget", [45.0, 70.0, 100.0])
def test_no_test_is_begun_that_goes_beyond_the_budget(budget: float, tmp_path: Path) -> None:
    """The first two tell nothing alone and are made; those after them only where they are expected to fit."""
    bench = Bench([NOTHING], seconds=20.0)
    record = investigated(tmp_path, bench, replace(SETTINGS, budget_s=budget))
    assert record.bench_s <= max(budget, 40.0)
    assert record.ended == ("no_gap" if budget >= 80.0 else "budget")


def test_a_person_declines_or_stops(tmp_path: Path) -> None:
    one = ahead("one", POINT_4, 40.0, 20.0, 0.6)
    other = ahead("other", POINT_5, 40.0, 20.0, 0.5)
    bench = Bench([diagnosis(Verdict.EFFECT, OPEN.probabilities, [one, other]), SURE])
    first, second = tmp_path / "a", tmp_path / "b"
    first.mkdir()
    second.mkdir()
    record = investigated(first, bench, agree=lambda test: NO if test.text == "one" else YES)
    assert [test.state for test in record.tests] == ["measured", "measured", "declined", "measured"]
    assert record.measured[-1].text == "other"
    bench = Bench([OPEN])
    record = investigated(second, bench, agree=lambda _: STOP)
    assert (record.ended, bench.made) == ("stopped", [])


def test_a_failed_test_is_repeated_and_nothing_is_lost(tmp_path: Path) -> None:
    bench = Bench([NOTHING, SURE], fails_at=3)
    with pytest.raises(BenchError, match="a node died"):
        investigated(tmp_path, bench)
    kept = read_record(tmp_path)
    assert kept is not None
    assert [test.state for test in kept.tests] == ["measured", "measured", "failed"]
    record = investigated(tmp_path, bench, record=kept)
    assert [asked_levels(test) for test in record.measured[1:]] == ["0.1,0.2"]
    assert len(bench.made) == 2
    assert record.ended == "named"


def test_a_test_that_locks_nothing_is_not_asked_again(tmp_path: Path) -> None:
    """It counts as made: by its bench time, and levels go on above it, in the same call and in the next one."""
    bench = Bench([NOTHING], empty=("0.1,0.2", "0.5,0.6"))
    record = investigated(tmp_path, bench)
    states = [(asked_levels(test), test.state) for test in record.tests[1:]]
    assert states == [("0.1,0.2", "empty"), ("0.3,0.4", "measured"), ("0.5,0.6", "empty")]
    assert record.bench_s == 4 * bench.seconds
    assert record.ended == "no_gap"
    assert bench.thought[-1] == ("01_linear", "03_levels")
    kept = replace(record, tests=record.tests[:2], turns=(), ended="", conclusion="")
    again = Bench([NOTHING], empty=("0.5,0.6",))
    investigated(tmp_path, again, record=kept)
    assert [asked_levels(test) for test in again.made] == ["0.3,0.4"]


def test_a_rig_that_never_locks_is_said(tmp_path: Path) -> None:
    bench = Bench([NOTHING], empty=("0.1,0.2", "0.3,0.4", "0.5,0.6"))
    record = investigated(tmp_path, bench)
    assert record.ended == "stopped"
    assert "No level of the plan locked" in record.conclusion
    assert not bench.thought


def test_a_test_that_was_cut_short_is_asked_for_again(tmp_path: Path) -> None:
    """Ctrl-C or a killed process: its levels were not measured."""
    bench = Bench([NOTHING])
    whole = investigated(tmp_path, bench)
    cut = replace(whole.tests[2], state="asked", seconds=math.nan)
    kept = replace(whole, tests=(*whole.tests[:2], cut), turns=whole.turns[:1], ended="", conclusion="")
    again = Bench([NOTHING])
    record = investigated(tmp_path, again, record=kept)
    assert [asked_levels(test) for test in again.made] == ["0.3,0.4", "0.5,0.6"]
    assert record.tests[2].state == "failed"
    assert len({test.name for test in record.tests}) == len(record.tests)


def test_no_level_above_one_that_was_declined_is_proposed(tmp_path: Path) -> None:
    bench = Bench([NOTHING])
    record = investigated(tmp_path, bench, agree=lambda test: NO if asked_levels(test) == "0.3,0.4" else YES)
    assert [asked_levels(test) for test in bench.made[1:]] == ["0.1,0.2"]
    assert record.ended == "stopped"
    assert "declined" in record.conclusion


def test_a_record_is_read_as_it_was_written(tmp_path: Path) -> None:
    record = investigated(tmp_path, Bench([NOTHING]))
    kept = read_record(tmp_path)
    assert kept is not None
    assert repr(kept) == repr(record)
    (tmp_path / "investigate.json").write_text('{"format": "something"}', encoding="utf-8")
    with pytest.raises(BenchError, match="another folder"):
        read_record(tmp_path)
    assert read_record(tmp_path / "nowhere") is None


def test_recordings_get_the_next_test_as_a_command(tmp_path: Path) -> None:
    slow = ahead("slow", POINT_4, 40.0, 200.0, 0.6)
    quick = ahead("quick", POINT_5, 5.0, 20.0, 0.5)
    given = InvestigationRecord("beam", bags=("a", "b"))
    record = proposed(given, lambda names: (diagnosis(Verdict.EFFECT, OPEN.probabilities, [slow, quick]), 1.0))
    assert [test.text for test in record.tests] == ["quick", "slow"]
    assert record.ended == "proposed"
    assert record.turns[0].tests == 2


def test_the_page_shows_what_was_believed_and_asked(tmp_path: Path) -> None:
    quick = ahead("quick & dirty", POINT_5, 5.0, 20.0, 0.5)
    bench = Bench([diagnosis(Verdict.EFFECT, OPEN.probabilities, [quick]), SURE])
    record = investigated(tmp_path, bench)
    page = investigation_page(record)
    assert "quick &amp; dirty" in page
    assert "The cause has a name" in page
    assert shown_answers(record) == ["cubic_stiffness", "quintic_stiffness"]
    assert "<svg" in page
    assert investigation_page(InvestigationRecord("beam", "real.yaml", ended="stopped")).count("<svg") == 0


def test_answers_are_those_of_effects_wherever_they_act() -> None:
    found = answers_of(diagnosis(Verdict.EFFECT, {"none": 0.1, "b@1 + a@2": 0.2, "a@3 + b@1": 0.3, "a@1": 0.4}))
    assert found == pytest.approx({"a + b": 0.5, "a": 0.4, "none": 0.1})


@pytest.mark.parametrize(("p", "sigmas"), [(0.5, 0.5), (0.5, 2.0), (0.9, 1.0), (0.98, 3.0)])
def test_expected_information_is_the_mean_over_what_may_be_measured(p: float, sigmas: float) -> None:
    """By draws of a measurement with unit noise whose mean is 0 under one hypothesis and d under the other."""
    rng = np.random.default_rng(5)
    second = rng.random(400_000) > p
    measured = rng.standard_normal(second.size) + sigmas * second
    like = [p * np.exp(-0.5 * measured**2), (1.0 - p) * np.exp(-0.5 * (measured - sigmas) ** 2)]
    after = like[0] / (like[0] + like[1])
    left = -after * np.log(after) - (1.0 - after) * np.log1p(-after)
    before = -p * math.log(p) - (1.0 - p) * math.log(1.0 - p)
    assert expected_information(p, 1.0 - p, sigmas) == pytest.approx(before - float(np.mean(left)), abs=2e-3)


def test_expected_information_has_its_limits() -> None:
    assert expected_information(0.3, 0.3, 99.0) == pytest.approx(math.log(2.0))
    assert expected_information(0.5, 0.5, 0.0) == pytest.approx(0.0, abs=1e-12)
    assert expected_information(1.0, 0.0, 9.0) == 0.0
    assert expected_information(0.0, 0.0, 9.0) == 0.0
