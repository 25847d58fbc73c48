"""A rig's linear model fitted to measured frequency responses: its modes, and gain and delay of every channel.

Frequency and damping of each mode are moved in the structure's own matrices, so that resonances, antiresonances and the
force behind the exciter move as they do on the bench. What Welch's estimator makes of a sharp resonance is part of the
model: the expectation of a cross spectrum is the response smoothed by the power spectrum of the window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_plant.devices.simulated_rig import rig_sensors, sensor_row
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_resting_elements, build_structure, build_system, input_per_volt

_FINE = 4  # points of the model between two lines
_MOST_UNKNOWNS = 200  # of a model whose matrices are solved at every frequency
_MOST_GROUPS = 8  # of channels, for the scatter between them
_RATIOS = np.geomspace(0.7, 1.4, 141)


class MovedModes:
    """Frequency responses of a rig's sensors to its drive, SI units per volt, as a function of its structure's modes.

    Args:
        rig: the rig; its contacts are at rest.
        lines: Hz, equally spaced, shape ``(L,)``.
        channels: names of the sensors, in the order wanted.

    Attributes:
        numbers: of the modes that can be moved, from 0, shape ``(m,)``.
        frequencies: of the modes that can be moved, those between the lines, rad/s, shape ``(m,)``.
        damping: their damping ratios, same shape.

    Raises:
        ValueError: the model is too large, or no mode lies between the lines.
    """

    def __init__(self, rig: Rig, lines: FloatArray, channels: Sequence[str]) -> None:
        structure = build_structure(rig)
        system = build_system(rig, structure)
        if system.size > _MOST_UNKNOWNS:
            raise ValueError("the model is too large")
        modes = sticking_modes(structure, build_resting_elements(rig, structure))
        step = float(lines[1] - lines[0])
        hz = modes.frequencies / (2.0 * np.pi)
        chosen = np.flatnonzero((hz > lines[0]) & (hz < lines[-1]))
        if not chosen.size:
            raise ValueError("no mode lies between the lines")
        self.numbers = chosen
        self.frequencies, self.damping = modes.frequencies[chosen], modes.damping_ratios[chosen]
        ends = np.zeros((system.size, chosen.size))
        ends[: system.structure_size] = structure.mass @ modes.full_shapes[:, chosen]
        self._lines = lines.size
        fine = lines[0] + step / _FINE * np.arange(-4 * _FINE, (lines.size + 3) * _FINE + 1)
        s = 2j * np.pi * fine
        self._s = s
        given = np.column_stack((system.input_vector * input_per_volt(rig), ends)).astype(np.complex128)
        stiffness, damping = system.sticking_stiffness(), system.resting_damping()
        solved = np.array([np.linalg.solve(stiffness + x * damping + x * x * system.mass, given) for x in s])
        order = [sensor.channel for sensor in rig_sensors(rig)]
        rows = [sensor_row(system, rig, order.index(name)) for name in channels]
        parts = np.array([[row.displacement, row.velocity, row.acceleration] for row in rows])
        powers = np.stack((np.ones_like(s), s, s * s), axis=1)
        self._out = np.einsum("fp,cpn,fnk->kfc", powers, parts, solved)
        self._through = input_per_volt(rig) * np.array([row.feedthrough for row in rows])
        self._between = np.ascontiguousarray(np.einsum("nj,fnk->jkf", ends, solved))
        # Power spectrum of the Hann window about its line, at the fine frequencies.
        away = np.arange(-4 * _FINE, 4 * _FINE + 1) / _FINE
        window = np.sinc(away) + 0.5 * (np.sinc(away - 1.0) + np.sinc(away + 1.0))
        self._kernel = window**2 / np.sum(window**2)

    def __call__(self, frequency: FloatArray, damping: FloatArray) -> ComplexArray:
        """Responses per volt of drive, (channels, L), of modes with these ratios to the model's, each (m,)."""
        moved, old = frequency * self.frequencies, 2.0 * self.damping * self.frequencies
        stiffer, damped = moved**2 - self.frequencies**2, 2.0 * damping * self.damping * moved - old
        active = np.flatnonzero((stiffer != 0.0) | (damped != 0.0))  # a mode that stays where it is adds nothing
        change = stiffer[active, None] + damped[active, None] * self._s
        between = change[:, None] * self._between[active][:, np.append(0, 1 + active)]
        between[np.arange(active.size), 1 + np.arange(active.size)] += 1.0
        found = self._out[0] + self._through
        for mode, inner in zip(active, _eliminated(between[:, 1:], between[:, 0]), strict=True):
            found = found - inner[:, None] * self._out[1 + mode]
        smooth = np.lib.stride_tricks.sliding_window_view(found, self._kernel.size, axis=0)[::_FINE] @ self._kernel
        return np.asarray(smooth[: self._lines].T)


