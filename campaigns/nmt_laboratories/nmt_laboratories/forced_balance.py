"""Forced responses of a structure with one local element, by harmonic balance at that element alone.

It shares no code with the bench. The structure has the receptances Y_ab(n) = aᵀ (K + i n ω C − n² ω² M)⁻¹ b; a force
F_n acts along d and the element along c, with the force g(w, v) of its displacement w = cᵀ x and velocity. For the odd
harmonics n

    w_n = Y_cd(n) F_n − Y_cc(n) g_n,    x_n = Y_dd(n) F_n − Y_dc(n) g_n.

The unknowns are w_n and ω, the condition is the lag ϑ of x₁ behind F₁, which has the phase 0. Newton's method with a
Jacobian by differences. ``simulate`` integrates the same equations over time with ``scipy.integrate.solve_ivp``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares, minimize_scalar

Law = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Force (N) of the element from samples of w (m) and v (m/s) over one period."""


@dataclass(frozen=True)
class Orbit:
    """A periodic response: ω in rad/s, harmonics (m) of the element (orders,) and of the drive point (orders,)."""

    omega: float
    local: np.ndarray
    drive: np.ndarray

    @property
    def response(self) -> float:
        """|x₁| at the drive point, m."""
        return float(abs(self.drive[0]))


