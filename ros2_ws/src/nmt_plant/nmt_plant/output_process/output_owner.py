"""The process that owns a converter: it puts out what it is fed, and goes to zero by itself when it is not.

The process that makes the samples (the plant node) can hang in a driver, be stopped, hold its interpreter in one call
or die. The owner shares nothing with it but memory for samples and a socket: what is late, missing or out of sequence,
an end of the socket, a stop request or the external stop input take the output to zero along a half-cosine, latched
until ``reset``. Samples pass the same guard as in the device once more.

The converter's samples are the clock. It begins when ``lead_blocks`` have been fed; from then on every sample that the
converter takes has the next index, fed or not, and what was put out with it is given back. A side that feeds and is
late finds that its samples' time has passed: zeros were put out in their place.

What it cannot do: if the owner itself is killed or stopped, the converter keeps what its hardware does without it. The
feeding side says then that the state of the output is unknown (see `output_link`).

    python -m nmt_plant.output_process.output_owner SOCKET MEMORY SETTINGS CONVERTER ARGUMENTS [STOP_DESCRIPTOR]

is how `output_link.OutputLink` starts it. No named shared memory; the only file is the record, where one is asked for.
"""

from __future__ import annotations

import contextlib
import gc
import json
import math
import os
import select
import signal
import socket
import struct
import sys
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_core.processes.output_record import BEAT as RECORD_BEAT
from nmt_core.processes.output_record import OutputRecord
from nmt_core.processes.steady_clock import STEADY_CLOCK, SteadyClock
from nmt_core.vocabulary import OutputState, StopCause
from nmt_plant.converters.converter import Converter, Taken, load_converter
from nmt_plant.converters.delay_probe import Delay, DelayProbe
from nmt_plant.output_process.shared_samples import SharedSamples
from nmt_plant.safety.output_guard import OutputGuard, all_to_zero, guard_together

MESSAGE_BYTES = 4096
_MOST_LEAD = 128
_MOST_MESSAGES = 200  # taken in one turn
_BEAT = 0.05  # s, longest time between two reports
_PRIORITY = 10  # of a real-time process, where the system allows one
_HINT = "the feeding process is hung, or the computer too busy for so few blocks of latency"
_FEED = struct.Struct("<BQQ")
_QUIET = struct.Struct("<Bd")
_REPORT = struct.Struct("<BB6QdQ?qQddQ")


class OwnerMessage(IntEnum):
    """First byte of a message to the owner."""

    FEED = 1
    QUIET = 2
    RESET = 3
    STOP = 4


@dataclass(frozen=True)
class OwnerSettings:
    """How an output is owned.

    Attributes:
        sample_rate: Hz.
        block_samples: samples in a block.
        lead_blocks: blocks that are fed before the first is put out; what may be late.
        deadline: s of samples put out without a new block, after which the output goes to zero.
        ramp: s, half-cosine to zero.
        limit: V, largest magnitude; None = none.
        slew: V/s, largest rate of change; None = none.
        outputs: channels that are put out; what takes one to zero takes all, along one half-cosine.
        inputs: channels that are measured.
        record: file for what the output does, see `nmt_core.processes.output_record`; empty = none.
        probe: V, amplitude of the signal that finds the delay before the first block, at the first output; 0 = the
            converter's own figure.
        probe_input: row of the inputs that measures the output.
        probe_settling: s of zeros before that signal.
        probe_needed: whether an output that is not seen at that input is a fault; else the converter's figure is taken.

    Raises:
        BenchError: a number out of its range.
    """

    sample_rate: float
    block_samples: int
    lead_blocks: int = 2
    deadline: float = 0.06
    ramp: float = 0.1
    limit: float | None = None
    slew: float | None = None
    outputs: int = 1
    inputs: int = 0
    record: str = ""
    probe: float = 0.0
    probe_input: int = 0
    probe_settling: float = 0.2
    probe_needed: bool = True

    def __post_init__(self) -> None:
        if self.block_samples < 1:
            raise BenchError(f"output owner: block_samples must be at least 1, got {self.block_samples}.")
        if not 1 <= self.lead_blocks <= _MOST_LEAD or not 0.0 < self.deadline < 60.0:
            raise BenchError(
                f"output owner: lead_blocks must be 1 to {_MOST_LEAD} and deadline positive and below 60 s, got "
                f"{self.lead_blocks} and {self.deadline} s."
            )
        if self.outputs < 1 or self.inputs < 0:
            raise BenchError(f"output owner: it needs an output, got {self.outputs} and {self.inputs} inputs.")
        if not 0.0 <= self.probe < math.inf or (self.probe and not 0 <= self.probe_input < self.inputs):
            raise BenchError(
                f"output owner: a probe of {self.probe} V at input {self.probe_input} of {self.inputs} is not possible."
            )

    @property
    def ring_samples(self) -> int:
        """Samples of history: enough for the whole way to zero of an output that is not fed any more."""
        blocks = math.ceil((2.0 * (self.deadline + self.ramp) + 1.0) * self.sample_rate / self.block_samples)
        return self.block_samples * (blocks + 4 * self.lead_blocks)


