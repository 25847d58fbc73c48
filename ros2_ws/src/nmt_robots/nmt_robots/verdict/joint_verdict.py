"""The answer for one joint: what differs from its model, by how much, and what remains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nmt_core.text.number_words import percent, value_text
from nmt_robots.bodies.body_finding import BodyFinding
from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.log_faults.finding import Finding
from nmt_robots.mechanics.ladder import JointMechanics, JointShare
from nmt_robots.mechanics.motion import Motion
from nmt_robots.mechanics.readings import Reading
from nmt_robots.mechanics.transmission import Transmission
from nmt_robots.model.robot_model import Joint
from nmt_robots.thresholds import THRESHOLDS

OF_ALL_JOINTS = frozenset({"bodies", "torque_constant"})
"""Terms that all joints together were asked for; their sizes stand with the bodies."""
OF_BODIES = frozenset({"link_mass", "gravity_scale", "mass_centre"})
"""Effects that are of bodies: where all joints together were asked, a joint alone does not say what they are."""
_MOST_ALIKE = 2
"""Nearly equal columns that a sentence lists."""


@dataclass(frozen=True, eq=False)
class JointTerm:
    """A term of a joint's torque.

    Attributes:
        key, words, unit: of its effect.
        value, std: of its coefficient; the uncertainty spans all readings that fit as well.
        in_model: what the model has of it.
        share: of the joint's torque that the difference to the model takes, rms over rms.
        differs: whether the difference is certain, beyond the model's tolerance, and large enough to matter.
        alike: causes that would fit almost as well.
        equal: those of them that no fit of such a log parts from this one.
        impossible: coefficient that would have been negative and may not be; zero elsewhere.
        probability: posterior probability that its cause is there, with the other causes that were asked.
    """

    key: str
    words: str
    unit: str
    value: float
    std: float
    in_model: float
    share: float
    differs: bool
    alike: tuple[str, ...] = ()
    equal: tuple[str, ...] = ()
    impossible: float = 0.0
    probability: float = 0.0

    @property
    def name(self) -> str:
        """Its words with those of effects that are one class with it."""
        every = (self.words, *self.equal)
        return " or ".join(every) if len(every) < 3 else f"{', '.join(every[:-1])} or {every[-1]}"

    @property
    def brief(self) -> str:
        """Its words; of bodies, which all joints share, without their names."""
        return "bodies that differ" if self.key == "bodies" else self.words

    def text(self) -> str:
        """The term in a sentence."""
        if self.impossible < 0.0:
            return f"{self.words}: {self.impossible:.3g} {self.unit} would fit, which is impossible: timing"
        if self.key in OF_ALL_JOINTS:
            return f"{self.brief} ({percent(self.share)} of its torque)"
        model = f" (model {self.in_model:.3g})" if self.in_model else ""
        alike = [words for words in self.alike if words not in self.equal][:_MOST_ALIKE]
        also = f"; {', '.join(alike)} would fit almost as well" if alike else ""
        return f"{self.name} {value_text(self.value, self.std, self.unit)}{model}{also}"

    def to_mapping(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {
            "key": self.key, "words": self.words, "unit": self.unit, "value": self.value, "std": self.std,
            "in_model": self.in_model, "share": self.share, "differs": self.differs, "alike": list(self.alike),
            "equal": list(self.equal),
            "impossible": self.impossible, "probability": self.probability,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class JointVerdict:
    """The answer for a joint.

    Attributes:
        joint: as the model has it.
        mechanics: what was found; None where it does not move enough.
        terms: of its torque, largest difference first.
        torque: rms about the mean, N·m.
        as_logged: left on held-out seconds by the plain fit of the log as it is, N·m.
        unchanged: left by the model as it is, with the log read as chosen.
        plain: left by the plain fit with the log read as chosen.
        left: left by all terms.
        last_plain, last: the same of the last part of the log.
        remains: sentence on the residual.
        transmission: behind which its link moves by itself; None of a rigid one.
    """

    joint: Joint
    mechanics: JointMechanics | None
    terms: tuple[JointTerm, ...]
    torque: float
    as_logged: float = float("nan")
    unchanged: float = float("nan")
    plain: float = float("nan")
    left: float = float("nan")
    last_plain: float = float("nan")
    last: float = float("nan")
    remains: str = ""
    transmission: Transmission | None = None

    @property
    def differs(self) -> bool:
        """Whether anything differs from the model."""
        return any(term.differs for term in self.terms)

    @property
    def adequate(self) -> bool:
        """Whether its terms leave little enough of the torque."""
        return self.left < THRESHOLDS.unexplained * self.torque

    @property
    def closed(self) -> float:
        """Share of the residual of the model as given that is gone on held-out seconds."""
        return 1.0 - self.left / self.unchanged if self.unchanged > 0.0 else float("nan")

    @property
    def cause(self) -> str:
        """What differs, in a few words."""
        if self.mechanics is None:
            return "not judged"
        differing = [term for term in self.terms if term.differs]
        if differing:
            return differing[0].name
        return "as in the model" if self.is_as_in_the_model else "not known"

    @property
    def is_as_in_the_model(self) -> bool:
        """Whether the model as given leaves little enough of the torque that nothing differs.

        A term that the model does not state has no tolerance: one that takes much leaves the joint open.
        """
        new = self.mechanics.new if self.mechanics is not None else frozenset()
        opened = any(
            term.key in new and term.impossible == 0.0 and term.share >= THRESHOLDS.smallest_share
            for term in self.terms
        )
        small = self.unchanged < THRESHOLDS.unexplained * self.torque
        return not self.differs and small and not opened

    @property
    def difference(self) -> str:
        """What differs from the model, with sizes."""
        if self.differs:
            words = "; ".join(f"{term.text()}{self._at_its_middle(term)}" for term in self.terms if term.differs)
            if self.adequate:
                return words
            return self.joint.units(f"{words}; in part: the rest of the torque stays without a name")
        if self.is_as_in_the_model:
            return "nothing: as in the model"
        share = percent(self.unchanged / self.torque)
        fitted_terms = [term.brief for term in self.terms if term.share >= THRESHOLDS.smallest_share]
        if self.adequate and fitted_terms:
            words = " or ".join(dict.fromkeys(fitted_terms))
            return self.joint.units(
                f"open: {words} would take the {share} of the torque that the model leaves, none for certain"
            )
        return self.joint.units(f"not known: the model leaves {share} of the torque, no cause is claimed")

    def _at_its_middle(self, spring: JointTerm) -> str:
        """Torque of a spring at the mean angle, which its rest makes; empty of other terms and where that is small."""
        offset = next((term for term in self.terms if term.key == "offset" and not term.differs), None)
        if spring.key != "spring" or offset is None or offset.share < THRESHOLDS.smallest_share:
            return ""
        return f", {value_text(offset.value, offset.std, offset.unit)} at the mean angle"

    def to_mapping(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {
            "joint": self.joint.name, "cause": self.cause, "unit": self.joint.effort_unit,
            "torque_rms": self.torque, "left_as_logged": self.as_logged,
            "left_by_model": self.unchanged, "left_by_plain_fit": self.plain, "left": self.left, "closed": self.closed,
            "adequate": self.adequate,
            "last_part_plain": self.last_plain, "last_part": self.last, "remains": self.remains,
            "terms": [term.to_mapping() for term in self.terms],
        }  # fmt: skip


def unjudged(joint: Joint, torque: float) -> JointVerdict:
    """The answer for a joint that does not move."""
    return JointVerdict(joint, None, (), torque, remains="does not move enough: move it alone over its range")


def without_claims(verdict: JointVerdict, reason: str) -> JointVerdict:
    """The answer with nothing claimed, and why."""
    terms = tuple(replace(term, differs=False) for term in verdict.terms)
    return replace(verdict, terms=terms, remains=f"{verdict.remains}; {reason}" if verdict.remains else reason)


def undisturbed(verdicts: list[JointVerdict], coupling: Array) -> list[JointVerdict]:
    """The answers with claims taken back that are no larger than what a link may do to them whose motion is not known.

    Friction is not made by the joint's own link. The mass of a link that several joints carry is claimed at its own
    joint.

    Args:
        verdicts: of the joints.
        coupling: J × J: torque at a joint over that which accelerates another one.
    """
    disturbing = np.zeros(len(verdicts))
    for number, item in enumerate(verdicts):
        loose = any(term.key in TRANSMISSION and term.differs for term in item.terms)
        if item.mechanics is not None and (loose or item.left > _DISTURBING * item.torque):
            disturbing[number] = item.plain if loose else item.left
    by_others = (coupling * ~np.eye(len(verdicts), dtype=bool)) @ disturbing
    found = []
    for verdict, others, itself in zip(verdicts, by_others, disturbing, strict=True):
        terms = []
        for term in verdict.terms:
            elsewhere = term.key == "link_mass" and not term.words.endswith(f"link of {verdict.joint.name}")
            rubs = term.key in _FRICTION
            disturbed = 0.0 if rubs and term.share >= _DISTURBING else others if rubs else others + itself
            unclear = term.key not in TRANSMISSION and term.share * verdict.torque < _BEYOND * disturbed
            terms.append(replace(term, differs=term.differs and not elsewhere and not unclear))
        found.append(replace(verdict, terms=tuple(terms)))
    return found


def with_body_terms(verdicts: list[JointVerdict], bodies: BodyFinding) -> list[JointVerdict]:
    """The answers with what differs of the bodies at each joint whose torque it takes a part of, last part included.

    Where all joints together were asked for the bodies, a joint alone does not say what they are.
    """
    found = []
    for number, verdict in enumerate(verdicts):
        terms = tuple(replace(term, differs=term.differs and term.key not in OF_BODIES) for term in verdict.terms)
        verdict = replace(verdict, terms=terms)
        share = float(bodies.effect[number]) if bodies.claimed else 0.0
        holds = bool(bodies.after[number] < bodies.before[number])
        if verdict.mechanics is None or share < THRESHOLDS.smallest_share or not holds:
            found.append(verdict)
            continue
        first = bodies.values[0] if bodies.values else None
        size = (0.0, 0.0, 0.0, "") if first is None else (first.value, first.std, first.in_model, first.unit)
        key = "torque_constant" if bodies.kind == "constant" else "bodies"
        instead = tuple(words for words, _ in bodies.instead)
        term = JointTerm(key, bodies.words, size[3], *size[:3], share, True, instead, probability=bodies.probability)
        found.append(replace(verdict, terms=(term, *verdict.terms)))
    return found


def scale_findings(verdicts: tuple[JointVerdict, ...], of_bodies: bool = False) -> list[Finding]:
    """What single joints say of their drive: its gain, its torque constant, a limit of its torque.

    Args:
        verdicts: of the joints.
        of_bodies: whether all joints together say that bodies may differ, whose torque a constant scales.
    """
    found = []
    for verdict in verdicts:
        best = verdict.mechanics
        if best is None or best.held_out.interleaved >= THRESHOLDS.unexplained * best.held_out.torque:
            continue
        for share in best.shares:
            key = share.effect.key
            if not share.effect.made_of_torque or key not in best.causes or key in best.lost:
                continue
            name = verdict.joint.name
            bodies = OF_BODIES & set(best.choice.instead) if share.effect.key == best.causes[0] else set()
            if of_bodies and key == "gain" and share.effect.shape not in _GAINS:
                bodies = bodies | {"link_mass"}
            value = value_text(share.size, share.size_std, share.effect.unit if share.effect.unit != "1" else "")
            if share.effect.key == "saturation":
                sentence = f"{name}: the drive's torque ends at {share.effect.shape}; the computed one goes beyond."
            elif share.effect.shape in _GAINS:
                sentence = f"{name}: the {_GAINS[share.effect.shape]} gain is off by {value} from what is stated."
            else:
                sentence = (
                    f"{name}: the torque is off by {value} of itself: torque constant, gear ratio or both gains of "
                    "the drive."
                )
            if bodies:
                sentence += (
                    " The mass of its link would do as well in this log: a known mass, hung on, tells them apart."
                )
            units = verdict.joint.units
            found.append(
                Finding(
                    key, units(sentence), share.size, share.size_std, units(share.effect.unit), joints=(name,),
                    fault=not bodies, instead=tuple(sorted(bodies)),
                )
            )  # fmt: skip
    return found


TRANSMISSION = frozenset({"elastic", "backlash"})
"""Terms of a link that moves by itself."""
_OF_FIRST_ORDER = frozenset({"jerk"})
"""Effects that stand for a state of their own to first order: they are looked into by simulation and not claimed."""
_OF_INERTIA = frozenset({"armature", "inertia_scale"})
"""Effects that a state of its own, which is not understood, changes most."""
_WITH_A_MEAN = frozenset({"spring", "gravity_scale", "mass_centre", "link_mass", "ripple", "end_stop"})
"""Effects whose own mean an offset takes."""
_FRICTION = frozenset(
    {"coulomb", "viscous", "creep", "stribeck", "changing_friction", "load_friction", "spring", "ripple", "end_stop"}
)
"""Effects that the motion of other joints does not make."""
_GAINS = {"kp": "position", "kd": "velocity"}
_DISTURBING = 0.15
"""Torque left over in a joint, as a share, from which others next to it pay for its motion."""
_BEYOND = 3.0
"""Multiple of the torque that another joint's motion may cause in a joint, up to which nothing is claimed there."""
_TOLERANCES = {
    "coulomb": THRESHOLDS.coulomb_tolerance,
    "viscous": THRESHOLDS.damping_tolerance,
    "armature": THRESHOLDS.armature_tolerance,
}


