"""Exact Fourier coefficients of piecewise linear local forces (Jenkins elements, stops) of a periodic
displacement.

Between its turning points w(θ) is monotone, so every switch is either a turning point (slip → stick) or one
bracketed root (stick → slip, contact opens or closes). On each piece the force is affine in w, hence its
Fourier coefficients and
their derivatives are integrals of products of two basis functions, known in closed form: no sampling error.
The derivative needs no switching angles, because the force is continuous there; what remains of the
hysteretic memory is the displacement at the last slip → stick turning point, where dw/dθ = 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_core.numerics.kernels import loop_step, njit
from nmt_rig.model.local_elements.element import (
    CONTACT_GAP,
    CONTACT_SIDE,
    CONTACT_STIFFNESS,
    SLIDER_SLIP,
    SLIDER_STIFFNESS,
)

TWO_PI = 2.0 * np.pi
# Columns of the phases of a slider, see `jenkins_phases`.
SLIP_FROM, SLIP_FORCE, ANCHOR, OFFSET_FORCE = 0, 1, 2, 3
_NEVER_SLIPPED = -1.0


class Waves(NamedTuple):
    """cos(kθ) and sin(kθ), or integrals of them, in the last direction for k = 0 … highest; one row for each corner
    where there are several.
    """

    cosines: FloatArray
    sines: FloatArray


class SlidingForces(NamedTuple):
    """Integrals of the forces of all sliders with cos(kθ) and sin(kθ), by what the forces go with.

    Attributes:
        motion: stiffness of the part in proportion to w.
        rest: of the constant part.
        anchored: (corners,) of the part in proportion to w at the corner where the present sticking began.
    """

    motion: Waves
    rest: Waves
    anchored: Waves


@njit(cache=True)
def evaluate(coefficients: FloatArray, orders: IntArray, offsets: IntArray, angle: float) -> tuple[float, float, float]:
    """w, dw/dθ and d²w/dθ² of the real Fourier coefficients at one angle (rad)."""
    value = 0.0
    slope = 0.0
    curvature = 0.0
    c1 = np.cos(angle)
    s1 = np.sin(angle)
    cosine = 1.0
    sine = 0.0
    reached = 0
    for position in range(orders.size):
        n = orders[position]
        offset = offsets[position]
        if n == 0:
            value += coefficients[offset]
            continue
        for _ in range(n - reached):
            cosine, sine = cosine * c1 - sine * s1, sine * c1 + cosine * s1
        reached = n
        c = coefficients[offset]
        s = coefficients[offset + 1]
        even = c * cosine + s * sine
        value += even
        slope += n * (s * cosine - c * sine)
        curvature -= n * n * even
    return value, slope, curvature


@njit(cache=True)
def turning_points(
    coefficients: FloatArray, orders: IntArray, offsets: IntArray, slope_basis: FloatArray, angles: FloatArray
) -> int:
    """Zeros of dw/dθ in [0, 2π), ascending, written to ``angles``; returns their number.

    ``slope_basis`` (samples, size) brackets the zeros; two zeros within one of its cells are not seen, which
    loses a loop smaller than that cell.
    """
    samples = slope_basis.shape[0]
    cell = TWO_PI / samples
    slopes = slope_basis @ coefficients
    count = 0
    for j in range(samples):
        left_slope = slopes[j]
        right_slope = slopes[(j + 1) % samples]
        if not ((left_slope > 0.0 and right_slope <= 0.0) or (left_slope < 0.0 and right_slope >= 0.0)):
            continue
        left = j * cell
        right = left + cell
        angle = left + cell * left_slope / (left_slope - right_slope)
        for _ in range(60):
            _, slope, curvature = evaluate(coefficients, orders, offsets, angle)
            if slope == 0.0:
                break
            if (slope > 0.0) == (left_slope > 0.0):
                left = angle
            else:
                right = angle
            step = -slope / curvature if curvature != 0.0 else np.inf
            refined = angle + step
            if not (left <= refined <= right):
                refined = 0.5 * (left + right)
            change = abs(refined - angle)
            angle = refined
            if change < 4e-15 * TWO_PI:
                break
        if count < angles.size:
            angles[count] = angle
            count += 1
    return count


@njit(cache=True)
def level_crossing(
    coefficients: FloatArray,
    orders: IntArray,
    offsets: IntArray,
    left: float,
    right: float,
    first: float,
    last: float,
    level: float,
) -> float:
    """Angle in [left, right] where the monotone w, which goes from ``first`` to ``last``, reaches ``level``."""
    low = left
    high = right
    # As half a cosine goes from one turning point to the next.
    share = (level - first) / (last - first) if last != first else 0.5
    angle: float = left + (right - left) * np.arccos(1.0 - 2.0 * min(max(share, 0.0), 1.0)) / np.pi
    rising = last > first
    for _ in range(80):
        value, slope, _ = evaluate(coefficients, orders, offsets, angle)
        excess = value - level
        if excess == 0.0:
            break
        if (excess > 0.0) == rising:
            high = angle
        else:
            low = angle
        refined = angle - excess / slope if slope != 0.0 else np.inf
        if not (low <= refined <= high):
            refined = 0.5 * (low + high)
        change = abs(refined - angle)
        angle = refined
        if change < 4e-15 * TWO_PI:
            break
    return angle


@njit(cache=True)
def add_interval(cosines: FloatArray, sines: FloatArray, left: float, right: float, weight: float) -> None:
    """Add weight · ∫ cos(kθ) dθ and weight · ∫ sin(kθ) dθ over [left, right] for k = 0 … size − 1."""
    cosines[0] += weight * (right - left)
    c1l = np.cos(left)
    s1l = np.sin(left)
    c1r = np.cos(right)
    s1r = np.sin(right)
    cl = 1.0
    sl = 0.0
    cr = 1.0
    sr = 0.0
    for k in range(1, cosines.size):
        cl, sl = cl * c1l - sl * s1l, sl * c1l + cl * s1l
        cr, sr = cr * c1r - sr * s1r, sr * c1r + cr * s1r
        cosines[k] += weight * (sr - sl) / k
        sines[k] += weight * (cl - cr) / k


@njit(cache=True)
def turn(angle: float, cosines: FloatArray, sines: FloatArray) -> None:
    """cos(kθ) and sin(kθ) at one angle (rad) for k = 0 … size − 1, written to the last two."""
    c1 = np.cos(angle)
    s1 = np.sin(angle)
    cosine = 1.0
    sine = 0.0
    for k in range(cosines.size):
        cosines[k] = cosine
        sines[k] = sine
        cosine, sine = cosine * c1 - sine * s1, sine * c1 + cosine * s1


@njit(cache=True)
def basis_integrals(
    cosines: FloatArray, sines: FloatArray, orders: IntArray, offsets: IntArray, integrals: FloatArray
) -> None:
    """Every basis function, or its integral, picked from those of cos(kθ), sin(kθ)."""
    for position in range(orders.size):
        n = orders[position]
        integrals[offsets[position]] = cosines[n]
        if n > 0:
            integrals[offsets[position] + 1] = sines[n]


@njit(cache=True)
def add_gram(
    cosines: FloatArray, sines: FloatArray, orders: IntArray, offsets: IntArray, derivative: FloatArray
) -> None:
    """Add ∫ (basis_i basis_j) dθ, from the weighted integrals of cos(kθ), sin(kθ), to ``derivative``."""
    for p in range(orders.size):
        m = orders[p]
        i = offsets[p]
        for r in range(orders.size):
            n = orders[r]
            j = offsets[r]
            total = m + n
            difference = abs(m - n)
            derivative[i, j] += 0.5 * (cosines[difference] + cosines[total])
            odd_difference = sines[difference] if m >= n else -sines[difference]
            if m > 0:
                derivative[i + 1, j] += 0.5 * (sines[total] + odd_difference)
            if n > 0:
                derivative[i, j + 1] += 0.5 * (sines[total] - odd_difference)
            if m > 0 and n > 0:
                derivative[i + 1, j + 1] += 0.5 * (cosines[difference] - cosines[total])


@njit(cache=True)
def corners(
    coefficients: FloatArray, orders: IntArray, offsets: IntArray, slope_basis: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Turning points of one period, from the one with the largest |w| to its repetition one period later.

    Returns:
        angles (count + 1,) in rad, ascending, and w (count + 1,) there, m. A constant w has two of them.
    """
    angles = np.empty(4 * orders[-1] + 4)
    count = turning_points(coefficients, orders, offsets, slope_basis, angles)
    if count < 2:
        angles[0] = 0.0
        angles[1] = np.pi
        count = 2
    start = 0
    largest = -1.0
    for p in range(count):
        value, _, _ = evaluate(coefficients, orders, offsets, angles[p])
        if abs(value) > largest:
            largest = abs(value)
            start = p
    corner_angles = np.empty(count + 1)
    corner_values = np.empty(count + 1)
    for p in range(count + 1):
        index = start + p
        corner_angles[p] = angles[index % count] + (TWO_PI if index >= count else 0.0)
        corner_values[p], _, _ = evaluate(coefficients, orders, offsets, corner_angles[p])
    corner_values[count] = corner_values[0]
    return corner_angles, corner_values


