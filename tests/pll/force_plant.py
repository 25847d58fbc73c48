"""Forces of several exciters that answer the terms of all drives, as envelopes: a plant for their controller."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from nmt_pll.force_control.force_controller import ForceController, ForceSetup

FREQUENCY = 30.0  # Hz
CUTOFF = 0.15 * 2 * math.pi * FREQUENCY
HIGHEST = 6
BLOCK = 0.01
STEPS = 16
FUNDAMENTAL_GAIN = np.array([1.0, 3.0 - 1.0j, 2.0 + 0.5j])  # N/V
FUNDAMENTAL_RATIO = np.array([1.0, 0.8j, -0.5])  # F_j1* / F_11


def matrices(frequency_hz, exciters=2):
    """G(f): stiff exciters with inductance, each of which moves the points of the others, not alike both ways."""
    s = 2j * math.pi * np.atleast_1d(frequency_hz)[:, None, None]
    blocked = np.diag([5.0, 4.0, 6.0][:exciters])
    shapes = np.array([[0.9, 0.5, 0.3], [0.4, -0.8, 0.4], [-0.3, 0.4, 0.9]])[:exciters]
    omega = 2 * math.pi * np.array([70.0, 115.0, 160.0])
    mobility = sum(
        s * np.outer(shape, shape * [1.0, 0.8, 1.2][:exciters]) / (s * s + 0.3 * own * s + own * own)
        for own, shape in zip(omega, shapes.T, strict=True)
    )
    return np.linalg.inv(np.eye(exciters) + 60.0 * mobility) @ blocked / (1 + s / 4000.0)


def disturbances(exciters, seed=3):
    """Forces of the harmonics without control, N, shape (exciters, HIGHEST); the first column counts for nothing."""
    rng = np.random.default_rng(seed)
    size = np.array([0.0, 0.01, 0.12, 0.02, 0.06, 0.01])
    return size * np.exp(2j * np.pi * rng.random((exciters, HIGHEST)))


class ForcePlant:
    """The closed loop of controller and forces.

    Args:
        exciters: number of them.
        latency: blocks between command and effect.
        factors: what the controller takes the columns of G to be, over what they are; None = it knows nothing.
        known: G that the controller is told of, in place of that.
        noise: of each force behind the filter, N.
        dead: (exciter from 1, harmonic) whose voltage does not reach a force.
        setup: fields of the controller's setup that differ.
    """

    def __init__(self, exciters=2, latency=0, factors=(1.0,), known=None, noise=0.0, dead=(), **setup):
        self.setup = ForceSetup(HIGHEST, CUTOFF, BLOCK, latency, (1.5 + latency) * BLOCK, 40, **setup)
        told = [np.nan] if factors is None else factors
        known = known or (lambda f: matrices(f, exciters) * np.broadcast_to(told, exciters))
        tables = {}  # of the frequencies that are asked for block by block

        def table(frequency_hz):
            key = np.asarray(frequency_hz, dtype=float).tobytes()
            if key not in tables:
                tables[key] = known(frequency_hz)
            return tables[key].copy()

        start, gain = np.eye(1, exciters)[0].astype(complex), FUNDAMENTAL_GAIN[:exciters].copy()
        self.controller = ForceController(self.setup, table, start, gain)
        self.gains = matrices(FREQUENCY * np.arange(2, HIGHEST + 1), exciters)
        for exciter, order in dead:
            self.gains[order - 2, :, exciter - 1] = 0.0
        self.target = np.zeros((exciters, HIGHEST), complex)
        self.target[:, 0] = FUNDAMENTAL_RATIO[:exciters]
        self.disturbance = disturbances(exciters)
        self.noise, self.random = noise, np.random.default_rng(1)
        rest = np.zeros((exciters, HIGHEST), complex)
        self.pending = deque([rest] * latency)
        self.previous, self.filtered, self.force = rest, self._forces(rest), rest
        # Over the steps of a block, in which the force goes in a straight line from one value to the next.
        share = CUTOFF * BLOCK / STEPS
        left = share * (1.0 - share) ** np.arange(STEPS)[::-1]
        way = (np.arange(STEPS) + 0.5) / STEPS
        self.shares = (1.0 - share) ** STEPS, left @ (1.0 - way), left @ way
        self.blocks = 0
        self.largest = np.zeros(exciters)
        self.steepest = np.zeros(exciters)

    def _forces(self, voltages):
        result = self.disturbance.copy()
        result[:, 1:] += np.einsum("nij,jn->in", self.gains, voltages[:, 1:])
        result[:, 0] = FUNDAMENTAL_GAIN[: voltages.shape[0]] * voltages[:, 0]
        result[0, 0] = 1.0
        return result

    @property
    def deviation(self) -> np.ndarray:
        """Of the true forces from their targets, N."""
        return self.force - self.target

    def step(self) -> None:
        """One block with a drive of 1 V."""
        self.pending.append(self.controller.terms.copy())
        target = self.pending.popleft()
        before, self.force = self._forces(self.previous), self._forces(target)
        kept, first, last = self.shares
        self.filtered = kept * self.filtered + first * before + last * self.force
        self.previous = target
        orders = np.arange(1, HIGHEST + 1)
        self.largest = np.maximum(self.largest, np.abs(target).sum(axis=1))
        slopes = 2 * self.setup.sample_rate * np.sin(np.pi * orders * FREQUENCY / self.setup.sample_rate)
        self.steepest = np.maximum(self.steepest, (np.abs(target) * slopes).sum(axis=1))
        scatter = self.random.standard_normal((*self.force.shape, 2)) @ [1.0, 1.0j]
        self.controller.update(self.filtered + self.noise * scatter, [1.0], FREQUENCY, 1.0, self.target)
        self.controller.fit(1.0, FREQUENCY)
        self.blocks += 1

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / BLOCK)):
            self.step()
