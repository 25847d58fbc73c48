"""Local forces under the motion that a random drive makes: motion and equivalent forces that belong to each other.

The drive is flat over the lines of the test and has a known rms. Motion gives the equivalent springs and dampers of the
local forces (equivalent_linear.py), these give the motion; turns go on until neither changes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.prediction.equivalent_linear import NODES, Quadrature, equivalents_kernel
from nmt_diagnose.prediction.linear_model import Fractions, LinearModel
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.aft import ElementTables, LocalTables

# Frequencies about each pole at which the motion is added up, in half widths of its peak.
_ABOUT = np.sinh(np.linspace(-6.0, 6.0, 61)) / 4.0
# Most turns and relative change that ends the search for a motion and the local forces that belong to it; below
# the last, poles that move with rounding move the sums, and a change that does not fall is theirs.
_TURNS, _SETTLED, _ROUNDING = 40, 1e-9, 1e-6
_NODES = tuple(NODES)


class NearPoles(NamedTuple):
    """The poles of a linear model that move motions in a band.

    Attributes:
        poles: (k,) rad/s.
        outputs: (r, k) displacements of the coordinates of each pole.
        inputs: (k, r) share of each pole in the local forces.
    """

    poles: ComplexArray
    outputs: ComplexArray
    inputs: ComplexArray


def forces_in_motion(
    model: LinearModel,
    tables: LocalTables,
    acting: NDArray[np.bool_],
    resting: tuple[FloatArray, FloatArray],
    fractions: Fractions,
    omega: FloatArray,
    drive_rms: float,
    powers: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Stiffness (N/m) and damping (N s/m) of the local forces of each coordinate, (r,) each.

    Args:
        model: the linear part.
        tables: of the local forces.
        acting: (coordinates of the tables,) which carry a force that depends on the motion.
        resting: stiffness and damping at rest, (r,) each; also the answer where no motion is found.
        fractions: ``LinearModel.partial_fractions`` of the r coordinates and of channels, the last of them the drive.
        omega: (lines,) of the test, rad/s, at least two.
        drive_rms: of the reference over the band, V or N.
        powers: (exciters,) of the drive of each over that of the first.
    """
    r = resting[0].size
    low, high = float(omega.min()), float(omega.max())
    near = np.flatnonzero(
        (np.abs(model.poles) < THRESHOLDS.prediction.far_pole_ratio * high)
        & (np.abs(model.poles) > low / THRESHOLDS.prediction.far_pole_ratio)
    )
    nearest = (
        model.poles[near],
        np.ascontiguousarray(model.displacement[:r, near]),
        np.ascontiguousarray(model.inputs[near, :r]),
    )
    stiffness, damping, found = _settled(
        np.ascontiguousarray(omega), nearest, acting, *resting, tuple(fractions), drive_rms, powers,
        tuple(tables.elements), _NODES, _ABOUT,
    )  # fmt: skip
    return (stiffness, damping) if found else resting


@njit(cache=True)
def _settled(
    lines: FloatArray,
    near_tables: tuple[ComplexArray, ComplexArray, ComplexArray],
    acting: NDArray[np.bool_],
    rest_stiffness: FloatArray,
    rest_damping: FloatArray,
    fraction_tables: tuple[FloatArray, ...],
    drive_rms: float,
    powers: FloatArray,
    element_tables: tuple[Any, ...],
    node_tables: tuple[FloatArray, ...],
    about: FloatArray,
) -> tuple[FloatArray, FloatArray, bool]:
    """Stiffness and damping (r,) each, and whether a motion was found.

    The tables are `NearPoles`, `Fractions`, `ElementTables` and `Quadrature` as plain tuples, which come from Python
    sooner than named ones.
    """
    near, fractions = NearPoles(*near_tables), Fractions(*fraction_tables)
    elements, nodes = ElementTables(*element_tables), Quadrature(*node_tables)
    count, r = acting.size, rest_stiffness.size
    low, high = lines.min(), lines.max()
    stiffness, damping = rest_stiffness.copy(), rest_damping.copy()
    poles = near.poles
    before, size = np.inf, 1.0
    omega = np.empty(lines.size + poles.size * about.size)
    moved, fast, most = np.empty(count), np.empty(count), np.empty(count)
    for _ in range(_TURNS):
        omega[: lines.size] = lines
        places = lines.size
        # About each pole the lines of the test may be too far apart.
        for pole in _closed_poles(near, stiffness, damping):
            if pole.imag > 0.0:
                natural = abs(pole)
                width = max(abs(pole.real), 1e-4 * natural)
                # Clipped, not left out: sums must not jump where a pole moves.
                for n in range(about.size):
                    omega[places + n] = min(max(natural + width * about[n], low), high)
                places += about.size
        total = _powers(np.sort(omega[:places]), r, stiffness, damping, fractions, powers, moved, fast, most)
        scale = drive_rms * drive_rms / total
        for i in range(count):
            moved[i], fast[i] = np.sqrt(scale * moved[i]), np.sqrt(scale * fast[i])
            if not np.isfinite(moved[i]) or (acting[i] and not moved[i] > 0.0):
                return stiffness, damping, False
            moved[i], fast[i] = max(moved[i], 1e-300), max(fast[i], 1e-300)
        k_new, d_new = equivalents_kernel(elements, moved, fast, nodes)
        # Over what moves the coordinate as it is.
        change = 0.0
        for i in range(count):
            mobility = np.sqrt(most[i])
            change = max(
                change,
                abs(k_new[i] - stiffness[i]) * mobility,
                abs(d_new[i] - damping[i]) * mobility * fast[i] / moved[i],
            )
        if not change < 0.9 * before:
            if change < _ROUNDING:
                break
            size *= 0.5
        before = change
        for i in range(count):
            stiffness[i] += size * (k_new[i] - stiffness[i])
            damping[i] += size * (d_new[i] - damping[i])
        if change < _SETTLED:
            break
    return stiffness, damping, True


