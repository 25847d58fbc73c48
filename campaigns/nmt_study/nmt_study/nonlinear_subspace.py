"""Nonlinear subspace identification: polynomial forces as further inputs of a linear state space.

A nonlinear restoring force p₂ w² + p₃ w³ + … at a known place is an input that was measured, because w was
(Marchesiello and Garibaldi, Shock and Vibration 15 (2008) 345; Noël and Kerschen, Mech. Syst. Signal Process. 40 (2013)
701):

    x⁺ = A x + B f + E [w², w³, …]ᵀ,   y = C x.

A and C come from N4SID of the library nfoursid, with all inputs; B and E from least squares over all recordings, in
which the outputs are linear for known A and C. With w taken from y the model runs by itself: a polynomial nonlinear
state space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import root
from scipy.signal import lfilter

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray

POWERS = (2, 3, 4, 5)
ORDERS = (4, 6, 8)
SAMPLE_RATE = 500.0
"""Of the identification, Hz: 25 samples a period of the mode, 5 of its fifth harmonic."""
AMPLITUDES = (3e-5, 7e-4)
"""Modal amplitudes q of the backbone, m√kg."""
SWEEP_HZ = (15.0, 25.0)
BLOCK_ROWS = 20
MOST_SAMPLES = 2500
"""The library decomposes a matrix of so many rows and columns."""
_SLOWEST = 1.0 - 1e-6
_SAMPLES_A_PERIOD = 64
_SOLVED = 1e-6


@dataclass(frozen=True, eq=False)
class Recording:
    """A stretch of a test.

    Attributes:
        force: (n,) at the drive point, N.
        outputs: (o, n) displacements, m.
    """

    force: FloatArray
    outputs: FloatArray


@dataclass(frozen=True, eq=False)
class PolynomialStateSpace:
    """Modal form of an identified model.

    Attributes:
        poles: (k,) of A, one of each pair.
        outputs: (o, k) motion of each; the real part counts.
        inputs: (k, 1 + powers) share of the force and of the polynomials.
        powers: of w.
        place: (o,) w as a sum of outputs.
        scale: w by which the polynomials are taken, m.
        sample_rate: Hz.
    """

    poles: ComplexArray
    outputs: ComplexArray
    inputs: ComplexArray
    powers: tuple[int, ...]
    place: FloatArray
    scale: float
    sample_rate: float

    def simulate(self, force: FloatArray) -> FloatArray:
        """Outputs (o, n) under a force (n,), from rest; NaN from where the motion has no bound."""
        result = np.full((len(self.outputs), force.size), np.nan)
        state = np.zeros(self.poles.size, dtype=np.complex128)
        inputs = np.empty(self.inputs.shape[1])
        for n in range(force.size):
            y = (self.outputs @ state).real
            w = float(self.place @ y) / self.scale
            if not abs(w) < 1e3:
                break
            result[:, n] = y
            inputs[0] = force[n]
            inputs[1:] = [w**power for power in self.powers]
            state = self.poles * state + self.inputs @ inputs
        return result

    def responses(self, omega: float) -> ComplexArray:
        """Outputs (o, 1 + powers) by the inputs at ω (rad/s)."""
        z = np.exp(1j * omega / self.sample_rate)
        direct = self.outputs @ (self.inputs / (z - self.poles)[:, None])
        mirrored = self.outputs.conj() @ (self.inputs.conj() / (z - self.poles.conj())[:, None])
        return np.asarray(0.5 * (direct + mirrored))

    def phase_resonance(self, amplitudes: Sequence[float], drive: int, omega: float, harmonics: int = 7) -> FloatArray:
        """Phase resonance at the drive point under a harmonic force, by harmonic balance.

        Args:
            amplitudes: of the fundamental of w, m, ascending.
            drive: output at the drive point.
            omega: where to begin, rad/s.
            harmonics: of w.

        Returns:
            (amplitudes, 2 + 2 o): ω, the force (N), real and imaginary parts of the outputs' fundamentals; NaN where
            none was found.
        """
        found = np.full((len(amplitudes), 2 + 2 * len(self.outputs)), np.nan)
        response = self.responses(omega)[:, 0]
        w = complex(self.place @ response)
        # In units of the amplitude, of ω and of the force, which goes with the amplitude at first.
        guess = np.zeros(2 * harmonics + 3)
        guess[1], guess[harmonics + 1] = w.real / abs(w), -w.imag / abs(w)
        guess[-2:] = 1.0
        force = 1.0 / abs(w)
        for k, amplitude in enumerate(amplitudes):
            balance = _Balance(self, float(amplitude), drive, omega, force * float(amplitude), harmonics)
            solution = root(balance, guess, tol=1e-12)
            if not np.abs(solution.fun).max() < _SOLVED:
                break
            guess = solution.x
            made, _ = balance.harmonics_at(guess)
            found[k] = [guess[-2] * omega, guess[-1] * balance.force, *made[:, 1].real, *made[:, 1].imag]
        return found


@dataclass(frozen=True, eq=False)
class _Balance:
    """Harmonic balance at phase resonance for one amplitude of w; the unknowns are w's coefficients, ω and the force.

    Attributes:
        model: the identified model.
        amplitude: of the fundamental of w, m, unit of its coefficients.
        drive: output at the drive point.
        omega, force: units of ω (rad/s) and of the force (N).
        harmonics: of w.
    """

    model: PolynomialStateSpace
    amplitude: float
    drive: int
    omega: float
    force: float
    harmonics: int

    def harmonics_at(self, unknowns: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Amplitudes of the outputs (o, harmonics + 1) that force and polynomials make and of w (harmonics + 1,), m."""
        highest, model = self.harmonics, self.model
        own = np.zeros(highest + 1, dtype=np.complex128)
        own[0] = unknowns[0]
        own[1:] = unknowns[1 : highest + 1] - 1j * unknowns[highest + 1 : 2 * highest + 1]
        own *= self.amplitude
        angle = 2.0 * np.pi * np.arange(_SAMPLES_A_PERIOD) / _SAMPLES_A_PERIOD
        w = (own @ np.exp(1j * np.outer(np.arange(highest + 1), angle))).real / model.scale
        forces = np.fft.rfft([w**power for power in model.powers], axis=1)[:, : highest + 1] / angle.size
        forces[:, 1:] *= 2.0
        made = np.empty((len(model.outputs), highest + 1), dtype=np.complex128)
        for order in range(highest + 1):
            inputs = np.concatenate(([unknowns[-1] * self.force if order == 1 else 0.0], forces[:, order]))
            made[:, order] = model.responses(order * unknowns[-2] * self.omega) @ inputs
        return made, own

    def __call__(self, unknowns: FloatArray) -> FloatArray:
        """Residual: w as it is made, quadrature of force and drive point, amplitude."""
        made, own = self.harmonics_at(unknowns)
        off = (self.model.place @ made - own) / self.amplitude
        turn = made[self.drive, 1] / (abs(made[self.drive, 1]) or 1.0)
        return np.concatenate((off.real, off.imag[1:], [turn.real, abs(own[1]) / self.amplitude - 1.0]))


