"""What unit sources at a place would do to the rows of locked windows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.measurements.locked_windows.predictor import PhaseResonancePredictor
from nmt_diagnose.observations.observables import OF_THE_CHANNEL, Part
from nmt_diagnose.prediction.influence import Source, SourceColumn, source_vectors, with_sources
from nmt_diagnose.prediction.linear_model import LinearModel
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.periodic_state import PeriodicState
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import RigParts
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig


def influence_on_levels(
    predictor: PhaseResonancePredictor,
    rig: Rig,
    cache: PartsCache,
    states: Sequence[PeriodicState | None],
    source: Source,
    settings: PredictionSettings,
) -> tuple[FloatArray, list[SourceColumn]]:
    """Columns (rows of the test, sources), one for each level at least, and what each is the response to."""
    if source.kind == "controller":
        held, levels = predictor.rows.part == Part.PHASE_ERROR, range(len(predictor.levels))
        shifts = [0.01 * (held & (predictor.rows.level == level)) for level in levels]
        return np.stack(shifts, axis=1), [SourceColumn(predictor.test.name, "level", level) for level in levels]
    columns, labels = _resonance_influence(predictor, rig, cache, states, source, settings)
    # Lines and steps follow no excitation: only an error of their own channel adds to them.
    columns[np.isin(predictor.rows.part, OF_THE_CHANNEL)] = 0.0
    direct, more = _channel_sources(predictor, states, source)
    return np.hstack((columns, direct)), labels + more


def _resonance_influence(
    predictor: PhaseResonancePredictor,
    rig: Rig,
    cache: PartsCache,
    states: Sequence[PeriodicState | None],
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


def _channel_sources(
    predictor: PhaseResonancePredictor, states: Sequence[Any], source: Source
) -> tuple[FloatArray, list[SourceColumn]]:
    """Lines and steps of a channel, (rows of the test, sources): 1 % of its smallest fundamental, at each level."""
    empty: tuple[FloatArray, list[SourceColumn]] = np.zeros((len(predictor.rows), 0)), []
    if source.kind not in ("force_sensor", "response_sensor"):
        return empty
    channel = predictor.force_row if source.kind == "force_sensor" else predictor.own_row(source.index)
    rows = [index for index in range(len(predictor.test.channels)) if predictor.own_row(index) == channel]
    sizes = [float(abs(state.channels[channel, predictor.basis.fundamental])) for state in states if state is not None]
    columns, names = [], []
    for part in OF_THE_CHANNEL:
        selected = (predictor.rows.part == part) & np.isin(predictor.rows.channel, rows)
        for level in np.unique(predictor.rows.level[selected]) if sizes else ():
            columns.append(0.01 * min(sizes) * (selected & (predictor.rows.level == level)))
            names.append(SourceColumn(predictor.test.name, "level", int(level), unexcited=part))
    return (np.stack(columns, axis=1), names) if columns else empty
