"""What the bodies of a robot's file have wrong: in words, with its size, and as a changed model.

A body is named where one explanation holds nine tenths of the probability and its values of the first part of the log
leave less of the torque of the last part. Of a link that differs, each number is stated where the log tells it better
than its prior; the others stay at the file's values. What the file hangs on a link and weighs what the link lacks is
not mounted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import norm

from nmt_core.text.number_words import percent, value_text
from nmt_robots.bodies.body_choice import EVERY, RISES, TOLERANCE, BodyChoice, BodyEvidence, BodyExplanation, Weighed
from nmt_robots.bodies.body_rows import UNSEEN, BodyRows, Whitened, across, body_rows, free_spread, whitened
from nmt_robots.bodies.body_shape import SHAPE, moved_body
from nmt_robots.bodies.robot_parts import MountedPart, last_links, parts_of
from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.model.links import parameters_of, split_parameters
from nmt_robots.model.robot_model import BodyChange, Joint, RobotModel

_EARLY = 0.7
_TOLD = 0.7
"""Share of a prior's variance that the log has to take for a number to be stated."""
_SAME = 3.0
"""Standard uncertainties within which the mass of a part is that which its link lacks."""
_SAME_SHARE, _AS_MUCH = 0.2, 0.9
"""The same as a share of its mass; and what it has to explain of the evidence that the link explains, set free."""
_MISFIT = 3.0
"""Pull of a tolerance, in standard deviations, from which the bodies are not as in the file for sure."""
_IMPLAUSIBLE = 3.5
_ONE_OF_ALL = 0.005
"""Chance that one of several numbers lies so far from the file; a larger chance is plausible."""
_FEWEST_ROWS = 80
_WORDS = {
    ("spring", True): "spring at", ("constant", True): "gain or torque constant of",
    ("constant", False): "torque constant of",
}  # fmt: skip
"""Of a joint, and whether the joint is asked for it: a computed torque has two gains next to the drive's constant."""
_AXES = ("x", "y", "z")
_OF_LINKS = frozenset({"link", "pair", "all", "several", "payload", "part"})


