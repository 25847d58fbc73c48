"""What a node knows of the other nodes, free of ROS: who is ready, busy, stopped, hung, dead, failed or there twice.

In real time a node without a heartbeat for the silence time-out is lost. In lockstep wall time decides nothing: a node
is *dead* when its process has ended, *hung* when it could have worked for `HANG_LIMIT` and has said nothing, and else
*busy* or *stopped*, for which the run waits. Of a node on another host only the heartbeats are known, and it is judged
as in real time.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from nmt_core.processes.process_watch import ProcessWatch, process_of

READY = "ready"
HUNG = "hung"
BUSY = "busy"
HANG_LIMIT = 60.0  # s with a processor at hand, 3,000 blocks of 20 ms, after which a node in lockstep hangs
_OVERDUE = 1.0  # s without a heartbeat, of which there are four a second, after which its process is looked at
_FOR_GOOD = 1.0  # s without the process before, which beats four times a second
_DEAF = 1.0  # s without listening after which the silence is this node's own


@dataclass
class _Heard:
    """The newest heartbeat of a name.

    Attributes:
        time: when, s.
        message: its words.
        instance: the process it came from.
        watch: that process; None on another host.
        pace: the same, for `could_work`.
        here: whether it is this process.
        free: s since the heartbeat in which the process could have worked.
        looking: whether `free` is being counted.
        before: the process that used the name before.
        twice: when two processes were last heard in turn, s.
        since: when the process took over from another one, s.
    """

    time: float
    message: str
    instance: str
    watch: ProcessWatch | None = None
    pace: ProcessWatch | None = None
    here: bool = False
    free: float = 0.0
    looking: bool = False
    before: str = ""
    twice: float = -1.0e9
    since: float = -1.0e9


def watch_of(instance: str) -> ProcessWatch | None:
    """The process that a heartbeat names, where it can be watched from here."""
    process = process_of(instance)
    if process is None:
        return None
    try:
        return ProcessWatch(process)
    except (OSError, AttributeError):  # ended by now, or a system without process descriptors
        return None


class Liveness:
    """The nodes around one node.

    Heartbeats carry the name of their process. Where two processes use one name in turn, none of the two can be
    trusted; where a second one takes over for good, the node has been started again.

    Args:
        watched: names of the nodes that matter.
        silence_timeout: s without a heartbeat after which a node is lost in real time.
        own: name of this node.
        own_instance: its process.
        lockstep: whether the run waits for its nodes.
        watching: how a process is watched, by the name that its heartbeats give.

    Attributes:
        failures: errors that watched nodes have reported, by name.
    """

    def __init__(
        self,
        watched: Sequence[str],
        silence_timeout: float,
        own: str = "",
        own_instance: str = "",
        *,
        lockstep: bool = False,
        watching: Callable[[str], ProcessWatch | None] = watch_of,
    ) -> None:
        self.watched = tuple(watched)
        self.failures: dict[str, str] = {}
        self._met = -1.0e9
        self._silence = silence_timeout
        self._own, self._own_instance = own, own_instance
        self._lockstep, self._watching = lockstep, watching
        self._heard: dict[str, _Heard] = {}
        self._listened: float | None = None

    def listened(self, now: float) -> None:
        """This node has taken all that came until ``now`` (s); time in which it could not listen does not count."""
        gap = 0.0 if self._listened is None else now - self._listened
        for heard in self._heard.values():
            if gap > _DEAF:
                heard.time += gap
            if self._lockstep and heard.watch is not None and heard.watch.lives:
                self._look(heard, now)
        self._listened = now

    @staticmethod
    def _look(heard: _Heard, now: float) -> None:
        assert heard.watch is not None
        if now - heard.time <= _OVERDUE:
            heard.looking, heard.free = False, 0.0
        elif heard.looking:
            heard.free += heard.watch.looked(now)[0]
        else:
            heard.looking = True
            heard.watch.begin(now)

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
            self._meet(heard)
        if name == self._own and instance != self._own_instance:
            heard.before, heard.instance, heard.twice = self._own_instance, instance, now
        elif name != self._own and instance != heard.instance:
            if instance == heard.before:
                heard.twice = now
            heard.before, heard.instance, heard.since = heard.instance, instance, now
            self._meet(heard)
        heard.time, heard.message, heard.free = now, message, 0.0
        if failed and name in self.watched:
            self.failures[name] = message

    def _meet(self, heard: _Heard) -> None:
        heard.here = process_of(heard.instance) == os.getpid()
        watched = self._lockstep and not heard.here and heard.instance != self._own_instance
        heard.watch, heard.pace = (self._watching(heard.instance) if watched else None for _ in range(2))

    def _judge(self, heard: _Heard, now: float) -> str:
        """Why a node that was heard once is lost, as it is said of it; empty if it is not."""
        if heard.message.startswith(HUNG):
            return "hangs"
        if self._lockstep and heard.here:
            return ""
        if self._lockstep and heard.watch is not None:
            if not heard.watch.lives:
                return "has died"
            return f"hangs: it could have worked for {HANG_LIMIT:.0f} s" if heard.free > HANG_LIMIT else ""
        deaf = self._listened is None or now - self._listened > _DEAF
        return "has fallen silent" if not deaf and now - heard.time > self._silence else ""

    def lost(self, now: float) -> dict[str, str]:
        """Watched nodes that were heard once and are lost, in the order of the watched ones, each with why."""
        found = {}
        for name in self.watched:
            heard = self._heard.get(name)
            why = self._judge(heard, now) if heard is not None else ""
            if why:
                found[name] = why
        return found

    def first_lost(self, now: float) -> str:
        """A sentence on the first of `lost`, without a full stop; empty if none is."""
        return next((f"node {name} {why}" for name, why in self.lost(now).items()), "")

    def waited_for(self, now: float) -> dict[str, str]:
        """Watched nodes that a run in lockstep waits for, each with why: it is stopped, or busy."""
        found = {}
        for name in self.watched:
            heard = self._heard.get(name)
            if not self._lockstep or heard is None or self._judge(heard, now):
                continue
            if heard.message.startswith(BUSY):
                found[name] = f"is {heard.message}"
            elif now - heard.time > _OVERDUE and heard.watch is not None:
                stopped = heard.watch.is_stopped
                found[name] = f"is stopped (process {heard.watch.process})" if stopped else "is busy"
        return found

    def could_work(self, now: float) -> float:
        """Time since the last call in which every watched node on this host that lives could have worked, s.

        None of them waited for a processor or was stopped; infinite where none is known.
        """
        paces = [self._heard[name].pace for name in self.watched if name in self._heard]
        return min((pace.looked(now)[0] for pace in paces if pace is not None and pace.lives), default=float("inf"))

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

    def forget_failures(self, now: float) -> None:
        """Start over: what a watched node reported before a run (which begins at ``now``, s) does not end it."""
        self.failures.clear()
        self.meet_again(now)

    def first_failure(self) -> tuple[str, str]:
        """A watched node that reports an error, and its words; empty if none does."""
        return next(iter(self.failures.items()), ("", ""))

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
                states[name] = self._judge(heard, now) or self.waited_for(now).get(name, "silent").removeprefix("is ")
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
