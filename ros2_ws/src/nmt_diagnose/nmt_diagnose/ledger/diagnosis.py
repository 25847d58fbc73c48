"""The outcome of a diagnosis, and ``diagnosis.json``."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from nmt_core.files.whole_file import write_whole
from nmt_core.kinds.request import TestRequest
from nmt_diagnose.law.reading import LawReading
from nmt_diagnose.ledger.row import Ledger
from nmt_diagnose.thresholds import THRESHOLDS

FORMAT = "nmt diagnosis 1"
NULL, UNKNOWN = "none", "unknown"
"""Further keys of ``probabilities`` after the labels of explanations: nothing is missing, or an unnamed cause."""
TOO_WEAK = "too_weak"
"""What acts and shows in no row, among answers."""
HIDDEN = "too_weak_so_far"
"""What acts and shows in tests that are left only."""


class Verdict(str, Enum):
    """What a diagnosis comes to."""

    NONE = "none"
    CALIBRATION = "calibration"
    EFFECT = "effect"
    UNKNOWN = "unknown"

    @property
    def gap(self) -> bool:
        """Whether something is missing that the model's own parameters do not make up for."""
        return self in (Verdict.EFFECT, Verdict.UNKNOWN)


@dataclass(frozen=True)
class Value:
    """A number with its standard uncertainty.

    Attributes:
        value, std, unit: of the number.
        shared_std: part of ``std`` that comes from the priors of the model's parameters: the same for all
            recordings that are compared with one model.
    """

    value: float
    std: float
    unit: str
    shared_std: float = 0.0


