"""Time integration of a structure by its modes, each with a damping ratio of its own, and local nonlinear forces.

It shares no code with the bench. With mass-normalised modes and w = φₑ·q the displacement of an element's point::

    q̈ + 2 ζ ω q̇ + ω² q = b s(t) − Σ φₑ gₑ(w, ẇ, …)

is integrated by the method of Dormand and Prince (J. Comput. Appl. Math. 6 (1980) 19) with its weights of fifth order
at a fixed step. Sliders (Jenkins elements) are held over a step and follow at its end, so that a return inside a step
costs an error of second order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

FORCE, TRACKED, PULSE = 0, 1, 2
"""Drives: a sine; a force in phase with the velocity of its point; a half sine."""

KINDS = {
    "cubic": 0, "quintic": 1, "drag": 2, "amplitude_damper": 3, "stop": 4, "gap": 5, "sliders": 6, "stribeck": 7,
    "lugre": 8, "bouc_wen": 9, "backlash": 10, "eddy_brake": 11, "damper": 12, "polynomial": 13, "magnet": 14,
    "pinched": 15,
}  # fmt: skip
_PARAMETERS = 6


@dataclass(frozen=True)
class Element:
    """A force gₑ that acts against the motion of one point.

    Attributes:
        kind: one of ``KINDS``; SI units:
            cubic k (g = k w³); quintic k (k w⁵); drag c (c v|v|); amplitude_damper c (c w² v); damper c (c v);
            stop k, gap (k max(w − gap, 0)); gap k, gap (the same on both sides);
            sliders (Jenkins elements side by side, see ``sliders``);
            stribeck force, regularisation velocity, excess, its velocity
            (g = F tanh(v/v_r) (1 + e exp(−(v/v_s)²)));
            lugre σ₀, σ₁, Coulomb force, static force, Stribeck velocity
            (g = σ₀ z + σ₁ ż, ż = v − σ₀ |v| z / s(v), s = F_C + (F_S − F_C) exp(−(v/v_s)²));
            bouc_wen k, yield displacement, exponent, post-yield ratio
            (g = k (a w + (1 − a) z), ż = v (1 − |z/z_y|ⁿ (1 + sign(v z)) / 2));
            backlash k, gap, λ (|g| = max(e (k + λ ė), 0), e = |w| − gap);
            eddy_brake c, critical velocity (c v / (1 + (v/v_c)²));
            polynomial k, k₂, k₃, k₅ (k w + k₂ w² + k₃ w³ + k₅ w⁵);
            magnet κ, distance (between two of them: κ ((d − w)⁻² − (d + w)⁻²) without its linear part);
            pinched k, yield displacement, exponent, p, z_p (bouc_wen without post-yield stiffness whose ż is divided by
            1 + p exp(−(z/z_p)²): loops that are narrow about zero).
        shape: φₑ, 1/√kg, (modes,).
        parameters: as above.
        sliders: stiffness (N/m) and slip force (N) of each.
    """

    kind: str
    shape: np.ndarray
    parameters: tuple[float, ...] = ()
    sliders: tuple[tuple[float, float], ...] = ()


def iwan(stiffness: float, slip: float, number: int = 25) -> tuple[tuple[float, float], ...]:
    """Sliders of equal stiffness whose slip displacements are spread evenly up to ``slip``, m."""
    each = stiffness / number
    return tuple((each, each * slip * (j + 0.5) / number) for j in range(number))


@njit(cache=True, error_model="numpy")
def _rates(
    y: Any, s: Any, omega2: Any, damping: Any, b: Any, kinds: Any, shapes: Any, p: Any, stiff: Any, limit: Any,
    at: Any, out: Any, forces: Any,
) -> None:  # fmt: skip
    """State derivative; ``forces`` gets gₑ."""
    n, elements = omega2.size, kinds.size
    for r in range(n):
        out[r] = y[n + r]
        out[n + r] = b[r] * s - omega2[r] * y[r] - damping[r] * y[n + r]
    for e in range(elements):
        w = v = 0.0
        for r in range(n):
            w += shapes[e, r] * y[r]
            v += shapes[e, r] * y[n + r]
        z = y[2 * n + e]
        rate, g, kind = 0.0, 0.0, kinds[e]
        a0, a1, a2, a3, a4 = p[e, 0], p[e, 1], p[e, 2], p[e, 3], p[e, 4]
        if kind == 0:
            g = a0 * w * w * w
        elif kind == 1:
            g = a0 * w**5
        elif kind == 2:
            g = a0 * v * abs(v)
        elif kind == 3:
            g = a0 * w * w * v
        elif kind == 4:
            g = a0 * max(w - a1, 0.0)
        elif kind == 5:
            g = a0 * (max(w - a1, 0.0) + min(w + a1, 0.0))
        elif kind == 6:
            for j in range(stiff.shape[1]):
                force = stiff[e, j] * (w - at[e, j])
                g += min(max(force, -limit[e, j]), limit[e, j])
        elif kind == 7:
            g = a0 * math.tanh(v / a1) * (1.0 + a2 * math.exp(-((v / a3) ** 2)))
        elif kind == 8:
            level = a2 + (a3 - a2) * math.exp(-((v / a4) ** 2))
            rate = v - a0 * abs(v) * z / level
            g = a0 * z + a1 * rate
        elif kind == 9:
            turned = 1.0 if v * z > 0.0 else 0.0
            rate = v * (1.0 - abs(z / a1) ** a2 * turned)
            g = a0 * (a3 * w + (1.0 - a3) * z)
        elif kind == 10:
            if w > a1:
                g = max((w - a1) * (a0 + a2 * v), 0.0)
            elif w < -a1:
                g = -max((-w - a1) * (a0 - a2 * v), 0.0)
        elif kind == 11:
            g = a0 * v / (1.0 + (v / a1) ** 2)
        elif kind == 12:
            g = a0 * v
        elif kind == 13:
            g = a0 * w + a1 * w * w + a2 * w * w * w + a3 * w**5
        elif kind == 14:
            g = a0 * (1.0 / (a1 - w) ** 2 - 1.0 / (a1 + w) ** 2 - 4.0 * w / a1**3)
        elif kind == 15:
            turned = 1.0 if v * z > 0.0 else 0.0
            rate = v * (1.0 - abs(z / a1) ** a2 * turned) / (1.0 + a3 * math.exp(-((z / a4) ** 2)))
            g = a0 * z
        forces[e] = g
        out[2 * n + e] = rate
        for r in range(n):
            out[n + r] -= shapes[e, r] * g


@njit(cache=True, error_model="numpy")
def _drive(
    kind: int, y: Any, n: int, t: float, size: float, growth: float, phase: float, omega: float, length: float
) -> Any:
    """Value of the drive at a time t since the call."""
    if kind == 0:
        return (size + growth * t) * math.cos(phase + omega * t)
    if kind == 1:
        filtered, rate = y[y.size - 2], y[y.size - 1]
        speed = math.sqrt(filtered**2 + (rate / omega) ** 2)
        return size * filtered / speed if speed > 0.0 else size
    return size * math.sin(math.pi * t / length) if 0.0 < t < length else 0.0


_NODES = np.array([0.0, 0.2, 0.3, 0.8, 8.0 / 9.0, 1.0])
_STAGES = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [1.0 / 5.0, 0.0, 0.0, 0.0, 0.0],
        [3.0 / 40.0, 9.0 / 40.0, 0.0, 0.0, 0.0],
        [44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0, 0.0, 0.0],
        [19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0, 0.0],
        [9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0],
    ]
)
_WEIGHTS = np.array([35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0])


@njit(cache=True, error_model="numpy")
def _advance(
    y: Any, at: Any, steps: int, every: int, h: float, drive: int, size: float, growth: float, phase: float,
    omega: float, length: float, omega2: Any, damping: Any, b: Any, kinds: Any, shapes: Any, p: Any, stiff: Any,
    limit: Any, out: Any, forces_out: Any,
) -> None:  # fmt: skip
    """Integrate; every so many steps a row of q, q̇, q̈, s and of gₑ as they are at the step's beginning."""
    n, size_y, elements = omega2.size, y.size, kinds.size
    k, x, forces = np.zeros((6, size_y)), np.empty(size_y), np.empty(max(elements, 1))
    for i in range(steps):
        t = i * h
        for stage in range(6):
            for c in range(size_y):
                moved = 0.0
                for j in range(stage):
                    moved += _STAGES[stage, j] * k[j, c]
                x[c] = y[c] + h * moved
            s = _drive(drive, x, n, t + _NODES[stage] * h, size, growth, phase, omega, length)
            _rates(x, s, omega2, damping, b, kinds, shapes, p, stiff, limit, at, k[stage], forces)
            if drive == 1:
                # A band-pass of damping ratio 0.3 at the motion's frequency keeps other modes from feeding themselves.
                turned = -(omega**2) * x[size_y - 2] - 0.6 * omega * x[size_y - 1]
                for r in range(n):
                    turned += 0.6 * omega * b[r] * k[stage, n + r]
                k[stage, size_y - 2], k[stage, size_y - 1] = x[size_y - 1], turned
            if stage == 0 and i % every == 0:
                row = i // every
                for r in range(n):
                    out[row, r], out[row, n + r], out[row, 2 * n + r] = y[r], y[n + r], k[0, n + r]
                out[row, 3 * n] = s
                for e in range(elements):
                    forces_out[row, e] = forces[e]
        for c in range(size_y):
            for j in range(6):
                y[c] += h * _WEIGHTS[j] * k[j, c]
        for e in range(elements):
            if kinds[e] == 6:
                w = 0.0
                for r in range(n):
                    w += shapes[e, r] * y[r]
                for j in range(stiff.shape[1]):
                    if stiff[e, j] > 0.0:
                        slip = limit[e, j] / stiff[e, j]
                        at[e, j] = min(max(at[e, j], w - slip), w + slip)


