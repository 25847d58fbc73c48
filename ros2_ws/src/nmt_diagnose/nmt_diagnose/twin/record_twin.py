"""Records: the model driven by the measured input, stepped pole by pole with its local forces in between.

Between two steps the local forces run linearly (first-order hold) while the linear part is exact; the steps are a
sixtieth of the fastest period that matters: (π/60)²/3 of the local forces, 0.1 %, is lost. The measured input is
interpolated as the band-limited signal it is.
"""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict

import numpy as np
from numba import njit
from scipy.signal import resample_poly

from nmt_core.blocks import FloatArray, Quantity
from nmt_diagnose.observations.conditions import RecordTest
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.twin.converter import expected_quantised
from nmt_diagnose.twin.linear_model import ComplexArray
from nmt_diagnose.twin.parts_cache import PartsCache, Setup
from nmt_diagnose.twin.rig_parts import RigParts
from nmt_diagnose.twin.twin_settings import TwinSettings
from nmt_rig.model.aft import LocalTables
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements import element_response
from nmt_rig.rig import Rig

STEPS_PER_PERIOD = 60.0
MOST_SUBSTEPS = 32
ITERATIONS = 12
TOLERANCE = 1e-7  # of the largest force so far
REMEMBERED = 3


class RecordTwin:
    """Predicts the samples of one record.

    Args:
        test: the record.
        rows: its rows.
        settings: of the twin.
    """

    def __init__(self, test: RecordTest, rows: Rows, settings: TwinSettings) -> None:
        self.test, self.rows, self.settings = test, rows, settings
        self.ideal_force = test.input_channel.quantity == Quantity.FORCE
        self.channels = tuple(test.channels)
        self._known: OrderedDict[bytes, FloatArray] = OrderedDict()
        self.use(Setup(test.drive_point, self.ideal_force, self.channels, FourierBasis.up_to(1)))
        self._sample = np.clip(
            np.round((rows.time_s - test.start_s) * test.sample_rate).astype(np.int64), 0, test.input.size - 1
        )
        self._inputs: dict[int, FloatArray] = {}

    def use(self, setup: Setup) -> None:
        """Take the parts of rigs from a setup that other tests share."""
        self.setup = setup
        self._own = np.array(setup.index(self.channels), dtype=np.int64)
        self._known.clear()

    def values(self, rig: Rig, cache: PartsCache) -> FloatArray:
        """Observables of the test's rows."""
        responses = self.responses(rig, cache)
        result = np.full(len(self.rows), np.nan)
        which = self.rows.part == Part.SAMPLE
        result[which] = responses[np.maximum(self.rows.channel[which], 0), self._sample[which]]
        return result

    def responses(self, rig: Rig, cache: PartsCache) -> FloatArray:
        """Recorded responses without their mean (channels, samples)."""
        test = self.test
        middle = test.start_s + 0.5 * test.input.size / test.sample_rate
        parts = cache.parts(rig, self.setup, middle)
        rate = test.sample_rate * parts.clock
        substeps = self._substeps(parts, rate)
        raw = self._raw(parts, rate, substeps)
        result = np.empty_like(raw)
        for position, index in enumerate(self._own):
            values = _through_sensor(raw[position], rate, parts.channels[index])
            level, step, noise = parts.limits[index]
            if math.isfinite(level):
                values = np.clip(values, -level, level)
            if step > 0.0 and noise < 0.7 * step:
                values = expected_quantised(values, step, noise)
            result[position] = values - float(values.mean())
        return np.asarray(result, dtype=np.float64)

    def _raw(self, parts: RigParts, rate: float, substeps: int) -> FloatArray:
        """What the channels would record without their sensors; rigs that differ in sensors only share it."""
        saturation = math.inf if self.ideal_force else parts.saturation
        gain = 1.0 if self.ideal_force else parts.input_per_volt
        rows = np.concatenate((np.arange(parts.coordinates), parts.coordinates + self._own))
        model = stepped_model(parts, rows, 1.0 / (rate * substeps))
        digest = hashlib.sha256(repr((substeps, saturation, gain)).encode())
        for array in (*model, parts.force_factor, *parts.tables[3:10]):
            digest.update(repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
        key = digest.digest()
        if key not in self._known:
            drive = self._interpolated(substeps)
            if math.isfinite(saturation):
                drive = saturation * np.tanh(drive / saturation)
            self._known[key] = step_through(
                gain * drive, substeps, parts.coordinates, *model, parts.force_factor, parts.tables
            )
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        self._known.move_to_end(key)
        return self._known[key]

    def _substeps(self, parts: RigParts, rate: float) -> int:
        """Steps per sample: from the fastest oscillation below half of a tenth of the sampling rate, if any."""
        poles = parts.linear.poles
        oscillating = np.abs(poles.imag[(np.abs(poles.real) < 0.5 * np.abs(poles)) & (poles.imag > 0.0)])
        seen = oscillating[oscillating < 0.5 * np.pi * rate]
        fastest = float(seen.min()) / (2.0 * np.pi) if seen.size else 0.05 * rate
        return int(min(max(math.ceil(STEPS_PER_PERIOD * fastest / rate), 1), MOST_SUBSTEPS))

    def _interpolated(self, substeps: int) -> FloatArray:
        if substeps not in self._inputs:
            own = np.asarray(self.test.input, dtype=np.float64)
            found = own if substeps == 1 else np.asarray(resample_poly(own, substeps, 1, window=("kaiser", 10.0)))
            self._inputs[substeps] = np.ascontiguousarray(found)
        return self._inputs[substeps]


def _through_sensor(values: FloatArray, rate: float, chain: FloatArray) -> FloatArray:
    """Recorded values of a channel: gain, delay and filters, in the frequency domain."""
    gain, delay, low_pass, high_pass = (float(value) for value in chain)
    if delay == 0.0 and low_pass == 0.0 and high_pass == 0.0:
        return gain * values
    s = 2j * np.pi * np.fft.rfftfreq(values.size, 1.0 / rate)
    response = gain * np.exp(-s * delay) / (1.0 + s * low_pass)
    if high_pass > 0.0:
        response = response * s / (s + high_pass)
    result: FloatArray = np.fft.irfft(response * np.fft.rfft(values), values.size)
    return result


SteppedModel = tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray, ComplexArray, FloatArray]


