"""Each channel of a window judged by what the others say: dead, flat-topped, off its shape, noisy.

A fault is distinguished from a nonlinear shape by where it sits. A structure that changes its shape changes it at many
points; without a faulty channel the rest of the shape fits its neighbour, or the linear modes, much better than with
it. Where other modes lie near the frequency, and where the shape moved from level to level before, it may move on by
them: what fits is then the span of all of these. Where there are too few points for that, a shape that moves as it did
before is none that a fault makes; any other leaves open which of both it is, and nothing is left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray

_ISOLATED, _ISOLATED_LINEAR = 10.0, 15.0  # a channel's deviation over that of all others together
_OFF_OWN = 0.05  # of a channel's own value
_OFF_LINEAR = 0.35  # of the largest value of the shape: linear modes have errors of their own
_OFF_CLEAR, _CLEAR = 0.1, 50.0  # the same where the deviation is so much larger than that of all others
_LEAST = 0.02  # of the largest value: smaller deviations do not matter
_SURE = 5.0  # standard deviations
_STRANGE = 0.5  # correlation with all that the linear modes can do
_ALIKE_DOUBT = 3.0  # isolation of the worst deviation over that of another one that may be a fault as well
_LEAST_DOUBT = 0.002  # of the largest value


@dataclass(frozen=True)
class Deviation:
    """A channel next to what the others predict of it.

    Attributes:
        index: of the point in the shape.
        ratio: measured over predicted.
        share: of the deviation in the largest value of the shape.
        isolation: the deviation over that of all others together when this one is left out.
    """

    index: int
    ratio: complex
    share: float
    isolation: float

    @property
    def own(self) -> float:
        """Deviation in terms of the larger one of measured and predicted."""
        return abs(self.ratio - 1.0) / max(abs(self.ratio), 1.0)

    @property
    def words(self) -> str:
        """For people."""
        size, turn = abs(self.ratio), math.degrees(np.angle(self.ratio))
        if size < 0.05:
            return "does not follow the excitation"
        if abs(turn) > 150.0:
            turned = "with the wrong sign"
        else:
            turned = f"{abs(turn):.0f}° {'early' if turn > 0 else 'late'}" if abs(turn) >= 2.0 else "in phase"
        return f"measures {size:.2f} times what the other channels say, {turned}"


def predicted(basis: ComplexArray, shape: ComplexArray, kept: Sequence[int]) -> ComplexArray:
    """The shape that a basis makes of the kept points.

    Args:
        basis: shape ``(points, columns)``.
        shape: shape ``(..., points)``.
        kept: points that are fitted.

    Returns:
        Shape ``(..., points)``.
    """
    rows = list(kept)
    return np.asarray(shape[..., rows] @ np.linalg.pinv(basis[rows]).T @ basis.T)


def deviations(basis: ComplexArray, shape: ComplexArray, kept: Sequence[int]) -> list[Deviation]:
    """Each of the kept points left out in turn; empty where the basis leaves nothing to compare.

    Args:
        basis: shape ``(points, columns)``.
        shape: shape ``(points,)``.
        kept: points that are judged.
    """
    if len(kept) - 1 <= basis.shape[1]:
        return []
    found = []
    for index in kept:
        others = [k for k in kept if k != index]
        guess = predicted(basis, shape, others)
        scale = max(float(np.abs(shape[others]).max()), abs(guess[index]))
        rest = max(float(np.linalg.norm((shape - guess)[others])), 1e-9 * scale)
        away = abs(shape[index] - guess[index])
        ratio = complex(shape[index] / guess[index]) if guess[index] != 0.0 else complex(math.inf, 0.0)
        found.append(Deviation(index, ratio, float(away / scale), float(away / rest)))
    return found


def linear_basis(shapes: FloatArray, target: int, points: int) -> ComplexArray:
    """The linear modes, or the target mode where so many points do not determine them with something to spare."""
    chosen = shapes if points > shapes.shape[1] else shapes[:, [target]]
    return chosen.astype(np.complex128)


class ShapeFaults(NamedTuple):
    """What does not fit, by point.

    Attributes:
        off: the words why, and whether it was the neighbouring level.
        doubtful: words on channels that may be off, or the shape moves: there are too few points to tell.
    """

    off: dict[int, tuple[str, bool]]
    doubtful: dict[int, Deviation]


def off_its_shape(
    shape: ComplexArray,
    std: FloatArray,
    linear: ComplexArray,
    neighbour: ComplexArray | None,
    points: Sequence[int],
    suspects: Sequence[int] = (),
    near: ComplexArray | None = None,
    trend: ComplexArray | None = None,
) -> ShapeFaults:
    """Points whose channel alone does not fit the neighbouring level or the linear modes.

    Linear modes have errors of their own: a small deviation from them counts where the neighbouring level had none.

    Args:
        shape: fundamental, shape ``(points,)``.
        std: its standard uncertainty, same unit and shape; NaN = not known.
        linear: see :func:`linear_basis`.
        neighbour: shape of a level before without a fault, same shape; None = there is none.
        points: that are judged.
        suspects: that were faulty at the level before; no sensor mends itself.
        near: modes near the frequency, shape ``(points, modes)``: the shape may move by them.
        trend: by what it moved over the levels before, shape ``(points,)``; None = nothing to speak of.
    """
    kept = list(points)
    found: dict[int, tuple[str, bool]] = {}
    bases = [linear] if neighbour is None else [neighbour[:, np.newaxis], linear]
    before = [] if neighbour is None else deviations(linear, neighbour, range(shape.size))
    fitted = {each.index for each in before if each.share < _LEAST}
    largest = float(np.abs(shape).max())

    def is_off(each: Deviation, to_linear: bool, *, doubt: bool = False) -> bool:
        turned = each.ratio.real < 0.0 or abs(each.ratio) < 0.05
        clear = each.isolation > _CLEAR and (doubt or each.share > _OFF_CLEAR)
        plain = each.share > _OFF_LINEAR or clear
        needed = _ISOLATED
        if to_linear and not (turned or plain):
            if each.index not in fitted:
                return False
            needed = _ISOLATED_LINEAR
        if each.index in suspects:
            needed *= 0.25
        sure = not each.share * largest <= _SURE * std[each.index]
        least = _LEAST_DOUBT if doubt else _LEAST
        return sure and each.own > _OFF_OWN and each.share > least and each.isolation > needed

    while True:
        off: list[tuple[Deviation, bool]] = []
        doubtful: dict[int, Deviation] = {}
        for basis in bases:
            wide = basis if near is None else np.concatenate([basis, near], axis=1)
            if trend is not None and len(kept) - 1 > wide.shape[1] + 1:
                wide = np.concatenate([wide, trend[:, np.newaxis]], axis=1)
            to_linear = basis is linear
            off += [(each, not to_linear) for each in deviations(wide, shape, kept) if is_off(each, to_linear)]
            if len(kept) - 1 <= wide.shape[1]:
                for each in deviations(basis, shape, kept):
                    before_it = doubtful.get(each.index, each)
                    if is_off(each, to_linear, doubt=True) and each.isolation >= before_it.isolation:
                        doubtful[each.index] = each
        if not off:
            clearest = max((each.isolation for each in doubtful.values()), default=0.0)
            return ShapeFaults(
                found, {k: each for k, each in doubtful.items() if _ALIKE_DOUBT * each.isolation > clearest}
            )
        # Of channels that stand out alike, as those of points that move alike do, the one that was faulty before.
        clearest = max(each.isolation for each, _ in off)
        alike = [item for item in off if _ALIKE_DOUBT * item[0].isolation > clearest]
        before_too = [item for item in alike if item[0].index in suspects]
        worst, by_neighbour = max(before_too or off, key=lambda item: item[0].isolation)
        found[worst.index] = worst.words, by_neighbour
        kept.remove(worst.index)


def strange_shape(shape: ComplexArray, shapes: FloatArray) -> bool:
    """Whether a shape is neither one of the linear modes nor, where there are more points than modes, made of them."""
    size = float(np.linalg.norm(shape))
    if size == 0.0:
        return True
    each = np.abs(shapes.T @ shape) / (np.linalg.norm(shapes, axis=0) * size)
    best = float(each.max()) ** 2
    if shapes.shape[0] > shapes.shape[1]:
        whole = predicted(shapes.astype(np.complex128), shape, range(shape.size))
        best = max(best, float(np.linalg.norm(whole) / size) ** 2)
    return best < _STRANGE
