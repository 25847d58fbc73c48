"""Feeds the messages of the bench's topics into an extractor; the same code live and offline."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nmt_extract.conversions import level_unit, lock_event_from_message
from nmt_extract.extractor import Extractor

STATE_TOPICS = ("frequency", "lock", "level")
"""Topics that the extraction reads besides samples."""


class MessageFeed:
    """One callback for each topic.

    Args:
        extractor: what the messages go to; made with ``decode=nmt_core.conversions.block_from_message``.

    Attributes:
        callbacks: function of one message, by topic name.
    """

    def __init__(self, extractor: Extractor) -> None:
        self._extractor = extractor
        self.callbacks: dict[str, Callable[[Any], None]] = {
            "frequency": self._on_frequency,
            "lock": self._on_lock,
            "level": self._on_level,
        }
        for topic in extractor.settings.topics:
            self.callbacks[topic] = self._block_callback(topic)

    def _block_callback(self, topic: str) -> Callable[[Any], None]:
        add_record = self._extractor.add_record

        def on_block(message: Any) -> None:
            # Decoding waits until a window needs the block.
            channels = len(message.channels)
            add_record(
                topic, int(message.first_sample), len(message.data) // channels if channels else 0, message
            )

        return on_block

    def _on_frequency(self, message: Any) -> None:
        self._extractor.add_state(
            int(message.last_sample),
            int(message.state),
            int(message.level_index),
            message.reason,
            message.response_unit,
        )

    def _on_lock(self, message: Any) -> None:
        self._extractor.add_lock(lock_event_from_message(message))

    def _on_level(self, message: Any) -> None:
        self._extractor.add_level(
            int(message.index), float(message.amplitude), level_unit(int(message.control))
        )
