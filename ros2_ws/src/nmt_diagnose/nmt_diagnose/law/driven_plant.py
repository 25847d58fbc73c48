"""The model of a driven rig about rest: response of its channels to forces at places, and the motion of its places.

The measured force and a force at any place act on poles that are stepped exactly. The motion of a place is estimated
from the measured responses by a model on which an unknown force acts there: a random walk, found by the Kalman filter
in its steady state and smoothed backwards (Bryson and Frazier, Proc. Optimum System Synthesis Conf. (1963)). A sensor
at the place nearly determines it; without one the other sensors and the model do. The step of the walk is its value of
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.prediction.linear_model import LinearModel, OutputRows, linear_model
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.record_kernel import SteppedModel, poles_at, stepped_model
from nmt_diagnose.prediction.rig_parts import RigParts
from nmt_diagnose.prediction.rig_tables import GAIN

_WALKS = 10.0 ** np.arange(-4.0, 0.75, 0.75)  # of the unknown force from sample to sample, over the measured force
_ELSEWHERE = 0.003  # forces at other places over the measured one: what no model has
_FORGOTTEN = 2.0  # periods of the slowest motion in which the walk comes back: accelerometers tell no slow force
_HEAD = 400  # samples that the state at the beginning is read off
_DOUBLINGS = 40


@dataclass(frozen=True)
class DrivenPlant:
    """A rig driven by one measured force.

    Attributes:
        parts: of the rig, its exciter left out.
        places: points, and the other point of each; 0 = the ground.
        directions: of coordinates with local forces and then of the places, (N, r + p).
        linear: poles; inputs are forces along the directions and at the exciter, outputs displacements along the
            directions, channels, and displacement, velocity and acceleration of all unknowns.
        channels: number of channels.
        rate: of the recorded samples, Hz.
        stride: steps of a force at a place from one recorded sample to the next.
    """

    parts: RigParts
    places: tuple[tuple[int, int], ...]
    directions: FloatArray
    linear: LinearModel
    channels: int
    rate: float
    stride: int

    @classmethod
    def of(
        cls,
        parts: RigParts,
        places: Sequence[tuple[int, int]],
        channels: IntArray,
        rate: float,
        stride: int,
        settings: PredictionSettings,
    ) -> DrivenPlant:
        """The model about rest: friction sticks, and contacts are as open as they are there.

        Args:
            parts: of the rig with an ideal force.
            places: where a force may act.
            channels: of the record among those of the parts.
            rate: of the recorded samples, Hz.
            stride: steps from one of them to the next.
            settings: of the predictor.
        """
        system, r = parts.system, parts.coordinates
        n = system.size
        local = parts.inputs[:, :r]
        stiffness, damping = parts.resting
        system = replace(
            system,
            stiffness=system.stiffness + (local * stiffness) @ local.T,
            damping=system.damping + (local * damping) @ local.T,
        )
        at = [system.selector(p) - (system.selector(o) if o else 0.0) for p, o in places]
        directions = np.column_stack((local, *at))
        inputs = np.column_stack((directions, parts.inputs[:, r]))
        shares = inputs.shape[1]
        picked, nothing = r + channels, np.zeros((n, n))
        feed = np.zeros((picked.size, shares))
        feed[:, :r], feed[:, -1] = parts.rows.feedthrough[picked, :r], parts.rows.feedthrough[picked, r]
        none = np.zeros_like(directions.T)
        rows = OutputRows(
            np.vstack((directions.T, parts.rows.displacement[picked], np.eye(n), nothing, nothing)),
            np.vstack((none, parts.rows.velocity[picked], nothing, np.eye(n), nothing)),
            np.vstack((none, parts.rows.acceleration[picked], nothing, nothing, np.eye(n))),
            np.vstack((np.zeros((directions.shape[1], shares)), feed, np.zeros((3 * n, shares)))),
        )
        gains = parts.channels[channels, GAIN]
        for values in (rows.displacement, rows.velocity, rows.acceleration, rows.feedthrough):
            values[directions.shape[1] : directions.shape[1] + picked.size] *= gains[:, np.newaxis]
        linear = linear_model(system, inputs, rows, settings.kept_modes, settings.full_size)
        return cls(replace(parts, system=system), tuple(places), directions, linear, picked.size, rate, stride)

    @property
    def coordinates(self) -> int:
        """Directions: coordinates with local forces, and places."""
        return int(self.directions.shape[1])

    @cached_property
    def fine(self) -> SteppedModel:
        """Recursion over a step of the forces; outputs are directions and channels."""
        rows = np.arange(self.coordinates + self.channels)
        return stepped_model(self.linear, self.coordinates, rows, 1.0 / (self.rate * self.stride))

    @cached_property
    def coarse(self) -> SteppedModel:
        """Recursion over a recorded sample; outputs are all."""
        return stepped_model(
            self.linear, self.coordinates, np.arange(self.linear.feedthrough.shape[0]), 1.0 / self.rate
        )

    @cached_property
    def over_poles(self) -> ComplexArray:
        """Share of each pole of the recursion in forces on all unknowns, (k, N): poles of symmetric matrices."""
        n, system = self.parts.system.size, self.parts.system
        first = self.coordinates + self.channels
        shapes = self.linear.displacement[first : first + n]
        size = np.einsum("ik,ij,jk->k", shapes, system.mass, shapes) * 2.0 * self.linear.poles
        size += np.einsum("ik,ij,jk->k", shapes, system.damping, shapes)
        return np.asarray((shapes / size).T[self.linear.poles.imag >= 0.0])

    def answer(self, number: int, force: FloatArray, at: IntArray) -> FloatArray:
        """Channels (c, T) at some steps under a force at an input, N, (n,), from rest."""
        model, rows = self.fine, slice(self.coordinates, None)
        poles = self._poles_under(number, force, at)
        return np.asarray(_outputs_of(model.outputs[rows], poles) + np.outer(model.direct[rows, number], force[at]))

    def motion_under(self, number: int, force: FloatArray) -> tuple[FloatArray, FloatArray, ComplexArray]:
        """Displacements and velocities (r + p, n) along the directions at all steps, and poles (samples, k)."""
        model = self.fine
        poles = self._poles_under(number, force, np.arange(force.size))
        return (
            _outputs_of(model.outputs[: self.coordinates], poles),
            _outputs_of(model.velocities, poles),
            poles[:: self.stride],
        )

    def _poles_under(self, number: int, force: FloatArray, at: IntArray) -> ComplexArray:
        model = self.fine
        early, late = model.early[:, number].copy(), model.late[:, number].copy()
        return np.asarray(poles_at(model.decay, early, late, np.ascontiguousarray(force)[:, np.newaxis], at))

    def answer_of_all(self, forces: FloatArray, at: IntArray) -> FloatArray:
        """Channels (c, T) at some recorded samples under forces on all unknowns, (samples, N), from rest."""
        model = self.coarse
        each = stepped_model(
            replace(
                self.linear, inputs=np.eye(self.linear.poles.size, dtype=np.complex128),
                feedthrough=np.zeros((self.linear.feedthrough.shape[0], self.linear.poles.size), dtype=np.complex128),
            ),
            0, np.arange(0), 1.0 / self.rate,
        )  # fmt: skip
        keep = np.flatnonzero(self.linear.poles.imag >= 0.0)
        early, late = each.early[np.arange(keep.size), keep], each.late[np.arange(keep.size), keep]
        rows = slice(self.coordinates, self.coordinates + self.channels)
        return _outputs_of(model.outputs[rows], poles_at(model.decay, early, late, forces @ self.over_poles.T, at))


@dataclass(frozen=True)
class UnknownMotion:
    """Motion that measured responses add to that under the measured force, at the recorded samples.

    Attributes:
        x, v: along the directions of the plant, (r + p, samples), m and m/s.
        force: unknown force at the place, as a force on the structure, N, (samples,).
        x_std, force_std: standard uncertainties of displacement and force at the place by the noise of the channels,
            m and N.
        poles: of the plant, (samples, k).
        inputs: numbers of the inputs with an unknown force.
        forces: these, N, (samples, inputs).
    """

    x: FloatArray
    v: FloatArray
    force: FloatArray
    x_std: float
    force_std: float
    poles: ComplexArray
    inputs: tuple[int, ...]
    forces: FloatArray


def unknown_motion(
    plant: DrivenPlant, inputs: Sequence[int], left: FloatArray, noise: FloatArray, force_size: float, slowest_hz: float
) -> UnknownMotion:
    """The motion caused by unknown forces at some inputs, from the residual of the channels under the measured force.

    Args:
        plant: the model.
        inputs: of the plant; the first is the place of interest.
        left: measured channels less the model's under the measured force, (c, samples).
        noise: standard deviation of each channel, (c,).
        force_size: of the measured force, N.
        slowest_hz: lowest frequency of the motion, Hz.
    """
    model = plant.coarse
    rows = slice(plant.coordinates, plant.coordinates + plant.channels)
    every = _real(model.early + model.decay[:, np.newaxis] * model.late)
    through = model.direct + (model.outputs @ model.late).real
    outputs = np.hstack((model.outputs.real, -model.outputs.imag))
    decay = model.decay
    turn = np.block([[np.diag(decay.real), -np.diag(decay.imag)], [np.diag(decay.imag), np.diag(decay.real)]])
    chosen = list(inputs)
    states, unknown = turn.shape[0], len(chosen)
    kept = np.exp(-2.0 * np.pi * slowest_hz / _FORGOTTEN / plant.rate)
    a = np.zeros((states + unknown, states + unknown))
    a[:states, :states], a[:states, states:] = turn, every[:, chosen] * force_size
    a[states:, states:] = kept * np.eye(unknown)
    c = np.hstack((outputs[rows], through[rows][:, chosen] * force_size)) / noise[:, np.newaxis]
    elsewhere = every * (_ELSEWHERE * force_size)
    measured = np.ascontiguousarray((left / noise[:, np.newaxis]).T)
    least, best = np.inf, None
    for walk in _WALKS:
        q = np.zeros_like(a)
        q[:states, :states] = elsewhere @ elsewhere.T
        q[states:, states:] = walk**2 * np.eye(unknown)
        p = _riccati(a, c, q)
        s = c @ p @ c.T + np.eye(len(c))
        gain = np.ascontiguousarray(np.linalg.solve(s, c @ p).T, np.float64)
        start = _start(a, c, gain, measured)
        predicted, innovations = _filtered(a, c, gain, measured, start)
        inverse = np.asarray(np.linalg.inv(s), np.float64)
        cost = float(np.einsum("nc,cd,nd->", innovations, inverse, innovations))
        cost += measured.shape[0] * float(np.linalg.slogdet(s)[1])
        if cost < least:
            least, best = cost, (p, gain, predicted, innovations, inverse)
    if best is None:
        raise ArithmeticError("no motion of the model explains the responses.")
    p, gain, predicted, innovations, inverse = best
    found = _smoothed(a, c, gain, p, inverse, predicted, innovations)
    forces = found[:, states:] * force_size
    k = decay.size
    # Inputs enter at the end of a step, too.
    poles = found[:, :k] + 1j * found[:, k:states] + forces @ model.late[:, chosen].T
    d = plant.coordinates
    x, v = (poles @ model.outputs[:d].T).real.T, (poles @ model.velocities.T).real.T
    left_open = p - p @ _of_later(a, c, gain, inverse) @ p
    row = np.hstack((model.outputs[inputs[0]].real, -model.outputs[inputs[0]].imag, np.zeros(unknown)))
    stds = [max(float(values @ left_open @ values), 0.0) ** 0.5 for values in (row, np.eye(len(a))[states])]
    return UnknownMotion(x, v, forces[:, 0], stds[0], force_size * stds[1], poles, tuple(chosen), forces)


def _outputs_of(outputs: ComplexArray, poles: ComplexArray) -> FloatArray:
    """Outputs (o, T) of poles, (T, k)."""
    return np.asarray(outputs.real @ poles.real.T - outputs.imag @ poles.imag.T)


def _real(values: ComplexArray) -> FloatArray:
    return np.vstack((values.real, values.imag))


def _riccati(a: FloatArray, c: FloatArray, q: FloatArray) -> FloatArray:
    """Covariance of the predicted state for unit noise of the channels, by doubling.

    (Chu, Fan, Lin and Wang, Int. J. Control 77 (2004) 767.) The solver of scipy by Schur vectors fails here: poles
    close to the unit circle and a walk of 1e-4 leave pencils that it cannot order.
    """
    turn, g, h = a.T.copy(), c.T @ c, q.copy()
    size = len(a)
    for _ in range(_DOUBLINGS):
        solved = np.linalg.solve(np.eye(size) + g @ h, np.hstack((turn, g)))
        more = turn.T @ h @ solved[:, :size]
        g = g + turn @ solved[:, size:] @ turn.T
        turn = turn @ solved[:, :size]
        h = h + 0.5 * (more + more.T)
        if np.max(np.abs(more)) <= 1e-12 * np.max(np.abs(h)):
            break
    return h


def _of_later(a: FloatArray, c: FloatArray, gain: FloatArray, inverse: FloatArray) -> FloatArray:
    """Information that all later samples have of a predicted state: Σ (Tᵀ)ᵏ Cᵀ S⁻¹ C Tᵏ, by doubling."""
    turn, known = a - a @ gain @ c, c.T @ inverse @ c
    for _ in range(_DOUBLINGS):
        more = turn.T @ known @ turn
        known, turn = known + more, turn @ turn
        if np.max(np.abs(more)) <= 1e-12 * np.max(np.abs(known)):
            break
    return np.asarray(known)


def _start(a: FloatArray, c: FloatArray, gain: FloatArray, measured: FloatArray) -> FloatArray:
    """State in which the first samples surprise the filter least."""
    count = min(_HEAD, measured.shape[0])
    _, surprises = _filtered(a, c, gain, measured[:count], np.zeros(len(a)))
    turn, row = a - a @ gain @ c, np.eye(len(a))
    columns = np.empty((count, *c.shape))
    for k in range(count):
        columns[k] = c @ row
        row = turn @ row
    flat = columns.reshape(-1, len(a))
    sizes = np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    return np.asarray(np.linalg.lstsq(flat / sizes, surprises.ravel(), rcond=1e-6)[0] / sizes)


def _filtered(
    a: FloatArray, c: FloatArray, gain: FloatArray, measured: FloatArray, start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Predicted states (samples, d) and what the channels differ from them by (samples, c)."""
    predicted = _recursion(a - a @ gain @ c, measured[:-1] @ (a @ gain).T, start)
    return predicted, measured - predicted @ c.T


def _smoothed(
    a: FloatArray,
    c: FloatArray,
    gain: FloatArray,
    p: FloatArray,
    inverse: FloatArray,
    predicted: FloatArray,
    surprises: FloatArray,
) -> FloatArray:
    """States (samples, d) by all samples: the surprises of later ones come back by the filter's transpose."""
    weighted = (surprises @ inverse @ c)[::-1]
    return np.asarray(predicted + _recursion((a - a @ gain @ c).T, weighted[1:], weighted[0])[::-1] @ p)


@njit(cache=True)
def _stepped(turn: FloatArray, driven: FloatArray, states: FloatArray) -> None:
    for n in range(1, states.shape[0]):
        np.dot(turn, states[n - 1], states[n])
        states[n] += driven[n - 1]


def _recursion(turn: FloatArray, driven: FloatArray, start: FloatArray) -> FloatArray:
    """States x₀ = ``start``, xₙ₊₁ = ``turn`` xₙ + ``driven``ₙ, one for each sample that drives and the last."""
    states = np.empty((len(driven) + 1, start.size))
    states[0] = start
    _stepped(np.ascontiguousarray(turn), np.ascontiguousarray(driven), states)
    return states
