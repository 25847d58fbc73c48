"""Feeds the messages of the bench's topics into an extractor; the same code live and offline."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nmt_core.test_kind import TestKind
from nmt_core.wire import BlockReader, read_status
from nmt_extract.conversions import level_unit, lock_event_from_message
from nmt_extract.extractor import Extractor

STATE_TOPICS = ("frequency", "lock", "level")
"""Topics that the extraction reads besides samples."""


def gives_modal_points(message: Any) -> bool:
    """Whether a level or lock event is of a kind of test that is extracted; as all were before there were kinds."""
    value = int(getattr(message, "test", 0))
    return value in tuple(TestKind) and TestKind(value).gives_modal_points


class MessageFeed:
    """One callback for each topic.

    Args:
        extractor: what the messages go to.

    Attributes:
        raw: function of one serialised message, by topic name: samples and loop states, the bulk of the traffic.
        decoded: function of one deserialised message, by topic name.
        malformed: serialised messages that could not be read.
    """

    def __init__(self, extractor: Extractor) -> None:
        self._extractor = extractor
        self.malformed = 0
        self.raw: dict[str, Callable[[bytes], None]] = {"frequency": self._on_frequency}
        self.decoded: dict[str, Callable[[Any], None]] = {"lock": self._on_lock, "level": self._on_level}
        for topic in extractor.settings.topics:
            self.raw[topic] = self._block_callback(topic)

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
        self._extractor.add_state(
            status.last_sample, status.state, status.level_index, status.reason, status.response_unit
        )

    def _on_lock(self, message: Any) -> None:
        if not gives_modal_points(message):
            return
        self._extractor.add_lock(lock_event_from_message(message))

    def _on_level(self, message: Any) -> None:
        if not gives_modal_points(message):
            self._extractor.pass_over_level(int(message.index))
            return
        self._extractor.add_level(int(message.index), float(message.amplitude), level_unit(int(message.control)))
