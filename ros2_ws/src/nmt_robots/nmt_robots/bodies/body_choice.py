"""Which explanation of the bodies the torque of all joints prefers, each with its posterior probability.

Every explanation has every number: each link's mass, centre and shape, the tilt of the base, the constant of each
drive. All may move within the tolerance of a file; those that an explanation points at may move far. The evidence is
Laplace's about the best numbers::

    ln Z = −½ |W (r − Y Δφ(θ))|² − ½ |θ / σ|² − ½ ln det(JᵀJ + 1)

with the rows whitened and J per prior standard deviation σ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from nmt_robots.bodies.body_rows import CONSTANT, TILT, UNSEEN, BodyRows, Whitened, spring_spread
from nmt_robots.bodies.body_shape import SHAPE, BodyShapes
from nmt_robots.log.joint_log import Array

TOLERANCE = (0.015, 0.01, 0.02)
"""Of a file: relative mass, centre as a share of the link's length, shape."""
WIDE = (0.25, 0.15, 0.15)
"""The same of a link that an explanation points at: 15 % of shape are 30 % of an inertia."""
EVERYWHERE = (0.10, 0.10, 0.15)
"""The same where all links are off."""
_TILT_TOLERANCE, _CONSTANT_TOLERANCE = np.radians(0.2), 0.005
_PRIOR = {
    "none": 0.4, "link": 0.25, "payload": 0.12, "tilt": 0.08, "constant": 0.10, "pair": 0.10, "all": 0.10,
    "part": 0.10, "spring": 0.05,
}  # fmt: skip
_STEPS = 12
_LONGEST = 3.0
_SETTLED = 1e-3
_PAYLOAD_SIZES = (0.03, 0.15, 0.5)
"""Masses at which the fit of a payload starts, as shares of the mass of the last links."""
_PAYLOAD_SPREAD = 1.5
_NAMED, _TOGETHER = 0.9, 0.95
"""Probability of one subject that is named, and of several that cannot be told apart."""
_SURELY = 0.99
"""Of a payload and its link: share from which it is a payload; below, the link differs, which is true of both."""
RISES = 3.0
"""ln evidence by which a further link has to be better."""
_PAIRED = 6
"""Links of highest evidence of which pairs are made."""


MASS, CENTRE, BOTH, EVERY = (0,), (1, 2, 3), (0, 1, 2, 3), tuple(range(SHAPE))
_VARIANTS = (MASS, CENTRE, BOTH, EVERY)
_OF_ALL = (BOTH, EVERY)
"""The same where all links are off: whoever has drawn them has no mass without its place."""


@dataclass(frozen=True)
class BodyExplanation:
    """A way in which bodies may differ from the file.

    Attributes:
        kind: key of the class.
        wide: links whose numbers may move far, each with these numbers.
        joint: number of the drive whose constant may; −1 without one.
        off: number of the part that is not mounted; −1 without one.
        end: number of the link that carries a payload; −1 without one.
    """

    kind: str
    wide: tuple[tuple[int, tuple[int, ...]], ...] = ()
    joint: int = -1
    off: int = -1
    end: int = -1

    @property
    def links(self) -> tuple[int, ...]:
        """Links that may differ."""
        return tuple(link for link, _ in self.wide)

    @property
    def subject(self) -> tuple[str, tuple[int, ...], int, int, int]:
        """What it is about, whatever may move of it."""
        return self.kind, self.links, self.joint, self.off, self.end


Subject = tuple[str, tuple[int, ...], int, int, int]


@dataclass(frozen=True, eq=False)
class Weighed:
    """An explanation with its numbers.

    Attributes:
        explanation: which.
        evidence: ln Z.
        numbers, std: of all columns' numbers: ten of each link, two of the tilt (rad), one of each drive, and
            what no body is; those of a
            payload stand behind them: mass (kg) and first moments (kg·m).
        spread: prior standard deviations of the same.
        change: P, by how much the parameters of the columns differ from the file.
        wide: P, the same of the widely varied parameters.
        pulled: largest pull of a number within its tolerance.
        reached: the same of those that may move far.
    """

    explanation: BodyExplanation
    evidence: float
    numbers: Array
    std: Array
    spread: Array
    change: Array
    wide: Array
    pulled: float
    reached: float

    def of_link(self, link: int) -> tuple[Array, Array, Array]:
        """Numbers of a link, their ±, and their prior spread."""
        part = slice(SHAPE * link, SHAPE * (link + 1))
        return self.numbers[part], self.std[part], self.spread[part]


