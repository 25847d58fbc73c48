"""Whether a command that arrives can be meant: one source, numbers that are finite, samples that can exist.

Every message on a command topic names samples. One that names a sample far ahead would hold the bench until then, one
that claims to answer an unmeasured block would switch the lockstep rule off. A judge stands before each topic
and says, in a sentence, why a message is not taken.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from nmt_core.errors import BenchError

_MOST_STRANGERS = 100  # tokens remembered; the count goes on
LONGEST_AHEAD = 60.0  # s of bench time that a command may name ahead; no ramp or wait of the bench is longer


@dataclass(frozen=True)
class CommandSource:
    """Who publishes on a topic.

    Attributes:
        token: what tells it from others, such as the GID of its publisher.
        name: fully qualified name of its node, for people.
        alone: False if the topic has several publishers, of which any may have sent a message.
    """

    token: str
    name: str = field(default="", compare=False)
    alone: bool = True

    def __str__(self) -> str:
        return self.name or self.token


class Refusal(Enum):
    """Why a command was not taken; the value goes into counters."""

    SOURCE = "second_source"
    NOT_FINITE = "not_finite"
    NOT_MEASURED = "not_measured_yet"
    NOT_A_BLOCK = "not_the_end_of_a_block"
    REPEATED = "repeated_or_going_back"
    GAP = "gap"
    AHEAD = "too_far_ahead"


@dataclass
class CommandJudge:
    """Judges the messages of one topic; counts and names what it refuses.

    Attributes:
        block_samples: samples in a block.
        horizon: samples ahead of the present one that a message may name.
        most_missing: blocks that a source may leave unanswered between two messages. In lockstep no more than the
            plant runs ahead; in real time what a stalled loop may miss.
        source: token of the source that is accepted; None = the first whose message is plausible.
        last: last sample that an accepted message was based on, None before the first.
        accepted: messages taken.
        missing: unanswered blocks, between accepted messages.
        refused: kind -> messages not taken.
        strangers: token of a source that was refused -> its messages.
        latest: sentence about the message refused last, empty while there is none.
    """

    block_samples: int
    horizon: int
    most_missing: int = 0
    source: Hashable = None
    last: int | None = field(default=None, init=False)
    accepted: int = field(default=0, init=False)
    missing: int = field(default=0, init=False)
    refused: Counter[Refusal] = field(default_factory=Counter, init=False)
    strangers: Counter[Hashable] = field(default_factory=Counter, init=False)
    latest: str = field(default="", init=False)
    _present: int = field(default=0, init=False)  # as `last`, but kept for the next run: samples are never counted anew

    def __post_init__(self) -> None:
        if self.block_samples < 1 or self.horizon < 1 or self.most_missing < 0:
            raise BenchError(
                "command judge: block_samples and horizon must be at least 1 and most_missing at least 0, got "
                f"{self.block_samples}, {self.horizon} and {self.most_missing}."
            )

    def judge(
        self,
        source: Hashable,
        *,
        next_sample: int | None = None,
        based_on: int | None = None,
        apply_at: int | None = None,
        values: Mapping[str, float] | None = None,
    ) -> str:
        """Take or refuse a message.

        Args:
            source: who sent it: any token that stays the same, such as the publisher's GID.
            next_sample: first sample that has not been measured yet; None = not known here, then what the newest
                accepted message was based on stands for it, also that of a run before.
            based_on: last sample the message was computed from; None = it names none.
            apply_at: sample it takes effect at; None = it names none.
            values: its numbers by name.

        Returns:
            Empty if the message is taken, otherwise the sentence why not.
        """
        refusal = self._refusal(source, next_sample, based_on, apply_at, values or {})
        if refusal is not None:
            kind, self.latest = refusal
            self.refused[kind] += 1
            return self.latest
        self.source = source
        self.accepted += 1
        if based_on is not None:
            if self.last is not None:
                self.missing += (based_on - self.last) // self.block_samples - 1
            self.last = self._present = based_on
        return ""

    def _refusal(
        self,
        source: Hashable,
        next_sample: int | None,
        based_on: int | None,
        apply_at: int | None,
        values: Mapping[str, float],
    ) -> tuple[Refusal, str] | None:
        if isinstance(source, CommandSource) and not source.alone:
            self.strangers[source] += 1
            return Refusal.SOURCE, f"the topic has several publishers, {source}; one is accepted."
        if self.source is not None and source != self.source:
            if source in self.strangers or len(self.strangers) < _MOST_STRANGERS:
                self.strangers[source] += 1
            return Refusal.SOURCE, f"it comes from a second source, {source}; the one accepted is {self.source}."
        for name, value in values.items():
            if not math.isfinite(value):
                return Refusal.NOT_FINITE, f"its {name} is {value}; it must be finite."
        if based_on is not None:
            found = self._refusal_of_base(based_on, next_sample)
            if found is not None:
                return found
        present = next_sample if next_sample is not None else self._present
        if apply_at is not None and apply_at > present + self.horizon:
            return Refusal.AHEAD, (
                f"it is for sample {apply_at}, more than {self.horizon} samples ahead of sample {present}."
            )
        return None

    def _refusal_of_base(self, based_on: int, next_sample: int | None) -> tuple[Refusal, str] | None:
        if next_sample is not None and based_on >= next_sample:
            return Refusal.NOT_MEASURED, (
                f"it claims to be based on sample {based_on}, which has not been measured; the next sample is "
                f"{next_sample}."
            )
        if next_sample is None and based_on > self._present + self.horizon:
            return Refusal.AHEAD, (
                f"it claims to be based on sample {based_on}, more than {self.horizon} samples ahead of sample "
                f"{self._present}."
            )
        if (based_on + 1) % self.block_samples:
            return Refusal.NOT_A_BLOCK, (
                f"it claims to be based on sample {based_on}, which is not the last of a block of "
                f"{self.block_samples} samples."
            )
        if self.last is None:
            return None
        if based_on <= self.last:
            return Refusal.REPEATED, f"it is based on sample {based_on}; sample {self.last} was answered before."
        missing = (based_on - self.last) // self.block_samples - 1
        if missing > self.most_missing:
            return Refusal.GAP, (
                f"it is based on sample {based_on} after {self.last}: {missing} blocks were left out, "
                f"{self.most_missing} are allowed."
            )
        return None

    @property
    def second_source(self) -> str:
        """The sources refused, by name; empty while one source only has sent."""
        return ", ".join(str(source) for source in self.strangers)

    def release(self, present: int | None = None) -> None:
        """Accept any source and any first sample near the present one again, for a new run.

        The counts stay, the strangers are forgotten.

        Args:
            present: the present sample where the plant's count is another than before; None = as before.
        """
        if present is not None:
            self._present = present
        self.source = None
        self.strangers.clear()
        self.last = None

    @property
    def counts(self) -> dict[str, int]:
        """Counters for diagnostics: taken, unanswered blocks, and refusals, by kind."""
        return {
            "accepted": self.accepted,
            "missing_blocks": self.missing,
            **{f"refused_{kind.value}": count for kind, count in self.refused.items()},
        }
