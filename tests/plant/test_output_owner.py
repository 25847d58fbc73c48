"""The owner of an output: what it puts out for what it is fed, chunk by chunk on a clock of the test."""

from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_core.processes.output_record import read_output
from nmt_core.vocabulary import OutputState, StopCause
from nmt_plant.converters.converter import Converter, Taken, load_converter
from nmt_plant.output_process.output_owner import (
    OutputOwner,
    OwnerMessage,
    OwnerReport,
    OwnerSettings,
    feed_message,
    quiet_message,
    read_report,
)
from nmt_plant.output_process.shared_samples import SharedSamples

RATE, BLOCK, CHUNK = 10_000.0, 200, 40
SETTINGS = OwnerSettings(RATE, BLOCK, lead_blocks=2, deadline=0.06, ramp=0.02, limit=5.0)


class TestConverter(Converter):
    """A converter that belongs to the test: it asks for turns and keeps what it is given."""

    __test__ = False

    def __init__(self, outputs: int = 1, inputs: int = 0, delay: int = 0) -> None:
        self.outputs, self.inputs, self.delay, self.chunk_samples = outputs, inputs, delay, CHUNK
        self.out: list[FloatArray] = []
        self.stop = self.closed = False

    def exchange(self, values: FloatArray) -> None:
        assert len(self.out) < 20_000, "it does not end"
        self.out.append(values.copy())

    def stop_requested(self) -> bool:
        return self.stop

    def close(self) -> None:
        self.closed = True


