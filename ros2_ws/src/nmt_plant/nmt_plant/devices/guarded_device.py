"""A device with oscillator, output guard, watchdog and limits of its own, working block by block in one fixed order.

Simulated devices and converters extend `GuardedDevice`; they are handed the final samples of a block and say what it
measures. Everything that keeps the drive safe stays here: the methods it consists of cannot be overridden.
"""

from __future__ import annotations

import contextlib
import math
import operator
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import PEAK_FACTOR
from nmt_core.messages.blocks import BlockFlag, OscillatorPhase, Quantity, SampleBlock, rounded
from nmt_core.messages.records import DriveCommand
from nmt_core.numerics.arrays import FloatArray
from nmt_core.numerics.ramp import half_cosine
from nmt_core.vocabulary import OutputState, StopCause, Waveform
from nmt_plant.devices.device import Device, DeviceFault, DeviceState
from nmt_plant.oscillator import Oscillator, OscillatorBlock, check_command, load_filters
from nmt_plant.output_process.output_link import OutputLink
from nmt_plant.output_process.output_owner import OwnerSettings
from nmt_plant.safety.limits import ChannelLimit, LimitGuard, OpenLoop, watch_rows
from nmt_plant.safety.output_guard import OutputGuard, all_to_zero, default_slew, guard_together
from nmt_plant.safety.watchdog import DriveWatchdog

# The order in which `tick` works; tests hold it to this.
TICK_ORDER = ("commands", "drive", "measure", "compute", "safety", "actuate", "publish")

LEAST_LEAD = 3
"""Blocks that wait at an output in a process of its own, at least: one that is put out, and two that may be late."""
_RISE_SHARE = 0.05  # of the voltage limit: what may be put out before any response has been seen

# More than these waiting for their sample, or one that waits longer than these seconds, are refused.
_MOST_PENDING = 1000
_LONGEST_WAIT = 60.0


_OVERLOAD = int(BlockFlag.OVERLOAD)
_FLAGS = {
    StopCause.LIMIT: BlockFlag.LIMIT,
    StopCause.WATCHDOG: BlockFlag.WATCHDOG,
    StopCause.OUTPUT: BlockFlag.WATCHDOG,
    StopCause.NODE: BlockFlag.WATCHDOG,
}
"""Flag of the blocks after a stop; STOP where none is named."""


class ChannelGroup(NamedTuple):
    """The channels of one quantity: one block of them is published."""

    quantity: Quantity
    unit: str
    channels: tuple[str, ...]
    points: tuple[int, ...]
    rows: slice | list[int]


@dataclass(frozen=True)
class GuardSettings:
    """When a device takes its drive to zero, and how fast.

    Attributes:
        limits: quantity -> largest magnitude, SI; that of VOLTAGE holds for every sample put out, too.
        limit_ramp: s, ramp to zero after a violation, and of `quiet` unless it names another.
        watchdog_blocks: blocks without a command that trip; 0 = off.
        watchdog_ramp: s, ramp to zero after a trip of the watchdog.
        slew: V/s, largest rate of change of the output; None = as belongs to the limit of VOLTAGE, see
            `output_guard.default_slew`; without that limit none.
        rise_from: V, amplitude from which the drive may at most quadruple from block to block, so that its response is
            seen in time; None = 5 % of the limit of VOLTAGE. Only with a limit on something measured.
        channels: abort and warning levels of single channels.
        open_loops: channels that must respond to the drive.
        drive_maximum: V, amplitude of the drive that ends a test; None = none.
        rms_time: s, time constant of the rms.
        warning_share: of an abort level, from which it is reported; None = only at the warning levels of `channels`.
        sample_bits: significant bits of the samples given; 53 = all.
    """

    limits: Mapping[Quantity, float]
    limit_ramp: float
    watchdog_blocks: int
    watchdog_ramp: float
    slew: float | None = None
    rise_from: float | None = None
    channels: tuple[ChannelLimit, ...] = ()
    open_loops: tuple[OpenLoop, ...] = ()
    drive_maximum: float | None = None
    rms_time: float = 1.0
    warning_share: float | None = None
    sample_bits: int = 53

    @property
    def voltage(self) -> float | None:
        """V, largest magnitude of the output."""
        return self.limits.get(Quantity.VOLTAGE)

    def slew_at(self, sample_rate: float) -> float | None:
        """V/s, slew limit of the output at a sample rate in Hz."""
        if self.slew is None and self.voltage is not None:
            return default_slew(self.voltage, sample_rate)
        return self.slew

    @property
    def free_rise(self) -> float:
        """V, amplitude that the drive may take up at once; infinity = any."""
        measured = any(quantity is not Quantity.VOLTAGE for quantity in self.limits) or any(
            limit.abort_peak is not None for limit in self.channels
        )
        if not measured:
            return math.inf
        if self.rise_from is not None:
            return self.rise_from
        return math.inf if self.voltage is None else _RISE_SHARE * self.voltage


