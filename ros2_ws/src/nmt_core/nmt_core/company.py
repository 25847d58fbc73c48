"""What a node knows of the other nodes from their heartbeats, free of ROS: who is ready, silent, hung, failed or there
twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

READY = "ready"
HUNG = "hung"
_FOR_GOOD = 1.0  # s without the process before, which beats four times a second
_DEAF = 1.0  # s without listening after which nobody else is to blame for the silence


@dataclass
class _Heard:
    """The newest heartbeat of a name.

    Attributes:
        time: when, s.
        message: its words.
        instance: the process it came from.
        before: the process that used the name before.
        twice: when two processes were last heard in turn, s.
        since: when the process took over from another one, s.
    """

    time: float
    message: str
    instance: str
    before: str = ""
    twice: float = -1.0e9
    since: float = -1.0e9


class Company:
    """The nodes around one node.

    Heartbeats carry the name of their process. Where two processes use one name in turn, none of the two can be
    trusted; where a second one takes over for good, the node has been started again.

    Args:
        watched: names of the nodes that matter.
        silence_timeout: s without a heartbeat after which a node is lost.
        own: name of this node.
        own_instance: its process.

    Attributes:
        failures: errors that watched nodes have reported, by name.
    """

    def __init__(self, watched: Sequence[str], silence_timeout: float, own: str = "", own_instance: str = "") -> None:
        self.watched = tuple(watched)
        self.failures: dict[str, str] = {}
        self._met = -1.0e9
        self._silence = silence_timeout
        self._own, self._own_instance = own, own_instance
        self._heard: dict[str, _Heard] = {}
        self._listened: float | None = None

    def listened(self, now: float) -> None:
        """This node has taken all that came until ``now`` (s); time in which it could not listen does not count."""
        gap = 0.0 if self._listened is None else now - self._listened
        if gap > _DEAF:
            for heard in self._heard.values():
                heard.time += gap
        self._listened = now

    def hear(self, name: str, instance: str, message: str, failed: bool, now: float) -> None:
        """Take a heartbeat.

        Args:
            name: of the node.
            instance: its process.
            message: its words.
            failed: whether it reports an error.
            now: s.
        """
        heard = self._heard.get(name)
        if heard is None:
            heard = self._heard[name] = _Heard(now, message, instance)
        if name == self._own and instance != self._own_instance:
            heard.before, heard.instance, heard.twice = self._own_instance, instance, now
        elif name != self._own and instance != heard.instance:
            if instance == heard.before:
                heard.twice = now
            heard.before, heard.instance, heard.since = heard.instance, instance, now
        heard.time, heard.message = now, message
        if failed and name in self.watched:
            self.failures[name] = message

    def silent(self, now: float) -> str:
        """A watched node that was heard once and has fallen silent, or whose work stands still; empty if none."""
        return next(iter(self.all_silent(now)), "")

    def all_silent(self, now: float) -> list[str]:
        """All such nodes, in the order of the watched ones."""
        if self._listened is None or now - self._listened > _DEAF:
            return []
        return [
            name
            for name in self.watched
            if (heard := self._heard.get(name)) is not None
            and (now - heard.time > self._silence or heard.message.startswith(HUNG))
        ]

    @property
    def unheard(self) -> list[str]:
        """Watched nodes of which no heartbeat has come yet."""
        return [name for name in self.watched if name not in self._heard]

    def meet_again(self, now: float) -> None:
        """A run begins (at ``now``, s): who was started again since the last one may be discovered a little later."""
        self._met = now
        for heard in self._heard.values():
            heard.time = max(heard.time, now)

    def restarted(self, now: float) -> list[str]:
        """Watched nodes whose process took over from another one since the run began, and for good."""
        return [
            name
            for name in self.watched
            if (heard := self._heard.get(name)) is not None
            and self._met < heard.since < now - _FOR_GOOD
            and now - heard.twice > self._silence
        ]

    def unheard_since(self, time: float) -> list[str]:
        """Watched nodes of which no heartbeat has come since a time, s."""
        return [name for name in self.watched if name not in self._heard or self._heard[name].time < time]

    def unready(self, now: float) -> dict[str, str]:
        """Watched nodes that have not called themselves ready, each with what it waits for."""
        states = {}
        for name in self.watched:
            heard = self._heard.get(name)
            if heard is None:
                states[name] = "not heard of"
            elif now - heard.time > self._silence:
                states[name] = "silent"
            elif heard.message != READY:
                states[name] = heard.message
        return states

    def twice(self, now: float) -> str:
        """A sentence that names a node which is there twice; empty if none is."""
        for name in (self._own, *self.watched):
            heard = self._heard.get(name)
            if heard is not None and now - heard.twice <= self._silence:
                return f"node {name} is there twice: {' and '.join(sorted((heard.before, heard.instance)))}"
        return ""
