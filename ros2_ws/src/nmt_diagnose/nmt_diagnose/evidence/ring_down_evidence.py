"""Observables of ring-downs: instantaneous frequency and damping ratio over amplitude.

The response is fitted period by period with a Fourier series on its own phase. In an exponential decay every period is
a smaller copy of the one before, so the error that a fixed amplitude makes within a period is the same factor each time
and cancels in frequency and decay rate. Logarithm and phase of the fundamentals are then fitted with parabolas over a
few periods around each amplitude.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nmt_core.blocks import FloatArray, Quantity
from nmt_core.errors import BenchError
from nmt_diagnose.evidence.bag_samples import Stretch
from nmt_diagnose.evidence.conditions import MeasuredChannel, RingDownTest
from nmt_diagnose.evidence.model_view import ModelView
from nmt_diagnose.evidence.observables import Evidence, Part
from nmt_diagnose.evidence.row_table import Place, RowTable, empty
from nmt_diagnose.evidence.settings import EvidenceSettings
from nmt_extract.harmonics import resolvable_harmonics, segment_moments, solve_moments
from nmt_rig.model.linear_modes import damped_modes

_HALF_WIDTH = 3
_FEWEST_PERIODS = 12
_LONGEST_SKIP = 10
_SWITCH_OFF = 1  # periods within which the drive goes to zero
_OTHER_MODES = 5.0
_SMALLEST = 1e-3
_WORST_DAMPING = 0.3
_PASSES = 3
_ORDER = (Quantity.DISPLACEMENT, Quantity.ACCELERATION, Quantity.VELOCITY)


def period_fundamentals(
    samples: FloatArray, cycles: FloatArray, harmonics: int
) -> tuple[NDArray[np.complex128], FloatArray]:
    """Fundamental of each whole period of a phase.

    Args:
        samples: shape (n,).
        cycles: phase at each sample, cycles, ascending, shape (n,).
        harmonics: of the fit.

    Returns:
        Complex amplitudes, shape (periods,), and the index of each middle in samples, shape (periods,).
    """
    periods = math.floor(cycles[-1] - cycles[0])
    bounds = np.searchsorted(cycles, cycles[0] + np.arange(periods + 1) - 1e-9).astype(np.int64)
    amplitudes = solve_moments(segment_moments(cycles, samples[np.newaxis], harmonics, bounds))[:, 0, 1]
    middle = np.interp(cycles[0] + np.arange(periods) + 0.5, cycles, np.arange(cycles.size))
    return amplitudes, np.asarray(middle, dtype=np.float64)


def decay_of(samples: FloatArray, sample_rate: float, frequency_hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Phase and logarithm of the amplitude of a decay, period by period.

    Args:
        samples: shape (n,).
        sample_rate: Hz.
        frequency_hz: at the start, Hz.

    Returns:
        Time (s), phase (rad, unwrapped), ln of the amplitude; each of shape (periods,).

    Raises:
        BenchError: less than a few periods.
    """
    index = np.arange(samples.size)
    cycles: FloatArray = frequency_hz / sample_rate * index.astype(np.float64)
    harmonics = resolvable_harmonics(3, sample_rate / frequency_hz)
    if harmonics < 1 or cycles[-1] < _FEWEST_PERIODS:
        raise BenchError(f"{cycles[-1]:.3g} periods of decay are too few; {_FEWEST_PERIODS} are needed")
    middle, phase, log = np.zeros(0), np.zeros(0), np.zeros(0)
    for number in range(_PASSES):
        amplitudes, middle = period_fundamentals(samples, cycles, harmonics)
        size = np.abs(amplitudes)
        if not (size > 0.0).all():
            raise BenchError("the response vanishes")
        log = np.log(size)
        phase = 2.0 * math.pi * np.interp(middle, index, cycles) + np.unwrap(np.angle(amplitudes))
        if number + 1 == _PASSES:
            break
        # The next pass counts periods of the decay itself, as long as it stands out.
        strong = log > log.max() + math.log(_SMALLEST)
        last = int(np.argmin(strong)) if not strong.all() else strong.size
        if last < _FEWEST_PERIODS:
            break
        own = phase[:last] / (2.0 * math.pi)
        smooth = np.convolve(own, np.full(3, 1.0 / 3.0), mode="valid")
        smooth = np.concatenate((own[:1], smooth, own[-1:]))
        new = np.interp(index, middle[:last], smooth)
        ends = np.diff(smooth)[[0, -1]] / np.diff(middle[:last])[[0, -1]]
        before, after = index < middle[0], index > middle[last - 1]
        new[before] = smooth[0] + (index[before] - middle[0]) * ends[0]
        new[after] = smooth[-1] + (index[after] - middle[last - 1]) * ends[1]
        if not (np.diff(new) > 0.0).all():
            break
        cycles = new
    return middle / sample_rate, phase, log


