"""Messages between nodes over Unix sockets: in order, none lost to a slow reader, and never without end."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Iterator

import pytest

from nmt_core.nodes import link
from nmt_core.nodes.link import Link, serve, serve_late

BENCH = f"test {os.getpid()}"
MANY = 500  # more than the kernel keeps


@pytest.fixture
def pair() -> Iterator[tuple[Link, Link]]:
    plant, pll = Link(BENCH, "plant"), Link(BENCH, "pll")
    yield plant, pll
    plant.close()
    pll.close()


def test_a_reader_that_is_slow_gets_all_in_order(pair: tuple[Link, Link]) -> None:
    plant, pll = pair
    taken: list[bytes] = []
    pll.take("loop_input", taken.append)
    send = plant.sender("loop_input")
    sent = [number.to_bytes(4, "big") * 1000 for number in range(MANY)]
    for message in sent:
        send(message)
    assert not plant.flush()
    end = time.monotonic() + 10.0
    while len(taken) < MANY and time.monotonic() < end:
        serve(pair, 0.01)
    assert taken == sent
    assert plant.flush()


def test_a_node_that_has_gone_takes_nothing_and_holds_nobody_up(pair: tuple[Link, Link]) -> None:
    plant, pll = pair
    pll.close()
    plant.sender("loop_input")(b"lost")
    assert plant.flush()
    again = Link(BENCH, "pll")  # started anew
    taken: list[bytes] = []
    again.take("loop_input", taken.append)
    plant.sender("loop_input")(b"taken")
    serve((again,), 0.01)
    again.close()
    assert taken == [b"taken"]


def test_a_taker_that_does_not_read_holds_up_no_other(pair: tuple[Link, Link]) -> None:
    plant, pll = pair
    recorder, extract = Link(BENCH, "recorder"), Link(BENCH, "extract")
    for_extract: list[bytes] = []
    for_loop: list[bytes] = []
    extract.take("plant_bundle", for_extract.append)
    pll.take("loop_input", for_loop.append)
    bundle, send = plant.sender("plant_bundle"), plant.sender("loop_input")
    sent = [number.to_bytes(4, "big") * 10_000 for number in range(MANY // 10)]
    for message in sent:
        bundle(message)  # the recorder takes none of them
        send(message[:8])
        serve_late(extract, 0.0001)
        serve((pll,), 0.0001)
    end = time.monotonic() + 10.0
    while len(for_extract) < len(sent) and time.monotonic() < end:
        plant.flush()
        serve_late(extract, 0.001)
    assert for_extract == sent
    assert for_loop == [message[:8] for message in sent]
    assert not plant.flush()
    recorder.close()
    extract.close()
    assert plant.flush()


def test_a_second_node_of_a_name_is_refused(pair: tuple[Link, Link]) -> None:
    with pytest.raises(OSError, match="in use"):
        Link(BENCH, "plant")


def test_messages_without_end_leave_time_for_the_middleware(pair: tuple[Link, Link]) -> None:
    plant, pll = pair
    count = [0]

    def answer(raw: bytes) -> None:
        count[0] += 1
        send(raw)

    pll.take("loop_input", lambda raw: pll.sender("drive")(raw))
    plant.take("drive", answer)
    send = plant.sender("loop_input")
    send(b"x")
    began = time.thread_time()
    serve(pair, 0.05)
    assert count[0] > 3
    assert time.thread_time() - began < 0.5


def test_what_waits_is_sent_as_the_reader_has_room_although_nothing_more_is_sent(
    pair: tuple[Link, Link], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sender works while the reader polls, as a node does after its last block: one wake-up takes many queues."""
    plant, _ = pair
    extract = Link(BENCH, "extract")
    taken: list[bytes] = []
    extract.take("plant_bundle", taken.append)
    send = plant.sender("plant_bundle")
    sent = [number.to_bytes(4, "big") * 1000 for number in range(MANY)]
    for message in sent:
        send(message)
    counters = plant.counters
    assert counters["outbox_extract_longest"] > MANY // 2
    assert counters["outbox_extract_bytes"] == 4001 * counters["outbox_extract_longest"]  # one byte says the topic
    polled = link._polled

    def polled_while_the_sender_works(poll: select.poll, milliseconds: float) -> list[tuple[int, int]]:
        plant.flush()
        return polled(poll, milliseconds)

    monkeypatch.setattr(link, "_polled", polled_while_the_sender_works)
    wakes = 0
    while len(taken) < MANY and wakes < MANY:
        serve_late(extract, 0.05)
        wakes += 1
    assert taken == sent
    assert wakes < MANY // 20, "a queue at a time, however much waits"
    assert plant.counters["outbox_extract_bytes"] == 0
    extract.close()


def test_a_reader_that_was_started_anew_gets_what_is_sent_then(pair: tuple[Link, Link]) -> None:
    plant, pll = pair
    send = plant.sender("loop_input")
    send(b"to the first")
    assert pll.read()
    pll.close()
    again = Link(BENCH, "pll")
    taken: list[bytes] = []
    again.take("loop_input", taken.append)
    send(b"to the second")
    serve((again,), 0.01)
    again.close()
    assert taken == [b"to the second"]
