"""What unit sources at a place would do to all observables, linearised about a prediction.

A source is an additional force (or error) of one order at one level, or at one line. Any effect at a place, known or
not, acts as some combination of the sources there: what they cannot explain does not lie there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.measurements.locked_windows.predictor import PhaseResonancePredictor
from nmt_diagnose.measurements.random_responses.predictor import RandomPredictor
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.linear_model import LinearModel, OutputRows, linear_model
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.periodic_state import PeriodicState
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import RigParts, resting_tangent
from nmt_diagnose.thresholds import THRESHOLDS
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


def resonance_influence(
    predictor: PhaseResonancePredictor,
    rig: Rig,
    cache: PartsCache,
    states: tuple[PeriodicState | None, ...],
    source: Source,
    settings: PredictionSettings,
) -> tuple[FloatArray, list[SourceColumn]]:
    """Columns (rows of the test, sources): one for each level, order, and real and imaginary part."""
    base = predictor.values(rig, cache, list(states))
    moved: list[tuple[int, PeriodicState]] = []
    names: list[SourceColumn] = []
    models: dict[int, LinearModel] = {}
    highest = predictor.test.harmonics
    for position, (level, state) in enumerate(zip(predictor.levels, states, strict=True)):
        if state is None:
            continue
        parts = predictor.parts(rig, cache, level)
        z = predictor.carried(parts, level, state)
        at = predictor.linearised(parts, level, z)
        channels = at.channels
        force = abs(channels[predictor.force_row, 1])
        vectors = np.zeros((parts.system.size, 0))
        if source.kind not in ("force_sensor", "response_sensor"):
            vectors, measured = source_vectors(rig, parts, source)
            if id(parts) not in models:
                models[id(parts)] = with_sources(parts, vectors, measured, settings)
        for order in range(highest + 1):
            for turn in (1.0, 1j) if order else (1.0,):
                for residual, direct, vector in _level_sources(
                    predictor,
                    parts,
                    models.get(id(parts)),
                    vectors.shape[1],
                    source,
                    state,
                    order,
                    turn,
                    force,
                    channels,
                ):
                    step = -np.linalg.solve(at.jacobian, residual)
                    channels_there = channels + direct + at.slopes @ step
                    moved.append((position, PeriodicState(z + step, parts.keys, state.drive, channels_there)))
                    part: Literal["re", "im"] = "re" if turn == 1.0 else "im"
                    names.append(SourceColumn(predictor.test.name, "level", position, order, part, vector))
    columns = np.zeros((base.size, len(moved)))
    # Only the rows of its own level follow a solution: one of every level can be looked at in one go.
    turns: dict[int, int] = {}
    together: list[dict[int, int]] = []
    for column, (position, _) in enumerate(moved):
        turn_of_level = turns[position] = turns.get(position, -1) + 1
        if turn_of_level == len(together):
            together.append({})
        together[turn_of_level][position] = column
    for members in together:
        several: list[PeriodicState | None] = [None] * len(states)
        for position, column in members.items():
            several[position] = moved[column][1]
        change = predictor.values(rig, cache, several) - base
        for position, column in members.items():
            columns[:, column] = np.where(predictor.rows.level == position, change, 0.0)
    return columns, names


def _level_sources(
    predictor: PhaseResonancePredictor, parts: RigParts, model: LinearModel | None, count: int, source: Source,
    state: PeriodicState, order: int, turn: complex, force: float, channels: ComplexArray,
) -> list[tuple[FloatArray, ComplexArray, int]]:  # fmt: skip
    """Change of the residual, of the channels, and its number, for each source vector at one order."""
    nz, r, basis = state.z.size, parts.coordinates, parts.basis
    result: list[tuple[FloatArray, ComplexArray, int]] = []
    if model is None:
        row = predictor.force_row if source.kind == "force_sensor" else predictor.own_row(source.index)
        direct = np.zeros_like(channels)
        direct[row, order] = THRESHOLDS.prediction.unit_source_share * turn * channels[row, 1]
        residual = np.zeros(nz)
        if order == 1:
            residual[-2] = predictor.phase_change(row, THRESHOLDS.prediction.unit_source_share * turn)
        return [(residual, direct, 0)]
    t, _ = model.at(1j * order * state.omega)
    for k in range(count):
        amount = (
            THRESHOLDS.prediction.unit_source_share
            * force
            * turn
            * np.exp(1j * np.angle(channels[predictor.force_row, 1]))
        )
        column = t[:, parts.inputs.shape[1] + k]
        size = float(np.max(np.abs(column[: r + parts.channels.shape[0]]))) or 1.0
        residual = np.zeros(nz)
        for i in range(r):
            direct_change = -column[i] * amount
            offset = i * basis.size + basis.offsets[order]
            residual[offset] = direct_change.real
            if order:
                residual[offset + 1] = -direct_change.imag
        direct = np.zeros_like(channels)
        gains = predictor.gains(parts, 1j * order * state.omega)
        direct[:, order] = gains * column[r:] * amount
        if order == 1:
            residual[-2] = float(
                (direct[predictor.force_row, 1] / channels[predictor.force_row, 1]).imag
                - (direct[predictor.response_row, 1] / channels[predictor.response_row, 1]).imag
            )
        if size > 0.0:
            result.append((residual, direct, k))
    return result


def random_influence(
    predictor: RandomPredictor, rig: Rig, cache: PartsCache, source: Source, settings: PredictionSettings
) -> tuple[FloatArray, list[SourceColumn]]:
    """Columns (rows of the test, sources): one for each line and real and imaginary part."""
    parts = cache.parts(rig, predictor.setup, predictor.seconds)
    responses = predictor.responses(rig, cache)
    rows, r = predictor.rows, parts.coordinates
    lines = predictor.test.lines_hz
    channel_rows = predictor.channel_rows
    columns: list[FloatArray] = []
    names: list[SourceColumn] = []
    model: LinearModel | None = None
    count = 1
    if source.kind not in ("force_sensor", "response_sensor"):
        vectors, measured = source_vectors(rig, parts, source)
        model = with_sources(parts, vectors, measured, settings)
        count = vectors.shape[1]
    for line in range(lines.size):
        which = np.flatnonzero(rows.level == line)
        if which.size == 0:
            continue
        omega = 2.0 * np.pi * lines[line] * parts.clock
        changes = [
            _line_change(predictor, parts, model, k, source, omega, responses[line], channel_rows, r)
            for k in range(count)
        ]
        for k, change in enumerate(changes):
            for turn in (1.0, 1j):
                relative = change * turn / responses[line]
                column = np.zeros(len(rows))
                channel = rows.channel[which]
                column[which] = np.where(
                    rows.part[which] == Part.LOG_MAGNITUDE, relative[channel].real,
                    np.where(rows.part[which] == Part.PHASE, relative[channel].imag, 0.0),
                )  # fmt: skip
                columns.append(column)
                part: Literal["re", "im"] = "re" if turn == 1.0 else "im"
                names.append(SourceColumn(predictor.test.name, "line", line, part=part, vector=k))
    if not columns:
        return np.zeros((len(rows), 0)), []
    return np.column_stack(columns), names


def _line_change(
    predictor: RandomPredictor, parts: RigParts, model: LinearModel | None, k: int, source: Source, omega: float,
    responses: ComplexArray, channel_rows: Any, r: int,
) -> ComplexArray:  # fmt: skip
    """Change of the responses (channels,) by a unit source at one line."""
    change = np.zeros(responses.size, dtype=np.complex128)
    if model is None:
        for index, channel in enumerate(predictor.test.channels):
            is_force = channel.quantity == Quantity.FORCE
            if (source.kind == "force_sensor" and is_force) or (
                source.kind == "response_sensor" and not is_force and index == source.index
            ):
                change[index] = THRESHOLDS.prediction.unit_source_share * responses[index]
        return change
    s = 1j * omega
    t, _ = model.at(s)
    tangent = resting_tangent(parts, s)
    both = [r, r + parts.input_per_volt.size + k]  # the first exciter and the source
    closed = np.linalg.solve(np.eye(r) + t[:r, :r] * tangent, t[:r, both])
    full = t[r:, both] - t[r:, :r] @ (tangent[:, None] * closed)
    gains = np.array([predictor.gain(parts, row, s) for row in range(full.shape[0])])
    full = full * gains[:, None]
    # Unit: a share of the force at this line; where the channels have none, of the drive.
    force = [row for row, section in enumerate(parts.sections) if section is not None and section.quantity == "force"]
    size = abs(full[force[0], 0]) if force else 1.0
    drive = full[channel_rows[-1], 0]
    result: ComplexArray = THRESHOLDS.prediction.unit_source_share * size * full[channel_rows[:-1], 1] / drive
    return result
