"""Nonlinear modes of a structure with one friction element, by harmonic balance at that element alone.

It shares no code with the bench. The extended periodic motion concept asks for periodic motions of

    M ẍ + C ẋ + K x + d f(w) − ξ M ẋ = 0,   w = dᵀ x.

For a harmonic n of w the linear part is a number, the receptance Y_n = dᵀ (K + i n ω (C − ξ M) − n² ω² M)⁻¹ d, so that

    w_n / Y_n + f_n(w) = 0

for all odd n are the only equations. w_1 is prescribed and real; ω, ξ and the other w_n are found by Newton's method
with a Jacobian by differences. f is an elastic Coulomb element whose slider is followed over two periods.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class NonlinearMode:
    """One motion: ω (rad/s), ξ (rad/s), modal amplitude q (m √kg) and the fundamental's shape ψ_1 (n,) in m."""

    omega: float
    self_excitation: float
    amplitude: float
    shape: np.ndarray

    @property
    def damping_ratio(self) -> float:
        """δ̃ = ξ / (2 ω)."""
        return self.self_excitation / (2.0 * self.omega)


def coulomb_force(w: np.ndarray, stiffness: float, limit: float) -> np.ndarray:
    """Force of the element over the second of two periods of w, samples of one period."""
    reach = limit / stiffness
    slider = 0.0
    values = w.tolist()
    force = np.empty(w.size)
    for turn in range(2):
        for k, value in enumerate(values):
            if value - slider > reach:
                slider = value - reach
            elif value - slider < -reach:
                slider = value + reach
            if turn:
                force[k] = stiffness * (value - slider)
    return force


def nonlinear_modes(
    mass: np.ndarray,
    damping: np.ndarray,
    stiffness: np.ndarray,
    direction: np.ndarray,
    tangential_stiffness: float,
    slip_force: float,
    displacements: np.ndarray,
    start: tuple[float, float],
    highest: int = 15,
    samples: int = 1024,
    tolerance: float = 1e-11,
) -> list[NonlinearMode]:
    """Motions of growing w_1.

    Args:
        mass, damping, stiffness: of the structure without the element.
        direction: d.
        tangential_stiffness, slip_force: of the element, N/m and N.
        displacements: amplitudes w_1, m, ascending from one at which the element sticks.
        start: ω (rad/s) and δ̃ of the mode with the element sticking.
        highest: highest (odd) harmonic.
        samples: of a period.
        tolerance: of the balance over the element's force; near the onset of sliding the samples leave some.
    """
    orders = np.arange(1, highest + 1, 2)
    theta = 2.0 * np.pi * np.arange(samples) / samples
    waves = np.exp(1j * np.outer(orders, theta))

    def receptance(order: int, omega: float, xi: float) -> np.ndarray:
        s = 1j * order * omega
        return np.linalg.solve(stiffness + s * (damping - xi * mass) + s * s * mass, direction.astype(complex))

    def element(w: np.ndarray) -> np.ndarray:
        force = coulomb_force((w @ waves).real, tangential_stiffness, slip_force)
        harmonics: np.ndarray = 2.0 * (waves.conj() @ force) / samples
        return harmonics

    def unpack(unknowns: np.ndarray, w1: float) -> tuple[float, float, np.ndarray]:
        rest = unknowns[2::2] + 1j * unknowns[3::2]
        return unknowns[0] * start[0], unknowns[1] * start[0], w1 * np.concatenate([[1.0], rest])

    def residual(unknowns: np.ndarray, w1: float) -> np.ndarray:
        omega, xi, w = unpack(unknowns, w1)
        inverse = np.array([1.0 / (direction @ receptance(int(n), omega, xi)) for n in orders])
        balance = (w * inverse + element(w)) / (tangential_stiffness * w1)
        return np.column_stack([balance.real, balance.imag]).ravel()

    unknowns = np.zeros(2 * orders.size)
    unknowns[0], unknowns[1] = 1.0, 2.0 * start[1]
    steps = np.full(unknowns.size, 1e-7)
    found = []
    for w1 in displacements:
        for _ in range(40):
            here = residual(unknowns, w1)
            if np.abs(here).max() < tolerance:
                break
            jacobian = np.empty((unknowns.size, unknowns.size))
            for k, step in enumerate(steps):
                moved = unknowns.copy()
                moved[k] += step
                jacobian[:, k] = (residual(moved, w1) - here) / step
            unknowns = unknowns - np.linalg.solve(jacobian, here)
        else:
            raise ArithmeticError(f"no motion at w_1 = {w1}")
        omega, xi, w = unpack(unknowns, w1)
        shape = -receptance(1, omega, xi) * element(w)[0]
        amplitude = float(np.sqrt((shape.conj() @ mass @ shape).real))
        found.append(NonlinearMode(float(omega), float(xi), amplitude, shape))
    return found
