"""The messages of one MCAP chunk, handed to the writer of the ``mcap`` package together instead of one by one.

The bytes of the file are those that ``Writer.add_message`` gives; a message costs a fifth of the time.
"""

from __future__ import annotations

import struct
from typing import Any

from mcap.records import MessageIndex
from mcap.writer import Writer

_HEAD = struct.Struct("<BQHIQQ")
_MESSAGE = 0x05
_BESIDE_DATA = 22  # bytes of a message record next to its data and its own head of 9
_BUILDER, _STATISTICS = "_Writer__chunk_builder", "_Writer__statistics"


class ChunkMessages:
    """Messages that wait for the end of their chunk.

    Args:
        writer: with chunks, without a limit of their size.
    """

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        builder, statistics = getattr(writer, _BUILDER, None), getattr(writer, _STATISTICS, None)
        # Another version of the package may have other insides; then its own function takes them one by one.
        self.known_insides = all(
            hasattr(builder, name)
            for name in (
                "count", "record_writer", "message_indices", "message_start_time", "message_end_time", "num_messages"
            )
        ) and all(
            hasattr(statistics, name)
            for name in ("message_count", "message_start_time", "message_end_time", "channel_message_counts")
        )  # fmt: skip
        self._builder: Any = builder
        self._statistics: Any = statistics
        self._waiting: list[tuple[int, int, int, bytes]] = []

    def add(self, channel: int, log_time: int, publish_time: int, raw: bytes) -> None:
        """Take one message; times in ns."""
        self._waiting.append((channel, log_time, publish_time, raw))

    def hand_over(self) -> tuple[int, int, int] | None:
        """Give all messages to the writer.

        Returns:
            Their number, first and last time, ns; None if none waited.
        """
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return None
        times = [message[1] for message in waiting]
        span = len(waiting), min(times), max(times)
        if self.known_insides:
            self._append(waiting, *span)
        else:
            for channel, log_time, publish_time, raw in waiting:
                self._writer.add_message(channel, log_time, raw, publish_time)
        return span

    def _append(self, waiting: list[tuple[int, int, int, bytes]], number: int, first: int, last: int) -> None:
        builder, statistics = self._builder, self._statistics
        offset = builder.count
        parts: list[bytes] = []
        for channel, log_time, publish_time, raw in waiting:
            index = builder.message_indices.get(channel)
            if index is None:
                index = builder.message_indices[channel] = MessageIndex(channel_id=channel, records=[])
            index.records.append((log_time, offset))
            parts += (_HEAD.pack(_MESSAGE, _BESIDE_DATA + len(raw), channel, 0, log_time, publish_time), raw)
            offset += _HEAD.size + len(raw)
            statistics.channel_message_counts[channel] += 1
        builder.record_writer.write(b"".join(parts))
        builder.message_start_time = min(first, builder.message_start_time) if builder.num_messages else first
        builder.message_end_time = max(last, builder.message_end_time)
        builder.num_messages += number
        statistics.message_start_time = min(first, statistics.message_start_time) if statistics.message_count else first
        statistics.message_end_time = max(last, statistics.message_end_time)
        statistics.message_count += number
