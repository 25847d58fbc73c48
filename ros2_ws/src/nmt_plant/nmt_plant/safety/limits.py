"""Safety limits on what is measured: abort and warning levels of every channel, peak and rms; open loop; drive maximum.

The first violation latches. Peaks are also predicted: what the last block measured, scaled by how much the drive is
about to grow, must not pass an abort level by a quarter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.numerics.arrays import FloatArray
from nmt_core.numerics.kernels import njit

# A prediction trips when it lies this much beyond the level: between the two, the measurement decides.
PREDICTION_FACTOR = 1.25
# s, in which a drive that fell counts less by a factor e, as the ringing of a light structure does.
_RING_TIME = 1.0


@njit(cache=True)
def watch_rows(data: FloatArray, share: float, levels: FloatArray, values: FloatArray) -> int:
    """Update the peaks and mean squares of every row of ``data`` and compare them with their levels.

    Args:
        data: (channels, samples).
        share: weight of this block in the running mean of squares.
        levels: (4, channels) abort peak, abort mean square, warning peak, warning mean square; infinity = none.
        values: (4, channels) peak of this block, running mean square, largest of both so far; changed in place.

    Returns:
        1 where a peak violates its abort level, plus 2 for a mean square, plus 4 for a warning level. What is not a
        number violates every finite level.
    """
    found = 0
    for row in range(data.shape[0]):
        peak = 0.0
        square = 0.0
        for k in range(data.shape[1]):
            magnitude = abs(data[row, k])
            if not magnitude <= peak:
                peak = magnitude if magnitude == magnitude else np.inf
            square += magnitude * magnitude
        mean = values[1, row] + share * (square / data.shape[1] - values[1, row])
        if not mean <= np.inf:
            mean = np.inf
        values[0, row] = peak
        values[1, row] = mean
        values[2, row] = max(values[2, row], peak)
        values[3, row] = max(values[3, row], mean)
        if peak > levels[0, row]:
            found |= 1
        if mean > levels[1, row]:
            found |= 2
        if peak > levels[2, row] or mean > levels[3, row]:
            found |= 4
    return found


@dataclass(frozen=True)
class ChannelLimit:
    """Levels of one channel, SI; None = none.

    Attributes:
        channel: name of the channel.
        abort_peak, abort_rms: levels that take the drive to zero.
        warning_peak, warning_rms: levels that are reported.
    """

    channel: str
    abort_peak: float | None = None
    abort_rms: float | None = None
    warning_peak: float | None = None
    warning_rms: float | None = None


@dataclass(frozen=True)
class OpenLoop:
    """The drive is on and a channel does not respond: a broken cable, a loose sensor, an amplifier that is off.

    Attributes:
        channel: name of the channel.
        least: smallest peak of a block that counts as a response, SI.
        drive: V, amplitude of the drive from which a response is due.
        seconds: how long there may be none.
    """

    channel: str
    least: float
    drive: float
    seconds: float


class _Rows:
    """Levels of the channels of one quantity as rows, and what they have reached; see `watch_rows`."""

    def __init__(
        self, block: SampleBlock, limit: float | None, channels: Mapping[str, ChannelLimit], warning_share: float | None
    ) -> None:
        self.channels = block.channels
        own = [channels.get(name, ChannelLimit(name)) for name in block.channels]
        none = math.inf
        common = none if limit is None else limit
        share = none if warning_share is None else warning_share
        peak = [min(common, none if c.abort_peak is None else c.abort_peak) for c in own]
        rms = [none if c.abort_rms is None else c.abort_rms for c in own]
        warning_peak = [c.warning_peak or share * top for c, top in zip(own, peak, strict=True)]
        warning_rms = [c.warning_rms or share * top for c, top in zip(own, rms, strict=True)]
        self.levels = np.array([peak, np.square(rms), warning_peak, np.square(warning_rms)])
        self.values = np.zeros((4, len(own)))
        self.background = np.zeros(len(own))
        self.watched = bool(np.isfinite(self.levels).any())
        self.limited = bool(np.isfinite(self.levels[0]).any())

    @property
    def abort_peak(self) -> FloatArray:
        """Abort levels of the peaks."""
        return np.asarray(self.levels[0], dtype=np.float64)

    @property
    def peaks(self) -> FloatArray:
        """Peaks of the last block."""
        return np.asarray(self.values[0], dtype=np.float64)


@dataclass
class LimitGuard:
    """Compares every block with the levels of its channels.

    Attributes:
        limits: quantity -> largest permitted magnitude of every channel of it, SI.
        channels: levels of single channels, next to those of their quantity.
        open_loops: channels that must respond to the drive.
        drive_maximum: V, amplitude of the drive that ends a test; None = none.
        rms_time: s, time constant of the running mean of squares.
        warning_share: of an abort level, from which it is reported where a channel has no warning level; None = never.
        reason: sentence about the violation that tripped, empty while there is none.
        warnings: channel and kind -> sentence about the first time a warning level was passed.
    """

    limits: Mapping[Quantity, float]
    channels: Sequence[ChannelLimit] = ()
    open_loops: Sequence[OpenLoop] = ()
    drive_maximum: float | None = None
    rms_time: float = 1.0
    warning_share: float | None = None
    reason: str = field(default="", init=False)
    warnings: dict[str, str] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self._by_channel = {limit.channel: limit for limit in self.channels}
        self._loops: dict[str, list[OpenLoop]] = {}
        for loop in self.open_loops:
            self._loops.setdefault(loop.channel, []).append(loop)
        self._rows: dict[Quantity, _Rows] = {}
        self._silent: dict[OpenLoop, int] = {}
        self._last: Sequence[SampleBlock] = ()
        self._drive = self._drive_of_ringing = 0.0

    def check(self, blocks: Sequence[SampleBlock], drive: float = 0.0) -> bool:
        """Latch the first violation; True if tripped now or before. NaN and infinity violate every limit.

        Args:
            blocks: what was measured.
            drive: V, largest amplitude of the drive in these blocks.
        """
        if self.reason:
            return True
        for block in blocks:
            rows = self._rows_of(block)
            if not (rows.watched or self._loops):
                continue
            if self._check_rows(block, rows) or (self._loops and self._check_loops(block, rows, drive)):
                return True
        if self.drive_maximum is not None and drive > self.drive_maximum and blocks:
            self.reason = (
                f"drive maximum: the drive's amplitude reached {drive:.4g} V in the block from sample "
                f"{blocks[0].first_sample}, limit {self.drive_maximum:g} V"
            )
            return True
        if blocks:  # of a block with lost samples nothing is known; the one before still tells the proportion
            self._last, self._drive = blocks, drive
            fade = math.exp(-blocks[0].samples / (blocks[0].sample_rate * _RING_TIME))
            self._drive_of_ringing = max(drive, fade * self._drive_of_ringing) if drive > 0.0 else 0.0
        return False

    def _rows_of(self, block: SampleBlock) -> _Rows:
        rows = self._rows.get(block.quantity)
        if rows is None:
            rows = _Rows(block, self.limits.get(block.quantity), self._by_channel, self.warning_share)
            self._rows[block.quantity] = rows
        return rows

    def _check_rows(self, block: SampleBlock, rows: _Rows) -> bool:
        """Update what the channels have reached; True where one of them trips."""
        share = -math.expm1(-block.samples / (block.sample_rate * self.rms_time))
        found = watch_rows(block.data, share, rows.levels, rows.values)
        if not found:
            return False
        rms = np.sqrt(rows.values[1])
        if found & 4:
            self._note_warnings(block, rows, rms)
        if found & 1:
            self._latch_peak(block, rows)
        elif found & 2:
            row = int(np.argmax(rows.values[1] > rows.levels[1]))
            self.reason = (
                f"{block.quantity.name.lower()} limit: {block.channels[row]} reached {rms[row]:.4g} {block.unit} rms "
                f"at sample {block.end_sample - 1}, limit {math.sqrt(rows.levels[1, row]):g} {block.unit} rms"
            )
        return bool(self.reason)

    def _note_warnings(self, block: SampleBlock, rows: _Rows, rms: FloatArray) -> None:
        for kind, values, levels in (("peak", rows.peaks, rows.levels[2]), ("rms", rms, np.sqrt(rows.levels[3]))):
            for index in np.flatnonzero(values > levels):
                name = block.channels[index]
                self.warnings.setdefault(
                    f"{name} {kind}",
                    f"{name} passed its warning level of {levels[index]:g} {block.unit} {kind} with "
                    f"{values[index]:.4g} {block.unit} in the block from sample {block.first_sample}",
                )

    def _latch_peak(self, block: SampleBlock, rows: _Rows) -> None:
        violating = np.argwhere(~(np.abs(block.data) <= rows.abort_peak[:, None]))
        row, sample = violating[np.argmin(violating[:, 1])]
        self.reason = (
            f"{block.quantity.name.lower()} limit: {block.channels[row]} reached "
            f"{block.data[row, sample]:.4g} {block.unit} at sample "
            f"{block.first_sample + int(sample)}, "
            f"limit {rows.abort_peak[row]:g} {block.unit}"
        )

    def _check_loops(self, block: SampleBlock, rows: _Rows, drive: float) -> bool:
        for row, name in enumerate(block.channels):
            for loop in self._loops.get(name, ()):
                silent = drive >= loop.drive and rows.peaks[row] < loop.least
                count = self._silent.get(loop, 0) + block.samples if silent else 0
                self._silent[loop] = count
                if count >= loop.seconds * block.sample_rate:
                    self.reason = (
                        f"open loop: {name} stayed below {loop.least:g} {block.unit} for {loop.seconds:g} s up to "
                        f"sample {block.end_sample - 1} although the drive was at {drive:.4g} V"
                    )
                    return True
        return False

    def predict(self, drive: float) -> bool:
        """Latch a violation that the next block would bring; True if tripped now or before.

        The peak of a channel is taken to grow in proportion to the drive, next to what it was before the drive came
        on; beyond `PREDICTION_FACTOR` times its abort level it trips. After a drive that falls the structure rings on:
        its peaks belong to the drive that it had, which counts less and less over `_RING_TIME`. Without a drive in the
        last block nothing is predicted.

        Args:
            drive: V, largest amplitude of the drive in the next block.
        """
        if self.reason:
            return True
        if not drive > self._drive:
            return False
        for block in self._last:
            rows = self._rows[block.quantity]
            if not rows.limited:
                continue
            if self._drive == 0.0:
                rows.background[:] = rows.peaks
                continue
            gain = np.maximum(rows.peaks - rows.background, 0.0) / self._drive_of_ringing
            expected = rows.peaks + gain * (drive - self._drive)
            if (expected > PREDICTION_FACTOR * rows.abort_peak).any():
                row = int(np.argmax(expected / rows.abort_peak))
                self.reason = (
                    f"{block.quantity.name.lower()} limit: {block.channels[row]} would reach about "
                    f"{expected[row]:.4g} {block.unit} in the block from sample {block.end_sample} with a drive of "
                    f"{drive:.4g} V, limit {rows.abort_peak[row]:g} {block.unit}"
                )
                return True
        return False

    @property
    def margins(self) -> dict[str, float]:
        """Channel -> largest share of an abort level it has reached so far; only channels that have one."""
        shares: dict[str, float] = {}
        for rows in self._rows.values():
            share = np.maximum(rows.values[2] / rows.levels[0], np.sqrt(rows.values[3] / rows.levels[1]))
            limited = np.isfinite(rows.levels[:2]).any(axis=0)
            shares.update({rows.channels[row]: float(share[row]) for row in np.flatnonzero(limited)})
        return shares

    def reset(self) -> None:
        """Forget the violation and what led to it; warnings and margins stay."""
        self.reason = ""
        self._silent.clear()
        self._last, self._drive, self._drive_of_ringing = (), 0.0, 0.0
        for rows in self._rows.values():
            rows.values[:2] = 0.0
