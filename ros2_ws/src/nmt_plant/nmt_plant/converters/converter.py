"""What puts samples out, and takes them in where it is full duplex: contract of a driver, and two without a device.

A converter lives in the process that owns it (see `output_owner`), alone with the guard: its stream, its callback and
its buffers are there. Nothing here needs more than numpy, so that this process starts fast.
"""

from __future__ import annotations

import importlib
import os
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_core.processes.steady_clock import STEADY_CLOCK, SteadyClock

_CHUNK_TIME = 0.004  # s of a turn
_MOST_SLIP = 0.002  # s; a clock that is more behind goes on from the present


class Taken(NamedTuple):
    """What was measured since the last exchange.

    Attributes:
        values: (inputs, n); n need not be that of the samples put out.
        lost: whether samples were lost in or before them: an overflow, an xrun.
    """

    values: FloatArray
    lost: bool = False


Turn = Callable[[int, "Taken | None"], "FloatArray | None"]
"""Asked by a converter: how many samples it wants, and what it has measured since it asked last (None = nothing).

The answer is what to put out next, (outputs, samples) in V; None when the output is at zero for good.
"""


class Converter(ABC):
    """Base of all converters.

    A driver with calls that wait (NI-DAQmx) implements `exchange`. One with a callback (PortAudio) overrides `run`:
    the callback asks ``turn`` and hands out the answer; `run` returns when the answer was None.

    Attributes:
        outputs: channels that are put out.
        inputs: channels that are measured.
        delay: samples between the input of an index and that under which the output of the same index acts: the sample
            put out with index k acts while the input of index k + delay is measured. Both count from the same turn on.
            Negative = not known; then it has to be measured.
        stated: round trip as the driver says it, from the first sample of a turn put out to the same sample measured;
            negative = it says nothing. Measured in the same way it is delay plus the samples of a turn.
        chunk_samples: samples of one turn of `run` as it stands here; the guard looks at everything once a turn.
    """

    outputs: int = 1
    inputs: int = 0
    delay: int = 0
    stated: int = -1
    chunk_samples: int = 40

    def run(self, turn: Turn) -> None:
        """Put out and measure until ``turn`` gives None."""
        taken: Taken | None = None
        while (values := turn(self.chunk_samples, taken)) is not None:
            taken = self.exchange(values)

    def exchange(self, values: FloatArray) -> Taken | None:
        """Put out (outputs, n) samples, V; return when the device has taken them, with what was measured meanwhile.

        Raises:
            NotImplementedError: the driver works by callback; it has its own `run`.
        """
        raise NotImplementedError(f"{type(self).__name__} has neither exchange nor run")

    def stop_requested(self) -> bool:
        """Whether the device's external stop input asks for zero; asked once a turn."""
        return False

    @abstractmethod
    def close(self) -> None:
        """Release the device, its output at zero."""


class SteadyClockConverter(Converter):
    """Takes samples when they are due on the steady clock; stands for a converter where there is none.

    A host that is late stops its clock for as long: no sample is ever due earlier than its time after the one before.

    Args:
        sample_rate: Hz.
        log: file for the time and the values of every call, see `read_log`; empty = none.
        stop_file: path whose existence is the external stop input; empty = none.
        clock: by which samples are due.
        outputs: channels.
    """

    def __init__(
        self,
        sample_rate: float,
        log: str = "",
        stop_file: str = "",
        clock: SteadyClock = STEADY_CLOCK,
        outputs: int = 1,
    ) -> None:
        self._clock, self.outputs = clock, outputs
        self.chunk_samples = max(1, int(_CHUNK_TIME * sample_rate))
        self._rate = sample_rate
        self._log = Path(log).open("wb", buffering=0) if log else None  # noqa: SIM115 - open as long as the output
        self._stop_file = stop_file
        self._due = self._clock.now()

    def exchange(self, values: FloatArray) -> Taken | None:
        """Wait until the samples are due."""
        self._due = max(self._due, self._clock.now() - _MOST_SLIP) + values.shape[1] / self._rate
        self._clock.sleep(self._due - self._clock.now())
        if self._log is not None:
            self._log.write(struct.pack("<dqq", self._clock.now(), *values.shape) + values.tobytes())
        return None

    def stop_requested(self) -> bool:
        """Whether the stop file exists."""
        return bool(self._stop_file) and os.path.exists(self._stop_file)

    def close(self) -> None:
        """Close the log."""
        if self._log is not None:
            self._log.close()


class LoopbackConverter(SteadyClockConverter):
    """Full duplex, every output wired to the input of the same number; what a loopback cable does.

    Args:
        sample_rate: Hz.
        outputs: channels.
        inputs: channels, all wired to the one output; 0 = as many as outputs.
        gain: measured over put out.
        delay: samples from a sample put out to the same sample measured.
        lost_at: index of a sample at which a loss of input is reported, in the count since the start; negative = none.
        **clock: of `SteadyClockConverter`.
    """

    def __init__(
        self,
        sample_rate: float,
        outputs: int = 1,
        delay: int = 0,
        lost_at: int = -1,
        inputs: int = 0,
        gain: float = 1.0,
        **clock: Any,
    ) -> None:
        super().__init__(sample_rate, **clock)
        self.outputs, self.inputs = outputs, inputs or outputs
        self.delay = delay
        self._gain = gain
        self._line = np.zeros((self.inputs, delay))
        self._lost_at = lost_at
        self._taken = 0

    def exchange(self, values: FloatArray) -> Taken:
        """Wait until the samples are due; they come back after the delay."""
        super().exchange(values)
        heard = np.broadcast_to(self._gain * values, (self.inputs, values.shape[1]))
        line = np.concatenate([self._line, heard], axis=1)
        count = values.shape[1]
        lost = self._taken <= self._lost_at < self._taken + count
        self._taken += count
        self._line = line[:, count:]
        return Taken(line[:, :count], lost)


def read_log(path: str | Path) -> list[tuple[float, FloatArray]]:
    """Calls of a `SteadyClockConverter`: end of each on the steady clock (s), and its values (outputs, n), V."""
    raw, position, calls = Path(path).read_bytes(), 0, []
    while position + 24 <= len(raw):
        at, outputs, size = struct.unpack_from("<dqq", raw, position)
        end = position + 24 + 8 * outputs * size
        if end > len(raw):
            break
        calls.append((at, np.frombuffer(raw, np.float64, outputs * size, position + 24).reshape(outputs, size)))
        position = end
    return calls


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