class OwnerReport(NamedTuple):
    """What the owner says, once a block and at every change.

    Attributes:
        state: of the output.
        cause: EXTERNAL_INPUT or OUTPUT where the owner took the output to zero of itself; else UNKNOWN.
        put_out: index after the last sample put out.
        taken: index after the last sample measured.
        hole: indices (first, end) of samples put out of which no history was kept: zeros at rest.
        lost: indices (first, end) of samples measured that were lost or may be.
        time: s on the steady clock, when ``put_out`` was reached.
        delay: of the converter, samples: measured where a probe was asked for, else the converter's own figure.
        stop_is_set: whether the external stop input asks for zero now.
        stated: round trip as the converter's driver says it, samples; negative = it says nothing.
        lost_turns: turns of the converter in which samples were lost, since the clock began.
        monitor_gain: V measured per V put out, from the probe; 0 = not measured or not seen.
        clearness: of the probe, see `delay_probe.Delay`.
        turn: samples of the converter's last turn; delay + turn is the round trip.
        reason: why the output was taken to zero.
    """

    state: OutputState
    cause: StopCause
    put_out: int
    taken: int
    hole: tuple[int, int]
    lost: tuple[int, int]
    time: float
    delay: int
    stop_is_set: bool
    stated: int
    lost_turns: int
    monitor_gain: float
    clearness: float
    turn: int
    reason: str