@njit(cache=True)
def jenkins_phases(
    coefficients: FloatArray,
    orders: IntArray,
    offsets: IntArray,
    corner_angles: FloatArray,
    corner_values: FloatArray,
    stiffness: float,
    limit: float,
    phases: FloatArray,
) -> None:
    """Stick and slip of one Jenkins element between successive turning points of the periodic motion.

    Args:
        phases: (count, 4) overwritten, per piece: `SLIP_FROM` angle at which slip starts (the right end if it sticks),
            `SLIP_FORCE` ±μN (0 if it sticks), `ANCHOR` number of the turning point at which the present sticking began
            (−1: it never slipped), and `OFFSET_FORCE` g − k_t w while it sticks, N.
    """
    count = corner_angles.size - 1
    current = stiffness * corner_values[0]
    anchor = _NEVER_SLIPPED
    offset_force = 0.0
    if abs(current) > limit:
        current = limit if current > 0.0 else -limit
        anchor = 0.0
        offset_force = current - stiffness * corner_values[0]
    for period in range(2):
        for p in range(count):
            right = corner_angles[p + 1]
            phases[p, SLIP_FROM] = right
            phases[p, SLIP_FORCE] = 0.0
            phases[p, ANCHOR] = anchor
            phases[p, OFFSET_FORCE] = offset_force
            trial = stiffness * corner_values[p + 1] + offset_force
            if abs(trial) <= limit:
                continue
            slip_force = limit if trial > 0.0 else -limit
            if period == 1:
                level = (slip_force - offset_force) / stiffness
                phases[p, SLIP_FROM] = level_crossing(
                    coefficients,
                    orders,
                    offsets,
                    corner_angles[p],
                    right,
                    corner_values[p],
                    corner_values[p + 1],
                    level,
                )
            phases[p, SLIP_FORCE] = slip_force
            anchor = p + 1.0
            offset_force = slip_force - stiffness * corner_values[p + 1]


