"""From blocks and lock events to whole windows, or to the reason why a window cannot be used.

What comes out depends on the content of the streams alone, not on the order in which different streams
arrive: live and offline evaluation see the same windows. The rule is that of :mod:`nmt_record.windows.window_policy`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.records import LockEvent
from nmt_core.numerics.arrays import FloatArray
from nmt_record.windows.sample_table import HISTORY_SAMPLES, PATIENCE_SAMPLES, CutWindow, SampleTable
from nmt_record.windows.topic_blocks import ExcitationPhase, phase_reference
from nmt_record.windows.window_policy import MINIMUM_PERIODS, NamedWindow


class Channel(NamedTuple):
    """What a row of a window's data is."""

    name: str
    quantity: Quantity
    point: int
    stated_unit: str = ""

    @property
    def unit(self) -> str:
        """SI unit, as its block has it."""
        return self.stated_unit or self.quantity.unit


@dataclass(frozen=True, eq=False)
class Window:
    """All channels over a window without a flaw.

    Attributes:
        lock: the event that named it.
        sample_rate: Hz.
        channels: one for each row of ``data``.
        data: shape ``(channels, samples)``.
        cycles: excitation phase at each sample, cycles, not wrapped, shape ``(samples,)``; None if not
            knows it.
        end_cycles: phase at the sample after the last; NaN if not known.
    """

    lock: LockEvent
    sample_rate: float
    channels: tuple[Channel, ...]
    data: FloatArray
    cycles: FloatArray | None
    end_cycles: float

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.data.shape[1])


@dataclass(frozen=True)
class SpoiledWindow:
    """A window that must not be used.

    Attributes:
        lock: the event that named it.
        sample_rate: Hz; NaN if no block came.
        reason: one sentence.
    """

    lock: LockEvent
    sample_rate: float
    reason: str


class WindowAssembler:
    """Keeps the newest blocks of every stream and cuts windows out of them.

    Args:
        topics: sample topics that a window needs.
        decode: makes a :class:`SampleBlock` from the arguments of :meth:`add_record`; called only for blocks of a
            window.
        require_loop_state: a window needs loop states up to its end (False for data without a phase-locked
            loop).
        minimum_periods: windows of fewer whole periods are rejected.
        history_samples: samples kept of every topic while no window is awaited.
        patience_samples: how far other topics may run ahead before a window that lacks samples is given up.
        maximum_samples: longer windows are rejected, so that the memory stays bounded.

    Attributes:
        table: the streams.
        add_block, add_record, add_state: those of the table.
    """

    def __init__(
        self,
        topics: Sequence[str],
        decode: Callable[[Any], SampleBlock] = lambda payload: payload,
        *,
        require_loop_state: bool = True,
        minimum_periods: int = MINIMUM_PERIODS,
        history_samples: int = HISTORY_SAMPLES,
        patience_samples: int = PATIENCE_SAMPLES,
        maximum_samples: int = 4_000_000,
    ) -> None:
        self.table = SampleTable(
            topics,
            decode,
            every_channel=True,
            require_loop_state=require_loop_state,
            minimum_periods=minimum_periods,
            history_samples=history_samples,
            patience_samples=patience_samples,
            maximum_samples=maximum_samples,
        )
        self.add_block = self.table.add_block
        self.add_record = self.table.add_record
        self.add_state = self.table.add_state

    def add_lock(self, lock: LockEvent) -> None:
        """Take a lock event: a window to wait for."""
        window = NamedWindow(lock.window_first_sample, lock.window_samples, lock.window_periods, lock.sample)
        self.table.add_window(lock, window)

    def take(self) -> list[Window | SpoiledWindow]:
        """Windows that have become ready since the last call, in the order of their readiness."""
        cuts, found = self.table.take()[::-1], []
        while cuts:
            found.append(_joined(cuts.pop(), self.sample_rate))
        return found

    @property
    def ready(self) -> bool:
        """Whether :meth:`take` would return something."""
        return self.table.ready

    @property
    def sample_rate(self) -> float:
        """Of the first block, Hz; NaN before it."""
        return self.table.sample_rate

    def finish(self) -> None:
        """The streams have ended: give up what is not complete."""
        self.table.finish()


def _joined(cut: CutWindow, sample_rate: float) -> Window | SpoiledWindow:
    """The window as one array; its blocks go as they are copied."""
    lock: LockEvent = cut.key
    if cut.verdict.reason:
        return SpoiledWindow(lock, sample_rate, cut.verdict.reason)
    heads = [stretch.blocks[0] for stretch in cut.stretches]
    channels = tuple(
        Channel(name, head.quantity, point, head.unit)
        for head in heads
        for name, point in zip(head.channels, head.points, strict=True)
    )
    phase = ExcitationPhase(phase_reference(cut.stretches))
    cycles, end_cycles = (phase.cycles(), phase.end_cycles()) if phase.known else (None, math.nan)
    del phase
    data = np.empty((len(channels), cut.window.samples))
    row = 0
    for stretch, head in zip(cut.stretches, heads, strict=True):
        part = data[row : row + len(head.channels)]
        stretch.move_data(part)
        row += len(head.channels)
        missing = stretch.missing_values(part)
        if missing is not None:
            return SpoiledWindow(lock, sample_rate, missing.reason)
    return Window(lock, cut.stretches[0].sample_rate, channels, data, cycles, end_cycles)
