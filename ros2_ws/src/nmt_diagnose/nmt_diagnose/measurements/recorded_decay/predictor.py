"""Free decays as the model predicts them: frequency and damping ratio over amplitude."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.observations.observables import FUNDAMENTAL, Part, Rows
from nmt_diagnose.prediction.decay_kernel import free_rows, observed_ratios
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.periodic_kernel import (
    FREE,
    Closing,
    Limits,
    at_pole,
    carried,
    channels_of,
    newton,
    resting_response,
    stepped,
)
from nmt_diagnose.prediction.periodic_state import PeriodicState, shared_unknowns
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.prediction.rig_parts import RigParts, sliding
from nmt_diagnose.prediction.rig_tables import sensor_gain
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig

# Step of a decay over which frequency and damping are as good as constant.
_LARGEST_STEP = 0.05

if TYPE_CHECKING:
    from nmt_diagnose.measurements.recorded_decay.recorded_decay import RecordedDecay

_OFF_POLE = 1e-8
_TOLERANCE = 1e-10
_NO_CHANNELS = np.zeros((0, 0), dtype=np.complex128)
_DEEPEST = 3


class RingDownPredictor(Predictor):
    """Predicts one free decay: structure and exciter at zero volts.

    Args:
        test: the decay.
        rows: its rows.
        settings: of the predictor.
    """

    SOLUTION: ClassVar[str] = "decay"

    def __init__(self, test: RecordedDecay, rows: Rows, settings: PredictionSettings) -> None:
        self.test, self.rows, self.settings = test, rows, settings
        self.channels = test.channels
        self.use(Setup(test.drive_points, False, self.channels, FourierBasis.up_to(settings.harmonics)))

    def use(self, setup: Setup) -> None:
        """Take the parts of rigs from a setup that other tests share."""
        self.setup = setup
        self._places = setup.index(self.channels)
        self._own = self._places[0]

    def solve(self, rig: Rig, cache: PartsCache, start: tuple[PeriodicState | None, ...] | None) -> list[Any]:
        """One state per amplitude; None where there is no solution."""
        parts = cache.parts(rig, self.setup)
        states: list[PeriodicState | None] = [None] * self.test.amplitudes.size
        last: PeriodicState | None = None
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

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> FloatArray:
        """Observables of the test's rows."""
        clock = 1.0 + rig.clock_error
        log_omega = np.array([math.nan if s is None else math.log(s.omega / clock) for s in states])
        parts = cache.parts(rig, self.setup)
        solved = [position for position, state in enumerate(states) if state is not None]
        ratio = np.full(len(states), np.nan)
        shapes = np.full((len(states), len(self.channels)), np.nan, dtype=np.complex128)
        shape = np.isin(self.rows.part, FUNDAMENTAL)
        if solved:
            z = np.array([state.z for state in states if state is not None])
            # Not at the pole of the linear system itself, where transfer functions are infinite.
            z[:, -2] *= 1.0 + _OFF_POLE
            asked = self._arguments(parts, z, np.array([state.drive for state in states if state is not None]))
            ratio[solved] = observed_ratios(z, *asked)
            if shape.any():
                motions = channels_of(z, *asked)[:, self._places, 0]
                shapes[solved] = motions / motions[:, :1]
        result = np.full(len(self.rows), np.nan)
        for kind, values in ((Part.LOG_FREQUENCY, log_omega), (Part.DAMPING, ratio)):
            which = self.rows.part == kind
            result[which] = values[self.rows.level[which]]
        if shape.any():
            picked = shapes[self.rows.level[shape], self.rows.channel[shape]]
            log_size = np.log(np.abs(picked) * self.test.amplitudes[self.rows.level[shape]])
            result[shape] = np.where(self.rows.part[shape] == Part.PHASE, np.angle(picked), log_size)
        return result

    def stepped(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> list[PeriodicState | None]:
        """Solutions of a slightly different rig by one Newton step."""
        parts = cache.parts(rig, self.setup)
        result: list[PeriodicState | None] = [None] * len(states)
        solved = [(position, state) for position, state in enumerate(states) if state is not None]
        if not solved:
            return result
        z = np.array([self._carried(parts, state, state.drive) for _, state in solved])
        # Not at the pole of the linear system itself, where transfer functions are infinite.
        z[:, -2] *= 1.0 + _OFF_POLE
        moved, _ = stepped(z, *self._arguments(parts, z, np.array([state.drive for _, state in solved])))
        for (position, state), unknowns in zip(solved, moved, strict=True):
            result[position] = PeriodicState(unknowns, parts.keys, state.drive, _NO_CHANNELS)
        return result

    def _arguments(self, parts: RigParts, z: FloatArray, amplitudes: FloatArray) -> tuple[Any, ...]:
        """Arguments of the kernel behind the unknowns (levels, nz)."""
        closing = Closing(FREE, self._own)
        return closing, free_rows(z, amplitudes, closing, parts.kernel_tables), parts.first_input, parts.kernel_tables

    def _continued(
        self, parts: RigParts, guess: PeriodicState | None, amplitude: float, depth: int = _DEEPEST
    ) -> PeriodicState | None:
        """Solution from a similar one, by way of amplitudes between the two where Newton's method does not reach it."""
        z = (
            self._linear_start(parts, amplitude, parts.resting)
            if guess is None
            else self._carried(parts, guess, amplitude)
        )
        found = self._newton(parts, z, amplitude)
        if found is not None or guess is None or depth == 0 or amplitude == guess.drive:
            return found
        between = self._continued(parts, guess, math.sqrt(amplitude * guess.drive), depth - 1)
        return None if between is None else self._continued(parts, between, amplitude, depth - 1)

    def _newton(self, parts: RigParts, z: FloatArray | None, amplitude: float) -> PeriodicState | None:
        if z is None:
            return None
        closing, targets, *how = self._arguments(parts, z[None], np.array([amplitude]))
        limits = Limits(self.settings.iterations, _TOLERANCE, _LARGEST_STEP)
        done = at_pole(z, closing, targets[0], parts.kernel_tables)
        try:
            if not done:
                done, z, _ = newton(z, closing, targets[0], *how, limits)
        except np.linalg.LinAlgError:
            return None
        return PeriodicState(z, parts.keys, amplitude, _NO_CHANNELS) if done else None

    def _linear_start(
        self, parts: RigParts, amplitude: float, tangents: tuple[FloatArray, FloatArray]
    ) -> FloatArray | None:
        """Pole of the linearised system nearest to the frequency of the switch-off, and its shape; None without one.

        Args:
            parts: of the rig.
            amplitude: of the channel.
            tangents: stiffness and damping of each coordinate's forces, (r,) each.
        """
        basis = self.setup.basis
        s = 2j * np.pi * self.test.frequency_hz * parts.clock
        # Not at the pole itself: without tangents at rest it is one of the transfer functions too.
        pole = self._pole(parts, s, tangents)
        if pole is None:
            return None
        s = pole * (1.0 + 1e-5)
        w, outputs = resting_response(s, *tangents, parts.first_input[basis.fundamental], parts.kernel_tables)
        gain, _ = sensor_gain(1j * s.imag, parts.channels[self._own])
        amplitudes = np.zeros((parts.coordinates, basis.orders.size), dtype=np.complex128)
        amplitudes[:, basis.fundamental] = w / outputs[self._own] * amplitude / abs(gain)
        return np.concatenate((basis.to_real(amplitudes).ravel(), [s.imag, -s.real / s.imag]))

    @staticmethod
    def _pole(parts: RigParts, near: complex, tangents: tuple[FloatArray, FloatArray]) -> complex | None:
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
        return complex(poles[np.argmin(np.abs(poles.imag - near.imag))]) if poles.size else None

    def _carried(self, parts: RigParts, state: PeriodicState, amplitude: float) -> FloatArray:
        z = state.z.copy()
        z[:-2] *= amplitude / state.drive
        if state.keys == parts.keys:
            return z
        # A state of the linear system may be its pole to the last bit.
        z[-2] *= 1.0 + _OFF_POLE
        closing, targets, *how = self._arguments(parts, z[None], np.array([amplitude]))
        shared = shared_unknowns(state.keys, parts.keys, self.setup.basis.size)
        return cast(FloatArray, carried(z, *shared, closing, targets[0], *how))