@njit(cache=True)
def largest_motion(coefficients: FloatArray, orders: IntArray, offsets: IntArray) -> float:
    """A bound on |w|: the sum of the amplitudes of all orders."""
    bound = 0.0
    for position in range(orders.size):
        offset = offsets[position]
        if orders[position] == 0:
            bound += abs(coefficients[offset])
        else:
            bound += np.hypot(coefficients[offset], coefficients[offset + 1])
    return bound


@loop_step
def add_phase(
    phase: FloatArray, stiffness: float, p: int, angles: FloatArray, at: Waves, slip: Waves, into: SlidingForces
) -> None:
    """Add the integrals of one slider over one piece, from corner p to the next.

    Args:
        phase: (4,) of the piece, see `jenkins_phases`.
        stiffness: of the slider, N/m.
        angles, at: the corners (count + 1,), rad, and their waves (count + 1, ·).
        slip: work space for the waves where slip starts.
        into: added to.
    """
    waves, rest, anchored = into.motion, into.rest, into.anchored
    slip_from, slip_force, offset_force = phase[SLIP_FROM], phase[SLIP_FORCE], phase[OFFSET_FORCE]
    anchor = int(phase[ANCHOR])
    tables = waves.cosines.size
    if slip_force != 0.0:
        turn(slip_from, slip.cosines, slip.sines)
        rest.cosines[0] += slip_force * (angles[p + 1] - slip_from)
        for k in range(1, tables):
            rest.cosines[k] += slip_force * (at.sines[p + 1, k] - slip.sines[k]) / k
            rest.sines[k] += slip_force * (slip.cosines[k] - at.cosines[p + 1, k]) / k
    else:
        for k in range(tables):
            slip.cosines[k] = at.cosines[p + 1, k]
            slip.sines[k] = at.sines[p + 1, k]
    # From here on the integrals over the sticking part.
    width = slip_from - angles[p]
    waves.cosines[0] += stiffness * width
    if anchor >= 0:
        rest.cosines[0] += offset_force * width
        anchored.cosines[anchor, 0] += stiffness * width
    for k in range(1, tables):
        even = (slip.sines[k] - at.sines[p, k]) / k
        odd = (at.cosines[p, k] - slip.cosines[k]) / k
        waves.cosines[k] += stiffness * even
        waves.sines[k] += stiffness * odd
        if anchor >= 0:
            rest.cosines[k] += offset_force * even
            rest.sines[k] += offset_force * odd
            anchored.cosines[anchor, k] += stiffness * even
            anchored.sines[anchor, k] += stiffness * odd