def local_slopes(time: FloatArray, values: FloatArray, centre: int, first: int) -> tuple[float, float, float]:
    """Value, slope and uncertainty of the slope of a parabola around one value, of those from ``first`` on.

    What a narrower parabola says otherwise counts as uncertainty: near a corner of the decay neither is right.
    """
    value, slope, std = _parabola(time, values, centre, first, _HALF_WIDTH)
    _, narrow, _ = _parabola(time, values, centre, first, _HALF_WIDTH - 1)
    return value, slope, math.hypot(std, 0.5 * (slope - narrow))


def _parabola(
    time: FloatArray, values: FloatArray, centre: int, first: int, half_width: int
) -> tuple[float, float, float]:
    start = max(first, centre - half_width)
    near = slice(start, start + 2 * half_width + 1)
    t = time[near] - time[centre]
    design = np.stack((np.ones_like(t), t, t * t), axis=1)
    solution, *_ = np.linalg.lstsq(design, values[near], rcond=None)
    residual = values[near] - design @ solution
    freedom = t.size - 3
    covariance = np.linalg.inv(design.T @ design) * float(residual @ residual) / freedom
    return float(solution[0]), float(solution[1]), math.sqrt(float(covariance[1, 1]))


def _skipped(view: ModelView, frequency_hz: float) -> int:
    """Periods after which the drive is off and the other modes have decayed."""
    values = damped_modes(view.system).eigenvalues
    others = values[np.abs(np.abs(values) - 2.0 * math.pi * frequency_hz).argsort()[1:]]
    if others.size == 0:
        return _SWITCH_OFF
    slowest = float(np.min(-others.real))
    periods = _OTHER_MODES / slowest * frequency_hz if slowest > 0.0 else _LONGEST_SKIP
    return _SWITCH_OFF + int(np.clip(math.ceil(periods), 1, _LONGEST_SKIP))


def ring_down_evidence(
    name: str,
    stretch: Stretch,
    frequency_hz: float,
    view: ModelView,
    channels: dict[str, MeasuredChannel],
    settings: EvidenceSettings,
    response_quantity: Quantity | None = None,
) -> Evidence:
    """Observables of one free decay.

    Args:
        name: name of the test.
        stretch: samples from the switch-off on.
        frequency_hz: at the switch-off, Hz; NaN or 0 = that of the model's mode.
        view: the model, driven at the test's drive point.
        channels: the model's channel for each recorded one.
        settings: settings.
        response_quantity: preferred quantity of the drive-point response.
    """
    order: Sequence[Quantity] = ((response_quantity,) if response_quantity is not None else ()) + _ORDER
    usable = set(channels) - set(stretch.faults)
    candidates = [stretch.find(quantity, view.rig.drive_point) for quantity in order]
    channel = next((c for c in candidates if c is not None and c.name in usable), None)
    if channel is None:
        return empty((f"{name}: the ring-down is left out: there is no usable response at the drive point.",))
    samples = stretch.row(channel.name)
    guess = frequency_hz if frequency_hz > 0.0 else view.frequencies_hz[0]
    try:
        time, phase, log = decay_of(samples, stretch.sample_rate, guess)
    except BenchError as error:
        return empty((f"{name}: the ring-down is left out: {error}.",))
    first = _skipped(view, guess)
    nodes = _nodes(log, settings.decay_points, first)
    table = RowTable()
    amplitudes: list[float] = []
    floors = settings.floors
    for node in nodes:
        level, rate, rate_std = local_slopes(time, log, node, first)
        _, omega, omega_std = local_slopes(time, phase, node, first)
        if not omega > 0.0:
            continue
        damping = -rate / omega
        if not rate_std / omega < max(_WORST_DAMPING * abs(damping), 1e-5):
            break
        place = Place(len(amplitudes), stretch.start_s + float(time[node]), omega / (2.0 * math.pi), math.exp(level))
        table.add(Part.LOG_FREQUENCY, math.log(omega), omega_std / omega, floors.decay_log_frequency, place, 0, 1)
        table.add(Part.DAMPING, damping, rate_std / omega, floors.decay_damping * abs(damping), place, 0, 1)
        amplitudes.append(math.exp(level))
    if not amplitudes:
        return empty((f"{name}: the ring-down is left out: the decay does not stand out of the noise.",))
    test = RingDownTest(name, view.rig.drive_point, channels[channel.name], np.array(amplitudes), guess)
    return table.evidence(test)


def _nodes(log: FloatArray, wanted: int, skipped: int) -> list[int]:
    """Periods evenly spread over the logarithm of the amplitude, far enough apart to be nearly independent."""
    first, last = skipped + 1, log.size - _HALF_WIDTH - 1
    strong = log[first : last + 1] > log[: first + 1].max() + math.log(_SMALLEST)
    # Once the decay has reached the noise it is not used again.
    stop = first + (int(np.argmin(strong)) if not strong.all() else strong.size)
    falling = np.arange(first, stop)
    if falling.size == 0:
        return []
    marks = np.linspace(log[falling[0]], log[falling[-1]], max(1, min(wanted, falling.size)))
    result: list[int] = []
    for node in sorted({int(falling[np.argmin(np.abs(log[falling] - mark))]) for mark in marks}):
        if not result or node - result[-1] >= _HALF_WIDTH:
            result.append(node)
    return result
