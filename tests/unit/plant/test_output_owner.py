"""The owner of an output: what it puts out for what it is fed, chunk by chunk on a clock of the test."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Iterator

import numpy as np
import pytest

from nmt_core.blocks import FloatArray
from nmt_core.errors import BenchError
from nmt_plant.output_owner import (
    OutputOwner,
    OutputState,
    OwnerMessage,
    OwnerSettings,
    load_converter,
    read_report,
)

RATE, BLOCK, CHUNK = 10_000.0, 200, 40
SETTINGS = OwnerSettings(RATE, BLOCK, CHUNK, lead_blocks=2, deadline=0.06, ramp=0.02, limit=5.0)


class Bench:
    """An owner whose converter and clock belong to the test; a chunk takes its time on that clock."""

    def __init__(self, settings: OwnerSettings = SETTINGS, stop_input: int | None = None) -> None:
        self.now = 0.0
        self.out: list[FloatArray] = []
        self.stop = self.closed = False
        self.channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._theirs = theirs
        self.owner = OutputOwner(settings, theirs, self, stop_input, clock=lambda: self.now, parent=os.getppid())
        self.sequence = 0

    def write(self, values: FloatArray) -> None:
        assert len(self.out) < 20_000, "it does not end"
        self.out.append(values.copy())
        self.now += values.size / RATE

    def stop_requested(self) -> bool:
        return self.stop

    def close(self) -> None:
        self.closed = True

    def feed(self, values: FloatArray, sequence: int | None = None) -> None:
        number = self.sequence if sequence is None else sequence
        self.sequence = number + 1
        self.channel.send(struct.pack("<BQ", OwnerMessage.FEED, number) + values.tobytes())

    def steps(self, count: int) -> bool:
        going = True
        for _ in range(count):
            going = self.owner.step()
        return going

    def wave(self, blocks: int) -> FloatArray:
        """Feed a sine block by block while it is put out; returns what was fed."""
        fed = []
        for n in range(blocks):
            block = 2.0 * np.cos(2 * np.pi * 50.0 * (n * BLOCK + np.arange(BLOCK)) / RATE)
            self.feed(block)
            fed.append(block)
            if n >= 1:
                self.steps(BLOCK // CHUNK)
        return np.concatenate(fed)

    @property
    def output(self) -> FloatArray:
        return np.concatenate(self.out)

    def reports(self) -> list[tuple[OutputState, int, FloatArray, str]]:
        found = []
        while True:
            try:
                found.append(read_report(self.channel.recv(1 << 17, socket.MSG_DONTWAIT)))
            except BlockingIOError:
                return found

    def end(self) -> None:
        self.channel.close()
        self._theirs.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.end()


def ramp_from(value: float, samples: int) -> FloatArray:
    return 0.5 * value * (1.0 + np.cos(np.pi * np.arange(1, samples + 1) / samples))


def test_what_is_fed_is_put_out_and_reported_sample_by_sample(bench: Bench) -> None:
    fed = bench.wave(10)
    np.testing.assert_array_equal(bench.output, fed[: 9 * BLOCK])
    line = np.concatenate([values for _, _, values, _ in bench.reports()])
    np.testing.assert_array_equal(line, fed[: line.size])
    assert line.size >= 8 * BLOCK
    assert bench.owner.state is OutputState.FOLLOWING


def test_it_waits_for_its_lead(bench: Bench) -> None:
    bench.feed(np.ones(BLOCK))
    bench.steps(10)
    assert not bench.output.any()
    assert bench.owner.state is OutputState.AT_ZERO
    bench.feed(np.ones(BLOCK))
    bench.steps(1)
    assert bench.output[-CHUNK:].all()


def test_no_more_blocks_end_in_a_ramp_from_the_last_sample(bench: Bench) -> None:
    fed = bench.wave(6)
    bench.steps(20)
    np.testing.assert_array_equal(bench.output[: 6 * BLOCK], fed)
    np.testing.assert_allclose(bench.output[6 * BLOCK :][:200], ramp_from(fed[-1], 200), atol=1e-12)
    assert not bench.output[6 * BLOCK + 200 :].any()
    assert bench.owner.state is OutputState.HELD
    assert bench.owner.reason == "no block was there to be put out"


def test_the_deadline_acts_while_blocks_still_wait() -> None:
    bench = Bench(OwnerSettings(RATE, BLOCK, CHUNK, lead_blocks=8, deadline=0.059, ramp=0.02))
    for _ in range(8):
        bench.feed(np.full(BLOCK, 1.5))
    bench.steps(40)
    # Fed at time 0; the first chunk that begins later than 59 ms is the one at 60 ms.
    np.testing.assert_array_equal(bench.output[:600], 1.5)
    np.testing.assert_allclose(bench.output[600:800], ramp_from(1.5, 200), atol=1e-12)
    assert bench.owner.reason == "not fed for 60 ms"
    bench.end()


def test_a_hang_with_the_drive_at_zero_trips_nothing(bench: Bench) -> None:
    for _ in range(3):
        bench.feed(np.zeros(BLOCK))
    bench.steps(100)
    assert bench.owner.state is OutputState.AT_ZERO
    fed = bench.wave(4)
    np.testing.assert_array_equal(bench.output[-3 * BLOCK :], fed[: 3 * BLOCK])


def test_the_end_of_the_feeding_process_ends_the_owner_at_zero(bench: Bench) -> None:
    fed = bench.wave(6)
    bench.channel.close()
    bench.owner.run()
    assert bench.closed
    assert bench.owner.reason == "the process that fed the output has ended"
    np.testing.assert_allclose(bench.output[5 * BLOCK :][:200], ramp_from(fed[5 * BLOCK - 1], 200), atol=1e-12)
    assert not bench.output[5 * BLOCK + 200 :].any()


def test_the_end_of_the_feeding_process_is_seen_although_its_socket_lives_on(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.wave(6)
    monkeypatch.setattr(os, "getppid", lambda: 1_000_000)
    bench.owner.run()
    assert bench.owner.reason == "the process that fed the output has ended"
    assert bench.output[-1] == 0.0


@pytest.mark.parametrize(
    ("act", "reason"),
    [
        (lambda b: b.feed(np.ones(BLOCK), sequence=99), "block 99 was fed after block 5"),
        (lambda b: b.channel.send(struct.pack("<Bd", OwnerMessage.QUIET, -1.0) + b"operator"), "operator"),
        (lambda b: b.channel.send(b"\xff\x00nonsense"), "a message that is none was fed"),
        (lambda b: setattr(b, "stop", True), "the external stop input"),
        (lambda b: b.feed(np.full(BLOCK, np.nan)), "a sample of nan V is beyond the limit of 5.0 V"),
        (lambda b: b.feed(np.full(BLOCK, 5.1)), "a sample of 5.1 V is beyond the limit of 5.0 V"),
        (lambda b: [b.feed(np.ones(BLOCK)) for _ in range(80)], "blocks are fed faster than they can be put out"),
    ],
)
def test_every_stop_is_a_ramp_and_latches(bench: Bench, act, reason: str) -> None:
    bench.wave(6)
    act(bench)
    bench.steps(40)
    assert bench.owner.reason == reason
    assert bench.owner.state is OutputState.HELD
    out = bench.output
    assert np.abs(out).max() <= 2.0
    ramp = np.abs(np.diff(out[5 * BLOCK :]))
    assert ramp.max() <= 2.0 * max(2 * np.pi * 50.0 / RATE, 0.5 * np.pi / 200) + 1e-9
    assert not out[-CHUNK:].any()
    bench.stop = False
    bench.steps(5)
    assert not bench.output[-5 * CHUNK :].any(), "latched"
    bench.channel.send(bytes([OwnerMessage.RESET]))
    bench.steps(1)
    assert bench.owner.reason == ""
    assert bench.owner.state is not OutputState.HELD


def test_reset_waits_for_zero(bench: Bench) -> None:
    bench.wave(6)
    bench.channel.send(struct.pack("<Bd", OwnerMessage.QUIET, 0.02) + b"operator")
    bench.steps(2)
    assert bench.owner.state is OutputState.RAMPING
    bench.channel.send(bytes([OwnerMessage.RESET]))
    bench.steps(10)
    assert bench.owner.state is OutputState.HELD
    assert bench.owner.reason == "operator"


@pytest.mark.parametrize("act", ["byte", "end"])
def test_the_external_stop_line_stops_for_good(act: str) -> None:
    ours, line = os.pipe()
    bench = Bench(stop_input=ours)
    bench.wave(6)
    assert bench.owner.state is OutputState.FOLLOWING
    if act == "byte":
        os.write(line, b"!")
    os.close(line)
    bench.steps(10)
    assert bench.owner.reason == "the external stop input"
    bench.channel.send(bytes([OwnerMessage.RESET]))
    bench.steps(2)
    assert bench.owner.state is OutputState.HELD
    os.close(ours)
    bench.end()


def test_it_ends_when_told_to(bench: Bench) -> None:
    bench.wave(6)
    bench.channel.send(bytes([OwnerMessage.STOP]))
    bench.owner.run()
    assert bench.closed
    assert not bench.output[-1:].any()
    assert bench.reports()[-1][0] is OutputState.ENDED


def test_a_feeding_side_that_does_not_listen_costs_nothing(bench: Bench) -> None:
    """Its socket fills; the output goes on, and reports that follow say where they belong."""
    for n in range(2000):
        bench.feed(np.full(BLOCK, 1.0))
        if n >= 1:
            bench.steps(BLOCK // CHUNK)
    assert np.all(bench.output == 1.0)
    heard = bench.reports()
    assert len(heard) < 1900
    bench.feed(np.full(BLOCK, 1.0))
    bench.steps(BLOCK // CHUNK)
    (_, first, values, _), *_ = bench.reports()
    assert first + values.size > 1900 * BLOCK


def test_flood_of_random_messages_keeps_the_limit(bench: Bench) -> None:
    rng = np.random.default_rng(4)
    for _ in range(1000):
        kind = rng.integers(0, 6)
        try:
            if kind <= 1:
                bench.feed(rng.normal(0.0, 3.0, int(rng.integers(1, 300))))
            elif kind == 2:
                bench.channel.send(rng.bytes(int(rng.integers(1, 60))), socket.MSG_DONTWAIT)
            elif kind == 3:
                bench.channel.send(bytes([OwnerMessage.RESET]), socket.MSG_DONTWAIT)
            elif kind == 4:
                bench.channel.send(struct.pack("<Bd", OwnerMessage.QUIET, rng.choice([np.nan, -1.0, 1e300, 0.01])))
        except BlockingIOError:
            pass
        if not bench.owner.step():
            break
        bench.reports()
    assert np.isfinite(bench.output).all()
    assert np.abs(bench.output).max() <= 5.0
    bench.channel.close()
    bench.owner.run()
    assert bench.output[-1] == 0.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"chunk_samples": 33},
        {"lead_blocks": 0},
        {"lead_blocks": 99},
        {"deadline": 0.0},
        {"block_samples": 20_000, "chunk_samples": 200},
    ],
)
def test_settings_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(BenchError, match="output owner"):
        OwnerSettings(**{"sample_rate": RATE, "block_samples": BLOCK, "chunk_samples": CHUNK, **wrong})  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["nowhere:Converter", "nmt_plant.output_owner:Nothing", "nmt_plant.output_owner"])
def test_a_converter_that_is_none_is_named(name: str) -> None:
    with pytest.raises(BenchError, match="there is no converter"):
        load_converter(name, {})
