"""From blocks, loop states and the windows that lock events name to a verdict on each window.

One code for streams as they come (with bounded memory) and for recordings: what is made of a window depends on the
content of the streams alone, not on the order in which different streams arrive. The rule is in
:mod:`nmt_record.windows.window_policy`.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from nmt_core.vocabulary import LoopState
from nmt_record.windows.topic_blocks import ExcitationPhase, TopicBlocks, TopicStretch, phase_reference
from nmt_record.windows.window_policy import (
    MINIMUM_PERIODS,
    STATE_NAMES,
    AnyBlock,
    Consequence,
    NamedWindow,
    WindowFault,
    WindowFinding,
    WindowVerdict,
    judge,
)

# One topic may lag behind another by the time a lost datagram takes to be sent again; at a hundred times real time
# that is many seconds of bench time.
HISTORY_SAMPLES = 600_000
PATIENCE_SAMPLES = 1_200_000
# Of hundreds of channels so many samples would be a gigabyte; a second of them stays in any case.
HISTORY_BYTES = 40_000_000
_BYTES_PER_VALUE = 8
_COMPACT = 256


class StateAfter(NamedTuple):
    """State of the loop after the block that ends with ``last_sample``."""

    last_sample: int
    state: int
    reason: str = ""


class LoopStates:
    """The newest states of the loop, in time.

    Attributes:
        reached: last sample that a state is known of; −1 before the first.
    """

    def __init__(self) -> None:
        self.reached = -1
        self._states: list[StateAfter] = []
        self._samples: list[int] = []
        self._start = 0

    def __len__(self) -> int:
        return len(self._states) - self._start

    def add(self, state: StateAfter) -> None:
        """Take the next state; one from before the newest means that the acquisition has started anew."""
        if state.last_sample < self.reached:
            self._states, self._samples, self._start = [], [], 0
        self._states.append(state)
        self._samples.append(state.last_sample)
        self.reached = state.last_sample

    def lost_lock(self, window: NamedWindow) -> WindowFinding | None:
        """Where the loop did not hold its lock over a window, as far as states are known."""
        holds_lock = window.policy.holds_lock
        start = max(window.first_sample, window.lock_sample)
        for index in range(bisect_left(self._samples, start, self._start), len(self._states)):
            entry = self._states[index]
            last = entry.last_sample >= window.end_sample - 1
            # The block that ends the window may already show the next level: it takes effect after that block.
            if entry.state == LoopState.LOCK_LOST or (holds_lock and entry.state != LoopState.LOCKED and not last):
                name = STATE_NAMES.get(entry.state, "unknown state")
                why = f" ({entry.reason.rstrip('.')})" if entry.reason else ""
                where = f"{name} at sample {entry.last_sample}{why}"
                reason = f"The loop did not hold its lock over the window: {where}."
                return WindowFinding(WindowFault.LOST_LOCK, reason, entry.last_sample)
            if last:
                break
        return None

    def forget(self, oldest: int) -> None:
        """Drop states from before a sample."""
        self._start = bisect_left(self._samples, oldest, self._start)
        if self._start > _COMPACT and 2 * self._start > len(self._states):
            del self._states[: self._start], self._samples[: self._start]
            self._start = 0


@dataclass(frozen=True, eq=False)
class CutWindow:
    """A window and what is to be made of it.

    Attributes:
        key: what it was announced with.
        window: its samples.
        verdict: what can be used of it.
        stretches: its blocks, one entry for each topic; empty where nothing can be used.
    """

    key: Any
    window: NamedWindow
    verdict: WindowVerdict
    stretches: tuple[TopicStretch, ...]


class SampleTable:
    """Keeps the newest blocks of every stream and cuts windows out of them.

    Args:
        topics: sample topics that a window needs.
        decode: makes a block (or its head) from the arguments of :meth:`add_record`; called only for blocks of a
            window.
        every_channel: a window is lost with one of its channels.
        require_loop_state: a window needs loop states up to its end (False for data without a loop).
        minimum_periods: windows of fewer whole periods are rejected.
        history_samples: samples kept of every topic while no window is awaited.
        history_bytes: what they may take of the memory, where blocks come with their samples; a second stays.
        patience_samples: how far other topics may run ahead before a window that lacks samples is given up.
        maximum_samples: longer windows are rejected, so that the memory stays bounded; None = no limit.
        one_acquisition: what comes after a source has started over cannot be used, as in recordings that are read again
            by sample index; else it is a new acquisition.

    Attributes:
        sample_rate: of the first block, Hz; NaN before it.
    """

    def __init__(
        self,
        topics: Sequence[str],
        decode: Callable[[Any], AnyBlock] = lambda payload: payload,
        *,
        every_channel: bool = False,
        require_loop_state: bool = True,
        minimum_periods: int = MINIMUM_PERIODS,
        history_samples: int = HISTORY_SAMPLES,
        history_bytes: int = HISTORY_BYTES,
        patience_samples: int = PATIENCE_SAMPLES,
        maximum_samples: int | None = None,
        one_acquisition: bool = False,
    ) -> None:
        self._topics = tuple(topics)
        self._decode = decode
        self._every_channel = every_channel
        self._require_loop_state = require_loop_state
        self._minimum_periods = minimum_periods
        self._history = history_samples
        self._history_bytes, self._width = history_bytes, 0
        self._patience = patience_samples
        self._maximum = maximum_samples
        self._blocks: dict[str, TopicBlocks] = {
            topic: TopicBlocks(topic, one_acquisition=one_acquisition) for topic in self._topics
        }
        self._states = LoopStates()
        self._pending: list[tuple[Any, NamedWindow]] = []
        # Nothing can change for a pending window before a stream reaches this sample.
        self._next_end: float = math.inf
        self._ready: list[CutWindow] = []
        self.sample_rate = math.nan

    def add_block(self, topic: str, block: AnyBlock) -> None:
        """Take one block of a topic, in the order of the stream; other topics are ignored."""
        self.add_record(topic, block.first_sample, block.samples, block)

    def add_record(self, topic: str, first_sample: int, samples: int, payload: Any) -> None:
        """Take one block that is decoded only if a window needs it.

        Args:
            topic: sample topic; ignored if no window needs it.
            first_sample: index of its first sample.
            samples: number of samples.
            payload: what ``decode`` understands; has the attribute ``sample_rate``.
        """
        blocks = self._blocks.get(topic)
        if blocks is None:
            return
        end = first_sample + samples
        if blocks.reached is None:
            self._see(payload)
        known = blocks.set_back
        anew = blocks.add(first_sample, end, payload)
        if anew:
            self._give_up_all()
        if end >= self._next_end or blocks.set_back is not known:
            self._check()
        elif not self._pending:
            blocks.forget(end - self._history)

    @property
    def reached(self) -> int:
        """Sample after the last one that all topics, and the loop's states where they are needed, have brought."""
        ends = [blocks.reached or 0 for blocks in self._blocks.values()]
        return min([*ends, self._states.reached + 1] if self._require_loop_state else ends, default=0)

    def _see(self, payload: Any) -> None:
        """The first block of a topic."""
        if math.isnan(self.sample_rate):
            self.sample_rate = float(payload.sample_rate)
        data = getattr(payload, "data", None)
        if data is not None and len(data):
            self._width += _BYTES_PER_VALUE * len(data)
            second = self.sample_rate if math.isfinite(self.sample_rate) else 0.0  # blocks come from anywhere
            self._history = min(self._history, max(self._history_bytes // self._width, math.ceil(second)))

    def add_state(self, last_sample: int, state: int, reason: str = "") -> None:
        """Take the loop's state after one block."""
        self._states.add(StateAfter(last_sample, state, reason))
        if self._pending:
            if state != LoopState.LOCKED or last_sample + 1 >= self._next_end:
                self._check()
        else:
            self._states.forget(last_sample - self._history)

    def add_window(self, key: Any, window: NamedWindow) -> None:
        """Take a window to wait for; ``key`` comes back with it."""
        longest = self._maximum
        if window.samples < 1 or (longest is not None and window.samples > longest):
            bounds = f"within 1..{longest} samples" if longest is not None else "one sample or more"
            reason = f"The window of {window.samples} samples is not {bounds}."
            verdict = WindowVerdict(reason, WindowFault.LENGTH, window.first_sample, 0)
            self._ready.append(CutWindow(key, window, verdict, ()))
            return
        self._pending.append((key, window))
        self._check()

    def take(self) -> list[CutWindow]:
        """Windows that have become ready since the last call, in the order of their readiness."""
        ready, self._ready = self._ready, []
        return ready

    @property
    def ready(self) -> bool:
        """Whether :meth:`take` would return something."""
        return bool(self._ready)

    @property
    def gaps(self) -> dict[str, int]:
        """Blocks that did not begin where the one before ended, by topic."""
        return {topic: blocks.gaps for topic, blocks in self._blocks.items()}

    @property
    def blocks(self) -> dict[str, int]:
        """Blocks that came, by topic."""
        return {topic: blocks.blocks for topic, blocks in self._blocks.items()}

    @property
    def kept(self) -> tuple[int, int]:
        """Blocks and states that are held at the moment."""
        return sum(map(len, self._blocks.values())), len(self._states)

    def finish(self) -> None:
        """The streams have ended: give up what is not complete."""
        for key, window in self._pending:
            self._decide(key, window)
        self._pending = []
        self._next_end = math.inf

    def _check(self) -> None:
        keep = []
        for key, window in self._pending:
            if self._hopeless(window) or self._complete(window) or self._newest() >= window.end_sample + self._patience:
                self._decide(key, window)
            else:
                keep.append((key, window))
        self._pending = keep
        self._next_end = min((window.end_sample for _, window in keep), default=math.inf)
        self._forget(min((window.first_sample for _, window in keep), default=None))

    def _newest(self) -> int:
        return max((blocks.reached for blocks in self._blocks.values() if blocks.reached is not None), default=0)

    def _hopeless(self, window: NamedWindow) -> bool:
        """Whether nothing that is still to come can save any of the window."""
        effects = window.policy.effects
        if effects[WindowFault.LOST_LOCK] is Consequence.WINDOW and self._states.lost_lock(window) is not None:
            return True
        return effects[WindowFault.SET_BACK] is Consequence.WINDOW and any(
            map(partial(_set_back, window), self._blocks.values())
        )

    def _complete(self, window: NamedWindow) -> bool:
        if self._require_loop_state and self._states.reached < window.end_sample - 1:
            return False
        return all(
            (blocks.reached is not None and blocks.reached >= window.end_sample) or _set_back(window, blocks)
            for blocks in self._blocks.values()
        )

    def _decide(self, key: Any, window: NamedWindow) -> None:
        findings: list[WindowFinding] = []
        lost = self._states.lost_lock(window)
        if lost is not None:
            findings.append(lost)
        findings += self._missing(window)
        if 0 < window.periods < self._minimum_periods:
            reason = f"The window holds {window.periods} whole periods; at least {self._minimum_periods} are needed."
            findings.append(WindowFinding(WindowFault.PERIODS, reason, window.first_sample))
        stretches = tuple(
            TopicStretch.of(
                topic,
                window.first_sample,
                window.samples,
                blocks.over(window.first_sample, window.end_sample),
                self._decode,
            )
            for topic, blocks in self._blocks.items()
        )
        findings += window_findings(stretches)
        verdict = judge(window, findings, self._topics, every_channel=self._every_channel)
        self._ready.append(CutWindow(key, window, verdict, stretches if verdict.samples else ()))

    def _give_up_all(self) -> None:
        """One topic began anew: what of the windows it had is gone."""
        for key, window in self._pending:
            reason = "The acquisition began anew before the window was complete."
            verdict = WindowVerdict(reason, WindowFault.NEW_ACQUISITION, window.first_sample, 0)
            self._ready.append(CutWindow(key, window, verdict, ()))
        self._pending = []
        self._next_end = math.inf

    def _missing(self, window: NamedWindow) -> list[WindowFinding]:
        """Why a window is not complete; empty if it is."""
        end = window.end_sample
        if not self._topics:
            return [
                WindowFinding(WindowFault.INCOMPLETE, "There are no samples that a window needs.", window.first_sample)
            ]
        for blocks in self._blocks.values():
            reached = blocks.reached
            if blocks.set_back is not None and _set_back(window, blocks):
                turned, back = blocks.set_back
                reason = (
                    f"The sample clock of '{blocks.topic}' was set back from sample {turned} to {back}; what comes "
                    "after that is not where events say."
                )
                return [WindowFinding(WindowFault.SET_BACK, reason, turned)]
            if reached is None:
                reason = f"The window was never completed: no block of '{blocks.topic}' came."
                return [WindowFinding(WindowFault.INCOMPLETE, reason, window.first_sample)]
            if reached < end:
                have = max(0, reached - window.first_sample)
                reason = (
                    f"The window was never completed: '{blocks.topic}' ended after {have} of its "
                    f"{window.samples} samples."
                )
                return [WindowFinding(WindowFault.INCOMPLETE, reason, reached)]
        if self._require_loop_state and window.policy.holds_lock and self._states.reached < end - 1:
            reason = "The window was never completed: the loop's state did not come up to its end."
            return [WindowFinding(WindowFault.INCOMPLETE, reason, max(window.first_sample, self._states.reached + 1))]
        return []

    def _forget(self, oldest_needed: int | None) -> None:
        for blocks in self._blocks.values():
            oldest = (blocks.reached or 0) - self._history
            blocks.forget(oldest if oldest_needed is None else min(oldest, oldest_needed))
        oldest = self._states.reached - self._history
        self._states.forget(oldest if oldest_needed is None else min(oldest, oldest_needed))


def _set_back(window: NamedWindow, blocks: TopicBlocks) -> bool:
    """Whether the clock of a topic was set back before it had all samples of a window."""
    return blocks.set_back is not None and blocks.set_back[0] < window.end_sample


def window_findings(stretches: Sequence[TopicStretch]) -> list[WindowFinding]:
    """What is wrong with the blocks of a window, topic by topic, between topics, and with the excitation's phase."""
    findings = [finding for stretch in stretches for finding in stretch.findings]
    present = [stretch for stretch in stretches if stretch.blocks]
    for stretch in present[1:]:
        if stretch.sample_rate != present[0].sample_rate:
            reason = (
                f"'{stretch.topic}' was sampled at {stretch.sample_rate:g} Hz, '{present[0].topic}' at "
                f"{present[0].sample_rate:g} Hz."
            )
            findings.append(WindowFinding(WindowFault.RATE, reason, stretch.first_sample, stretch.topic))
    if present:
        findings += ExcitationPhase(phase_reference(present)).findings()
    return findings