def stepped_model(parts: RigParts, rows: np.ndarray, step: float) -> SteppedModel:
    """Recursion of the poles over one step.

    Returns:
        decay (k,), shares of the inputs at the beginning and at the end of a step (k, p), outputs of coordinates and
        channels (o, k), velocities of the coordinates (r, k), direct share of the inputs in the outputs (o, p). One k
        for each pair of poles; real parts of the sums are meant.
    """
    model = parts.linear
    keep = model.poles.imag >= 0.0
    poles = model.poles[keep]
    weight = np.where(np.abs(poles.imag) > 1e-12 * np.abs(poles), 2.0, 1.0)
    z = poles * step
    decay = np.exp(z)
    small = np.abs(z) < 1e-4
    safe = np.where(small, 1.0, z)
    first = np.where(small, 1.0 + z / 2.0 + z**2 / 6.0, (decay - 1.0) / safe)
    second = np.where(small, 0.5 + z / 6.0 + z**2 / 24.0, (decay - 1.0 - z) / safe**2)
    inputs = model.inputs[keep]
    p = model.poles
    outputs = model.displacement[rows] + model.velocity[rows] * p + model.acceleration[rows] * p**2
    r = parts.coordinates
    direct = (model.velocity[rows] + model.acceleration[rows] * model.poles) @ model.inputs + model.feedthrough[rows]
    return (
        decay,
        np.ascontiguousarray(step * (first - second)[:, None] * inputs),
        np.ascontiguousarray(step * second[:, None] * inputs),
        np.ascontiguousarray(outputs[:, keep] * weight),
        np.ascontiguousarray(model.displacement[:r, keep] * poles * weight),
        np.ascontiguousarray(direct.real),
    )


@njit(cache=True)
def coordinate_forces(
    w: FloatArray,
    v: FloatArray,
    sliders: FloatArray,
    moved: FloatArray,
    factor: FloatArray,
    tables: LocalTables,
    g: FloatArray,
    by_displacement: FloatArray,
    by_velocity: FloatArray,
) -> None:
    """Forces (r,) of the coordinates and their tangents (r, r), written to the last three arguments; ``moved`` gets the
    sliders after the step."""
    jenkins, jenkins_start, contacts, contacts_start, kinds, parameters, sampled_start = tables[3:10]
    elements = jenkins_start.size - 1
    by_displacement[:] = 0.0
    by_velocity[:] = 0.0
    for i in range(elements):
        force = 0.0
        stiffness = 0.0
        damping = 0.0
        for e in range(jenkins_start[i], jenkins_start[i + 1]):
            own, k, _, slider = element_response(1, jenkins[e], w[i], v[i], sliders[e])
            moved[e] = slider
            force += own
            stiffness += k
        for e in range(contacts_start[i], contacts_start[i + 1]):
            side = contacts[e, 2]
            overlap = side * w[i] - contacts[e, 1]
            if overlap > 0.0:
                force += side * contacts[e, 0] * overlap
                stiffness += contacts[e, 0]
        for e in range(sampled_start[i], sampled_start[i + 1]):
            own, k, c, _ = element_response(kinds[e], parameters[e], w[i], v[i], 0.0)
            force += own
            stiffness += k
            damping += c
        g[i] = force
        by_displacement[i, i] = stiffness
        by_velocity[i, i] = damping
    r = g.size
    if r > elements:
        x, current = w[r - 2], w[r - 1]
        f = factor[1] * x + factor[2] * x * x
        slope = factor[1] + 2.0 * factor[2] * x
        g[r - 2] = -f * current
        by_displacement[r - 2, r - 2] = -slope * current
        by_displacement[r - 2, r - 1] = -f
        g[r - 1] = f * v[r - 2]
        by_displacement[r - 1, r - 2] = slope * v[r - 2]
        by_velocity[r - 1, r - 2] = f