@dataclass(frozen=True)
class BodyValue:
    """One number that differs.

    Attributes:
        body: the link's or joint's name.
        quantity: what it is.
        value, std: of the robot.
        in_model: of the file.
        unit: of all three.
    """

    body: str
    quantity: str
    value: float
    std: float
    in_model: float
    unit: str

    def text(self) -> str:
        """In a sentence."""
        return f"{self.quantity} {value_text(self.value, self.std, self.unit)} (file {self.in_model:.3g})"

    def to_mapping(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {
            "body": self.body, "quantity": self.quantity, "value": self.value, "std": self.std,
            "in_model": self.in_model, "unit": self.unit,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class BodyFinding:
    """What all joints together say of the bodies.

    Attributes:
        kind: none, part, link, pair, payload, tilt, constant, all or several; joint where something else at one joint
            explains more, unknown where nothing is sure.
        words: what it is, in a few words; empty of none and unknown.
        sentence: for people.
        probability: posterior, of the subject that is named.
        instead: words of others that cannot be told apart, with their probabilities.
        values: that differ.
        effect: J, rms of its change over each joint's torque.
        before, after: J, torque left on the last part by values of the rows before, as given and as changed; N·m.
        robot: the changed model; the same object where nothing is claimed.
        within: the same with all links moved within the file's tolerances to where they fit best, for the joints.
        early: as ``robot``, by the rows before the last part alone.
        factor: J, of each joint's logged torque against the real one.
        unseen: what this log cannot tell, by name.
        misfit: largest pull of a tolerance where nothing differs, in standard deviations.
        subjects: kind and places of all that holds 95 % of the probability.
        changes, gravity: of the bodies, and gravity in the base's frame; None where that stands as in the file.
    """

    kind: str
    words: str
    sentence: str
    probability: float
    robot: RobotModel
    within: RobotModel
    early: RobotModel
    factor: Array
    effect: Array
    before: Array
    after: Array
    values: tuple[BodyValue, ...] = ()
    instead: tuple[tuple[str, float], ...] = ()
    unseen: tuple[str, ...] = ()
    misfit: float = 0.0
    subjects: tuple[str, ...] = ()
    changes: tuple[BodyChange, ...] = field(default=())
    gravity: Array | None = None

    @property
    def claimed(self) -> bool:
        """Whether bodies differ by a named cause."""
        return bool(self.words)

    @property
    def of_links(self) -> bool:
        """Whether links, parts or payloads may differ."""
        return any(item.split(" ")[0] in _OF_LINKS for item in self.subjects)

    def to_mapping(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {
            "kind": self.kind, "words": self.words, "sentence": self.sentence, "probability": self.probability,
            "values": [value.to_mapping() for value in self.values],
            "cannot_be_told_apart": [{"words": words, "probability": share} for words, share in self.instead],
            "share_of_torque": self.effect.tolist(), "last_part_as_given": self.before.tolist(),
            "last_part": self.after.tolist(), "cannot_tell": list(self.unseen), "largest_pull": self.misfit,
        }  # fmt: skip


def body_finding(robot: RobotModel, log: JointLog, torque: Array, joints: Sequence[Joint]) -> BodyFinding | None:
    """What bodies differ from the file; None where the log is too short to ask, or has one joint, which shares nothing.

    Args:
        robot: as the file has it.
        log: on an even clock.
        torque: rows × J, of the drives as the log is read, N·m.
        joints: of the columns.
    """
    if log.rows * log.step_s < _FEWEST_ROWS * 0.05 + 1.0 or len(joints) < 2:
        return None
    in_file = [(joint.coulomb, joint.damping, joint.armature) for joint in joints]
    rows = body_rows(robot, log.joints, log.position, torque, log.step_s, in_file)
    parts = parts_of(robot, rows.links)
    white = whitened(rows, free_spread(rows))
    evidence = BodyEvidence(
        rows, white, last_links(robot, rows.links), [(part.parameters, part.link) for part in parts]
    )
    asked = _Asked(robot, log.joints, rows, evidence, parts, log.is_arithmetic)
    return asked.finding(evidence.choose())


class _Asked:
    """Bodies of one log, and words for them."""

    def __init__(
        self, robot: RobotModel, joints: tuple[str, ...], rows: BodyRows, evidence: BodyEvidence,
        parts: list[MountedPart], arithmetic: bool,
    ) -> None:  # fmt: skip
        self._robot, self._joints, self._rows, self._evidence, self._parts = robot, joints, rows, evidence, parts
        self._of_one_joint = {"spring", "constant"} if arithmetic else {"spring"}

    def finding(self, choice: BodyChoice) -> BodyFinding:
        """The answer by all explanations."""
        rows, width = self._rows, len(self._joints)
        nothing = next(item for item in choice.weighed if item.explanation.kind == "none")
        still = np.zeros(rows.columns.shape[2])
        before = self._last_part(still)
        best, probability = choice.named[0]
        unseen = tuple(self._unseen())
        others = (*choice.named[1:], *choice.same)
        instead = tuple((self._words(item.explanation), share) for item, share in others)
        base = BodyFinding(
            "none", "", "", probability, self._robot, self._robot, self._robot, np.ones(width), np.zeros(width), before,
            before, (), instead, unseen, nothing.pulled,
            tuple(self._subject(item.explanation) for item, _ in (*choice.named, *choice.same)),
        )  # fmt: skip
        if len(choice.named) > 1:
            listed = ", ".join(f"{self._words(item.explanation)} ({percent(share)})" for item, share in choice.named)
            return replace(base, kind="unknown", sentence=f"This log cannot tell apart: {listed}.",
                           instead=((self._words(best.explanation), probability), *instead))  # fmt: skip
        if best.explanation.kind == "none":
            words = "As far as this log tells, the bodies agree with the file within its tolerances."
            if nothing.pulled > _MISFIT:
                base = replace(base, kind="unknown")
                words += (
                    f" Yet a tolerance is pulled by {nothing.pulled:.1f} standard deviations: something acts that none "
                    "of the explanations has."
                )
            return replace(base, sentence=words)
        if best.explanation.kind in self._of_one_joint:
            words = f"{_capital(self._words(best.explanation))} explains the torque better than any body."
            return replace(base, kind="joint", sentence=words)
        free = int(np.count_nonzero(self._evidence.spread(best.explanation)[1]))
        if best.reached > max(_IMPLAUSIBLE, norm.isf(0.5 * _ONE_OF_ALL / max(free, 1))):
            words = (
                f"Best fits: {self._words(best.explanation)}; but that would be off by {best.reached:.1f} prior "
                "standard deviations, which no file is: nothing is claimed."
            )
            return replace(base, kind="unknown", sentence=_capital(words))
        return self._claimed(base, self._structured(best))

    def _structured(self, best: Weighed) -> Weighed:
        """The explanation with parts in the place of links that lack their mass, and with links added that it needs."""
        evidence, explanation = self._evidence, best.explanation
        for link in explanation.links:
            numbers, std, _ = best.of_link(link)
            mass = float(evidence.shapes.masses[link])
            lacking, loose = mass * (1.0 - np.exp(numbers[0])), mass * np.exp(numbers[0]) * std[0]
            others = tuple(item for item in explanation.wide if item[0] != link)
            without = evidence.weigh(BodyExplanation("several", others)).evidence
            for place, part in enumerate(self._parts):
                apart = abs(part.mass - lacking)
                if part.link != link or apart > max(_SAME * loose, _SAME_SHARE * part.mass):
                    continue
                # Nothing is free in a part that is off: it need not explain as much as a link with ten numbers.
                trial = evidence.weigh(BodyExplanation("part", others, off=place))
                if trial.evidence - without > max(RISES, _AS_MUCH * (best.evidence - without)):
                    return trial
        if explanation.kind != "all":
            return best
        found = evidence.grown(explanation)
        return found if found.explanation.wide else best

    def _claimed(self, base: BodyFinding, best: Weighed) -> BodyFinding:
        """The claim with the numbers that the log tells, tested on the last part of the log."""
        evidence = self._evidence
        wide = tuple(
            (link, measured)
            for link, numbers in best.explanation.wide
            if (measured := self._measured(best, link, numbers))
        )
        early = np.arange(len(self._rows.time)) < _EARLY * len(self._rows.time)
        white = whitened(self._rows, free_spread(self._rows), early)
        holding = self._holding(replace(best.explanation, wide=wide), white, base.before)
        explanation = best.explanation if holding is None else holding
        kind = "part" if explanation.off >= 0 else explanation.kind
        fitted = evidence.weigh(explanation)
        touched = evidence.effect(fitted.wide) >= UNSEEN
        first = evidence.weigh(explanation, white)
        after = self._last_part(first.change)
        closes = float(np.sum(np.log(after / base.before)))
        several = explanation.off < 0 and len(explanation.wide) > 1
        worse = holding is None or (several and bool(np.any(touched & (after >= base.before))))
        if not np.any(touched) or closes >= 0.0 or worse:
            return replace(
                base, kind="unknown",
                sentence=f"Best fits: {self._words(best.explanation)}; but by values of the first part of the log some "
                "joints have no less left on the last part, so nothing is claimed.",
            )  # fmt: skip
        values = tuple(self._values(fitted))
        words = self._words(explanation)
        sized = "; ".join(f"{value.body}: {value.text()}" for value in values if explanation.off < 0 or value.std > 0.0)
        factor = np.ones(len(self._joints))
        factor += np.where(fitted.spread[self._rows.drives] > 0.05, fitted.numbers[self._rows.drives], 0.0)
        far = evidence.spread(explanation)[1]
        changes, before = (
            self._changes(item, np.where(far, item.numbers[: len(far)], 0.0)) for item in (fitted, first)
        )
        gravity = self._gravity(fitted)
        moved = self._changes(fitted, fitted.numbers)
        sentence = (
            f"{_capital(words)}{': ' if sized else ''}{sized}. All joints were asked together; posterior "
            f"probability {base.probability:.3g}. On the last part of the log, by values from before, the torque left "
            f"falls at {int(np.sum(after < base.before))} of {len(after)} joints."
        )
        if base.instead:
            sentence += f" It may be a {base.instead[0][0]} ({percent(base.instead[0][1])})."
        return replace(
            base, kind=kind, words=words, subjects=(self._subject(fitted.explanation), *base.subjects[1:]),
            sentence=sentence,
            values=values, effect=evidence.effect(fitted.wide), after=after, factor=factor, changes=changes,
            robot=self._robot.with_bodies(changes, gravity), within=self._robot.with_bodies(moved, gravity),
            early=self._robot.with_bodies(before, self._gravity(first)), gravity=gravity,
        )  # fmt: skip

    def _holding(self, explanation: BodyExplanation, white: Whitened, before: Array) -> BodyExplanation | None:
        """The explanation, without those of several links by which joints have more left on the last part; None where
        nothing of it holds.
        """
        if explanation.off >= 0 or len(explanation.wide) < 2:
            return explanation
        lost = self._lost(explanation, white, before)
        while lost > 0.0:
            if len(explanation.wide) == 1:
                return None
            fewer = [
                replace(explanation, kind="several", wide=tuple(item for item in explanation.wide if item is not link))
                for link in explanation.wide
            ]
            losses = [self._lost(item, white, before) for item in fewer]
            least = int(np.argmin(losses))
            if losses[least] >= lost:
                return None
            explanation, lost = fewer[least], losses[least]
        return explanation

    def _lost(self, explanation: BodyExplanation, white: Whitened, before: Array) -> float:
        """ln of how much more joints have left on the last part, over those whose torque the links take a part of."""
        first = self._evidence.weigh(explanation, white)
        more = np.log(self._last_part(first.change) / before)[self._evidence.effect(first.wide) >= UNSEEN]
        return float(np.sum(np.maximum(more, 0.0)))

    def _measured(self, best: Weighed, link: int, numbers: tuple[int, ...]) -> tuple[int, ...]:
        _, std, spread = best.of_link(link)
        return tuple(
            number for number in numbers if spread[number] > 0.0 and 1.0 - (std[number] / spread[number]) ** 2 > _TOLD
        )

    def _last_part(self, change: Array) -> Array:
        """J: torque on the last part that a change and friction fitted before it leave, rms, N·m."""
        rows = self._rows
        left = rows.left - rows.columns @ change
        early = np.arange(len(left)) < _EARLY * len(left)
        found = np.empty(left.shape[1])
        for joint in range(left.shape[1]):
            columns = rows.nuisances[:, joint, :, joint]
            weight = 1.0 / (0.01 * rows.size[joint]) ** 2
            gram = weight * columns[early].T @ columns[early] + np.eye(columns.shape[1])
            values = np.linalg.solve(gram, weight * columns[early].T @ left[early, joint])
            found[joint] = float(np.sqrt(np.mean((left[~early, joint] - columns[~early] @ values) ** 2)))
        return np.maximum(found, 1e-12)

    def _link_name(self, link: int) -> str:
        return self._robot.body_name(self._rows.links[link].root)

    def _subject(self, explanation: BodyExplanation) -> str:
        """Kind and places in one line."""
        names = [self._link_name(link) for link in explanation.links]
        if explanation.off >= 0:
            names.insert(0, self._robot.body_name(self._parts[explanation.off].bodies[0]))
        if explanation.end >= 0:
            names.append(self._link_name(explanation.end))
        if explanation.joint >= 0:
            names.append(self._joints[explanation.joint])
        return " ".join([explanation.kind, *(names if explanation.kind != "all" else [])])

    def _words(self, explanation: BodyExplanation) -> str:
        """A few words for an explanation."""
        names = [self._link_name(link) for link in explanation.links]
        if explanation.off >= 0:
            part = self._parts[explanation.off]
            further = f", and the body of {_listed(names)} differs" if names else ""
            return f"the part {part.words} of the file ({part.mass:.3g} kg) is not mounted{further}"
        if explanation.end >= 0:
            return f"payload on {self._link_name(explanation.end)} that is not in the file"
        if explanation.joint >= 0:
            what = _WORDS[explanation.kind, explanation.kind in self._of_one_joint]
            return f"{what} {self._joints[explanation.joint]}"
        if explanation.kind == "tilt":
            return "base that leans"
        if explanation.kind == "all":
            return "bodies of all links"
        if explanation.kind == "none":
            return "bodies as in the file"
        return f"body of {names[0]}" if len(names) == 1 else f"bodies of {_listed(names)}"

    def _values(self, item: Weighed) -> list[BodyValue]:
        """Numbers that differ, in a person's units."""
        found: list[BodyValue] = []
        rows, explanation = self._rows, item.explanation
        for link, numbers in explanation.wide:
            name, shapes = self._link_name(link), self._evidence.shapes
            in_file, centre = float(shapes.masses[link]), shapes.centres[link]
            values, std, _ = item.of_link(link)
            for number in numbers:
                if number == 0:
                    mass = in_file * float(np.exp(values[0]))
                    found.append(BodyValue(name, "mass", mass, mass * float(std[0]), in_file, "kg"))
                elif number < 4:
                    place = float(centre[number - 1])
                    found.append(BodyValue(name, f"centre of mass along {_AXES[number - 1]}",
                                           place + float(values[number]), float(std[number]), place, "m"))  # fmt: skip
        if explanation.off >= 0:
            part = self._parts[explanation.off]
            found.insert(0, BodyValue(part.words, "mass", 0.0, 0.0, part.mass, "kg"))
        if explanation.end >= 0:
            mass, loose = float(np.exp(item.numbers[-4])), float(item.std[-4])
            found.append(BodyValue(self._link_name(explanation.end), "payload", mass, mass * loose, 0.0, "kg"))
        if explanation.joint >= 0:
            place = rows.drives.start + explanation.joint
            value, loose = float(item.numbers[place]), float(item.std[place])
            found.append(BodyValue(self._joints[explanation.joint], "torque constant", 1.0 / (1.0 + value),
                                   loose, 1.0, "of the log's value"))  # fmt: skip
        if explanation.kind == "tilt":
            lean = np.degrees(item.numbers[rows.tilt])
            size = float(np.linalg.norm(lean))
            spread = np.linalg.norm(lean * np.degrees(item.std[rows.tilt])) / max(size, 1e-12)
            # What leans is the file's masses.
            spread = np.hypot(spread, TOLERANCE[0] * size)
            found.append(BodyValue("base", "lean", size, float(spread), 0.0, "°"))
        return found

    def _changes(self, item: Weighed, numbers: Array) -> tuple[BodyChange, ...]:
        """Mass, centre and inertia of each body that differs, with some numbers of the links."""
        model, data = self._robot.at_rest()
        found: dict[int, BodyChange] = {}
        explanation = item.explanation
        for link, centre in enumerate(self._evidence.shapes.centres):
            values, root = numbers[SHAPE * link : SHAPE * (link + 1)], self._rows.links[link].root
            if not np.any(values) and link != explanation.end:
                continue
            load = self._evidence.payload(link, item.numbers) if link == explanation.end else np.zeros(len(EVERY))
            for body in self._rows.links[link].bodies:
                if model.body_mass[body] > 0.0 or (body == root and np.any(load)):
                    moved = moved_body(body_in(model, data, root, body), centre, values)
                    if body == root:
                        moved = split_parameters(parameters_of(*moved) + load)
                    found[body] = body_change(model, data, root, body, moved)
        if explanation.off >= 0:
            for body in self._parts[explanation.off].bodies:
                found[body] = BodyChange(body, 0.0, np.zeros(3), np.zeros((3, 3)))
        return tuple(found.values())

    def _gravity(self, item: Weighed) -> Array | None:
        """Gravity in the base's frame, m/s²; None where the base stands as in the file."""
        if item.explanation.kind != "tilt":
            return None
        gravity = self._rows.gravity
        lean = item.numbers[self._rows.tilt] @ across(gravity)
        changed = gravity + np.cross(lean, gravity)
        return np.asarray(changed * np.linalg.norm(gravity) / np.linalg.norm(changed))

    def _unseen(self) -> list[str]:
        """What this motion cannot tell, before any torque is looked at: a mass off by 30 %, a centre by 3 cm."""
        found = []
        evidence = self._evidence
        for link in range(evidence.count):
            if evidence.shapes.masses[link] <= 0.0:
                continue
            name, dumb = self._link_name(link), []
            for number, size in ((0, np.log(1.3)), (1, 0.03), (2, 0.03), (3, 0.03)):
                numbers = np.zeros(self._rows.columns.shape[2])
                numbers[10 * link + number] = size
                change = evidence.change(BodyExplanation("none"), numbers)
                if float(np.max(evidence.effect(change))) < UNSEEN:
                    dumb.append("mass" if number == 0 else f"centre along {_AXES[number - 1]}")
            if dumb:
                found.append(f"{name}: {', '.join(dumb)}")
        return found


def _capital(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}"


def _listed(names: Sequence[str]) -> str:
    """Up to three names; of more links the first and how many there are."""
    if len(names) > 3:
        return f"{names[0]} and {len(names) - 1} more links"
    return " and ".join(names)


def body_in(model: Any, data: Any, root: int, body: int) -> tuple[float, Array, Array]:
    """Mass, centre and inertia about it of a body, in the frame of another that moves with it."""
    turn = data.xmat[root].reshape(3, 3)
    axes = turn.T @ data.ximat[body].reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    return float(model.body_mass[body]), turn.T @ (data.xipos[body] - data.xpos[root]), inertia


def body_change(model: Any, data: Any, root: int, body: int, values: tuple[float, Array, Array]) -> BodyChange:
    """Mass, centre and inertia in the frame of ``root`` as a change of a body, in its frame."""
    mass, centre, inertia = values
    between = data.xmat[body].reshape(3, 3).T @ data.xmat[root].reshape(3, 3)
    shift = data.xmat[body].reshape(3, 3).T @ (data.xpos[root] - data.xpos[body])
    return BodyChange(body, mass, between @ centre + shift, between @ inertia @ between.T)


def without_factor(log: JointLog, factor: Array) -> JointLog:
    """The log with the torque that the drives made where their constants are not those it assumes."""
    if np.all(factor == 1.0):
        return log
    scaled = {
        name: values / factor
        for name in ("torque", "torque_command", "position_gain", "velocity_gain")
        if (values := getattr(log, name)) is not None
    }
    return replace(log, **scaled)
