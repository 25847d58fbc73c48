"""Observables of random tests: frequency responses at chosen lines (:mod:`nmt_signals.local_responses`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Observations, RowTable, empty
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.measurements.stepped_reading import has_levels, require_base, spread_lines
from nmt_diagnose.observations.bag_windows import BagWindows
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.noise.scatter import moderated, neighbour_cubics
from nmt_diagnose.observations.observables import Part, Place
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.tables_together import TablesTogether
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_record.exchange.sidecar.import_sidecar import TableKind
from nmt_signals.local_responses import OFFSETS, REACH, choose_bins, local_fits, local_responses


def random_responses_of(bag: BagWindows) -> list[Observations]:
    """Windows of noise, a test for each and for each exciter."""
    noises = [kind for kind in TestKind if kind_class(kind).is_broad_band]
    return [
        found for name, window in bag.each(noises) for found in responses_to_each_exciter(name, window.stretch, bag)
    ]


def responses_to_each_exciter(name: str, stretch: SampleStretch, bag: BagWindows) -> list[Observations]:
    """Responses of one window to the drive of each exciter, with what those of the others do taken out."""
    points = bag.view.rig.exciter_points
    if len(points) == 1:
        return [random_observations(name, stretch, bag.view, bag)]
    voltages = bag.view.voltages(stretch.channels)
    found = []
    for number, point in enumerate(points):
        order = [number, *(k for k in range(len(points)) if k != number)]
        view = ModelView.of(bag.view.rig, [points[k] for k in order])
        named = [voltages[k] for k in order]
        found.append(random_observations(f"{name} from point {point}", stretch, view, bag, named))
    return found


@dataclass(frozen=True, eq=False)
class _Signals:
    """What of a window is used.

    Attributes:
        reference: what responses are divided by.
        others: voltages of the other exciters.
        channels: of the model; those of the responses.
        inputs: reference and others, (exciters, n).
        outputs: (channels, n), less their means.
        part: of the window.
    """

    reference: MeasuredChannel
    others: list[MeasuredChannel]
    channels: list[MeasuredChannel]
    inputs: FloatArray
    outputs: FloatArray
    part: slice


def random_observations(
    name: str, stretch: SampleStretch, view: ModelView, bag: BagWindows, voltages: Sequence[str] = ()
) -> Observations:
    """Observables of one window of random excitation.

    Args:
        name: name of the test.
        stretch: its samples.
        view: the model, its first exciter the one whose drive the responses are to.
        bag: the window is of; what linear interpolation of its drive does to the responses to the voltage is taken out
            (see drive_hold.py).
        voltages: of several exciters, names of the recorded ones in the order of the view's: responses are those to the
            first.
    """
    notes: list[str] = []
    settings = bag.settings
    try:
        used = _signals(stretch, bag.channels, voltages, name, notes)
        lines, bins = lines_of(used, stretch.sample_rate, view, settings)
    except BenchError as error:
        return empty((*notes, f"{name}: the random test is left out: {error}."))
    reference, present = used.reference, used.channels
    inputs = used.inputs - used.inputs.mean(axis=1, keepdims=True)
    found = local_responses(inputs, used.outputs, bins)
    estimate = found.estimate
    variance = found.resonance.copy()
    for row in range(variance.shape[0]):
        drawn, degrees = moderated(found.noise[row], float(found.degrees_of_freedom))
        variance[row] += drawn * found.factor * degrees / (degrees - 2.0)
    table = RowTable()
    drive_rms = float(np.std(used.inputs[0]))
    middle = 0.5 * (stretch.start_s + stretch.stop_s)
    source = MeasuredChannel("u", Quantity.VOLTAGE, 0) if used.others else reference  # of the view's first exciter
    bias = _bias(view, present, inputs, source, bins, stretch.sample_rate)
    # By neighbours and model: choosing by the line's amplitude would keep those that noise has raised.
    expected = np.maximum(_of_model(view, present, source, lines, estimate), _of_neighbours(estimate))
    for number, line in enumerate(lines):
        for row in range(len(present)):
            size = abs(estimate[row, number])
            if not size > 0.0:
                continue
            std = math.sqrt(0.5 * variance[row, number]) / size
            if math.sqrt(0.5 * variance[row, number]) > settings.largest_std * expected[row, number]:
                continue
            place = Place(number, middle, float(line), drive_rms)
            floor = math.hypot(settings.floors.frf, bias[row, number])
            table.add(Part.LOG_MAGNITUDE, math.log(size), std, floor, place, row)
            table.add(Part.PHASE, float(np.angle(estimate[row, number])), std, floor, place, row)
    if not len(table):
        return empty((*notes, f"{name}: the random test is left out: no line is coherent with {reference.name}."))
    rate, over_voltage = stretch.sample_rate, reference.quantity is Quantity.VOLTAGE
    test = RandomResponses(
        name=name,
        drive_point=view.rig.drive_point,
        channels=tuple(present),
        reference="voltage" if over_voltage else "force",
        lines_hz=np.asarray(lines, dtype=np.float64),
        resolution_hz=rate / inputs.shape[1],
        window="none",
        drive_rms=drive_rms,
        start_s=stretch.start_s + used.part.start / rate,
        stop_s=stretch.start_s + used.part.stop / rate,
        drive_hold_hz=bag.hold_rate_hz if over_voltage else math.inf,
        resting_points=view.rig.exciter_points[1:],
        other_rms=tuple(float(np.std(row)) for row in inputs[1:]),
    )
    return table.observations(test, notes)


def _signals(
    stretch: SampleStretch,
    channels: dict[str, MeasuredChannel],
    voltages: Sequence[str],
    name: str,
    notes: list[str],
) -> _Signals:
    """Reference and responses of a window; sentences on channels that cannot be used into ``notes``.

    Raises:
        BenchError: why the window cannot be used, a clause.
    """
    voltage = stretch.find(Quantity.VOLTAGE) if len(voltages) < 2 else _named(stretch, voltages[0])
    others = [found for other in voltages[1:] if (found := _named(stretch, other)) is not None]
    if len(others) < len(voltages[1:]) or (others and voltage is None):
        raise BenchError("it needs the voltage of each exciter")
    force = stretch.find(Quantity.FORCE)
    reference = voltage if voltage is not None and voltage.name not in stretch.faults else force
    usable_whole = {c.name for c in stretch.channels if c.name not in stretch.faults}
    part = slice(0, stretch.samples)
    if reference is None or reference.name not in usable_whole or len(usable_whole) < 2:
        part = _clean_part(stretch)
        length = part.stop - part.start
        if reference is None or length < stretch.samples // 2:
            faults = sorted(f"{channel}: {fault}" for channel, fault in stretch.faults.items())
            raise BenchError("; ".join(faults) or "no reference")
        notes.append(f"{name}: the longest stretch without gaps, {length} of {stretch.samples} samples, is used.")
        usable_whole = {c.name for c in stretch.channels if np.isfinite(stretch.row(c.name)[part]).all()}
    for channel, fault in stretch.faults.items():
        if channel in channels and channel not in usable_whole:
            notes.append(f"{name}: channel {channel} is left out: {fault}.")
    present = {
        theirs: channel
        for theirs, channel in channels.items()
        if theirs in usable_whole
        and channel.quantity not in (Quantity.VOLTAGE, Quantity.CURRENT)
        and theirs != reference.name
    }
    if not present:
        raise BenchError("there is no response channel")
    inputs = np.stack([stretch.row(channel.name)[part] for channel in (reference, *others)])
    if not np.ptp(inputs[0]) > 0.0:
        raise BenchError(f"its reference {reference.name} is constant")
    outputs = np.stack([stretch.row(theirs)[part] for theirs in present])
    outputs = outputs - outputs.mean(axis=1, keepdims=True)
    return _Signals(reference, others, list(present.values()), inputs, outputs, part)


def lines_of(
    used: _Signals, sample_rate: float, view: ModelView, settings: ObservationSettings
) -> tuple[FloatArray, IntArray]:
    """Lines at which the responses are read, Hz, and their bins.

    Raises:
        BenchError: there are none, a clause.
    """
    samples = used.inputs.shape[1]
    if samples < THRESHOLDS.reading.random_fewest_lines * 2:
        raise BenchError(f"{samples} samples are too few")
    point = view.rig.drive_point
    guide = next((row for row, c in enumerate(used.channels) if c.point == point and c.quantity in MOTIONS), 0)
    bins = choose_bins(used.inputs[0], used.outputs[guide], sample_rate, settings.lines)
    if bins.size == 0:
        raise BenchError("it has no driven band")
    return bins * sample_rate / samples, bins


def _named(stretch: SampleStretch, name: str) -> MeasuredChannel | None:
    return next((channel for channel in stretch.channels if channel.name == name), None)


def _of_neighbours(estimate: ComplexArray) -> FloatArray:
    """Amplitudes that the two lines on either side of each have in the median, shape (channels, lines)."""
    size, count = np.pad(np.abs(estimate), ((0, 0), (2, 2))), estimate.shape[1]
    return np.asarray(np.median([size[:, shift : shift + count] for shift in (0, 1, 3, 4)], axis=0))


def _of_model(
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
        magnitude = np.abs(responses[row] / responses[-1])
        if np.all(np.isfinite(magnitude)) and np.all(magnitude > 0.0):
            strong = magnitude >= np.median(magnitude)
            result[row] = magnitude * np.median(size[row, strong] / magnitude[strong])
    return result


def _bias(
    view: ModelView,
    channels: list[MeasuredChannel],
    inputs: FloatArray,
    source: MeasuredChannel,
    bins: IntArray,
    sample_rate: float,
) -> FloatArray:
    """Relative error of the local fits of the model's own response to inputs (exciters, n), shape (channels, lines)."""
    unique, inverse = np.unique(bins[:, np.newaxis] + OFFSETS, return_inverse=True)
    frequency = unique * sample_rate / inputs.shape[1]
    near = inverse.reshape(bins.size, OFFSETS.size)
    responses = view.responses([*channels, source], frequency)
    exact = (responses[:-1] / responses[-1])[:, near]
    u = np.fft.rfft(inputs)[:, bins[:, np.newaxis] + OFFSETS]
    motion = exact * u[0]
    for number in range(1, len(inputs)):
        alone = [0.0] * number + [1.0]
        motion = motion + view.responses(channels, frequency, alone)[:, near] * u[number]
    fitted = local_fits(u, np.moveaxis(motion, 0, -1)).estimate
    with np.errstate(divide="ignore", invalid="ignore"):  # an ideal exciter's force shows nothing of the others
        return np.asarray(np.nan_to_num(np.abs(fitted / exact[:, :, REACH] - 1.0), posinf=0.0))