@dataclass(frozen=True)
class OneElement:
    """A structure with one local element.

    Attributes:
        mass, damping, stiffness: (n, n).
        local: c, (n,).
        driven: d, (n,).
        law: of the element.
        highest: highest odd order.
        samples: of a period.
    """

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    local: np.ndarray
    driven: np.ndarray
    law: Law
    highest: int = 15
    samples: int = 512

    @property
    def orders(self) -> np.ndarray:
        """1, 3, …"""
        return np.arange(1, self.highest + 1, 2)

    def receptances(self, omega: float) -> np.ndarray:
        """Y_cc, Y_cd, Y_dd of each order, (3, orders)."""
        s = 1j * self.orders[:, None, None] * omega
        sides = np.column_stack([self.local, self.driven]).astype(complex)
        found = np.linalg.solve(self.stiffness + s * self.damping + s * s * self.mass, sides[None].repeat(s.size, 0))
        return np.array([found[:, :, 0] @ self.local, found[:, :, 1] @ self.local, found[:, :, 1] @ self.driven])

    def element(self, local: np.ndarray, omega: float) -> np.ndarray:
        """g_n of w_n, (orders,)."""
        waves = np.exp(2j * math.pi * np.outer(self.orders, np.arange(self.samples) / self.samples))
        force = self.law((local @ waves).real, ((1j * omega * self.orders * local) @ waves).real)
        return np.asarray(2.0 * (waves.conj() @ force) / self.samples)

    def guess(self, omega: float, motion: complex, force: np.ndarray) -> np.ndarray:
        """w_n of a measured x₁ (m), with its first order only, (orders,)."""
        cc, cd, dd = self.receptances(omega)[:, 0]
        local = np.zeros(self.orders.size, complex)
        local[0] = cd * force[0] - cc * (dd * force[0] - motion) / cd
        return local

    def at_lag(self, lag: float, force: np.ndarray, omega: float, motion: complex) -> Orbit:
        """The response at a lag (rad) near ω (rad/s) and x₁ (m); ``force`` (N) has all orders, the first real.

        Raises:
            ArithmeticError: there is none near.
        """
        return self._solved(lag, force, omega, motion)[0]

    def at_response(self, lag: float, response: float, omega: float, force: float) -> tuple[Orbit, float]:
        """The response of an amplitude (m) at a lag (rad) near ω (rad/s), and the force (N) it needs, near a guess.

        Raises:
            ArithmeticError: there is none near.
        """
        pure = np.zeros(self.orders.size, complex)
        pure[0] = force
        return self._solved(lag, pure, omega, response * np.exp(-1j * lag), response)

    def at_motion(self, omega: float, response: float, force: complex, lag: float) -> tuple[Orbit, float]:
        """The response of an amplitude (m) at ω (rad/s), near a force (N) and a lag (rad), and the force it needs.

        It is single-valued where response and frequency are, at folds over force and lag too. The phase of the force
        is 0; the odd harmonics of the force are none.

        Raises:
            ArithmeticError: there is none near.
        """
        cc, cd, dd = self.receptances(omega)
        pure = np.zeros(self.orders.size, complex)
        pure[0] = force
        start = self.guess(omega, response * np.exp(-1j * lag), pure)
        length = abs(start[0])

        def residual(unknowns: np.ndarray) -> np.ndarray:
            w = (unknowns[:-1:2] + 1j * unknowns[1:-1:2]) * length
            g = self.element(w, omega)
            force_now = pure * unknowns[-1]
            open_ = (w - cd * force_now + cc * g) / length
            x = dd[0] * force_now[0] - cd[0] * g[0]
            return np.append(np.column_stack([open_.real, open_.imag]).ravel(), abs(x) / response - 1.0)

        found = least_squares(
            residual, np.append(np.column_stack([start.real, start.imag]).ravel() / length, 1.0), xtol=1e-14, ftol=1e-14
        )
        if np.abs(found.fun).max() > 1e-8:
            raise ArithmeticError(f"no response of {response:g} m at {omega / 2.0 / math.pi:g} Hz")
        w = (found.x[:-1:2] + 1j * found.x[1:-1:2]) * length
        size = float(found.x[-1])
        return Orbit(omega, w, dd * pure * size - cd * self.element(w, omega)), float(abs(force) * size)

    def _solved(
        self, lag: float, force: np.ndarray, omega: float, motion: complex, held: float = 0.0
    ) -> tuple[Orbit, float]:
        """At a force, or at a response that is held (m), for which the size of the force is one more unknown."""
        local = self.guess(omega, motion, force)
        length, unit, given = abs(local[0]), omega, force

        def residual(unknowns: np.ndarray) -> np.ndarray:
            force = given
            if held:
                force, unknowns = given * unknowns[-1], unknowns[:-1]
            speed = unknowns[-1] * unit
            w = (unknowns[:-1:2] + 1j * unknowns[1:-1:2]) * length
            cc, cd, dd = self.receptances(speed)
            g = self.element(w, speed)
            open_ = (w - cd * force + cc * g) / length
            x = dd[0] * force[0] - cd[0] * g[0]
            found = np.append(np.column_stack([open_.real, open_.imag]).ravel(), (x / abs(x) * np.exp(1j * lag)).imag)
            return np.append(found, abs(x) / held - 1.0) if held else found

        unknowns = np.append(np.column_stack([local.real, local.imag]).ravel() / length, [1.0] * (2 if held else 1))
        for _ in range(60):
            here = residual(unknowns)
            if np.abs(here).max() < 1e-10:
                break
            jacobian = np.empty((unknowns.size, unknowns.size))
            for k in range(unknowns.size):
                moved = unknowns.copy()
                moved[k] += 1e-7
                jacobian[:, k] = (residual(moved) - here) / 1e-7
            step = np.linalg.solve(jacobian, here)
            unknowns = unknowns - step * min(1.0, 0.1 / np.abs(step).max())
        else:
            raise ArithmeticError(f"no response at a lag of {math.degrees(lag):g}°")
        size = float(unknowns[-1]) if held else 1.0
        unknowns = unknowns[:-1] if held else unknowns
        found = float(unknowns[-1] * unit)
        w = (unknowns[:-1:2] + 1j * unknowns[1:-1:2]) * length
        _, cd, dd = self.receptances(found)
        return Orbit(found, w, dd * given * size - cd * self.element(w, found)), float(abs(given[0]) * size)

    def slope(self, orbit: Orbit, lag: float, force: np.ndarray, step: float = 1e-4) -> float:
        """dω/dϑ at an orbit, rad/s a rad."""
        ends = [self.at_lag(lag + s, force, orbit.omega, orbit.drive[0]).omega for s in (-step, step)]
        return (ends[1] - ends[0]) / (2.0 * step)

    def fold(self, lag: float, force: np.ndarray, omega: float, response: float, sign: float) -> tuple[float, Orbit]:
        """Where ω turns near a lag: the largest for ``sign`` 1, the least for −1."""

        def at(place: float) -> Orbit:
            return self.at_lag(place, force, omega, response * np.exp(-1j * place))

        best = minimize_scalar(
            lambda place: -sign * at(place).omega, bounds=(lag - 0.1, lag + 0.1), method="bounded",
            options={"xatol": 1e-5},
        )  # fmt: skip
        return float(best.x), at(float(best.x))

    def exponents(self, orbit: Orbit, steps: int = 400) -> np.ndarray:
        """Floquet exponents (1/s) of an orbit by its variational equation, largest real part first; no memory.

        Imaginary parts are those nearest to zero. The equation is integrated by the classical method of Runge and
        Kutta, with the slopes of the law by differences.
        """
        n, h = self.local.size, 2.0 * math.pi / orbit.omega / steps
        turning = np.exp(1j * np.outer(0.5 * h * orbit.omega * np.arange(2 * steps + 1), self.orders))
        w, v = (turning @ orbit.local).real, (turning @ (1j * self.orders * orbit.omega * orbit.local)).real
        dw, dv = 1e-6 * np.abs(w).max(), 1e-6 * np.abs(v).max()
        slopes = np.array([
            (self.law(w + dw, v) - self.law(w - dw, v)) / (2.0 * dw),
            (self.law(w, v + dv) - self.law(w, v - dv)) / (2.0 * dv),
        ])  # fmt: skip
        along = np.outer(self.local, self.local)
        inverse = np.linalg.inv(self.mass)

        def rate(k: int) -> np.ndarray:
            below = -inverse @ np.hstack([self.stiffness + slopes[0, k] * along, self.damping + slopes[1, k] * along])
            return np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), below])

        turned = np.eye(2 * n)
        for k in range(steps):
            a, b, c = rate(2 * k), rate(2 * k + 1), rate(2 * k + 2)
            k1 = a @ turned
            k2 = b @ (turned + 0.5 * h * k1)
            k3 = b @ (turned + 0.5 * h * k2)
            turned = turned + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + c @ (turned + h * k3))
        found = np.log(np.linalg.eigvals(turned).astype(complex)) / (h * steps)
        return np.asarray(found[np.argsort(-found.real)])

    def simulate(self, orbit: Orbit, force: float, periods: int, instant: Callable[..., float]) -> complex:
        """x₁ (m) in the last of so many periods of a time integration that starts on the orbit.

        Args:
            orbit: where it starts.
            force: amplitude of the cosine, N.
            periods: of the excitation.
            instant: force of the element from w (m) and v (m/s); laws without a memory only.
        """
        n, omega = self.local.size, orbit.omega
        inverse = np.linalg.inv(self.mass)
        state = np.zeros((2, n))
        g = self.element(orbit.local, omega)
        for k, order in enumerate(self.orders):
            s = 1j * order * omega
            outside = force * self.driven if order == 1 else 0.0 * self.driven
            x = np.linalg.solve(self.stiffness + s * self.damping + s * s * self.mass, outside - g[k] * self.local)
            state += np.array([x.real, (s * x).real])

        def slope(time: float, y: np.ndarray) -> np.ndarray:
            x, v = y[:n], y[n:]
            inner = instant(float(self.local @ x), float(self.local @ v))
            load = force * math.cos(omega * time) * self.driven - inner * self.local
            return np.append(v, inverse @ (load - self.damping @ v - self.stiffness @ x))

        period = 2.0 * math.pi / omega
        times = period * (periods - 1 + np.arange(256) / 256)
        found = solve_ivp(slope, (0.0, period * periods), state.ravel(), "DOP853", times, rtol=1e-9, atol=1e-13)
        return complex(2.0 * np.fft.fft(self.driven @ found.y[:n])[1] / 256)


