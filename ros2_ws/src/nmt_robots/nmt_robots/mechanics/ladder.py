"""Mechanics of one joint: the usual effects, and rivals that earn their place on motion that no fit has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nmt_robots.log.joint_log import Array
from nmt_robots.mechanics.columns import Effect, rival_effects, usual_effects
from nmt_robots.mechanics.least_squares import Fit, fitted, solve
from nmt_robots.mechanics.motion import Motion
from nmt_robots.mechanics.readings import DriveSignals
from nmt_robots.mechanics.selection import Chooser, nuisances_of
from nmt_robots.thresholds import THRESHOLDS

USUAL = ("coulomb", "viscous", "armature", "offset")
_LAST_PART = 0.7
_FURTHER_AT_MOST = 2
_MOSTLY_OTHERS = 0.1
"""Of a column, beyond other effects, below which it is theirs and says nothing of a further one."""


@dataclass(frozen=True, eq=False)
class Share:
    """An effect as found in a joint.

    Attributes:
        effect: which.
        values, std: of its coefficients.
        rms: torque that it takes, N·m.
        alike: words of effects whose columns say the same in this log.
        equal: those of them whose columns are the same, so that no fit parts them.
        impossible: what a coefficient would be that may not be negative; zero where it is allowed.
    """

    effect: Effect
    values: Array
    std: Array
    rms: float
    alike: tuple[str, ...] = ()
    equal: tuple[str, ...] = ()
    impossible: float = 0.0

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
class HeldOut:
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


@dataclass(frozen=True, eq=False)
class JointMechanics:
    """What acts in a joint.

    Attributes:
        shares: effects, the usual ones first.
        held_out, plain: torque left by these, and by the usual effects alone.
        rivals: words and gain of rivals that were not taken but also improve, best first.
        sticking_excess: share of sticking rows whose torque is beyond Coulomb friction.
        causes: keys of the effects that are needed where all that is within its tolerance may move.
        instead: keys of effects that would do about as well in the place of the first of them.
        predicted: torque left with up to two of ``rivals`` on top, which predict but are not claimed.
    """

    shares: tuple[Share, ...]
    held_out: HeldOut
    plain: HeldOut
    rivals: tuple[tuple[str, float], ...]
    sticking_excess: float
    causes: tuple[str, ...] = ()
    instead: tuple[str, ...] = ()
    predicted: HeldOut | None = None

    def share(self, key: str) -> Share | None:
        """An effect by its key."""
        return next((share for share in self.shares if share.effect.key == key), None)


class JointProblem:
    """Torque and columns of one joint.

    Args:
        motion: of all joints.
        joint: number of the column.
        drive: of this joint as it is read, unfiltered.
        names: of all joints.
    """

    def __init__(self, motion: Motion, joint: int, drive: DriveSignals, names: tuple[str, ...] = ()) -> None:
        self.motion, self.joint = motion, joint
        smooth = motion.smooth_twice(drive.torque)
        self._rows = motion.moving[:, joint]
        self.torque = smooth[self._rows]
        self._every = smooth - motion.rigid[:, joint]
        self.left = self._every[self._rows]
        self.blocks = motion.blocks[self._rows]
        self.usual = usual_effects(motion, joint)
        self._filtered: dict[int, Array] = {}
        every = rival_effects(motion, joint, drive.through(motion.smooth), names)
        # A velocity gain beside a commanded speed of zero is viscous friction: it is named with it and is no rival.
        twins = [rival for rival in every if rival.shape == "kd" and self._is_viscous(rival)]
        self.rivals = [rival for rival in every if rival not in twins]
        self.library = [*self.usual, *self.rivals, *twins]

    def _is_viscous(self, rival: Effect) -> bool:
        """Whether its column is that of viscous friction, beyond the other usual effects."""
        viscous = next(effect for effect in self.usual if effect.key == "viscous")
        others = _span(self.columns([effect for effect in self.usual if effect is not viscous]))
        direction = _span(_beyond(others, self.columns([viscous])))
        return _cosine(others, direction, self.columns([rival])) > THRESHOLDS.equal

    def columns(self, effects: list[Effect]) -> Array:
        """Filtered columns of effects in the rows that move."""
        parts = []
        for effect in effects:
            if id(effect) not in self._filtered:
                self._filtered[id(effect)] = self.motion.smooth(effect.columns)[self._rows]
            parts.append(self._filtered[id(effect)])
        return np.column_stack(parts)

    def held_out(self, effects: list[Effect]) -> HeldOut:
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
        return HeldOut(_rms(lost), _rms(last), float(np.std(torque)), values)

    def fit(self, effects: list[Effect]) -> Fit:
        """Coefficients of effects by all rows; ± with what the model's own tolerances make of them."""
        matrix = self.columns(effects)
        fit = fitted(matrix, self.left, never_negative(effects), self.blocks)
        free = ~fit.held
        gravity = self.motion.gravity[self._rows, self.joint]
        inertial = self.motion.rigid[self._rows, self.joint] - gravity
        tolerated = np.column_stack(
            [
                THRESHOLDS.inertia_tolerance * inertial,
                THRESHOLDS.mass_tolerance * gravity,
                THRESHOLDS.torque_tolerance * self.torque,
            ]
        )
        scale = np.maximum(np.linalg.norm(matrix[:, free], axis=0), 1e-300)
        moved = np.linalg.lstsq(matrix[:, free] / scale, tolerated, rcond=1e-10)[0] / scale[:, None]
        std = fit.std.copy()
        std[free] = np.sqrt(std[free] ** 2 + np.sum(moved**2, axis=1))
        return replace(fit, std=std)

    def needed(self, in_model: dict[str, float]) -> tuple[list[Effect], tuple[str, ...]]:
        """Effects that are needed where all that is within its tolerance may move, the largest first.

        Returns:
            They, and keys of those that would do about as well in the place of the first.
        """
        angle = self.motion.smooth(self.motion.q[:, self.joint])[self._rows]
        gravity = self.motion.gravity[self._rows, self.joint]
        inertial = self.motion.rigid[self._rows, self.joint] - gravity
        usual = [(effect, self.columns([effect])) for effect in self.usual]
        nuisances = nuisances_of(usual, in_model, (angle, gravity, inertial), self.torque)
        chooser = Chooser(self.left, self.torque, nuisances, float(np.count_nonzero(self._rows)) * self.motion.step_s)
        rivals = [(effect, self.columns([effect])) for effect in self.rivals]
        least = THRESHOLDS.smallest_floor * float(np.std(self.torque))
        # The usual effects are free here; once more with what the causes leave over, which is less where one is needed.
        matrix = np.column_stack([columns for _, columns in usual])
        floor = max(_rms(self.left - matrix @ np.linalg.lstsq(matrix, self.left, rcond=1e-10)[0]), least)
        chosen = chooser.choose(self.usual, rivals, floor)
        floor = max(chooser.floor_of(chosen, rivals, floor), least)
        chosen = chooser.choose(self.usual, rivals, floor)
        return chosen, chooser.instead_of_first(chosen, self.usual, rivals, floor)

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


