"""Terms of local laws: forces of a unit coefficient along a given periodic motion, and their harmonics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.law.modal_frame import ORDERS

LEFT_SHARE = 0.01
"""Of the force of weakening bristles that high speeds leave; without it they would not hold on to anything there."""
SAMPLES = 512
"""A period's samples: forces with corners have aliases below 1e-4 of their size in the orders that are kept."""


@dataclass(frozen=True)
class Term:
    """One term of a law; its force is a coefficient times :func:`force`.

    Attributes:
        kind: of the formula.
        first, second: its parameters, see :func:`force`.
        signed: whether its coefficient may be negative.
    """

    kind: str
    first: float = 0.0
    second: float = 0.0

    @property
    def signed(self) -> bool:
        """Polynomials of the displacement may soften; all else is passive by coefficients that are not negative."""
        return self.kind == "power"

    @property
    def unit(self) -> str:
        """Unit of the coefficient."""
        return _UNITS[self.kind] if self.kind in _UNITS else _power_unit(self)

    def force(self, x: FloatArray, v: FloatArray) -> FloatArray:
        """Force (…, SAMPLES) of a unit coefficient along one period of displacement (m) and velocity (m/s)."""
        a, b = self.first, self.second
        if self.kind == "power":
            return np.asarray(x**a)
        if self.kind == "gap":
            return np.asarray(x - np.clip(x, -a, a))
        if self.kind == "gap damping":
            return np.asarray(np.where(np.abs(x) > a, v, 0.0))
        if self.kind == "stop":
            return np.asarray(np.sign(b) * np.maximum(np.sign(b) * x - a, 0.0))
        if self.kind == "stop damping":
            return np.asarray(np.where(np.sign(b) * x > a, v, 0.0))
        if self.kind == "slider":
            return slider_force(x, a)
        if self.kind == "slack slider":
            # The spring before the slider has a slack of a share of its slip displacement: loops narrow about no force.
            behind = slider_force(x, a)
            return np.asarray(behind - np.clip(behind, -b * a, b * a))
        if self.kind == "bristle":
            return bristle_force(x, np.full_like(x, a))
        if self.kind == "weakening bristle":
            return bristle_force(x, a * (LEFT_SHARE + (1.0 - LEFT_SHARE) * np.exp(-((v / b) ** 2))))
        if self.kind == "speed":
            return np.asarray(np.abs(v) ** a * np.sign(v))
        if self.kind == "amplitude":
            return np.asarray(np.abs(x) ** a * v)
        if self.kind == "friction":
            return np.asarray(np.tanh(v / a))
        if self.kind == "weakening friction":
            return np.asarray(np.tanh(v / a) * np.exp(-((v / b) ** 2)))
        if self.kind == "brake":
            return np.asarray(v / (1.0 + (v / a) ** 2))
        raise ValueError(f"there is no term of kind {self.kind}")


_UNITS = {
    "gap": "N/m", "stop": "N/m", "gap damping": "N s/m", "stop damping": "N s/m", "slider": "N/m", "friction": "N",
    "weakening friction": "N", "brake": "N s/m", "slack slider": "N/m", "bristle": "N/m", "weakening bristle": "N/m",
}  # fmt: skip


def _power_unit(term: Term) -> str:
    power = f"{term.first:g}"
    if term.kind == "power":
        return f"N/m^{power}"
    return f"N (s/m)^{power}" if term.kind == "speed" else f"N s/m^{term.first + 1.0:g}"


def slider_force(x: FloatArray, slip: float) -> FloatArray:
    """Force of a spring of 1 N/m in series with a slider that yields at a displacement, on its closed loop.

    Args:
        x: one period of the displacement, m, (…, n).
        slip: slip displacement, m.
    """
    flat = np.ascontiguousarray(x.reshape(-1, x.shape[-1]))
    loops: FloatArray = _slider_loops(flat, slip)
    return loops.reshape(x.shape)


@njit(cache=True)
def _slider_loops(x: FloatArray, slip: float) -> FloatArray:
    """Spring force behind the slider, row by row."""
    result = np.empty_like(x)
    for row in range(x.shape[0]):
        at = 0.0
        # The second period is the closed loop: a slider forgets its start at the first full slip.
        for turn in range(2):
            for k in range(x.shape[1]):
                at = min(max(at, x[row, k] - slip), x[row, k] + slip)
                if turn == 1:
                    result[row, k] = x[row, k] - at
    return result


def bristle_force(x: FloatArray, reach: FloatArray) -> FloatArray:
    """Force z of bristles of 1 N/m on its closed loop: dz/dx = 1 − z sgn(v) / reach.

    Constant reach is Dahl's law, one that falls with speed the bristles of Canudas de Wit et al. (IEEE Trans. Automat.
    Contr. 40, 1995) without their damping. Between samples the reach is constant; the loop is affine in its start.

    Args:
        x: one period of the displacement, m, (…, n).
        reach: deflection of the bristles while they slide, m, (…, n).
    """
    flat = (np.ascontiguousarray(part.reshape(-1, x.shape[-1])) for part in (x, reach))
    loops: FloatArray = _bristle_loops(*flat)
    return loops.reshape(x.shape)


@njit(cache=True)
def _bristle_loops(x: FloatArray, reach: FloatArray) -> FloatArray:
    """Deflection of the bristles, row by row."""
    result = np.empty_like(x)
    count = x.shape[1]
    for row in range(x.shape[0]):
        at, kept = 0.0, 1.0
        # A period from zero and what it keeps of a start give the start that a period comes back to.
        for turn in range(2):
            if turn == 1:
                at = at / (1.0 - kept) if kept < 1.0 else 0.0
            for k in range(count):
                result[row, k] = at
                after = (k + 1) % count
                way = x[row, after] - x[row, k]
                full = 0.5 * (reach[row, after] + reach[row, k])
                full = full if way > 0.0 else -full
                share = np.exp(-abs(way / full))
                at = full + (at - full) * share
                if turn == 0:
                    kept *= share
    return result


def sampled(motion: ComplexArray, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Displacement and velocity (L, SAMPLES) of harmonics (L, ORDERS + 1)."""
    angles = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
    turns = np.exp(1j * np.arange(ORDERS + 1)[:, np.newaxis] * angles)
    x = (motion @ turns).real
    v = ((1j * omega[:, np.newaxis] * np.arange(ORDERS + 1) * motion) @ turns).real
    return x, v


def harmonics(force: FloatArray) -> ComplexArray:
    """Orders 0 … ORDERS (…, ORDERS + 1) of forces over one period (…, SAMPLES)."""
    found = np.fft.rfft(force, axis=-1)[..., : ORDERS + 1] * (2.0 / SAMPLES)
    found[..., 0] *= 0.5
    return np.asarray(found)
