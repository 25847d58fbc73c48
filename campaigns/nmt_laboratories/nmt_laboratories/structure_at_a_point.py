"""A structure measured at one point, by equations of its own: modes, forces at the point, Runge–Kutta.

It shares no code with the bench. Resonance is found without a phase-locked loop: a force of held amplitude that follows
the sign of the velocity, smoothed, drives the structure at its phase resonance by itself. What a laboratory would write
down of it are backbone points (frequency, amplitude and damping ratio with their scatter), free decays from there, and
frequency responses at held forces, stepped up or down.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

STEPS = 100  # of the integration in a period
_MEASURED = 40  # periods


@dataclass(frozen=True)
class Structure:
    """Modes scaled to unit mass, and forces at the point.

    Attributes:
        frequencies_hz: of the modes.
        ratios: damping ratios.
        shape: of the modes at the point, 1/√kg.
        cubic: N/m³.
        quadratic: N/m².
        square_damping: of a force c x² v, N s/m³.
        stop: stiffness (N/m) of stops on both sides and their gap (m).
        joint: stiffness (N/m) and slip force (N) of each slider of a joint.
    """

    frequencies_hz: tuple[float, ...]
    ratios: tuple[float, ...]
    shape: tuple[float, ...] = (1.0,)
    cubic: float = 0.0
    quadratic: float = 0.0
    square_damping: float = 0.0
    stop: tuple[float, float] = (0.0, 1.0)
    joint: tuple[tuple[float, float], ...] = ()


def iwan_joint(
    stiffness: float, largest: float, exponent: float, sliders: int = 60, least: float = 2e-3
) -> tuple[tuple[float, float], ...]:
    """Sliders of a joint whose stiffness has a density ~ φ^exponent up to a slip displacement ``largest``, m."""
    edges = np.concatenate(([0.0], np.geomspace(least, 1.0, sliders)))
    power = exponent + 1.0
    share = np.diff(edges**power)
    mean = np.diff(edges ** (power + 1.0)) * power / (power + 1.0) / share
    return tuple((float(stiffness * s), float(stiffness * s * m * largest)) for s, m in zip(share, mean, strict=True))


@njit(cache=True)
def local_force(x: float, v: float, terms: Any, stiffness: Any, limits: Any, moved: Any) -> float:
    """Force on the point, N: springs, damping, a stop, and sliders that have moved so far."""
    total: float = terms[0] * x**3 + terms[1] * x * x + terms[2] * x * x * v
    if abs(x) > terms[4]:
        total += terms[3] * (abs(x) - terms[4]) * np.sign(x)
    for i in range(stiffness.size):
        spring = stiffness[i] * (x - moved[i])
        total += min(max(spring, -limits[i]), limits[i])
    return total


@njit(cache=True)
def advance(state: Any, slope: Any, dt: float) -> None:
    """A step of Runge and Kutta's fourth order from its four slopes, (4, 2, modes)."""
    for k in range(2):
        for m in range(state.shape[1]):
            state[k, m] += dt / 6.0 * (slope[0, k, m] + 2.0 * slope[1, k, m] + 2.0 * slope[2, k, m] + slope[3, k, m])


@njit(cache=True)
def slide(x: float, stiffness: Any, limits: Any, moved: Any) -> None:
    """Sliders go with the point where their springs reach the slip force."""
    for i in range(stiffness.size):
        reach = limits[i] / stiffness[i]
        moved[i] = min(max(moved[i], x - reach), x + reach)


@njit(cache=True)
def _play(
    state: Any, steps: int, dt: float, force: float, omega: float, angle: float, modes: Any, terms: Any,
    stiffness: Any, limits: Any, moved: Any, position: Any, speed: Any, applied: Any,
) -> None:  # fmt: skip
    """Rows of ``modes`` are ω, damping ratio and shape, ``state`` is (q, q̇).

    The drive follows the velocity's direction where ``angle`` is NaN, and is force · cos(ω t + angle) elsewhere.
    """
    count = modes.shape[1]
    slope = np.zeros((4, 2, count))
    now = np.zeros((2, count))
    for step in range(steps):
        for stage in range(4):
            part = 0.0 if stage == 0 else (0.5 if stage < 3 else 1.0)
            for k in range(2):
                for m in range(count):
                    now[k, m] = state[k, m] + (part * dt * slope[stage - 1, k, m] if stage else 0.0)
            x, v = 0.0, 0.0
            for m in range(count):
                x += modes[2, m] * now[0, m]
                v += modes[2, m] * now[1, m]
            if np.isnan(angle):
                drive = force * v / np.sqrt(v * v + omega * omega * x * x + 1e-30)
            else:
                drive = force * np.cos(omega * (step + part) * dt + angle)
            if stage == 0:
                position[step], speed[step], applied[step] = x, v, drive
            net = drive - local_force(x, v, terms, stiffness, limits, moved)
            for m in range(count):
                slope[stage, 0, m] = now[1, m]
                slope[stage, 1, m] = (
                    modes[2, m] * net
                    - 2.0 * modes[1, m] * modes[0, m] * now[1, m]
                    - modes[0, m] * modes[0, m] * now[0, m]
                )
        advance(state, slope, dt)
        x = 0.0
        for m in range(count):
            x += modes[2, m] * state[0, m]
        slide(x, stiffness, limits, moved)


