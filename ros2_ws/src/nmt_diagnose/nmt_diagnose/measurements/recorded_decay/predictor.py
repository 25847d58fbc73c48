"""Free decays as the model predicts them: frequency and damping ratio over amplitude."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.recorded_decay.recorded_decay import RecordedDecay
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.decay_kernel import (
    closure,
    decay_shapes,
    evaluate_decay,
    newton_step,
    observed_ratios,
    stepped_decays,
)
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.periodic_kernel import sensor_gain
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import RigParts, sliding
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig

DecayState = tuple[FloatArray, tuple[str, ...], float]
_OFF_POLE = 1e-8
_DEEPEST = 3


class RingDownPredictor:
    """Predicts one free decay: structure and exciter at zero volts.

    Args:
        test: the decay.
        rows: its rows.
        settings: of the predictor.
    """

    def __init__(self, test: RecordedDecay, rows: Rows, settings: PredictionSettings) -> None:
        self.test, self.rows, self.settings = test, rows, settings
        self.channels = test.channels
        self.use(Setup(test.drive_points, False, self.channels, FourierBasis.up_to(settings.harmonics)))

    def use(self, setup: Setup) -> None:
        """Take the parts of rigs from a setup that other tests share."""
        self.setup = setup
        self._places = setup.index(self.channels)
        self._own = self._places[0]

    def solve(self, rig: Rig, cache: PartsCache, start: tuple[DecayState | None, ...] | None) -> list[Any]:
        """One state per amplitude; None where there is no solution."""
        parts = cache.parts(rig, self.setup)
        states: list[DecayState | None] = [None] * self.test.amplitudes.size
        last: DecayState | None = None
        for position in np.argsort(self.test.amplitudes, kind="stable"):
            amplitude = float(self.test.amplitudes[position])
            for guess in (None if start is None else start[position], last, None):
                states[position] = self._continued(parts, guess, amplitude)
                if states[position] is not None:
                    break
            else:
                # Far beyond the slip of a stiff contact nothing leads there from rest.
                states[position] = self._newton(parts, self._linear_start(parts, amplitude, sliding(parts)), amplitude)
            last = states[position] or last
        return states

    def values(self, rig: Rig, cache: PartsCache, states: list[DecayState | None]) -> FloatArray:
        """Observables of the test's rows."""
        clock = 1.0 + rig.clock_error
        log_omega = np.array([math.nan if s is None else math.log(s[0][-2] / clock) for s in states])
        parts = cache.parts(rig, self.setup)
        solved = [position for position, state in enumerate(states) if state is not None]
        ratio = np.full(len(states), np.nan)
        shapes = np.full((len(states), len(self.channels)), np.nan, dtype=np.complex128)
        shape = np.isin(self.rows.part, (Part.LOG_MAGNITUDE, Part.PHASE))
        if solved:
            z = np.array([state[0] for state in states if state is not None])
            amplitudes = np.array([state[2] for state in states if state is not None])
            # Not at the pole of the linear system itself, where transfer functions are infinite.
            z[:, -2] *= 1.0 + _OFF_POLE
            ratio[solved] = observed_ratios(z, amplitudes, self._own, parts.decay_tables)
            if shape.any():
                places = np.array(self._places, dtype=np.int64)
                shapes[solved] = decay_shapes(z, amplitudes, self._own, places, parts.decay_tables)
        result = np.full(len(self.rows), np.nan)
        for kind, values in ((Part.LOG_FREQUENCY, log_omega), (Part.DAMPING, ratio)):
            which = self.rows.part == kind
            result[which] = values[self.rows.level[which]]
        if shape.any():
            picked = shapes[self.rows.level[shape], self.rows.channel[shape]]
            log_size = np.log(np.abs(picked) * self.test.amplitudes[self.rows.level[shape]])
            result[shape] = np.where(self.rows.part[shape] == Part.PHASE, np.angle(picked), log_size)
        return result

    def stepped(self, rig: Rig, cache: PartsCache, states: tuple[DecayState | None, ...]) -> list[DecayState | None]:
        """Solutions of a slightly different rig by one Newton step."""
        parts = cache.parts(rig, self.setup)
        result: list[DecayState | None] = [None] * len(states)
        solved = [(position, state) for position, state in enumerate(states) if state is not None]
        if not solved:
            return result
        z = np.array([self._carried(parts, state, state[2]) for _, state in solved])
        # Not at the pole of the linear system itself, where transfer functions are infinite.
        z[:, -2] *= 1.0 + _OFF_POLE
        amplitudes = np.array([state[2] for _, state in solved])
        moved = stepped_decays(z, amplitudes, self._own, parts.decay_tables)
        for (position, state), change in zip(solved, moved, strict=True):
            result[position] = (change, parts.keys, state[2])
        return result

    def _arguments(self, parts: RigParts, z: FloatArray, amplitude: float) -> tuple[Any, ...]:
        true, weight = closure(z, amplitude, self._own, parts.decay_tables)
        return true, weight, parts.coordinates + self._own, parts.decay_tables

    def _continued(
        self, parts: RigParts, guess: DecayState | None, amplitude: float, depth: int = _DEEPEST
    ) -> DecayState | None:
        """Solution from a similar one, by way of amplitudes between the two where Newton's method does not reach it."""
        z = (
            self._linear_start(parts, amplitude, parts.resting)
            if guess is None
            else self._carried(parts, guess, amplitude)
        )
        found = self._newton(parts, z, amplitude)
        if found is not None or guess is None or depth == 0 or amplitude == guess[2]:
            return found
        between = self._continued(parts, guess, math.sqrt(amplitude * guess[2]), depth - 1)
        return None if between is None else self._continued(parts, between, amplitude, depth - 1)

    def _newton(self, parts: RigParts, z: FloatArray, amplitude: float) -> DecayState | None:
        arguments = self._arguments(parts, z, amplitude)
        first = z[-2]
        for _ in range(self.settings.iterations):
            try:
                residual, jacobian = evaluate_decay(z, *arguments)
            except ZeroDivisionError:
                # The pole of a linear system, to the last bit.
                return z, parts.keys, amplitude
            if not np.all(np.isfinite(residual)):
                return None
            try:
                step = newton_step(jacobian, residual, z, self.setup.basis.size)
            except np.linalg.LinAlgError:
                return None
            moved = max(abs(step[-2]) / z[-2], abs(step[-1]))
            z = z - step * min(1.0, THRESHOLDS.prediction.decay_largest_step / moved if moved > 0.0 else 1.0)
            if not 0.5 * first < z[-2] < 2.0 * first:
                return None
            if moved < 1e-10:
                return z, parts.keys, amplitude
        return None

    def _linear_start(self, parts: RigParts, amplitude: float, tangents: tuple[FloatArray, FloatArray]) -> FloatArray:
        """Pole of the linearised system nearest to the frequency of the switch-off, and its shape.

        Args:
            parts: of the rig.
            amplitude: of the channel.
            tangents: stiffness and damping of each coordinate's forces, (r,) each.
        """
        r, basis = parts.coordinates, self.setup.basis
        s = 2j * np.pi * self.test.frequency_hz * parts.clock
        model = parts.linear
        output = r + self._own
        # Not at the pole itself: without tangents at rest it is one of the transfer functions too.
        s = self._pole(parts, s, tangents) * (1.0 + 1e-5)
        t, _ = model.at(s)
        tangent = tangents[0] + s * tangents[1]
        closed = np.linalg.solve(np.eye(r) + t[:r, :r] * tangent, t[:r, r])
        transfer = t[output, r] - t[output, :r] @ (tangent * closed)
        gain, _ = sensor_gain(1j * s.imag, parts.channels[self._own])
        amplitudes = np.zeros((r, basis.orders.size), dtype=np.complex128)
        amplitudes[:, basis.fundamental] = closed / transfer * amplitude / abs(gain)
        return np.concatenate((basis.to_real(amplitudes).ravel(), [s.imag, -s.real / s.imag]))

    @staticmethod
    def _pole(parts: RigParts, near: complex, tangents: tuple[FloatArray, FloatArray]) -> complex:
        system = parts.system
        n, mechanical = system.size, system.mechanical_size
        stiffness, damping = system.stiffness.copy(), system.damping.copy()
        for k, c, direction in zip(*tangents, parts.inputs.T[: parts.coordinates], strict=True):
            outer = np.outer(direction, direction)
            stiffness += k * outer
            damping += c * outer
        a = np.zeros((n + mechanical, n + mechanical))
        b = np.zeros_like(a)
        a[:n, :n], b[:n, :n], b[:n, n:] = -stiffness, damping, system.mass[:, :mechanical]
        a[n:, n:] = b[n:, :mechanical] = np.eye(mechanical)
        poles = np.linalg.eigvals(np.linalg.solve(b, a))
        poles = poles[poles.imag > 0.0]
        return complex(poles[np.argmin(np.abs(poles.imag - near.imag))])

    def _carried(self, parts: RigParts, state: DecayState, amplitude: float) -> FloatArray:
        z_old, keys, old = state
        size = self.setup.basis.size
        z = np.zeros(parts.coordinates * size + 2)
        z[-2:] = z_old[-2:]
        fresh = []
        for i, key in enumerate(parts.keys):
            if key in keys:
                j = keys.index(key)
                z[i * size : (i + 1) * size] = z_old[j * size : (j + 1) * size] * amplitude / old
            else:
                fresh.append(i)
        if fresh:
            # A state of the linear system may be its pole to the last bit.
            z[-2] *= 1.0 + _OFF_POLE
            residual = evaluate_decay(z, *self._arguments(parts, z, amplitude))[0]
            for i in fresh:
                z[i * size : (i + 1) * size] = -residual[i * size : (i + 1) * size]
        return z
