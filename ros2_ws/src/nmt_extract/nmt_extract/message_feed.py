"""Feeds the messages of the bench's topics into an extractor; the same code live and offline."""

from __future__ import annotations

from collections.abc import Callable

from nmt_core.errors import BenchError
from nmt_core.kinds import kind_class
from nmt_core.messages.records import LevelCommand, LockEvent, LoopStatus
from nmt_core.messages.wire import LEVEL, LOCK_EVENT, BlockReader, read_status
from nmt_core.vocabulary import ControlKind
from nmt_extract.extractor import Extractor

STATE_TOPICS = ("frequency", "lock", "level")
"""Topics that the extraction reads besides samples."""


class MessageFeed:
    """One callback for each topic.

    Args:
        extractor: what the messages go to.

    Attributes:
        callbacks: function of one serialised message, by topic name.
        malformed: messages that could not be read.
    """

    def __init__(self, extractor: Extractor) -> None:
        self._extractor = extractor
        self.malformed = 0
        self.callbacks: dict[str, Callable[[bytes], None]] = {
            "frequency": self._on_frequency,
            "lock": self._on_lock,
            "level": self._on_level,
        }
        for topic in extractor.settings.topics:
            self.callbacks[topic] = self._block_callback(topic)

    def _block_callback(self, topic: str) -> Callable[[bytes], None]:
        add_record = self._extractor.add_record
        read = BlockReader().read

        def on_block(raw: bytes) -> None:
            try:
                block = read(raw)
            except ValueError:
                # The window it belongs to will be found to have a gap.
                self.malformed += 1
                return
            add_record(topic, block.first_sample, block.data.shape[1], block)

        return on_block

    def _on_frequency(self, raw: bytes) -> None:
        try:
            status = read_status(raw)
        except ValueError:
            self.malformed += 1
            return
        self.add_status(status)

    def add_status(self, status: LoopStatus) -> None:
        """Take the loop's state after a block."""
        self._extractor.add_state(
            status.last_sample, status.state, status.level_index, status.reason, status.response_unit
        )

    def _on_lock(self, raw: bytes) -> None:
        try:
            lock = LOCK_EVENT.read(raw)
        except BenchError:
            return  # a kind of test that is not known is not extracted
        except ValueError:
            self.malformed += 1
            return
        self.add_lock(lock)

    def add_lock(self, lock: LockEvent) -> None:
        """Take a lock event; only those of phase resonance tests are extracted."""
        if kind_class(lock.test).gives_modal_points:
            self._extractor.add_lock(lock)

    def _on_level(self, raw: bytes) -> None:
        try:
            level = LEVEL.read(raw)
        except BenchError:
            self._extractor.pass_over_level(int(LEVEL.values(raw)["index"]))
            return
        except ValueError:
            self.malformed += 1
            return
        self.add_level(level)

    def add_level(self, level: LevelCommand) -> None:
        """Take a level of the plan."""
        if not kind_class(level.test).gives_modal_points:
            self._extractor.pass_over_level(level.index)
            return
        unit = ControlKind(level.control).level_unit() if level.control in _KNOWN else ""
        self._extractor.add_level(
            level.index, level.amplitude, unit, level.harmonics_control, level.held_phase, level.parameter
        )


_KNOWN = frozenset(ControlKind)
