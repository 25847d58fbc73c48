"""Messages of a run straight into a bag, for tests of a rig in one process without ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmt_core.blocks import Quantity, SampleBlock
from nmt_core.records import LevelCommand, LockEvent, LoopStatus
from nmt_core.vocabulary import ControlKind
from nmt_core.wire import LEVEL, LOCK_EVENT, BlockWriter, write_status
from nmt_record.bag_writer import BagWriter
from nmt_record.bench_topics import BENCH_TOPICS

if TYPE_CHECKING:
    from nmt_pll.level_loop import LoopOutput


class RunMessages:
    """Writes what plant, loop and sequencer of a run would publish.

    Args:
        writer: the bag; all topics of the bench are made known to it.
        rig: name of the rig.
    """

    def __init__(self, writer: BagWriter, rig: str) -> None:
        for topic in BENCH_TOPICS:
            writer.add_topic(topic.name, topic.message_type, topic.service)
        self._writer = writer
        self._rig = rig
        self._blocks: dict[Quantity, BlockWriter] = {}
        self._sample_rate = 1.0

    def put_level(self, level: LevelCommand) -> None:
        """A level of the plan."""
        self._writer.write("level", LEVEL.write(level))

    def put_block(self, block: SampleBlock) -> None:
        """Samples of one quantity."""
        self._sample_rate = block.sample_rate
        codec = self._blocks.setdefault(block.quantity, BlockWriter(self._rig))
        self._writer.write(block.quantity.topic, codec.write(block))

    def put_output(self, output: LoopOutput, response: Quantity) -> None:
        """The loop's answer to a block, and its lock if there is one."""
        level = output.level
        status = LoopStatus(
            last_sample=output.last_sample,
            level_index=level.index if level is not None else 0,
            level_sequence=level.sequence if level is not None else 0,
            state=int(output.state),
            frequency_hz=output.frequency_hz if output.amplitude > 0.0 else 0.0,
            phase_error=output.phase_error,
            force_amplitude=output.force_amplitude,
            response_amplitude=output.response_amplitude,
            response_unit=response.unit,
            drive_amplitude=output.amplitude,
            flags=output.flags,
            reason=output.transition.reason if output.transition is not None else "",
        )
        self._writer.write("frequency", write_status(status, self._sample_rate))
        if output.lock is not None:
            lock = output.lock
            event = LockEvent(
                level_index=lock.level.index,
                level=lock.level.amplitude,
                level_unit=ControlKind(lock.level.control).level_unit(response),
                sample=lock.sample,
                frequency_hz=lock.frequency_hz,
                phase_error=lock.phase_error,
                window_first_sample=lock.first_sample,
                window_samples=lock.samples,
                window_periods=lock.periods,
                test=lock.level.test,
            )
            self._writer.write("lock", LOCK_EVENT.write(event))
