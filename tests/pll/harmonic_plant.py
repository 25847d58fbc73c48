"""A force with harmonics that answers the drive's harmonics, sample by sample: a plant for their controller."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from nmt_pll.detection.phase_detector import AdaptiveFourierFilter
from nmt_pll.force_control.force_controller import ForceController, ForceSetup

RATE = 1e4
FREQUENCY = 22.2  # Hz
PERIOD = 1.0 / FREQUENCY
CUTOFF = 0.15 * 2 * math.pi * FREQUENCY
HIGHEST = 9
FORCE = 1.0  # N
DISTURBANCE = np.array([0.001, 0.12, 0.002, 0.05, 0.001, 0.02, 0.0, 0.008]) * np.exp(1j * np.arange(8))  # n = 2 … 9


def gain(frequency_hz):
    """Force per volt: a stiff exciter with inductance on a structure with an antiresonance near the fifth harmonic."""
    s = 2j * math.pi * frequency_hz
    low, high = 2 * math.pi * 100.0, 2 * math.pi * 125.0
    numerator = s * s + 2 * 0.2 * low * s + low * low
    denominator = s * s + 2 * 0.2 * high * s + high * high
    return 5.0 * numerator / denominator / (1 + s / 4000.0)


class HarmonicPlant:
    """The closed loop of controller and force.

    Args:
        block_ms: block length.
        latency: blocks between command and effect.
        factor: what the controller takes G to be, over what it is; None = it knows nothing.
        noise: rms of the force's noise at each sample, N.
        growth: time constant with which disturbances and motion come up, s; 0 = they are there.
        dead: harmonics of the drive that do not reach the force.
        setup: fields of the controller's setup that differ.
    """

    def __init__(self, block_ms=20.0, latency=0, factor=1.0, noise=0.0, growth=0.0, dead=(), amplitude=1.0, **setup):
        self.block = round(RATE * block_ms * 1e-3)
        duration = self.block / RATE
        self.amplitude, self.noise, self.growth = amplitude, noise, growth
        values = {"voltage_limit": 0.0, **setup}
        self.setup = ForceSetup(
            HIGHEST, CUTOFF, duration, latency, (1.5 + latency) * duration, math.ceil(10 * PERIOD / duration), **values
        )
        factor = np.nan if factor is None else factor
        known = lambda f: factor * gain(f)[:, None, None]  # noqa: E731
        self.controller = ForceController(self.setup, known)
        self.filter = AdaptiveFourierFilter(1, HIGHEST + 1, CUTOFF, RATE)
        self.gains = np.array([0.0 if n in dead else gain(n * FREQUENCY) for n in range(2, HIGHEST + 1)])
        self.random = np.random.default_rng(1)
        self.sample = 0
        self.pending = deque([np.zeros(HIGHEST - 1, complex)] * latency)
        self.previous = np.zeros(HIGHEST - 1, complex)
        self.force = np.zeros(HIGHEST - 1, complex)  # true harmonics at the block's end
        self.largest = 0.0

    @property
    def periods(self) -> float:
        return self.sample / RATE / PERIOD

    @property
    def voltages(self) -> np.ndarray:
        """V_n of the harmonics 2 … H, a view."""
        return self.controller.terms[0, 1:]

    @property
    def known_gain(self) -> np.ndarray:
        """Ĝ of the harmonics 2 … H."""
        return self.controller.gain(FREQUENCY)[:, 0, 0]

    @property
    def residual(self) -> float:
        """Root of the sum of squares of the true force harmonics, of the fundamental."""
        return float(np.linalg.norm(self.force)) / FORCE

    def step(self, control=True) -> None:
        """One block."""
        self.pending.append(self.voltages.copy())
        target = self.pending.popleft()
        time = (self.sample + np.arange(self.block)) / RATE
        grown = 1.0 - np.exp(-time / self.growth) if self.growth else np.ones(self.block)
        fade = 0.5 - 0.5 * np.cos(np.pi * (np.arange(self.block) + 1) / self.block)
        voltage = self.previous[:, None] + (target - self.previous)[:, None] * fade
        harmonics = DISTURBANCE[:, None] * grown**2 + self.gains[:, None] * voltage
        theta = 2 * math.pi * FREQUENCY * time
        data = FORCE * np.cos(theta)
        for n, row in enumerate(harmonics, start=2):
            data += (row * np.exp(1j * n * theta)).real
        data += self.noise * self.random.standard_normal(self.block)
        cycles = math.fmod(FREQUENCY * self.sample / RATE, 1.0)
        seen = self.filter.process(data[None, :], cycles, FREQUENCY)[0, 1 : HIGHEST + 1].copy()
        self.previous, self.force = target, harmonics[:, -1]
        self.sample += self.block
        self.largest = max(self.largest, float(np.sum(np.abs(voltage), axis=0).max()))
        if control and self.periods > 4:
            target = np.zeros((1, HIGHEST), complex)
            self.controller.update(seen[None, :], [complex(grown[-1])], FREQUENCY, self.amplitude, target)
        else:
            self.controller.idle(self.amplitude)

    def run(self, periods: float) -> None:
        until = self.periods + periods
        while self.periods < until:
            self.step()

    def run_to(self, share: float, limit: float = 400.0) -> float:
        """Periods of control until the harmonics stay below ``share`` of what they are without it."""
        alone = float(np.linalg.norm(DISTURBANCE))
        while self.periods < 4:
            self.step(control=False)
        begun, last = self.periods, self.periods
        while self.periods - begun < limit:
            self.step()
            if np.linalg.norm(self.force) > share * alone:
                last = self.periods
            if self.periods - last > 30:
                return last - begun
        return math.inf