def joint_verdict(
    joint: Joint, motion: Motion, number: int, results: list[JointMechanics], plain: tuple[float, float],
    put_in: Array, timing: Mapping[str, float] | None = None,
) -> JointVerdict:  # fmt: skip
    """The answer from the mechanics under all readings that fit.

    Args:
        joint: as the model has it.
        motion: of all joints.
        number: column of the joint.
        results: under each reading, that taken first.
        plain: torque and what the plain fit leaves of the log as it is, N·m.
        put_in: rows, N·m, that changed bodies take from what the model as given leaves over.
        timing: what a delay that the joints share makes of a term, by key.
    """
    best = results[0]
    in_model = values_in_model(joint)
    terms = []
    for share in best.shares:
        key, reference = share.effect.key, in_model.get(share.effect.key, 0.0)
        std, part, certain = _certainty(results, share, reference, (timing or {}).get(key, 0.0))
        differs = bool(
            certain
            and share.impossible == 0.0
            and key in {*best.causes, *best.new}
            and key not in _OF_FIRST_ORDER
            and not (key in _OF_INERTIA and _OF_FIRST_ORDER & set(best.causes))
            and not any(key in result.lost for result in results)
            and not (key == "offset" and _WITH_A_MEAN & set(best.causes))
            and not share.effect.made_of_torque
        )
        words = share.effect.words + (f", {share.effect.shape}" if share.effect.shape else "")
        size, unit = share.size, share.effect.unit
        if share.stated is not None:
            # A coefficient at no speed lies outside the speeds of the log; an angle does not grow with it.
            relative = 0.0 if share.effect.reach else std / max(abs(size), 1e-300)
            std = float(np.hypot(share.stated.std, abs(share.stated.size) * relative))
            words, size, unit = share.stated.words, share.stated.size, share.stated.unit
            # How far friction falls is the effect; over which angle it builds up is not.
            differs = differs and (share.effect.reach > 0.0 or abs(size) > THRESHOLDS.certain * share.stated.std)
        alike, equal = (tuple(map(joint.units, names)) for names in (share.alike, share.equal))
        terms.append(
            JointTerm(key, joint.units(words), joint.units(unit), size, std, reference, part, differs, alike, equal,
                 share.impossible, best.choice.probability.get(key, 0.0))
        )  # fmt: skip
    # An offset is what other terms leave of their mean: it stands behind them.
    terms.sort(key=lambda term: (not term.differs, term.key == "offset", -term.share))
    after = best.held_out
    unchanged = _left_by_model(motion, number, best, in_model, put_in)
    return JointVerdict(
        joint, best, tuple(terms), best.held_out.torque, plain[1], unchanged, best.plain.interleaved,
        after.interleaved, best.plain.last, after.last, joint.units(_remains(best)),
    )  # fmt: skip