def _eliminated(matrices: ComplexArray, given: ComplexArray) -> ComplexArray:
    """Solutions (k, F) of F systems of k equations (k, k, F), (k, F) each; both are changed.

    Gauss elimination of all of them at once: k is small and F large, and LAPACK is called for one after the other.
    Damping keeps the pivots off zero.
    """
    size = len(given)
    for pivot in range(size):
        for row in range(pivot + 1, size):
            factor = matrices[row, pivot] / matrices[pivot, pivot]
            matrices[row, pivot + 1 :] -= factor * matrices[pivot, pivot + 1 :]
            given[row] -= factor * given[pivot]
    for row in reversed(range(size)):
        for later in range(row + 1, size):
            given[row] -= matrices[row, later] * given[later]
        given[row] /= matrices[row, row]
    return given


@dataclass(frozen=True, eq=False)
class ModelFit:
    """What a fit found, with standard uncertainties.

    Attributes:
        mode_hz: frequencies of the model's modes, Hz, shape ``(m,)``.
        frequency, frequency_std: ratios to them, same shape.
        damping, damping_std: damping ratios found, 1.
        rows: channels that were fitted.
        gain, gain_std: measured over expected, with sign, one a row.
        delay, delay_std: s, later than the median of the channels, one a row.
    """

    mode_hz: FloatArray
    frequency: FloatArray
    frequency_std: FloatArray
    damping: FloatArray
    damping_std: FloatArray
    rows: tuple[int, ...]
    gain: FloatArray
    gain_std: FloatArray
    delay: FloatArray
    delay_std: FloatArray


def scan_modes(
    model: MovedModes, measured: FloatArray, clear: FloatArray, at_rest: ComplexArray, expected: FloatArray
) -> FloatArray:
    """Ratios of the modes' frequencies that fit most channels, whatever their gains and phases.

    Args:
        model: the rig.
        measured, expected: magnitudes of the responses, and what a simulation of the check gives, (channels, L).
        clear: which lines count, same shape, bool.
        at_rest: the model's responses with its own modes, same shape.

    Returns:
        Shape ``(m,)``; 1 where no other ratio explains a good deal more.
    """
    plain = np.ones(model.frequencies.size)

    def costs_of(trials: FloatArray) -> FloatArray:
        """Of some ratios, (n, m): median over the channels of the residual of a gain."""
        moved = np.abs(np.array([model(ratios, plain) for ratios in trials]) / at_rest)
        log = np.log(np.maximum(measured, 1e-300) / np.maximum(expected * moved, 1e-300))
        costs = []
        for row, keep in enumerate(clear):
            if keep.sum() >= 10:
                left = log[:, row, keep]
                left = np.abs(left - np.median(left, axis=1, keepdims=True))
                costs.append(np.mean(np.minimum(left, 3.0), axis=1))
        return np.asarray(np.median(costs, axis=0)) if costs else np.zeros(len(trials))

    best, ratios = float(costs_of(plain[np.newaxis])[0]), plain.copy()
    together = costs_of(np.multiply.outer(_RATIOS, plain))
    if together.min() < 0.7 * best:
        best, ratios = float(together.min()), _RATIOS[int(np.argmin(together))] * plain
    for _ in range(2):
        before = best
        for mode in range(ratios.size):
            trials = np.tile(ratios, (_RATIOS.size, 1))
            trials[:, mode] = _RATIOS
            costs = costs_of(trials)
            if costs.min() < 0.8 * best:
                best, ratios = float(costs.min()), trials[int(np.argmin(costs))]
        if best == before:
            break
    return ratios


