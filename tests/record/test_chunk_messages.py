"""Messages handed over together give the bytes that the ``mcap`` package gives for them one by one."""

from __future__ import annotations

import io

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from nmt_record.bag.chunk_messages import ChunkMessages


def file_of(compression: CompressionType, together: bool) -> bytes:
    rng = np.random.default_rng(6)
    file = io.BytesIO()
    writer = Writer(file, chunk_size=2**62, compression=compression)
    writer.start(profile="ros2", library="test")
    chunk = ChunkMessages(writer)
    assert chunk.known_insides
    chunk.known_insides = together
    channels = [writer.register_channel(f"/{name}", "cdr", 0, {}) for name in "abc"]
    time = 10**18
    for number in (1, 40, 0, 7):
        for _ in range(number):
            time += int(rng.integers(-5, 50))
            chunk.add(int(rng.choice(channels)), time, time - 3, rng.bytes(int(rng.integers(0, 300))))
        span = chunk.hand_over()
        assert (span is None) == (number == 0)
        assert span is None or span[0] == number
        if number == 40:
            channels.append(writer.register_channel("/late", "cdr", 0, {}))
            continue
        writer.flush()
    writer.finish()
    return file.getvalue()


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_the_bytes_are_those_of_messages_one_by_one(compression: CompressionType) -> None:
    assert file_of(compression, together=True) == file_of(compression, together=False)
