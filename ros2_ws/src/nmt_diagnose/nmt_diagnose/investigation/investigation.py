"""The loop of an investigation: diagnose, choose the test with most information for its bench time, measure; again.

Nothing here runs a node or fits a model: measuring, diagnosing and asking are handed in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.kinds import RandomTest
from nmt_core.kinds.request import TestRequest
from nmt_diagnose.effects.library import ALIKE_AT_EVERY_LEVEL
from nmt_diagnose.effects.location import effect_words
from nmt_diagnose.investigation.answers import answers_of, end_of, entropy_of, reason, worth
from nmt_diagnose.investigation.checks import ended_record
from nmt_diagnose.investigation.investigation_record import AskedTest, EmptyTestError, InvestigationRecord, Turn
from nmt_diagnose.ledger.diagnosis import HIDDEN, Diagnosis, NextTest, Verdict
from nmt_diagnose.thresholds import THRESHOLDS

YES, NO, STOP = "yes", "no", "stop"


@dataclass(frozen=True)
class InvestigationSettings:
    """How an investigation goes about.

    Attributes:
        until: probability of an answer from which it is taken.
        budget_s: most bench time, s.
        levels: plan of the real rig, V, from low to high; no test goes beyond it.
        periods: whole periods of a window.
        random_s: length of each record of the linear test, s.
        fixed_exciter: the exciter stays where it is: that of hardware is moved by people.
    """

    until: float = 0.95
    budget_s: float = math.inf
    levels: tuple[float, ...] = ()
    periods: int = 50
    random_s: float = 20.0
    fixed_exciter: bool = False


Measure = Callable[[AskedTest], tuple[float, float]]
"""Carries a test out and returns its bench time in s and the highest level that locked, NaN of a random test; raises
BenchError where it failed, EmptyTestError where it showed nothing."""
Think = Callable[[Sequence[str]], tuple[Diagnosis, float]]
"""Diagnoses the tests of these names; the diagnosis and the processor time that it took in s."""
Agree = Callable[[AskedTest], str]
"""What a person says to a test: yes, no or stop."""
Look = Callable[[], str]
"""What a plain look at the recordings says against having no gap; empty where it says nothing."""


class Investigation:
    """Chooses tests, has them carried out, and learns from them.

    Args:
        record: how far it has come.
        settings: how it goes about.
        folder: where tests and record are kept.
        measure, think, agree, look: do the work.
        command: writes the command of a test for the record; empty where none does it.
        tell: called with a sentence as it goes on.
        changed: called with the record whenever it has grown.
    """

    def __init__(
        self,
        record: InvestigationRecord,
        settings: InvestigationSettings,
        folder: Path,
        measure: Measure,
        think: Think,
        agree: Agree = lambda _: YES,
        command: Callable[[TestRequest], str] = lambda _: "",
        tell: Callable[[str], None] = lambda _: None,
        changed: Callable[[InvestigationRecord], None] = lambda _: None,
        look: Look = lambda: "",
    ) -> None:
        # What was under way when an earlier call ended was not measured: it is asked for again.
        tests = [replace(test, state="failed", seconds=0.0) if test.state == "asked" else test for test in record.tests]
        self.record = replace(record, tests=tuple(tests), plan=tuple(sorted(settings.levels)))
        self.settings, self.folder = settings, folder
        self._measure, self._think, self._agree, self._tell, self._changed = measure, think, agree, tell, changed
        self._command, self._look = command, look
        self.diagnosis: Diagnosis | None = None

    def run(self) -> InvestigationRecord:
        """Go on until it ends; the record is written after every step.

        Raises:
            BenchError: a test failed; the record says which, and the next call repeats it.
        """
        while (test := self._next_test()) is not None:
            self._carry_out(test)
        self._written()
        return self.record

    def _written(self) -> None:
        self.record.write(self.folder)
        self._changed(self.record)

    def _next_test(self) -> AskedTest | None:
        """What is measured next; None where it has ended, and the record says why."""
        if self.record.ended:
            return None
        first = self._first_test()
        if first is not None or self.record.ended:
            return first
        # A test that was declined gives no information.
        if self.diagnosis is None or self.record.turns[-1].tests < len(self.record.measured):
            self._learn()
        chosen = None if self.record.ended else self._choose()
        if chosen is None and not self.record.ended:
            self._conclude()
        return chosen

    # -- tests --------------------------------------------------------------------------------------------------------

    def _name(self, what: str) -> str:
        return f"{len(self.record.tests) + 1:02d}_{what}"

    def _asking(self, what: str, request: TestRequest, text: str, why: str, seconds: float) -> AskedTest:
        return AskedTest(self._name(what), request, text, why, seconds=seconds, command=self._command(request))

    def _first_test(self) -> AskedTest | None:
        """The linear test, then the lowest levels of the plan; None once both are measured."""
        linear = [test.is_random for test in self.record.measured]
        rig, settings = self.record.real, self.settings
        if True not in linear:
            request = TestRequest(kind=RandomTest(duration=settings.random_s), rig=rig)
            why = "the linear modes, and what is wrong with sensors and mass"
            return self._asking("linear", request, "a random test at low level", why, 2.05 * settings.random_s)
        if False not in linear:
            tried = self._highest_level()
            lowest = [level for level in settings.levels if level > 1.001 * tried]
            lowest = lowest[: max(2, math.ceil(len(settings.levels) / 3))]
            if lowest:
                text, why = "the lowest levels of the plan", "how frequency and damping begin to move"
                return self._levels_test(lowest, text if tried == 0.0 else "the next levels of the plan", why)
            self._end("stopped", "No level of the plan locked: see the logs of the tests for why.")
        return None

    def _highest_level(self) -> float:
        """Of the tests at levels that were made; 0 where there is none."""
        return max((test.request.top for test in self.record.made if not test.is_random), default=0.0)

    def _levels_test(self, levels: Sequence[float], text: str, why: str) -> AskedTest:
        request = self._complete(TestRequest(rig=self.record.real, levels=tuple(levels)))
        seconds = self._seconds_of_levels(len(levels))
        return self._asking("levels", request, f"{text}, up to {request.top:.3g} V", why, seconds)

    def _seconds_of_levels(self, count: int) -> float:
        """Bench time of so many levels as those before took it; NaN before any."""
        times = [
            (test.seconds, max(1, len(test.request.levels))) for test in self.record.measured if not test.is_random
        ]
        return count * sum(s for s, _ in times) / max(1, sum(n for _, n in times)) if times else math.nan

    def _complete(self, request: TestRequest) -> TestRequest:
        """A test at levels with what every one here has."""
        linear = next((test.name for test in self.record.measured if test.is_random), "")
        request = replace(request, periods=request.periods or self.settings.periods)
        # A linear test belongs to its exciter and mode.
        if linear and not request.exciters and not request.changes:
            request = replace(request, linear=str(self.folder / linear / "linear.json"))
        return request

    def _next_levels(self) -> AskedTest | None:
        """The next levels of the plan above what was measured; None at its end, and above levels that were declined.

        None, too, where rivals are left that all of them would not set apart, unless they act alike at every level:
        what else acts at levels that are left such rivals hide.
        """
        if any(test.state == "declined" and not test.is_random for test in self.record.tests):
            return None
        found = None
        if self.diagnosis is not None:
            found = self.diagnosis.next_levels
            explained = self.diagnosis.verdict is Verdict.EFFECT and self.diagnosis.adequate
            if explained and found is not None and found.tells_little and not self._acts_alike():
                return None
        top = self._highest_level()
        more = [level for level in self.settings.levels if level > 1.001 * top]
        third = more[: max(1, math.ceil(len(self.settings.levels) / 3))]
        expected = [] if found is None else [level for level in more if level in found.levels]
        if not more:
            return None
        return self._expected_of_levels(
            self._levels_test(expected or third, "the next levels of the plan", "whether the gap grows with the level")
        )

    def _expected_of_levels(self, test: AskedTest) -> AskedTest:
        """The next levels of the plan with what the last diagnosis expects of them."""
        ahead = None if self.diagnosis is None else self.diagnosis.next_levels
        if ahead is None or not math.isfinite(ahead.information) or (ahead.tells_little and self._acts_alike()):
            return test
        if ahead.grows:
            small = effect_words(ahead.grows)
            why = f"whether {small}, too small to matter so far, grows to what matters, {100.0 * ahead.hidden:.0f} %"
        elif HIDDEN in ahead.separates:
            why = f"what is too weak to show so far, {100.0 * ahead.hidden:.0f} %"
        else:
            why = reason(ahead)
        return replace(
            test, why=why, separates=ahead.separates, expected_sigma=ahead.expected_sigma, expected=ahead.information
        )

    def _choose(self) -> AskedTest | None:
        """The test with the most expected information for its bench time; None where none remains that may be made."""
        assert self.diagnosis is not None
        if self._is_named():
            levels = self._next_levels()
            return levels if levels is not None and self._affordable(levels) else None
        least = THRESHOLDS.next_test.least_information
        proposed = [self._asked(item) for item in self._possible() if not item.information < least]
        levels = self._next_levels()
        if levels is not None and levels.expected >= least:
            proposed.append(levels)
        known = [test.request for test in self.record.tests if test.state != "failed"]
        proposed = [test for test in proposed if test.request not in known and self._affordable(test)]
        if proposed:
            return max(proposed, key=worth)
        return levels if levels is not None and self._affordable(levels) else None

    def _possible(self) -> list[NextTest]:
        """Proposed tests that have a command and need no person at the rig."""
        assert self.diagnosis is not None
        fixed = self.settings.fixed_exciter
        return [
            test
            for test in self.diagnosis.next_test
            if test.command and test.request is not None and not (fixed and test.request.exciters)
        ]

    def _asked(self, item: NextTest) -> AskedTest:
        assert item.request is not None
        random = isinstance(item.request.kind, RandomTest)
        request = item.request if random else self._complete(item.request)
        return AskedTest(
            self._name("linear" if random else "levels"), request, item.test, reason(item), item.separates,
            item.expected_sigma, item.information, seconds=item.seconds, command=self._command(request),
        )  # fmt: skip

    def _affordable(self, test: AskedTest) -> bool:
        return not self.record.bench_s + (test.seconds if math.isfinite(test.seconds) else 0.0) > self.settings.budget_s

    def _carry_out(self, test: AskedTest) -> None:
        answer = self._agree(test)
        if answer == STOP:
            self._end("stopped", "It was stopped before its next test.")
            return
        if answer == NO:
            self._keep(replace(test, state="declined"))
            if test.is_random or not self.record.turns:
                self._end("stopped", "Without its first two tests nothing can be told.")
            return
        self._tell(f"test {len(self.record.made) + 1}: {test.text} ({test.why})")
        self._keep(test)
        try:
            seconds, reached = self._measure(test)
        except EmptyTestError as nothing:
            # Asked again it would show nothing again.
            self._tell(str(nothing))
            self._keep(replace(test, state="empty", seconds=nothing.seconds))
            return
        except BenchError:
            self._keep(replace(test, state="failed", seconds=0.0))
            raise
        self._keep(replace(test, state="measured", seconds=seconds, reached=reached))

    def _keep(self, test: AskedTest) -> None:
        self.record = self.record.with_test(test)
        self._written()

    # -- what is learnt -----------------------------------------------------------------------------------------------

    def _learn(self) -> None:
        """Diagnose all that was measured, record what the last test gave, and end where the answer is sure enough."""
        names = [test.name for test in self.record.measured]
        self._tell(f"diagnosing {len(names)} tests, {self.record.bench_s:.0f} s of bench time")
        self.diagnosis, seconds = self._think(names)
        answers = answers_of(self.diagnosis)
        last = self.record.measured[-1] if self.record.measured else None
        if last is not None and last.separates and self.record.turns and not math.isfinite(last.received):
            turn = self.record.turns[-1]
            before = entropy_of(turn.answers, last.separates, turn.verdict)
            after = entropy_of(answers, last.separates, self.diagnosis.verdict.value)
            self._keep(replace(last, received=before - after))
        text = self.diagnosis.sentences[1] if len(self.diagnosis.sentences) > 1 else ""
        turn = Turn(len(names), self.record.bench_s, seconds, self.diagnosis.verdict.value, answers, text)
        self.record = replace(self.record, turns=(*self.record.turns, turn))
        self._written()
        if self._is_named():
            # Such a cause is found at low level, and whatever grows with the level is not.
            if not (self._acts_alike() and self._next_levels()):
                self._end("named", text)
        elif self._has_no_gap() and self._sure(answers) and not (self._next_levels() or self._declined()):
            self._end_without_gap()

    def _has_no_gap(self) -> bool:
        assert self.diagnosis is not None
        return self.diagnosis.verdict in (Verdict.NONE, Verdict.CALIBRATION)

    def _is_named(self) -> bool:
        """Whether a cause explains everything and is sure enough."""
        found = self.diagnosis
        named = found is not None and found.verdict is Verdict.EFFECT and found.adequate
        return named and self._sure(self.record.turns[-1].answers)

    def _acts_alike(self) -> bool:
        """Whether the first explanation and all that is taken for it act alike at every level."""
        if self.diagnosis is None or not self.diagnosis.ranking:
            return False
        first = self.diagnosis.ranking[0]
        names = {name for effect in (first.effect, *first.equivalents) for name in effect.split(" + ")}
        return names <= ALIKE_AT_EVERY_LEVEL

    def _end_without_gap(self) -> None:
        """No gap, unless a plain look at the recordings says otherwise."""
        assert self.diagnosis is not None
        contradicted = self._look()
        if contradicted:
            self._end("unknown", contradicted)
        else:
            self._end(end_of(self.diagnosis), self.diagnosis.sentences[1])

    def _declined(self) -> bool:
        return any(test.state == "declined" for test in self.record.tests)

    def _sure(self, answers: Mapping[str, float]) -> bool:
        """Whether an answer has the wanted probability without what the recordings do not distinguish from it."""
        assert self.diagnosis is not None
        if self.diagnosis.verdict is Verdict.EFFECT and self.diagnosis.ranking:
            first = self.diagnosis.ranking[0]
            alone = first.probability if not first.equivalents else answers.get(first.effect, 0.0)
            return alone >= self.settings.until
        return answers.get("none", 0.0) >= self.settings.until

    def _conclude(self) -> None:
        """Say why no further test is made."""
        assert self.diagnosis is not None
        found = self.diagnosis
        left = self._possible()
        if self._is_named():
            self._end("named", found.sentences[1])
        elif self._next_levels() is not None or any(not self._affordable(self._asked(item)) for item in left):
            self._end("budget", f"The bench time is used up. So far: {found.sentences[1]}")
        elif self._declined():
            self._end("stopped", f"The remaining tests were declined. So far: {found.sentences[1]}")
        elif self._has_no_gap():
            self._end_without_gap()
        elif end_of(found) == "unknown":
            self._end("unknown", " ".join(found.sentences[:2]))
        else:
            first = found.ranking[0]
            least = THRESHOLDS.next_test.second_class_share * first.probability
            second = [row.effect for row in found.ranking[1:2] if row.probability > least]
            rivals = dict.fromkeys((first.effect, *first.equivalents, *second))
            apart = " or ".join(effect_words(name) for name in rivals)
            self._end(
                "not_told_apart",
                f"Whether it is {apart} cannot be told with these sensors and exciters: no level of the plan, other "
                f"drive point or mode that is left sets them apart by a standard deviation; {self._elsewhere()}.",
            )

    def _elsewhere(self) -> str:
        """What would set apart what no test that is left does."""
        assert self.diagnosis is not None
        moved = [item for item in self.diagnosis.next_test if item not in self._possible()]
        if moved:
            best = max(moved, key=lambda item: item.expected_sigma)
            return f"{best.test} would, by {best.expected_sigma:.0f}: with --ask the exciter is moved between tests"
        if not self.diagnosis.other_sensors:
            return "nor would one more sensor at any point of the model"
        best = self.diagnosis.other_sensors[0]
        others = [item.test for item in self.diagnosis.other_sensors[1:3]]
        return f"{best.test} would, by {best.expected_sigma:.0f}" + (f"; also {' or '.join(others)}" if others else "")

    def _end(self, why: str, sentence: str) -> None:
        """End with a sentence, unless the record contradicts it."""
        self.record = ended_record(self.record, why, sentence)
        self._written()


def proposed(record: InvestigationRecord, think: Think) -> InvestigationRecord:
    """The record after a diagnosis of recordings that were given, with the tests that it proposes.

    Args:
        record: its ``bags`` are diagnosed.
        think: called without names.
    """
    diagnosis, seconds = think(())
    answers = answers_of(diagnosis)
    text = diagnosis.sentences[1] if len(diagnosis.sentences) > 1 else ""
    turn = Turn(len(record.bags), record.bench_s, seconds, diagnosis.verdict.value, answers, text)
    tests = [
        AskedTest(
            f"{number:02d}_proposal", item.request or TestRequest(), item.test, reason(item), item.separates,
            item.expected_sigma, item.information, seconds=item.seconds, command=item.command,
        )
        for number, item in enumerate(diagnosis.next_test, 1)
    ]  # fmt: skip
    tests.sort(key=worth, reverse=True)
    ended = "proposed" if tests else end_of(diagnosis)
    return replace(record, tests=tuple(tests), turns=(*record.turns, turn), ended=ended, conclusion=text)