@njit(cache=True)
def add_sliders(
    coefficients: FloatArray,
    orders: IntArray,
    offsets: IntArray,
    corner_angles: FloatArray,
    corner_values: FloatArray,
    jenkins: FloatArray,
    amplitude: float,
    waves: Waves,
    force: FloatArray,
    derivative: FloatArray,
) -> None:
    """Add the Jenkins elements that slip.

    Args:
        amplitude: bound on |w|, m; below its slip displacement an element is left out.
        waves: integrals of the stiffness of the part in proportion to w, added to.
        force: (size,) integrals of all other forces with the basis functions, added to.
        derivative: (size, size) of these by the coefficients, added to; (0, 0) where it is not wanted.
    """
    size, tables = coefficients.size, waves.cosines.size
    count = corner_angles.size - 1
    rest = Waves(np.zeros(tables), np.zeros(tables))
    anchored = Waves(np.zeros((count + 1, tables)), np.zeros((count + 1, tables)))
    at = Waves(np.empty((count + 1, tables)), np.empty((count + 1, tables)))
    slip = Waves(np.empty(tables), np.empty(tables))
    into = SlidingForces(waves, rest, anchored)
    phases = np.empty((count, 4))
    corner_cosines, corner_sines = at.cosines, at.sines
    for p in range(count + 1):
        turn(corner_angles[p], corner_cosines[p], corner_sines[p])
    for e in range(jenkins.shape[0]):
        stiffness = jenkins[e, SLIDER_STIFFNESS]
        limit = jenkins[e, SLIDER_SLIP]
        if stiffness * amplitude <= limit:
            continue
        jenkins_phases(coefficients, orders, offsets, corner_angles, corner_values, stiffness, limit, phases)
        for p in range(count):
            add_phase(phases[p], stiffness, p, corner_angles, at, slip, into)
    integrals = np.zeros(size)
    basis_integrals(rest.cosines, rest.sines, orders, offsets, integrals)
    for i in range(size):
        force[i] += integrals[i]
    anchor_basis = np.zeros(size)
    anchored_cosines, anchored_sines = anchored.cosines, anchored.sines
    for p in range(count + 1 if derivative.size > 0 else 0):
        basis_integrals(anchored_cosines[p], anchored_sines[p], orders, offsets, integrals)
        basis_integrals(corner_cosines[p], corner_sines[p], orders, offsets, anchor_basis)
        for i in range(size):
            for j in range(size):
                derivative[i, j] -= integrals[i] * anchor_basis[j]


