"""Local forces that only the stepping through a record predicts: those that no balance over a period has.

Bristles, slack, waves over the position, and strengths that follow a channel.

Each row is a force of unit strength with a memory of its own, times a strength at every step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_core.numerics.kernels import njit
from nmt_rig.model.element_kernels import response
from nmt_rig.model.local_elements.attachments import LuGre, SlackSlider
from nmt_rig.model.local_elements.element import (
    CONTACT_GAP,
    CONTACT_SIDE,
    CONTACT_STIFFNESS,
    SLIDER_SLIP,
    SLIDER_STIFFNESS,
    ElementSection,
    LocalElement,
)
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.structure import Structure

# Kinds of further elements; those of smooth elements are positive.
BRISTLES, SLIDER, STOP, SLACKED = -1, -2, -3, -4
_PARAMETERS = 6
# Columns of a slider with slack.
SLACKED_STIFFNESS, SLACKED_REACH, SLACKED_GAP = 0, 1, 2

_moved = njit(Jenkins.moved)


class TimedTables(NamedTuple):
    """Rows for the compiled kernels.

    Attributes:
        kinds: (n,); rows start[i] … start[i + 1] act on coordinate i.
        parameters: (n, 6).
        start: (r + 1,).
        strengths: (n, steps), or (n, 1) where they are constant.
    """

    kinds: IntArray
    parameters: FloatArray
    start: IntArray
    strengths: FloatArray


@dataclass(frozen=True)
class TimedRow:
    """One force.

    Attributes:
        kind, parameters: of its formula.
        base: strength of its own.
        share: what a unit of the channel adds to it.
        channel: that it follows; empty = none.
        value: of the channel at which it adds nothing.
        floor: smallest strength; its sum with the parallel element is not below zero.
        stiffness, damping: at rest, N/m and N s/m, with all sliders sticking.
        friction: whether that stiffness goes where it slides.
    """

    kind: int
    parameters: tuple[float, ...]
    base: float = 0.0
    share: float = 0.0
    channel: str = ""
    value: float = 0.0
    floor: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    friction: bool = False


@dataclass(frozen=True)
class TimedElements:
    """Rows of each coordinate."""

    groups: tuple[tuple[TimedRow, ...], ...]

    @property
    def only_in_time(self) -> bool:
        """Whether some have no periodic motion that could be balanced."""
        return any(row.base != 0.0 for group in self.groups for row in group)

    def resting(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Stiffness and damping at rest, and how much of the stiffness is friction's, (r,) each."""
        result = np.zeros((3, len(self.groups)))
        for i, group in enumerate(self.groups):
            for row in group:
                result[:, i] += row.base * np.array([row.stiffness, row.damping, row.friction * row.stiffness])
        return result[0], result[1], result[2]

    def tables(self, followed: Mapping[str, FloatArray] | None = None, substeps: int = 1) -> TimedTables:
        """Rows with their strengths along a record; a channel that it has not is where the rig file says.

        Args:
            followed: measured channels at the samples, by name.
            substeps: steps from one sample to the next; the first step is one.
        """
        rows = [row for group in self.groups for row in group]
        signals = {name: _between(values, substeps) for name, values in (followed or {}).items()}
        columns = max((signals[row.channel].size for row in rows if row.channel in signals), default=1)
        strengths = np.array([row.base for row in rows]).reshape(-1, 1) * np.ones(columns)
        for number, row in enumerate(rows):
            if row.channel in signals:
                strengths[number] += row.share * (signals[row.channel] - row.value)
                strengths[number] = np.maximum(strengths[number], row.floor)
        parameters = np.zeros((len(rows), _PARAMETERS))
        for number, row in enumerate(rows):
            parameters[number, : len(row.parameters)] = row.parameters
        start = np.concatenate(([0], np.cumsum([len(group) for group in self.groups])))
        kinds = np.array([row.kind for row in rows], np.int64)
        return TimedTables(kinds, parameters, start.astype(np.int64), strengths)


def _between(values: FloatArray, substeps: int) -> FloatArray:
    """Samples with steps between them, straight from one to the next."""
    steps = np.arange(substeps * values.size) / substeps
    return np.interp(steps, np.arange(values.size), values)


def timed_rows(section: ElementSection, structure: Structure) -> list[TimedRow]:
    """What of a local element only the stepping in time predicts."""
    kept = section.times(1.0)
    following: dict[str, Any] = {}
    if section.modulated_by:
        following = {
            "share": section.modulated_share, "channel": section.modulated_by, "value": section.modulation_value
        }  # fmt: skip
    if section.element is LuGre:
        parameters = tuple(kept.own_values())
        made = LuGre(np.ones(1), *parameters)
        stiffness, damping = made.resting_stiffness, made.resting_damping
        return [
            TimedRow(BRISTLES, parameters, section.modulation, **following, stiffness=stiffness, damping=damping,
                     friction=True)
        ]  # fmt: skip
    if section.element is SlackSlider:
        slack = SlackSlider(np.ones(1), *kept.own_values())
        parameters = (slack.stiffness, slack.reach, slack.slack)
        return [
            TimedRow(SLACKED, parameters, section.modulation, **following, stiffness=slack.resting_stiffness,
                     friction=True)
        ]  # fmt: skip
    if section.without_harmonic_balance and hasattr(section.element, "response"):
        (element,) = kept.elements(structure)
        following |= {"stiffness": element.linear_stiffness, "damping": element.linear_damping}
        return [TimedRow(element.kind, tuple(element.values), section.modulation, **following)]
    if not section.modulated_by:
        return []
    following["floor"] = -section.modulation
    return [row for element in kept.elements(structure) for row in _rows_of(element, following)]


