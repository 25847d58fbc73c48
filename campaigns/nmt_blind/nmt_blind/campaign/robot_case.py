"""Cases of robots that a laboratory has made, and how an answer about a robot is classed.

A case is a folder with ``robot.xml`` as its owner believes it, ``log.yaml`` with its data, and ``truth.yaml``::

    kind: effect                # healthy, effect, log, two, or unknown (no library has it)
    causes:
    - name: coulomb
      of: joint                 # or log
      joint: knee               # empty = all
      named: [coulomb]          # terms of the joint, words for the bodies, or findings on the log, that name it
      partly: []                # terms that are a part of it or of its class
      value: 0.8                # of the term, where it has one
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nmt_blind.campaign.foreign_case import TRUTH_FILE
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_text, yaml_value
from nmt_robots.verdict.joint_verdict import OF_ALL_JOINTS

ROBOT_FILE, SIDECAR = "robot.xml", "log.yaml"
KINDS = ("healthy", "effect", "log", "two", "unknown")
CLASSES = ("right", "hedged", "hedged wrong", "confidently wrong", "refused")
ORDINARY = frozenset({"velocity_late", "command_held"})
"""Findings on the log that every chain may have; they are no false alarm."""
_LEVELS = frozenset({"coulomb", "viscous", "offset"})
"""Terms that may take the mean of what no library has."""


@dataclass(frozen=True)
class Planted:
    """A cause that is in a case; keys as in ``truth.yaml``."""

    name: str
    of: str
    joint: str
    named: tuple[str, ...]
    partly: tuple[str, ...]
    value: float = math.nan


@dataclass(frozen=True)
class RobotCase:
    """A case's folder, its kind and what is in it."""

    folder: Path
    kind: str
    causes: tuple[Planted, ...]

    @property
    def name(self) -> str:
        """That of the folder."""
        return self.folder.name

    @property
    def truth(self) -> str:
        """Causes in words."""
        words = (f"{cause.name}@{cause.joint}" if cause.joint else cause.name for cause in self.causes)
        return " + ".join(words) or self.kind


@dataclass(frozen=True)
class Claims:
    """What an answer states.

    Attributes:
        terms: pairs of joint and term that differ from the model, the largest of each joint first.
        findings: pairs of joints (empty = all) and key of the faults of the log.
        values: value and standard uncertainty of a term, by joint and term.
        classes: joint and keys of causes of which one is there, without a claim which.
        shared: words for what differs of the bodies or of a drive's constant, which all joints were asked for.
    """

    terms: tuple[tuple[str, str], ...]
    findings: tuple[tuple[tuple[str, ...], str], ...]
    values: Mapping[tuple[str, str], tuple[float, float]]
    classes: tuple[tuple[str, frozenset[str]], ...] = ()
    shared: frozenset[str] = frozenset()

    @property
    def text(self) -> str:
        """In one line."""
        log = ", ".join(f"{key}({','.join(joints)})" if joints else key for joints, key in self.findings)
        either = [f"{' or '.join(sorted(keys))}@{joint}" for joint, keys in self.classes]
        return f"[{log}] " + ", ".join(
            [*sorted(self.shared), *(f"{key}@{joint}" for joint, key in self.terms), *either]
        )


@dataclass(frozen=True)
class RobotAnswer:
    """What an answer is worth: one of ``CLASSES``, why, and the deviation of a value in standard uncertainties."""

    outcome: str
    reason: str = ""
    deviation: float = math.nan


def has_robots(folder: Path) -> bool:
    """Whether the cases of a folder are robots."""
    return any(folder.glob(f"*/{ROBOT_FILE}"))


def read_robot_cases(folder: Path) -> list[RobotCase]:
    """Cases of a folder by name.

    Raises:
        BenchError: a truth has a mistake.
    """
    return [_case(path) for path in sorted(folder.glob(f"*/{TRUTH_FILE}"))]


def _case(path: Path) -> RobotCase:
    name = f"The truth {path}"
    values = yaml_value(read_text(path, "truth"), name)
    if not isinstance(values, dict) or values.get("kind") not in KINDS or not isinstance(values.get("causes"), list):
        raise BenchError(f"{name} must have a kind ({', '.join(KINDS)}) and a list of causes.")
    causes = []
    for cause in values["causes"]:
        if not isinstance(cause, dict) or not {"name", "of", "named"} <= set(cause):
            raise BenchError(f"{name}: each cause needs name, of and named.")
        causes.append(
            Planted(
                str(cause["name"]), str(cause["of"]), str(cause.get("joint") or ""), tuple(map(str, cause["named"])),
                tuple(map(str, cause.get("partly") or ())), float(cause.get("value", math.nan)),
            )
        )  # fmt: skip
    return RobotCase(path.parent, str(values["kind"]), tuple(causes))


