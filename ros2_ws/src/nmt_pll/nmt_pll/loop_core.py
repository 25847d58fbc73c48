"""What the PLL node does with messages, free of ROS: levels and blocks in, answers of the loop out."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace

from nmt_core.errors import BenchError
from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.command_judge import LONGEST_AHEAD, CommandJudge
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import DriveCommand, LevelCommand, LockEvent, LoopStatus
from nmt_core.vocabulary import ControlKind, LoopState, Quantity, TestKind, Waveform
from nmt_pll.coverage import covers
from nmt_pll.force_control.force_per_volt import table_from_json
from nmt_pll.level_loop import LevelLoop, LockWindow, LoopOutput
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.open_loop.random_drive import RandomDrive
from nmt_pll.open_loop.sweep_loop import SteppedSineLoop, SweepLoop
from nmt_pll.phase_loop.loop import PhaseLockedLoop
from nmt_pll.phase_loop.paper_loop import PaperLoop
from nmt_pll.pll_settings import PllSettings
from nmt_pll.secondary.secondary_loop import SecondaryResonanceLoop
from nmt_pll.self_excited.self_excited_loop import SelfExcitedLoop


def drive_command(output: LoopOutput, delay: int = 0) -> DriveCommand:
    """The drive command that a loop's answer asks for; at amplitude zero the drive is off.

    Args:
        output: the answer to a block.
        delay: samples of buffering between command and excitation.
    """
    return DriveCommand(
        output.waveform if output.amplitude > 0.0 else Waveform.OFF,
        output.frequency_hz,
        output.amplitude,
        output.ramp,
        output.last_sample + 1 + delay,
        output.last_sample,
        output.band_low_hz,
        output.band_high_hz,
        output.rate_hz_s,
        output.frequency_end_hz,
        output.terms if output.amplitude > 0.0 else (),
    )


def loop_status(output: LoopOutput, level_sequence: int, response_unit: str) -> LoopStatus:
    """The state of the loop that goes with its answer; the frequency is zero while the drive is off."""
    return LoopStatus(
        last_sample=output.last_sample,
        level_index=output.level.index if output.level else 0,
        level_sequence=level_sequence,
        state=int(output.state),
        frequency_hz=output.frequency_hz if output.amplitude > 0.0 else 0.0,
        phase_error=output.phase_error,
        force_amplitude=output.force_amplitude,
        response_amplitude=output.response_amplitude,
        response_unit=response_unit,
        drive_amplitude=output.amplitude,
        flags=output.flags,
        reason=output.transition.reason if output.transition else "",
    )


def lock_event(lock: LockWindow, response: Quantity, sample_rate: float) -> LockEvent:
    """The event that names the window of a lock.

    Args:
        lock: the lock.
        response: quantity of the drive-point response.
        sample_rate: Hz.
    """
    return LockEvent(
        level_index=lock.level.index,
        level=lock.level.amplitude,
        level_unit=ControlKind(lock.level.control).level_unit(response),
        sample=lock.sample,
        frequency_hz=lock.frequency_hz,
        phase_error=lock.phase_error,
        window_first_sample=lock.first_sample,
        window_samples=lock.samples,
        window_periods=lock.periods,
        test=lock.level.test,
        time_ns=bench_time_ns(lock.sample, sample_rate),
        response_order=lock.level.response_order,
        held_phase=lock.level.held_phase,
        perturbation=lock.level.perturbation,
        parameter=lock.level.parameter,
        force_order=lock.level.force_order,
    )


@dataclass(frozen=True, slots=True)
class LoopAnswer:
    """What is published after one pair of blocks, in this order; several states where levels are acknowledged.

    Attributes:
        drive: command for the next block.
        lock: the lock event, if lock was confirmed.
        statuses: state of the loop, and the same again with the number of each level acknowledged.
    """

    drive: DriveCommand
    lock: LockEvent | None
    statuses: tuple[LoopStatus, ...]


class LoopCore:
    """Chooses the loop for a level, pairs force with response, and puts the loop's answers into records.

    A level is acknowledged by a repetition of the newest state with the level's number: after the block that ends where
    the level begins, or at once if that has passed. So the acknowledgement tells the same however late the level comes.

    Args:
        settings: those of the node.
        complain: told in a sentence what is refused and why, and whether it may come with every block.

    Attributes:
        loops: the loop for each kind of test.
        loop: the one at work.
        judge: whether a level can be meant.
        counters: gaps, refusals, late levels and lost locks so far.

    Raises:
        BenchError: a setting is refused.
    """

    def __init__(self, settings: PllSettings, complain: Callable[[str, bool], None] = lambda _, __: None) -> None:
        self.settings = settings
        self.sample_rate = settings.sample_rate
        self.block_samples = settings.block_samples
        self.response = Quantity[settings.response_topic.upper()]
        self.loops = self._make_loops()
        self.loop: LevelLoop = next(iter(self.loops.values()))
        self.counters = dict.fromkeys(("gaps", "refused", "late_levels", "lock_losses"), 0)
        self.judge = CommandJudge(self.block_samples, horizon=round(LONGEST_AHEAD * self.sample_rate))
        self._complain = complain
        self._delay = settings.loop_settings.latency_blocks * self.block_samples
        self._waiting: dict[bool, SampleBlock] = {}
        self._next_sample: int | None = None
        self._sequence = 0
        self._unacknowledged: list[LevelCommand] = []
        self._status: LoopStatus | None = None
        self._orders_from: Hashable = None
        self._warm_up()

    def _make_loops(self) -> dict[TestKind, LevelLoop]:
        """The loop for each kind of test; the phase is controlled only where a linear description is given."""
        settings = self.settings.loop_settings
        loops: list[LevelLoop] = []
        drive_point = self.settings.drive_point
        self._exciters = self.settings.exciters
        if self.settings.linear_json:
            linear = LinearDescription.from_json(self.settings.linear_json)
            drive_point = linear.drive_point
            self._exciters = max(self._exciters, len(linear.exciter_points))
            if self.settings.loop == "paper":
                paper = self.settings.paper_settings.combined_with(settings)
                loops.append(PaperLoop(linear, paper, self.sample_rate, self.block_samples))
            elif len(linear.exciter_points) > 1:
                loops.append(PhaseLockedLoop(linear, settings, self.sample_rate, self.block_samples))
            else:
                known = table_from_json(self.settings.force_per_volt_json)
                self_excited = self._self_excited(linear, settings)
                damped = min(linear.damping_ratios[linear.target_mode], linear.plant_damping_ratio) > 0.0
                if damped or not self_excited:  # a rest that is unstable can be held by feedback only
                    loops.append(PhaseLockedLoop(linear, settings, self.sample_rate, self.block_samples, known))
                    loops.append(SecondaryResonanceLoop(linear, settings, self.sample_rate, self.block_samples))
                loops += self_excited
        of_noise = settings.quiet_ramp, self.settings.settling_time, settings.latency_blocks, self.settings.exciters
        for noise in (RandomDrive,):
            loops.append(noise(drive_point, self.sample_rate, self.block_samples, *of_noise))
        for given_frequency in (SweepLoop, SteppedSineLoop):
            loops.append(given_frequency(drive_point, settings, self.sample_rate, self.block_samples))
        return {kind: loop for loop in loops for kind in loop.KINDS}

    def _self_excited(self, linear: LinearDescription, settings: LoopSettings) -> list[LevelLoop]:
        """The loop of self-excited tests, where the description has what it needs."""
        method, limit = self.settings.self_excited_method, self.settings.response_limit
        try:
            return [SelfExcitedLoop(linear, settings, self.sample_rate, self.block_samples, method, limit)]
        except BenchError:
            if method != "auto":
                raise
            return []

    def _warm_up(self) -> None:
        """Compile the detector's kernel before the first block, not with it."""
        for loop in self.loops.values():
            tracking = PhaseLockedLoop | SecondaryResonanceLoop | SelfExcitedLoop | SweepLoop | SteppedSineLoop
            if not isinstance(loop, tracking):
                continue
            loop.filter.process(loop.warm_up_data(), 0.0, 1.0)
            loop.filter.reset()

    def refusal(self, kind: TestKind) -> str:
        """Why a kind of test has no loop; empty = it has one."""
        refusal = covers(DrivenTest(kind=kind, exciters=("",) * self._exciters), self.settings.loop)
        if refusal or kind in self.loops:
            return refusal
        label = kind_class(kind).words()
        if kind_class(kind).closes_phase_loop and not self.settings.linear_json:
            return f"A {label} test needs a linear description: the parameter 'linear_json' of the pll node is empty."
        return f"The pll node has no {label} test for a rig with this linear description."

    def _choose_loop(self, level: LevelCommand) -> None:
        """Take the loop for the kind of test; only a loop at rest may be left.

        Raises:
            BenchError: no such loop here, or another one is at work.
        """
        refusal = self.refusal(level.test)
        if refusal:
            raise BenchError(refusal)
        loop = self.loops[level.test]
        if loop is self.loop:
            return
        if self.loop.machine.state in (LoopState.ACQUIRING, LoopState.LOCKED):
            raise BenchError(f"A {kind_class(level.test).words()} test cannot begin while the level before is at work.")
        self.loop = loop

    def refuse(self, sentence: str, often: bool = True) -> None:
        """Count and tell a message that cannot be used; ``often``: it may be so with every block."""
        self.counters["refused"] += 1
        self._complain(sentence, often)

    def forget_samples(self) -> None:
        """Another plant is there, which counts its samples anew; what waits for its sample stays."""
        self._next_sample = self._status = None
        self._waiting.clear()

    @property
    def second_source(self) -> str:
        """A sentence that names who else has sent levels; empty if none has."""
        names = self.judge.second_source
        return f"topic level has a second publisher: {names}" if names else ""

    @property
    def at_work(self) -> bool:
        """Whether a level is sought or held, or waits for its sample."""
        return self.loop.machine.state in (LoopState.ACQUIRING, LoopState.LOCKED) or bool(self._unacknowledged)

    def take_level(self, level: LevelCommand, source: Hashable = "sequencer") -> tuple[LoopStatus, ...]:
        """Take a level; returns the acknowledgement if it is due already.

        A level above zero is taken from one source only and for a sample that can exist, see
        `nmt_core.messages.command_judge.CommandJudge.judge`; zero is taken from anybody.

        A level of this run that cannot be done is answered by a lost lock at its sample: without an answer the
        sequencer would wait for ever.
        """
        why = ""
        if level.amplitude != 0.0:
            why = self.judge.judge(source, next_sample=self._next_sample, apply_at=level.apply_at_sample)
        if why:
            self.refuse(f"Level refused: {why}", often=False)
            return ()
        if level.amplitude != 0.0 and source != self._orders_from:
            self._orders_from, self._sequence = source, 0  # another sequencer counts its levels from one
        if level.control == ControlKind.UNKNOWN:
            level = replace(level, control=ControlKind.VOLTAGE)
        newest = max([self._sequence, *(item.sequence for item in self._unacknowledged)])
        try:
            self._choose_loop(level)
            self.loop.set_level(level)
        except BenchError as error:
            self.refuse(f"Level refused: {error}", often=False)
            if level.sequence <= newest:
                return ()
            self.loop.reject(level, str(error).rstrip("."))
        if self._next_sample is not None and level.apply_at_sample < self._next_sample:
            self.counters["late_levels"] += 1
        self._unacknowledged.append(level)
        return self._acknowledge()

    def _acknowledge(self) -> tuple[LoopStatus, ...]:
        """The newest state again for every level whose sample is the next one or has passed."""
        statuses = []
        for level in [item for item in self._unacknowledged if item.apply_at_sample <= (self._next_sample or 0)]:
            self._unacknowledged.remove(level)
            self._sequence = max(self._sequence, level.sequence)
            if self._status is not None:
                self._status = self._status._replace(level_sequence=self._sequence, reason="")
                statuses.append(self._status)
        return tuple(statuses)

    def take_block(self, block: SampleBlock) -> LoopAnswer | None:
        """Take a block of force or response; the answer if it completes a pair."""
        self._waiting[block.quantity == Quantity.FORCE] = block
        if len(self._waiting) < 2:
            return None
        force, response = self._waiting[True], self._waiting[False]
        if force.first_sample != response.first_sample:
            # One topic is ahead: drop the older block and wait for its successor.
            del self._waiting[force.first_sample < response.first_sample]
            self.counters["gaps"] += 1
            return None
        self._waiting.clear()
        if self._next_sample is not None and force.first_sample != self._next_sample:
            self.counters["gaps"] += 1
            if force.first_sample < self._next_sample:
                self.counters["refused"] += 1
                return None
        if force.sample_rate != self.sample_rate:
            self.refuse(f"Sample rate is {force.sample_rate} Hz, the parameter says {self.sample_rate} Hz.")
            return None
        self._next_sample = force.end_sample
        try:
            output = self.loop.process(force, response)
        except ValueError as error:
            self.refuse(f"Blocks refused: {error}")
            return None
        return self._answer(output, response.unit)

    def _answer(self, output: LoopOutput, unit: str) -> LoopAnswer:
        if output.transition and output.transition.state == LoopState.LOCK_LOST:
            self.counters["lock_losses"] += 1
        lock = None if output.lock is None else lock_event(output.lock, self.response, self.sample_rate)
        self._status = status = loop_status(output, self._sequence, unit)
        acknowledged = self._acknowledge() if self._unacknowledged else ()
        return LoopAnswer(drive_command(output, self._delay), lock, (status, *acknowledged))
