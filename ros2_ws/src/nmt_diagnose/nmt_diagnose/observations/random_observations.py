"""Observables of random tests: frequency responses at chosen lines, free of leakage.

Around each line response and reference are fitted with H(f) U + T(f), where the frequency response H and the leakage T
are polynomials over a few neighbouring lines of one Fourier transform of the whole window (local polynomial method:
R. Pintelon, J. Schoukens, 2012, System Identification, 2nd ed., section 7.2). Averaged spectra would leave leakage as
noise that all channels share; here sensor noise and nonlinear distortions are what remains, and the residual of the
fit tells how large they are.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd, welch

from nmt_core.blocks import FloatArray, Quantity
from nmt_diagnose.observations.bag_samples import Stretch
from nmt_diagnose.observations.conditions import MeasuredChannel, RandomTest
from nmt_diagnose.observations.drive_hold import image_responses
from nmt_diagnose.observations.model_view import ORDER as DERIVATIVES
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.moderated_variance import moderated
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.row_table import Place, RowTable, empty

ComplexArray = NDArray[np.complex128]
IndexArray = NDArray[np.int64]

ORDER = 4
"""Degree of the local polynomials."""
REACH = 10
"""Lines on either side that a local fit uses."""
_FEWEST_LINES = 200
_DRIVEN = 0.25
_HIGHEST = 0.4


def local_responses(
    reference: FloatArray, responses: FloatArray, bins: IndexArray
) -> tuple[ComplexArray, FloatArray, FloatArray, int]:
    """Frequency responses at some lines of the Fourier transform.

    Args:
        reference: samples of the reference, shape (n,).
        responses: samples of the responses, shape (channels, n).
        bins: lines, each at least ``REACH`` from the ends of the transform.

    Returns:
        Responses, shape (channels, lines); variance of the noise in the responses' lines, same shape; factor from there
        to the variance of the estimate, shape (lines,); degrees of freedom of that variance.
    """
    u = np.fft.rfft(reference)
    y = np.fft.rfft(responses, axis=-1)
    offsets = np.arange(-REACH, REACH + 1)
    powers = (offsets[:, np.newaxis] / REACH) ** np.arange(ORDER + 1)
    estimate = np.empty((responses.shape[0], bins.size), dtype=np.complex128)
    noise = np.empty((responses.shape[0], bins.size))
    factor = np.empty(bins.size)
    degrees_of_freedom = offsets.size - 2 * (ORDER + 1)
    for number, line in enumerate(bins):
        near = line + offsets
        design = np.concatenate((u[near, np.newaxis] * powers, powers), axis=1)
        scale = np.linalg.norm(design, axis=0)
        q, r = np.linalg.qr(design / scale)
        right = y[:, near].T
        projected = np.conj(q.T) @ right
        inverse = np.linalg.inv(r)
        estimate[:, number] = (inverse[0] @ projected) / scale[0]
        residual = right - q @ projected
        noise[:, number] = (np.abs(residual) ** 2).sum(axis=0) / degrees_of_freedom
        factor[number] = float((np.abs(inverse[0]) ** 2).sum()) / scale[0] ** 2
    return estimate, noise, factor, 2 * degrees_of_freedom


def choose_bins(reference: FloatArray, response: FloatArray, sample_rate: float, wanted: int) -> IndexArray:
    """Lines evenly spread over decades and over the turns of the response's phase, within the driven band.

    Args:
        reference: samples, shape (n,).
        response: samples of the drive-point response, shape (n,).
        sample_rate: Hz.
        wanted: most lines.

    Returns:
        Lines of the Fourier transform of the whole, ascending, far enough apart to be nearly independent; may be empty.
    """
    size = reference.size
    segment = max(256, size // 12)
    if size < segment:
        return np.zeros(0, dtype=np.int64)
    frequency, power = welch(reference, sample_rate, nperseg=segment)
    _, cross = csd(reference, response, sample_rate, nperseg=segment)
    driven = (power > _DRIVEN * power[1:].max()) & (frequency > 0.0) & (frequency < _HIGHEST * sample_rate)
    if not driven.any():
        return np.zeros(0, dtype=np.int64)
    low, high = frequency[driven][0], frequency[driven][-1]
    own = np.arange(size // 2 + 1) * sample_rate / size
    inside = np.flatnonzero((own >= low) & (own <= high))
    inside = inside[(inside > REACH) & (inside < own.size - REACH - 1)]
    if inside.size < 2:
        return np.zeros(0, dtype=np.int64)
    turns = np.interp(own[inside], frequency, np.concatenate(([0.0], np.cumsum(np.abs(_steps(cross))))))
    # A resonance (a turn by π) has as many lines as a factor of four in frequency.
    way = np.log(own[inside] / own[inside[0]]) + turns * math.log(4.0) / math.pi
    marks = np.linspace(way[0], way[-1], wanted)
    picked = inside[np.searchsorted(way, marks).clip(0, inside.size - 1)]
    result = []
    last = -(10**9)
    for line in picked:
        if line - last > REACH:
            result.append(int(line))
            last = int(line)
    return np.array(result, dtype=np.int64)


def _steps(cross: ComplexArray) -> FloatArray:
    smooth = np.convolve(cross, np.array([0.25, 0.5, 0.25]), mode="same")
    result: FloatArray = np.angle(smooth[1:] * np.conj(smooth[:-1]))
    # Noise turns the phase to and fro: what exceeds a quarter turn a step is no resonance.
    return np.where(np.abs(result) < 0.5 * math.pi, result, 0.0)


def random_observations(
    name: str,
    stretch: Stretch,
    view: ModelView,
    channels: dict[str, MeasuredChannel],
    settings: ObservationSettings,
    hold_rate_hz: float = math.inf,
) -> Observations:
    """Observables of one window of random excitation.

    Args:
        name: name of the test.
        stretch: its samples.
        view: the model, driven at the test's drive point.
        channels: the model's channel for each recorded one.
        settings: settings.
        hold_rate_hz: rate at which the drive is interpolated linearly, as that of simulated rigs is; what this does
            to the responses to the voltage is taken out (see drive_hold.py).
    """
    notes: list[str] = []
    voltage = stretch.find(Quantity.VOLTAGE)
    force = stretch.find(Quantity.FORCE)
    reference = voltage if voltage is not None and voltage.name not in stretch.faults else force
    usable_whole = {c.name for c in stretch.channels if c.name not in stretch.faults}
    part = slice(0, stretch.samples)
    if reference is None or reference.name not in usable_whole or len(usable_whole) < 2:
        part = _clean_part(stretch)
        length = part.stop - part.start
        if reference is None or length < stretch.samples // 2:
            why = (
                "; ".join(sorted(f"{channel}: {fault}" for channel, fault in stretch.faults.items())) or "no reference"
            )
            return empty((f"{name}: the random test is left out: {why}.",))
        notes.append(f"{name}: the longest stretch without gaps, {length} of {stretch.samples} samples, is used.")
        usable_whole = {c.name for c in stretch.channels if np.isfinite(stretch.row(c.name)[part]).all()}
    for channel, fault in stretch.faults.items():
        if channel in channels and channel not in usable_whole:
            notes.append(f"{name}: channel {channel} is left out: {fault}.")
    recorded = {own.name: theirs for theirs, own in channels.items()}
    kinds = (Quantity.VOLTAGE, Quantity.CURRENT)
    present = [
        channel
        for channel in channels.values()
        if recorded[channel.name] in usable_whole
        and channel.quantity not in kinds
        and recorded[channel.name] != reference.name
    ]
    input_samples = stretch.row(reference.name)[part]
    if not present or not np.ptp(input_samples) > 0.0:
        why = "there is no response channel" if not present else f"its reference {reference.name} is constant"
        return empty((*notes, f"{name}: the random test is left out: {why}."))
    outputs = np.stack([stretch.row(recorded[channel.name])[part] for channel in present])
    outputs = outputs - outputs.mean(axis=1, keepdims=True)
    if input_samples.size < _FEWEST_LINES * 2:
        return empty((*notes, f"{name}: the random test is left out: {input_samples.size} samples are too few."))
    drive_point = view.rig.drive_point
    guide = next((row for row, c in enumerate(present) if c.point == drive_point and c.quantity in DERIVATIVES), 0)
    bins = choose_bins(input_samples, outputs[guide], stretch.sample_rate, settings.lines)
    if bins.size == 0:
        return empty((*notes, f"{name}: the random test is left out: it has no driven band."))
    lines = bins * stretch.sample_rate / input_samples.size
    estimate, noise, factor, degrees_of_freedom = local_responses(input_samples - input_samples.mean(), outputs, bins)
    variance = np.empty_like(noise)
    for row in range(noise.shape[0]):
        drawn, degrees = moderated(noise[row], float(degrees_of_freedom))
        variance[row] = drawn * factor * degrees / (degrees - 2.0)
    table = RowTable()
    drive_rms = float(np.std(input_samples))
    middle = 0.5 * (stretch.start_s + stretch.stop_s)
    bias = _bias(view, present, input_samples, reference, bins, stretch.sample_rate)
    held = reference.quantity is Quantity.VOLTAGE
    images = np.abs(image_responses(view, present, lines, hold_rate_hz if held else math.inf))
    believed = _believed(view, present, reference, lines, estimate)
    for number, line in enumerate(lines):
        for row in range(len(present)):
            size = abs(estimate[row, number])
            if not size > 0.0:
                continue
            std = math.sqrt(0.5 * variance[row, number]) / size
            # By the model's amplitude: choosing by the measured one would keep those that noise has raised.
            if math.sqrt(0.5 * variance[row, number]) > settings.largest_std * believed[row, number]:
                continue
            place = Place(number, middle, float(line), drive_rms)
            # What sensors and structure do to images of the drive, far above the lines, is known roughly only.
            folded = settings.floors.images * images[row, number] / size
            floor = math.hypot(settings.floors.frf, bias[row, number], folded)
            table.add(Part.LOG_MAGNITUDE, math.log(size), std, floor, place, row)
            table.add(Part.PHASE, float(np.angle(estimate[row, number])), std, floor, place, row)
    if not len(table):
        return empty((*notes, f"{name}: the random test is left out: no line is coherent with {reference.name}."))
    start, stop = stretch.start_s + part.start / stretch.sample_rate, stretch.start_s + part.stop / stretch.sample_rate
    test = RandomTest(
        name=name,
        drive_point=view.rig.drive_point,
        channels=tuple(present),
        reference="voltage" if reference.quantity is Quantity.VOLTAGE else "force",
        lines_hz=np.asarray(lines, dtype=np.float64),
        resolution_hz=stretch.sample_rate / input_samples.size,
        window="none",
        drive_rms=drive_rms,
        start_s=start,
        stop_s=stop,
        drive_hold_hz=hold_rate_hz if reference.quantity is Quantity.VOLTAGE else math.inf,
    )
    return table.observations(test, notes)


def _believed(
    view: ModelView,
    channels: list[MeasuredChannel],
    source: MeasuredChannel,
    lines: FloatArray,
    estimate: ComplexArray,
) -> FloatArray:
    """Amplitudes of the model, scaled channel by channel to the measured ones, shape (channels, lines)."""
    responses = view.responses([*channels, source], lines)
    size = np.abs(estimate)
    result = size.copy()
    for row in range(len(channels)):
        own = np.abs(responses[row] / responses[-1])
        if np.all(np.isfinite(own)) and np.all(own > 0.0):
            strong = own >= np.median(own)
            result[row] = own * np.median(size[row, strong] / own[strong])
    return result


def _bias(
    view: ModelView,
    channels: list[MeasuredChannel],
    reference: FloatArray,
    source: MeasuredChannel,
    bins: IndexArray,
    sample_rate: float,
) -> FloatArray:
    """Relative error that the local polynomials make on the model's own response, shape (channels, lines)."""
    offsets = np.arange(-REACH, REACH + 1)
    unique, inverse = np.unique(bins[:, np.newaxis] + offsets, return_inverse=True)
    frequency = unique * sample_rate / reference.size
    responses = view.responses([*channels, source], frequency)
    exact = (responses[:-1] / responses[-1])[:, inverse.reshape(bins.size, offsets.size)]
    u = np.fft.rfft(reference - reference.mean())
    powers = (offsets[:, np.newaxis] / REACH) ** np.arange(ORDER + 1)
    result = np.zeros((len(channels), bins.size))
    for number, line in enumerate(bins):
        near = u[line + offsets]
        design = np.concatenate((near[:, np.newaxis] * powers, powers * np.abs(near).mean()), axis=1)
        fitted = np.linalg.lstsq(design, (exact[:, number] * near).T, rcond=None)[0][0]
        result[:, number] = np.abs(fitted / exact[:, number, REACH] - 1.0)
    return np.nan_to_num(result)


def _clean_part(stretch: Stretch) -> slice:
    """Longest stretch in which force, voltage and some response all have values."""
    good = np.isfinite(stretch.data)
    # Channels that are hardly there at all do not decide about the others.
    good = good[good.mean(axis=1) > 0.5] if (good.mean(axis=1) > 0.5).any() else good
    edges = np.flatnonzero(np.diff(np.concatenate(([0], good.all(axis=0).astype(np.int8), [0]))))
    if edges.size == 0:
        return slice(0, 0)
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    return slice(int(edges[2 * longest]), int(edges[2 * longest + 1]))
