"""Which effects are needed in a joint, where all that the user cannot know exactly may move within its tolerance.

Every set of causes carries the same nuisances: friction, damping and armature about the model's values, mass, inertia
and torque about one, each with the cost of its pull. One cause that is far off wins so against five that are each two
standard deviations off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_robots.log.joint_log import Array
from nmt_robots.mechanics.columns import Effect
from nmt_robots.mechanics.least_squares import solve_scaled
from nmt_robots.thresholds import THRESHOLDS

_PER_SECOND = 4.0
"""Independent rows in a second: neighbours leave the same errors of the model over."""
_AT_MOST = 3
_COST_OF_A_CAUSE = 12.0
_FREE = 1e3
"""Standard deviations that a cause may move at the cost of one."""


@dataclass(frozen=True, eq=False)
class Nuisance:
    """A column and its prior: mean, standard deviation, and the effect that frees it; none where no cause does."""

    column: Array
    mean: float
    std: float
    key: str = ""


class Chooser:
    """Penalised least squares over sets of causes.

    Args:
        left: rows, N·m; torque of the drive without that of the rigid bodies.
        torque: rows, N·m, of the drive.
        nuisances: with their priors.
        seconds: of the rows.
    """

    def __init__(self, left: Array, torque: Array, nuisances: list[Nuisance], seconds: float) -> None:
        self._torque = torque
        self._means = np.array([item.mean for item in nuisances])
        self._stds = np.array([max(item.std, 1e-9) for item in nuisances])
        self._keys = [item.key for item in nuisances]
        self._columns = np.column_stack([item.column for item in nuisances])
        self._left = left - self._columns @ self._means
        self._effective = max(_PER_SECOND * seconds, 8.0)
        self._gram = self._columns.T @ self._columns
        self._moment = self._columns.T @ self._left
        self._total = float(self._left @ self._left)
        self._costs: dict[tuple[frozenset[int], float], float] = {}
        self._rivals: dict[int, tuple[Array, Array, Array, Array]] = {}

    def choose(self, usual: list[Effect], rivals: list[tuple[Effect, Array]], floor: float) -> list[Effect]:
        """The causes that are needed, the one that takes most of the gap first.

        Args:
            usual: effects that have a nuisance of their key.
            rivals: effects with their filtered columns in the rows.
            floor: rms that no set of causes is expected to undercut, N·m.
        """
        columns = {id(effect): values for effect, values in rivals}
        candidates = [effect for effect in usual if effect.key in self._keys] + [effect for effect, _ in rivals]
        variance = self._variance(floor)
        chosen: list[Effect] = []
        cost = self._cost(chosen, columns, variance)
        for _ in range(_AT_MOST):
            keys = {effect.key for effect in chosen}
            found = [
                (self._cost([*chosen, effect], columns, variance) + _COST_OF_A_CAUSE, number)
                for number, effect in enumerate(candidates)
                if effect.key not in keys
            ]
            if not found:
                break
            lowest, number = min(found)
            if lowest >= cost:
                break
            chosen.append(candidates[number])
            cost = lowest
            chosen, cost = self._exchanged(chosen, candidates, columns, variance, cost)
        return chosen

    def floor_of(self, causes: list[Effect], rivals: list[tuple[Effect, Array]], floor: float) -> float:
        """Rms that is left by causes where all else moves at its cost, N·m; arguments as of choose."""
        columns = {id(effect): values for effect, values in rivals}
        variance = self._variance(floor)
        squares, _, _ = self._parts_of_cost(causes, columns, variance)
        return float(np.sqrt(squares * variance / len(self._left)))

    def _variance(self, floor: float) -> float:
        """Of a row, so that neighbours that leave the same over count as one, (N·m)²."""
        least = max(floor**2, 1e-6 * self._total / len(self._left), 1e-300)
        return least * len(self._left) / self._effective

    def instead_of_first(
        self, chosen: list[Effect], usual: list[Effect], rivals: list[tuple[Effect, Array]], floor: float
    ) -> tuple[str, ...]:
        """Keys of effects that cost about as little in the place of the first of the chosen; others as of choose."""
        if not chosen:
            return ()
        columns = {id(effect): values for effect, values in rivals}
        candidates = [effect for effect in usual if effect.key in self._keys] + [effect for effect, _ in rivals]
        variance = self._variance(floor)
        cost = self._cost(chosen, columns, variance)
        keys = {effect.key for effect in chosen}
        found = [
            effect.key
            for effect in candidates
            if effect.key not in keys
            and self._cost([effect, *chosen[1:]], columns, variance) < cost + 3.0 * _COST_OF_A_CAUSE
        ]
        return tuple(dict.fromkeys(found))

    def _exchanged(
        self, chosen: list[Effect], candidates: list[Effect], columns: dict[int, Array], variance: float, cost: float
    ) -> tuple[list[Effect], float]:
        """The set with one left out or put in the place of another where that costs less."""
        for place in range(len(chosen)):
            others = chosen[:place] + chosen[place + 1 :]
            price = _COST_OF_A_CAUSE * len(others)
            without = self._cost(others, columns, variance) + price
            if without < cost:
                return others, without
            keys = {effect.key for effect in others}
            for effect in candidates:
                if effect.key in keys:
                    continue
                other = [*chosen[:place], effect, *chosen[place + 1 :]]
                value = self._cost(other, columns, variance) + price + _COST_OF_A_CAUSE
                if value < cost - 1e-9:
                    chosen, cost = other, value
        return chosen, cost

    def _cost(self, causes: list[Effect], columns: dict[int, Array], variance: float) -> float:
        """Weighted squares of what is left and of the pulls; a set that was asked before is not computed again."""
        asked = frozenset(map(id, causes)), variance
        if asked not in self._costs:
            self._costs[asked] = self._cost_of_set(causes, columns, variance)
        return self._costs[asked]

    def _cost_of_set(self, causes: list[Effect], columns: dict[int, Array], variance: float) -> float:
        squares, kept, pulls = self._parts_of_cost(causes, columns, variance)
        return squares / kept + pulls if kept > 0.0 else np.inf

    def _parts_of_cost(
        self, causes: list[Effect], columns: dict[int, Array], variance: float
    ) -> tuple[float, float, float]:
        """Weighted squares of what is left, share of the torque that is kept, and squares of the pulls.

        Nothing is kept where a coefficient is negative that may not be.
        """
        free = {effect.key for effect in causes} | {effect.frees for effect in causes}
        stds = np.where([key in free and key != "" for key in self._keys], _FREE, 1.0) * self._stds
        parts = [self._rival(effect, columns[id(effect)]) for effect in causes if id(effect) in columns]
        size = len(stds) + sum(len(part[2]) for part in parts)
        gram, moment = np.zeros((size, size)), np.zeros(size)
        count = len(stds)
        gram[:count, :count] = self._gram / variance + np.diag(stds**-2.0)
        moment[:count] = self._moment / variance
        place = count
        for number, (cross, inner, with_left, values) in enumerate(parts):
            width = len(with_left)
            span = slice(place, place + width)
            gram[:count, span], gram[span, :count] = cross / variance, cross.T / variance
            gram[span, span] = inner / variance + 1e-9 * np.diag(np.diag(inner)) / variance
            moment[span] = with_left / variance
            before = count
            for other in parts[:number]:
                wide = slice(before, before + len(other[2]))
                gram[wide, span] = other[3].T @ values / variance
                gram[span, wide] = gram[wide, span].T
                before += len(other[2])
            place += width
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-200))
        solution = solve_scaled(gram / np.outer(scale, scale), moment / scale, 1e-12) / scale
        pulls = float(np.sum((solution[:count] / stds) ** 2))
        squares = float(self._total / variance - solution @ moment) - pulls
        return max(squares, 0.0), self._kept_torque(causes, parts, solution[count:]), pulls

    def _kept_torque(
        self, causes: list[Effect], parts: list[tuple[Array, Array, Array, Array]], values: Array
    ) -> float:
        """Square of the torque with the gain of a set of causes against that without: scale to zero explains all.

        Zero where a coefficient is negative that may not be.
        """
        torque, place = self._torque, 0
        rivals = [effect for effect in causes if effect.key not in self._keys]
        for effect, part in zip(rivals, parts, strict=True):
            width = part[3].shape[1]
            if effect.never_negative and np.any(values[place : place + width] < 0.0):
                return 0.0
            if effect.made_of_torque:
                torque = torque - part[3] @ values[place : place + width]
            place += width
        if torque is self._torque:
            return 1.0
        return max(float(np.var(torque)) / max(float(np.var(self._torque)), 1e-300), 1e-3)

    def _rival(self, effect: Effect, values: Array) -> tuple[Array, Array, Array, Array]:
        if id(effect) not in self._rivals:
            products = self._columns.T @ values, values.T @ values, values.T @ self._left, values
            self._rivals[id(effect)] = products
        return self._rivals[id(effect)]


def nuisances_of(
    usual: list[tuple[Effect, Array]], in_model: dict[str, float], bodies: tuple[Array, Array, Array], torque: Array
) -> list[Nuisance]:
    """What may move without being a cause.

    Args:
        usual: effects with their filtered columns in the rows.
        in_model: values of the model by key.
        bodies: rows each: angle (rad), gravity and inertial torque (N·m), filtered.
        torque: rows, N·m, of the drive, filtered.
    """
    angle, gravity, inertial = bodies
    relative = {
        "coulomb": THRESHOLDS.coulomb_tolerance,
        "viscous": THRESHOLDS.damping_tolerance,
        "armature": THRESHOLDS.armature_tolerance,
    }
    size = max(float(np.std(torque)), 1e-12)
    heaviest = float(np.max(np.abs(gravity)))
    found = []
    for effect, values in usual:
        mean = in_model.get(effect.key, 0.0)
        # A model without a value for it has a tolerance of 1 % of the torque.
        small = 0.01 * size / max(float(np.std(values)), 1e-12) if effect.key != "offset" else 0.02 * size
        std = max(relative.get(effect.key, 0.0) * abs(mean), small if not mean else 0.0)
        found.append(Nuisance(values[:, 0], mean, std, effect.key))
    found += [
        Nuisance(gravity, 0.0, 1.5 * THRESHOLDS.mass_tolerance),
        Nuisance(inertial, 0.0, THRESHOLDS.inertia_tolerance),
        Nuisance(torque, 0.0, THRESHOLDS.torque_tolerance),
        Nuisance(np.cos(angle), 0.0, THRESHOLDS.mass_tolerance * heaviest),
        Nuisance(np.sin(angle), 0.0, THRESHOLDS.mass_tolerance * heaviest),
    ]
    return found