def fit_model(
    model: MovedModes,
    measured: ComplexArray,
    std: FloatArray,
    expected: ComplexArray,
    at_rest: ComplexArray,
    start: FloatArray,
    rows: Sequence[int],
    lines: FloatArray,
) -> ModelFit:
    """Frequency and damping of the modes, gain and delay of the channels by least squares on logarithms.

    Args:
        model: the rig.
        measured, expected: responses, and what a simulation of the check gives, (channels, L).
        std: relative standard deviation of ``measured``, same shape; infinite where a line does not count.
        at_rest: the model's responses with its own modes, same shape.
        start: ratios of the frequencies, (m,).
        rows: channels to be fitted.
        lines: Hz, (L,).
    """
    from scipy.optimize import least_squares

    kept = list(rows)
    modes, count = model.frequencies.size, len(kept)
    omega = 2.0 * np.pi * lines
    moved = model(start, np.ones(modes))
    ratio = measured[kept] / (expected * moved / at_rest)[kept]
    weights = np.where(np.isfinite(std[kept]), 1.0 / std[kept], 0.0)
    # Delays from the slopes of the phases, then the sign; the search goes on from there.
    trial = np.linspace(-0.02, 0.02, 4001)
    turns = np.exp(1j * np.multiply.outer(trial, omega))
    phasors = np.where(weights > 0.0, ratio / np.maximum(np.abs(ratio), 1e-300), 0.0) * np.minimum(weights, 30.0)
    sums = phasors @ turns.T
    late = trial[np.argmax(np.abs(sums), axis=1)]
    signs = np.where(sums[np.arange(count), np.argmax(np.abs(sums), axis=1)].real < 0.0, -1.0, 1.0)
    gains = np.array(
        [np.median(np.abs(r[w > 0.0])) if (w > 0.0).any() else 1.0 for r, w in zip(ratio, weights, strict=True)]
    )

    def residuals(x: FloatArray) -> FloatArray:
        frequency, damping = np.exp(x[:modes]), np.exp(x[modes : 2 * modes])
        gain, delay = x[2 * modes : 2 * modes + count], x[2 * modes + count :]
        full = (expected * model(frequency, damping) / at_rest)[kept]
        turned = signs[:, None] * np.exp(gain[:, None] - 1j * delay[:, None] * omega)
        log = np.log(measured[kept] / (full * turned))
        return np.concatenate([(log.real * weights).ravel(), (log.imag * weights).ravel()])

    def derivatives(x: FloatArray) -> FloatArray:
        """Of the residuals: differences for the modes; gains and delays are in them as they are."""
        base, step = residuals(x), 1e-7
        columns = [(residuals(x + step * unit) - base) / step for unit in np.eye(x.size)[: 2 * modes]]
        single = np.zeros((2, count, count, lines.size))
        single[0, np.arange(count), np.arange(count)] = -weights
        single[1, np.arange(count), np.arange(count)] = weights * omega
        none = np.zeros((count, count * lines.size))
        gain = np.concatenate([single[0].reshape(count, -1), none], axis=1)
        delay = np.concatenate([none, single[1].reshape(count, -1)], axis=1)
        return np.column_stack([*columns, gain.T, delay.T])

    x0 = np.concatenate([np.log(start), np.zeros(modes), np.log(gains), late])
    scale = np.concatenate([np.full(2 * modes, 0.01), np.full(count, 0.01), np.full(count, 1e-4)])
    settings = {"x_scale": scale, "loss": "soft_l1", "f_scale": 2.0, "max_nfev": 60, "jac": derivatives}
    found = least_squares(residuals, x0, **settings)
    used = found.fun != 0.0
    spread = 1.4826 * float(np.median(np.abs(found.fun[used]))) if used.any() else 1.0
    variance = np.diag(np.linalg.pinv(found.jac.T @ found.jac))
    # Rounding makes some negative where the data do not fix a parameter.
    std_x = np.sqrt(np.where(variance >= 0.0, variance, np.nan)) * max(spread, 1.0)
    # Channels that see other modes than the model's shapes allow disagree: jackknife over groups of them.
    groups = np.array_split(np.arange(count), min(count, _MOST_GROUPS))
    if len(groups) > 1:
        whole, without = weights, []
        for group in groups:
            weights = whole.copy()
            weights[group] = 0.0
            without.append(least_squares(residuals, found.x, **settings).x[: 2 * modes])
        away = np.array(without) - np.mean(without, axis=0)
        factor = (len(groups) - 1) / len(groups)
        std_x[: 2 * modes] = np.hypot(std_x[: 2 * modes], np.sqrt(factor * (away**2).sum(axis=0)))
    x = found.x
    delay = x[2 * modes + count :]
    gain = signs * np.exp(x[2 * modes : 2 * modes + count])
    frequency, damping = np.exp(x[:modes]), np.exp(x[modes : 2 * modes]) * model.damping
    return ModelFit(
        model.frequencies / (2.0 * np.pi),
        frequency,
        frequency * std_x[:modes],
        damping,
        damping * std_x[modes : 2 * modes],
        tuple(kept),
        gain,
        np.abs(gain) * std_x[2 * modes : 2 * modes + count],
        delay - np.median(delay),
        std_x[2 * modes + count :],
    )
