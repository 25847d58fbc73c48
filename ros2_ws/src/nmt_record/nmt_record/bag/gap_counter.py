"""Counts what is missing between the blocks of each topic."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class Continuity:
    """What one topic delivered.

    Attributes:
        first_sample: first sample received.
        next_sample: sample that the next block must begin with.
        sample_rate: of the newest block, Hz.
        blocks: number of blocks.
        gaps: number of jumps forward.
        missing_samples: samples jumped over.
        repeats: blocks that began before the expected sample (a restarted or doubled source).
    """

    first_sample: int
    next_sample: int
    sample_rate: float
    blocks: int = 0
    gaps: int = 0
    missing_samples: int = 0
    repeats: int = 0


@dataclass(slots=True)
class GapCounter:
    """Continuity of every sample topic: block n+1 must begin where block n ends.

    Attributes:
        topics: by topic name.
    """

    topics: dict[str, Continuity] = field(default_factory=dict)

    def add(self, topic: str, first_sample: int, samples: int, sample_rate: float) -> int:
        """Take note of a block.

        Args:
            topic: its topic.
            first_sample: index of its first sample.
            samples: number of samples.
            sample_rate: Hz.

        Returns:
            Number of samples missing before it.
        """
        state = self.topics.get(topic)
        if state is None:
            state = Continuity(first_sample, first_sample, sample_rate)
            self.topics[topic] = state
        missing = first_sample - state.next_sample
        if missing > 0:
            state.gaps += 1
            state.missing_samples += missing
        elif missing < 0:
            state.repeats += 1
        state.blocks += 1
        state.next_sample = first_sample + samples
        state.sample_rate = sample_rate
        return max(missing, 0)

    def reached(self, sample: int) -> bool:
        """Whether every topic seen so far has delivered ``sample``."""
        return all(state.next_sample > sample for state in self.topics.values())

    @property
    def recorded(self) -> int:
        """First sample that not every topic seen so far has delivered; 0 before the first block."""
        return min((state.next_sample for state in self.topics.values()), default=0)

    def lacking(self, end_sample: int | None = None) -> float:
        """Bench time that is missing, s, of the topic that lacks most: in its gaps and up to the end.

        Args:
            end_sample: last sample that there should be; None = not known.
        """
        lacks = 0.0
        for state in self.topics.values():
            at_end = 0 if end_sample is None else max(end_sample + 1 - state.next_sample, 0)
            if state.sample_rate > 0:
                lacks = max(lacks, (state.missing_samples + at_end) / state.sample_rate)
        return lacks

    @property
    def gaps(self) -> int:
        """Gaps of all topics together."""
        return sum(state.gaps for state in self.topics.values())

    @property
    def missing_samples(self) -> int:
        """Missing samples of all topics together."""
        return sum(state.missing_samples for state in self.topics.values())

    def bench_time(self) -> float:
        """Bench time after the newest sample, s; 0 before the first."""
        return max((s.next_sample / s.sample_rate for s in self.topics.values() if s.sample_rate > 0), default=0.0)

    def as_dict(self) -> dict[str, dict[str, int]]:
        """For the stop record."""
        return {
            topic: {
                "first_sample": state.first_sample,
                "end_sample": state.next_sample,
                "blocks": state.blocks,
                "gaps": state.gaps,
                "missing_samples": state.missing_samples,
                "repeats": state.repeats,
            }
            for topic, state in self.topics.items()
        }
