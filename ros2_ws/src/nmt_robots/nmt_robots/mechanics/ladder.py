"""Mechanics of one joint: which effects its torque needs, their values, and what they leave on motion not seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from nmt_diagnose.choose.choice import Choice, Chosen
from nmt_diagnose.choose.space import Space
from nmt_robots.log.joint_log import Array
from nmt_robots.mechanics.columns import JointEffect, creeping_effects, rival_effects, usual_effects
from nmt_robots.mechanics.joint_space import MARGIN, independent_rows, joint_space
from nmt_robots.mechanics.least_squares import Fit, fitted, solve
from nmt_robots.mechanics.motion import Motion
from nmt_robots.mechanics.readings import DriveSignals
from nmt_robots.thresholds import THRESHOLDS

USUAL = ("coulomb", "viscous", "armature", "offset")
_LAST_PART = 0.7
_CAUSES_AT_MOST = 4
_ALIKE = 10.0
"""Difference of the criterion, odds of 150, up to which another cause does as well in the place of the first."""
_FALLS = frozenset({"stribeck", "changing_friction"})
_SLOW_AND_FAST = (0.02, 0.95)  # of the rows, by speed: between these friction that falls with speed is stated
_FORM_AS_WELL = 1.05
"""Torque left by another form of the same effect against that of the chosen one, up to which it widens the ±."""
_FEWEST_SLOW = 0.01
"""Share of the rows in which a joint must be slow for friction that builds up to be asked for."""
_AS_ROWS_THAT_MOVE = 1.5
"""Torque left in rows that may stick against that in rows that move, up to which they are equations as well."""
_MOSTLY_OTHERS = 0.1
"""Of a column, beyond other effects, below which it is theirs and says nothing of a further one."""


@dataclass(frozen=True)
class StatedFriction:
    """What is stated of friction in the place of its coefficient, which is one at no speed, no time or no angle.

    Attributes:
        words: what falls or builds up, and between what.
        size, std: by how much, or over how much.
        unit: of both.
    """

    words: str
    size: float
    std: float
    unit: str


@dataclass(frozen=True, eq=False)
class JointShare:
    """An effect as found in a joint.

    Attributes:
        effect: which.
        values, std: of its coefficients.
        rms: torque that it takes, N·m.
        unit_rms: the same of a coefficient of one.
        alike: words of effects whose columns say the same in this log.
        equal: those of them whose columns are the same, so that no fit parts them.
        impossible: what a coefficient would be that may not be negative; zero where it is allowed.
        stated: what it makes of friction over the speeds, seconds or angles of the log; None of other effects.
    """

    effect: JointEffect
    values: Array
    std: Array
    rms: float
    unit_rms: float
    alike: tuple[str, ...] = ()
    equal: tuple[str, ...] = ()
    impossible: float = 0.0
    stated: StatedFriction | None = None

    @property
    def size(self) -> float:
        """The coefficient; the length of a pair of them."""
        return float(self.values[0]) if len(self.values) == 1 else float(np.linalg.norm(self.values))

    @property
    def size_std(self) -> float:
        """Its standard uncertainty."""
        if len(self.values) == 1 or self.size == 0.0:
            return float(self.std[0])
        return float(np.sqrt(np.sum((self.values * self.std) ** 2)) / self.size)


@dataclass(frozen=True, eq=False)
class TorqueHeldOut:
    """Torque left on rows that no fit has seen, rms in N·m.

    Attributes:
        interleaved: every other second.
        last: the last part, which in a chirp is another motion.
        torque: of the drive in the same rows, about its mean, with the gain that was found.
        early: coefficients of all effects by the rows before the last part.
    """

    interleaved: float
    last: float
    torque: float
    early: Array


@dataclass(frozen=True)
class JointChoice:
    """Causes that a joint needs where all that is within its tolerance may move.

    Attributes:
        causes: keys of the effects, that first without which the others explain least.
        instead: keys of effects that would do about as well in the place of the first.
        probability: posterior probability of each cause, by key.
        score: the criterion of the choice, of torques in units of the joint's rms.
    """

    causes: tuple[str, ...] = ()
    instead: tuple[str, ...] = ()
    probability: Mapping[str, float] = field(default_factory=dict)
    score: float = 0.0


@dataclass(frozen=True, eq=False)
class JointMechanics:
    """What acts in a joint.

    Attributes:
        shares: effects, the usual ones first.
        held_out, plain: torque left by these, and by the usual effects alone.
        sticking_excess: share of sticking rows whose torque is beyond Coulomb friction.
        choice: which of them are causes.
        new: keys of the usual effects that the model does not state, so that the log alone says what they are.
        lost: keys of causes and new effects that leave no less on the last part of the log, which their values have not
            seen.
    """

    shares: tuple[JointShare, ...]
    held_out: TorqueHeldOut
    plain: TorqueHeldOut
    sticking_excess: float
    choice: JointChoice = JointChoice()
    new: frozenset[str] = frozenset()
    lost: frozenset[str] = frozenset()

    @property
    def causes(self) -> tuple[str, ...]:
        """Keys of the causes."""
        return self.choice.causes

    def share(self, key: str) -> JointShare | None:
        """An effect by its key."""
        return next((share for share in self.shares if share.effect.key == key), None)


class JointProblem:
    """Torque and columns of one joint.

    Args:
        motion: of all joints.
        joint: number of the column.
        drive: of this joint as it is read, unfiltered.
        names: of all joints.

    Attributes:
        rows: which rows of the log are equations, (N,).
    """

    def __init__(self, motion: Motion, joint: int, drive: DriveSignals, names: tuple[str, ...] = ()) -> None:
        self.motion, self.joint = motion, joint
        smooth = motion.smooth_twice(drive.torque)
        self._every = smooth - motion.rigid[:, joint]
        self.usual = usual_effects(motion, joint)
        self._filtered: dict[int, Array] = {}
        self._space: tuple[dict[str, float], Space] | None = None
        creeping = creeping_effects(motion, joint)
        self.rows = self._equations(creeping)
        self.torque = smooth[self.rows]
        self.left = self._every[self.rows]
        self._change = np.gradient(smooth, motion.step_s)[self.rows]
        self.blocks = motion.blocks[self.rows]
        every = [*rival_effects(motion, joint, drive.through(motion.smooth), names), *creeping]
        # A velocity gain next to a commanded speed of zero, or the inertia of a single link: it is named with the usual
        # effect that has the same column, and is not a rival of it.
        twins = self._twins(every)
        self.rivals = [rival for rival in every if rival not in twins]
        self.library = [*self.usual, *self.rivals, *twins]

    def _equations(self, creeping: list[JointEffect]) -> Array:
        """N: rows that move; all of them where friction that builds up explains those that may stick as well as others.

        Torque and angle of a joint that creeps go together, those of one that sticks do not.
        """
        moving, edge = self.motion.moving[:, self.joint], self.motion.window
        every = np.zeros_like(moving)
        every[edge : len(every) - edge] = True
        slow = every & ~moving
        if np.count_nonzero(slow) < _FEWEST_SLOW * np.count_nonzero(every) or not creeping:
            return moving
        usual = self.motion.smooth(np.column_stack([effect.columns for effect in self.usual]))
        odd, lefts = self.motion.blocks % 2 == 1, []
        for further in (None, *creeping):
            matrix = usual if further is None else np.hstack([usual, self.motion.smooth(further.columns)])
            left = np.empty(len(matrix))
            for test in (odd, ~odd):
                known = every & ~test
                left[test] = self._every[test] - matrix[test] @ np.linalg.lstsq(matrix[known], self._every[known])[0]
            lefts.append((_rms(left[slow]), _rms(left[every & moving])))
        least = (1.0 - THRESHOLDS.gives_way / 2.0) * lefts[0][0]
        explained = any(still < least and still < _AS_ROWS_THAT_MOVE * moves for still, moves in lefts[1:])
        return every if explained else moving

    def _twins(self, rivals: list[JointEffect]) -> list[JointEffect]:
        """Rivals whose column is that of friction or armature, beyond the other usual effects."""
        # All of a drive's torque is like what takes most of it, and yet scales all else as well.
        single = [
            rival for rival in rivals if rival.parameters == 1 and (not rival.made_of_torque or rival.shape == "kd")
        ]
        columns = self.columns(single)
        equal = np.zeros(len(single), dtype=bool)
        for effect in self.usual[:-1]:
            others = _span(self.columns([item for item in self.usual if item is not effect]))
            direction = _span(_beyond(others, self.columns([effect])))
            beyond = _beyond(others, columns)
            length = np.linalg.norm(beyond, axis=0)
            apart = length > _MOSTLY_OTHERS * np.linalg.norm(columns, axis=0)
            equal |= apart & (np.abs(direction[:, 0] @ beyond) > THRESHOLDS.equal * length)
        return [rival for rival, same in zip(single, equal, strict=True) if same]

    def columns(self, effects: list[JointEffect]) -> Array:
        """Filtered columns of effects in the rows that move."""
        parts = []
        for effect in effects:
            if id(effect) not in self._filtered:
                self._filtered[id(effect)] = self.motion.smooth(effect.columns)[self.rows]
            parts.append(self._filtered[id(effect)])
        return np.column_stack(parts)

    def held_out(self, effects: list[JointEffect]) -> TorqueHeldOut:
        """What effects leave on rows that their fit has not seen."""
        matrix, never = self.columns(effects), never_negative(effects)
        lost = np.empty_like(self.left)
        odd = self.blocks % 2 == 1
        for test in (odd, ~odd):
            values = solve(matrix[~test], self.left[~test], never)[0]
            lost[test] = self.left[test] - matrix[test] @ values
        late = np.arange(len(self.left)) >= int(_LAST_PART * len(self.left))
        values = solve(matrix[~late], self.left[~late], never)[0]
        last = self.left[late] - matrix[late] @ values
        torque, place = self.torque, 0
        for effect in effects:
            part = slice(place, place + effect.parameters)
            place += effect.parameters
            if effect.made_of_torque:
                torque = torque - matrix[:, part] @ values[part]
        return TorqueHeldOut(_rms(lost), _rms(last), float(np.std(torque)), values)

    def fit(self, effects: list[JointEffect]) -> Fit:
        """Coefficients of effects by all rows; ± with what the model's own tolerances make of them."""
        matrix = self.columns(effects)
        fit = fitted(matrix, self.left, never_negative(effects), self.blocks)
        free = ~fit.held
        gravity = self.motion.gravity[self.rows, self.joint]
        inertial = self.motion.rigid[self.rows, self.joint] - gravity
        tolerated = np.column_stack(
            [
                THRESHOLDS.inertia_tolerance * inertial,
                THRESHOLDS.mass_tolerance * gravity,
                THRESHOLDS.torque_tolerance * self.torque,
                THRESHOLDS.lag_s * self._change,
            ]
        )
        scale = np.maximum(np.linalg.norm(matrix[:, free], axis=0), 1e-300)
        moved = np.linalg.lstsq(matrix[:, free] / scale, tolerated, rcond=1e-10)[0] / scale[:, None]
        std = fit.std.copy()
        std[free] = np.sqrt(std[free] ** 2 + np.sum(moved**2, axis=1))
        return replace(fit, std=std)

    def space(self, in_model: dict[str, float]) -> Space:
        """The rows about the model as given, with all effects that may be causes."""
        if self._space is None or self._space[0] != in_model:
            self._space = dict(in_model), self._space_about(in_model)
        return self._space[1]

    def _space_about(self, in_model: dict[str, float]) -> Space:
        rows, joint = self.rows, self.joint
        gravity = self.motion.gravity[rows, joint]
        inertial = self.motion.rigid[rows, joint] - gravity
        angle = self.motion.smooth(self.motion.q[:, joint])[rows]
        return joint_space(
            self.left, self.torque, (angle, gravity, inertial, self._change), self.blocks, self.motion.step_s,
            [(effect, self.columns([effect])) for effect in [*self.usual, *self.rivals]], in_model,
        )  # fmt: skip

    def last_without(self, cause: JointEffect, effects: list[JointEffect], in_model: float) -> float:
        """Torque on the last part of the log that others leave over by values from before, rms, N·m.

        Args:
            cause: which is as in the model.
            effects: with it among them.
            in_model: its coefficient there.
        """
        others = [effect for effect in effects if effect is not cause]
        matrix, early = self.columns(others), int(_LAST_PART * len(self.left))
        left = self.left - in_model * self.columns([cause])[:, 0]
        values = solve(matrix[:early], left[:early], never_negative(others))[0]
        return _rms(left[early:] - matrix[early:] @ values)

    def last_within(self, causes: list[JointEffect], space: Space) -> float:
        """The same that causes leave of the model, all else within its tolerances; the mean of a torque is free."""
        early, loose = int(_LAST_PART * len(space.left)), space.nuisances.shape[1]
        free = [*causes, *(effect for effect in self.usual if effect.key == "offset" and effect not in causes)]
        matrix = np.hstack([space.nuisances, self.columns(free)])
        known, left = matrix[:early], space.left[:early]
        prior = np.diag(np.where(np.arange(matrix.shape[1]) < loose, 1.0, 0.0))
        # With the torque itself as the error of a row tolerances hardly take what a claim should.
        weight = space.independent / len(space.left) / max(float(np.mean(left**2)), space.floor**2)
        values = np.linalg.lstsq(weight * known.T @ known + prior, weight * known.T @ left, rcond=1e-12)[0]
        return _rms(space.left[early:] - matrix[early:] @ values)

    def stated(self, effects: list[JointEffect], effect: JointEffect, fit: Fit) -> StatedFriction | None:
        """By how much friction falls over the speeds or seconds of the log, or over which angle it builds up; forms
        that fit as well are in its ±.
        """
        if effect.reach:
            return self._reach(effects, effect)
        if effect.key not in _FALLS:
            return None
        others = [item for item in effects if item is not effect]
        forms = [effect, *(item for item in self.rivals if item.key == effect.key and item is not effect)]
        speed, rows = self.motion.v[self.rows, self.joint], np.flatnonzero(self.rows)
        slow, fast = (float(x) for x in np.quantile(np.abs(speed), _SLOW_AND_FAST))
        count = max(len(rows) // 50, 1)
        if effect.key == "stribeck":  # the rows about each of the two speeds
            order = np.argsort(np.abs(speed))
            ends = [order[max(0, int(rank * len(order)) - count // 2) :][:count] for rank in _SLOW_AND_FAST]
        else:
            ends = [np.arange(count), np.arange(len(rows) - count, len(rows))]
        falls, lefts = [], []
        for form in forms:
            matrix = self.columns([*others, form])
            values, _, _ = solve(matrix, self.left, never_negative([*others, form]))
            friction = form.columns[rows, 0] * np.sign(speed) * values[-1]
            falls.append(float(np.mean(friction[ends[0]]) - np.mean(friction[ends[1]])))
            lefts.append(_rms(self.left - matrix @ values))
        as_well = [fall for fall, left in zip(falls, lefts, strict=True) if left < _FORM_AS_WELL * lefts[0]]
        place = sum(item.parameters for item in effects[: effects.index(effect)])
        relative = float(fit.std[place]) / max(abs(float(fit.values[place])), 1e-300)
        std = float(np.hypot(abs(falls[0]) * relative, max(abs(fall - falls[0]) for fall in as_well) / np.sqrt(3.0)))
        if effect.key == "stribeck":
            words = f"friction that falls from {slow:.2g} to {fast:.2g} rad/s (Stribeck), by"
        else:
            at = effects.index(next(item for item in effects if item.key == "coulomb"))
            friction = effect.columns[rows, 0] * np.sign(speed) * fit.values[place] + fit.values[at]
            start, end = float(np.mean(friction[:count])), float(np.mean(friction[-count:]))
            words = f"friction that changes over the log from {start:.2g} to {end:.2g} N·m, falling by"
        return StatedFriction(words, falls[0], std, "N·m")

    def _reach(self, effects: list[JointEffect], effect: JointEffect) -> StatedFriction:
        """The angle over which friction builds up, by the squares left over those of its grid, as independent rows."""
        forms = [item for item in self.rivals if item.key == effect.key]
        squares = []
        for form in forms:
            every = [form if item is effect else item for item in effects]
            matrix = self.columns(every)
            squares.append(_rms(self.left - matrix @ solve(matrix, self.left, never_negative(every))[0]) ** 2)
        rows = independent_rows(len(self.left), self.motion.step_s)
        log_likelihood = -0.5 * rows * np.log(np.array(squares) / min(squares))
        fine = np.linspace(np.log(forms[0].reach), np.log(forms[-1].reach), 200)
        weights = np.exp(np.interp(fine, np.log([form.reach for form in forms]), log_likelihood))
        weights /= np.sum(weights)
        reach = 1e3 * np.exp(fine)
        mean = float(weights @ reach)
        return StatedFriction("friction builds up over", mean, float(np.sqrt(weights @ (reach - mean) ** 2)), "mrad")

    def rival(self, key: str, shape: str) -> JointEffect | None:
        """One of the rivals."""
        return next((item for item in self.rivals if (item.key, item.shape) == (key, shape)), None)

    def credible(self, effects: list[JointEffect], rival: JointEffect) -> bool:
        """Whether a rival with other effects is within its limits where all of them are free."""
        values = self.fit([*effects, rival]).values[-rival.parameters :]
        size = float(np.linalg.norm(values))
        takes = _rms(self.columns([rival]) @ values)
        return rival.smallest <= size <= rival.largest and (rival.made_of_torque or takes <= float(np.std(self.torque)))

    def excess_in_stick(self, coulomb: float) -> float:
        """Share of the rows that may stick in which the torque is beyond Coulomb friction by more than a tenth."""
        still = np.abs(self.motion.v[:, self.joint]) < 0.3 * THRESHOLDS.sticking_rad_s
        if np.count_nonzero(still) < 10 or coulomb <= 0.0:
            return 0.0
        centre = float(np.median(self._every[still]))
        return float(np.mean(np.abs(self._every[still] - centre) > 1.1 * coulomb))


def first_of_last_part(motion: Motion) -> int:
    """The row from which on no joint's values of :attr:`HeldOut.early` have seen the log."""
    first = 0
    for rows in motion.moving.T[motion.moves]:
        moving = np.flatnonzero(rows)
        first = max(first, int(moving[min(int(_LAST_PART * len(moving)), len(moving) - 1)]))
    return first


def never_negative(effects: list[JointEffect]) -> Array:
    """Which of the columns of effects may have no negative coefficient."""
    return np.concatenate([[effect.never_negative] * effect.parameters for effect in effects]).astype(bool)


def explain(
    problem: JointProblem, in_model: dict[str, float], kept: JointMechanics | None = None,
    without: frozenset[str] = frozenset(),
) -> JointMechanics:  # fmt: skip
    """The usual effects with their values, and the causes that the joint needs.

    Args:
        problem: one joint.
        in_model: values of the usual effects in the model, by key.
        kept: mechanics under another reading, whose causes are taken without asking.
        without: keys that are no cause.
    """
    space = problem.space(in_model)
    if kept is None:
        chosen, names = _asked(problem, space, without)
        choice = JointChoice(
            tuple(key for key, _ in names), tuple(key for _, key in chosen.instead),
            {key: chosen.probability(("", key)) for key, _ in names},
            chosen.score - space.independent * float(np.log(np.var(problem.torque))),
        )  # fmt: skip
    else:
        choice = kept.choice
        names = [(share.effect.key, share.effect.shape) for share in kept.shares]
    effects = [*problem.usual, *(item for name in names if (item := problem.rival(*name)) is not None)]
    new = frozenset(key for key, value in in_model.items() if value == 0.0)
    lost = _lost(problem, effects, (*choice.causes, *new), space, in_model)
    effects = [effect for effect in effects if effect.key not in lost or effect in problem.usual]
    shares = _shares(problem, effects, problem.fit(effects), named=kept is None)
    coulomb = next(share.size for share in shares if share.effect.key == "coulomb")
    return JointMechanics(
        tuple(shares), problem.held_out(effects), problem.held_out(problem.usual),
        problem.excess_in_stick(coulomb), choice, new, lost,
    )  # fmt: skip


def _asked(problem: JointProblem, space: Space, without: frozenset[str]) -> tuple[Chosen, list[tuple[str, str]]]:
    """The choice, and keys and shapes of its causes; what is not credible where all is free is not asked again.

    The usual effects are in every fit. One that is not a cause keeps its torque, so that no other cause gets it.
    """
    library = [item for item in space.columns() if item.term not in without or item.term in USUAL]
    while True:
        chosen = Choice(space).grow(library, _CAUSES_AT_MOST, _ALIKE)
        names = [(cause.term, cause.variant) for cause in chosen.causes if cause.term not in without]
        effects, refused = list(problem.usual), set()
        for name in names:
            rival = problem.rival(*name)
            if rival is None:
                continue
            if problem.credible(effects, rival):
                effects.append(rival)
            else:
                refused.add(rival.key)
        if not refused:
            return chosen, names
        library = [item for item in library if item.term not in refused]


def _lost(
    problem: JointProblem, effects: list[JointEffect], causes: tuple[str, ...], space: Space, in_model: dict[str, float]
) -> frozenset[str]:
    """Causes and new effects that leave no less on the last part of the log, worst first.

    Each is judged without those lost before.
    """
    kept, lost = list(effects), set[str]()
    while True:
        claimed = [effect for effect in kept if effect.key in causes and effect.key not in lost]
        found = problem.held_out(kept).last, problem.last_within(claimed, space)
        worst = {
            effect: max(
                found[0] / problem.last_without(effect, kept, in_model.get(effect.key, 0.0)),
                0.0
                if effect.key == "offset" or in_model.get(effect.key) == 0.0
                else found[1] / problem.last_within([item for item in claimed if item is not effect], space),
            )
            for effect in claimed
        }
        cause = max(worst, key=lambda effect: worst[effect], default=None)
        if cause is None or worst[cause] < 1.0:
            return frozenset(lost)
        lost.add(cause.key)
        kept = [effect for effect in kept if effect is not cause or effect in problem.usual]


def _shares(problem: JointProblem, effects: list[JointEffect], fit: Fit, named: bool) -> list[JointShare]:
    shares, place = [], 0
    for effect in effects:
        part = slice(place, place + effect.parameters)
        place += effect.parameters
        columns = problem.columns([effect])
        torque = columns @ fit.values[part]
        alike = _alike(problem, effects, effect) if named else {}
        equal = tuple(words for words, cosine in alike.items() if cosine > THRESHOLDS.equal)
        unit = _rms(columns[:, 0])
        impossible = float(np.sum(fit.negative[part]))
        if abs(impossible) * unit < MARGIN * float(np.std(problem.torque)):
            impossible = 0.0
        shares.append(
            JointShare(effect, fit.values[part], fit.std[part], _rms(torque), unit, tuple(alike), equal, impossible,
                  problem.stated(effects, effect, fit) if named else None)
        )  # fmt: skip
    return shares


def _alike(problem: JointProblem, effects: list[JointEffect], effect: JointEffect) -> dict[str, float]:
    """Effects of the library whose columns, beyond the other effects, point the way of this one: words and cosine."""
    others = [item for item in effects if item is not effect]
    basis, column = _span(problem.columns(others)), problem.columns([effect])
    beyond = _beyond(basis, column)
    size = np.linalg.norm(column)
    if size == 0.0 or np.linalg.norm(beyond) < 1e-6 * size:
        return {"the other effects together": 1.0}
    direction = _span(beyond)
    found: dict[str, float] = {}
    for rival in problem.library:
        if rival.key == effect.key or any(rival is item for item in others):
            continue
        if rival.parameters > effect.parameters:
            continue
        cosine = _cosine(basis, direction, problem.columns([rival]))
        if cosine > max(THRESHOLDS.alike, found.get(rival.words, 0.0)):
            found[rival.words] = cosine
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _span(columns: Array) -> Array:
    """Orthonormal columns that span the same."""
    return np.asarray(np.linalg.qr(columns)[0])


def _beyond(span: Array, columns: Array) -> Array:
    """What of columns is not in the span of orthonormal others."""
    return np.asarray(columns - span @ (span.T @ columns))


def _cosine(span: Array, direction: Array, other: Array) -> float:
    """Of the angle between a direction and columns, beyond a span; zero where the span has most of the columns."""
    remainder = _beyond(span, other)
    length = float(np.linalg.norm(remainder))
    if length <= _MOSTLY_OTHERS * float(np.linalg.norm(other)):
        return 0.0
    return float(np.linalg.norm(direction.T @ remainder)) / length


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0
