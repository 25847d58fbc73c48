"""Generic sources at every place of a rig: what an unnamed effect there could do to the observables.

A source has an amplitude for every level, order and quadrature. Physical effects change smoothly from level to level
(and from line to line), and most act on some orders only: odd ones, even ones, the fundamental alone, or linearly on
everything. Each of these families competes on its own; a place's evidence is their mean.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.boundary_effects import joint_location
from nmt_diagnose.effects.location import Location
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.prediction.forward import Forward, Prediction
from nmt_diagnose.prediction.influence import Source, SourceColumn
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.rig import Rig

_FAMILIES: tuple[tuple[str, tuple[int, ...], bool], ...] = (
    ("fundamental", (1,), False),
    ("odd orders", (1, 3, 5), False),
    ("even orders", (0, 2, 4), False),
    ("linear", (1,), True),
)


@dataclass(frozen=True)
class SourceLocation:
    """A place with the smooth responses to sources there.

    Attributes:
        location: where.
        families: name and whitened columns (m, s) of each family of sources.
    """

    location: Location
    families: tuple[tuple[str, FloatArray], ...]


def places(
    forward: Forward,
    rig: Rig,
    prediction: Prediction,
    observations: Observations,
    whitened: Callable[[FloatArray], FloatArray],
) -> list[SourceLocation]:
    """Places where an unnamed source may sit, with what it could do.

    Args:
        forward: the model.
        rig: rig of ``prediction``.
        prediction: solution about which the sources are small.
        observations: the real side.
        whitened: maps changes (m, n) of the model's values to changes of the compared values, over σ.
    """
    channels = {c.name: c for test in observations.tests for c in test.channels}
    wanted: list[tuple[Location, Source]] = [
        (Location.at("structure", point), Source("structure", point)) for point in rig.structure.points
    ]
    wanted += [(joint_location(element, f"element {k + 1}"), Source("joint", k)) for k, element in _joints(rig)]
    wanted += [(Location("boundary", detail="clamp"), Source("clamp")), (Location("exciter"), Source("exciter"))]
    wanted += [(Location("force_sensor"), Source("force_sensor"))]
    responses = sorted((c for c in channels.values() if c.quantity is not Quantity.FORCE), key=lambda c: c.name)
    wanted += [(_response(rig, channel), Source("response_sensor", channel=channel.name)) for channel in responses]
    wanted += [(Location("controller"), Source("controller")), (Location("time"), Source("time"))]
    result = []
    for location, source in wanted:
        columns, names = forward.influence(rig, prediction, source)
        changes = np.nan_to_num(whitened(columns), posinf=0.0, neginf=0.0)
        drift = source.kind == "time"
        families = (("drift", changes),) if drift else _families(changes, names, observations)
        families = tuple((name, block) for name, block in families if block.shape[1] and np.any(block))
        if families:
            result.append(SourceLocation(location, families))
    return result


def _response(rig: Rig, channel: MeasuredChannel) -> Location:
    """The sensor of a channel, at its point in the model where it is one of the model's."""
    points = [rig.sensor_point(sensor) for sensor in rig.sensors if rig.sensor_channel(sensor) == channel.name]
    return Location.on_channel("response_sensor", channel.name, points[0] if points else channel.point)


def _joints(rig: Rig) -> list[tuple[int, ElementSection]]:
    """Local elements with friction, numbered as the nonlinear coordinates that they act on."""
    return [(k, element) for k, element in enumerate(rig.local_elements) if element.friction]


def _families(
    columns: FloatArray, names: Sequence[SourceColumn], observations: Observations
) -> tuple[tuple[str, FloatArray], ...]:
    """Columns of single levels and lines, combined to smooth courses."""
    level_groups: dict[SourceColumn, list[tuple[int, int]]] = {}
    line_groups: dict[SourceColumn, list[tuple[int, int]]] = {}
    for position, column in enumerate(names):
        groups = level_groups if column.per == "level" else line_groups
        groups.setdefault(replace(column, number=-1), []).append((column.number, position))
    drive = {key: _logs(observations, [n for n, _ in members], True) for key, members in level_groups.items()}
    smooth = {
        key: _smooth(columns[:, [p for _, p in members]], drive[key], THRESHOLDS.comparison.source_level_length)
        for key, members in level_groups.items()
    }
    shared = {key: columns[:, [p for _, p in members]].sum(axis=1)[:, None] for key, members in level_groups.items()}
    lines = [
        _smooth(
            columns[:, [p for _, p in members]],
            _logs(observations, [n for n, _ in members], False),
            THRESHOLDS.comparison.source_line_length,
        )
        for members in line_groups.values()
    ]
    result = []
    for name, orders, linear in _FAMILIES:
        chosen = [block for key, block in (shared if linear else smooth).items() if key.order in orders]
        chosen += lines if linear else []
        if chosen:
            result.append((name, np.hstack(chosen)))
    return tuple(result)


def _logs(observations: Observations, numbers: Sequence[int], levels: bool) -> FloatArray:
    """ln of the drive of each level, or of the frequency of each line."""
    rows = observations.rows
    with_order = rows.harmonic >= 0
    values = rows.amplitude if levels else rows.frequency_hz
    result = np.empty(len(numbers))
    for k, number in enumerate(numbers):
        selected = values[with_order & (rows.level == number)]
        result[k] = np.log(max(float(np.median(selected)), 1e-300)) if selected.size else 0.0
    return result


def _smooth(columns: FloatArray, x: FloatArray, length: float) -> FloatArray:
    """Columns of smooth courses: principal functions of a Gaussian process over x, scaled by their size."""
    kernel = np.exp(-0.5 * ((x[:, None] - x[None, :]) / length) ** 2)
    values, vectors = np.linalg.eigh(kernel)
    keep = values > THRESHOLDS.comparison.source_least_eigenvalue * values[-1]
    result: FloatArray = columns @ (vectors[:, keep] * np.sqrt(values[keep]))
    return result
