"""Harmonic balance and continuation for modes with one local cubic spring; it shares no code with the bench.

Mass-normalised modes, a spring at the point c and a force at the point d::

    q̈ + 2 ζ ω q̇ + ω² q + φ_c k₃ (φ_c·q)³ = φ_d F cos(ν τ),    τ = ω_b t

The solution is a Fourier series in τ with odd orders only, which is all that a cubic spring and an odd ν excite. The
force has the order ν, and the condition on the phase is put on the order k of the displacement of the drive point:

    k : ν resonance    θ = k arg F_ν − ν arg x_k    (both for cos; the force itself has the phase 0)

k = ν = 1 is phase resonance (θ = 90°), 3:1 the superharmonic resonance (θ = 270°), 1:3 the subharmonic one
(θ = 90°, i.e. a lag of the subharmonic of 30° modulo 120°). Volvert and Kerschen, Mechanical Systems and Signal
Processing 167 (2022) 108510, give these lags.

Continuation: tangent predictor and Newton corrector on an arc of the scaled unknowns (Keller). Time simulation:
``scipy.integrate.solve_ivp``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve


@dataclass(frozen=True)
class CubicModes:
    """The system.

    Attributes:
        omega: rad/s, (modes,).
        zeta: damping ratios, (modes,).
        spring_shape: φ_c, 1/√kg, (modes,).
        drive_shape: φ_d, 1/√kg, (modes,).
        cubic: k₃, N/m³.
        highest: highest order of the series.
        force_order: ν.
        response_order: k.
    """

    omega: np.ndarray
    zeta: np.ndarray
    spring_shape: np.ndarray
    drive_shape: np.ndarray
    cubic: float
    highest: int = 15
    force_order: int = 1
    response_order: int = 1
    orders: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "orders", np.arange(1, self.highest + 1, 2))

    @cached_property
    def _turns(self) -> np.ndarray:
        """From the series to samples of a period, (samples, orders)."""
        samples = 4 * (self.highest + 1)
        return np.exp(2j * math.pi * np.outer(np.arange(samples), self.orders) / samples)

    # -- equations -----------------------------------------------------------------------------------------------

    def residual(self, series: np.ndarray, omega_b: float, force: float) -> np.ndarray:
        """Of the equations of motion, scaled by the lowest stiffness; ``series`` complex, (orders, modes)."""
        motion = np.real(self._turns @ (series @ self.spring_shape))
        restoring = 2.0 / len(motion) * self._turns.conj().T @ (self.cubic * motion**3)
        w = self.orders[:, None] * omega_b
        result = (self.omega**2 - w**2 + 2j * self.zeta * self.omega * w) * series
        result += np.outer(restoring, self.spring_shape)
        result[np.flatnonzero(self.orders == self.force_order)[0]] -= force * self.drive_shape
        return result / self.omega[0] ** 2

    def lag(self, series: np.ndarray) -> float:
        """θ in rad, in (−π, π]."""
        return -self.force_order * float(np.angle(self.drive_point(series, self.response_order)))

    def drive_point(self, series: np.ndarray, order: int) -> complex:
        """Displacement of the drive point at an order, m."""
        return complex(series[np.flatnonzero(self.orders == order)[0]] @ self.drive_shape)

    def pack(self, series: np.ndarray) -> np.ndarray:
        """Series as real numbers."""
        return np.concatenate([series.real.ravel(), series.imag.ravel()])

    def unpack(self, values: np.ndarray) -> np.ndarray:
        """The inverse."""
        half = values.size // 2
        return (values[:half] + 1j * values[half:]).reshape(self.orders.size, self.omega.size)

    # -- time ----------------------------------------------------------------------------------------------------

    def simulate(
        self, state: np.ndarray, omega_b: float, force: float, periods: int, points: int = 64
    ) -> tuple[np.ndarray, np.ndarray]:
        """Modal coordinates over the last of so many base periods, (points, modes), and the state at the end."""
        modes = self.omega.size

        def slope(time: float, y: np.ndarray) -> np.ndarray:
            q, v = y[:modes], y[modes:]
            spring = self.cubic * (self.spring_shape @ q) ** 3
            drive = force * math.cos(self.force_order * omega_b * time)
            return np.concatenate(
                [v, self.drive_shape * drive - self.spring_shape * spring - 2 * self.zeta * self.omega * v
                 - self.omega**2 * q]
            )  # fmt: skip

        end = 2.0 * math.pi * periods / omega_b
        begin = 2.0 * math.pi * (periods - 1) / omega_b
        times = np.append(begin + (end - begin) * np.arange(points) / points, end)
        solution = solve_ivp(
            slope, (0.0, end), state, "DOP853", times, rtol=1e-9, atol=1e-13 + 1e-10 * abs(state).max()
        )
        return solution.y[:modes, :-1].T, solution.y[:, -1]

    def start_state(self, series: np.ndarray, omega_b: float) -> np.ndarray:
        """Coordinates and velocities at τ = 0."""
        velocity = (1j * self.orders[:, None] * omega_b * series).real.sum(axis=0)
        return np.concatenate([series.real.sum(axis=0), velocity])


@dataclass
class Solution:
    """One periodic solution: series (orders, modes), base frequency (rad/s), force (N)."""

    series: np.ndarray
    omega_b: float
    force: float


def newton(function: Callable[[np.ndarray], np.ndarray], start: np.ndarray, steps: int = 25) -> np.ndarray | None:
    """Root of a scaled function with a Jacobian by differences; None where it is not found."""
    x = start.copy()
    for _ in range(steps):
        value = function(x)
        if not np.isfinite(value).all():
            return None
        step = np.linalg.solve(jacobian(function, x, value), -value)
        x = x + step
        if np.linalg.norm(step) < 1e-9:
            return x
    return None


def jacobian(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray, value: np.ndarray) -> np.ndarray:
    """By forward differences of the scaled unknowns."""
    step = 1e-7
    columns = [(function(x + step * unit) - value) / step for unit in np.eye(x.size)]
    return np.array(columns).T


class PhaseBranch:
    """Solutions with the lag θ held, as a curve over the force.

    Args:
        system: the system.
        lag_deg: θ.
        length: m√kg, unit of the scaled series.
    """

    def __init__(self, system: CubicModes, lag_deg: float, length: float) -> None:
        self.system = system
        self.turn = np.exp(1j * math.radians(lag_deg))
        self.length = length

    def function(self, x: np.ndarray) -> np.ndarray:
        """Scaled residual and condition of x = [series / length, ω_b / ω₁, ln F]."""
        system = self.system
        series = system.unpack(x[:-2]) * self.length
        value = system.residual(series, x[-2] * system.omega[0], math.exp(x[-1])) / self.length
        held = np.conj(system.drive_point(series, system.response_order)) ** system.force_order
        # θ is held where held · e^{−iθ} is real and positive.
        return np.append(system.pack(value), (held / abs(held) / self.turn).imag)

    def pack(self, solution: Solution) -> np.ndarray:
        """The unknowns of a solution."""
        system = self.system
        return np.concatenate(
            [system.pack(solution.series) / self.length, [solution.omega_b / system.omega[0], math.log(solution.force)]]
        )

    def unpack(self, x: np.ndarray) -> Solution:
        """The solution of the unknowns."""
        return Solution(
            self.system.unpack(x[:-2]) * self.length, float(x[-2] * self.system.omega[0]), math.exp(float(x[-1]))
        )

    def at_force(self, guess: Solution, force: float) -> Solution:
        """The solution at a force near a guess.

        Raises:
            ArithmeticError: there is none near.
        """
        x = newton(lambda y: np.append(self.function(y), y[-1] - math.log(force)), self.pack(guess))
        if x is None:
            raise ArithmeticError(f"no solution at {force:g} N")
        return self.unpack(x)

    def at_amplitude(self, guess: Solution, amplitude: float) -> Solution:
        """The solution at an amplitude (m) of the held order of the drive point near a guess; errors as above."""
        system = self.system

        def function(x: np.ndarray) -> np.ndarray:
            size = abs(system.drive_point(system.unpack(x[:-2]) * self.length, system.response_order))
            return np.append(self.function(x), (size - amplitude) / self.length)

        x = newton(function, self.pack(guess))
        if x is None:
            raise ArithmeticError(f"no solution at {amplitude:g} m")
        return self.unpack(x)

    def follow(
        self, start: Solution, step: float, until: Callable[[Solution], bool], most: int = 2000
    ) -> list[Solution]:
        """Solutions along the curve, ``step`` > 0 towards higher force at first; ends where ``until`` is true."""
        x = self.pack(start)
        corrected = newton(lambda y: np.append(self.function(y), y[-1] - x[-1]), x)
        if corrected is None:
            raise ArithmeticError("no solution at the start")
        x = corrected
        direction = np.zeros(x.size)
        direction[-1] = math.copysign(1.0, step)
        found, length = [self.unpack(x)], abs(step)
        for _ in range(most):
            slopes = jacobian(self.function, x, self.function(x))
            tangent = np.linalg.svd(slopes)[2][-1]
            tangent *= math.copysign(1.0, float(tangent @ direction))
            while True:
                guess = x + length * tangent
                y = newton(lambda z, g=guess, t=tangent: np.append(self.function(z), (z - g) @ t), guess, 8)
                if y is not None and np.linalg.norm(y - guess) < 0.5 * length:
                    break
                length *= 0.5
                if length < 1e-7:
                    return found
            x, direction = y, tangent
            length = min(length * 1.3, abs(step))
            found.append(self.unpack(x))
            if until(found[-1]):
                break
        return found


def response_curve(system: CubicModes, start: Solution, frequencies: Sequence[float]) -> list[Solution]:
    """Solutions at a constant force over base frequencies (rad/s), each from the one before."""
    found, series = [], start.series
    scale = abs(series).max()
    for omega_b in frequencies:
        values, _, status, _ = fsolve(
            lambda y, w=omega_b: system.pack(system.residual(system.unpack(y) * scale, w, start.force)) / scale,
            system.pack(series) / scale,
            full_output=True,
        )
        if status != 1:
            break
        series = system.unpack(values) * scale
        found.append(Solution(series, float(omega_b), start.force))
    return found