def _certainty(
    results: list[JointMechanics], share: JointShare, reference: float, timing: float = 0.0
) -> tuple[float, float, bool]:
    """± over all readings, share of the torque that the difference takes, and whether that is certain and matters."""
    key, best = share.effect.key, results[0]
    sizes = [share.size, *(_size_in(result, share) for result in results[1:])]
    single = float(np.hypot(share.size_std, timing))
    std = float(np.hypot(single, max(abs(size - share.size) for size in sizes)))
    if key == "load_friction":
        # Of the torque or of the load: the same to first order.
        std = float(np.hypot(std, share.size**2))
    difference = share.size - reference
    # Each reading of the log by itself has to differ: their spread is a bound and no standard deviation.
    nearest = min((size - reference) * np.sign(difference) for size in sizes)
    part = abs(difference) * share.unit_rms / max(best.held_out.torque, 1e-300)
    tolerance = _TOLERANCES.get(key, 0.0) * abs(reference)
    certain = (
        part > (THRESHOLDS.smallest_new if key in best.new else THRESHOLDS.smallest_share)
        and nearest > THRESHOLDS.certain * single
        and nearest > THRESHOLDS.certain * tolerance
        and abs(difference) > THRESHOLDS.certain_over_readings * std
    )
    return std, part, bool(certain)