class Simulator:
    """A structure at rest, driven piece by piece.

    Args:
        frequencies_hz: of the undamped modes, (modes,).
        ratios: their damping ratios, (modes,).
        load: b, what the drive does to each mode, (modes,): 1/√kg for a force, −Γ for a table.
        elements: local forces.
        steps: of the integration in a period of the highest mode, at least; and ``fine`` in one of the first.
    """

    def __init__(
        self,
        frequencies_hz: np.ndarray,
        ratios: np.ndarray,
        load: np.ndarray,
        elements: Sequence[Element] = (),
        steps: int = 12,
        fine: int = 160,
    ) -> None:
        omega = 2.0 * np.pi * np.asarray(frequencies_hz, dtype=float)
        self.modes = omega.size
        self._omega2, self._damping = omega**2, 2.0 * np.asarray(ratios, dtype=float) * omega
        self._load = np.array(load, dtype=float)
        count, width = len(elements), max((len(e.sliders) for e in elements), default=0) or 1
        self._kinds = np.array([KINDS[e.kind] for e in elements], dtype=np.int64)
        self._shapes = np.array([e.shape for e in elements], dtype=float).reshape(count, self.modes)
        self._parameters = np.zeros((count, _PARAMETERS))
        self._stiff, self._limit, self._at = (
            np.zeros((count, width)),
            np.zeros((count, width)),
            np.zeros((count, width)),
        )
        for i, element in enumerate(elements):
            self._parameters[i, : len(element.parameters)] = element.parameters
            for j, (stiffness, force) in enumerate(element.sliders):
                self._stiff[i, j], self._limit[i, j] = stiffness, force
        self.state = np.zeros(2 * self.modes + count + 2)
        self.phase = 0.0
        self.size = 0.0
        self._step = min(1.0 / (steps * frequencies_hz[-1]), 1.0 / (fine * frequencies_hz[0]))

    def sine(
        self, size: float, frequency_hz: float, periods: int, per_period: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Whole periods of a sine, the amplitude going there from the last one along a line, the phase going on.

        Args:
            size: amplitude at the end.
            frequency_hz: of the drive.
            periods: how many.
            per_period: rows for each; 0 = one.

        Returns:
            Rows of q, q̇, q̈, s, (rows, 3 modes + 1), and forces gₑ, (rows, elements).
        """
        rows = per_period or 1
        each = math.ceil(1.0 / (frequency_hz * self._step * rows))
        h = 1.0 / (frequency_hz * rows * each)
        before, self.size = self.size, size
        duration = periods / frequency_hz
        return self._run(FORCE, periods * rows * each, each, h, before, (size - before) / duration, frequency_hz)

    def tracked(self, size: float, frequency_hz: float, rows: int, rate: float) -> tuple[np.ndarray, np.ndarray]:
        """A force of this amplitude in phase with the velocity of its point, which moves at this frequency."""
        each = math.ceil(1.0 / (rate * self._step))
        return self._run(TRACKED, rows * each, each, 1.0 / (rate * each), size, 0.0, frequency_hz)

    def tap(self, size: float, length: float, rows: int, rate: float) -> tuple[np.ndarray, np.ndarray]:
        """A half sine of this amplitude and length (s), and what follows, at a sampling rate in Hz."""
        each = math.ceil(1.0 / (rate * self._step))
        return self._run(PULSE, rows * each, each, 1.0 / (rate * each), size, 0.0, 0.0, length)

    def _run(
        self,
        kind: int,
        steps: int,
        every: int,
        h: float,
        size: float,
        growth: float,
        frequency_hz: float,
        length: float = 1.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        rows = -(-steps // every)
        out, forces = np.empty((rows, 3 * self.modes + 1)), np.empty((rows, self._kinds.size))
        omega = 2.0 * np.pi * frequency_hz
        _advance(
            self.state, self._at, steps, every, h, kind, size, growth, self.phase, omega, length, self._omega2,
            self._damping, self._load, self._kinds, self._shapes, self._parameters, self._stiff, self._limit, out,
            forces,
        )  # fmt: skip
        if kind == FORCE:
            self.phase = (self.phase + omega * steps * h) % (2.0 * np.pi)
        if not np.all(np.isfinite(self.state)):
            raise FloatingPointError("The motion grew beyond all bounds; a force has the wrong sign.")
        return out, forces


def fundamental(signal: np.ndarray, periods: int) -> complex:
    """Complex amplitude of the fundamental of rows over whole periods; cos is real."""
    turn = np.exp(-2j * np.pi * periods * np.arange(signal.shape[0]) / signal.shape[0])
    return complex(2.0 * np.mean(signal * turn))
