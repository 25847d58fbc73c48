"""What is wrong with messages that a bridge takes, in sentences: stamps, names, samples that cannot be made."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_plant.topic_bridge_table import BridgeChannel, BridgeTable

_SET_BACK = 16  # messages one after the other whose stamps rise, but from an earlier time
_APART = 0.5  # s between the bases of two clocks
_FIRST = 20  # messages by which a topic is judged
_BLOCKS_WITHIN = 3.0  # patiences: blocks that have not come by then cannot be made
_MISSING = 0.2  # of the samples of a channel: worth a sentence
_JUDGED = 5  # blocks after which missing samples are judged, once


@dataclass(eq=False)
class _Watched:
    """What came of one topic."""

    channels: list[BridgeChannel]
    count: int = 0
    zero: int = 0
    late: int = 0
    first_zero: int = 0
    unstamped: bool = False
    lead: float = math.nan
    run: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=_SET_BACK))
    arrivals: deque[int] = field(default_factory=lambda: deque(maxlen=200))
    stamps: deque[int] = field(default_factory=lambda: deque(maxlen=200))
    found: set[str] = field(default_factory=set)
    last: tuple[int, int] = (0, 0)


class StampWatch:
    """Judges the stamps of messages as they come.

    Args:
        table: the channels.
        patience: s by which a topic may be behind the others.
    """

    def __init__(self, table: BridgeTable, patience: float) -> None:
        self._clock, self._rate, self._patience = table.clock, table.sample_rate, patience
        self._topics: dict[str, _Watched] = {}
        for channel in table.channels:
            self._topics.setdefault(channel.topic, _Watched([])).channels.append(channel)
        self._sentences: list[str] = []
        self._began: int | None = None
        self._blocks = 0
        self._samples: dict[str, tuple[int, int]] = {}
        self._waiting = False
        self._apart = False

    def time_of(self, topic: str, message: Any, arrived_ns: int) -> int | None:
        """Time of a message, ns; None where it has none that can be used."""
        topic_state = self._topics[topic]
        topic_state.count += 1
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        if stamp is None or self._clock == "arrival" or topic_state.unstamped:
            return arrived_ns
        time = int(stamp.sec) * 10**9 + int(stamp.nanosec)
        if time > 0:
            return time
        topic_state.zero += 1
        topic_state.first_zero = topic_state.first_zero or arrived_ns
        if topic_state.zero == 1:
            self._say(f"Messages of {topic} have a stamp of zero; they are left out.")
        only_zero = topic_state.zero == topic_state.count
        if only_zero and arrived_ns - topic_state.first_zero > self._patience * 1e9:
            topic_state.unstamped = True
            self._say(f"No message of {topic} has a stamp; its samples are placed by their arrival, phases with it.")
            return arrived_ns
        return None

    def late(self, topic: str, behind_s: float, time: int, arrived_ns: int) -> int | None:
        """Take note of a message whose stamp does not rise.

        Returns:
            Where its time goes on if the clock was set back for good, ns; None = leave it out.
        """
        state = self._topics[topic]
        state.late += 1
        if state.run and time <= state.run[-1][0]:
            state.run.clear()
        state.run.append((time, arrived_ns))
        if state.late in (1, 100, 10_000):
            self._say(
                f"{state.late} of {state.count} messages of {topic} have a stamp that does not rise (the last by "
                f"{behind_s:.6g} s); they are left out."
            )
        if len(state.run) < _SET_BACK:
            return None
        state.run.clear()
        at, arrived = state.last
        self._say(f"The stamps of {topic} were set back by {-behind_s:.6g} s; its samples go on by their arrival.")
        return at + max(1, arrived_ns - arrived)

    def taken(self, topic: str, message: Any, time: int, arrived_ns: int) -> None:
        """Take note of a message that is used."""
        state = self._topics[topic]
        state.run.clear()
        state.last = (time, arrived_ns)
        state.arrivals.append(arrived_ns)
        state.stamps.append(time)
        self._began = arrived_ns if self._began is None else self._began
        lead = (arrived_ns - time) * 1e-9
        state.lead = lead if math.isnan(state.lead) else min(state.lead, lead)
        if state.count == _FIRST:
            for channel in state.channels:
                lack = channel.lack(message)
                if lack:
                    self._say(f"{topic} gives nothing for channel {channel.name}: {lack}.")

    def cut(self, channels: Sequence[BridgeChannel], data: FloatArray) -> None:
        """Take note of a block that was made, shape (channels, samples)."""
        self._blocks += 1
        for channel, row in zip(channels, data, strict=True):
            missing, every = self._samples.get(channel.name, (0, 0))
            missing, every = missing + int(np.isnan(row).sum()), every + row.size
            self._samples[channel.name] = missing, every
            state = self._topics[channel.topic]
            if every >= _JUDGED * row.size and missing > _MISSING * every and channel.name not in state.found:
                state.found.add(channel.name)
                self._say(self._on_missing(channel, missing / every))

    def findings(self, now_ns: int) -> list[str]:
        """Sentences that are new."""
        self._judge_bases()
        late = self._began is not None and now_ns - self._began > _BLOCKS_WITHIN * self._patience * 1e9
        if late and not self._blocks and not self._waiting:
            self._waiting = True
            silent = [topic for topic, state in self._topics.items() if not state.stamps]
            why = f"nothing that can be used came on {', '.join(silent)}" if silent else "no topic has passed its end"
            self._say(f"No block could be made yet: {why}.")
        sentences, self._sentences = self._sentences, []
        return sentences

    def _judge_bases(self) -> None:
        ready = [(topic, state) for topic, state in self._topics.items() if state.count >= _FIRST]
        ready = [(topic, state) for topic, state in ready if math.isfinite(state.lead)]
        if self._apart or len(ready) < 2:
            return
        first, last = min(ready, key=lambda pair: pair[1].lead), max(ready, key=lambda pair: pair[1].lead)
        apart = last[1].lead - first[1].lead
        if apart > _APART:
            self._apart = True
            self._say(
                f"The stamps of {first[0]} and {last[0]} count from different times ({apart:.6g} s apart by their "
                "arrival): no sample has both; bring their clocks together, or say 'clock: arrival' in the table."
            )

    def _on_missing(self, channel: BridgeChannel, share: float) -> str:
        stamps = np.array(self._topics[channel.topic].stamps, dtype=np.float64) * 1e-9
        steps = np.diff(stamps)
        what = f"{100 * share:.0f} % of the samples of channel {channel.name} are missing"
        if steps.size < _FIRST:
            return f"{what}: hardly any message of {channel.topic} came."
        rate = steps.size / float(stamps[-1] - stamps[0])
        return (
            f"{what}: {channel.topic} has {rate:.4g} messages a second with stamps {1e3 * float(steps.min()):.3g} to "
            f"{1e3 * float(steps.max()):.3g} ms apart (stamped on arrival, or messages are lost) for a grid of "
            f"{self._rate:g} Hz; let the sensor stamp its samples, or lower sample_rate."
        )

    def _say(self, sentence: str) -> None:
        self._sentences.append(sentence)
