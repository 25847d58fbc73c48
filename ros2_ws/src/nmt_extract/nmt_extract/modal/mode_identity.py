"""Which mode a level is: that of the test, another one under its name, or the mode of the test with another next to it.

One exciter at one frequency drives every mode that is near it, and the loop locks on whichever is in phase at the drive
point. The shape tells them apart: by MAC with each linear mode, and by the participation Φ⁺φ̃ of each.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import PointStatus
from nmt_extract.judgement.moving_shape import mode_words, near_modes

_PART = 0.1  # participation of a near mode from which on it is named: MAC 0.99


def mode_macs(shape: ComplexArray, linear: LinearDescription) -> FloatArray:
    """MAC of a shape with every linear mode, shape ``(modes,)``; NaN for a shape of nothing.

    Args:
        shape: at the points of the description, any unit, shape ``(points,)``.
        linear: linear modes.
    """
    modes = linear.shape_matrix
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(modes.T @ shape) ** 2 / ((modes**2).sum(axis=0) * np.vdot(shape, shape).real))


def other_mode(shape: ComplexArray, linear: LinearDescription) -> int | None:
    """The linear mode that a shape is nearer to than to the target's, by MAC; None = it is nearest to the target."""
    if len(linear.points) < 2:
        return None
    macs = mode_macs(shape, linear)
    best = int(np.argmax(np.nan_to_num(macs)))
    return None if best == linear.target_mode or not macs[best] > macs[linear.target_mode] else best


def mode_sentence(shape: ComplexArray, linear: LinearDescription, omega: float) -> str:
    """What is to be said of the mode of a shape; empty where it is that of the test alone.

    Args:
        shape: fundamental at the points of the description, any unit, shape ``(points,)``.
        linear: linear modes.
        omega: frequency of the window, rad/s.
    """
    target, other = linear.target_mode, other_mode(shape, linear)
    if other is not None:
        macs = mode_macs(shape, linear)
        return (
            f"The shape is that of {mode_words(linear, other)} rather than of {mode_words(linear, target)}: MAC "
            f"{macs[other]:.2f} with mode {other + 1}, {macs[target]:.2f} with mode {target + 1}."
        )
    shares = np.abs(np.linalg.pinv(linear.shape_matrix) @ shape)
    near = [mode for mode in near_modes(linear, omega) if shares[mode] > _PART * shares[target]]
    return " ".join(
        f"{mode_words(linear, mode)[0].upper()}{mode_words(linear, mode)[1:]} takes part by "
        f"{100.0 * shares[mode] / shares[target]:.0f} % of mode {target + 1}."
        for mode in near
    )


def mode_verdict(points: Sequence[ModalPoint], linear: LinearDescription) -> str:
    """One sentence on levels whose shape is nearer to another mode than to that of the test; empty = there are none.

    Args:
        points: of a run.
        linear: linear modes that they were extracted with.
    """
    levels: dict[int, list[ModalPoint]] = {}
    good = [point for point in points if point.status is PointStatus.OK]
    for point in good:
        other = other_mode(point.normalised_shape, linear)
        if other is not None:
            levels.setdefault(other, []).append(point)
    target = linear.target_mode
    return " ".join(
        f"{len(found)} of {len(good)} levels with values are {mode_words(linear, other)} under the name of "
        f"{mode_words(linear, target)}: MAC at most {max(point.mac for point in found):.2f} with mode {target + 1}."
        for other, found in sorted(levels.items())
    )