@njit(cache=True)
def _closed_poles(near: NearPoles, stiffness: FloatArray, damping: FloatArray) -> ComplexArray:
    """The poles with springs and dampers in place of the local forces."""
    poles = near.poles
    closed = np.diag(poles)
    for i in range(stiffness.size):
        for k in range(poles.size):
            turned = stiffness[i] * near.outputs[i, k] + damping[i] * near.outputs[i, k] * poles[k]
            for row in range(poles.size):
                closed[row, k] -= near.inputs[row, i] * turned
    return np.linalg.eigvals(closed)  # type: ignore[return-value]


@njit(cache=True)
def _powers(
    omega: FloatArray,
    r: int,
    stiffness: FloatArray,
    damping: FloatArray,
    fractions: Fractions,
    powers: FloatArray,
    moved: FloatArray,
    fast: FloatArray,
    most: FloatArray,
) -> float:
    """Integrals over ω of |H|², and of ω² |H|², into ``moved`` and ``fast``, the largest |H|² into ``most``, for the
    first coordinates, (count,) each; returns that of |H|² of the last channel. H as in ``linear_responses``; of several
    exciters with the sum over them, each by its share ``powers``, but for the last channel: the drive of the first.
    """
    sums, products = fractions.sums, fractions.products
    count, columns = moved.size, r + powers.size
    rows = (r + 1) * columns
    last = fractions.constant_part.size - columns
    at = np.empty(rows, dtype=np.int64)
    for e in range(rows):
        at[e] = e if e < r * columns else last + e - r * columns
    # Only what is needed, and beside each other.
    constants, slopes, constant_part = fractions.constants[:, at], fractions.slopes[:, at], fractions.constant_part[at]
    re, im = np.empty(rows), np.empty(rows)
    closed = np.empty((r, columns), dtype=np.complex128)
    now, then = np.empty(count + 1), np.zeros(count + 1)
    moved[:], fast[:], most[:] = 0.0, 0.0, 0.0
    total = 0.0
    for line in range(omega.size):
        w = omega[line]
        s = 1j * w
        re[:] = constant_part
        im[:] = 0.0
        for k in range(sums.size):
            a = products[k] - w * w
            b = -sums[k] * w
            size = 1.0 / (a * a + b * b)
            dr, di = a * size, -b * size
            wr, wi = -w * di, w * dr
            for e in range(rows):
                re[e] += constants[k, e] * dr + slopes[k, e] * wr
                im[e] += constants[k, e] * di + slopes[k, e] * wi
        for i in range(r):
            for j in range(r):
                closed[i, j] = (re[i * columns + j] + 1j * im[i * columns + j]) * (stiffness[j] + s * damping[j])
            closed[i, i] += 1.0
            for x in range(r, columns):
                closed[i, x] = re[i * columns + x] + 1j * im[i * columns + x]
        for i in range(r):
            pivot = 1.0 / closed[i, i]
            for row in range(r):
                if row != i and closed[row, i] != 0.0:
                    factor = closed[row, i] * pivot
                    for j in range(i, columns):
                        closed[row, j] -= factor * closed[i, j]
        drive = re[r * columns + r] + 1j * im[r * columns + r]
        for i in range(r):
            w_i = closed[i, r] / closed[i, i]
            drive -= (re[r * columns + i] + 1j * im[r * columns + i]) * (stiffness[i] + s * damping[i]) * w_i
            if i < count:
                now[i] = w_i.real * w_i.real + w_i.imag * w_i.imag
                for x in range(1, powers.size):
                    w_i = closed[i, r + x] / closed[i, i]
                    now[i] += powers[x] * (w_i.real * w_i.real + w_i.imag * w_i.imag)
                most[i] = max(most[i], now[i])
        now[count] = drive.real * drive.real + drive.imag * drive.imag
        if line:
            step = 0.5 * (w - omega[line - 1])
            for i in range(count):
                moved[i] += step * (now[i] + then[i])
                fast[i] += step * (now[i] * w * w + then[i] * omega[line - 1] ** 2)
            total += step * (now[count] + then[count])
        then[:] = now
    return total
