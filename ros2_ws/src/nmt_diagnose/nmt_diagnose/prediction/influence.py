"""What unit sources at a place would do to all observables, linearised about a prediction.

A source is an additional force (or error) of one order at one level, or at one line. Any effect at a place, known or
not, acts as some combination of the sources there: what they cannot explain does not lie there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.linear_model import LinearModel, OutputRows, linear_model
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import RigParts
from nmt_rig.rig import BeamSection, Rig

SourceKind = Literal["structure", "joint", "clamp", "exciter", "force_sensor", "response_sensor", "controller", "time"]


@dataclass(frozen=True)
class Source:
    """A place with one or several source vectors.

    Attributes:
        kind: force at a point, across a nonlinear coordinate, of the clamp, from behind the force sensor, error of the
            force channel or of another channel, phase that the loop holds, drift of stiffness and of slip forces.
        index: point, coordinate, or number of the channel in a test.
        channel: name of the channel.
    """

    kind: SourceKind
    index: int = 0
    channel: str = ""


@dataclass(frozen=True)
class SourceColumn:
    """What one column of an influence is the response to.

    Attributes:
        test: name of the test; empty for a drift.
        per: each level, line of the spectrum or drift has sources of its own.
        number: of the level, the line or the drift; −1 where one source serves all.
        order: harmonic.
        part: real or imaginary part; empty where there is only one.
        vector: number of the source vector.
        unexcited: a line of the mains, or a converter's step, that follows no excitation.
    """

    test: str
    per: Literal["level", "line", "drift"]
    number: int
    order: int = 1
    part: Literal["re", "im", ""] = ""
    vector: int = 0
    unexcited: Part | None = None


def source_vectors(rig: Rig, parts: RigParts, source: Source) -> tuple[FloatArray, tuple[int, ...]]:
    """Generalised forces (n, k) of a mechanical source, and point of the force that each is part of (0 = none)."""
    system = parts.system
    if source.kind == "structure":
        vectors = [system.selector(source.index)]
    elif source.kind == "joint":
        if source.index >= parts.coordinates:
            return np.zeros((system.size, 0)), ()
        vectors = [parts.inputs[:, source.index]]
    elif source.kind == "exciter":
        points = parts.rig.exciter_points
        return np.column_stack([system.selector(point) for point in points]), points
    else:
        vectors = _clamp_vectors(rig, system.size)
    return np.array(vectors).reshape(-1, system.size).T, (0,) * len(vectors)


def _clamp_vectors(rig: Rig, size: int) -> list[FloatArray]:
    """Forces of a rotation and of a displacement of the clamp, by the stiffness of the first element."""
    beam = rig.structure
    if not isinstance(beam, BeamSection) or "clamped" not in beam.boundary:
        return []
    a = beam.length_m / (beam.elements * beam.mesh_refinement)
    rotation, lateral = np.zeros(size), np.zeros(size)
    if beam.clamp_rotational_stiffness_nm_rad is not None or beam.clamp_lateral_stiffness_n_m is not None:
        rotation[0] = 1.0
        return [rotation]
    rotation[:2] = 6.0 * a, -2.0 * a * a
    lateral[:2] = 12.0, 6.0 * a
    return [rotation / np.linalg.norm(rotation), lateral / np.linalg.norm(lateral)]


def with_sources(
    parts: RigParts, vectors: FloatArray, measured: tuple[int, ...], settings: PredictionSettings
) -> LinearModel:
    """Linear model with the sources as further inputs behind the exciters."""
    feed = np.zeros((parts.rows.feedthrough.shape[0], vectors.shape[1]))
    r = parts.coordinates
    for row, section in enumerate(parts.sections):
        # A force from behind the sensor passes through it.
        if section is not None and section.quantity == "force":
            feed[r + row] = [point == parts.rig.sensor_point(section) for point in measured]
    rows = OutputRows(
        parts.rows.displacement, parts.rows.velocity, parts.rows.acceleration,
        np.column_stack((parts.rows.feedthrough, feed)),
    )  # fmt: skip
    inputs = np.column_stack((parts.inputs, vectors))
    return linear_model(parts.system, inputs, rows, settings.kept_modes, settings.full_size)
