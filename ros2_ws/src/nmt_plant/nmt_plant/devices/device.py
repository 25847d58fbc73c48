"""Device contract: what a simulated rig or a data acquisition system must do for the plant node.

Call order: configure, start, then in turn read and write, stop, close. `read` returns the next block of every
quantity and blocks until it is complete; `write` hands over a drive command that takes effect at the first
block that starts at or after its `apply_at_sample`. `quiet` starts the emergency ramp: the drive goes to zero
along a half-cosine and stays there until `reset`; reading goes on meanwhile. `close` is allowed in every
state, and twice.

Raises: DeviceStateError for a call out of order, BenchError for a command or configuration the user can fix,
DeviceFault where the device itself fails (the node then quiets and closes it).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from enum import Enum

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import OutputState, StopCause, Waveform


def check_drive(command: DriveCommand) -> None:
    """Refuse a drive command that no device can follow.

    Raises:
        BenchError: a value out of its range.
    """
    if (
        command.waveform == Waveform.SINE
        and 0.0 < command.frequency_hz < math.inf
        and 0.0 <= command.amplitude < math.inf
        and 0.0 <= command.ramp < math.inf
        and not command.terms
        and command.band_low_hz == command.band_high_hz == command.rate_hz_s == command.frequency_end_hz == 0.0
    ):
        return  # the ordinary case, once a block
    if command.waveform not in _WAVEFORMS:
        raise BenchError(f"drive command: waveform {command.waveform} is unknown; use OFF, SINE, RANDOM or SWEEP.")
    for name in ("frequency_hz", "amplitude", "ramp", "band_low_hz", "band_high_hz", "frequency_end_hz"):
        value = getattr(command, name)
        if not (math.isfinite(value) and value >= 0):
            raise BenchError(f"drive command: {name} must be finite and not negative, got {value}.")
    if not math.isfinite(command.rate_hz_s):
        raise BenchError(f"drive command: rate_hz_s must be finite, got {command.rate_hz_s}.")
    periodic = command.waveform in (Waveform.SINE, Waveform.SWEEP)
    if periodic and command.frequency_hz <= 0:
        raise BenchError("drive command: frequency_hz must be positive for a sine or a sweep.")
    if command.waveform == Waveform.RANDOM and not 0 < command.band_low_hz < command.band_high_hz:
        raise BenchError("drive command: a random drive needs 0 < band_low_hz < band_high_hz.")
    if command.waveform == Waveform.SWEEP:
        way = command.frequency_end_hz - command.frequency_hz
        if command.frequency_end_hz <= 0 or way * command.rate_hz_s < 0 or (way != 0 and command.rate_hz_s == 0):
            raise BenchError("drive command: rate_hz_s must lead from frequency_hz to frequency_end_hz.")
    for exciter, order, value, relative in command.terms:
        if exciter < 1 or order < 1 or (relative and (exciter, order) == (1, 1)):
            raise BenchError(
                f"drive command: harmonic {order} of exciter {exciter} is not a term; exciters and orders count "
                "from 1, and the fundamental of exciter 1 is the amplitude itself."
            )
        if not relative and exciter != 1:
            raise BenchError(f"drive command: a term in V is one of exciter 1, not of {exciter}; give it as a ratio.")
        if not (math.isfinite(value.real) and math.isfinite(value.imag)):
            raise BenchError(f"drive command: the terms of exciter {exciter} must be finite, got {value}.")


_WAVEFORMS = frozenset(waveform for waveform in Waveform if waveform is not Waveform.UNKNOWN)


class DeviceState(Enum):
    """Where a device is in its life."""

    CREATED = "created"
    CONFIGURED = "configured"
    RUNNING = "running"
    STOPPED = "stopped"
    CLOSED = "closed"


class DeviceStateError(RuntimeError):
    """A call out of order."""


class DeviceFault(RuntimeError):  # noqa: N818 - a fault of the device, not of the caller
    """The device failed: lost samples, lost connection, a motion that is not finite."""


class Device(ABC):
    """Base of all devices: checks the call order, leaves the work to the methods with an underscore."""

    def __init__(self) -> None:
        self._device_state = DeviceState.CREATED

    @property
    def state(self) -> DeviceState:
        """Where the device is in its life."""
        return self._device_state

    @property
    @abstractmethod
    def sample_rate(self) -> float:
        """Sample rate, Hz."""

    @property
    @abstractmethod
    def block_samples(self) -> int:
        """Samples in a block."""

    @property
    @abstractmethod
    def quantities(self) -> tuple[Quantity, ...]:
        """What is measured, in the order of the blocks."""

    @property
    @abstractmethod
    def next_sample(self) -> int:
        """Index of the first sample of the next block."""

    @property
    @abstractmethod
    def tripped(self) -> str:
        """Why the drive was taken to zero and held there; empty if it was not."""

    @property
    @abstractmethod
    def stop_cause(self) -> StopCause:
        """What took the drive to zero; UNKNOWN while nothing has."""

    @property
    @abstractmethod
    def output_state(self) -> OutputState:
        """What the output does, as far as anybody knows."""

    @property
    @abstractmethod
    def is_quiet(self) -> bool:
        """Whether the drive is at zero and stays there without a new command."""

    def configure(self) -> None:
        """Prepare everything that takes time; once, from CREATED or STOPPED."""
        self._require("configure", DeviceState.CREATED, DeviceState.STOPPED)
        self._configure()
        self._device_state = DeviceState.CONFIGURED

    def start(self) -> None:
        """Begin acquisition at sample 0 with the drive at zero."""
        self._require("start", DeviceState.CONFIGURED)
        self._start()
        self._device_state = DeviceState.RUNNING

    def read(self) -> list[SampleBlock]:
        """The next block: one SampleBlock for each quantity, all with one first sample and oscillator phase.

        Empty where samples of the block were lost: `next_sample` goes on, and the gap is marked by it.

        Raises:
            DeviceFault: the device failed.
        """
        self._require("read", DeviceState.RUNNING)
        return self._read()

    def write(self, command: DriveCommand) -> None:
        """Hand over a drive command; it counts for the watchdog even while a trip overrides it.

        Raises:
            BenchError: a command out of its range, or beyond what the device can do.
        """
        self._require("write", DeviceState.RUNNING)
        check_drive(command)
        self._write(command)

    def quiet(self, reason: str, ramp: float | None = None, cause: StopCause = StopCause.QUIET) -> None:
        """Emergency ramp: drive to zero within `ramp` s (the device's own when None), latched until reset."""
        self._require("quiet", DeviceState.RUNNING)
        self._quiet(reason, ramp, cause)

    def reset(self) -> None:
        """Clear a latched trip; the drive stays at zero until the next command.

        Raises:
            BenchError: the external stop input still asks for zero, or the output is not released.
        """
        self._require("reset", DeviceState.RUNNING)
        self._reset()

    def stop(self) -> None:
        """End acquisition; the output is zero afterwards."""
        self._require("stop", DeviceState.RUNNING)
        self._device_state = DeviceState.STOPPED
        self._stop()

    def close(self) -> None:
        """Release everything; stops first where needed."""
        if self._device_state is DeviceState.RUNNING:
            self.stop()
        if self._device_state is not DeviceState.CLOSED:
            self._device_state = DeviceState.CLOSED
            self._close()

    def _require(self, call: str, *allowed: DeviceState) -> None:
        if self._device_state not in allowed:
            names = " or ".join(state.value for state in allowed)
            raise DeviceStateError(f"{call} needs a device that is {names}; this one is {self.state.value}")

    @abstractmethod
    def _configure(self) -> None:
        """Do everything that takes time; called again after a stop."""

    @abstractmethod
    def _start(self) -> None:
        """Begin at sample 0 with the drive at zero."""

    @abstractmethod
    def _read(self) -> list[SampleBlock]:
        """Wait for the next block: one first sample, one oscillator phase, SI units; none where samples were lost."""

    @abstractmethod
    def _write(self, command: DriveCommand) -> None:
        """Take the command for the first block at or after `apply_at_sample`; BenchError for what is beyond a limit."""

    @abstractmethod
    def _quiet(self, reason: str, ramp: float | None, cause: StopCause) -> None:
        """Start the emergency ramp and hold zero until reset; reading goes on."""

    @abstractmethod
    def _reset(self) -> None:
        """Clear the trip."""

    @abstractmethod
    def _stop(self) -> None:
        """End with zero output."""

    @abstractmethod
    def _close(self) -> None:
        """Release everything."""