def owned_output(
    sample_rate: float,
    block_samples: int,
    settings: GuardSettings,
    lead_blocks: int = LEAST_LEAD,
    deadline_blocks: float | None = None,
    inputs: int = 0,
    outputs: int = 1,
    record: str = "",
    probe: Mapping[str, Any] | None = None,
    **link: Any,
) -> OutputLink:
    """An output in a process of its own, with the limits of a device.

    Args:
        sample_rate: Hz.
        block_samples: samples in a block.
        settings: limits and ramps of the device.
        lead_blocks: blocks that wait at the output, so that one may be late.
        deadline_blocks: blocks without a new one after which the output goes to zero; None = as many as wait.
        inputs: channels that the converter measures.
        outputs: channels that it puts out.
        record: file for what the output does, see `nmt_core.processes.output_record`; empty = none.
        probe: the settings of `output_owner.OwnerSettings` whose names begin with probe; None = no probe.
        **link: converter, arguments and stop_input of `output_link.OutputLink`.
    """
    deadline = lead_blocks if deadline_blocks is None else deadline_blocks
    owner = OwnerSettings(
        sample_rate=float(sample_rate),
        block_samples=block_samples,
        lead_blocks=lead_blocks,
        deadline=deadline * block_samples / sample_rate,
        ramp=settings.limit_ramp,
        limit=settings.voltage,
        slew=settings.slew_at(sample_rate),
        outputs=outputs,
        inputs=inputs,
        record=record,
        **(probe or {}),
    )
    return OutputLink(owner, **link)


def _sums(command: DriveCommand, weight: Callable[[int], float] = lambda order: 1.0) -> dict[int, float]:
    """Exciter -> sum of the amplitudes of its terms times a weight of the order, V, with the fundamental's."""
    if not command.terms:  # the ordinary case, once a block
        return {1: command.amplitude * weight(1)}
    turned = sum(term.value for term in command.terms if term.order == 1 and not term.relative)
    sums = {1: abs(command.amplitude + turned) * weight(1)}
    for exciter, order, value, relative in command.terms:
        if relative or order > 1:
            size = abs(value) * weight(order) * (command.amplitude if relative else 1.0)
            sums[exciter] = sums.get(exciter, 0.0) + size
    return sums


