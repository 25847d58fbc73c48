"""Serialised messages of several topics joined to one message, ``nmt_msgs/Bundle``, and taken apart again.

A delivery costs the middleware and both processes much more than the bytes it carries. Whoever may be late by some
blocks, as recorder and extraction may, takes them in bundles.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

from nmt_core.messages.cdr import COUNT, ENCAPSULATION, aligned, check_encapsulation, read_string, string_bytes

PLANT_BUNDLE = "plant_bundle"
"""Topic of the plant's samples."""
PLL_BUNDLE = "pll_bundle"
"""Topic of the loop's drive commands and states."""
LOOP_INPUT = "loop_input"
"""Topic of the loop's input of a block: force and response at the drive point."""
MOST_BYTES = 65_536
"""A bundle is full when the next block might not fit."""


class BundleWriter:
    """Joins serialised messages until there are enough.

    Args:
        topics: their topics.
        blocks: blocks of a bundle.
        publish: takes the serialised bundle.
    """

    def __init__(self, topics: Sequence[str], blocks: int, publish: Callable[[bytes], object]) -> None:
        self._index = {topic: index for index, topic in enumerate(topics)}
        self._head = _padded(ENCAPSULATION + string_bytes(",".join(topics)))
        self._blocks = blocks
        self._publish = publish
        self._messages: list[bytes] = []
        self._topics = bytearray()
        self._waiting = 0

    def add(self, topic: str, raw: bytes) -> None:
        """Take a message; it waits for `end_block` or `flush`."""
        self._topics.append(self._index[topic])
        self._messages.append(raw)

    def end_block(self, last: bool = False) -> None:
        """All messages of a block have been added; ``last``: none may follow for a while."""
        self._waiting += 1
        size = sum(map(len, self._messages))
        if last or self._waiting >= self._blocks or size * (self._waiting + 1) > MOST_BYTES * self._waiting:
            self.flush()

    def flush(self) -> None:
        """Publish what waits, if anything does."""
        if not self._messages:
            return
        messages, topics = self._messages, bytes(self._topics)
        count = len(messages)
        sizes = struct.pack(f"<I{count}I", count, *map(len, messages))
        head = _padded(self._head + COUNT.pack(count) + topics) + sizes
        raw = b"".join((head, COUNT.pack(sum(map(len, messages))), *messages))
        self._messages, self._topics, self._waiting = [], bytearray(), 0
        self._publish(raw)


def read_bundle(raw: bytes) -> list[tuple[str, bytes]]:
    """The messages of a serialised bundle, each with its topic, in the order in which they were published.

    Raises:
        ValueError: the bytes are not a whole Bundle message.
    """
    check_encapsulation(raw)
    try:
        names, position = read_string(raw, len(ENCAPSULATION))
        topics = names.split(",")
        position = aligned(position, 4)
        (count,) = COUNT.unpack_from(raw, position)
        which = raw[position + 4 : position + 4 + count]
        position = aligned(position + 4 + count, 4)
        (count_of_sizes,) = COUNT.unpack_from(raw, position)
        if count_of_sizes != count or len(which) != count:
            raise ValueError("topics and sizes differ in number")
        sizes = struct.unpack_from(f"<{count}I", raw, position + 4)
        position += 4 + 4 * count
        (total,) = COUNT.unpack_from(raw, position)
        position += 4
        if total != sum(sizes) or position + total > len(raw):
            raise ValueError("it ends early")
        messages = []
        for index, size in zip(which, sizes, strict=True):
            messages.append((topics[index], raw[position : position + size]))
            position += size
    except (struct.error, IndexError, ValueError) as error:
        raise ValueError(f"the message is not a whole Bundle: {error}") from error
    return messages


def _padded(raw: bytes) -> bytes:
    return raw + bytes(aligned(len(raw), 4) - len(raw))
