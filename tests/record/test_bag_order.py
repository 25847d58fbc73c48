"""A bag whose messages stand in another order in the file than their log times, as merged and converted ones do."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from record.foreign_data import write

from nmt_extract.offline import extract_bag
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.imports.imported_run import read_import, write_import


def rewritten(source: Path, folder: Path, reach: int, chunk: int) -> Path:
    """The bag with its messages shuffled over ``reach`` messages, in chunks of that many bytes."""
    folder.mkdir()
    shutil.copy(source / "metadata.yaml", folder)
    (file,) = source.glob("*.mcap")
    with file.open("rb") as data:
        reader = make_reader(data)
        header = reader.get_header()
        messages = list(reader.iter_messages(log_time_order=True))
        metadata = list(reader.iter_metadata())
    order = random.Random(1)
    shuffled = []
    for first in range(0, len(messages), reach):
        part = messages[first : first + reach]
        order.shuffle(part)
        shuffled += part
    with (folder / file.name).open("wb") as data:
        writer = Writer(data, chunk_size=chunk, compression=CompressionType.ZSTD)
        writer.start(profile=header.profile, library="other")
        for item in metadata:
            writer.add_metadata(item.name, item.metadata)
        channels: dict[int, int] = {}
        for schema, channel, message in shuffled:
            if channel.id not in channels:
                assert schema is not None
                own = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, own, channel.metadata
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()
    return folder


@pytest.mark.parametrize(("reach", "chunk"), [(40, 1 << 20), (40, 3000), (100_000, 3000)])
def test_the_order_in_the_file_does_not_matter(reach: int, chunk: int, tmp_path: Path) -> None:
    run = read_import(write(tmp_path))
    source = write_import(run, tmp_path / "bag", "", "", {})
    other = rewritten(source, tmp_path / "other", reach, chunk)
    times = [received for _, received, _, _ in Bag.open(other).raw_messages()]
    assert times == sorted(times)
    expected, found = extract_bag(source).points, extract_bag(other).points
    assert len(expected) == len(found) > 0
    assert all(one.identical(two) for one, two in zip(expected, found, strict=True))
