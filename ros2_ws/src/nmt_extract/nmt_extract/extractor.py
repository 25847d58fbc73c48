"""The extraction as one object, live and offline: streams in, modal points out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.records import LockEvent
from nmt_core.vocabulary import LoopState, PointStatus
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.judgement.channel_history import ChannelHistory
from nmt_extract.modal.point import modal_point, rejected_point
from nmt_extract.modal.window import SpoiledWindow, WindowAssembler


class Extractor:
    """Takes blocks, loop states, levels and lock events in any interleaving and returns modal points.

    Args:
        linear: linear modes at the response points.
        settings: None = defaults.
        decode: makes a :class:`SampleBlock` from the arguments of :meth:`add_record`.
        require_loop_state: False for data without a phase-locked loop.
    """

    def __init__(
        self,
        linear: LinearDescription,
        settings: ExtractionSettings | None = None,
        decode: Callable[[Any], SampleBlock] = lambda payload: payload,
        *,
        require_loop_state: bool = True,
    ) -> None:
        self.linear = linear
        self.settings = settings or ExtractionSettings()
        self.assembler = WindowAssembler(
            self.settings.topics,
            decode,
            require_loop_state=require_loop_state,
            minimum_periods=self.settings.minimum_periods,
        )
        self.add_record = self.assembler.add_record
        self.levels: dict[int, tuple[float, str, float, int]] = {}
        self.history = ChannelHistory()
        self._passed_over: set[int] = set()
        self.lock_samples: dict[int, int] = {}
        self._state = 0
        self._acquiring_since = -1
        self._not_locked: list[ModalPoint] = []
        self._counts = dict.fromkeys(PointStatus, 0)

    def add_block(self, topic: str, block: SampleBlock) -> None:
        """Take one block of a topic."""
        self.add_record(topic, block.first_sample, block.samples, block)

    def add_state(
        self, last_sample: int, state: int, level_index: int = 0, reason: str = "", response_unit: str = ""
    ) -> None:
        """Take the loop's state after one block (``nmt_msgs/Frequency``)."""
        previous, self._state = self._state, state
        if state == LoopState.ACQUIRING and previous != LoopState.ACQUIRING:
            self._acquiring_since = last_sample
        if state == LoopState.LOCK_LOST and previous != LoopState.LOCK_LOST:
            locked = self.lock_samples.get(level_index, -1)
            never_locked = not self._acquiring_since <= locked <= last_sample or locked < 0
            if never_locked and level_index not in self._passed_over:
                self._not_locked.append(self._not_locked_point(last_sample, level_index, reason, response_unit))
        self.assembler.add_state(last_sample, state, reason)

    def add_level(
        self,
        index: int,
        amplitude: float,
        unit: str,
        harmonics_control: int = 0,
        held_phase: float = 0.0,
        parameter: int = 0,
    ) -> None:
        """Take a level of the plan; the unit of controlled responses may be empty.

        ``held_phase``: by which its force leads the velocity, rad; ``parameter``: what it is held by.
        ``harmonics_control``: up to which the force's
        harmonics are controlled in it, see :class:`~nmt_core.messages.records.LevelCommand`.

        A level of amplitude zero ends the excitation and is not a level of the plan.
        """
        if amplitude > 0.0:
            self.levels[index] = (amplitude, unit, held_phase, parameter)
            self._passed_over.discard(index)
            if harmonics_control:
                self.history.driven[index] = harmonics_control

    def pass_over_level(self, index: int) -> None:
        """A level of a test that gives no modal points: neither does its failure."""
        self._passed_over.add(index)

    def add_lock(self, lock: LockEvent) -> None:
        """Take a lock event."""
        self.lock_samples[lock.level_index] = lock.sample
        self.assembler.add_lock(lock)

    @property
    def ready(self) -> bool:
        """Whether :meth:`take` would return points."""
        return bool(self._not_locked) or self.assembler.ready

    def take(self) -> list[ModalPoint]:
        """Points that have become ready since the last call."""
        points, self._not_locked = self._not_locked, []
        for window in self.assembler.take():
            if isinstance(window, SpoiledWindow):
                points.append(rejected_point(window.lock, window.sample_rate, window.reason))
            else:
                points.append(modal_point(window, self.linear, self.settings, self.history))
        for point in points:
            self._counts[point.status] += 1
        return points

    def finish(self) -> list[ModalPoint]:
        """The streams have ended: the points of windows that were never completed, with the reason."""
        self.assembler.finish()
        return self.take()

    @property
    def reached(self) -> tuple[int, float]:
        """Sample after the last one that all streams have brought, and the sample rate (Hz; NaN before the first)."""
        return self.assembler.table.reached, self.assembler.sample_rate

    @property
    def counters(self) -> dict[str, int]:
        """Points by status, gaps and blocks by topic."""
        counters = {
            "points": self._counts[PointStatus.OK],
            "rejected": self._counts[PointStatus.REJECTED],
            "not_locked": self._counts[PointStatus.NOT_LOCKED],
        }
        counters.update({f"gaps_{topic}": count for topic, count in self.assembler.table.gaps.items()})
        counters.update({f"blocks_{topic}": count for topic, count in self.assembler.table.blocks.items()})
        return counters

    def _not_locked_point(self, sample: int, level_index: int, reason: str, response_unit: str) -> ModalPoint:
        level, unit, held_phase, parameter = self.levels.get(level_index, (float("nan"), "", 0.0, 0))
        why = f": {reason.rstrip('.')}" if reason else ""
        return ModalPoint(
            level_index=level_index,
            status=PointStatus.NOT_LOCKED,
            reason=f"The level did not lock{why}.",
            level=level,
            level_unit=unit or response_unit,
            held_phase=held_phase,
            parameter=parameter,
            time_ns=bench_time_ns(sample, self.assembler.sample_rate),
        )