@njit(cache=True)
def step_through(
    drive: FloatArray,
    substeps: int,
    r: int,
    decay: ComplexArray,
    early: ComplexArray,
    late: ComplexArray,
    outputs: ComplexArray,
    velocities: ComplexArray,
    direct: FloatArray,
    factor: FloatArray,
    tables: LocalTables,
) -> FloatArray:
    """Channels (c, samples) from rest; see ``stepped_model``."""
    count = decay.size
    c = outputs.shape[0] - r
    samples = drive.size // substeps
    result = np.empty((c, samples))
    state = np.zeros(count, dtype=np.complex128)
    sliders = np.zeros(tables[3].shape[0])
    moved = np.zeros(tables[3].shape[0])
    g = np.zeros(r)
    trial = np.zeros(r)
    w = np.zeros(r)
    v = np.zeros(r)
    free_w = np.zeros(r)
    free_v = np.zeros(r)
    kw = np.zeros((r, r))
    kv = np.zeros((r, r))
    # What a force at the end of a step does to displacement and velocity there.
    dw = np.zeros((r, r))
    dv = np.zeros((r, r))
    for i in range(r):
        for j in range(r):
            for k in range(count):
                dw[i, j] += (outputs[i, k] * late[k, j]).real
                dv[i, j] += (velocities[i, k] * late[k, j]).real
    free = tables[3].shape[0] + tables[5].shape[0] + tables[7].shape[0] == 0 and tables[4].size - 1 == r
    before = np.zeros(r)
    largest = 1e-300
    previous = 0.0
    for n in range(drive.size):
        u = drive[n]
        for k in range(count):
            x = decay[k] * state[k] + early[k, r] * previous + late[k, r] * u
            if not free:
                for j in range(r):
                    x -= early[k, j] * g[j]
            state[k] = x
        previous = u
        for i in range(0 if free else r):
            a = 0.0
            b = 0.0
            for k in range(count):
                a += (outputs[i, k] * state[k]).real
                b += (velocities[i, k] * state[k]).real
            free_w[i] = a
            free_v[i] = b
            # Where the force seems to go: a step of the iteration saved.
            trial[i] = 2.0 * g[i] - before[i]
            before[i] = g[i]
        for _ in range(0 if free else ITERATIONS):
            for i in range(r):
                w[i] = free_w[i]
                v[i] = free_v[i]
                for j in range(r):
                    w[i] -= dw[i, j] * trial[j]
                    v[i] -= dv[i, j] * trial[j]
            coordinate_forces(w, v, sliders, moved, factor, tables, g, kw, kv)
            error = 0.0
            size = largest
            for i in range(r):
                error = max(error, abs(g[i] - trial[i]))
                size = max(size, abs(g[i]))
            if error <= TOLERANCE * size:
                break
            if r == 1:
                trial[0] += (g[0] - trial[0]) / (1.0 + kw[0, 0] * dw[0, 0] + kv[0, 0] * dv[0, 0])
            else:
                system = np.eye(r) + kw @ dw + kv @ dv
                trial += np.linalg.solve(system, g - trial)
        for e in range(sliders.size):
            sliders[e] = moved[e]
        if not free:
            for j in range(r):
                largest = max(largest, abs(g[j]))
                for k in range(count):
                    state[k] -= late[k, j] * g[j]
        if n % substeps == 0:
            for o in range(c):
                y = direct[r + o, r] * u
                for j in range(r):
                    y -= direct[r + o, j] * g[j]
                for k in range(count):
                    y += (outputs[r + o, k] * state[k]).real
                result[o, n // substeps] = y
    return result