def never_negative(effects: list[Effect]) -> Array:
    """Which of the columns of effects may have no negative coefficient."""
    return np.concatenate([[effect.never_negative] * effect.parameters for effect in effects]).astype(bool)


def explain(
    problem: JointProblem, in_model: dict[str, float], kept: Sequence[tuple[str, str]] | None = None
) -> JointMechanics:
    """The usual effects, and up to three rivals that earn their place.

    Args:
        problem: one joint.
        in_model: values of the usual effects in the model, by key.
        kept: keys and shapes of effects that are taken without asking, instead of a choice.
    """
    effects = list(problem.usual)
    plain = now = problem.held_out(effects)
    gains: list[tuple[Effect, float]] = []
    predicted: HeldOut | None = None
    causes: list[str] = []
    instead: tuple[str, ...] = ()
    if kept is not None:
        effects += [rival for rival in problem.rivals if (rival.key, rival.shape) in kept]
        now = problem.held_out(effects)
    else:
        needed, instead = problem.needed(in_model)
        for effect in needed:
            if effect.key in USUAL:
                causes.append(effect.key)
                continue
            taken = _gains(problem, effects, now, [effect], needed=True)
            if taken and _earns_its_place(problem, effects, effect):
                effects.append(effect)
                causes.append(effect.key)
                now = taken[0][2]
        gains, predicted = _further(problem, effects, now)
    shares = _shares(problem, effects, problem.fit(effects), named=kept is None)
    coulomb = next(share.size for share in shares if share.effect.key == "coulomb")
    runners_up: dict[str, float] = {}
    for effect, gain in gains:
        if effect.key not in {share.effect.key for share in shares}:
            runners_up.setdefault(effect.words, gain)
    return JointMechanics(
        tuple(shares), now, plain, tuple(runners_up.items())[:3], problem.excess_in_stick(coulomb),
        tuple(causes), instead, predicted or now,
    )  # fmt: skip


