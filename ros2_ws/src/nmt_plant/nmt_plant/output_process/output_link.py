"""The feeding side of an output that a process of its own owns; see `output_owner`."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_core.processes.steady_clock import STEADY_CLOCK, SteadyClock
from nmt_core.vocabulary import OutputState, StopCause
from nmt_plant.devices.device import DeviceFault
from nmt_plant.output_process.output_owner import (
    MESSAGE_BYTES,
    OwnerMessage,
    OwnerReport,
    OwnerSettings,
    feed_message,
    quiet_message,
    read_report,
)
from nmt_plant.output_process.owner_process import OwnerProcess
from nmt_plant.output_process.shared_samples import SharedSamples

_SILENT = 0.5  # s without a report after which the state of the output is unknown
_START_TIME = 90.0  # s; drivers load for long on a busy computer
_NOTHING = OwnerReport(
    OutputState.NOT_KNOWN, StopCause.UNKNOWN, 0, 0, (0, 0), (0, 0), 0.0, 0, False, -1, 0, 0.0, 0.0, 0, ""
)


class Collected(NamedTuple):
    """What the converter did during some samples.

    Attributes:
        put_out: (outputs, n) V.
        measured: (inputs, n), at the same time.
        lost: whether samples measured are missing among them; what is in their place means nothing.
    """

    put_out: FloatArray
    measured: FloatArray
    lost: bool


class OutputLink:
    """Starts the owner of an output, feeds it and knows, or does not know, what it does.

    Args:
        settings: how the output is owned.
        converter: ``module:class`` of the converter, made in the owner's process.
        arguments: keyword arguments of the converter, as JSON allows them.
        stop_input: descriptor of an external stop line: a byte on it, or its end, stops the output for good.
        clock: on which it waits.
        start: starts the owner.
    """

    def __init__(
        self,
        settings: OwnerSettings,
        converter: str = "nmt_plant.converters.converter:SteadyClockConverter",
        arguments: Mapping[str, Any] | None = None,
        stop_input: int | None = None,
        clock: SteadyClock = STEADY_CLOCK,
        start: Callable[..., OwnerProcess] = OwnerProcess,
    ) -> None:
        self.settings = settings
        self._clock, self._start_owner = clock, start
        self._converter = converter
        self._arguments = {"sample_rate": settings.sample_rate} if arguments is None else dict(arguments)
        self._stop_input = stop_input
        self._channel: socket.socket | None = None
        self._owner: OwnerProcess | None = None
        self._samples: SharedSamples | None = None
        self._forget()

    def _forget(self) -> None:
        self._fed = self._position = 0
        self._last = _NOTHING
        self._heard = 0.0
        self._gone = False
        self._holes: list[tuple[int, int]] = []
        self._losses: list[tuple[int, int]] = []

    def __enter__(self) -> OutputLink:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def pid(self) -> int | None:
        """Process id of the owner, None before the start and after the end."""
        return None if self._owner is None else self._owner.pid

    def start(self) -> None:
        """Start the owner; returns when it has its converter and the output is at zero.

        Raises:
            DeviceFault: it does not start; its last words are in the sentence.
        """
        self.close()
        self._forget()
        settings = self.settings
        samples = SharedSamples(settings.outputs, settings.inputs, settings.ring_samples)
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        arguments = self._converter, self._arguments, self._stop_input
        owner = self._owner = self._start_owner(settings, theirs, samples, *arguments)
        theirs.close()
        self._channel, self._samples = ours, samples
        end = self._clock.now() + _START_TIME
        while self._last.state is OutputState.NOT_KNOWN:
            if owner.has_ended or self._clock.now() > end or self._gone:
                owner.wait(2.0)
                words = owner.last_words()
                self.close()
                raise DeviceFault(f"the process that owns the output did not start: {words}.")
            self._listen(0.1)
        least = 2 + self._last.delay // settings.block_samples
        if settings.inputs and settings.lead_blocks < least:
            self.close()
            raise DeviceFault(
                f"what is measured comes {self._last.delay} samples after what is put out, so at least {least} blocks "
                f"must wait at the output; lead_blocks is {settings.lead_blocks}."
            )

    def feed(self, values: FloatArray) -> None:
        """Hand over the next samples, V, shape (outputs, n), or (n,) for one output.

        Raises:
            DeviceFault: the owner does not take them; the state of the output is unknown.
        """
        line = np.atleast_2d(values)
        samples = self._samples
        if samples is None or self._fed + line.shape[1] - self._last.put_out > self.settings.ring_samples:
            self._listen(0.0)
            if samples is None or self._fed + line.shape[1] - self._last.put_out > self.settings.ring_samples:
                raise DeviceFault(f"the output does not take what it is fed: {self.sentence}")
        samples.fed.write(self._fed, line)
        self._send(feed_message(self._fed, line.shape[1]))
        self._fed += line.shape[1]

    def _send(self, message: bytes) -> None:
        try:
            if self._channel is None:
                raise BrokenPipeError
            self._channel.send(message, socket.MSG_DONTWAIT)
        except OSError as error:
            raise DeviceFault(f"the output cannot be fed: {self.sentence}") from error

    def collect(self, samples: int, timeout: float = 1.0) -> Collected:
        """What was put out and measured during the next samples; waits for them.

        Raises:
            DeviceFault: they do not come; the state of the output is unknown.
        """
        end = self._clock.now() + timeout
        while self._complete < samples:
            remaining = end - self._clock.now()
            if remaining <= 0.0 or not self._listen(remaining):
                raise DeviceFault(f"no samples come back from the output: {self.sentence}")
        memory = self._samples
        assert memory is not None
        first, last = self._position, self._position + samples
        put_out = memory.put_out.read(first, samples)
        for start, stop in self._holes:
            put_out[:, max(start - first, 0) : max(stop - first, 0)] = 0.0
        delay = self._last.delay
        measured = memory.measured.read(first + delay, samples)
        lost = any(start < last + delay and stop > first + delay for start, stop in self._losses)
        self._holes = [hole for hole in self._holes if hole[1] > last]
        self._losses = [loss for loss in self._losses if loss[1] > last + delay]
        self._position = last
        return Collected(put_out, measured, lost)

    def _listen(self, timeout: float) -> bool:
        """Take what has been reported; waits for the first report. False when the owner has ended."""
        if self._channel is None:
            return False
        if timeout > 0.0:
            self._clock.wait_to_read(self._channel, timeout)
        while True:
            try:
                message = self._channel.recv(MESSAGE_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return True
            except ConnectionResetError:  # it left something unread; what it said last is still there
                continue
            except OSError:
                message = b""
            if not message:
                self._gone = True
                return False
            self._last = read_report(message)
            self._heard = self._clock.now()
            if self._last.hole[1]:
                self._holes.append(self._last.hole)
            if self._last.lost[1]:
                self._losses.append(self._last.lost)

    @property
    def _complete(self) -> int:
        """Samples of which everything has come back."""
        end = self._last.put_out
        if self.settings.inputs:
            end = min(end, self._last.taken - self._last.delay)
        return end - self._position

    @property
    def available(self) -> int:
        """Samples that `collect` gives without waiting."""
        self._listen(0.0)
        return self._complete

    @property
    def lateness(self) -> float:
        """s since the last of the samples that are available now was put out; of the block after `collect`'s last."""
        return (
            self._clock.now()
            - self._last.time
            + (self._complete - self.settings.block_samples) / (self.settings.sample_rate)
        )

    @property
    def last_report(self) -> OwnerReport:
        """What the owner said last."""
        self._listen(0.0)
        return self._last

    @property
    def has_ended(self) -> bool:
        """Whether the owner has gone, in order or not."""
        self._listen(0.0)
        return self._gone or self._owner is None

    @property
    def reason(self) -> str:
        """Why the output was taken to zero; empty while it follows."""
        return self._last.reason

    @property
    def cause(self) -> StopCause:
        """EXTERNAL_INPUT or OUTPUT where the owner took the output to zero of itself; else UNKNOWN."""
        return self._last.cause

    @property
    def stop_is_set(self) -> bool:
        """Whether the external stop input asks for zero now."""
        self._listen(0.0)
        return self._last.stop_is_set

    @property
    def state(self) -> OutputState:
        """What the output does; NOT_KNOWN where the owner has died or does not report."""
        self._listen(0.0)
        if self._last.state is OutputState.ENDED:
            return OutputState.ENDED
        if self._gone or self._owner is None or self._is_silent:
            return OutputState.NOT_KNOWN
        return self._last.state

    @property
    def _is_silent(self) -> bool:
        return self._clock.now() - self._heard > _SILENT

    @property
    def is_tripped(self) -> bool:
        """Whether the owner has taken the output to zero, or is about to, or its state is unknown."""
        return self.state in (OutputState.RAMPING, OutputState.HELD, OutputState.ENDED, OutputState.NOT_KNOWN)

    @property
    def sentence(self) -> str:
        """What is known of the output, for people."""
        state, reason = self.state, self.reason
        if state is OutputState.NOT_KNOWN:
            why = f" ({reason})" if self._last.state is OutputState.NOT_KNOWN and reason else ""
            return f"the state of the output is UNKNOWN: the process that owns it has died or does not report{why}."
        words = {
            OutputState.AT_ZERO: "the output is at zero",
            OutputState.FOLLOWING: "the output follows what it is fed",
            OutputState.RAMPING: "the output goes to zero",
            OutputState.HELD: "the output is held at zero",
            OutputState.ENDED: "the output is at zero and released",
        }[state]
        return f"{words}: {reason}." if reason else f"{words}."

    def quiet(self, reason: str, ramp: float | None = None) -> None:
        """Take the output to zero within ``ramp`` s (the owner's own when None), latched until `reset`.

        Raises:
            DeviceFault: the owner cannot be reached; the state of the output is unknown.
        """
        self._send(quiet_message(reason, ramp))

    def reset(self, timeout: float = 1.0) -> bool:
        """Clear a latched stop; what was fed before is not put out any more.

        Returns:
            False where the owner does not: the output is not at zero, or the external stop is set.

        Raises:
            DeviceFault: the owner cannot be reached.
        """
        self._send(bytes([OwnerMessage.RESET]))
        end = self._clock.now() + timeout
        while self.is_tripped and self._clock.now() < end:
            self._listen(0.02)
        return not self.is_tripped

    def close(self, timeout: float = 10.0) -> OutputState:
        """Take the output to zero, end the owner and wait for it; one that does not report is killed at once.

        Returns:
            ENDED where the owner said that the output is at zero, otherwise NOT_KNOWN.
        """
        owner, channel, samples = self._owner, self._channel, self._samples
        if owner is None or channel is None or samples is None:
            return self._last.state
        if self.state is OutputState.NOT_KNOWN and self._is_silent:
            # Stopped or hung it cannot go to zero, and JACK repeats its last period; without it the converter does
            # what its hardware does.
            owner.kill()
        with contextlib.suppress(DeviceFault):
            self._send(bytes([OwnerMessage.STOP]))
        end = self._clock.now() + timeout
        while self._listen(0.05) and self._clock.now() < end:
            pass
        if not owner.wait(max(end - self._clock.now(), 0.1)):
            owner.kill()
        if self._last.state is not OutputState.ENDED:
            self._last = self._last._replace(state=OutputState.NOT_KNOWN)
        channel.close()
        samples.close()
        owner.close()
        self._owner = self._channel = self._samples = None
        return self._last.state
