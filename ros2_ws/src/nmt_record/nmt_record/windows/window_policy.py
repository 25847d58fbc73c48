"""What may be wrong with a window of samples, and what each fault does to it: the one rule for everybody who cuts one.

The extraction, live and offline, the readers of whole windows and the diagnosis ask here, so that a window that is
rejected for one of them is not an observation for another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import BlockFlag, SampleBlock
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.wire import BlockHead
from nmt_core.vocabulary import LoopState, TestKind

STATE_NAMES: dict[int, str] = {
    LoopState.FIXED: "fixed frequency",
    LoopState.ACQUIRING: "acquiring",
    LoopState.LOCKED: "locked",
    LoopState.LOCK_LOST: "lock lost",
}

MINIMUM_PERIODS = 3
"""Fewer whole periods cannot be told from a transient."""

PHASE_JUMP_CYCLES = 1e-6
"""More than rounding, far less than any phase step worth the name."""

AnyBlock = SampleBlock | BlockHead
"""What faults are searched for in: the samples themselves do not matter for most of them."""


def covers(test: DrivenTest) -> str:
    """What the judgement of windows does not take of a test: nothing, every kind has its column of faults."""
    return ""


class WindowFault(Enum):
    """What may be wrong with a window; the values are for people."""

    LENGTH = "too long, or without a sample"
    PERIODS = "too few whole periods"
    LOST_LOCK = "the loop did not hold its lock, or the test was given up"
    INCOMPLETE = "the streams or the recording ended within it"
    NEW_ACQUISITION = "the acquisition began anew before it was complete"
    SET_BACK = "the sample clock had been set back before it was complete"
    MISSING = "samples are missing, or were in a block that cannot be read"
    REPEATED = "samples came twice"
    MALFORMED = "a block cannot be read, or contradicts itself"
    CHANNELS = "the channels change"
    RATE = "the sampling rate changes, is not positive, or differs between topics"
    OVERLOAD = "a converter reached its end"
    LIMIT = "a safety limit had tripped"
    WATCHDOG = "the drive watchdog had tripped"
    STOPPED = "the drive had been stopped"
    SILENT = "the excitation is not periodic"
    PHASE_JUMP = "the phase of the excitation jumps, or runs backwards"
    UNIT = "a quantity that is not its topic's, or a unit that is not SI"
    VALUE = "a sample is not a finite number"


class Consequence(Enum):
    """What a fault does to a window.

    Attributes:
        WINDOW: nothing in it can be used.
        REST: what comes before the fault can be used.
        PARTS: the longest part between such faults can be used, if it is at least half of the window.
        CHANNELS: what was measured by the channels with the fault cannot be used; a window is lost to those who need
            every channel.
        NONE: it does not matter.
    """

    WINDOW = "the window"
    REST = "the rest of the window"
    PARTS = "one part of the window"
    CHANNELS = "channels"
    NONE = "nothing"


class WindowFinding(NamedTuple):
    """One fault of one window.

    Attributes:
        fault: what kind it is.
        reason: one sentence.
        sample: first sample that must not be used because of it.
        topic: sample topic; empty where it is the whole bench.
        end: sample after the last one that must not be used; None = unknown or to the end.
    """

    fault: WindowFault
    reason: str
    sample: int
    topic: str = ""
    end: int | None = None


FLAG_FAULTS = (
    (BlockFlag.OVERLOAD, WindowFault.OVERLOAD, "a converter was overloaded"),
    (BlockFlag.LIMIT, WindowFault.LIMIT, "a safety limit had tripped"),
    (BlockFlag.WATCHDOG, WindowFault.WATCHDOG, "the drive watchdog had tripped"),
    (BlockFlag.STOP, WindowFault.STOPPED, "the drive had been stopped"),
)

# Samples that are not there, or not to be relied on.
_BROKEN = (
    WindowFault.MISSING,
    WindowFault.REPEATED,
    WindowFault.MALFORMED,
    WindowFault.CHANNELS,
    WindowFault.RATE,
    WindowFault.OVERLOAD,
    WindowFault.LIMIT,
    WindowFault.WATCHDOG,
    WindowFault.STOPPED,
)
_CHANNEL_FAULTS = {WindowFault.UNIT: Consequence.CHANNELS, WindowFault.VALUE: Consequence.CHANNELS}
_NO_PHASE = {WindowFault.SILENT: Consequence.NONE, WindowFault.PHASE_JUMP: Consequence.NONE}
# Noise has no phase, and any part of it is as good as another.
_WITHOUT_PHASE = {WindowFault.MISSING: Consequence.PARTS, **_NO_PHASE}
_EXCEPTIONS: dict[TestKind, dict[WindowFault, Consequence]] = {
    # A sweep that was given up half way has measured the first half.
    TestKind.SWEEP: {
        **dict.fromkeys(
            (*_BROKEN, WindowFault.LOST_LOCK, WindowFault.INCOMPLETE, WindowFault.SET_BACK, WindowFault.PHASE_JUMP),
            Consequence.REST,
        ),
        WindowFault.SILENT: Consequence.NONE,
    },
    # The drive is switched off: the decay has its own phase.
    TestKind.RING_DOWN: _NO_PHASE,
    # Any excitation, any channels: the model is driven by the input that was measured.
    TestKind.RECORD: {
        **dict.fromkeys(_BROKEN, Consequence.CHANNELS),
        **_NO_PHASE,
    },
}


@dataclass(frozen=True)
class WindowPolicy:
    """What each fault does to a window of one kind of test.

    Attributes:
        kind: the kind of test.
        effects: by fault; all are there.
        holds_lock: the loop must be locked from the lock to the end of the window; for other kinds it is enough that
            the test was not given up.
    """

    kind: TestKind
    effects: Mapping[WindowFault, Consequence]
    holds_lock: bool

    def effect(self, finding: WindowFinding, topics: Sequence[str]) -> Consequence:
        """What a finding does to a window that needs some topics; the others only lose their channels."""
        effect = self.effects[finding.fault]
        if effect is not Consequence.NONE and finding.topic and finding.topic not in topics:
            return Consequence.CHANNELS
        return effect


def _policy(kind: TestKind) -> WindowPolicy:
    exceptions = _EXCEPTIONS.get(kind, {} if kind_class(kind).has_phase else _WITHOUT_PHASE)
    effects = {**dict.fromkeys(WindowFault, Consequence.WINDOW), **_CHANNEL_FAULTS, **exceptions}
    return WindowPolicy(kind, effects, kind_class(kind).gives_modal_points)


POLICIES: Mapping[TestKind, WindowPolicy] = {kind: _policy(kind) for kind in TestKind}


class NamedWindow(NamedTuple):
    """A window as a lock event names it.

    Attributes:
        first_sample: first sample.
        samples: number of samples.
        periods: whole excitation periods; 0 = not so many.
        lock_sample: sample at which the lock was confirmed; the loop must hold it from there on.
        kind: kind of test.
    """

    first_sample: int
    samples: int
    periods: int = 0
    lock_sample: int = 0
    kind: TestKind = TestKind.PHASE_RESONANCE

    @property
    def end_sample(self) -> int:
        """Index of the sample after the last one."""
        return self.first_sample + self.samples

    @property
    def policy(self) -> WindowPolicy:
        """The rule for this kind of test."""
        return POLICIES[self.kind]


class WindowVerdict(NamedTuple):
    """What can be used of a window.

    Attributes:
        reason: one sentence on what is wrong with it; empty if nothing is that concerns the whole window.
        fault: its kind; None if nothing is wrong.
        first_sample: first sample that can be used.
        samples: how many can be used; 0 = none.
    """

    reason: str
    fault: WindowFault | None
    first_sample: int
    samples: int


def judge(
    window: NamedWindow, findings: Sequence[WindowFinding], topics: Sequence[str], *, every_channel: bool = False
) -> WindowVerdict:
    """What can be used of a window.

    Args:
        window: the window.
        findings: all that was found.
        topics: what the window needs; faults of other topics only cost the channels there.
        every_channel: a window of these topics is lost with one of their channels.
    """
    first, end = window.first_sample, window.end_sample
    found = [(finding, window.policy.effect(finding, topics)) for finding in findings]
    for finding, effect in found:
        if effect is Consequence.WINDOW:
            return WindowVerdict(finding.reason, finding.fault, first, 0)
    for finding, effect in found:
        if every_channel and effect is Consequence.CHANNELS and finding.topic in topics:
            return WindowVerdict(finding.reason, finding.fault, first, 0)
    cuts = sorted((f for f, effect in found if effect is Consequence.REST), key=lambda finding: finding.sample)
    if cuts:
        samples = min(max(0, cuts[0].sample - first), window.samples)
        return WindowVerdict(cuts[0].reason, cuts[0].fault, first, samples)
    holes = sorted((f for f, effect in found if effect is Consequence.PARTS), key=lambda finding: finding.sample)
    if not holes:
        return WindowVerdict("", None, first, window.samples)
    best, position = (first, 0), first
    for hole in [*((f.sample, f.end if f.end is not None else end) for f in holes), (end, end)]:
        if hole[0] - position > best[1]:
            best = (position, hole[0] - position)
        position = max(position, hole[1])
    if 2 * best[1] < window.samples:
        best = (first, 0)
    return WindowVerdict(holes[0].reason, holes[0].fault, *best)
