"""Nonlinear modes of lumped masses with one cubic spring, by harmonic balance of all masses and arclength.

It shares no code with the bench. The extended periodic motion concept asks for periodic motions of

    M ẍ + C ẋ + K x + d k₃ (dᵀx)³ − ξ M ẋ = 0.

Unknown are all odd harmonics of all masses, ω and ξ; the motion's phase and a step along the branch close the system.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class NonlinearMode:
    """One motion: ω (rad/s), δ̃, modal amplitude q (m √kg) and the fundamental's shape ψ_1 (n,) in m."""

    omega: float
    damping_ratio: float
    amplitude: float
    shape: np.ndarray


class Masses:
    """Three matrices (n, n), direction d (n,) and k₃ in N/m³ of the spring."""

    def __init__(self, mass, damping, stiffness, direction, cubic, highest=5, samples=64):
        self.mass, self.damping, self.stiffness = mass, damping, stiffness
        self.direction, self.cubic = direction, cubic
        self.orders = np.arange(1, highest + 1, 2)
        self.waves = np.exp(1j * np.outer(self.orders, 2.0 * np.pi * np.arange(samples) / samples))

    def modes(self, mode: int, until: float, step: float = 0.03) -> list[NonlinearMode]:
        """The branch of a linear mode (from 0) up to a modal amplitude, m √kg."""
        squares, shapes = np.linalg.eigh(_whitened(self.stiffness, self.mass))
        shape = _root_inverse(self.mass) @ shapes[:, mode]
        omega = float(np.sqrt(squares[mode]))
        self.size = np.array([omega, omega])
        small = 1e-3 * until
        x = np.zeros((self.orders.size, shape.size), complex)
        x[0] = shape
        damping = float(shape @ self.damping @ shape)
        point = np.concatenate([x.real.ravel(), x.imag.ravel(), [1.0, damping / omega, np.log(small)]])
        direction = np.zeros(point.size)
        direction[-1] = 1.0
        found = []
        while True:
            point = self._corrected(point + (step * direction if found else 0.0), direction)
            found.append(self._mode(point))
            if found[-1].amplitude > until:
                return found
            jacobian = np.vstack([self._jacobian(point), direction])
            tangent = np.linalg.solve(jacobian, np.eye(point.size)[-1])
            direction = tangent / np.linalg.norm(tangent)

    def _series(self, point):
        half = (point.size - 3) // 2
        return (point[:half] + 1j * point[half:-3]).reshape(self.orders.size, -1), *point[-3:]

    def _mode(self, point) -> NonlinearMode:
        x, omega, xi, log = self._series(point)
        shape = x[0] * np.exp(log)
        amplitude = float(np.sqrt((shape.conj() @ self.mass @ shape).real))
        return NonlinearMode(omega * self.size[0], 0.5 * xi / omega, amplitude, shape)

    def _residual(self, point):
        x, omega, xi, log = self._series(point)
        w, scale = omega * self.size[0], np.exp(log)
        relative = (x @ self.direction @ self.waves).real
        force = 2.0 / relative.size * (self.waves.conj() @ (self.cubic * scale**2 * relative**3))
        left = []
        for n, row, pull in zip(self.orders, x, force, strict=True):
            s = 1j * n * w
            matrix = s * s * self.mass + s * (self.damping - xi * self.size[1] * self.mass) + self.stiffness
            left.append(matrix @ row + self.direction * pull)
        balance = np.concatenate(left) / self.size[0] ** 2
        norm = (x[0].conj() @ self.mass @ x[0]).real - 1.0
        return np.concatenate([balance.real, balance.imag, [norm, (x[0] * self.anchor).imag.sum()]])

    def _jacobian(self, point):
        self.anchor = self._series(point)[0][0].real
        here = np.eye(point.size) * 1e-6
        return np.stack([(self._residual(point + d) - self._residual(point - d)) / 2e-6 for d in here], axis=1)

    def _corrected(self, start, direction):
        self.anchor = self._series(start)[0][0].real
        point = start.copy()
        for _ in range(30):
            left = np.concatenate([self._residual(point), [direction @ (point - start)]])
            if np.abs(left).max() < 1e-11:
                return point
            anchor = self.anchor
            jacobian = self._jacobian(point)
            self.anchor = anchor
            point = point - np.linalg.solve(np.vstack([jacobian, direction]), left)
        raise ArithmeticError("no motion found")


def _root_inverse(mass):
    return np.diag(np.diag(mass) ** -0.5)


def _whitened(matrix, mass):
    return _root_inverse(mass) @ matrix @ _root_inverse(mass)