def uncertain_causes(results: list[JointMechanics]) -> frozenset[str]:
    """Causes that are not certain over all readings: those that scale the torque, with which all other sizes go; where
    there are none, those with a mean of their own, which is certain as an offset.
    """
    uncertain = [
        share.effect
        for share in results[0].shares
        if share.effect.key in results[0].causes and not _certainty(results, share, 0.0)[2]
    ]
    scaling = frozenset(effect.key for effect in uncertain if effect.made_of_torque)
    return scaling or frozenset(effect.key for effect in uncertain if effect.key in _WITH_A_MEAN)


def by_lag_of_torque(log: JointLog, reading: Reading) -> dict[int, dict[str, float]]:
    """What of damping and armature the torque's lag of a reading may be made of, by joint and key.

    A lag δ of the whole loop is to first order a late command with a damping of −kp δ and an armature of −kd δ.
    """
    if not log.is_arithmetic or log.position_gain is None:
        return {}
    # A drive that holds its torque is late by a part of a row, and the fit's own tolerance has that.
    delay = max(abs(reading.torque_lag_s) - 2.0 * THRESHOLDS.lag_s, 0.0)
    damped = np.zeros(len(log.joints)) if log.velocity_gain is None else log.velocity_gain
    return {
        number: {"viscous": delay * float(log.position_gain[number]), "armature": delay * float(damped[number])}
        for number in range(len(log.joints))
    }


