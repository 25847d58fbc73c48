"""The feeding side of an output that a process of its own owns; see `output_owner`."""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict
from types import TracebackType
from typing import Any

import numpy as np

from nmt_core.blocks import FloatArray
from nmt_plant.device import DeviceFault
from nmt_plant.output_owner import MESSAGE_BYTES, OutputState, OwnerMessage, OwnerSettings, read_report

_SILENT = 0.5  # s without a report after which the state of the output is unknown
_START_TIME = 30.0


class OutputLink:
    """Starts the owner of an output, feeds it and knows, or does not know, what it does.

    Args:
        settings: how the output is owned.
        converter: ``module:class`` of the converter, made in the owner's process.
        arguments: keyword arguments of the converter, as JSON allows them.
        stop_input: descriptor of an external stop line: a byte on it, or its end, stops the output for good.
    """

    def __init__(
        self,
        settings: OwnerSettings,
        converter: str = "nmt_plant.output_owner:SteadyClockConverter",
        arguments: Mapping[str, Any] | None = None,
        stop_input: int | None = None,
    ) -> None:
        self.settings = settings
        self._converter = converter
        self._arguments = {"sample_rate": settings.sample_rate} if arguments is None else dict(arguments)
        self._stop_input = stop_input
        self._channel: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._forget()

    def _forget(self) -> None:
        self._sequence = 0
        self._state = OutputState.NOT_KNOWN
        self._heard = 0.0
        self._gone = False
        self.reason = ""
        self._values: list[FloatArray] = []
        self._available = 0
        self._position = 0

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
        return None if self._process is None else self._process.pid

    def start(self) -> None:
        """Start the owner; returns when it has its converter and the output is at zero.

        Raises:
            DeviceFault: it does not start; its last words are in the sentence.
        """
        self.close()
        self._forget()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        descriptors = [theirs.fileno(), *([] if self._stop_input is None else [self._stop_input])]
        command = [sys.executable, "-m", "nmt_plant.output_owner", str(descriptors[0])]
        command += [json.dumps(asdict(self.settings)), self._converter, json.dumps(self._arguments)]
        command += [str(number) for number in descriptors[1:]]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
        self._process = subprocess.Popen(
            command,
            pass_fds=descriptors,
            env=environment,
            start_new_session=True,  # a terminal's signals are for the feeding side
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        theirs.close()
        self._channel = ours
        end = time.monotonic() + _START_TIME
        while self._state is OutputState.NOT_KNOWN:
            if self._process.poll() is not None or time.monotonic() > end:
                words = self._last_words()
                self.close()
                raise DeviceFault(f"the process that owns the output did not start: {words}")
            self._listen(0.1)

    def _last_words(self) -> str:
        process = self._process
        if process is None or process.stderr is None or process.poll() is None:
            return "it does not answer"
        lines = process.stderr.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"exit code {process.returncode}"

    def feed(self, values: FloatArray) -> None:
        """Hand over the next block, V.

        Raises:
            DeviceFault: the owner does not take it; the state of the output is unknown.
        """
        message = struct.pack("<BQ", OwnerMessage.FEED, self._sequence) + np.ascontiguousarray(values).tobytes()
        self._send(message)
        self._sequence += 1

    def _send(self, message: bytes) -> None:
        try:
            if self._channel is None:
                raise BrokenPipeError
            self._channel.send(message, socket.MSG_DONTWAIT)
        except OSError as error:
            raise DeviceFault(f"the output cannot be fed: {self.sentence}") from error

    def collect(self, samples: int, timeout: float = 1.0) -> FloatArray:
        """The next samples that were put out in place of those fed, V, shape (samples,); waits for them.

        Reports that were lost while nobody listened belong to an output held at zero, and count as zero.

        Raises:
            DeviceFault: they do not come; the state of the output is unknown.
        """
        end = time.monotonic() + timeout
        while self._available < samples:
            remaining = end - time.monotonic()
            if remaining <= 0.0 or not self._listen(remaining):
                raise DeviceFault(f"no samples come back from the output: {self.sentence}")
        line = np.concatenate(self._values)
        self._values, self._available = [line[samples:]], line.size - samples
        return line[:samples]

    def _listen(self, timeout: float) -> bool:
        """Take what has been reported; waits for the first report. False when the owner has ended."""
        if self._channel is None:
            return False
        select.select([self._channel], [], [], timeout)
        while True:
            try:
                message = self._channel.recv(MESSAGE_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return True
            except OSError:
                message = b""
            if not message:
                self._gone = True
                return False
            self._state, first, values, self.reason = read_report(message)
            self._heard = time.monotonic()
            lost = first - self._position
            for part in (np.zeros(max(lost, 0)), values):
                if part.size:
                    self._values.append(part)
                    self._available += part.size
            self._position = first + values.size

    @property
    def available(self) -> int:
        """Samples that `collect` gives without waiting."""
        self._listen(0.0)
        return self._available

    @property
    def has_ended(self) -> bool:
        """Whether the owner has gone, in order or not."""
        self._listen(0.0)
        return self._gone or self._process is None

    @property
    def state(self) -> OutputState:
        """What the output does; UNKNOWN where the owner has died or does not report."""
        self._listen(0.0)
        if self._state is OutputState.ENDED:
            return self._state
        if self._gone or self._process is None or time.monotonic() - self._heard > _SILENT:
            return OutputState.NOT_KNOWN
        return self._state

    @property
    def is_tripped(self) -> bool:
        """Whether the owner has taken the output to zero, or is about to, or nobody knows."""
        return self.state in (OutputState.RAMPING, OutputState.HELD, OutputState.ENDED, OutputState.NOT_KNOWN)

    @property
    def sentence(self) -> str:
        """What is known of the output, for people."""
        state = self.state
        if state is OutputState.NOT_KNOWN:
            return "the state of the output is UNKNOWN: the process that owns it has died or does not report."
        words = {
            OutputState.AT_ZERO: "the output is at zero",
            OutputState.FOLLOWING: "the output follows what it is fed",
            OutputState.RAMPING: "the output goes to zero",
            OutputState.HELD: "the output is held at zero",
            OutputState.ENDED: "the output is at zero and released",
        }[state]
        return f"{words}: {self.reason}." if self.reason else f"{words}."

    def quiet(self, reason: str, ramp: float | None = None) -> None:
        """Take the output to zero within ``ramp`` s (the owner's own when None), latched until `reset`.

        Raises:
            DeviceFault: the owner cannot be reached; the state of the output is unknown.
        """
        self._send(struct.pack("<Bd", OwnerMessage.QUIET, -1.0 if ramp is None else ramp) + reason.encode()[:500])

    def reset(self) -> None:
        """Clear a latched stop; refused by the owner unless the output is at zero and the external stop is not set.

        Raises:
            DeviceFault: the owner cannot be reached.
        """
        self._send(bytes([OwnerMessage.RESET]))

    def close(self, timeout: float = 10.0) -> OutputState:
        """Take the output to zero, end the owner and wait for it.

        Returns:
            ENDED where the owner said that the output is at zero, otherwise UNKNOWN.
        """
        process, channel = self._process, self._channel
        if process is None or channel is None:
            return self._state
        with contextlib.suppress(DeviceFault):
            self._send(bytes([OwnerMessage.STOP]))
        end = time.monotonic() + timeout
        while self._listen(0.05) and time.monotonic() < end:
            pass
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(max(end - time.monotonic(), 0.1))
        if process.poll() is None:
            process.kill()
            process.wait()
        if self._state is not OutputState.ENDED:
            self._state = OutputState.NOT_KNOWN
        channel.close()
        if process.stderr is not None:
            process.stderr.close()
        self._process = self._channel = None
        return self._state
