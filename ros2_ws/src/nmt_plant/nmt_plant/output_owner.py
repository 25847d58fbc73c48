"""The process that owns a converter: it puts out what it is fed, and goes to zero by itself when it is not.

The process that makes the samples (the plant node) can hang in a driver, be stopped, hold its interpreter in one call
or die. The owner shares nothing with it but a socket: every block comes with a sequence number, and a block that is
late, missing or out of sequence, an end of the socket, a stop request or the external stop input take the output to
zero along a half-cosine, latched until ``reset``. Samples pass the same guard as in the device once more.

What it cannot do: if the owner itself is killed or stopped, the converter keeps what its hardware does without it. The
feeding side says then that the state of the output is unknown (see `output_link`).

    python -m nmt_plant.output_owner DESCRIPTOR SETTINGS CONVERTER ARGUMENTS [STOP_DESCRIPTOR]

is how `output_link.OutputLink` starts it. No named shared memory, no files: nothing is left behind by any end.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import select
import signal
import socket
import struct
import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from nmt_core.blocks import FloatArray
from nmt_core.errors import BenchError
from nmt_plant.output_guard import OutputGuard

MESSAGE_BYTES = 1 << 17
_MOST_QUEUED_BLOCKS = 64
_BEAT = 0.05  # s, longest time between two reports
_RESYNCHRONISE = 0.5  # s a clock may be behind before it starts anew


class OwnerMessage(IntEnum):
    """First byte of a message to the owner."""

    FEED = 1
    QUIET = 2
    RESET = 3
    STOP = 4


class OutputState(IntEnum):
    """What is known of an output."""

    NOT_KNOWN = 0
    AT_ZERO = 1
    FOLLOWING = 2
    RAMPING = 3
    HELD = 4
    ENDED = 5


@dataclass(frozen=True)
class OwnerSettings:
    """How an output is owned.

    Attributes:
        sample_rate: Hz.
        block_samples: samples in a block.
        chunk_samples: samples handed to the converter at a time; the owner looks at everything once a chunk.
        lead_blocks: blocks that are fed before the first is put out; what may be late.
        deadline: s without a block after which the output goes to zero.
        ramp: s, half-cosine to zero.
        limit: V, largest magnitude; None = none.
        slew: V/s, largest rate of change; None = none.

    Raises:
        BenchError: a number out of its range.
    """

    sample_rate: float
    block_samples: int
    chunk_samples: int
    lead_blocks: int = 2
    deadline: float = 0.06
    ramp: float = 0.1
    limit: float | None = None
    slew: float | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.chunk_samples <= self.block_samples or self.block_samples % self.chunk_samples:
            raise BenchError(
                f"output owner: chunk_samples must divide block_samples ({self.block_samples}), got "
                f"{self.chunk_samples}."
            )
        if 8 * self.block_samples > MESSAGE_BYTES - 64:
            raise BenchError(f"output owner: a block of {self.block_samples} samples does not fit into one message.")
        if not 1 <= self.lead_blocks <= _MOST_QUEUED_BLOCKS // 2 or not self.deadline > 0.0:
            raise BenchError(
                f"output owner: lead_blocks must be 1 to {_MOST_QUEUED_BLOCKS // 2} and deadline positive, got "
                f"{self.lead_blocks} and {self.deadline} s."
            )


class Converter(Protocol):
    """What puts samples out. ``write`` waits until the device takes the samples, which paces the owner."""

    def write(self, values: FloatArray) -> None:
        """Put out the next samples, V."""

    def stop_requested(self) -> bool:
        """Whether the device's external stop input asks for zero."""

    def close(self) -> None:
        """Release the device, its output at zero."""


class SteadyClockConverter:
    """Takes samples when they are due on the steady clock; stands for a converter where there is none.

    Args:
        sample_rate: Hz.
        log: file for the time and the values of every call, see `read_log`; empty = none.
        stop_file: path whose existence is the external stop input; empty = none.
    """

    def __init__(self, sample_rate: float, log: str = "", stop_file: str = "") -> None:
        self._rate = sample_rate
        self._log = Path(log).open("wb", buffering=0) if log else None  # noqa: SIM115 - open as long as the output
        self._stop_file = stop_file
        self._due = time.monotonic()

    def write(self, values: FloatArray) -> None:
        """Wait until the samples are due."""
        self._due = max(self._due, time.monotonic() - _RESYNCHRONISE) + values.size / self._rate
        time.sleep(max(0.0, self._due - time.monotonic()))
        if self._log is not None:
            self._log.write(struct.pack("<dq", time.monotonic(), values.size) + values.tobytes())

    def stop_requested(self) -> bool:
        """Whether the stop file exists."""
        return bool(self._stop_file) and os.path.exists(self._stop_file)

    def close(self) -> None:
        """Close the log."""
        if self._log is not None:
            self._log.close()