class GuardedDevice(Device):
    """Commands, final samples, trips and publishing of a device; `_measure` and `_compute` are left to the device.

    A subclass calls `_prepare` at the end of its constructor. One that overrides a method of the guard is refused
    when it is defined (TypeError).

    Args:
        sample_rate: Hz.
        block_samples: samples in a block.
        groups: published channels, in order; their rows are those that `_compute` returns.
        settings: limits, watchdog and ramps.
        seed: of the random waveform.
        output: process that owns the output, see `owned_output`; None = the samples go to `_measure` directly. With it
            a block is put out ``lead_blocks`` after it was made, and commands act that much later at the earliest.
        exciters: number of outputs; several are guarded alike, and what stops one stops all.
    """

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for name in vars(cls):
            if getattr(getattr(GuardedDevice, name, None), "__final__", False):
                raise TypeError(f"{cls.__name__}.{name} would replace a part of the output guard; implement _measure")

    def __init__(
        self,
        sample_rate: float,
        block_samples: int,
        groups: Sequence[ChannelGroup],
        settings: GuardSettings,
        seed: int = 0,
        output: OutputLink | None = None,
        exciters: int = 1,
    ) -> None:
        super().__init__()
        if output is not None and output.settings.outputs != exciters:
            raise BenchError(
                f"the process that owns the outputs has {output.settings.outputs} and the rig {exciters} exciters; "
                "give it one output for each."
            )
        self._exciters = exciters
        self._sample_rate = float(sample_rate)
        self._block_samples = block_samples
        self._groups = groups
        self._settings = settings
        self._seed = seed
        self.link = output
        self._lead = 0 if output is None else output.settings.lead_blocks
        # A half-cosine from zero grows by at most this factor until its response is seen.
        self._rise_factor = float(2 + self._lead) ** 2
        self._free_rise = settings.free_rise
        self._voltage_limit = settings.voltage
        self._slew_limit = settings.slew_at(self._sample_rate)

    def _prepare(self) -> None:
        """State at sample 0: drive at zero, nothing tripped, nothing pending."""
        self.oscillator = Oscillator(self._sample_rate, self._seed, self._exciters)
        self._watchdog = DriveWatchdog(self._settings.watchdog_blocks)
        settings = self._settings
        self._outputs = [
            OutputGuard(self._sample_rate, self._voltage_limit, self._slew_limit, settings.limit_ramp)
            for _ in range(self._exciters)
        ]
        self._guard = LimitGuard(
            dict(settings.limits),
            settings.channels,
            settings.open_loops,
            settings.drive_maximum,
            settings.rms_time,
            settings.warning_share,
        )
        self._seen = 0.0  # V, amplitude of the drive in the block measured last
        self._reached = 0.0  # V, amplitude of the drive in the block made last
        nothing = np.zeros((self._exciters, self._block_samples + 1))
        still = OscillatorBlock(nothing, OscillatorPhase(0.0, 0.0, 0.0))
        self._made = deque([(still, 0.0)] * self._lead)
        self._fed = False
        self._lost = False
        self._last = 0.0  # V, largest value of the output in the block read last
        self.measured: FloatArray = np.zeros((0, self._block_samples))
        self._share = 1.0  # of the drive wanted that its rise lets through
        self._pending: list[DriveCommand] = []
        self._reason = ""
        self._cause = StopCause.UNKNOWN
        self._flags = BlockFlag.NONE
        self._quiet_ramp = 0.0
        self._next_sample = 0

    @property
    def sample_rate(self) -> float:
        """Sample rate, Hz."""
        return self._sample_rate

    @property
    def block_samples(self) -> int:
        """Samples in a block."""
        return self._block_samples

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What the device measures, in the order of its blocks."""
        return tuple(group.quantity for group in self._groups)

    @property
    def next_sample(self) -> int:
        """Index of the first sample of the next block."""
        return self._next_sample

    @property
    def tripped(self) -> str:
        """Why the drive was taken to zero and held there; empty if it was not."""
        return self._reason

    @property
    def stop_cause(self) -> StopCause:
        """What took the drive to zero; UNKNOWN while nothing has."""
        return self._cause

    @property
    def output_state(self) -> OutputState:
        """What the output does, as far as anybody knows."""
        if self.link is not None:
            state = self.link.state
            return OutputState.RAMPING if state is OutputState.HELD and self._last != 0.0 else state
        if self.state is DeviceState.CLOSED:
            return OutputState.ENDED
        if self._reason:
            return OutputState.HELD if self._at_zero else OutputState.RAMPING
        return OutputState.AT_ZERO if self._at_zero else OutputState.FOLLOWING

    @property
    def is_quiet(self) -> bool:
        """Whether the drive is at zero and stays there without a new command."""
        harmless = all(command.waveform == Waveform.OFF for command in self._pending)
        return self._at_zero and (bool(self._reason) or harmless)

    @property
    def _at_zero(self) -> bool:
        """Whether the next sample put out is zero, and all that follow without a new command."""
        if self.link is not None:
            state = self.link.state
            if state in (OutputState.RAMPING, OutputState.NOT_KNOWN):
                return False
            follows = state in (OutputState.FOLLOWING, OutputState.AT_ZERO)
            if self._last != 0.0 or (follows and any(block.voltages.any() for block, _ in self._made)):
                return False
        return self.oscillator.is_quiet and all(output.reaches_zero for output in self._outputs)

    @property
    def output_sentence(self) -> str:
        """What is known of an output that a process of its own owns, for people; empty without one."""
        return "" if self.link is None else self.link.sentence

    @property
    def is_ready(self) -> bool:
        """Whether `read` returns at once: always without a process that owns the output, else when a block is out.

        The first `read` sets the clock of the samples going and waits for its block.
        """
        link = self.link
        return link is None or not self._fed or link.available >= self._block_samples or link.has_ended

    @property
    def lateness(self) -> float:
        """s since the block that `read` gives next was put out; 0 without a process that owns the output."""
        return 0.0 if self.link is None or not self._fed else self.link.lateness

    @property
    def turn_time(self) -> float:
        """s, of the converter's turns: a block cannot be ready earlier than the turn that completes it."""
        return 0.0

    @property
    def is_owned(self) -> bool:
        """Whether a process of its own owns the output."""
        return self.link is not None

    @property
    def output_pid(self) -> int | None:
        """Process that owns the output; None without one."""
        return None if self.link is None else self.link.pid

    @property
    def output_record(self) -> str:
        """File in which that process says what the output does; empty where there is none."""
        return "" if self.link is None else self.link.settings.record

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each channel that has passed a warning level since the start."""
        return tuple(self._guard.warnings.values())

    @property
    def margins(self) -> dict[str, float]:
        """Channel -> largest share of an abort level that it has reached since the start."""
        return self._guard.margins

    @property
    def spread_samples(self) -> int:
        """Samples that the slew limit has held back since the start."""
        return sum(output.spread for output in self._outputs)

    def _start(self) -> None:
        # Compile, or load, what a block needs: not in the first one.
        Oscillator(self._sample_rate).block(1)
        watch_rows(np.zeros((1, 1)), 0.0, np.ones((4, 1)), np.zeros((4, 1)))
        self._prepare()
        if self.link is not None:
            load_filters()
            self.link.start()

    @final
    def _read(self) -> list[SampleBlock]:
        return self.tick()

    @final
    def tick(self) -> list[SampleBlock]:
        """One block, in the order of TICK_ORDER; `read` calls it.

        Commands that are due act on this block's drive. A sample beyond the output's limit acts at that sample, a
        measured violation from the next block on; one that can be predicted acts before. Of a block in which samples
        measured were lost nothing is given: the gap shows in the first sample of the next one.
        """
        self._look_at_stop_line()
        self._take_commands()
        drive = self._put_out(self._drive())
        true_values = self._measure(drive)
        recorded, overload = self._compute(true_values)
        blocks = self._blocks(recorded, drive.phase)
        self._safety(blocks)
        self._actuate()
        return self._publish(blocks, overload)

    def _stop_requested(self) -> bool:
        """Whether the device's external stop input asks for zero, where no process owns the output.

        Where one does, its converter is asked (`converter.Converter.stop_requested`).
        """
        return False

    @final
    def _look_at_stop_line(self) -> None:
        if self.link is None and not self._reason and self._stop_requested():
            self._quiet("the external stop input", None, StopCause.EXTERNAL_INPUT)

    @final
    def _take_commands(self) -> None:
        """Apply, in order of arrival, what is due at this block; ignored while tripped."""
        first = self._next_sample + self._lead * self._block_samples
        due = [command for command in self._pending if command.apply_at_sample <= first]
        self._pending = [command for command in self._pending if command.apply_at_sample > first]
        if not self._reason:
            for command in due:
                self.oscillator.apply(command)

    @final
    def _drive(self) -> OscillatorBlock:
        """The final samples of the next block to be made: what the oscillator gives, after rise, slew and limit."""
        n = self._block_samples
        wanted = self.oscillator.bound(n)
        if wanted == 0.0:
            share = 1.0
        elif self._reason or self.oscillator.is_stopping:
            share = self._share  # on the way to zero nothing rises
        else:
            allowed = max(self._free_rise, self._rise_factor * self._seen) * (1.0 + 1e-9)
            share = 1.0 if wanted <= allowed else allowed / wanted
        reached = share * wanted
        predicts = self.oscillator.is_periodic and not self.oscillator.is_feedback
        if not self._reason and predicts and self._guard.predict(reached):
            self._trip(self._guard.reason, StopCause.LIMIT, self._settings.limit_ramp)
            all_to_zero(self._outputs)
            self._quiet_link(None)
        block = self.oscillator.block(n)
        wanted_samples = list(block.voltages)
        risen = self._rising(wanted_samples, share)
        self._reached = reached
        final = guard_together(self._outputs, risen, n)
        violations = [output.violation for output in self._outputs if output.violation is not None]
        if violations:
            self.oscillator.ramp_to_zero(0.0)
            if not self._reason:
                index, value = min(violations)
                self._trip(
                    f"output limit: the drive would have reached {value:.4g} V at sample "
                    f"{self._next_sample + self._lead * n + index}, "
                    f"limit {self._voltage_limit or math.inf:g} V",
                    StopCause.LIMIT,
                    0.0,
                )
        unchanged = all(map(operator.is_, final, wanted_samples))
        return block if unchanged else replace(block, voltages=np.array(final))

    @final
    def _put_out(self, block: OscillatorBlock) -> OscillatorBlock:
        """Hand a block to the process that owns the output; returns what is put out in the block to be measured now.

        Raises:
            DeviceFault: that process has died or does not answer.
        """
        if self.link is None:
            self._seen = self._reached
            return block
        n = self._block_samples
        if not self._fed:
            self._fed = True
            for still, _ in self._made:
                self.link.feed(still.voltages[:, :n])
        self.link.feed(block.voltages[:, :n])
        self._made.append((block, self._reached))
        made, self._seen = self._made.popleft()
        put_out, self.measured, self._lost = self.link.collect(n, 1.0 + 4.0 * self._lead * n / self._sample_rate)
        self._last = float(np.abs(put_out[:, -1]).max())
        if self.link.is_tripped and not self._reason:
            if self.link.state is OutputState.NOT_KNOWN:
                raise DeviceFault(self.link.sentence)
            self._trip(f"output: {self.link.reason}", self.link.cause or StopCause.OUTPUT, 0.0)
        following = put_out[:, -1:] if self._reason else self._made[0][0].voltages[:, :1]
        return replace(made, voltages=np.concatenate([put_out, following], axis=1))

    def _quiet_link(self, ramp: float | None) -> None:
        """Tell the process that owns the output at once, past the blocks that wait there."""
        if self.link is not None:
            with contextlib.suppress(DeviceFault):  # the next read says so
                self.link.quiet(self._reason, ramp)

    def _rising(self, voltages: Sequence[FloatArray], share: float) -> Sequence[FloatArray]:
        """The voltages times the share that is let through, along a half-cosine from the last block's share."""
        start, self._share = min(self._share, share), share
        if start == 1.0:
            return voltages
        weight = start + (share - start) * half_cosine(np.arange(voltages[0].size) / self._block_samples)
        return [np.asarray(weight * voltage, dtype=np.float64) for voltage in voltages]

    @abstractmethod
    def _measure(self, drive: OscillatorBlock) -> FloatArray:
        """True values of all channels under the drive of this block, shape (channels, samples), SI.

        ``drive.voltages`` hold the final samples: a converter puts out these and no others. Where a process owns the
        output, they are those that were put out, and ``self.measured``, shape (inputs, samples), is what its converter
        took in at the same time, in the converter's own unit.
        """

    def _compute(self, true_values: FloatArray) -> tuple[FloatArray, bool]:
        """Recorded values (channels, samples), SI, and whether a channel was beyond its range."""
        return true_values, False

    def _blocks(self, recorded: FloatArray, phase: OscillatorPhase) -> list[SampleBlock]:
        if self._settings.sample_bits < 53:
            # Here, not in the recorder: live and offline extraction have the same samples.
            recorded = rounded(recorded, self._settings.sample_bits)
        return [
            SampleBlock(
                self._next_sample,
                self._sample_rate,
                group.quantity,
                group.unit,
                group.channels,
                group.points,
                recorded[group.rows],
                phase,
            )
            for group in self._groups
        ]

    @final
    def _safety(self, blocks: Sequence[SampleBlock]) -> None:
        if self._reason:
            return
        if self._guard.check(blocks, self._seen):
            self._trip(self._guard.reason, StopCause.LIMIT, self._settings.limit_ramp)
            self._quiet_link(self._quiet_ramp)
        elif self._watchdog.block(not self.oscillator.is_quiet):
            self._trip(
                f"watchdog: no drive command for {self._watchdog.missed} blocks",
                StopCause.WATCHDOG,
                self._settings.watchdog_ramp,
            )
            self._quiet_link(self._quiet_ramp)

    @final
    def _actuate(self) -> None:
        """Hand the drive to the output: while tripped it can only go to zero."""
        if self._reason:
            self.oscillator.ramp_to_zero(0.0 if self.oscillator.is_quiet else self._quiet_ramp)

    @final
    def _publish(self, blocks: Sequence[SampleBlock], overload: bool) -> list[SampleBlock]:
        flags = int(self._flags) | (_OVERLOAD if overload else 0)
        self._next_sample += self._block_samples
        if self._lost:
            return []
        if not flags:
            return list(blocks)
        return [replace(block, flags=flags) for block in blocks]

    @final
    def _trip(self, reason: str, cause: StopCause, ramp: float) -> None:
        self._reason = reason
        self._cause = cause
        self._flags |= _FLAGS.get(cause, BlockFlag.STOP)
        self._quiet_ramp = ramp

    def _check(self, command: DriveCommand) -> None:
        """Refuse a command, other than OFF, that the device cannot follow.

        Raises:
            BenchError: a command beyond what the device can do, or beyond a limit of its output.
        """
        check_command(command, self._sample_rate)
        beyond = [term.exciter for term in command.terms if term.exciter > self._exciters]
        if beyond:
            raise BenchError(f"the drive names exciter {max(beyond)}, but there are {self._exciters}.")
        if self._voltage_limit is not None:
            self._check_peak(command, self._voltage_limit)
        if self._slew_limit is not None and command.waveform != Waveform.RANDOM:
            self._check_slew(command, self._slew_limit)

    def _check_peak(self, command: DriveCommand, limit: float) -> None:
        """Refuse a command whose samples would pass the voltage limit, V."""
        largest = max(_sums(command).values())
        if command.waveform == Waveform.RANDOM:
            if PEAK_FACTOR * largest > limit:
                raise BenchError(
                    f"peaks of a random drive of {command.amplitude:g} V rms reach {PEAK_FACTOR:g} times as much, "
                    f"beyond the voltage limit of {limit:g} V; lower the level."
                )
        elif largest > limit:
            what = "drive amplitude with its harmonics" if command.terms else "drive amplitude"
            raise BenchError(f"{what} {largest:g} V is beyond the voltage limit of {limit:g} V; lower the level.")

    def _check_slew(self, command: DriveCommand, slew: float) -> None:
        """Refuse a periodic command that changes faster than the slew limit, V/s, between its samples."""
        angle = math.pi * max(command.frequency_hz, command.frequency_end_hz) / self._sample_rate
        fastest = max(_sums(command, lambda order: math.sin(min(order * angle, 0.5 * math.pi))).values())
        fastest *= 2.0 * self._sample_rate
        if fastest > slew * (1.0 + 1e-9):
            raise BenchError(
                f"the drive changes by up to {fastest:.4g} V/s, beyond the slew limit of {slew:.4g} V/s; lower its "
                "level or its frequency."
            )

    @final
    def _write(self, command: DriveCommand) -> None:
        # A command the oscillator cannot follow is refused here, where its sender can be told.
        if command.waveform != Waveform.OFF:
            self._check(command)
        self._check_wait(command)
        self._watchdog.command()
        self._pending.append(command)

    def _check_wait(self, command: DriveCommand) -> None:
        """Refuse a command that lies too far ahead, or one too many of those that wait."""
        wait = (command.apply_at_sample - self._next_sample) / self._sample_rate
        if wait > _LONGEST_WAIT:
            raise BenchError(
                f"a drive command for sample {command.apply_at_sample} lies {wait:.4g} s ahead of sample "
                f"{self._next_sample}; {_LONGEST_WAIT:g} s are allowed."
            )
        # There is always room for OFF.
        if len(self._pending) >= _MOST_PENDING * (2 if command.waveform == Waveform.OFF else 1):
            raise BenchError(f"{len(self._pending)} drive commands wait for their sample; no more are taken.")

    @final
    def _quiet(self, reason: str, ramp: float | None, cause: StopCause) -> None:
        wanted = self._settings.limit_ramp if ramp is None else ramp
        if not self._reason:
            self._trip(reason, cause, wanted)
        self._quiet_ramp = min(self._quiet_ramp, wanted)
        self.oscillator.ramp_to_zero(self._quiet_ramp)
        self._quiet_link(self._quiet_ramp)

    @final
    def _reset(self) -> None:
        if self._stop_requested() if self.link is None else self.link.stop_is_set:
            raise BenchError("the external stop input still asks for zero; release it first")
        if self.link is not None and not self.link.reset():
            raise BenchError(f"the output is not released: {self.link.sentence}")
        # The tripped drive must be at rest before anybody takes over again.
        self.oscillator.ramp_to_zero(0.0)
        self._pending.clear()
        for output in self._outputs:
            output.release()
        self._guard.reset()
        self._seen, self._share = 0.0, 1.0
        self._watchdog.command()
        self._reason = ""
        self._cause = StopCause.UNKNOWN
        self._flags = BlockFlag.NONE

    def _stop(self) -> None:
        self.oscillator.ramp_to_zero(0.0)
        self._pending.clear()
        if self.link is not None:
            self.link.close()