def claims_of(diagnosis: Mapping[str, Any]) -> Claims:
    """What a ``diagnosis.json`` of a robot states."""
    terms, values, shared = [], {}, set()
    for joint in diagnosis["joints"]:
        for term in joint["terms"]:
            if term["differs"] and term["key"] in OF_ALL_JOINTS:
                shared.add(str(term["words"]))
            elif term["differs"]:
                terms.append((str(joint["joint"]), str(term["key"])))
            values[str(joint["joint"]), str(term["key"])] = (float(term["value"]), float(term["std"]))
    faults = [item for item in diagnosis["log_findings"] if item["fault"] and not item["instead"]]
    classes = [
        (str(joint), frozenset(map(str, (item["key"], *item["instead"]))))
        for item in diagnosis["log_findings"]
        if item["instead"]
        for joint in item["joints"]
    ]
    return Claims(
        tuple(terms), tuple((tuple(map(str, item["joints"])), str(item["key"])) for item in faults), values,
        tuple(classes), frozenset(shared),
    )  # fmt: skip


def judge_robot(case: RobotCase, claims: Claims) -> RobotAnswer:
    """Class an answer.

    * A claim is false if no cause of the case has it among its names or parts, at its joint. Of a case that no library
      has, friction and offset at the joint are no false claims. ``ORDINARY`` findings are none.
    * right: every cause is named, by the largest term of its joint or a finding, and nothing is false.
    * hedged: the same by a part, a class or a smaller term, or not every cause, and nothing is false; or all are named
      and a finding on the log is false.
    * confidently wrong: a false term where no cause is named; any term where the log alone is at fault or the robot is
      healthy; a false finding on a healthy log.
    * hedged wrong: all else, such as silence, or a class of which nothing is there.
    """
    named = [_named(cause, claims) for cause in case.causes]
    false_terms = [f"{key}@{joint}" for joint, key in claims.terms if not _allowed_term(case, joint, key)]
    false_terms += sorted(claims.shared.difference(*(cause.named for cause in case.causes)))
    false_findings = [key for joints, key in claims.findings if not _allowed_finding(case, key)]
    false_classes = [
        f"{' or '.join(sorted(keys))}@{joint}"
        for joint, keys in claims.classes
        if not any(cause.joint in ("", joint) and keys & {*cause.named} for cause in case.causes)
    ]
    deviation = _deviation(case, claims)
    words = ", ".join([*false_terms, *false_findings, *false_classes])
    reason = f"false: {words}" if words else ""
    if case.kind == "unknown":
        sure = "confidently wrong" if false_terms or false_findings else "right"
        return RobotAnswer("hedged wrong" if false_classes and sure == "right" else sure, reason, deviation)
    if false_terms and (case.kind in ("healthy", "log") or not any(named)):
        return RobotAnswer("confidently wrong", reason, deviation)
    if case.kind == "healthy" and (false_findings or not false_classes):
        return RobotAnswer("confidently wrong" if false_findings else "right", reason, deviation)
    if false_terms or false_classes or (false_findings and min(named) == 0):
        return RobotAnswer("hedged wrong", reason, deviation)
    if min(named) == 2 and not false_findings:
        return RobotAnswer("right", "", deviation)
    if any(named):
        return RobotAnswer("hedged", reason or "in part", deviation)
    return RobotAnswer("hedged wrong", "nothing named", deviation)


def _named(cause: Planted, claims: Claims) -> int:
    """2: named; 1: a part of it, in a class, or behind another term of its joint; 0: not."""
    if claims.shared & {*cause.named}:
        return 2
    in_class = any(cause.joint in ("", joint) and keys & {*cause.named} for joint, keys in claims.classes)
    if cause.of == "log":
        hits = [joints for joints, key in claims.findings if key in cause.named]
        at_joint = [not joints or not cause.joint or cause.joint in joints for joints in hits]
        return 2 if any(at_joint) else int(in_class)
    terms = [key for joint, key in claims.terms if joint == cause.joint]
    if terms and terms[0] in cause.named:
        return 2
    return int(in_class or bool(set(terms) & {*cause.named, *cause.partly}))


def _allowed_term(case: RobotCase, joint: str, key: str) -> bool:
    """Whether a term is not a false claim."""
    return any(
        cause.joint == joint
        and (key in cause.named or key in cause.partly or (case.kind == "unknown" and key in _LEVELS))
        for cause in case.causes
        if cause.of == "joint"
    )


def _allowed_finding(case: RobotCase, key: str) -> bool:
    return key in ORDINARY or any(key in (*cause.named, *cause.partly) for cause in case.causes if cause.of == "log")


def _deviation(case: RobotCase, claims: Claims) -> float:
    """Of the first value that is known and stated."""
    for cause in case.causes:
        for key in cause.named[:1]:
            found = claims.values.get((cause.joint, key))
            if found is not None and math.isfinite(cause.value) and found[1] > 0.0:
                return (found[0] - cause.value) / found[1]
    return math.nan


def counts_of(outcomes: Iterable[str]) -> dict[str, int]:
    """Cases of each class."""
    listed = list(outcomes)
    return {name: listed.count(name) for name in CLASSES}