@dataclass(frozen=True)
class Share:
    """How much of the gap was closed, with the interval of 90 %."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class PlaceShare:
    """How much of the gap a place accounts for.

    Attributes:
        place: structure, boundary, joint, exciter, force_sensor, response_sensor, controller or time.
        detail: point, channel or coordinate.
        share: share of the gap that sources at this place account for, 0..1, all places together 1.
        p: probability that the cause lies there.
    """

    place: str
    detail: str
    share: float
    p: float


@dataclass(frozen=True)
class Ranked:
    """One named explanation.

    Attributes:
        effect: name of the effect, two joined by `` + ``.
        place: where it acts.
        detail: point or channel.
        probability: of the class it heads.
        equivalents: other effects that these tests cannot distinguish from it.
        parameters: fitted parameters.
        closed: share of the held-out gap it closes.
        sigmas: its strength over its standard uncertainty.
        converged: whether its fit reached the optimum.
        adequate: whether its residual is noise, or smaller than what matters.
        given_library: whether ``probability`` is among the explanations of the library alone, as that of a partial
            explanation is.
        places: probability of each place if these effects are the cause, the most probable first; sum 1.
    """

    effect: str
    place: str
    detail: str
    probability: float
    equivalents: tuple[str, ...]
    parameters: dict[str, Value]
    closed: Share
    sigmas: float
    converged: bool = True
    adequate: bool = True
    given_library: bool = False
    places: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Answer:
    """One of the answers that together hold most of the probability.

    Attributes:
        kind: ``none``, ``too_weak``, ``unknown`` or ``effect``.
        effects: those that these tests cannot distinguish, two that act together joined by `` + ``; of ``effect`` only.
        probability: of the answer.
    """

    kind: str
    effects: tuple[str, ...]
    probability: float


@dataclass(frozen=True)
class Gap:
    """The gap on held-out data in noise units, and per observable in engineering units too.

    Attributes:
        before: root-mean-square whitened residual of the model with its own parameters re-fitted; that of the fits
            themselves where no held-out data test the explanation, and ``closed`` is NaN.
        after: with the accepted explanation.
        floor: what no model can beat.
        as_given: of the model as it was given.
        closed, low, high: (before − after) / (before − floor) with the interval of 90 %.
        per_observable: by observable: before, after in noise units and in ``unit``.
        held_out: what was held out.
    """

    before: float
    after: float
    floor: float
    as_given: float
    closed: float
    low: float
    high: float
    per_observable: dict[str, dict[str, Any]]
    held_out: tuple[str, ...]

    @property
    def bridged(self) -> float:
        """Share of the gap that the explanation closes: on data held out, else by the fits themselves; 0 = no gap."""
        if math.isfinite(self.closed):
            return self.closed
        return (self.before - self.after) / (self.before - self.floor) if self.before > self.floor else 0.0


@dataclass(frozen=True)
class RemainderPart:
    """Residual of an explanation in one observable of a test.

    Attributes:
        observable: test and observable.
        levels: the third of its levels or lines where most of it lies; empty where it is spread.
        share: of all that is left.
        rms: in standard deviations.
        rms_unit: in ``unit``.
        unit: engineering unit.
    """

    observable: str
    levels: str
    share: float
    rms: float
    rms_unit: float
    unit: str


@dataclass(frozen=True)
class Remainder:
    """The part of the gap on held-out data that a named explanation does not close.

    Attributes:
        share: of the gap, with the interval of 90 % from ``low`` to ``high``.
        where: the observables that hold most of it.
    """

    share: float
    low: float
    high: float
    where: tuple[RemainderPart, ...]


@dataclass(frozen=True)
class NextTest:
    """A test that would decide between explanations that are left.

    Attributes:
        test: what to do, for people.
        command: the command that does it on the recorded rig; empty where that is not simulated here.
        separates: the explanations that it distinguishes.
        expected_sigma: by how many standard deviations.
        seconds: bench time that it takes, as the tests at hand took it.
        information: fall of the entropy of the explanations that it distinguishes that is expected, nats.
        hidden: probability of an effect that shows, or matters, only in the remaining tests; 0 where there is a gap.
        grows: what shows already and is expected to matter in them; empty where that is less probable than that
            something else shows.
        levels: of the plan, where the test goes on with it.
        plan_sigma: by how many standard deviations all remaining levels of the plan separate the explanations.
        request: the test as a value; no part of ``diagnosis.json``.
    """

    test: str
    command: str
    separates: tuple[str, ...]
    expected_sigma: float
    seconds: float = math.nan
    information: float = math.nan
    hidden: float = 0.0
    grows: str = ""
    levels: tuple[float, ...] = ()
    plan_sigma: float = math.nan
    request: TestRequest | None = None

    @property
    def tells_little(self) -> bool:
        """Whether even all remaining levels of the plan cannot separate the remaining explanations."""
        return self.plan_sigma < THRESHOLDS.next_test.least_asked_sigmas


@dataclass(frozen=True)
class Recalibrated:
    """A parameter of the given model that was re-fitted; ``shared_std`` as of a value."""

    name: str
    start: float
    to: float
    std: float
    unit: str
    prior_std: float
    sigmas: float
    shared_std: float = 0.0


@dataclass(frozen=True)
class DetectableEffect:
    """The weakest that an effect could be and still be seen by these recordings.

    Attributes:
        effect: its name.
        place, detail: where it would show first.
        parameters: its parameters at the strength from which it is reported.
    """

    effect: str
    place: str
    detail: str
    parameters: dict[str, Value]


@dataclass(frozen=True)
class ResidualGroup:
    """Part of the residual map: residual of a test, level, channel and harmonic, in noise units."""

    test: str
    level: int
    amplitude: float
    channel: str
    harmonic: int
    as_given: float
    before: float
    after: float
    rows: int


@dataclass(frozen=True)
class Diagnosis:
    """All that a diagnosis says; the fields are those of ``diagnosis.json``.

    ``adequate`` is false where the residual exceeds noise and matters: with the verdict ``effect`` the explanation is a
    partial one then. ``law`` is the local force that the model lacks, where no effect of the library explains the
    recordings; ``law_leads`` says whether it is the answer.
    ``next_levels`` are those of the plan that was given, ``other_sensors`` those that would separate explanations that
    no remaining test separates. ``answers`` are the fewest that hold the truth with a probability of 95 %.
    ``ledger`` has each explanation that was fitted, and the rules that state it or not. ``too_small`` is an effect that
    the recordings demand and that changes less than what matters; None without one.
    """

    verdict: Verdict
    sentences: tuple[str, ...]
    where: tuple[PlaceShare, ...]
    ranking: tuple[Ranked, ...]
    probabilities: dict[str, float]
    gap: Gap
    next_test: tuple[NextTest, ...]
    calibration: tuple[Recalibrated, ...]
    inputs: dict[str, Any]
    notes: tuple[str, ...] = ()
    residual_map: tuple[ResidualGroup, ...] = ()
    residual_tests: tuple[dict[str, Any], ...] = ()
    candidates: tuple[dict[str, Any], ...] = ()
    features: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    remainder: Remainder | None = None
    visible: tuple[DetectableEffect, ...] = ()
    adequate: bool = True
    law: LawReading | None = None
    law_leads: bool = False
    next_levels: NextTest | None = None
    other_sensors: tuple[NextTest, ...] = ()
    answers: tuple[Answer, ...] = ()
    ledger: Ledger = field(default_factory=Ledger)
    too_small: Ranked | None = None

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON; what is not finite becomes None."""
        result: dict[str, Any] = {"format": FORMAT, **_plain(asdict(self))}
        for test in (*result["next_test"], *result["other_sensors"], result["next_levels"] or {}):
            test.pop("request", None)
        return result

    def write(self, path: Path) -> None:
        """Write ``diagnosis.json`` whole."""
        write_whole(path, json.dumps(self.to_mapping(), indent=2, ensure_ascii=False) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if hasattr(value, "item"):
        return _plain(value.item())
    return value