def chain_of_one(stiffness: float, damping: float, law: Law, **settings: int) -> OneElement:
    """One mass of 1 kg."""
    one = np.array([1.0])
    return OneElement(np.eye(1), np.array([[damping]]), np.array([[stiffness]]), one, one, law, **settings)


def of_modes(
    omega: ArrayLike, zeta: ArrayLike, local: ArrayLike, driven: ArrayLike, law: Law,
    **settings: int,
) -> OneElement:  # fmt: skip
    """Mass-normalised modes: ω in rad/s, shapes in 1/√kg."""
    w, z = np.asarray(omega), np.asarray(zeta)
    return OneElement(
        np.eye(w.size), np.diag(2.0 * z * w), np.diag(w * w), np.asarray(local), np.asarray(driven), law, **settings
    )


def cantilever(
    elements: int, length: float, width: float, height: float, modulus: float, density: float, factor: float,
    local: int, driven: int, law: Law, **settings: int,
) -> OneElement:  # fmt: skip
    """Euler-Bernoulli beam with C = ``factor`` K (s); ``local`` and ``driven`` count free nodes from 1."""
    a, part = width * height, length / elements
    rigidity = modulus * width * height**3 / 12.0
    k = rigidity / part**3 * np.array([
        [12, 6 * part, -12, 6 * part], [6 * part, 4 * part**2, -6 * part, 2 * part**2],
        [-12, -6 * part, 12, -6 * part], [6 * part, 2 * part**2, -6 * part, 4 * part**2],
    ])  # fmt: skip
    m = density * a * part / 420.0 * np.array([
        [156, 22 * part, 54, -13 * part], [22 * part, 4 * part**2, 13 * part, -3 * part**2],
        [54, 13 * part, 156, -22 * part], [-13 * part, -3 * part**2, -22 * part, 4 * part**2],
    ])  # fmt: skip
    mass, stiffness = np.zeros((2, 2 * elements + 2, 2 * elements + 2))
    for e in range(elements):
        rows = slice(2 * e, 2 * e + 4)
        mass[rows, rows] += m
        stiffness[rows, rows] += k
    mass, stiffness = mass[2:, 2:], stiffness[2:, 2:]
    units = np.eye(2 * elements)
    return OneElement(
        mass, factor * stiffness, stiffness, units[2 * (local - 1)], units[2 * (driven - 1)], law, **settings
    )


def cubic(coefficient: float, linear: float = 0.0) -> Law:
    """k₁ w + k₃ w³."""
    return lambda w, v: linear * w + coefficient * w**3


def stops(stiffness: float, gap: float) -> Law:
    """Stops on both sides."""
    return lambda w, v: stiffness * (np.maximum(w - gap, 0.0) - np.maximum(-w - gap, 0.0))