class Bench:
    """An owner whose converter belongs to the test."""

    def __init__(
        self, settings: OwnerSettings = SETTINGS, stop_input: int | None = None, converter: TestConverter | None = None
    ) -> None:
        self.settings = settings
        self.channel, self._theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.samples = SharedSamples(settings.outputs, settings.inputs, settings.ring_samples)
        self.converter = converter or TestConverter(settings.outputs, settings.inputs)
        self.owner = OutputOwner(settings, self._theirs, self.samples, self.converter, stop_input, os.getppid())
        self.fed = 0

    def feed(self, values: FloatArray, first: int | None = None) -> None:
        line = np.atleast_2d(values)
        at = self.fed if first is None else first
        self.samples.fed.write(at, line)
        self.channel.send(feed_message(at, line.shape[1]))
        self.fed = at + line.shape[1]

    def turns(self, count: int, taken: Taken | None = None) -> bool:
        for _ in range(count):
            values = self.owner.turn(CHUNK, taken)
            if values is None:
                return False
            self.converter.exchange(values)
        return True

    def wave(self, blocks: int) -> FloatArray:
        """Feed a sine block by block while it is put out; returns what was fed."""
        fed = []
        for n in range(blocks):
            block = 2.0 * np.cos(2 * np.pi * 50.0 * (n * BLOCK + np.arange(BLOCK)) / RATE)
            self.feed(block)
            fed.append(block)
            if n >= 1:
                self.turns(BLOCK // CHUNK)
        return np.concatenate(fed)

    @property
    def output(self) -> FloatArray:
        return np.concatenate(self.converter.out, axis=1)[0]

    def reports(self) -> list[OwnerReport]:
        found = []
        while True:
            try:
                found.append(read_report(self.channel.recv(1 << 17, socket.MSG_DONTWAIT)))
            except BlockingIOError:
                return found

    def end(self) -> None:
        self.channel.close()
        self._theirs.close()
        self.samples.close()


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
    end = bench.reports()[-1].put_out
    assert end >= 8 * BLOCK
    np.testing.assert_array_equal(bench.samples.put_out.read(0, end)[0], fed[:end])
    assert bench.owner.state is OutputState.FOLLOWING


def test_it_waits_for_its_lead(bench: Bench) -> None:
    bench.feed(np.ones(BLOCK))
    bench.turns(10)
    assert not bench.output.any()
    assert bench.owner.state is OutputState.AT_ZERO
    bench.feed(np.ones(BLOCK))
    bench.turns(1)
    assert bench.output[-CHUNK:].all()


def test_no_more_blocks_end_in_a_ramp_from_the_last_sample(bench: Bench) -> None:
    fed = bench.wave(6)
    bench.turns(20)
    np.testing.assert_array_equal(bench.output[: 6 * BLOCK], fed)
    np.testing.assert_allclose(bench.output[6 * BLOCK :][:200], ramp_from(fed[-1], 200), atol=1e-12)
    assert not bench.output[6 * BLOCK + 200 :].any()
    assert bench.owner.state is OutputState.HELD
    assert bench.owner.reason.startswith("no block was there to be put out; the feeding process is hung")


def test_the_deadline_acts_while_blocks_still_wait() -> None:
    bench = Bench(OwnerSettings(RATE, BLOCK, lead_blocks=8, deadline=0.059, ramp=0.02))
    for _ in range(8):
        bench.feed(np.full(BLOCK, 1.5))
    bench.turns(40)
    # Fed at time 0; the first chunk that begins later than 59 ms is the one at 60 ms.
    np.testing.assert_array_equal(bench.output[:600], 1.5)
    np.testing.assert_allclose(bench.output[600:800], ramp_from(1.5, 200), atol=1e-12)
    assert bench.owner.reason.startswith("not fed for 60 ms; ")
    bench.end()


def test_a_hang_with_the_drive_at_zero_trips_nothing(bench: Bench) -> None:
    for _ in range(3):
        bench.feed(np.zeros(BLOCK))
    bench.turns(100)
    assert bench.owner.state is OutputState.AT_ZERO
    for _ in range(18):  # what is fed now belongs to indices that have passed, until the feeding side has caught up
        bench.feed(np.zeros(BLOCK))
    bench.turns(1)
    assert bench.owner.state is OutputState.AT_ZERO
    fed = np.sin(2 * np.pi * 50.0 * np.arange(3 * BLOCK) / RATE)
    for n in range(3):
        bench.feed(fed[n * BLOCK :][:BLOCK])
    bench.turns(3 * BLOCK // CHUNK)
    np.testing.assert_array_equal(bench.output[21 * BLOCK :], fed[: bench.output.size - 21 * BLOCK])
    assert bench.output.size > 23 * BLOCK


def test_a_block_that_moves_after_its_time_is_not_put_out_but_stops(bench: Bench) -> None:
    for _ in range(2):
        bench.feed(np.zeros(BLOCK))
    bench.turns(3 * BLOCK // CHUNK)
    bench.feed(np.ones(BLOCK))
    bench.turns(20)
    assert not bench.output.any()
    assert bench.owner.state is OutputState.HELD
    assert bench.owner.reason.startswith("a block came 20 ms too late; ")
    assert bench.owner.cause is StopCause.OUTPUT


def test_every_sample_put_out_has_an_index_and_is_given_back(bench: Bench) -> None:
    """The ramp of an output that nobody feeds, too: whoever models the structure must see it."""
    bench.wave(6)
    bench.turns(40)
    end = bench.reports()[-1].put_out
    assert end > 6 * BLOCK + 200
    np.testing.assert_array_equal(bench.samples.put_out.read(0, end)[0], bench.output[:end])
    assert bench.output[6 * BLOCK : 6 * BLOCK + 199].all()


def test_of_an_output_nobody_asks_for_the_way_to_zero_is_kept(bench: Bench) -> None:
    bench.wave(6)
    bench.turns(2000)
    np.testing.assert_array_equal(
        bench.samples.put_out.read(3 * BLOCK, 10 * BLOCK)[0], bench.output[3 * BLOCK : 13 * BLOCK]
    )
    reports = bench.reports()
    bench.turns(10)
    reports += bench.reports()
    holes = [report.hole for report in reports if report.hole[1]]
    kept = bench.settings.ring_samples + 6 * BLOCK - 3 * BLOCK  # the feeding side is a lead and a block behind
    assert holes[0][0] == kept
    assert all(one[1] == other[0] for one, other in itertools.pairwise(holes))
    assert holes[-1][1] == reports[-1].put_out
    assert not bench.output[kept:].any()


def test_after_a_reset_nothing_fed_before_is_put_out(bench: Bench) -> None:
    for _ in range(30):
        bench.feed(np.ones(BLOCK))
    bench.turns(10)
    bench.channel.send(quiet_message("operator", 0.0))
    bench.turns(3)
    assert bench.owner.state is OutputState.HELD
    bench.channel.send(bytes([OwnerMessage.RESET]))
    at = bench.output.size
    bench.feed(np.zeros(BLOCK))
    bench.turns(40)
    assert not bench.output[at:].any()
    assert bench.owner.state is OutputState.AT_ZERO


def test_two_outputs_are_guarded_together() -> None:
    bench = Bench(OwnerSettings(RATE, BLOCK, lead_blocks=1, ramp=0.02, limit=5.0, outputs=2))
    bench.feed(np.stack([np.full(BLOCK, 1.0), np.full(BLOCK, -2.0)]))
    bench.turns(5)
    np.testing.assert_array_equal(np.concatenate(bench.converter.out, axis=1)[:, :BLOCK].T, [[1.0, -2.0]] * BLOCK)
    bench.feed(np.stack([np.full(BLOCK, 1.0), np.full(BLOCK, 6.0)]))
    bench.turns(10)
    both = np.concatenate(bench.converter.out, axis=1)[:, BLOCK:]
    np.testing.assert_allclose(both[1, :200], ramp_from(-2.0, 200), atol=1e-12)
    assert not both[:, -CHUNK:].any(), "the other one goes to zero with it"
    assert bench.owner.reason == "a sample of 6 V is beyond the limit of 5.0 V"
    bench.end()


def measured(first: int, count: int) -> FloatArray:
    """Samples of two inputs that tell their own index."""
    index = np.arange(first, first + count, dtype=float)
    return np.stack([index, -index])


def test_what_is_measured_comes_with_its_index_and_losses_are_marked() -> None:
    settings = OwnerSettings(RATE, BLOCK, lead_blocks=2, ramp=0.02, inputs=2)
    bench = Bench(settings, converter=TestConverter(inputs=2, delay=60))
    bench.turns(3, Taken(np.full((2, CHUNK), 99.0)))  # before the clock has begun: thrown away
    bench.feed(np.zeros(BLOCK))
    bench.feed(np.zeros(BLOCK))
    bench.turns(1, Taken(np.full((2, CHUNK), 99.0)))
    for n in range(10):
        bench.feed(np.zeros(BLOCK))
        bench.owner.turn(CHUNK, Taken(measured(n * 50, 50), lost=n == 4))
    reports = bench.reports()
    assert reports[-1].taken > 400
    assert reports[-1].delay == 60
    np.testing.assert_array_equal(bench.samples.measured.read(0, 200), measured(0, 200))
    np.testing.assert_array_equal(bench.samples.measured.read(350, 150), measured(350, 150))
    lost = [report.lost for report in reports if report.lost[1]]
    assert (lost[0][0], lost[-1][1]) == (200, 350), (
        "and as long as what was put out before is on its way, in whole turns"
    )
    assert reports[-1].lost_turns == 1
    bench.end()


def test_the_channels_of_converter_and_device_must_agree() -> None:
    samples = SharedSamples(1, 0, SETTINGS.ring_samples)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs, pytest.raises(BenchError, match="has 1 outputs and 2 inputs, the device wants 1 and 0"):
        OutputOwner(SETTINGS, theirs, samples, TestConverter(inputs=2))
    samples.close()


def test_a_converter_that_fails_leaves_an_unknown_state(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.wave(6)
    monkeypatch.setattr(bench.converter, "exchange", lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        bench.owner.run()
    assert bench.converter.closed
    last = bench.reports()[-1]
    assert last.state is OutputState.NOT_KNOWN
    assert last.reason == "the converter failed: division by zero"


def test_the_record_tells_every_change_by_its_sample(tmp_path: Path) -> None:
    path = tmp_path / "output.jsonl"
    bench = Bench(OwnerSettings(RATE, BLOCK, lead_blocks=2, ramp=0.02, record=str(path)))
    bench.turns(1)
    bench.wave(6)
    bench.turns(40)
    bench.channel.close()
    bench.owner.run()
    bench.end()
    lines = read_output(path)
    assert [line.state for line in lines] == ["AT_ZERO", "FOLLOWING", "RAMPING", "HELD", "ENDED"]
    ramping, held = lines[2:4]
    assert ramping.reason.startswith("no block was there to be put out; ")
    assert 6 * BLOCK < ramping.sample <= 6 * BLOCK + CHUNK
    assert ramping.fed_at == 4 * BLOCK, "where the sixth block was fed"
    assert held.sample == 6 * BLOCK + 200
    assert {line.pid for line in lines} == {os.getpid()}


def test_the_end_of_the_feeding_process_ends_the_owner_at_zero(bench: Bench) -> None:
    fed = bench.wave(6)
    bench.channel.close()
    bench.owner.run()
    assert bench.converter.closed
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
        (lambda b: b.feed(np.ones(BLOCK), first=9900), "samples from 9900 on were fed after those to 1200"),
        (lambda b: b.channel.send(quiet_message("operator")), "operator"),
        (lambda b: b.channel.send(b"\xff\x00nonsense"), "a message that is none was fed"),
        (lambda b: setattr(b.converter, "stop", True), "the external stop input"),
        (lambda b: b.feed(np.full(BLOCK, np.nan)), "a sample of nan V is beyond the limit of 5.0 V"),
        (lambda b: b.feed(np.full(BLOCK, 5.1)), "a sample of 5.1 V is beyond the limit of 5.0 V"),
        (lambda b: [b.feed(np.ones(BLOCK)) for _ in range(120)], "blocks are fed faster than they can be put out"),
    ],
)
def test_every_stop_is_a_ramp_and_latches(bench: Bench, act, reason: str) -> None:
    bench.wave(6)
    act(bench)
    bench.turns(40)
    assert bench.owner.reason == reason
    assert bench.owner.state is OutputState.HELD
    out = bench.output
    assert np.abs(out).max() <= 2.0
    ramp = np.abs(np.diff(out[5 * BLOCK :]))
    assert ramp.max() <= 2.0 * max(2 * np.pi * 50.0 / RATE, 0.5 * np.pi / 200) + 1e-9
    assert not out[-CHUNK:].any()
    bench.converter.stop = False
    bench.turns(5)
    assert not bench.output[-5 * CHUNK :].any(), "latched"
    bench.channel.send(bytes([OwnerMessage.RESET]))
    bench.turns(1)
    assert bench.owner.reason == ""
    assert bench.owner.state is not OutputState.HELD


def test_reset_waits_for_zero(bench: Bench) -> None:
    bench.wave(6)
    bench.channel.send(quiet_message("operator", 0.02))
    bench.turns(2)
    assert bench.owner.state is OutputState.RAMPING
    bench.channel.send(bytes([OwnerMessage.RESET]))
    bench.turns(10)
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
    bench.turns(10)
    assert bench.owner.reason == "the external stop input"
    bench.channel.send(bytes([OwnerMessage.RESET]))
    bench.turns(2)
    assert bench.owner.state is OutputState.HELD
    os.close(ours)
    bench.end()


def test_it_ends_when_told_to(bench: Bench) -> None:
    bench.wave(6)
    bench.channel.send(bytes([OwnerMessage.STOP]))
    bench.owner.run()
    assert bench.converter.closed
    assert not bench.output[-1:].any()
    assert bench.reports()[-1][0] is OutputState.ENDED


def test_a_feeding_side_that_does_not_listen_costs_nothing(bench: Bench) -> None:
    """Its socket fills; the output goes on, and reports that follow say where they belong."""
    for n in range(2000):
        bench.feed(np.full(BLOCK, 1.0))
        if n >= 1:
            bench.turns(BLOCK // CHUNK)
    assert np.all(bench.output == 1.0)
    heard = bench.reports()
    assert len(heard) < 1900
    bench.feed(np.full(BLOCK, 1.0))
    bench.turns(BLOCK // CHUNK)
    assert bench.reports()[-1].put_out == 2000 * BLOCK


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
                bench.channel.send(quiet_message("", float(rng.choice([np.nan, -1.0, 1e300, 0.01]))))
        except BlockingIOError:
            pass
        if not bench.turns(1):
            break
        bench.reports()
    assert np.isfinite(bench.output).all()
    assert np.abs(bench.output).max() <= 5.0
    bench.channel.close()
    bench.owner.run()
    assert bench.output[-1] == 0.0


@pytest.mark.parametrize(
    "wrong", [{"block_samples": 0}, {"lead_blocks": 0}, {"lead_blocks": 999}, {"deadline": 0.0}, {"outputs": 0}]
)
def test_settings_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(BenchError, match="output owner"):
        OwnerSettings(**{"sample_rate": RATE, "block_samples": BLOCK, **wrong})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "name", ["nowhere:Converter", "nmt_plant.converters.converter:Nothing", "nmt_plant.converters.converter"]
)
def test_a_converter_that_is_none_is_named(name: str) -> None:
    with pytest.raises(BenchError, match="there is no converter"):
        load_converter(name, {})


class ForgetfulLoop(TestConverter):
    """A loop whose input forgets turns, and says nothing."""

    def __init__(self, delay: int, forgotten: set[int]) -> None:
        super().__init__(inputs=1)
        self._line, self._forgotten = np.zeros((1, delay)), forgotten

    def measure(self, turn: int, values: FloatArray) -> Taken | None:
        line = np.concatenate([self._line, values], axis=1)
        self._line = line[:, CHUNK:]
        return None if turn in self._forgotten else Taken(line[:, :CHUNK])


def delay_found(forgotten: set[int]) -> OwnerReport:
    converter = ForgetfulLoop(120, forgotten)
    bench = Bench(replace(SETTINGS, inputs=1, probe=0.1, probe_settling=0.05), converter=converter)
    taken = None
    try:
        for turn in range(4000):
            values = bench.owner.turn(CHUNK, taken)
            assert values is not None
            taken = converter.measure(turn, values)
            if reports := bench.reports():
                return reports[0]
    finally:
        bench.end()
    raise AssertionError("the owner says nothing")


def test_a_delay_that_changed_while_it_was_looked_for_is_looked_for_again() -> None:
    report = delay_found({60})
    assert report.delay == 120
    assert report.monitor_gain == pytest.approx(1.0)
    with pytest.raises(RuntimeError, match="loses samples again and again"):
        delay_found(set(range(60, 4000, 100)))