def _further(problem: JointProblem, effects: list[Effect], now: HeldOut) -> tuple[list[tuple[Effect, float]], HeldOut]:
    """Effects that predict held-out motion better on top, best first with their gain, and what they leave."""
    taken: list[Effect] = []
    listed: list[tuple[Effect, float]] = []
    for _ in range(_FURTHER_AT_MOST + 1):
        chosen = {effect.key for effect in [*effects, *taken]}
        others = [rival for rival in problem.rivals if rival.key not in chosen]
        gains = _gains(problem, [*effects, *taken], now, others)
        best = next((item for item in gains if _earns_its_place(problem, [*effects, *taken], item[0])), None)
        if best is None or len(taken) == _FURTHER_AT_MOST:
            listed += [(effect, gain) for effect, gain, _ in gains]
            break
        taken.append(best[0])
        listed.append(best[:2])
        now = best[2]
    return listed, now


def _gains(
    problem: JointProblem, effects: list[Effect], now: HeldOut, rivals: list[Effect], needed: bool = False
) -> list[tuple[Effect, float, HeldOut]]:
    """Rivals that improve both held-out parts by a claimable share of the torque, best first.

    Beside usual effects that are free, one that is needed beside those of the model may take less: it has to shrink
    what both parts leave over. The gain is the torque that a rival takes, as a share of the joint's.
    """
    matrix = problem.columns(effects)
    basis = _span(matrix)
    unexplained = _beyond(basis, problem.left)
    found = []
    for rival in rivals:
        # What a rival takes of the rows it is fitted to bounds what it can take of others.
        column = problem.columns([rival])
        beyond = _span(_beyond(basis, column))
        bound = _rms(beyond @ (beyond.T @ unexplained)) / max(now.torque, 1e-300)
        if bound < THRESHOLDS.smallest_share and not needed:
            continue
        after = problem.held_out([*effects, rival])
        # What makes the torque itself smaller must shrink what is left by more than that.
        fair = after.torque / max(now.torque, 1e-300)
        gained = now.interleaved**2 - (after.interleaved / fair) ** 2
        if gained > 0.0 and after.last / fair < now.last:
            share = float(np.sqrt(gained)) / max(now.torque, 1e-300)
            shrunk = max(after.interleaved / fair / now.interleaved, after.last / fair / now.last)
            # What a delay of the loop does as well has to take more.
            lesser = needed and rival.key != "jerk" and shrunk < 1.0 - THRESHOLDS.needed_gain
            if share > THRESHOLDS.smallest_share or lesser:
                found.append((rival, share, after))
    return sorted(found, key=lambda item: -item[1])


def _earns_its_place(problem: JointProblem, effects: list[Effect], rival: Effect) -> bool:
    """Whether its coefficients are certain, and neither they nor those of the others become impossible."""
    fit = problem.fit([*effects, rival])
    place = 0
    for effect in [*effects, rival]:
        part = slice(place, place + effect.parameters)
        place += effect.parameters
        if not effect.smallest <= float(np.linalg.norm(fit.values[part])) <= effect.largest:
            return False
        added = _rms(problem.columns([effect]) @ fit.values[part])
        if effect.key not in USUAL and not effect.made_of_torque and added > float(np.std(problem.torque)):
            return False
    values, std = fit.values[-rival.parameters :], fit.std[-rival.parameters :]
    size = float(np.linalg.norm(values))
    spread = float(np.sqrt(np.sum((values * std) ** 2))) / max(size, 1e-300)
    before = problem.fit(effects)
    return size > THRESHOLDS.certain * spread and int(np.sum(fit.held)) <= int(np.sum(before.held))


def _shares(problem: JointProblem, effects: list[Effect], fit: Fit, named: bool) -> list[Share]:
    shares, place = [], 0
    for effect in effects:
        part = slice(place, place + effect.parameters)
        place += effect.parameters
        columns = problem.columns([effect])
        torque = columns @ fit.values[part]
        alike = _alike(problem, effects, effect) if named else {}
        equal = tuple(words for words, cosine in alike.items() if cosine > THRESHOLDS.equal)
        impossible = float(np.sum(fit.negative[part]))
        shares.append(
            Share(effect, fit.values[part], fit.std[part], _rms(torque), tuple(alike), equal, impossible)
        )  # fmt: skip
    return shares


def _alike(problem: JointProblem, effects: list[Effect], effect: Effect) -> dict[str, float]:
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
    return found


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
