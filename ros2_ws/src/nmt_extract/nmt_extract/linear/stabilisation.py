"""Stabilisation diagram (poly-reference LSCF of sdypy-EMA) and the automatic choice of stable poles.

With one reference (one exciter) the poly-reference method is the common-denominator LSCF that the library implements;
responses to several exciters are so many rows more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray

FREQUENCY_TOLERANCE = 0.005
"""Relative change of a stable pole's frequency from one order to the next."""
DAMPING_TOLERANCE = 0.05
"""Relative change of its damping ratio."""
MINIMUM_RUN = 6
"""Successive orders over which a pole must be stable."""
HIGHEST_DAMPING = 0.3
"""Damping ratio above which a pole is not taken for a mode."""
DEFAULT_ORDER = 40
"""Highest number of modes of the diagram."""
SAME_POLE = 4.0 * FREQUENCY_TOLERANCE
"""Relative distance of frequencies below which poles of several diagrams are one."""


@dataclass(frozen=True, eq=False)
class OrderPoles:
    """Poles of one order.

    Attributes:
        order: number of modes of the polynomial.
        frequency_hz: Hz, shape ``(poles,)``.
        damping_ratio: shape ``(poles,)``.
        stable: against the order below, shape ``(poles,)``.
    """

    order: int
    frequency_hz: FloatArray
    damping_ratio: FloatArray
    stable: np.ndarray


@dataclass(frozen=True)
class StablePole:
    """A pole that stays over the orders: medians of its longest run.

    Attributes:
        frequency_hz: Hz.
        damping_ratio: 1.
        orders: number of orders of the run.
        highest_order: where the run ends.
    """

    frequency_hz: float
    damping_ratio: float
    orders: int
    highest_order: int


def order_poles(
    accelerance: ComplexArray,
    frequency_hz: FloatArray,
    band_hz: tuple[float, float],
    highest_order: int = DEFAULT_ORDER,
) -> list[OrderPoles]:
    """Poles of all orders by the library's LSCF.

    Args:
        accelerance: acceleration over force, m/s²/N, of every response to every force, shape ``(rows, lines)``;
            accelerance weighs the modes of a wide band more evenly than receptance.
        frequency_hz: lines, Hz, evenly spaced from below the band to above it.
        band_hz: where poles are sought.
        highest_order: highest number of modes.

    Raises:
        BenchError: too few lines.
    """
    low, high = band_hz
    inside = int(np.count_nonzero((frequency_hz >= low) & (frequency_hz <= high)))
    if inside < 4 * highest_order:
        raise BenchError(
            f"There are {inside} spectral lines between {low:g} and {high:g} Hz; the stabilisation diagram needs at "
            f"least {4 * highest_order}: use longer segments."
        )
    from sdypy import EMA  # takes its time and brings matplotlib

    # Where the first line is not 0 Hz the library fills up by numpy.arange, whose rounding can add one line too many
    # and so shift all poles by one line: fill up here. It also leaves out the line nearest to `upper`.
    spacing = (frequency_hz[-1] - frequency_hz[0]) / (frequency_hz.size - 1)
    missing = round(float(frequency_hz[0] / spacing))
    keep = frequency_hz <= high + spacing
    lines = np.arange(missing + int(np.count_nonzero(keep))) * spacing
    scale = np.sqrt(np.mean(np.abs(accelerance) ** 2, axis=1, keepdims=True))
    model = EMA.Model(
        frf=np.hstack([np.zeros((accelerance.shape[0], missing)), (accelerance / scale)[:, keep]]),
        freq=lines,
        lower=low,
        upper=min(high, float(lines[-1])),
        pol_order_high=highest_order,
        frf_form="accelerance",
    )
    model.get_poles(method="lscf", show_progress=False)
    diagram: list[OrderPoles] = []
    for order, (frequency, damping) in enumerate(zip(model.pole_freq, model.pole_xi, strict=True), start=1):
        frequency, damping = np.asarray(frequency, dtype=np.float64), np.asarray(damping, dtype=np.float64)
        use = (frequency > low) & (frequency < high) & (damping > 0.0) & (damping < 1.0)
        frequency, damping = frequency[use], damping[use]
        ascending = np.argsort(frequency)
        frequency, damping = frequency[ascending], damping[ascending]
        stable = np.zeros(frequency.size, dtype=bool)
        if diagram and diagram[-1].frequency_hz.size:
            below = diagram[-1]
            for index in range(frequency.size):
                stable[index] = _match(below, frequency[index], damping[index]) is not None
        diagram.append(OrderPoles(order, frequency, damping, stable))
    return diagram


def _match(poles: OrderPoles, frequency: float, damping: float) -> int | None:
    """Index of the pole that is the same within the tolerances, nearest in frequency; None if there is none."""
    if not poles.frequency_hz.size:
        return None
    distance = np.abs(poles.frequency_hz / frequency - 1.0)
    distance[np.abs(poles.damping_ratio / damping - 1.0) > DAMPING_TOLERANCE] = np.inf
    nearest = int(np.argmin(distance))
    return nearest if distance[nearest] <= FREQUENCY_TOLERANCE else None


def stable_poles(*diagrams: list[OrderPoles]) -> list[StablePole]:
    """Stable poles of one or several diagrams of one test, ascending in frequency; an earlier diagram goes first."""
    found: list[StablePole] = []
    for diagram in diagrams:
        for pole in _stable(diagram):
            distances = (abs(other.frequency_hz / pole.frequency_hz - 1.0) for other in found)
            if all(distance >= SAME_POLE for distance in distances):
                found.append(pole)
    return sorted(found, key=lambda pole: pole.frequency_hz)


def _stable(diagram: list[OrderPoles]) -> list[StablePole]:
    """Poles that stay within the tolerances over ``MINIMUM_RUN`` successive orders, ascending in frequency.

    A run may start at any order; it ends where no pole of the next order lies within the tolerances. Runs that meet
    (within the frequency tolerance of each other) are one mode: the longest counts. Damping above ``HIGHEST_DAMPING``
    is not a mode.
    """
    runs: list[list[tuple[int, int]]] = []
    open_runs: dict[int, list[tuple[int, int]]] = {}
    for level, poles in enumerate(diagram):
        grown: dict[int, list[tuple[int, int]]] = {}
        for index in range(poles.frequency_hz.size):
            run: list[tuple[int, int]] = []
            if level:
                previous = _match(diagram[level - 1], poles.frequency_hz[index], poles.damping_ratio[index])
                if previous is not None and previous in open_runs:
                    run = open_runs[previous]
            run = [*run, (level, index)]
            grown[index] = run
            runs.append(run)
        open_runs = grown
    found: list[StablePole] = []
    for run in sorted(runs, key=len, reverse=True):
        if len(run) < MINIMUM_RUN:
            break
        frequency = float(np.median([diagram[level].frequency_hz[index] for level, index in run]))
        damping = float(np.median([diagram[level].damping_ratio[index] for level, index in run]))
        same = any(abs(pole.frequency_hz / frequency - 1.0) < 2.0 * FREQUENCY_TOLERANCE for pole in found)
        if not same and damping <= HIGHEST_DAMPING:
            found.append(StablePole(frequency, damping, len(run), diagram[run[-1][0]].order))
    return sorted(found, key=lambda pole: pole.frequency_hz)
