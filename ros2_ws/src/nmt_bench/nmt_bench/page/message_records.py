"""Serialised messages of the bench as its records, by topic."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import SAMPLE_TOPICS
from nmt_core.messages.wire import (
    DRIVE_STOP,
    LEVEL,
    LOCK_EVENT,
    MODAL_POINT,
    RUN_STATE,
    STEERING,
    BlockReader,
    read_status,
)

SLOW_TOPICS = ("level", "lock", "modal_point", "steering", "drive_stop")
"""Topics with a few messages a level, which tell what has become of a test."""
WATCHED_TOPICS = (*SAMPLE_TOPICS, "frequency", "run_state", *SLOW_TOPICS)
"""Topics that the page shows."""


class RecordReader:
    """Reads messages of the watched topics; counts those that cannot be read."""

    def __init__(self) -> None:
        self.malformed = 0
        self._read: dict[str, Callable[[bytes], Any]] = {topic: BlockReader().read for topic in SAMPLE_TOPICS}
        self._read.update(
            frequency=read_status,
            run_state=RUN_STATE.read,
            level=LEVEL.read,
            lock=LOCK_EVENT.read,
            modal_point=MODAL_POINT.read,
            steering=STEERING.read,
            drive_stop=DRIVE_STOP.read,
        )

    def read(self, topic: str, raw: bytes) -> Any:
        """The record; None for other topics and for what cannot be read."""
        read = self._read.get(topic)
        if read is None:
            return None
        try:
            return read(raw)
        except (ValueError, BenchError):
            self.malformed += 1
            return None
