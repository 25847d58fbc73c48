"""Further logs of a robot as tests that are held out: the same values, and torque that the first log's terms leave."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt_robots.bodies.body_finding import without_factor
from nmt_robots.log.joint_log import Array
from nmt_robots.log.robot_sidecar import robot_of_sidecar
from nmt_robots.mechanics.ladder import JointProblem
from nmt_robots.mechanics.motion import with_bodies
from nmt_robots.mechanics.readings import DriveTorque
from nmt_robots.verdict.joint_verdict import JointVerdict, values_in_model

if TYPE_CHECKING:
    from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis

_WITHIN = 2.0
"""Combined standard uncertainties within which two logs say the same."""


@dataclass(frozen=True)
class ComparedTerm:
    """A term of a joint by two logs, each with its standard uncertainty.

    Attributes:
        joint, words, unit: of the term.
        first: by the first log; value and ±.
        other: by the other one; both NaN where that has no such term.
    """

    joint: str
    words: str
    unit: str
    first: tuple[float, float]
    other: tuple[float, float]

    @property
    def agrees(self) -> bool:
        """Whether both say the same within two combined ±."""
        apart = abs(self.first[0] - self.other[0])
        return bool(apart <= _WITHIN * float(np.hypot(self.first[1], self.other[1])))


@dataclass(frozen=True)
class OtherLog:
    """A further log, which nothing of the first answer was fitted to.

    Attributes:
        source: file.
        terms: that differ from the model by one of the logs.
        left: by joint: rms of the torque, of what the model as it is, and of what the first log's terms leave of it,
            each about its mean, N·m.
        joints: the answer by this log alone.
        model: file of a model of its own; empty = that of the first log.
    """

    source: str
    terms: tuple[ComparedTerm, ...]
    left: dict[str, tuple[float, float, float]]
    joints: tuple[JointVerdict, ...] = ()
    model: str = ""

    @property
    def sentence(self) -> str:
        """For people."""
        agreeing = sum(term.agrees for term in self.terms)
        words = f"{agreeing} of {len(self.terms)} differing values agree within 2 ±" if self.terms else (
            "no log finds a value that differs"
        )  # fmt: skip
        source = f"{self.source} with its own model {self.model}" if self.model else self.source
        if not self.left:
            return f"{source}: {words}; no joint moves in both."
        model, terms = (float(np.sqrt(np.mean([row[place] ** 2 for row in self.left.values()]))) for place in (1, 2))
        return (
            f"{source}: {words}; of its torque the model leaves {model:.3g} N·m, with the first log's values "
            f"{terms:.3g} N·m (rms over the joints)."
        )

    def to_mapping(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {
            "log": self.source,
            "model": self.model,
            "terms": [
                {"joint": term.joint, "words": term.words, "unit": term.unit, "first": list(term.first),
                 "other": list(term.other), "agrees": term.agrees}
                for term in self.terms
            ],
            "left": {joint: list(values) for joint, values in self.left.items()},
        }  # fmt: skip


def model_of_other_log(model: Path, first: Path, other: Path) -> Path:
    """The model that a further log is tested with: its sidecar's own, where that is another than the first log's.

    So a known mass that was hung on for the second log stands in a model of its own.

    Args:
        model: of the first log.
        first, other: logs or their sidecars.

    Raises:
        BenchError: a sidecar is wrong, or its robot does not exist.
    """
    theirs = robot_of_sidecar(other)
    if theirs is None or theirs.samefile(model):
        return model
    proposed = robot_of_sidecar(first)
    return model if proposed is not None and theirs.samefile(proposed) else theirs


def other_log(first: RobotDiagnosis, other: RobotDiagnosis, model: str = "") -> OtherLog:
    """What a further log says of the answer of the first one; joints are matched by name.

    Args:
        first, other: by the two logs.
        model: name of the further log's own model; empty = that of the first one.
    """
    by_name = {verdict.joint.name: verdict for verdict in other.joints}
    terms: list[ComparedTerm] = []
    left: dict[str, tuple[float, float, float]] = {}
    assert other.as_given is not None
    log, motion = other.as_given
    sides = [(log, motion, DriveTorque(log).signals(other.reading))]
    if first.bodies is not None and first.bodies.claimed and not model:
        log = without_factor(log, first.bodies.factor) if log.joints == first.log.joints else log
        motion = with_bodies(first.changed, log, motion)
    sides.append((log, motion, DriveTorque(log).signals(other.reading)))
    for verdict in first.joints:
        name = verdict.joint.name
        match = by_name.get(name)
        if match is None or verdict.mechanics is None or match.mechanics is None:
            continue
        terms += _compared(verdict, match)
        number = other.log.joints.index(name)
        before, after = (JointProblem(motion, number, signals.of(number), log.joints) for log, motion, signals in sides)
        left[name] = _left(before, after, verdict)
    return OtherLog(other.log.source, tuple(terms), left, other.joints, model)


def _compared(verdict: JointVerdict, match: JointVerdict) -> list[ComparedTerm]:
    """Terms that differ from the model by one of two answers for a joint."""
    found = {}
    for here, there, turned in ((verdict, match, False), (match, verdict, True)):
        others = {term.key: term for term in there.terms}
        for term in here.terms:
            if not term.differs or term.key in found:
                continue
            twin = others.get(term.key)
            values = (term.value, term.std), ((twin.value, twin.std) if twin else (float("nan"), float("nan")))
            first, second = reversed(values) if turned else values
            found[term.key] = ComparedTerm(verdict.joint.name, term.words, term.unit, first, second)
    return list(found.values())


def _left(before: JointProblem, after: JointProblem, verdict: JointVerdict) -> tuple[float, float, float]:
    """Torque of a joint, and what the model and another log's terms leave of it, rms about the mean, N·m."""
    assert verdict.mechanics is not None
    in_model = values_in_model(verdict.joint)
    model, terms = before.left.copy(), after.left.copy()
    for effect in before.usual:
        model -= before.columns([effect])[:, 0] * in_model.get(effect.key, 0.0)
    effects = {(effect.key, effect.shape): effect for effect in [*after.usual, *after.rivals]}
    for share in verdict.mechanics.shares:
        twin = effects.get((share.effect.key, share.effect.shape))
        if twin is not None:
            terms -= after.columns([twin]) @ share.values
    return _spread(before.torque), _spread(model), _spread(terms)


def _spread(values: Array) -> float:
    return float(np.std(values))
