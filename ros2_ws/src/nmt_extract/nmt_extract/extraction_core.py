"""What the extraction node does with messages, free of ROS: blocks, loop states, levels and locks in, points out."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from functools import partial
from typing import Any

from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.wire import BlockReader
from nmt_extract.extraction_settings import ExtractSettings
from nmt_extract.extractor import Extractor
from nmt_extract.message_feed import STATE_TOPICS, MessageFeed


class ExtractionCore:
    """The extractor with its parameters; without a linear description nothing is extracted.

    Args:
        settings: those of the node.

    Attributes:
        topics: what it listens to.
        extractor: None without a linear description.

    Raises:
        BenchError: a parameter is refused.
    """

    def __init__(self, settings: ExtractSettings) -> None:
        text = settings.linear_json
        extraction = settings.whole_extraction
        self.topics: tuple[str, ...] = (*extraction.topics, *STATE_TOPICS)
        self.extractor: Extractor | None = None
        self.feed: MessageFeed | None = None
        self._passed: dict[str, tuple[int, float]] = dict.fromkeys(extraction.topics, (0, math.nan))
        if text:
            self.extractor = Extractor(LinearDescription.from_json(text), extraction)
            self.feed = MessageFeed(self.extractor)

    def callback(self, topic: str) -> Callable[[bytes], None]:
        """Function of one serialised message of a topic."""
        if self.feed is not None:
            return self.feed.callbacks[topic]
        if topic in self._passed:
            return partial(self._pass, topic, BlockReader().read)
        return lambda _: None

    def _pass(self, topic: str, read: Callable[[bytes], Any], raw: bytes) -> None:
        """Note how far a topic has come of which nothing is extracted."""
        with contextlib.suppress(ValueError):
            block = read(raw)
            self._passed[topic] = block.first_sample + block.data.shape[1], block.sample_rate

    @property
    def taken(self) -> tuple[int, float]:
        """First sample that has not been taken yet, and the sample rate (Hz; NaN before the first)."""
        if self.extractor is not None:
            return self.extractor.reached
        return min(self._passed.values(), default=(0, math.nan))

    def points(self) -> list[ModalPoint]:
        """Points that have become ready since the last call."""
        if self.extractor is None or not self.extractor.ready:
            return []
        return self.extractor.take()

    @property
    def counters(self) -> dict[str, int]:
        """Points by status, gaps and blocks by topic, and what could not be read."""
        own = {} if self.extractor is None else self.extractor.counters
        return {**own, "malformed": 0 if self.feed is None else self.feed.malformed, "taken": self.taken[0]}