def _clean_part(stretch: SampleStretch) -> slice:
    """Longest stretch in which force, voltage and some response all have values."""
    good = np.isfinite(stretch.data)
    # Channels that are hardly there at all do not decide about the others.
    good = good[good.mean(axis=1) > 0.5] if (good.mean(axis=1) > 0.5).any() else good
    edges = np.flatnonzero(np.diff(np.concatenate(([0], good.all(axis=0).astype(np.int8), [0]))))
    if edges.size == 0:
        return slice(0, 0)
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    return slice(int(edges[2 * longest]), int(edges[2 * longest + 1]))


# -- tables ----------------------------------------------------------------------------------------------------------


def response_table_observations(tables: TablesTogether) -> Observations | None:
    """Observables of frequency responses without a level that someone else has reduced; None of other tables.

    Raises:
        BenchError: they are over the acceleration of a base, and the model has none.
    """
    name, table, settings = tables.name, tables.tables[0], tables.settings
    if table.kind != TableKind.FRF or has_levels(table):
        return None
    require_base(tables)
    frequency = table.columns["frequency_hz"]
    response = table.responses
    size = np.abs(response)
    good = np.isfinite(size) & (size > 0.0) & (frequency > 0.0)
    if not good.any():
        return empty((f"{name}: left out: it has no usable line.",))
    scatter = np.sqrt(0.5 * (table.column("real_std") ** 2 + table.column("imag_std") ** 2))
    if not table.phase_known:
        scatter = table.column("magnitude_std")
    std = scatter / np.where(size > 0.0, size, 1.0)
    if table.noise > 0.0:
        std = np.where(np.isfinite(std), std, table.noise)
    stated = np.isfinite(std)
    std = np.where(stated, std, THRESHOLDS.noise.table_default_std)
    # Without uncertainties a coherence says something, but not how much was averaged: the line counts for less below 1.
    coherence = np.clip(table.column("coherence"), 1e-6, 1.0)
    weak = ~stated & np.isfinite(coherence)
    std[weak] = np.maximum(std[weak], np.sqrt(0.5 * (1.0 - coherence[weak]) / coherence[weak]))
    # A magnitude has a corner at an antiresonance, where the response itself goes smoothly through zero.
    noise_from_lines = table.phase_known and not stated.any()
    everywhere = noise_of_weak_lines(frequency[good], response[good]) if noise_from_lines else 0.0
    std = np.hypot(std, everywhere / np.where(size > 0.0, size, 1.0))
    good &= std <= settings.largest_std
    candidates = np.flatnonzero(good)
    if candidates.size == 0:
        return empty((f"{name}: left out: no line is known to better than {100 * settings.largest_std:g} %.",))
    order = candidates[np.argsort(frequency[candidates], kind="stable")]
    spread = _spread if table.phase_known else spread_lines
    chosen = order[spread(frequency[order], response[order], settings.lines)]
    notes = []
    if not stated.any():
        noise = f"; weak lines show {everywhere:.2g} {table.units.get('real', '')} besides" if everywhere else ""
        notes.append(
            f"{name}: no uncertainties are given; {100 * THRESHOLDS.noise.table_default_std:g} % is taken for every "
            f"line{noise}."
        )
    rows = RowTable()
    level = table.level if math.isfinite(table.level) else 0.0
    for number, index in enumerate(chosen):
        place = Place(number, 0.0, float(frequency[index]), level)
        value = float(std[index])
        floors = settings.floors
        rows.add(Part.LOG_MAGNITUDE, math.log(float(size[index])), value, floors.frf, place, 0)
        if table.phase_known:
            rows.add(Part.PHASE, float(np.angle(response[index])), value, floors.frf, place, 0)
    steps = np.diff(np.sort(frequency))
    test = RandomResponses(
        name=name,
        drive_point=tables.view.rig.drive_point,
        channels=tables.channels[:1],
        reference=table.reference,
        lines_hz=frequency[chosen].copy(),
        resolution_hz=float(np.min(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0,
        window="none",
        drive_rms=level,
        start_s=0.0,
        stop_s=0.0,
    )
    return rows.observations(test, notes)


def noise_of_weak_lines(frequency: FloatArray, response: NDArray[np.complex128]) -> float:
    """Standard deviation of the real and of the imaginary part of the weaker half of a frequency response's lines.

    About an antiresonance a response goes smoothly through zero: what scatters there is noise that does not fall with
    the response. It is read off the median distance from the cubics through four neighbours.

    Args:
        frequency: Hz, any order, shape (n,).
        response: shape (n,).

    Returns:
        In the unit of the response; 0 for fewer than seven weak lines.
    """
    frequency, first = np.unique(frequency, return_index=True)
    response = response[first]
    if frequency.size < 2 * THRESHOLDS.noise.table_fewest_for_scatter:
        return 0.0
    middle, near, weights = neighbour_cubics(frequency)
    apart = np.abs(response[middle] - np.sum(weights * response[near], axis=1))
    apart /= np.sqrt(1.0 + np.sum(weights**2, axis=1))
    weak = np.abs(response[middle]) <= np.median(np.abs(response))
    # The distance in the plane of a complex number follows Rayleigh's law.
    return (
        float(np.median(apart[weak])) / math.sqrt(2.0 * math.log(2.0))
        if weak.sum() >= THRESHOLDS.noise.table_fewest_for_scatter
        else 0.0
    )


def _spread(frequency: FloatArray, response: NDArray[np.complex128], wanted: int) -> NDArray[np.int64]:
    """Indices evenly spread over decades and turns of the phase."""
    if frequency.size <= wanted:
        return np.arange(frequency.size, dtype=np.int64)
    turns = np.concatenate(([0.0], np.cumsum(np.abs(np.angle(response[1:] * np.conj(response[:-1]))))))
    way = np.log(frequency / frequency[0]) + turns * math.log(4.0) / math.pi
    picked = np.searchsorted(way, np.linspace(way[0], way[-1], wanted)).clip(0, way.size - 1)
    return np.unique(picked.astype(np.int64))
