"""Limit cycles of a self-excited structure: amplitudes at which its damping ratio passes through zero.

The free motion keeps such an amplitude. It is stable where δ̃ grows with the amplitude: a motion a little larger loses
energy, one a little smaller gains it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.files.whole_file import csv_text, write_result
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import PointStatus

COLUMNS = ("modal_amplitude", "modal_amplitude_std", "omega_rad_s", "frequency_hz", "stable", "between_levels")
"""Columns of ``limit_cycles.csv``."""


@dataclass(frozen=True)
class LimitCycle:
    """One limit cycle.

    Attributes:
        modal_amplitude, modal_amplitude_std: q, m√kg; the uncertainty is that of the damping ratios next to it
            and of the way between them: the distance to where a straight line is zero.
        omega_rad_s: ω̃ there, rad/s.
        stable: whether a free motion settles at it.
        levels: the two levels that it lies between, in the unit of the levels.
    """

    modal_amplitude: float
    modal_amplitude_std: float
    omega_rad_s: float
    stable: bool
    levels: tuple[float, float]


def feeds_its_motion(points: Iterable[ModalPoint]) -> bool:
    """Whether a damping ratio is negative: deviations are then told in percentage points, since it may be zero."""
    return any(point.status == PointStatus.OK and point.damping_ratio < 0.0 for point in points)


def limit_cycles(points: Iterable[ModalPoint]) -> list[LimitCycle]:
    """Limit cycles between neighbouring amplitudes, ascending.

    δ̃ and ω̃ between them by cubics that are monotone where the values are (pchip), by straight lines for two points.

    Args:
        points: of one mode; those without values are passed over.

    Examples:
        Damping of -1 % and 1 % at 1 and 3 mm√kg:

        >>> from nmt_core.messages.modal_point import ModalPoint
        >>> from nmt_core.vocabulary import PointStatus
        >>> points = [ModalPoint(k, PointStatus.OK, "", 1.0, "m", modal_amplitude=q, damping_ratio=d, omega_rad_s=100.0)
        ...           for k, (q, d) in enumerate([(1e-3, -0.01), (3e-3, 0.01)])]
        >>> [(cycle.modal_amplitude, cycle.stable) for cycle in limit_cycles(points)]
        [(0.002, True)]
    """
    good = [point for point in points if point.status == PointStatus.OK and math.isfinite(point.damping_ratio)]
    good.sort(key=lambda point: point.modal_amplitude)
    good = [point for k, point in enumerate(good) if not k or point.modal_amplitude > good[k - 1].modal_amplitude]
    found = []
    if len(good) < 2:
        return []
    q = np.array([point.modal_amplitude for point in good])
    damping = _curve(q, np.array([point.damping_ratio for point in good]))
    omega = _curve(q, np.array([point.omega_rad_s for point in good]))
    for low, high in pairwise(good):
        change = high.damping_ratio - low.damping_ratio
        if low.damping_ratio * high.damping_ratio > 0.0 or change == 0.0 or high.damping_ratio == 0.0:
            continue
        from scipy.optimize import brentq  # late: most tests have no limit cycle

        at = float(brentq(damping, low.modal_amplitude, high.modal_amplitude))
        way = high.modal_amplitude - low.modal_amplitude
        share = (at - low.modal_amplitude) / way
        measured = math.hypot((1.0 - share) * low.damping_ratio_std, share * high.damping_ratio_std) * way / abs(change)
        for place, point in enumerate(good):
            if point in (low, high) and abs(point.damping_ratio) < 2.0 * point.damping_ratio_std:
                # Its sign is open: the cycle may be anywhere up to where the damping may be zero, beyond the level too.
                measured = max(measured, _moved(q, damping(q), place, point.damping_ratio_std, at))
        straight = low.modal_amplitude - low.damping_ratio * way / change
        found.append(
            LimitCycle(
                at,
                math.hypot(measured, at - straight),
                float(omega(at)),
                change > 0.0,
                (low.level, high.level),
            )
        )
    return found


def _moved(q: FloatArray, damping: FloatArray, place: int, std: float, at: float) -> float:
    """How far a limit cycle at ``at`` moves with the damping ratio of one level by its standard uncertainty."""
    farthest = 0.0
    for change in (std, -std):
        other = damping.copy()
        other[place] += change
        roots = _curve(q, other).roots(extrapolate=False)
        roots = roots[np.isfinite(roots)]
        ends = q[[max(place - 1, 0), min(place + 1, q.size - 1)]]
        farthest = max(farthest, float(np.abs(roots - at).min() if roots.size else np.abs(ends - at).max()))
    return farthest


def _curve(q: FloatArray, values: FloatArray) -> Any:
    """Values over q (k,), ascending, k at least 2."""
    from scipy.interpolate import PchipInterpolator  # late: most tests have no limit cycle

    return PchipInterpolator(q, values)


def write_limit_cycles(cycles: Sequence[LimitCycle], path: Path | str) -> None:
    """Write ``limit_cycles.csv``: one row each.

    Raises:
        BenchError: the file cannot be written; an older file is then left as it was.
    """
    rows: list[Sequence[str]] = [COLUMNS]
    for cycle in cycles:
        numbers = (
            cycle.modal_amplitude,
            cycle.modal_amplitude_std,
            cycle.omega_rad_s,
            cycle.omega_rad_s / (2 * math.pi),
        )
        between = " to ".join(repr(float(level)) for level in cycle.levels)
        rows.append([*(repr(float(number)) for number in numbers), "yes" if cycle.stable else "no", between])
    write_result(Path(path), csv_text(rows))
