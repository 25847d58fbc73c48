"""A bench in miniature for the run machine: plant, loop and channels whose delays can be chosen.

The loop answers each block with a report, and with a lock event some blocks into each level. Reports and lock events
reach the machine over two channels that keep their own order and may lag behind one another by any amount; levels and
horizons reach loop and plant over two more. The scheduler picks which channel moves next.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from nmt_core.messages.records import LevelCommand, LoopStatus
from nmt_core.vocabulary import BlockFlag, LoopState, RunPhase
from nmt_sequencer.level_plan import RunPlan
from nmt_sequencer.run_machine import Pacing, RunMachine

BLOCK = 100
RATE = 1000.0
PACING = Pacing(RATE, BLOCK, tick_blocks=3, quiet_ramp=0.25, settle=0.2)


def status(
    last_sample: int, index: int, sequence: int, state: LoopState, flags: int = 0, reason: str = ""
) -> LoopStatus:
    """State of the loop after a block; nobody asks for the amplitudes here."""
    return LoopStatus(last_sample, index, sequence, state, 0.0, 0.0, 0.0, 0.0, "", 0.0, flags, reason)


@dataclass(frozen=True)
class Fate:
    """What becomes of a level: blocks until the lock (None = lost then), blocks of the window, loss in it, response."""

    blocks: int = 4
    locks: bool = True
    window: int = 6
    lost_after: int | None = None
    limit_after: int | None = None
    answers: bool = True


@dataclass
class MiniLoop:
    """Plays the loop: a state for each block, by the fate of the level."""

    fates: list[Fate]
    index: int = 0
    state: int = LoopState.FIXED
    sequence: int = 0
    flags: int = 0
    waiting: list[LevelCommand] = field(default_factory=list)
    begun: int = 0
    newest: LoopStatus | None = None
    late: list[LevelCommand] = field(default_factory=list)

    def on_level(self, order: LevelCommand, produced: int) -> LoopStatus | None:
        """Take an order; the acknowledgement repeats the newest report."""
        self.sequence = max(self.sequence, order.sequence)
        self.waiting.append(order)
        if order.apply_at_sample < produced:
            self.late.append(order)
        if self.newest is None:
            return None
        self.newest = self.newest._replace(level_sequence=self.sequence, reason="")
        return self.newest

    def block(self, first: int) -> tuple[LoopStatus, tuple[int, int, int] | None]:
        """Answer a block; the lock event goes with the block that confirms the lock."""
        end = first + BLOCK
        reason, lock = "", None
        while self.waiting and self.waiting[0].apply_at_sample <= first:
            order = self.waiting.pop(0)
            if order.amplitude == 0.0:
                if self.state != LoopState.LOCK_LOST or order.index != self.index:
                    self.state = LoopState.FIXED
            else:
                self.state, self.begun = LoopState.ACQUIRING, first
            self.index = order.index
        fate = self.fates[self.index % len(self.fates)]
        age = (first - self.begun) // BLOCK
        if self.state == LoopState.ACQUIRING and age == fate.blocks:
            if fate.locks:
                self.state, reason = LoopState.LOCKED, "phase error is small"
                lock = self.index, end - 1, end + fate.window * BLOCK
            else:
                self.state, reason = LoopState.LOCK_LOST, f"level {self.index} did not lock"
        elif self.state == LoopState.LOCKED and fate.lost_after is not None and age >= fate.blocks + fate.lost_after:
            self.state, reason = LoopState.LOCK_LOST, f"level {self.index} lost its lock"
        if (
            self.state in (LoopState.ACQUIRING, LoopState.LOCKED)
            and fate.limit_after is not None
            and age >= fate.limit_after
        ):
            self.flags = BlockFlag.LIMIT
        self.newest = status(end - 1, self.index, self.sequence, self.state, self.flags, reason)
        if not fate.answers:
            self.newest = self.newest._replace(phase_error=math.nan)
        return self.newest, lock


@dataclass
class Bench:
    """Everything joined; :meth:`move` lets one thing happen."""

    fates: list[Fate]
    pacing: Pacing = PACING
    produced: int = 0
    orders: list[LevelCommand] = field(default_factory=list)
    horizons: list[int] = field(default_factory=list)
    progress: list[float] = field(default_factory=list)
    acknowledged: int = 0

    def __post_init__(self) -> None:
        self.machine = RunMachine(self.pacing)
        self.loop = MiniLoop(self.fates)
        self.reports: deque[LoopStatus] = deque()
        self.locks: deque[tuple[int, int, int]] = deque()
        self.levels: deque[LevelCommand] = deque()
        self.states: deque[int] = deque()
        self.plant_horizon = 0

    def start(self, plan: RunPlan) -> None:
        self.machine.start(plan)
        self.published()

    def published(self) -> None:
        """What the node does after every call: orders first, then the state."""
        machine = self.machine
        for order in machine.take_orders():
            self.orders.append(order)
            self.levels.append(order)
        if not self.horizons or machine.horizon != self.horizons[-1]:
            self.horizons.append(machine.horizon)
            self.states.append(machine.horizon)
        if self.pacing.lockstep:
            newest = self.orders[-3:]  # there are never more on the way
            pending = [order.apply_at_sample for order in newest if order.sequence > self.acknowledged]
            assert machine.horizon <= min(pending, default=machine.horizon), "past an unacknowledged level"
            assert machine.horizon % BLOCK == 0
        self.progress.append(machine.progress)

    def call(self, method: Callable[..., object], *arguments: object) -> object:
        """Call the machine and publish."""
        result = method(*arguments)
        self.published()
        return result

    def possible(self) -> list[str]:
        """Names of what may happen next; nothing within a channel overtakes."""
        moves = [name for name in ("reports", "locks", "levels", "states") if getattr(self, name)]
        if not self.pacing.lockstep or self.produced + BLOCK <= self.plant_horizon:
            moves.append("plant")
        return moves

    def move(self, name: str, twice: bool = False) -> None:
        """Let one thing happen; ``twice``: what comes to the machine comes again."""
        machine = self.machine
        if name == "plant":
            report, lock = self.loop.block(self.produced)
            self.produced += BLOCK
            if lock is not None:
                self.locks.append(lock)
            self.reports.append(report)
        elif name == "levels":
            acknowledgement = self.loop.on_level(self.levels.popleft(), self.produced)
            if acknowledgement is not None:
                self.reports.append(acknowledgement)
        elif name == "states":
            self.plant_horizon = max(self.plant_horizon, self.states.popleft())
        elif name == "locks":
            lock = self.locks.popleft()
            for _ in range(1 + twice):
                self.call(machine.on_lock, *lock)
        else:
            report = self.reports.popleft()
            self.acknowledged = max(self.acknowledged, report.level_sequence)
            for _ in range(1 + twice):
                self.call(machine.on_report, report)

    def run(self, choose: Callable[[list[str]], str] | None = None, limit: int = 20_000) -> None:
        """Until the machine is done; without ``choose`` everything arrives at once."""
        for _ in range(limit):
            if not self.machine.active:
                return
            moves = self.possible()
            assert moves, f"nothing can move: {self.machine}"
            self.move(choose(moves) if choose else moves[0])
        raise AssertionError(f"the run does not end: {self.machine.phase.name}")

    def until(self, condition: Callable[[], bool], limit: int = 20_000) -> None:
        """Move on until a condition holds."""
        for _ in range(limit):
            if condition():
                return
            self.move(self.possible()[0])
        raise AssertionError("the condition does not come true")

    @property
    def done(self) -> bool:
        return self.machine.phase == RunPhase.DONE
