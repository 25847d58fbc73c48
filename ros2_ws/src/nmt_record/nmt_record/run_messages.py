"""Messages of a run straight into a bag, for tests of a rig in one process without ROS."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt_core.blocks import SampleBlock
from nmt_record.bag_writer import BagWriter
from nmt_record.bench_topics import BENCH_TOPICS
from nmt_record.message_definitions import local_definitions

if TYPE_CHECKING:
    from nmt_pll.level_loop import LoopOutput
    from nmt_pll.settings import LevelCommand


class RunMessages:
    """Writes what plant, loop and sequencer of a run would publish, with the local type store.

    Args:
        writer: the bag; all topics of the bench are made known to it.
        rig: name of the rig.
    """

    def __init__(self, writer: BagWriter, rig: str) -> None:
        for topic in BENCH_TOPICS:
            writer.add_topic(topic.name, topic.message_type, topic.service)
        self._types = local_definitions().typestore.types
        self._writer = writer
        self._zero = self._types["builtin_interfaces/msg/Time"](0, 0)
        self._header = self._types["std_msgs/msg/Header"](self._zero, rig)

    def put_level(self, level: LevelCommand) -> None:
        """A level of the plan."""
        self._put("level", "Level", **dataclasses.asdict(level))

    def put_block(self, block: SampleBlock) -> None:
        """Samples of one quantity."""
        self._put(
            block.quantity.topic,
            "SampleBlock",
            header=self._header,
            first_sample=block.first_sample,
            sample_rate=block.sample_rate,
            quantity=int(block.quantity),
            unit=block.unit,
            channels=list(block.channels),
            points=np.array(block.points, dtype=np.uint32),
            data=np.ascontiguousarray(block.data).ravel(),
            oscillator_cycles=block.oscillator.cycles,
            oscillator_frequency_hz=block.oscillator.frequency_hz,
            oscillator_rate_hz_s=block.oscillator.rate_hz_s,
            flags=block.flags,
        )

    def put_output(self, output: LoopOutput, response_unit: str) -> None:
        """The loop's answer to a block, and its lock if there is one."""
        level = output.level
        self._put(
            "frequency",
            "Frequency",
            last_sample=output.last_sample,
            level_index=level.index if level is not None else 0,
            level_sequence=level.sequence if level is not None else 0,
            state=int(output.state),
            frequency_hz=output.frequency_hz,
            phase_error=output.phase_error,
            force_amplitude=output.force_amplitude,
            response_amplitude=output.response_amplitude,
            response_unit=response_unit,
            drive_amplitude=output.amplitude,
            flags=output.flags,
            reason=output.transition.reason if output.transition is not None else "",
        )
        if output.lock is not None:
            lock = output.lock
            self._put(
                "lock",
                "LockEvent",
                level_index=lock.level.index,
                level=lock.level.amplitude,
                level_unit="V",
                sample=lock.sample,
                frequency_hz=lock.frequency_hz,
                phase_error=lock.phase_error,
                window_first_sample=lock.first_sample,
                window_samples=lock.samples,
                window_periods=lock.periods,
                test=int(lock.level.test),
            )

    def _put(self, topic: str, kind: str, **values: Any) -> None:
        message_type = self._types[f"nmt_msgs/msg/{kind}"]
        if "stamp" in message_type.__dataclass_fields__:
            values["stamp"] = self._zero
        self._writer.write_message(topic, message_type(**values))