class Bench:
    """A structure with its state, driven from one force to the next.

    Args:
        structure: what is driven.
    """

    def __init__(self, structure: Structure) -> None:
        self.structure = structure
        count = len(structure.frequencies_hz)
        self._modes = np.array(
            [2.0 * np.pi * np.array(structure.frequencies_hz), structure.ratios, structure.shape], dtype=float
        )
        self._state = np.zeros((2, count))
        self._state[1, 0] = 1e-4
        sliders = np.array(structure.joint, dtype=float).reshape(-1, 2)
        self._stiffness, self._limits = sliders[:, 0].copy(), sliders[:, 1].copy()
        self._moved = np.zeros(len(sliders))
        self._frequency = float(structure.frequencies_hz[0])
        self._terms = np.array(
            [structure.cubic, structure.quadratic, structure.square_damping, *structure.stop], dtype=float
        )

    def _played(
        self, steps: int, dt: float, force: float, frequency: float, angle: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position (m), velocity (m/s) and force (N) at the point, step by step."""
        kept = np.zeros((3, steps))
        _play(
            self._state, steps, dt, force, 2.0 * np.pi * frequency, angle, self._modes, self._terms, self._stiffness,
            self._limits, self._moved, kept[0], kept[1], kept[2],
        )  # fmt: skip
        return kept[0], kept[1], kept[2]

    def point(self, force: float) -> tuple[float, float, float]:
        """Frequency (Hz), amplitude (m) and damping ratio at phase resonance under a force of held amplitude, N.

        The damping ratio is the work of a cycle over 2π ω² a², for unit modal mass.
        """
        for turn in range(4):
            dt = 1.0 / self._frequency / STEPS
            periods = int(1.2 / self.structure.ratios[0]) if turn == 0 else 60
            position, _, applied = self._played(STEPS * periods, dt, force, self._frequency, np.nan)
            centre = position - position[-STEPS * _MEASURED :].mean()
            before = np.flatnonzero((centre[:-1] < 0.0) & (centre[1:] >= 0.0))
            times = (before - centre[before] / (centre[before + 1] - centre[before])) * dt
            count = min(_MEASURED, len(times) - 1)
            self._frequency = float(count / (times[-1] - times[-1 - count]))
        first, last = round(times[-1 - count] / dt), round(times[-1] / dt)
        turning = np.exp(-2j * np.pi * self._frequency * np.arange(first, last) * dt)
        amplitude = 2.0 * complex(np.mean(position[first:last] * turning))
        drive = 2.0 * complex(np.mean(applied[first:last] * turning))
        work = np.pi * abs((drive * amplitude.conjugate()).imag)
        omega = 2.0 * np.pi * self._frequency
        return self._frequency, abs(amplitude), work / (2.0 * np.pi * omega**2 * abs(amplitude) ** 2)

    def locked(self, force: float, seconds: float, rate: float) -> np.ndarray:
        """Force (N) and acceleration (m/s²) at phase resonance under a held force, sampled, (2, samples)."""
        self.point(force)
        finer = int(np.ceil(STEPS * self._frequency / rate))
        dt = 1.0 / rate / finer
        _, speed, applied = self._played(int(seconds * rate) * finer, dt, force, self._frequency, np.nan)
        return np.array([applied[::finer], np.gradient(speed, dt)[::finer]])

    def decay(self, force: float, seconds: float, rate: float) -> np.ndarray:
        """Velocity (m/s) after a force that held phase resonance is taken away, sampled at ``rate``, Hz."""
        self.point(force)
        finer = int(np.ceil(STEPS * self._frequency / rate))
        _, speed, _ = self._played(int(seconds * rate) * finer, 1.0 / rate / finer, 0.0, self._frequency, 0.0)
        return speed[::finer]

    def response(self, force: float, frequencies: np.ndarray) -> np.ndarray:
        """Fundamental of the displacement over that of the force (m/N) at frequencies (Hz), one after the other."""
        found = np.zeros(len(frequencies), dtype=complex)
        angle = 0.0
        settling = int(1.5 / self.structure.ratios[0])
        for i, frequency in enumerate(frequencies):
            dt = 1.0 / frequency / STEPS
            position, _, applied = self._played(STEPS * (settling + _MEASURED), dt, force, float(frequency), angle)
            turning = np.exp(-2j * np.pi * np.arange(STEPS * _MEASURED) / STEPS)
            last = slice(-STEPS * _MEASURED, None)
            found[i] = np.mean(position[last] * turning) / np.mean(applied[last] * turning)
        return found


def backbone_table(
    structure: Structure,
    forces: np.ndarray,
    path: Path,
    scatter: tuple[float, float, float],
    seed: int,
    gain: float = 1.0,
) -> None:
    """Write the backbone as a laboratory would, in Hz and mm.

    Args:
        structure: what is measured.
        forces: held one after the other, N.
        path: of the CSV file.
        scatter: relative, of frequency, amplitude and damping ratio.
        seed: of the scatter.
        gain: of the sensor.
    """
    generator, bench = np.random.default_rng(seed), Bench(structure)
    lines = ["frequency_hz,amplitude,damping_ratio"]
    for force in forces:
        point = np.array(bench.point(float(force))) * (1.0 + np.array(scatter) * generator.standard_normal(3))
        lines.append(f"{point[0]:.7g},{1e3 * gain * point[1]:.6g},{point[2]:.5g}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