def _rows_of(element: LocalElement, following: Mapping[str, Any]) -> list[TimedRow]:
    sliders = [TimedRow(SLIDER, slider, **following) for slider in element.sliders]
    stops = [TimedRow(STOP, stop, **following) for stop in element.contacts]
    smooth = [] if sliders or stops else [TimedRow(element.kind, tuple(element.values), **following)]
    return sliders + stops + smooth


@njit(cache=True, forceinline=True)
def bristle_step(
    p: FloatArray, e: int, w: float, v: float, before: FloatArray
) -> tuple[float, float, float, float, float]:
    """Force of bristles at the end of a step, its tangents, and their deflection and reach there.

    dz/dw = 1 − z sgn(ẇ) / reach (Canudas de Wit et al., IEEE Trans. Automat. Contr. 40 (1995) 419) has a closed form
    where the reach, s(v) / σ₀, goes straight along a step and divides by its mean; sliding bristles end at its end.

    Args:
        p, e: σ₀, σ₁, σ₂, F_C, F_S and v_S in row e.
        w, v: displacement and velocity at the end of the step.
        before: displacement, deflection and reach of row e before it, (n, 3).
    """
    stiffness, inner, viscous, coulomb, static, fall = p[e, 0], p[e, 1], p[e, 2], p[e, 3], p[e, 4], p[e, 5]
    ratio = v / fall
    bump = (static - coulomb) * np.exp(-ratio * ratio)
    reach = (coulomb + bump) / stiffness
    former = before[e, 2] if before[e, 2] > 0.0 else reach
    mean = 0.5 * (former + reach)
    way = w - before[e, 0]
    side = 1.0 if way > 0.0 else -1.0
    ways = abs(way) / mean
    left = np.exp(-ways)
    change, distance = side * (reach - former), before[e, 1] - side * former
    # Mean of the decaying initial part along the step, and its derivative.
    lag, by_ratio = 1.0 - 0.5 * ways, -0.5
    if ways > 1e-6:
        lag = (1.0 - left) / ways
        by_ratio = (left - lag) / ways
    z = side * reach + distance * left - change * lag
    by_ways = -distance * left - change * by_ratio
    by_w = by_ways * side / mean
    by_reach = side * (1.0 - lag) - 0.5 * by_ways * ways / mean
    by_v = -by_reach * ratio * bump / (fall * stiffness)
    sliding = 1.0 - (1.0 if v > 0.0 else -1.0) * z / reach
    force = stiffness * z + inner * v * sliding + viscous * v
    return force, stiffness * by_w, stiffness * by_v + inner * sliding + viscous, z, reach


@njit(cache=True, forceinline=True)
def timed_force(
    timed: TimedTables, e: int, step: int, w: float, v: float, before: FloatArray, after: FloatArray
) -> tuple[float, float, float]:
    """Force of a row and its tangents at the end of a step; its memory goes from ``before`` to ``after``, (n, 3)."""
    kinds, parameters, strengths = timed.kinds, timed.parameters, timed.strengths
    strength = strengths[e, min(step, strengths.shape[1] - 1)]
    force = stiffness = damping = 0.0
    after[e, 0] = w
    if kinds[e] == BRISTLES:
        force, stiffness, damping, after[e, 1], after[e, 2] = bristle_step(parameters, e, w, v, before)
    elif kinds[e] == SLIDER:
        force, stiffness, after[e, 0] = _moved(
            parameters[e, SLIDER_STIFFNESS], parameters[e, SLIDER_SLIP], w, before[e, 0]
        )
    elif kinds[e] == SLACKED:
        k, reach = parameters[e, SLACKED_STIFFNESS], parameters[e, SLACKED_REACH]
        z, _, after[e, 0] = _moved(1.0, reach, w, before[e, 0])
        side = 1.0 if z > 0.0 else -1.0
        overlap = side * z - parameters[e, SLACKED_GAP]
        if overlap > 0.0:
            force = side * k * overlap
            stiffness = k if abs(z) < reach else 0.0
    elif kinds[e] == STOP:
        side = parameters[e, CONTACT_SIDE]
        overlap = side * w - parameters[e, CONTACT_GAP]
        if overlap > 0.0:
            stiffness = parameters[e, CONTACT_STIFFNESS]
            force = side * stiffness * overlap
    else:
        force, stiffness, damping = response(kinds[e], parameters, e, w, v)
    return strength * force, strength * stiffness, strength * damping


def no_timed_elements(coordinates: int) -> TimedTables:
    """Tables without a row."""
    return TimedElements(((),) * coordinates).tables()