def read_log(path: str | Path) -> list[tuple[float, FloatArray]]:
    """Calls of a `SteadyClockConverter`: end of each on the steady clock (s), and its values (V)."""
    raw, position, calls = Path(path).read_bytes(), 0, []
    while position + 16 <= len(raw):
        at, size = struct.unpack_from("<dq", raw, position)
        if position + 16 + 8 * size > len(raw):
            break
        calls.append((at, np.frombuffer(raw, np.float64, size, position + 16)))
        position += 16 + 8 * size
    return calls


class OutputOwner:
    """The owner's work, chunk by chunk; `run` repeats it until the end.

    Args:
        settings: how the output is owned.
        channel: socket (SOCK_SEQPACKET) to the side that feeds.
        converter: what puts the samples out.
        stop_input: descriptor of an external stop line: a byte on it, or its end, stops for good; None = none.
        clock: steady clock, s.
        parent: process that feeds; its end is seen even where a copy of its socket lives on. None = not watched.
    """

    def __init__(
        self,
        settings: OwnerSettings,
        channel: socket.socket,
        converter: Converter,
        stop_input: int | None = None,
        clock: Callable[[], float] = time.monotonic,
        parent: int | None = None,
    ) -> None:
        self._settings = settings
        self._channel = channel
        self._converter = converter
        self._stop_input = stop_input
        self._clock = clock
        self._parent = parent
        self._guard = OutputGuard(settings.sample_rate, settings.limit, settings.slew, settings.ramp)
        self._queue: deque[FloatArray] = deque()
        self._queued = 0
        self._sequence = -1
        self._fed_at = clock()
        self._reported_at = -1.0
        self._reported_state = OutputState.NOT_KNOWN
        self._echo: list[FloatArray] = []
        self._echoed = 0
        self._consumed = 0
        self._playing = False
        self._ending = False
        self._stopped = False
        self.reason = ""

    @property
    def state(self) -> OutputState:
        """What the output does."""
        if self._guard.held:
            return OutputState.HELD if self._guard.last == 0.0 else OutputState.RAMPING
        return OutputState.FOLLOWING if self._playing else OutputState.AT_ZERO

    def run(self) -> None:
        """Work until the side that feeds has ended or asks for the end, and the output is at zero."""
        try:
            while self.step():
                pass
        finally:
            self._converter.close()

    def step(self) -> bool:
        """One chunk: messages, checks, output, report. False when the output is at zero for good."""
        self._take_messages()
        self._watch()
        fed = self._guard.block(self._next_samples())
        missing = self._settings.chunk_samples - fed.size
        if missing and self._guard.last != 0.0:
            self._to_zero("no block was there to be put out")
        values = np.concatenate([fed, self._guard.block(np.zeros(missing))]) if missing else fed
        if self._guard.violation is not None and not self.reason:
            self.reason = (
                f"a sample of {self._guard.violation[1]:.4g} V is beyond the limit of {self._settings.limit} V"
            )
        self._converter.write(values)
        over = self._ending and self.state is OutputState.HELD
        self._report(fed, OutputState.ENDED if over else self.state)
        return not over

    def terminate(self) -> None:
        """Take the output to zero and end, as when the feeding side ends."""
        self._ending = True
        self._to_zero("the process that owns the output was told to end")

    def _to_zero(self, reason: str, ramp: float | None = None) -> None:
        if not self.reason:
            self.reason = reason
        self._guard.to_zero(ramp)

    def _take_messages(self) -> None:
        for _ in range(2 * _MOST_QUEUED_BLOCKS):
            try:
                message = self._channel.recv(MESSAGE_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            except OSError:
                message = b""
            if not message:
                self._end_with_feeder()
                return
            self._take(message)

    def _end_with_feeder(self) -> None:
        if not self._ending:
            self._ending = True
            self._to_zero("the process that fed the output has ended")

    def _take(self, message: bytes) -> None:
        kind = message[0]
        if kind == OwnerMessage.FEED and len(message) > 9 and len(message) % 8 == 1:
            (sequence,) = struct.unpack_from("<Q", message, 1)
            values = np.frombuffer(message, np.float64, offset=9)
            if sequence != self._sequence + 1:
                self._to_zero(f"block {sequence} was fed after block {self._sequence}")
            self._sequence = sequence
            self._fed_at = self._clock()
            if self._queued > _MOST_QUEUED_BLOCKS * self._settings.block_samples:
                self._to_zero("blocks are fed faster than they can be put out")
                return
            self._queue.append(values)
            self._queued += values.size
        elif kind == OwnerMessage.QUIET and len(message) >= 9:
            (ramp,) = struct.unpack_from("<d", message, 1)
            self._to_zero(message[9:].decode(errors="replace") or "quiet", ramp if 0.0 <= ramp < 1e6 else None)
        elif kind == OwnerMessage.RESET:
            if self.state is OutputState.HELD and not self._stopped and not self._ending:
                self._guard.release()
                self.reason = ""
                self._fed_at = self._clock()
        elif kind == OwnerMessage.STOP:
            self._ending = True
            self._to_zero("the output is closed")
        else:
            self._to_zero("a message that is none was fed")

    def _watch(self) -> None:
        """External stop, deadline, and whether the process that feeds is still there."""
        if self._parent is not None and os.getppid() != self._parent:
            self._end_with_feeder()
        asked = self._converter.stop_requested()
        if self._stop_input is not None and not self._stopped:
            self._stopped = bool(select.select([self._stop_input], [], [], 0.0)[0])
        if asked or self._stopped:
            self._to_zero("the external stop input")
        late = self._clock() - self._fed_at
        if self._playing and late > self._settings.deadline and self._guard.last != 0.0:
            self._to_zero(f"not fed for {1e3 * late:.0f} ms")

    def _next_samples(self) -> FloatArray:
        """The samples to put out next, as far as they have been fed; at most a chunk of them."""
        size = self._settings.chunk_samples
        if self._guard.held:
            self._playing = self._queued > 0
        elif not self._playing:
            self._playing = self._queued >= self._settings.lead_blocks * self._settings.block_samples
        parts: list[FloatArray] = []
        while self._playing and size and self._queue:
            block = self._queue.popleft()
            if block.size > size:
                self._queue.appendleft(block[size:])
            parts.append(block[:size])
            size -= parts[-1].size
        values = np.concatenate(parts) if parts else np.zeros(0)
        self._queued -= values.size
        self._consumed += values.size
        self._playing = self._playing and size == 0
        return values

    def _report(self, values: FloatArray, state: OutputState) -> None:
        """Tell the feeding side what was put out; a side that does not listen costs nothing."""
        if values.size:
            self._echo.append(values)
            self._echoed += values.size
        now = self._clock()
        changed = state is not self._reported_state
        if not changed and self._echoed < self._settings.block_samples and now - self._reported_at < _BEAT:
            return
        echo = np.concatenate(self._echo) if self._echo else np.zeros(0)
        head = struct.pack("<BQI", int(state), self._consumed - echo.size, echo.size)
        with contextlib.suppress(OSError):
            self._channel.send(head + echo.tobytes() + self.reason.encode()[:500], socket.MSG_DONTWAIT)
        self._echo, self._echoed = [], 0
        self._reported_state, self._reported_at = state, now


def read_report(message: bytes) -> tuple[OutputState, int, FloatArray, str]:
    """State, index of the first sample, the samples put out (V), and why the output was taken to zero."""
    state, first, size = struct.unpack_from("<BQI", message)
    values = np.frombuffer(message, np.float64, size, 13)
    return OutputState(state), first, values, message[13 + 8 * size :].decode(errors="replace")


def load_converter(name: str, arguments: dict[str, Any]) -> Converter:
    """Make a converter from ``module:class`` and its keyword arguments.

    Raises:
        BenchError: there is none of that name.
    """
    module, _, attribute = name.partition(":")
    try:
        factory = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise BenchError(f"output owner: there is no converter {name}: {error}.") from error
    made: Converter = factory(**arguments)
    return made


def main(arguments: list[str] | None = None) -> int:
    """Own a converter until the side that feeds ends."""
    given = sys.argv[1:] if arguments is None else arguments
    descriptor, settings, name, options = given[:4]
    channel = socket.socket(fileno=int(descriptor))
    converter = load_converter(name, json.loads(options))
    stop_input = int(given[4]) if len(given) > 4 else None
    owner = OutputOwner(OwnerSettings(**json.loads(settings)), channel, converter, stop_input, parent=os.getppid())
    # A terminal's signals reach the feeding side, which ends in order; its end is seen here.
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: owner.terminate())
    with contextlib.suppress(OSError):
        os.nice(-10)
    gc.collect()
    gc.freeze()
    gc.disable()
    owner.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
