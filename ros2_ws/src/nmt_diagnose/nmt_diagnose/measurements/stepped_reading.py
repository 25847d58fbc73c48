"""Observables of imported stepped sines and of response curves: responses over the measured force of each line.

The model takes every line at its measured amplitude, which has one solution on whatever branch. So the points of a
response curve are lines as those of stepped sines are, the unstable ones too. They stay in the order in which they were
measured, along the curve, which has no jump.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows import LockedWindow, analyse_window
from nmt_diagnose.measurements.measurement import Observations, RowTable, empty, joined
from nmt_diagnose.measurements.stepped_responses import SteppedResponses
from nmt_diagnose.observations.bag_windows import BagWindow, BagWindows
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.noise.scatter import neighbour_cubics
from nmt_diagnose.observations.observables import Part, Place
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.tables_together import TablesTogether
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_extract.judgement.uncertainty import jackknife_variance
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_record.exchange.sidecar.import_sidecar import TableKind
from nmt_record.exchange.unit_table import REFERENCE_UNITS, quantity_of_unit
from nmt_rig.rig import ShakingTableSection

_WAYS = {1: " up", -1: " down", 0: ""}


def swept_responses_of(bag: BagWindows) -> list[Observations]:
    """Stepped sines of an import that are frequency responses, and response curves.

    Raises:
        BenchError: the bag cannot be of the model's rig.
    """
    bag.drop_implausible()
    swept = [
        kind for kind in (TestKind.STEPPED_SINE, TestKind.RESPONSE_CURVE) if bag.is_swept(kind) and bag.of_kind(kind)
    ]
    return [stepped_sine_observations(bag.named(kind), bag.of_kind(kind), bag) for kind in swept]


def stepped_sine_observations(name: str, windows: Sequence[BagWindow], bag: BagWindows) -> Observations:
    """Observables of stepped-sine windows: a test for each level and direction, of response curves for each curve.

    The level of a line is its measured force, whatever was held. Lines of stepped sines on both sides of a jump are
    left out.

    Args:
        name: of the tests.
        windows: the windows and their samples, in time.
        bag: they are of.
    """
    notes: list[str] = []
    analysed: list[LockedWindow] = []
    for window in windows:
        try:
            analysed.append(analyse_window(window.segment, window.stretch, bag.settings, bag.view))
        except BenchError as error:
            notes.append(f"{name}: {error}")
    parts = []
    groups = _groups(analysed)
    for number, group in enumerate(groups):
        direction = 0 if _is_curve(group[0]) else _direction(group)
        test_name = name
        if len(groups) > 1:
            level = group[0].segment.level
            text = f" at {level:g} {group[0].segment.level_unit}" if math.isfinite(level) else f" {number + 1}"
            test_name = f"{name}{text}{_WAYS[direction]}"
        if len(group) < THRESHOLDS.reading.stepped_fewest_lines:
            notes.append(
                f"{test_name}: {len(group)} lines are no frequency response; measure "
                f"{THRESHOLDS.reading.stepped_fewest_lines} or more."
            )
            continue
        parts.append(_sweep_of_windows(test_name, group, direction, bag.view, bag.channels, bag.settings))
    return joined([empty(notes), *parts])


def _groups(windows: Sequence[LockedWindow]) -> list[list[LockedWindow]]:
    """Windows of one level and one direction of the frequency, in time."""
    result: list[list[LockedWindow]] = []
    for window in windows:
        last = result[-1] if result else []
        same = bool(last) and _level(window) == _level(last[-1])
        if same and len(last) > 1 and not _is_curve(window):
            turn = (window.frequency_hz - last[-1].frequency_hz) * (last[1].frequency_hz - last[0].frequency_hz)
            same = turn > 0.0
        if same:
            last.append(window)
        else:
            result.append([window])
    return result


def _level(window: LockedWindow) -> float | None:
    level = window.segment.level
    return float(f"{level:.3g}") if math.isfinite(level) else None


def _is_curve(window: LockedWindow) -> bool:
    return window.segment.kind is TestKind.RESPONSE_CURVE


def _direction(group: Sequence[LockedWindow]) -> int:
    return 1 if group[-1].frequency_hz >= group[0].frequency_hz else -1


def _sweep_of_windows(
    name: str,
    group: Sequence[LockedWindow],
    direction: int,
    view: ModelView,
    channels: dict[str, MeasuredChannel],
    settings: ObservationSettings,
) -> Observations:
    force = group[0].stretch.find(Quantity.FORCE)
    assert force is not None
    curve = direction == 0
    order = list(group) if curve else sorted(group, key=lambda window: window.frequency_hz)
    common = [k for k, c in channels.items() if c.quantity in MOTIONS and all(k in window.rows for window in order)]
    if not common:
        return empty((f"{name}: no response channel is usable in all windows; left out.",))
    # The channel that moves most in its own noise says how large the motion was.
    found = {key: _responses(order, key, force.name) for key in common}
    common.sort(key=lambda key: float(np.median(found[key][1])))
    kept = np.all([std <= settings.largest_std for _, std in found.values()], axis=0)
    notes = []
    for first, last in () if curve else jumps_of(found[common[0]][0]):
        kept[first : last + 1] = False
        notes.append(jump_note(name, order[first].frequency_hz, order[last].frequency_hz))
    lines = np.flatnonzero(kept)
    if lines.size < THRESHOLDS.reading.stepped_fewest_lines:
        return empty((*notes, f"{name}: left out: {lines.size} of its lines can be used."))
    frequency = np.array([order[k].frequency_hz for k in lines])
    level = np.array([abs(order[k].amplitudes[order[k].row(force.name), 1]) for k in lines])
    floor = settings.floors.stepped
    rows = RowTable()
    for number, k in enumerate(lines):
        window = order[k]
        middle = (window.segment.usable_first_sample + 0.5 * window.segment.usable_samples) / window.stretch.sample_rate
        place = Place(number, middle, window.frequency_hz, float(level[number]))
        for channel, key in enumerate(common):
            response, std = found[key]
            rows.add(Part.LOG_MAGNITUDE, math.log(abs(response[k])), float(std[k]), floor, place, channel, 1)
            rows.add(Part.PHASE, float(np.angle(response[k])), float(std[k]), floor, place, channel, 1)
    test = SteppedResponses(
        name=name,
        drive_point=view.rig.drive_point,
        channels=tuple(channels[key] for key in common),
        reference="force",
        held="force" if not curve or group[0].segment.level_unit == "N" else "response",
        lines_hz=frequency,
        levels=level,
        measured=np.column_stack([found[key][0][lines] for key in common]),
        noise=np.hypot(found[common[0]][1][lines], floor),
        direction=direction,
    )
    return rows.observations(test, notes)


def _responses(windows: Sequence[LockedWindow], channel: str, force: str) -> tuple[ComplexArray, FloatArray]:
    """Fundamental over that of the force in each window, and its relative standard uncertainty (jackknife)."""
    responses, deviations = [], []
    for window in windows:
        row, below = window.row(channel), window.row(force)
        responses.append(window.amplitudes[row, 1] / window.amplitudes[below, 1])
        without = np.log(window.without[:, row, 1] / window.without[:, below, 1] / responses[-1])
        deviations.append(math.sqrt(0.5 * float(jackknife_variance(without))))
    return np.array(responses), np.array(deviations)


# -- tables ----------------------------------------------------------------------------------------------------------


# Ratios of a common noise to a relative one that are tried, between lines a tenth of the least and the largest.
_NOISE_RATIOS = 40
# Degrees of freedom of residuals with resonances and jumps among them, and the scale that normal noise has by them.
_TAIL, _TAIL_SCALE, _SCALE_ROUNDS = 2.0, 0.735, 8
_WHAT = {"force": "force", "base": "acceleration of the base", "voltage": "voltage", "response": "response"}


def has_levels(table: ObservableTable) -> bool:
    """Whether a table says with what amplitude it was measured.

    A coherence is that of a random test: its level is an rms of noise, which no harmonic balance follows.
    """
    if "coherence" in table.columns:
        return False
    level_columns = [table.columns[name] for name in ("level", "force_n") if name in table.columns]
    return table.level > 0.0 or any(bool(np.any(column > 0.0)) for column in level_columns)


def measured_together(tables: Sequence[ObservableTable], drive_point: int) -> list[list[int]]:
    """Numbers of tables that are points of one passage: the same lines at the same level, each point once.

    Such tables have one motion, which is solved once for all of them. All others stand alone.

    Args:
        tables: of one bag.
        drive_point: of tables that do not say theirs.
    """
    groups: list[list[int]] = []
    open_groups: dict[str, list[int]] = {}
    for number, table in enumerate(tables):
        if not _levels_of_the_excitation(table):
            groups.append([number])
            continue
        lines = [table.columns.get(name) for name in ("frequency_hz", "level", "force_n")]
        key = repr((
            table.drive_point or drive_point, table.reference, table.held, table.level, table.level_unit,
            table.direction, table.phase_known, *(None if column is None else column.tobytes() for column in lines),
        ))  # fmt: skip
        group = open_groups.get(key)
        places = [(tables[other].point, tables[other].quantity) for other in group or ()]
        if group is None or (table.point, table.quantity) in places:
            group = open_groups[key] = []
            groups.append(group)
        group.append(number)
    return groups


def _levels_of_the_excitation(table: ObservableTable) -> bool:
    if table.kind != TableKind.FRF or not has_levels(table):
        return False
    try:
        return _held("", table)[0] != "response"
    except BenchError:
        return False


def stepped_table_observations(together: TablesTogether) -> Observations | None:
    """Observables of frequency responses at held amplitudes, a test for each level; None of other tables.

    Their tables have a level, a column of levels, or a measured force at each line. Where they have several levels,
    each test adds its own to its name.

    Raises:
        BenchError: what was held, or its unit, does not fit the responses.
    """
    name, tables = together.name, together.tables
    table = tables[0]
    if table.kind != TableKind.FRF or not has_levels(table):
        return None
    require_base(together)
    held, notes = _held(name, table)
    level = table.columns.get("level", np.full(table.rows, table.level))
    if held == "force" and "force_n" in table.columns:
        level = np.where(np.isfinite(level) & (level > 0.0), level, 0.0)
        amplitude = table.columns["force_n"]
    else:
        amplitude = level
    frequency = table.columns["frequency_hz"]
    omega = 2.0 * np.pi * frequency
    if held == "response":
        # The held motion may be given as another derivative than the responses.
        level_quantity = quantity_of_unit(table.level_unit or table.quantity.unit)
        amplitude = amplitude * omega ** (MOTIONS[table.quantity] - MOTIONS[level_quantity])
    elif held == "base" and table.level_unit:
        moved = quantity_of_unit(table.level_unit)
        amplitude = amplitude * omega ** (
            MOTIONS[Quantity.ACCELERATION] - MOTIONS.get(moved, MOTIONS[Quantity.ACCELERATION])
        )
    responses = np.column_stack([each.responses for each in tables])
    usable = np.all(np.isfinite(responses) & (np.abs(responses) > 0.0), axis=1) & (frequency > 0.0)
    usable &= np.isfinite(amplitude) & (amplitude > 0.0)
    if not usable.all():
        notes.append(f"{name}: {int((~usable).sum())} of {usable.size} rows have no response or level; left out.")
    if not usable.any():
        return empty((*notes, f"{name}: left out: it has no usable line."))
    groups = force_groups(level, usable)
    parts = []
    for own_level, selected in groups:
        test_name = name if len(groups) == 1 else f"{name} at {own_level:g} {table.level_unit}".strip()
        parts.append(_sweep_of_table(test_name, together, held, selected, amplitude))
    return joined([empty(notes), *parts])


def require_base(together: TablesTogether) -> None:
    """Refuse responses over the acceleration of a base that the model does not have.

    Raises:
        BenchError: what exciter to write.
    """
    if together.tables[0].reference == "base" and not isinstance(together.view.rig.exciter, ShakingTableSection):
        point = together.channels[0].point
        raise BenchError(
            f"{together.name}: its responses are over the acceleration of the base, but the exciter of the model "
            f"{together.view.rig.name} is not a shaking table; write exciter: {{kind: shaking_table, point: {point}}}."
        )


def _held(name: str, table: ObservableTable) -> tuple[str, list[str]]:
    """What had the given amplitude, and what was assumed about it."""
    notes: list[str] = []
    held = table.held
    if not held:
        quantity = quantity_of_unit(table.level_unit) if table.level_unit else Quantity.UNKNOWN
        if table.reference == "base" or "force_n" in table.columns or not table.level_unit:
            held = table.reference
        else:
            held = {Quantity.FORCE: "force", Quantity.VOLTAGE: "voltage"}.get(quantity, "response")
    if not table.level_unit and "force_n" not in table.columns:
        unit = table.quantity.unit if held == "response" else REFERENCE_UNITS[held]
        notes.append(f"{name}: its level has no unit; it is taken as the amplitude of the {_WHAT[held]} in {unit}.")
    if held not in (table.reference, "response"):
        raise BenchError(
            f"{name}: the {_WHAT[held]} was held, but the responses are over the {_WHAT[table.reference]}: how large "
            f"that was is not known. Give the measured {_WHAT[table.reference]} of each line as a column force_n."
        )
    if not table.direction and held != "response":
        notes.append(
            f"{name}: it does not say whether the frequency rose or fell (direction: up or down); every line is "
            "taken to lie on the branch where it was measured, as it is with a direction."
        )
    return held, notes


def force_groups(level: FloatArray, usable: NDArray[np.bool_]) -> list[tuple[float, NDArray[np.int64]]]:
    """Rows of each level, lowest first."""
    order = np.flatnonzero(usable)
    order = order[np.argsort(level[order], kind="stable")]
    steps = np.diff(level[order]) > THRESHOLDS.reading.stepped_same_level * np.abs(level[order[1:]])
    pieces = np.split(order, np.flatnonzero(steps) + 1)
    return [(float(np.median(level[piece])), np.sort(piece)) for piece in pieces]


def _sweep_of_table(
    name: str, together: TablesTogether, held: str, selected: NDArray[np.int64], amplitude: FloatArray
) -> Observations:
    """Observables of one level."""
    tables, channels, view, settings = together.tables, together.channels, together.view, together.settings
    frequency = tables[0].columns["frequency_hz"]
    order = selected[np.argsort(frequency[selected], kind="stable")]
    f = frequency[order]
    notes: list[str] = []
    measured = []
    for table, channel in zip(tables, channels, strict=True):
        label = name if len(tables) == 1 else f"{name}, {channel.name}"
        std, sentences, degrees = noise_of_lines(label, table, order, table.responses[order], f)
        notes += sentences
        measured.append((channel, table.responses[order], std, degrees))
    estimated = [float(np.median(std)) for _, _, std, degrees in measured if math.isfinite(degrees)]
    if len(estimated) == len(measured) > 1:  # one sentence for all of them
        low, high = 100.0 * min(estimated), 100.0 * max(estimated)
        notes = [
            f"{name}: no uncertainties are given; the lines of its {len(estimated)} points scatter by {low:.2g} to "
            f"{high:.2g} % about a smooth course."
        ]
    # The channel that moves most in its own noise says how large the motion was.
    measured.sort(key=lambda column: float(np.median(column[2])))
    h = np.column_stack([response for _, response, _, _ in measured]).astype(np.complex128)
    std = np.column_stack([deviations for _, _, deviations, _ in measured])
    kept = np.all(std <= settings.largest_std, axis=1)
    if held != "response":
        for first, last in jumps_of(h[:, 0]):
            kept[first : last + 1] = False
            notes.append(jump_note(name, f[first], f[last]))
    if not kept.any():
        return empty((*notes, f"{name}: left out: no line is known to better than {100 * settings.largest_std:g} %."))
    order, f, h, std = order[kept], f[kept], h[kept], std[kept]
    chosen = spread_lines(f, h[:, 0], settings.stepped_lines)
    rows = RowTable()
    floor, phase_known = settings.floors.stepped, tables[0].phase_known
    for number, index in enumerate(chosen):
        place = Place(number, 0.0, float(f[index]), float(amplitude[order[index]]))
        for k in range(len(measured)):
            value, own_std = complex(h[index, k]), float(std[index, k])
            rows.add(Part.LOG_MAGNITUDE, math.log(abs(value)), own_std, floor, place, k, 1)
            if phase_known:
                rows.add(Part.PHASE, float(np.angle(value)), own_std, floor, place, k, 1)
    test = SteppedResponses(
        name=name,
        drive_point=view.rig.drive_point,
        channels=tuple(own[0] for own in measured),
        reference=tables[0].reference,
        held=held,
        lines_hz=f[chosen].copy(),
        levels=amplitude[order[chosen]].copy(),
        measured=h[chosen].copy(),
        noise=np.hypot(std[chosen, 0], floor),
        direction={"up": 1, "down": -1}.get(tables[0].direction, 0),
        noise_degrees=measured[0][3],
        phase_known=phase_known,
        imposed=held == "response" and measured[0][0].point == view.rig.drive_point and view.far_from_modes(f[chosen]),
    )
    return rows.observations(test, notes)


def noise_of_lines(
    name: str, table: ObservableTable, order: NDArray[np.int64], h: ComplexArray, f: FloatArray
) -> tuple[FloatArray, list[str], float]:
    """Relative standard uncertainty of each line: stated by columns or for the table, else shown by its scatter.

    Also a note, and the degrees of freedom of its variance.
    """
    if "real_std" in table.columns and "imag_std" in table.columns:
        scatter = np.sqrt(0.5 * (table.columns["real_std"] ** 2 + table.columns["imag_std"] ** 2))[order]
        std = np.asarray(scatter / np.abs(h), dtype=np.float64)
        if np.isfinite(std).all():
            return std, [], math.inf
    if "magnitude_std" in table.columns:
        std = np.asarray(table.columns["magnitude_std"][order] / np.abs(h), dtype=np.float64)
        if np.isfinite(std).all():
            return std, [], math.inf
    if table.noise > 0.0:
        return np.full(h.size, table.noise), [], math.inf
    found, floor = scatter_of_lines(f, h, table.phase_known)
    if not math.isfinite(found):
        return (
            np.full(h.size, THRESHOLDS.noise.stepped_default_std),
            [
                f"{name}: no uncertainties are given; {100 * THRESHOLDS.noise.stepped_default_std:g} % is taken for "
                "every line."
            ],
            math.inf,
        )
    degrees = (2 if table.phase_known else 1) * h.size / (2.0 * THRESHOLDS.noise.median_relative_std**2)
    besides = f" and {floor:.2g} {table.units.get('real', '')}".rstrip() if floor else ""
    note = (
        f"{name}: no uncertainties are given; its lines scatter by {100 * found:.2g} %{besides} about a smooth course."
    )
    return np.hypot(found, floor / np.abs(h)), [note], degrees


def scatter_of_lines(frequency: FloatArray, response: ComplexArray, phase_known: bool = True) -> tuple[float, float]:
    """Noise of a frequency response from its scatter about a smooth course: a share of each line, and what all have.

    Each line is compared with the cubic through its four neighbours in ln H, or in H where that is nearer, as it is
    about an antiresonance. Medians and heavy tails do not see resonances and jumps, where no cubic follows the course.

    Args:
        frequency: ascending, Hz, shape (n,).
        response: shape (n,).
        phase_known: whether it has a phase; else its magnitude alone is looked at.

    Returns:
        Relative standard deviation of magnitude and phase (rad), NaN for fewer than twelve lines; and the deviation
        that all lines have in common, in the unit of the response, 0 where none is shown.
    """
    limits = THRESHOLDS.noise
    if frequency.size < limits.stepped_fewest_for_scatter:
        return math.nan, 0.0
    size = np.abs(response)
    log = np.log(size) + 1j * np.unwrap(np.angle(response))
    middle, near, weights = neighbour_cubics(frequency)
    if not middle.size:
        return math.nan, 0.0
    at, around, squares = size[middle], size[near], weights**2
    distance = log[middle] - np.sum(weights * log[near], axis=1)
    # Variances over those of a relative noise of 1, and of a noise of 1 that all lines have.
    shares = np.stack([1.0 + squares.sum(axis=1), at**-2 + np.sum(squares / around**2, axis=1)])
    if phase_known:
        plain = (response[middle] - np.sum(weights * response[near], axis=1)) / response[middle]
        in_plane = np.stack([1.0 + np.sum(squares * around**2, axis=1) / at**2, shares[0] / at**2])
        nearer = np.abs(plain) ** 2 / in_plane[0] < np.abs(distance) ** 2 / shares[0]
        distance, shares = np.where(nearer, plain, distance), np.where(nearer, in_plane, shares)
    parts = np.abs(np.stack([distance.real, distance.imag]) if phase_known else distance.real[None])

    def fitted(ratio: float) -> tuple[float, float]:
        """Relative noise of single lines, for its ratio to a common one, and minus the log likelihood (Student)."""
        scale = np.sqrt(shares[0] + ratio**2 * shares[1])
        whitened = (parts / scale) ** 2
        square = float(np.median(whitened))
        for _ in range(_SCALE_ROUNDS):
            square = max(float(np.mean((_TAIL + 1.0) * whitened / (_TAIL + whitened / max(square, 1e-300)))), 1e-300)
        cost = float(
            np.sum(np.log(scale) + 0.5 * np.log(square) + 0.5 * (_TAIL + 1.0) * np.log1p(whitened / square / _TAIL))
        )
        return math.sqrt(square) / _TAIL_SCALE, cost

    ratios = np.concatenate([[0.0], np.geomspace(0.1 * size.min(), size.max(), _NOISE_RATIOS)])
    tried = [fitted(float(ratio)) for ratio in ratios]
    best = int(np.argmin([cost for _, cost in tried]))
    if tried[0][1] - tried[best][1] > limits.stepped_floor_log_likelihood:
        return max(tried[best][0], 1e-4), tried[best][0] * float(ratios[best])
    # Median of |x| of a normal variable: 0.6745 σ.
    return max(float(np.median(parts / np.sqrt(shares[0]))) / 0.6745, 1e-4), 0.0


def jumps_of(response: ComplexArray) -> list[tuple[int, int]]:
    """First and last line of each jump of a response: neighbours, or with one between that had not settled."""
    steps = np.abs(np.log(np.abs(response[1:] / response[:-1])) + 1j * np.angle(response[1:] / response[:-1]))
    result: list[tuple[int, int]] = []
    for width in (1, 2):
        for i in range(steps.size - width + 1):
            around = [steps[k] for k in (i - 2, i - 1, i + width, i + width + 1) if 0 <= k < steps.size]
            step = float(np.mean(steps[i : i + width]))
            known = any(low <= i + width and i <= high for low, high in result)
            if (
                step > THRESHOLDS.reading.stepped_jump
                and around
                and step > THRESHOLDS.reading.stepped_jump_ratio * max(around)
                and not known
            ):
                result.append((i, i + width))
    return sorted(result)


def jump_note(name: str, low_hz: float, high_hz: float) -> str:
    """Sentence on a jump."""
    return (
        f"{name}: the response jumps between {low_hz:.5g} and {high_hz:.5g} Hz; these lines and any between are left "
        "out."
    )


def spread_lines(frequency: FloatArray, response: ComplexArray, wanted: int) -> NDArray[np.int64]:
    """Indices evenly spread over decades, turns of the phase and changes of the magnitude."""
    if frequency.size <= wanted:
        return np.arange(frequency.size, dtype=np.int64)
    ratio = response[1:] / response[:-1]
    turns = np.concatenate(([0.0], np.cumsum(np.abs(np.angle(ratio)) + 0.5 * np.abs(np.log(np.abs(ratio))))))
    # Noise of single lines looks like a turn, so half of the weight goes to the axis itself.
    share = turns / max(float(turns[-1]), 1e-300) + np.log(frequency / frequency[0]) / math.log(
        frequency[-1] / frequency[0]
    )
    picked = np.searchsorted(share, np.linspace(share[0], share[-1], wanted)).clip(0, share.size - 1)
    return np.unique(picked.astype(np.int64))