@njit(cache=True)
def add_contacts(
    coefficients: FloatArray,
    orders: IntArray,
    offsets: IntArray,
    corner_angles: FloatArray,
    corner_values: FloatArray,
    contacts: FloatArray,
    amplitude: float,
    waves: Waves,
    force: FloatArray,
) -> None:
    """Add the contacts that close; arguments as for `add_sliders`."""
    size, tables = coefficients.size, waves.cosines.size
    piece_cosines, piece_sines, integrals = np.zeros(tables), np.zeros(tables), np.zeros(size)
    for e in range(contacts.shape[0]):
        stiffness = contacts[e, CONTACT_STIFFNESS]
        gap = contacts[e, CONTACT_GAP]
        side = contacts[e, CONTACT_SIDE]
        if amplitude <= gap:
            continue
        for p in range(corner_angles.size - 1):
            left = corner_angles[p]
            right = corner_angles[p + 1]
            before = side * corner_values[p] - gap
            after = side * corner_values[p + 1] - gap
            if before <= 0.0 and after <= 0.0:
                continue
            if before < 0.0 or after < 0.0:
                crossing = level_crossing(
                    coefficients, orders, offsets, left, right, corner_values[p], corner_values[p + 1], side * gap
                )
                if before < 0.0:
                    left = crossing
                else:
                    right = crossing
            add_interval(waves.cosines, waves.sines, left, right, stiffness)
            piece_cosines[:] = 0.0
            piece_sines[:] = 0.0
            add_interval(piece_cosines, piece_sines, left, right, -stiffness * side * gap)
            basis_integrals(piece_cosines, piece_sines, orders, offsets, integrals)
            for i in range(size):
                force[i] += integrals[i]


@njit(cache=True)
def add_piecewise_forces(
    coefficients: FloatArray,
    orders: IntArray,
    offsets: IntArray,
    slope_basis: FloatArray,
    jenkins: FloatArray,
    contacts: FloatArray,
    force: FloatArray,
    derivative: FloatArray,
) -> None:
    """Add the Fourier coefficients of all piecewise linear forces of one local coordinate, and their
    derivative.

    Args:
        coefficients: (size,) real Fourier coefficients of w, m.
        slope_basis: (samples, size) derivatives of the basis functions, to bracket turning points.
        jenkins: (n, 2) tangential stiffness k_t (N/m) and slip force μN (N).
        contacts: (m, 3) stiffness (N/m), gap (m, ≥ 0 in the sense of ``side``) and side (+1 or −1):
            force k (w − gap) for w > gap, or k (w + gap) for w < −gap.
        force: (size,) coefficients in N, added to.
        derivative: (size, size) ∂force/∂coefficients in N/m, added to; (0, 0) where it is not wanted.

    A Jenkins element starts from the virgin curve (g = k_t w, clipped) at the largest |w|; after one period
    its memory is that of the periodic motion.
    """
    size = coefficients.size
    wanted = derivative.size > 0
    tables = 2 * orders[-1] + 1
    waves = Waves(np.zeros(tables), np.zeros(tables))
    raw_derivative = np.zeros((size, size) if wanted else (0, 0))
    raw_force = np.zeros(size)
    amplitude = largest_motion(coefficients, orders, offsets)

    # Bounds on |w| decide the cheap cases: every element sticks, every contact is open.
    slipping = False
    for e in range(jenkins.shape[0]):
        if jenkins[e, SLIDER_STIFFNESS] * amplitude <= jenkins[e, SLIDER_SLIP]:
            waves.cosines[0] += jenkins[e, SLIDER_STIFFNESS] * TWO_PI
        else:
            slipping = True
    touching = False
    for e in range(contacts.shape[0]):
        if amplitude > contacts[e, CONTACT_GAP]:
            touching = True
    if slipping or touching:
        angles, values = corners(coefficients, orders, offsets, slope_basis)
        if slipping:
            add_sliders(
                coefficients, orders, offsets, angles, values, jenkins, amplitude, waves, raw_force, raw_derivative
            )
        if touching:
            add_contacts(coefficients, orders, offsets, angles, values, contacts, amplitude, waves, raw_force)

    # The terms proportional to w share one Gram matrix; the virgin offset terms are already separate.
    gram = np.zeros((size, size))
    add_gram(waves.cosines, waves.sines, orders, offsets, gram)
    for i in range(size):
        scale = 1.0 / np.pi
        if orders[0] == 0 and i == offsets[0]:
            scale = 0.5 / np.pi
        total = raw_force[i]
        for j in range(size):
            total += gram[i, j] * coefficients[j]
            if wanted:
                derivative[i, j] += scale * (gram[i, j] + raw_derivative[i, j])
        force[i] += scale * total