@dataclass(frozen=True, eq=False)
class BodyChoice:
    """All explanations that were asked.

    Attributes:
        weighed: best first.
        probability: of each, in the same order.
        named: subjects that hold 95 % together, likeliest first.
        same: what else the first of them may be called, with its probability, where no log parts the two: a payload
            on a last link is that link with more in it.
    """

    weighed: tuple[Weighed, ...]
    probability: tuple[float, ...]
    named: tuple[tuple[Weighed, float], ...] = field(default=())
    same: tuple[tuple[Weighed, float], ...] = field(default=())


class BodyEvidence:
    """Evidence of explanations about one log.

    Args:
        rows: of the log, unwhitened.
        white: the same, whitened.
        ends: for each payload the number of the link that carries it.
        parts: for each part ten parameters of it in the frame of its link, and the number of the link.
    """

    def __init__(
        self, rows: BodyRows, white: Whitened, ends: Sequence[int], parts: Sequence[tuple[Array, int]]
    ) -> None:
        self.rows, self._white, self.ends, self.parts = rows, white, ends, parts
        self.shapes = BodyShapes(
            np.array([link.parameters for link in rows.links]), np.array([link.length for link in rows.links])
        )
        self.count = len(rows.links)
        self._size = 10 * self.count + 2 + 2 * rows.left.shape[1]
        scaled = rows.columns / rows.size[:, None]
        self._grams = np.einsum("njp,njq->jpq", scaled, scaled) / len(scaled)

    def spread(self, explanation: BodyExplanation) -> tuple[Array, Array]:
        """Prior standard deviations of all numbers, and which of them may move far."""
        found, far = np.zeros(self._size), np.zeros(self._size, dtype=bool)
        for link in range(self.count):
            found[SHAPE * link : SHAPE * (link + 1)] = self._of_link(link, TOLERANCE)
        found[10 * self.count : 10 * self.count + 2] = _TILT_TOLERANCE
        found[self.rows.drives] = _CONSTANT_TOLERANCE
        wide = EVERYWHERE if explanation.kind == "all" else WIDE
        for link, numbers in explanation.wide:
            part = SHAPE * link + np.array(numbers, dtype=int)
            found[part], far[part] = self._of_link(link, wide)[list(numbers)], True
        if explanation.kind == "tilt":
            found[10 * self.count : 10 * self.count + 2], far[10 * self.count : 10 * self.count + 2] = TILT, True
        if explanation.kind == "constant":
            place = self.rows.drives.start + explanation.joint
            found[place], far[place] = CONSTANT, True
        if explanation.kind == "spring":
            place = self.rows.springs.start + explanation.joint
            found[place], far[place] = spring_spread(self.rows)[explanation.joint], True
        return found, far

    def _of_link(self, link: int, sizes: tuple[float, float, float]) -> Array:
        length = self.rows.links[link].length
        if self.shapes.masses[link] <= 0.0:
            return np.zeros(SHAPE)
        return np.array([sizes[0], *3 * [sizes[1] * length], *6 * [sizes[2]]])

    def weigh(self, explanation: BodyExplanation, white: Whitened | None = None) -> Weighed:
        """An explanation at its best numbers; a payload from several starts."""
        white = self._white if white is None else white
        if explanation.end < 0:
            return self._weigh(explanation, white, 0.0)
        carried = float(self.shapes.masses[explanation.end])
        found = [self._weigh(explanation, white, size * max(carried, 0.1)) for size in _PAYLOAD_SIZES]
        return max(found, key=lambda item: item.evidence)

    def _weigh(self, explanation: BodyExplanation, white: Whitened, start: float) -> Weighed:
        spread, far = self.spread(explanation)
        middle = np.zeros(self._size)
        if explanation.end >= 0:
            length = self.rows.links[explanation.end].length
            spread = np.concatenate([spread, [_PAYLOAD_SPREAD], 3 * [max(0.5 * length, 0.1)]])
            far = np.concatenate([far, 4 * [True]])
            middle = np.concatenate([middle, [np.log(start), 0.0, 0.0, 0.0]])
        free = spread > 0.0
        x = np.zeros(len(spread))
        cost, left = self._at(explanation, white, middle, x)
        for _ in range(_STEPS):
            scaled = self._slopes(explanation, white, middle + spread * x)[:, free] * spread[free]
            matrix = scaled.T @ scaled + np.eye(scaled.shape[1])
            step = np.linalg.solve(matrix, scaled.T @ left - x[free])
            step *= min(1.0, _LONGEST / max(float(np.max(np.abs(step))), 1e-12))
            for shorter in (1.0, 0.5, 0.2, 0.05):
                trial = x.copy()
                trial[free] += shorter * step
                result = self._at(explanation, white, middle + spread * trial, trial)
                if result[0] < cost:
                    break
            else:
                break
            settled = cost - result[0] < _SETTLED
            x, (cost, left) = trial, result
            if settled:
                break
        scaled = self._slopes(explanation, white, middle + spread * x)[:, free] * spread[free]
        matrix = scaled.T @ scaled + np.eye(scaled.shape[1])
        sign, size = np.linalg.slogdet(matrix)
        std = np.zeros(len(spread))
        std[free] = spread[free] * np.sqrt(np.diag(np.linalg.inv(matrix)))
        numbers = middle + spread * x
        evidence = -0.5 * (cost + size) if sign > 0 else -np.inf
        within = free & ~far
        return Weighed(
            explanation, float(evidence), numbers, std, spread, self.change(explanation, numbers),
            self.change(explanation, np.where(far, numbers, 0.0)),
            float(np.max(np.abs(x[within]), initial=0.0)), float(np.max(np.abs(x[far]), initial=0.0)),
        )  # fmt: skip

    def change(self, explanation: BodyExplanation, numbers: Array) -> Array:
        """P: parameters of all columns without those of the file."""
        found = np.zeros(self._size)
        found[: 10 * self.count] = self.shapes.change(self._of_links(numbers)).ravel()
        found[10 * self.count : self._size] = numbers[10 * self.count : self._size]
        if explanation.end >= 0:
            found[10 * explanation.end : 10 * explanation.end + 10] += self.payload(explanation.end, numbers)
        if explanation.off >= 0:
            parameters, link = self.parts[explanation.off]
            found[10 * link : 10 * link + 10] -= parameters
        return found

    def _of_links(self, numbers: Array) -> Array:
        return np.asarray(numbers[: SHAPE * self.count]).reshape(self.count, SHAPE)

    def payload(self, link: int, numbers: Array) -> Array:
        """Ten parameters of a payload: a point at a distance from the end of its link."""
        mass, place = float(np.exp(numbers[self._size])), self._end(link) + numbers[self._size + 1 :]
        inertia = mass * (float(place @ place) * np.eye(3) - np.outer(place, place))
        return np.array([mass, *(mass * place), *inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])

    def _end(self, link: int) -> Array:
        return np.asarray(self.shapes.centres[link])

    def _at(self, explanation: BodyExplanation, white: Whitened, numbers: Array, pulls: Array) -> tuple[float, Array]:
        """Cost, and what the whitened rows leave."""
        left = white.moment - white.triangle @ self.change(explanation, numbers)
        return float(left @ left + pulls @ pulls), left

    def _slopes(self, explanation: BodyExplanation, white: Whitened, numbers: Array) -> Array:
        """Of the whitened rows by each number."""
        slopes = np.zeros((len(white.moment), len(numbers)))
        triangle = white.triangle[:, : 10 * self.count].reshape(-1, self.count, 10).swapaxes(0, 1)
        of_links = triangle @ self.shapes.slopes(self._of_links(numbers))
        slopes[:, : SHAPE * self.count] = of_links.swapaxes(0, 1).reshape(-1, SHAPE * self.count)
        slopes[:, 10 * self.count : self._size] = white.triangle[:, 10 * self.count :]
        if explanation.end >= 0:
            link = explanation.end
            part = slice(10 * link, 10 * link + 10)
            for place in range(4):
                step = np.zeros(len(numbers))
                step[self._size + place] = 1e-5
                slope = (self.payload(link, numbers + step) - self.payload(link, numbers - step)) / 2e-5
                slopes[:, self._size + place] = white.triangle[:, part] @ slope
        return slopes

    def effect(self, change: Array) -> Array:
        """J: torque that a change of the parameters makes, rms over that of the joint."""
        return np.asarray(np.sqrt(np.maximum(np.einsum("p,jpq,q->j", change, self._grams, change), 0.0)))

    def _subject(self, item: Weighed) -> Subject:
        """What an explanation is about: nothing where it hardly changes any torque, one link where only that does."""
        if float(np.max(self.effect(item.wide))) < UNSEEN:
            return BodyExplanation("none").subject
        if item.explanation.kind != "pair":
            return item.explanation.subject
        acting = []
        for link in item.explanation.links:
            part = np.zeros(self._size)
            part[10 * link : 10 * link + 10] = item.wide[10 * link : 10 * link + 10]
            if float(np.max(self.effect(part))) >= UNSEEN:
                acting.append((link, EVERY))
        return BodyExplanation("pair" if len(acting) != 1 else "link", tuple(acting) or item.explanation.wide).subject

    def choose(self) -> BodyChoice:
        """All explanations with their probabilities."""
        links = [link for link in range(self.count) if self.shapes.masses[link] > 0.0]
        asked: list[tuple[BodyExplanation, float]] = [(BodyExplanation("none"), _PRIOR["none"])]
        singles = [BodyExplanation("link", ((link, numbers),)) for link in links for numbers in _VARIANTS]
        asked += [(item, _PRIOR["link"] / len(singles)) for item in singles]
        asked += [(BodyExplanation("payload", end=end), _PRIOR["payload"] / len(self.ends)) for end in self.ends]
        if np.any(self.rows.gravity):
            asked.append((BodyExplanation("tilt"), _PRIOR["tilt"]))
        width = self.rows.left.shape[1]
        asked += [(BodyExplanation("constant", joint=joint), _PRIOR["constant"] / width) for joint in range(width)]
        asked += [(BodyExplanation("spring", joint=joint), _PRIOR["spring"] / width) for joint in range(width)]
        asked += [
            (BodyExplanation("all", tuple((link, numbers) for link in links)), _PRIOR["all"] / len(_OF_ALL))
            for numbers in _OF_ALL
        ]
        asked += [
            (BodyExplanation("part", off=off), _PRIOR["part"] / len(self.parts)) for off in range(len(self.parts))
        ]
        weighed = [(self.weigh(item), prior) for item, prior in asked]
        singly = {link: max(w.evidence for w, _ in weighed if w.explanation.links == (link,)) for link in links}
        few = sorted(sorted(links, key=lambda link: -singly[link])[:_PAIRED])
        pairs = [(first, second) for place, first in enumerate(few) for second in few[place + 1 :]]
        share = _PRIOR["pair"] / max(len(links) * (len(links) - 1) // 2, 1)
        sizes = (MASS, BOTH, EVERY)
        weighed += [
            (self.weigh(BodyExplanation("pair", ((first, numbers), (second, numbers)))), share / len(sizes))
            for first, second in pairs
            for numbers in sizes
        ]
        logs = np.array([item.evidence + np.log(prior) for item, prior in weighed])
        shares = np.exp(logs - np.max(logs))
        shares /= np.sum(shares)
        order = np.argsort(-shares)
        nothing = weighed[0][0]
        subjects: dict[Subject, float] = {}
        best: dict[Subject, Weighed] = {}
        for place in order:
            item = weighed[place][0]
            key = self._subject(item)
            subjects[key] = subjects.get(key, 0.0) + float(shares[place])
            # The leanest explanation of a subject stands for it.
            if key not in best or (best[key].explanation.subject != key and item.explanation.subject == key):
                best[key] = nothing if key == nothing.explanation.subject else item
        same = self._joined(subjects, best)
        named: list[tuple[Weighed, float]] = []
        for key in sorted(subjects, key=lambda key: -subjects[key]):
            named.append((best[key], subjects[key]))
            if sum(probability for _, probability in named) >= (_NAMED if len(named) == 1 else _TOGETHER):
                break
        return BodyChoice(
            tuple(weighed[place][0] for place in order), tuple(float(shares[place]) for place in order), tuple(named),
            tuple(same.get(named[0][0].explanation.subject, ())),
        )  # fmt: skip

    def _joined(
        self, subjects: dict[Subject, float], best: dict[Subject, Weighed]
    ) -> dict[Subject, list[tuple[Weighed, float]]]:
        """Probabilities of subjects that are one, put together in place; what else each may be called.

        All links, of which only some are needed, are those. A link may be a payload on it.
        """
        every = next((key for key in subjects if key[0] == "all"), None)
        if every is not None and 1.0 - _TOGETHER < subjects[every] < _NAMED:
            needed = self.grown(best[every].explanation).explanation.links
            some = next((key for key in subjects if key[0] == "pair" and key[1] == needed), None)
            if some is not None:
                subjects[some] += subjects.pop(every)
        same: dict[Subject, list[tuple[Weighed, float]]] = {}
        for end in self.ends:
            link = next((key for key in subjects if key[0] == "link" and key[1] == (end,)), None)
            load = next((key for key in subjects if key[0] == "payload" and key[4] == end), None)
            if link is None or load is None:
                continue
            total = subjects[link] + subjects[load]
            if total >= _NAMED and 1.0 - _TOGETHER < subjects[load] / total < _SURELY:
                same[link] = [(best[load], subjects.pop(load))]
                subjects[link] = total
        return same

    def grown(self, every: BodyExplanation) -> Weighed:
        """Links of an explanation added one by one to none while the evidence rises."""
        found = self.weigh(BodyExplanation("none"))
        while True:
            more = [
                self.weigh(BodyExplanation("several", tuple(sorted((*found.explanation.wide, link)))))
                for link in every.wide
                if link not in found.explanation.wide
            ]
            further = max(more, key=lambda item: item.evidence, default=None)
            if further is None or further.evidence < found.evidence + RISES:
                return found
            found = further
