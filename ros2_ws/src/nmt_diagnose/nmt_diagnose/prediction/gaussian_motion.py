"""Local forces under the motion that a random drive makes: motion and equivalent forces that belong to each other.

The drive is flat over the lines of the test and has a known rms. Motion gives the equivalent springs and dampers of the
local forces (equivalent_linear.py), these give the motion; turns go on until neither changes. How forces and motion
follow a small change of the rig needs one turn and the derivatives of a turn by the forces (implicit function theorem).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
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
# Step of stiffness and damping over which a turn is differenced, over what moves the coordinate.
_FORCE_STEP = 1e-5


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


class Room(NamedTuple):
    """Room for what a turn finds.

    Attributes:
        omega: frequencies at which the motion is added up, rad/s.
        moved, fast: rms displacement and velocity of each coordinate, (count,).
        most: largest |H|² of each, (count,).
    """

    omega: FloatArray
    moved: FloatArray
    fast: FloatArray
    most: FloatArray


@dataclass(frozen=True)
class DrivenForces:
    """Local forces of a rig under the motion that a random drive makes.

    Attributes:
        model: the linear part.
        tables: of the local forces.
        acting: (coordinates of the tables,) which carry a force that depends on the motion.
        resting: stiffness and damping at rest, (r,) each; also the answer where no motion is found.
        fractions: ``LinearModel.partial_fractions`` of the r coordinates and of channels, the last of them the drive.
        omega: (lines,) of the test, rad/s, at least two.
        drive_rms: of the reference over the band, V or N.
        powers: (exciters,) of the drive of each over that of the first.
        keys: identity of each coordinate.
    """

    model: LinearModel
    tables: LocalTables
    acting: NDArray[np.bool_]
    resting: tuple[FloatArray, FloatArray]
    fractions: Fractions
    omega: FloatArray
    drive_rms: float
    powers: FloatArray
    keys: tuple[str, ...]

    @cached_property
    def _near(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        r, ratio = self.resting[0].size, THRESHOLDS.prediction.far_pole_ratio
        sizes = np.abs(self.model.poles)
        near = np.flatnonzero((sizes < ratio * float(self.omega.max())) & (sizes > float(self.omega.min()) / ratio))
        return (
            self.model.poles[near],
            np.ascontiguousarray(self.model.displacement[:r, near]),
            np.ascontiguousarray(self.model.inputs[near, :r]),
        )

    @cached_property
    def found(self) -> tuple[FloatArray, FloatArray] | None:
        """Stiffness (N/m) and damping (N s/m) of each coordinate, (r,) each; None where no motion was found."""
        stiffness, damping, found = _settled(
            np.ascontiguousarray(self.omega), self._near, self.acting, *self.resting, tuple(self.fractions),
            self.drive_rms, self.powers, tuple(self.tables.elements), _NODES, _ABOUT,
        )  # fmt: skip
        return (stiffness, damping) if found else None

    @property
    def forces(self) -> tuple[FloatArray, FloatArray]:
        """The same; those at rest where no motion was found."""
        return self.resting if self.found is None else self.found

    def turned(self, forces: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Forces, (2 r,), of the motion that some given forces cause, stiffness first, and the steps of these.

        None where no motion was found.
        """
        r, count = self.resting[0].size, self.acting.size
        stiffness, damping, moved, fast, most, there = _turned(
            np.ascontiguousarray(self.omega), self._near, self.acting, forces[:r].copy(), forces[r:].copy(),
            tuple(self.fractions), self.drive_rms, self.powers, tuple(self.tables.elements), _NODES, _ABOUT,
        )  # fmt: skip
        if not there:
            return None
        result, steps = forces.copy(), np.zeros(2 * r)
        result[:count], result[r : r + count] = stiffness, damping
        # Of acting coordinates: other forces stay as they are.
        steps[:count][self.acting] = _FORCE_STEP / np.sqrt(most[self.acting])
        steps[r : r + count][self.acting] = steps[:count][self.acting] * (moved / fast)[self.acting]
        return result, steps

    @cached_property
    def _following(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Forces that were found, those after one more turn, (2 r,) each, and (1 − ∂turn/∂forces)⁻¹."""
        if self.found is None:
            return None
        forces = np.concatenate(self.found)
        again = self.turned(forces)
        if again is None:
            return None
        turned, steps = again
        slopes = np.zeros((forces.size, forces.size))
        for column in np.flatnonzero(steps > 0.0):
            moved = forces.copy()
            moved[column] += steps[column]
            other = self.turned(moved)
            if other is None:
                return None
            slopes[:, column] = (other[0] - turned) / steps[column]
        try:
            inverse = np.asarray(np.linalg.inv(np.eye(forces.size) - slopes), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        return (forces, turned, inverse) if np.isfinite(inverse).all() else None

    def followed(self, other: DrivenForces) -> tuple[FloatArray, FloatArray] | None:
        """Forces of a rig that differs a little, to first order; None where these are not sufficient."""
        if other.keys != self.keys or not np.array_equal(other.acting, self.acting) or self._following is None:
            return None
        forces, turned, inverse = self._following
        # Forces that no motion changes have their values at rest.
        r, count = self.resting[0].size, self.acting.size
        begin = forces.copy()
        begin[count:r], begin[r + count :] = other.resting[0][count:], other.resting[1][count:]
        again = other.turned(begin)
        if again is None:
            return None
        result = forces + inverse @ (again[0] - turned)
        return result[:r], result[r:]


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
    count = acting.size
    stiffness, damping = rest_stiffness.copy(), rest_damping.copy()
    before, size = np.inf, 1.0
    omega = np.empty(lines.size + near.poles.size * about.size)
    moved, fast, most = np.empty(count), np.empty(count), np.empty(count)
    room = Room(omega, moved, fast, most)
    for _ in range(_TURNS):
        k_new, d_new, found = _turn(
            lines, near, acting, stiffness, damping, fractions, drive_rms, powers, elements, nodes, about, room
        )  # fmt: skip
        if not found:
            return stiffness, damping, False
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
def _turned(
    lines: FloatArray,
    near_tables: tuple[ComplexArray, ComplexArray, ComplexArray],
    acting: NDArray[np.bool_],
    stiffness: FloatArray,
    damping: FloatArray,
    fraction_tables: tuple[FloatArray, ...],
    drive_rms: float,
    powers: FloatArray,
    element_tables: tuple[Any, ...],
    node_tables: tuple[FloatArray, ...],
    about: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, bool]:
    """Stiffness and damping after one turn, rms displacement and velocity, largest |H|², (count,) each; whether found.

    Tables as of ``_settled``.
    """
    near, fractions = NearPoles(*near_tables), Fractions(*fraction_tables)
    elements, nodes = ElementTables(*element_tables), Quadrature(*node_tables)
    count = acting.size
    omega = np.empty(lines.size + near.poles.size * about.size)
    moved, fast, most = np.empty(count), np.empty(count), np.empty(count)
    room = Room(omega, moved, fast, most)
    k_new, d_new, found = _turn(
        lines, near, acting, stiffness, damping, fractions, drive_rms, powers, elements, nodes, about, room
    )  # fmt: skip
    return k_new, d_new, moved, fast, most, found


@njit(cache=True)
def _turn(
    lines: FloatArray,
    near: NearPoles,
    acting: NDArray[np.bool_],
    stiffness: FloatArray,
    damping: FloatArray,
    fractions: Fractions,
    drive_rms: float,
    powers: FloatArray,
    elements: ElementTables,
    nodes: Quadrature,
    about: FloatArray,
    room: Room,
) -> tuple[FloatArray, FloatArray, bool]:
    """Equivalent stiffness and damping, (count,) each, under the motion that some, (r,) each, make; whether there is
    one.
    """
    omega, moved, fast, most = room
    count, r = acting.size, stiffness.size
    low, high = lines.min(), lines.max()
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
            return stiffness[:count], damping[:count], False
        moved[i], fast[i] = max(moved[i], 1e-300), max(fast[i], 1e-300)
    k_new, d_new = equivalents_kernel(elements, moved, fast, nodes)
    return k_new, d_new, True


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
    # Only the rows that are needed, contiguous in memory.
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