def by_shared_delay(
    log: JointLog, believed: list[dict[str, float]], found: Mapping[int, JointMechanics]
) -> dict[int, dict[str, float]]:
    """What a delay of the loop that all joints share makes of damping and armature, by joint and key.

    Such a delay δ adds −kp δ to each damping and −kd δ to each armature where the torque is computed. The joints agree
    on it up to half of them, so that one joint whose damping really differs makes none.
    """
    if not log.is_arithmetic or log.position_gain is None or len(found) < 2:
        return {}
    delays = []
    for number, mechanics in found.items():
        viscous = mechanics.share("viscous")
        if viscous is not None and log.position_gain[number] > 0.0:
            delays.append((viscous.size - believed[number]["viscous"]) / float(log.position_gain[number]))
    if not delays:
        return {}
    delay = sorted(map(abs, delays))[(len(delays) - 1) // 2]
    damped = np.zeros(len(log.joints)) if log.velocity_gain is None else log.velocity_gain
    return {
        number: {"viscous": delay * float(log.position_gain[number]), "armature": delay * float(damped[number])}
        for number in found
    }


def values_in_model(joint: Joint) -> dict[str, float]:
    """What the model has of the usual effects, by key."""
    return {"coulomb": joint.coulomb, "viscous": joint.damping, "armature": joint.armature}


def _size_in(result: JointMechanics, share: JointShare) -> float:
    """Size of the same effect under another reading."""
    other = result.share(share.effect.key)
    return share.size if other is None else other.size


def _left_by_model(
    motion: Motion, number: int, best: JointMechanics, in_model: dict[str, float], put_in: Array
) -> float:
    """Torque that the model as it is leaves over, rms about its mean, N·m."""
    rows = motion.moving[:, number]
    total: Array = put_in[rows]
    for share in best.shares:
        columns = motion.smooth(share.effect.columns)[rows]
        total = total + columns @ (
            share.values - (in_model.get(share.effect.key, 0.0) if len(share.values) == 1 else 0.0)
        )
    return float(np.hypot(np.sqrt(np.mean(total**2)), best.held_out.interleaved))


def _remains(best: JointMechanics) -> str:
    """The residual, and what it may be."""
    after = best.held_out
    share = after.interleaved / max(after.torque, 1e-300)
    words = f"{percent(share)} of the torque"
    if best.sticking_excess > 0.5:
        words += "; torque in rows that stick is beyond Coulomb friction (breakaway, or friction that builds up)"
    return words
