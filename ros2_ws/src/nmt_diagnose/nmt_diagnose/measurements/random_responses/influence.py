"""What unit sources at a place would do to the rows of a random test."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.measurements.random_responses.predictor import RandomPredictor
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.influence import Source, SourceColumn, source_vectors, with_sources
from nmt_diagnose.prediction.linear_model import LinearModel
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import RigParts, resting_tangent
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig


def influence_on_lines(
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
                # A response of zero has no logarithm to change: its rows are not used.
                there = responses[line] != 0.0
                relative = np.divide(change * turn, responses[line], out=np.zeros_like(change), where=there)
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