class OutputOwner:
    """The owner's work, turn by turn; `run` leaves it to the converter to ask for the turns.

    Args:
        settings: how the output is owned.
        channel: socket (SOCK_SEQPACKET) to the side that feeds.
        samples: the shared memory.
        converter: what puts the samples out.
        stop_input: descriptor of an external stop line: a byte on it, or its end, stops for good; None = none.
        parent: process that feeds; its end is seen even where a copy of its socket lives on. None = not watched.
        clock: only for the time of reports and how often they are sent.
    """

    def __init__(
        self,
        settings: OwnerSettings,
        channel: socket.socket,
        samples: SharedSamples,
        converter: Converter,
        stop_input: int | None = None,
        parent: int | None = None,
        clock: SteadyClock = STEADY_CLOCK,
    ) -> None:
        if (converter.outputs, converter.inputs) != (settings.outputs, settings.inputs):
            raise BenchError(
                f"output owner: the converter has {converter.outputs} outputs and {converter.inputs} inputs, the "
                f"device wants {settings.outputs} and {settings.inputs}."
            )
        self._settings = settings
        self._channel = channel
        self._samples = samples
        self._converter = converter
        self._stop_input = stop_input
        self._parent = parent
        self._clock = clock
        self._record = OutputRecord(settings.record) if settings.record else None
        self._guards = [
            OutputGuard(settings.sample_rate, settings.limit, settings.slew, settings.ramp)
            for _ in range(settings.outputs)
        ]
        self._deadline = settings.deadline * settings.sample_rate
        self._probe: DelayProbe | None = None
        if settings.probe:
            self._probe = DelayProbe(settings.probe, settings.sample_rate, settings.probe_settling)
        self._delay: Delay | None = None
        self._lost_turns = self._turn_samples = 0
        self._begun = False
        self._fed = self._next = self._taken = 0
        self._in_step = 0  # what is measured from this index on belongs to what was put out
        self._void = 0  # what was fed before this index is not put out any more
        self._since_feed = 0
        self._moving = False
        self._hole = self._lost = (0, 0)
        self._reported: tuple[OutputState, bool, int, int] | None = None
        self._reported_at = self._touched_at = -math.inf
        self._recorded: tuple[OutputState, str] | None = None
        self._ending = self._reported_to_end = self._stopped = self._stop_is_set = False
        self.cause = StopCause.UNKNOWN
        self.reason = ""

    @property
    def state(self) -> OutputState:
        """What the output does."""
        if self._guards[0].held:
            return OutputState.RAMPING if self._on else OutputState.HELD
        return OutputState.FOLLOWING if self._moving else OutputState.AT_ZERO

    @property
    def _on(self) -> bool:
        """Whether the sample put out last was not zero."""
        return any(guard.last != 0.0 for guard in self._guards)

    def run(self) -> None:
        """Work until the side that feeds has ended or asks for the end, and the output is at zero."""
        try:
            self._converter.run(self.turn)
            if not self._ending:
                raise RuntimeError("it ended by itself")
        except Exception as error:
            self.reason = f"the converter failed: {error}"
            self._report(OutputState.NOT_KNOWN)
            raise
        finally:
            self._converter.close()
            if self._record is not None:
                self._record.close()

    def turn(self, samples: int, taken: Taken | None = None) -> FloatArray | None:
        """One turn of the converter: messages, checks, what to put out, report.

        Args:
            samples: how many the converter wants.
            taken: what it has measured since the turn before.

        Returns:
            (outputs, samples) V; None when the output is at zero for good.
        """
        self._turn_samples = samples
        if self._probe is not None:
            self._look_for_delay(self._probe, taken)
        self._keep(taken)
        self._take_messages()
        self._watch()
        if self._ending and self.state is OutputState.HELD:
            self._report(OutputState.ENDED)
            return None
        values = self._next_samples(samples)
        self._moving = bool(values.any())
        self._report(self.state)
        return values

    def _look_for_delay(self, probe: DelayProbe, taken: Taken | None) -> None:
        if taken is not None:
            probe.take(taken.values[self._settings.probe_input], taken.lost)
        if probe.failed:
            self._probe = None
            raise RuntimeError(
                "it loses samples again and again, or its output and inputs do not share one clock; give it a larger "
                "block, or real-time priority, or one clock"
            )
        if not probe.done:
            return
        found = self._delay = probe.delay()
        if found.is_seen and not found.is_clear:  # samples were lost without a report
            self._delay = None
            probe.restart()
            return
        self._probe = None
        if found.is_clear:
            return
        self._delay = found._replace(samples=max(self._converter.delay, 0), gain=0.0)
        if self._settings.probe_needed:
            raise RuntimeError(
                f"the output of {self._settings.probe:.3g} V is not seen at the drive's monitor input; check cables, "
                "ports and the monitor's sensitivity, './nmt check' looks at every channel"
            )

    @property
    def _delay_samples(self) -> int:
        return max(self._converter.delay, 0) if self._delay is None else self._delay.samples

    def terminate(self) -> None:
        """Take the output to zero and end, as when the feeding side ends; may be called by a signal's handler."""
        self._reported_to_end = True

    def _to_zero(self, reason: str, ramp: float | None = None, cause: StopCause = StopCause.OUTPUT) -> None:
        if not self.reason:
            self.reason, self.cause = reason, cause
        all_to_zero(self._guards, ramp)

    # -- what comes in -------------------------------------------------------------------------------------------

    def _take_messages(self) -> None:
        for _ in range(_MOST_MESSAGES):
            try:
                message = self._channel.recv(MESSAGE_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            except OSError:
                message = b""
            if not message:
                self._end("the process that fed the output has ended")
                return
            self._take(message)

    def _end(self, reason: str) -> None:
        if not self._ending:
            self._ending = True
            self._to_zero(reason)

    def _take(self, message: bytes) -> None:
        kind = message[0]
        if kind == OwnerMessage.FEED and len(message) == _FEED.size:
            self._take_feed(*_FEED.unpack(message)[1:])
        elif kind == OwnerMessage.QUIET and len(message) >= _QUIET.size:
            _, ramp = _QUIET.unpack_from(message)
            reason = message[_QUIET.size :].decode(errors="replace") or "quiet"
            self._to_zero(reason, ramp if 0.0 <= ramp < 1e6 else None, StopCause.UNKNOWN)
        elif kind == OwnerMessage.RESET and len(message) == 1:
            if self.state is OutputState.HELD and not self._stopped and not self._ending:
                for guard in self._guards:
                    guard.release()
                self._void, self._since_feed = self._fed, 0
                self.reason, self.cause = "", StopCause.UNKNOWN
        elif kind == OwnerMessage.STOP and len(message) == 1:
            self._end("the output is closed")
        else:
            self._to_zero("a message that is none was fed")

    def _take_feed(self, first: int, count: int) -> None:
        settings = self._settings
        if first != self._fed:
            self._to_zero(f"samples from {first} on were fed after those to {self._fed}")
            return
        if not 0 < count <= settings.ring_samples or first + count - self._next > settings.ring_samples:
            self._to_zero("blocks are fed faster than they can be put out")
            return
        self._fed = first + count
        self._since_feed = 0
        late = min(self._fed, self._next) - max(first, self._void)
        if late > 0 and self._samples.fed.read(max(first, self._void), late).any():
            milliseconds = 1e3 * (self._next - first) / settings.sample_rate
            self._to_zero(f"a block came {milliseconds:.0f} ms too late; {_HINT}")
        if not self._begun and self._fed >= settings.lead_blocks * settings.block_samples:
            self._begun = True

    def _watch(self) -> None:
        """External stop, deadline, and whether the process that feeds is still there."""
        if self._reported_to_end:
            self._end("the process that owns the output was told to end")
        if self._parent is not None and os.getppid() != self._parent:
            self._end("the process that fed the output has ended")
        if self._stop_input is not None and not self._stopped:
            self._stopped = bool(select.select([self._stop_input], [], [], 0.0)[0])
        self._stop_is_set = self._stopped or self._converter.stop_requested()
        if self._stop_is_set:
            self._to_zero("the external stop input", cause=StopCause.EXTERNAL_INPUT)
        if self._since_feed > self._deadline and self._on:
            self._to_zero(f"not fed for {1e3 * self._since_feed / self._settings.sample_rate:.0f} ms; {_HINT}")

    def _keep(self, taken: Taken | None) -> None:
        """Hand on what was measured; what comes before the clock has begun is thrown away."""
        if taken is None or not self._begun:
            return
        count = taken.values.shape[1]
        end = self._taken + count
        self._lost_turns += taken.lost
        if taken.lost:  # what is still on its way was not put out in step with what comes
            self._in_step = end + self._delay_samples
        if self._taken < self._in_step or end - self._needed > self._settings.ring_samples:
            self._lost = _together(self._lost, (self._taken, end))
        else:
            self._samples.measured.write(self._taken, taken.values)
        self._taken = end

    @property
    def _needed(self) -> int:
        """First index of which the feeding side may still want to know."""
        return self._fed - (self._settings.lead_blocks + 1) * self._settings.block_samples

    # -- what goes out -------------------------------------------------------------------------------------------

    def _next_samples(self, count: int) -> FloatArray:
        """The samples to put out next: what was fed for their indices, zero where nothing was."""
        wanted = np.zeros((self._settings.outputs, count))
        if self._probe is not None and not self._ending:
            wanted[0] = self._probe.next(count)
        if not self._begun:
            return self._guarded(wanted)
        first = self._next
        fed = min(max(self._fed - first, 0), count)
        if fed:
            wanted[:, :fed] = self._samples.fed.read(first, fed)
            wanted[:, : max(min(self._void - first, fed), 0)] = 0.0
        if fed == count:
            values = self._guarded(wanted)
        else:
            head = self._guarded(wanted[:, :fed])
            if self._on:
                self._to_zero(f"no block was there to be put out; {_HINT}")
            values = np.concatenate([head, self._guarded(wanted[:, fed:])], axis=1)
        end = first + count
        if end - self._needed > self._settings.ring_samples:
            self._hole = _together(self._hole, (first, end))
        else:
            self._samples.put_out.write(first, values)
        self._next = end
        self._since_feed += count
        return values

    def _guarded(self, wanted: FloatArray) -> FloatArray:
        values = np.stack(guard_together(self._guards, list(wanted)))
        violation = next((guard.violation for guard in self._guards if guard.violation is not None), None)
        if violation is not None:
            self._to_zero(f"a sample of {violation[1]:.4g} V is beyond the limit of {self._settings.limit} V")
        return values

    def _report(self, state: OutputState) -> None:
        """Tell the feeding side; one that does not listen costs nothing. Write the record where something changed."""
        now = self._clock.now()
        if self._probe is not None and state is not OutputState.NOT_KNOWN and not self._ending:
            return  # the feeding side waits until the delay is known
        if self._record is not None:
            self._write_record(self._record, state, now)
        block = self._settings.block_samples
        told = (state, self._stop_is_set, self._next // block, (self._taken - self._delay_samples) // block)
        if told == self._reported and now - self._reported_at < _BEAT:
            return
        ranges = (*self._hole, *self._lost)
        head = _REPORT.pack(
            state,
            self.cause,
            self._next,
            self._taken,
            *ranges,
            now,
            self._delay_samples,
            self._stop_is_set,
            self._converter.stated,
            self._lost_turns,
            0.0 if self._delay is None else self._delay.gain,
            0.0 if self._delay is None else self._delay.clearness,
            self._turn_samples,
        )
        try:
            self._channel.send(head + self.reason.encode()[:500], socket.MSG_DONTWAIT)
        except OSError:
            return
        self._hole = self._lost = (0, 0)
        self._reported, self._reported_at = told, now

    def _write_record(self, record: OutputRecord, state: OutputState, now: float) -> None:
        with contextlib.suppress(OSError):  # a full disk must not stop the output
            if self._recorded != (state, self.reason):
                self._recorded = (state, self.reason)
                record.write(self._next, state, self._next - self._since_feed, self.reason)
            elif now - self._touched_at >= RECORD_BEAT:
                self._touched_at = now
                record.touch()


def _together(one: tuple[int, int], other: tuple[int, int]) -> tuple[int, int]:
    """The range (first, end) that holds both; (0, 0) is empty."""
    return other if one == (0, 0) else (min(one[0], other[0]), max(one[1], other[1]))


def feed_message(first: int, count: int) -> bytes:
    """The message that samples ``first`` to ``first + count`` are there."""
    return _FEED.pack(OwnerMessage.FEED, first, count)


def quiet_message(reason: str, ramp: float | None = None) -> bytes:
    """The message that takes the output to zero within ``ramp`` s; the owner's own when None."""
    return _QUIET.pack(OwnerMessage.QUIET, -1.0 if ramp is None else ramp) + reason.encode()[:500]


def read_report(message: bytes) -> OwnerReport:
    """A report of the owner."""
    state, cause, put_out, taken, *rest = _REPORT.unpack_from(message)
    ranges, (at, delay, stop_is_set, stated, lost_turns, gain, clearness, turn) = rest[:4], rest[4:]
    reason = message[_REPORT.size :].decode(errors="replace")
    hole, lost = (ranges[0], ranges[1]), (ranges[2], ranges[3])
    return OwnerReport(
        OutputState(state),
        StopCause(cause),
        put_out,
        taken,
        hole,
        lost,
        at,
        delay,
        stop_is_set,
        stated,
        lost_turns,
        gain,
        clearness,
        turn,
        reason,
    )


def main(arguments: list[str] | None = None) -> int:
    """Own a converter until the side that feeds ends."""
    given = sys.argv[1:] if arguments is None else arguments
    descriptor, memory, options, name, converter_options = given[:5]
    parent = os.getppid()
    channel = socket.socket(fileno=int(descriptor))
    settings = OwnerSettings(**json.loads(options))
    samples = SharedSamples(settings.outputs, settings.inputs, settings.ring_samples, int(memory))
    owners: list[OutputOwner] = []
    # A terminal's signals reach the feeding side, which ends in order; its end is seen here.
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: owners[0].terminate() if owners else sys.exit(1))
    with contextlib.suppress(OSError):
        os.nice(-10)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    # After the priority, which the threads of its driver inherit.
    converter = load_converter(name, json.loads(converter_options))
    stop_input = int(given[5]) if len(given) > 5 else None
    owner = OutputOwner(settings, channel, samples, converter, stop_input, parent)
    owners.append(owner)
    gc.collect()
    gc.freeze()
    gc.disable()
    owner.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
