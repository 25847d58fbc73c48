"""Bundles of serialised messages: what goes in comes out, when they are published, what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmt_core.messages.bundle import MOST_BYTES, BundleWriter, read_bundle
from nmt_record.bag.message_definitions import local_definitions

TOPICS = ("force", "acceleration", "voltage")
messages = st.lists(st.tuples(st.sampled_from(TOPICS), st.binary(max_size=40)), min_size=1, max_size=20)


def bundled(items, blocks=1):
    published = []
    writer = BundleWriter(TOPICS, blocks, published.append)
    for topic, raw in items:
        writer.add(topic, raw)
    writer.end_block()
    return published


@given(messages)
def test_messages_come_out_as_they_went_in(items):
    (raw,) = bundled(items)
    assert read_bundle(raw) == items


@given(messages)
def test_bytes_are_the_message_that_rosbags_makes(items):
    (raw,) = bundled(items)
    store = local_definitions()
    store.definition("nmt_msgs/msg/Bundle")
    message = store.typestore.types["nmt_msgs/msg/Bundle"](
        topics=",".join(TOPICS),
        topic=np.array([TOPICS.index(topic) for topic, _ in items], dtype=np.uint8),
        size=np.array([len(data) for _, data in items], dtype=np.uint32),
        data=np.frombuffer(b"".join(data for _, data in items), dtype=np.uint8),
    )
    assert raw == bytes(store.typestore.serialize_cdr(message, "nmt_msgs/msg/Bundle"))


def test_a_bundle_waits_for_its_blocks():
    published = []
    writer = BundleWriter(TOPICS, 3, published.append)
    for count in (0, 0, 1, 1, 1, 2):
        writer.add("force", b"1234")
        writer.end_block()
        assert len(published) == count
    assert [len(read_bundle(raw)) for raw in published] == [3, 3]


def test_what_waits_goes_when_no_other_block_may_follow():
    published = []
    writer = BundleWriter(TOPICS, 5, published.append)
    writer.add("force", b"1")
    writer.end_block(last=True)
    writer.add("voltage", b"2")
    writer.flush()
    writer.flush()
    assert [read_bundle(raw) for raw in published] == [[("force", b"1")], [("voltage", b"2")]]


def test_no_bundle_grows_beyond_a_datagram():
    published = []
    writer = BundleWriter(TOPICS, 100, published.append)
    for _ in range(20):
        writer.add("force", bytes(MOST_BYTES // 4))
        writer.end_block()
    assert published
    assert max(map(len, published)) <= MOST_BYTES + 100


@given(messages, st.data())
def test_what_is_cut_off_is_refused(items, data):
    (raw,) = bundled(items)
    end = data.draw(st.integers(0, len(raw) - 1))
    with pytest.raises(ValueError, match=r"whole Bundle|XCDR1"):
        read_bundle(raw[:end])


def test_an_unknown_topic_is_refused():
    (raw,) = bundled([("voltage", b"x")])
    with pytest.raises(ValueError, match="whole Bundle"):
        read_bundle(raw.replace(b"\x01\x00\x00\x00\x02", b"\x01\x00\x00\x00\x07"))