def identify(
    recordings: Sequence[Recording], place: FloatArray, powers: Sequence[int], order: int, sample_rate: float
) -> PolynomialStateSpace:
    """Identify a model; A and C from the recording with the largest motion.

    Args:
        recordings: of the same structure.
        place: (o,) w as a sum of the outputs.
        powers: of w that are forces.
        order: states.
        sample_rate: Hz.

    Raises:
        BenchError: the recordings are too short, or no oscillation was found in them.
    """
    from nfoursid.nfoursid import NFourSID
    from pandas import DataFrame

    largest = max(recordings, key=lambda r: float(np.abs(place @ r.outputs).max()))
    scale = float(np.abs(place @ largest.outputs).max())
    if largest.force.size < 20 * BLOCK_ROWS or not scale > 0.0:
        raise BenchError(f"A recording of {largest.force.size} samples is too short, or nothing moves in it.")
    inputs = _inputs(largest, place, powers, scale)
    middle = max(0, (largest.force.size - MOST_SAMPLES) // 2)
    part = slice(middle, middle + MOST_SAMPLES)
    sizes = np.concatenate((inputs.std(axis=1), largest.outputs.std(axis=1)))
    table = DataFrame((np.vstack((inputs, largest.outputs))[:, part] / sizes[:, None]).T)
    columns = list(table.columns)
    subspace = NFourSID(table, columns[len(inputs) :], columns[: len(inputs)], num_block_rows=BLOCK_ROWS)
    subspace.subspace_identification()
    found, _ = subspace.system_identification(rank=order)
    values, vectors = np.linalg.eig(found.a)
    rows = (found.c @ vectors) * sizes[len(inputs) :, None]
    kept = values.imag > 0.0
    if not kept.any():
        raise BenchError("No oscillation was found in the recordings; choose a higher order or a longer recording.")
    poles = values[kept]
    poles = poles * np.minimum(1.0, _SLOWEST / np.abs(poles))
    shapes = rows[:, kept]
    shares = _shares(recordings, place, powers, scale, poles, shapes)
    return PolynomialStateSpace(poles, shapes, shares, tuple(powers), place, scale, sample_rate)


def _inputs(recording: Recording, place: FloatArray, powers: Sequence[int], scale: float) -> FloatArray:
    w = place @ recording.outputs / scale
    return np.vstack((recording.force, *(w**power for power in powers)))


def _shares(
    recordings: Sequence[Recording], place: FloatArray, powers: Sequence[int], scale: float, poles: ComplexArray,
    shapes: ComplexArray,
) -> ComplexArray:  # fmt: skip
    """B and E (k, 1 + powers) by least squares over all recordings, each with an initial state of its own."""
    count = 1 + len(powers)
    weights = 1.0 / np.array([np.sqrt(np.mean(recording.outputs**2)) for recording in recordings])
    width = 2 * poles.size * (count + len(recordings))
    normal, right = np.zeros((width, width)), np.zeros(width)
    for number, recording in enumerate(recordings):
        inputs = _inputs(recording, place, powers, scale)
        n = recording.force.size
        first = np.zeros(n, dtype=np.complex128)
        first[0] = 1.0
        columns = []
        for pole in poles:
            # x⁺ = λ x + u: the state follows its input by a sample.
            moved = [lfilter([0.0, 1.0], [1.0, -pole], signal.astype(np.complex128)) for signal in inputs]
            free = [np.zeros(n, dtype=np.complex128) for _ in recordings]
            free[number] = lfilter([1.0], [1.0, -pole], first)
            columns.append(np.array([*moved, *free]))
        for row, y in zip(shapes, recording.outputs, strict=True):
            matrix = np.vstack([shape * own for shape, own in zip(row, columns, strict=True)]) * weights[number]
            real = np.vstack((matrix.real, -matrix.imag))
            normal += real @ real.T
            right += real @ (y * weights[number])
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    solved = np.linalg.lstsq(normal / np.outer(size, size), right / size, rcond=1e-13)[0] / size
    shares = (solved[: width // 2] + 1j * solved[width // 2 :]).reshape(poles.size, count + len(recordings))
    return np.asarray(shares[:, :count])
