"""Lines of stepped sines at several forces as levels."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.law.held_levels import HeldLevels
from nmt_diagnose.observations.observables import Observations

if TYPE_CHECKING:
    from nmt_diagnose.measurements.measurement import Measurement
    from nmt_diagnose.measurements.stepped_responses.stepped_responses import SteppedResponses

_LINES = 6
"""Lines of a response at one force: half of the motion of its peak and more, evenly over its logarithm."""
_BAND = 0.15
"""Of a mode, relative: a peak that moves further is not that of one level."""


def levels_of_lines(first: SteppedResponses, observations: Observations, number: int) -> HeldLevels | None:
    """Lines of all responses to a held force or base over the same channels as levels; None but for the first test."""
    same = [other for other, test in enumerate(observations.tests) if _alike(first, test)]
    same = [other for other in same if np.any(observations.rows.test == other)]
    if not same or same[0] != number or first.held != first.reference or first.reference not in ("force", "base"):
        return None
    tests = [_in_order(first, observations.tests[other]) for other in same]
    if any(channel.quantity not in MOTIONS for channel in first.channels):
        return None
    forces = {round(float(np.log(np.max(test.levels))), 2) for test in tests}
    powers = np.array([MOTIONS[channel.quantity] for channel in first.channels])
    size = [np.abs(test.measured[:, 0]) * test.levels / (2.0 * np.pi * test.lines_hz) ** powers[0] for test in tests]
    if len(forces) < 2:  # what does not change with the amplitude is no law
        return None
    loudest = max(range(len(tests)), key=lambda k: float(size[k].max()))
    peak = tests[loudest].lines_hz[int(np.argmax(size[loudest]))]
    parts: list[tuple[FloatArray, ...]] = []
    for test, moved in zip(tests, size, strict=True):
        near = np.flatnonzero(np.abs(np.log(test.lines_hz / peak)) < _BAND)
        near = near[moved[near] >= 0.5 * moved[near].max()] if near.size else near
        order = near[np.argsort(moved[near], kind="stable")]
        chosen = order[np.unique(np.linspace(0, order.size - 1, min(order.size, _LINES)).round().astype(int))]
        if order.size:
            force = test.levels[chosen]
            amplitude = test.measured[chosen] * force[:, np.newaxis]
            parts.append((test.lines_hz[chosen], force, amplitude, test.noise[chosen], moved[chosen]))
    lines, force, amplitude, noise, moved = (np.concatenate(part) for part in zip(*parts, strict=True))
    omega = 2.0 * np.pi * lines
    motion = np.zeros((*amplitude.shape, 2), complex)
    motion[:, :, 1] = first.scale * amplitude / (1j * omega[:, np.newaxis]) ** powers
    driven = np.zeros((1, lines.size, 2), complex)
    driven[0, :, 1] = force
    chain = observations.chains[number] if observations.chains else None
    more = f" and {len(tests) - 1} more" if len(tests) > 1 else ""
    found = HeldLevels(
        f"{first.name}{more}", first.drive_points, tuple(range(lines.size)), omega, driven, np.zeros((1, lines.size)),
        tuple(first.channels), motion, np.abs(motion) * noise[:, np.newaxis, np.newaxis], chain,
        over_base=first.reference == "base", alone=True,
    )  # fmt: skip
    return found.take([int(k) for k in np.argsort(moved, kind="stable")])


def _alike(first: SteppedResponses, test: Measurement) -> bool:
    """Whether a test is another response at the same drive and channels as the first, with phases."""
    if test.sweep_key is None or test.sweep_key != first.sweep_key:
        return False
    other = cast("SteppedResponses", test)
    return other.phase_known and not first.imposed and not other.imposed


def _in_order(first: SteppedResponses, test: Measurement) -> SteppedResponses:
    """The test with the channels of the first, in their order."""
    other = cast("SteppedResponses", test)
    order = [other.channels.index(channel) for channel in first.channels]
    return replace(other, channels=first.channels, measured=other.measured[:, order])
