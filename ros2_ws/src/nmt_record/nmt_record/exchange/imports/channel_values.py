"""Values of a column in SI units: by what the file says of scale, zero and direction, and what the sidecar says."""

from __future__ import annotations

import math

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_record.exchange.sidecar.import_sidecar import ChannelSection
from nmt_record.exchange.source_table import SourceTable
from nmt_record.exchange.unit_table import channel_factor

_HALF = 32  # samples on either side that a delayed sample is made of


def channel_values(
    channel: ChannelSection, table: SourceTable, index: int, values: FloatArray, place: str, notes: list[str]
) -> FloatArray:
    """Values of one column, shape (rows,): force in N where a current counts as one.

    Args:
        channel: what the sidecar says.
        table: the file.
        index: of the column.
        values: of the column as they were judged, shape (rows,).
        place: of the channel in the sidecar, for messages.
        notes: where sentences go.

    Raises:
        BenchError: the unit is none of the quantity, or file and sidecar both turn the values.
    """
    where = f"{place}: column {channel.column}"
    factor = channel_factor(channel.quantity, channel.unit, where) * (channel.force_factor or 1.0)
    stated, scaling = "scale" in channel.model_fields_set, table.scalings[index]
    sign = _sign(channel, table, index, where, notes)
    scale = channel.scale if stated else scaling.scale
    if scaling.has_scale and stated and not math.isclose(scale, scaling.scale, rel_tol=1e-9):
        notes.append(
            f"{where}: {scaling.words} states the scale {scaling.scale:g}, the sidecar {scale:g}, which is used."
        )
    elif scaling.has_scale:
        values = (values - scaling.zero) * scale + scaling.offset
        scale = 1.0
    if channel.force_factor is not None:
        notes.append(
            f"Column {channel.column} counts as a {'torque' if channel.force_unit == 'N*m' else 'force'} by "
            f"{channel.force_factor:g} {channel.force_unit}/A: that on the coil. Mass, springs and damping of what the "
            "coil moves belong to the structure."
        )
    # Multiplying by one would be exact too, but this keeps the bits visibly untouched.
    return values if sign * scale * factor == 1.0 else values * (sign * scale * factor)


def _sign(channel: ChannelSection, table: SourceTable, index: int, where: str, notes: list[str]) -> int:
    scaling = table.scalings[index]
    if channel.sign is not None:
        if scaling.sign != channel.sign and scaling.words:
            notes.append(
                f"{where}: {scaling.words} says sign {scaling.sign}, the sidecar {channel.sign}, which is used."
            )
        return channel.sign
    if scaling.sign < 0 and channel.scale < 0.0:
        raise BenchError(
            f"{where} points the other way by {scaling.words}, and its scale is negative, too; say 'sign: -1' if both "
            "turn it, or 'sign: 1' if the scale alone does."
        )
    if scaling.sign < 0:
        notes.append(f"{where} points the other way by {scaling.words}; its values were turned.")
    return scaling.sign


def without_delay(values: FloatArray, samples: float) -> FloatArray:
    """A signal whose samples came late, at the times at which they belong.

    Fractions of a sample by a windowed sinc: flat to 0.1 % up to 0.9 of half the sampling rate. What lies outside of
    the recording is NaN for whole samples; missing samples spread over 32 on either side.

    Args:
        values: shape (samples,).
        samples: by how many it is late; negative = early.
    """
    steps = math.floor(samples + 0.5)
    part = samples - steps
    result = np.full(values.size, np.nan)
    if abs(steps) < values.size:
        kept = slice(max(steps, 0), values.size + min(steps, 0))
        result[max(-steps, 0) : values.size - max(steps, 0)] = _shifted(values, part)[kept]
    return result


def _shifted(values: FloatArray, part: float) -> FloatArray:
    """A signal part of a sample (at most a half) earlier."""
    if abs(part) < 1e-9 or values.size < 2 * _HALF + 2:
        return values
    places = np.arange(-_HALF, _HALF + 1, dtype=np.float64)
    weights = np.sinc(places - part) * np.kaiser(places.size, 8.0)
    weights /= weights.sum()
    padded = np.pad(values, _HALF, mode="reflect", reflect_type="odd")
    return np.convolve(padded, weights[::-1], mode="valid")
