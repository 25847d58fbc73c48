"""What an investigation has asked, measured and learnt: the content of ``investigate.json``."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json
from nmt_core.files.whole_file import write_whole
from nmt_core.kinds import RandomTest
from nmt_core.kinds.request import TestRequest

FORMAT = "nmt investigation 3"
RECORD_FILE = "investigate.json"


class EmptyTestError(BenchError):
    """A test was carried out to its end and no level of it locked.

    Args:
        sentence: says so.
        seconds: its bench time.
    """

    def __init__(self, sentence: str, seconds: float) -> None:
        super().__init__(sentence)
        self.seconds = seconds


@dataclass(frozen=True)
class AskedTest:
    """A test that was chosen.

    Attributes:
        name: of its folder.
        request: the test as a value.
        text: what is done, for people.
        why: what it is expected to show.
        separates: answers that it is to separate; empty where it only goes on with the plan.
        expected_sigma: by how many standard deviations.
        expected: fall of their entropy that is expected, nats; NaN where none is computed.
        received: what the entropy of these answers fell by, nats; negative where it rose.
        seconds: bench time, s; the expected one until it is measured.
        command: what carries it out, for people; empty where no command does.
        state: ``asked``, ``measured``, ``empty`` (no level of it locked), ``declined`` or ``failed``.
        reached: highest level of which a window locked; NaN until it is measured, and of a random test.
    """

    name: str
    request: TestRequest
    text: str
    why: str
    separates: tuple[str, ...] = ()
    expected_sigma: float = math.nan
    expected: float = math.nan
    received: float = math.nan
    seconds: float = math.nan
    command: str = ""
    state: str = "asked"
    reached: float = math.nan

    @property
    def is_random(self) -> bool:
        """Whether it is the test that determines the linear modes."""
        return isinstance(self.request.kind, RandomTest)


@dataclass(frozen=True)
class Turn:
    """The posterior after a diagnosis.

    Attributes:
        tests: how many had been measured.
        bench_s: bench time until then, s.
        thinking_s: processor time that the diagnosis took, s.
        verdict: of the diagnosis.
        answers: probability of ``none``, ``unknown`` and of each set of effects, the most probable first.
        sentence: which effect, as the diagnosis says it.
    """

    tests: int
    bench_s: float
    thinking_s: float
    verdict: str
    answers: Mapping[str, float]
    sentence: str


@dataclass(frozen=True)
class InvestigationRecord:
    """All of an investigation.

    Attributes:
        model: rig file of the model.
        real: rig file of the real side; empty where its recordings are given.
        changes: ``key=value`` texts for the real side.
        bags: recordings that were given.
        calibration: calibration file of the real side; empty where its recordings say what is known of its sensors.
        tests: in the order in which they were asked.
        turns: diagnoses in their order.
        plan: levels of the real side's plan, V, from low to high; empty where its recordings are given.
        ended: why it ended: ``named``, ``no_gap``, ``recalibrated``, ``unknown``, ``not_told_apart``, ``budget``,
            ``stopped``, ``proposed``; empty while it goes on.
        conclusion: the end in a sentence, with its bound where the top of the plan was not reached.
    """

    model: str
    real: str = ""
    changes: tuple[str, ...] = ()
    bags: tuple[str, ...] = ()
    calibration: str = ""
    tests: tuple[AskedTest, ...] = ()
    turns: tuple[Turn, ...] = ()
    plan: tuple[float, ...] = ()
    ended: str = ""
    conclusion: str = ""
    format: str = field(default=FORMAT)

    @property
    def measured(self) -> tuple[AskedTest, ...]:
        """Tests that were carried out."""
        return tuple(test for test in self.tests if test.state == "measured")

    @property
    def bench_s(self) -> float:
        """Bench time of all tests that were carried out, also those that failed, s."""
        return sum(test.seconds for test in self.tests if test.state in ("measured", "empty", "failed"))

    @property
    def made(self) -> tuple[AskedTest, ...]:
        """Tests that were carried out, also those of which no level locked."""
        return tuple(test for test in self.tests if test.state in ("measured", "empty"))

    @property
    def reached(self) -> float:
        """Highest level of which a window locked, V; 0 where none has."""
        return max((test.reached for test in self.measured if math.isfinite(test.reached)), default=0.0)

    @property
    def bound(self) -> str:
        """What the recordings say nothing of; empty where the top of the plan was reached."""
        if not self.plan or self.plan[-1] <= 1.001 * self.reached:
            return ""
        return (
            f"Of effects that act above {self.reached:.3g} V only nothing is known: no higher level of the plan, up to "
            f"{self.plan[-1]:.3g} V, was measured."
        )

    def with_test(self, test: AskedTest) -> InvestigationRecord:
        """The record with a test added, or in place of the one with its name."""
        others = [each_test for each_test in self.tests if each_test.name != test.name]
        position = next((k for k, it in enumerate(self.tests) if it.name == test.name), len(others))
        return replace(self, tests=(*others[:position], test, *others[position:]))

    def write(self, folder: Path) -> None:
        """Write ``investigate.json`` whole, with what follows from it; what is not finite becomes null."""
        values = asdict(self) | {name: getattr(self, name) for name in _DERIVED}
        for test, of_test in zip(self.tests, values["tests"], strict=True):
            of_test["request"] = test.request.to_mapping()
        write_whole(folder / RECORD_FILE, json.dumps(_finite(values), indent=2, ensure_ascii=False) + "\n")


def read_record(folder: Path) -> InvestigationRecord | None:
    """The record in a folder; None without one.

    Raises:
        BenchError: the file cannot be read or is not a record.
    """
    path = folder / RECORD_FILE
    if not path.exists():
        return None
    values = read_json(path, "investigation")
    try:
        if values["format"] != FORMAT:
            raise ValueError(f"its format is {values['format']}")
        tests = tuple(AskedTest(**_read(test)) for test in values["tests"])
        turns = tuple(Turn(**turn) for turn in values["turns"])
        lists = {key: tuple(values[key]) for key in ("changes", "bags", "plan")}
        kept = {key: value for key, value in values.items() if key not in _DERIVED}
        return InvestigationRecord(**{**kept, **lists, "tests": tests, "turns": turns})
    except (BenchError, KeyError, TypeError, ValueError) as error:
        raise BenchError(
            f"{path} is not a record of an investigation that can be gone on with ({error}); give another folder with "
            "--out."
        ) from error


_NUMBERS = ("expected_sigma", "expected", "received", "seconds", "reached")
_DERIVED = ("reached", "bound")


def _read(test: Mapping[str, Any]) -> dict[str, Any]:
    numbers = {key: _number(test[key]) for key in _NUMBERS}
    request = TestRequest.from_mapping(test["request"])
    return {**test, **numbers, "separates": tuple(test["separates"]), "request": request}


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
