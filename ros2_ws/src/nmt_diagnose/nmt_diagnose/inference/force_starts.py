"""Where a search may begin when frequency responses at held amplitudes are far from those of any linear model.

Each line tells how large the motion was, and the model tells the force that this motion needs. The force is linear in
the strength of a stiffness or a damping, and nearly so in the model's own parameters; its logarithm, which observables
are made of, is not: where the model alone is wrong by many times the force, steps along the logarithm lead nowhere. So
strengths are found by linear least squares of the force itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nmt_core.arrays import FloatArray
from nmt_diagnose.observations.conditions import SteppedSineTest
from nmt_diagnose.observations.observables import Observations, Part

# Error of a force that is as good as the prior of a parameter, relative; share of the squared error of the model alone
# that a start may leave.
_ERROR, _LEFT = 0.1, 0.5


@dataclass(frozen=True)
class ForceColumn:
    """What the strength of one candidate does.

    Attributes:
        slope: change of the observables per unit of strength, shape (m,); of an even force per unit of its square.
        spread: prior standard deviation of the strength.
        signed: whether it may be negative.
        even: whether the fundamental shows the square of the strength only, the same for either sign.
    """

    slope: FloatArray
    spread: float
    signed: bool
    even: bool = False


@dataclass(frozen=True)
class ForceStart:
    """A start of one candidate.

    Attributes:
        number: of its column.
        own: parameters of the model, shape (n,), in prior standard deviations.
        strength: of the candidate, in the units of its column.
    """

    number: int
    own: FloatArray
    strength: float


def lines_of_known_amplitude(observations: Observations) -> NDArray[np.int64]:
    """Rows (magnitude, phase) of the first channel of each line at which the motion is known, shape (lines, 2)."""
    rows = observations.rows
    known = [
        number
        for number, test in enumerate(observations.tests)
        if isinstance(test, SteppedSineTest) and np.all(np.isfinite(test.amplitudes))
    ]
    found: dict[tuple[int, int], list[int]] = {}
    for part in (Part.LOG_MAGNITUDE, Part.PHASE):
        for row in np.flatnonzero(np.isin(rows.test, known) & (rows.channel == 0) & (rows.part == part)):
            found.setdefault((int(rows.test[row]), int(rows.level[row])), []).append(int(row))
    return np.array([pair for pair in found.values() if len(pair) == 2], dtype=np.int64).reshape(-1, 2)


def even_column(lines: NDArray[np.int64], change: FloatArray, strength: float, spread: float) -> ForceColumn:
    """Column of an even force, from a prediction with one strength.

    Args:
        lines: as from :func:`lines_of_known_amplitude`.
        change: of the observables by that strength, shape (m,).
        strength: of the prediction.
        spread: prior standard deviation of the strength.
    """
    magnitude, phase = lines.T
    # The force grows with the square of the strength, its logarithm does not.
    grown = (1.0 - np.exp(-(change[magnitude] + 1j * change[phase]))) / strength**2
    slope = np.zeros_like(change)
    slope[magnitude], slope[phase] = grown.real, grown.imag
    return ForceColumn(slope, spread, signed=False, even=True)


def force_starts(
    lines: NDArray[np.int64],
    difference: FloatArray,
    own: FloatArray,
    columns: Sequence[ForceColumn],
    most: int,
) -> list[ForceStart]:
    """Candidates whose force makes up for what the model's lacks, best first.

    Args:
        lines: as from :func:`lines_of_known_amplitude`.
        difference: measured minus predicted by the model as given, shape (m,).
        own: change of the observables per parameter of the model, each in prior standard deviations, shape (m, n).
        columns: of the candidates.
        most: how many.
    """
    magnitude, phase = lines[np.all(np.isfinite(difference[lines]), axis=1)].T
    force = np.exp(difference[magnitude] + 1j * difference[phase])  # of the model over the measured one

    def change(column: FloatArray) -> FloatArray:
        turned = -force * (column[magnitude] + 1j * column[phase])
        return np.concatenate([turned.real, turned.imag]) / _ERROR

    missing = np.concatenate([1.0 - force.real, -force.imag]) / _ERROR
    plain = np.array([change(column) for column in own.T]).reshape(own.shape[1], -1).T
    if not missing.size:
        return []

    def solution(design: FloatArray, penalties: FloatArray) -> tuple[FloatArray, float]:
        matrix = np.vstack([design, np.diag(penalties)])
        target = np.concatenate([missing, np.zeros(penalties.size)])
        found = np.linalg.lstsq(matrix, target, rcond=None)[0]
        return found, float(np.sum((matrix @ found - target) ** 2))

    alone = solution(plain, np.ones(own.shape[1]))[1]
    starts = []
    for number, column in enumerate(columns):
        added = change(column.slope)
        if not np.all(np.isfinite(added)) or not np.any(added):
            continue
        spread = column.spread**2 if column.even else column.spread
        theta, left = solution(np.column_stack([plain, added]), np.append(np.ones(own.shape[1]), 1.0 / spread))
        if left < _LEFT * alone and (column.signed or theta[-1] > 0.0):
            strength = float(np.sqrt(theta[-1]) if column.even else theta[-1])
            starts.append((left, ForceStart(number, theta[:-1], strength)))
    return [start for _, start in sorted(starts, key=lambda item: item[0])[:most]]
